use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// A number with its error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    pub value: f64,
    /// Standard error: the standard deviation over resamples.
    pub error: f64,
    /// 95 % confidence interval: percentiles over resamples.
    pub interval: [f64; 2],
}

impl Default for Estimate {
    fn default() -> Self {
        Estimate { value: f64::NAN, error: f64::NAN, interval: [f64::NAN; 2] }
    }
}

impl Estimate {
    /// How many standard errors `other` is away.
    pub fn sigmas(&self, other: f64) -> f64 {
        (self.value - other) / self.error
    }

    /// With all of it multiplied by a positive factor.
    pub fn times(self, factor: f64) -> Self {
        Estimate { value: self.value * factor, error: self.error * factor, interval: self.interval.map(|x| x * factor) }
    }

    fn of(value: f64, mut resampled: Vec<f64>) -> Self {
        resampled.retain(|x| x.is_finite());
        if resampled.len() < 2 {
            return Estimate { value, ..Estimate::default() };
        }
        resampled.sort_by(f64::total_cmp);
        let last = resampled.len() - 1;
        let percentile = |p: f64| resampled[(p * last as f64).round() as usize];
        Estimate { value, error: spread(resampled.iter().copied()), interval: [percentile(0.025), percentile(0.975)] }
    }
}

/// Statistics of several independent samples, with errors by resampling each of them with replacement (Efron 1979).
///
/// `sizes` are the numbers of items in each sample; `statistic` is given indices into each and answers the same number
/// of values every time, NaN where it has none. The same bits every time: the random numbers have a fixed key.
pub fn bootstrap(sizes: &[usize], resamples: usize, statistic: impl Fn(&[Vec<usize>]) -> Vec<f64>) -> Vec<Estimate> {
    let all: Vec<Vec<usize>> = sizes.iter().map(|&n| (0..n).collect()).collect();
    let values = statistic(&all);
    let mut random = ChaCha8Rng::seed_from_u64(1);
    // the high bits of a product: an integer below n, with a bias of n/2⁶⁴
    let mut below = |n: usize| ((random.next_u64() as u128 * n as u128) >> 64) as usize;
    let mut columns = vec![Vec::with_capacity(resamples); values.len()];
    for _ in 0..resamples {
        let drawn: Vec<Vec<usize>> = sizes.iter().map(|&n| (0..n).map(|_| below(n)).collect()).collect();
        columns.iter_mut().zip(statistic(&drawn)).for_each(|(column, value)| column.push(value));
    }
    values.into_iter().zip(columns).map(|(value, column)| Estimate::of(value, column)).collect()
}

/// Mean of the numbers that are there; NaN if none is.
pub fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, n) = values.filter(|x| !x.is_nan()).fold((0.0, 0.0), |(sum, n), x| (sum + x, n + 1.0));
    sum / n
}

/// Standard deviation of the numbers that are there, with n − 1; NaN for fewer than two.
pub fn spread(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let center = mean(values.clone());
    let (sum, n) = values.filter(|x| !x.is_nan()).fold((0.0, 0.0), |(sum, n), x| (sum + (x - center).powi(2), n + 1.0));
    if n < 2.0 { f64::NAN } else { (sum / (n - 1.0)).sqrt() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_error_of_a_mean_is_its_textbook_value() {
        let mut random = ChaCha8Rng::seed_from_u64(7);
        let numbers: Vec<f64> = (0..400).map(|_| random.next_u64() as f64 / 2f64.powi(64)).collect();
        let found = bootstrap(&[400], 2000, |drawn| vec![mean(drawn[0].iter().map(|&k| numbers[k]))])[0];
        let exact = spread(numbers.iter().copied()) / 20.0;
        assert!((found.error / exact - 1.0).abs() < 0.05, "{found:?}, {exact}");
        let width = found.interval[1] - found.interval[0];
        assert!((width / (2.0 * 1.96 * exact) - 1.0).abs() < 0.08, "{found:?}, {exact}");
        assert!((found.sigmas(0.5)).abs() < 3.0);
    }

    #[test]
    fn missing_numbers_are_passed_over() {
        let numbers = [1.0, f64::NAN, 3.0];
        assert_eq!(mean(numbers.iter().copied()), 2.0);
        assert!((spread(numbers.iter().copied()) - 2f64.sqrt()).abs() < 1e-15);
        assert!(mean([f64::NAN].into_iter()).is_nan() && spread([1.0].into_iter()).is_nan());
        let nothing = bootstrap(&[0], 10, |_| vec![f64::NAN])[0];
        assert!(nothing.value.is_nan() && nothing.error.is_nan());
    }
}
