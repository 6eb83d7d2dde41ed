//! One frame of a results file, put to another use: drawn, looked at, or handed on in the exchange format.

use crate::comm::Comm;
use crate::engine::System;
use crate::exchange::{Cell, Configuration, ContactForm};
use crate::failure::Failure;
use crate::geometry::{Polygon, Vec2, add};
use crate::minimize::Report;
use crate::model::{EdgeEdge, Model, VertexEdge};
use crate::observe::{Look, Rattlers, Sample};
use crate::output::{Header, Results, Snapshot};
use crate::run::{drawing, setup};
use crate::scene::{ColorBy, Contact, Physics, Scene};
use std::path::Path;

/// Which frame of a file, counted from 0; the last one if there is no number.
pub type Frame = Option<usize>;

/// Draws a frame. The engine measures it anew, because contacts are not stored. Collective.
pub fn render(
    comm: Comm,
    file: &Path,
    frame: Frame,
    color_by: ColorBy,
    part: Option<f64>,
    picture: &Path,
) -> Result<(), Failure> {
    let results = Results::open(&comm, file)?;
    with_frame(comm, file, &results, frame, |_, _| Draw { color_by, part, picture })?
}

struct Draw<'a> {
    color_by: ColorBy,
    part: Option<f64>,
    picture: &'a Path,
}

impl Look for Draw<'_> {
    type Output = ();
    type Error = Failure;

    fn look<M: Model>(self, system: &mut System<M>) -> Result<(), Failure> {
        let (sample, columns) = Sample::measure(system, &Report::default(), Rattlers::default())?;
        drawing::draw(system, &sample, &columns, self.color_by, self.part, &[self.picture.to_path_buf()])
    }
}

/// Sets up a frame of an open file, and has a look at it that may depend on the scene of the file and on what was
/// stored with the frame. Collective.
pub fn with_frame<L: Look>(
    comm: Comm,
    file: &Path,
    results: &Results,
    frame: Frame,
    look: impl FnOnce(&Scene, &Snapshot) -> L,
) -> Result<Result<L::Output, L::Error>, Failure> {
    let snapshot = snapshot(&comm, results, frame)?;
    let scene = Scene::parse(&results.header.scene, &file.display().to_string(), &[])?;
    let look = look(&scene, &snapshot);
    match &scene.physics {
        Physics::Sp(sp) => look_at(comm, setup::disk_model(sp), snapshot, &scene, look),
        Physics::Dp(dp) => match dp.potential.contact {
            Contact::VertexEdge => look_at(comm, setup::deformable_model::<VertexEdge>(dp), snapshot, &scene, look),
            Contact::EdgeEdge => look_at(comm, setup::deformable_model::<EdgeEdge>(dp), snapshot, &scene, look),
        },
    }
}

fn look_at<M: Model, L: Look>(
    comm: Comm,
    model: M,
    snapshot: Snapshot,
    scene: &Scene,
    look: L,
) -> Result<Result<L::Output, L::Error>, Failure> {
    let Snapshot { pbox, particles, .. } = snapshot;
    let mut system = System::new(comm, model, pbox, &pbox, particles, scene.neighbor.skin)?;
    Ok(look.look(&mut system))
}

/// A frame in the exchange format. Called by one rank, which reads all of it.
pub fn configuration(file: &Path, frame: Frame) -> Result<Configuration, Failure> {
    let (header, snapshot) = read(&Comm::alone(), file, frame)?;
    let Snapshot { pbox, particles, .. } = snapshot;
    let constant = |name: &str| {
        let found = header.potential.iter().find(|(n, _)| n == name).map(|&(_, value)| value);
        found.ok_or_else(|| Failure::Input(format!("{}: the potential has no {name}", file.display())))
    };
    let cell = Cell { lx: pbox.lx(), ly: pbox.ly(), xy: pbox.xy() };
    let contact = match header.contact.as_str() {
        "vertex-edge" => ContactForm::VertexEdge,
        "edge-edge" => ContactForm::EdgeEdge,
        _ => {
            return Ok(Configuration::Sp {
                cell,
                epsilon: constant("epsilon")?,
                diameters: particles.size,
                positions: particles.position.iter().map(|&center| pbox.position(center)).collect(),
            });
        }
    };
    let whole = |p: usize| -> Vec<Vec2> {
        let points = particles.points_of(p);
        let first = pbox.position(points[0]);
        Polygon::from_vertices(&pbox, points).offsets().map(|offset| add(first, offset)).collect()
    };
    Ok(Configuration::Dp {
        cell,
        line_tension: constant("line_tension")?,
        k_area: constant("k_area")?,
        epsilon: constant("epsilon")?,
        delta: constant("delta")?,
        contact,
        n_vertices: (0..particles.len()).map(|p| particles.points_of(p).len() as u32).collect(),
        vertices: (0..particles.len()).flat_map(whole).collect(),
        a0: particles.size,
    })
}

fn read(comm: &Comm, file: &Path, frame: Frame) -> Result<(Header, Snapshot), Failure> {
    let results = Results::open(comm, file)?;
    let snapshot = snapshot(comm, &results, frame)?;
    Ok((results.header, snapshot))
}

/// The frame that was asked for, or the last one. Collective.
fn snapshot(comm: &Comm, results: &Results, frame: Frame) -> Result<Snapshot, Failure> {
    let k = frame.unwrap_or(results.frames.saturating_sub(1));
    Ok(results.frame(comm, k)?)
}
