//! Reading a results file back, by any number of ranks: the exact bits of every sample.

use super::error::{OutputError, agree};
use super::folder::explain;
use super::h5md::{
    COLUMNS, COMPLETE, EDGES, FRACTION, Header, OBSERVABLES, SIZES, STEP, Status, access, model, size_name, slab,
};
use super::rows::{ids_of_rank, points_here};
use crate::comm::Comm;
use crate::geometry::{Frac, PeriodicBox};
use crate::particles::{Bodies, Particles};
use hdf5::types::VarLenUnicode;
use hdf5::{Dataset, File, Group, H5Type, Location};
use std::io::Read;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// A results file open for reading. To be dropped on all ranks together, before MPI ends.
pub struct Results {
    pub header: Header,
    /// Version of jamhpc and the commit that wrote it.
    pub version: String,
    pub git_hash: String,
    /// Why the run ended early, if it did, or that it never ended.
    pub failure: Option<String>,
    /// Number of samples.
    pub frames: usize,
    /// Number of particles.
    pub particles: usize,
    path: PathBuf,
    /// This rank's particles: ids, sizes, points.
    ids: Range<usize>,
    size: Vec<f64>,
    bodies: Bodies,
    points: Range<usize>,
    /// Names of per-sample and per-particle values.
    scalars: Vec<String>,
    tensors: Vec<String>,
    columns: Vec<String>,
    file: File,
}

/// One sample as it was written; particles and columns are those of this rank's block of ids.
#[derive(Clone, Debug)]
pub struct Snapshot {
    pub step: u64,
    pub pbox: PeriodicBox,
    pub particles: Particles,
    pub scalars: Vec<(String, f64)>,
    pub tensors: Vec<(String, [f64; 4])>,
    pub columns: Vec<(String, Vec<f64>)>,
}

impl Results {
    /// Opens a file that [`super::ResultsFile`] wrote. Collective.
    pub fn open(comm: &Comm, path: &Path) -> Result<Self, OutputError> {
        Self::try_open(comm, path).map_err(|reason| OutputError::read(path, reason))
    }

    fn try_open(comm: &Comm, path: &Path) -> Result<Self, String> {
        let bytes = comm.from_root(|| looks_like_hdf5(path).map(|bytes| bytes.to_le_bytes().to_vec()))?;
        let bytes = bytes.try_into().map_or(0, u64::from_le_bytes);
        let file = agree(comm, access(comm).and_then(|fapl| File::with_options().set_fapl(&fapl)?.open(path)))
            .map_err(|reason| format!("damaged HDF5 file ({reason})"))?;
        let mut results = agree(comm, read_header(comm, path, file))
            .map_err(|reason| format!("an HDF5 file, but not a results file of jamhpc, or a damaged one ({reason})"))?;
        if results.frames.max(results.particles) as u64 > bytes {
            let Results { frames, particles, .. } = results;
            return Err(format!("damaged: {frames} samples of {particles} particles in {bytes} bytes"));
        }
        results.points = points_here(comm, results.points.len()).0;
        Ok(results)
    }

    /// `sp` or `dp`.
    pub fn model(&self) -> &'static str {
        model(&self.bodies)
    }

    /// Sample `k`, counted from 0. Collective.
    pub fn frame(&self, comm: &Comm, k: usize) -> Result<Snapshot, OutputError> {
        if k >= self.frames {
            let reason = match self.frames {
                0 => format!("it has no frames, frame {k} was asked for"),
                n => format!("no frame {k}; it has the frames 0 to {}", n - 1),
            };
            return Err(OutputError::read(&self.path, reason));
        }
        agree(comm, self.snapshot(k)).map_err(|reason| OutputError::read(&self.path, format!("frame {k}: {reason}")))
    }

    /// One number per sample by name: density, pressure, ...
    pub fn series(&self) -> Result<Vec<(String, Vec<f64>)>, OutputError> {
        let all = 0..self.frames;
        let read = |name: &String| {
            let values = self.part::<f64>(&format!("{OBSERVABLES}/{name}/value"), vec![all.clone()])?;
            Ok((name.clone(), values))
        };
        let series: hdf5::Result<Vec<_>> = self.scalars.iter().map(read).collect();
        series.map_err(|reason| OutputError::read(&self.path, reason))
    }

    fn snapshot(&self, k: usize) -> hdf5::Result<Snapshot> {
        let sample = k..k + 1;
        let edges = self.part::<f64>(&format!("{EDGES}/value"), vec![sample.clone(), 0..2, 0..2])?;
        let bits = self.part::<i64>(&format!("{FRACTION}/value"), vec![sample.clone(), self.points.clone(), 0..2])?;
        let step = self.part::<i64>(STEP, vec![sample.clone()])?[0];
        let mut particles = Particles::empty(&self.bodies);
        particles.id = self.ids.clone().map(|id| id as u32).collect();
        particles.size = self.size.clone();
        particles.bodies = self.bodies.clone();
        particles.position = bits.chunks_exact(2).map(|b| Frac::from_bits([b[0], b[1]])).collect();
        let scalar = |name: &String| {
            let values = self.part::<f64>(&format!("{OBSERVABLES}/{name}/value"), vec![sample.clone()])?;
            Ok((name.clone(), values[0]))
        };
        let tensor = |name: &String| {
            let ranges = vec![sample.clone(), 0..2, 0..2];
            let t = self.part::<f64>(&format!("{OBSERVABLES}/{name}/value"), ranges)?;
            Ok((name.clone(), [t[0], t[1], t[2], t[3]]))
        };
        let column = |name: &String| {
            let ranges = vec![sample.clone(), self.ids.clone()];
            Ok((name.clone(), self.part::<f64>(&format!("{COLUMNS}/{name}/value"), ranges)?))
        };
        Ok(Snapshot {
            step: step as u64,
            pbox: PeriodicBox::new(edges[0], edges[3], edges[2]),
            particles,
            scalars: self.scalars.iter().map(scalar).collect::<hdf5::Result<_>>()?,
            tensors: self.tensors.iter().map(tensor).collect::<hdf5::Result<_>>()?,
            columns: self.columns.iter().map(column).collect::<hdf5::Result<_>>()?,
        })
    }

    fn part<T: H5Type>(&self, name: &str, ranges: Vec<Range<usize>>) -> hdf5::Result<Vec<T>> {
        part(&self.file.dataset(name)?, ranges)
    }
}

/// Whether there is a file and it begins as HDF5 files do, before HDF5 itself looks at it; its length.
fn looks_like_hdf5(path: &Path) -> Result<u64, String> {
    if path.is_dir() {
        return Err("it is a folder; name the .h5 file in it".to_owned());
    }
    let mut start = [0; 8];
    let mut file = std::fs::File::open(path).map_err(|e| explain(&e))?;
    match file.read_exact(&mut start) {
        Ok(()) if start == *b"\x89HDF\r\n\x1a\n" => Ok(file.metadata().map_err(|e| explain(&e))?.len()),
        Ok(()) => Err("not an HDF5 file; results files are named NAME.h5".to_owned()),
        Err(_) => Err("too short for an HDF5 file".to_owned()),
    }
}

/// Everything but the samples. Points are counted from this rank's first.
fn read_header(comm: &Comm, path: &Path, file: File) -> hdf5::Result<Results> {
    let parameters = file.group("parameters")?;
    let creator = file.group("h5md/creator")?;
    if text(&creator, "name")? != env!("CARGO_PKG_NAME") {
        return Err(format!("written by {}", text(&creator, "name")?).into());
    }
    let potential = parameters.group("potential")?;
    let constants = potential.attr_names()?.into_iter().filter(|name| name != "contact");
    let constant = |name: String| Ok((name.clone(), potential.attr(&name)?.read_scalar::<f64>()?));
    let header = Header {
        scene: text(&parameters, "scene")?,
        seed: parameters.attr("seed")?.read_scalar()?,
        units: text(&parameters, "units")?,
        contact: text(&potential, "contact")?,
        potential: constants.map(constant).collect::<hdf5::Result<_>>()?,
    };
    let status = parameters.attr("status")?.read_scalar::<Status>()?;
    let particles = parameters.attr("n_particles")?.read_scalar::<u64>()? as usize;
    let ids = ids_of_rank(particles, comm.size(), comm.rank());
    let sizes = file.group(SIZES)?;
    let bodies = match text(&parameters, "model")?.as_str() {
        "sp" => Bodies::Disks,
        _ => {
            let counts: Vec<i64> = part(&sizes.dataset("n_vertices")?, vec![ids.clone()])?;
            let mut first = vec![0];
            for n in counts {
                first.push(first[first.len() - 1] + n as u32);
            }
            Bodies::Polygons { first }
        }
    };
    let size = part(&sizes.dataset(size_name(&bodies))?, vec![ids.clone()])?;
    let points = 0..match &bodies {
        Bodies::Disks => ids.len(),
        Bodies::Polygons { first } => first[ids.len()] as usize,
    };
    let frames = if file.group("particles/all")?.link_exists("position") { file.dataset(STEP)?.size() } else { 0 };
    let named = |group: &Group, ndim: usize| -> hdf5::Result<Vec<String>> {
        let mut names = group.member_names()?;
        names.retain(|name| group.dataset(&format!("{name}/value")).is_ok_and(|d| d.ndim() == ndim));
        Ok(names)
    };
    let (mut scalars, mut tensors, mut columns) = (Vec::new(), Vec::new(), Vec::new());
    if file.link_exists(OBSERVABLES) {
        let observables = file.group(OBSERVABLES)?;
        (scalars, tensors) = (named(&observables, 1)?, named(&observables, 3)?);
        if file.link_exists(COLUMNS) {
            columns = named(&file.group(COLUMNS)?, 2)?;
        }
    }
    Ok(Results {
        header,
        version: text(&creator, "version")?,
        git_hash: text(&parameters, "git_hash")?,
        failure: (status.as_str() != COMPLETE).then(|| status.as_str().to_owned()),
        frames,
        particles,
        path: path.to_owned(),
        ids,
        size,
        bodies,
        points,
        scalars,
        tensors,
        columns,
        file,
    })
}

fn text(at: &Location, name: &str) -> hdf5::Result<String> {
    Ok(at.attr(name)?.read_scalar::<VarLenUnicode>()?.as_str().to_owned())
}

/// The values in the given range along each axis. Not collective.
fn part<T: H5Type>(dataset: &Dataset, ranges: Vec<Range<usize>>) -> hdf5::Result<Vec<T>> {
    let shape = dataset.shape();
    if shape.len() != ranges.len() || ranges.iter().zip(&shape).any(|(range, &length)| range.end > length) {
        return Err(format!("{} has the shape {shape:?}", dataset.name()).into());
    }
    if ranges.iter().any(|range| range.is_empty()) {
        return Ok(Vec::new());
    }
    let array = dataset.read_slice::<T, _, ndarray::IxDyn>(slab(ranges))?;
    Ok(array.into_raw_vec_and_offset().0)
}
