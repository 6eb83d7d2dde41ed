//! The operations on plain arrays, for every processor.

use super::{Frac, LANES, Lanes, TAGS, Tagged, Vec2, eight, eight_mut, point_of, tag_of};

#[derive(Clone, Copy)]
pub struct Arrays;

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
