use crate::geometry::{Frac, PeriodicBox};
use crate::particles::Particles;

/// One own polygon and points of others near it, as plain numbers about the polygon's first vertex: each position is
/// converted from fixed point once, however many pairs it is in.
///
/// The origin belongs to the polygon alone, so that the numbers are the same bits on whatever rank they are made. Slots
/// 0 and n + 1 repeat the last and the first of the n vertices in slots 1..=n: edge k runs from slot k to slot k + 1,
/// and every vertex has an edge on either side. The other points follow.
#[derive(Default)]
pub struct OutlineFrame {
    raw: Vec<[i64; 2]>,
    /// Positions.
    pub x: Vec<f64>,
    pub y: Vec<f64>,
    /// Edges from each slot to the next; between slots that are no neighbours on an outline they mean nothing.
    pub along_x: Vec<f64>,
    pub along_y: Vec<f64>,
    /// 1 / length of each edge, 0 for an edge of length zero.
    pub per_length: Vec<f64>,
}

impl OutlineFrame {
    /// Slot of the first point of another particle.
    pub fn first_other(vertices: usize) -> usize {
        vertices + 2
    }

    pub fn slots(&self) -> usize {
        self.raw.len()
    }

    /// Takes own particle `particle` and the points `others`.
    #[inline(always)]
    pub fn fill(&mut self, pbox: &PeriodicBox, particles: &Particles, particle: usize, others: &[u32]) {
        let own = particles.points_of(particle);
        let origin = own[0];
        let from_origin = |p: &Frac| p.minus(origin);
        self.raw.clear();
        self.raw.push(from_origin(&own[own.len() - 1]));
        self.raw.extend(own.iter().map(from_origin));
        self.raw.push([0; 2]);
        self.raw.extend(others.iter().map(|&p| from_origin(&particles.position[p as usize])));
        let n = self.raw.len();
        for array in [&mut self.x, &mut self.y, &mut self.along_x, &mut self.along_y, &mut self.per_length] {
            array.resize(n, 0.0);
        }
        for ((x, y), &raw) in self.x.iter_mut().zip(&mut self.y).zip(&self.raw) {
            [*x, *y] = pbox.vector(raw);
        }
        // edges are differences of the exact positions: a short one is as exact as a long one
        for ((x, y), ends) in self.along_x.iter_mut().zip(&mut self.along_y).zip(self.raw.windows(2)) {
            [*x, *y] = pbox.vector(difference(ends[1], ends[0]));
        }
        for ((inverse, x), y) in self.per_length.iter_mut().zip(&self.along_x).zip(&self.along_y) {
            let length2 = x * x + y * y;
            *inverse = if length2 > 0.0 { 1.0 / length2.sqrt() } else { 0.0 };
        }
    }

    /// Whether slots a and b are certainly nearest images of each other, by a good margin.
    pub fn are_in_one_image(&self, a: usize, b: usize) -> bool {
        // 0.45 of a period
        const MARGIN: u64 = 8_301_034_833_169_298_227;
        (0..2).all(|axis| {
            let d = self.raw[a][axis].checked_sub(self.raw[b][axis]);
            d.is_some_and(|d| d.unsigned_abs() < MARGIN)
        })
    }
}

#[inline(always)]
fn difference(a: [i64; 2], b: [i64; 2]) -> [i64; 2] {
    [a[0].wrapping_sub(b[0]), a[1].wrapping_sub(b[1])]
}
