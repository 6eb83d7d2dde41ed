//! How much memory the ranks of a run have taken.

use crate::comm::Comm;
use crate::profile::peak_memory;

/// The line for the end of a run: the largest and the smallest peak of resident memory of a rank, all included, and the
/// sum of all over the number of points; nothing where the system does not tell. Collective.
pub fn peak(comm: &Comm, n_points: u64) -> Option<String> {
    let here = Some(peak_memory()).filter(|bytes| bytes.is_finite()).unwrap_or(0.0);
    let [most, least] = comm.max_each([here, -here]).map(f64::abs);
    let per_point = comm.sum_count(here as u64) as f64 / n_points.max(1) as f64;
    let mb = |bytes: f64| bytes / 1e6;
    (least > 0.0).then(|| match comm.size() {
        1 => format!("peak memory: {:.1} MB, {per_point:.0} B per point", mb(most)),
        n => format!(
            "peak memory: {:.1} to {:.1} MB on each of {n} ranks, {per_point:.0} B per point",
            mb(least),
            mb(most)
        ),
    })
}
