//! Systems to test, and ways to look at them that do not depend on who owns what.

use jamhpc::comm::Comm;
use jamhpc::engine::System;
use jamhpc::geometry::{Frac, PeriodicBox, Vec2};
use jamhpc::minimize::Goal;
use jamhpc::model::{Contact, Deformable, DeformableParameters, Harmonic, Model, SoftDisks};
use jamhpc::particles::{Bodies, Particles};
use jamhpc::protocol::{Species, deformable_particles, random_disks};
use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hash, Hasher};

pub const DISKS: SoftDisks = SoftDisks { epsilon: 1.0, smallest: 1.0 };
/// Width of the circulo-lines.
pub const DELTA: f64 = 0.1;

/// When a minimisation ends.
pub fn goal(force_tolerance: f64, max_iterations: u64) -> Goal {
    Goal { force_tolerance, max_iterations }
}

/// Half small, half large, diameters 1 and 1.4.
pub fn disk_species(n: u32) -> [Species; 2] {
    [Species { count: n / 2, size: 1.0, n_vertices: 1 }, Species { count: n - n / 2, size: 1.4, n_vertices: 1 }]
}

/// Half small, half large, 12 and 17 vertices, (√a_S + √a_L)/2 = 1.
pub fn polygon_species(n: u32) -> [Species; 2] {
    let small = (24.0f64 / 29.0).powi(2);
    let large = small * (17.0f64 / 12.0).powi(2);
    [Species { count: n / 2, size: small, n_vertices: 12 }, Species { count: n - n / 2, size: large, n_vertices: 17 }]
}

/// Contacts about as stiff as areas.
pub fn polygon_parameters() -> DeformableParameters {
    let [small, large] = polygon_species(2).map(|s| s.size);
    let k_area = 1000.0 / (small * small);
    DeformableParameters {
        line_tension: 1.0,
        k_area,
        contact: Harmonic { epsilon: 0.01 * k_area * large * large, delta: DELTA },
        largest_area_per_vertex: large / 17.0,
    }
}

/// A box of area 1 that is square, or tilted by this fraction of its edge.
pub fn unit_box(tilt: f64) -> PeriodicBox {
    PeriodicBox::new(1.0, 1.0, tilt)
}

/// Disks at random places. The ranks fit it until its density is `densest`.
pub fn random_sp(comm: Comm, n: u32, shape: PeriodicBox, density: f64, densest: f64) -> System<SoftDisks> {
    let species = disk_species(n);
    let area: f64 = species.iter().map(|s| s.count as f64 * s.undeformed_area(0.0)).sum();
    let disks = random_disks(&comm, &species, 1, |s| s.size);
    let smallest = shape.with_area(area / densest);
    System::new(comm, DISKS, shape.with_area(area / density), &smallest, disks, 0.3).unwrap()
}

/// Regular polygons that do not cross, at a density below jamming.
pub fn random_dp<C: Contact>(
    comm: Comm,
    n: u32,
    shape: PeriodicBox,
    density: f64,
    densest: f64,
) -> System<Deformable<C>> {
    polygons_of(comm, n, shape, [density, densest], 0.0)
}

/// The same about centres that are spread evenly, if `spread` is not 0.
pub fn polygons_of<C: Contact>(
    comm: Comm,
    n: u32,
    shape: PeriodicBox,
    [density, densest]: [f64; 2],
    spread: f64,
) -> System<Deformable<C>> {
    let species = polygon_species(n);
    let area: f64 = species.iter().map(|s| s.count as f64 * s.undeformed_area(DELTA)).sum();
    let pbox = shape.with_area(area / density);
    let (comm, polygons) = deformable_particles(comm, pbox, &species, 1, DELTA, spread).unwrap();
    let model = Deformable::new(polygon_parameters());
    System::new(comm, model, pbox, &shape.with_area(area / densest), polygons, 0.1).unwrap()
}

/// Polygons with these vertices in a box, all brought by rank 0; rest areas 1 unless given.
pub fn polygons_at(
    comm: &Comm,
    pbox: &PeriodicBox,
    vertices: &[Vec<Vec2>],
    rest_area: impl Fn(usize) -> f64,
) -> Particles {
    let mut particles = Particles::empty(&Bodies::Polygons { first: vec![0] });
    if comm.is_root() {
        for (id, polygon) in vertices.iter().enumerate() {
            let points: Vec<Frac> = polygon.iter().map(|&v| pbox.frac(v)).collect();
            particles.push(id as u32, rest_area(id), &points);
        }
    }
    particles
}

/// A regular polygon.
pub fn regular(n: usize, center: Vec2, radius: f64, turn: f64) -> Vec<Vec2> {
    let corner = |k: usize| {
        let angle = turn + std::f64::consts::TAU * k as f64 / n as f64;
        [center[0] + radius * angle.cos(), center[1] + radius * angle.sin()]
    };
    (0..n).map(corner).collect()
}

/// Words about each own particle, of all ranks, by global id: on rank 0 (empty elsewhere). Panics if a particle is
/// owned twice, or none owns it.
pub fn by_id<M: Model>(system: &System<M>, words: impl Fn(&System<M>, usize) -> Vec<u64>) -> BTreeMap<u32, Vec<u64>> {
    let mut message = Vec::new();
    let particles = system.particles();
    for p in 0..particles.len() {
        let here = words(system, p);
        message.extend([particles.id[p] as u64, here.len() as u64]);
        message.extend(here);
    }
    let mut all = BTreeMap::new();
    for part in system.comm.gather(message) {
        let mut rest = &part[..];
        while let [id, n, tail @ ..] = rest {
            let (words, after) = tail.split_at(*n as usize);
            let twice = all.insert(*id as u32, words.to_vec());
            assert!(twice.is_none(), "particle {id} has two owners");
            rest = after;
        }
    }
    if system.comm.is_root() {
        let last = all.keys().next_back().map_or(0, |&id| id as usize + 1);
        assert_eq!(all.len(), last, "particles are lost");
    }
    all
}

pub fn hash(of: &impl Hash) -> String {
    let mut hasher = DefaultHasher::new();
    of.hash(&mut hasher);
    format!("{:016x}", hasher.finish())
}

pub fn hex(numbers: &[f64]) -> String {
    numbers.iter().map(|x| format!("{x:e}/{:016x} ", x.to_bits())).collect()
}

pub fn position_words<M: Model>(system: &System<M>, p: usize) -> Vec<u64> {
    system.particles().points_of(p).iter().flat_map(|f| f.to_bits().map(|k| k as u64)).collect()
}

pub fn force_words<M: Model>(system: &System<M>, p: usize) -> Vec<u64> {
    let points = system.particles().bodies.points(p);
    system.forces()[points].iter().flat_map(|f| f.map(f64::to_bits)).collect()
}

/// Everything there is to know about a state, to the last bit.
pub fn describe<M: Model>(system: &mut System<M>) -> Vec<String> {
    let largest = system.max_force().unwrap();
    let e = system.energies().unwrap();
    let contacts = system.contacts().unwrap();
    let contact_words = |_: &System<M>, p: usize| -> Vec<u64> {
        contacts[p].iter().flat_map(|(id, f)| [*id as u64, f[0].to_bits(), f[1].to_bits()]).collect()
    };
    vec![
        format!("positions {}", hash(&by_id(system, position_words))),
        format!("forces {}", hash(&by_id(system, force_words))),
        format!("contacts {}", hash(&by_id(system, contact_words))),
        format!("max|F| {}", hex(&[largest])),
        format!("energies {}", hex(&[e.total, e.line, e.area, e.contact])),
        format!("virial {}", hex(&e.virial)),
        format!("centroid stress {}", hex(&e.centroid)),
        format!("density {}", hex(&[system.density().unwrap()])),
        format!("box {}", hex(&[system.pbox().lx(), system.pbox().ly(), system.pbox().xy()])),
    ]
}

/// All particles of all ranks in the order of their ids, on every rank.
pub fn whole<M: Model>(system: &System<M>) -> Particles {
    let mut message = Vec::new();
    (0..system.particles().len()).for_each(|p| system.particles().pack(p, false, &mut message));
    let bytes = bytemuck::cast_slice(&system.comm.gather(message).concat()).to_vec();
    let words: Vec<u64> = bytemuck::pod_collect_to_vec(&system.comm.broadcast(bytes));
    let mut all = Particles::empty(&system.model.bodies());
    all.unpack(&words, false);
    let mut order: Vec<u32> = (0..all.len() as u32).collect();
    order.sort_by_key(|&p| all.id[p as usize]);
    all.reordered(&order)
}

/// The same particles in a system built afresh, whole on this rank.
pub fn rebuilt_alone<M: Model + Clone>(system: &System<M>, skin: f64) -> System<M> {
    let pbox = *system.pbox();
    System::new(Comm::alone(), system.model, pbox, &pbox, whole(system), skin).unwrap()
}

/// Forces by global id, on this rank.
pub fn own_forces<M: Model>(system: &System<M>) -> BTreeMap<u32, Vec<Vec2>> {
    let particles = system.particles();
    let of = |p: usize| system.forces()[particles.bodies.points(p)].to_vec();
    (0..particles.len()).map(|p| (particles.id[p], of(p))).collect()
}

/// Panics unless the forces of every own particle are those of a system built afresh, to the last bit.
pub fn assert_forces_as_rebuilt<M: Model + Clone>(system: &mut System<M>, skin: f64, when: &str) {
    system.max_force().unwrap();
    let mut fresh = rebuilt_alone(system, skin);
    fresh.max_force().unwrap();
    let right = own_forces(&fresh);
    for (id, forces) in own_forces(system) {
        assert_eq!(forces, right[&id], "particle {id}, {when}");
    }
}

/// Global id of the particle that a point (own or foreign) belongs to, and which of its points it is.
pub fn name_of(particles: &Particles, point: u32) -> (u32, u32) {
    match (point as usize).checked_sub(particles.owned_points()) {
        Some(foreign) => (particles.foreign[foreign].id, particles.foreign[foreign].index),
        None => {
            let p = (0..particles.len()).find(|&p| particles.bodies.points(p).contains(&(point as usize))).unwrap();
            (particles.id[p], point - particles.bodies.points(p).start as u32)
        }
    }
}

/// Moves every point by `distance` in a direction that its present place and `turn` decide.
pub fn shake<M: Model>(system: &mut System<M>, distance: f64, turn: f64) {
    system.move_points(distance * (1.0 + 1e-9), |pbox, positions, _, _| {
        for position in positions {
            let f = position.fractions();
            let angle = turn + 1e3 * f[0] + 3e3 * f[1];
            *position = pbox.moved(*position, [distance * angle.cos(), distance * angle.sin()]);
        }
    });
}
