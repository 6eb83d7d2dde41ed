use super::{Candidates, CellList, PointList};
use crate::lanes::{self, Kernel, LANES, Lanes, TAGS, Tagged, point_of, tag_of, tagged};
use crate::threads::{self, Chunk};
use std::ops::Range;

/// For each own disk all disks within the sum of their radii plus a skin, in the order of global ids.
///
/// Eight disks are evaluated at a time, lane by lane, so that the lists are stored in slices of eight (sliced ELLPACK):
/// first the eight own disks, then the k-th neighbour of each, k = 0, 1, ... A disk with fewer neighbours than the
/// others has itself in the places that are left over. Disks with equally many neighbours share a slice.
///
/// Where there are few different sizes, each entry bears its size as a tag, so that sizes need not be fetched.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DiskList {
    contacts: Option<[f64; TAGS * TAGS]>,
    /// One for each chunk of own particles.
    parts: Vec<Part>,
}

/// The lists of a run of own disks.
#[derive(Clone, Debug, PartialEq)]
struct Part {
    disks: Range<u32>,
    rows: Vec<[Tagged; LANES]>,
    /// Where in `rows` each slice begins, and where the last one ends.
    start: Vec<u32>,
    /// Slice and lane of each disk, as one number.
    place: Vec<u16>,
}

impl DiskList {
    pub fn new(candidates: &Candidates, skin: f64) -> Self {
        let Candidates { pbox, particles, region, chunks, .. } = candidates;
        let largest = threads::largest(particles.len(), |p| particles.size[p]);
        let cells = &CellList::new(pbox, region, &particles.position, largest + skin);
        assert!(particles.len() < (u32::MAX as usize) / TAGS, "fewer than 2^30 disks on a rank");
        let sizes = &few_sizes(&particles.size);
        let tag = |p: usize| sizes.iter().position(|&size| size == particles.size[p]).unwrap_or(0) as u8;
        let tags = &threads::collect(particles.len(), tag)[..];
        let part = |scratch: &mut Scratch, chunk: &Chunk| {
            lanes::run(Search { candidates, cells, tags, skin, disks: chunk.particles.clone(), scratch })
        };
        let contact = |a: usize, b: usize| match (sizes.get(a), sizes.get(b)) {
            (Some(a), Some(b)) => 0.5 * (a + b),
            _ => 0.0, // no disk has this tag
        };
        let table = std::array::from_fn(|k| contact(k / TAGS, k % TAGS));
        DiskList { contacts: (!sizes.is_empty()).then_some(table), parts: threads::map_with(chunks, part) }
    }

    /// Distances at which disks touch, by their tags; nothing where there are too many different sizes.
    pub fn contacts(&self) -> Option<&[f64; TAGS * TAGS]> {
        self.contacts.as_ref()
    }

    fn part(&self, disk: usize) -> &Part {
        &self.parts[self.parts.partition_point(|part| part.disks.end as usize <= disk)]
    }

    /// Neighbours of own disk i.
    pub fn neighbors(&self, i: usize) -> impl Iterator<Item = u32> + '_ {
        let part = self.part(i);
        let place = part.place[i - part.disks.start as usize] as usize;
        let lane = place % LANES;
        part.slice(place / LANES)[1..].iter().map(move |row| point_of(row[lane])).take_while(move |&j| j as usize != i)
    }

    /// The slices of a run of own disks, which must be one of the chunks that the list was made for.
    pub fn slices(&self, disks: &Range<usize>) -> impl Iterator<Item = &[[Tagged; LANES]]> {
        let part = self.part(disks.start);
        debug_assert_eq!(part.disks, disks.start as u32..disks.end as u32);
        (0..part.start.len() - 1).map(|s| part.slice(s))
    }
}

/// The neighbours of a chunk of disks, eight candidates tested at a time.
struct Search<'a> {
    candidates: &'a Candidates<'a>,
    cells: &'a CellList,
    /// Of all disks.
    tags: &'a [u8],
    skin: f64,
    disks: Range<usize>,
    scratch: &'a mut Scratch,
}

/// Neighbours of one disk, each below its global id; those of all disks of a chunk, and where those of each end.
#[derive(Default)]
struct Scratch {
    found: Vec<u64>,
    neighbors: Vec<u32>,
    ends: Vec<usize>,
}

impl Kernel for Search<'_> {
    type Output = Part;

    #[inline(always)]
    fn run(self, l: impl Lanes) -> Part {
        let Search { candidates: Candidates { pbox, particles, .. }, cells, tags, skin, disks, scratch } = self;
        let Scratch { found, neighbors, ends } = scratch;
        let (position, size) = (&particles.position[..], &particles.size[..]);
        let [unit_x, tilt, unit_y, half, skin] =
            [pbox.unit()[0], pbox.unit()[1], pbox.unit()[2], 0.5, skin].map(|x| l.splat(x));
        neighbors.clear();
        ends.clear();
        for i in disks.clone() {
            found.clear();
            let own = [i as u32; LANES];
            let ([x, y], own_size) = (l.points(position, &own), l.numbers(size, &own));
            // no closures: they would not be compiled for wide registers
            for eight in cells.runs_near(position[i]).into_iter().flat_map(|run| run.chunks(LANES)) {
                // the disk itself fills up what is left over, and is left out with it
                let at = <[u32; LANES]>::try_from(eight)
                    .unwrap_or_else(|_| std::array::from_fn(|k| eight.get(k).copied().unwrap_or(i as u32)));
                let [other_x, other_y] = l.points(position, &at);
                let (across, up) = (l.difference(x, other_x), l.difference(y, other_y));
                let (dx, dy) = (l.add(l.mul(across, unit_x), l.mul(up, tilt)), l.mul(up, unit_y));
                let reach = l.add(l.mul(half, l.add(own_size, l.numbers(size, &at))), skin);
                let mut near = l.bits(l.less(l.add(l.mul(dx, dx), l.mul(dy, dy)), l.mul(reach, reach)));
                while near != 0 {
                    let j = at[near.trailing_zeros() as usize];
                    near &= near - 1;
                    if j as usize != i {
                        found.push((particles.id[j as usize] as u64) << 32 | j as u64);
                    }
                }
            }
            append_sorted(found, neighbors);
            ends.push(neighbors.len());
        }
        Part::new(disks.start as u32, neighbors, ends, |point| tagged(point, tags[point as usize].into()))
    }
}

/// Appends the lower halves of different numbers in ascending order. The place of each is how many are less: of few
/// numbers that is counted sooner, eight at a time, than they are sorted by comparisons that nobody can foresee.
#[inline(always)]
fn append_sorted(numbers: &mut Vec<u64>, sorted: &mut Vec<u32>) {
    let (n, begin) = (numbers.len(), sorted.len());
    if n > 64 {
        numbers.sort_unstable();
        sorted.extend(numbers.iter().map(|&number| number as u32));
        return;
    }
    numbers.resize(n.next_multiple_of(LANES), u64::MAX);
    // what fills up the last eight goes to the place behind all others
    sorted.resize(begin + n + 1, 0);
    for eight in numbers.chunks_exact(LANES) {
        let mut less = [0u64; LANES];
        for &other in &numbers[..n] {
            for k in 0..LANES {
                less[k] += u64::from(other < eight[k]);
            }
        }
        for k in 0..LANES {
            sorted[begin + less[k] as usize] = eight[k] as u32;
        }
    }
    sorted.truncate(begin + n);
}

/// The different sizes among these, if there are no more than tags; else none.
fn few_sizes(sizes: &[f64]) -> Vec<f64> {
    let add = |mut found: Vec<f64>, size: f64| {
        if found.len() <= TAGS && !found.contains(&size) {
            found.push(size);
        }
        found
    };
    let of = |range: Range<usize>| sizes[range].iter().copied().fold(Vec::new(), add);
    let found = threads::reduce(0..sizes.len(), &of, &|a, b| b.into_iter().fold(a, add));
    if found.len() <= TAGS { found } else { Vec::new() }
}

impl Part {
    /// Of the disks from `first` on, the neighbours of which stand one after another and end at `ends`.
    fn new(first: u32, neighbors: &[u32], ends: &[usize], entry: impl Fn(u32) -> Tagged) -> Part {
        let n = ends.len();
        let row = |i: usize| &neighbors[if i > 0 { ends[i - 1] } else { 0 }..ends[i]];
        let order = by_length(n, |i| row(i).len());
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
            part.rows.push(own.map(|i| entry(first + i as u32)));
            for k in 0..row(own[0]).len() {
                part.rows.push(own.map(|i| entry(row(i).get(k).copied().unwrap_or(first + i as u32))));
            }
            part.start.push(part.rows.len() as u32);
            eight.iter().enumerate().for_each(|(lane, &i)| part.place[i] = (slice * LANES + lane) as u16);
        }
        part
    }

    #[inline(always)]
    fn slice(&self, s: usize) -> &[[Tagged; LANES]] {
        &self.rows[self.start[s] as usize..self.start[s + 1] as usize]
    }
}

/// All i below `n`, those with the longest rows first, equals in their order.
fn by_length(n: usize, length: impl Fn(usize) -> usize) -> Vec<usize> {
    let longest = (0..n).map(&length).max().unwrap_or(0);
    let mut place = vec![0; longest + 2];
    (0..n).for_each(|i| place[longest - length(i) + 1] += 1);
    (0..=longest).for_each(|k| place[k + 1] += place[k]);
    let mut order = vec![0; n];
    for i in 0..n {
        let next = &mut place[longest - length(i)];
        order[*next] = i;
        *next += 1;
    }
    order
}

impl PointList for DiskList {
    fn for_each_point(&mut self, visit: impl Fn(&mut u32) + Sync + Send) {
        let of_entry = |entry: &mut Tagged| {
            let mut point = point_of(*entry);
            visit(&mut point);
            *entry = tagged(point, tag_of(*entry));
        };
        let of_part = |_: &mut (), _: usize, part: &mut Part| part.rows.iter_mut().flatten().for_each(of_entry);
        threads::for_each(&mut self.parts, of_part);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_count_of_numbers_is_sorted() {
        for n in 0..100u64 {
            let mut numbers: Vec<u64> = (0..n).map(|k| (k * 37 % 101) << 32 | k).collect();
            let mut right = numbers.clone();
            right.sort_unstable();
            let mut sorted = vec![7, 7];
            append_sorted(&mut numbers, &mut sorted);
            assert_eq!(sorted[..2], [7, 7]);
            assert!(sorted[2..].iter().copied().eq(right.iter().map(|&number| number as u32)), "{n} numbers");
        }
    }
}
