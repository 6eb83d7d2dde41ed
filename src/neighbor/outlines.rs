use super::{Candidates, CellList};
use crate::geometry::{Frac, Vec2, norm, sub};
use crate::particles::Particles;

/// The candidate polygons as plain numbers about the middles of circles that hold them, binned.
pub(super) struct Outlines<'a> {
    pub particles: &'a Particles,
    /// Pairs closer than this are wanted.
    pub range: f64,
    candidates: &'a Candidates<'a>,
    /// Vertices of all particles, each relative to the middle of its circle.
    offsets: Vec<Vec2>,
    circles: Vec<Circle>,
    cells: CellList,
}

/// A circle that holds a polygon.
struct Circle {
    radius: f64,
    /// Longest edge of the polygon.
    longest: f64,
    center: Frac,
}

/// One polygon.
#[derive(Clone, Copy)]
pub(super) struct Outline<'a> {
    pub offsets: &'a [Vec2],
    pub radius: f64,
    pub longest: f64,
}

impl<'a> Outlines<'a> {
    pub fn new(candidates: &'a Candidates<'a>, range: f64) -> Self {
        let Candidates { pbox, particles, region, .. } = candidates;
        let mut offsets = Vec::with_capacity(particles.position.len());
        let mut circles = Vec::with_capacity(particles.len());
        for p in 0..particles.len() {
            let points = particles.points_of(p);
            let start = offsets.len();
            // along the edges: a particle may be wider than half the box
            let (mut at, mut longest): (Vec2, f64) = ([0.0; 2], 0.0);
            let (mut low, mut high): (Vec2, Vec2) = ([0.0; 2], [0.0; 2]);
            for (k, &point) in points.iter().enumerate() {
                offsets.push(at);
                (low, high) = ([0, 1].map(|a| at[a].min(low[a])), [0, 1].map(|a| at[a].max(high[a])));
                let along = pbox.displacement(points[(k + 1) % points.len()], point);
                longest = longest.max(norm(along));
                at = [at[0] + along[0], at[1] + along[1]];
            }
            let middle = [0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1])];
            let mut radius = 0.0f64;
            for offset in &mut offsets[start..] {
                *offset = sub(*offset, middle);
                radius = radius.max(norm(*offset));
            }
            circles.push(Circle { radius, longest, center: pbox.moved(points[0], middle) });
        }
        let largest = circles.iter().map(|c| c.radius).fold(0.0, f64::max);
        let centers: Vec<Frac> = circles.iter().map(|c| c.center).collect();
        let cells = CellList::new(pbox, region, &centers, 2.0 * largest + range);
        Outlines { particles, range, candidates, offsets, circles, cells }
    }

    pub fn outline(&self, particle: usize) -> Outline<'_> {
        let Circle { radius, longest, .. } = self.circles[particle];
        Outline { offsets: &self.offsets[self.particles.bodies.points(particle)], radius, longest }
    }

    /// Visits the other particles whose circle comes within range of that of own particle `p`, in the order of global
    /// ids, each with the vectors from the centre of its circle to that of the other in all images within reach.
    pub fn for_each_neighbor(&self, p: usize, mut visit: impl FnMut(u32, &[Vec2])) {
        let pbox = self.candidates.pbox;
        let own = &self.circles[p];
        let widths = pbox.widths();
        let mut found = Vec::new();
        self.cells.for_each_near(own.center, |q| {
            if q as usize == p {
                return;
            }
            let other = &self.circles[q as usize];
            let reach = own.radius + other.radius + self.range;
            let nearest = pbox.displacement(other.center, own.center);
            // in a box this small the nearest image of the centre need not be that of the nearest vertex
            let images = if 2.0 * reach < widths[0].min(widths[1]) { 0..=0 } else { -1..=1 };
            for y in images.clone() {
                for x in images.clone() {
                    let (x, y) = (x as f64, y as f64);
                    let shift = [nearest[0] + x * pbox.lx() + y * pbox.xy(), nearest[1] + y * pbox.ly()];
                    if norm(shift) < reach {
                        found.push((self.particles.id[q as usize], q, shift));
                    }
                }
            }
        });
        found.sort_by_key(|&(id, ..)| id);
        for images in found.chunk_by(|a, b| a.0 == b.0) {
            let shifts: Vec<Vec2> = images.iter().map(|&(.., shift)| shift).collect();
            visit(images[0].1, &shifts);
        }
    }
}
