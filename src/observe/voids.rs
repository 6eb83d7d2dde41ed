use super::Contacts;
use super::outlines::{Chain, Outlines, Thickness, nearest_pairs};
use crate::comm::Comm;
use crate::engine::{EngineError, System};
use crate::geometry::{Frac, PeriodicBox, Polygon, Region, Vec2, add, cross, norm};
use crate::model::Model;
use crate::neighbor::CellList;
use crate::particles::Bodies;
use std::cell::OnceCell;
use std::f64::consts::PI;

/// A connected part of the box that no particle covers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Void {
    /// Different particles along its outer boundary; of a percolating one, along its whole boundary.
    pub sides: u32,
    pub area: f64,
    /// Length of its whole boundary, islands included.
    pub perimeter: f64,
    /// Clusters of particles that float in it.
    pub islands: u32,
    /// It is connected with a periodic image of itself, or nothing encloses it.
    pub percolates: bool,
}

impl Void {
    /// p²/4πa
    pub fn shape_parameter(&self) -> f64 {
        self.perimeter * self.perimeter / (4.0 * PI * self.area)
    }

    /// A gap between fewer than three particles is no void: where two shells face each other with uneven overlap, it
    /// lies inside one contact.
    fn is_sliver(&self) -> bool {
        self.sides < 3 && !self.percolates
    }
}

/// The voids of a state in numbers, the same on all ranks.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct VoidStatistics {
    /// All voids, slivers left out.
    pub n_voids: u64,
    pub n_percolating: u64,
    /// Gaps between fewer than three particles.
    pub n_slivers: u64,
    /// Areas of all voids and of all slivers; their sum is the area that particles leave.
    pub area: f64,
    pub sliver_area: f64,
    /// Numbers of voids with 3, 4, 5, 6 and more than 6 sides, percolating ones left out.
    pub with_sides: [u64; 5],
    /// Means over the voids with 3 sides; 0 if there are none. `border_radius` is the r of three touching arcs that
    /// enclose as much, a = (√3 − π/2) r²: the radius of a Plateau border.
    pub border_shape_parameter: f64,
    pub border_radius: f64,
}

impl VoidStatistics {
    /// Of the voids that all ranks have found. Collective.
    fn of(comm: &Comm, voids: &[Void]) -> Self {
        let row = |k: usize| -> [f64; 12] {
            let void = &voids[k];
            let mut row = [0.0; 12];
            let (kind, area) = match () {
                _ if void.is_sliver() => (2, 9),
                _ if void.percolates => (1, 8),
                _ => (void.sides.min(7) as usize, 8),
            };
            row[kind] = 1.0;
            row[0] = if void.is_sliver() { 0.0 } else { 1.0 };
            row[area] = void.area;
            if kind == 3 {
                row[10] = void.shape_parameter();
                row[11] = (void.area / (3.0f64.sqrt() - 0.5 * PI)).sqrt();
            }
            row
        };
        let [n_voids, n_percolating, n_slivers, three, four, five, six, more, area, sliver_area, shape, radius] =
            comm.sum_terms(voids.len(), row);
        let of_borders = |sum: f64| if three > 0.0 { sum / three } else { 0.0 };
        VoidStatistics {
            n_voids: n_voids as u64,
            n_percolating: n_percolating as u64,
            n_slivers: n_slivers as u64,
            area,
            sliver_area,
            with_sides: [three, four, five, six, more].map(|n| n as u64),
            border_shape_parameter: of_borders(shape),
            border_radius: of_borders(radius),
        }
    }

    /// The part of the box that voids and slivers fill.
    pub(super) fn filled(&self, pbox: &PeriodicBox) -> f64 {
        (self.area + self.sliver_area) / pbox.area()
    }

    /// That voids fill what particles leave of the box, an error if they do not.
    pub fn fill(&self, pbox: &PeriodicBox, packing_fraction: f64) -> Result<(), EngineError> {
        let (found, left) = (self.filled(pbox), 1.0 - packing_fraction);
        if (found - left).abs() > ROUNDING { Err(EngineError::Voids { found, left }) } else { Ok(()) }
    }

    /// P_l for l = 3, 4, 5, 6 and more: fractions of the voids that do not percolate; zeros without any.
    pub fn fractions(&self) -> [f64; 5] {
        let n = self.with_sides.iter().sum::<u64>().max(1) as f64;
        self.with_sides.map(|k| k as f64 / n)
    }
}

/// How well voids must fill what particles leave of the box. Where two circles touch with an overlap of δ, the angle at
/// which they meet is rounded to 10⁻¹⁶/√δ, which is 10⁻¹² at an onset; a void missed is larger than this by far.
const ROUNDING: f64 = 1e-9;

/// The voids of a state: connected parts of what the union of all particles (with their shells) leaves of the box.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Voids {
    /// Those that this rank has found, slivers left out; on one rank those with most sides first, then the largest.
    list: Vec<Void>,
    /// Of all ranks.
    pub statistics: VoidStatistics,
}

impl Voids {
    /// Of the particles whose global ids `removed` (ascending) does not hold. Collective.
    ///
    /// Every rank finds the outlines of its own particles and the voids among them. Rank 0 links what is left: voids
    /// between particles of several ranks, those wide enough for a particle to float in, and what floats.
    /// With no particle removed, the voids must fill what `packing_fraction` leaves of the box.
    pub fn of<M: Model>(
        system: &mut System<M>,
        removed: &[u32],
        packing_fraction: Option<f64>,
    ) -> Result<Voids, EngineError> {
        let thickness = Thickness::of(system);
        let counts = |id: u32| removed.binary_search(&id).is_err();
        let smallest_island = 0.5 * smallest_area(system);
        let widest = thickness.widest_gap();
        let Settling { mut voids, kept, open } = system.with_whole_neighbors(|seen| {
            let mut settling = Settling::default();
            let outlines = Outlines::new(seen, thickness, counts);
            outlines.chains(|chains| settling.add(seen.pbox, chains, widest, smallest_island));
            settling
        })?;
        let mut words = Vec::new();
        kept.iter().chain(&open).for_each(|chain| pack(chain, &mut words));
        drop((kept, open));
        let parts = system.comm.gather(words);
        let mut is_linked = true;
        if system.comm.is_root() {
            let mut chains: Vec<Chain> = parts.iter().flat_map(|words| unpack(words)).collect();
            drop(parts);
            sort_chains(&mut chains);
            match Linked::new(system.pbox(), &chains, widest) {
                Some(linked) => voids.extend(linked.voids(smallest_island)),
                None => is_linked = false,
            }
        }
        let is_linked = !system.comm.any(!is_linked);
        let statistics = VoidStatistics::of(&system.comm, &voids);
        if !is_linked {
            return Err(EngineError::OpenVoids);
        }
        if let Some(packing_fraction) = packing_fraction {
            statistics.fill(system.pbox(), packing_fraction)?;
        }
        voids.retain(|void| !void.is_sliver());
        sort(&mut voids);
        Ok(Voids { list: voids, statistics })
    }

    /// All of them on rank 0, slivers left out, those with most sides first, then the largest; none on other ranks.
    /// Collective.
    pub fn on_root(&self, comm: &Comm) -> Vec<Void> {
        let words = self.list.iter().flat_map(|void| {
            let counts = (void.sides as u64) << 32 | void.islands as u64;
            [counts, void.percolates as u64, void.area.to_bits(), void.perimeter.to_bits()]
        });
        let all = comm.gather(words.collect()).concat();
        let void = |words: &[u64]| Void {
            sides: (words[0] >> 32) as u32,
            area: f64::from_bits(words[2]),
            perimeter: f64::from_bits(words[3]),
            islands: words[0] as u32,
            percolates: words[1] != 0,
        };
        let mut all: Vec<Void> = all.chunks_exact(4).map(void).collect();
        sort(&mut all);
        all
    }
}

/// By particle, in place.
fn sort_chains(chains: &mut [Chain]) {
    chains.sort_unstable_by_key(|chain| (chain.id, chain.number));
}

fn sort(voids: &mut [Void]) {
    let largest_first = |a: &Void, b: &Void| {
        b.sides.cmp(&a.sides).then(b.area.total_cmp(&a.area)).then(b.perimeter.total_cmp(&a.perimeter))
    };
    voids.sort_by(largest_first);
}

/// Of all particles the least area that one covers, less its shell unless that is all of it. Collective.
fn smallest_area<M: Model>(system: &System<M>) -> f64 {
    let (particles, pbox) = (system.particles(), system.pbox());
    let width = system.model.range(system.largest_size());
    let area = |p: usize| match particles.bodies {
        Bodies::Disks => 0.25 * PI * particles.size[p] * particles.size[p],
        Bodies::Polygons { .. } => {
            let polygon = Polygon::from_vertices(pbox, particles.points_of(p)).area();
            polygon.abs().max(0.25 * PI * width * width)
        }
    };
    let smallest = (0..particles.len()).map(area).fold(f64::INFINITY, f64::min);
    -system.comm.max(-smallest)
}

/// Outlines of particles, a few particles after the others, and the voids among them.
#[derive(Default)]
struct Settling {
    /// Those whose whole boundary is known and in which nothing can float.
    voids: Vec<Void>,
    /// Chains of all other boundaries that are known as a whole.
    kept: Vec<Chain>,
    /// Chains of boundaries that go on along particles that have not come yet.
    open: Vec<Chain>,
}

impl Settling {
    /// `new` are all chains of their particles. What comes out does not depend on which come together, but for the
    /// order.
    fn add(&mut self, pbox: &PeriodicBox, new: impl IntoIterator<Item = Chain>, widest: f64, smallest_island: f64) {
        let mut chains = std::mem::take(&mut self.open);
        chains.extend(new);
        sort_chains(&mut chains);
        let is_here = |id: u32| chains.binary_search_by_key(&id, |chain| chain.id).is_ok();
        let next = partners(pbox, &chains, widest, is_here);
        let mut previous = vec![NONE; chains.len()];
        (0..chains.len()).filter(|&k| next[k] != NONE).for_each(|k| previous[next[k] as usize] = k as u32);
        let mut is_used = vec![false; chains.len()];
        for end in (0..chains.len()).filter(|&k| next[k] == NONE) {
            let mut at = end as u32;
            while at != NONE {
                is_used[at as usize] = true;
                at = previous[at as usize];
            }
        }
        let (is_open, mut is_kept) = (is_used.clone(), vec![false; chains.len()]);
        for first in 0..chains.len() {
            if is_used[first] {
                continue;
            }
            let ring = Ring::from(pbox, &chains, &next, first, &mut is_used);
            if ring.winding == [0, 0] && ring.area <= 0.0 && -ring.area < smallest_island {
                self.voids.push(Void {
                    sides: different(ring.chains.iter().map(|&c| chains[c].id)),
                    area: -ring.area,
                    perimeter: ring.length,
                    islands: 0,
                    percolates: false,
                });
            } else {
                ring.chains.iter().for_each(|&c| is_kept[c] = true);
            }
        }
        for (k, chain) in chains.into_iter().enumerate() {
            match (is_open[k], is_kept[k]) {
                (true, _) => self.open.push(chain),
                (_, true) => self.kept.push(chain),
                _ => (),
            }
        }
    }
}

/// How many different ids there are.
fn different(ids: impl Iterator<Item = u32>) -> u32 {
    let mut ids: Vec<u32> = ids.collect();
    ids.sort_unstable();
    ids.dedup();
    ids.len() as u32
}

/// Global ids of all rattlers on all ranks, ascending, on every rank: what to remove for the voids of the backbone.
/// Collective. `contacts` must belong to the present state of `system`.
pub fn rattler_ids<M: Model>(system: &System<M>, contacts: &Contacts) -> Vec<u32> {
    let own = system.particles().id.iter().zip(&contacts.is_rattler);
    let words = own.filter(|(_, is_rattler)| **is_rattler).map(|(&id, _)| id as u64).collect();
    let mut ids = system.comm.gather(words).concat();
    ids.sort_unstable();
    let bytes = system.comm.broadcast(ids.into_iter().flat_map(|id| (id as u32).to_le_bytes()).collect());
    bytes.chunks_exact(4).map(|b| u32::from_le_bytes(std::array::from_fn(|k| b[k]))).collect()
}

fn pack(chain: &Chain, words: &mut Vec<u64>) {
    let place = |at: Frac| at.to_bits().map(|k| k as u64);
    words.push(chain.id as u64 | (chain.number as u64) << 32);
    words.push(chain.after as u64 | (chain.before as u64) << 32);
    words.extend(place(chain.start));
    words.extend(place(chain.end));
    words.extend([chain.reach[0], chain.reach[1], chain.length, chain.area].map(f64::to_bits));
    words.push((chain.via.len() as u64) << 1 | chain.is_closed as u64);
    words.extend(chain.via.iter().flat_map(|&at| place(at)));
}

fn unpack(words: &[u64]) -> Vec<Chain> {
    let place = |w: &[u64]| Frac::from_bits([w[0] as i64, w[1] as i64]);
    let mut chains = Vec::new();
    let mut rest = words;
    while let [head, ends, tail @ ..] = rest {
        let number = |k: usize| f64::from_bits(tail[k]);
        let (via, after) = tail[9..].split_at(2 * (tail[8] >> 1) as usize);
        chains.push(Chain {
            id: *head as u32,
            number: (head >> 32) as u32,
            first_edge: 0, // of no meaning here
            is_closed: tail[8] & 1 != 0,
            after: *ends as u32,
            before: (ends >> 32) as u32,
            start: place(&tail[0..]),
            end: place(&tail[2..]),
            reach: [number(4), number(5)],
            length: number(6),
            area: number(7),
            via: via.chunks_exact(2).map(place).collect(),
        });
        rest = after;
    }
    chains
}

/// A closed line of chains, the void on its right.
struct Ring {
    chains: Vec<usize>,
    start: Frac,
    /// From its start to its end: zero, or periods of the box if it winds around it.
    reach: Vec2,
    /// Those periods along the two box vectors.
    winding: [i64; 2],
    /// ½ ∮ r × dr about its start.
    area: f64,
    length: f64,
}

impl Ring {
    /// The one that `first` is on, where every chain has one that follows.
    fn from(pbox: &PeriodicBox, chains: &[Chain], next: &[u32], first: usize, is_used: &mut [bool]) -> Ring {
        let mut ring = Ring {
            chains: Vec::new(),
            start: chains[first].start,
            reach: [0.0; 2],
            winding: [0; 2],
            area: 0.0,
            length: 0.0,
        };
        let mut at = first;
        while !is_used[at] {
            is_used[at] = true;
            let chain = &chains[at];
            ring.chains.push(at);
            ring.area += 0.5 * cross(ring.reach, chain.reach) + chain.area;
            ring.reach = add(ring.reach, chain.reach);
            ring.length += chain.length;
            at = next[at] as usize;
            let gap = pbox.displacement(chains[at].start, chain.end);
            ring.area += 0.5 * cross(ring.reach, gap);
            ring.reach = add(ring.reach, gap);
        }
        let rows = (ring.reach[1] / pbox.ly()).round();
        let columns = ((ring.reach[0] - rows * pbox.xy()) / pbox.lx()).round();
        ring.winding = [columns as i64, rows as i64];
        ring
    }
}

/// All chains, linked to rings.
struct Linked<'a> {
    pbox: &'a PeriodicBox,
    chains: &'a [Chain],
    rings: Vec<Ring>,
}

impl<'a> Linked<'a> {
    /// Links every end with the start that follows it; nothing if some are left or lie farther apart than `widest`.
    fn new(pbox: &'a PeriodicBox, chains: &'a [Chain], widest: f64) -> Option<Self> {
        let next = successors(pbox, chains, widest)?;
        let mut is_used = vec![false; chains.len()];
        let mut rings = Vec::new();
        for first in 0..chains.len() {
            if !is_used[first] {
                rings.push(Ring::from(pbox, chains, &next, first, &mut is_used));
            }
        }
        Some(Linked { pbox, chains, rings })
    }

    fn voids(&self, smallest_island: f64) -> Vec<Void> {
        let mut enclosed = Vec::new();
        let mut islands = Vec::new();
        let mut winding = Vec::new();
        for (k, ring) in self.rings.iter().enumerate() {
            match () {
                _ if ring.winding != [0, 0] => winding.push(k),
                // rounding may turn a ring without area around
                _ if ring.area > smallest_island => islands.push(k),
                _ => enclosed.push(self.around(&[k])),
            }
        }
        let strips = self.strips(&winding);
        let mut found: Vec<Around> = enclosed.into_iter().chain(strips).collect();
        let n_strips = found.iter().filter(|void| void.percolates).count();
        let locator = Locator::new(self, &found);
        let mut outside = Vec::new();
        for &island in &islands {
            let at = self.rings[island].start;
            match locator.enclosing(self, &found, at) {
                Some(void) => found[void].islands.push(island),
                None => outside.push((island, at)),
            }
        }
        if !outside.is_empty() && n_strips == 0 {
            found.push(Around { rings: Vec::new(), islands: Vec::new(), area: self.pbox.area(), percolates: true });
        }
        let open: Vec<usize> = (0..found.len()).filter(|&k| found[k].percolates).collect();
        for (island, at) in outside {
            let surrounds = |&&k: &&usize| open.len() == 1 || locator.surrounds(self, &found[k], k, at);
            if let Some(&k) = open.iter().find(surrounds) {
                found[k].islands.push(island);
            }
        }
        found.iter().map(|void| self.measured(void)).collect()
    }

    /// What one ring encloses, or lies between two that wind around the box: area and boundary without islands.
    fn around(&self, rings: &[usize]) -> Around {
        let area = -self.signed_area(rings);
        let percolates = rings.len() > 1;
        let whole = self.pbox.area();
        // between two rings any number of boxes may seem to lie
        let area = if percolates { area - whole * ((area / whole).ceil() - 1.0) } else { area };
        Around { rings: rings.to_vec(), islands: Vec::new(), area, percolates }
    }

    /// ½ ∮ r × dr along rings whose windings cancel, joined by straight lines that are walked both ways.
    fn signed_area(&self, rings: &[usize]) -> f64 {
        let (mut area, mut at, mut place) = (0.0, [0.0; 2], self.rings[rings[0]].start);
        for &k in rings {
            let ring = &self.rings[k];
            let way = self.pbox.displacement(ring.start, place);
            area += 0.5 * cross(at, way);
            at = add(at, way);
            place = ring.start;
            area += 0.5 * cross(at, ring.reach) + ring.area;
            at = add(at, ring.reach);
        }
        area
    }

    /// The voids between rings that wind around the box: from each the nearest one that winds the other way.
    fn strips(&self, winding: &[usize]) -> Vec<Around> {
        let forward = |w: [i64; 2]| w > [0, 0];
        let ahead = winding.iter().filter(|&&k| forward(self.rings[k].winding));
        let strip = |&a: &usize| {
            let back = winding.iter().filter(|&&b| !forward(self.rings[b].winding));
            back.map(|&b| self.around(&[a, b])).min_by(|x, y| x.area.total_cmp(&y.area))
        };
        ahead.filter_map(strip).collect()
    }

    /// Corners of a line through particles that passes every point outside of all particles as these rings do, from the
    /// start of the first.
    fn corners(&self, rings: &[usize]) -> Vec<Vec2> {
        let (mut at, mut place) = ([0.0; 2], self.rings[rings[0]].start);
        let mut corners = vec![at];
        for &k in rings {
            for chain in self.rings[k].chains.iter().map(|&c| &self.chains[c]) {
                for &to in [&chain.start].into_iter().chain(&chain.via).chain([&chain.end]) {
                    at = add(at, self.pbox.displacement(to, place));
                    place = to;
                    corners.push(at);
                }
            }
            at = add(at, self.pbox.displacement(self.rings[k].start, place));
            place = self.rings[k].start;
            corners.push(at);
        }
        corners
    }

    fn measured(&self, void: &Around) -> Void {
        let rings = || void.rings.iter().chain(&void.islands).map(|&k| &self.rings[k]);
        let sides = if void.percolates { rings().collect::<Vec<_>>() } else { vec![&self.rings[void.rings[0]]] };
        let islands: f64 = void.islands.iter().map(|&k| self.rings[k].area).sum();
        Void {
            sides: different(sides.iter().flat_map(|ring| &ring.chains).map(|&c| self.chains[c].id)),
            area: void.area - islands,
            perimeter: rings().map(|ring| ring.length).sum(),
            islands: void.islands.len() as u32,
            percolates: void.percolates,
        }
    }
}

/// A void in the making.
struct Around {
    /// Its outer boundary; none where nothing encloses it.
    rings: Vec<usize>,
    islands: Vec<usize>,
    /// Islands included.
    area: f64,
    percolates: bool,
}

/// Rings that are longer than so many mean ones are looked at from everywhere, the others from nearby.
const LONG: f64 = 8.0;

/// Finds the voids around a point. The boundaries of those that it has looked at are kept: below the onset many islands
/// float in one void that is nearly as large as the box.
struct Locator {
    boundaries: Vec<OnceCell<Boundary>>,
    /// Places of voids with short rings, and which voids these are.
    cells: CellList,
    short: Vec<usize>,
    long: Vec<usize>,
}

impl Locator {
    fn new(linked: &Linked, voids: &[Around]) -> Self {
        let ring = |k: usize| &linked.rings[voids[k].rings[0]];
        let enclosed: Vec<usize> = (0..voids.len()).filter(|&k| !voids[k].percolates).collect();
        let mean = enclosed.iter().map(|&k| ring(k).length).sum::<f64>() / enclosed.len() as f64;
        let (short, long): (Vec<usize>, Vec<usize>) =
            enclosed.into_iter().partition(|&k| ring(k).length <= LONG * mean);
        let starts: Vec<Frac> = short.iter().map(|&k| ring(k).start).collect();
        // nothing inside a ring is farther from its start than half its length
        let reach = short.iter().map(|&k| 0.5 * ring(k).length).fold(f64::MIN_POSITIVE, f64::max);
        Locator {
            boundaries: vec![OnceCell::new(); voids.len()],
            cells: CellList::new(linked.pbox, &Region::whole(), &starts, reach),
            short,
            long,
        }
    }

    /// The smallest enclosed void around a point that no particle covers.
    fn enclosing(&self, linked: &Linked, voids: &[Around], point: Frac) -> Option<usize> {
        let mut smallest: Option<usize> = None;
        let mut look = |k: usize| {
            let is_smaller = smallest.is_none_or(|s| voids[k].area < voids[s].area);
            if is_smaller && self.surrounds(linked, &voids[k], k, point) {
                smallest = Some(k);
            }
        };
        self.long.iter().for_each(|&k| look(k));
        self.cells.for_each_near(point, |i| look(self.short[i as usize]));
        smallest
    }

    /// Whether a point that no particle covers lies inside the `k`-th void or on one of its islands.
    fn surrounds(&self, linked: &Linked, void: &Around, k: usize, point: Frac) -> bool {
        if void.rings.is_empty() {
            return true;
        }
        self.boundaries[k].get_or_init(|| Boundary::of(linked, void)).surrounds(linked.pbox, point)
    }
}

/// A closed line that passes every point outside of all particles as the boundary of a void does.
#[derive(Clone)]
struct Boundary {
    /// Where it starts, the origin of all that follows.
    start: Frac,
    low: Vec2,
    high: Vec2,
    /// The edges that reach into each of the rows from `low` to `high`.
    rows: Vec<Vec<[Vec2; 2]>>,
    /// By how many boxes the area that it runs around differs from that of the void.
    boxes: i64,
}

impl Boundary {
    fn of(linked: &Linked, void: &Around) -> Self {
        let corners = linked.corners(&void.rings);
        let low = corners.iter().fold([f64::INFINITY; 2], |m, c| [m[0].min(c[0]), m[1].min(c[1])]);
        let high = corners.iter().fold([f64::NEG_INFINITY; 2], |m, c| [m[0].max(c[0]), m[1].max(c[1])]);
        let area = -linked.signed_area(&void.rings) - void.area;
        let boxes = (area / linked.pbox.area()).round() as i64;
        let rows = vec![Vec::new(); corners.len().isqrt()];
        let mut boundary = Boundary { start: linked.rings[void.rings[0]].start, low, high, rows, boxes };
        for (&a, &b) in corners.iter().zip(corners.iter().cycle().skip(1)) {
            let (first, last) = (boundary.row(a[1].min(b[1])), boundary.row(a[1].max(b[1])));
            boundary.rows[first..=last].iter_mut().for_each(|row| row.push([a, b]));
        }
        boundary
    }

    fn row(&self, y: f64) -> usize {
        let height = self.high[1] - self.low[1];
        let row = (y - self.low[1]) / height * self.rows.len() as f64;
        (row as usize).min(self.rows.len() - 1) // 0 where it has no height
    }

    fn surrounds(&self, pbox: &PeriodicBox, point: Frac) -> bool {
        let nearest = pbox.displacement(point, self.start);
        let steps = |low: f64, high: f64, step: f64| (low / step).ceil() as i64..=(high / step).floor() as i64;
        let mut turns = 0;
        for row in steps(self.low[1] - nearest[1], self.high[1] - nearest[1], pbox.ly()) {
            let x = nearest[0] + row as f64 * pbox.xy();
            for column in steps(self.low[0] - x, self.high[0] - x, pbox.lx()) {
                turns -= self.turns([x + column as f64 * pbox.lx(), nearest[1] + row as f64 * pbox.ly()]);
            }
        }
        turns - self.boxes > 0
    }

    /// How often it runs counter-clockwise around a point between `low` and `high`.
    fn turns(&self, point: Vec2) -> i64 {
        let mut turns = 0;
        for [a, b] in &self.rows[self.row(point[1])] {
            let side = cross([b[0] - a[0], b[1] - a[1]], [point[0] - a[0], point[1] - a[1]]);
            if a[1] <= point[1] && b[1] > point[1] && side > 0.0 {
                turns += 1;
            } else if a[1] > point[1] && b[1] <= point[1] && side < 0.0 {
                turns -= 1;
            }
        }
        turns
    }
}

/// Beyond this many ends without a partner something is wrong, and pairing by distance alone would take too long.
const FEW: usize = 2000;

/// No chain.
const NONE: u32 = u32::MAX;

/// For every chain the one that follows; nothing if one has none.
fn successors(pbox: &PeriodicBox, chains: &[Chain], widest: f64) -> Option<Vec<u32>> {
    let mut next = partners(pbox, chains, widest, |_| true);
    let mut is_followed = vec![false; chains.len()];
    next.iter().filter(|&&start| start != NONE).for_each(|&start| is_followed[start as usize] = true);
    let ends: Vec<usize> = (0..chains.len()).filter(|&k| next[k] == NONE).collect();
    let starts: Vec<usize> = (0..chains.len()).filter(|&k| !is_followed[k]).collect();
    if ends.len() > FEW {
        return None;
    }
    // what rounding has left over
    let gap = |i: usize, j: usize| norm(pbox.displacement(chains[starts[j]].start, chains[ends[i]].end));
    for (i, j) in nearest_pairs(ends.len(), starts.len(), gap) {
        if gap(i, j) >= widest {
            return None;
        }
        next[ends[i]] = starts[j] as u32;
    }
    Some(next)
}

/// The particle that hides what follows a chain, or what precedes it.
type Other = fn(&Chain) -> u32;

/// The ids of the particle of a chain and of another.
fn pair(chain: &Chain, other: u32) -> (u32, u32) {
    (chain.id.min(other), chain.id.max(other))
}

/// For every chain the one that follows, itself if it is closed, or [`NONE`]. The end of a chain of p that q hides is
/// the start of one of q that p hides before: those of one pair of particles, both of them here, are matched.
fn partners(pbox: &PeriodicBox, chains: &[Chain], widest: f64, is_here: impl Fn(u32) -> bool) -> Vec<u32> {
    let number = |k: usize| if chains[k].is_closed { k as u32 } else { NONE };
    let mut next: Vec<u32> = (0..chains.len()).map(number).collect();
    let between = |k: u32, other: Other| pair(&chains[k as usize], other(&chains[k as usize]));
    let by_pair = |other: Other| -> Vec<u32> {
        let is_open = |&k: &u32| !chains[k as usize].is_closed && is_here(other(&chains[k as usize]));
        let mut open: Vec<u32> = (0..chains.len() as u32).filter(is_open).collect();
        open.sort_unstable_by_key(|&k| (between(k, other), k));
        open
    };
    let (before, after): (Other, Other) = (|chain| chain.before, |chain| chain.after);
    let (ends, starts) = (by_pair(before), by_pair(after));
    let (mut ends, mut starts) = (&ends[..], &starts[..]);
    while let Some(key) = [ends.first().map(|&k| between(k, before)), starts.first().map(|&k| between(k, after))]
        .into_iter()
        .flatten()
        .min()
    {
        let (these_ends, these_starts);
        (these_ends, ends) = ends.split_at(ends.iter().take_while(|&&k| between(k, before) == key).count());
        (these_starts, starts) = starts.split_at(starts.iter().take_while(|&&k| between(k, after) == key).count());
        let gap = |i: usize, j: usize| {
            let (end, start) = (&chains[these_ends[i] as usize], &chains[these_starts[j] as usize]);
            norm(pbox.displacement(start.start, end.end))
        };
        for (i, j) in nearest_pairs(these_ends.len(), these_starts.len(), gap) {
            if gap(i, j) < widest {
                next[these_ends[i] as usize] = these_starts[j];
            }
        }
    }
    next
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{Deformable, DeformableParameters, Harmonic, SoftDisks, VertexEdge};
    use crate::neighbor::Candidates;
    use crate::observe::{PackingFraction, Rattlers, Shape};
    use crate::particles::Particles;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn disks(pbox: PeriodicBox, all: &[(Vec2, f64)]) -> System<SoftDisks> {
        let mut particles = Particles::empty(&Bodies::Disks);
        all.iter().enumerate().for_each(|(i, &(x, d))| particles.push(i as u32, d, &[pbox.frac(x)]));
        System::new(Comm::alone(), SoftDisks { epsilon: 1.0, smallest: 0.2 }, pbox, &pbox, particles, 0.1).unwrap()
    }

    fn polygons(pbox: PeriodicBox, all: &[Vec<Vec2>]) -> System<Deformable<VertexEdge>> {
        let mut particles = Particles::empty(&Bodies::Polygons { first: vec![0] });
        for (id, vertices) in all.iter().enumerate() {
            particles.push(id as u32, 1.0, &vertices.iter().map(|&v| pbox.frac(v)).collect::<Vec<_>>());
        }
        let contact = Harmonic { epsilon: 1.0, delta: 0.2 };
        let parameters =
            DeformableParameters { line_tension: 1.0, k_area: 1.0, contact, largest_area_per_vertex: 0.25 };
        System::new(Comm::alone(), Deformable::new(parameters), pbox, &pbox, particles, 0.1).unwrap()
    }

    /// With the check against ρ.
    fn voids<M: Model>(mut system: System<M>) -> Voids {
        let shapes: Vec<Shape> = system.outlines(Shape::of).unwrap();
        let rho = PackingFraction::of(&mut system, &shapes).unwrap().packing_fraction;
        Voids::of(&mut system, &[], Some(rho)).unwrap()
    }

    fn square(x: f64, y: f64, edge: f64) -> Vec<Vec2> {
        vec![[x, y], [x + edge, y], [x + edge, y + edge], [x, y + edge]]
    }

    /// (sides, islands, percolates) of all voids.
    fn kinds(voids: &Voids) -> Vec<(u32, u32, bool)> {
        voids.list.iter().map(|v| (v.sides, v.islands, v.percolates)).collect()
    }

    #[test]
    fn a_lone_particle_leaves_one_void() {
        let pbox = PeriodicBox::new(5.0, 4.5, 1.0);
        let v = voids(disks(pbox, &[([4.9, 4.4], 1.0)]));
        assert_eq!(kinds(&v), [(1, 1, true)]);
        assert!((v.list[0].area - (22.5 - 0.25 * PI)).abs() < 1e-13);
        assert!((v.list[0].perimeter - PI).abs() < 1e-14);
        let v = voids(polygons(pbox, &[square(4.5, 4.0, 1.0)]));
        assert_eq!(kinds(&v), [(1, 1, true)]);
        assert!((v.list[0].perimeter - (4.0 + 0.2 * PI)).abs() < 1e-14);
        assert_eq!(v.statistics.fractions(), [0.0; 5]);
    }

    #[test]
    fn nothing_touches_or_hardly() {
        let pbox = PeriodicBox::square(7.0);
        for gap in [0.5, 1e-9, 1e-15, 0.0, -1e-15, -1e-13, -1e-12, -1e-9, -0.1] {
            let v = voids(disks(pbox, &[([1.0, 1.0], 1.0), ([2.0 + gap, 1.0], 1.0), ([5.0, 5.0], 1.0)]));
            let islands = if gap < -1e-14 { 2 } else { 3 };
            assert_eq!((v.list.len(), v.list[0].sides, v.list[0].percolates), (1, 3, true), "{gap}");
            assert!(v.list[0].islands == islands || gap.abs() < 1e-12, "{gap}: {}", v.list[0].islands);
        }
    }

    /// n disks around a ring whose neighbours overlap.
    fn ring(center: Vec2, n: usize, diameter: f64) -> Vec<(Vec2, f64)> {
        let radius = 0.49 * diameter / (PI / n as f64).sin();
        let at = |k: usize| {
            let (sin, cos) = (2.0 * PI * k as f64 / n as f64).sin_cos();
            ([center[0] + radius * cos, center[1] + radius * sin], diameter)
        };
        (0..n).map(at).collect()
    }

    #[test]
    fn islands_belong_to_the_void_around_them() {
        let pbox = PeriodicBox::new(12.0, 11.0, 2.0);
        // a ring across the corner of the box; in it a smaller ring and in that a disk
        let mut all = ring([0.3, 0.2], 12, 1.0);
        all.extend(ring([0.4, 0.1], 5, 0.4));
        all.push(([0.4, 0.1], 0.2));
        all.push(([6.0, 5.0], 1.0));
        let v = voids(disks(pbox, &all));
        assert_eq!(kinds(&v), [(13, 2, true), (12, 1, false), (5, 1, false)]);
        let expected: f64 = pbox.area() * (1.0 - 1e-300) - v.list[0].area;
        assert!(v.list[1].area + v.list[2].area < expected);
        // what floats is no side; without the ring around it, it floats outside
        let mut system = disks(pbox, &all);
        let removed: Vec<u32> = (0..12).collect();
        assert_eq!(kinds(&Voids::of(&mut system, &removed, None).unwrap()), [(6, 2, true), (5, 1, false)]);
    }

    #[test]
    fn three_and_four_sides() {
        let pbox = PeriodicBox::square(9.0);
        let h = 0.75f64.sqrt();
        let v = voids(disks(pbox, &[([0.0, 0.0], 1.0 + 1e-9), ([1.0, 0.0], 1.0), ([0.5, h], 1.0 + 1e-9)]));
        assert_eq!(kinds(&v), [(3, 0, false), (3, 1, true)][..].iter().rev().copied().collect::<Vec<_>>());
        let border = v.list[1];
        assert!((border.area - (h / 2.0 - PI / 8.0)).abs() < 1e-8);
        // the closed form of a Plateau border
        assert!((border.shape_parameter() - PI / (4.0 * 3.0f64.sqrt() - 2.0 * PI)).abs() < 1e-3);
        assert!((v.statistics.border_radius - 0.5).abs() < 1e-6);
        assert_eq!(v.statistics.with_sides, [1, 0, 0, 0, 0]);
    }

    #[test]
    fn strips_between_chains_around_the_box() {
        // rows of five disks that touch through the boundary of a tilted box, and what floats between them
        let pbox = PeriodicBox::new(4.9, 9.0, 1.3);
        let row = |y: f64| (0..5).map(move |k| ([0.98 * k as f64 + 0.3, y], 1.0));
        let one: Vec<_> = row(2.0).chain([([1.0, 5.0], 0.5)]).collect();
        let v = voids(disks(pbox, &one));
        assert_eq!(kinds(&v), [(6, 1, true)]);
        let two: Vec<_> =
            row(2.0).chain(row(6.0)).chain([([1.0, 4.0], 0.5), ([2.0, 8.5], 0.4), ([0.9, 8.4], 0.4)]).collect();
        let v = voids(disks(pbox, &two));
        let mut found = kinds(&v);
        found.sort_unstable();
        assert_eq!(found, [(11, 1, true), (12, 2, true)]);
        assert_eq!((v.statistics.n_percolating, v.statistics.with_sides), (2, [0; 5]));
    }

    #[test]
    fn slivers_inside_a_contact_are_no_voids() {
        // two facing rectangles, one with a dent of two half lengths: their shells meet at both ends
        let pbox = PeriodicBox::square(9.0);
        let lower = vec![[1.0, 1.0], [4.0, 1.0], [4.0, 2.0], [2.5, 1.9], [1.0, 2.0]];
        let upper = vec![[1.0, 2.19], [4.0, 2.19], [4.0, 3.0], [1.0, 3.0]];
        let v = voids(polygons(pbox, &[lower, upper]));
        assert_eq!(kinds(&v), [(2, 1, true)]);
        assert_eq!(v.statistics.n_slivers, 1);
        assert!(v.statistics.sliver_area > 0.1);
    }

    #[test]
    fn parallel_facets_make_no_voids_by_rounding() {
        let pbox = PeriodicBox::square(9.0);
        for overlap in [-1e-9, -1e-15, 0.0, 1e-15, 1e-14, 2e-14, 1e-12, 1e-9, 1e-3] {
            for tilt in [0.0, 1e-15, 1e-12, 1e-9, 1e-6] {
                let x = 2.2 - overlap;
                let turned = vec![[x, 1.0], [x + 1.0, 1.0 + tilt], [x + 1.0 - tilt, 2.0 + tilt], [x - tilt, 2.0]];
                let v = voids(polygons(pbox, &[square(1.0, 1.0, 1.0), turned]));
                assert_eq!((v.list.len(), v.list[0].percolates), (1, true), "{overlap} {tilt}");
                assert!(v.statistics.sliver_area < 1e-12);
            }
        }
    }

    #[test]
    fn a_hexagonal_foam_has_plateau_borders() {
        let (n, cell, r) = (4, 0.6, 0.1);
        let pbox = PeriodicBox::new(2.0 * cell * n as f64, 3.0f64.sqrt() * cell * n as f64, cell * n as f64);
        let hexagon = |k: usize| -> Vec<Vec2> {
            let (i, j) = ((k % n) as f64, (k / n) as f64);
            let center = [2.0 * cell * i + cell * j, 3.0f64.sqrt() * cell * j];
            let corner = |m: usize| {
                let (sin, cos) = (2.0 * PI * (m as f64 + 0.5) / 6.0).sin_cos();
                let radius = (cell - r + 1e-9) / (PI / 6.0).cos();
                [center[0] + radius * cos, center[1] + radius * sin]
            };
            (0..6).map(corner).collect()
        };
        let v = voids(polygons(pbox, &(0..n * n).map(hexagon).collect::<Vec<_>>()));
        assert_eq!(v.statistics.with_sides, [2 * n as u64 * n as u64, 0, 0, 0, 0]);
        assert_eq!(v.statistics.n_voids, 32);
        assert!((v.statistics.border_radius - r).abs() < 1e-4, "{}", v.statistics.border_radius);
        assert!((v.statistics.border_shape_parameter - 4.8706).abs() < 0.01);
    }

    #[test]
    fn edges_that_are_long_for_their_box() {
        // bricks, three rows of three, each shifted against the one below: three meet in a T, where the place farthest
        // from all of them is 5/8 of the gaps away
        for (gap, shift, n_voids) in [(0.05, 0.2, 0), (0.1, 0.55, 0), (0.15, 0.3, 0), (0.17, 0.3, 18), (0.25, 0.4, 1)] {
            let period = 1.0 + gap;
            let pbox = PeriodicBox::new(3.0 * period, 3.0 * period, 3.0 * shift);
            let brick = |k: usize| {
                let (column, row) = ((k % 3) as f64, (k / 3) as f64);
                square(column * period + row * shift + 0.1, row * period - 0.3, 1.0)
            };
            let v = voids(polygons(pbox, &(0..9).map(brick).collect::<Vec<_>>()));
            assert_eq!(v.statistics.n_voids, n_voids, "{gap} {shift} {v:?}");
        }
    }

    #[test]
    fn parts_come_to_the_same_voids() {
        // enough disks to percolate but in places, with voids that are wide, narrow, and between few
        let pbox = PeriodicBox::new(12.0, 11.0, 2.0);
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let mut random = |low: f64, high: f64| low + (high - low) * (rng.next_u64() as f64 / 2f64.powi(64));
        let all: Vec<_> = (0..420).map(|_| ([random(0.0, 12.0), random(0.0, 11.0)], random(0.5, 1.0))).collect();
        let mut system = disks(pbox, &all);
        let thickness = Thickness::of(&system);
        let mut chains = Vec::new();
        let all_chains =
            |seen: &Candidates| Outlines::new(seen, thickness, |_| true).chains(|part| chains.extend(part));
        system.with_whole_neighbors(all_chains).unwrap();
        let come = |particles: usize| {
            let mut settling = Settling::default();
            let by_particle: Vec<_> = chains.chunk_by(|a, b| a.id == b.id).collect();
            for part in by_particle.chunks(particles) {
                settling.add(system.pbox(), part.concat(), thickness.widest_gap(), 0.2);
            }
            assert!(settling.open.is_empty());
            sort(&mut settling.voids);
            sort_chains(&mut settling.kept);
            (settling.voids, settling.kept)
        };
        let (voids, kept) = come(all.len());
        assert!(voids.len() > 10 && kept.len() > 10, "{} {}", voids.len(), kept.len());
        for particles in [1, 2, 7, 100] {
            assert!(come(particles) == (voids.clone(), kept.clone()), "{particles} at a time");
        }
    }

    #[test]
    fn without_rattlers() {
        let pbox = PeriodicBox::square(9.0);
        let h = 0.75f64.sqrt() * 0.99;
        // every disk of a triangle has two contacts, that of a tail has one
        let at = [[1.0, 1.0], [1.99, 1.0], [1.495, 1.0 + h], [1.495, 1.98 + h], [6.0, 6.0]];
        let mut system = disks(pbox, &at.map(|x| (x, 1.0)));
        let contacts = Contacts::of(&mut system, Rattlers { fewer_than: 2 }).unwrap();
        let removed = rattler_ids(&system, &contacts);
        assert_eq!(removed, [3, 4]);
        let all = Voids::of(&mut system, &[], None).unwrap();
        assert_eq!(kinds(&all), [(5, 2, true), (3, 0, false)]);
        assert_eq!(kinds(&Voids::of(&mut system, &removed, None).unwrap()).len(), 2);
    }
}
