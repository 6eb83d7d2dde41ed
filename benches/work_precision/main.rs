//! Speed against error: what minimisers and tolerances cost, and what errors they leave; `scripts/work-precision` starts
//! this program with the folder of its results. Scenes are those of `jamhpc run`, as differences from its defaults.

mod tolerances;

use rustix::time::{ClockId, clock_gettime};
use std::path::Path;

fn main() {
    match std::env::args().skip(1).find(|word| !word.starts_with('-')) {
        Some(out) => tolerances::run(Path::new(&out)),
        None => println!("scripts/work-precision starts this program"),
    }
}

/// CPU time of this process.
fn cpu_seconds() -> f64 {
    let now = clock_gettime(ClockId::ProcessCPUTime);
    now.tv_sec as f64 + 1e-9 * now.tv_nsec as f64
}

fn write(path: &Path, text: &str) {
    let folder = path.parent().expect("a file in a folder");
    std::fs::create_dir_all(folder)
        .and_then(|()| std::fs::write(path, text))
        .unwrap_or_else(|error| panic!("{}: {error}", path.display()));
}
