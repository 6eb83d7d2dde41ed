use crate::geometry::{Frac, PeriodicBox, Region};

/// Points sorted into cells at least `reach` wide, so that all points within `reach` of one lie in its own cell or an
/// adjacent one. Construction and memory are linear in the number of points.
pub struct CellList {
    center: Frac,
    /// Cells per raw fixed-point unit.
    per_unit: [f64; 2],
    shape: [usize; 2],
    periodic: [bool; 2],
    start: Vec<u32>,
    items: Vec<u32>,
}

/// 2⁶⁴, one period in raw units.
const PERIOD: f64 = 18_446_744_073_709_551_616.0;

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
        let mut cells = CellList {
            center: region.center,
            per_unit: std::array::from_fn(|axis| shape[axis] as f64 / (span[axis] * PERIOD)),
            shape,
            periodic: region.span.map(|s| s >= 1.0),
            start: vec![0; shape[0] * shape[1] + 1],
            items: vec![0; points.len()],
        };
        let cell_of: Vec<u32> = points.iter().map(|&p| cells.cell(p) as u32).collect();
        for &c in &cell_of {
            cells.start[c as usize + 1] += 1;
        }
        for c in 1..cells.start.len() {
            cells.start[c] += cells.start[c - 1];
        }
        let mut next = cells.start.clone();
        for (i, &c) in cell_of.iter().enumerate() {
            cells.items[next[c as usize] as usize] = i as u32;
            next[c as usize] += 1;
        }
        cells
    }

    fn column_and_row(&self, point: Frac) -> [usize; 2] {
        let offset = point.minus(self.center);
        std::array::from_fn(|axis| {
            let n = self.shape[axis] as f64;
            // points outside an open region count to its outermost cells: adjacency survives
            (offset[axis] as f64 * self.per_unit[axis] + 0.5 * n).floor().clamp(0.0, n - 1.0) as usize
        })
    }

    fn cell(&self, point: Frac) -> usize {
        let [column, row] = self.column_and_row(point);
        row * self.shape[0] + column
    }

    /// Indices of all points cell by cell: neighbours in space stand close together.
    pub fn in_cell_order(&self) -> &[u32] {
        &self.items
    }

    /// Visits every point in the cell of `point` and the adjacent ones, each once.
    pub fn for_each_near(&self, point: Frac, mut visit: impl FnMut(u32)) {
        let at = self.column_and_row(point);
        let [columns, rows] = [0, 1].map(|axis| self.adjacent(axis, at[axis]));
        for row in rows.iter().flatten() {
            for column in columns.iter().flatten() {
                let cell = row * self.shape[0] + column;
                for &item in &self.items[self.start[cell] as usize..self.start[cell + 1] as usize] {
                    visit(item);
                }
            }
        }
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
