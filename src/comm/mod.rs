//! The only room that knows MPI: processes, messages, reductions, and the end of all ranks when one fails.
//!
//! Messages are `u64` words in buffers that the other rooms pack and unpack; nothing here knows what they mean.

mod exact_sum;
mod halo;
mod reduction;

pub use exact_sum::{ExactSum, Grid};
pub use halo::Halo;
pub use reduction::{EXTREMES, FusedSums, Sums, Totals};

use crate::allocator;
use crate::profile::{self, Count, Phase};
use crate::threads;
use mpi::collective::{SystemOperation, UnsafeUserOperation};
use mpi::point_to_point::{Destination, Source};
use mpi::topology::{Color, Communicator, SimpleCommunicator};
use mpi::traits::{AsRaw, CommunicatorCollectives, Root};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::io::Write;

/// MPI, from initialisation to finalisation. Without `mpirun` this is one rank.
pub struct Session {
    universe: Option<mpi::environment::Universe>,
}

impl Session {
    /// Initialises MPI (calls from the main thread only) and makes a panic on any rank end all of them.
    pub fn start() -> Self {
        allocator::keep_large_arrays_apart();
        let universe = mpi::initialize_with_threading(mpi::Threading::Funneled).map(|(universe, _)| universe);
        if let Some(universe) = &universe {
            let rank = universe.world().rank();
            let size = universe.world().size();
            let default_hook = std::panic::take_hook();
            std::panic::set_hook(Box::new(move |info| {
                tell(&format!("jamhpc: internal error on rank {rank} of {size}; all ranks end\n"));
                default_hook(info);
                // SimpleCommunicator::world() needs no state, so that any thread may abort
                SimpleCommunicator::world().abort(EXIT_PANIC);
            }));
        }
        Session { universe }
    }

    /// The communicator of all ranks.
    pub fn world(&self) -> Comm {
        match &self.universe {
            Some(universe) => Comm::over(universe.world().duplicate()),
            None => Comm::alone(),
        }
    }
}

/// Writes to the standard error. A terminal or a disk that is gone is no reason to end.
pub fn tell(text: &str) {
    let _ = std::io::stderr().write_all(text.as_bytes());
}

/// Exit status of all ranks when one has panicked.
pub const EXIT_PANIC: i32 = 70;

/// A group of ranks that work on one system. Every method that communicates must be called by all of them in the same
/// order.
pub struct Comm {
    group: Option<SimpleCommunicator>,
    fold: Option<UnsafeUserOperation>,
    rank: usize,
    size: usize,
}

impl Comm {
    /// One rank by itself: no MPI call is ever made.
    pub fn alone() -> Self {
        Comm { group: None, fold: None, rank: 0, size: 1 }
    }

    fn over(group: SimpleCommunicator) -> Self {
        let (rank, size) = (group.rank() as usize, group.size() as usize);
        // SAFETY: the function is a pure fold of plain data; commutative and associative by the tests of `reduction`.
        let fold = (size > 1).then(|| unsafe { UnsafeUserOperation::commutative(reduction::fold_raw) });
        Comm { group: Some(group), fold, rank, size }
    }

    /// The same ranks with messages of their own. Collective.
    pub fn duplicate(&self) -> Self {
        self.peers().map_or_else(Comm::alone, |group| Comm::over(group.duplicate()))
    }

    /// The ranks that name the same `color`, in their present order. Collective.
    pub fn split(&self, color: u32) -> Self {
        let part = self.peers().and_then(|group| group.split_by_color(Color::with_value(color as i32)));
        part.map_or_else(Comm::alone, Comm::over)
    }

    pub fn rank(&self) -> usize {
        self.rank
    }

    pub fn size(&self) -> usize {
        self.size
    }

    /// Rank 0 speaks to the user and reads files.
    pub fn is_root(&self) -> bool {
        self.rank == 0
    }

    fn peers(&self) -> Option<&SimpleCommunicator> {
        self.group.as_ref().filter(|_| self.size > 1)
    }

    /// The raw MPI communicator for libraries that open files in parallel; none when MPI was never started.
    pub fn raw(&self) -> Option<mpi::ffi::MPI_Comm> {
        self.group.as_ref().map(|group| group.as_raw())
    }

    /// Combines the partial totals of all ranks, in place, in one collective operation.
    pub fn combine<const S: usize>(&self, totals: &mut Totals<S>) {
        if let (Some(group), Some(fold)) = (self.peers(), &self.fold) {
            let mine = totals.to_block();
            let mut all = reduction::Block::default();
            let _reduction = profile::enter(Phase::Reductions);
            profile::add(Count::Collectives, 1);
            group.all_reduce_into(&mine, &mut all, fold);
            *totals = Totals::from_block(all);
        }
    }

    /// The largest of one number per rank; a NaN on any rank answers NaN.
    pub fn max(&self, x: f64) -> f64 {
        self.max_each([x])[0]
    }

    /// The largest over ranks of each of a few numbers.
    pub fn max_each<const N: usize>(&self, x: [f64; N]) -> [f64; N] {
        let largest = self.reduce(&x.map(ordered), SystemOperation::max());
        std::array::from_fn(|k| unordered(largest[k]))
    }

    /// Whether it is true on any rank.
    pub fn any(&self, here: bool) -> bool {
        self.max(if here { 1.0 } else { 0.0 }) > 0.0
    }

    /// Sum of one whole number per rank.
    pub fn sum_count(&self, here: u64) -> u64 {
        self.reduce(&[here], SystemOperation::sum())[0]
    }

    /// Words of all ranks, each reduced over ranks.
    fn reduce(&self, here: &[u64], operation: SystemOperation) -> Vec<u64> {
        let mut all = here.to_vec();
        if let Some(group) = self.peers() {
            let _reduction = profile::enter(Phase::Reductions);
            profile::add(Count::Collectives, 1);
            group.all_reduce_into(here, &mut all[..], operation);
        }
        all
    }

    /// Order-independent sums of `K` quantities over `n` terms here and any number on other ranks: the same bits
    /// whichever rank or thread has a term. Each is asked for twice (the largest magnitudes first). NaN where a term is
    /// not finite.
    pub fn sum_terms<const K: usize>(&self, n: usize, term: impl Fn(usize) -> [f64; K] + Sync) -> [f64; K] {
        let larger = |a: f64, b: f64| if a.is_nan() || b.is_nan() { f64::NAN } else { a.max(b) };
        let larger_each = |a: [f64; K], b: [f64; K]| std::array::from_fn(|k| larger(a[k], b[k]));
        let bound = threads::reduce(
            0..n,
            &|range| range.map(|i| term(i).map(f64::abs)).fold([0.0; K], larger_each),
            &larger_each,
        );
        let bound = self.max_each(bound);
        let grids = bound.map(Grid::for_terms_up_to);
        let sums = threads::reduce(
            0..n,
            &|range| {
                let mut sums = [ExactSum::default(); K];
                for i in range {
                    let row = term(i);
                    (0..K).for_each(|k| sums[k].add(grids[k], row[k]));
                }
                sums
            },
            &|mut a: [ExactSum; K], b| {
                a.iter_mut().zip(b).for_each(|(sum, part)| sum.merge(part));
                a
            },
        );
        // the sum of limbs as words without a sign has the same bits
        let words: Vec<u64> = sums.iter().flat_map(|s| s.limbs.map(|l| l as u64)).collect();
        let words = self.reduce(&words, SystemOperation::sum());
        let whole = |k: usize| ExactSum { limbs: [words[2 * k] as i64, words[2 * k + 1] as i64] };
        std::array::from_fn(|k| if bound[k].is_finite() { whole(k).value(grids[k]) } else { f64::NAN })
    }

    /// The same number of words from every rank, in rank order.
    pub fn all_gather(&self, words: &[u64]) -> Vec<Vec<u64>> {
        match self.peers() {
            None => vec![words.to_vec()],
            Some(group) => {
                let mut all = vec![0u64; words.len() * self.size];
                let _reduction = profile::enter(Phase::Reductions);
                profile::add(Count::Collectives, 1);
                group.all_gather_into(words, &mut all[..]);
                all.chunks(words.len().max(1)).map(<[u64]>::to_vec).collect()
            }
        }
    }

    /// Sends `outgoing[k]` to `peers[k]` and returns what each of them sent here, in the same order. The relation must
    /// be mutual: every rank names those that name it. Any lengths.
    pub fn exchange(&self, peers: &[usize], outgoing: &[Vec<u64>]) -> Vec<Vec<u64>> {
        let Some(group) = self.peers() else { return Vec::new() };
        profile::add(Count::OtherMessages, outgoing.len());
        profile::add(Count::OtherBytes, outgoing.iter().map(|words| size_of_val(&words[..])).sum());
        profile::add(Count::Waits, peers.len());
        mpi::request::multiple_scope(peers.len(), |scope, pending| {
            for (&peer, words) in peers.iter().zip(outgoing) {
                pending.add(group.process_at_rank(peer as i32).immediate_send(scope, &words[..]));
            }
            let incoming = peers.iter().map(|&peer| group.process_at_rank(peer as i32).receive_vec().0).collect();
            pending.wait_all(&mut Vec::new());
            incoming
        })
    }

    /// Sends `outgoing[r]` to every rank r and returns what every rank sent here.
    pub fn all_to_all(&self, mut outgoing: Vec<Vec<u64>>) -> Vec<Vec<u64>> {
        let Some(_) = self.peers() else { return outgoing };
        let everyone: Vec<usize> = (0..self.size).filter(|&r| r != self.rank).collect();
        let own = outgoing.remove(self.rank);
        let mut incoming = self.exchange(&everyone, &outgoing);
        incoming.insert(self.rank, own);
        incoming
    }

    /// All ranks' words on rank 0, in rank order; nothing elsewhere.
    pub fn gather(&self, words: Vec<u64>) -> Vec<Vec<u64>> {
        let Some(group) = self.peers() else { return vec![words] };
        if self.is_root() {
            profile::add(Count::Waits, self.size - 1);
            let mut all = vec![words];
            all.extend((1..self.size).map(|r| group.process_at_rank(r as i32).receive_vec().0));
            all
        } else {
            profile::add(Count::OtherMessages, 1);
            profile::add(Count::OtherBytes, size_of_val(&words[..]));
            group.process_at_rank(0).send(&words[..]);
            Vec::new()
        }
    }

    /// Rank 0's bytes on every rank.
    pub fn broadcast(&self, bytes: Vec<u8>) -> Vec<u8> {
        let Some(group) = self.peers() else { return bytes };
        let root = group.process_at_rank(0);
        let mut length = bytes.len() as u64;
        root.broadcast_into(&mut length);
        profile::add(Count::Collectives, if length == 0 { 1 } else { 2 });
        let mut bytes = if self.is_root() { bytes } else { vec![0; length as usize] };
        if length > 0 {
            // the address of an empty vector may be one that means something to MPI
            root.broadcast_into(&mut bytes[..]);
        }
        bytes
    }

    /// What `read` gives on rank 0, success or failure, on every rank. Rank 0 alone calls it.
    pub fn from_root<E: Serialize + DeserializeOwned>(
        &self,
        read: impl FnOnce() -> Result<Vec<u8>, E>,
    ) -> Result<Vec<u8>, E> {
        let outcome = if self.is_root() { Some(read()) } else { None };
        let (mut bytes, ok) = match outcome {
            Some(Ok(bytes)) => (bytes, 1),
            Some(Err(error)) => (note_of(&error), 0),
            None => (Vec::new(), 0),
        };
        bytes.push(ok);
        let mut tagged = self.broadcast(bytes);
        if tagged.pop() == Some(1) {
            return Ok(tagged);
        }
        Err(noted(&tagged))
    }

    /// The value of every rank if all succeeded, else the error of the first rank that failed, on all of them: the next
    /// collective call is then made by all ranks or by none. Collective.
    pub fn agree<T, E: Serialize + DeserializeOwned>(&self, outcome: Result<T, E>) -> Result<T, E> {
        if !self.any(outcome.is_err()) {
            return outcome;
        }
        let note = outcome.err().map_or(Vec::new(), |error| note_of(&error));
        // one byte a word: errors are short, and rare
        let all = self.gather(note.into_iter().map(u64::from).collect());
        let first = all.into_iter().find(|words| !words.is_empty()).unwrap_or_default();
        Err(noted(&self.broadcast(first.into_iter().map(|word| word as u8).collect())))
    }

    pub fn barrier(&self) {
        if let Some(group) = self.peers() {
            group.barrier();
        }
    }
}

/// An error as it is sent to other ranks.
fn note_of(error: &impl Serialize) -> Vec<u8> {
    serde_json::to_vec(error).expect("an error is plain data")
}

fn noted<E: DeserializeOwned>(note: &[u8]) -> E {
    serde_json::from_slice(note).expect("an error as another rank wrote it")
}

const SIGN: u64 = 1 << 63;

/// A word that is larger for a larger number, and largest for NaN.
fn ordered(x: f64) -> u64 {
    match x.to_bits() {
        _ if x.is_nan() => u64::MAX,
        bits if bits & SIGN == 0 => bits | SIGN,
        bits => !bits,
    }
}

/// The number of that word.
fn unordered(word: u64) -> f64 {
    f64::from_bits(if word & SIGN == 0 { !word } else { word & !SIGN })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_ordered_as_words() {
        let numbers = [f64::NEG_INFINITY, -2.0, -1e-310, -0.0, 0.0, 1e-310, 1.5, f64::INFINITY];
        assert!(numbers.windows(2).all(|pair| ordered(pair[0]) < ordered(pair[1])));
        assert!(ordered(f64::NAN) == ordered(-f64::NAN) && ordered(f64::INFINITY) < ordered(f64::NAN));
        assert!(numbers.iter().all(|&x| unordered(ordered(x)).to_bits() == x.to_bits()));
        assert!(unordered(ordered(f64::NAN)).is_nan());
    }

    #[test]
    fn what_is_no_number_spoils_its_own_sum_only() {
        let terms = [[f64::NAN, 1.0, 1.0], [1.0, f64::INFINITY, 2.0]];
        let [nan, infinite, three] = Comm::alone().sum_terms(2, |i| terms[i]);
        assert!(nan.is_nan() && infinite.is_nan());
        assert_eq!(three, 3.0);
    }
}
