//! The masses by which minimisers move the points of a deformable particle, as seen by their forces: the map M⁻¹, which
//! multiplies its rigid motions and its growth and keeps all else. The minimum is the same with any masses; what they
//! change is how far the softest motions get while the stiffest hold the time step.

use crate::geometry::{Vec2, add, cross, dot, scale, sub};

/// How much lighter than single vertices the rigid translations and rotations of a particle are made, less one.
///
/// Near jamming the softest modes are particles that roll and shift against each other, stiff by the pressure only,
/// while the time step is set by the stiffest vertex against a contact. The same contacts hold a particle as a whole,
/// shared over its vertices, so its rigid motion bears a smaller mass at the same time step. A rotation is held by the
/// short levers of the contact normals alone and bears the smallest.
const TRANSLATION: f64 = 2.0;
const ROTATION: f64 = 10.0;

/// What M⁻¹ adds to each force: `push`, `turn` times the arm turned by 90°, and `growth` times the outward chord, which is
/// the vector from the vertex before to the one after, turned by −90°: twice the gradient of the area.
pub(super) struct Added {
    pub push: Vec2,
    pub turn: f64,
    pub growth: f64,
}

impl Added {
    /// From the mean force, torque and moment of inertia about the mean vertex, the sum of forces times outward chords and
    /// that of squared chords; `held` is the part of forces on the growth that is taken away.
    #[inline(always)]
    pub fn new(mean_force: Vec2, [torque, inertia]: [f64; 2], [growth, square]: [f64; 2], held: f64) -> Self {
        let over = |product: f64, norm: f64| if norm > 0.0 { product / norm } else { 0.0 };
        Added {
            push: scale(TRANSLATION, mean_force),
            turn: over(ROTATION * torque, inertia),
            growth: over(-held * growth, square),
        }
    }
}

/// Writes M⁻¹F = (1 + 2 P_t + 10 P_r − held P_g) F for the vertices of one particle, with P_t, P_r and P_g the projections
/// of the forces F on its translations, its rotation about the mean vertex, and the gradient of its area. The array holds
/// the vertices, from any origin, at first.
pub(super) fn accelerate(forces: &[Vec2], accelerations: &mut [Vec2], held: f64) {
    let n = forces.len();
    let mean = |vectors: &[Vec2]| scale(1.0 / n as f64, vectors.iter().fold([0.0; 2], |sum, &v| add(sum, v)));
    let (mean_arm, mean_force) = (mean(accelerations), mean(forces));
    let [first, last] = [accelerations[0], accelerations[n - 1]];
    let outward = |before: Vec2, after: Vec2| [after[1] - before[1], before[0] - after[0]];
    let (mut rotation, mut growth) = ([0.0; 2], [0.0; 2]);
    let mut before = last;
    for (k, &f) in forces.iter().enumerate() {
        let here = accelerations[k];
        let (arm, out) = (sub(here, mean_arm), outward(before, accelerations.get(k + 1).copied().unwrap_or(first)));
        rotation = add(rotation, [cross(arm, f), dot(arm, arm)]);
        growth = add(growth, [dot(out, f), dot(out, out)]);
        before = here;
    }
    let Added { push, turn, growth } = Added::new(mean_force, rotation, growth, held);
    before = last;
    for (k, &f) in forces.iter().enumerate() {
        let here = accelerations[k];
        let (arm, out) = (sub(here, mean_arm), outward(before, accelerations.get(k + 1).copied().unwrap_or(first)));
        let rigid = add(push, [-turn * arm[1], turn * arm[0]]);
        accelerations[k] = add(f, add(rigid, scale(growth, out)));
        before = here;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rigid_motions_and_growth_are_multiplied_and_others_kept() {
        let corners = [[7.5, 7.6], [8.6, 7.7], [8.7, 8.4], [7.9, 8.9], [7.4, 8.2]];
        let middle = scale(0.2, corners.iter().fold([0.0; 2], |a, &b| add(a, b)));
        let accelerated = |forces: [Vec2; 5]| {
            let mut result = corners.map(|c| sub(c, corners[0]));
            accelerate(&forces, &mut result, 0.9);
            result
        };
        let product = |x: [Vec2; 5], y: [Vec2; 5]| x.iter().zip(y).map(|(&x, y)| dot(x, y)).sum::<f64>();
        let check = |forces: [Vec2; 5], factor: f64| {
            let wanted = forces.map(|f| scale(factor, f));
            let close =
                accelerated(forces).iter().flatten().zip(wanted.iter().flatten()).all(|(x, y)| (x - y).abs() < 1e-12);
            assert!(close, "{:?} {wanted:?}", accelerated(forces));
        };
        let shift = [[0.3, -0.7]; 5];
        let turn = corners.map(|c| [middle[1] - c[1], c[0] - middle[0]]);
        let growth: [Vec2; 5] = std::array::from_fn(|k| {
            let [x, y] = sub(corners[(k + 1) % 5], corners[(k + 4) % 5]);
            [y, -x]
        });
        check(shift, 1.0 + TRANSLATION);
        check(turn, 1.0 + ROTATION);
        check(growth, 1.0 - 0.9);
        // what is none of them
        let mut other = [[1.0, 0.2], [0.3, -2.0], [0.0, 0.5], [1.5, 1.0], [-0.4, 0.1]];
        for known in [[[1.0, 0.0]; 5], [[0.0, 1.0]; 5], turn, growth] {
            let part = product(other, known) / product(known, known);
            other.iter_mut().zip(known).for_each(|(o, k)| *o = sub(*o, scale(part, k)));
        }
        assert!(product(other, other) > 0.1);
        check(other, 1.0);
        let (one, two) =
            ([[1.0, 0.2], [0.3, -2.0], [0.0, 0.5], [1.5, 1.0], [-0.4, 0.1]], turn.map(|t| [t[0] * t[0], t[1]]));
        assert!((product(one, accelerated(two)) - product(two, accelerated(one))).abs() < 1e-12, "symmetric");
    }
}
