//! Sums of floating-point numbers that do not depend on the order or grouping of their terms.
//!
//! Every term is rounded once to a fixed-point grid shared by all ranks and threads (two 64-bit limbs, in units
//! of at most 2⁻⁶⁷ of the largest term); integers then add associatively, so any partition of the terms gives the same bits.

/// Bits of a term that the upper limb keeps, and again the lower: 2³⁴ per term leaves room for 2²⁹ terms as large as
/// the largest.
const LIMB: i32 = 34;

/// 1.5·2⁵²: adding it rounds a smaller number to an integer, kept in the low bits of the sum's mantissa.
const ROUNDER: f64 = 6_755_399_441_055_744.0;

/// The grid of one sum: a power of two chosen from a bound on its terms.
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(transparent)]
pub struct Grid {
    up: f64,
}

impl Grid {
    /// A grid for terms of magnitude up to `bound` (any non-negative finite number).
    pub fn for_terms_up_to(bound: f64) -> Self {
        let exponent = if bound > 0.0 { (LIMB - 1 - ilog2(bound)).clamp(-990, 900) } else { 0 };
        Grid { up: power_of_two(exponent) }
    }

    /// The largest magnitude a term may have.
    pub fn limit(&self) -> f64 {
        power_of_two(LIMB) / self.up
    }
}

/// A partial sum on a [`Grid`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ExactSum {
    pub limbs: [i64; 2],
}

impl ExactSum {
    /// Adds a term, |term| ≤ `grid.limit()`.
    #[inline(always)]
    pub fn add(&mut self, grid: Grid, term: f64) {
        let scaled = term * grid.up;
        let upper = scaled + ROUNDER;
        let rest = (scaled - (upper - ROUNDER)) * (1u64 << LIMB) as f64;
        let lower = rest + ROUNDER;
        let whole = |x: f64| (x.to_bits() as i64).wrapping_sub(ROUNDER.to_bits() as i64);
        self.limbs[0] = self.limbs[0].wrapping_add(whole(upper));
        self.limbs[1] = self.limbs[1].wrapping_add(whole(lower));
    }

    #[inline(always)]
    pub fn merge(&mut self, other: ExactSum) {
        self.limbs[0] = self.limbs[0].wrapping_add(other.limbs[0]);
        self.limbs[1] = self.limbs[1].wrapping_add(other.limbs[1]);
    }

    /// The sum, correctly rounded from the limbs.
    pub fn value(&self, grid: Grid) -> f64 {
        let whole = ((self.limbs[0] as i128) << LIMB) + self.limbs[1] as i128;
        // two steps, because the product of both scales alone may underflow
        whole as f64 * power_of_two(-LIMB) / grid.up
    }
}

/// ⌊log₂ x⌋ for a positive finite x.
fn ilog2(x: f64) -> i32 {
    let biased = (x.to_bits() >> 52) as i32;
    if biased == 0 { ilog2(x * 18_014_398_509_481_984.0) - 54 } else { biased - 1023 }
}

fn power_of_two(exponent: i32) -> f64 {
    2.0f64.powi(exponent)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn order_and_grouping_do_not_matter(mut terms in prop::collection::vec(-1e3..1e3f64, 1..200), cut in 0usize..200, scale in -60i32..60) {
            for t in &mut terms { *t *= 2.0f64.powi(scale); }
            let bound = terms.iter().fold(0.0, |m: f64, t| m.max(t.abs()));
            let grid = Grid::for_terms_up_to(bound);
            prop_assert!(bound <= grid.limit());
            let sum = |terms: &[f64]| { let mut s = ExactSum::default(); for &t in terms { s.add(grid, t); } s };
            let whole = sum(&terms);
            let cut = cut.min(terms.len());
            let mut parts = sum(&terms[cut..]);
            parts.merge(sum(&terms[..cut]));
            prop_assert_eq!(whole, parts);
            terms.reverse();
            prop_assert_eq!(whole, sum(&terms));
            let plain: f64 = terms.iter().sum();
            prop_assert!((whole.value(grid) - plain).abs() <= 1e-13 * bound * terms.len() as f64);
        }
    }

    #[test]
    fn cancellation_leaves_the_small_terms() {
        let grid = Grid::for_terms_up_to(1.0);
        let mut s = ExactSum::default();
        for t in [1.0, 2.0f64.powi(-60), -1.0, 3.0 * 2.0f64.powi(-62)] {
            s.add(grid, t);
        }
        assert_eq!(s.value(grid), 7.0 * 2.0f64.powi(-62));
    }

    #[test]
    fn extremes() {
        for bound in [0.0, 1e-310, 1e-300, 1e300] {
            let grid = Grid::for_terms_up_to(bound);
            let mut s = ExactSum::default();
            s.add(grid, bound);
            assert!((s.value(grid) - bound).abs() <= 1e-15 * bound + 1e-270, "{bound}");
        }
    }
}
