//! The Hessian and the moduli against finite differences of forces and stresses, in square and sheared boxes.

mod perturbed;

use jamhpc::geometry::{PeriodicBox, Vec2};
use jamhpc::minimize::{Fire, Goal, Minimizer};
use jamhpc::model::{Deformable, EdgeEdge, Model, Prestress, SoftDisks, VertexEdge};
use jamhpc::observe::{Moduli, Spectrum, Stability};
use jamhpc::particles::{Bodies, Particles};
use jamhpc::protocol::quasi_static_shear_modulus;
use jamhpc::stiffness::{Cholesky, Stiffness, elastic};
use perturbed::*;

fn forces<M: Model + Copy>(model: M, pbox: PeriodicBox, particles: &Particles) -> Vec<Vec2> {
    let mut system = system(model, pbox, particles);
    system.max_force().unwrap();
    // the order of storage depends on the box
    let stored = system.particles();
    let mut of_particle: Vec<(u32, Vec<Vec2>)> =
        (0..stored.len()).map(|p| (stored.id[p], system.forces()[stored.bodies.points(p)].to_vec())).collect();
    of_particle.sort_by_key(|&(id, _)| id);
    of_particle.into_iter().flat_map(|(_, forces)| forces).collect()
}

/// Fourth-order central difference of f at 0.
fn derivative(step: f64, f: impl Fn(f64) -> Vec<f64>) -> Vec<f64> {
    let [a, b, c, d] = [step, -step, 2.0 * step, -2.0 * step].map(&f);
    (0..a.len()).map(|k| (8.0 * (a[k] - b[k]) - (c[k] - d[k])) / (12.0 * step)).collect()
}

fn close(name: &str, got: &[f64], expected: &[f64], tolerance: f64) {
    let size = expected.iter().fold(0.0, |m: f64, x| m.max(x.abs()));
    for (k, (g, e)) in got.iter().zip(expected).enumerate() {
        assert!((g - e).abs() <= tolerance * size, "{name} {k}: {g} instead of {e} (size {size})");
    }
}

/// Compares H u, the affine forces and the second derivatives by the strain with differences over `step`.
fn check<M: Model + Copy>(model: M, pbox: PeriodicBox, particles: &Particles, step: f64) {
    let mut here = system(model, pbox, particles);
    let largest = here.max_force().unwrap();
    assert!(largest > 0.0, "nothing acts");
    let stiffness = Stiffness::of(&mut here, Prestress::ALL).unwrap();
    let stored = here.own_particles();
    let n = stored.owned_points();
    let direction: Vec<Vec2> = (0..n).map(|k| [noise(3 * k), noise(3 * k + 1)]).collect();
    // the product with another vector beside it is the same
    let mut products = vec![[[0.0; 2]; 2]; n];
    let beside = direction.iter().map(|&d| [[d[1], 0.3], d]).collect();
    stiffness.product(&mut here, &mut { beside }, &mut products);
    let product: Vec<Vec2> = products.iter().map(|row| row[1]).collect();
    let slope = derivative(step, |h| {
        let mut moved = stored.clone();
        for (point, d) in moved.position.iter_mut().zip(&direction) {
            *point = pbox.moved(*point, [h * d[0], h * d[1]]);
        }
        forces(model, pbox, &moved).concat()
    });
    let by_id = |of_points: &[Vec2]| {
        let mut order: Vec<usize> = (0..stored.len()).collect();
        order.sort_by_key(|&p| stored.id[p]);
        let rows = order.iter().flat_map(|&p| of_points[stored.bodies.points(p)].iter().copied());
        rows.flatten().collect::<Vec<f64>>()
    };
    let minus: Vec<f64> = by_id(&product).iter().map(|x| -x).collect();
    assert!(slope.iter().any(|&x| x != 0.0), "nothing to compare");
    close("H u", &minus, &slope, 1e-7);

    let affine = stiffness.affine_forces(&here);
    let whole = elastic(&mut here).unwrap();
    let (lx, ly, xy) = (pbox.lx(), pbox.ly(), pbox.xy());
    // the components that a box with its first edge along x can show, with their place on the diagonal of the tensor
    for (name, component, diagonal) in [("xx", 0, 0), ("xy", 1, 4), ("yy", 3, 9)] {
        let box_of = |e: f64| match component {
            0 => PeriodicBox::new(lx * (1.0 + e), ly, xy * (1.0 + e)),
            1 => pbox.sheared(e),
            _ => PeriodicBox::new(lx, ly * (1.0 + e), xy),
        };
        let slope = derivative(step, |e| forces(model, box_of(e), &stored).concat());
        assert!(slope.iter().any(|&x| x != 0.0), "nothing to compare");
        close(&format!("affine forces {name}"), &by_id(&affine[component]), &slope, 1e-7);
        // dU/dE = −A Σ F⁻ᵀ: with these strains the component itself, over 1 + e for a stretch
        let work = derivative(step, |e| {
            let strained = box_of(e);
            let energies = system(model, strained, &stored).energies().unwrap();
            let stretch = if component == 1 { 1.0 } else { 1.0 + e };
            vec![-energies.virial[component] * strained.area() / stretch]
        });
        close(&format!("elastic {name}"), &[whole[diagonal]], &work, 1e-6);
    }
    // both off-diagonal shears of an isotropic tensor would be equal; here the rotation ties them together:
    // C_xyxy − C_xyyx = −dU/dE_yy, the energy being the same for rotated boxes
    let stress = here.energies().unwrap().virial;
    let work = -stress[3] * pbox.area();
    let size = whole[4].abs().max(work.abs());
    assert!((whole[4] - whole[5] - work).abs() <= 1e-9 * size, "{} - {} against {work}", whole[4], whole[5]);
}

#[test]
fn soft_disks() {
    for tilt in [0.0, 2.3] {
        let (pbox, particles) = shaken(DISKS, 0.05, tilt);
        check(SoftDisks { epsilon: 1.3, smallest: 1.0 }, pbox, &particles, 1e-6);
    }
}

#[test]
fn line_tension() {
    for (pbox, particles, delta) in deformable(0.3) {
        check(Deformable::<VertexEdge>::new(parameters(1.7, 0.0, 0.0, delta)), pbox, &particles, 1e-5);
    }
}

#[test]
fn area() {
    for (pbox, particles, delta) in deformable(0.3) {
        check(Deformable::<VertexEdge>::new(parameters(0.0, 300.0, 0.0, delta)), pbox, &particles, 1e-5);
    }
}

#[test]
fn vertex_edge_contacts() {
    for (pbox, particles, delta) in deformable(0.3) {
        check(Deformable::<VertexEdge>::new(parameters(0.0, 0.0, 50.0, delta)), pbox, &particles, 1e-7);
    }
}

#[test]
fn edge_edge_contacts() {
    for (pbox, particles, delta) in deformable_in_wide_boxes(0.3) {
        check(Deformable::<EdgeEdge>::new(parameters(0.0, 0.0, 50.0, delta)), pbox, &particles, 1e-7);
    }
}

/// Triangular lattice of disks, spacing f σ: G = (√3 ε/4σ²)(1 − 3(1 − f)/f), K = −A dp/dA with p = √3 ε(1 − f)/(f σ²).
#[test]
fn triangular_lattice() {
    let f: f64 = 0.97;
    let (columns, rows) = (6, 6);
    let pbox = PeriodicBox::new(columns as f64 * f, rows as f64 * f * 0.75f64.sqrt(), 0.0);
    let mut particles = Particles::empty(&jamhpc::particles::Bodies::Disks);
    for row in 0..rows {
        for column in 0..columns {
            let at = [(column as f64 + 0.5 * (row % 2) as f64) * f, row as f64 * f * 0.75f64.sqrt()];
            particles.push((row * columns + column) as u32, 1.0, &[pbox.frac(at)]);
        }
    }
    let mut lattice = system(SoftDisks { epsilon: 1.0, smallest: 1.0 }, pbox, &particles);
    let moduli = Moduli::of(&mut lattice).unwrap();
    let shear = 3.0f64.sqrt() / 4.0 * (1.0 - 3.0 * (1.0 - f) / f);
    // p depends on the area through f ∝ √A: −A dp/dA = −(f/2) dp/df
    let bulk = 3.0f64.sqrt() / (2.0 * f);
    assert_eq!(moduli.stability, Stability::Stable);
    for modulus in [moduli.shear_modulus, moduli.pure_shear_modulus] {
        assert!((modulus.linear_response - shear).abs() < 1e-12, "{modulus:?} instead of {shear}");
        assert!((modulus.affine - shear).abs() < 1e-12);
    }
    assert!((moduli.mean_shear_modulus - shear).abs() < 1e-12);
    assert!((moduli.bulk_modulus.linear_response - bulk).abs() < 1e-12, "{:?} instead of {bulk}", moduli.bulk_modulus);
}

/// Reference values of an independent implementation.
#[test]
fn jammed_packings() {
    fn moduli<M: Model + Copy>(model: M, text: &str) -> Moduli {
        let (pbox, particles) = shaken(text, 0.0, 0.0);
        let mut system = system(model, pbox, &particles);
        assert!(system.max_force().unwrap() < 1e-9);
        let moduli = Moduli::of(&mut system).unwrap();
        assert_eq!(moduli.stability, Stability::Stable, "{moduli:?}");
        moduli
    }
    let of = |text: &str| {
        let case: serde_json::Value = serde_json::from_str(text).unwrap();
        let number = |path: &str| case.pointer(path).and_then(|v| v.as_f64());
        (
            number("/expected/shear_modulus/linear_response"),
            number("/expected/shear_modulus/affine"),
            number("/expected/bulk_modulus"),
            number("/input/k_area"),
            number("/input/epsilon"),
            number("/input/delta"),
        )
    };
    let (linear, affine, bulk, _, epsilon, _) = of(DISKS);
    let disks = moduli(SoftDisks { epsilon: epsilon.unwrap(), smallest: 1.0 }, DISKS);
    println!("{disks:?}");
    close(
        "G of disks",
        &[disks.shear_modulus.linear_response, disks.shear_modulus.affine, disks.bulk_modulus.linear_response],
        &[linear.unwrap(), affine.unwrap(), bulk.unwrap()],
        1e-9,
    );
    let (linear, affine, _, k_area, epsilon, delta) = of(SQUARE);
    let model = Deformable::<VertexEdge>::new(parameters(1.0, k_area.unwrap(), epsilon.unwrap(), delta.unwrap()));
    let polygons = moduli(model, SQUARE);
    println!("{polygons:?}");
    close("G of polygons", &[polygons.shear_modulus.linear_response], &[linear.unwrap()], 1e-6);
    close("affine G of polygons", &[polygons.shear_modulus.affine], &[affine.unwrap()], 1e-6);
}

/// G by relaxed strains of the box and by linear response, from one state.
#[test]
fn quasi_static_strain_agrees() {
    fn check<M: Model + Copy>(model: M, text: &str, force_tolerance: f64) {
        let (pbox, particles) = shaken(text, 0.0, 0.0);
        let mut system = system(model, pbox, &particles);
        let goal = Goal { force_tolerance, max_iterations: 1_000_000 };
        assert!(Fire.minimize(&mut system, &goal).unwrap().is_converged());
        let linear = Moduli::of(&mut system).unwrap().shear_modulus.linear_response;
        let strained = quasi_static_shear_modulus(&mut system, &Fire, &goal, 5e-5).unwrap();
        println!("{linear} {strained}: {:e}", strained / linear - 1.0);
        assert!((strained - linear).abs() < 1e-6 * linear, "{strained} instead of {linear}");
        // the system is as it was
        assert_eq!(*system.pbox(), pbox);
        assert!(system.max_force().unwrap() <= force_tolerance);
    }
    check(SoftDisks { epsilon: 1.0, smallest: 1.0 }, DISKS, 1e-14);
    let case: serde_json::Value = serde_json::from_str(SQUARE).unwrap();
    let number = |key: &str| case["input"][key].as_f64().unwrap();
    let mut model = parameters(1.0, number("k_area"), number("epsilon"), number("delta"));
    model.largest_area_per_vertex = 0.11;
    // rounding leaves forces of 1e-14 ε
    check(Deformable::<VertexEdge>::new(model), SQUARE, 5e-11);
}

/// A minimum has two zero modes, the shifts of the whole, and no negative one; points by themselves have nothing else.
#[test]
fn spectra() {
    let (pbox, particles) = shaken(DISKS, 0.0, 0.0);
    let model = SoftDisks { epsilon: 1.0, smallest: 1.0 };
    let jammed = Spectrum::of(&mut system(model, pbox, &particles)).unwrap().unwrap();
    assert_eq!((jammed.eigenvalues.len(), jammed.n_zero, jammed.n_negative), (128, 2, 0));
    // in a box so large that nothing touches
    let wide = PeriodicBox::square(3.0 * pbox.lx());
    let loose = Spectrum::of(&mut system(model, wide, &particles)).unwrap().unwrap();
    assert_eq!((loose.n_zero, loose.n_negative), (128, 0));
    // the same packing turned over by a random push is no minimum
    let (_, pushed) = shaken(DISKS, 0.3, 0.0);
    assert!(Spectrum::of(&mut system(model, pbox, &pushed)).unwrap().unwrap().n_negative > 0);
    let (pbox, particles) = shaken(SQUARE, 0.0, 0.0);
    let model = Deformable::<VertexEdge>::new(parameters(1.0, 100.0, 1e4, 0.1));
    let polygons = Spectrum::of(&mut system(model, pbox, &particles)).unwrap().unwrap();
    assert_eq!(polygons.eigenvalues.len(), 2 * particles.owned_points());
    assert!(polygons.eigenvalues.windows(2).all(|pair| pair[0] <= pair[1]));
}

/// A factor of H + s exists from the lowest eigenvalue of −H on, and solves (H + s) u = b.
fn check_factor<M: Model + Copy>(model: M, pbox: PeriodicBox, particles: &Particles) {
    let mut system = system(model, pbox, particles);
    let eigenvalues = Spectrum::of(&mut system).unwrap().unwrap().eigenvalues;
    let (lowest, highest) = (eigenvalues[0], eigenvalues[eigenvalues.len() - 1]);
    assert!(lowest < -1e-6 * highest, "{lowest} {highest}");
    let stiffness = Stiffness::of(&mut system, Prestress::ALL).unwrap();
    let mut cholesky = Cholesky::default();
    cholesky.load(&system, &stiffness);
    let margin = 1e-9 * highest;
    assert!(!cholesky.factorize(&system.comm, -lowest - margin));
    assert!(!cholesky.factorize(&system.comm, f64::NAN));
    for shift in [0.01 * highest - lowest, -lowest + margin] {
        assert!(cholesky.factorize(&system.comm, shift));
        let u: Vec<Vec2> = (0..particles.owned_points()).map(|k| [noise(3 * k), noise(3 * k + 1)]).collect();
        let mut product = vec![[[0.0; 2]]; u.len()];
        stiffness.product(&mut system, &mut u.iter().map(|&u| [u]).collect(), &mut product);
        let b: Vec<Vec2> = product.iter().zip(&u).map(|(p, u)| [0, 1].map(|k| p[0][k] + shift * u[k])).collect();
        let rounding = 1e-14 * highest / (shift + lowest);
        close("solution", cholesky.solve(&system, &b).as_flattened(), u.as_flattened(), 100.0 * rounding);
    }
}

/// Without what buckles, springs pull back every motion that changes their length, and nothing pushes.
#[test]
fn braced_disks_are_stable() {
    for tilt in [0.0, 2.3] {
        let (pbox, pushed) = shaken(DISKS, 0.3, tilt);
        let mut system = system(SoftDisks { epsilon: 1.0, smallest: 1.0 }, pbox, &pushed);
        let is_stable = [Prestress::ALL, Prestress::ALL.braced()].map(|prestress| {
            let mut cholesky = Cholesky::default();
            let stiffness = Stiffness::of(&mut system, prestress).unwrap();
            cholesky.load(&system, &stiffness);
            cholesky.factorize(&system.comm, 1e-9)
        });
        assert_eq!(is_stable, [false, true]);
    }
}

/// The corner of a square pressed on that of another by f at the distance d: all that is missing when braced is −f/d
/// across.
#[test]
fn braced_corners_keep_all_but_their_buckling() {
    let square = |x: f64| [[x + 1.0, 3.0], [x, 4.0], [x - 1.0, 3.0], [x, 2.0]];
    let (pbox, apart) = (PeriodicBox::square(10.0), 0.09);
    let mut particles = Particles::empty(&Bodies::Polygons { first: vec![0] });
    for (id, corners) in [square(3.0), square(5.0 + apart)].iter().enumerate() {
        particles.push(id as u32, 1.0, &corners.map(|corner| pbox.frac(corner)));
    }
    let model = |epsilon: f64| Deformable::<VertexEdge>::new(parameters(1.0, 100.0, epsilon, 0.1));
    let [with, without] = [1e4, 0.0].map(|epsilon| forces(model(epsilon), pbox, &particles));
    let push: f64 = with.iter().zip(&without).map(|(a, b)| (a[0] - b[0]).abs()).sum::<f64>() / 2.0;
    assert!(push > 0.1);
    let mut system = system(model(1e4), pbox, &particles);
    let forms = [Prestress::ALL, Prestress::ALL.braced()].map(|part| Stiffness::of(&mut system, part).unwrap());
    let mut missing = [[0.0; 2]; 2];
    for (moved, axis) in (0..8).flat_map(|point| [(point, 0), (point, 1)]) {
        let [all, braced] = [0, 1].map(|k| {
            let mut u = vec![[[0.0; 2]]; 8];
            u[moved][0][axis] = 1.0;
            let mut product = u.clone();
            forms[k].product(&mut system, &mut u, &mut product);
            product
        });
        for (along, sum) in missing[axis].iter_mut().enumerate() {
            *sum += (0..8).map(|i| (all[i][0][along] - braced[i][0][along]).abs()).sum::<f64>();
        }
    }
    // of both corners for both
    close("across", missing.as_flattened(), &[0.0, 0.0, 0.0, 4.0 * push / apart], 1e-9);
}

#[test]
fn factors() {
    for tilt in [0.0, 2.3] {
        let (pbox, pushed) = shaken(DISKS, 0.3, tilt);
        check_factor(SoftDisks { epsilon: 1.0, smallest: 1.0 }, pbox, &pushed);
    }
    for (pbox, particles, delta) in deformable(0.3) {
        check_factor(Deformable::<VertexEdge>::new(parameters(1.7, 300.0, 50.0, delta)), pbox, &particles);
        // line tension and contacts alone
        check_factor(Deformable::<VertexEdge>::new(parameters(1.7, 0.0, 50.0, delta)), pbox, &particles);
    }
}
