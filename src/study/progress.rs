//! How far a study is: finished packings and the time that the others will take, from what each kind has taken so far.
//!
//! `times.csv` in the folder of the study says what each packing took. It is a log: nothing of the results depends on it.

use super::plan::Member;
use super::schedule::Job;
use super::store;
use crate::comm::tell;
use crate::failure::Failure;
use crate::output::folder::explain;
use std::collections::BTreeMap;
use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

const TIMES: &str = "times.csv";
/// Between two lines.
const INTERVAL: Duration = Duration::from_secs(10);
const TERMINAL_INTERVAL: Duration = Duration::from_secs(1);

/// Adds to the log what a packing took. For one rank of its group.
pub fn note(folder: &Path, member: &Member, ranks: usize, took: Duration) -> Result<(), Failure> {
    let path = folder.join(TIMES);
    let line = format!("{},{},{ranks},{:.3}\n", member.group.id(), member.seed, took.as_secs_f64());
    let append = || {
        let mut file = std::fs::File::options().append(true).create(true).open(&path)?;
        // at once, so that lines of several processes stay whole
        file.write_all(line.as_bytes())
    };
    append().map_err(|e| Failure::Other(format!("cannot write {}: {}", path.display(), explain(&e))))
}

/// Rank-seconds of all packings of each group together, and how many they are.
pub fn times(folder: &Path) -> BTreeMap<String, [f64; 2]> {
    let text = std::fs::read_to_string(folder.join(TIMES)).unwrap_or_default();
    let mut times: BTreeMap<String, [f64; 2]> = BTreeMap::new();
    for line in text.lines() {
        let fields: Vec<&str> = line.split(',').collect();
        let [group, _, ranks, seconds] = fields[..] else { continue };
        let (Ok(ranks), Ok(seconds)) = (ranks.parse::<f64>(), seconds.parse::<f64>()) else { continue };
        let [sum, n] = times.entry(group.to_owned()).or_default();
        *sum += ranks * seconds;
        *n += 1.0;
    }
    times
}

/// One speaker for the whole study, silent on all ranks but rank 0.
pub struct Progress {
    speaks: bool,
    terminal: bool,
    folder: PathBuf,
    /// Name, cost by the plan, and number of missing packings of each group, in the order in which they are made.
    groups: Vec<(String, f64, usize)>,
    missing: usize,
    all: usize,
    started: Instant,
    last: Option<Instant>,
}

impl Progress {
    pub fn new(speaks: bool, folder: &Path, members: &[Member], jobs: &[Job]) -> Self {
        let mut groups: Vec<(String, f64, usize)> = Vec::new();
        for job in jobs {
            let id = members[job.member].group.id();
            match groups.iter_mut().find(|group| group.0 == id) {
                Some(group) => group.2 += 1,
                None => groups.push((id, job.cost, 1)),
            }
        }
        Progress {
            speaks,
            terminal: std::io::stderr().is_terminal(),
            folder: folder.to_owned(),
            groups,
            missing: jobs.len(),
            all: members.len(),
            started: Instant::now(),
            last: None,
        }
    }

    /// To be called now and then; shows how far it is if it is time for it.
    pub fn show(&mut self) {
        let interval = if self.terminal { TERMINAL_INTERVAL } else { INTERVAL };
        if !self.speaks || self.last.is_some_and(|last| last.elapsed() < interval) {
            return;
        }
        self.last = Some(Instant::now());
        let made = store::n_kept(&self.folder).min(self.missing);
        let elapsed = self.started.elapsed().as_secs_f64();
        let fraction = done_fraction(&self.groups, made, &times(&self.folder));
        let left = if fraction > 0.0 { elapsed * (1.0 - fraction) / fraction } else { f64::NAN };
        let rest = if made == 0 { String::new() } else { format!(", about {} left", clock(left)) };
        let line = format!("[{}] {} of {} packings{rest}", clock(elapsed), self.all - self.missing + made, self.all);
        if self.terminal {
            tell(&format!("\r\x1b[K{line}"));
        } else {
            tell(&format!("{line}\n"));
        }
    }

    /// Clears the rewritten line.
    pub fn finish(&self) {
        if self.speaks && self.terminal && self.last.is_some() {
            tell("\r\x1b[K");
        }
    }
}

/// Which part of the work is done when `made` packings are, the groups being made one after another. What a group has
/// not shown yet is judged by its cost in the plan.
fn done_fraction(groups: &[(String, f64, usize)], made: usize, times: &BTreeMap<String, [f64; 2]>) -> f64 {
    let known = |(id, cost, _): &(String, f64, usize)| times.get(id).map(|[sum, n]| (sum / n, *cost));
    let (seconds, costs) = groups.iter().filter_map(known).fold((0.0, 0.0), |(s, c), (t, cost)| (s + t, c + cost));
    let per_cost = if costs > 0.0 { seconds / costs } else { 1.0 };
    let (mut done, mut all, mut left) = (0.0, 0.0, made);
    for group in groups {
        let each = known(group).map_or(group.1 * per_cost, |(seconds, _)| seconds);
        let here = left.min(group.2);
        left -= here;
        done += each * here as f64;
        all += each * group.2 as f64;
    }
    if all > 0.0 { done / all } else { 0.0 }
}

fn clock(seconds: f64) -> String {
    if !seconds.is_finite() {
        return "?".into();
    }
    let s = seconds as u64;
    if s < 3600 {
        format!("{}:{:02}", s / 60, s % 60)
    } else {
        format!("{}:{:02}:{:02}", s / 3600, s / 60 % 60, s % 60)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_left_is_judged_by_what_others_took() {
        let groups = [("a".to_owned(), 8.0, 2), ("b".to_owned(), 1.0, 4)];
        let mut times = BTreeMap::from([("a".to_owned(), [16.0, 1.0])]);
        // a: 2 x 16 s; b: 4 x 2 s by the plan
        assert!((done_fraction(&groups, 1, &times) - 16.0 / 40.0).abs() < 1e-15);
        times.insert("b".to_owned(), [12.0, 3.0]);
        assert!((done_fraction(&groups, 5, &times) - 44.0 / 48.0).abs() < 1e-15);
        assert_eq!(done_fraction(&[], 0, &times), 0.0);
        assert_eq!((clock(61.0), clock(3725.0), clock(f64::NAN)), ("1:01".into(), "1:02:05".into(), "?".into()));
    }
}
