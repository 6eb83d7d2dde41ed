use super::{ExactSum, Grid};
use std::ffi::{c_int, c_void};

/// How many further maxima share a reduction with the sums.
pub const EXTREMES: usize = 3;

/// `S` sums and maxima of one step, combined over all ranks in a single collective operation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Totals<const S: usize> {
    /// Order-independent partial sums; their grids must be equal on all ranks.
    pub sums: [ExactSum; S],
    /// Largest magnitude of the terms of each sum; NaN wins.
    pub maxima: [f64; S],
    /// Maxima of other non-negative quantities; NaN wins.
    pub extremes: [f64; EXTREMES],
}

impl<const S: usize> Default for Totals<S> {
    fn default() -> Self {
        Totals { sums: [ExactSum::default(); S], maxima: [0.0; S], extremes: [0.0; EXTREMES] }
    }
}

impl<const S: usize> Totals<S> {
    /// A message has room for [`MOST_SUMS`]; those that are not taken are zero there.
    const FITS: () = assert!(S <= MOST_SUMS);

    /// Adds one term to each sum, and takes further quantities into the extremes.
    #[inline(always)]
    pub fn add(&mut self, grids: &[Grid; S], terms: [f64; S], quantities: [f64; EXTREMES]) {
        for k in 0..S {
            self.sums[k].add(grids[k], terms[k]);
            self.maxima[k] = larger(self.maxima[k], terms[k].abs());
        }
        for (most, x) in self.extremes.iter_mut().zip(quantities) {
            *most = larger(*most, x);
        }
    }

    /// Of two partial totals.
    pub fn merged(mut self, other: Self) -> Self {
        self.merge(&other);
        self
    }

    pub fn merge(&mut self, other: &Self) {
        for (sum, &term) in self.sums.iter_mut().zip(&other.sums) {
            sum.merge(term);
        }
        let mine = self.maxima.iter_mut().chain(&mut self.extremes);
        for (most, &x) in mine.zip(other.maxima.iter().chain(&other.extremes)) {
            *most = larger(*most, x);
        }
    }

    pub(super) fn to_block(self) -> Block {
        const { Self::FITS };
        let mut words = [0; WORDS];
        for (pair, sum) in words.chunks_exact_mut(2).zip(&self.sums) {
            pair.copy_from_slice(&sum.limbs);
        }
        for (word, most) in words[2 * MOST_SUMS..].iter_mut().zip(&self.maxima) {
            *word = most.to_bits() as i64;
        }
        for (word, most) in words[3 * MOST_SUMS..].iter_mut().zip(&self.extremes) {
            *word = most.to_bits() as i64;
        }
        Block { words }
    }

    pub(super) fn from_block(Block { words }: Block) -> Self {
        Totals {
            sums: std::array::from_fn(|k| ExactSum { limbs: [words[2 * k], words[2 * k + 1]] }),
            maxima: std::array::from_fn(|k| f64::from_bits(words[2 * MOST_SUMS + k] as u64)),
            extremes: std::array::from_fn(|k| f64::from_bits(words[3 * MOST_SUMS + k] as u64)),
        }
    }
}

/// `S` sums taken again and again: their grids follow the terms, so that nearly always one reduction is enough.
#[derive(Clone, Copy, Debug)]
pub struct FusedSums<const S: usize> {
    pub grids: [Grid; S],
}

/// What a fused reduction gives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sums<const S: usize> {
    pub sum: [f64; S],
    /// Maxima of the other quantities.
    pub extremes: [f64; EXTREMES],
}

/// The larger of two non-negative numbers; compared as integers, whose order is theirs, and NaN lies above infinity.
#[inline(always)]
fn larger(a: f64, b: f64) -> f64 {
    f64::from_bits(a.to_bits().max(b.to_bits()))
}

impl<const S: usize> Default for FusedSums<S> {
    fn default() -> Self {
        FusedSums { grids: [Grid::for_terms_up_to(1.0); S] }
    }
}

impl<const S: usize> FusedSums<S> {
    /// The sums, if the grids they were taken on suited their terms; else nothing, and they must be taken again on the
    /// grids as they are now. Where a term is not finite, its maximum says so, and the sum means nothing.
    pub fn settle(&mut self, totals: &Totals<S>) -> Option<Sums<S>> {
        let suits = |k: usize| {
            let (most, limit) = (totals.maxima[k], self.grids[k].limit());
            most == 0.0 || !most.is_finite() || (most <= limit && most >= limit * COARSEST)
        };
        let suited = (0..S).all(suits);
        let sum = std::array::from_fn(|k| totals.sums[k].value(self.grids[k]));
        for (grid, &most) in self.grids.iter_mut().zip(&totals.maxima) {
            if most > 0.0 && most.is_finite() {
                *grid = Grid::for_terms_up_to(16.0 * most);
            }
        }
        suited.then_some(Sums { sum, extremes: totals.extremes })
    }
}

/// A grid this much too large still resolves the largest term to 2⁻⁴⁸.
const COARSEST: f64 = 1.0 / (1u64 << 20) as f64;

/// The most sums that share a reduction.
const MOST_SUMS: usize = 3;
const WORDS: usize = 3 * MOST_SUMS + EXTREMES;

/// [`Totals`] of any number of sums as one element of an MPI message. To MPI a plain array would be that many elements,
/// which an implementation may fold in parts.
#[derive(Clone, Copy, Default, mpi::traits::Equivalence)]
#[repr(C)]
pub(super) struct Block {
    words: [i64; WORDS],
}

/// The MPI user function of [`Totals::merge`].
///
/// # Safety
/// MPI calls it with `len` elements in both arrays, which must have been declared as [`Block`].
pub(super) unsafe extern "C" fn fold_raw(
    incoming: *mut c_void,
    combined: *mut c_void,
    len: *mut c_int,
    _datatype: *mut mpi::ffi::MPI_Datatype,
) {
    // SAFETY: by the contract above.
    let (incoming, combined) = unsafe {
        let n = *len as usize;
        (
            std::slice::from_raw_parts(incoming.cast::<Block>(), n),
            std::slice::from_raw_parts_mut(combined.cast::<Block>(), n),
        )
    };
    for (whole, part) in combined.iter_mut().zip(incoming) {
        let mut totals = Totals::<MOST_SUMS>::from_block(*whole);
        totals.merge(&Totals::from_block(*part));
        *whole = totals.to_block();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(k: i64) -> Totals<2> {
        Totals {
            sums: std::array::from_fn(|i| ExactSum { limbs: [k * 7 + i as i64, -k] }),
            maxima: std::array::from_fn(|i| (k * (i as i64 + 1)) as f64 * 0.1),
            extremes: std::array::from_fn(|i| (k * (i as i64 + 2)) as f64 * 0.3),
        }
    }

    #[test]
    fn merging_is_commutative_and_associative() {
        let merged = |parts: &[i64]| {
            let mut t = Totals::default();
            for &k in parts {
                t.merge(&sample(k));
            }
            t
        };
        assert_eq!(merged(&[1, 2, 3]), merged(&[3, 1, 2]));
        let mut left = merged(&[1]);
        left.merge(&merged(&[2, 3]));
        assert_eq!(left, merged(&[1, 2, 3]));
        assert_eq!(Totals::from_block(left.to_block()), left);
    }

    #[test]
    fn grids_follow_the_terms() {
        let mut fused = FusedSums::<2>::default();
        for size in [1e-12, 1e-12, 1e9, 2e9] {
            let terms = [size, -0.5 * size * size];
            let mut tries = 0;
            let sums = loop {
                tries += 1;
                let mut totals = Totals::default();
                totals.add(&fused.grids, terms, [size, 0.0, 1.0]);
                totals.add(&fused.grids, terms, [0.5 * size, 0.0, 2.0]);
                if let Some(sums) = fused.settle(&totals) {
                    break sums;
                }
            };
            assert!(tries <= 2, "{size}: {tries}");
            for (sum, term) in sums.sum.iter().zip(terms) {
                assert!((sum - 2.0 * term).abs() <= 1e-13 * term.abs());
            }
            assert_eq!(sums.extremes, [size, 0.0, 2.0]);
        }
    }

    #[test]
    fn nan_wins_a_maximum() {
        let mut t = sample(1);
        t.merge(&Totals { extremes: [f64::NAN; EXTREMES], ..Totals::default() });
        t.merge(&sample(2));
        assert!(t.extremes.iter().all(|m| m.is_nan()));
        assert!(t.maxima.iter().all(|m| m.is_finite()));
    }
}
