//! The forces of deformable particles with vertex–edge contacts, made in one pass over each particle.
//!
//! The same sums as those over `Contact::for_each_touch`, arranged so that little is computed twice: positions are taken
//! once per particle ([`OutlineFrame`]), reciprocal lengths once per edge, and a vertex that faces an edge costs no root
//! and no division. Contributions that cancel are left out: where a vertex v is near the end w of an edge and the start
//! of the next, φ(|v − w|) counts once for each edge that v lies past, less once (see `vertex_edge`), which is zero
//! unless the outline turns a corner there.

use super::deformable::{Deformable, DeformableParameters};
use super::vertex_edge::VertexEdge;
use super::{Harmonic, Model, View, rigid};
use crate::geometry::{Vec2, cross};
use crate::lanes::{Kernel, Lanes};
use crate::neighbor::{OutlineFrame, Touching, VertexEdgeList};
use std::ops::Range;

/// All forces on a chunk of own particles, written to `forces`, and what they accelerate, to `lightened`.
pub(super) struct OutlineForces<'a> {
    pub model: &'a Deformable<VertexEdge>,
    pub view: &'a View<'a, VertexEdgeList>,
    pub particles: Range<usize>,
    pub forces: &'a mut [Vec2],
    pub lightened: &'a mut [Vec2],
}

impl Kernel for OutlineForces<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self, _: impl Lanes) {
        let OutlineForces { model, view, particles, forces, lightened } = self;
        let bodies = &view.particles.bodies;
        let origin = bodies.points(particles.start).start;
        let narrowed = view.lists.narrowed(particles.start);
        let (mut frame, mut sums) = (OutlineFrame::default(), Vec::new());
        for p in particles {
            let points = bodies.points(p);
            let mine = points.start - origin..points.end - origin;
            let (forces, lightened) = (&mut forces[mine.clone()], &mut lightened[mine]);
            let Some(touching) = narrowed.and_then(|chunk| chunk.of(p)) else {
                model.forces(view, p..p + 1, forces);
                model.lighten(view, p..p + 1, forces, lightened);
                continue;
            };
            frame.fill(view.pbox, view.particles, p, touching.points);
            shape(&model.parameters, view.particles.size[p], &frame, points.len(), &mut sums);
            contacts(model.parameters.contact, &frame, &touching, &mut sums);
            // the last slot repeats the first vertex
            let again = sums[points.len() + 1];
            sums[1] = [sums[1][0] + again[0], sums[1][1] + again[1]];
            forces.copy_from_slice(&sums[1..=points.len()]);
            for ((slot, &x), &y) in lightened.iter_mut().zip(&frame.x[1..]).zip(&frame.y[1..]) {
                *slot = [x, y];
            }
            rigid::lighten(forces, lightened);
        }
    }
}

/// Line tension and area forces on slots 1..=n of a frame.
///
/// With edge vectors e_i from vertex i to i + 1: −∂(γp)/∂x_i = γ(ê_i − ê_{i−1}), and ∂a/∂x_i is half the chord
/// e_{i−1} + e_i turned by −90°.
#[inline(always)]
fn shape(parameters: &DeformableParameters, rest_area: f64, frame: &OutlineFrame, n: usize, sums: &mut Vec<Vec2>) {
    let (x, y) = (&frame.x[..n + 1], &frame.y[..n + 1]);
    let (along_x, along_y, per_length) = (&frame.along_x[..n + 1], &frame.along_y[..n + 1], &frame.per_length[..n + 1]);
    let mut area2 = 0.0;
    for k in 1..n + 1 {
        area2 += cross([x[k], y[k]], [along_x[k], along_y[k]]);
    }
    let half_pressure = 0.5 * parameters.k_area * (rest_area - 0.5 * area2);
    sums.clear();
    sums.resize(n + 2, [0.0; 2]);
    for k in 1..n + 1 {
        let (pull_before, pull) =
            (parameters.line_tension * per_length[k - 1], parameters.line_tension * per_length[k]);
        sums[k] = [
            pull * along_x[k] - pull_before * along_x[k - 1] + half_pressure * (along_y[k] + along_y[k - 1]),
            pull * along_y[k] - pull_before * along_y[k - 1] - half_pressure * (along_x[k] + along_x[k - 1]),
        ];
    }
}

/// Adds the contact forces on the own slots of a frame.
#[inline(always)]
fn contacts(law: Harmonic, frame: &OutlineFrame, touching: &Touching, sums: &mut [Vec2]) {
    let n = frame.slots();
    let local = Local {
        x: &frame.x[..n],
        y: &frame.y[..n],
        along_x: &frame.along_x[..n],
        along_y: &frame.along_y[..n],
        per_length: &frame.per_length[..n],
        delta: law.delta,
        push: law.epsilon / law.delta,
        stiffness: law.epsilon / (law.delta * law.delta),
    };
    for &[v, e] in touching.faces {
        let (v, e) = (v as usize, e as usize);
        let (_, [x, y]) = local.face(v, e);
        sums[v][0] += x;
        sums[v][1] += y;
    }
    for &[v, e] in touching.opposite_faces {
        let (v, e) = (v as usize, e as usize);
        let (t, [x, y]) = local.face(v, e);
        sums[e][0] -= (1.0 - t) * x;
        sums[e][1] -= (1.0 - t) * y;
        sums[e + 1][0] -= t * x;
        sums[e + 1][1] -= t * y;
    }
    for &[v, w] in touching.corners {
        if let Some([x, y]) = local.corner(v as usize, w as usize) {
            sums[v as usize][0] += x;
            sums[v as usize][1] += y;
        }
    }
    for &[v, w] in touching.opposite_corners {
        if let Some([x, y]) = local.corner(v as usize, w as usize) {
            sums[w as usize][0] -= x;
            sums[w as usize][1] -= y;
        }
    }
}

/// A frame and the law of contact: φ′(d) = −push + stiffness d.
struct Local<'a> {
    x: &'a [f64],
    y: &'a [f64],
    along_x: &'a [f64],
    along_y: &'a [f64],
    per_length: &'a [f64],
    delta: f64,
    push: f64,
    stiffness: f64,
}

impl Local<'_> {
    /// Foot of vertex v on edge e (0 at its start, 1 at its end) and force on v by the edge: zero unless the foot lies
    /// between the ends and the distance is less than δ.
    #[inline(always)]
    fn face(&self, v: usize, e: usize) -> (f64, Vec2) {
        let (x, y, per_length) = (self.along_x[e], self.along_y[e], self.per_length[e]);
        let from_start = [self.x[v] - self.x[e], self.y[v] - self.y[e]];
        let from_end = [self.x[v] - self.x[e + 1], self.y[v] - self.y[e + 1]];
        let forward = from_start[0] * x + from_start[1] * y;
        let beyond = from_end[0] * x + from_end[1] * y;
        // distance to the left of the edge
        let left = (x * from_start[1] - y * from_start[0]) * per_length;
        let touches = (forward > 0.0) & (beyond <= 0.0) & (left.abs() < self.delta) & (left != 0.0);
        let strength = if touches { self.push.copysign(left) - self.stiffness * left } else { 0.0 };
        let along_normal = strength * per_length;
        (forward * per_length * per_length, [-along_normal * y, along_normal * x])
    }

    /// Force on vertex v by vertex w, where edges w − 1 and w meet.
    #[inline(always)]
    fn corner(&self, v: usize, w: usize) -> Option<Vec2> {
        let from = [self.x[v] - self.x[w], self.y[v] - self.y[w]];
        let distance2 = from[0] * from[0] + from[1] * from[1];
        if distance2 >= self.delta * self.delta || distance2 == 0.0 {
            return None;
        }
        let is_before = from[0] * self.along_x[w] + from[1] * self.along_y[w] <= 0.0;
        let is_beyond = from[0] * self.along_x[w - 1] + from[1] * self.along_y[w - 1] > 0.0;
        if is_before != is_beyond {
            return None;
        }
        let strength = self.push / distance2.sqrt() - self.stiffness;
        let strength = if is_before { strength } else { -strength };
        Some([strength * from[0], strength * from[1]])
    }
}
