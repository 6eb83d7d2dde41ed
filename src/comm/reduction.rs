use super::ExactSum;
use std::ffi::{c_int, c_void};

/// Sums and maxima of one step, combined over all ranks in a single collective operation.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Totals {
    /// Order-independent partial sums; their grids must be equal on all ranks.
    pub sums: [ExactSum; Totals::SUMS],
    /// Non-negative maxima; NaN wins.
    pub maxima: [f64; Totals::MAXIMA],
}

impl Totals {
    pub const SUMS: usize = 3;
    pub const MAXIMA: usize = 2;
    const WORDS: usize = 2 * Self::SUMS + Self::MAXIMA;

    pub fn merge(&mut self, other: &Totals) {
        for (sum, &term) in self.sums.iter_mut().zip(&other.sums) {
            sum.merge(term);
        }
        for (most, &x) in self.maxima.iter_mut().zip(&other.maxima) {
            // as integers: the bits of non-negative numbers are ordered, and NaN lies above infinity
            *most = f64::from_bits(most.to_bits().max(x.to_bits()));
        }
    }

    pub(super) fn to_block(self) -> Block {
        let mut words = [0; Self::WORDS];
        for (pair, sum) in words.chunks_exact_mut(2).zip(&self.sums) {
            pair.copy_from_slice(&sum.limbs);
        }
        for (word, most) in words[2 * Self::SUMS..].iter_mut().zip(&self.maxima) {
            *word = most.to_bits() as i64;
        }
        Block { words }
    }

    pub(super) fn from_block(Block { words }: Block) -> Self {
        Totals {
            sums: std::array::from_fn(|k| ExactSum { limbs: [words[2 * k], words[2 * k + 1]] }),
            maxima: std::array::from_fn(|k| f64::from_bits(words[2 * Self::SUMS + k] as u64)),
        }
    }
}

/// [`Totals`] as one element of an MPI message. To MPI a plain array would be that many elements, which an
/// implementation may fold in parts.
#[derive(Clone, Copy, Default, mpi::traits::Equivalence)]
#[repr(C)]
pub(super) struct Block {
    words: [i64; Totals::WORDS],
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
        let mut totals = Totals::from_block(*whole);
        totals.merge(&Totals::from_block(*part));
        *whole = totals.to_block();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(k: i64) -> Totals {
        Totals {
            sums: std::array::from_fn(|i| ExactSum { limbs: [k * 7 + i as i64, -k] }),
            maxima: std::array::from_fn(|i| (k * (i as i64 + 1)) as f64 * 0.1),
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
    fn nan_wins_a_maximum() {
        let mut t = sample(1);
        t.merge(&Totals { maxima: [f64::NAN; Totals::MAXIMA], ..Totals::default() });
        t.merge(&sample(2));
        assert!(t.maxima.iter().all(|m| m.is_nan()));
    }
}
