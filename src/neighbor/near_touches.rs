use super::{Near, OutlineFrame};
use crate::geometry::{Frac, PeriodicBox, closest_on_segment, dot, scale, sub};
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
}

impl<'a, F: Fn(usize) -> Near<'a>> Kernel for Picking<'_, F> {
    type Output = NearTouches;

    #[inline(always)]
    fn run(self, l: impl Lanes) -> NearTouches {
        let Picking { pbox, particles, chunk, near, reach, travel } = self;
        let mut made = NearTouches { first_particle: chunk.particles.start, ..NearTouches::default() };
        let widths = pbox.widths();
        // what lies in one image stays there: the margin of the test is a twentieth of the box
        let far = travel > 0.02 * widths[0].min(widths[1]);
        let (mut frame, mut place) = (OutlineFrame::default(), Vec::new());
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
                made.add(&frame, vertices, &near, reach + 2.0 * travel, 2.0 * travel, &mut place);
            }
        }
        made.begin_particle();
        made
    }
}

impl NearTouches {
    #[inline(always)]
    fn add(
        &mut self,
        frame: &OutlineFrame,
        vertices: usize,
        near: &Near,
        reach: f64,
        approach: f64,
        place: &mut Vec<u16>,
    ) {
        let first_other = OutlineFrame::first_other(vertices);
        let (faces, corners) = (self.faces.len(), self.corners.len());
        place.clear();
        place.resize(first_other + near.points.len(), 0);
        for &[i, e] in near.edges {
            let (vertex, edge) = (i as usize + 1, e as usize + first_other);
            let may = Pair { frame, vertex, edge, approach }.may(reach);
            if may.face {
                self.faces.push([vertex as u16, edge as u16]);
                place[edge..edge + 2].fill(1);
            }
            if may.meet_start {
                self.corners.push([vertex as u16, edge as u16]);
                place[edge - 1..edge + 2].fill(1);
            }
        }
        let own = [self.faces.len() - faces, self.corners.len() - corners];
        for &[i, v] in near.vertices {
            let (edge, vertex) = (i as usize + 1, v as usize + first_other);
            let may = Pair { frame, vertex, edge, approach }.may(reach);
            if may.face {
                self.faces.push([vertex as u16, edge as u16]);
                place[vertex] = 1;
            }
            if may.meet_start {
                self.corners.push([vertex as u16, edge as u16]);
                place[vertex] = 1;
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
    (0..own.len()).all(|i| together(of_own(i), of_own(after(i))) && together(of_own(i), [0; 2]))
        && (0..near.points.len()).all(|k| together(of_other(k as u32), [0; 2]))
        && near.edges.iter().all(|&[i, e]| pair([i, e]) && pair([i, e + 1]))
        && near.vertices.iter().all(|&p| pair(p))
}

/// A vertex and an edge of another particle in a frame; either may come closer to the other by `approach`.
struct Pair<'a> {
    frame: &'a OutlineFrame,
    vertex: usize,
    edge: usize,
    approach: f64,
}

struct May {
    face: bool,
    meet_start: bool,
}

impl Pair<'_> {
    /// Whether the vertex may come within `reach` of the edge with its foot between the ends; and within `reach` of the
    /// start of the edge, and there count as a corner: beyond the edge before and short of this one, or neither.
    ///
    /// What decides is the sign of products of two vectors, each of which may still change by `approach`.
    #[inline(always)]
    fn may(&self, reach: f64) -> May {
        const NOTHING: May = May { face: false, meet_start: false };
        let f = self.frame;
        let from = [f.x[self.vertex] - f.x[self.edge], f.y[self.vertex] - f.y[self.edge]];
        let along = [f.along_x[self.edge], f.along_y[self.edge]];
        let (from2, length2) = (dot(from, from), dot(along, along));
        let length = length2 * f.per_length[self.edge];
        let farthest = reach + length;
        if from2 >= farthest * farthest {
            return NOTHING;
        }
        let distance = from2.sqrt();
        let may_change = |a: f64, b: f64| (1.0 + 1e-12) * self.approach * (a + b + self.approach);
        let change = may_change(distance, length);
        let forward = dot(from, along);
        // no farther from the end than from the start and along the edge
        let may_face = forward >= -change && forward - length2 <= may_change(distance + length, length) && {
            let t = closest_on_segment(from, along);
            let apart = sub(from, scale(t, along));
            dot(apart, apart) < reach * reach
        };
        let may_meet_start = distance < reach && {
            let before = [f.along_x[self.edge - 1], f.along_y[self.edge - 1]];
            let length2 = dot(before, before);
            let length = length2 * f.per_length[self.edge - 1];
            let beyond = dot(from, before);
            let certain = forward.abs() > change && beyond.abs() > may_change(distance, length);
            !certain || (beyond > 0.0) == (forward < 0.0)
        };
        May { face: may_face, meet_start: may_meet_start }
    }
}
