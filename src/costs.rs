//! What a command has cost, over all ranks: the table of `--profile`.

use crate::comm::Comm;
use crate::profile::{self, Count, Phase};

/// Least, mean and largest of one number per rank.
fn spread(numbers: impl Iterator<Item = f64> + Clone) -> [f64; 3] {
    let n = numbers.clone().count() as f64;
    [
        numbers.clone().fold(f64::INFINITY, f64::min),
        numbers.clone().sum::<f64>() / n,
        numbers.fold(f64::NEG_INFINITY, f64::max),
    ]
}

/// The table of phases and counters since `profile::start`. Collective; the same on all ranks.
pub fn table(comm: &Comm) -> String {
    let (seconds, counts) = (profile::seconds(), profile::counts());
    let mine: Vec<u64> = seconds.iter().chain(&counts).map(|x| x.to_bits()).collect();
    let ranks = comm.all_gather(&mine);
    let column = |k: usize| spread(ranks.iter().map(move |rank| f64::from_bits(rank[k])));
    let whole: f64 = (0..seconds.len()).map(|k| column(k)[1]).sum();
    let steps = column(seconds.len())[1];
    let mut text =
        format!("{:<22}{:>11}{:>11}{:>11}{:>7}{:>13}\n", "seconds", "min", "mean", "max", "%", "us per step");
    for (k, phase) in Phase::ALL.iter().enumerate() {
        let [least, mean, most] = column(k);
        let (percent, each) = (100.0 * mean / whole, 1e6 * mean / steps);
        text += &format!("{:<22}{least:>11.3}{mean:>11.3}{most:>11.3}{percent:>7.1}{each:>13.2}\n", phase.name());
    }
    text += &format!("{:<22}{:>11}{:>11}{:>11}\n", "per step and rank", "min", "mean", "max");
    for (k, count) in Count::ALL.iter().enumerate() {
        let name = match count {
            Count::Steps => continue,
            Count::HaloMessages => "halo messages sent",
            Count::HaloBytes => "halo bytes sent",
            Count::OtherMessages => "other messages sent",
            Count::OtherBytes => "other bytes sent",
            Count::Collectives => "collective operations",
            Count::Waits => "messages waited for",
        };
        let [least, mean, most] = column(seconds.len() + k).map(|n| n / steps);
        text += &format!("{name:<22}{least:>11.3}{mean:>11.3}{most:>11.3}\n");
    }
    text + &format!("{:<22}{steps:>11.0}   force evaluations on {} ranks\n", "steps", ranks.len())
}
