//! Who owns which part of the periodic box. Pure arithmetic on fractions: no communication here.

use crate::geometry::{Frac, PeriodicBox, Region};

/// Ranks laid over the box as `columns` × `rows` equal slabs of its fractional coordinates. A change of the box never
/// changes the owner of a point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ProcessGrid {
    /// Number of subdomains along each box vector.
    pub shape: [usize; 2],
}

/// A box too small for the number of ranks.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "{ranks} ranks do not fit this box: a subdomain would be {width:.3} wide, and particles interact over {halo:.3}. \
     At most {largest} ranks fit: `mpirun -n {largest}`, or `ranks = {largest}` in a study (threads can use the other cores: \
     --threads)"
)]
pub struct TooManyRanks {
    pub ranks: usize,
    pub width: f64,
    pub halo: f64,
    /// The largest rank count that fits.
    pub largest: usize,
}

impl ProcessGrid {
    /// The grid of `ranks` subdomains that is as square as it can be: the one whose narrower side is widest.
    /// Fails if that side is narrower than `halo`, the distance over which particles meet.
    pub fn new(ranks: usize, pbox: &PeriodicBox, halo: f64) -> Result<Self, TooManyRanks> {
        let (grid, _) = Self::squarest(ranks, pbox);
        grid.check(pbox, halo)?;
        Ok(grid)
    }

    /// The best grid and its narrowest width.
    fn squarest(ranks: usize, pbox: &PeriodicBox) -> (Self, f64) {
        let widths = pbox.widths();
        let narrowest = |shape: [usize; 2]| (widths[0] / shape[0] as f64).min(widths[1] / shape[1] as f64);
        let shape = (1..=ranks)
            .filter(|n| ranks.is_multiple_of(*n))
            .map(|n| [ranks / n, n])
            .max_by(|&a, &b| narrowest(a).total_cmp(&narrowest(b)))
            .unwrap_or([ranks, 1]);
        (ProcessGrid { shape }, Self::narrowest(shape, pbox))
    }

    /// The narrowest side of a subdomain that has to hold a halo: an axis with one subdomain needs none.
    pub fn narrowest_width(&self, pbox: &PeriodicBox) -> f64 {
        Self::narrowest(self.shape, pbox)
    }

    fn narrowest(shape: [usize; 2], pbox: &PeriodicBox) -> f64 {
        let widths = pbox.widths();
        let along = (0..2).filter(|&axis| shape[axis] > 1).map(|axis| widths[axis] / shape[axis] as f64);
        along.fold(f64::INFINITY, f64::min)
    }

    /// Refuses a box in which a subdomain of this grid has become narrower than `halo`.
    pub fn check(&self, pbox: &PeriodicBox, halo: f64) -> Result<(), TooManyRanks> {
        let width = Self::narrowest(self.shape, pbox);
        if width >= halo {
            return Ok(());
        }
        let fits = |&n: &usize| Self::squarest(n, pbox).1 >= halo;
        let largest = (2..self.ranks()).rev().find(fits).unwrap_or(1);
        Err(TooManyRanks { ranks: self.ranks(), width, halo, largest })
    }

    pub fn ranks(&self) -> usize {
        self.shape[0] * self.shape[1]
    }

    fn cell(&self, rank: usize) -> [usize; 2] {
        [rank % self.shape[0], rank / self.shape[0]]
    }

    fn rank(&self, cell: [usize; 2]) -> usize {
        cell[0] + cell[1] * self.shape[0]
    }

    /// The rank whose subdomain holds the point.
    pub fn owner(&self, point: Frac) -> usize {
        self.rank([point.slab(0, self.shape[0]), point.slab(1, self.shape[1])])
    }

    /// The distinct other ranks whose subdomains touch that of `rank`, in ascending order: at most eight.
    pub fn neighbors(&self, rank: usize) -> Vec<usize> {
        let cell = self.cell(rank);
        let mut found: Vec<usize> = (0..9)
            .map(|k| {
                let step = |axis: usize, s: usize| (cell[axis] + self.shape[axis] + s - 1) % self.shape[axis];
                self.rank([step(0, k % 3), step(1, k / 3)])
            })
            .filter(|&r| r != rank)
            .collect();
        found.sort_unstable();
        found.dedup();
        found
    }

    /// The neighbour of `rank` (or `rank` itself) one step nearer to `target`.
    pub fn towards(&self, rank: usize, target: usize) -> usize {
        let (from, to) = (self.cell(rank), self.cell(target));
        let step = |axis: usize| {
            let n = self.shape[axis];
            match (to[axis] + n - from[axis]) % n {
                0 => from[axis],
                ahead if 2 * ahead <= n => (from[axis] + 1) % n,
                _ => (from[axis] + n - 1) % n,
            }
        };
        self.rank([step(0), step(1)])
    }

    /// Whether a point lies within `margin` (fractions of the box along each axis) of the subdomain of `rank`.
    /// Both are taken with their periodic images.
    pub fn is_near(&self, rank: usize, point: Frac, margin: [f64; 2]) -> bool {
        let (cell, at) = (self.cell(rank), point.fractions());
        (0..2).all(|axis| {
            let width = 1.0 / self.shape[axis] as f64;
            let beyond = at[axis] - (cell[axis] as f64 + 0.5) * width;
            let beyond = (beyond - beyond.round()).abs() - 0.5 * width;
            beyond <= margin[axis]
        })
    }
}

impl ProcessGrid {
    /// The part of the box within `margin` (fractions of the box) of the subdomain of `rank`.
    pub fn region(&self, rank: usize, margin: [f64; 2]) -> Region {
        let cell = self.cell(rank);
        let middle = |axis: usize| (cell[axis] as f64 + 0.5) / self.shape[axis] as f64;
        let span = |axis: usize| match self.shape[axis] {
            1 => 1.0,
            n => 1.0 / n as f64 + 2.0 * margin[axis],
        };
        Region { center: Frac::from_fractions([middle(0), middle(1)]), span: [span(0), span(1)] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn grids_are_as_square_as_they_can_be() {
        let shape = |ranks, lx, ly| {
            let mut s = ProcessGrid::new(ranks, &PeriodicBox::new(lx, ly, 0.0), 0.0).unwrap().shape;
            if lx == ly {
                s.sort();
            }
            s
        };
        assert_eq!(shape(1, 1.0, 1.0), [1, 1]);
        assert_eq!(shape(6, 1.0, 1.0), [2, 3]);
        assert_eq!(shape(7, 1.0, 1.0), [1, 7]);
        assert_eq!(shape(16, 1.0, 1.0), [4, 4]);
        assert_eq!(shape(16, 4.0, 1.0), [8, 2]);
        assert_eq!(shape(2, 1.0, 2.0), [1, 2]);
    }

    #[test]
    fn ranks_that_do_not_fit_are_refused_with_the_count_that_does() {
        let e = ProcessGrid::new(64, &PeriodicBox::square(8.9), 1.7).unwrap_err();
        assert_eq!(e.largest, 25);
        assert!(e.to_string().contains("mpirun -n 25"));
        assert_eq!(ProcessGrid::new(2, &PeriodicBox::square(2.0), 1.7).unwrap_err().largest, 1);
        assert!(ProcessGrid::new(1, &PeriodicBox::square(2.0), 1.7).is_ok());
    }

    proptest! {
        #[test]
        fn points_reach_their_owner(bits: [i64; 2], ranks in 1usize..40, start in 0usize..40) {
            let grid = ProcessGrid::new(ranks, &PeriodicBox::new(1.0, 1.3, 0.4), 0.0).unwrap();
            let point = Frac::from_bits(bits);
            let owner = grid.owner(point);
            prop_assert!(owner < grid.ranks());
            prop_assert!(grid.is_near(owner, point, [1e-12; 2]));
            let mut at = start % ranks;
            for _ in 0..ranks {
                let next = grid.towards(at, owner);
                prop_assert!(next == at && at == owner || grid.neighbors(at).contains(&next));
                at = next;
            }
            prop_assert_eq!(at, owner);
        }

        #[test]
        fn neighborhood_is_mutual(ranks in 1usize..40) {
            let grid = ProcessGrid::new(ranks, &PeriodicBox::square(1.0), 0.0).unwrap();
            for r in 0..ranks {
                for n in grid.neighbors(r) {
                    prop_assert!(grid.neighbors(n).contains(&r));
                }
            }
        }
    }
}
