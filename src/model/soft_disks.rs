use super::stiffness::{Block, Elastic, Prestress, add_elastic, of_separation, scaled, strained, times};
use super::{Harmonic, Model, Outline, Terms, View, add_outer};
use crate::geometry::{Vec2, dot, norm};
use crate::lanes::{self, Kernel, LANES, Lanes, TAGS, Tagged, point_of};
use crate::neighbor::{Candidates, DiskList};
use crate::particles::Bodies;
use std::ops::Range;

/// Soft disks (SP model, paper Eq. 5): U = Σ ε/2 (1 − r/σ_ij)² over overlapping pairs, σ_ij the mean diameter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SoftDisks {
    /// Energy scale ε.
    pub epsilon: f64,
    /// Smallest diameter, which sets the stiffest contact.
    pub smallest: f64,
}

/// Steps that a list build costs (`cargo bench --bench step`).
const BUILD: f64 = 15.0;
/// By how much of itself a step becomes longer with a skin as wide as the smallest disk.
const PAIRS: f64 = 0.4;
const LEAST_SKIN: f64 = 0.1;
const MOST_SKIN: f64 = 1.0;

/// An overlap as felt by disk i.
struct Overlap {
    /// The other disk.
    neighbor: u32,
    /// From the other centre to that of i.
    separation: Vec2,
    /// r
    distance: f64,
    /// σ_ij
    contact: f64,
    /// On i.
    force: Vec2,
}

impl SoftDisks {
    /// Second derivative of the energy of an overlap by the separation.
    fn block(&self, overlap: &Overlap, prestress: Prestress) -> Block {
        let law = Harmonic { epsilon: self.epsilon, delta: overlap.contact };
        of_separation(law, overlap.separation, overlap.distance, prestress)
    }

    /// Overlaps of disk i, the force of each as in [`Forces`], to the bit.
    fn overlaps<'a>(&'a self, view: &'a View<DiskList>, i: usize) -> impl Iterator<Item = Overlap> + 'a {
        let size = &view.particles.size;
        view.lists.neighbors(i).filter_map(move |neighbor| {
            let separation = view.displacement(i as u32, neighbor);
            let (distance, contact) = (norm(separation), 0.5 * (size[i] + size[neighbor as usize]));
            let strength = (self.epsilon * (contact - distance)) / ((contact * contact) * distance);
            // coincident centres push nowhere: the direction is undefined, and a random start leaves it at once
            let strength = if distance > 0.0 { strength } else { 0.0 };
            let force = [strength * separation[0], strength * separation[1]];
            (distance < contact).then_some(Overlap { neighbor, separation, distance, contact, force })
        })
    }
}

/// Forces on a chunk of disks, eight at a time. Each lane adds the pairs of its own disk in the order of its list.
struct Forces<'a, C> {
    model: &'a SoftDisks,
    view: &'a View<'a, DiskList>,
    contacts: C,
    particles: Range<usize>,
    forces: &'a mut [Vec2],
}

/// Where the distances σ_ij at which disks touch come from.
trait Contacts: Copy {
    fn between<L: Lanes>(&self, l: L, disks: &[Tagged; LANES], others: &[Tagged; LANES]) -> L::Real;
}

/// The tags of the lists tell.
impl Contacts for &[f64; TAGS * TAGS] {
    #[inline(always)]
    fn between<L: Lanes>(&self, l: L, disks: &[Tagged; LANES], others: &[Tagged; LANES]) -> L::Real {
        l.by_tags(self, disks, others)
    }
}

/// Diameters of all disks.
impl Contacts for &[f64] {
    #[inline(always)]
    fn between<L: Lanes>(&self, l: L, disks: &[Tagged; LANES], others: &[Tagged; LANES]) -> L::Real {
        let [own, other] = [disks, others].map(|at| l.numbers(self, &at.map(point_of)));
        l.mul(l.splat(0.5), l.add(own, other))
    }
}

impl<C: Contacts> Kernel for Forces<'_, C> {
    type Output = ();

    #[inline(always)]
    fn run(self, l: impl Lanes) {
        let Forces { model, view, contacts, particles, forces } = self;
        let position = &view.particles.position[..];
        let unit = view.pbox.unit();
        let is_tilted = unit[1] != 0.0;
        let [unit_x, tilt, unit_y, epsilon, zero] = [unit[0], unit[1], unit[2], model.epsilon, 0.0].map(|x| l.splat(x));
        for slice in view.lists.slices(&particles) {
            let [own, neighbors @ ..] = slice else { continue };
            let [x, y] = l.tagged_points(position, own);
            let (mut fx, mut fy) = (zero, zero);
            for at in neighbors {
                let [other_x, other_y] = l.tagged_points(position, at);
                let (across, up) = (l.difference(x, other_x), l.difference(y, other_y));
                let dx = l.mul(across, unit_x);
                let dx = if is_tilted { l.add(dx, l.mul(up, tilt)) } else { dx };
                let dy = l.mul(up, unit_y);
                let distance = l.sqrt(l.add(l.mul(dx, dx), l.mul(dy, dy)));
                let contact = contacts.between(l, own, at);
                // −U′(r)/r = ε (σ_ij − r)/(σ_ij² r); r = 0 is a disk in a place that is left over
                let strength =
                    l.div(l.mul(epsilon, l.sub(contact, distance)), l.mul(l.mul(contact, contact), distance));
                let strength = l.where_between(distance, contact, strength);
                fx = l.add(fx, l.mul(strength, dx));
                fy = l.add(fy, l.mul(strength, dy));
            }
            for (&disk, force) in own.iter().zip(l.vectors(fx, fy)) {
                forces[point_of(disk) as usize - particles.start] = force;
            }
        }
    }
}

impl Model for SoftDisks {
    type List = DiskList;

    const BODIES: bool = false;

    fn bodies(&self) -> Bodies {
        Bodies::Disks
    }

    fn range(&self, largest_size: f64) -> f64 {
        largest_size
    }

    fn list(&self, candidates: &Candidates, skin: f64) -> DiskList {
        DiskList::new(candidates, skin)
    }

    /// A skin s costs each step [`PAIRS`] s of it in pairs that do not touch, and a list for every s/`used` steps costs
    /// [`BUILD`] of them: together they are least at this s.
    fn better_skin(&self, used_per_step: f64, room: f64) -> Option<f64> {
        let best = (BUILD / PAIRS * used_per_step * self.smallest).sqrt();
        Some(best.clamp(LEAST_SKIN * self.smallest, MOST_SKIN * self.smallest).min(room))
    }

    fn forces(&self, view: &View<DiskList>, particles: Range<usize>, forces: &mut [Vec2]) {
        match view.lists.contacts() {
            Some(contacts) => lanes::run(Forces { model: self, view, contacts, particles, forces }),
            None => {
                let contacts = &view.particles.size[..];
                lanes::run(Forces { model: self, view, contacts, particles, forces })
            }
        }
    }

    fn accelerate(
        &self,
        _view: &View<DiskList>,
        _particles: Range<usize>,
        forces: &[Vec2],
        accelerations: &mut [Vec2],
    ) {
        accelerations.copy_from_slice(forces);
    }

    fn terms(&self, view: &View<DiskList>, i: usize) -> Terms {
        let mut terms = Terms::default();
        for Overlap { separation, distance, contact, force, .. } in self.overlaps(view, i) {
            let depth = 1.0 - distance / contact;
            terms.contact += 0.5 * (0.5 * self.epsilon * depth * depth);
            add_outer(&mut terms.virial, 0.5, force, separation);
        }
        terms.centroid = terms.virial;
        terms
    }

    fn for_each_contact(&self, view: &View<DiskList>, i: usize, mut visit: impl FnMut(u32, Vec2)) {
        self.overlaps(view, i).for_each(|overlap| visit(overlap.neighbor, overlap.force));
    }

    fn own_area(&self, view: &View<DiskList>, i: usize) -> f64 {
        0.25 * std::f64::consts::PI * view.particles.size[i] * view.particles.size[i]
    }

    fn outline(&self, view: &View<DiskList>, i: usize) -> Outline {
        let radius = 0.5 * view.particles.size[i];
        // σ_ij is the sum of the two radii
        let lens = |o: Overlap| ([-o.separation[0], -o.separation[1]], o.contact - radius);
        let overlaps = self.overlaps(view, i).map(lens).collect();
        Outline::Disk { radius, overlaps }
    }

    fn softened(&self, _factor: f64) -> Option<Self> {
        None
    }

    fn force_unit(&self) -> f64 {
        self.epsilon / self.smallest
    }

    fn stiffness(&self, view: &View<DiskList>, i: usize, prestress: Prestress, mut add: impl FnMut(usize, u32, Block)) {
        for overlap in self.overlaps(view, i).filter(|o| o.distance > 0.0) {
            let block = self.block(&overlap, prestress);
            add(0, i as u32, block);
            add(0, overlap.neighbor, scaled(-1.0, block));
        }
    }

    fn area_stiffness(&self, _view: &View<DiskList>, _i: usize, _gradient: &mut [Vec2]) -> f64 {
        0.0
    }

    fn elastic(&self, view: &View<DiskList>, i: usize) -> Elastic {
        let mut elastic = [0.0; 10];
        for overlap in self.overlaps(view, i).filter(|o| o.distance > 0.0) {
            let (block, r) = (self.block(&overlap, Prestress::ALL), overlap.separation);
            add_elastic(&mut elastic, |a, b| 0.5 * dot(strained(a, r), times(&block, strained(b, r))));
        }
        elastic
    }

    fn stiffest(&self) -> f64 {
        self.time_step().powi(-2)
    }

    fn time_step(&self) -> f64 {
        // 0.6 √(m σ²/ε): 0.8 and more never converge (dense packings have ω_max up to about 2.6 of that unit)
        0.6 * self.smallest / self.epsilon.sqrt()
    }

    fn step_cap(&self) -> f64 {
        0.1 * self.smallest
    }
}
