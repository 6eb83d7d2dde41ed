//! What a run says on the standard error while it works: plain lines at intervals, one line rewritten on a terminal, and
//! every state as a log event (`--log-format json`, or `--log-level info`).

use crate::comm::tell;
use std::io::IsTerminal;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Between two plain lines.
const INTERVAL: Duration = Duration::from_secs(5);
/// Without a new state for so long, a line says how far the minimisation is.
const PATIENCE: Duration = Duration::from_secs(30);
/// Between two changes of the line on a terminal.
const TERMINAL_INTERVAL: Duration = Duration::from_millis(100);

/// One speaker for the whole run; silent on all ranks but rank 0.
#[derive(Clone)]
pub struct Progress {
    speaks: bool,
    terminal: bool,
    started: Instant,
    last: Arc<Mutex<Option<Instant>>>,
}

impl Progress {
    pub fn new(speaks: bool) -> Self {
        // Open MPI gives every rank a terminal as standard output; the standard error tells the truth
        let terminal = std::io::stderr().is_terminal();
        Progress { speaks, terminal, started: Instant::now(), last: Arc::default() }
    }

    /// A minimised state; shown if it is time for it.
    pub fn state(&self, phase: &str, density: f64, pressure: f64, iterations: u64) {
        tracing::info!(phase, density, pressure, iterations, "minimised");
        let interval = if self.terminal { TERMINAL_INTERVAL } else { INTERVAL };
        self.show(None, interval, || {
            format!("{phase:<11} density {density:.6}  pressure {pressure:9.3e}  {iterations} iterations")
        });
    }

    /// A state on its way to force balance; shown if nothing else has been for long. `max_force` in the unit of forces.
    pub fn relaxing(&self, forces: u64, max_force: f64) {
        self.show(Some(self.started), PATIENCE, || {
            format!("relaxing    max|F| {max_force:9.3e}  {forces} force evaluations so far")
        });
    }

    /// `before` stands for a line if there has been none.
    fn show(&self, before: Option<Instant>, interval: Duration, text: impl FnOnce() -> String) {
        let mut last = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        if !self.speaks || last.or(before).is_some_and(|last| last.elapsed() < interval) {
            return;
        }
        *last = Some(Instant::now());
        let seconds = self.started.elapsed().as_secs();
        let line = format!("[{:3}:{:02}] {}", seconds / 60, seconds % 60, text());
        if self.terminal {
            tell(&format!("\r\x1b[K{line}"));
        } else {
            tell(&format!("{line}\n"));
        }
    }

    /// What the whole run took.
    pub fn end(&self, memory: Option<String>) {
        if let (true, Some(memory)) = (self.speaks, memory) {
            tell(&format!("{memory}\n"));
        }
    }

    /// Clears the rewritten line, so that whatever comes next starts on a line of its own.
    pub fn finish(&self) {
        if self.speaks && self.terminal && self.last.lock().unwrap_or_else(PoisonError::into_inner).is_some() {
            tell("\r\x1b[K");
        }
    }
}
