//! Results files on any number of ranks, however the particles lie on them.

use jamhpc::comm::Comm;
use jamhpc::geometry::{Frac, PeriodicBox};
use jamhpc::output::render::{Look, packing, write_packing};
use jamhpc::output::{Frame, Header, OutputError, Results, ResultsFile};
use jamhpc::particles::{Bodies, Column, Particles};
use std::path::Path;

const COUNT: u32 = 37;

/// Any bits, the same on all ranks.
fn noise(id: u32, k: u32, frame: u32) -> i64 {
    let seed = (id as u64) << 40 | (k as u64) << 20 | frame as u64;
    (seed + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15).rotate_left(31).wrapping_mul(0xD6E8_FEB8_6659_FD93) as i64
}

/// This rank's share of a system: particles are dealt out unevenly, in no order, differently at each frame.
fn share(comm: &Comm, polygons: bool, frame: u32) -> Particles {
    let bodies = if polygons { Bodies::Polygons { first: vec![0] } } else { Bodies::Disks };
    let mut particles = Particles::empty(&bodies);
    for id in (0..COUNT).rev() {
        // rank 1 never has any
        let owner = noise(id, 0, frame).unsigned_abs() as usize % comm.size();
        if (if owner == 1 { 0 } else { owner }) == comm.rank() {
            let points = if polygons { 3 + id % 5 } else { 1 };
            let points: Vec<Frac> =
                (0..points).map(|k| Frac::from_bits([noise(id, 2 * k, frame), noise(id, 2 * k + 1, frame)])).collect();
            particles.push(id, 1.0 + id as f64 / 7.0, &points);
        }
    }
    particles
}

/// Writes `frames` samples to `path`.
pub fn write(comm: &Comm, path: &Path, polygons: bool, frames: u32) -> Result<(), OutputError> {
    let header = Header { scene: "n = 37\n".to_owned(), seed: 5, contact: "none".to_owned(), ..Header::default() };
    let mut file = ResultsFile::create(comm, path, &header, &share(comm, polygons, 99))?;
    for frame in 0..frames {
        let particles = share(comm, polygons, frame);
        let pbox = PeriodicBox::new(9.0, 8.0 + frame as f64 / 3.0, 0.25);
        let columns: [(_, Column); 2] = [
            ("z", Box::new(|p| noise(particles.id[p], 77, frame) as f64)),
            ("pressure", Box::new(|_| 1.5)),
        ];
        let scalars = [("density", 0.8 + frame as f64 / 30.0), ("pressure", 1e-5)];
        let tensors = [("stress", [1.0, 2.0, 3.0, frame as f64])];
        let (scalars, tensors) = (&scalars[..], &tensors[..]);
        let step = frame as u64;
        let sample = Frame { step, pbox: &pbox, particles: &particles, scalars, tensors, columns: &columns };
        if let Err(error) = file.append(comm, &sample) {
            file.finish(comm, Some(&error.to_string()))?;
            return Err(error);
        }
    }
    file.finish(comm, None).map(drop)
}

/// Reads every sample of [`write`] and compares it with what was written, bit for bit.
pub fn check(comm: &Comm, path: &Path, polygons: bool, frames: u32) {
    let results = Results::open(comm, path).unwrap();
    assert_eq!((results.frames, results.particles), (frames as usize, COUNT as usize));
    for frame in 0..frames {
        let at = results.frame(comm, frame as usize).unwrap();
        assert_eq!(at.pbox, PeriodicBox::new(9.0, 8.0 + frame as f64 / 3.0, 0.25));
        assert_eq!(comm.sum_count(at.particles.len() as u64), COUNT as u64);
        for (p, &id) in at.particles.id.iter().enumerate() {
            assert_eq!(at.particles.size[p], 1.0 + id as f64 / 7.0);
            let points = if polygons { 3 + id % 5 } else { 1 };
            let expected: Vec<_> =
                (0..points).map(|k| Frac::from_bits([noise(id, 2 * k, frame), noise(id, 2 * k + 1, frame)])).collect();
            assert_eq!(at.particles.points_of(p), expected);
            let z = &at.columns.iter().find(|(name, _)| name == "z").unwrap().1;
            assert_eq!(z[p], noise(id, 77, frame) as f64);
        }
    }
}

/// Draws the particles of frame 0: the picture must be the same bytes on any number of ranks.
pub fn draw(comm: &Comm, path: &Path, polygons: bool) -> Result<(), OutputError> {
    let particles = share(comm, polygons, 0);
    let values: Vec<f64> = particles.id.iter().map(|&id| id as f64).collect();
    let touching: Vec<[u32; 1]> = particles.id.iter().map(|&id| [(id + 1) % COUNT]).collect();
    let contacts = |p: usize| &touching[p][..];
    let look = Look { part: None, delta: 0.1, values: &values, value_name: "id", contacts: &contacts, caption: "noise" };
    write_packing(comm, path, packing(comm, &PeriodicBox::new(9.0, 8.0, 0.25), &particles, &look).as_ref())
}
