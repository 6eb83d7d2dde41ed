//! A scene from beginning to end: random start, onset search, compression, and what is kept of it.

mod progress;
mod setup;
mod table;

use crate::comm::Comm;
use crate::engine::System;
use crate::failure::Failure;
use crate::minimize::{Fire, Minimizer, Report};
use crate::model::{EdgeEdge, Model, VertexEdge};
use crate::protocol::{compress_to, find_onset};
use crate::scene::{Contact, Method, Physics, Scene};
use progress::Progress;
use table::Row;

/// Runs a scene. The types of its model are chosen here, once; `speaks` allows progress lines.
pub fn run(comm: Comm, scene: &Scene, speaks: bool) -> Result<(), Failure> {
    match &scene.physics {
        Physics::Sp(sp) => minimized_by(setup::soft_disks(comm, scene, sp)?, scene, speaks),
        Physics::Dp(dp) => match dp.potential.contact {
            Contact::VertexEdge => minimized_by(setup::deformable::<VertexEdge>(comm, scene, dp)?, scene, speaks),
            Contact::EdgeEdge => minimized_by(setup::deformable::<EdgeEdge>(comm, scene, dp)?, scene, speaks),
        },
    }
}

fn minimized_by<M: Model>(system: System<M>, scene: &Scene, speaks: bool) -> Result<(), Failure> {
    match scene.minimize.method {
        Method::Fire => onset_and_compression(system, &Fire::default(), scene, speaks),
    }
}

fn onset_and_compression<M: Model>(
    mut system: System<M>,
    minimizer: &impl Minimizer,
    scene: &Scene,
    speaks: bool,
) -> Result<(), Failure> {
    let is_root = system.comm.is_root();
    let mut progress = Progress::new(speaks && is_root);
    let goal = setup::goal(scene);

    let mut last = Report::default();
    let onset = find_onset(&mut system, minimizer, &goal, &setup::onset_search(scene), |density, energies, report| {
        last = *report;
        progress.state("onset", density, energies.pressure(), report.iterations);
    })?;
    let mut rows = vec![sample(&mut system, &last)?];

    for density in scene.compression.samples(onset.density) {
        let report = compress_to(&mut system, minimizer, &goal, density)?;
        let row = sample(&mut system, &report)?;
        progress.state("compression", row.packing_fraction, row.pressure, report.iterations);
        rows.push(row);
    }
    progress.finish();
    if is_root {
        println!("{}", table::onset_line(scene.model(), &onset));
        print!("{}", table::table(scene.model(), &rows));
    }
    Ok(())
}

fn sample<M: Model>(system: &mut System<M>, report: &Report) -> Result<Row, Failure> {
    let energies = system.energies()?;
    Ok(Row {
        packing_fraction: system.density()?,
        reduced_number_density: f64::NAN,
        contact_number: f64::NAN,
        shape_parameter: f64::NAN,
        pressure: energies.pressure(),
        energy: energies.total,
        max_force: report.max_force,
        iterations: report.iterations,
    })
}
