use super::Report;
use bytemuck::{Pod, Zeroable};

/// What a search has done and seen, in order: one that was left is led by it to where it was, on the same way, as all it
/// decides follows from that.
#[derive(Default)]
pub(super) struct Past {
    acts: Vec<Act>,
    /// How many have been come to again.
    repeated: usize,
}

/// What one act came to, and the report after it.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct Act {
    value: f64,
    report: Report,
}

impl Past {
    /// From the memory of a search, with that of the minimiser that it was left in.
    pub fn remembered(memory: &[u64]) -> (Past, Vec<u64>) {
        let Some((&count, rest)) = memory.split_first() else { return Default::default() };
        let (acts, inner) = rest.split_at(count as usize * (size_of::<Act>() / size_of::<u64>()));
        (Past { acts: bytemuck::cast_slice(acts).to_vec(), repeated: 0 }, inner.to_vec())
    }

    /// The memory that [`Past::remembered`] reads.
    pub fn memory(&self, inner: &[u64]) -> Vec<u64> {
        [&[self.acts.len() as u64], bytemuck::cast_slice(&self.acts), inner].concat()
    }

    /// What the next act came to, if it was done before.
    pub fn repeat(&mut self) -> Option<(f64, Report)> {
        let act = self.acts.get(self.repeated)?;
        self.repeated += 1;
        Some((act.value, act.report))
    }

    /// Whether nothing is left to be come to again.
    pub fn is_over(&self) -> bool {
        self.repeated == self.acts.len()
    }

    pub fn push(&mut self, value: f64, report: Report) {
        self.acts.push(Act { value, report });
        self.repeated += 1;
    }
}
