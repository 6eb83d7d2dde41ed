use crate::engine::{EngineError, System};
use crate::model::Model;
use crate::neighbor::Rows;

/// Which particles count as rattlers: those with fewer contacts than this, found again and again after each removal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rattlers {
    pub fewer_than: usize,
}

impl Default for Rattlers {
    /// Three: two contacts hold a frictionless particle only if they are exactly opposite. The paper says two.
    fn default() -> Self {
        Rattlers { fewer_than: 3 }
    }
}

/// The contact network: particles, joined by one contact per touching pair, however many parts of their outlines touch.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Contacts {
    /// How many particles each own particle touches, rattlers included.
    pub n_touching: Vec<u32>,
    /// Whether each own particle is a rattler.
    pub is_rattler: Vec<bool>,
    /// N, on all ranks.
    pub n_particles: u64,
    /// Rattlers on all ranks.
    pub n_rattlers: u64,
    /// N_c: contacts between particles that are no rattlers, on all ranks, each counted once.
    pub n_contacts: u64,
}

impl Contacts {
    /// The contacts of the present state, and its rattlers. Collective.
    pub fn of<M: Model>(system: &mut System<M>, rattlers: Rattlers) -> Result<Contacts, EngineError> {
        system.prepare()?;
        let points = neighbors(system, |_, point| point);
        let is_rattler = remove_rattlers(system, &points, rattlers);
        let removed = on_points(system, &is_rattler);
        // every contact is seen from both sides
        let kept_ends = |p: usize| points.row(p).iter().filter(|&&point| !removed[point as usize]).count() as u64;
        let ends: u64 = (0..is_rattler.len()).filter(|&p| !is_rattler[p]).map(kept_ends).sum();
        let rattlers_here = is_rattler.iter().filter(|&&r| r).count() as u64;
        Ok(Contacts {
            n_touching: points.iter().map(|row| row.len() as u32).collect(),
            n_particles: system.n_particles(),
            n_rattlers: system.comm.sum_count(rattlers_here),
            n_contacts: system.comm.sum_count(ends) / 2,
            is_rattler,
        })
    }

    /// N′: particles that are no rattlers.
    pub fn n_backbone(&self) -> u64 {
        self.n_particles - self.n_rattlers
    }

    /// z = 2 N_c/N′, rattlers left out; 0 when all are rattlers. (The paper prints N_c/N, but its values are 2 N_c/N.)
    pub fn contact_number(&self) -> f64 {
        if self.n_backbone() == 0 { 0.0 } else { 2.0 * self.n_contacts as f64 / self.n_backbone() as f64 }
    }
}

/// For each own particle the global ids of all particles it touches, ascending, rattlers included. Collective.
pub fn touching<M: Model>(system: &mut System<M>) -> Result<Rows<u32>, EngineError> {
    system.prepare()?;
    Ok(neighbors(system, |id, _| id))
}

/// All contacts as pairs of global ids, smaller first, ascending, on rank 0; nothing elsewhere. Rattlers included. Collective.
pub fn all_pairs<M: Model>(system: &mut System<M>) -> Result<Vec<[u32; 2]>, EngineError> {
    let touching = touching(system)?;
    let mut words = Vec::new();
    for (&id, touching) in system.particles().id.iter().zip(touching.iter()) {
        // the owner of the smaller id names the pair
        words.extend(touching.iter().filter(|&&other| id < other).map(|&other| (id as u64) << 32 | other as u64));
    }
    let mut pairs = system.comm.gather(words).concat();
    pairs.sort_unstable();
    Ok(pairs.into_iter().map(|pair| [(pair >> 32) as u32, pair as u32]).collect())
}

/// For each own particle what is kept of those that it touches, each once, in the order of global ids: of its id and of one
/// of its points, own or foreign.
fn neighbors<M: Model>(system: &System<M>, keep: impl Fn(u32, u32) -> u32) -> Rows<u32> {
    let (view, particles) = (system.view(), system.particles());
    let mut particle_of = Vec::with_capacity(particles.owned_points());
    for p in 0..particles.len() {
        particle_of.resize(particles.bodies.points(p).end, p as u32);
    }
    let (mut rows, mut found) = (Rows::default(), Vec::new());
    for p in 0..particles.len() {
        found.clear();
        system.model.for_each_contact(&view, p, |point, _| {
            found.push((view.particle_id(point, &particle_of), point));
        });
        found.sort_unstable();
        found.dedup_by_key(|&mut (id, _)| id);
        rows.push_row(found.iter().map(|&(id, point)| keep(id, point)));
    }
    rows
}

/// A flag of each own particle on all of its points, wherever they are known.
fn on_points<M: Model>(system: &mut System<M>, of_particle: &[bool]) -> Vec<bool> {
    let particles = system.particles();
    let mut words = vec![[0u64; 2]; particles.owned_points()];
    for (p, &flag) in of_particle.iter().enumerate() {
        words[particles.bodies.points(p)].fill([flag as u64, 0]);
    }
    system.share(words).into_iter().map(|[flag, _]| flag != 0).collect()
}

/// Removes particles with too few contacts, then those that this leaves with too few, until nothing changes anywhere.
/// The result does not depend on the order of removal, so that every rank may work on its own particles at once.
fn remove_rattlers<M: Model>(system: &mut System<M>, touched: &Rows<u32>, rattlers: Rattlers) -> Vec<bool> {
    let mut removed = vec![false; touched.iter().len()];
    loop {
        let gone = on_points(system, &removed);
        let mut changed = false;
        for (p, row) in touched.iter().enumerate() {
            if !removed[p] && row.iter().filter(|&&point| !gone[point as usize]).count() < rattlers.fewer_than {
                removed[p] = true;
                changed = true;
            }
        }
        if !system.comm.any(changed) {
            return removed;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::comm::Comm;
    use crate::geometry::PeriodicBox;
    use crate::model::SoftDisks;
    use crate::particles::{Bodies, Particles};

    /// Disks of diameter 1 at these positions in a wide box.
    fn disks(at: &[[f64; 2]]) -> System<SoftDisks> {
        let pbox = PeriodicBox::square(20.0);
        let mut particles = Particles::empty(&Bodies::Disks);
        at.iter().enumerate().for_each(|(i, &x)| particles.push(i as u32, 1.0, &[pbox.frac(x)]));
        System::new(Comm::alone(), SoftDisks { epsilon: 1.0, smallest: 1.0 }, pbox, &pbox, particles, 0.1).unwrap()
    }

    /// Four disks that all touch each other but for one diagonal, a chain of two hanging on one of them.
    fn rhombus_with_a_tail() -> System<SoftDisks> {
        let h = 0.75f64.sqrt() * 0.99;
        disks(&[[0.0, 0.0], [0.99, 0.0], [0.495, h], [1.485, h], [2.475, h], [3.465, h]])
    }

    #[test]
    fn removal_recurses() {
        // corners of the rhombus have two contacts: once they are gone, so is everything
        let mut system = rhombus_with_a_tail();
        let all = Contacts::of(&mut system, Rattlers::default()).unwrap();
        assert_eq!((all.n_particles, all.n_rattlers, all.n_contacts), (6, 6, 0));
        assert_eq!(all.contact_number(), 0.0);
        assert_eq!(all_pairs(&mut system).unwrap(), [[0, 1], [0, 2], [1, 2], [1, 3], [2, 3], [3, 4], [4, 5]]);
    }

    #[test]
    fn the_paper_keeps_particles_with_two_contacts() {
        let mut system = rhombus_with_a_tail();
        let some = Contacts::of(&mut system, Rattlers { fewer_than: 2 }).unwrap();
        let mut rattling: Vec<u32> = system.particles().id.clone();
        rattling.retain(|&id| {
            let p = system.particles().id.iter().position(|&i| i == id).unwrap();
            some.is_rattler[p]
        });
        rattling.sort_unstable();
        assert_eq!(rattling, [4, 5]);
        assert_eq!((some.n_contacts, some.n_backbone()), (5, 4));
        assert_eq!(some.contact_number(), 2.5);
    }

    #[test]
    fn nothing_touches() {
        let mut system = disks(&[[0.0, 0.0], [5.0, 5.0]]);
        let none = Contacts::of(&mut system, Rattlers::default()).unwrap();
        assert_eq!((none.n_contacts, none.n_rattlers, none.contact_number()), (0, 2, 0.0));
    }
}
