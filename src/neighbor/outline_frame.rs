use crate::geometry::{PeriodicBox, Vec2};
use crate::lanes::{LANES, Lanes};
use crate::particles::Particles;

/// One own polygon and points of others near it, as plain numbers about the polygon's first vertex: each position is
/// converted from fixed point once, however many pairs it is in.
///
/// The origin belongs to the polygon alone, so that the numbers are the same bits on whatever rank they are made. Slots
/// 0 and n + 1 repeat the last and the first of the n vertices in slots 1..=n: edge k runs from slot k to slot k + 1,
/// and every vertex has an edge on either side. The other points follow, and then numbers without meaning: the arrays
/// are long enough for eight to be taken from any slot.
#[derive(Default)]
pub struct OutlineFrame {
    /// Positions.
    pub at: Vec<Vec2>,
    /// Edges from each slot to the next; between slots that are no neighbours on an outline they mean nothing.
    pub along: Vec<Vec2>,
    /// 1 / length of each edge, 0 for an edge of length zero.
    pub per_length: Vec<f64>,
    /// Of the polygon: twice its area, the sum of its vertices, and that of their squared distances from the origin.
    pub area2: f64,
    pub sum: [f64; 2],
    pub squares: f64,
}

impl OutlineFrame {
    /// Slot of the first point of another particle.
    pub fn first_other(vertices: usize) -> usize {
        vertices + 2
    }

    /// Takes own particle `particle` and the points `others`.
    #[inline(always)]
    pub fn fill(&mut self, l: impl Lanes, pbox: &PeriodicBox, particles: &Particles, particle: usize, others: &[u32]) {
        let own = particles.points_of(particle);
        let n = own.len();
        let first_other = Self::first_other(n);
        let length = first_other + others.len() + 2 * LANES;
        if self.at.len() < length {
            self.at.resize(length, [0.0; 2]);
            self.along.resize(length, [0.0; 2]);
            self.per_length.resize(length, 0.0);
        }
        let [origin_x, origin_y] = own[0].to_bits();
        let (origin_x, origin_y) = (l.splat_raw(origin_x), l.splat_raw(origin_y));
        let unit = pbox.unit();
        let zero = l.splat(0.0);
        let (mut area2, mut sum_x, mut sum_y, mut squares) = (zero, zero, zero, zero);
        for k in (0..n).step_by(LANES) {
            let ([x, y], [next_x, next_y]) = (l.few_points(&own[k..]), l.few_points(&own[k + 1..]));
            // beyond the last vertex all is zero: that is where the first lies, to which the last edge runs
            let (mask, mask_next) = (l.first(n - k), l.first(n - k - 1));
            let (x, y) = (l.sub_raw(x, origin_x), l.sub_raw(y, origin_y));
            let (x, y) = (l.keep_raw(mask, x), l.keep_raw(mask, y));
            let (next_x, next_y) = (l.sub_raw(next_x, origin_x), l.sub_raw(next_y, origin_y));
            let (next_x, next_y) = (l.keep_raw(mask_next, next_x), l.keep_raw(mask_next, next_y));
            let [x, y, along_x, along_y] = self.put(l, unit, k + 1, [x, y], [next_x, next_y]);
            area2 = l.add(area2, l.sub(l.mul(x, along_y), l.mul(y, along_x)));
            (sum_x, sum_y) = (l.add(sum_x, x), l.add(sum_y, y));
            squares = l.add(squares, l.add(l.mul(x, x), l.mul(y, y)));
        }
        (self.area2, self.sum, self.squares) = (l.sum(area2), [l.sum(sum_x), l.sum(sum_y)], l.sum(squares));
        (self.at[0], self.along[0], self.per_length[0]) = (self.at[n], self.along[n], self.per_length[n]);
        (self.at[n + 1], self.along[n + 1], self.per_length[n + 1]) = ([0.0; 2], [0.0; 2], 0.0);
        let mut blocks = others.chunks_exact(LANES);
        let (origin, mut slot) = ([origin_x, origin_y], first_other);
        let mut last = None;
        for block in blocks.by_ref() {
            let points = l.points(&particles.position, block.first_chunk().expect("a block"));
            if let Some(before) = last.replace(points) {
                self.put_others(l, unit, slot, before, points, origin);
                slot += LANES;
            }
        }
        if let [first, ..] = *blocks.remainder() {
            let mut rest = [first; LANES];
            rest[..blocks.remainder().len()].copy_from_slice(blocks.remainder());
            let points = l.points(&particles.position, &rest);
            if let Some(before) = last.replace(points) {
                self.put_others(l, unit, slot, before, points, origin);
                slot += LANES;
            }
        }
        if let Some(points) = last {
            self.put_others(l, unit, slot, points, points, origin);
        }
    }

    /// The edges from eight slots on, and those before them.
    #[inline(always)]
    pub fn edges<L: Lanes>(&self, l: L, k: usize) -> ([L::Real; 2], [L::Real; 2]) {
        let [x, y] = l.components(&self.along[k..]);
        // not loaded: the processor would wait for two stores to end
        let [before_x, before_y] = self.along[k - 1];
        ([x, y], [l.shifted(before_x, x), l.shifted(before_y, y)])
    }

    #[inline(always)]
    fn put_others<L: Lanes>(
        &mut self,
        l: L,
        unit: [f64; 3],
        slot: usize,
        points: [L::Raw; 2],
        after: [L::Raw; 2],
        origin: [L::Raw; 2],
    ) {
        let here = [l.sub_raw(points[0], origin[0]), l.sub_raw(points[1], origin[1])];
        let next = [l.shifted_raw(points[0], after[0]), l.shifted_raw(points[1], after[1])];
        let next = [l.sub_raw(next[0], origin[0]), l.sub_raw(next[1], origin[1])];
        self.put(l, unit, slot, here, next);
    }

    /// Puts eight points and the edges from them to those after them into slots; answers positions and edges.
    #[inline(always)]
    fn put<L: Lanes>(
        &mut self,
        l: L,
        [xx, xy, yy]: [f64; 3],
        slot: usize,
        here: [L::Raw; 2],
        next: [L::Raw; 2],
    ) -> [L::Real; 4] {
        let (xx, xy, yy) = (l.splat(xx), l.splat(xy), l.splat(yy));
        let (x, y) = (l.real(here[0]), l.real(here[1]));
        let (x, y) = (l.add(l.mul(x, xx), l.mul(y, xy)), l.mul(y, yy));
        // edges are differences of the exact positions: a short one is as exact as a long one
        let (dx, dy) = (l.difference(next[0], here[0]), l.difference(next[1], here[1]));
        let (along_x, along_y) = (l.add(l.mul(dx, xx), l.mul(dy, xy)), l.mul(dy, yy));
        let length2 = l.add(l.mul(along_x, along_x), l.mul(along_y, along_y));
        let per_length = l.keep(l.less(l.splat(0.0), length2), l.div(l.splat(1.0), l.sqrt(length2)));
        l.store_vectors(x, y, &mut self.at[slot..]);
        l.store_vectors(along_x, along_y, &mut self.along[slot..]);
        l.store(per_length, &mut self.per_length[slot..]);
        [x, y, along_x, along_y]
    }
}
