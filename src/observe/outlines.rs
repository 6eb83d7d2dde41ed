//! The outline of the union of all particles, disks or polygons with their shells, particle by particle.
//!
//! Each particle is the union of capsules: circulo-lines along its edges, or one disk. (The inside of a polygon adds
//! nothing: outlines do not cross, so that no point at the outer side of a shell lies deeper than the shell in another
//! polygon.) Its outline consists of arcs about its vertices and segments beside its edges; the capsules of others, and
//! its own at corners that turn inwards, hide exactly known parts of them.
//!
//! Where outlines touch almost in parallel, the points where one enters the other are ill-defined along the outlines,
//! though not across them. Ends are therefore paired with the nearest start and joined by a straight line: what that
//! changes in an area is the square of the rounding, whatever the places.

use crate::engine::System;
use crate::geometry::{Capsule, Exposure, Frac, Hidden, PeriodicBox, Piece, Vec2, add, cross, dot, norm, scale, sub};
use crate::model::Model;
use crate::neighbor::{Candidates, CellList};
use crate::particles::Bodies;
use crate::threads::{self, Chunk};
use std::borrow::Cow;
use std::f64::consts::TAU;
use std::ops::Range;

/// How thick the particles of a system are.
#[derive(Clone, Copy, Debug)]
pub struct Thickness {
    /// Half the width of the circulo-lines; none for disks, whose size is their diameter.
    shell: Option<f64>,
    /// Overlaps less deep than this do not count: rounding must not decide whether parallel outlines hide each other.
    hair: f64,
}

impl Thickness {
    pub fn of<M: Model>(system: &System<M>) -> Thickness {
        let size = system.largest_size();
        match system.model.bodies() {
            Bodies::Disks => Thickness { shell: None, hair: HAIR * size },
            Bodies::Polygons { .. } => {
                let delta = system.model.range(size);
                Thickness { shell: Some(0.5 * delta), hair: (HAIR * (size.sqrt() + delta)).min(1e-3 * delta) }
            }
        }
    }

    /// Ends and starts that belong together are nearer to each other than this.
    pub fn widest_gap(&self) -> f64 {
        self.hair * 1e12
    }
}

/// Fifty times the rounding of a distance.
const HAIR: f64 = 1e-14;

/// A circulo-line with the arc about its first vertex, or a disk.
#[derive(Clone, Copy)]
struct Edge {
    id: u32,
    anchor: Frac,
    along: Vec2,
    length: f64,
    radius: f64,
    /// Direction in which the arc begins, and its angle: 0 at a corner that turns inwards.
    arc_from: f64,
    turn: f64,
}

impl Edge {
    fn disk(id: u32, anchor: Frac, radius: f64) -> Edge {
        Edge { id, anchor, along: [1.0, 0.0], length: 0.0, radius, arc_from: 0.0, turn: TAU }
    }

    fn pieces(&self) -> impl Iterator<Item = Piece> {
        let arc = Piece::Arc { radius: self.radius, from: self.arc_from, sweep: self.turn };
        let segment = Piece::Segment { radius: self.radius, along: self.along, length: self.length };
        [(self.turn > 0.0).then_some(arc), (self.length > 0.0).then_some(segment)].into_iter().flatten()
    }
}

/// A connected part of the outline of one particle, between two others that hide what lies before and behind it.
#[derive(Clone, Debug, PartialEq)]
pub struct Chain {
    /// Global id of the particle, and which of its chains this is.
    pub id: u32,
    pub number: u32,
    /// The edge on which it starts, on the rank that owns the particle.
    pub first_edge: u32,
    /// It has no ends; `after` and `before` mean nothing.
    pub is_closed: bool,
    pub start: Frac,
    pub end: Frac,
    /// From start to end, through periodic images if need be.
    pub reach: Vec2,
    pub length: f64,
    /// ½ ∮ r × dr about the start.
    pub area: f64,
    /// Global ids of the particles that hide the outline before the start and behind the end.
    pub after: u32,
    pub before: u32,
    /// Start, these points and end make a line through the inside of the particle that passes every point outside of it
    /// on the same side as the chain does.
    pub via: Vec<Frac>,
}

impl Chain {
    /// Goes on, in a straight line and then along something with this end, reach, length and area about its own start.
    fn extend(&mut self, pbox: &PeriodicBox, start: Frac, end: Frac, reach: Vec2, length: f64, area: f64) {
        self.advance(pbox.displacement(start, self.end), 0.0);
        self.advance(reach, area);
        self.end = end;
        self.length += length;
    }

    fn advance(&mut self, by: Vec2, area: f64) {
        self.area += 0.5 * cross(self.reach, by) + area;
        self.reach = add(self.reach, by);
    }

    /// Another chain follows this one.
    fn join(&mut self, pbox: &PeriodicBox, next: Chain) {
        self.via.extend([self.end, next.start]);
        self.extend(pbox, next.start, next.end, next.reach, next.length, next.area);
        self.via.extend(next.via);
        self.before = next.before;
    }

    fn close(&mut self, pbox: &PeriodicBox) {
        self.via.push(self.end);
        self.advance(pbox.displacement(self.start, self.end), 0.0);
        self.end = self.start;
        self.is_closed = true;
    }
}

/// The edges of all particles that this rank sees, binned. Disks are edges as they are, particle p edge p: what is many of
/// must not be stored twice.
pub struct Outlines<'a> {
    candidates: &'a Candidates<'a>,
    /// Whether each local particle counts.
    counts: Vec<bool>,
    /// Those of all polygons that count; none for disks.
    edges: Vec<Edge>,
    /// Edges of local polygon p: `first[p]..first[p + 1]`, none if it does not count; empty for disks.
    first: Vec<usize>,
    /// Of each edge; the centres of disks.
    midpoints: Cow<'a, [Frac]>,
    cells: CellList,
    /// Images of an edge besides the nearest that may touch another ([`PeriodicBox::images_within`]).
    images: Vec<Vec2>,
    hair: f64,
}

impl<'a> Outlines<'a> {
    /// Of the particles that `counts` wants, by global id.
    pub fn new(candidates: &'a Candidates<'a>, thickness: Thickness, counts: impl Fn(u32) -> bool) -> Self {
        let Candidates { pbox, particles, region, .. } = candidates;
        let counts: Vec<bool> = particles.id.iter().map(|&id| counts(id)).collect();
        let (mut edges, mut first) = (Vec::new(), Vec::new());
        let (midpoints, reach, longest) = match thickness.shell {
            None => {
                let largest = particles.size.iter().copied().fold(0.0, f64::max);
                (Cow::Borrowed(&particles.position[..]), largest, 0.0)
            }
            Some(radius) => {
                edges.reserve(particles.position.len());
                first.push(0);
                for (p, &counts) in counts.iter().enumerate() {
                    if counts {
                        push_edges(pbox, particles.id[p], particles.points_of(p), radius, &mut edges);
                    }
                    first.push(edges.len());
                }
                let midpoint = |e: &Edge| pbox.moved(e.anchor, scale(0.5 * e.length, e.along));
                let longest = edges.iter().map(|e| e.length).fold(0.0, f64::max);
                (edges.iter().map(midpoint).collect(), longest + 2.0 * radius, longest)
            }
        };
        let cells = CellList::new(pbox, region, &midpoints, reach.max(f64::MIN_POSITIVE));
        let images = pbox.images_within(reach + longest);
        Outlines { candidates, counts, edges, first, midpoints, cells, images, hair: thickness.hair }
    }

    fn is_disks(&self) -> bool {
        self.first.is_empty()
    }

    fn edge(&self, e: usize) -> Edge {
        if self.is_disks() {
            let particles = self.candidates.particles;
            return Edge::disk(particles.id[e], particles.position[e], 0.5 * particles.size[e]);
        }
        self.edges[e]
    }

    /// Edges of a local particle that counts.
    fn edges_of(&self, p: usize) -> Range<usize> {
        if self.is_disks() { p..p + 1 } else { self.first[p]..self.first[p + 1] }
    }

    /// Visits all edges whose midpoints are near that of an edge, and others, of particles that count.
    fn for_each_near(&self, e: usize, mut visit: impl FnMut(u32)) {
        self.cells.for_each_near(self.midpoints[e], |c| {
            if !self.is_disks() || self.counts[c as usize] {
                visit(c);
            }
        });
    }

    /// What `of` says about every own particle that counts, in the order of storage; `take` is given a few particles
    /// at a time.
    fn in_parts<R: Send, Of: IntoIterator<Item = R>>(
        &self,
        of: impl Fn(usize) -> Of + Sync,
        mut take: impl FnMut(Vec<Vec<R>>),
    ) {
        // enough for all threads, and little beside the whole
        const FEW: usize = 16;
        let counting = |chunk: &Chunk| chunk.particles.clone().filter(|&p| self.counts[p]);
        for chunks in self.candidates.chunks.chunks(FEW) {
            take(threads::map(chunks, |chunk| counting(chunk).flat_map(&of).collect()));
        }
    }

    /// The parts of the outlines of own particles that no particle hides, particle after particle. They are too many
    /// to be there all at once: `take` is given those of a few particles at a time, which are near each other and near
    /// those before, as particles are stored.
    pub fn chains(&self, mut take: impl FnMut(Vec<Chain>)) {
        let of = |p: usize| {
            let pieces = self.own_pieces(p, |e, hiding| self.for_each_near(e, |c| hiding.push(c)));
            self.assembled(&pieces)
        };
        self.in_parts(of, |parts| take(parts.into_iter().flatten().collect()));
    }

    /// For each own particle the area that it covers and no particle with a lower global id does. Their sum over all
    /// particles is the area of the union, whatever the multiplicity of overlaps.
    pub fn shares(&self) -> Vec<f64> {
        let mut shares = Vec::new();
        self.in_parts(|p| [self.share(p)], |parts| parts.iter().for_each(|part| shares.extend(part)));
        shares
    }

    fn share(&self, p: usize) -> f64 {
        let own = self.edges_of(p);
        let id = self.candidates.particles.id[p];
        let pbox = self.candidates.pbox;
        let first = self.edge(own.start);
        // all from here on lies about the first vertex as the outline leads there: the nearest image may be another where
        // particles are as large as the box
        let mut here = [0.0; 2];
        let mut anchors = Vec::with_capacity(own.len());
        for e in own.clone() {
            let edge = self.edge(e);
            anchors.push(pbox.image_near(edge.anchor, first.anchor, here));
            here = add(anchors[e - own.start].0, scale(edge.length, edge.along));
        }
        // the edges of lower ones near it, each as often as there are images of it there
        let mut lower = Vec::new();
        for (e, &(anchor, _)) in own.clone().zip(&anchors) {
            self.for_each_near(e, |c| {
                let other = self.edge(c as usize);
                if other.id < id {
                    self.starts(e, c as usize).for_each(|start| {
                        let (at, periods) = pbox.image_near(other.anchor, first.anchor, add(anchor, start));
                        lower.push((other.id, c, periods, at));
                    });
                }
            });
        }
        lower.sort_unstable_by_key(|&(id, c, periods, _)| (id, c, periods));
        lower.dedup_by_key(|&mut (_, c, periods, _)| (c, periods));
        let mut area = 0.0;
        let (mut ends, mut starts) = (Vec::new(), Vec::new());
        let pieces = self.own_pieces(p, |_, hiding| {
            hiding.extend(own.clone().map(|c| c as u32));
            hiding.extend(lower.iter().map(|&(_, c, ..)| c));
        });
        for chain in self.assembled(&pieces) {
            let (anchor, _) = anchors[chain.first_edge as usize - own.start];
            let near = add(anchor, pbox.displacement(chain.start, self.edge(chain.first_edge as usize).anchor));
            let (start, _) = pbox.image_near(chain.start, first.anchor, near);
            area += 0.5 * cross(start, chain.reach) + chain.area;
            if !chain.is_closed {
                starts.push(start);
                ends.push(add(start, chain.reach));
            }
        }
        // what the lower ones leave is bounded by their outlines too, where those run inside this particle
        let (mut parts, mut near) = (Vec::new(), Vec::new());
        for &(_, e, _, anchor) in &lower {
            let edge = self.edge(e as usize);
            // own edges that this image of it is near to, and where they start from there
            near.clear();
            near.extend(own.clone().flat_map(|c| {
                let there = sub(anchors[c - own.start].0, anchor);
                let is_there = move |start: &Vec2| norm(sub(*start, there)) < edge.radius;
                self.starts(e as usize, c).filter(is_there).map(move |start| (c, start))
            }));
            for piece in edge.pieces() {
                parts.clear();
                near.iter().for_each(|&(c, start)| self.hide_from(e as usize, &piece, c, start, &mut parts));
                if parts.is_empty() {
                    continue;
                }
                let outside = Exposure::of(&mut parts, piece.extent()).parts;
                parts.clear();
                parts.extend(outside.iter().map(|part| Hidden { from: part.from, to: part.to, by: id }));
                lower.iter().for_each(|&(_, c, ..)| self.hide(e as usize, &piece, c as usize, &mut parts));
                for part in Exposure::of(&mut parts, piece.extent()).parts {
                    let [from, to] = [part.from, part.to].map(|place| add(anchor, piece.point(place)));
                    area += 0.5 * cross(to, from) - piece.bulge(part.from, part.to);
                    starts.push(to);
                    ends.push(from);
                }
            }
        }
        let distance = |e: usize, s: usize| norm(sub(starts[s], ends[e]));
        for (e, s) in nearest_pairs(ends.len(), starts.len(), distance) {
            area += 0.5 * cross(ends[e], starts[s]);
        }
        area
    }

    /// Exposures of the pieces of a particle in order, with their edges. `may_hide` names the edges to look at.
    fn own_pieces(&self, p: usize, may_hide: impl Fn(usize, &mut Vec<u32>)) -> Vec<(usize, Piece, Exposure)> {
        let (mut hiding, mut hidden) = (Vec::new(), Vec::new());
        let mut pieces = Vec::new();
        for e in self.edges_of(p) {
            hiding.clear();
            may_hide(e, &mut hiding);
            for piece in self.edge(e).pieces() {
                hidden.clear();
                hiding.iter().for_each(|&c| self.hide(e, &piece, c as usize, &mut hidden));
                pieces.push((e, piece, Exposure::of(&mut hidden, piece.extent())));
            }
        }
        pieces
    }

    /// Vectors from the start of edge `e` to the starts of those images of edge `c` that may touch it, itself left out.
    fn starts(&self, e: usize, c: usize) -> impl Iterator<Item = Vec2> {
        let (edge, other) = (self.edge(e), self.edge(c));
        let nearest = self.candidates.pbox.displacement(other.anchor, edge.anchor);
        let reach = edge.length + other.length + edge.radius + other.radius;
        let others = self.images.iter().map(move |&by| add(nearest, by));
        (e != c).then_some(nearest).into_iter().chain(others).filter(move |s| dot(*s, *s) < reach * reach)
    }

    /// Adds the parts of a piece of edge `e` that the capsule of edge `c` hides.
    fn hide(&self, e: usize, piece: &Piece, c: usize, hidden: &mut Vec<Hidden>) {
        self.starts(e, c).for_each(|start| self.hide_from(e, piece, c, start, hidden));
    }

    /// The same for the image of edge `c` that starts at `start` from that of `e`.
    fn hide_from(&self, e: usize, piece: &Piece, c: usize, start: Vec2, hidden: &mut Vec<Hidden>) {
        let (edge, other) = (self.edge(e), self.edge(c));
        let is_disk = edge.length == 0.0 && other.length == 0.0;
        if is_disk && norm(start) + (edge.radius - other.radius).abs() <= self.hair {
            // of two equal disks at one place only the first is seen
            if other.id < edge.id {
                hidden.push(Hidden { from: 0.0, to: piece.extent(), by: other.id });
            }
            return;
        }
        // at its outer side a shell hides nothing by rounding alone; at its inner side a polygon follows
        let capsule = Capsule {
            along: other.along,
            length: other.length,
            radius: other.radius - self.hair,
            inner: other.radius + 3.0 * self.hair,
        };
        piece.inside(start, &capsule, |from, to| hidden.push(Hidden { from, to, by: other.id }));
    }

    /// The chains of one particle from the exposures of its pieces in order. Ends at its own capsules are joined.
    fn assembled(&self, pieces: &[(usize, Piece, Exposure)]) -> Vec<Chain> {
        let pbox = self.candidates.pbox;
        let Some((_, _, last)) = pieces.last() else { return Vec::new() };
        let is_open_at_the_seam = last.end_hidden_by.is_none() && pieces[0].2.start_hidden_by.is_none();
        let mut chains: Vec<Chain> = Vec::new();
        let mut current: Option<Chain> = None;
        let mut hidden_by = last.end_hidden_by;
        let end = |chain: Option<Chain>, before: u32, chains: &mut Vec<Chain>| {
            chains.extend(chain.map(|chain| Chain { before, ..chain }));
        };
        for (e, piece, exposure) in pieces {
            let edge = self.edge(*e);
            if let Some(by) = exposure.start_hidden_by {
                end(current.take(), by, &mut chains);
            }
            for part in &exposure.parts {
                let [from, to] = [part.from, part.to].map(|place| piece.point(place));
                let [start, stop] = [from, to].map(|point| pbox.moved(edge.anchor, point));
                if let Some(by) = part.after {
                    end(current.take(), by, &mut chains);
                }
                let chain = current.get_or_insert_with(|| Chain {
                    id: edge.id,
                    number: 0,
                    first_edge: *e as u32,
                    is_closed: false,
                    start,
                    end: start,
                    reach: [0.0; 2],
                    length: 0.0,
                    area: 0.0,
                    after: part.after.or(hidden_by).unwrap_or(edge.id),
                    before: edge.id,
                    via: Vec::new(),
                });
                let chord = [to[0] - from[0], to[1] - from[1]];
                let length = piece.length(part.from, part.to);
                chain.extend(pbox, start, stop, chord, length, piece.bulge(part.from, part.to));
                // a disk is convex: its chord is such a line
                if edge.length > 0.0 && chain.via.last() != Some(&edge.anchor) {
                    chain.via.push(edge.anchor);
                }
                if let Some(by) = part.before {
                    end(current.take(), by, &mut chains);
                }
            }
            hidden_by = exposure.end_hidden_by;
        }
        if let Some(mut chain) = current {
            match (is_open_at_the_seam, chains.is_empty()) {
                (true, true) => {
                    chain.close(pbox);
                    chains.push(chain);
                }
                (true, false) => {
                    chain.join(pbox, chains[0].clone());
                    chains[0] = chain;
                }
                (false, _) => end(Some(chain), pieces[0].2.start_hidden_by.unwrap_or_default(), &mut chains),
            }
        }
        let mut chains = self.joined_to_itself(chains);
        // what is shorter than the rounding of its ends is no chain
        chains.retain(|chain| chain.is_closed || chain.length > 100.0 * self.hair);
        chains.iter_mut().zip(0..).for_each(|(chain, number)| chain.number = number);
        chains
    }

    /// The chains of one particle, joined where the particle itself hides what follows.
    fn joined_to_itself(&self, chains: Vec<Chain>) -> Vec<Chain> {
        let pbox = self.candidates.pbox;
        let select = |is_own: &dyn Fn(&Chain) -> bool| -> Vec<usize> {
            (0..chains.len()).filter(|&k| !chains[k].is_closed && is_own(&chains[k])).collect()
        };
        let ends = select(&|chain| chain.before == chain.id);
        let starts = select(&|chain| chain.after == chain.id);
        let distance = |e: usize, s: usize| norm(pbox.displacement(chains[starts[s]].start, chains[ends[e]].end));
        let (mut next, mut has_previous) = (vec![None; chains.len()], vec![false; chains.len()]);
        for (e, s) in nearest_pairs(ends.len(), starts.len(), distance) {
            next[ends[e]] = Some(starts[s]);
            has_previous[starts[s]] = true;
        }
        let mut chains: Vec<Option<Chain>> = chains.into_iter().map(Some).collect();
        let mut joined = Vec::new();
        // first those with a beginning, then those that bite their own tails
        for is_ring in [false, true] {
            for k in 0..chains.len() {
                if has_previous[k] != is_ring {
                    continue;
                }
                let Some(mut chain) = chains[k].take() else { continue };
                let mut at = next[k];
                while let Some(following) = at.and_then(|k| chains[k].take()) {
                    chain.join(pbox, following);
                    at = at.and_then(|k| next[k]);
                }
                if is_ring {
                    chain.close(pbox);
                }
                joined.push(chain);
            }
        }
        joined
    }
}

/// The edges of a polygon; of vertices at one place only the first counts.
fn push_edges(pbox: &PeriodicBox, id: u32, points: &[Frac], radius: f64, edges: &mut Vec<Edge>) {
    let begin = edges.len();
    for (i, &anchor) in points.iter().enumerate() {
        let vector = pbox.displacement(points[(i + 1) % points.len()], anchor);
        let length = norm(vector);
        if length > 0.0 {
            let along = scale(1.0 / length, vector);
            edges.push(Edge { id, anchor, along, length, radius, arc_from: 0.0, turn: 0.0 });
        }
    }
    let n = edges.len() - begin;
    if n == 0 {
        return edges.push(Edge::disk(id, points[0], radius));
    }
    for i in 0..n {
        let [before, after] = [edges[begin + (i + n - 1) % n].along, edges[begin + i].along];
        let turn = cross(before, after).atan2(dot(before, after));
        let edge = &mut edges[begin + i];
        edge.arc_from = (-before[0]).atan2(before[1]);
        edge.turn = turn.max(0.0);
    }
}

/// Pairs (end, start), each used once, the nearest first, until there are no more of one kind.
pub fn nearest_pairs(ends: usize, starts: usize, distance: impl Fn(usize, usize) -> f64) -> Vec<(usize, usize)> {
    let mut all: Vec<(f64, usize, usize)> =
        (0..ends).flat_map(|e| (0..starts).map(move |s| (e, s))).map(|(e, s)| (distance(e, s), e, s)).collect();
    all.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    let (mut end_taken, mut start_taken) = (vec![false; ends], vec![false; starts]);
    let mut pairs = Vec::new();
    for (_, e, s) in all {
        if !end_taken[e] && !start_taken[s] {
            (end_taken[e], start_taken[s]) = (true, true);
            pairs.push((e, s));
        }
    }
    pairs
}
