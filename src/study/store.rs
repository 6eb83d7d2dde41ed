//! The folder of a study: records of finished packings, gathered into one results file.
//!
//! A packing that is finished is a small file of its own in `members/`, written whole. At the end, and whenever the
//! study is taken up again, they are gathered into `study.h5` and removed. Whatever moment the study is killed at, every
//! finished packing is in one of the two. Of one that takes long, `checkpoints/` holds what has been done.
//!
//! ```text
//! /         attributes: study (TOML), version
//! /groups   ensemble, n_particles, scene (TOML): what packings of a group have in common
//! /members  group, seed, failure (empty if none), onset_density, unjammed_density, onset_pressure, onset_steps (NaN if
//!           there is no onset), first_sample, n_samples
//! /samples  every number of every sample by name; NaN where a packing does not have it
//! ```

use super::plan::{Member, Plan, scene_text};
use super::record::Record;
use crate::failure::Failure;
use crate::output::folder::{explain, is_part, write_whole};
use crate::output::tables::{Column, Table, read_tables, write_tables};
use crate::run::checkpoint;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Name of the results file in the folder of a study.
pub const RESULTS: &str = "study.h5";
const MEMBERS: &str = "members";
const PICTURES: &str = "pictures";
const CHECKPOINTS: &str = "checkpoints";
const ONSET: [&str; 4] = ["onset_density", "unjammed_density", "onset_pressure", "onset_steps"];

/// Records of a study, those of its plan in the order of the plan.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Store {
    pub records: Vec<Record>,
}

fn member_file(folder: &Path, id: &str) -> PathBuf {
    folder.join(MEMBERS).join(format!("{id}.json"))
}

/// The folder of what has been done for a packing that is not finished.
pub fn checkpoint_folder(folder: &Path, id: &str) -> PathBuf {
    folder.join(CHECKPOINTS).join(id)
}

/// Removes all checkpoints but those of these packings. For one rank.
pub fn keep_checkpoints(folder: &Path, ids: &BTreeSet<String>) {
    let all = folder.join(CHECKPOINTS);
    for entry in std::fs::read_dir(&all).into_iter().flatten().flatten() {
        if !ids.contains(&*entry.file_name().to_string_lossy()) {
            checkpoint::remove(&entry.path());
        }
    }
    // only if it is empty
    let _ = std::fs::remove_dir(all);
}

/// Where the picture of a packing at a density is.
pub fn picture_file(folder: &Path, group: &str, density: f64) -> PathBuf {
    folder.join(PICTURES).join(format!("{group}-{density}.svg"))
}

/// Writes pictures of a packing, before its record. For one rank.
pub fn keep_pictures(folder: &Path, group: &str, pictures: &[(f64, String)]) -> Result<(), Failure> {
    for (density, picture) in pictures {
        write_whole(&picture_file(folder, group, *density), picture.as_bytes())?;
    }
    Ok(())
}

/// Writes the record of a finished packing. For one rank.
pub fn keep(folder: &Path, record: &Record) -> Result<(), Failure> {
    let text = serde_json::to_vec(record).map_err(|e| Failure::Other(e.to_string()))?;
    Ok(write_whole(&member_file(folder, &record.id()), &text)?)
}

/// How many finished packings have not been gathered yet.
pub fn n_kept(folder: &Path) -> usize {
    std::fs::read_dir(folder.join(MEMBERS)).map_or(0, |entries| entries.flatten().filter(is_record).count())
}

fn is_record(entry: &std::fs::DirEntry) -> bool {
    entry.file_name().to_string_lossy().ends_with(".json")
}

/// Gathers all finished packings into the results file; those that failed are left out if they are to be tried again.
/// Refuses to lose or to mix in packings that the plan does not ask for. For one rank.
pub fn gather(folder: &Path, plan: &Plan, retry: bool) -> Result<Store, Failure> {
    let members = folder.join(MEMBERS);
    let fail = |e: std::io::Error| Failure::Other(format!("cannot use {}: {}", members.display(), explain(&e)));
    std::fs::create_dir_all(&members).and_then(|()| std::fs::create_dir_all(folder.join(PICTURES))).map_err(fail)?;
    let results = folder.join(RESULTS);
    let mut found: BTreeMap<String, Record> = BTreeMap::new();
    if results.exists() {
        found.extend(read(&results)?.records.into_iter().map(|record| (record.id(), record)));
    }
    let before = found.len();
    let mut files = Vec::new();
    for entry in std::fs::read_dir(&members).map_err(fail)? {
        let entry = entry.map_err(fail)?;
        if is_part(&entry.file_name().to_string_lossy()) {
            files.push(entry.path()); // what a killed process was writing
        } else if is_record(&entry) {
            files.push(entry.path());
            let bytes = std::fs::read(entry.path()).map_err(fail)?;
            // a file that a failing disk has damaged is a packing to be made again
            if let Ok(record) = serde_json::from_slice::<Record>(&bytes) {
                found.insert(record.id(), record);
            }
        }
    }
    if retry {
        found.retain(|_, record| record.failure.is_none());
    }
    let mut store = Store::default();
    for member in plan.members() {
        let Some(record) = found.remove(&member.id()) else { continue };
        check(&record, &member, folder)?;
        store.records.push(record);
    }
    if let Some(id) = found.keys().next() {
        return Err(Failure::Input(format!(
            "{} holds {} packings that the study does not ask for, such as {id}: ask for them, or choose another folder \
             with -o",
            folder.display(),
            found.len()
        )));
    }
    if !files.is_empty() || store.records.len() != before || !results.exists() {
        write(&results, plan, &store)?;
        for file in files {
            std::fs::remove_file(file).map_err(fail)?;
        }
    }
    Ok(store)
}

/// A record must come from the very plan that it now serves.
fn check(record: &Record, member: &Member, folder: &Path) -> Result<(), Failure> {
    let wanted = scene_text(&member.group.scene);
    if record.scene == wanted {
        return Ok(());
    }
    let differs = record.scene.lines().zip(wanted.lines()).find(|(old, new)| old != new);
    let (old, new) = differs.unwrap_or(("a shorter scene", "a longer one"));
    Err(Failure::Input(format!(
        "{}: {} was made with `{old}`, and the study now says `{new}`: choose another folder with -o",
        folder.display(),
        member.id()
    )))
}

fn write(path: &Path, plan: &Plan, store: &Store) -> Result<(), Failure> {
    let records = &store.records;
    let mut groups: Vec<(&str, u64, &str)> = Vec::new();
    let mut group_of = Vec::new();
    for r in records {
        let group = (r.ensemble.as_str(), r.n_particles, r.scene.as_str());
        // members of a group stand together
        if groups.last() != Some(&group) {
            groups.push(group);
        }
        group_of.push(groups.len() as u64 - 1);
    }
    let n_samples = |r: &Record| r.samples.first().map_or(0, |(_, values)| values.len());
    let first_sample = records.iter().scan(0u64, |next, r| {
        let first = *next;
        *next += n_samples(r) as u64;
        Some(first)
    });
    let texts = |of: &dyn Fn(&(&str, u64, &str)) -> String| Column::Texts(groups.iter().map(of).collect());
    let group_table = Table::new(
        "groups",
        vec![
            ("ensemble", texts(&|g| g.0.to_owned())),
            ("n_particles", Column::Counts(groups.iter().map(|g| g.1).collect())),
            ("scene", texts(&|g| g.2.to_owned())),
        ],
    );
    let mut members = vec![
        ("group", Column::Counts(group_of)),
        ("seed", Column::Counts(records.iter().map(|r| r.seed).collect())),
        ("failure", Column::Texts(records.iter().map(|r| r.failure.clone().unwrap_or_default()).collect())),
        ("first_sample", Column::Counts(first_sample.collect())),
        ("n_samples", Column::Counts(records.iter().map(|r| n_samples(r) as u64).collect())),
    ];
    for (k, name) in ONSET.iter().enumerate() {
        members.push((name, Column::Numbers(records.iter().map(|r| r.onset.map_or(f64::NAN, |o| o[k])).collect())));
    }
    let names: BTreeSet<&str> = records.iter().flat_map(|r| r.samples.iter().map(|(name, _)| name.as_str())).collect();
    let sample_column = |name: &str| {
        let of = |r: &Record| {
            let values = r.samples.iter().find(|(n, _)| n == name).map(|(_, values)| values.clone());
            values.unwrap_or_else(|| vec![f64::NAN; n_samples(r)])
        };
        Column::Numbers(records.iter().flat_map(of).collect())
    };
    let samples = names.into_iter().map(|name| (name, sample_column(name))).collect();
    let tables = [group_table, Table::new("members", members), Table::new("samples", samples)];
    let texts = [("study", plan.text.as_str()), ("version", env!("CARGO_PKG_VERSION"))];
    Ok(write_tables(path, &texts, &tables)?)
}

/// All records of a results file. For one rank.
pub fn read(path: &Path) -> Result<Store, Failure> {
    let (_, tables) = read_tables(path)?;
    records(&tables)
        .map(|records| Store { records })
        .ok_or_else(|| Failure::Input(format!("{} is no results file of a study, or a damaged one", path.display())))
}

fn records(tables: &[Table]) -> Option<Vec<Record>> {
    let table = |name: &str| tables.iter().find(|t| t.name == name);
    let (groups, members, samples) = (table("groups")?, table("members")?, table("samples")?);
    let (ensembles, sizes) = (groups.texts("ensemble")?, groups.counts("n_particles")?);
    let scenes = groups.texts("scene")?;
    let (group, seed, failure) = (members.counts("group")?, members.counts("seed")?, members.texts("failure")?);
    let (first, count) = (members.counts("first_sample")?, members.counts("n_samples")?);
    let onset: Option<Vec<&[f64]>> = ONSET.iter().map(|name| members.numbers(name)).collect();
    let onset = onset?;
    let mut records = Vec::new();
    for (k, &seed) in seed.iter().enumerate() {
        let g = *group.get(k)? as usize;
        let rows = *first.get(k)? as usize..(*first.get(k)? + *count.get(k)?) as usize;
        let mut own = Vec::new();
        for (name, _) in samples.columns.iter().filter(|_| !rows.is_empty()) {
            let values = samples.numbers(name)?.get(rows.clone())?.to_vec();
            // a packing without this number has none of it at all
            if !values.iter().all(|v| v.is_nan()) {
                own.push((name.clone(), values));
            }
        }
        let found = [onset[0].get(k)?, onset[1].get(k)?, onset[2].get(k)?, onset[3].get(k)?].map(|x| *x);
        records.push(Record {
            ensemble: ensembles.get(g)?.clone(),
            n_particles: *sizes.get(g)?,
            seed,
            scene: scenes.get(g)?.clone(),
            onset: (!found[0].is_nan()).then_some(found),
            samples: own,
            failure: Some(failure.get(k)?.clone()).filter(|reason| !reason.is_empty()),
        });
    }
    Some(records)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan() -> Plan {
        let text = "[[ensemble]]\nn_particles = [8, 16]\nseeds = 2\nscene.model = 'sp'\n\
            scene.compression.increments = [1e-3]";
        Plan::parse(text, "test").unwrap()
    }

    fn record(member: &Member, failure: Option<&str>) -> Record {
        Record {
            ensemble: member.group.ensemble.clone(),
            n_particles: member.group.scene.n_particles as u64,
            seed: member.seed,
            scene: scene_text(&member.group.scene),
            onset: failure.is_none().then_some([0.84, 0.8399999, 1e-8, 200.0]),
            samples: match failure {
                None => vec![("density".into(), vec![0.84, 0.841]), ("pressure".into(), vec![0.1, 1.0 / 3.0])],
                Some(_) => Vec::new(),
            },
            failure: failure.map(str::to_owned),
        }
    }

    #[test]
    fn gathered_at_any_moment_it_is_the_same_file() {
        let plan = plan();
        let all: Vec<Record> =
            plan.members().zip([None, Some("no onset"), None, None]).map(|(m, failure)| record(&m, failure)).collect();
        let write_in = |order: &[usize], pauses: bool| {
            let home = tempfile::tempdir().unwrap();
            let folder = home.path();
            gather(folder, &plan, false).unwrap();
            for &k in order {
                keep(folder, &all[k]).unwrap();
                // what a killed process was writing
                std::fs::write(folder.join(MEMBERS).join(".sp-N8-seed1.json.part"), "{").unwrap();
                if pauses {
                    gather(folder, &plan, false).unwrap();
                }
            }
            assert_eq!(gather(folder, &plan, false).unwrap().records, all);
            assert_eq!(n_kept(folder), 0);
            std::fs::read(folder.join(RESULTS)).unwrap()
        };
        let bytes = write_in(&[0, 1, 2, 3], false);
        assert!(bytes == write_in(&[3, 0, 2, 1], true));
    }

    #[test]
    fn failures_may_be_tried_again() {
        let plan = plan();
        let home = tempfile::tempdir().unwrap();
        let first = plan.members().next().unwrap();
        gather(home.path(), &plan, false).unwrap();
        keep(home.path(), &record(&first, Some("no onset"))).unwrap();
        assert_eq!(gather(home.path(), &plan, false).unwrap().records.len(), 1);
        assert_eq!(gather(home.path(), &plan, true).unwrap().records.len(), 0);
    }

    #[test]
    fn other_plans_are_refused_and_nothing_is_lost() {
        let plan = plan();
        let home = tempfile::tempdir().unwrap();
        gather(home.path(), &plan, false).unwrap();
        plan.members().for_each(|m| keep(home.path(), &record(&m, None)).unwrap());
        gather(home.path(), &plan, false).unwrap();
        let other = |from: &str, to: &str| {
            let other = Plan::parse(&plan.text.replace(from, to), "test").unwrap();
            gather(home.path(), &other, false).unwrap_err().to_string()
        };
        let fewer = other("seeds = 2", "seeds = 1");
        assert!(fewer.contains("2 packings") && fewer.contains("sp-N16-seed2"), "{fewer}");
        let changed = other("[1e-3]", "[2e-3]");
        assert!(changed.contains("0.001") && changed.contains("0.002"), "{changed}");
        assert_eq!(gather(home.path(), &plan, false).unwrap().records.len(), 4);
    }

    #[test]
    fn a_damaged_record_is_made_again() {
        let plan = plan();
        let home = tempfile::tempdir().unwrap();
        gather(home.path(), &plan, false).unwrap();
        let first = plan.members().next().unwrap();
        std::fs::write(member_file(home.path(), &first.id()), "{\"ensemble\":").unwrap();
        assert!(gather(home.path(), &plan, false).unwrap().records.is_empty());
    }
}
