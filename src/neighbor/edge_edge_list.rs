use super::{Candidates, EdgeCells, PointList, Rows};
use crate::geometry::{Vec2, add, closest_on_segment, dot, scale, segments_cross, segments_run_together, sub};

/// An edge of another particle near one of ours.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EdgePair {
    /// End points of the other edge.
    pub ends: [u32; 2],
    /// Whether our particle has the smaller global id: both owners evaluate the pair in that order.
    pub ours_first: bool,
}

/// For each own edge (named by its first end) the edges of other polygons within a range, in the order of global ids.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct EdgeEdgeList {
    pub edges: Rows<EdgePair>,
}

impl EdgeEdgeList {
    /// All pairs of edges closer than `range`; those that cross or lie on each other with the insides of their outlines on the
    /// same side are there at range zero, too.
    pub fn new(candidates: &Candidates, range: f64) -> Self {
        let cells = EdgeCells::new(candidates, range);
        let particles = candidates.particles;
        let edges = cells.rows_of_own_edges(|own, found| {
            cells.by_midpoint.for_each_near(cells.midpoints[own.ends[0] as usize], |e| {
                let other = &cells.edges[e as usize];
                if other.particle != own.particle && is_near(&cells, own, other, range) {
                    let ours_first = particles.id[own.particle as usize] < particles.id[other.particle as usize];
                    found.push((cells.order(other), EdgePair { ends: other.ends, ours_first }));
                }
            });
        });
        EdgeEdgeList { edges }
    }
}

/// Whether two edges come closer than `range`, or cross, or lie on each other as no edges of outlines do that are apart.
fn is_near(cells: &EdgeCells, a: &super::Edge, b: &super::Edge, range: f64) -> bool {
    let position = &cells.candidates.particles.position;
    let nearest = cells.candidates.pbox.displacement(position[b.ends[0] as usize], position[a.ends[0] as usize]);
    let (u, v) = (cells.vector(a), cells.vector(b));
    let near = |from_start, edge| {
        let d = sub(from_start, scale(closest_on_segment(from_start, edge), edge));
        dot(d, d) < range * range
    };
    let is_near_at = |apart: Vec2| {
        near(apart, u)
            || near([apart[0] + v[0], apart[1] + v[1]], u)
            || near([-apart[0], -apart[1]], v)
            || near(sub(u, apart), v)
            || segments_cross(apart, u, v)
            || segments_run_together(apart, u, v)
    };
    is_near_at(nearest) || cells.images.iter().any(|&by| is_near_at(add(nearest, by)))
}

impl PointList for EdgeEdgeList {
    fn for_each_point(&mut self, visit: impl FnMut(&mut u32)) {
        self.edges.items.iter_mut().flat_map(|pair| &mut pair.ends).for_each(visit);
    }
}
