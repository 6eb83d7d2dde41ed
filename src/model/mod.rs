//! Energies and forces. A model sees positions, a box and a neighbour list; it never hears of ranks.

mod deformable;
mod edge_edge;
mod masses;
mod outline_forces;
mod soft_disks;
mod stiffness;
mod vertex_edge;

pub use deformable::{Contact, Deformable, DeformableParameters};
pub use edge_edge::EdgeEdge;
pub use soft_disks::SoftDisks;
pub use stiffness::{Block, Elastic, Prestress, strained, times};
pub use vertex_edge::VertexEdge;

use crate::geometry::{Frac, PeriodicBox, Polygon, Vec2};
use crate::neighbor::{Candidates, PointList};
use crate::particles::{Bodies, Particles};
use std::ops::Range;

/// What forces are computed from.
pub struct View<'a, L> {
    pub pbox: &'a PeriodicBox,
    pub particles: &'a Particles,
    pub lists: &'a L,
}

impl<L> View<'_, L> {
    /// Nearest-image vector from point b to point a.
    #[inline(always)]
    pub fn displacement(&self, a: u32, b: u32) -> Vec2 {
        self.pbox.displacement(self.position(a), self.position(b))
    }

    #[inline(always)]
    pub fn position(&self, point: u32) -> Frac {
        self.particles.position[point as usize]
    }

    /// Global id of the particle that a foreign or own point belongs to.
    pub fn particle_id(&self, point: u32, particle_of: &[u32]) -> u32 {
        let owned = self.particles.owned_points();
        match (point as usize).checked_sub(owned) {
            Some(foreign) => self.particles.foreign[foreign].id,
            None => self.particles.id[particle_of[point as usize] as usize],
        }
    }
}

/// One particle's share of energy and stress; the sum over all particles is the total.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Terms {
    /// Line tension times perimeter.
    pub line: f64,
    /// Area term.
    pub area: f64,
    /// Half the energy of each of its contacts.
    pub contact: f64,
    /// −∂U/∂strain of all terms, in the order xx, xy, yx, yy: energy units, to be divided by the box area.
    pub virial: [f64; 4],
    /// Σ f ⊗ (distance of area centroids) of its halves of the contacts, same order and unit.
    pub centroid: [f64; 4],
}

/// What a particle looks like: all that its area and shape are measured from.
#[derive(Clone, Debug)]
pub enum Outline {
    /// A disk and the disks that overlap it: (vector to the centre, radius) of each.
    Disk { radius: f64, overlaps: Vec<(Vec2, f64)> },
    /// A polygon inside a shell of width δ/2.
    Polygon {
        polygon: Polygon,
        /// a₀
        rest_area: f64,
        delta: f64,
    },
}

/// Where points may soon be.
#[derive(Clone, Copy, Debug)]
pub struct Ahead<'a> {
    /// Of each own point, then each foreign one.
    pub displacement: &'a [Vec2],
    /// Outlines that are farther apart than a contact by more than this are not looked at.
    pub reach: f64,
}

/// An energy that is a function of positions alone and has a force everywhere: what the minimisers ask for.
pub trait Model: Copy + Send + Sync {
    type List: PointList + Default;

    /// Whether particles are bodies of several points, whose rigid motions and growth a minimiser may give other masses than the
    /// motions of single points ([`Model::accelerate`]).
    const BODIES: bool;

    /// The kind of particles it acts on.
    fn bodies(&self) -> Bodies;

    /// How many lengths of an edge and skins lie, at most, between two points whose nearest image is taken for that of
    /// touching outlines.
    const EDGES_AND_SKINS_BETWEEN: [f64; 2] = [0.0; 2];

    /// Largest distance at which points of two particles still interact: what a neighbour list must never miss.
    /// `largest_size` is the largest particle size on any rank.
    fn range(&self, largest_size: f64) -> f64;

    /// The neighbour list of all points closer than their range plus `skin`.
    fn list(&self, candidates: &Candidates, skin: f64) -> Self::List;

    /// The skin of the next list, given what was measured with the last: how much of a skin the points use up in a step.
    /// Not wider than `room`; nothing where the first skin is kept.
    fn better_skin(&self, _used_per_step: f64, _room: f64) -> Option<f64> {
        None
    }

    /// Forces on the points of a run of own particles (written, not added), each summed in the order of global ids.
    fn forces(&self, view: &View<Self::List>, particles: Range<usize>, forces: &mut [Vec2]);

    /// Writes what the forces on a run of own particles accelerate when the rigid motions of a particle are lighter than
    /// motions of its single points and its growth is heavier: M⁻¹F, a symmetric positive map of the forces, the identity
    /// for disks.
    fn accelerate(&self, view: &View<Self::List>, particles: Range<usize>, forces: &[Vec2], accelerations: &mut [Vec2]);

    /// [`Model::forces`] and [`Model::accelerate`] of a run of own particles that is a chunk of the lists.
    fn forces_and_accelerations(
        &self,
        view: &View<Self::List>,
        particles: Range<usize>,
        forces: &mut [Vec2],
        accelerations: &mut [Vec2],
    ) {
        self.forces(view, particles.clone(), forces);
        self.accelerate(view, particles, forces, accelerations);
    }

    /// Readies the lists for forces at the present positions and at all that can be reached while no point moves
    /// farther than `travel` and the box stays as it is. What forces come out does not depend on it, only how fast.
    fn narrow(&self, _pbox: &PeriodicBox, _particles: &Particles, _list: &mut Self::List, _travel: f64) {}

    /// Energy and stress of one own particle.
    fn terms(&self, view: &View<Self::List>, particle: usize) -> Terms;

    /// Visits the points of other particles that own particle `particle` is in contact with (repetitions allowed),
    /// with the force that the contact exerts on `particle`.
    fn for_each_contact(&self, view: &View<Self::List>, particle: usize, visit: impl FnMut(u32, Vec2));

    /// Area that own particle `particle` covers by itself: π σ²/4 of a disk, polygon and shell of a deformable one.
    /// Their sum over the area of the box is the density that protocols set (φ for disks, ρ for deformable particles).
    fn own_area(&self, view: &View<Self::List>, particle: usize) -> f64;

    /// Outline of own particle `particle`.
    fn outline(&self, view: &View<Self::List>, particle: usize) -> Outline;

    /// The blocks of the Hessian in the rows of own particle `particle`: `add(point, column, block)` with the point
    /// counted from the particle's first. Blocks of one row and column add up. [`Model::area_stiffness`] is not in it.
    /// The part that contact forces contribute by turning (pre-stress) is multiplied by `prestress`.
    fn stiffness(
        &self,
        view: &View<Self::List>,
        particle: usize,
        prestress: Prestress,
        add: impl FnMut(usize, u32, Block),
    );

    /// The same where contacts are those that are left or made when points move by the displacements of `ahead`, as long
    /// as outlines are straight lines there: contacts that open are left out, those that close are put in, and
    /// `push(point, force)` tells what the forces change by in a quadratic form of the energy with these contacts. Disks
    /// keep the contacts they have.
    fn stiffness_ahead(
        &self,
        view: &View<Self::List>,
        particle: usize,
        prestress: Prestress,
        _ahead: &Ahead,
        add: impl FnMut(usize, u32, Block),
        _push: impl FnMut(usize, Vec2),
    ) {
        self.stiffness(view, particle, prestress, add);
    }

    /// The same energy with contacts that are softer by a factor, all else unchanged; nothing where contacts are all
    /// there is, and softer ones the same in another unit.
    fn softened(&self, factor: f64) -> Option<Self>
    where
        Self: Sized;

    /// ε/δ² of contacts that can be [softened](Model::softened).
    fn contact_stiffness(&self) -> Option<f64> {
        Some((self.stiffest() - self.softened(0.0)?.stiffest()) / 4.0) // their stiffest mode is four times as stiff
    }

    /// Size of the forces that shape a packing: line tension γ, or ε/σ_S of disks.
    fn force_unit(&self) -> f64;

    /// The part k ∇a ∇aᵀ of the Hessian that couples all points of own particle `particle`: writes the gradient of its
    /// area by each of its points and returns k. Nothing for disks.
    fn area_stiffness(&self, view: &View<Self::List>, particle: usize, gradient: &mut [Vec2]) -> f64;

    /// Second derivatives of the energy of own particle `particle` by the strain; the sum over all particles is the
    /// whole.
    fn elastic(&self, view: &View<Self::List>, particle: usize) -> Elastic;

    /// About the stiffest mode for unit masses, the largest eigenvalue of the Hessian.
    fn stiffest(&self) -> f64;

    /// Largest time step that is safe for the masses of [`Model::accelerate`], from a bound on the stiffest mode.
    fn time_step(&self) -> f64;

    /// Largest displacement of a point in one minimiser step.
    fn step_cap(&self) -> f64;
}

/// The purely repulsive law of a contact at distance d: φ(d) = ε/2 (1 − d/δ)² for d < δ (paper, Eqs. 5 and 8).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Harmonic {
    pub epsilon: f64,
    pub delta: f64,
}

impl Harmonic {
    #[inline(always)]
    pub fn energy(&self, d: f64) -> f64 {
        let gap = 1.0 - d / self.delta;
        0.5 * self.epsilon * gap * gap
    }

    /// −φ′(d)/d: times the separation vector it is the repulsive force.
    #[inline(always)]
    pub fn force_over_distance(&self, d: f64) -> f64 {
        self.epsilon * (1.0 - d / self.delta) / (self.delta * d)
    }
}

/// f ⊗ r in the order xx, xy, yx, yy, added to a tensor.
#[inline(always)]
fn add_outer(tensor: &mut [f64; 4], weight: f64, f: Vec2, r: Vec2) {
    tensor[0] += weight * (f[0] * r[0]);
    tensor[1] += weight * (f[0] * r[1]);
    tensor[2] += weight * (f[1] * r[0]);
    tensor[3] += weight * (f[1] * r[1]);
}
