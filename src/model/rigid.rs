use crate::geometry::{Vec2, add, cross, dot, scale, sub};

/// How much lighter than single vertices the rigid translations and rotations of a particle are made, less one.
///
/// Near jamming the softest modes are particles that roll and shift against each other, stiff by the pressure only,
/// while the time step is set by the stiffest vertex against a contact. The same contacts hold a particle as a whole,
/// shared over its vertices, so its rigid motion bears a smaller mass at the same time step. A rotation is held by the
/// short levers of the contact normals alone and bears the smallest.
const TRANSLATION: f64 = 2.0;
const ROTATION: f64 = 10.0;

/// What lighter rigid motions add: to each force `push`, and `turn` times the arm turned by 90°.
pub(super) struct Lighter {
    pub push: Vec2,
    pub turn: f64,
}

impl Lighter {
    /// From the mean force, and torque and moment of inertia about the mean vertex.
    #[inline(always)]
    pub fn new(mean_force: Vec2, torque: f64, inertia: f64) -> Self {
        let turn = if inertia > 0.0 { ROTATION * torque / inertia } else { 0.0 };
        Lighter { push: scale(TRANSLATION, mean_force), turn }
    }
}

/// Writes (1 + 2 P_t + 10 P_r) F for the vertices of one particle, P_t and P_r the projections of the forces F on its
/// translations and its rotation about the mean vertex. The array holds the vertices, from any origin, at first.
#[inline(always)]
pub(super) fn lighten(forces: &[Vec2], lightened: &mut [Vec2]) {
    let per_vertex = 1.0 / forces.len() as f64;
    let (mut mean_arm, mut mean_force) = ([0.0; 2], [0.0; 2]);
    for (arm, f) in lightened.iter().zip(forces) {
        mean_arm = add(mean_arm, *arm);
        mean_force = add(mean_force, *f);
    }
    (mean_arm, mean_force) = (scale(per_vertex, mean_arm), scale(per_vertex, mean_force));
    let (mut torque, mut inertia) = (0.0, 0.0);
    for (arm, &f) in lightened.iter_mut().zip(forces) {
        *arm = sub(*arm, mean_arm);
        torque += cross(*arm, f);
        inertia += dot(*arm, *arm);
    }
    let Lighter { push, turn } = Lighter::new(mean_force, torque, inertia);
    for (slot, f) in lightened.iter_mut().zip(forces) {
        let arm = *slot;
        *slot = [f[0] + push[0] - turn * arm[1], f[1] + push[1] + turn * arm[0]];
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    #[test]
    fn rigid_motions_are_multiplied_and_others_kept() {
        let corners = [[7.5, 7.6], [8.6, 7.7], [8.7, 8.4], [7.9, 8.9], [7.4, 8.2]];
        let middle = scale(0.2, corners.iter().fold([0.0; 2], |a, &b| add(a, b)));
        let lightened = |forces: [Vec2; 5]| {
            let mut result = corners.map(|c| sub(c, corners[0]));
            lighten(&forces, &mut result);
            result
        };
        let close =
            |a: [Vec2; 5], b: [Vec2; 5]| a.iter().flatten().zip(b.iter().flatten()).all(|(x, y)| (x - y).abs() < 1e-14);
        let shift = [[0.3, -0.7]; 5];
        assert!(close(lightened(shift), shift.map(|f| scale(1.0 + TRANSLATION, f))));
        let turn = corners.map(|c| [middle[1] - c[1], c[0] - middle[0]]);
        assert!(
            lightened(turn)
                .iter()
                .flatten()
                .zip(turn.iter().flatten())
                .all(|(x, y)| (x - (1.0 + ROTATION) * y).abs() < 1e-12)
        );
        // symmetric: a·Mb = b·Ma
        let (a, b) =
            ([[1.0, 0.2], [0.3, -2.0], [0.0, 0.5], [1.5, 1.0], [-0.4, 0.1]], turn.map(|t| [t[0] * t[0], t[1]]));
        let product = |x: [Vec2; 5], y: [Vec2; 5]| x.iter().zip(y).map(|(&x, y)| dot(x, y)).sum::<f64>();
        assert!((product(a, lightened(b)) - product(b, lightened(a))).abs() < 1e-12);
    }
}
