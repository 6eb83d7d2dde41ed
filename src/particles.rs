//! The state of one rank: its own particles, and the points of others that its neighbour lists name.

use crate::geometry::{Frac, PeriodicBox, Polygon, Vec2, norm, sub};
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
}

/// Particles as structure of arrays. Global ids are unique over all ranks; the order of storage means nothing.
#[derive(Clone, Debug)]
pub struct Particles {
    /// Global id of each owned particle.
    pub id: Vec<u32>,
    /// Disk diameter, or rest area a₀ of a polygon.
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

    pub fn forget_foreign(&mut self) {
        self.position.truncate(self.owned_points());
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
    pub fn reordered(&self, order: &[u32]) -> Particles {
        let mut sorted = Particles::empty(&self.bodies);
        sorted.carried = vec![Vec::with_capacity(self.owned_points()); self.carried.len()];
        sorted.position.reserve(self.owned_points());
        for &p in order {
            let range = self.bodies.points(p as usize);
            for (to, from) in sorted.carried.iter_mut().zip(&self.carried) {
                to.extend_from_slice(&from[range.clone()]);
            }
            sorted.push(self.id[p as usize], self.size[p as usize], &self.position[range]);
        }
        sorted
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
        let r = p.reordered(&[1, 0]);
        assert_eq!(q.id, [3, 7]);
        assert_eq!(
            (&q.id, &q.size, &q.bodies, &q.position, &q.carried),
            (&r.id, &r.size, &r.bodies, &r.position, &r.carried)
        );
        assert_eq!(q.carried[1][4], [1.0, 0.0]);
        assert_eq!(q.points_of(0), p.points_of(1));
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
