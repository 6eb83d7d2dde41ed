use super::{Candidates, CellList, EdgeCells, PointList, Rows};
use crate::geometry::{closest_on_segment, dot, scale, sub};

/// Vertices and edges of different polygons within a range of each other, from both sides, in the order of global ids.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct VertexEdgeList {
    /// For each own vertex the foreign-to-its-particle edges, as their end points.
    pub edges: Rows<[u32; 2]>,
    /// For each own edge (named by its first end) the vertices of other particles.
    pub vertices: Rows<u32>,
}

impl VertexEdgeList {
    /// All pairs closer than `range`.
    pub fn new(candidates: &Candidates, range: f64) -> Self {
        let cells = EdgeCells::new(candidates, range, 1.0);
        let position = &candidates.particles.position;
        let pbox = candidates.pbox;
        let is_near = |vertex: u32, edge: &super::Edge| {
            let along = cells.vector(edge);
            let from_a = pbox.displacement(position[vertex as usize], position[edge.ends[0] as usize]);
            let apart = sub(from_a, scale(closest_on_segment(from_a, along), along));
            dot(apart, apart) < range * range
        };
        // vertex k and edge k (which starts at it) share particle and index, so one table describes both
        let edges = cells.rows_of_own_edges(|own, found| {
            let vertex = own.ends[0];
            cells.by_midpoint.for_each_near(position[vertex as usize], |e| {
                let edge = &cells.edges[e as usize];
                if edge.particle != own.particle && is_near(vertex, edge) {
                    found.push((cells.order(edge), edge.ends));
                }
            });
        });
        let by_vertex = CellList::new(pbox, &candidates.region, position, range + 0.5 * cells.longest);
        let vertices = cells.rows_of_own_edges(|own, found| {
            by_vertex.for_each_near(cells.midpoints[own.ends[0] as usize], |v| {
                let other = &cells.edges[v as usize];
                if other.particle != own.particle && is_near(v, own) {
                    found.push((cells.order(other), v));
                }
            });
        });
        VertexEdgeList { edges, vertices }
    }
}

impl PointList for VertexEdgeList {
    fn for_each_point(&mut self, mut visit: impl FnMut(&mut u32)) {
        self.edges.items.iter_mut().flatten().for_each(&mut visit);
        self.vertices.items.iter_mut().for_each(&mut visit);
    }
}
