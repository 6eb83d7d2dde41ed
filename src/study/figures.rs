//! The paper's figures from a data set, each by its number there.

use super::data::{Ensemble, Packing, Packings, Quantity};
use super::findings::{of_ensemble, of_size, table_size, window};
use super::paper;
use crate::output::plot::{Axes, Series, Style};
use crate::scene::Model;
use crate::statistics::{mean, spread};
use Quantity::*;

/// The figure that shows packings.
pub const PACKINGS: u8 = 2;
/// Numbers of all figures.
pub const NUMBERS: [u8; 8] = [PACKINGS, 3, 4, 5, 6, 7, 9, 10];

/// A figure: its panels, and how many stand side by side.
pub struct Figure {
    pub caption: &'static str,
    pub panels: Vec<Axes>,
    pub columns: usize,
}

/// A figure by its number in the paper; none if it is not one of [`NUMBERS`], or
/// shows [`PACKINGS`].
pub fn figure(number: u8, ensembles: &[Ensemble]) -> Option<Figure> {
    let (caption, panels, columns) = match number {
        3 => ("Packing fraction, particle area and shape above onset", density_and_shape(ensembles), 3),
        4 => ("Contact number and shear modulus against density", against_density(ensembles), 2),
        5 => ("Excess contacts and shear modulus above onset, and their collapse", scaling(ensembles), 3),
        6 => ("Contacts missing at confluence", confluence(ensembles), 2),
        7 => ("Voids by their number of sides, and the shape of those with three", voids(ensembles), 2),
        9 => ("Jamming onsets", onsets(ensembles), 2),
        10 => ("Scaling of overlap, area and shape", exponents(ensembles), 3),
        _ => return None,
    };
    Some(Figure { caption, panels, columns })
}

const BLACK: usize = 6;

/// Marker of a system size: squares, disks, triangles up and down for 32, 64, 128 and 256, as in the paper.
fn marker(n_particles: usize) -> usize {
    match n_particles {
        32 => 1,
        64 => 0,
        128 => 2,
        256 => 4,
        _ => 3,
    }
}

fn axes(x: &str, y: &str, log: [bool; 2]) -> Axes {
    Axes { x_label: x.into(), y_label: y.into(), log_x: log[0], log_y: log[1], ..Axes::default() }
}

/// Means of one size, with their errors.
fn data(name: String, packings: &Packings, [x, y]: [Quantity; 2], colour: usize, marker: usize) -> Series {
    let curve = packings.curve(x, y);
    Series {
        name,
        points: curve.x.into_iter().zip(curve.y).map(|(x, y)| [x, y]).collect(),
        error: Some(curve.error),
        line: false,
        style: Some(Style { colour, marker: Some(marker), dash: 0 }),
    }
}

/// A bare line of a law.
fn law(name: &str, [low, high]: [f64; 2], log: bool, dash: usize, y: impl Fn(f64) -> f64) -> Series {
    const N: usize = 100;
    let x = |k: usize| {
        let t = k as f64 / N as f64;
        if log { low * (high / low).powf(t) } else { low + t * (high - low) }
    };
    Series {
        name: name.into(),
        points: (0..=N).map(|k| [x(k), y(x(k))]).collect(),
        error: None,
        line: true,
        style: Some(Style { colour: BLACK, marker: None, dash }),
    }
}

/// All sizes of an ensemble, one series each.
fn sizes(ensemble: &Ensemble, xy: [Quantity; 2]) -> Vec<Series> {
    let of =
        |(colour, s): (usize, &Packings)| data(format!("N = {}", s.n_particles), s, xy, colour, marker(s.n_particles));
    ensemble.sizes.iter().enumerate().map(of).collect()
}

fn title(ensemble: &Ensemble) -> String {
    ensemble.name.to_uppercase()
}

/// The smallest size with as many packings as any: what the paper shows of quantities that do not depend on size.
fn one_size(ensemble: &Ensemble) -> Option<&Packings> {
    let most = ensemble.sizes.iter().map(|s| s.all.len()).max()?;
    ensemble.sizes.iter().find(|s| s.all.len() == most)
}

fn of_model(ensembles: &[Ensemble], model: Model) -> impl Iterator<Item = &Ensemble> {
    ensembles.iter().filter(move |e| e.model == model)
}

/// Figure 3.
fn density_and_shape(ensembles: &[Ensemble]) -> Vec<Axes> {
    let mut rho = axes("Δφ", "Δρ", [false; 2]);
    let mut area = axes("Δρ", "⟨a⟩/a_{J}", [false; 2]);
    let mut shape = axes("A − 1", "Δρ, Δφ", [false; 2]);
    for (colour, ensemble) in ensembles.iter().enumerate() {
        let Some(packings) = one_size(ensemble) else { continue };
        let name = format!("{}, N = {}", title(ensemble), packings.n_particles);
        let marker = if ensemble.model == Model::Sp { 4 } else { 3 };
        if ensemble.model == Model::Sp {
            rho.series.push(data(name.clone(), packings, [DeltaPhi, DeltaRho], colour, marker));
            let mut phi = data(format!("{name}: Δφ"), packings, [Shape, DeltaPhi], colour, 2);
            phi.points.retain(|p| p[1] < 0.25);
            phi.error = None;
            shape.series.push(phi);
        }
        let mut loss = data(name.clone(), packings, [DeltaRho, AreaLoss], colour, marker);
        loss.points.iter_mut().for_each(|p| p[1] = 1.0 - p[1]);
        area.series.push(loss);
        shape.series.push(data(format!("{name}: Δρ"), packings, [Shape, DeltaRho], colour, marker));
    }
    rho.series.push(law("Δρ = Δφ", [0.0, 0.3], false, 1, |x| x));
    rho.series.push(law("paper: 1.21 (Δφ − Δφ^{1.5})", [0.0, 0.25], false, 0, |x| paper::C * (x - x.powf(1.5))));
    vec![rho, area, shape]
}

/// Figure 4, of the size of the tables.
fn against_density(ensembles: &[Ensemble]) -> Vec<Axes> {
    let mut contacts = axes("ρ, φ", "z", [false; 2]);
    let mut modulus = axes("ρ, φ", "G", [false; 2]);
    let mut dp_modulus = axes("ρ", "G (γ/l)", [false; 2]);
    for (colour, ensemble) in ensembles.iter().enumerate() {
        let Some(packings) = table_size(ensemble) else { continue };
        let name = format!("{}, N = {}", title(ensemble), packings.n_particles);
        let onset = mean(packings.onsets().into_iter());
        let found = of_size(packings);
        let z_onset = found.get("z_J", "mean").map_or(f64::NAN, |z| z.value);
        if ensemble.model == Model::Sp {
            for (y, panel) in [(ContactNumber, &mut contacts), (ShearModulus, &mut modulus)] {
                panel.series.push(data(format!("{name}: against φ"), packings, [Phi, y], colour, 2));
            }
        }
        let own = if ensemble.model == Model::Sp { &mut modulus } else { &mut dp_modulus };
        own.series.push(data(name.clone(), packings, [Rho, ShearModulus], colour, 4));
        contacts.series.push(data(name.clone(), packings, [Rho, ContactNumber], colour, 4));
        let reach = [onset, onset + window(packings.n_particles)[1]];
        let row = paper::Row::of(ensemble.model);
        let two = |a: [f64; 2], x: f64| a[0] * (x - onset).max(0.0).sqrt() + a[1] * (x - onset);
        if let (Some(a), Some(b)) = (found.get("z_0", "Δz = z_0 Δρ^0.5 +"), found.get("z_1", "Δz = z_0 Δρ^0.5 +"))
        {
            contacts.series.push(law("fit", reach, false, 0, |x| z_onset + two([a.value, b.value], x)));
        }
        let label = format!("paper, {}", title(ensemble));
        contacts.series.push(law(&label, [onset, 0.98], false, 1, |x| paper::Z_ONSET + two(row.contacts, x)));
        if let (Some(a), Some(b)) = (found.get("G_0", "G = G_0 Δρ^0.5 +"), found.get("G_1", "G = G_0 Δρ^0.5 +")) {
            own.series.push(law("fit", reach, false, 0, |x| two([a.value, b.value], x)));
        }
        // the paper's moduli of deformable particles are in another unit
        if ensemble.model == Model::Sp {
            own.series.push(law(&label, [onset, 0.98], false, 1, |x| two(row.modulus, x)));
        }
    }
    modulus.y_label = "G (ε/σ_{LS}^{2})".into();
    [contacts, modulus, dp_modulus].into_iter().filter(|panel| !panel.series.is_empty()).collect()
}

/// Figure 5, and the collapse of its small distances.
fn scaling(ensembles: &[Ensemble]) -> Vec<Axes> {
    const LOG: [bool; 2] = [true; 2];
    let mut panels = Vec::new();
    for (y, label) in [(DeltaContactNumber, "z − z_{J}"), (ShearModulus, "G")] {
        for sp in of_model(ensembles, Model::Sp) {
            let row = |row: paper::Row| if y == ShearModulus { row.modulus } else { row.contacts };
            for (x, name, paper) in [(DeltaPhi, "Δφ", row(paper::SP_PHI)), (DeltaRho, "Δρ", row(paper::SP_RHO))] {
                let mut panel = axes(name, label, LOG);
                panel.title = title(sp);
                panel.series = sizes(sp, [x, y]);
                let two = move |x: f64| paper[0] * x.sqrt() + paper[1] * x;
                panel.series.push(law("paper", [1e-4, 0.15], true, 0, two));
                if y == DeltaContactNumber {
                    panel.series.push(law("slope 1", [1e-6, 1e-4], true, 2, |x| 300.0 * x));
                }
                panels.push(panel);
            }
        }
        for dp in of_model(ensembles, Model::Dp) {
            let mut panel = axes("Δρ", label, LOG);
            panel.title = title(dp);
            panel.series = sizes(dp, [DeltaRho, y]);
            if y == DeltaContactNumber {
                let [a, b] = paper::DP_RHO.contacts;
                panel.series.push(law("paper", [1e-4, 0.15], true, 0, move |x| a * x.sqrt() + b * x));
            }
            panels.push(panel);
        }
    }
    for ensemble in ensembles {
        let (x, name) = if ensemble.model == Model::Sp { (DeltaPhi, "Δφ") } else { (DeltaRho, "Δρ") };
        for (y, label) in [(DeltaContactNumber, "(z − z_{J}) N"), (ShearModulus, "G N")] {
            let mut panel = axes(&format!("{name} N^{{2}}"), label, LOG);
            panel.title = format!("{}, collapse", title(ensemble));
            panel.series = sizes(ensemble, [x, y]);
            for (series, s) in panel.series.iter_mut().zip(&ensemble.sizes) {
                let n = s.n_particles as f64;
                series.points.iter_mut().for_each(|p| *p = [p[0] * n * n, p[1] * n]);
                series.error.iter_mut().flatten().for_each(|e| *e *= n);
            }
            panels.push(panel);
        }
    }
    panels
}

const Z_CONFLUENT: f64 = 6.0;

/// ρ where z of a packing comes to 6, between samples; 1 if it does not.
fn confluent_density(p: &Packing) -> f64 {
    let at = |k: usize| [p.value(Rho, k), p.value(ContactNumber, k)];
    let Some(k) = (1..p.n_samples()).find(|&k| at(k)[1] >= Z_CONFLUENT) else { return 1.0 };
    let ([x0, z0], [x1, z1]) = (at(k - 1), at(k));
    x0 + (x1 - x0) * (Z_CONFLUENT - z0) / (z1 - z0)
}

/// Figure 6 and its insets.
fn confluence(ensembles: &[Ensemble]) -> Vec<Axes> {
    let mut panels = Vec::new();
    for ensemble in ensembles {
        for scaled in [false, true] {
            let labels =
                if scaled { ["(ρ* − ρ) N", "(z_{conf} − z) N"] } else { ["ρ* − ρ", "z_{conf} − z"] };
            let mut panel = axes(labels[0], labels[1], [true; 2]);
            panel.title = title(ensemble);
            for (colour, s) in ensemble.sizes.iter().enumerate() {
                let stars: Vec<f64> = s.all.iter().map(confluent_density).collect();
                let factor = if scaled { s.n_particles as f64 } else { 1.0 };
                let point = |k: usize| {
                    // packings that are not confluent yet
                    let open = || s.all.iter().zip(&stars).filter(move |(p, star)| p.value(Rho, k) < **star);
                    let x = mean(open().map(|(p, star)| star - p.value(Rho, k)));
                    let y = mean(open().map(|(p, _)| Z_CONFLUENT - p.value(ContactNumber, k)));
                    [x * factor, y * factor]
                };
                panel.series.push(Series {
                    name: format!("N = {}", s.n_particles),
                    points: (0..s.n_samples()).map(point).collect(),
                    style: Some(Style { colour, marker: Some(marker(s.n_particles)), dash: 0 }),
                    ..Series::default()
                });
            }
            panels.push(panel);
        }
    }
    panels
}

/// Figure 7 (a), and the shape of the voids with three sides.
fn voids(ensembles: &[Ensemble]) -> Vec<Axes> {
    let mut fractions = axes("ρ", "P_{l}", [false; 2]);
    let mut shape = axes("ρ", "A of voids with 3 sides", [false; 2]);
    for (place, ensemble) in ensembles.iter().enumerate() {
        let wanted = ensemble.sizes.iter().find(|s| s.n_particles == 64 && s.all.len() > 2);
        let Some(packings) = wanted.or_else(|| table_size(ensemble)) else { continue };
        let name = format!("{}, N = {}", title(ensemble), packings.n_particles);
        for sides in 3..=6 {
            let colour = [1, 2, 3, 5][sides - 3];
            let mut series =
                data(format!("{}, l = {sides}", title(ensemble)), packings, [Rho, Voids(sides)], colour, 0);
            if ensemble.model == Model::Dp {
                series.line = true;
                series.style = Some(Style { colour, marker: None, dash: 0 });
            }
            fractions.series.push(series);
        }
        shape.series.push(data(name, packings, [Rho, BorderShape], place, 4 - place % 2));
    }
    let onset = Series {
        name: "paper, onset".into(),
        points: paper::VOIDS.iter().map(|&p| [0.842, p]).collect(),
        style: Some(Style { colour: BLACK, marker: Some(3), dash: 0 }),
        ..Series::default()
    };
    fractions.series.push(onset);
    shape.series.push(law("4.87", [0.83, 1.0], false, 1, |_| paper::PLATEAU));
    vec![fractions, shape]
}

/// Figure 9 with its insets, then mean and spread against size.
fn onsets(ensembles: &[Ensemble]) -> Vec<Axes> {
    let mut panels = Vec::new();
    for ensemble in ensembles {
        let name = if ensemble.model == Model::Sp { "φ_{J}" } else { "ρ_{J}" };
        let mut density = axes(name, &format!("P({name})"), [false; 2]);
        let mut below = axes(name, "f_{J}", [false; 2]);
        (density.title, below.title) = (title(ensemble), title(ensemble));
        for (colour, s) in ensemble.sizes.iter().enumerate() {
            let mut found = s.onsets();
            found.sort_by(f64::total_cmp);
            if found.len() < 10 {
                continue;
            }
            let style = Some(Style { colour, marker: Some(marker(s.n_particles)), dash: 0 });
            let label = format!("N = {}", s.n_particles);
            let line =
                |points: Vec<[f64; 2]>, line: bool| Series { name: label.clone(), points, line, style, error: None };
            density.series.push(line(histogram(&found), true));
            let n = found.len() as f64;
            below.series.push(line(found.iter().enumerate().map(|(k, &x)| [x, (k + 1) as f64 / n]).collect(), false));
        }
        panels.extend([density, below]);
    }
    let mut means = axes("N", "mean onset", [true, false]);
    let mut widths = axes("N", "spread of onsets", [true; 2]);
    for (colour, ensemble) in ensembles.iter().enumerate() {
        let style = Some(Style { colour, marker: Some(4 - colour % 2), dash: 0 });
        let n = |s: &Packings| s.n_particles as f64;
        let center = |s: &Packings| [n(s), mean(s.onsets().into_iter())];
        let width = |s: &Packings| [n(s), spread(s.onsets().into_iter())];
        let error = |s: &Packings| match s.resolves_onsets() {
            true => width(s)[1] / (s.onsets().len() as f64).sqrt(),
            false => s.onset_excess(),
        };
        means.series.push(Series {
            name: title(ensemble),
            points: ensemble.sizes.iter().map(center).collect(),
            error: Some(ensemble.sizes.iter().map(error).collect()),
            style,
            ..Series::default()
        });
        let resolved: Vec<&Packings> = ensemble.sizes.iter().filter(|s| s.resolves_onsets()).collect();
        let width_error = |s: &&Packings| width(s)[1] / (2.0 * (s.onsets().len() as f64 - 1.0)).sqrt();
        widths.series.push(Series {
            name: title(ensemble),
            points: resolved.iter().map(|s| width(s)).collect(),
            error: Some(resolved.iter().map(width_error).collect()),
            style,
            ..Series::default()
        });
        let found = of_ensemble(ensemble);
        let name = if ensemble.model == Model::Sp { "φ_J" } else { "ρ_J" };
        let fit = format!("{name} = {name}∞ + b N^−0.7");
        let n = [ensemble.sizes.first().map_or(1.0, n), ensemble.sizes.last().map_or(2.0, n)];
        if let (Some(limit), Some(b)) = (found.get(&format!("{name}∞"), &fit), found.get("b", &fit)) {
            let curve = |x: f64| limit.value + b.value * x.powf(-0.7);
            means.series.push(law(&format!("{}: fit, N^{{−0.7}}", title(ensemble)), n, true, 0, curve));
        }
        if let (Some(theta), Some([n0, s0])) = (found.get("θ", "spread"), resolved.first().map(|s| width(s))) {
            let curve = |x: f64| s0 * (x / n0).powf(-theta.value);
            widths.series.push(law(&format!("{}: N^{{−{:.2}}}", title(ensemble), theta.value), n, true, 0, curve));
        }
    }
    means.series.push(law("paper: 0.842", [32.0, 1024.0], true, 1, |_| paper::ONSET_LIMIT));
    panels.extend([means, widths]);
    panels
}

/// Probability density of sorted numbers, in bins of their own spread (Scott 1979).
fn histogram(sorted: &[f64]) -> Vec<[f64; 2]> {
    let n = sorted.len() as f64;
    let width = 3.49 * spread(sorted.iter().copied()) / n.cbrt();
    let (low, high) = (sorted[0], sorted[sorted.len() - 1]);
    if width <= 0.0 || !width.is_finite() {
        return Vec::new();
    }
    let bins = ((high - low) / width).ceil().max(1.0) as usize;
    let start = 0.5 * (low + high - bins as f64 * width);
    let mut counts = vec![0.0; bins];
    sorted.iter().for_each(|x| counts[(((x - start) / width) as usize).min(bins - 1)] += 1.0);
    counts.iter().enumerate().map(|(k, c)| [start + (k as f64 + 0.5) * width, c / (n * width)]).collect()
}

/// Figure 10.
fn exponents(ensembles: &[Ensemble]) -> Vec<Axes> {
    const LOG: [bool; 2] = [true; 2];
    let mut panels = Vec::new();
    // a guide of the paper's slope through the sample that is nearest to x
    let guide = |series: &Series, x: f64, range: [f64; 2], slope: f64, dash: usize| {
        let near = |p: &&[f64; 2]| p[0] > 0.0 && p[1] > 0.0;
        let distance = |p: &[f64; 2]| (p[0] / x).ln().abs();
        let through = series.points.iter().filter(near).min_by(|a, b| distance(a).total_cmp(&distance(b))).copied();
        through.map(|[x0, y0]| law(&format!("slope {slope}"), range, true, dash, move |x| y0 * (x / x0).powf(slope)))
    };
    let mut add = |ensemble: &Ensemble, xy: [Quantity; 2], labels: [&str; 2], guides: &[(f64, [f64; 2], f64)]| {
        let Some(packings) = one_size(ensemble) else { return };
        let mut panel = axes(labels[0], labels[1], LOG);
        panel.title = format!("{}, N = {}", title(ensemble), packings.n_particles);
        let series = data(String::new(), packings, xy, 0, 4);
        let lines: Vec<Series> = guides
            .iter()
            .enumerate()
            .filter_map(|(dash, &(x, range, slope))| guide(&series, x, range, slope, dash))
            .collect();
        panel.series = [vec![series], lines].concat();
        panels.push(panel);
    };
    for sp in of_model(ensembles, Model::Sp) {
        add(sp, [EnergyPerParticle, Overlap], ["U/N", "φ − ρ"], &[(1e-6, [1e-10, 1e-2], paper::KAPPA)]);
        add(sp, [DeltaPhi, DeltaRho], ["Δφ", "Δρ"], &[(1e-3, [1e-5, 0.1], 1.0)]);
        let zeta = paper::ZETA;
        add(
            sp,
            [DeltaRho, AreaLoss],
            ["Δρ", "1 − ⟨a⟩/a_{J}"],
            &[(1e-3, [1e-5, 0.1], zeta[0]), (0.14, [0.05, 0.16], zeta[1])],
        );
    }
    for ensemble in ensembles {
        let omega = paper::omega(ensemble.model);
        let small = if ensemble.model == Model::Sp { 1e-4 } else { 1e-3 };
        add(
            ensemble,
            [Shape, DeltaRho],
            ["A − 1", "Δρ"],
            &[(small, [1e-6, 1e-2], omega[0]), (5e-2, [5e-3, 0.1], omega[1])],
        );
    }
    panels
}
