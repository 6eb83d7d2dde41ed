//! Work shared by the threads of one rank, with results that do not depend on their number.

use rayon::prelude::*;
use std::ops::Range;

/// A run of particles that one thread handles at a time.
#[derive(Clone, Debug, PartialEq)]
pub struct Chunk {
    pub particles: Range<usize>,
    /// Their points, contiguous.
    pub points: Range<usize>,
}

/// Arrays with one item per point, to be cut between two points.
pub trait Split: Sized + Send {
    fn split(self, at: usize) -> (Self, Self);
}

impl<T: Send> Split for &mut [T] {
    fn split(self, at: usize) -> (Self, Self) {
        self.split_at_mut(at)
    }
}

impl<A: Split, B: Split> Split for (A, B) {
    fn split(self, at: usize) -> (Self, Self) {
        let ((a_left, a_right), (b_left, b_right)) = (self.0.split(at), self.1.split(at));
        ((a_left, b_left), (a_right, b_right))
    }
}

/// Calls `work` on every chunk with that chunk's points of two arrays, and merges what it answers. `merge` must not
/// care about the order (exact sums and maxima do not).
pub fn fold<A: Send, B: Send, R: Send>(
    chunks: &[Chunk],
    a: &mut [A],
    b: &mut [B],
    work: &(impl Fn(&Chunk, &mut [A], &mut [B]) -> R + Sync),
    merge: &(impl Fn(R, R) -> R + Sync),
) -> Option<R> {
    fold_split(chunks, (a, b), &|chunk, (a, b)| work(chunk, a, b), merge)
}

/// [`fold`] over any number of arrays.
pub fn fold_split<S: Split, R: Send>(
    chunks: &[Chunk],
    arrays: S,
    work: &(impl Fn(&Chunk, S) -> R + Sync),
    merge: &(impl Fn(R, R) -> R + Sync),
) -> Option<R> {
    match chunks {
        [] => None,
        [chunk] => Some(work(chunk, arrays)),
        _ => {
            let (left, right) = chunks.split_at(chunks.len() / 2);
            let (a, b) = arrays.split(right[0].points.start - left[0].points.start);
            let (x, y) = if rayon::current_num_threads() == 1 {
                (fold_split(left, a, work, merge), fold_split(right, b, work, merge))
            } else {
                rayon::join(|| fold_split(left, a, work, merge), || fold_split(right, b, work, merge))
            };
            match (x, y) {
                (Some(x), Some(y)) => Some(merge(x, y)),
                (x, y) => x.or(y),
            }
        }
    }
}

/// What `work` gives for every chunk, in order.
pub fn map<R: Send>(chunks: &[Chunk], work: impl Fn(&Chunk) -> R + Sync + Send) -> Vec<R> {
    if rayon::current_num_threads() == 1 {
        return chunks.iter().map(work).collect();
    }
    chunks.par_iter().map(work).collect()
}

/// The same with arrays that `work` may use again from chunk to chunk: made anew for each, they would leave holes between
/// what it gives.
pub fn map_with<S: Default, R: Send>(chunks: &[Chunk], work: impl Fn(&mut S, &Chunk) -> R + Sync + Send) -> Vec<R> {
    if rayon::current_num_threads() == 1 {
        let scratch = &mut S::default();
        return chunks.iter().map(|chunk| work(scratch, chunk)).collect();
    }
    chunks.par_iter().map_init(S::default, work).collect()
}

/// Enough items to be worth handing to another thread.
const BLOCK: usize = 4096;

/// Whether the calling thread had better do it all.
fn alone(n: usize) -> bool {
    n <= BLOCK || rayon::current_num_threads() == 1
}

/// `value(i)` for all i below `n`, in order.
pub fn collect<T: Send>(n: usize, value: impl Fn(usize) -> T + Sync + Send) -> Vec<T> {
    if alone(n) {
        return (0..n).map(value).collect();
    }
    (0..n).into_par_iter().with_min_len(BLOCK).map(value).collect()
}

/// All i below `n` that `is_wanted`, ascending.
pub fn choose(n: usize, is_wanted: impl Fn(usize) -> bool + Sync + Send) -> Vec<u32> {
    let wanted = |i: usize| is_wanted(i).then_some(i as u32);
    if alone(n) {
        return (0..n).filter_map(wanted).collect();
    }
    (0..n).into_par_iter().with_min_len(BLOCK).filter_map(wanted).collect()
}

/// Calls `visit` on every item and its index, each of which is much work, with arrays that it may use again from item
/// to item.
pub fn for_each<S: Default, T: Send>(items: &mut [T], visit: impl Fn(&mut S, usize, &mut T) + Sync + Send) {
    if rayon::current_num_threads() == 1 {
        let scratch = &mut S::default();
        return items.iter_mut().enumerate().for_each(|(k, item)| visit(scratch, k, item));
    }
    items.par_iter_mut().enumerate().for_each_init(S::default, |scratch, (k, item)| visit(scratch, k, item));
}

/// Merges what `part` gives for runs that tile `range`. `merge` must not care about the order or about where the runs
/// are cut (exact sums and maxima do not).
pub fn reduce<R: Send>(
    range: Range<usize>,
    part: &(impl Fn(Range<usize>) -> R + Sync),
    merge: &(impl Fn(R, R) -> R + Sync),
) -> R {
    if alone(range.len()) {
        return part(range);
    }
    let middle = range.start + range.len() / 2;
    let (x, y) = rayon::join(|| reduce(range.start..middle, part, merge), || reduce(middle..range.end, part, merge));
    merge(x, y)
}

/// The largest of `value(i)` over all i below `n`, none of which is NaN or negative; 0 when there are none.
pub fn largest(n: usize, value: impl Fn(usize) -> f64 + Sync) -> f64 {
    reduce(0..n, &|range| range.map(&value).fold(0.0, f64::max), &f64::max)
}

/// Indices sorted by a bin in a table of rows and columns.
pub struct Binned {
    /// Where each bin starts in `items`, row by row; one entry more than there are bins.
    pub start: Vec<u32>,
    /// All indices, those of one bin in ascending order.
    pub items: Vec<u32>,
}

/// Sorts all i below `n` by their bin `[column, row]` in a table of `shape`.
///
/// First by rows, each thread a run of indices; then each row by columns, gathering what the runs have for it in their
/// order. Both are counting sorts that keep the order of equals, so that the outcome is that of one thread.
pub fn sort_by_bin(n: usize, shape: [usize; 2], bin: impl Fn(usize) -> [usize; 2] + Sync + Send) -> Binned {
    const RUN: usize = 1 << 16;
    let [columns, rows] = shape;
    let run = |k: usize| {
        let range = k * RUN..n.min((k + 1) * RUN);
        let bins: Vec<[u32; 2]> = range.clone().map(|i| bin(i).map(|b| b as u32)).collect();
        let mut end = vec![0u32; rows + 1];
        bins.iter().for_each(|&[_, row]| end[row as usize + 1] += 1);
        accumulate(&mut end);
        let mut sorted = vec![[0u32; 2]; bins.len()];
        for (i, &[column, row]) in range.zip(&bins) {
            let place = &mut end[row as usize];
            sorted[*place as usize] = [i as u32, column];
            *place += 1;
        }
        (end, sorted) // the rows end where they did begin, one place on
    };
    let n_runs = n.div_ceil(RUN);
    let runs: Vec<(Vec<u32>, Vec<[u32; 2]>)> =
        if alone(n) { (0..n_runs).map(run).collect() } else { (0..n_runs).into_par_iter().map(run).collect() };
    let of_row = |k: usize, row: usize| {
        let (end, sorted) = &runs[k];
        let begin = if row > 0 { end[row - 1] } else { 0 };
        &sorted[begin as usize..end[row] as usize]
    };

    let mut binned = Binned { start: vec![0; columns * rows + 1], items: vec![0; n] };
    binned.start[columns * rows] = n as u32;
    let mut work = Vec::with_capacity(rows);
    let (mut starts, mut items, mut begin) = (&mut binned.start[..], &mut binned.items[..], 0);
    for row in 0..rows {
        let here: usize = (0..n_runs).map(|k| of_row(k, row).len()).sum();
        let (row_starts, row_items);
        (row_starts, starts) = starts.split_at_mut(columns);
        (row_items, items) = items.split_at_mut(here);
        work.push((row, begin, row_starts, row_items));
        begin += here as u32;
    }
    let sort_row = |(row, begin, starts, items): (usize, u32, &mut [u32], &mut [u32])| {
        let all = || (0..n_runs).flat_map(|k| of_row(k, row));
        let mut next = vec![0u32; columns + 1];
        all().for_each(|&[_, column]| next[column as usize + 1] += 1);
        accumulate(&mut next);
        starts.iter_mut().zip(&next).for_each(|(start, &before)| *start = begin + before);
        for &[i, column] in all() {
            let place = &mut next[column as usize];
            items[*place as usize] = i;
            *place += 1;
        }
    };
    if alone(n) {
        work.into_iter().for_each(sort_row)
    } else {
        work.into_par_iter().for_each(sort_row)
    }
    binned
}

/// Replaces every number by the sum of those up to it.
fn accumulate(counts: &mut [u32]) {
    let mut sum = 0;
    for count in counts {
        sum += *count;
        *count = sum;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_number_of_threads_visits_every_point_once() {
        for threads in [1, 2, 3] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let run = |k: usize| 500 * k..500 * (k + 1);
            let cut: Vec<Chunk> = (0..10).map(|k| Chunk { particles: run(k), points: run(k) }).collect();
            let (mut a, mut b) = (vec![0u32; 5000], vec![(); 5000]);
            let total = pool.install(|| {
                fold(
                    &cut,
                    &mut a,
                    &mut b,
                    &|c, a, _| {
                        a.iter_mut().zip(c.points.clone()).for_each(|(x, p)| *x += p as u32);
                        a.iter().map(|&x| x as u64).sum::<u64>()
                    },
                    &|x, y| x + y,
                )
            });
            assert_eq!(total, Some(4999 * 5000 / 2));
            assert!(a.iter().enumerate().all(|(i, &x)| x == i as u32));
        }
    }

    #[test]
    fn any_number_of_threads_sorts_alike() {
        const N: usize = 200_000;
        let shape = [37, 53];
        let bin = |i: usize| [(i * 7919 + i / 11) % shape[0], (i * i / 3) % (shape[1] - 1)];
        let mut right: Vec<u32> = (0..N as u32).collect();
        let number = |i: u32| bin(i as usize)[1] * shape[0] + bin(i as usize)[0];
        right.sort_by_key(|&i| number(i));
        for threads in [1, 2, 4] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let Binned { start, items } = pool.install(|| sort_by_bin(N, shape, bin));
            assert_eq!(items, right);
            assert_eq!((start[0], start.len(), start[shape[0] * shape[1]]), (0, shape[0] * shape[1] + 1, N as u32));
            let begins = |b: usize| right.partition_point(|&i| number(i) < b) as u32;
            assert!(start.iter().enumerate().all(|(b, &at)| at == begins(b)));
            pool.install(|| {
                assert_eq!(choose(N, |i| i % 3 == 1), (0..N as u32).filter(|i| i % 3 == 1).collect::<Vec<_>>());
                assert_eq!(largest(N, |i| (i % 1000) as f64), 999.0);
                let mut squares = collect(N, |i| i * i);
                for_each(&mut squares, |_: &mut (), i, x| *x += i);
                assert!(squares.iter().enumerate().all(|(i, &x)| x == i * i + i));
            });
        }
        let empty = sort_by_bin(0, [2, 2], |_| [0, 0]);
        assert_eq!((empty.start, empty.items), (vec![0; 5], vec![]));
    }
}
