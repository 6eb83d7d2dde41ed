//! Who makes which packing: groups of ranks that take the longest one left, until none is.
//!
//! Large packings come first, on many ranks; a group that finds none left of its kind falls apart into smaller ones.
//! Groups agree by files, because a rank that computes alone answers no messages: whoever creates a packing's claim
//! makes it.

use crate::comm::Comm;
use crate::failure::Failure;
use crate::output::folder::{explain, remove_own};
use std::fs::File;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// A packing to be made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Job {
    /// Which one.
    pub member: usize,
    /// Most ranks that share it.
    pub ranks: usize,
    /// How long it takes, in any units.
    pub cost: f64,
}

/// Puts jobs in the order in which they are taken: many ranks first, then long ones.
pub fn sort(jobs: &mut [Job]) {
    jobs.sort_by(|a, b| b.ranks.cmp(&a.ranks).then(b.cost.total_cmp(&a.cost)).then(a.member.cmp(&b.member)));
}

/// Does all jobs, sorted, each by one group of ranks. An error ends the group that it befalls; the others go on. To be
/// called by all ranks.
pub fn work(
    comm: &Comm,
    jobs: &[Job],
    claims: &Claims,
    act: &mut impl FnMut(&Comm, &Job) -> Result<(), Failure>,
) -> Result<(), Failure> {
    let Some(first) = jobs.first() else { return Ok(()) };
    let end = jobs.partition_point(|job| job.ranks == first.ranks);
    let n_groups = comm.size().div_ceil(first.ranks);
    let group = comm.split((comm.rank() * n_groups / comm.size()) as u32);
    let mut from = 0;
    while let Some(k) = claims.next(&group, &jobs[from..end])? {
        from += k + 1;
        act(&group, &jobs[from - 1])?;
    }
    work(&group, &jobs[end..], claims, act)
}

/// Claims to packings, as empty files in a folder.
pub struct Claims {
    folder: PathBuf,
}

impl Claims {
    /// A folder without claims; those of a killed study are removed. For one rank.
    pub fn reset(folder: &Path) -> Result<(), Failure> {
        let fail = |e: std::io::Error| Failure::Other(format!("cannot write {}: {}", folder.display(), explain(&e)));
        Claims::remove(folder).and_then(|()| std::fs::create_dir_all(folder)).map_err(fail)
    }

    /// For one rank, when all work is done.
    pub fn remove(folder: &Path) -> std::io::Result<()> {
        remove_own(folder, |name| name.bytes().all(|digit| digit.is_ascii_digit()))
    }

    pub fn in_folder(folder: &Path) -> Claims {
        Claims { folder: folder.to_owned() }
    }

    /// Claims the first job that nobody has taken, for all ranks of the group. Collective.
    fn next(&self, group: &Comm, jobs: &[Job]) -> Result<Option<usize>, Failure> {
        let taken = group.from_root(|| {
            let claimed =
                self.claim(jobs).map_err(|e| Failure::Other(format!("cannot claim work: {}", explain(&e))))?;
            Ok::<_, Failure>(claimed.map_or(Vec::new(), |k| (k as u64).to_le_bytes().to_vec()))
        })?;
        Ok(<[u8; 8]>::try_from(&taken[..]).ok().map(|bytes| u64::from_le_bytes(bytes) as usize))
    }

    fn claim(&self, jobs: &[Job]) -> std::io::Result<Option<usize>> {
        // jobs are taken in order, so that those taken are the first ones: few files need to be looked at
        let mut k = jobs.partition_point(|job| self.path(job).exists());
        while k < jobs.len() {
            match File::create_new(self.path(&jobs[k])) {
                Ok(_) => return Ok(Some(k)),
                Err(e) if e.kind() == ErrorKind::AlreadyExists => k += 1,
                Err(e) => return Err(e),
            }
        }
        Ok(None)
    }

    fn path(&self, job: &Job) -> PathBuf {
        self.folder.join(job.member.to_string())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_jobs_come_first_and_each_is_done_once() {
        let home = tempfile::tempdir().unwrap();
        let folder = home.path().join("claims");
        Claims::reset(&folder).unwrap();
        let mut jobs: Vec<Job> = [(1, 5.0), (4, 1.0), (1, 9.0), (4, 2.0)]
            .iter()
            .enumerate()
            .map(|(member, &(ranks, cost))| Job { member, ranks, cost })
            .collect();
        sort(&mut jobs);
        std::fs::write(folder.join("2"), "").unwrap(); // somebody else has it
        let mut done = Vec::new();
        let mut act = |_: &Comm, job: &Job| {
            done.push(job.member);
            Ok(())
        };
        let claims = Claims::in_folder(&folder);
        work(&Comm::alone(), &jobs, &claims, &mut act).unwrap();
        work(&Comm::alone(), &jobs, &claims, &mut act).unwrap();
        assert_eq!(done, [3, 1, 0]);
        Claims::reset(&folder).unwrap();
        assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 0);
    }

    #[test]
    fn an_error_ends_the_group() {
        let home = tempfile::tempdir().unwrap();
        let claims = Claims::in_folder(home.path());
        let jobs = [0, 1].map(|member| Job { member, ranks: 1, cost: 1.0 });
        let mut calls = 0;
        let outcome = work(&Comm::alone(), &jobs, &claims, &mut |_, _| {
            calls += 1;
            Err(Failure::Other("disk".into()))
        });
        assert_eq!((outcome, calls), (Err(Failure::Other("disk".into())), 1));
    }
}
