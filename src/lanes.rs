//! Arithmetic on eight numbers at a time, in the widest registers that the processor has.
//!
//! Every operation is one IEEE operation per lane, rounded as scalar code rounds it (no fused multiply-add, no
//! estimates), so that results are the same bits on every processor.
//!
//! Kernels call these operations outside of closures: a closure handed to other code, as to `map` of an array, need not
//! be inlined, and is then compiled for the oldest processor.
//!
//! This file holds the only `unsafe` code outside of foreign interfaces: the instructions of AVX-512 and the calls of
//! functions compiled for more than the oldest processor. They halve the time of a force evaluation of soft disks.

use crate::geometry::{Frac, Vec2};

/// How many numbers are handled together.
pub const LANES: usize = 8;

/// A number of a point with a tag below [`TAGS`], which says what the point is like.
pub type Tagged = u32;

pub const TAGS: usize = 4;
const TAG_BITS: u32 = 2;

#[inline(always)]
pub fn tagged(point: u32, tag: u32) -> Tagged {
    point << TAG_BITS | tag
}

#[inline(always)]
pub fn point_of(tagged: Tagged) -> u32 {
    tagged >> TAG_BITS
}

#[inline(always)]
pub fn tag_of(tagged: Tagged) -> u32 {
    tagged % TAGS as u32
}

/// Work that is compiled for each kind of processor; whatever it calls and is to profit must be inlined into it.
pub trait Kernel {
    type Output;
    fn run(self, lanes: impl Lanes) -> Self::Output;
}

/// Runs `kernel` in the widest registers that this processor has.
#[inline]
pub fn run<K: Kernel>(kernel: K) -> K::Output {
    #[cfg(target_arch = "x86_64")]
    {
        if let Some(lanes) = avx512::Avx512::detected() {
            // SAFETY: `lanes` exists where the processor has these instructions only.
            return unsafe { for_avx512(kernel, lanes) };
        }
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: as detected.
            return unsafe { for_avx2(kernel) };
        }
    }
    kernel.run(Arrays)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,avx512f,avx512dq,avx512vl")]
fn for_avx512<K: Kernel>(kernel: K, lanes: avx512::Avx512) -> K::Output {
    kernel.run(lanes)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn for_avx2<K: Kernel>(kernel: K) -> K::Output {
    kernel.run(Arrays)
}

/// Eight-fold numbers and what can be done with them.
pub trait Lanes: Copy {
    /// Eight f64.
    type Real: Copy;
    /// Eight fixed-point coordinates.
    type Raw: Copy;
    /// Eight times yes or no.
    type Mask: Copy;

    fn splat(self, x: f64) -> Self::Real;
    /// The first eight numbers.
    fn load(self, from: &[f64]) -> Self::Real;
    /// To the first eight places.
    fn store(self, x: Self::Real, to: &mut [f64]);
    fn add(self, a: Self::Real, b: Self::Real) -> Self::Real;
    fn sub(self, a: Self::Real, b: Self::Real) -> Self::Real;
    fn mul(self, a: Self::Real, b: Self::Real) -> Self::Real;
    fn div(self, a: Self::Real, b: Self::Real) -> Self::Real;
    fn sqrt(self, a: Self::Real) -> Self::Real;
    fn abs(self, a: Self::Real) -> Self::Real;
    /// a, but no less than 0 and no more than 1.
    fn clamp_to_unit(self, a: Self::Real) -> Self::Real;
    /// |a| with the sign of b.
    fn with_sign(self, a: Self::Real, b: Self::Real) -> Self::Real;
    /// The sum of all eight, in one order: halves, then quarters, then neighbours.
    fn sum(self, a: Self::Real) -> f64;
    /// a < b.
    fn less(self, a: Self::Real, b: Self::Real) -> Self::Mask;
    /// a ≤ b.
    fn up_to(self, a: Self::Real, b: Self::Real) -> Self::Mask;
    fn both(self, a: Self::Mask, b: Self::Mask) -> Self::Mask;
    /// The first n, all if there are not more.
    fn first(self, n: usize) -> Self::Mask;
    /// x where the mask says so, else +0.
    fn keep(self, mask: Self::Mask, x: Self::Real) -> Self::Real;
    /// Bit k is what the mask says of lane k.
    fn bits(self, mask: Self::Mask) -> u8;
    /// x where 0 < a < b, else +0.
    fn where_between(self, a: Self::Real, b: Self::Real, x: Self::Real) -> Self::Real;
    /// Wrapping difference a − b, to the nearest f64.
    fn difference(self, a: Self::Raw, b: Self::Raw) -> Self::Real;
    fn real(self, a: Self::Raw) -> Self::Real;
    fn splat_raw(self, x: i64) -> Self::Raw;
    /// Wrapping difference.
    fn sub_raw(self, a: Self::Raw, b: Self::Raw) -> Self::Raw;
    /// x where the mask says so, else 0.
    fn keep_raw(self, mask: Self::Mask, x: Self::Raw) -> Self::Raw;
    /// All but the first of a, then the first of b.
    fn shifted_raw(self, a: Self::Raw, b: Self::Raw) -> Self::Raw;
    /// `before`, then all but the last of a.
    fn shifted(self, before: f64, a: Self::Real) -> Self::Real;
    /// The two coordinates of up to eight points, and zeros.
    fn few_points(self, points: &[Frac]) -> [Self::Raw; 2];
    /// The two coordinates of the points with these numbers.
    fn points(self, points: &[Frac], at: &[u32; LANES]) -> [Self::Raw; 2];
    /// The same of tagged points.
    fn tagged_points(self, points: &[Frac], at: &[Tagged; LANES]) -> [Self::Raw; 2];
    /// What a table of `TAGS` rows says about pairs of tags.
    fn by_tags(self, table: &[f64; TAGS * TAGS], row: &[Tagged; LANES], column: &[Tagged; LANES]) -> Self::Real;
    /// The numbers with these numbers.
    fn numbers(self, numbers: &[f64], at: &[u32; LANES]) -> Self::Real;
    /// The numbers in the places that the first (or second) numbers of eight pairs name.
    fn named<const SECOND: bool>(self, numbers: &[f64], pairs: &[[u16; 2]; LANES]) -> Self::Real;
    /// The two components of the vectors there.
    fn named_vectors<const SECOND: bool>(self, vectors: &[Vec2], pairs: &[[u16; 2]; LANES]) -> [Self::Real; 2];
    /// Eight vectors.
    fn vectors(self, x: Self::Real, y: Self::Real) -> [Vec2; LANES];
    /// The two components of the first eight.
    fn components(self, from: &[Vec2]) -> [Self::Real; 2];
    /// To the first eight places.
    fn store_vectors(self, x: Self::Real, y: Self::Real, to: &mut [Vec2]);
}

/// The first eight of a slice.
#[inline(always)]
fn eight<T>(from: &[T]) -> &[T; LANES] {
    from.first_chunk().expect("eight")
}

#[inline(always)]
fn eight_mut<T>(to: &mut [T]) -> &mut [T; LANES] {
    to.first_chunk_mut().expect("eight")
}

/// Plain arrays, for every processor.
#[derive(Clone, Copy)]
struct Arrays;

#[inline(always)]
fn zip<T: Copy, R>(a: [T; LANES], b: [T; LANES], f: impl Fn(T, T) -> R) -> [R; LANES] {
    std::array::from_fn(|k| f(a[k], b[k]))
}

impl Lanes for Arrays {
    type Real = [f64; LANES];
    type Raw = [i64; LANES];
    type Mask = [bool; LANES];

    #[inline(always)]
    fn splat(self, x: f64) -> Self::Real {
        [x; LANES]
    }

    #[inline(always)]
    fn load(self, from: &[f64]) -> Self::Real {
        *eight(from)
    }

    #[inline(always)]
    fn store(self, x: Self::Real, to: &mut [f64]) {
        *eight_mut(to) = x;
    }

    #[inline(always)]
    fn add(self, a: Self::Real, b: Self::Real) -> Self::Real {
        zip(a, b, |a, b| a + b)
    }

    #[inline(always)]
    fn sub(self, a: Self::Real, b: Self::Real) -> Self::Real {
        zip(a, b, |a, b| a - b)
    }

    #[inline(always)]
    fn mul(self, a: Self::Real, b: Self::Real) -> Self::Real {
        zip(a, b, |a, b| a * b)
    }

    #[inline(always)]
    fn div(self, a: Self::Real, b: Self::Real) -> Self::Real {
        zip(a, b, |a, b| a / b)
    }

    #[inline(always)]
    fn sqrt(self, a: Self::Real) -> Self::Real {
        a.map(f64::sqrt)
    }

    #[inline(always)]
    fn abs(self, a: Self::Real) -> Self::Real {
        a.map(f64::abs)
    }

    #[inline(always)]
    fn clamp_to_unit(self, a: Self::Real) -> Self::Real {
        a.map(|a| a.clamp(0.0, 1.0))
    }

    #[inline(always)]
    fn with_sign(self, a: Self::Real, b: Self::Real) -> Self::Real {
        zip(a, b, f64::copysign)
    }

    #[inline(always)]
    fn sum(self, a: Self::Real) -> f64 {
        let four: [f64; 4] = std::array::from_fn(|k| a[k] + a[k + 4]);
        (four[0] + four[2]) + (four[1] + four[3])
    }

    #[inline(always)]
    fn less(self, a: Self::Real, b: Self::Real) -> Self::Mask {
        zip(a, b, |a, b| a < b)
    }

    #[inline(always)]
    fn up_to(self, a: Self::Real, b: Self::Real) -> Self::Mask {
        zip(a, b, |a, b| a <= b)
    }

    #[inline(always)]
    fn both(self, a: Self::Mask, b: Self::Mask) -> Self::Mask {
        zip(a, b, |a, b| a & b)
    }

    #[inline(always)]
    fn first(self, n: usize) -> Self::Mask {
        std::array::from_fn(|k| k < n)
    }

    #[inline(always)]
    fn keep(self, mask: Self::Mask, x: Self::Real) -> Self::Real {
        std::array::from_fn(|k| if mask[k] { x[k] } else { 0.0 })
    }

    #[inline(always)]
    fn bits(self, mask: Self::Mask) -> u8 {
        mask.iter().enumerate().fold(0, |bits, (k, &yes)| bits | (yes as u8) << k)
    }

    #[inline(always)]
    fn where_between(self, a: Self::Real, b: Self::Real, x: Self::Real) -> Self::Real {
        std::array::from_fn(|k| if (0.0 < a[k]) & (a[k] < b[k]) { x[k] } else { 0.0 })
    }

    #[inline(always)]
    fn difference(self, a: Self::Raw, b: Self::Raw) -> Self::Real {
        zip(a, b, |a, b| a.wrapping_sub(b) as f64)
    }

    #[inline(always)]
    fn real(self, a: Self::Raw) -> Self::Real {
        a.map(|a| a as f64)
    }

    #[inline(always)]
    fn splat_raw(self, x: i64) -> Self::Raw {
        [x; LANES]
    }

    #[inline(always)]
    fn sub_raw(self, a: Self::Raw, b: Self::Raw) -> Self::Raw {
        zip(a, b, i64::wrapping_sub)
    }

    #[inline(always)]
    fn keep_raw(self, mask: Self::Mask, x: Self::Raw) -> Self::Raw {
        std::array::from_fn(|k| if mask[k] { x[k] } else { 0 })
    }

    #[inline(always)]
    fn shifted_raw(self, a: Self::Raw, b: Self::Raw) -> Self::Raw {
        std::array::from_fn(|k| if k + 1 < LANES { a[k + 1] } else { b[0] })
    }

    #[inline(always)]
    fn shifted(self, before: f64, a: Self::Real) -> Self::Real {
        std::array::from_fn(|k| if k > 0 { a[k - 1] } else { before })
    }

    #[inline(always)]
    fn few_points(self, points: &[Frac]) -> [Self::Raw; 2] {
        let bits: [[i64; 2]; LANES] = std::array::from_fn(|k| points.get(k).map_or([0; 2], |point| point.to_bits()));
        [bits.map(|b| b[0]), bits.map(|b| b[1])]
    }

    #[inline(always)]
    fn points(self, points: &[Frac], at: &[u32; LANES]) -> [Self::Raw; 2] {
        let bits = at.map(|i| points[i as usize].to_bits());
        [bits.map(|b| b[0]), bits.map(|b| b[1])]
    }

    #[inline(always)]
    fn tagged_points(self, points: &[Frac], at: &[Tagged; LANES]) -> [Self::Raw; 2] {
        self.points(points, &at.map(point_of))
    }

    #[inline(always)]
    fn by_tags(self, table: &[f64; TAGS * TAGS], row: &[Tagged; LANES], column: &[Tagged; LANES]) -> Self::Real {
        zip(*row, *column, |a, b| table[tag_of(a) as usize * TAGS + tag_of(b) as usize])
    }

    #[inline(always)]
    fn numbers(self, numbers: &[f64], at: &[u32; LANES]) -> Self::Real {
        at.map(|i| numbers[i as usize])
    }

    #[inline(always)]
    fn named<const SECOND: bool>(self, numbers: &[f64], pairs: &[[u16; 2]; LANES]) -> Self::Real {
        pairs.map(|pair| numbers[pair[SECOND as usize] as usize])
    }

    #[inline(always)]
    fn named_vectors<const SECOND: bool>(self, vectors: &[Vec2], pairs: &[[u16; 2]; LANES]) -> [Self::Real; 2] {
        let named = pairs.map(|pair| vectors[pair[SECOND as usize] as usize]);
        [0, 1].map(|axis| named.map(|vector| vector[axis]))
    }

    #[inline(always)]
    fn vectors(self, x: Self::Real, y: Self::Real) -> [Vec2; LANES] {
        zip(x, y, |x, y| [x, y])
    }

    #[inline(always)]
    fn components(self, from: &[Vec2]) -> [Self::Real; 2] {
        let from = eight(from);
        [0, 1].map(|axis| from.map(|vector| vector[axis]))
    }

    #[inline(always)]
    fn store_vectors(self, x: Self::Real, y: Self::Real, to: &mut [Vec2]) {
        *eight_mut(to) = self.vectors(x, y);
    }
}

#[cfg(target_arch = "x86_64")]
mod avx512 {
    use super::{Frac, LANES, Lanes, TAG_BITS, TAGS, Tagged, Vec2, eight, eight_mut};
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

    /// A number that addresses are made from: the compiler would load eight of them together and take them apart again
    /// in the registers and units that the arithmetic waits for.
    #[inline(always)]
    fn one_by_one<T: Copy>(x: &T) -> T {
        // SAFETY: a reference can be read.
        unsafe { std::ptr::read_volatile(x) }
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
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every operation, on numbers that vary in size and sign and hit all cases.
    struct All<'a> {
        points: &'a [Frac],
        /// 16 and more.
        numbers: &'a [f64],
        at: [[u32; LANES]; 2],
    }

    impl Kernel for All<'_> {
        type Output = Vec<u64>;

        #[inline(always)]
        fn run(self, l: impl Lanes) -> Vec<u64> {
            let [a, b] = self.at.map(|at| l.numbers(self.numbers, &at));
            let [[ax, ay], [bx, by]] = self.at.map(|at| l.points(self.points, &at));
            let tags = self.at.map(|at| at.map(|point| tagged(point, point % TAGS as u32)));
            let [[cx, cy], [ex, ey]] = tags.map(|at| l.tagged_points(self.points, &at));
            let table = std::array::from_fn(|k| self.numbers[k]);
            let (dx, dy) = (l.difference(ax, bx), l.difference(by, ay));
            let (less, up_to) = (l.less(a, b), l.up_to(a, b));
            let [first_x, first_y] = l.few_points(&self.points[self.at[0][0] as usize..]);
            let [few_x, few_y] = l.few_points(&self.points[..self.at[0][0] as usize % LANES]);
            let (mut stored, mut interleaved) = ([0.0; LANES + 1], [[0.0; 2]; LANES + 1]);
            l.store(a, &mut stored[1..]);
            l.store_vectors(a, b, &mut interleaved[1..]);
            let [taken_a, taken_b] = l.components(&interleaved[1..]);
            let bits = [l.bits(less), l.bits(up_to), l.bits(l.both(less, l.first(5)))].map(f64::from);
            let named: [[u16; 2]; LANES] = std::array::from_fn(|k| self.at.map(|at| at[k] as u16));
            let (first, second) = (l.named::<false>(self.numbers, &named), l.named::<true>(self.numbers, &named));
            let vectors: Vec<Vec2> = self.numbers.iter().map(|&x| [x, -1.5 * x]).collect();
            let (first_pair, second_pair) =
                (l.named_vectors::<false>(&vectors, &named), l.named_vectors::<true>(&vectors, &named));
            let pairs = [
                (first, second),
                first_pair.into(),
                second_pair.into(),
                (l.load(&stored[1..]), l.splat(l.sum(a))),
                (l.abs(a), l.with_sign(a, b)),
                (l.clamp_to_unit(a), l.clamp_to_unit(b)),
                (l.keep(less, a), l.keep(up_to, b)),
                (l.keep(l.first(3), a), l.keep(l.both(less, l.first(9)), b)),
                (l.real(first_x), l.real(first_y)),
                (l.real(few_x), l.real(few_y)),
                (l.real(l.keep_raw(less, ax)), l.real(l.sub_raw(l.splat_raw(77), by))),
                (l.real(l.shifted_raw(ax, by)), l.shifted(3.25, a)),
                (taken_a, taken_b),
                (l.load(&self.numbers[self.at[1][0] as usize..]), l.splat(bits.iter().sum())),
                (l.add(a, b), l.sub(a, b)),
                (l.mul(a, b), l.div(a, b)),
                (l.sqrt(a), l.splat(1.5)),
                (l.difference(cx, ex), l.difference(cy, ey)),
                (l.by_tags(&table, &tags[0], &tags[1]), l.by_tags(&table, &tags[1], &tags[0])),
                (dx, dy),
                (l.where_between(a, b, dx), l.where_between(a, l.splat(f64::INFINITY), dy)),
            ];
            let mut bits: Vec<u64> =
                pairs.into_iter().flat_map(|(x, y)| l.vectors(x, y)).flatten().map(f64::to_bits).collect();
            bits.extend([l.less(a, b), l.less(b, a), l.less(a, a)].map(|mask| u64::from(l.bits(mask))));
            bits
        }
    }

    #[test]
    fn wide_registers_round_as_plain_code() {
        let word = |k: u64| (k + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15) as i64;
        let points: Vec<Frac> = (0..100).map(|k| Frac::from_bits([word(k) >> (k % 50), word(k + 1000)])).collect();
        let number = |k: u64| if k.is_multiple_of(9) { 0.0 } else { word(k + 7) as f64 * 2.0f64.powi(k as i32 - 100) };
        let numbers: Vec<f64> = (0..100).map(number).collect();
        for shift in 0..50 {
            // the first points and numbers have seven after them
            let at = [0, 13].map(|more| std::array::from_fn(|k| (shift + more * k as u32 + more) % 100));
            let all = || All { points: &points, numbers: &numbers, at };
            let canonical = |bits: Vec<u64>| -> Vec<u64> {
                // which NaN it is says nothing
                bits.into_iter().map(|b| if f64::from_bits(b).is_nan() { u64::MAX } else { b }).collect()
            };
            assert_eq!(canonical(run(all())), canonical(all().run(Arrays)));
        }
    }

    struct Rows<'a>(&'a [f64], [[u16; 2]; LANES]);

    impl Kernel for Rows<'_> {
        type Output = ();

        #[inline(always)]
        fn run(self, l: impl Lanes) {
            l.named::<true>(self.0, &self.1);
        }
    }

    #[test]
    #[should_panic]
    fn numbers_that_are_not_there_are_not_read() {
        run(Rows(&[0.0; 8], [[0, 7], [0, 8], [0, 0], [0, 0], [0, 0], [0, 0], [0, 0], [0, 0]]));
    }

    #[test]
    #[should_panic]
    fn points_that_are_not_there_are_not_read() {
        run(All { points: &[Frac::default(); 9], numbers: &[0.0; 16], at: [[0, 1, 2, 3, 4, 5, 6, 9], [0; LANES]] });
    }

    struct Last<'a>(&'a [Frac], Tagged);

    impl Kernel for Last<'_> {
        type Output = [Vec2; LANES];

        #[inline(always)]
        fn run(self, l: impl Lanes) -> [Vec2; LANES] {
            let [x, y] = l.tagged_points(self.0, &[self.1; LANES]);
            l.vectors(l.difference(x, x), l.difference(y, y))
        }
    }

    #[test]
    fn the_last_point_is_read_with_any_tag() {
        let last = |tag| run(Last(&[Frac::default(); 9], tagged(8, tag)));
        assert!((0..TAGS as u32).all(|tag| last(tag) == [[0.0; 2]; LANES]));
    }

    #[test]
    #[should_panic]
    fn tagged_points_that_are_not_there_are_not_read() {
        run(Last(&[Frac::default(); 9], tagged(9, 0)));
    }
}
