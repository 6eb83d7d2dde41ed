use super::{Near, OutlineFrame};
use crate::geometry::{PeriodicBox, Vec2, closest_on_segment, dot, norm, scale, sub};
use crate::particles::Particles;
use crate::threads::Chunk;

/// The pairs of the own particles of one chunk that can touch before any point has moved farther than a given travel,
/// in slots of the particle's [`OutlineFrame`]: far fewer than all pairs in range of the list.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NearTouches {
    first_particle: usize,
    /// For each own particle where its points and its pairs of each kind begin; then where the last one's end.
    start: Vec<[u32; 5]>,
    points: Vec<u32>,
    faces: Vec<[u16; 2]>,
    corners: Vec<[u16; 2]>,
    opposite_faces: Vec<[u16; 2]>,
    opposite_corners: Vec<[u16; 2]>,
    /// Own particles, by their place in the chunk, that have no frame: they or their neighbours reach around the box.
    wide: Vec<u32>,
}

/// What may touch one own particle. Each list is in the order of the other particles' global ids.
#[derive(Clone, Copy, Debug)]
pub struct Touching<'a> {
    /// Points of others in the frame.
    pub points: &'a [u32],
    /// Own vertices, and the edges of others which they may face.
    pub faces: &'a [[u16; 2]],
    /// Own vertices and vertices of others.
    pub corners: &'a [[u16; 2]],
    /// Vertices of others, and the own edges which they may face.
    pub opposite_faces: &'a [[u16; 2]],
    /// Vertices of others and own vertices.
    pub opposite_corners: &'a [[u16; 2]],
}

impl NearTouches {
    pub(super) fn new<'a>(
        pbox: &PeriodicBox,
        particles: &Particles,
        chunk: &Chunk,
        near: impl Fn(usize) -> Near<'a>,
        reach: f64,
        travel: f64,
    ) -> Self {
        let mut made = NearTouches { first_particle: chunk.particles.start, ..NearTouches::default() };
        let widths = pbox.widths();
        // what lies in one image stays there: the margin of the test is a twentieth of the box
        let far = travel > 0.02 * widths[0].min(widths[1]);
        let (mut frame, mut place) = (OutlineFrame::default(), Vec::new());
        made.start.push([0; 5]);
        for p in chunk.particles.clone() {
            let k = p - chunk.particles.start;
            let near = near(k);
            frame.fill(pbox, particles, p, near.points);
            let vertices = particles.bodies.points(p).len();
            if far || frame.slots() > u16::MAX as usize || !is_in_one_image(&frame, vertices, &near) {
                made.wide.push(k as u32);
            } else {
                made.add(&frame, vertices, &near, reach + 2.0 * travel, 2.0 * travel, &mut place);
            }
            made.end_particle();
        }
        made
    }

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
        let from = [self.faces.len(), self.corners.len(), self.opposite_faces.len(), self.opposite_corners.len()];
        place.clear();
        place.resize(frame.slots(), 0);
        for &[i, e] in near.edges {
            let (vertex, edge) = (i as usize + 1, e as usize + first_other);
            let pair = Pair { frame, vertex, edge, approach };
            if pair.may_face(reach) {
                self.faces.push([vertex as u16, edge as u16]);
                place[edge..edge + 2].fill(1);
            }
            if pair.may_meet_start(reach) {
                self.corners.push([vertex as u16, edge as u16]);
                place[edge - 1..edge + 2].fill(1);
            }
        }
        for &[i, v] in near.vertices {
            let (edge, vertex) = (i as usize + 1, v as usize + first_other);
            let pair = Pair { frame, vertex, edge, approach };
            if pair.may_face(reach) {
                self.opposite_faces.push([vertex as u16, edge as u16]);
                place[vertex] = 1;
            }
            if pair.may_meet_start(reach) {
                self.opposite_corners.push([vertex as u16, edge as u16]);
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
        for pair in self.faces[from[0]..].iter_mut().chain(&mut self.corners[from[1]..]) {
            pair[1] = place[pair[1] as usize];
        }
        for pair in self.opposite_faces[from[2]..].iter_mut().chain(&mut self.opposite_corners[from[3]..]) {
            pair[0] = place[pair[0] as usize];
        }
    }

    fn end_particle(&mut self) {
        let ends = [
            self.points.len(),
            self.faces.len(),
            self.corners.len(),
            self.opposite_faces.len(),
            self.opposite_corners.len(),
        ];
        self.start.push(ends.map(|n| n as u32));
    }

    /// The pairs of an own particle of the chunk; nothing where it has no frame.
    #[inline(always)]
    pub fn of(&self, particle: usize) -> Option<Touching<'_>> {
        let k = particle - self.first_particle;
        if !self.wide.is_empty() && self.wide.binary_search(&(k as u32)).is_ok() {
            return None;
        }
        let (from, to) = (self.start[k], self.start[k + 1]);
        let range = |list: usize| from[list] as usize..to[list] as usize;
        Some(Touching {
            points: &self.points[range(0)],
            faces: &self.faces[range(1)],
            corners: &self.corners[range(2)],
            opposite_faces: &self.opposite_faces[range(3)],
            opposite_corners: &self.opposite_corners[range(4)],
        })
    }
}

/// Whether the plain differences of a frame are nearest-image vectors for all own edges and listed pairs.
fn is_in_one_image(frame: &OutlineFrame, vertices: usize, near: &Near) -> bool {
    let first_other = OutlineFrame::first_other(vertices);
    let consecutive = |k: usize| frame.are_in_one_image(k, k + 1);
    let from_origin = |k: usize| frame.are_in_one_image(k, 1);
    let pair = |[i, k]: [u32; 2]| {
        let (own, other) = (i as usize + 1, k as usize + first_other);
        frame.are_in_one_image(own, other) && frame.are_in_one_image(own + 1, other)
    };
    (0..=vertices).all(consecutive)
        && (0..frame.slots()).all(from_origin)
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

impl Pair<'_> {
    /// From the start of edge `slot` to the vertex, that vector along edge `edge`, and by how much the product of the
    /// two may still change: both factors by no more than `approach`.
    fn product(&self, slot: usize, edge: usize) -> (Vec2, f64, f64) {
        let f = self.frame;
        let from = [f.x[self.vertex] - f.x[slot], f.y[self.vertex] - f.y[slot]];
        let along = [f.along_x[edge], f.along_y[edge]];
        let product = dot(from, along);
        let change = self.approach * (norm(from) + norm(along) + self.approach);
        (from, product, change * (1.0 + 1e-12))
    }

    /// Whether the vertex may come within `reach` of the edge with its foot between the ends.
    fn may_face(&self, reach: f64) -> bool {
        let (from_a, forward, change) = self.product(self.edge, self.edge);
        let (_, beyond, change_at_end) = self.product(self.edge + 1, self.edge);
        if forward < -change || beyond > change_at_end {
            return false;
        }
        let along = [self.frame.along_x[self.edge], self.frame.along_y[self.edge]];
        let t = closest_on_segment(from_a, along);
        norm(sub(from_a, scale(t, along))) < reach
    }

    /// Whether the vertex may come within `reach` of the start of the edge, and there count as a corner: beyond the edge
    /// before and short of this one, or neither.
    fn may_meet_start(&self, reach: f64) -> bool {
        let (from_a, forward, change) = self.product(self.edge, self.edge);
        if norm(from_a) >= reach {
            return false;
        }
        let (_, beyond, change_before) = self.product(self.edge, self.edge - 1);
        let certain = forward.abs() > change && beyond.abs() > change_before;
        !certain || (beyond > 0.0) == (forward < 0.0)
    }
}
