//! How the jamming onset of soft disks depends on the first step of its search: mean φ_J with its standard error, and
//! what one packing costs.
//!
//! `cargo bench --bench onset` prints the table for 100 seeds of N = 128, `cargo bench --bench onset -- 400` for 400.

use jamhpc::comm::Comm;
use jamhpc::validate::{AtOnset, mean_and_error};
use std::time::Instant;

const N: u32 = 128;
const STEPS: [f64; 6] = [0.02, 0.01, 0.005, 0.001, 0.0003, 0.0001];

fn main() {
    let asked = std::env::args().skip(1).find(|word| !word.starts_with('-'));
    let seeds = asked.map_or(100, |word| word.parse().expect("a number of seeds"));
    println!("N = {N}, {seeds} seeds\nstep    phi_J    error    seconds a packing");
    for step in STEPS {
        let start = Instant::now();
        let packings = AtOnset::of_seeds(&Comm::alone(), N, 1..=seeds, step);
        let seconds = start.elapsed().as_secs_f64() / seeds as f64;
        let [mean, error] = mean_and_error(packings.iter().map(|p| p.density));
        println!("{step:<6}  {mean:.5}  {error:.5}  {seconds:17.3}");
    }
}
