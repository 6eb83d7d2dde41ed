//! Pictures of a system in its present state.

use crate::engine::System;
use crate::failure::Failure;
use crate::model::Model;
use crate::observe::{Contacts, PerParticle, Rattlers, Sample};
use crate::output::render::{Look, packing, write_packing};
use crate::scene::ColorBy;
use std::path::Path;

/// Draws a measured system, or a part of its box, to a file, SVG or PNG by its name. Collective.
pub fn draw<M: Model>(
    system: &mut System<M>,
    sample: &Sample,
    columns: &PerParticle,
    color_by: ColorBy,
    part: Option<f64>,
    path: &Path,
) -> Result<(), Failure> {
    with_look(system, sample, columns, color_by, part, |system, look| {
        Ok(write_packing(&system.comm, path, system.pbox(), system.particles(), look)?)
    })
}

/// A measured system as an SVG document, on rank 0; nothing on the other ranks. Collective.
pub fn svg<M: Model>(
    system: &mut System<M>,
    sample: &Sample,
    columns: &PerParticle,
    color_by: ColorBy,
) -> Result<Option<String>, Failure> {
    with_look(system, sample, columns, color_by, None, |system, look| {
        Ok(packing(&system.comm, system.pbox(), system.particles(), look).map(|packing| packing.to_svg()))
    })
}

/// What a picture shows beside the particles.
fn with_look<M: Model, R>(
    system: &mut System<M>,
    sample: &Sample,
    columns: &PerParticle,
    color_by: ColorBy,
    part: Option<f64>,
    act: impl FnOnce(&System<M>, &Look) -> Result<R, Failure>,
) -> Result<R, Failure> {
    let touching = Contacts::of(system, Rattlers::default())?.touching;
    let ids = &system.particles().id;
    let pairs: Vec<[u32; 2]> =
        ids.iter().zip(touching.iter()).flat_map(|(&id, row)| row.iter().map(move |&other| [id, other])).collect();
    drop(touching);
    let (values, value_name): (Vec<f64>, &str) = match color_by {
        ColorBy::Z => (columns.contacts.iter().map(|&n| n as f64).collect(), "contacts z"),
        ColorBy::ShapeParameter => (columns.shape_parameter.clone(), "shape parameter"),
        ColorBy::Pressure => (columns.pressure.clone(), "pressure"),
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
    let look = Look { part, delta, values: &values, value_name, contacts: &pairs, caption: &caption };
    act(system, &look)
}
