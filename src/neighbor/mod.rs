//! Who may touch whom until the next rebuild: cell lists and the neighbour lists made from them.

mod cell_list;
mod disk_list;
mod edge_edge_list;
mod near_touches;
mod outline_frame;
mod outlines;
mod vertex_edge_list;

pub use cell_list::CellList;
pub use disk_list::DiskList;
pub use edge_edge_list::{EdgeEdgeList, EdgePair};
pub use near_touches::{NearTouches, Touching};
pub use outline_frame::OutlineFrame;
pub use vertex_edge_list::{Near, VertexEdgeList};

use crate::geometry::{Frac, PeriodicBox, Region, Vec2, norm, scale};
use crate::particles::Particles;
use crate::threads::{self, Chunk};

/// Everything a list is built from: a rank's own particles and whole foreign ones that may come near them.
pub struct Candidates<'a> {
    pub pbox: &'a PeriodicBox,
    /// Own particles first.
    pub particles: &'a Particles,
    /// Number of own particles.
    pub owned: usize,
    /// The part of the box that holds them.
    pub region: Region,
    /// Own particles in runs.
    pub chunks: &'a [Chunk],
}

/// A neighbour list names points by index; those at or above the number of owned points are foreign.
pub trait PointList: Send + Sync {
    /// Visits every named point, so that a caller may mark or renumber it.
    fn for_each_point(&mut self, visit: impl Fn(&mut u32) + Sync + Send);
}

/// Rows of items, one after another.
#[derive(Clone, Debug, PartialEq)]
pub struct Rows<T> {
    start: Vec<u32>,
    items: Vec<T>,
}

impl<T> Default for Rows<T> {
    fn default() -> Self {
        Rows { start: vec![0], items: Vec::new() }
    }
}

impl<T: Copy> Rows<T> {
    #[inline(always)]
    pub fn row(&self, i: usize) -> &[T] {
        &self.items[self.start[i] as usize..self.start[i + 1] as usize]
    }

    pub fn iter(&self) -> impl ExactSizeIterator<Item = &[T]> {
        self.start.windows(2).map(|ends| &self.items[ends[0] as usize..ends[1] as usize])
    }

    /// All items of all rows.
    pub fn items(&self) -> &[T] {
        &self.items
    }

    pub fn push_row(&mut self, items: impl Iterator<Item = T>) {
        self.items.extend(items);
        self.start.push(u32::try_from(self.items.len()).expect("fewer than 2^32 neighbours on a rank"));
    }

    fn concatenated(parts: Vec<Rows<T>>) -> Self {
        let mut whole = Rows::default();
        whole.items.reserve(parts.iter().map(|p| p.items.len()).sum());
        whole.start.reserve(parts.iter().map(|p| p.start.len() - 1).sum());
        for part in parts {
            let offset = whole.items.len() as u32;
            whole.items.extend_from_slice(&part.items);
            whole.start.extend(part.start[1..].iter().map(|s| s + offset));
        }
        whole
    }
}

/// One edge (circulo-line) of a polygon among the candidates.
#[derive(Clone, Copy, Debug)]
struct Edge {
    /// First and second end point.
    ends: [u32; 2],
    /// Particle it belongs to, by local index.
    particle: u32,
    /// Which edge of that particle.
    index: u32,
}

/// The edges of all candidate polygons, binned.
struct EdgeCells<'a> {
    candidates: &'a Candidates<'a>,
    edges: Vec<Edge>,
    midpoints: Vec<Frac>,
    by_midpoint: CellList,
    /// Images of an edge besides the nearest that may be within the range of another ([`PeriodicBox::images_within`]).
    images: Vec<Vec2>,
}

impl<'a> EdgeCells<'a> {
    /// Bins all edges so that every edge within `range` of one is found from that.
    fn new(candidates: &'a Candidates<'a>, range: f64) -> Self {
        let Candidates { pbox, particles, .. } = candidates;
        let n = particles.position.len();
        let mut edges = threads::collect(n, |_| Edge { ends: [0; 2], particle: 0, index: 0 });
        let mut midpoints = threads::collect(n, |_| Frac::default());
        let work = |chunk: &Chunk, edges: &mut [Edge], midpoints: &mut [Frac]| {
            let mut longest = 0.0f64;
            let mut places = edges.iter_mut().zip(midpoints);
            for p in chunk.particles.clone() {
                let points = particles.bodies.points(p);
                for ((index, a), (edge, midpoint)) in points.clone().enumerate().zip(&mut places) {
                    let b = if a + 1 < points.end { a + 1 } else { points.start };
                    let along = pbox.displacement(particles.position[b], particles.position[a]);
                    longest = longest.max(norm(along));
                    *edge = Edge { ends: [a as u32, b as u32], particle: p as u32, index: index as u32 };
                    *midpoint = pbox.moved(particles.position[a], scale(0.5, along));
                }
            }
            longest
        };
        let chunks = particles.bodies.chunks(particles.len());
        let longest = threads::fold(&chunks, &mut edges, &mut midpoints, &work, &f64::max).unwrap_or(0.0);
        let reach = range + longest;
        let by_midpoint = CellList::new(pbox, &candidates.region, &midpoints, reach);
        let images = pbox.images_within(reach + longest);
        EdgeCells { candidates, edges, midpoints, by_midpoint, images }
    }

    fn vector(&self, edge: &Edge) -> Vec2 {
        let at = |end: usize| self.candidates.particles.position[edge.ends[end] as usize];
        self.candidates.pbox.displacement(at(1), at(0))
    }

    /// Rows made for every edge of own particles (edge k starts at own point k), in parallel.
    fn rows_of_own_edges<T: Copy + Send>(&self, row: impl Fn(&Edge, &mut Vec<(u64, T)>) + Sync) -> Rows<T> {
        let parts = threads::map(self.candidates.chunks, |chunk| {
            let (mut rows, mut found) = (Rows::default(), Vec::new());
            for point in chunk.points.clone() {
                found.clear();
                row(&self.edges[point], &mut found);
                // the order of global ids, so that sums come out the same on every rank
                found.sort_unstable_by_key(|&(order, _)| order);
                rows.push_row(found.iter().map(|&(_, item)| item));
            }
            rows
        });
        Rows::concatenated(parts)
    }

    /// Sort key of an edge: global id of its particle, then its index there.
    fn order(&self, edge: &Edge) -> u64 {
        (self.candidates.particles.id[edge.particle as usize] as u64) << 32 | edge.index as u64
    }
}
