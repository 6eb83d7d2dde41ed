//! One system of particles over a group of ranks: migrate → cell lists → halo → neighbour lists when needed,
//! else a halo update, then forces. The only place where models meet communication.

use crate::allocator;
use crate::comm::{Comm, Halo};
use crate::decomposition::{ProcessGrid, TooManyRanks};
use crate::geometry::{Frac, PeriodicBox, Polygon, Vec2, norm};
use crate::model::{Model, Outline, Terms, View};
use crate::neighbor::{Candidates, PointList};
use crate::particles::{Bodies, ForeignPoint, Particles};
use crate::profile::{self, Count, Phase};
use crate::threads::{self, Chunk};
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

/// Why a system cannot be set up or continued. All ranks get the same value.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum EngineError {
    #[error(transparent)]
    TooManyRanks(#[from] TooManyRanks),
    #[error(
        "the box is too small: a particle {extent:.4} across (contact range included) meets its own periodic image in a \
         box {width:.4} wide; take more particles or a larger box"
    )]
    BoxTooSmall { extent: f64, width: f64 },
    #[error(
        "the box is too small: with edges as long as {edge:.4}, which act up to {range:.4} away, it must be wider than \
         {least:.4}, but is {width:.4} wide; take more particles, more vertices or a larger box"
    )]
    LongEdges { edge: f64, range: f64, least: f64, width: f64 },
    #[error(
        "forces on particle {particle} are not finite or run away; the state before this minimisation was the last good one"
    )]
    Runaway { particle: u32 },
    #[error(
        "the shear modulus by linear response, {linear_response}, is not that of relaxed strains, {strained}, to 1e-6: \
         the state is not relaxed well enough (minimize it to smaller forces), or a contact is about to open or close"
    )]
    Moduli { linear_response: f64, strained: f64 },
    #[error("the outlines of particles {0} and {1} cross: crossed outlines never untangle, so the state is not valid")]
    Crossing(u32, u32),
    #[error("disks {0} and {1} lie at one place, where no force parts them: move one of them a little")]
    Coincident(u32, u32),
    #[error("interrupted")]
    Interrupted,
    #[error("the voids found fill {found:.15} of the box, but particles leave {left:.15}: please report this state")]
    Voids { found: f64, left: f64 },
    #[error("the outlines of voids do not close: please report this state")]
    OpenVoids,
}

/// What a run has cost so far, on this rank.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Counters {
    /// Force evaluations.
    pub forces: u64,
    /// Neighbour list builds.
    pub rebuilds: u64,
    /// How often the pairs that can touch were picked from the lists.
    pub narrowings: u64,
    /// Particles handed to another rank.
    pub migrated: u64,
}

/// Who follows long minimisations from outside. Nothing of it touches their bits.
pub struct Watch {
    /// Told now and then of the force evaluations so far and the largest force.
    pub told: Box<dyn Fn(u64, f64) + Send + Sync>,
    /// This rank is asked to end.
    pub ends: Arc<AtomicBool>,
}

/// Energy and stress of the whole system.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Energies {
    /// U, sum of the three terms.
    pub total: f64,
    pub line: f64,
    pub area: f64,
    /// U_int: all contacts.
    pub contact: f64,
    /// −dU/d(strain)/A, all terms: xx, xy, yx, yy.
    pub virial: [f64; 4],
    /// Σ_pairs f ⊗ (distance of centroids)/A, same order (paper, Eq. 6 and §2.2, in pairwise periodic writing).
    pub centroid: [f64; 4],
}

impl Energies {
    /// Mean of the diagonal of the centroid stress: exactly zero where nothing touches.
    pub fn pressure(&self) -> f64 {
        0.5 * (self.centroid[0] + self.centroid[3])
    }

    /// Largest difference between the two stress forms, zero at force balance.
    pub fn stress_mismatch(&self) -> f64 {
        self.virial.iter().zip(&self.centroid).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    }
}

/// Steps like the last one for which pairs that can touch are picked from the lists: picking costs about two force
/// evaluations, and pairs picked in vain make each of the others dearer.
const STEPS_FORESEEN: f64 = 16.0;

/// Particles wander by less than half a skin between list builds, so that not every build need sort them in space.
const REBUILDS_PER_SORT: u64 = 8;
/// Where a box has shrunk, the skin is shortened to what fits its subdomains, at most to this part of it at once.
const SKIN_LEAST: f64 = 0.1;

/// Particles, their box and potential, and the lists that make forces cheap.
pub struct System<M: Model> {
    pub comm: Comm,
    pub model: M,
    pub counters: Counters,
    /// On all ranks or on none.
    pub watch: Option<Watch>,
    grid: ProcessGrid,
    pbox: PeriodicBox,
    particles: Particles,
    forces: Vec<Vec2>,
    /// What the forces accelerate ([`Model::accelerate`]); empty where particles are single points.
    accelerations: Vec<Vec2>,
    chunks: Vec<Chunk>,
    skin: f64,
    list: M::List,
    halo: Halo,
    /// Largest particle size on any rank.
    largest_size: f64,
    /// Width of the largest particle at the start, contact range included.
    largest_width: f64,
    built_box: PeriodicBox,
    built_position: Vec<Frac>,
    /// Force evaluations until then.
    built_at: u64,
    /// No own or foreign point has travelled farther than this since the build; the same on all ranks. Infinite when
    /// not known.
    travel_bound: f64,
    /// No point has moved farther than this since the lists were narrowed, and for how much they were; the last step.
    since_narrowed: f64,
    narrowed_for: f64,
    last_move: f64,
    /// The lists were never built, or do not describe these particles.
    stale: bool,
    /// Lists and halo were let go of.
    bare: bool,
    /// Foreign positions may be old.
    halo_is_old: bool,
}

/// The domains of so many ranks in a box with particles whose points are at most `radius` from their centre and interact up to
/// `range`, with `skin` added in neighbour lists.
pub fn fits(
    ranks: usize,
    smallest_box: &PeriodicBox,
    is_disks: bool,
    [radius, range, skin]: [f64; 3],
) -> Result<ProcessGrid, EngineError> {
    let extent = 2.0 * radius + range;
    let widths = smallest_box.widths();
    let width = widths[0].min(widths[1]);
    // a disk also must not overlap the same neighbour through two images
    let extent = if is_disks { 2.0 * extent } else { extent };
    if extent >= width {
        return Err(EngineError::BoxTooSmall { extent, width });
    }
    Ok(ProcessGrid::new(ranks, smallest_box, range + skin + 2.0 * radius)?)
}

/// Between a point and the edge on which it acts the vector is taken to an end of that edge, in the nearest image, which is
/// that of the edge only where the box is wide enough: whether it is, for edges of that length which act up to `range`, with
/// `skin` added in neighbour lists, and the [`Model::EDGES_AND_SKINS_BETWEEN`] of their contacts.
pub fn edges_fit(
    pbox: &PeriodicBox,
    [edges, skins]: [f64; 2],
    [edge, range, skin]: [f64; 3],
) -> Result<(), EngineError> {
    let widths = pbox.widths();
    let width = widths[0].min(widths[1]);
    let least = 2.0 * (edges * edge + range + skins * skin);
    if least >= width { Err(EngineError::LongEdges { edge, range, least, width }) } else { Ok(()) }
}

impl<M: Model> System<M> {
    /// A system of the particles that each rank brings (any distribution over the ranks; ids unique).
    ///
    /// `smallest_box` is the smallest box that this system is going to have: whether the ranks fit is decided for it
    /// here, not in the middle of a run. `skin` is added to the range of neighbour lists.
    pub fn new(
        comm: Comm,
        model: M,
        pbox: PeriodicBox,
        smallest_box: &PeriodicBox,
        particles: Particles,
        skin: f64,
    ) -> Result<Self, EngineError> {
        let radius = |p: usize| particles.circumradius(&pbox, p);
        let (size, radius) =
            (0..particles.len()).fold((0.0f64, 0.0f64), |(size, r), p| (size.max(particles.size[p]), r.max(radius(p))));
        let [largest_size, largest_radius] = comm.max_each([size, radius]);
        let range = model.range(largest_size);
        let is_disks = matches!(particles.bodies, Bodies::Disks);
        let grid = fits(comm.size(), smallest_box, is_disks, [largest_radius, range, skin])?;
        allocator::suit(particles.owned_points());
        Ok(System {
            list: M::List::default(),
            comm,
            model,
            counters: Counters::default(),
            watch: None,
            grid,
            pbox,
            forces: Vec::new(),
            accelerations: Vec::new(),
            chunks: Vec::new(),
            skin,
            halo: Halo::default(),
            largest_size,
            largest_width: 2.0 * largest_radius + range,
            built_box: pbox,
            built_position: Vec::new(),
            built_at: 0,
            travel_bound: f64::INFINITY,
            since_narrowed: f64::INFINITY,
            narrowed_for: 0.0,
            last_move: 0.0,
            stale: true,
            bare: true,
            halo_is_old: true,
            particles,
        })
    }

    pub fn pbox(&self) -> &PeriodicBox {
        &self.pbox
    }

    pub fn particles(&self) -> &Particles {
        &self.particles
    }

    /// Tells whoever watches how far a minimisation is.
    pub fn tell(&self, max_force: f64) {
        if let Some(watch) = &self.watch {
            (watch.told)(self.counters.forces, max_force);
        }
    }

    /// Whether some rank is asked to end. Collective.
    pub fn is_to_end(&self) -> bool {
        self.watch.as_ref().is_some_and(|watch| self.comm.any(watch.ends.load(Ordering::Relaxed)))
    }

    /// Forces on this rank's own points, as of the last evaluation.
    pub fn forces(&self) -> &[Vec2] {
        &self.forces
    }

    /// Own particles in runs of similar work.
    pub fn chunks(&self) -> &[Chunk] {
        &self.chunks
    }

    /// Number of particles on all ranks.
    pub fn n_particles(&self) -> u64 {
        self.comm.sum_count(self.particles.len() as u64)
    }

    /// Edge of the square that a particle has to itself.
    pub fn spacing(&self) -> f64 {
        (self.pbox.area() / self.n_particles() as f64).sqrt()
    }

    /// Number of points on all ranks.
    pub fn n_points(&self) -> u64 {
        self.comm.sum_count(self.particles.owned_points() as u64)
    }

    pub fn largest_size(&self) -> f64 {
        self.largest_size
    }

    pub fn grid(&self) -> &ProcessGrid {
        &self.grid
    }

    /// Points sent and received by this rank in one update of the halo.
    pub fn halo_points(&self) -> (usize, usize) {
        (self.halo.sent(), self.halo.received())
    }

    /// Reserves `n` vectors per point that travel with their particle, all zero.
    pub fn carry(&mut self, n: usize) {
        let points = self.particles.owned_points();
        self.particles.carried = Vec::new(); // before there are others
        self.particles.carried = (0..n).map(|_| vec![[0.0; 2]; points]).collect();
    }

    /// Gives each own point the vectors that travel with it, in place of all others.
    pub fn carry_these(&mut self, vectors: Vec<Vec<Vec2>>) {
        self.particles.carried = vectors;
    }

    /// Changes the box and takes every point along affinely.
    pub fn deform(&mut self, to: PeriodicBox) {
        self.pbox = to;
        // what was travelled in the old box is another length in this one
        self.travel_bound = f64::INFINITY;
        self.since_narrowed = f64::INFINITY;
    }

    /// Shears the box (x displaced by `strain` × y) and takes every point along affinely; a box tilted by more than
    /// half its first edge is replaced by an equal one that is not, exactly.
    pub fn shear(&mut self, strain: f64) {
        let (pbox, flips) = self.pbox.sheared(strain).least_tilted();
        if flips != 0 {
            self.particles.forget_foreign();
            for point in &mut self.particles.position {
                *point = point.flipped(flips);
            }
            // the subdomains lie elsewhere now
            self.stale = true;
        }
        self.deform(pbox);
    }

    /// Changes the box, takes particle centres along affinely and moves each particle as a rigid whole.
    pub fn deform_rigidly(&mut self, to: PeriodicBox) {
        if matches!(self.particles.bodies, Bodies::Disks) {
            return self.deform(to);
        }
        for p in 0..self.particles.len() {
            let center = self.particles.center(&self.pbox, p);
            for point in self.particles.bodies.points(p) {
                let arm = self.pbox.displacement(self.particles.position[point], center);
                self.particles.position[point] = to.moved(center, arm);
            }
        }
        self.pbox = to;
        self.travel_bound = f64::INFINITY;
        self.since_narrowed = f64::INFINITY;
        self.halo_is_old = true;
    }

    /// Puts this rank's own particles at other positions, in another box.
    pub fn restore(&mut self, pbox: PeriodicBox, particles: Particles) {
        self.pbox = pbox;
        self.particles = particles;
        self.particles.forget_foreign();
        self.stale = true;
    }

    /// A second system in the same state, of the own particles that `is_wanted` wants. Collective.
    pub fn with_some(&self, is_wanted: impl Fn(usize) -> bool + Send + Sync) -> Result<System<M>, EngineError> {
        let mut wanted = self.own_particles();
        wanted.carried.clear();
        wanted.reorder(&threads::choose(self.particles.len(), is_wanted));
        System::new(self.comm.duplicate(), self.model, self.pbox, &self.pbox, wanted, self.skin)
    }

    /// Copy of this rank's own particles.
    pub fn own_particles(&self) -> Particles {
        let mut own = self.particles.clone();
        own.forget_foreign();
        own
    }

    /// What the forces on this rank's own points accelerate ([`Model::accelerate`]), as of the last evaluation.
    pub fn accelerations(&self) -> &[Vec2] {
        if M::BODIES { &self.accelerations } else { &self.forces }
    }

    /// Moves points: `step` gets the box, and a chunk's positions, first carried vectors and accelerations. No
    /// point may move farther than `bound`, which must be the same on all ranks.
    pub fn move_points(&mut self, bound: f64, step: impl Fn(&PeriodicBox, &mut [Frac], &mut [Vec2], &[Vec2]) + Sync) {
        let owned = self.particles.owned_points();
        let Particles { position, carried, .. } = &mut self.particles;
        let forces = if M::BODIES { &self.accelerations } else { &self.forces };
        let pbox = &self.pbox;
        let _update = profile::enter(Phase::Update);
        threads::fold(
            &self.chunks,
            &mut position[..owned],
            &mut carried[0],
            &|chunk, position, vectors| step(pbox, position, vectors, &forces[chunk.points.clone()]),
            &|(), ()| (),
        );
        self.moved(bound);
    }

    /// Own points have moved, none farther than `bound`.
    fn moved(&mut self, bound: f64) {
        self.travel_bound += bound;
        self.since_narrowed += bound;
        self.last_move = bound;
        self.halo_is_old = true;
    }

    /// As [`System::move_points`], for a minimiser that carries two vectors.
    pub fn move_points_keeping(
        &mut self,
        bound: f64,
        step: impl Fn(&PeriodicBox, &mut [Frac], &mut [Vec2], &mut [Vec2], &[Vec2]) + Sync,
    ) {
        let owned = self.particles.owned_points();
        let Particles { position, carried, .. } = &mut self.particles;
        let [first, second] = &mut carried[..] else { panic!("two vectors are carried") };
        let forces = if M::BODIES { &self.accelerations } else { &self.forces };
        let pbox = &self.pbox;
        let _update = profile::enter(Phase::Update);
        threads::fold_split(
            &self.chunks,
            (&mut position[..owned], (&mut first[..], &mut second[..])),
            &|chunk, (position, (first, second))| step(pbox, position, first, second, &forces[chunk.points.clone()]),
            &|(), ()| (),
        );
        self.moved(bound);
    }

    /// Evaluates the forces on all own points, then calls `reduce` on each chunk while it is in the cache, with its
    /// forces and accelerations, and merges the answers; `None` on a rank without particles.
    pub fn evaluate<R: Send>(
        &mut self,
        reduce: impl Fn(&Chunk, &Particles, &[Vec2], &[Vec2]) -> R + Sync,
        merge: impl Fn(R, R) -> R + Sync,
    ) -> Result<Option<R>, EngineError> {
        self.prepare()?;
        self.narrow();
        self.counters.forces += 1;
        profile::add(Count::Steps, 1);
        let _forces = profile::enter(Phase::Forces);
        let view = View { pbox: &self.pbox, particles: &self.particles, lists: &self.list };
        let model = &self.model;
        if M::BODIES {
            let work = |chunk: &Chunk, forces: &mut [Vec2], accelerations: &mut [Vec2]| {
                model.forces_and_accelerations(&view, chunk.particles.clone(), forces, accelerations);
                reduce(chunk, view.particles, forces, accelerations)
            };
            return Ok(threads::fold(&self.chunks, &mut self.forces, &mut self.accelerations, &work, &merge));
        }
        let work = |chunk: &Chunk, forces: &mut [Vec2], _: &mut [()]| {
            model.forces(&view, chunk.particles.clone(), forces);
            reduce(chunk, view.particles, forces, forces)
        };
        let nothing = &mut vec![(); self.forces.len()]; // zero-sized: no memory behind it
        Ok(threads::fold(&self.chunks, &mut self.forces, nothing, &work, &merge))
    }

    /// The largest force on any point of any rank (NaN if one is), evaluated afresh.
    pub fn max_force(&mut self) -> Result<f64, EngineError> {
        let largest = |_: &Chunk, _: &Particles, forces: &[Vec2], _: &[Vec2]| {
            forces.iter().map(|&f| norm(f)).fold(0.0, |m, f| if f > m || f.is_nan() { f } else { m })
        };
        let here = self.evaluate(largest, |a, b| if a.is_nan() || a > b { a } else { b })?;
        Ok(self.comm.max(here.unwrap_or(0.0)))
    }

    /// Lists and foreign positions for the present positions and box. Collective.
    pub fn prepare(&mut self) -> Result<(), EngineError> {
        if self.stale || self.bare {
            self.rebuild()?;
        } else if !self.lists_hold() {
            self.choose_skin();
            self.rebuild()?;
        } else if self.halo_is_old {
            let _halo = profile::enter(Phase::Halo);
            self.halo.update(&self.comm, &mut self.particles.position);
        }
        self.halo_is_old = false;
        Ok(())
    }

    /// [`System::prepare`], with lists that hold all pairs in range and those that are farther apart by no more than
    /// [`System::reach`]; whether they were built again, so that forces must be, too. Collective.
    pub fn prepare_for_reach(&mut self) -> Result<bool, EngineError> {
        self.prepare()?;
        let holds = self.pbox == self.built_box && 2.0 * self.travel_bound <= self.skin - self.reach();
        if !holds {
            self.rebuild()?;
        }
        Ok(!holds)
    }

    /// Half of the skin.
    pub fn reach(&self) -> f64 {
        0.5 * self.skin
    }

    /// Picks from the lists what can touch during the next steps, if points have moved farther than was foreseen.
    fn narrow(&mut self) {
        if self.since_narrowed > self.narrowed_for {
            let _lists = profile::enter(Phase::Lists);
            self.narrowed_for = (STEPS_FORESEEN * self.last_move).max(0.01 * self.skin).min(0.5 * self.skin);
            self.model.narrow(&self.pbox, &self.particles, &mut self.list, self.narrowed_for);
            self.since_narrowed = 0.0;
            self.counters.narrowings += 1;
        }
    }

    /// What forces are computed from; call [`System::prepare`] first.
    pub fn view(&self) -> View<'_, M::List> {
        View { pbox: &self.pbox, particles: &self.particles, lists: &self.list }
    }

    /// The skin that would have been best for the steps that the last lists have served. The same on all ranks.
    fn choose_skin(&mut self) {
        let steps = self.counters.forces - self.built_at;
        let widths = self.pbox.widths();
        let room = self.grid.narrowest_width(&self.pbox).min(0.5 * widths[0].min(widths[1])) - self.largest_width;
        if steps > 0
            && let Some(skin) = self.model.better_skin(self.skin / steps as f64, room.max(self.skin))
        {
            self.skin = skin;
        }
    }

    /// Whether every interacting pair is certainly in the lists.
    ///
    /// A pair that is not was farther apart than range + skin; the box has shortened that distance to no less than
    /// `stretch` times it, and the two points have since come closer by at most twice the largest travel.
    fn lists_hold(&mut self) -> bool {
        let range = self.model.range(self.largest_size);
        let stretch =
            if self.pbox == self.built_box { 1.0 } else { self.pbox.shortest_stretch(&self.built_box).min(1.0) };
        let allowed = 0.5 * (stretch * (range + self.skin) - range);
        if self.travel_bound <= allowed {
            return true;
        }
        let _lists = profile::enter(Phase::Lists);
        let travel = |i: usize| norm(self.pbox.displacement(self.particles.position[i], self.built_position[i]));
        let farthest = threads::largest(self.built_position.len(), travel);
        self.travel_bound = self.comm.max(farthest);
        // the last tenth of the skin is not worth measuring at every step
        self.travel_bound <= 0.9 * allowed
    }

    /// Hands particles to the owners of their centres and lets go of forces, lists and foreign points, which are as much
    /// memory again as the particles and more: to be had again from [`System::prepare`], before which no point can be moved. As
    /// long as nothing moves, particles are stored in the same order from then on. Collective.
    pub fn lay_bare(&mut self) {
        if self.bare && !self.stale && self.travel_bound == 0.0 {
            return;
        }
        let _lists = profile::enter(Phase::Lists);
        (self.list, self.halo) = (M::List::default(), Halo::default());
        (self.forces, self.accelerations, self.built_position) = (Vec::new(), Vec::new(), Vec::new());
        self.particles.forget_foreign();
        self.migrate();
        let has_moved = self.travel_bound > 0.0;
        if self.stale || has_moved && self.counters.rebuilds.is_multiple_of(REBUILDS_PER_SORT) {
            self.sort_in_space();
        }
        self.chunks = self.particles.bodies.chunks(self.particles.len());
        (self.stale, self.bare, self.travel_bound) = (false, true, 0.0);
    }

    /// Collects the foreign points that the new lists name.
    fn rebuild(&mut self) -> Result<(), EngineError> {
        let _lists = profile::enter(Phase::Lists);
        self.counters.rebuilds += 1;
        self.lay_bare();
        let owned = self.particles.len();
        let owned_points = self.particles.owned_points();
        let [radius, edge] = self.comm.max_each([self.largest_circumradius(), self.longest_edge()]);
        let widths = self.pbox.widths();
        let range = self.model.range(self.largest_size) + 2.0 * radius;
        // the box may have become smaller since the skin was chosen; that of bodies is how far Newton steps look, and stays
        if !M::BODIES {
            let (extent, width) = (2.0 * range, widths[0].min(widths[1]));
            if extent >= width {
                return Err(EngineError::BoxTooSmall { extent, width });
            }
            let room = self.grid.narrowest_width(&self.pbox) - range;
            self.skin = self.skin.min(room.max(SKIN_LEAST * self.skin));
            // lists hold one image of another disk, in a tilted box the nearest one only up to here
            if self.pbox.xy() != 0.0 {
                self.skin = self.skin.min(0.5 * width - range);
            }
        }
        if M::BODIES {
            edges_fit(&self.pbox, M::EDGES_AND_SKINS_BETWEEN, [edge, self.model.range(self.largest_size), self.skin])?;
        }
        let halo = range + self.skin;
        self.grid.check(&self.pbox, halo)?;
        let margin = widths.map(|w| halo / w);
        let Offers { peers, offered, foreign_of_peer } =
            collect_foreign(&self.comm, &self.grid, margin, &self.pbox, &mut self.particles);

        let candidates = Candidates {
            pbox: &self.pbox,
            particles: &self.particles,
            owned,
            region: self.grid.region(self.comm.rank(), margin),
            chunks: &self.chunks,
        };
        self.list = self.model.list(&candidates, self.skin);
        self.keep_named(owned, owned_points, &peers, &offered, &foreign_of_peer);

        self.forces = vec![[0.0; 2]; owned_points];
        if M::BODIES {
            self.accelerations = vec![[0.0; 2]; owned_points];
        }
        self.built_box = self.pbox;
        self.built_at = self.counters.forces;
        self.built_position = threads::collect(owned_points, |i| self.particles.position[i]);
        self.travel_bound = 0.0;
        self.since_narrowed = f64::INFINITY;
        self.bare = false;
        Ok(())
    }

    /// Largest distance from the centre of an own particle to one of its points.
    fn largest_circumradius(&self) -> f64 {
        let (particles, pbox) = (&self.particles, &self.pbox);
        threads::largest(particles.len(), |p| particles.circumradius(pbox, p))
    }

    /// Of own particles; 0 of disks.
    fn longest_edge(&self) -> f64 {
        let (particles, pbox) = (&self.particles, &self.pbox);
        let count = if M::BODIES { particles.len() } else { 0 };
        threads::largest(count, |p| Polygon::from_vertices(pbox, particles.points_of(p)).longest_edge())
    }

    /// Every particle to the rank that owns its centre. Particles travel one subdomain at a time, so that only
    /// neighbours talk, however far one has moved.
    fn migrate(&mut self) {
        let rank = self.comm.rank();
        let peers = self.grid.neighbors(rank);
        while !peers.is_empty() {
            let particles = &self.particles;
            let next = |p: usize| self.grid.towards(rank, self.grid.owner(particles.center(&self.pbox, p)));
            let leaving = threads::choose(particles.len(), |p| next(p) != rank);
            if !self.comm.any(!leaving.is_empty()) {
                return;
            }
            let mut outgoing = vec![Vec::new(); peers.len()];
            for &p in &leaving {
                let to = next(p as usize);
                let peer = peers.partition_point(|&peer| peer < to);
                self.particles.pack(p as usize, true, &mut outgoing[peer]);
            }
            self.counters.migrated += leaving.len() as u64;
            if !leaving.is_empty() {
                let staying = threads::choose(particles.len(), |p| leaving.binary_search(&(p as u32)).is_err());
                self.particles.reorder(&staying);
            }
            for message in self.comm.exchange(&peers, &outgoing) {
                self.particles.unpack(&message, true);
            }
        }
    }

    /// Stores own particles in bands across the box, each from one end to the other: a chunk is a patch about as wide
    /// as high, whose neighbourhood fits the first cache.
    fn sort_in_space(&mut self) {
        let (n, points) = (self.particles.len(), self.particles.owned_points());
        let region = self.grid.region(self.comm.rank(), [0.0; 2]);
        let spacing = (self.pbox.area() / (self.grid.ranks() * n.max(1)) as f64).sqrt();
        let band = spacing * (Bodies::POINTS_PER_CHUNK as f64 * n.max(1) as f64 / points.max(1) as f64).sqrt();
        let widths = self.pbox.widths();
        let shape = [(0, spacing), (1, band)].map(|(axis, width)| {
            let most = n.max(1) as f64;
            (widths[axis] * region.span[axis] / width).clamp(1.0, most) as usize
        });
        let particles = &self.particles;
        let bin = |p: usize| region.bin(particles.center(&self.pbox, p), shape);
        let order = threads::sort_by_bin(n, shape, bin).items;
        self.particles.reorder(&order);
    }

    /// Drops every foreign point that the list does not name, renumbers the list and settles the halo exchange.
    fn keep_named(
        &mut self,
        owned: usize,
        owned_points: usize,
        peers: &[usize],
        offered: &[Vec<u32>],
        foreign_of_peer: &[std::ops::Range<usize>],
    ) {
        const UNNAMED: u32 = u32::MAX;
        let all = &mut self.particles;
        let marks: Vec<AtomicU32> = (owned_points..all.position.len()).map(|_| AtomicU32::new(UNNAMED)).collect();
        if !marks.is_empty() {
            self.list.for_each_point(|point| {
                if let Some(foreign) = (*point as usize).checked_sub(owned_points) {
                    marks[foreign].store(0, Ordering::Relaxed); // whoever comes first
                }
            });
        }
        let mut number: Vec<u32> = marks.into_iter().map(AtomicU32::into_inner).collect();
        let mut kept = Vec::new();
        let mut wanted = vec![Vec::new(); peers.len()];
        for (range, wanted) in foreign_of_peer.iter().zip(&mut wanted) {
            for point in range.clone() {
                if number[point - owned_points] != UNNAMED {
                    number[point - owned_points] = (owned_points + kept.len()) as u32;
                    kept.push(point);
                    wanted.push((point - range.start) as u32);
                }
            }
        }
        if !number.is_empty() {
            self.list.for_each_point(|point| {
                if let Some(foreign) = (*point as usize).checked_sub(owned_points) {
                    *point = number[foreign];
                }
            });
        }
        let bodies = &all.bodies;
        let mut particle = owned;
        let foreign = kept.iter().map(|&point| {
            while bodies.points(particle).end <= point {
                particle += 1;
            }
            let index = (point - bodies.points(particle).start) as u32;
            ForeignPoint { id: all.id[particle], index, size: all.size[particle] }
        });
        all.foreign = foreign.collect();
        for (k, &point) in kept.iter().enumerate() {
            all.position[owned_points + k] = all.position[point];
        }
        all.position.truncate(owned_points + kept.len());
        all.id.truncate(owned);
        all.size.truncate(owned);
        if let Bodies::Disks = all.bodies {
            all.size.extend(all.foreign.iter().map(|f| f.size));
        }
        if let Bodies::Polygons { first } = &mut all.bodies {
            first.truncate(owned + 1);
        }
        // what a peer asks for is numbered in the order in which it was offered
        let points = |particles: &Vec<u32>| -> Vec<u32> {
            particles.iter().flat_map(|&p| all.bodies.points(p as usize)).map(|point| point as u32).collect()
        };
        let offered: Vec<Vec<u32>> = offered.iter().map(points).collect();
        self.halo = Halo::new(&self.comm, peers.to_vec(), &wanted, &offered, owned_points);
    }

    /// Shows `look` this rank's own particles and all whole foreign ones that may overlap them, which the halo of the
    /// lists (single points) does not hold. Lists are let go of ([`System::lay_bare`]). Collective.
    pub fn with_whole_neighbors<R>(&mut self, look: impl FnOnce(&Candidates) -> R) -> Result<R, EngineError> {
        self.lay_bare();
        let owned = self.particles.len();
        let halo = 2.0 * self.comm.max(self.largest_circumradius()) + self.model.range(self.largest_size);
        self.grid.check(&self.pbox, halo)?;
        let margin = self.pbox.widths().map(|w| halo / w);
        collect_foreign(&self.comm, &self.grid, margin, &self.pbox, &mut self.particles);
        let seen = look(&Candidates {
            pbox: &self.pbox,
            particles: &self.particles,
            owned,
            region: self.grid.region(self.comm.rank(), margin),
            chunks: &self.chunks,
        });
        self.particles.keep(owned);
        Ok(seen)
    }

    /// Energies and stresses of the present state. Collective.
    pub fn energies(&mut self) -> Result<Energies, EngineError> {
        self.prepare()?;
        let view = self.view();
        let row = |p: usize| {
            let t = self.model.terms(&view, p);
            let [a, b, c, d] = t.virial;
            let [e, f, g, h] = t.centroid;
            [t.line, t.area, t.contact, a, b, c, d, e, f, g, h]
        };
        let [line, area, contact, v0, v1, v2, v3, c0, c1, c2, c3] = self.comm.sum_terms(self.particles.len(), row);
        let per_area = |s: [f64; 4]| s.map(|x| x / self.pbox.area());
        Ok(Energies {
            total: line + area + contact,
            line,
            area,
            contact,
            virial: per_area([v0, v1, v2, v3]),
            centroid: per_area([c0, c1, c2, c3]),
        })
    }

    /// What `of` says about the energy and stress of each own particle.
    pub fn terms<R: Copy + Send>(&mut self, of: impl Fn(usize, &Terms) -> R + Sync) -> Result<Vec<R>, EngineError> {
        self.prepare()?;
        let view = self.view();
        Ok(threads::collect(self.particles.len(), |p| of(p, &self.model.terms(&view, p))))
    }

    /// What `of` says about the outline of each own particle.
    pub fn outlines<R: Copy + Send>(&mut self, of: impl Fn(&Outline) -> R + Sync) -> Result<Vec<R>, EngineError> {
        self.prepare()?;
        let view = self.view();
        Ok(threads::collect(self.particles.len(), |p| of(&self.model.outline(&view, p))))
    }

    /// Density that protocols set: the sum of the areas that particles cover by themselves over the area of the box
    /// (φ for disks, ρ with the shell for deformable particles). Collective.
    pub fn density(&mut self) -> Result<f64, EngineError> {
        Ok(self.own_area()? / self.pbox.area())
    }

    /// Largest factor by which the density may be raised at once: centres of touching particles then approach by half
    /// a contact width, so that outlines moved as rigid wholes cannot cross.
    pub fn densest_step(&self) -> f64 {
        let approach = 5.0 * self.model.step_cap();
        (1.0 - approach / self.largest_width).max(0.5).powi(-2)
    }

    /// Sum of the areas that all particles cover by themselves. Collective.
    pub fn own_area(&mut self) -> Result<f64, EngineError> {
        self.prepare()?;
        let view = self.view();
        let [whole] = self.comm.sum_terms(self.particles.len(), |p| [self.model.own_area(&view, p)]);
        Ok(whole)
    }

    /// For each own particle the global ids of the particles it touches, ascending, each once, and the total force of
    /// each contact on it.
    pub fn contacts(&mut self) -> Result<Vec<Vec<(u32, Vec2)>>, EngineError> {
        self.prepare()?;
        let view = self.view();
        let particles = &self.particles;
        let mut particle_of = Vec::with_capacity(particles.owned_points());
        for p in 0..particles.len() {
            particle_of.resize(particles.bodies.points(p).end, p as u32);
        }
        let of = |p: usize| {
            let mut found: Vec<(u32, Vec2)> = Vec::new();
            self.model.for_each_contact(&view, p, |other, force| {
                found.push((view.particle_id(other, &particle_of), force));
            });
            found.sort_by_key(|&(id, _)| id); // stable: the forces of one contact stay in their order
            found.dedup_by(|later, first| {
                let same = later.0 == first.0;
                if same {
                    first.1 = [first.1[0] + later.1[0], first.1[1] + later.1[1]];
                }
                same
            });
            found
        };
        let parts = threads::map(&self.chunks, |chunk| chunk.particles.clone().map(of).collect::<Vec<_>>());
        Ok(parts.concat())
    }

    /// Refreshes a value per point from the owners, own points first; T is some pairs of words wide.
    pub fn share<T: bytemuck::Pod + Default>(&mut self, own: Vec<T>) -> Vec<T> {
        let mut values = own;
        self.refresh(&mut values);
        values
    }

    /// The same in place; room for the foreign points is made at the first call.
    pub fn refresh<T: bytemuck::Pod + Default>(&mut self, values: &mut Vec<T>) {
        let _halo = profile::enter(Phase::Halo);
        values.resize(self.particles.position.len(), T::default());
        self.halo.update(&self.comm, values);
    }

    /// Global id of the lowest-numbered particle with a point whose force is not below `limit`, if there is one.
    pub fn offender(&self, limit: f64) -> Option<u32> {
        let bad = |p: &usize| {
            let points = self.particles.bodies.points(*p);
            self.forces[points].iter().any(|&f| norm(f).is_nan() || norm(f) >= limit)
        };
        let here = (0..self.particles.len()).filter(bad).map(|p| self.particles.id[p]).min();
        let lowest = -self.comm.max(-here.map_or(f64::INFINITY, f64::from));
        lowest.is_finite().then_some(lowest as u32)
    }
}

/// Which whole particles go where at a list build.
struct Offers {
    /// Ranks with adjacent subdomains.
    peers: Vec<usize>,
    /// For each peer the own particles that may come near its own.
    offered: Vec<Vec<u32>>,
    /// For each peer the range of points that it has sent.
    foreign_of_peer: Vec<Range<usize>>,
}

/// Appends to `particles`, which are this rank's own, the whole foreign particles whose centres lie within `margin`
/// (fractions of the box) of its subdomain, without vectors that they carry. Collective.
fn collect_foreign(
    comm: &Comm,
    grid: &ProcessGrid,
    margin: [f64; 2],
    pbox: &PeriodicBox,
    particles: &mut Particles,
) -> Offers {
    let peers = grid.neighbors(comm.rank());
    let near =
        |&peer: &usize| threads::choose(particles.len(), |p| grid.is_near(peer, particles.center(pbox, p), margin));
    let offered: Vec<Vec<u32>> = peers.iter().map(near).collect();
    let packed = |chosen: &Vec<u32>| {
        let mut message = Vec::new();
        chosen.iter().for_each(|&p| particles.pack(p as usize, false, &mut message));
        message
    };
    let outgoing: Vec<Vec<u64>> = offered.iter().map(packed).collect();
    let received = comm.exchange(&peers, &outgoing);
    let carried = std::mem::take(&mut particles.carried);
    let append = |message: &Vec<u64>| {
        let start = particles.position.len();
        particles.unpack(message, false);
        start..particles.position.len()
    };
    let foreign_of_peer = received.iter().map(append).collect();
    particles.carried = carried;
    Offers { peers, offered, foreign_of_peer }
}
