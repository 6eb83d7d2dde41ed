//! The operations in registers of AVX-512, which hold eight numbers.

use super::{Frac, LANES, Lanes, TAG_BITS, TAGS, Tagged, Vec2, eight, eight_mut, one_by_one};
use std::arch::x86_64::*;

/// Proof that the processor has the instructions used here (AVX-512 F, DQ and VL): made by `detected` only.
#[derive(Clone, Copy)]
pub struct Avx512(());

impl Avx512 {
    #[inline(always)]
    pub fn detected() -> Option<Self> {
        let has_all = std::arch::is_x86_feature_detected!("avx512f")
            && std::arch::is_x86_feature_detected!("avx512dq")
            && std::arch::is_x86_feature_detected!("avx512vl");
        has_all.then_some(Avx512(()))
    }

    /// Panics unless all numbers are below `n`.
    #[inline(always)]
    fn check(self, at: &[u32; LANES], n: usize) {
        // SAFETY: see Avx512; the load is of eight u32.
        let inside = unsafe {
            let at = _mm256_loadu_si256(at.as_ptr().cast());
            _mm256_cmplt_epu32_mask(at, _mm256_set1_epi32(n.min(u32::MAX as usize) as i32))
        };
        assert!(inside == 0xff, "a point that is not there");
    }

    /// Panics unless the first (or second) numbers of all pairs are below `n`.
    #[inline(always)]
    fn check_names<const SECOND: bool>(self, pairs: &[[u16; 2]; LANES], n: usize) {
        // SAFETY: see Avx512; the load is of eight pairs.
        let inside = unsafe {
            let both = _mm256_loadu_si256(pairs.as_ptr().cast());
            let first = _mm256_and_si256(both, _mm256_set1_epi32(0xffff));
            let at = if SECOND { _mm256_srli_epi32::<16>(both) } else { first };
            _mm256_cmplt_epu32_mask(at, _mm256_set1_epi32(n.min(u16::MAX as usize + 1) as i32))
        };
        assert!(inside == 0xff, "a number that is not there");
    }

    /// Eight loads of whole points or vectors and two shuffles: quicker than two gathers.
    ///
    /// # Safety
    /// `of(k)` must point to 16 bytes for each k below 8.
    #[inline(always)]
    unsafe fn transposed(self, of: impl Fn(usize) -> *const __m128i) -> [__m512i; 2] {
        // SAFETY: by the contract above.
        unsafe {
            let one = |k: usize| _mm_loadu_si128(of(k));
            let four = |k: usize| {
                let a = _mm512_castsi128_si512(one(k));
                let b = _mm512_inserti64x2::<1>(a, one(k + 2));
                let c = _mm512_inserti64x2::<2>(b, one(k + 4));
                _mm512_inserti64x2::<3>(c, one(k + 6))
            };
            let (even, odd) = (four(0), four(1));
            [_mm512_unpacklo_epi64(even, odd), _mm512_unpackhi_epi64(even, odd)]
        }
    }
}

// where the eight numbers of a result lie among the sixteen of two registers
const EVEN: [i64; LANES] = [0, 2, 4, 6, 8, 10, 12, 14];
const ODD: [i64; LANES] = [1, 3, 5, 7, 9, 11, 13, 15];
const FIRST_FOUR: [i64; LANES] = [0, 8, 1, 9, 2, 10, 3, 11];
const LAST_FOUR: [i64; LANES] = [4, 12, 5, 13, 6, 14, 7, 15];

// SAFETY of all methods: the instructions are there, see Avx512; loads are within slices, see `check`.
impl Lanes for Avx512 {
    type Real = __m512d;
    type Raw = __m512i;
    type Mask = __mmask8;

    #[inline(always)]
    fn splat(self, x: f64) -> __m512d {
        unsafe { _mm512_set1_pd(x) }
    }

    #[inline(always)]
    fn load(self, from: &[f64]) -> __m512d {
        unsafe { _mm512_loadu_pd(eight(from).as_ptr()) }
    }

    #[inline(always)]
    fn store(self, x: __m512d, to: &mut [f64]) {
        unsafe { _mm512_storeu_pd(eight_mut(to).as_mut_ptr(), x) }
    }

    #[inline(always)]
    fn add(self, a: __m512d, b: __m512d) -> __m512d {
        unsafe { _mm512_add_pd(a, b) }
    }

    #[inline(always)]
    fn sub(self, a: __m512d, b: __m512d) -> __m512d {
        unsafe { _mm512_sub_pd(a, b) }
    }

    #[inline(always)]
    fn mul(self, a: __m512d, b: __m512d) -> __m512d {
        unsafe { _mm512_mul_pd(a, b) }
    }

    #[inline(always)]
    fn div(self, a: __m512d, b: __m512d) -> __m512d {
        unsafe { _mm512_div_pd(a, b) }
    }

    #[inline(always)]
    fn sqrt(self, a: __m512d) -> __m512d {
        unsafe { _mm512_sqrt_pd(a) }
    }

    #[inline(always)]
    fn abs(self, a: __m512d) -> __m512d {
        unsafe { _mm512_abs_pd(a) }
    }

    #[inline(always)]
    fn clamp_to_unit(self, a: __m512d) -> __m512d {
        // of two zeros, and with a NaN, the second operand is taken
        unsafe { _mm512_min_pd(_mm512_set1_pd(1.0), _mm512_max_pd(_mm512_setzero_pd(), a)) }
    }

    #[inline(always)]
    fn with_sign(self, a: __m512d, b: __m512d) -> __m512d {
        unsafe {
            let sign = _mm512_and_pd(b, _mm512_set1_pd(-0.0));
            _mm512_or_pd(_mm512_abs_pd(a), sign)
        }
    }

    #[inline(always)]
    fn sum(self, a: __m512d) -> f64 {
        unsafe {
            let four = _mm256_add_pd(_mm512_castpd512_pd256(a), _mm512_extractf64x4_pd::<1>(a));
            let two = _mm_add_pd(_mm256_castpd256_pd128(four), _mm256_extractf128_pd::<1>(four));
            _mm_cvtsd_f64(_mm_add_sd(two, _mm_unpackhi_pd(two, two)))
        }
    }

    #[inline(always)]
    fn less(self, a: __m512d, b: __m512d) -> __mmask8 {
        unsafe { _mm512_cmp_pd_mask::<_CMP_LT_OQ>(a, b) }
    }

    #[inline(always)]
    fn up_to(self, a: __m512d, b: __m512d) -> __mmask8 {
        unsafe { _mm512_cmp_pd_mask::<_CMP_LE_OQ>(a, b) }
    }

    #[inline(always)]
    fn both(self, a: __mmask8, b: __mmask8) -> __mmask8 {
        a & b
    }

    #[inline(always)]
    fn first(self, n: usize) -> __mmask8 {
        if n < LANES { (1 << n) - 1 } else { 0xff }
    }

    #[inline(always)]
    fn keep(self, mask: __mmask8, x: __m512d) -> __m512d {
        unsafe { _mm512_maskz_mov_pd(mask, x) }
    }

    #[inline(always)]
    fn bits(self, mask: __mmask8) -> u8 {
        mask
    }

    #[inline(always)]
    fn where_between(self, a: __m512d, b: __m512d, x: __m512d) -> __m512d {
        unsafe {
            let positive = _mm512_cmp_pd_mask::<_CMP_GT_OQ>(a, _mm512_setzero_pd());
            _mm512_maskz_mov_pd(_mm512_mask_cmp_pd_mask::<_CMP_LT_OQ>(positive, a, b), x)
        }
    }

    #[inline(always)]
    fn difference(self, a: __m512i, b: __m512i) -> __m512d {
        unsafe { _mm512_cvtepi64_pd(_mm512_sub_epi64(a, b)) }
    }

    #[inline(always)]
    fn real(self, a: __m512i) -> __m512d {
        unsafe { _mm512_cvtepi64_pd(a) }
    }

    #[inline(always)]
    fn splat_raw(self, x: i64) -> __m512i {
        unsafe { _mm512_set1_epi64(x) }
    }

    #[inline(always)]
    fn sub_raw(self, a: __m512i, b: __m512i) -> __m512i {
        unsafe { _mm512_sub_epi64(a, b) }
    }

    #[inline(always)]
    fn keep_raw(self, mask: __mmask8, x: __m512i) -> __m512i {
        unsafe { _mm512_maskz_mov_epi64(mask, x) }
    }

    #[inline(always)]
    fn shifted_raw(self, a: __m512i, b: __m512i) -> __m512i {
        unsafe { _mm512_alignr_epi64::<1>(b, a) }
    }

    #[inline(always)]
    fn shifted(self, before: f64, a: __m512d) -> __m512d {
        unsafe {
            let before = _mm512_castpd_si512(_mm512_set1_pd(before));
            _mm512_castsi512_pd(_mm512_alignr_epi64::<7>(_mm512_castpd_si512(a), before))
        }
    }

    #[inline(always)]
    fn few_points(self, points: &[Frac]) -> [__m512i; 2] {
        let numbers = 2 * points.len().min(LANES) as u32;
        let mask = ((1u32 << numbers) - 1) as u16;
        unsafe {
            let from = points.as_ptr().cast::<i64>();
            let low = _mm512_maskz_loadu_epi64(mask as u8, from);
            let high = _mm512_maskz_loadu_epi64((mask >> 8) as u8, from.wrapping_add(LANES));
            let even = _mm512_permutex2var_epi64(low, _mm512_loadu_si512(EVEN.as_ptr().cast()), high);
            let odd = _mm512_permutex2var_epi64(low, _mm512_loadu_si512(ODD.as_ptr().cast()), high);
            [even, odd]
        }
    }

    #[inline(always)]
    fn points(self, points: &[Frac], at: &[u32; LANES]) -> [__m512i; 2] {
        self.check(at, points.len());
        unsafe { self.transposed(|k| points.as_ptr().add(one_by_one(&at[k]) as usize).cast()) }
    }

    #[inline(always)]
    fn tagged_points(self, points: &[Frac], at: &[Tagged; LANES]) -> [__m512i; 2] {
        // a point is below the number of points when it is with any tag
        self.check(at, points.len().saturating_mul(TAGS));
        // cleared of its tag, a number is the place of its point in units of a quarter point
        let quarters = |k: usize| (one_by_one(&at[k]) >> TAG_BITS << TAG_BITS) as usize;
        unsafe { self.transposed(|k| points.as_ptr().byte_add(size_of::<Frac>() / TAGS * quarters(k)).cast()) }
    }

    #[inline(always)]
    fn by_tags(self, table: &[f64; TAGS * TAGS], row: &[Tagged; LANES], column: &[Tagged; LANES]) -> __m512d {
        unsafe {
            let wide = |at: &[u32; LANES]| _mm512_cvtepu32_epi64(_mm256_loadu_si256(at.as_ptr().cast()));
            let tags = _mm512_and_epi64(wide(column), _mm512_set1_epi64(TAGS as i64 - 1));
            // of an index the instruction looks at the last four bits only
            let place = _mm512_or_epi64(_mm512_slli_epi64::<TAG_BITS>(wide(row)), tags);
            let [first, last] = [0, LANES].map(|k| _mm512_loadu_pd(table.as_ptr().add(k)));
            _mm512_permutex2var_pd(first, place, last)
        }
    }

    #[inline(always)]
    fn numbers(self, numbers: &[f64], at: &[u32; LANES]) -> __m512d {
        self.check(at, numbers.len());
        unsafe {
            let from = numbers.as_ptr();
            let two = |k: usize| {
                let low = _mm_load_sd(from.add(at[k] as usize));
                _mm_loadh_pd(low, from.add(at[k + 1] as usize))
            };
            let a = _mm512_castpd128_pd512(two(0));
            let b = _mm512_insertf64x2::<1>(a, two(2));
            let c = _mm512_insertf64x2::<2>(b, two(4));
            _mm512_insertf64x2::<3>(c, two(6))
        }
    }

    #[inline(always)]
    fn named<const SECOND: bool>(self, numbers: &[f64], pairs: &[[u16; 2]; LANES]) -> __m512d {
        self.check_names::<SECOND>(pairs, numbers.len());
        unsafe {
            let from = numbers.as_ptr();
            macro_rules! two {
                ($lane:literal) => {{
                    let low = _mm_load_sd(from.add(one_by_one(&pairs[$lane][SECOND as usize]) as usize));
                    _mm_loadh_pd(low, from.add(one_by_one(&pairs[$lane + 1][SECOND as usize]) as usize))
                }};
            }
            let a = _mm512_castpd128_pd512(two!(0));
            let b = _mm512_insertf64x2::<1>(a, two!(2));
            let c = _mm512_insertf64x2::<2>(b, two!(4));
            _mm512_insertf64x2::<3>(c, two!(6))
        }
    }

    #[inline(always)]
    fn named_vectors<const SECOND: bool>(self, vectors: &[Vec2], pairs: &[[u16; 2]; LANES]) -> [__m512d; 2] {
        self.check_names::<SECOND>(pairs, vectors.len());
        unsafe {
            let place = |k: usize| one_by_one(&pairs[k][SECOND as usize]) as usize;
            self.transposed(|k| vectors.as_ptr().add(place(k)).cast()).map(|row| _mm512_castsi512_pd(row))
        }
    }

    #[inline(always)]
    fn vectors(self, x: __m512d, y: __m512d) -> [Vec2; LANES] {
        unsafe {
            let (low, high) = (_mm512_unpacklo_pd(x, y), _mm512_unpackhi_pd(x, y));
            let mut vectors = [[0.0; 2]; LANES];
            let mut put = |k: usize, v: __m128d| _mm_storeu_pd(vectors[k].as_mut_ptr(), v);
            put(0, _mm512_castpd512_pd128(low));
            put(1, _mm512_castpd512_pd128(high));
            put(2, _mm512_extractf64x2_pd::<1>(low));
            put(3, _mm512_extractf64x2_pd::<1>(high));
            put(4, _mm512_extractf64x2_pd::<2>(low));
            put(5, _mm512_extractf64x2_pd::<2>(high));
            put(6, _mm512_extractf64x2_pd::<3>(low));
            put(7, _mm512_extractf64x2_pd::<3>(high));
            vectors
        }
    }

    #[inline(always)]
    fn components(self, from: &[Vec2]) -> [__m512d; 2] {
        let from = eight(from).as_ptr();
        unsafe {
            let (low, high) = (_mm512_loadu_pd(from.cast()), _mm512_loadu_pd(from.add(4).cast()));
            let even = _mm512_permutex2var_pd(low, _mm512_loadu_si512(EVEN.as_ptr().cast()), high);
            let odd = _mm512_permutex2var_pd(low, _mm512_loadu_si512(ODD.as_ptr().cast()), high);
            [even, odd]
        }
    }

    #[inline(always)]
    fn store_vectors(self, x: __m512d, y: __m512d, to: &mut [Vec2]) {
        let to = eight_mut(to).as_mut_ptr();
        unsafe {
            let first = _mm512_permutex2var_pd(x, _mm512_loadu_si512(FIRST_FOUR.as_ptr().cast()), y);
            let last = _mm512_permutex2var_pd(x, _mm512_loadu_si512(LAST_FOUR.as_ptr().cast()), y);
            _mm512_storeu_pd(to.cast(), first);
            _mm512_storeu_pd(to.add(4).cast(), last);
        }
    }
}
