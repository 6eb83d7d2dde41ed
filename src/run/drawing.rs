//! Pictures of a system in its present state.

use crate::engine::System;
use crate::failure::Failure;
use crate::model::Model;
use crate::observe::{PerParticle, Sample};
use crate::output::render::{Look, write_packing};
use crate::scene::ColorBy;
use std::path::Path;

/// Draws a measured system to a file, SVG or PNG by its name. Collective.
pub fn draw<M: Model>(
    system: &mut System<M>,
    sample: &Sample,
    columns: &PerParticle,
    color_by: ColorBy,
    path: &Path,
) -> Result<(), Failure> {
    let touching = system.contacts()?;
    let ids = &system.particles().id;
    let pairs: Vec<[u32; 2]> =
        ids.iter().zip(&touching).flat_map(|(&id, row)| row.iter().map(move |&(other, _)| [id, other])).collect();
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
    let look = Look { delta, values: &values, value_name, contacts: &pairs, caption: &caption };
    Ok(write_packing(&system.comm, path, system.pbox(), system.particles(), &look)?)
}
