//! Pictures of a system in its present state.

use crate::engine::System;
use crate::failure::Failure;
use crate::model::Model;
use crate::observe::{PerParticle, Sample, touching};
use crate::output::picture::Packing;
use crate::output::render::{self, Look, write_packing};
use crate::scene::ColorBy;
use std::borrow::Cow;
use std::path::PathBuf;

/// Draws a measured system, or a part of its box, to files, SVG or PNG by their names. Lists are let go of: a picture takes
/// as much memory as those of some hundred thousand particles. Collective.
pub fn draw<M: Model>(
    system: &mut System<M>,
    sample: &Sample,
    columns: &PerParticle,
    color_by: ColorBy,
    part: Option<f64>,
    paths: &[PathBuf],
) -> Result<(), Failure> {
    let packing = packing(system, sample, columns, color_by, part)?;
    system.lay_bare();
    paths.iter().try_for_each(|path| Ok(write_packing(&system.comm, path, packing.as_ref())?))
}

/// A measured system as an SVG document, on rank 0; nothing on the other ranks. Collective.
pub fn svg<M: Model>(
    system: &mut System<M>,
    sample: &Sample,
    columns: &PerParticle,
    color_by: ColorBy,
) -> Result<Option<String>, Failure> {
    Ok(packing(system, sample, columns, color_by, None)?.map(|packing| packing.to_svg()))
}

/// What a picture shows, on rank 0.
fn packing<M: Model>(
    system: &mut System<M>,
    sample: &Sample,
    columns: &PerParticle,
    color_by: ColorBy,
    part: Option<f64>,
) -> Result<Option<Packing>, Failure> {
    let touching = touching(system)?;
    let contacts = |p: usize| touching.row(p);
    let (values, value_name): (Cow<[f64]>, &str) = match color_by {
        ColorBy::Z => (columns.contacts.iter().map(|&n| n as f64).collect(), "contacts z"),
        ColorBy::ShapeParameter => (Cow::from(&columns.shape_parameter), "shape parameter"),
        ColorBy::Pressure => (Cow::from(&columns.pressure), "pressure"),
    };
    let caption = format!(
        "N = {}, packing fraction {:.4}, z = {:.3}, pressure {:.4e}",
        sample.n_particles,
        sample.density.packing_fraction,
        sample.contact_number,
        sample.pressure()
    );
    // particles of no size of their own still meet at the width of their circulo-lines: delta, or 0 for disks
    let delta = system.model.range(0.0);
    let look = Look { part, delta, values: &values, value_name, contacts: &contacts, caption: &caption };
    Ok(render::packing(&system.comm, system.pbox(), system.particles(), &look))
}
