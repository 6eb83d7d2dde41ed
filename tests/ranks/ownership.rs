//! Who owns which particle, and what travels between ranks.

use crate::harness::Outcome;
use crate::systems::*;
use jamhpc::comm::Comm;
use jamhpc::decomposition::ProcessGrid;
use jamhpc::engine::{EngineError, System};
use jamhpc::geometry::{Frac, PeriodicBox};
use jamhpc::model::{Model, SoftDisks, VertexEdge};
use jamhpc::neighbor::PointList;
use jamhpc::particles::{Bodies, Particles};
use std::collections::BTreeSet;

/// Disks of diameter 1 at these fractions of the box, all brought by rank 0, each with a vector that travels with it.
fn disks_at(comm: Comm, pbox: PeriodicBox, centers: &[[f64; 2]]) -> System<SoftDisks> {
    let mut disks = Particles::empty(&Bodies::Disks);
    if comm.is_root() {
        centers.iter().enumerate().for_each(|(id, &c)| disks.push(id as u32, 1.0, &[Frac::from_fractions(c)]));
    }
    disks.carried = vec![disks.id.iter().map(|&id| [id as f64, 0.5]).collect()];
    System::new(comm, DISKS, pbox, &pbox, disks, 0.3).unwrap()
}

fn assert_vectors_came_along(system: &System<SoftDisks>) {
    for (id, vector) in system.particles().id.iter().zip(&system.particles().carried[0]) {
        assert_eq!(*vector, [*id as f64, 0.5]);
    }
}

/// Rank 0 brings one particle for the middle of each subdomain; each must end there, also after all have moved on.
pub fn one_particle_per_subdomain(mut comm: Comm) -> Outcome {
    // the second box makes a row of subdomains, many steps from end to end
    for pbox in [PeriodicBox::square(40.0), PeriodicBox::new(200.0, 3.5, 0.0)] {
        let (rank, ranks) = (comm.rank(), comm.size());
        let [columns, rows] = ProcessGrid::new(ranks, &pbox, 1.3).unwrap().shape;
        let middle =
            |k: usize| [((k % columns) as f64 + 0.5) / columns as f64, ((k / columns) as f64 + 0.5) / rows as f64];
        let centers: Vec<[f64; 2]> = (0..ranks).map(middle).collect();
        let mut system = disks_at(comm, pbox, &centers);
        for hop in 0..ranks {
            // every particle to the middle that is `hop` subdomains on, whatever lies between
            let mut moved = system.own_particles();
            for (position, id) in moved.position.iter_mut().zip(&moved.id) {
                *position = Frac::from_fractions(centers[(*id as usize + hop) % ranks]);
            }
            system.restore(pbox, moved);
            system.prepare().unwrap();
            assert_eq!(system.particles().id.len(), 1, "rank {rank}, hop {hop}");
            assert_eq!((system.particles().id[0] as usize + hop) % ranks, rank, "hop {hop}");
            assert_eq!(system.particles().position[0], Frac::from_fractions(centers[rank]));
            assert_vectors_came_along(&system);
            by_id(&system, position_words); // none lost or doubled
        }
        comm = system.comm;
    }
    Vec::new()
}

/// All particles jump to places all over the box at once, again and again.
pub fn far_migration(comm: Comm) -> Outcome {
    const N: usize = 500;
    let centers: Vec<[f64; 2]> = (0..N).map(|i| [0.618 * i as f64 % 1.0, 0.755 * i as f64 % 1.0]).collect();
    let pbox = PeriodicBox::new(60.0, 20.0, 5.0);
    let mut system = disks_at(comm, pbox, &centers);
    let mut outcome = Vec::new();
    for jump in 0..5u64 {
        let mut moved = system.own_particles();
        for (position, &id) in moved.position.iter_mut().zip(&moved.id) {
            // golden ratio steps: anywhere in the box
            let far = (id as u64 + 1) * (jump + 1);
            let scattered = [0x9E37_79B9_7F4A_7C15u64, 0xC2B2_AE3D_27D4_EB4F].map(|k| k.wrapping_mul(far) as i64);
            *position = position.plus(scattered);
        }
        system.restore(pbox, moved);
        system.prepare().unwrap();
        let particles = system.particles();
        for p in 0..particles.len() {
            assert_eq!(system.grid().owner(particles.position[p]), system.comm.rank());
        }
        assert_vectors_came_along(&system);
        assert_eq!(system.n_particles(), N as u64);
        outcome.push(hash(&by_id(&system, position_words)));
    }
    let migrated = system.comm.sum_count(system.counters.migrated);
    assert!(system.comm.size() == 1 || migrated > N as u64, "{migrated}");
    outcome
}

/// Four touching disks around the point where all four corners of the periodic box meet: on a 2 × 2 grid each has an
/// owner of its own, who must see the three others.
pub fn four_around_the_corner(comm: Comm) -> Outcome {
    let mut outcome = Vec::new();
    let e = 0.45 / 12.0; // 0.9 diameters apart; 1.27 across
    let centers = [[e, e], [1.0 - e, e], [e, 1.0 - e], [1.0 - e, 1.0 - e]];
    let pbox = PeriodicBox::square(12.0);
    let mut system = disks_at(comm, pbox, &centers);
    outcome.extend(describe(&mut system));
    let contacts = system.contacts().unwrap();
    assert!(contacts.iter().all(|c| c.len() == 2), "{contacts:?}");
    if system.comm.size() == 4 {
        let seen: BTreeSet<u32> = system.particles().foreign.iter().map(|f| f.id).collect();
        assert_eq!(system.particles().id.len(), 1);
        assert_eq!(seen.len(), 3, "all three lie within range and skin: {seen:?}");
    }
    // across the corner only: two disks on the diagonal
    let diagonal = 0.3 / 12.0;
    let mut system = disks_at(system.comm, pbox, &[[diagonal, diagonal], [1.0 - diagonal, 1.0 - diagonal]]);
    outcome.extend(describe(&mut system));
    assert!(system.contacts().unwrap().iter().all(|c| c.len() == 1));
    outcome
}

/// After every update each foreign point is its owner's point, bit for bit, and none is there that no list names.
fn halo<M: Model>(mut system: System<M>, step: f64) -> Outcome
where
    M::List: Clone,
{
    system.carry(1);
    system.prepare().unwrap();
    for round in 0..20 {
        shake(&mut system, step, round as f64);
        system.prepare().unwrap();
        let all = whole(&system);
        let particles = system.particles();
        for (foreign, position) in particles.foreign.iter().zip(&particles.position[particles.owned_points()..]) {
            let p = all.id.binary_search(&foreign.id).unwrap();
            assert_eq!(*position, all.points_of(p)[foreign.index as usize], "round {round}, {foreign:?}");
            assert_eq!(foreign.size, all.size[p]);
        }
    }
    // the lists, built again for the present state, are consumed by renumbering them
    let own = system.own_particles();
    system.restore(*system.pbox(), own);
    system.prepare().unwrap();
    let owned = system.particles().owned_points();
    let foreign = system.particles().foreign.len();
    let named = named_foreign_points(&system, owned);
    assert_eq!(named, (owned as u32..(owned + foreign) as u32).collect::<BTreeSet<u32>>(), "only named points travel");
    let (sent, received) = system.halo_points();
    assert_eq!(received, foreign);
    let [sent, received] = [sent, received].map(|n| system.comm.sum_count(n as u64));
    assert_eq!(sent, received);
    assert!(system.comm.size() == 1 || received > 0);
    assert!(system.counters.rebuilds < 20, "most rounds must be updates, not rebuilds");
    // what was measured before lists were let go of belongs to the same particles after that
    for round in 0..20 {
        system.prepare().unwrap();
        shake(&mut system, step, round as f64);
        system.lay_bare();
        let order = system.particles().id.clone();
        for _ in 0..2 {
            system.prepare().unwrap();
            assert_eq!(system.particles().id, order, "round {round}");
            system.lay_bare();
        }
        assert_eq!(system.particles().id, order, "round {round}");
    }
    describe(&mut system)
}

fn named_foreign_points<M: Model>(system: &System<M>, owned: usize) -> BTreeSet<u32>
where
    M::List: Clone,
{
    let mut list = system.view().lists.clone();
    let named = std::sync::Mutex::new(BTreeSet::new());
    list.for_each_point(|&mut point| {
        if point as usize >= owned {
            named.lock().unwrap().insert(point);
        }
    });
    named.into_inner().unwrap()
}

pub fn halo_sp(comm: Comm) -> Outcome {
    halo(random_sp(comm, 400, unit_box(0.2), 0.9, 0.9), 0.02)
}

pub fn halo_dp(comm: Comm) -> Outcome {
    halo(random_dp::<VertexEdge>(comm, 128, unit_box(0.2), 0.75, 0.75), 0.005)
}

/// A box for four ranks, started on more: every rank gets the same answer, and what it advises works.
pub fn too_many_ranks(comm: Comm) -> Outcome {
    let pbox = PeriodicBox::square(3.6); // two subdomains of 1.8 hold range and skin, three of 1.2 do not
    let (rank, ranks) = (comm.rank(), comm.size());
    let mut disks = Particles::empty(&Bodies::Disks);
    disks.push(rank as u32, 1.4, &[Frac::from_fractions([rank as f64 / ranks as f64, 0.5])]);
    let outcome = System::new(comm, DISKS, pbox, &pbox, disks, 0.3);
    if ranks <= 4 {
        assert!(outcome.is_ok());
        return Vec::new();
    }
    let Err(EngineError::TooManyRanks(refused)) = outcome else { panic!("{ranks} ranks were accepted on rank {rank}") };
    assert_eq!((refused.ranks, refused.largest), (ranks, 4), "on rank {rank}");
    assert!((refused.halo - 1.7).abs() < 1e-12 && (refused.width - 1.2).abs() < 0.4, "{refused:?}");
    assert!(ProcessGrid::new(refused.largest, &pbox, refused.halo).is_ok());
    assert!(EngineError::from(refused).to_string().contains("mpirun -n 4"));
    Vec::new()
}
