use bytemuck::{Pod, Zeroable};

/// A point of the periodic plane: two 64-bit fractions of the box vectors, 2⁶⁴ making one period.
///
/// Integer overflow *is* the periodic boundary: differences wrap to the nearest image, exactly and antisymmetrically,
/// and no code anywhere wraps a coordinate. A change of the box leaves every fraction as it is (an affine
/// deformation), the resolution is the same everywhere in the box (5·10⁻²⁰ of its edge), and a copy of a point on
/// another rank is the same bits on whichever side of a boundary it lies.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Pod, Zeroable)]
#[repr(transparent)]
pub struct Frac(pub(super) [i64; 2]);

/// 2⁶⁴ as f64.
pub(super) const PERIOD: f64 = 18_446_744_073_709_551_616.0;

impl Frac {
    /// The point at these fractions of the box vectors; any real number of periods is accepted.
    pub fn from_fractions(fractions: [f64; 2]) -> Self {
        Frac(fractions.map(fixed))
    }

    /// From the raw fixed-point pair, as stored in files.
    pub fn from_bits(bits: [i64; 2]) -> Self {
        Frac(bits)
    }

    /// The raw fixed-point pair, as stored in files.
    pub fn to_bits(self) -> [i64; 2] {
        self.0
    }

    /// Fractions of the box vectors in [0, 1).
    pub fn fractions(self) -> [f64; 2] {
        self.0.map(|k| {
            let f = (k as u64) as f64 / PERIOD;
            if f < 1.0 { f } else { 0.0 }
        })
    }

    /// Which of `n` equal slabs across axis `axis` holds the point: 0 ≤ result < n, exact for any n.
    pub fn slab(self, axis: usize, n: usize) -> usize {
        ((self.0[axis] as u64 as u128 * n as u128) >> 64) as usize
    }

    /// Nearest-image difference `self − other` in raw units, −2⁶³ ≤ d < 2⁶³.
    #[inline(always)]
    pub fn minus(self, other: Frac) -> [i64; 2] {
        [self.0[0].wrapping_sub(other.0[0]), self.0[1].wrapping_sub(other.0[1])]
    }

    /// The point moved by a raw difference.
    #[inline(always)]
    pub fn plus(self, raw: [i64; 2]) -> Frac {
        Frac([self.0[0].wrapping_add(raw[0]), self.0[1].wrapping_add(raw[1])])
    }

    /// The same point when the second box vector has become shorter by `n` times the first: exact.
    pub fn flipped(self, n: i64) -> Frac {
        Frac([self.0[0].wrapping_add(self.0[1].wrapping_mul(n)), self.0[1]])
    }
}

/// A real number of periods as a wrapped 64-bit fraction, to the nearest representable one.
fn fixed(f: f64) -> i64 {
    let f = f - f.round(); // exact, in [-1/2, 1/2]
    (f * PERIOD).round_ties_even() as i128 as i64
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn differences_are_antisymmetric(a: [i64; 2], b: [i64; 2]) {
            let (a, b) = (Frac(a), Frac(b));
            let (d, e) = (a.minus(b), b.minus(a));
            prop_assert_eq!(d[0], e[0].wrapping_neg());
            prop_assert_eq!(d[1], e[1].wrapping_neg());
            prop_assert_eq!(b.plus(d), a);
        }

        #[test]
        fn slabs_tile_the_period(a: [i64; 2], n in 1usize..1000) {
            let slab = Frac(a).slab(1, n);
            prop_assert!(slab < n);
            let f = Frac(a).fractions()[1];
            prop_assert!((f * n as f64).floor() as usize == slab || (f * n as f64 - slab as f64).abs() < 1e-9);
        }

        #[test]
        fn whole_periods_do_not_matter(f in 0.0..1.0f64, k in -1000i32..1000) {
            let d = Frac::from_fractions([f + k as f64, 0.0]).minus(Frac::from_fractions([f, 0.0]));
            prop_assert!((d[0] as f64 / PERIOD).abs() < 2e-13);
        }
    }

    #[test]
    fn the_boundary_is_crossed_without_a_jump() {
        let (left, right) = (Frac::from_fractions([0.999, 0.5]), Frac::from_fractions([0.001, 0.5]));
        let d = right.minus(left);
        assert!((d[0] as f64 / PERIOD - 0.002).abs() < 1e-15);
        assert_eq!(Frac::from_fractions([0.5, -0.5]).minus(Frac::from_fractions([-0.5, 0.5])), [0, 0]);
    }
}
