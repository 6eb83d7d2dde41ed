//! Rows of a file: particles in the order of their ids, a contiguous block on each rank.

use crate::comm::Comm;
use crate::geometry::{PeriodicBox, Polygon, Vec2, add};
use crate::particles::{Bodies, Particles};
use std::ops::Range;

/// The particles whose ids are `ids`, in order, and where their points stand among all points.
pub struct Block {
    pub ids: Range<usize>,
    pub points: Range<usize>,
    pub particles: Particles,
    /// Number of particles and points on all ranks.
    pub total: usize,
    pub total_points: usize,
}

/// The ids of rank `rank` when ids `0..total` are dealt out to `size` ranks in blocks.
pub fn ids_of_rank(total: usize, size: usize, rank: usize) -> Range<usize> {
    let start = |rank: usize| (total as u128 * rank as u128 / size as u128) as usize;
    start(rank)..start(rank + 1)
}

/// Hands every particle to the rank that holds its row. The ids of all ranks must be 0, 1, 2, ... without gaps.
/// Collective.
pub fn to_block(comm: &Comm, particles: &Particles) -> Result<Block, String> {
    let total = comm.sum_count(particles.len() as u64) as usize;
    if comm.any(particles.id.iter().any(|&id| id as usize >= total)) {
        return Err(format!("particle ids must be 0 to {}", total.saturating_sub(1)));
    }
    let mut arrived = Particles::empty(&particles.bodies);
    let pack = |p: usize, message: &mut Vec<u64>| particles.pack(p, false, message);
    deal(comm, particles, total, pack, |message| arrived.unpack(message, false));
    let mut order: Vec<u32> = (0..arrived.len() as u32).collect();
    order.sort_unstable_by_key(|&p| arrived.id[p as usize]);
    let particles = arrived.reordered(&order);
    let ids = ids_of_rank(total, comm.size(), comm.rank());
    if comm.any(!particles.id.iter().map(|&id| id as usize).eq(ids.clone())) {
        return Err("particle ids are not unique".to_owned());
    }
    let (points, total_points) = points_here(comm, particles.owned_points());
    Ok(Block { ids, points, particles, total, total_points })
}

impl Block {
    /// A number of every particle in the order of the block: `value` has it for each of `particles`, those that the block
    /// was made of. Collective.
    pub fn column(&self, comm: &Comm, particles: &Particles, value: impl Fn(usize) -> f64) -> Vec<f64> {
        let mut column = vec![f64::NAN; self.ids.len()];
        let pack = |p: usize, message: &mut Vec<u64>| message.extend([particles.id[p] as u64, value(p).to_bits()]);
        deal(comm, particles, self.total, pack, |message| {
            for word in message.chunks_exact(2) {
                column[word[0] as usize - self.ids.start] = f64::from_bits(word[1]);
            }
        });
        column
    }
}

/// Sends what `pack` appends for each particle to the rank that holds its row, which `take`s it. In pieces: what is on its
/// way must not be much beside what stays.
fn deal(
    comm: &Comm,
    particles: &Particles,
    total: usize,
    pack: impl Fn(usize, &mut Vec<u64>),
    mut take: impl FnMut(&[u64]),
) {
    const PIECE: usize = 1 << 16;
    let first: Vec<usize> = (0..comm.size()).map(|r| ids_of_rank(total, comm.size(), r).start).collect();
    let pieces = comm.all_gather(&[particles.len().div_ceil(PIECE) as u64]).concat().into_iter().max().unwrap_or(0);
    for k in 0..pieces as usize {
        let mut outgoing = vec![Vec::new(); comm.size()];
        for p in k * PIECE..particles.len().min((k + 1) * PIECE) {
            let rank = first.partition_point(|&start| start <= particles.id[p] as usize) - 1;
            pack(p, &mut outgoing[rank]);
        }
        comm.all_to_all(outgoing).iter().for_each(|message| take(message));
    }
}

/// Where this rank's points stand when each rank has `here` points, in rank order, and how many there are. Collective.
pub fn points_here(comm: &Comm, here: usize) -> (Range<usize>, usize) {
    let counts = comm.all_gather(&[here as u64]);
    let count = |ranks: &[Vec<u64>]| ranks.iter().map(|c| c[0]).sum::<u64>() as usize;
    let start = count(&counts[..comm.rank()]);
    (start..start + here, count(&counts))
}

/// Cartesian positions of a particle's points: the first in the box, the others in the same periodic image.
pub fn whole(pbox: &PeriodicBox, particles: &Particles, particle: usize) -> Vec<Vec2> {
    let points = particles.points_of(particle);
    let Some(&first) = points.first() else { return Vec::new() };
    let origin = pbox.position(first);
    match particles.bodies {
        Bodies::Disks => vec![origin],
        Bodies::Polygons { .. } => Polygon::from_vertices(pbox, points).offsets().map(|r| add(origin, r)).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Frac;

    #[test]
    fn blocks_cover_all_ids_once() {
        for (total, size) in [(0, 1), (1, 4), (7, 3), (64, 6), (5, 8)] {
            let all: Vec<usize> = (0..size).flat_map(|rank| ids_of_rank(total, size, rank)).collect();
            assert_eq!(all, (0..total).collect::<Vec<_>>());
        }
    }

    #[test]
    fn rows_are_sorted_and_columns_follow() {
        let mut disks = Particles::empty(&Bodies::Disks);
        for id in [2, 0, 1] {
            disks.push(id, 1.0 + id as f64, &[Frac::from_fractions([0.1 * id as f64, 0.5])]);
        }
        let block = to_block(&Comm::alone(), &disks).unwrap();
        assert_eq!(block.particles.id, [0, 1, 2]);
        assert_eq!(block.particles.size, [1.0, 2.0, 3.0]);
        assert_eq!(block.column(&Comm::alone(), &disks, |p| [20.0, 0.0, 10.0][p]), [0.0, 10.0, 20.0]);
        assert_eq!((block.ids, block.points, block.total, block.total_points), (0..3, 0..3, 3, 3));
    }

    #[test]
    fn gaps_and_twins_are_refused() {
        let mut disks = Particles::empty(&Bodies::Disks);
        disks.push(0, 1.0, &[Frac::default()]);
        disks.push(0, 1.0, &[Frac::default()]);
        assert!(to_block(&Comm::alone(), &disks).is_err());
        disks.id[1] = 2;
        assert!(to_block(&Comm::alone(), &disks).is_err());
    }
}
