use super::deformable::{Contact, Slide, Touch, is_inside, touch};
use super::{Harmonic, View};
use crate::geometry::{Vec2, dot, scale, sub};
use crate::neighbor::{Candidates, VertexEdgeList};

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

    fn list(candidates: &Candidates, range: f64) -> VertexEdgeList {
        VertexEdgeList::new(candidates, range)
    }

    #[inline(always)]
    fn for_each_touch(law: Harmonic, view: &View<VertexEdgeList>, particle: usize, mut visit: impl FnMut(Touch)) {
        let points = view.particles.bodies.points(particle);
        for point in points.clone() {
            let here = point - points.start;
            for &[a, b] in view.lists.edges.row(point) {
                let from_a = view.displacement(point as u32, a);
                let along = view.displacement(b, a);
                for_each_part(law.delta, from_a, along, |sign, t, d, length| {
                    let (ours, theirs) = ([(here, 1.0), (here, 0.0)], [(a, 1.0 - t), (b, t)]);
                    let slide = if is_inside(t) { Slide::Theirs(along) } else { Slide::None };
                    visit(touch(law, sign, ours, theirs, slide, d, length));
                });
            }
            let next = if point + 1 < points.end { point + 1 } else { points.start };
            let ends = [here, next - points.start];
            let vertices = view.lists.vertices.row(point);
            if vertices.is_empty() {
                continue;
            }
            let along = view.displacement(next as u32, point as u32);
            for &vertex in vertices {
                let from_a = view.displacement(vertex, point as u32);
                for_each_part(law.delta, from_a, along, |sign, t, d, length| {
                    let (ours, theirs) = ([(ends[0], 1.0 - t), (ends[1], t)], [(vertex, 1.0), (vertex, 0.0)]);
                    let slide = if is_inside(t) { Slide::Ours(along) } else { Slide::None };
                    visit(touch(law, sign, ours, theirs, slide, [-d[0], -d[1]], length));
                });
            }
        }
    }
}
