//! Arithmetic on eight numbers at a time, in the widest registers that the processor has.
//!
//! Every operation is one IEEE operation per lane, rounded as scalar code rounds it (no fused multiply-add, no
//! estimates), so that results are the same bits on every processor.
//!
//! Kernels call these operations outside of closures: a closure handed to other code, as to `map` of an array, need not
//! be inlined, and is then compiled for the oldest processor.
//!
//! Here is the only `unsafe` code outside of foreign interfaces: the instructions of AVX2 and AVX-512 and the calls of
//! functions compiled for more than the oldest processor.

mod arrays;
#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;

use crate::geometry::{Frac, Vec2};
use arrays::Arrays;

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
        if let Some(lanes) = avx2::Avx2::detected() {
            // SAFETY: likewise.
            return unsafe { for_avx2(kernel, lanes) };
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
fn for_avx2<K: Kernel>(kernel: K, lanes: avx2::Avx2) -> K::Output {
    kernel.run(lanes)
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

/// A number that addresses are made from: the compiler would load eight of them together and take them apart again
/// in the registers and units that the arithmetic waits for.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn one_by_one<T: Copy>(x: &T) -> T {
    // SAFETY: a reference can be read.
    unsafe { std::ptr::read_volatile(x) }
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
                (l.real(ax), l.real(by)),
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
            bits.extend([l.less(a, b), l.less(b, a), l.less(a, a), l.up_to(a, a)].map(|mask| u64::from(l.bits(mask))));
            bits
        }
    }

    /// What each kind of registers that this processor has makes of it.
    fn of_all_kinds<K: Kernel>(kernel: impl Fn() -> K) -> Vec<K::Output> {
        let mut all = vec![kernel().run(Arrays)];
        #[cfg(target_arch = "x86_64")]
        {
            // SAFETY: the instructions are there where they are detected.
            all.extend(avx512::Avx512::detected().map(|lanes| unsafe { for_avx512(kernel(), lanes) }));
            all.extend(avx2::Avx2::detected().map(|lanes| unsafe { for_avx2(kernel(), lanes) }));
        }
        all
    }

    #[test]
    fn wide_registers_round_as_plain_code() {
        let word = |k: u64| (k + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15) as i64;
        let mut points: Vec<Frac> = (0..100).map(|k| Frac::from_bits([word(k) >> (k % 50), word(k + 1000)])).collect();
        // the ends, what is half way between two f64, and next to it
        let half = (1 << 53) + 1;
        let hard =
            [i64::MIN, i64::MAX, half, -half, half + 1, half - 1, half << 9, (half << 9) + 1, (half << 9) - 1, 0];
        for (point, k) in points.iter_mut().zip(0..30) {
            *point = Frac::from_bits([hard[k % 10], hard[9 - k / 3]]);
        }
        let number = |k: u64| if k.is_multiple_of(9) { 0.0 } else { word(k + 7) as f64 * 2.0f64.powi(k as i32 - 100) };
        let numbers: Vec<f64> = (0..100).map(number).collect();
        for shift in 0..50 {
            // the first points and numbers have seven after them
            let at = [1, 13].map(|more| std::array::from_fn(|k| (shift + more * k as u32 + more) % 100));
            // which NaN it is says nothing
            let canonical = |bits: u64| if f64::from_bits(bits).is_nan() { u64::MAX } else { bits };
            let all: Vec<Vec<u64>> = of_all_kinds(|| All { points: &points, numbers: &numbers, at })
                .into_iter()
                .map(|bits| bits.into_iter().map(canonical).collect())
                .collect();
            assert!(all.iter().all(|bits| *bits == all[0]));
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
