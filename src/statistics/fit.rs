use nalgebra::{DMatrix, DVector};

/// Points with their standard errors.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Curve {
    pub x: Vec<f64>,
    pub y: Vec<f64>,
    /// All positive; how much each point counts is one over its square.
    pub error: Vec<f64>,
}

impl Curve {
    /// The points with x within a window, both ends included, that have a value and an error.
    pub fn within(&self, [low, high]: [f64; 2]) -> Curve {
        let mut inside = Curve::default();
        for ((&x, &y), &error) in self.x.iter().zip(&self.y).zip(&self.error) {
            if low <= x && x <= high && y.is_finite() && error.is_finite() && error > 0.0 {
                inside.x.push(x);
                inside.y.push(y);
                inside.error.push(error);
            }
        }
        inside
    }

    /// The same points, x ascending, each counting as much as the stretch of x that it stands for: what points evenly
    /// spaced in x and counting alike would be.
    pub fn evenly(&self) -> Curve {
        let n = self.x.len();
        let stretch = |k: usize| 0.5 * (self.x[(k + 1).min(n - 1)] - self.x[k.saturating_sub(1)]);
        Curve { error: (0..n).map(|k| 1.0 / stretch(k).sqrt()).collect(), ..self.clone() }
    }
}

/// Amplitudes a_k of y = Σ a_k x^(e_k) by weighted linear least squares, and χ²; none with fewer points than exponents.
pub fn amplitudes(curve: &Curve, exponents: &[f64]) -> Option<(Vec<f64>, f64)> {
    let n = curve.x.len();
    if n < exponents.len() {
        return None;
    }
    let design = DMatrix::from_fn(n, exponents.len(), |i, k| curve.x[i].powf(exponents[k]) / curve.error[i]);
    let values = DVector::from_fn(n, |i, _| curve.y[i] / curve.error[i]);
    // columns of one length, so that what counts as rank does not depend on units
    let lengths: Vec<f64> = design.column_iter().map(|column| column.norm()).collect();
    let mut scaled = design.clone();
    scaled.column_iter_mut().zip(&lengths).for_each(|(mut column, length)| column /= *length);
    let solution = scaled.svd(true, true).solve(&values, 1e-12).ok()?;
    let found: Vec<f64> = solution.iter().zip(&lengths).map(|(a, length)| a / length).collect();
    let misfit = (design * DVector::from_column_slice(&found) - values).norm_squared();
    found.iter().all(|a| a.is_finite()).then_some((found, misfit))
}

/// Amplitude and exponent of y = a x^e by a weighted line through the logarithms of the points where y > 0.
pub fn power_law(curve: &Curve) -> Option<[f64; 2]> {
    let mut logs = [const { Vec::new() }; 3];
    for ((&x, &y), &error) in curve.x.iter().zip(&curve.y).zip(&curve.error) {
        if x > 0.0 && y > 0.0 {
            logs[0].push(x.ln());
            logs[1].push(y.ln());
            logs[2].push(y / error);
        }
    }
    let [x, y, weight] = logs;
    let design = DMatrix::from_fn(x.len(), 2, |i, k| weight[i] * if k == 0 { 1.0 } else { x[i] });
    let values = DVector::from_fn(x.len(), |i, _| weight[i] * y[i]);
    if x.len() < 2 {
        return None;
    }
    let line = design.svd(true, true).solve(&values, 1e-12).ok()?;
    Some([line[0].exp(), line[1]])
}

/// The exponent e within `range` with which y = a x^e + Σ a_k x^(e_k) fits best, the others given; all amplitudes, that
/// of e first. Amplitudes are eliminated (variable projection), so that one unknown is left.
pub fn free_exponent(curve: &Curve, others: &[f64], range: [f64; 2]) -> Option<(f64, Vec<f64>, f64)> {
    if curve.x.len() < others.len() + 2 {
        return None;
    }
    let with = |e: f64| [&[e], others].concat();
    let misfit = |e: f64| amplitudes(curve, &with(e)).map_or(f64::INFINITY, |(_, misfit)| misfit);
    let best = lowest(misfit, range);
    let (found, misfit) = amplitudes(curve, &with(best))?;
    Some((best, found, misfit))
}

/// Exponents e₀ < e₁ within their ranges with which y = a₀ x^e₀ + a₁ x^e₁ fits best, and the amplitudes.
pub fn free_exponents(curve: &Curve, ranges: [[f64; 2]; 2]) -> Option<([f64; 2], [f64; 2])> {
    if curve.x.len() < 5 {
        return None;
    }
    let misfit = |e: f64| free_exponent(curve, &[e], ranges[0]).map_or(f64::INFINITY, |(_, _, misfit)| misfit);
    let second = lowest(misfit, ranges[1]);
    let (first, found, _) = free_exponent(curve, &[second], ranges[0])?;
    Some(([first, second], [found[0], found[1]]))
}

/// Where a function of one number is lowest: the best of a coarse scan, then golden sections.
fn lowest(f: impl Fn(f64) -> f64, [low, high]: [f64; 2]) -> f64 {
    const SCAN: usize = 16;
    let at = |k: usize| low + (high - low) * k as f64 / SCAN as f64;
    let best = (0..=SCAN).min_by(|&a, &b| f(at(a)).total_cmp(&f(at(b)))).unwrap_or(0);
    let (mut a, mut b) = (at(best.saturating_sub(1)), at((best + 1).min(SCAN)));
    let ratio = 0.5 * (5f64.sqrt() - 1.0);
    let mut inner = [b - ratio * (b - a), a + ratio * (b - a)];
    let mut values = inner.map(&f);
    while b - a > 1e-5 * (high - low) {
        if values[0] < values[1] {
            b = inner[1];
            inner = [b - ratio * (b - a), inner[0]];
            values = [f(inner[0]), values[0]];
        } else {
            a = inner[0];
            inner = [inner[1], a + ratio * (b - a)];
            values = [values[1], f(inner[1])];
        }
    }
    0.5 * (a + b)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve(y: impl Fn(f64) -> f64) -> Curve {
        let x: Vec<f64> = (0..20).map(|k| 1e-4 * 10f64.powf(0.15 * k as f64)).collect();
        let y: Vec<f64> = x.iter().map(|&x| y(x)).collect();
        Curve { error: y.iter().map(|y| 0.01 * y).collect(), x, y }
    }

    fn close(a: f64, b: f64, tolerance: f64) {
        assert!((a - b).abs() < tolerance * b.abs(), "{a} instead of {b}");
    }

    #[test]
    fn exact_laws_are_found_again() {
        let two = curve(|x| 2.6 * x.sqrt() + 4.0 * x);
        let (a, misfit) = amplitudes(&two, &[0.5, 1.0]).unwrap();
        close(a[0], 2.6, 1e-10);
        close(a[1], 4.0, 1e-8);
        assert!(misfit < 1e-20);
        let (e, a, _) = free_exponent(&two, &[1.0], [0.1, 0.95]).unwrap();
        close(e, 0.5, 1e-3);
        close(a[0], 2.6, 1e-2);
        let (e, _) = free_exponents(&two, [[0.1, 0.8], [0.85, 2.0]]).unwrap();
        close(e[0], 0.5, 1e-2);
        close(e[1], 1.0, 5e-2);
        let [a, e] = power_law(&curve(|x| 3.0 * x.powf(0.66))).unwrap();
        close(a, 3.0, 1e-10);
        close(e, 0.66, 1e-10);
        // what finite-size extrapolation does: a limit and a correction
        let limit = curve(|x| 0.842 - 0.1 * x.powf(0.6));
        let (e, a, _) = free_exponent(&limit, &[0.0], [0.2, 2.0]).unwrap();
        close(e, 0.6, 1e-2);
        close(a[1], 0.842, 1e-4);
    }

    #[test]
    fn weights_count() {
        let mut points = curve(|x| 2.0 * x);
        points.y[3] *= 5.0;
        points.error[3] = 1e9;
        close(amplitudes(&points, &[1.0]).unwrap().0[0], 2.0, 1e-9);
    }

    #[test]
    fn points_spaced_anyhow_count_as_if_evenly() {
        // a straight line through a curve: by its integral over x, whatever the spacing
        let y = |x: f64| x * x;
        let slope = |x: Vec<f64>| {
            let curve = Curve { y: x.iter().map(|&x| y(x)).collect(), error: vec![1.0; x.len()], x };
            amplitudes(&curve.evenly(), &[1.0]).unwrap().0[0]
        };
        let even = slope((1..=4000).map(|k| k as f64 / 4000.0).collect());
        let log = slope((0..=800).map(|k| 10f64.powf(-4.0 + k as f64 / 200.0)).collect());
        close(even, 0.75, 1e-3);
        close(log, 0.75, 1e-2);
    }

    #[test]
    fn too_few_points_are_no_fit() {
        let few = curve(|x| x).within([1e-4, 1.2e-4]);
        assert_eq!(few.x.len(), 1);
        assert_eq!(amplitudes(&few, &[0.5, 1.0]), None);
        assert_eq!(power_law(&few), None);
        assert_eq!(free_exponent(&few, &[], [0.1, 1.0]), None);
        assert_eq!(free_exponents(&few, [[0.1, 0.8], [0.9, 2.0]]), None);
    }
}
