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
    /// One value per particle of the block, for each column given.
    pub columns: Vec<Vec<f64>>,
    /// Number of particles and points on all ranks.
    pub total: usize,
    pub total_points: usize,
}

/// The ids of rank `rank` when ids `0..total` are dealt out to `size` ranks in blocks.
pub fn ids_of_rank(total: usize, size: usize, rank: usize) -> Range<usize> {
    let start = |rank: usize| (total as u128 * rank as u128 / size as u128) as usize;
    start(rank)..start(rank + 1)
}

/// Hands every particle, with its value in each column, to the rank that holds its row. The ids of all ranks must be
/// 0, 1, 2, ... without gaps. Collective.
pub fn to_blocks(comm: &Comm, particles: &Particles, columns: &[&[f64]]) -> Result<Block, String> {
    let counts = comm.all_gather(&[particles.len() as u64, particles.owned_points() as u64]);
    let total = counts.iter().map(|c| c[0]).sum::<u64>() as usize;
    let bad = columns.iter().any(|c| c.len() != particles.len()) || particles.id.iter().any(|&id| id as usize >= total);
    if comm.any(bad) {
        return Err(format!("ids must be 0 to {}, and columns have one value per particle", total.saturating_sub(1)));
    }
    let mut bodies = vec![Vec::new(); comm.size()];
    let mut values = vec![Vec::new(); comm.size()];
    let first: Vec<usize> = (0..comm.size()).map(|r| ids_of_rank(total, comm.size(), r).start).collect();
    for p in 0..particles.len() {
        let rank = first.partition_point(|&start| start <= particles.id[p] as usize) - 1;
        particles.pack(p, false, &mut bodies[rank]);
        values[rank].extend(columns.iter().map(|c| c[p].to_bits()));
    }
    let mut arrived = Particles::empty(&particles.bodies);
    comm.all_to_all(bodies).iter().for_each(|message| arrived.unpack(message, false));
    let values = comm.all_to_all(values).concat();

    let mut order: Vec<u32> = (0..arrived.len() as u32).collect();
    order.sort_by_key(|&p| arrived.id[p as usize]);
    let particles = arrived.reordered(&order);
    let ids = ids_of_rank(total, comm.size(), comm.rank());
    if comm.any(!particles.id.iter().map(|&id| id as usize).eq(ids.clone())) {
        return Err("particle ids are not unique".to_owned());
    }
    let column = |k: usize| order.iter().map(|&p| f64::from_bits(values[p as usize * columns.len() + k])).collect();
    let columns = (0..columns.len()).map(column).collect();
    let (points, total_points) = points_here(comm, particles.owned_points());
    Ok(Block { ids, points, particles, columns, total, total_points })
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
        let block = to_blocks(&Comm::alone(), &disks, &[&[20.0, 0.0, 10.0], &[-2.0, 0.0, -1.0]]).unwrap();
        assert_eq!(block.particles.id, [0, 1, 2]);
        assert_eq!(block.particles.size, [1.0, 2.0, 3.0]);
        assert_eq!(block.columns, [[0.0, 10.0, 20.0], [0.0, -1.0, -2.0]]);
        assert_eq!((block.ids, block.points, block.total, block.total_points), (0..3, 0..3, 3, 3));
    }

    #[test]
    fn gaps_twins_and_short_columns_are_refused() {
        let mut disks = Particles::empty(&Bodies::Disks);
        disks.push(0, 1.0, &[Frac::default()]);
        assert!(to_blocks(&Comm::alone(), &disks, &[&[]]).is_err());
        disks.push(0, 1.0, &[Frac::default()]);
        assert!(to_blocks(&Comm::alone(), &disks, &[]).is_err());
        disks.id[1] = 2;
        assert!(to_blocks(&Comm::alone(), &disks, &[]).is_err());
    }
}
