//! Configurations that are no minimum and have no symmetry: what derivatives are compared on.

use jamhpc::comm::Comm;
use jamhpc::engine::System;
use jamhpc::exchange::Configuration;
use jamhpc::geometry::PeriodicBox;
use jamhpc::model::{DeformableParameters, Harmonic, Model};
use jamhpc::particles::Particles;

pub const DISKS: &str = include_str!("../cases/sp_n64_phi090.json");
pub const SHEARED: &str = include_str!("../cases/dp_random_sheared.json");
pub const SQUARE: &str = include_str!("../cases/dp_jammed_rho095.json");

/// Numbers in (−1, 1) that look random and never change.
pub fn noise(k: usize) -> f64 {
    let x = (k as f64 + 1.0) * 0.618_033_988_749_895;
    let y = (x - x.floor()) * 57.0 * (1.0 + x.sqrt());
    2.0 * (y - y.floor()) - 1.0
}

/// A configuration with all its points moved by a random bit, in a box tilted by so much more.
pub fn shaken(text: &str, by: f64, tilt: f64) -> (PeriodicBox, Particles) {
    let configuration = Configuration::read(text).unwrap();
    let mut particles = configuration.particles(0, 1);
    let pbox = configuration.pbox();
    for (k, point) in particles.position.iter_mut().enumerate() {
        *point = pbox.moved(*point, [by * noise(2 * k), by * noise(2 * k + 1)]);
    }
    (PeriodicBox::new(pbox.lx(), pbox.ly(), pbox.xy() + tilt), particles)
}

/// Deformable particles in a sheared box and in a square one that is tilted, with the contact width at which they press
/// into each other.
pub fn deformable(tilt: f64) -> [(PeriodicBox, Particles, f64); 2] {
    let (sheared, first) = shaken(SHEARED, 0.003, 0.0);
    let (square, second) = shaken(SQUARE, 0.01, tilt);
    [(sheared, first, 0.12), (square, second, 0.27)]
}

/// The second in a square box and in one that is tilted: both are wide enough where edges act on edges.
pub fn deformable_in_wide_boxes(tilt: f64) -> [(PeriodicBox, Particles, f64); 2] {
    [0.0, tilt].map(|tilt| {
        let (pbox, particles) = shaken(SQUARE, 0.01, tilt);
        (pbox, particles, 0.27)
    })
}

pub fn parameters(line_tension: f64, k_area: f64, epsilon: f64, delta: f64) -> DeformableParameters {
    let contact = Harmonic { epsilon, delta };
    DeformableParameters { line_tension, k_area, contact, largest_area_per_vertex: 0.1 }
}

pub fn system<M: Model + Copy>(model: M, pbox: PeriodicBox, particles: &Particles) -> System<M> {
    System::new(Comm::alone(), model, pbox, &pbox, particles.clone(), 0.01).unwrap()
}
