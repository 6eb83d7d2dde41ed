use super::near_touches::{NearTouches, Picking};
use super::outlines::Outlines;
use super::{Candidates, PointList};
use crate::geometry::{PeriodicBox, Vec2, dot, sub};
use crate::lanes;
use crate::particles::Particles;
use crate::threads::{self, Chunk};

/// Vertices and edges of different polygons within a range of each other, from both sides, particle by particle, and
/// for each the other particles in the order of their global ids.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct VertexEdgeList {
    chunks: Vec<Chunk>,
    rows: Vec<Row>,
    /// What may touch before points have moved far; made by [`VertexEdgeList::narrow`].
    narrow: Vec<NearTouches>,
}

/// The pairs of the own particles of one chunk.
#[derive(Clone, Debug, Default, PartialEq)]
struct Row {
    /// For each own particle where its points, its edges and its vertices begin, and where the last one's end.
    start: Vec<[u32; 3]>,
    points: Vec<u32>,
    edges: Vec<[u32; 2]>,
    vertices: Vec<[u32; 2]>,
}

/// What is near one own particle.
#[derive(Clone, Copy, Debug)]
pub struct Near<'a> {
    /// Points of other particles, neighbours on an outline one after another.
    pub points: &'a [u32],
    /// Own vertices, and the edges near them as the place of the first of two consecutive `points`.
    pub edges: &'a [[u32; 2]],
    /// Own edges (named by their first vertex), and the vertices near them as places among `points`.
    pub vertices: &'a [[u32; 2]],
}

impl VertexEdgeList {
    /// All pairs closer than `range`.
    pub fn new(candidates: &Candidates, range: f64) -> Self {
        let outlines = Outlines::new(candidates, range);
        let rows = threads::map(candidates.chunks, |chunk| {
            let (mut row, mut scratch) = (Row::default(), Scratch::default());
            row.start.push([0; 3]);
            for p in chunk.particles.clone() {
                outlines.for_each_neighbor(p, |neighbor, shifts| {
                    row.add_neighbor(&outlines, p, neighbor, shifts, &mut scratch);
                });
                row.end_particle();
            }
            row.shrink();
            row
        });
        VertexEdgeList { chunks: candidates.chunks.to_vec(), rows, narrow: Vec::new() }
    }

    /// Which chunk holds an own particle, and its place there.
    fn place(&self, particle: usize) -> (usize, usize) {
        let chunk = self.chunks.partition_point(|c| c.particles.end <= particle);
        (chunk, particle - self.chunks[chunk].particles.start)
    }

    /// All pairs of an own particle.
    pub fn near(&self, particle: usize) -> Near<'_> {
        let (chunk, k) = self.place(particle);
        self.rows[chunk].near(k)
    }

    /// Picks the pairs that can touch (distance below `reach`) before any point has moved farther than `travel`.
    pub fn narrow(&mut self, pbox: &PeriodicBox, particles: &Particles, reach: f64, travel: f64) {
        self.narrow.resize_with(self.chunks.len(), NearTouches::default);
        let (chunks, rows) = (&self.chunks, &self.rows);
        threads::for_each(&mut self.narrow, |scratch, k, made| {
            let near = |p: usize| rows[k].near(p);
            lanes::run(Picking { pbox, particles, chunk: &chunks[k], near, reach, travel, made, scratch })
        });
    }

    /// What [`VertexEdgeList::narrow`] has picked for the chunk that begins with own particle `first`; nothing if it
    /// was not called for these lists.
    pub fn narrowed(&self, first: usize) -> Option<&NearTouches> {
        self.narrow.get(self.place(first).0)
    }
}

/// Parts of two outlines that are near each other's particle.
#[derive(Default)]
struct Scratch {
    own: Parts,
    other: Parts,
    /// Which points of the other particle are named, and where.
    place: Vec<u32>,
}

#[derive(Default)]
struct Parts {
    vertices: Vec<(u32, Vec2)>,
    /// First vertex, its position, the edge and 1 / length².
    edges: Vec<(u32, Vec2, Vec2, f64)>,
}

impl Parts {
    /// The vertices and edges of an outline, moved by `shift`, within `reach` of the circle's centre `center`.
    fn choose(&mut self, offsets: &[Vec2], longest: f64, shift: Vec2, center: Vec2, reach: f64) {
        self.vertices.clear();
        self.edges.clear();
        let (near, nearly) = (reach * reach, (reach + longest) * (reach + longest));
        for (k, offset) in offsets.iter().enumerate() {
            let at = [offset[0] + shift[0], offset[1] + shift[1]];
            let from_center = sub(at, center);
            let distance2 = dot(from_center, from_center);
            if distance2 < nearly {
                let along = sub(offsets[if k + 1 < offsets.len() { k + 1 } else { 0 }], *offset);
                let length2 = dot(along, along);
                let inverse = if length2 > 0.0 { 1.0 / length2 } else { 0.0 };
                self.edges.push((k as u32, at, along, inverse));
                if distance2 < near {
                    self.vertices.push((k as u32, at));
                }
            }
        }
    }
}

/// Whether a vertex is closer to an edge than √`range2`.
#[inline(always)]
fn is_near(vertex: Vec2, &(_, start, along, per_length2): &(u32, Vec2, Vec2, f64), range2: f64) -> bool {
    let from_a = sub(vertex, start);
    let t = (dot(from_a, along) * per_length2).clamp(0.0, 1.0);
    let apart = [from_a[0] - t * along[0], from_a[1] - t * along[1]];
    dot(apart, apart) < range2
}

const UNNAMED: u32 = u32::MAX;

impl Row {
    /// Adds the pairs of own particle `p` with another, whose circle's centre lies at the vectors `shifts` from its
    /// own (more than one where the box is so small that it has several images in reach).
    fn add_neighbor(&mut self, outlines: &Outlines, p: usize, q: u32, shifts: &[Vec2], scratch: &mut Scratch) {
        let (own, other) = (outlines.outline(p), outlines.outline(q as usize));
        let (range, range2) = (outlines.range, outlines.range * outlines.range);
        let (first_edge, first_vertex) = (self.edges.len(), self.vertices.len());
        for &shift in shifts {
            scratch.own.choose(own.offsets, own.longest, [0.0; 2], shift, other.radius + range);
            scratch.other.choose(other.offsets, other.longest, shift, [0.0; 2], own.radius + range);
            for &(i, at) in &scratch.own.vertices {
                for edge in &scratch.other.edges {
                    if is_near(at, edge, range2) {
                        self.edges.push([i, edge.0]);
                    }
                }
            }
            for edge in &scratch.own.edges {
                for &(k, at) in &scratch.other.vertices {
                    if is_near(at, edge, range2) {
                        self.vertices.push([edge.0, k]);
                    }
                }
            }
        }
        if shifts.len() > 1 {
            sort_and_dedup(&mut self.edges, first_edge);
            sort_and_dedup(&mut self.vertices, first_vertex);
        }
        self.name_points(outlines, q, [first_edge, first_vertex], &mut scratch.place);
    }

    /// Puts the points that the pairs from `first_edge` and `first_vertex` on are made of into `points`, in the order of
    /// the outline, and makes the pairs name their places.
    fn name_points(&mut self, outlines: &Outlines, q: u32, first: [usize; 2], place: &mut Vec<u32>) {
        let (edges, vertices) = (&mut self.edges[first[0]..], &mut self.vertices[first[1]..]);
        if edges.is_empty() && vertices.is_empty() {
            return;
        }
        let points = outlines.particles.bodies.points(q as usize);
        let n = points.len();
        let begin = self.start[self.start.len() - 1][0] as usize;
        place.clear();
        place.resize(n, UNNAMED);
        for &[_, k] in edges.iter() {
            place[k as usize] = 0;
            place[(k as usize + 1) % n] = 0;
        }
        for &[_, k] in vertices.iter() {
            place[k as usize] = 0;
        }
        let gap = place.iter().position(|&p| p == UNNAMED);
        // after a gap, every named point has those before and after it beside it if they are named too
        for k in (0..n).map(|k| (gap.unwrap_or(n - 1) + 1 + k) % n) {
            if place[k] != UNNAMED {
                place[k] = (self.points.len() - begin) as u32;
                self.points.push((points.start + k) as u32);
            }
        }
        if gap.is_none() {
            // a closed outline: its first vertex once more at the end, between its neighbours
            place[0] = (self.points.len() - begin) as u32;
            self.points.extend([points.start as u32, points.start as u32 + 1]);
        }
        for [_, k] in edges.iter_mut().chain(vertices) {
            *k = place[*k as usize];
        }
    }

    fn end_particle(&mut self) {
        let count = |n: usize| u32::try_from(n).expect("fewer than 2^32 pairs of a few particles");
        self.start.push([count(self.points.len()), count(self.edges.len()), count(self.vertices.len())]);
    }

    fn shrink(&mut self) {
        self.points.shrink_to_fit();
        self.edges.shrink_to_fit();
        self.vertices.shrink_to_fit();
    }

    /// Pairs of the k-th particle.
    fn near(&self, k: usize) -> Near<'_> {
        let range = |list: usize| self.start[k][list] as usize..self.start[k + 1][list] as usize;
        Near { points: &self.points[range(0)], edges: &self.edges[range(1)], vertices: &self.vertices[range(2)] }
    }
}

fn sort_and_dedup(pairs: &mut Vec<[u32; 2]>, from: usize) {
    let mut tail = pairs.split_off(from);
    tail.sort_unstable();
    tail.dedup();
    pairs.append(&mut tail);
}

impl PointList for VertexEdgeList {
    fn for_each_point(&mut self, visit: impl FnMut(&mut u32)) {
        self.rows.iter_mut().flat_map(|row| &mut row.points).for_each(visit);
    }
}
