use super::deformable::{Contact, Deformable, Slide, Touch, is_inside, touch};
use super::outline_forces::OutlineForces;
use super::{Harmonic, View};
use crate::geometry::{PeriodicBox, Vec2, dot, scale, sub};
use crate::lanes;
use crate::neighbor::{Candidates, VertexEdgeList};
use crate::particles::Particles;
use std::ops::Range;

/// The smooth contact term: vertices of each particle against edges of the other,
///
/// U_int = Σ_{v,e} φ(d(v, e)) − Σ_{v,w} φ(|v − w|), and the same with the particles exchanged.
///
/// A corner lies on two edges and would count twice; the second sum takes one of them away. It is continuously
/// differentiable for parallel faces, corners and reflex corners, which the sum over pairs of edges (paper, Eq. 8) is
/// not. Here each vertex w is booked on the edge that starts at it, so every vertex–edge pair stands for itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VertexEdge;

/// Visits the at most two contributions of a vertex near an edge a → b, given vertex − a and b − a: sign, position
/// along the edge (0 at a, 1 at b) and vector from there to the vertex, with its length.
#[inline(always)]
fn for_each_part(delta: f64, from_a: Vec2, along: Vec2, mut part: impl FnMut(f64, f64, Vec2, f64)) {
    let forward = dot(from_a, along);
    if forward <= 0.0 {
        return; // nearest to a: the edge's contribution and the correction at a cancel
    }
    let delta2 = delta * delta;
    let length2 = dot(along, along);
    if forward < length2 {
        let t = forward / length2;
        let d = sub(from_a, scale(t, along));
        let d2 = dot(d, d);
        if d2 < delta2 {
            part(1.0, t, d, d2.sqrt());
        }
    } else {
        let d = sub(from_a, along);
        let d2 = dot(d, d);
        if d2 < delta2 {
            part(1.0, 1.0, d, d2.sqrt());
        }
    }
    let d2 = dot(from_a, from_a);
    if d2 < delta2 {
        part(-1.0, 0.0, from_a, d2.sqrt());
    }
}

impl Contact for VertexEdge {
    type List = VertexEdgeList;

    // lists know all images; forces take a vertex to the start of an edge
    const EDGES_AND_SKINS_BETWEEN: [f64; 2] = [1.0, 0.0];

    fn list(candidates: &Candidates, range: f64) -> VertexEdgeList {
        VertexEdgeList::new(candidates, range)
    }

    #[inline(always)]
    fn for_each_touch(law: Harmonic, view: &View<VertexEdgeList>, particle: usize, mut visit: impl FnMut(Touch)) {
        let points = view.particles.bodies.points(particle);
        let near = view.lists.near(particle);
        let after = |i: usize| if i + 1 < points.len() { i + 1 } else { 0 };
        for &[i, e] in near.edges {
            let here = i as usize;
            let [a, b] = [near.points[e as usize], near.points[e as usize + 1]];
            let from_a = view.displacement((points.start + here) as u32, a);
            let along = view.displacement(b, a);
            for_each_part(law.delta, from_a, along, |sign, t, d, length| {
                let (ours, theirs) = ([(here, 1.0), (here, 0.0)], [(a, 1.0 - t), (b, t)]);
                let slide = if is_inside(t) { Slide::Theirs(along) } else { Slide::None };
                visit(touch(law, sign, ours, theirs, slide, d, length));
            });
        }
        for &[i, v] in near.vertices {
            let (here, vertex) = (i as usize, near.points[v as usize]);
            let start = (points.start + here) as u32;
            let along = view.displacement((points.start + after(here)) as u32, start);
            let from_a = view.displacement(vertex, start);
            for_each_part(law.delta, from_a, along, |sign, t, d, length| {
                let (ours, theirs) = ([(here, 1.0 - t), (after(here), t)], [(vertex, 1.0), (vertex, 0.0)]);
                let slide = if is_inside(t) { Slide::Ours(along) } else { Slide::None };
                visit(touch(law, sign, ours, theirs, slide, [-d[0], -d[1]], length));
            });
        }
    }

    fn narrow(law: Harmonic, pbox: &PeriodicBox, particles: &Particles, list: &mut VertexEdgeList, travel: f64) {
        list.narrow(pbox, particles, law.delta, travel);
    }

    fn forces_and_accelerations(
        model: &Deformable<Self>,
        view: &View<VertexEdgeList>,
        particles: Range<usize>,
        forces: &mut [Vec2],
        accelerations: &mut [Vec2],
    ) {
        lanes::run(OutlineForces { model, view, particles, forces, accelerations });
    }
}
