use super::{Candidates, CellList, PointList};
use crate::geometry::dot;
use crate::lanes::LANES;
use crate::threads;
use std::ops::Range;

/// For each own disk all disks within the sum of their radii plus a skin, in the order of global ids.
///
/// Eight disks are evaluated at a time, lane by lane, so that the lists are stored in slices of eight (sliced ELLPACK):
/// first the eight own disks, then the k-th neighbour of each, k = 0, 1, ... A disk with fewer neighbours than the
/// others has itself in the places that are left over. Disks with equally many neighbours share a slice.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DiskList {
    /// One for each chunk of own particles.
    parts: Vec<Part>,
}

/// The lists of a run of own disks.
#[derive(Clone, Debug, PartialEq)]
struct Part {
    disks: Range<u32>,
    rows: Vec<[u32; LANES]>,
    /// Where in `rows` each slice begins, and where the last one ends.
    start: Vec<u32>,
    /// Slice and lane of each disk, as one number.
    place: Vec<u16>,
}

impl DiskList {
    pub fn new(candidates: &Candidates, skin: f64) -> Self {
        let Candidates { pbox, particles, region, chunks, .. } = candidates;
        let largest = threads::largest(particles.len(), |p| particles.size[p]);
        let cells = CellList::new(pbox, region, &particles.position, largest + skin);
        let parts = threads::map(chunks, |chunk| {
            let (mut found, mut neighbors, mut ends) = (Vec::new(), Vec::new(), Vec::new());
            for i in chunk.particles.clone() {
                found.clear();
                cells.for_each_near(particles.position[i], |j| {
                    let reach = 0.5 * (particles.size[i] + particles.size[j as usize]) + skin;
                    let d = pbox.displacement(particles.position[j as usize], particles.position[i]);
                    if j as usize != i && dot(d, d) < reach * reach {
                        found.push((particles.id[j as usize] as u64) << 32 | j as u64);
                    }
                });
                found.sort_unstable();
                neighbors.extend(found.iter().map(|&key| key as u32));
                ends.push(neighbors.len());
            }
            Part::new(chunk.particles.start as u32, &neighbors, &ends)
        });
        DiskList { parts }
    }

    fn part(&self, disk: usize) -> &Part {
        &self.parts[self.parts.partition_point(|part| part.disks.end as usize <= disk)]
    }

    /// Neighbours of own disk i.
    pub fn neighbors(&self, i: usize) -> impl Iterator<Item = u32> + '_ {
        let part = self.part(i);
        let place = part.place[i - part.disks.start as usize] as usize;
        let lane = place % LANES;
        part.slice(place / LANES)[1..].iter().map(move |row| row[lane]).take_while(move |&j| j as usize != i)
    }

    /// The slices of a run of own disks, which must be one of the chunks that the list was made for.
    pub fn slices(&self, disks: &Range<usize>) -> impl Iterator<Item = &[[u32; LANES]]> {
        let part = self.part(disks.start);
        debug_assert_eq!(part.disks, disks.start as u32..disks.end as u32);
        (0..part.start.len() - 1).map(|s| part.slice(s))
    }
}

impl Part {
    /// Of the disks from `first` on, the neighbours of which stand one after another and end at `ends`.
    fn new(first: u32, neighbors: &[u32], ends: &[usize]) -> Part {
        let n = ends.len();
        let row = |i: usize| &neighbors[if i > 0 { ends[i - 1] } else { 0 }..ends[i]];
        let mut order: Vec<usize> = (0..n).collect();
        order.sort_by_key(|&i| std::cmp::Reverse(row(i).len()));
        let depth = |eight: &[usize]| 1 + row(eight[0]).len();
        let mut part = Part {
            disks: first..first + n as u32,
            rows: Vec::with_capacity(order.chunks(LANES).map(depth).sum()),
            start: Vec::with_capacity(n.div_ceil(LANES) + 1),
            place: vec![0; n],
        };
        part.start.push(0);
        for (slice, eight) in order.chunks(LANES).enumerate() {
            // the last slice may be short of disks: the last one stands in for the others
            let own: [usize; LANES] = std::array::from_fn(|lane| eight[lane.min(eight.len() - 1)]);
            part.rows.push(own.map(|i| first + i as u32));
            for k in 0..row(own[0]).len() {
                part.rows.push(own.map(|i| row(i).get(k).copied().unwrap_or(first + i as u32)));
            }
            part.start.push(part.rows.len() as u32);
            eight.iter().enumerate().for_each(|(lane, &i)| part.place[i] = (slice * LANES + lane) as u16);
        }
        part
    }

    #[inline(always)]
    fn slice(&self, s: usize) -> &[[u32; LANES]] {
        &self.rows[self.start[s] as usize..self.start[s + 1] as usize]
    }
}

impl PointList for DiskList {
    fn for_each_point(&mut self, visit: impl Fn(&mut u32) + Sync + Send) {
        let of_part = |part: &mut Part| part.rows.iter_mut().flatten().for_each(&visit);
        threads::for_each(&mut self.parts, of_part);
    }
}
