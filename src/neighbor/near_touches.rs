use super::{Near, OutlineFrame};
use crate::geometry::{Frac, PeriodicBox};
use crate::lanes::{Kernel, LANES, Lanes};
use crate::particles::Particles;
use crate::threads::Chunk;

/// The pairs of the own particles of one chunk that can touch before any point has moved farther than a given travel,
/// in slots of the particle's [`OutlineFrame`]: far fewer than all pairs in range of the list.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NearTouches {
    first_particle: usize,
    /// For each own particle where its points and its pairs of each kind begin; then where the last one's end.
    start: Vec<Start>,
    points: Vec<u32>,
    faces: Vec<[u16; 2]>,
    corners: Vec<[u16; 2]>,
    /// Own particles, by their place in the chunk, that have no frame: they or their neighbours reach around the box.
    wide: Vec<u32>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Start {
    points: u32,
    faces: Group,
    corners: Group,
}

/// Where pairs of one kind begin, how many are of an own vertex, and how many there are.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Group {
    start: u32,
    own: u16,
    all: u16,
}

impl Group {
    #[inline(always)]
    fn of<'a>(&self, pairs: &'a [[u16; 2]], next: &Group) -> Pairs<'a> {
        let padded = &pairs[self.start as usize..next.start as usize];
        Pairs { padded, own: self.own as usize, all: self.all as usize }
    }
}

/// What may touch one own particle.
#[derive(Clone, Copy, Debug)]
pub struct Touching<'a> {
    /// Points of others in the frame; the last one again up to a multiple of eight.
    pub points: &'a [u32],
    /// Vertices and the edges which they may face.
    pub faces: Pairs<'a>,
    /// Vertices and the vertices which they may meet.
    pub corners: Pairs<'a>,
}

/// Pairs of slots: first those of own vertices with something of others, then those of vertices of others with
/// something own, either in the order of the others' global ids.
#[derive(Clone, Copy, Debug)]
pub struct Pairs<'a> {
    /// The pairs, and then zeros up to a multiple of eight.
    pub padded: &'a [[u16; 2]],
    /// How many are of own vertices.
    pub own: usize,
    pub all: usize,
}

/// What pairs are picked from.
pub(super) struct Picking<'a, F> {
    pub pbox: &'a PeriodicBox,
    pub particles: &'a Particles,
    pub chunk: &'a Chunk,
    /// What is near the k-th particle of the chunk.
    pub near: F,
    /// Pairs closer than this touch.
    pub reach: f64,
    pub travel: f64,
    /// What is picked takes the place of what was there.
    pub made: &'a mut NearTouches,
    pub scratch: &'a mut Scratch,
}

/// One particle at work.
#[derive(Default)]
pub(super) struct Scratch {
    frame: OutlineFrame,
    /// For each slot of the frame whether it is used, then the slot that it becomes.
    place: Vec<u16>,
}

impl<'a, F: Fn(usize) -> Near<'a>> Kernel for Picking<'_, F> {
    type Output = ();

    #[inline(always)]
    fn run(self, l: impl Lanes) {
        let Picking { pbox, particles, chunk, near, reach, travel, made, scratch } = self;
        let Scratch { frame, place } = scratch;
        made.clear(chunk.particles.start);
        let widths = pbox.widths();
        // what lies in one image stays there: the margin of the test is a twentieth of the box
        let far = travel > 0.02 * widths[0].min(widths[1]);
        let range = Range { reach: reach + 2.0 * travel, approach: 2.0 * travel };
        for p in chunk.particles.clone() {
            let k = p - chunk.particles.start;
            let near = near(k);
            made.begin_particle();
            frame.fill(l, pbox, particles, p, near.points);
            let vertices = particles.bodies.points(p).len();
            let most = u16::MAX as usize;
            let slots = OutlineFrame::first_other(vertices) + near.points.len();
            let fits = slots <= most && near.edges.len() + near.vertices.len() <= most;
            if far || !fits || !is_in_one_image(particles, p, &near) {
                made.wide.push(k as u32);
            } else {
                made.add(l, frame, vertices, &near, range, place);
            }
        }
        made.begin_particle();
    }
}

impl NearTouches {
    /// Nothing, for the chunk that begins with own particle `first`. Arrays stay where they are, but for room that was
    /// not used last time: in the first steps after a rearrangement far more is picked than at rest.
    fn clear(&mut self, first: usize) {
        fn clear<T>(list: &mut Vec<T>) {
            let used = list.len();
            list.clear();
            list.shrink_to(2 * used);
        }
        let NearTouches { first_particle, start, points, faces, corners, wide } = self;
        *first_particle = first;
        clear(start);
        clear(points);
        clear(faces);
        clear(corners);
        clear(wide);
    }

    #[inline(always)]
    fn add(
        &mut self,
        l: impl Lanes,
        frame: &OutlineFrame,
        vertices: usize,
        near: &Near,
        range: Range,
        place: &mut Vec<u16>,
    ) {
        let first_other = OutlineFrame::first_other(vertices);
        let (faces, corners) = (self.faces.len(), self.corners.len());
        place.clear();
        place.resize(first_other + near.points.len(), 0);
        for pairs in near.edges.chunks(LANES) {
            let slots = slots(pairs, |[i, e]| [i as usize + 1, e as usize + first_other]);
            let [faces, corners] = range.may(l, frame, &slots, pairs.len());
            for [vertex, edge] in chosen(&slots, faces) {
                self.faces.push([vertex, edge]);
                place[edge as usize..edge as usize + 2].fill(1);
            }
            for [vertex, edge] in chosen(&slots, corners) {
                self.corners.push([vertex, edge]);
                place[edge as usize - 1..edge as usize + 2].fill(1);
            }
        }
        let own = [self.faces.len() - faces, self.corners.len() - corners];
        for pairs in near.vertices.chunks(LANES) {
            let slots = slots(pairs, |[i, v]| [v as usize + first_other, i as usize + 1]);
            let [faces, corners] = range.may(l, frame, &slots, pairs.len());
            for [vertex, edge] in chosen(&slots, faces) {
                self.faces.push([vertex, edge]);
                place[vertex as usize] = 1;
            }
            for [vertex, edge] in chosen(&slots, corners) {
                self.corners.push([vertex, edge]);
                place[vertex as usize] = 1;
            }
        }
        // only points that are used, in the order of the list; those side by side stay so
        let mut next = first_other as u16;
        for (slot, &point) in place[first_other..].iter_mut().zip(near.points) {
            if *slot == 1 {
                *slot = next;
                next += 1;
                self.points.push(point);
            }
        }
        let start = self.start.last_mut().expect("the particle that was begun");
        let begin = start.points as usize;
        if let Some(&last) = self.points[begin..].last() {
            self.points.resize(begin + (self.points.len() - begin).next_multiple_of(LANES), last);
        }
        let groups = [(&mut self.faces, &mut start.faces), (&mut self.corners, &mut start.corners)];
        for ((list, group), own) in groups.into_iter().zip(own) {
            let pairs = &mut list[group.start as usize..];
            let (of_own, of_others) = pairs.split_at_mut(own);
            of_own.iter_mut().for_each(|pair| pair[1] = place[pair[1] as usize]);
            of_others.iter_mut().for_each(|pair| pair[0] = place[pair[0] as usize]);
            (group.own, group.all) = (own as u16, pairs.len() as u16);
            list.resize(list.len().next_multiple_of(LANES), [0; 2]);
        }
    }

    fn begin_particle(&mut self) {
        let group = |pairs: &Vec<[u16; 2]>| Group { start: pairs.len() as u32, own: 0, all: 0 };
        self.start.push(Start {
            points: self.points.len() as u32,
            faces: group(&self.faces),
            corners: group(&self.corners),
        });
    }

    /// The pairs of an own particle of the chunk; nothing where it has no frame.
    #[inline(always)]
    pub fn of(&self, particle: usize) -> Option<Touching<'_>> {
        let k = particle - self.first_particle;
        if !self.wide.is_empty() && self.wide.binary_search(&(k as u32)).is_ok() {
            return None;
        }
        let (from, to) = (&self.start[k], &self.start[k + 1]);
        Some(Touching {
            points: &self.points[from.points as usize..to.points as usize],
            faces: from.faces.of(&self.faces, &to.faces),
            corners: from.corners.of(&self.corners, &to.corners),
        })
    }
}
/// Whether the plain differences of a frame are nearest-image vectors for all own edges and listed pairs, by a good
/// margin.
fn is_in_one_image(particles: &Particles, particle: usize, near: &Near) -> bool {
    // 0.45 of a period
    const MARGIN: u64 = 8_301_034_833_169_298_227;
    let own = particles.points_of(particle);
    let after = |i: usize| if i + 1 < own.len() { i + 1 } else { 0 };
    let from_origin = |point: &Frac| point.minus(own[0]);
    let of_own = |i: usize| from_origin(&own[i]);
    let of_other = |k: u32| from_origin(&particles.position[near.points[k as usize] as usize]);
    let together = |a: [i64; 2], b: [i64; 2]| {
        (0..2).all(|axis| a[axis].checked_sub(b[axis]).is_some_and(|d| d.unsigned_abs() < MARGIN))
    };
    let pair = |[i, k]: [u32; 2]| {
        let (i, other) = (i as usize, of_other(k));
        together(of_own(i), other) && together(of_own(after(i)), other)
    };
    // two that lie within half of it in any direction from the origin are together
    let is_close = |d: [i64; 2]| d.iter().all(|d| d.unsigned_abs() < MARGIN / 2);
    if (0..own.len()).all(|i| is_close(of_own(i))) && (0..near.points.len()).all(|k| is_close(of_other(k as u32))) {
        return true;
    }
    (0..own.len()).all(|i| together(of_own(i), of_own(after(i))) && together(of_own(i), [0; 2]))
        && (0..near.points.len()).all(|k| together(of_other(k as u32), [0; 2]))
        && near.edges.iter().all(|&[i, e]| pair([i, e]) && pair([i, e + 1]))
        && near.vertices.iter().all(|&p| pair(p))
}

/// Slots of the vertices and edges of up to eight pairs, the last one again up to eight.
#[inline(always)]
fn slots(pairs: &[[u32; 2]], slots_of: impl Fn([u32; 2]) -> [usize; 2]) -> [[u16; 2]; LANES] {
    let mut slots = [[0; 2]; LANES];
    for (k, slot) in slots.iter_mut().enumerate() {
        *slot = slots_of(pairs[k.min(pairs.len() - 1)]).map(|s| s as u16);
    }
    slots
}

/// Those of eight whose bits are set.
#[inline(always)]
fn chosen(slots: &[[u16; 2]; LANES], mut bits: u8) -> impl Iterator<Item = [u16; 2]> {
    std::iter::from_fn(move || {
        (bits != 0).then(|| {
            let k = bits.trailing_zeros() as usize;
            bits &= bits - 1;
            slots[k]
        })
    })
}

/// How near a vertex and an edge of another particle must be to be picked.
#[derive(Clone, Copy)]
struct Range {
    reach: f64,
    /// Either may come closer to the other by this.
    approach: f64,
}

impl Range {
    /// Which of the first `count` of eight vertices may come within reach of their edges with their foot between the ends; and
    /// which within reach of the start of the edge, and there count as a corner: beyond the edge before and short of this one,
    /// or neither.
    ///
    /// What decides is the sign of products of two vectors, each of which may still change by `approach`.
    #[inline(always)]
    fn may<L: Lanes>(self, l: L, frame: &OutlineFrame, slots: &[[u16; 2]; LANES], count: usize) -> [u8; 2] {
        let f = frame;
        let [at_x, at_y] = l.named_vectors::<false>(&f.at, slots);
        let [start_x, start_y] = l.named_vectors::<true>(&f.at, slots);
        let ([x, y], per_length) = (l.named_vectors::<true>(&f.along, slots), l.named::<true>(&f.per_length, slots));
        let (from_x, from_y) = (l.sub(at_x, start_x), l.sub(at_y, start_y));
        let zero = l.splat(0.0);
        let approach = l.splat((1.0 + 1e-12) * self.approach);
        let distance2 = l.add(l.mul(from_x, from_x), l.mul(from_y, from_y));
        let distance = l.sqrt(distance2);
        let length2 = l.add(l.mul(x, x), l.mul(y, y));
        let length = l.mul(length2, per_length);
        let near = l.add(distance, approach);
        let change = l.mul(approach, l.add(near, length));
        let forward = l.add(l.mul(from_x, x), l.mul(from_y, y));
        // no farther from the end than from the start and along the edge
        let change_at_end = l.add(change, l.mul(approach, length));
        let between = l.both(l.up_to(l.sub(zero, change), forward), l.up_to(l.sub(forward, length2), change_at_end));
        let foot = l.clamp_to_unit(l.mul(forward, l.mul(per_length, per_length)));
        let (apart_x, apart_y) = (l.sub(from_x, l.mul(foot, x)), l.sub(from_y, l.mul(foot, y)));
        let apart2 = l.add(l.mul(apart_x, apart_x), l.mul(apart_y, apart_y));
        let reach2 = l.splat(self.reach * self.reach);
        let counted = l.first(count);
        let faces = l.bits(l.both(counted, l.both(between, l.less(apart2, reach2))));
        let meets = l.bits(l.both(counted, l.less(distance2, reach2)));
        if meets == 0 {
            return [faces, 0];
        }
        let before = slots.map(|[vertex, edge]| [vertex, edge - 1]);
        let [x, y] = l.named_vectors::<true>(&f.along, &before);
        let per_length = l.named::<true>(&f.per_length, &before);
        let length = l.mul(l.add(l.mul(x, x), l.mul(y, y)), per_length);
        let change_before = l.mul(approach, l.add(near, length));
        let beyond = l.add(l.mul(from_x, x), l.mul(from_y, y));
        let is_certain = l.both(l.less(change, l.abs(forward)), l.less(change_before, l.abs(beyond)));
        let past = l.less(zero, beyond);
        let short = l.less(forward, zero);
        let past_one = l.bits(past) ^ l.bits(short);
        [faces, meets & !(l.bits(is_certain) & past_one)]
    }
}
