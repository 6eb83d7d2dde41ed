//! The operations in pairs of registers of AVX2, which hold four numbers each: lanes 0 to 3 in the first, 4 to 7 in the
//! second.

use super::{Frac, LANES, Lanes, TAG_BITS, TAGS, Tagged, Vec2, eight, eight_mut, one_by_one};
use std::arch::x86_64::*;

/// Proof that the processor has the instructions of AVX2: made by `detected` only.
#[derive(Clone, Copy)]
pub struct Avx2(());

/// What is done in both registers alike: `$x` are those of one, then those of the other. (A `map` of arrays need not be
/// inlined.)
macro_rules! halves {
    (|$($x:ident),*| $f:expr) => {{
        let half = |k: usize| {
            $(let $x = $x[k];)*
            unsafe { $f }
        };
        [half(0), half(1)]
    }};
}

impl Avx2 {
    #[inline(always)]
    pub fn detected() -> Option<Self> {
        std::arch::is_x86_feature_detected!("avx2").then_some(Avx2(()))
    }

    /// Panics unless all eight numbers are below `n`.
    #[inline(always)]
    fn check(self, at: __m256i, n: usize) {
        // SAFETY: see Avx2.
        let outside = unsafe {
            let n = _mm256_set1_epi32(n.min(u32::MAX as usize) as i32);
            // there is no comparison of numbers without sign but that the larger one is `at`
            _mm256_movemask_epi8(_mm256_cmpeq_epi32(_mm256_max_epu32(at, n), at))
        };
        assert!(outside == 0, "a number that is not there");
    }

    /// Panics unless the first (or second) numbers of all pairs are below `n`.
    #[inline(always)]
    fn check_names<const SECOND: bool>(self, pairs: &[[u16; 2]; LANES], n: usize) {
        // SAFETY: see Avx2; the load is of eight pairs.
        let at = unsafe {
            let both = _mm256_loadu_si256(pairs.as_ptr().cast());
            let first = _mm256_and_si256(both, _mm256_set1_epi32(0xffff));
            if SECOND { _mm256_srli_epi32::<16>(both) } else { first }
        };
        self.check(at, n);
    }

    #[inline(always)]
    fn eight_numbers(self, at: &[u32; LANES]) -> __m256i {
        // SAFETY: see Avx2; the load is of eight u32.
        unsafe { _mm256_loadu_si256(at.as_ptr().cast()) }
    }

    /// The components of eight points or vectors by loads of whole ones.
    ///
    /// # Safety
    /// `of(k)` must point to 16 bytes for each k below 8.
    #[inline(always)]
    unsafe fn transposed(self, of: impl Fn(usize) -> *const __m128i) -> [[__m256i; 2]; 2] {
        // SAFETY: by the contract above.
        let four = |k: usize| unsafe {
            let two = |k: usize| {
                let low = _mm256_castsi128_si256(_mm_loadu_si128(of(k)));
                _mm256_inserti128_si256::<1>(low, _mm_loadu_si128(of(k + 2)))
            };
            let (even, odd) = (two(k), two(k + 1));
            (_mm256_unpacklo_epi64(even, odd), _mm256_unpackhi_epi64(even, odd))
        };
        let ((x, y), (more_x, more_y)) = (four(0), four(4));
        [[x, more_x], [y, more_y]]
    }

    /// The same bits as f64.
    #[inline(always)]
    fn as_reals(self, [x, y]: [[__m256i; 2]; 2]) -> [[__m256d; 2]; 2] {
        [halves!(|x| _mm256_castsi256_pd(x)), halves!(|y| _mm256_castsi256_pd(y))]
    }

    /// Eight numbers, each from a place of its own.
    ///
    /// # Safety
    /// `of(k)` must point to a number for each k below 8.
    #[inline(always)]
    unsafe fn collected(self, of: impl Fn(usize) -> *const f64) -> [__m256d; 2] {
        // SAFETY: by the contract above.
        let four = |k: usize| unsafe {
            let two = |k: usize| _mm_loadh_pd(_mm_load_sd(of(k)), of(k + 1));
            _mm256_insertf128_pd::<1>(_mm256_castpd128_pd256(two(k)), two(k + 2))
        };
        [four(0), four(4)]
    }

    /// The nearest f64. The halves of x as the last bits of large numbers: 2⁵² + low, and 2⁸⁴ + 2⁶³ + 2³² high; what
    /// is too much is taken off exactly, and their sum is rounded once.
    #[inline(always)]
    fn converted(self, x: __m256i) -> __m256d {
        const LOW: f64 = (1u64 << 52) as f64;
        const HIGH: f64 = (1u128 << 84) as f64 + (1u128 << 63) as f64;
        // SAFETY: see Avx2.
        unsafe {
            let low = _mm256_blend_epi32::<0b1010_1010>(x, _mm256_castpd_si256(_mm256_set1_pd(LOW)));
            // exclusive or with 2⁶³, as 2³¹ in this half, makes high + 2³¹ of the signed number high
            let high = _mm256_xor_si256(_mm256_srli_epi64::<32>(x), _mm256_castpd_si256(_mm256_set1_pd(HIGH)));
            let high = _mm256_sub_pd(_mm256_castsi256_pd(high), _mm256_set1_pd(HIGH + LOW));
            _mm256_add_pd(high, _mm256_castsi256_pd(low))
        }
    }
}

/// Masks of the first n numbers of 16 and less, from place 16 − n on.
static FIRST: [i64; 4 * LANES] = {
    let mut first = [0; 4 * LANES];
    let mut k = 0;
    while k < 2 * LANES {
        first[k] = -1;
        k += 1;
    }
    first
};

// SAFETY of all methods: the instructions are there, see Avx2; loads are within slices, see `check`.
impl Lanes for Avx2 {
    type Real = [__m256d; 2];
    type Raw = [__m256i; 2];
    /// All bits of a lane.
    type Mask = [__m256d; 2];

    #[inline(always)]
    fn splat(self, x: f64) -> Self::Real {
        unsafe { [_mm256_set1_pd(x); 2] }
    }

    #[inline(always)]
    fn load(self, from: &[f64]) -> Self::Real {
        let from = eight(from).as_ptr();
        unsafe { [_mm256_loadu_pd(from), _mm256_loadu_pd(from.add(4))] }
    }

    #[inline(always)]
    fn store(self, x: Self::Real, to: &mut [f64]) {
        let to = eight_mut(to).as_mut_ptr();
        unsafe {
            _mm256_storeu_pd(to, x[0]);
            _mm256_storeu_pd(to.add(4), x[1]);
        }
    }

    #[inline(always)]
    fn add(self, a: Self::Real, b: Self::Real) -> Self::Real {
        halves!(|a, b| _mm256_add_pd(a, b))
    }

    #[inline(always)]
    fn sub(self, a: Self::Real, b: Self::Real) -> Self::Real {
        halves!(|a, b| _mm256_sub_pd(a, b))
    }

    #[inline(always)]
    fn mul(self, a: Self::Real, b: Self::Real) -> Self::Real {
        halves!(|a, b| _mm256_mul_pd(a, b))
    }

    #[inline(always)]
    fn div(self, a: Self::Real, b: Self::Real) -> Self::Real {
        halves!(|a, b| _mm256_div_pd(a, b))
    }

    #[inline(always)]
    fn sqrt(self, a: Self::Real) -> Self::Real {
        halves!(|a| _mm256_sqrt_pd(a))
    }

    #[inline(always)]
    fn abs(self, a: Self::Real) -> Self::Real {
        halves!(|a| _mm256_andnot_pd(_mm256_set1_pd(-0.0), a))
    }

    #[inline(always)]
    fn clamp_to_unit(self, a: Self::Real) -> Self::Real {
        // of two zeros, and with a NaN, the second operand is taken
        halves!(|a| _mm256_min_pd(_mm256_set1_pd(1.0), _mm256_max_pd(_mm256_setzero_pd(), a)))
    }

    #[inline(always)]
    fn with_sign(self, a: Self::Real, b: Self::Real) -> Self::Real {
        halves!(|a, b| {
            let sign = _mm256_set1_pd(-0.0);
            _mm256_or_pd(_mm256_andnot_pd(sign, a), _mm256_and_pd(sign, b))
        })
    }

    #[inline(always)]
    fn sum(self, a: Self::Real) -> f64 {
        unsafe {
            let four = _mm256_add_pd(a[0], a[1]);
            let two = _mm_add_pd(_mm256_castpd256_pd128(four), _mm256_extractf128_pd::<1>(four));
            _mm_cvtsd_f64(_mm_add_sd(two, _mm_unpackhi_pd(two, two)))
        }
    }

    #[inline(always)]
    fn less(self, a: Self::Real, b: Self::Real) -> Self::Mask {
        halves!(|a, b| _mm256_cmp_pd::<_CMP_LT_OQ>(a, b))
    }

    #[inline(always)]
    fn up_to(self, a: Self::Real, b: Self::Real) -> Self::Mask {
        halves!(|a, b| _mm256_cmp_pd::<_CMP_LE_OQ>(a, b))
    }

    #[inline(always)]
    fn both(self, a: Self::Mask, b: Self::Mask) -> Self::Mask {
        halves!(|a, b| _mm256_and_pd(a, b))
    }

    #[inline(always)]
    fn first(self, n: usize) -> Self::Mask {
        let from = FIRST[2 * LANES - n.min(LANES)..].as_ptr().cast();
        unsafe { [_mm256_loadu_pd(from), _mm256_loadu_pd(from.add(4))] }
    }

    #[inline(always)]
    fn keep(self, mask: Self::Mask, x: Self::Real) -> Self::Real {
        halves!(|mask, x| _mm256_and_pd(mask, x))
    }

    #[inline(always)]
    fn bits(self, mask: Self::Mask) -> u8 {
        let [low, high] = halves!(|mask| _mm256_movemask_pd(mask) as u8);
        low | high << 4
    }

    #[inline(always)]
    fn where_between(self, a: Self::Real, b: Self::Real, x: Self::Real) -> Self::Real {
        halves!(|a, b, x| {
            let positive = _mm256_cmp_pd::<_CMP_GT_OQ>(a, _mm256_setzero_pd());
            _mm256_and_pd(_mm256_and_pd(positive, _mm256_cmp_pd::<_CMP_LT_OQ>(a, b)), x)
        })
    }

    #[inline(always)]
    fn difference(self, a: Self::Raw, b: Self::Raw) -> Self::Real {
        self.real(self.sub_raw(a, b))
    }

    #[inline(always)]
    fn real(self, a: Self::Raw) -> Self::Real {
        [self.converted(a[0]), self.converted(a[1])]
    }

    #[inline(always)]
    fn splat_raw(self, x: i64) -> Self::Raw {
        unsafe { [_mm256_set1_epi64x(x); 2] }
    }

    #[inline(always)]
    fn sub_raw(self, a: Self::Raw, b: Self::Raw) -> Self::Raw {
        halves!(|a, b| _mm256_sub_epi64(a, b))
    }

    #[inline(always)]
    fn keep_raw(self, mask: Self::Mask, x: Self::Raw) -> Self::Raw {
        halves!(|mask, x| _mm256_and_si256(_mm256_castpd_si256(mask), x))
    }

    #[inline(always)]
    fn shifted_raw(self, a: Self::Raw, b: Self::Raw) -> Self::Raw {
        // each lane from the one after it; `next` are the four lanes after a
        let after = |a: __m256i, next: __m256i| unsafe {
            _mm256_alignr_epi8::<8>(_mm256_permute2x128_si256::<0x21>(a, next), a)
        };
        [after(a[0], a[1]), after(a[1], b[0])]
    }

    #[inline(always)]
    fn shifted(self, before: f64, a: Self::Real) -> Self::Real {
        // `pairs` are the two pairs of lanes before those of a
        let behind = |pairs: __m256d, a: __m256d| unsafe { _mm256_shuffle_pd::<0b0101>(pairs, a) };
        unsafe {
            let first = _mm256_permute2f128_pd::<0x20>(_mm256_set1_pd(before), a[0]);
            [behind(first, a[0]), behind(_mm256_permute2f128_pd::<0x21>(a[0], a[1]), a[1])]
        }
    }

    #[inline(always)]
    fn few_points(self, points: &[Frac]) -> [Self::Raw; 2] {
        let masks = FIRST[2 * (LANES - points.len().min(LANES))..].as_ptr();
        let from = points.as_ptr().cast::<i64>();
        // SAFETY: numbers that the masks leave out are not read; there are 2 LANES masks.
        let four = |k: usize| unsafe {
            let two =
                |k: usize| _mm256_maskload_epi64(from.wrapping_add(2 * k), _mm256_loadu_si256(masks.add(2 * k).cast()));
            let (a, b) = (two(k), two(k + 2));
            let (even, odd) = (_mm256_permute2x128_si256::<0x20>(a, b), _mm256_permute2x128_si256::<0x31>(a, b));
            (_mm256_unpacklo_epi64(even, odd), _mm256_unpackhi_epi64(even, odd))
        };
        let ((x, y), (more_x, more_y)) = (four(0), four(4));
        [[x, more_x], [y, more_y]]
    }

    #[inline(always)]
    fn points(self, points: &[Frac], at: &[u32; LANES]) -> [Self::Raw; 2] {
        self.check(self.eight_numbers(at), points.len());
        unsafe { self.transposed(|k| points.as_ptr().add(one_by_one(&at[k]) as usize).cast()) }
    }

    #[inline(always)]
    fn tagged_points(self, points: &[Frac], at: &[Tagged; LANES]) -> [Self::Raw; 2] {
        // a point is below the number of points when it is with any tag
        self.check(self.eight_numbers(at), points.len().saturating_mul(TAGS));
        // cleared of its tag, a number is the place of its point in units of a quarter point
        let quarters = |k: usize| (one_by_one(&at[k]) >> TAG_BITS << TAG_BITS) as usize;
        unsafe { self.transposed(|k| points.as_ptr().byte_add(size_of::<Frac>() / TAGS * quarters(k)).cast()) }
    }

    #[inline(always)]
    fn by_tags(self, table: &[f64; TAGS * TAGS], row: &[Tagged; LANES], column: &[Tagged; LANES]) -> Self::Real {
        let mut places = [0u32; LANES];
        unsafe {
            let tag = _mm256_set1_epi32(TAGS as i32 - 1);
            let row = _mm256_and_si256(self.eight_numbers(row), tag);
            let column = _mm256_and_si256(self.eight_numbers(column), tag);
            let place = _mm256_or_si256(_mm256_slli_epi32::<{ TAG_BITS as i32 }>(row), column);
            _mm256_storeu_si256(places.as_mut_ptr().cast(), place);
            self.collected(|k| table.as_ptr().add(one_by_one(&places[k]) as usize))
        }
    }

    #[inline(always)]
    fn numbers(self, numbers: &[f64], at: &[u32; LANES]) -> Self::Real {
        self.check(self.eight_numbers(at), numbers.len());
        unsafe { self.collected(|k| numbers.as_ptr().add(one_by_one(&at[k]) as usize)) }
    }

    #[inline(always)]
    fn named<const SECOND: bool>(self, numbers: &[f64], pairs: &[[u16; 2]; LANES]) -> Self::Real {
        self.check_names::<SECOND>(pairs, numbers.len());
        unsafe { self.collected(|k| numbers.as_ptr().add(one_by_one(&pairs[k][SECOND as usize]) as usize)) }
    }

    #[inline(always)]
    fn named_vectors<const SECOND: bool>(self, vectors: &[Vec2], pairs: &[[u16; 2]; LANES]) -> [Self::Real; 2] {
        self.check_names::<SECOND>(pairs, vectors.len());
        let place = |k: usize| one_by_one(&pairs[k][SECOND as usize]) as usize;
        self.as_reals(unsafe { self.transposed(|k| vectors.as_ptr().add(place(k)).cast()) })
    }

    #[inline(always)]
    fn vectors(self, x: Self::Real, y: Self::Real) -> [Vec2; LANES] {
        let mut vectors = [[0.0; 2]; LANES];
        self.store_vectors(x, y, &mut vectors);
        vectors
    }

    #[inline(always)]
    fn components(self, from: &[Vec2]) -> [Self::Real; 2] {
        let from = eight(from);
        self.as_reals(unsafe { self.transposed(|k| from[k].as_ptr().cast()) })
    }

    #[inline(always)]
    fn store_vectors(self, x: Self::Real, y: Self::Real, to: &mut [Vec2]) {
        let to = eight_mut(to).as_mut_ptr().cast::<f64>();
        let four = |k: usize, x: __m256d, y: __m256d| unsafe {
            let (even, odd) = (_mm256_unpacklo_pd(x, y), _mm256_unpackhi_pd(x, y));
            _mm256_storeu_pd(to.add(2 * k), _mm256_permute2f128_pd::<0x20>(even, odd));
            _mm256_storeu_pd(to.add(2 * k + 4), _mm256_permute2f128_pd::<0x31>(even, odd));
        };
        four(0, x[0], y[0]);
        four(4, x[1], y[1]);
    }
}
