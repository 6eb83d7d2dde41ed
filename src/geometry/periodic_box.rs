use super::frac::PERIOD;
use super::{Frac, Vec2};
use nalgebra::Matrix2;

/// The periodic cell a₁ = (lx, 0), a₂ = (xy, ly).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PeriodicBox {
    lx: f64,
    ly: f64,
    xy: f64,
    /// lx, xy, ly over 2⁶⁴: raw fixed-point differences times these are lengths.
    unit: [f64; 3],
    /// 1/lx, 1/ly times 2⁶⁴, and xy/ly.
    inverse: [f64; 3],
}

/// The part of the periodic box whose points are binned: fractions `center ± span/2` along each box vector; a span of
/// 1 or more is the whole axis, with its periodic images.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Region {
    pub center: Frac,
    pub span: [f64; 2],
}

impl Region {
    pub fn whole() -> Self {
        Region { center: Frac::from_fractions([0.5, 0.5]), span: [1.0; 2] }
    }

    /// Column and row of a point in a table of `shape` laid over the region. Points outside count to the outermost
    /// ones.
    #[inline]
    pub fn bin(&self, point: Frac, shape: [usize; 2]) -> [usize; 2] {
        let offset = point.minus(self.center);
        std::array::from_fn(|axis| {
            let n = shape[axis] as f64;
            let per_unit = n / (self.span[axis].min(1.0) * PERIOD);
            (offset[axis] as f64 * per_unit + 0.5 * n).clamp(0.0, n - 1.0) as usize
        })
    }
}

impl PeriodicBox {
    /// A cell with edge vectors (lx, 0) and (xy, ly); lx, ly > 0.
    pub fn new(lx: f64, ly: f64, xy: f64) -> Self {
        PeriodicBox {
            lx,
            ly,
            xy,
            unit: [lx / PERIOD, xy / PERIOD, ly / PERIOD],
            inverse: [PERIOD / lx, PERIOD / ly, xy / ly],
        }
    }

    pub fn square(edge: f64) -> Self {
        Self::new(edge, edge, 0.0)
    }

    pub fn lx(&self) -> f64 {
        self.lx
    }

    pub fn ly(&self) -> f64 {
        self.ly
    }

    /// x component of the second box vector.
    pub fn xy(&self) -> f64 {
        self.xy
    }

    pub fn area(&self) -> f64 {
        self.lx * self.ly
    }

    /// Box matrix, box vectors as columns.
    pub fn matrix(&self) -> Matrix2<f64> {
        Matrix2::new(self.lx, self.xy, 0.0, self.ly)
    }

    /// lx, xy, ly over 2⁶⁴: differences of raw fixed-point coordinates times these are lengths, as in `displacement`.
    pub fn unit(&self) -> [f64; 3] {
        self.unit
    }

    /// Distances between opposite faces along the two fractional axes. Two points less than half the smaller width
    /// apart have their nearest image found by wrapping the fractions.
    pub fn widths(&self) -> [f64; 2] {
        [self.area() / self.xy.hypot(self.ly), self.ly]
    }

    /// The same shape at another area.
    pub fn with_area(&self, area: f64) -> Self {
        let s = (area / self.area()).sqrt();
        Self::new(s * self.lx, s * self.ly, s * self.xy)
    }

    /// Sheared: x displaced by `strain` × y.
    pub fn sheared(&self, strain: f64) -> Self {
        Self::new(self.lx, self.ly, self.xy + strain * self.ly)
    }

    /// The cell of the same lattice that is tilted by at most half its first edge, and how many times that edge was
    /// taken from the second; [`Frac::flipped`] takes points along.
    pub fn least_tilted(&self) -> (Self, i64) {
        let n = (self.xy / self.lx).round();
        (Self::new(self.lx, self.ly, self.xy - n * self.lx), n as i64)
    }

    /// Nearest-image vector a − b.
    #[inline(always)]
    pub fn displacement(&self, a: Frac, b: Frac) -> Vec2 {
        self.vector(a.minus(b))
    }

    /// The vector from `b` to the periodic image of `a` that lies at `near`, which may be rounded, and by how many periods along
    /// either axis it is not the nearest image of all.
    pub fn image_near(&self, a: Frac, b: Frac, near: Vec2) -> (Vec2, [i64; 2]) {
        let nearest = self.displacement(a, b);
        let rows = ((near[1] - nearest[1]) / self.ly).round();
        let columns = ((near[0] - nearest[0] - rows * self.xy) / self.lx).round();
        let image = [nearest[0] + columns * self.lx + rows * self.xy, nearest[1] + rows * self.ly];
        (image, [columns as i64, rows as i64])
    }

    /// By which vectors of the lattice images of a point that are not the nearest differ from that, if they may come nearer
    /// than `reach`, which is at most the smaller width: none in a box twice as wide.
    pub fn images_within(&self, reach: f64) -> Vec<Vec2> {
        let [a, b] = self.widths();
        if 2.0 * reach <= a.min(b) {
            return Vec::new();
        }
        let around = [-1.0, 0.0, 1.0]
            .map(|rows| [-1.0, 0.0, 1.0].map(|columns| [columns * self.lx + rows * self.xy, rows * self.ly]));
        around.as_flattened().iter().copied().filter(|&by| by != [0.0; 2]).collect()
    }

    /// A raw fixed-point difference as a Cartesian vector.
    #[inline(always)]
    pub fn vector(&self, raw: [i64; 2]) -> Vec2 {
        let (x, y) = (raw[0] as f64, raw[1] as f64);
        [x * self.unit[0] + y * self.unit[1], y * self.unit[2]]
    }

    /// The point `a` moved by a Cartesian vector, rounded to the resolution of `Frac`.
    #[inline(always)]
    pub fn moved(&self, a: Frac, by: Vec2) -> Frac {
        a.plus(self.raw(by))
    }

    /// A Cartesian vector shorter than half the box in raw fixed-point units, cut off.
    #[inline(always)]
    fn raw(&self, v: Vec2) -> [i64; 2] {
        let x = (v[0] - v[1] * self.inverse[2]) * self.inverse[0];
        let y = v[1] * self.inverse[1];
        [cut_off(x), cut_off(y)]
    }

    /// Cartesian position in the cell, both fractions in [0, 1).
    pub fn position(&self, a: Frac) -> Vec2 {
        let f = a.fractions();
        [f[0] * self.lx + f[1] * self.xy, f[1] * self.ly]
    }

    /// The point at a Cartesian position in any periodic image. Divisions carry their remainder, so that the result is
    /// the given number to the resolution of `Frac` and forces are those at the given coordinates.
    pub fn frac(&self, position: Vec2) -> Frac {
        let (y, y_rest) = divide(position[1], self.ly);
        let shift = y * self.xy;
        let shift_rest = y.mul_add(self.xy, -shift) + y_rest * self.xy;
        let x_rounded = position[0] - shift;
        let x_error = two_sum_tail(position[0], -shift, x_rounded) - shift_rest;
        let (x, x_rest) = divide(x_rounded, self.lx);
        let rest = [(x_rest + x_error / self.lx) * PERIOD, y_rest * PERIOD];
        Frac::from_fractions([x, y]).plus(rest.map(|r| r.round_ties_even() as i64))
    }

    /// Smallest factor by which the change from `before` to this box shortens any distance that moves affinely with it.
    pub fn shortest_stretch(&self, before: &PeriodicBox) -> f64 {
        let deformation = self.matrix() * inverse(before);
        deformation.singular_values().min()
    }
}

fn inverse(b: &PeriodicBox) -> Matrix2<f64> {
    Matrix2::new(1.0 / b.lx, -b.xy / (b.lx * b.ly), 0.0, 1.0 / b.ly)
}

/// `x as i64` for |x| < 2⁶³, in operations that every processor has for several numbers at a time: a large and a small
/// part are rounded to whole numbers by adding 1.5·2⁵², which leaves these in the low bits.
#[inline(always)]
fn cut_off(x: f64) -> i64 {
    const ROUNDER: f64 = 6_755_399_441_055_744.0;
    const HALF: f64 = 4_294_967_296.0; // 2³²
    let whole = |x: f64| (x.to_bits() as i64).wrapping_sub(ROUNDER.to_bits() as i64);
    let size = x.abs();
    let large = size * (1.0 / HALF) + ROUNDER;
    let rest = size - (large - ROUNDER) * HALF; // exact
    let small = rest + ROUNDER;
    let too_much = i64::from(small - ROUNDER > rest);
    let magnitude = (whole(large) << 32).wrapping_add(whole(small)).wrapping_sub(too_much);
    let sign = x.to_bits() as i64 >> 63;
    (magnitude ^ sign).wrapping_sub(sign)
}

/// a/b as a rounded quotient and what the rounding left.
fn divide(a: f64, b: f64) -> (f64, f64) {
    let q = a / b;
    (q, (-q).mul_add(b, a) / b)
}

/// The rounding error of s = a + b.
fn two_sum_tail(a: f64, b: f64, s: f64) -> f64 {
    let bb = s - a;
    (a - (s - bb)) + (b - bb)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn reals_are_cut_off_as_scalar_code_does_it(mantissa in -1.0..1.0f64, exponent in -3i32..=63) {
            for x in [mantissa * 2.0f64.powi(exponent), (mantissa * 9.0).round() * 2.0f64.powi(exponent - 4)] {
                prop_assert_eq!(cut_off(x), x as i64);
            }
        }

        #[test]
        fn displacement_undoes_a_move(f: [i64; 2], dx in -2.0..2.0f64, dy in -2.0..2.0f64, xy in -4.0..4.0f64) {
            let b = PeriodicBox::new(9.0, 8.0, xy);
            let a = Frac::from_bits(f);
            let d = b.displacement(b.moved(a, [dx, dy]), a);
            prop_assert!((d[0] - dx).abs() < 1e-14 && (d[1] - dy).abs() < 1e-14);
        }

        #[test]
        fn cartesian_positions_survive(x in -30.0..30.0f64, y in -30.0..30.0f64, xy in -4.0..4.0f64) {
            let b = PeriodicBox::new(9.0, 8.0, xy);
            let p = b.position(b.frac([x, y]));
            // equal up to whole box vectors
            let v = (y - p[1]) / 8.0;
            let u = (x - p[0] - v.round() * xy) / 9.0;
            prop_assert!((u - u.round()).abs() < 1e-13 && (v - v.round()).abs() < 1e-13);
        }
    }

    #[test]
    fn differences_of_given_coordinates_keep_their_last_digits() {
        // two points whose distance is known to 1e-19 although their coordinates are of order 3
        for xy in [0.0, 1.3184448772660222] {
            let b = PeriodicBox::new(2.8052018665234515, 2.8052018665234515, xy);
            let (p, q) = ([2.472579703712418, 2.179939813766941], [2.3968197584549253, 2.071053059664813]);
            let d = b.displacement(b.frac(p), b.frac(q));
            assert!((d[0] - (p[0] - q[0])).abs() < 2e-17, "{}", d[0] - (p[0] - q[0]));
            assert!((d[1] - (p[1] - q[1])).abs() < 2e-17);
        }
    }

    #[test]
    fn flips_leave_every_point_where_it_is() {
        let far = PeriodicBox::new(4.0, 3.0, 0.5).sheared(3.25);
        let (near, n) = far.least_tilted();
        assert_eq!((near.xy(), n), (10.25 - 12.0, 3));
        for f in [[0.1, 0.2], [0.9, 0.95], [0.5, 0.5], [0.999, 0.001]] {
            let (a, b) = (Frac::from_fractions(f), Frac::from_fractions([0.3, 0.4]));
            // the same up to periods of the lattice
            let [p, q] = [far.position(a), near.position(a.flipped(n))];
            let v = ((p[1] - q[1]) / 3.0).round();
            let u = (p[0] - q[0] - v * near.xy()) / 4.0;
            assert!((u - u.round()).abs() < 1e-14 && (p[1] - q[1] - 3.0 * v).abs() < 1e-14, "{f:?}");
            assert_eq!(a.flipped(n).flipped(-n), a);
            let short = near.moved(b.flipped(n), [0.2, -0.1]);
            let d = near.displacement(short, b.flipped(n));
            assert!((d[0] - 0.2).abs() < 1e-15 && (d[1] + 0.1).abs() < 1e-15);
        }
    }

    #[test]
    fn shear_keeps_area_and_narrows_the_box() {
        let b = PeriodicBox::new(2.0, 1.0, 1.0);
        assert_eq!(b.area(), 2.0);
        assert!((b.widths()[0] - 2.0f64.sqrt()).abs() < 1e-15);
        let s = b.shortest_stretch(&PeriodicBox::new(2.0, 1.0, 0.0));
        assert!((s - 0.618033988749895).abs() < 1e-12); // simple shear by 1: the golden ratio
        assert!((b.with_area(0.5).shortest_stretch(&b) - 0.5).abs() < 1e-15);
    }
}
