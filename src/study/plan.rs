//! The study: a TOML text of ensembles becomes the list of packings to make. Nothing is read or written here.

use crate::scene::{Compression, Model, Scene};
use serde::Deserialize;
use std::collections::BTreeMap;

/// Commented study with every key, for `jamhpc init study`.
pub const STARTER: &str = include_str!("starter.toml");

/// A validated study.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// The text that it was made from.
    pub text: String,
    /// All packings with the same ensemble and number of particles, in the order of the text.
    pub groups: Vec<Group>,
}

/// Packings that differ by their seeds only: what averages are taken over.
#[derive(Clone, Debug, PartialEq)]
pub struct Group {
    /// Name of the ensemble, in files and legends.
    pub ensemble: String,
    /// Plan of each packing, but for its seed.
    pub scene: Scene,
    pub seeds: std::ops::Range<u64>,
    /// Ranks that share a packing.
    pub ranks: usize,
}

/// One packing of a study.
#[derive(Clone, Debug, PartialEq)]
pub struct Member<'a> {
    pub group: &'a Group,
    pub seed: u64,
}

/// Why a study was refused, and where.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{0}")]
pub struct PlanError(String);

/// Points (disks, or vertices of polygons) that keep a rank busy.
const POINTS_PER_RANK: usize = 2500;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Text {
    ensemble: Vec<Ensemble>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Ensemble {
    name: Option<String>,
    n_particles: Vec<u64>,
    seeds: u64,
    #[serde(default = "one")]
    first_seed: u64,
    ranks: Option<usize>,
    scene: toml::Table,
}

fn one() -> u64 {
    1
}

impl Plan {
    /// Reads and checks a study. `origin` is the file's name in messages.
    pub fn parse(text: &str, origin: &str) -> Result<Plan, PlanError> {
        let parsed: Text = toml::from_str(text).map_err(|e| PlanError(misread(&e, text, origin)))?;
        let mut groups: Vec<Group> = Vec::new();
        for (k, ensemble) in parsed.ensemble.iter().enumerate() {
            let refuse = |problem: String| PlanError(format!("{origin}: ensemble {}: {problem}", k + 1));
            for group in ensemble.groups().map_err(refuse)? {
                if groups.iter().any(|g| g.id() == group.id()) {
                    let id = group.id();
                    return Err(refuse(format!(
                        "{id} is there already: give one of them another `name`, or merge them"
                    )));
                }
                groups.push(group);
            }
        }
        if groups.is_empty() {
            return Err(PlanError(format!("{origin}: no packings are asked for: add an [[ensemble]]")));
        }
        Ok(Plan { text: text.to_owned(), groups })
    }

    /// Which packings there are, one line a group.
    pub fn summary(&self) -> String {
        let mut out = format!("{:<24} {:>8} {:>8} {:>8}\n", "group", "packings", "samples", "ranks");
        for group in &self.groups {
            let samples = 1 + group.scene.compression.samples(0.5).len();
            let (id, n) = (group.id(), group.seeds.end - group.seeds.start);
            out += &format!("{id:<24} {n:>8} {samples:>8} {:>8}\n", group.ranks);
        }
        out
    }

    /// Every packing, in the order of the text.
    pub fn members(&self) -> impl Iterator<Item = Member<'_>> {
        self.groups.iter().flat_map(|group| group.seeds.clone().map(move |seed| Member { group, seed }))
    }
}

/// What is wrong with a text that is no study, and in which of its lines.
fn misread(error: &toml::de::Error, text: &str, origin: &str) -> String {
    let place = error.span().map_or(String::new(), |span| {
        let number = text.bytes().take(span.start).filter(|&byte| byte == b'\n').count();
        let line: String = text.lines().nth(number).unwrap_or_default().trim().chars().take(60).collect();
        format!(":{}: `{line}`", number + 1)
    });
    // what serde calls the kinds of values
    let kinds =
        [("u64", "an integer from 0"), ("usize", "an integer from 0"), ("a sequence", "a list"), ("a map", "a table")];
    let problem = error.message().trim().replace('\n', ", ");
    let problem = kinds.iter().fold(problem, |problem, (kind, name)| problem.replace(kind, name));
    format!("{origin}{place}: {problem}; `jamhpc init study` prints a commented study")
}

impl Ensemble {
    fn groups(&self) -> Result<Vec<Group>, String> {
        if let Some(key) = ["n_particles", "seed"].iter().find(|key| self.scene.contains_key(**key)) {
            return Err(format!("`scene.{key}` belongs to the ensemble: use `n_particles`, `seeds` and `first_seed`"));
        }
        if self.n_particles.is_empty() {
            return Err("`n_particles` is empty: list the system sizes, such as [32, 64]".into());
        }
        if self.seeds == 0 || self.first_seed.checked_add(self.seeds).is_none_or(|end| end > i64::MAX as u64) {
            return Err("`seeds` is how many packings there are of each size: an integer from 1".into());
        }
        if self.ranks == Some(0) {
            return Err("`ranks` is how many ranks share a packing at most: an integer from 1".into());
        }
        self.n_particles.iter().map(|&n| self.group(n)).collect()
    }

    fn group(&self, n_particles: u64) -> Result<Group, String> {
        let text = toml::to_string(&self.scene).map_err(|e| e.to_string())?;
        let sizes = [format!("n_particles={n_particles}"), "seed=0".into()];
        let mut scene = Scene::parse(&text, "scene", &sizes).map_err(|e| e.problem.to_string())?;
        if let Compression::Until { .. } | Compression::Densities { .. } = scene.compression {
            return Err("packings are compared at one distance above their own onsets: give `scene.compression` the \
                        form `increments` or `log`"
                .into());
        }
        if scene.shear.until != 0.0 {
            return Err("studies do not shear: remove `scene.shear`".into());
        }
        // where and what a single run would write is no part of a study
        scene.output = scene.of_results().output;
        let name = self.name.clone().unwrap_or_else(|| scene.model().name().to_owned());
        let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '_';
        if name.is_empty() || name.len() > 40 || !name.chars().all(is_plain) {
            return Err(format!("`name` = {name:?} is part of file names: letters, digits and _, at most 40"));
        }
        let ranks = self.ranks.unwrap_or_else(|| (n_points(&scene) / POINTS_PER_RANK).max(1));
        Ok(Group { ensemble: name, scene, seeds: self.first_seed..self.first_seed + self.seeds, ranks })
    }
}

impl Group {
    /// Names the group in files.
    pub fn id(&self) -> String {
        format!("{}-N{}", self.ensemble, self.scene.n_particles)
    }

    /// How long a packing takes, in units that are the same for all groups: near onset, iterations grow with the size
    /// of the box, and polygons take many more of them.
    pub fn cost(&self) -> f64 {
        let points = n_points(&self.scene) as f64;
        let stiff = if self.scene.model() == Model::Dp { 30.0 } else { 1.0 };
        points.powf(1.5) * stiff * self.scene.compression.samples(0.5).len() as f64
    }
}

impl Member<'_> {
    /// Names the packing in files.
    pub fn id(&self) -> String {
        format!("{}-seed{}", self.group.id(), self.seed)
    }

    /// The plan of this packing.
    pub fn scene(&self) -> Scene {
        Scene { seed: self.seed, ..self.group.scene.clone() }
    }
}

/// Disks, or vertices of polygons.
fn n_points(scene: &Scene) -> usize {
    match &scene.physics {
        crate::scene::Physics::Sp(_) => scene.n_particles,
        crate::scene::Physics::Dp(dp) => dp.species(scene.n_particles).iter().map(|s| s.count * s.n_vertices).sum(),
    }
}

/// The plan of all packings of a group, as files hold it.
pub fn scene_text(scene: &Scene) -> String {
    Scene { seed: 0, ..scene.of_results() }.to_toml()
}

/// Groups by ensemble, in the order of their first appearance.
pub fn by_ensemble<T>(items: &[T], name: impl Fn(&T) -> &str) -> Vec<(String, Vec<&T>)> {
    let mut order: Vec<(String, Vec<&T>)> = Vec::new();
    let mut place = BTreeMap::new();
    for item in items {
        let at = *place.entry(name(item).to_owned()).or_insert_with(|| {
            order.push((name(item).to_owned(), Vec::new()));
            order.len() - 1
        });
        order[at].1.push(item);
    }
    order
}

#[cfg(test)]
mod tests {
    use super::*;

    const STUDY: &str = "[[ensemble]]\nn_particles = [8, 16]\nseeds = 3\nscene.model = 'sp'\n\
        scene.compression.increments = [1e-3]\n";

    fn refusal(text: &str) -> String {
        let error = Plan::parse(text, "s.toml").unwrap_err().to_string();
        assert!(error.starts_with("s.toml") && !error.contains('\n'), "{error}");
        error
    }

    #[test]
    fn every_size_and_seed_is_a_packing() {
        let plan = Plan::parse(STUDY, "s.toml").unwrap();
        let ids: Vec<String> = plan.members().map(|m| m.id()).collect();
        assert_eq!(ids.len(), 6);
        assert_eq!((ids[0].as_str(), ids[5].as_str()), ("sp-N8-seed1", "sp-N16-seed3"));
        assert_eq!(plan.members().last().unwrap().scene().seed, 3);
        assert_eq!(plan.groups[0].ranks, 1);
    }

    #[test]
    fn large_packings_get_several_ranks() {
        let text = STUDY.replace("[8, 16]", "[10000]");
        assert_eq!(Plan::parse(&text, "s.toml").unwrap().groups[0].ranks, 4);
    }

    #[test]
    fn what_is_wrong_is_named() {
        assert!(refusal("").contains("ensemble"));
        assert!(refusal("x = 1").contains("unknown field `x`"));
        assert!(refusal(&STUDY.replace("seeds = 3", "sedes = 3")).contains("unknown field `sedes`"));
        assert!(refusal(&STUDY.replace("seeds = 3", "seeds = 0")).contains("integer from 1"));
        let of_wrong_kind = refusal(&STUDY.replace("seeds = 3", "seeds = 'x'"));
        assert!(
            of_wrong_kind.contains("s.toml:3: `seeds = 'x'`: invalid type: string \"x\", expected an integer from 0")
        );
        assert!(refusal(&STUDY.replace("[8, 16]", "[1]")).contains("n_particles"));
        assert!(refusal(&STUDY.replace("[8, 16]", "[8, 8]")).contains("sp-N8 is there already"));
        assert!(refusal(&STUDY.replace("'sp'", "'xp'")).contains("ensemble 1: `model`"));
        assert!(refusal(&format!("{STUDY}scene.seed = 3")).contains("belongs to the ensemble"));
        assert!(refusal(&format!("{STUDY}scene.shear.until = 0.1")).contains("do not shear"));
        assert!(refusal(&format!("{STUDY}name = 'a/b'")).contains("file names"));
        for form in ["until = 0.9", "densities = [0.9]"] {
            let other = STUDY.replace("increments = [1e-3]", form);
            assert!(refusal(&other).contains("`increments` or `log`"));
        }
    }

    #[test]
    fn the_starter_is_a_study() {
        assert!(Plan::parse(STARTER, "starter").unwrap().groups.len() > 1);
    }
}
