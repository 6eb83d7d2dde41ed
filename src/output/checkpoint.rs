//! Checkpoint files: what a run has found out, whole and with a checksum, or not there at all.
//!
//! Rank 0 alone writes, in pieces that the others hand it: a plain file tells that the disk is full, which parallel
//! writes may not, and a checkpoint is rare and much smaller than what memory holds. Particles stand in the file in any
//! order and any number of ranks may read them, each a part: the system hands them to their owners.

use super::error::{OutputError, agree, on_root};
use super::folder::explain;
use crate::comm::Comm;
use crate::particles::{Bodies, Particles};
use crc32fast::Hasher;
use std::borrow::Cow;
use std::fs::{self, File};
use std::io::{BufReader, BufWriter, Error, ErrorKind, Read, Write};
use std::path::Path;

/// One thing that is known.
#[derive(Clone, Debug)]
pub struct Record<'a> {
    /// Words about it that its writer understands, the same on all ranks.
    pub note: String,
    /// This rank's own particles in a state, with the vectors that they carry.
    pub particles: Option<Cow<'a, Particles>>,
}

/// First bytes of a file; the digit changes with the layout.
const MAGIC: &[u8; 8] = b"JAMCKPT1";
/// Particles that are handed to rank 0 at once: some megabytes.
const PIECE: usize = 1 << 14;

/// Writes a file of records beside `path`, brings it to the disk and gives it its name. What had the name before is
/// kept as `previous`, if that is given. After an error everything is as it was. Collective.
pub fn write_records(
    comm: &Comm,
    path: &Path,
    records: &[Record<'_>],
    previous: Option<&Path>,
) -> Result<(), OutputError> {
    let part = path.with_extension("part");
    let mut file = comm.is_root().then(|| Writer::create(&part));
    let mut put = |bytes: &[u8]| {
        if let Some(file) = &mut file {
            file.message(bytes);
        }
    };
    put(&(records.len() as u64).to_le_bytes());
    for record in records {
        put(record.note.as_bytes());
        let pieces = record.particles.as_ref().map_or(0, |p| p.len().div_ceil(PIECE)) as u64;
        let counts: Vec<u64> = comm.all_gather(&[pieces]).iter().map(|here| here[0]).collect();
        let carried = record.particles.as_ref().map_or(0, |p| 1 + p.carried.len()) as u64;
        put(bytemuck::cast_slice(&[carried, counts.iter().sum::<u64>()]));
        for k in 0..counts.into_iter().max().unwrap_or(0) as usize {
            let mut message = Vec::new();
            if let Some(particles) = &record.particles {
                let last = particles.len().min((k + 1) * PIECE);
                (k * PIECE..last).for_each(|p| particles.pack(p, true, &mut message));
            }
            comm.gather(message)
                .iter()
                .filter(|piece| !piece.is_empty())
                .for_each(|piece| put(bytemuck::cast_slice(piece)));
        }
    }
    let finish = || -> std::io::Result<()> {
        let Some(file) = file else { return Ok(()) };
        file.finish()?;
        if let Some(previous) = previous.filter(|_| path.exists()) {
            fs::rename(path, previous)?;
        }
        fs::rename(&part, path)?;
        path.parent().map_or(Ok(()), |folder| File::open(folder)?.sync_all())
    };
    let written = on_root(comm, || {
        finish().map_err(|e| {
            let _ = fs::remove_file(&part); // it takes space that is wanted
            explain(&e)
        })
    });
    written.map_err(|reason| OutputError::write(path, reason))
}

/// Reads a file of records whose particles are of the kind of `bodies`; each rank gets some of them. Collective.
pub fn read_records(comm: &Comm, path: &Path, bodies: &Bodies) -> Result<Vec<Record<'static>>, OutputError> {
    try_read(comm, path, bodies).map_err(|reason| OutputError::read(path, reason))
}

fn try_read(comm: &Comm, path: &Path, bodies: &Bodies) -> Result<Vec<Record<'static>>, String> {
    let mut file = None;
    on_root(comm, || {
        file = Some(Reader::open(path).map_err(|e| explain(&e))?);
        Ok(())
    })?;
    // only rank 0 has a file
    let mut next = || file.as_mut().map_or(Ok(Vec::new()), |file| file.message().map_err(|e| explain(&e)));
    let words = |bytes: &[u8]| bytemuck::pod_collect_to_vec::<u8, u64>(bytes);
    let damaged = || "it is damaged".to_owned();

    let [n_records] = words(&comm.from_root(&mut next)?)[..] else { return Err(damaged()) };
    let mut records = Vec::new();
    for _ in 0..n_records {
        let note = String::from_utf8(comm.from_root(&mut next)?).map_err(|_| damaged())?;
        let [carried, pieces] = words(&comm.from_root(&mut next)?)[..] else { return Err(damaged()) };
        if carried == 0 {
            records.push(Record { note, particles: None });
            continue;
        }
        let mut particles = Particles::empty(bodies);
        particles.carried = vec![Vec::new(); carried as usize - 1];
        for first in (0..pieces as usize).step_by(comm.size()) {
            let here = comm.size().min(pieces as usize - first);
            let mut outgoing = vec![Vec::new(); comm.size()];
            let mut read = Ok(());
            if comm.is_root() {
                for piece in &mut outgoing[..here] {
                    match next() {
                        Ok(bytes) => *piece = words(&bytes),
                        Err(reason) => read = Err(reason),
                    }
                }
            }
            comm.all_to_all(outgoing).iter().for_each(|piece| particles.unpack(piece, true));
            agree(comm, read)?;
        }
        records.push(Record { note, particles: Some(Cow::Owned(particles)) });
    }
    Ok(records)
}

/// Bytes in messages, each after its length; at the end a checksum of everything before. Says at the end whether
/// something went wrong on the way.
struct Writer {
    state: std::io::Result<(BufWriter<File>, Hasher)>,
}

impl Writer {
    fn create(path: &Path) -> Self {
        let mut writer = Writer { state: File::create(path).map(|file| (BufWriter::new(file), Hasher::new())) };
        writer.bytes(MAGIC);
        writer
    }

    fn message(&mut self, bytes: &[u8]) {
        self.bytes(&(bytes.len() as u64).to_le_bytes());
        self.bytes(bytes);
    }

    fn bytes(&mut self, bytes: &[u8]) {
        if let Ok((file, sum)) = &mut self.state {
            sum.update(bytes);
            if let Err(error) = file.write_all(bytes) {
                self.state = Err(error);
            }
        }
    }

    fn finish(self) -> std::io::Result<()> {
        let (mut file, sum) = self.state?;
        file.write_all(&sum.finalize().to_le_bytes())?;
        file.into_inner()?.sync_all()
    }
}

/// The messages of a file whose checksum is right.
struct Reader {
    file: BufReader<File>,
}

impl Reader {
    fn open(path: &Path) -> std::io::Result<Self> {
        verify(path)?;
        let mut file = BufReader::new(File::open(path)?);
        file.read_exact(&mut [0; MAGIC.len()])?;
        Ok(Reader { file })
    }

    fn message(&mut self) -> std::io::Result<Vec<u8>> {
        let mut length = [0; 8];
        self.file.read_exact(&mut length)?;
        let mut bytes = vec![0; u64::from_le_bytes(length) as usize];
        self.file.read_exact(&mut bytes)?;
        Ok(bytes)
    }
}

/// Whether a file begins as it must, and its checksum is right.
fn verify(path: &Path) -> std::io::Result<()> {
    let damaged = |what| Error::new(ErrorKind::InvalidData, what);
    let file = File::open(path)?;
    let length = file.metadata()?.len();
    let mut file = BufReader::new(file);
    let mut magic = [0; MAGIC.len()];
    let sum_at =
        length.checked_sub(4).filter(|&at| at >= magic.len() as u64).ok_or_else(|| damaged("it is cut off"))?;
    file.read_exact(&mut magic)?;
    if magic != *MAGIC {
        return Err(damaged("it is no checkpoint, or one of another version of jamhpc"));
    }
    let mut sum = Hasher::new();
    sum.update(&magic);
    let mut rest = sum_at - magic.len() as u64;
    let mut buffer = vec![0; 1 << 16];
    while rest > 0 {
        let part = buffer.len().min(rest as usize);
        file.read_exact(&mut buffer[..part])?;
        sum.update(&buffer[..part]);
        rest -= part as u64;
    }
    let mut stored = [0; 4];
    file.read_exact(&mut stored)?;
    if stored == sum.finalize().to_le_bytes() { Ok(()) } else { Err(damaged("it is damaged (its checksum is wrong)")) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Frac;

    fn records() -> Vec<Record<'static>> {
        let mut particles = Particles::empty(&Bodies::Polygons { first: vec![0] });
        particles.push(7, 1.5, &[[1, -2], [3, 4], [i64::MIN, i64::MAX]].map(Frac::from_bits));
        particles.push(3, 0.5, &[[5, 6], [7, 8], [9, 10], [11, 12]].map(Frac::from_bits));
        particles.carried = vec![(0..7).map(|k| [0.1 * k as f64, -1.0 / 3.0]).collect(); 2];
        let state = Record { note: "{\"δ\":1}".to_owned(), particles: Some(Cow::Owned(particles)) };
        vec![state, Record { note: "two".to_owned(), particles: None }]
    }

    fn read(path: &Path) -> Result<Vec<Record<'static>>, String> {
        read_records(&Comm::alone(), path, &Bodies::Polygons { first: vec![0] }).map_err(|e| e.to_string())
    }

    #[test]
    fn records_are_read_back_to_the_bit() {
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("a.records");
        write_records(&Comm::alone(), &path, &records(), None).unwrap();
        let [state, note] = &read(&path).unwrap()[..] else { panic!() };
        let (there, here) = (state.particles.as_ref().unwrap(), &records()[0]);
        let here_particles = here.particles.as_ref().unwrap();
        assert_eq!((&state.note, &note.note[..], note.particles.is_none()), (&here.note, "two", true));
        assert_eq!(
            (&there.id, &there.size, &there.bodies),
            (&here_particles.id, &here_particles.size, &here_particles.bodies)
        );
        assert_eq!((&there.position, &there.carried), (&here_particles.position, &here_particles.carried));
    }

    #[test]
    fn the_one_before_is_kept() {
        let home = tempfile::tempdir().unwrap();
        let (path, previous) = (home.path().join("a.records"), home.path().join("b.records"));
        for n in 1..=2 {
            write_records(&Comm::alone(), &path, &records()[..n], Some(&previous)).unwrap();
        }
        assert_eq!((read(&path).unwrap().len(), read(&previous).unwrap().len()), (2, 1));
        assert_eq!(fs::read_dir(home.path()).unwrap().count(), 2, "no traces");
    }

    #[test]
    fn any_damage_is_found() {
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("a.records");
        assert!(read(&path).unwrap_err().contains("check the path"));
        write_records(&Comm::alone(), &path, &records(), None).unwrap();
        let whole = fs::read(&path).unwrap();
        for k in 0..whole.len() {
            let mut bytes = whole.clone();
            bytes[k] ^= 1 << (k % 8);
            fs::write(&path, &bytes).unwrap();
            assert!(read(&path).unwrap_err().contains("a.records"), "byte {k}");
            fs::write(&path, &whole[..k]).unwrap();
            assert!(read(&path).unwrap_err().contains("a.records"), "cut at byte {k}");
        }
    }
}
