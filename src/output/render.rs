//! Pictures and plots of a run, from its own data.

use super::error::{OutputError, agree};
use super::folder::write_whole;
use super::picture::{MARGIN, Outline, Packing, PictureError, rasterise, side_by_side};
use super::plot::{Axes, Panels, Series, panels};
use super::rows::whole;
use crate::comm::Comm;
use crate::geometry::{PeriodicBox, add};
use crate::particles::{Bodies, Particles};
use std::path::Path;

/// Of larger packings only a part with about as many particles as the second number is drawn: a particle would be smaller
/// than a pixel.
const MAX_PARTICLES: u64 = 200_000;
const PARTICLES_OF_A_PART: f64 = 1500.0;
const WIDTH_PX: u32 = 1600;

/// What a picture shows beside the particles. Values and contacts are each rank's own.
pub struct Look<'a> {
    /// The part of either edge of the box to show, above 0 and up to 1; by itself all but of huge packings.
    pub part: Option<f64>,
    /// Width of the circulo-lines; 0 for disks.
    pub delta: f64,
    /// One value per own particle, shown as its colour.
    pub values: &'a [f64],
    /// Name of the values along the colour bar.
    pub value_name: &'a str,
    /// Global ids of the particles that an own particle touches. They are not stored in results files: the engine finds
    /// them again in an exact state.
    pub contacts: &'a dyn Fn(usize) -> &'a [u32],
    pub caption: &'a str,
}

/// The packing as rank 0 draws it, particles in the order of their ids, of a part of the box those that may be seen in
/// it; nothing on the other ranks. Collective.
pub fn packing(comm: &Comm, pbox: &PeriodicBox, particles: &Particles, look: &Look) -> Option<Packing> {
    let count = comm.sum_count(particles.len() as u64);
    let by_itself = if count > MAX_PARTICLES { (PARTICLES_OF_A_PART / count as f64).sqrt() } else { 1.0 };
    let part = look.part.unwrap_or(by_itself);
    // rank 0 has no room for what is not drawn
    let radius = |p: usize| match particles.bodies {
        Bodies::Disks => 0.5 * particles.size[p],
        Bodies::Polygons { .. } => particles.circumradius(pbox, p) + 0.5 * look.delta,
    };
    let largest = comm.max((0..particles.len()).map(radius).fold(0.0, f64::max));
    let beyond = pbox.widths().map(|width| (2.0 * largest + MARGIN * part * pbox.area().sqrt()) / width);
    let reaches_in = |at: f64, axis: usize| at < part + beyond[axis] || at > 1.0 - beyond[axis];
    let is_near = |&p: &usize| {
        let at = particles.center(pbox, p).fractions();
        part >= 1.0 || (0..2).all(|axis| reaches_in(at[axis], axis))
    };
    let near: Vec<usize> = (0..particles.len()).filter(is_near).collect();
    let mut bodies = Vec::new();
    near.iter().for_each(|&p| particles.pack(p, false, &mut bodies));
    let mut all = Particles::empty(&particles.bodies);
    comm.gather(bodies).iter().for_each(|message| all.unpack(message, false));
    // a missing value is drawn grey
    let value = |&p: &usize| look.values.get(p).copied().unwrap_or(f64::NAN).to_bits();
    let values = comm.gather(near.iter().map(value).collect()).concat();
    let pairs_of = |&p: &usize| {
        let id = particles.id[p];
        (look.contacts)(p).iter().map(move |&other| (id.min(other) as u64) << 32 | id.max(other) as u64)
    };
    let pairs = comm.gather(near.iter().flat_map(pairs_of).collect());
    if !comm.is_root() {
        return None;
    }
    let mut order: Vec<u32> = (0..all.len() as u32).collect();
    order.sort_by_key(|&p| all.id[p as usize]);
    let all = all.reordered(&order);
    let values = order.iter().map(|&p| f64::from_bits(values[p as usize])).collect();
    let outline = |p: usize| {
        let points = whole(pbox, &all, p);
        match all.bodies {
            Bodies::Disks => Outline::Disk { center: points[0], diameter: all.size[p] },
            Bodies::Polygons { .. } => Outline::RoundedPolygon { vertices: points, width: look.delta },
        }
    };
    let mut pairs = pairs.concat();
    pairs.sort_unstable();
    pairs.dedup();
    let of_part = if part < 1.0 { format!("; {part:.3} of either edge of the box") } else { String::new() };
    let segment = |pair: &u64| {
        let center = |id: u64| Some(all.center(pbox, all.id.binary_search(&(id as u32)).ok()?));
        let (from, to) = (center(pair >> 32)?, center(*pair)?);
        let start = pbox.position(from);
        Some([start, add(start, pbox.displacement(to, from))])
    };
    Some(Packing {
        cell: [[pbox.lx(), 0.0], [pbox.xy(), pbox.ly()]],
        part,
        outlines: (0..all.len()).map(outline).collect(),
        values: if look.value_name.is_empty() { Vec::new() } else { values },
        value_name: look.value_name.to_owned(),
        contacts: pairs.iter().filter_map(segment).collect(),
        caption: format!("{}{of_part}", look.caption),
    })
}

/// Draws a packing that rank 0 has to a file, SVG or PNG by its name. Collective.
pub fn write_packing(comm: &Comm, path: &Path, packing: Option<&Packing>) -> Result<(), OutputError> {
    let written = packing.map_or(Ok(()), |packing| save(path, || packing.to_svg(), || packing.to_png(WIDTH_PX)));
    agree(comm, written).map_err(|reason| OutputError::write(path, reason))
}

/// Draws the samples of a run, `series` as [`super::Results::series`] gives them, against their density: contact
/// number and pressure, shape parameter, packing fraction, as far as they are known. For one rank.
pub fn write_plot(path: &Path, series: &[(String, Vec<f64>)]) -> Result<(), OutputError> {
    let axes = run_axes(series);
    let figure = panels(&axes, 2);
    let plain = [Axes { x_label: "density".to_owned(), ..Axes::default() }];
    let plain_figure = panels(&plain, 1);
    write_panels(path, if axes.is_empty() { &plain_figure } else { &figure })
}

/// Writes a figure of several plots as the ending of the file name says. For one rank.
pub fn write_panels(path: &Path, figure: &Panels) -> Result<(), OutputError> {
    save(path, || figure.to_svg(), || figure.to_png(WIDTH_PX)).map_err(|reason| OutputError::write(path, reason))
}

/// Writes SVG documents two by two as one picture. For one rank.
pub fn write_row(path: &Path, svgs: &[&str]) -> Result<(), OutputError> {
    let joined = side_by_side(svgs, 2).map_err(|e| OutputError::write(path, e))?;
    save(path, || joined.clone(), || rasterise(&joined, WIDTH_PX)).map_err(|reason| OutputError::write(path, reason))
}

/// The panels of the plot of a run.
fn run_axes(series: &[(String, Vec<f64>)]) -> Vec<Axes> {
    const COMPRESSION: [(&str, &str); 5] = [
        ("contact_number", "contact number z"),
        ("pressure", "pressure p"),
        ("shape_parameter_relative", "shape parameter"),
        ("packing_fraction", "packing fraction"),
        ("mean_shear_modulus", "shear modulus G"),
    ];
    const SHEAR: [(&str, &str); 2] = [("shear_stress", "shear stress"), ("contact_number", "contact number z")];
    let find = |name: &str| series.iter().find(|(n, _)| n == name).map(|(_, values)| values);
    let (Some(density), Some(strain)) = (find("density"), find("strain")) else { return Vec::new() };
    let compressed = strain.iter().take_while(|&&strain| strain == 0.0).count();
    let panel = |x: &[f64], x_label: &str, first: usize, (name, label): (&str, &str)| {
        let values = find(name)?;
        let points = x.iter().zip(&values[first..]).map(|(&x, &y)| [x, y]).collect();
        Some(Axes {
            x_label: x_label.to_owned(),
            y_label: label.to_owned(),
            series: vec![Series { points, line: true, ..Series::default() }],
            ..Axes::default()
        })
    };
    let mut axes: Vec<Axes> =
        COMPRESSION.iter().filter_map(|&quantity| panel(&density[..compressed], "density", 0, quantity)).collect();
    if compressed < strain.len() {
        let first = compressed.saturating_sub(1);
        axes.extend(SHEAR.iter().filter_map(|&quantity| panel(&strain[first..], "shear strain", first, quantity)));
    }
    axes
}

/// Writes a figure as the ending of the file name says.
fn save(
    path: &Path,
    svg: impl FnOnce() -> String,
    png: impl FnOnce() -> Result<Vec<u8>, PictureError>,
) -> Result<(), String> {
    let bytes = match path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase).as_deref() {
        Some("svg") => svg().into_bytes(),
        Some("png") => png().map_err(|e| e.to_string())?,
        _ => return Err("pictures are .svg or .png".to_owned()),
    };
    write_whole(path, &bytes).map_err(OutputError::reason)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Frac;

    fn two_disks() -> (PeriodicBox, Particles) {
        let mut disks = Particles::empty(&Bodies::Disks);
        for (id, x) in [(1, 0.95), (0, 0.05)] {
            disks.push(id, 0.5, &[Frac::from_fractions([x, 0.5])]);
        }
        (PeriodicBox::square(4.0), disks)
    }

    fn look<'a>(contacts: &'a dyn Fn(usize) -> &'a [u32]) -> Look<'a> {
        Look { part: None, delta: 0.0, values: &[2.0, 1.0], value_name: "z", contacts, caption: "two disks" }
    }

    #[test]
    fn particles_are_drawn_in_the_order_of_ids_and_contacts_across_the_boundary() {
        let (pbox, disks) = two_disks();
        let touching = |p: usize| [&[0, 9][..], &[1]][p];
        let drawn = packing(&Comm::alone(), &pbox, &disks, &look(&touching)).unwrap();
        assert_eq!(drawn.values, [1.0, 2.0]);
        assert_eq!(drawn.contacts.len(), 1);
        let [[x, _], [far, _]] = drawn.contacts[0];
        assert!((x - 0.2).abs() < 1e-12 && (far + 0.2).abs() < 1e-12);
    }

    #[test]
    fn of_a_part_rank_0_takes_what_may_be_seen() {
        let mut disks = Particles::empty(&Bodies::Disks);
        let at = |k: u32| [0.05 * (k % 20) as f64 + 0.01, 0.05 * (k / 20) as f64 + 0.01];
        (0..400).rev().for_each(|k| disks.push(k, 0.5, &[Frac::from_fractions(at(k))]));
        let pbox = PeriodicBox::new(10.0, 10.0, 3.0);
        let touching: Vec<[u32; 2]> = (0..400).rev().map(|k| [(k + 399) % 400, (k + 1) % 400]).collect();
        let touching = |p: usize| &touching[p][..];
        let values: Vec<f64> = (0..400).rev().map(|k| (k % 20 / 10) as f64).collect();
        let whole = Look { part: Some(1.0), values: &values, ..look(&touching) };
        let part = Look { part: Some(0.3), ..whole };
        let [whole, part] = [whole, part].map(|look| packing(&Comm::alone(), &pbox, &disks, &look).unwrap());
        assert_eq!(whole.outlines.len(), 400);
        assert!(part.outlines.len() < 200);
        // nothing is missing, in any colour
        let of_all = Packing { part: 0.3, caption: part.caption.clone(), ..whole };
        assert!(of_all.to_svg().contains("<circle"));
        assert_eq!(part.to_svg(), of_all.to_svg());
    }

    #[test]
    fn pictures_and_plots_are_written_by_their_ending() {
        let (pbox, disks) = two_disks();
        let home = tempfile::tempdir().unwrap();
        let path = |name: &str| home.path().join(name);
        let drawn = packing(&Comm::alone(), &pbox, &disks, &look(&|_| &[]));
        let draw = |name: &str| write_packing(&Comm::alone(), &path(name), drawn.as_ref());
        draw("a.svg").unwrap();
        draw("a.png").unwrap();
        assert!(std::fs::read(path("a.png")).unwrap().starts_with(b"\x89PNG"));
        assert!(draw("a.pdf").unwrap_err().to_string().contains(".svg or .png"));
        assert!(draw("none/a.svg").unwrap_err().to_string().contains("check the path"));
        let series = [
            ("density", vec![0.8, 0.9, 0.9]),
            ("strain", vec![0.0, 0.0, 0.1]),
            ("pressure", vec![0.0, 0.1, 0.2]),
            ("shear_stress", vec![0.0, 0.1, 0.3]),
            ("contact_number", vec![4.0, 4.5, 4.6]),
        ];
        let series = series.map(|(name, values)| (name.to_owned(), values));
        let axes = run_axes(&series);
        assert_eq!(axes.len(), 4);
        assert_eq!(axes[1].series[0].points, [[0.8, 0.0], [0.9, 0.1]]);
        assert_eq!(axes[2].series[0].points, [[0.0, 0.1], [0.1, 0.3]]);
        write_plot(&path("plot.svg"), &series).unwrap();
        write_plot(&path("empty.svg"), &[]).unwrap();
    }
}
