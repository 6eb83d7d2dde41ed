//! Where the time of this rank goes, and what it sends: phases that exclude each other, and counters.
//!
//! One per process, used by the thread that talks to MPI. Nothing is decided by it, so it cannot change a result; unless
//! asked for, entering a phase costs one look at a flag, a few of which there are in a step.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering::Relaxed};
use std::time::Instant;

/// What a rank is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// All that is none of the others: start, observables, decisions of the minimiser.
    Other,
    /// Forces, with this rank's part of the sums of a step.
    Forces,
    /// Neighbour lists: migration, sorting, building, and picking what can touch.
    Lists,
    /// Positions of foreign points, waiting for them included.
    Halo,
    /// Sums and maxima over all ranks, waiting included.
    Reductions,
    /// Moving points.
    Update,
    /// Files.
    Output,
}

impl Phase {
    pub const ALL: [Phase; 7] =
        [Phase::Forces, Phase::Lists, Phase::Halo, Phase::Reductions, Phase::Update, Phase::Output, Phase::Other];

    pub fn name(self) -> &'static str {
        match self {
            Phase::Other => "other",
            Phase::Forces => "forces",
            Phase::Lists => "lists",
            Phase::Halo => "halo",
            Phase::Reductions => "reductions",
            Phase::Update => "update",
            Phase::Output => "output",
        }
    }
}

/// What is counted, on this rank.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Count {
    /// Force evaluations.
    Steps,
    /// Messages to other ranks in updates of the halo.
    HaloMessages,
    /// Their bytes.
    HaloBytes,
    /// Other messages to single ranks: at list builds, of rows for files, and what rank 0 factorises.
    OtherMessages,
    /// Their bytes.
    OtherBytes,
    /// Collective operations.
    Collectives,
    /// Messages waited for, one for each that is received.
    Waits,
}

impl Count {
    pub const ALL: [Count; 7] = [
        Count::Steps,
        Count::HaloMessages,
        Count::HaloBytes,
        Count::OtherMessages,
        Count::OtherBytes,
        Count::Collectives,
        Count::Waits,
    ];
}

/// Of one thread.
struct Profile {
    is_on: AtomicBool,
    start: OnceLock<Instant>,
    present: AtomicUsize,
    /// When the present phase began, in ns after the start.
    since: AtomicU64,
    nanoseconds: [AtomicU64; Phase::ALL.len()],
    counts: [AtomicU64; Count::ALL.len()],
}

static OF_THIS_RANK: Profile = Profile::new();

impl Profile {
    const fn new() -> Self {
        Profile {
            is_on: AtomicBool::new(false),
            start: OnceLock::new(),
            present: AtomicUsize::new(Phase::Other as usize),
            since: AtomicU64::new(0),
            nanoseconds: [const { AtomicU64::new(0) }; Phase::ALL.len()],
            counts: [const { AtomicU64::new(0) }; Count::ALL.len()],
        }
    }

    fn begin(&self) {
        self.start.get_or_init(Instant::now);
        self.nanoseconds.iter().chain(&self.counts).for_each(|number| number.store(0, Relaxed));
        self.since.store(self.now(), Relaxed);
        self.is_on.store(true, Relaxed);
    }

    fn now(&self) -> u64 {
        self.start.get().map_or(0, |start| start.elapsed().as_nanos() as u64)
    }

    #[inline]
    fn enter(&self, phase: Phase) -> Guard<'_> {
        Guard { profile: self, before: self.is_on.load(Relaxed).then(|| self.switch(phase as usize)) }
    }

    fn switch(&self, to: usize) -> usize {
        let (from, now) = (self.present.swap(to, Relaxed), self.now());
        self.nanoseconds[from].fetch_add(now - self.since.swap(now, Relaxed), Relaxed);
        from
    }

    #[inline]
    fn add(&self, count: Count, n: usize) {
        if self.is_on.load(Relaxed) {
            self.counts[count as usize].fetch_add(n as u64, Relaxed);
        }
    }

    fn seconds(&self) -> [f64; Phase::ALL.len()] {
        self.switch(self.present.load(Relaxed));
        Phase::ALL.map(|phase| self.nanoseconds[phase as usize].load(Relaxed) as f64 * 1e-9)
    }

    fn counts(&self) -> [f64; Count::ALL.len()] {
        Count::ALL.map(|count| self.counts[count as usize].load(Relaxed) as f64)
    }
}

/// The phase that was interrupted goes on when this is dropped.
#[must_use]
pub struct Guard<'a> {
    profile: &'a Profile,
    before: Option<usize>,
}

impl Drop for Guard<'_> {
    fn drop(&mut self) {
        if let Some(before) = self.before {
            self.profile.switch(before);
        }
    }
}

/// Begins to measure, from zero; all until now is forgotten.
pub fn start() {
    OF_THIS_RANK.begin();
}

/// Enters a phase.
#[inline]
pub fn enter(phase: Phase) -> Guard<'static> {
    OF_THIS_RANK.enter(phase)
}

#[inline]
pub fn add(count: Count, n: usize) {
    OF_THIS_RANK.add(count, n);
}

/// Seconds in each phase until now, in the order of [`Phase::ALL`].
pub fn seconds() -> [f64; Phase::ALL.len()] {
    OF_THIS_RANK.seconds()
}

/// What was counted until now, in the order of [`Count::ALL`].
pub fn counts() -> [f64; Count::ALL.len()] {
    OF_THIS_RANK.counts()
}

/// CPU time of this process, of all its threads.
pub fn cpu_seconds() -> f64 {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    now.tv_sec as f64 + 1e-9 * now.tv_nsec as f64
}

/// Peak resident memory of this process in bytes; NaN where the system does not tell (`/proc`).
pub fn peak_memory() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find(|l| l.starts_with("VmHWM"));
    line.and_then(|l| l.split_whitespace().nth(1)?.parse::<f64>().ok()).map_or(f64::NAN, |kib| kib * 1024.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn phases_exclude_each_other_and_fill_the_time() {
        let profile = Profile::new();
        {
            let _forces = profile.enter(Phase::Forces); // not asked for: nothing happens
            assert_eq!(profile.present.load(Relaxed), Phase::Other as usize);
        }
        profile.begin();
        let begin = profile.now();
        {
            let _lists = profile.enter(Phase::Lists);
            {
                let _reductions = profile.enter(Phase::Reductions);
                assert_eq!(profile.present.load(Relaxed), Phase::Reductions as usize);
                profile.add(Count::Collectives, 2);
            }
            assert_eq!(profile.present.load(Relaxed), Phase::Lists as usize);
        }
        let seconds = profile.seconds();
        let whole: f64 = seconds.iter().sum();
        // what happened between the first look at the clock and the last
        assert!(seconds[1] > 0.0 && seconds[3] > 0.0 && seconds[0] == 0.0);
        assert!(whole >= (profile.since.load(Relaxed) - begin) as f64 * 1e-9 * (1.0 - 1e-12));
        assert_eq!(profile.counts(), [0.0, 0.0, 0.0, 0.0, 0.0, 2.0, 0.0]);
    }
}
