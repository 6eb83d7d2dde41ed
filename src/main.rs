use jamhpc::comm::*;
use jamhpc::engine::*;
use jamhpc::geometry::*;
use jamhpc::minimize::*;
use jamhpc::model::*;
use jamhpc::protocol::*;
fn main() {
    let s = Session::start();
    let comm = s.world();
    let a: Vec<String> = std::env::args().collect();
    let n: u32 = a[2].parse().unwrap();
    let seed: u64 = a[3].parse().unwrap();
    let root = comm.is_root();
    let t = std::time::Instant::now();
    if a[1] == "sp" {
        let sp = [
            Species { count: n / 2, size: 1.0, n_vertices: 1 },
            Species { count: n - n / 2, size: 1.4, n_vertices: 1 },
        ];
        let area: f64 = sp.iter().map(|s| s.count as f64 * s.undeformed_area(0.0)).sum();
        let pbox = PeriodicBox::square((area / 0.2).sqrt());
        let d = random_disks(&comm, &sp, seed, |s| s.size);
        let mut sys =
            System::new(comm, SoftDisks { epsilon: 1.0, smallest: 1.0 }, pbox, &pbox.with_area(area), d, 0.3).unwrap();
        let goal = Goal { force_tolerance: 1e-13, max_iterations: 1000000, stop_when_free: false };
        let on = find_onset(
            &mut sys,
            &Fire::default(),
            &goal,
            &OnsetSearch { step: 0.04, smallest_step: 1e-12, pressure: [1e-10, 1e-8] },
            |d, e, r| {
                if root {
                    println!("{d:.9} {:.3e} it {} f {}", e.pressure(), r.iterations, r.force_evaluations)
                }
            },
        )
        .unwrap();
        let c = sys.contacts().unwrap();
        let nc: usize = c.iter().map(|c| c.len()).sum::<usize>();
        let e = sys.energies();
        if root {
            println!("{on:?} {nc} {:?} {:?} {:?}", sys.counters, t.elapsed(), e);
        }
    } else {
        let aS: f64 = (24.0f64 / 29.0).powi(2);
        let al = aS * (17.0f64 / 12.0).powi(2);
        let sp = [
            Species { count: n / 2, size: aS, n_vertices: 12 },
            Species { count: n - n / 2, size: al, n_vertices: 17 },
        ];
        let delta = 0.1;
        let ka = 1000.0 / aS / aS;
        let e: f64 = a[4].parse().unwrap();
        let law = Harmonic { epsilon: e * ka * al * al, delta };
        let area: f64 = sp.iter().map(|s| s.count as f64 * s.undeformed_area(delta)).sum();
        let pbox = PeriodicBox::square((area / 0.2).sqrt());
        let (comm, p) = deformable_particles(comm, pbox, &sp, seed, delta).unwrap();
        let par =
            DeformableParameters { line_tension: 1.0, k_area: ka, contact: law, largest_area_per_vertex: al / 17.0 };
        let skin: f64 = a[5].parse().unwrap();
        let mut sys =
            System::new(comm, Deformable::<VertexEdge>::new(par), pbox, &pbox.with_area(area), p, skin).unwrap();
        let goal = Goal { force_tolerance: 1e-9, max_iterations: 1000000, stop_when_free: false };
        let f = Fire::default();
        let on = find_onset(
            &mut sys,
            &f,
            &goal,
            &OnsetSearch { step: 0.04, smallest_step: 1e-12, pressure: [1e-7, 1e-5] },
            |d, e, r| {
                if root {
                    println!("{d:.9} {:.3e} it {} f {}", e.pressure(), r.iterations, r.force_evaluations)
                }
            },
        )
        .unwrap();
        let c = sys.contacts().unwrap();
        let nc: usize = c.iter().map(|c| c.len()).sum::<usize>();
        let e = sys.energies();
        if root {
            println!("{on:?} {nc} {:?} {:?} {:?}", sys.counters, t.elapsed(), e);
        }
        for d in (Increments::Until { density: 0.95, step: 0.01 }).densities(on.density) {
            let t = std::time::Instant::now();
            let r = compress_to(&mut sys, &f, &goal, d).unwrap();
            let rho = sys.density().unwrap();
            let e = sys.energies().unwrap();
            let nc: usize = sys.contacts().unwrap().iter().map(|c| c.len()).sum::<usize>();
            if root {
                println!(
                    "{d:.6} {:.6} {:?} z {} P {:.6} mismatch {:.2e} {:?} {:?}",
                    rho,
                    r,
                    nc as f64 / n as f64,
                    e.pressure(),
                    e.stress_mismatch(),
                    t.elapsed(),
                    sys.counters
                );
            }
        }
    }
}
