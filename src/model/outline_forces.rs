//! The forces of deformable particles with vertex–edge contacts, made in one pass over each particle.
//!
//! The same sums as those over `Contact::for_each_touch`, arranged so that little is computed twice: positions are taken
//! once per particle ([`OutlineFrame`]), reciprocal lengths once per edge, and a vertex that faces an edge costs no root
//! and no division. Contributions that cancel are left out: where a vertex v is near the end w of an edge and the start
//! of the next, φ(|v − w|) counts once for each edge that v lies past, less once (see `vertex_edge`), which is zero
//! unless the outline turns a corner there.
//!
//! Eight pairs or eight vertices are handled together; what pairs give is added up one after the other, in their order.

use super::deformable::{Deformable, DeformableParameters};
use super::masses::Added;
use super::vertex_edge::VertexEdge;
use super::{Harmonic, Model, View};
use crate::geometry::{Vec2, cross, dot, norm, scale, sub};
use crate::lanes::{Kernel, LANES, Lanes};
use crate::neighbor::{OutlineFrame, Touching, VertexEdgeList};
use std::cell::RefCell;
use std::ops::Range;

/// All forces on a chunk of own particles, written to `forces`, and what they accelerate, to `accelerations`.
pub(super) struct OutlineForces<'a> {
    pub model: &'a Deformable<VertexEdge>,
    pub view: &'a View<'a, VertexEdgeList>,
    pub particles: Range<usize>,
    pub forces: &'a mut [Vec2],
    pub accelerations: &'a mut [Vec2],
}

impl Kernel for OutlineForces<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self, l: impl Lanes) {
        let OutlineForces { model, view, particles, forces, accelerations } = self;
        let bodies = &view.particles.bodies;
        let origin = bodies.points(particles.start).start;
        let narrowed = view.lists.narrowed(particles.start);
        let mut scratch = SCRATCH.take();
        scratch.held = model.parameters.held_growth();
        for p in particles {
            let points = bodies.points(p);
            let (mine, n) = (points.start - origin..points.end - origin, points.len());
            let Some(touching) = narrowed.and_then(|chunk| chunk.of(p)) else {
                let (forces, accelerations) = (&mut forces[mine.clone()], &mut accelerations[mine]);
                model.forces(view, p..p + 1, forces);
                model.accelerate(view, p..p + 1, forces, accelerations);
                continue;
            };
            scratch.frame.fill(l, view.pbox, view.particles, p, touching.points);
            scratch.contacts(l, model.parameters.contact, &touching);
            scratch.add_up(&touching, n);
            let (forces, accelerations) = (&mut forces[mine.start..], &mut accelerations[mine.start..]);
            scratch.all_forces(l, &model.parameters, view.particles.size[p], n, forces, accelerations);
        }
        SCRATCH.set(scratch);
    }
}

thread_local! {
    /// Kept from chunk to chunk: threads that all grow theirs anew wait for each other in the allocator.
    static SCRATCH: RefCell<Scratch> = RefCell::default();
}

#[inline(always)]
fn add(sum: &mut Vec2, term: Vec2) {
    *sum = [sum[0] + term[0], sum[1] + term[1]];
}

#[inline(always)]
fn eight(pairs: &[[u16; 2]]) -> &[[u16; 2]; LANES] {
    pairs.first_chunk().expect("lists are padded to multiples of eight")
}

/// One particle at work.
#[derive(Default)]
struct Scratch {
    /// See [`DeformableParameters::held_growth`].
    held: f64,
    frame: OutlineFrame,
    /// For each facing pair the force on the vertex, and the part of it that falls to the end of the edge.
    pushes: Vec<Vec2>,
    at_end: Vec<Vec2>,
    /// The forces of corners, each on one own vertex (by its slot).
    corners: Vec<(u16, Vec2)>,
    /// The forces of all contacts on the n vertices, then zeros: long enough for eight to be taken from any vertex.
    on_vertex: Vec<Vec2>,
    /// All forces on them, as long.
    force_x: Vec<f64>,
    force_y: Vec<f64>,
}

impl Scratch {
    /// What all pairs that touch give.
    #[inline(always)]
    fn contacts(&mut self, l: impl Lanes, law: Harmonic, touching: &Touching) {
        let local = Local {
            frame: &self.frame,
            delta: law.delta,
            push: law.epsilon / law.delta,
            stiffness: law.epsilon / (law.delta * law.delta),
        };
        let faces = touching.faces;
        if self.pushes.len() < faces.padded.len() {
            self.pushes.resize(faces.padded.len(), [0.0; 2]);
            self.at_end.resize(faces.padded.len(), [0.0; 2]);
        }
        let results = self.pushes.chunks_exact_mut(LANES).zip(self.at_end.chunks_exact_mut(LANES));
        for (pairs, (pushes, at_end)) in faces.padded.chunks_exact(LANES).zip(results) {
            let Facing { push_x, push_y, foot } = local.faces(l, pairs);
            l.store_vectors(push_x, push_y, pushes);
            l.store_vectors(l.mul(foot, push_x), l.mul(foot, push_y), at_end);
        }
        self.corners.clear();
        let corners = touching.corners;
        for (block, pairs) in corners.padded.chunks_exact(LANES).enumerate() {
            let mut near = local.near(l, pairs);
            while near != 0 {
                let k = near.trailing_zeros() as usize;
                near &= near - 1;
                let [v, w] = pairs[k];
                if let Some([x, y]) = local.corner(v.into(), w.into()) {
                    let (slot, force) = if block * LANES + k < corners.own { (v, [x, y]) } else { (w, [-x, -y]) };
                    self.corners.push((slot, force));
                }
            }
        }
    }

    /// Adds up the forces of contacts vertex by vertex, each in the order of the list. Pairs that do not touch add zeros,
    /// so that it does not matter how many of them there are, nor where.
    #[inline(always)]
    fn add_up(&mut self, touching: &Touching, n: usize) {
        self.on_vertex.clear();
        self.on_vertex.resize(n + LANES, [0.0; 2]);
        // slots 1..=n, and once more the first
        let mut add_to =
            |slot: usize, force: Vec2| add(&mut self.on_vertex[if slot > n { 0 } else { slot - 1 }], force);
        let faces = touching.faces;
        let (own, opposite) = (&faces.padded[..faces.own], &faces.padded[faces.own..faces.all]);
        for (&[v, _], &push) in own.iter().zip(&self.pushes) {
            add_to(v.into(), push);
        }
        let results = self.pushes[faces.own..].iter().zip(&self.at_end[faces.own..]);
        for (&[_, e], (push, at_end)) in opposite.iter().zip(results) {
            add_to(e.into(), [at_end[0] - push[0], at_end[1] - push[1]]);
            add_to(usize::from(e) + 1, [-at_end[0], -at_end[1]]);
        }
        for &(slot, force) in &self.corners {
            add_to(slot.into(), force);
        }
    }

    /// Writes all forces on the n vertices, and what they accelerate (see `masses`). Only contacts move or turn the particle
    /// as a whole; tension and pressure do not.
    ///
    /// With edge vectors e_i from vertex i to i + 1: −∂(γp)/∂x_i = γ(ê_i − ê_{i−1}), and ∂a/∂x_i is half the chord
    /// e_{i−1} + e_i turned by −90°.
    #[inline(always)]
    fn all_forces(
        &mut self,
        l: impl Lanes,
        parameters: &DeformableParameters,
        rest_area: f64,
        n: usize,
        forces: &mut [Vec2],
        accelerations: &mut [Vec2],
    ) {
        let Scratch { held, frame, on_vertex, force_x, force_y, .. } = self;
        if force_x.len() < n + LANES {
            force_x.resize(n + LANES, 0.0);
            force_y.resize(n + LANES, 0.0);
        }
        let zero = l.splat(0.0);
        let (mut sum_x, mut sum_y, mut torque, mut growth, mut square) = (zero, zero, zero, zero, zero);
        let half_pressure = l.splat(0.5 * parameters.k_area * (rest_area - 0.5 * frame.area2));
        let tension = l.splat(parameters.line_tension);
        for k in (1..=n).step_by(LANES) {
            let ([x, y], [before_x, before_y]) = frame.edges(l, k);
            let per_length = l.load(&frame.per_length[k..]);
            let per_length_before = l.shifted(frame.per_length[k - 1], per_length);
            let (pull_before, pull) = (l.mul(tension, per_length_before), l.mul(tension, per_length));
            let tension_x = l.sub(l.mul(pull, x), l.mul(pull_before, before_x));
            let tension_y = l.sub(l.mul(pull, y), l.mul(pull_before, before_y));
            let [contact_x, contact_y] = l.components(&on_vertex[k - 1..]);
            let is_vertex = l.first(n + 1 - k);
            let chord_x = l.keep(is_vertex, l.add(x, before_x));
            let chord_y = l.keep(is_vertex, l.add(y, before_y));
            let fx = l.add(l.add(tension_x, l.mul(half_pressure, chord_y)), contact_x);
            let fy = l.add(l.sub(tension_y, l.mul(half_pressure, chord_x)), contact_y);
            l.store(fx, &mut force_x[k - 1..]);
            l.store(fy, &mut force_y[k - 1..]);
            put(l, fx, fy, &mut forces[k - 1..]);
            let [at_x, at_y] = l.components(&frame.at[k..]);
            (sum_x, sum_y) = (l.add(sum_x, contact_x), l.add(sum_y, contact_y));
            torque = l.add(torque, l.sub(l.mul(at_x, contact_y), l.mul(at_y, contact_x)));
            growth = l.add(growth, l.sub(l.mul(chord_y, fx), l.mul(chord_x, fy)));
            square = l.add(square, l.add(l.mul(chord_x, chord_x), l.mul(chord_y, chord_y)));
        }
        let per_vertex = 1.0 / n as f64;
        let mean = scale(per_vertex, frame.sum);
        let force = [l.sum(sum_x), l.sum(sum_y)];
        let torque = l.sum(torque) - cross(mean, force);
        let rotation = [torque, frame.squares - dot(mean, frame.sum)];
        let growth = [l.sum(growth), l.sum(square)];
        let Added { push, turn, growth } = Added::new(scale(per_vertex, force), rotation, growth, *held);
        // push + turn × (arm from the mean vertex, turned by 90°)
        let (push_x, push_y) = (l.splat(push[0] + turn * mean[1]), l.splat(push[1] - turn * mean[0]));
        let (turn, growth) = (l.splat(turn), l.splat(growth));
        for k in (1..=n).step_by(LANES) {
            let ([x, y], [before_x, before_y]) = frame.edges(l, k);
            let (chord_x, chord_y) = (l.add(x, before_x), l.add(y, before_y));
            let [at_x, at_y] = l.components(&frame.at[k..]);
            let (fx, fy) = (l.load(&force_x[k - 1..]), l.load(&force_y[k - 1..]));
            let (more_x, more_y) = (l.sub(push_x, l.mul(turn, at_y)), l.add(push_y, l.mul(turn, at_x)));
            let (more_x, more_y) = (l.add(more_x, l.mul(growth, chord_y)), l.sub(more_y, l.mul(growth, chord_x)));
            put(l, l.add(more_x, fx), l.add(more_y, fy), &mut accelerations[k - 1..]);
        }
    }
}

/// Writes eight vectors, or as many as there is room for. What is written beyond the places of a particle, the next one
/// overwrites.
#[inline(always)]
fn put<L: Lanes>(l: L, x: L::Real, y: L::Real, to: &mut [Vec2]) {
    if to.len() >= LANES {
        l.store_vectors(x, y, to);
    } else {
        let n = to.len();
        to.copy_from_slice(&l.vectors(x, y)[..n]);
    }
}

/// A frame and the law of contact: φ′(d) = −push + stiffness d.
struct Local<'a> {
    frame: &'a OutlineFrame,
    delta: f64,
    push: f64,
    stiffness: f64,
}

/// Eight pairs of a vertex and an edge.
struct Facing<L: Lanes> {
    /// The force on the vertex, zero unless its foot lies between the ends of the edge and the distance is less than δ.
    push_x: L::Real,
    push_y: L::Real,
    /// Where the foot lies: 0 at the start, 1 at the end.
    foot: L::Real,
}

impl Local<'_> {
    #[inline(always)]
    fn faces<L: Lanes>(&self, l: L, pairs: &[[u16; 2]]) -> Facing<L> {
        let f = self.frame;
        let pairs = eight(pairs);
        let [at_x, at_y] = l.named_vectors::<false>(&f.at, pairs);
        let [start_x, start_y] = l.named_vectors::<true>(&f.at, pairs);
        let ([x, y], per_length) = (l.named_vectors::<true>(&f.along, pairs), l.named::<true>(&f.per_length, pairs));
        let (from_x, from_y) = (l.sub(at_x, start_x), l.sub(at_y, start_y));
        let forward = l.add(l.mul(from_x, x), l.mul(from_y, y));
        let foot = l.mul(forward, l.mul(per_length, per_length));
        // distance to the left of the edge
        let left = l.mul(l.sub(l.mul(x, from_y), l.mul(y, from_x)), per_length);
        let distance = l.abs(left);
        let (zero, one) = (l.splat(0.0), l.splat(1.0));
        let between = l.both(l.less(zero, foot), l.up_to(foot, one));
        let near = l.both(l.less(zero, distance), l.less(distance, l.splat(self.delta)));
        let strength = l.sub(l.with_sign(l.splat(self.push), left), l.mul(l.splat(self.stiffness), left));
        let along_normal = l.keep(l.both(between, near), l.mul(strength, per_length));
        let (push_x, push_y) = (l.sub(zero, l.mul(along_normal, y)), l.mul(along_normal, x));
        Facing { push_x, push_y, foot }
    }

    /// Which of eight pairs of vertices are closer than δ, as bits.
    #[inline(always)]
    fn near(&self, l: impl Lanes, pairs: &[[u16; 2]]) -> u8 {
        let f = self.frame;
        let pairs = eight(pairs);
        let ([v_x, v_y], [w_x, w_y]) = (l.named_vectors::<false>(&f.at, pairs), l.named_vectors::<true>(&f.at, pairs));
        let (x, y) = (l.sub(v_x, w_x), l.sub(v_y, w_y));
        let distance2 = l.add(l.mul(x, x), l.mul(y, y));
        l.bits(l.both(l.less(l.splat(0.0), distance2), l.less(distance2, l.splat(self.delta * self.delta))))
    }

    /// Force on vertex v by vertex w closer than δ, where edges w − 1 and w meet.
    #[inline(always)]
    fn corner(&self, v: usize, w: usize) -> Option<Vec2> {
        let f = self.frame;
        // the foot on an edge, to the same bits as in `faces`
        let foot = |e: usize| dot(sub(f.at[v], f.at[e]), f.along[e]) * (f.per_length[e] * f.per_length[e]);
        let is_before = foot(w) <= 0.0;
        if is_before != (foot(w - 1) > 1.0) {
            return None;
        }
        let from = sub(f.at[v], f.at[w]);
        let strength = self.push / norm(from) - self.stiffness;
        Some(scale(if is_before { strength } else { -strength }, from))
    }
}
