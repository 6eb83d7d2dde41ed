use super::Comm;
use crate::profile::{self, Count};
use mpi::point_to_point::{Destination, Source};
use mpi::topology::Communicator;
use std::ops::Range;

/// Which of this rank's points other ranks see, and where theirs lie here. Made at each list build; only points that
/// the neighbour lists name travel.
#[derive(Default)]
pub struct Halo {
    /// The other ranks, ascending.
    peers: Vec<usize>,
    /// For each peer the local points it needs.
    send: Vec<Vec<u32>>,
    /// For each peer where its points are stored, contiguous after the owned points.
    receive: Vec<Range<usize>>,
    outgoing: Vec<Vec<[u64; 2]>>,
    incoming: Vec<Vec<[u64; 2]>>,
}

impl Halo {
    /// Settles the exchange. `offered[k]` lists own points that `peers[k]` may ask for, `wanted[k]` says which of those
    /// offered by `peers[k]` are wanted here, by their place in its list; they will be stored from index `owned` on,
    /// peer after peer, in the order asked for.
    pub fn new(comm: &Comm, peers: Vec<usize>, wanted: &[Vec<u32>], offered: &[Vec<u32>], owned: usize) -> Self {
        let requests: Vec<Vec<u64>> = wanted.iter().map(|w| w.iter().map(|&i| i as u64).collect()).collect();
        let asked = comm.exchange(&peers, &requests);
        let chosen = |(places, offer): (&Vec<u64>, &Vec<u32>)| places.iter().map(|&i| offer[i as usize]).collect();
        let send: Vec<Vec<u32>> = asked.iter().zip(offered).map(chosen).collect();
        let mut next = owned;
        let receive: Vec<Range<usize>> = wanted
            .iter()
            .map(|w| {
                let range = next..next + w.len();
                next = range.end;
                range
            })
            .collect();
        let outgoing = send.iter().map(|s| vec![[0; 2]; s.len()]).collect();
        let incoming = receive.iter().map(|r| vec![[0; 2]; r.len()]).collect();
        Halo { peers, send, receive, outgoing, incoming }
    }

    /// Number of points received in an update.
    pub fn received(&self) -> usize {
        self.receive.iter().map(|r| r.len()).sum()
    }

    /// Number of points sent in an update, counted once for each peer that needs them.
    pub fn sent(&self) -> usize {
        self.send.iter().map(|s| s.len()).sum()
    }

    /// Refreshes the values of all foreign points from their owners: one message to and from each peer, no allocation
    /// but for values wider than any before. `values` holds this rank's points, then the foreign ones; T is some pairs of
    /// words wide.
    pub fn update<T: bytemuck::Pod>(&mut self, comm: &Comm, values: &mut [T]) {
        let Some(group) = comm.peers() else { return };
        const { assert!(size_of::<T>().is_multiple_of(16)) };
        let width = size_of::<T>() / 16;
        let values: &mut [[u64; 2]] = bytemuck::cast_slice_mut(values);
        for (buffer, points) in self.outgoing.iter_mut().zip(&self.send) {
            buffer.resize(width * points.len(), [0; 2]);
            for (slots, &point) in buffer.chunks_exact_mut(width).zip(points) {
                slots.copy_from_slice(&values[width * point as usize..][..width]);
            }
        }
        for (buffer, range) in self.incoming.iter_mut().zip(&self.receive) {
            buffer.resize(width * range.len(), [0; 2]);
        }
        mpi::request::scope(|scope| {
            // a subdomain has at most eight neighbours, so the requests need no heap
            let mut pending: [Option<_>; 8] = [const { None }; 8];
            let mut sending: [Option<_>; 8] = [const { None }; 8];
            for (k, buffer) in self.incoming.iter_mut().enumerate().filter(|(_, b)| !b.is_empty()) {
                let peer = group.process_at_rank(self.peers[k] as i32);
                let words: &mut [u64] = bytemuck::cast_slice_mut(buffer);
                pending[k] = Some(peer.immediate_receive_into(scope, words));
            }
            for (k, buffer) in self.outgoing.iter().enumerate().filter(|(_, b)| !b.is_empty()) {
                let peer = group.process_at_rank(self.peers[k] as i32);
                let words: &[u64] = bytemuck::cast_slice(buffer);
                sending[k] = Some(peer.immediate_send(scope, words));
            }
            let bytes: usize = self.outgoing.iter().map(|buffer| size_of_val(&buffer[..])).sum();
            profile::add(Count::HaloBytes, bytes);
            profile::add(Count::HaloMessages, sending.iter().flatten().count());
            profile::add(Count::Waits, pending.iter().flatten().count());
            for request in pending.into_iter().flatten() {
                request.wait_without_status();
            }
            for request in sending.into_iter().flatten() {
                request.wait_without_status();
            }
        });
        for (range, buffer) in self.receive.iter().zip(&self.incoming) {
            values[width * range.start..width * range.end].copy_from_slice(buffer);
        }
    }
}
