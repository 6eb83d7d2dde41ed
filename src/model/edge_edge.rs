use super::deformable::{Contact, Slide, Touch, is_inside, touch};
use super::{Harmonic, View};
use crate::geometry::{Vec2, closest_on_segment, dot, scale, sub};
use crate::neighbor::{Candidates, EdgeEdgeList};

/// The paper's Eq. 8 as printed: Σ over pairs of edges of φ(their smallest distance).
///
/// Where two edges face each other in parallel its minimum lies on a kink of the force, so compressed packings stop
/// with unbalanced forces of 0.1–1 γ whatever the minimiser: for comparison with the paper only.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EdgeEdge;

/// Where two edges p → p + u and q → q + v, not crossing, are nearest: positions along each and the vector from the
/// second to the first. The nearest pair has an end of one of them; ties go to the first in a fixed order.
fn nearest(q_from_p: Vec2, u: Vec2, v: Vec2) -> (f64, f64, Vec2) {
    let p_from_q = [-q_from_p[0], -q_from_p[1]];
    let first_end = sub(u, q_from_p);
    let second_end = [q_from_p[0] + v[0], q_from_p[1] + v[1]];
    let onto = |from_start: Vec2, edge: Vec2| {
        let t = closest_on_segment(from_start, edge);
        (t, sub(from_start, scale(t, edge)))
    };
    let (t0, d0) = onto(p_from_q, v);
    let (t1, d1) = onto(first_end, v);
    let (t2, d2) = onto(q_from_p, u);
    let (t3, d3) = onto(second_end, u);
    let mut best = (0.0, t0, d0);
    for other in [(1.0, t1, d1), (t2, 0.0, [-d2[0], -d2[1]]), (t3, 1.0, [-d3[0], -d3[1]])] {
        if dot(other.2, other.2) < dot(best.2, best.2) {
            best = other;
        }
    }
    best
}

impl Contact for EdgeEdge {
    type List = EdgeEdgeList;

    // lists and forces take the start of an edge to that of another
    const EDGES_AND_SKINS_BETWEEN: [f64; 2] = [2.0, 1.0];

    fn list(candidates: &Candidates, range: f64) -> EdgeEdgeList {
        EdgeEdgeList::new(candidates, range)
    }

    #[inline(always)]
    fn for_each_touch(law: Harmonic, view: &View<EdgeEdgeList>, particle: usize, mut visit: impl FnMut(Touch)) {
        let origin = view.particles.bodies.points(particle).start;
        for_each_pair(view, particle, |[a, b], [c, e], t, s, d| {
            let d2 = dot(d, d);
            if d2 < law.delta * law.delta {
                let ours = [(a as usize - origin, 1.0 - t), (b as usize - origin, t)];
                let slide = if is_inside(t) {
                    Slide::Ours(view.displacement(b, a))
                } else if is_inside(s) {
                    Slide::Theirs(view.displacement(e, c))
                } else {
                    Slide::None
                };
                visit(touch(law, 1.0, ours, [(c, 1.0 - s), (e, s)], slide, d, d2.sqrt()));
            }
        });
    }
}

/// Visits the pairs of an edge of ours and one of another particle: their ends, the nearest positions along each, and
/// the vector from theirs to ours.
#[inline(always)]
fn for_each_pair(
    view: &View<EdgeEdgeList>,
    particle: usize,
    mut visit: impl FnMut([u32; 2], [u32; 2], f64, f64, Vec2),
) {
    let points = view.particles.bodies.points(particle);
    for point in points.clone() {
        let next = if point + 1 < points.end { point + 1 } else { points.start };
        let (here, next) = (point as u32, next as u32);
        for pair in view.lists.edges.row(point) {
            let [c, e] = pair.ends;
            let ours = view.displacement(next, here);
            let theirs = view.displacement(e, c);
            // both owners evaluate the pair in the same order, to the same bits
            if pair.ours_first {
                let (t, s, d) = nearest(view.displacement(c, here), ours, theirs);
                visit([here, next], pair.ends, t, s, d);
            } else {
                let (s, t, d) = nearest(view.displacement(here, c), theirs, ours);
                visit([here, next], pair.ends, t, s, [-d[0], -d[1]]);
            }
        }
    }
}
