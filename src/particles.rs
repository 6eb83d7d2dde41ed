//! The state of one rank: its own particles, and the points of others that its neighbour lists name.

use crate::geometry::{Frac, PeriodicBox, Polygon, Vec2, norm, sub};
use crate::threads::{self, Chunk};
use std::ops::Range;

/// How many points make a particle.
#[derive(Clone, Debug, PartialEq)]
pub enum Bodies {
    /// One: a disk, its point the centre.
    Disks,
    /// Several: the vertices of a polygon, counter-clockwise. Particle p has the points `first[p]..first[p + 1]`.
    Polygons { first: Vec<u32> },
}

impl Bodies {
    /// Enough work to be worth handing to another thread, and little enough for the first cache.
    pub const POINTS_PER_CHUNK: usize = 512;

    pub fn none_like(&self) -> Bodies {
        match self {
            Bodies::Disks => Bodies::Disks,
            Bodies::Polygons { .. } => Bodies::Polygons { first: vec![0] },
        }
    }

    #[inline(always)]
    pub fn points(&self, particle: usize) -> Range<usize> {
        match self {
            Bodies::Disks => particle..particle + 1,
            Bodies::Polygons { first } => first[particle] as usize..first[particle + 1] as usize,
        }
    }

    /// The first `n` particles in runs of roughly equal numbers of points.
    pub fn chunks(&self, n: usize) -> Vec<Chunk> {
        let mut cut = Vec::new();
        let mut begin = 0;
        while begin < n {
            let points = self.points(begin);
            let most = points.start + Self::POINTS_PER_CHUNK.max(points.len());
            let end = match self {
                Bodies::Disks => most.min(n),
                Bodies::Polygons { first } => begin + first[begin + 1..=n].partition_point(|&end| end as usize <= most),
            };
            cut.push(Chunk { particles: begin..end, points: points.start..self.points(end - 1).end });
            begin = end;
        }
        cut
    }

    /// The particles listed in `order`, in that order.
    fn reordered(&self, order: &[u32]) -> Bodies {
        match self {
            Bodies::Disks => Bodies::Disks,
            Bodies::Polygons { .. } => {
                let mut first = Vec::with_capacity(order.len() + 1);
                first.push(0);
                first.extend(order.iter().scan(0, |end, &p| {
                    *end += self.points(p as usize).len() as u32;
                    Some(*end)
                }));
                Bodies::Polygons { first }
            }
        }
    }
}

/// A number of every owned particle, by its place.
pub type Column<'a> = Box<dyn Fn(usize) -> f64 + 'a>;

/// Particles as structure of arrays. Global ids are unique over all ranks; the order of storage means nothing.
#[derive(Clone, Debug)]
pub struct Particles {
    /// Global id of each owned particle.
    pub id: Vec<u32>,
    /// Disk diameter, or rest area a₀ of a polygon; after those of owned disks also the diameters of foreign ones.
    pub size: Vec<f64>,
    pub bodies: Bodies,
    /// Points of owned particles, then foreign points.
    pub position: Vec<Frac>,
    /// Per-point vectors that a minimiser keeps between steps (velocities, search directions): they travel with their
    /// particle. Owned points only.
    pub carried: Vec<Vec<Vec2>>,
    /// Owner of each foreign point: global id of its particle, and the particle's size.
    pub foreign: Vec<ForeignPoint>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ForeignPoint {
    pub id: u32,
    /// Which point of that particle.
    pub index: u32,
    pub size: f64,
}

impl Particles {
    /// No particles of the given kind.
    pub fn empty(bodies: &Bodies) -> Self {
        Particles {
            id: Vec::new(),
            size: Vec::new(),
            bodies: bodies.none_like(),
            position: Vec::new(),
            carried: Vec::new(),
            foreign: Vec::new(),
        }
    }

    /// Number of owned particles.
    pub fn len(&self) -> usize {
        self.id.len()
    }

    pub fn is_empty(&self) -> bool {
        self.id.is_empty()
    }

    /// Number of owned points.
    pub fn owned_points(&self) -> usize {
        self.position.len() - self.foreign.len()
    }

    /// Positions of the points of an owned particle.
    pub fn points_of(&self, particle: usize) -> &[Frac] {
        &self.position[self.bodies.points(particle)]
    }

    /// Adds an owned particle, its carried vectors zero. No foreign points may be present.
    pub fn push(&mut self, id: u32, size: f64, points: &[Frac]) {
        debug_assert!(self.foreign.is_empty());
        self.id.push(id);
        self.size.push(size);
        self.position.extend_from_slice(points);
        for vectors in &mut self.carried {
            vectors.resize(self.position.len(), [0.0; 2]);
        }
        if let Bodies::Polygons { first } = &mut self.bodies {
            first.push(self.position.len() as u32);
        }
    }

    /// Only the first `n`, where all are whole; vectors that they carry stay as they are.
    pub fn keep(&mut self, n: usize) {
        let points = if n > 0 { self.bodies.points(n - 1).end } else { 0 };
        self.position.truncate(points);
        self.id.truncate(n);
        self.size.truncate(n);
        if let Bodies::Polygons { first } = &mut self.bodies {
            first.truncate(n + 1);
        }
    }

    pub fn forget_foreign(&mut self) {
        self.position.truncate(self.owned_points());
        self.size.truncate(self.len());
        self.foreign.clear();
    }

    /// Reference point of a particle, which decides its owner: the centre of a disk, the area centroid of a polygon.
    pub fn center(&self, pbox: &PeriodicBox, particle: usize) -> Frac {
        center(pbox, &self.bodies, self.points_of(particle))
    }

    /// Largest distance from the reference point to a point of the same particle: 0 for a disk.
    pub fn circumradius(&self, pbox: &PeriodicBox, particle: usize) -> f64 {
        circumradius(pbox, &self.bodies, self.points_of(particle))
    }

    /// Appends the record of particle `p` to a message: id, number of points, size, positions and, if asked for,
    /// carried vectors.
    pub fn pack(&self, p: usize, with_carried: bool, message: &mut Vec<u64>) {
        let range = self.bodies.points(p);
        message.push(self.id[p] as u64 | (range.len() as u64) << 32);
        message.push(self.size[p].to_bits());
        message.extend(self.position[range.clone()].iter().flat_map(|f| f.to_bits().map(|k| k as u64)));
        if with_carried {
            for vectors in &self.carried {
                message.extend(vectors[range.clone()].iter().flat_map(|v| v.map(f64::to_bits)));
            }
        }
    }

    /// Adds all particles packed in a message, which must agree about `with_carried`.
    pub fn unpack(&mut self, message: &[u64], with_carried: bool) {
        let mut rest = message;
        let mut points = Vec::new();
        while let [head, size, tail @ ..] = rest {
            let (id, n) = (*head as u32, (head >> 32) as usize);
            points.clear();
            points.extend(tail[..2 * n].chunks_exact(2).map(|w| Frac::from_bits([w[0] as i64, w[1] as i64])));
            rest = &tail[2 * n..];
            let start = self.position.len();
            self.push(id, f64::from_bits(*size), &points);
            if with_carried {
                for vectors in &mut self.carried {
                    for (slot, w) in vectors[start..].iter_mut().zip(rest.chunks_exact(2)) {
                        *slot = [f64::from_bits(w[0]), f64::from_bits(w[1])];
                    }
                    rest = &rest[2 * n..];
                }
            }
        }
    }

    /// The owned particles listed in `order`, in that order; no foreign points.
    pub fn reordered(mut self, order: &[u32]) -> Particles {
        self.reorder(order);
        self
    }

    /// Keeps the owned particles listed in `order`, in that order; no foreign points. One array after the other, so
    /// that only one of them is there twice.
    pub fn reorder(&mut self, order: &[u32]) {
        fn points<T: Copy + Default + Send + Sync>(from: &mut Vec<T>, old: &Bodies, new: &Bodies, order: &[u32]) {
            if let Bodies::Disks = old {
                *from = taken(from, order);
                return;
            }
            let chunks = new.chunks(order.len());
            let n = chunks.last().map_or(0, |chunk| chunk.points.end);
            let mut sorted = threads::collect(n, |_| T::default());
            let copy = |chunk: &Chunk, mut to: &mut [T], _: &mut [()]| {
                for &p in &order[chunk.particles.clone()] {
                    let range = old.points(p as usize);
                    let (here, rest) = to.split_at_mut(range.len());
                    here.copy_from_slice(&from[range]);
                    to = rest;
                }
            };
            threads::fold(&chunks, &mut sorted, &mut vec![(); n], &copy, &|(), ()| ());
            *from = sorted;
        }
        fn taken<T: Copy + Send + Sync>(from: &[T], order: &[u32]) -> Vec<T> {
            threads::collect(order.len(), |i| from[order[i] as usize])
        }
        self.forget_foreign();
        let bodies = self.bodies.reordered(order);
        for vectors in &mut self.carried {
            points(vectors, &self.bodies, &bodies, order);
        }
        points(&mut self.position, &self.bodies, &bodies, order);
        self.id = taken(&self.id, order);
        self.size = taken(&self.size, order);
        self.bodies = bodies;
    }
}

/// Area centroid of a polygon's vertices, or the disk's own point.
pub fn center(pbox: &PeriodicBox, bodies: &Bodies, points: &[Frac]) -> Frac {
    match bodies {
        Bodies::Disks => points[0],
        Bodies::Polygons { .. } => pbox.moved(points[0], Polygon::from_vertices(pbox, points).centroid()),
    }
}

fn circumradius(pbox: &PeriodicBox, bodies: &Bodies, points: &[Frac]) -> f64 {
    match bodies {
        Bodies::Disks => 0.0,
        Bodies::Polygons { .. } => {
            let polygon = Polygon::from_vertices(pbox, points);
            let center = polygon.centroid();
            polygon.offsets().map(|r| norm(sub(r, center))).fold(0.0, f64::max)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn two_polygons() -> Particles {
        let mut p = Particles::empty(&Bodies::Polygons { first: vec![0] });
        p.carried = vec![Vec::new(); 2];
        let frac = |x, y| Frac::from_fractions([x, y]);
        p.push(7, 1.5, &[frac(0.1, 0.1), frac(0.2, 0.1), frac(0.1, 0.2)]);
        p.push(3, 0.5, &[frac(0.6, 0.6), frac(0.7, 0.6), frac(0.7, 0.7), frac(0.6, 0.7)]);
        for (k, v) in p.carried.iter_mut().enumerate() {
            for (i, x) in v.iter_mut().enumerate() {
                *x = [k as f64, i as f64];
            }
        }
        p
    }

    #[test]
    fn messages_carry_everything() {
        let p = two_polygons();
        let mut message = Vec::new();
        p.pack(1, true, &mut message);
        p.pack(0, true, &mut message);
        let mut q = Particles::empty(&p.bodies);
        q.carried = vec![Vec::new(); 2];
        q.unpack(&message, true);
        let r = p.clone().reordered(&[1, 0]);
        assert_eq!(q.id, [3, 7]);
        assert_eq!(
            (&q.id, &q.size, &q.bodies, &q.position, &q.carried),
            (&r.id, &r.size, &r.bodies, &r.position, &r.carried)
        );
        assert_eq!(q.carried[1][4], [1.0, 0.0]);
        assert_eq!(q.points_of(0), p.points_of(1));
    }

    #[test]
    fn chunks_tile_the_points() {
        let first: Vec<u32> = (0..2001).map(|p| p * 13 + (p > 7) as u32 * 900).collect();
        for (bodies, n) in [(Bodies::Disks, 3000), (Bodies::Polygons { first }, 2000)] {
            let cut = bodies.chunks(n);
            assert!(cut.len() > 4);
            assert_eq!(cut[0].particles.start, 0);
            assert!(
                cut.windows(2)
                    .all(|w| w[0].particles.end == w[1].particles.start && w[0].points.end == w[1].points.start)
            );
            assert_eq!(cut.last().unwrap().points.end, bodies.points(n - 1).end);
        }
        assert!(Bodies::Disks.chunks(0).is_empty());
    }

    #[test]
    fn reference_points() {
        let p = two_polygons();
        let pbox = PeriodicBox::square(10.0);
        let c = pbox.position(p.center(&pbox, 1));
        assert!((c[0] - 6.5).abs() < 1e-14 && (c[1] - 6.5).abs() < 1e-14);
        assert!((p.circumradius(&pbox, 1) - 0.5f64.sqrt()).abs() < 1e-14);
    }
}
