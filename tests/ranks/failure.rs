//! What happens when one rank fails.

use crate::harness::Outcome;
use jamhpc::comm::Comm;

/// Rank 1 fails while the others wait for it in a collective operation: without an abort they would wait forever.
pub fn panic_on_one_rank(comm: Comm) -> Outcome {
    comm.barrier();
    assert!(comm.rank() != 1, "this is meant to happen");
    comm.max(1.0);
    unreachable!("rank 1 never comes");
}
