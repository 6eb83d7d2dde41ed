//! Neighbour lists against all pairs, and their validity while box and particles move.

use crate::harness::Outcome;
use crate::systems::*;
use jamhpc::comm::Comm;
use jamhpc::engine::{EngineError, System};
use jamhpc::geometry::{Frac, PeriodicBox, Vec2, closest_on_segment, dot, scale, segments_cross, sub};
use jamhpc::minimize::{Fire, Minimizer};
use jamhpc::model::{EdgeEdge, Model, VertexEdge};
use jamhpc::particles::{Bodies, Particles};

const SQUARE_AND_SHEARED: [f64; 3] = [0.0, 0.3, -0.5];

/// Every pair nearer than the mean diameter and the skin, each once, by ascending id; no other.
pub fn sp(mut comm: Comm) -> Outcome {
    let mut outcome = Vec::new();
    for tilt in SQUARE_AND_SHEARED {
        let mut system = random_sp(comm, 300, unit_box(tilt), 0.85, 0.85);
        system.prepare().unwrap();
        let (all, pbox) = (whole(&system), system.pbox());
        let particles = system.particles();
        for p in 0..particles.len() {
            let i = particles.id[p] as usize;
            let near = |&j: &usize| {
                let reach = 0.5 * (all.size[i] + all.size[j]) + 0.3;
                let d = pbox.displacement(all.position[j], all.position[i]);
                j != i && dot(d, d) < reach * reach
            };
            let right: Vec<u32> = (0..all.len()).filter(near).map(|j| j as u32).collect();
            let listed: Vec<u32> = system.view().lists.neighbors(p).map(|j| name_of(particles, j).0).collect();
            assert_eq!(listed, right, "neighbours of {i}, tilt {tilt}");
            assert!(right.len() < all.len() / 4, "a test of lists, not of all pairs");
        }
        outcome.extend(describe(&mut system));
        comm = system.comm;
    }
    outcome
}

/// A skin as wide as the subdomains have room for, and a box that shrinks, at last to one that is too small.
pub fn shrinking_box(comm: Comm) -> Outcome {
    let system = random_sp(comm, 64, unit_box(0.0), 0.8, 0.8);
    let (pbox, disks) = (*system.pbox(), system.own_particles());
    let room = system.grid().narrowest_width(&pbox).min(0.5 * pbox.widths()[0]);
    let skin = 0.99 * room - system.model.range(system.largest_size());
    let mut system = System::new(system.comm, DISKS, pbox, &pbox, disks, skin).unwrap();
    system.max_force().unwrap();
    system.lay_bare(); // as after each sample: no other skin is chosen for the lists that come next
    system.deform_rigidly(pbox.with_area(0.9 * pbox.area()));
    assert!(system.max_force().unwrap() > 0.0);
    let outcome = describe(&mut system);
    // disks that meet both images of another
    system.deform_rigidly(pbox.with_area(0.02 * pbox.area()));
    assert!(matches!(system.max_force(), Err(EngineError::BoxTooSmall { .. })));
    outcome
}

/// Vertex k and edge k → k + 1 of each particle.
struct Outlines<'a> {
    pbox: &'a PeriodicBox,
    all: &'a Particles,
}

impl Outlines<'_> {
    fn vertex(&self, (id, k): (u32, u32)) -> Frac {
        self.all.points_of(id as usize)[k as usize]
    }

    fn edge_vector(&self, (id, k): (u32, u32)) -> Vec2 {
        let points = self.all.points_of(id as usize);
        self.pbox.displacement(points[(k as usize + 1) % points.len()], points[k as usize])
    }

    /// All vertices (or edges) of other particles, by ascending particle and index.
    fn of_others(&self, id: u32) -> impl Iterator<Item = (u32, u32)> + '_ {
        let count = |other: u32| self.all.points_of(other as usize).len() as u32;
        let others = (0..self.all.len() as u32).filter(move |&other| other != id);
        others.flat_map(move |other| (0..count(other)).map(move |k| (other, k)))
    }

    fn vertex_is_near(&self, vertex: (u32, u32), edge: (u32, u32), range: f64) -> bool {
        let along = self.edge_vector(edge);
        let from_a = self.pbox.displacement(self.vertex(vertex), self.vertex(edge));
        let apart = sub(from_a, scale(closest_on_segment(from_a, along), along));
        dot(apart, apart) < range * range
    }

    fn next(&self, (id, k): (u32, u32)) -> (u32, u32) {
        (id, (k + 1) % self.all.points_of(id as usize).len() as u32)
    }

    fn edges_are_near(&self, a: (u32, u32), b: (u32, u32), range: f64) -> bool {
        let apart = self.pbox.displacement(self.vertex(b), self.vertex(a));
        [a, self.next(a)].iter().any(|&v| self.vertex_is_near(v, b, range))
            || [b, self.next(b)].iter().any(|&v| self.vertex_is_near(v, a, range))
            || segments_cross(apart, self.edge_vector(a), self.edge_vector(b))
    }
}

/// Particle and vertex of an own point.
fn place_of(particles: &Particles, point: u32) -> (usize, u32) {
    let holds = |&p: &usize| particles.bodies.points(p).contains(&(point as usize));
    let particle = (0..particles.len()).find(holds).unwrap();
    (particle, point - particles.bodies.points(particle).start as u32)
}

/// Vertices against edges and edges against edges, on polygons pressed into each other so that the lists are long.
pub fn dp(mut comm: Comm) -> Outcome {
    const RANGE: f64 = DELTA + 0.1;
    let mut outcome = Vec::new();
    for tilt in SQUARE_AND_SHEARED {
        let mut system = random_dp::<VertexEdge>(comm, 64, unit_box(tilt), 0.7, 0.9);
        let tighter = system.pbox().with_area(0.8 * system.pbox().area());
        system.deform_rigidly(tighter);
        system.prepare().unwrap();
        let all = whole(&system);
        let outlines = Outlines { pbox: system.pbox(), all: &all };
        let particles = system.particles();
        for point in 0..particles.owned_points() as u32 {
            let own = name_of(particles, point);
            let others = || outlines.of_others(own.0);
            let (particle, i) = place_of(particles, point);
            let near = system.view().lists.near(particle);
            let name = |place: u32| name_of(particles, near.points[place as usize]);
            let of_point = |pairs: &'_ [[u32; 2]]| pairs.iter().filter(|pair| pair[0] == i).map(|p| p[1]).collect();
            let edges: Vec<u32> = of_point(near.edges);
            let edges: Vec<_> = edges.iter().map(|&e| [name(e), name(e + 1)]).collect();
            let vertices: Vec<u32> = of_point(near.vertices);
            let vertices: Vec<_> = vertices.iter().map(|&v| name(v)).collect();
            let near = others().filter(|&e| outlines.vertex_is_near(own, e, RANGE));
            assert_eq!(edges, near.map(|e| [e, outlines.next(e)]).collect::<Vec<_>>(), "edges near vertex {own:?}");
            let near = others().filter(|&v| outlines.vertex_is_near(v, own, RANGE));
            assert_eq!(vertices, near.collect::<Vec<_>>(), "vertices near edge {own:?}");
        }
        outcome.extend(describe(&mut system));

        let (pbox, own) = (*system.pbox(), system.own_particles());
        let model = jamhpc::model::Deformable::<EdgeEdge>::new(polygon_parameters());
        let mut system = System::new(system.comm, model, pbox, &pbox, own, 0.1).unwrap();
        system.prepare().unwrap();
        let outlines = Outlines { pbox: &pbox, all: &all };
        let particles = system.particles();
        for point in 0..particles.owned_points() as u32 {
            let own = name_of(particles, point);
            let row = system.view().lists.edges.row(point as usize);
            let listed: Vec<_> = row.iter().map(|e| (e.ends.map(|p| name_of(particles, p)), e.ours_first)).collect();
            let near = outlines.of_others(own.0).filter(|&e| outlines.edges_are_near(own, e, RANGE));
            let right: Vec<_> = near.map(|e| ([e, outlines.next(e)], own.0 < e.0)).collect();
            assert_eq!(listed, right, "edges near edge {own:?}");
        }
        outcome.extend(describe(&mut system));
        comm = system.comm;
    }
    outcome
}

/// Shrinks, shears and shakes, and compares forces with a system built afresh every few steps.
fn changing_box<M: Model + Clone>(mut system: System<M>, skin: f64, shake_by: f64) -> Outcome {
    const STEPS: u32 = 120;
    system.carry(1);
    system.prepare().unwrap();
    let mut outcome = Vec::new();
    for step in 0..STEPS {
        let b = *system.pbox();
        // shear and compression of a fraction of the skin a step, now and then a decompression
        let shrink: f64 = if step % 5 == 4 { 1.004 } else { 0.998 };
        let to = PeriodicBox::new(shrink * b.lx(), shrink * b.ly(), shrink * b.xy() + 0.004 * b.ly());
        if step % 2 == 0 {
            system.deform(to)
        } else {
            system.deform_rigidly(to)
        }
        shake(&mut system, shake_by, step as f64);
        if step % 3 == 0 {
            assert_forces_as_rebuilt(&mut system, skin, &format!("step {step}"));
        } else {
            system.max_force().unwrap();
        }
        if step % 40 == 39 {
            outcome.extend(describe(&mut system));
        }
    }
    let rebuilds = system.counters.rebuilds;
    assert!(rebuilds > 3, "the lists never grew old: {rebuilds}");
    assert!(rebuilds < STEPS as u64 / 3, "{rebuilds} rebuilds in {STEPS} steps");
    // how often lists are made must not depend on the ranks either
    outcome.push(format!("{rebuilds} rebuilds"));
    outcome
}

pub fn changing_box_sp(comm: Comm) -> Outcome {
    changing_box(random_sp(comm, 300, unit_box(0.0), 0.85, 1.2), 0.3, 0.01)
}

pub fn changing_box_dp(comm: Comm) -> Outcome {
    changing_box(random_dp::<VertexEdge>(comm, 64, unit_box(0.0), 0.7, 0.95), 0.1, 0.002)
}

/// Nothing that leaves the lists valid makes them anew: evaluating, observing, trembling on the spot, slight strain.
pub fn rebuilds_when_needed(comm: Comm) -> Outcome {
    let mut system = random_sp(comm, 300, unit_box(0.0), 0.85, 1.2);
    for _ in 0..10 {
        describe(&mut system);
    }
    assert_eq!(system.counters.rebuilds, 1, "a static system");

    // to and fro a thousand times: travel adds up to a hundred skins, but no point gets anywhere
    system.carry(1);
    for k in 0..1000 {
        let there_and_back = if k % 2 == 0 { 0.03 } else { -0.03 };
        system.move_points(0.0301, |pbox, positions, _, _| {
            positions.iter_mut().for_each(|p| *p = pbox.moved(*p, [there_and_back, 0.0]));
        });
        system.max_force().unwrap();
    }
    assert_eq!(system.counters.rebuilds, 1, "trembling");

    // a skin of 0.3 on diameters up to 1.4 lasts for a compression by 1.4/1.7; nine tenths of it without a rebuild
    let whole_box = *system.pbox();
    for k in 0..15 {
        system.deform(whole_box.with_area(whole_box.area() * (1.0 - 0.01 * k as f64).powi(2)));
        system.max_force().unwrap();
    }
    assert_eq!(system.counters.rebuilds, 1, "compression by 14 % of the edge");
    system.deform(whole_box.with_area(whole_box.area() * 0.82f64.powi(2)));
    system.max_force().unwrap();
    assert_eq!(system.counters.rebuilds, 2, "compression by 18 % of the edge");

    // a balanced state that is minimised again stays where it is
    system.deform(whole_box);
    let balanced = goal(1e-8, 100_000);
    assert!(Fire.minimize(&mut system, &balanced).unwrap().is_converged());
    let before = system.counters.rebuilds;
    let goal = goal(0.0, 5000);
    let _ = Fire.minimize(&mut system, &goal).unwrap();
    assert!(
        system.counters.rebuilds <= before + 1,
        "{} rebuilds of a packing at rest",
        system.counters.rebuilds - before
    );
    vec![format!("{} rebuilds", system.counters.rebuilds)]
}

/// Two disks that travel in a compressed box, which then widens: their travel widens with it.
pub fn travel_in_the_present_box(comm: Comm) -> Outcome {
    let wide = PeriodicBox::square(16.0);
    let narrow = PeriodicBox::square(16.0 * 0.6);
    let mut disks = Particles::empty(&Bodies::Disks);
    if comm.is_root() {
        disks.push(0, 1.0, &[wide.frac([7.0 - 0.0005, 8.0])]);
        disks.push(1, 1.0, &[wide.frac([9.0 + 0.0005, 8.0])]);
    }
    // range and skin 2, distance 2.001: not in the list
    let mut system = System::new(comm, DISKS, wide, &narrow, disks, 1.0).unwrap();
    system.carry(1);
    system.max_force().unwrap();
    let approach = |system: &mut System<_>, by: f64| {
        system.move_points(by, |pbox, positions, _, _| {
            for p in positions {
                let x = if p.fractions()[0] < 0.5 { by } else { -by };
                *p = pbox.moved(*p, [x, 0.0]);
            }
        });
        system.max_force().unwrap();
    };
    system.deform(narrow);
    system.max_force().unwrap();
    approach(&mut system, 0.099); // 0.165 in the wide box
    system.deform(wide);
    system.max_force().unwrap();
    approach(&mut system, 0.4);
    assert_forces_as_rebuilt(&mut system, 1.0, "after the approach");
    let touching = system.contacts().unwrap().iter().all(|c| c.len() == 1);
    assert!(touching, "the disks overlap by 0.13");
    describe(&mut system)
}
