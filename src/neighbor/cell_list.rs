use crate::geometry::{Frac, PeriodicBox, Region};
use crate::threads::{self, Binned};

/// Points sorted into cells at least `reach` wide, so that all points within `reach` of one lie in its own cell or an
/// adjacent one. Construction and memory are linear in the number of points.
pub struct CellList {
    region: Region,
    shape: [usize; 2],
    periodic: [bool; 2],
    start: Vec<u32>,
    items: Vec<u32>,
}

impl CellList {
    pub fn new(pbox: &PeriodicBox, region: &Region, points: &[Frac], reach: f64) -> Self {
        let widths = pbox.widths();
        let span = region.span.map(|s| s.min(1.0));
        // no more cells than points: a dilute region must not cost memory
        let most = (points.len() as f64).sqrt().ceil().max(1.0);
        let aspect = ((widths[0] * span[0]) / (widths[1] * span[1])).sqrt().clamp(1.0 / most, most);
        let shape: [usize; 2] = std::array::from_fn(|axis| {
            let fitting = (widths[axis] * span[axis] / reach).floor();
            let limit = if axis == 0 { most * aspect } else { most / aspect };
            fitting.min(limit.ceil()).max(1.0) as usize
        });
        let Binned { start, items } = threads::sort_by_bin(points.len(), shape, |i| region.bin(points[i], shape));
        CellList { region: *region, shape, periodic: region.span.map(|s| s >= 1.0), start, items }
    }

    /// Visits every point in the cell of `point` and the adjacent ones, each once.
    pub fn for_each_near(&self, point: Frac, mut visit: impl FnMut(u32)) {
        self.runs_near(point).into_iter().flatten().for_each(|&item| visit(item));
    }

    /// The same points in runs, some of them empty: cells beside each other in a row are stored one after another, but
    /// for the ends of the row, which may be neighbours too.
    #[inline(always)]
    pub fn runs_near(&self, point: Frac) -> [&[u32]; 6] {
        // points outside an open region count to its outermost cells: adjacency survives
        let at = self.region.bin(point, self.shape);
        let [columns, rows] = [0, 1].map(|axis| self.adjacent(axis, at[axis]));
        let mut runs: [&[u32]; 6] = [&[]; 6];
        for (row, pair) in rows.iter().flatten().zip(runs.chunks_exact_mut(2)) {
            let (mut run, mut which) = (0..0, 0);
            for column in columns.iter().flatten() {
                let cell = row * self.shape[0] + column;
                let [from, to] = [cell, cell + 1].map(|c| self.start[c] as usize);
                if from != run.end {
                    // an empty run at the first cell
                    which = usize::from(!run.is_empty());
                    run.start = from;
                }
                run.end = to;
                pair[which] = &self.items[run.clone()];
            }
        }
        runs
    }

    /// The distinct cells at most one step from cell `k` along an axis.
    fn adjacent(&self, axis: usize, k: usize) -> [Option<usize>; 3] {
        let n = self.shape[axis];
        if self.periodic[axis] {
            [(n > 2).then(|| (k + n - 1) % n), Some(k), (n > 1).then(|| (k + 1) % n)]
        } else {
            [k.checked_sub(1), Some(k), (k + 1 < n).then_some(k + 1)]
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::norm;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn no_near_pair_is_missed(
            bits in prop::collection::vec(any::<[i64; 2]>(), 2..150),
            reach in 0.01..0.7f64,
            xy in -0.6..0.6f64,
            lx in 0.5..2.0f64,
        ) {
            let pbox = PeriodicBox::new(lx, 1.0, xy);
            let points: Vec<Frac> = bits.into_iter().map(Frac::from_bits).collect();
            let cells = CellList::new(&pbox, &Region::whole(), &points, reach);
            for (i, &p) in points.iter().enumerate() {
                let mut seen = vec![0; points.len()];
                cells.for_each_near(p, |j| seen[j as usize] += 1);
                prop_assert!(seen.iter().all(|&s| s <= 1));
                for (j, &q) in points.iter().enumerate() {
                    prop_assert!(seen[j] == 1 || norm(pbox.displacement(p, q)) >= reach, "{} {}", i, j);
                }
            }
        }

        #[test]
        fn open_regions_hold_their_points(
            fractions in prop::collection::vec([0.0..1.0f64, 0.0..1.0f64], 2..100),
            reach in 0.02..0.1f64,
        ) {
            // a strip across the periodic boundary
            let pbox = PeriodicBox::new(1.0, 1.0, 0.2);
            let region = Region { center: Frac::from_fractions([0.95, 0.3]), span: [0.3, 0.4] };
            let inside = |f: [f64; 2]| Frac::from_fractions([0.95 + 0.3 * (f[0] - 0.5), 0.3 + 0.4 * (f[1] - 0.5)]);
            let points: Vec<Frac> = fractions.into_iter().map(inside).collect();
            let cells = CellList::new(&pbox, &region, &points, reach);
            for &p in &points {
                let mut seen = vec![0; points.len()];
                cells.for_each_near(p, |j| seen[j as usize] += 1);
                for (j, &q) in points.iter().enumerate() {
                    prop_assert!(seen[j] == 1 || norm(pbox.displacement(p, q)) >= reach);
                }
            }
        }
    }
}
