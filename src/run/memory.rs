//! How much memory the ranks of a run have taken.

use crate::comm::Comm;

/// The line for the end of a run: the largest and the smallest peak of resident memory of a rank, all included, and the
/// sum of all over the number of points; nothing where the system does not tell. Collective.
pub fn peak(comm: &Comm, n_points: u64) -> Option<String> {
    let here = resident().unwrap_or(0);
    let [most, least] = comm.max_each([here as f64, -(here as f64)]).map(f64::abs);
    let per_point = comm.sum_count(here) as f64 / n_points.max(1) as f64;
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

/// Peak resident memory of this process in bytes.
fn resident() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM"))?;
    Some(line.split_whitespace().nth(1)?.parse::<u64>().ok()? * 1024)
}
