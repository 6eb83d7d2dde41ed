//! Known statistics of soft-disk packings at their onset.

use crate::harness::Outcome;
use jamhpc::comm::Comm;
use jamhpc::validate::onset_checks;

/// Five times as many as the reference has: the mean is then known better than the reference is, and a change of code,
/// which draws other packings, moves it by less than half of the tolerance.
const SEEDS: u64 = 100;
/// That of the reference.
const STEP: f64 = 1e-4;

/// Each rank packs its share of the seeds by itself.
pub fn soft_disks(comm: Comm) -> Outcome {
    for check in onset_checks(&comm, SEEDS, STEP) {
        println!("{check:?}");
        assert!(check.passes(), "{check:?}");
    }
    Vec::new()
}
