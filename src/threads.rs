//! Work shared by the threads of one rank, without allocation, and with results that do not depend on their number.

use crate::particles::Bodies;
use std::ops::Range;

/// A run of particles that one thread handles at a time.
#[derive(Clone, Debug, PartialEq)]
pub struct Chunk {
    pub particles: Range<usize>,
    /// Their points, contiguous.
    pub points: Range<usize>,
}

/// Enough work to be worth handing to another thread.
const POINTS_PER_CHUNK: usize = 512;

/// Cuts `n` particles into runs of roughly equal numbers of points.
pub fn chunks(bodies: &Bodies, n: usize) -> Vec<Chunk> {
    let mut cut = Vec::new();
    let mut begin = 0;
    while begin < n {
        let first_point = bodies.points(begin).start;
        let mut end = begin;
        while end < n && bodies.points(end).end <= first_point + POINTS_PER_CHUNK.max(bodies.points(begin).len()) {
            end += 1;
        }
        cut.push(Chunk { particles: begin..end, points: first_point..bodies.points(end - 1).end });
        begin = end;
    }
    cut
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
    match chunks {
        [] => None,
        [chunk] => Some(work(chunk, a, b)),
        _ if rayon::current_num_threads() == 1 => {
            let origin = chunks[0].points.start;
            let part = |c: &Chunk| c.points.start - origin..c.points.end - origin;
            chunks.iter().map(|c| work(c, &mut a[part(c)], &mut b[part(c)])).reduce(merge)
        }
        _ => {
            let (left, right) = chunks.split_at(chunks.len() / 2);
            let cut = right[0].points.start - left[0].points.start;
            let (a_left, a_right) = a.split_at_mut(cut);
            let (b_left, b_right) = b.split_at_mut(cut);
            let (x, y) =
                rayon::join(|| fold(left, a_left, b_left, work, merge), || fold(right, a_right, b_right, work, merge));
            match (x, y) {
                (Some(x), Some(y)) => Some(merge(x, y)),
                (x, y) => x.or(y),
            }
        }
    }
}

/// What `work` gives for every chunk, in order.
pub fn map<R: Send>(chunks: &[Chunk], work: impl Fn(&Chunk) -> R + Sync + Send) -> Vec<R> {
    use rayon::prelude::*;
    if rayon::current_num_threads() == 1 {
        return chunks.iter().map(work).collect();
    }
    chunks.par_iter().map(work).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chunks_tile_the_points() {
        let first: Vec<u32> = (0..2001).map(|p| p * 13 + (p > 7) as u32 * 900).collect();
        for (bodies, n) in [(Bodies::Disks, 3000), (Bodies::Polygons { first }, 2000)] {
            let cut = chunks(&bodies, n);
            assert!(cut.len() > 4);
            assert_eq!(cut[0].particles.start, 0);
            assert!(
                cut.windows(2)
                    .all(|w| w[0].particles.end == w[1].particles.start && w[0].points.end == w[1].points.start)
            );
            assert_eq!(cut.last().unwrap().points.end, bodies.points(n - 1).end);
        }
        assert!(chunks(&Bodies::Disks, 0).is_empty());
    }

    #[test]
    fn any_number_of_threads_visits_every_point_once() {
        for threads in [1, 2, 3] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let cut = chunks(&Bodies::Disks, 5000);
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
}
