//! Studies: packings of many sizes and seeds, made by groups of ranks, then averaged, fitted and drawn.
//!
//! `plan` says which packings there are, `schedule` who makes them, `record` what is kept of each and `store` where;
//! `data` averages, `findings` fits, `densities` compares the models, `figures` and `report` show, and `paper` is what it is
//! compared with.

pub mod data;
pub mod densities;
pub mod figures;
pub mod findings;
pub mod paper;
pub mod plan;
mod progress;
pub mod record;
pub mod report;
pub mod schedule;
pub mod store;

use crate::comm::Comm;
use crate::failure::Failure;
use crate::output::Folder;
use crate::output::folder::write_whole;
use crate::output::plot::panels;
use crate::output::render::{write_panels, write_row};
use crate::run::checkpoint::{self, Signals};
use figures::{NUMBERS, PACKINGS};
use plan::{Member, Plan};
use progress::Progress;
use record::Record;
use schedule::{Claims, Job};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use store::Store;

/// Makes the packings that are missing in the folder of a study, gathers all of them and answers a summary of what
/// there is. A signal that asks for the end leaves checkpoints of those that are being made. Collective.
pub fn run(comm: &Comm, plan: &Plan, directory: &Path, retry: bool, speaks: bool) -> Result<String, Failure> {
    // by ranks too that have no packing to make
    let signals = Signals::listen()?;
    // held until the end
    let folder = Folder::prepare(comm, directory).map_err(|e| Failure::Input(e.to_string()))?;
    let claims = folder.file("claims");
    let members: Vec<Member> = plan.members().collect();
    let missing = comm.from_root(|| {
        Claims::reset(&claims)?;
        let done: BTreeSet<String> = store::gather(directory, plan, retry)?.records.iter().map(Record::id).collect();
        // others are left by another plan, or by a kill just when a packing was done
        let wanted = members.iter().map(Member::id).filter(|id| !done.contains(id)).collect();
        store::keep_checkpoints(directory, &wanted);
        Ok::<_, Failure>(members.iter().map(|m| !done.contains(&m.id()) as u8).collect())
    })?;
    let job = |k: usize| Job { member: k, ranks: members[k].group.ranks, cost: members[k].group.cost() };
    let mut jobs: Vec<Job> = (0..members.len()).filter(|&k| missing[k] == 1).map(job).collect();
    schedule::sort(&mut jobs);

    let mut progress = Progress::new(speaks && comm.is_root(), directory, &members, &jobs);
    let worked = schedule::work(comm, &jobs, &Claims::in_folder(&claims), &mut |group, job| {
        if group.any(signals.asks_for_end()) {
            return Err(Failure::Interrupted("between two packings".into()));
        }
        let member = &members[job.member];
        let started = std::time::Instant::now();
        let under_way = store::checkpoint_folder(directory, &member.id());
        let made = Record::make(group.duplicate(), member, under_way.clone())?;
        if let Some(reason) = &made.record.failure {
            tracing::warn!(member = member.id(), reason, "failed");
        }
        group.from_root(|| {
            store::keep_pictures(directory, &member.group.id(), &made.pictures)?;
            store::keep(directory, &made.record)?;
            checkpoint::remove(&under_way);
            progress::note(directory, member, group.size(), started.elapsed())?;
            Ok::<_, Failure>(Vec::new())
        })?;
        progress.show();
        Ok(())
    });
    progress.finish();
    // a group that has met an error is waited for by the others, and what all of them made is kept
    let is_ended = comm.any(matches!(worked, Err(Failure::Interrupted(_))));
    let error = worked.err().filter(|error| !matches!(error, Failure::Interrupted(_)));
    let error = comm.agree(error.map_or(Ok(()), Err)).err();
    let text = comm.from_root(|| {
        let store = match (store::gather(directory, plan, false), &error) {
            (Err(_), Some(first)) => return Err(first.clone()),
            (gathered, _) => gathered?,
        };
        // claims of finished work say nothing
        let _ = Claims::remove(&claims);
        let of_all = format!("{} of {} packings", store.records.len(), members.len());
        if let Some(error) = error {
            return Err(error.and(&format!("{of_all} are kept")));
        }
        if is_ended {
            let place = directory.display();
            return Err(Failure::Interrupted(format!(
                "ended by a signal; {of_all} and all work on others are kept in {place}: the same command goes on"
            )));
        }
        if store.records.len() < members.len() {
            let place = directory.display();
            return Err(Failure::Other(format!(
                "only {of_all} can be read in {place}: the same command makes the others"
            )));
        }
        store::keep_checkpoints(directory, &BTreeSet::new());
        let mut summary = summary(plan, &store, directory);
        if store.records.iter().all(|record| record.samples.is_empty()) {
            return Err(Failure::NotConverged(format!(
                "none of {} packings has come to a sample, so that there is nothing to draw:\n{summary}",
                members.len()
            )));
        }
        for path in draw(directory, &NUMBERS, true)? {
            summary += &format!("{}\n", path.display());
        }
        Ok(summary.into_bytes())
    })?;
    Ok(String::from_utf8_lossy(&text).into_owned())
}

/// Draws figures of the study in a folder, by their numbers in the paper, as SVG and PNG; with the report and the table of
/// all fits if they are wanted too. Answers what was written. For one rank.
pub fn draw(directory: &Path, numbers: &[u8], report: bool) -> Result<Vec<PathBuf>, Failure> {
    let results = directory.join(store::RESULTS);
    let ensembles = data::ensembles(&store::read(&results)?)?;
    let mut written = vec![results];
    let pictures = pictures(directory, &ensembles);
    if report {
        let all = report::findings(&ensembles);
        let canonical = directory.canonicalize().unwrap_or_else(|_| directory.to_owned());
        let name = canonical.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let html = report::html(&name, env!("CARGO_PKG_VERSION"), &ensembles, &all, &pictures);
        for (file, text) in [("report.html", html), ("findings.csv", report::csv(&all))] {
            let path = directory.join(file);
            write_whole(&path, text.as_bytes())?;
            written.push(path);
        }
    }
    for &number in numbers {
        if number == PACKINGS && !pictures.is_empty() {
            let all: Vec<&str> = pictures.iter().map(|(_, svg)| svg.as_str()).collect();
            for ending in ["svg", "png"] {
                let path = directory.join(format!("figure-{number}.{ending}"));
                write_row(&path, &all)?;
                written.push(path);
            }
        }
        let Some(figure) = figures::figure(number, &ensembles).filter(|figure| !figure.panels.is_empty()) else {
            continue;
        };
        for ending in ["svg", "png"] {
            let path = directory.join(format!("figure-{number}.{ending}"));
            write_panels(&path, &panels(&figure.panels, figure.columns))?;
            written.push(path);
        }
    }
    Ok(written)
}

/// Pictures with captions: of each ensemble one size, 64 if it is there, at the densities of figures 2 and 7.
fn pictures(directory: &Path, ensembles: &[data::Ensemble]) -> Vec<(String, String)> {
    let mut found = Vec::new();
    for density in record::DRAWN {
        for ensemble in ensembles {
            let of = |s: &data::Packings| {
                let path = store::picture_file(directory, &format!("{}-N{}", s.ensemble, s.n_particles), density);
                Some((s.n_particles, std::fs::read_to_string(path).ok()?))
            };
            let drawn: Vec<(usize, String)> = ensemble.sizes.iter().filter_map(of).collect();
            let wanted = drawn.iter().find(|(n, _)| *n == 64).or(drawn.last());
            if let Some((n, svg)) = wanted {
                let caption =
                    format!("{}, N = {n}: the first sample above ρ = {density}", ensemble.name.to_uppercase());
                found.push((caption, svg.clone()));
            }
        }
    }
    found
}

/// What there is of each group, and why packings failed.
fn summary(plan: &Plan, store: &Store, directory: &Path) -> String {
    let mut out = format!("{:<24} {:>8} {:>8} {:>14}\n", "group", "packings", "failed", "rank-seconds");
    let seconds = progress::times(directory);
    for group in &plan.groups {
        let own = |r: &&Record| r.ensemble == group.ensemble && r.n_particles == group.scene.n_particles as u64;
        let records: Vec<&Record> = store.records.iter().filter(own).collect();
        let failed: Vec<&str> = records.iter().filter_map(|r| r.failure.as_deref()).collect();
        let id = group.id();
        let mean = seconds.get(&id).map_or("-".to_owned(), |[sum, n]| format!("{:.2}", sum / n));
        out += &format!("{id:<24} {:>8} {:>8} {mean:>14}\n", records.len(), failed.len());
        if let Some(reason) = failed.first() {
            out += &format!("  such as: {reason}\n");
        }
    }
    out
}
