//! The results file of a run: one HDF5 file in the H5MD 1.1 layout, written by all ranks together.
//!
//! ```text
//! /h5md                       version, author, creator
//! /parameters                 status, seed, scene (TOML), units, git_hash, n_particles; potential: its constants
//! /parameters/particles       diameter[N], or a0[N] and n_vertices[N]: of each particle
//! /particles/all              one row per point: a disk's centre or a polygon's vertex
//!     box/edges               [T][2][2], the box vectors as rows
//!     position                [T][points][2], Cartesian; a particle's points all in one periodic image
//!     position_fraction       [T][points][2], the exact state: fractions of the box vectors in units of 2⁻⁶⁴
//!     id, particle_id, vertex [points]
//! /observables/NAME           [T], or [T][2][2] for a tensor
//! /observables/particles/NAME [T][N], one value per particle
//! ```
//! Everything that changes is an H5MD element: a group of `value`, `step` and `time`, the latter two shared by all.
//! A quasistatic run has no time: `step` counts the samples, and `time` is the same number. The density of each sample
//! is an observable. Rows are in the order of the global ids, so that the data do not depend on the number of ranks.
//!
//! While the run lasts the file is called NAME.h5.part, flushed after each frame. It gets its name when it is finished.

use super::error::{OutputError, agree, on_root};
use super::folder::{explain, make_way, publish, reserve};
use super::rows::{Block, to_block, whole};
use crate::comm::Comm;
use crate::geometry::PeriodicBox;
use crate::particles::{Bodies, Column, Particles};
use hdf5::dataset::FillTime;
use hdf5::file::FileAccess;
use hdf5::types::{FixedAscii, FixedUnicode, VarLenUnicode};
use hdf5::{Dataset, Extent, File, Group, H5Type, Hyperslab, Location, Selection, SimpleExtents, SliceOrIndex};
use ndarray::ArrayViewD;
use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};

pub(super) const STEP: &str = "particles/all/position/step";
pub(super) const TIME: &str = "particles/all/position/time";
pub(super) const EDGES: &str = "particles/all/box/edges";
pub(super) const POSITION: &str = "particles/all/position";
pub(super) const FRACTION: &str = "particles/all/position_fraction";
pub(super) const OBSERVABLES: &str = "observables";
pub(super) const COLUMNS: &str = "observables/particles";
pub(super) const SIZES: &str = "parameters/particles";
pub(super) const COMPLETE: &str = "complete";
/// Of this length always, so that the end of a run is told in space that the file already has.
const STATUS_BYTES: usize = 400;
pub(super) type Status = FixedUnicode<STATUS_BYTES>;

/// Largest number of values along the first two axes of a chunk.
const CHUNK_ROWS: usize = 1 << 16;
/// Values of a time series in a chunk.
const CHUNK_SAMPLES: usize = 64;
/// Room for HDF5's own bookkeeping when a frame is added.
const MARGIN: u64 = 1 << 20;

/// What is known before the run begins.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Header {
    /// The scene with all its defaults, as TOML, but for what only concerns the folder of the run.
    pub scene: String,
    pub seed: u64,
    /// Units of length, energy and what else needs one, in words.
    pub units: String,
    /// How contacts are computed, e.g. `vertex-edge`; `disks` for disks.
    pub contact: String,
    /// Constants of the potential by name, e.g. `epsilon`, `delta`.
    pub potential: Vec<(String, f64)>,
}

/// One sample. Names and scalars are the same on all ranks; particles and columns are each rank's own.
pub struct Frame<'a> {
    /// Number of the sample, growing from frame to frame.
    pub step: u64,
    pub pbox: &'a PeriodicBox,
    pub particles: &'a Particles,
    /// One number per sample: density, pressure, contact_number, energy, max_force, ...
    pub scalars: &'a [(&'a str, f64)],
    /// In the order xx, xy, yx, yy.
    pub tensors: &'a [(&'a str, [f64; 4])],
    /// A number of each own particle, by its place.
    pub columns: &'a [(&'a str, Column<'a>)],
}

/// A results file being written. To be dropped on all ranks together, before MPI ends.
pub struct ResultsFile {
    path: PathBuf,
    part: PathBuf,
    // datasets are closed before the file
    elements: BTreeMap<String, Dataset>,
    file: File,
    frames: usize,
    particles: usize,
    points: usize,
}

impl ResultsFile {
    /// Opens NAME.h5.part, which will become `path`, and writes what does not change. Collective.
    pub fn create(comm: &Comm, path: &Path, header: &Header, particles: &Particles) -> Result<Self, OutputError> {
        Self::try_create(comm, path, header, particles).map_err(|reason| OutputError::write(path, reason))
    }

    fn try_create(comm: &Comm, path: &Path, header: &Header, particles: &Particles) -> Result<Self, String> {
        let part = with_suffix(path, ".part");
        on_root(comm, || {
            // what a killed run left may be all there is of its results
            make_way(&part).and_then(|_| std::fs::File::create(&part)).map(drop).map_err(|e| explain(&e))
        })?;
        let begun = Self::begin(comm, path, part.clone(), header, particles);
        if begun.is_err() && comm.is_root() {
            let _ = std::fs::remove_file(&part); // nothing is in it; the reason is what counts
        }
        begun
    }

    fn begin(comm: &Comm, path: &Path, part: PathBuf, header: &Header, particles: &Particles) -> Result<Self, String> {
        let block = to_block(comm, particles)?;
        let file = agree(comm, access(comm).and_then(|fapl| File::with_options().set_fapl(&fapl)?.create(&part)))?;
        on_root(comm, || {
            let sizes = 32 * (block.total + block.total_points) as u64;
            reserve(&part, sizes + header.scene.len() as u64 + MARGIN)
        })?;
        agree(comm, write_header(&file, header, &block))?;
        agree(comm, write_fixed_rows(&file, &block))?;
        agree(comm, file.flush())?;
        Ok(ResultsFile {
            path: path.to_owned(),
            part,
            elements: BTreeMap::new(),
            file,
            frames: 0,
            particles: block.total,
            points: block.total_points,
        })
    }

    /// Adds a sample. After an error the file still holds the samples before it, and can be finished. Collective.
    pub fn append(&mut self, comm: &Comm, frame: &Frame) -> Result<(), OutputError> {
        self.try_append(comm, frame).map_err(|reason| {
            for dataset in self.elements.values() {
                // the first error is the one to tell; a file that cannot be mended has its frames counted by `step`
                let _ = agree(comm, resize(dataset, self.frames));
            }
            OutputError::write(&self.part, reason)
        })
    }

    fn try_append(&mut self, comm: &Comm, frame: &Frame) -> Result<(), String> {
        let block = to_block(comm, frame.particles)?;
        let items = items(comm, frame, &block);
        let same = self.frames == 0
            || (items.len() == self.elements.len() && items.iter().all(|i| self.elements.contains_key(&i.name)));
        if !same || (block.total, block.total_points) != (self.particles, self.points) {
            return Err("particles and names of values must be the same in all samples".to_owned());
        }
        let bytes: u64 = items.iter().map(Item::bytes).sum();
        on_root(comm, || reserve(&self.part, bytes + MARGIN))?;
        for item in &items {
            if !self.elements.contains_key(&item.name) {
                let dataset = agree(comm, item.create(&self.file))?;
                self.elements.insert(item.name.clone(), dataset);
            }
            agree(comm, resize(&self.elements[&item.name], self.frames + 1))?;
        }
        // one after the other: the values of all at once would take several times as much memory
        for item in &items {
            agree(comm, item.write(&self.elements[&item.name], self.frames))?;
        }
        agree(comm, self.file.flush())?;
        self.frames += 1;
        Ok(())
    }

    /// Closes the file and gives it its name; an older file of that name is moved to NAME.1.h5 (or 2, ...), and
    /// rank 0 hears where it went. `failure` says why the run ended early, if it did: that is written into the file,
    /// which then holds the samples until then. Collective.
    pub fn finish(self, comm: &Comm, failure: Option<&str>) -> Result<Option<PathBuf>, OutputError> {
        let ResultsFile { path, part, elements, file, .. } = self;
        let close = || {
            agree(comm, write_status(&file, failure))?;
            agree(comm, file.flush())?;
            drop(elements);
            agree(comm, file.close())?;
            let mut moved = None;
            on_root(comm, || {
                moved = publish(&part, &path)?;
                Ok(())
            })?;
            Ok(moved)
        };
        close().map_err(|reason: String| OutputError::write(&path, reason))
    }
}

/// How a file is opened: by all ranks through MPI, or by one process that never started MPI.
pub(super) fn access(comm: &Comm) -> hdf5::Result<FileAccess> {
    let mut fapl = FileAccess::build();
    if let Some(raw) = comm.raw() {
        fapl.mpio(raw, None).coll_metadata_write(true);
    }
    fapl.finish()
}

fn with_suffix(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(suffix);
    PathBuf::from(name)
}

fn write_header(file: &File, header: &Header, block: &Block) -> hdf5::Result<()> {
    let h5md = file.create_group("h5md")?;
    h5md.new_attr::<i32>().shape([2]).create("version")?.write(&[1, 1])?;
    let author = h5md.create_group("author")?;
    write_text(&author, "name", "jamhpc")?;
    let creator = h5md.create_group("creator")?;
    write_text(&creator, "name", env!("CARGO_PKG_NAME"))?;
    write_text(&creator, "version", env!("CARGO_PKG_VERSION"))?;

    let parameters = file.create_group("parameters")?;
    parameters.new_attr::<Status>().create("status")?;
    write_text(&parameters, "model", model(&block.particles.bodies))?;
    write_text(&parameters, "scene", &header.scene)?;
    write_text(&parameters, "units", &header.units)?;
    write_text(&parameters, "git_hash", env!("JAMHPC_GIT_HASH"))?;
    write_text(&parameters, "time", "step and time count the samples; the density of each is an observable")?;
    write_number(&parameters, "seed", header.seed)?;
    write_number(&parameters, "n_particles", block.total as u64)?;
    let potential = parameters.create_group("potential")?;
    write_text(&potential, "contact", &header.contact)?;
    for (name, value) in &header.potential {
        write_number(&potential, name, *value)?;
    }
    write_state(file, "running, or killed before its end")?;

    let cell = make_group(file, "particles/all/box")?;
    write_number(&cell, "dimension", 2i32)?;
    let periodic: FixedAscii<8> = FixedAscii::from_ascii("periodic").map_err(|e| e.to_string())?;
    cell.new_attr::<FixedAscii<8>>().shape([2]).create("boundary")?.write(&[periodic, periodic])
}

/// Sizes and numbers of particles and points.
fn write_fixed_rows(file: &File, block: &Block) -> hdf5::Result<()> {
    let sizes = make_group(file, SIZES)?;
    let points = make_group(file, "particles/all")?;
    let rows = |here: &Range<usize>| here.clone().map(|k| k as i64).collect::<Vec<_>>();
    let particles = &block.particles;
    let per_particle = (block.ids.start, block.total);
    let per_point = (block.points.start, block.total_points);
    // creating is collective and writing is not: a rank whose write fails must have created everything
    let mut written = vec![
        write_fixed(&sizes, size_name(&particles.bodies), per_particle, &particles.size)?,
        write_fixed(&points, "id", per_point, &rows(&block.points))?,
    ];
    match particles.bodies {
        Bodies::Disks => file.link_hard(&format!("/{SIZES}/diameter"), "particles/all/diameter")?,
        Bodies::Polygons { .. } => {
            let n = |p: usize| particles.bodies.points(p).len();
            let counts: Vec<i64> = (0..particles.len()).map(|p| n(p) as i64).collect();
            let owner: Vec<i64> = block.ids.clone().enumerate().flat_map(|(p, id)| vec![id as i64; n(p)]).collect();
            let vertex: Vec<i64> = (0..particles.len()).flat_map(|p| (0..n(p)).map(|v| v as i64)).collect();
            written.push(write_fixed(&sizes, "n_vertices", per_particle, &counts)?);
            written.push(write_fixed(&points, "particle_id", per_point, &owner)?);
            written.push(write_fixed(&points, "vertex", per_point, &vertex)?);
        }
    }
    written.into_iter().collect()
}

/// Creates a dataset of `total` rows on all ranks and writes those of this rank; the inner result is of this rank.
fn write_fixed<T: H5Type>(
    group: &Group,
    name: &str,
    (start, total): (usize, usize),
    data: &[T],
) -> hdf5::Result<hdf5::Result<()>> {
    let builder = group.new_dataset::<T>().fill_time(FillTime::Never).obj_track_times(false);
    let dataset = builder.shape([total]).create(name)?;
    let rows = start..start + data.len();
    Ok(write_part(&dataset, vec![rows], data))
}

pub(super) fn model(bodies: &Bodies) -> &'static str {
    match bodies {
        Bodies::Disks => "sp",
        Bodies::Polygons { .. } => "dp",
    }
}

pub(super) fn size_name(bodies: &Bodies) -> &'static str {
    match bodies {
        Bodies::Disks => "diameter",
        Bodies::Polygons { .. } => "a0",
    }
}

fn make_group(file: &File, name: &str) -> hdf5::Result<Group> {
    if file.link_exists(name) {
        file.group(name)
    } else {
        file.create_group_builder().create_intermediate_group(true).create(name)
    }
}

fn write_text(at: &Location, name: &str, text: &str) -> hdf5::Result<()> {
    let text: VarLenUnicode = text.parse().map_err(|e| format!("{name}: {e}"))?;
    at.new_attr::<VarLenUnicode>().create(name)?.write_scalar(&text)
}

fn write_number<T: H5Type>(at: &Location, name: &str, value: T) -> hdf5::Result<()> {
    at.new_attr::<T>().create(name)?.write_scalar(&value)
}

fn write_status(file: &File, failure: Option<&str>) -> hdf5::Result<()> {
    match failure {
        None => write_state(file, COMPLETE),
        Some(why) => write_state(file, &format!("ended early: {why}")),
    }
}

fn write_state(file: &File, state: &str) -> hdf5::Result<()> {
    let mut short: String = state.chars().filter(|&c| c != '\0').collect();
    while short.len() > STATUS_BYTES {
        short.pop();
    }
    let status: Status = short.parse().map_err(|e| format!("status: {e}"))?;
    file.group("parameters")?.attr("status")?.write_scalar(&status)
}

fn resize(dataset: &Dataset, frames: usize) -> hdf5::Result<()> {
    let mut shape = dataset.shape();
    shape[0] = frames;
    dataset.resize(shape)
}

/// Writes `data` to the given range along each axis. Not collective.
fn write_part<T: H5Type>(dataset: &Dataset, ranges: Vec<Range<usize>>, data: &[T]) -> hdf5::Result<()> {
    if data.is_empty() {
        return Ok(());
    }
    let shape: Vec<usize> = ranges.iter().map(|r| r.len()).collect();
    let view = ArrayViewD::from_shape(shape, data).map_err(|e| e.to_string())?;
    dataset.write_slice(view, slab(ranges))
}

pub(super) fn slab(ranges: Vec<Range<usize>>) -> Selection {
    Hyperslab::from(ranges.into_iter().map(SliceOrIndex::from).collect::<Vec<_>>()).into()
}

/// This rank's part of one time-dependent element in one frame.
struct Item<'a> {
    name: String,
    /// Shape of the element in a frame, without the axis of samples.
    shape: Vec<usize>,
    /// The rows of the first axis of `shape` that are written here.
    rows: Range<usize>,
    values: Values<'a>,
}

/// How to come by the values, which may be collective.
enum Values<'a> {
    Real(Box<dyn Fn() -> Vec<f64> + 'a>),
    Whole(Box<dyn Fn() -> Vec<i64> + 'a>),
}

/// Everything that a frame writes, the same names in the same order on all ranks.
fn items<'a>(comm: &'a Comm, frame: &'a Frame, block: &'a Block) -> Vec<Item<'a>> {
    let particles = &block.particles;
    let positions = || (0..particles.len()).flat_map(|p| whole(frame.pbox, particles, p)).flatten().collect();
    let fractions = || particles.position.iter().flat_map(|f| f.to_bits()).collect();
    // what all ranks have is written by one
    let rows = |shape: &[usize]| 0..shape.first().copied().unwrap_or(1);
    let once = |name: String, shape: &[usize], values: Vec<f64>| Item {
        name,
        shape: shape.to_vec(),
        rows: rows(shape),
        values: Values::Real(Box::new(move || if comm.is_root() { values.clone() } else { Vec::new() })),
    };
    let of_points = |name: String, values: Values<'a>| Item {
        name,
        shape: vec![block.total_points, 2],
        rows: block.points.clone(),
        values,
    };
    let step = move || if comm.is_root() { vec![frame.step as i64] } else { Vec::new() };
    let edges = vec![frame.pbox.lx(), 0.0, frame.pbox.xy(), frame.pbox.ly()];
    let mut items = vec![
        Item { name: STEP.to_owned(), shape: Vec::new(), rows: rows(&[]), values: Values::Whole(Box::new(step)) },
        once(TIME.to_owned(), &[], vec![frame.step as f64]),
        once(format!("{EDGES}/value"), &[2, 2], edges),
        of_points(format!("{POSITION}/value"), Values::Real(Box::new(positions))),
        of_points(format!("{FRACTION}/value"), Values::Whole(Box::new(fractions))),
    ];
    for &(name, value) in frame.scalars {
        items.push(once(format!("{OBSERVABLES}/{name}/value"), &[], vec![value]));
    }
    for &(name, tensor) in frame.tensors {
        items.push(once(format!("{OBSERVABLES}/{name}/value"), &[2, 2], tensor.to_vec()));
    }
    for (name, value) in frame.columns {
        items.push(Item {
            name: format!("{COLUMNS}/{name}/value"),
            shape: vec![block.total],
            rows: block.ids.clone(),
            values: Values::Real(Box::new(move || block.column(comm, frame.particles, value))),
        });
    }
    items
}

impl Item<'_> {
    fn chunk(&self) -> Vec<usize> {
        match &self.shape[..] {
            [] => vec![CHUNK_SAMPLES],
            [rows, rest @ ..] => [&[1, (*rows).clamp(1, CHUNK_ROWS)], rest].concat(),
        }
    }

    /// Most bytes that a frame adds to the file.
    fn bytes(&self) -> u64 {
        let chunk: usize = self.chunk().iter().product();
        let frame: usize = self.shape.iter().product();
        (8 * frame.next_multiple_of(chunk)) as u64
    }

    /// The dataset with no samples yet, and beside it the steps and times that all elements share.
    fn create(&self, file: &File) -> hdf5::Result<Dataset> {
        let (group, name) = self.name.rsplit_once('/').unwrap_or(("", &self.name));
        let group = make_group(file, group)?;
        let samples = std::iter::once(Extent::resizable(0));
        let extents = SimpleExtents::new(samples.chain(self.shape.iter().map(|&n| Extent::fixed(n))));
        let builder = match self.values {
            Values::Real(_) => group.new_dataset::<f64>(),
            Values::Whole(_) => group.new_dataset::<i64>(),
        };
        let builder = builder.chunk(self.chunk()).fill_time(FillTime::Never).obj_track_times(false);
        let dataset = builder.shape(extents).create(name)?;
        if name == "value" && !group.link_exists("step") {
            group.link_hard(&format!("/{STEP}"), "step")?;
            group.link_hard(&format!("/{TIME}"), "time")?;
        }
        Ok(dataset)
    }

    fn write(&self, dataset: &Dataset, frame: usize) -> hdf5::Result<()> {
        let sample = frame..frame + 1;
        let mut ranges = vec![sample];
        if let [_, rest @ ..] = &self.shape[..] {
            ranges.push(self.rows.clone());
            ranges.extend(rest.iter().map(|&n| 0..n));
        }
        match &self.values {
            Values::Real(values) => write_part(dataset, ranges, &values()),
            Values::Whole(values) => write_part(dataset, ranges, &values()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Results, info};
    use super::*;
    use crate::geometry::Frac;
    use std::fs;

    fn header() -> Header {
        Header {
            scene: "model = \"dp\"  # ε and δ\n".to_owned(),
            seed: u64::MAX,
            units: "length l, energy γ l".to_owned(),
            contact: "vertex-edge".to_owned(),
            potential: vec![("delta".to_owned(), 0.1), ("epsilon".to_owned(), 1.0 / 3.0)],
        }
    }

    fn polygons() -> Particles {
        let mut p = Particles::empty(&Bodies::Polygons { first: vec![0] });
        p.push(1, 0.7, &[[i64::MAX, -7], [i64::MIN, -7], [i64::MIN, 1 << 60]].map(Frac::from_bits));
        p.push(0, 1.3, &[[1, 2], [1 << 60, 2], [1 << 60, 1 << 60], [1, 1 << 60]].map(Frac::from_bits));
        p
    }

    fn disks() -> Particles {
        let mut p = Particles::empty(&Bodies::Disks);
        p.push(0, 1.0, &[Frac::from_bits([3, -9])]);
        p.push(1, 1.4, &[Frac::from_bits([i64::MIN, 5])]);
        p
    }

    fn frame<'a>(
        step: u64,
        pbox: &'a PeriodicBox,
        particles: &'a Particles,
        columns: &'a [(&'a str, Column<'a>)],
    ) -> Frame<'a> {
        let scalars = &[("density", 0.84), ("pressure", -0.0), ("max_force", 1e-14)];
        Frame { step, pbox, particles, scalars, tensors: &[("stress_virial", [1.0, 2.0, 3.0, 4.0])], columns }
    }

    #[test]
    fn a_run_is_read_back_to_the_bit() {
        let comm = Comm::alone();
        for particles in [disks(), polygons()] {
            let home = tempfile::tempdir().unwrap();
            let path = home.path().join("run.h5");
            let mut file = ResultsFile::create(&comm, &path, &header(), &particles).unwrap();
            for step in 0..3 {
                let pbox = PeriodicBox::new(3.0, 2.0 + step as f64 / 3.0, 0.1 * step as f64);
                let columns: [(_, Column); 1] = [("z", Box::new(move |p| [1.0 + step as f64, f64::NAN][p]))];
                file.append(&comm, &frame(step, &pbox, &particles, &columns)).unwrap();
            }
            assert!(!path.exists(), "no unfinished file has the name of a finished one");
            file.finish(&comm, None).unwrap();

            let results = Results::open(&comm, &path).unwrap();
            assert_eq!(results.header, header());
            assert_eq!((results.frames, results.particles, results.failure.as_deref()), (3, 2, None));
            let at = results.frame(&comm, 2).unwrap();
            let sorted = to_block(&comm, &particles).unwrap().particles;
            assert_eq!(at.pbox, PeriodicBox::new(3.0, 2.0 + 2.0 / 3.0, 0.2));
            assert_eq!((at.step, &at.particles.id, &at.particles.size), (2, &sorted.id, &sorted.size));
            assert_eq!((&at.particles.bodies, &at.particles.position), (&sorted.bodies, &sorted.position));
            let scalar = |name: &str| at.scalars.iter().find(|(n, _)| n == name).unwrap().1;
            assert_eq!((scalar("density"), scalar("max_force")), (0.84, 1e-14));
            assert_eq!(scalar("pressure").to_bits(), (-0.0f64).to_bits());
            assert_eq!(at.tensors, [("stress_virial".to_owned(), [1.0, 2.0, 3.0, 4.0])]);
            assert!(at.columns[0].0 == "z" && at.columns[0].1.contains(&3.0));
            let beyond = results.frame(&comm, 3).unwrap_err().to_string();
            assert!(beyond.contains("run.h5") && beyond.contains("frames 0 to 2"), "{beyond}");
            let series = results.series().unwrap();
            assert!(series.contains(&("density".to_owned(), vec![0.84; 3])));
            let text = info(&path).unwrap();
            for part in ["complete", "2 particles", "1.00000e-14", "epsilon = 0.333", "# ε and δ"] {
                assert!(text.contains(part), "{part} in\n{text}");
            }
        }
    }

    #[test]
    fn a_failed_run_keeps_its_samples_and_says_why() {
        let comm = Comm::alone();
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("run.h5");
        let particles = disks();
        let pbox = PeriodicBox::square(3.0);
        let mut file = ResultsFile::create(&comm, &path, &header(), &particles).unwrap();
        file.append(&comm, &frame(0, &pbox, &particles, &[])).unwrap();
        let more: [(_, Column); 1] = [("z", Box::new(|_| 0.0))];
        let error = file.append(&comm, &frame(1, &pbox, &particles, &more)).unwrap_err().to_string();
        assert!(error.contains("the same in all samples"), "{error}");
        file.finish(&comm, Some(&"δ".repeat(300))).unwrap();
        let results = Results::open(&comm, &path).unwrap();
        assert_eq!(results.frames, 1);
        assert!(results.failure.as_deref().unwrap().starts_with("ended early: δδ"));
        assert!(info(&path).unwrap().contains("ended early"));
    }

    #[test]
    fn a_run_without_samples_can_be_read() {
        let comm = Comm::alone();
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("run.h5");
        let file = ResultsFile::create(&comm, &path, &header(), &polygons()).unwrap();
        file.finish(&comm, Some("not converged")).unwrap();
        let results = Results::open(&comm, &path).unwrap();
        assert_eq!(results.frames, 0);
        assert!(results.frame(&comm, 0).unwrap_err().to_string().contains("no frames"));
        assert!(info(&path).unwrap().contains("ended early: not converged"));
    }

    #[test]
    fn a_killed_run_can_be_read_and_is_never_overwritten() {
        let comm = Comm::alone();
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("run.h5");
        let part = home.path().join("run.h5.part");
        let particles = disks();
        let pbox = PeriodicBox::square(3.0);
        let mut file = ResultsFile::create(&comm, &path, &header(), &particles).unwrap();
        file.append(&comm, &frame(0, &pbox, &particles, &[])).unwrap();
        let as_killed = fs::read(&part).unwrap(); // as it is on the disk after the flush
        drop(file);
        fs::write(&part, as_killed).unwrap();
        let results = Results::open(&comm, &part).unwrap();
        assert_eq!((results.frames, results.failure.as_deref()), (1, Some("running, or killed before its end")));
        drop(results);
        for _ in 0..2 {
            ResultsFile::create(&comm, &path, &header(), &particles).unwrap().finish(&comm, None).unwrap();
        }
        let mut names: Vec<_> = fs::read_dir(home.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
        names.sort();
        assert_eq!(names, ["run.1.h5", "run.1.h5.part", "run.h5"]);
    }

    #[test]
    fn what_is_not_a_results_file_is_refused_by_name() {
        let comm = Comm::alone();
        let home = tempfile::tempdir().unwrap();
        let text = home.path().join("scene.toml");
        fs::write(&text, "model = \"dp\"").unwrap();
        let other = home.path().join("other.h5");
        File::create(&other).unwrap().close().unwrap();
        let cut = home.path().join("cut.h5");
        fs::write(&cut, &fs::read(&other).unwrap()[..100]).unwrap();
        let missing = home.path().join("missing.h5");
        for (path, word) in [
            (home.path(), "a folder"),
            (&text, "not an HDF5 file"),
            (&other, "not a results file"),
            (&cut, "damaged"),
            (&missing, "check the path"),
        ] {
            let error = Results::open(&comm, path).err().unwrap().to_string();
            assert!(error.contains(word) && error.contains(&*path.to_string_lossy()), "{error}");
        }
    }
}
