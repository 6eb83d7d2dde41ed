use super::{Sample, check_no_coincident, check_no_crossing};
use crate::engine::{EngineError, System};
use crate::geometry::{Vec2, add, norm};
use crate::model::Model;
use std::collections::BTreeMap;

/// Something that must hold in a stored state: a number that must not be above its limit.
#[derive(Clone, Debug, PartialEq)]
pub struct Invariant {
    pub name: String,
    pub value: f64,
    pub limit: f64,
    /// What to look at when it does not hold.
    pub detail: String,
}

impl Invariant {
    pub fn new(name: &str, value: f64, limit: f64, detail: &str) -> Self {
        Invariant { name: name.into(), value, limit, detail: detail.into() }
    }

    /// A number that is not finite does not hold.
    pub fn holds(&self) -> bool {
        self.value <= self.limit
    }
}

/// Rounding of sums of numbers as large as the largest force or stress, relative to it.
const ROUNDING: f64 = 1e-11;

/// What must hold in any valid state, recomputed: force balance to `force_tolerance`, both stresses, no crossing,
/// particles and voids that fill the box, contacts seen alike from both sides. `sample` must be of this state. Collective; the same on all ranks.
pub fn invariants<M: Model>(
    system: &mut System<M>,
    sample: &Sample,
    force_tolerance: f64,
) -> Result<Vec<Invariant>, EngineError> {
    let not_finite: Vec<&str> =
        sample.scalars().into_iter().filter(|(_, value)| !value.is_finite()).map(|(name, _)| name).collect();
    let no_pair = |name: &str, found: Option<(u32, u32)>| {
        let pair = found.map_or(String::new(), |(a, b)| format!("particles {a} and {b}"));
        Invariant::new(name, found.is_some() as u8 as f64, 0.0, &pair)
    };
    let crossing = check_no_crossing(system)?;
    let coincident = check_no_coincident(system)?;
    let [largest, one_sided, unequal] = contact_symmetry(system)?;

    // the two stresses differ by Σ F ⊗ (x − c)/A, c the centre of the particle
    let radius =
        (0..system.particles().len()).map(|p| system.particles().circumradius(system.pbox(), p)).fold(0.0, f64::max);
    let radius = system.comm.max(radius);
    let unbalanced = sample.max_force * system.n_points() as f64 * radius / system.pbox().area();
    let stress = sample.energies.virial.iter().fold(0.0, |m: f64, s| m.max(s.abs()));
    let rounding = ROUNDING * (stress + largest * (radius + system.largest_size()) / system.pbox().area());
    let filled = sample.density.packing_fraction + sample.voids.filled(system.pbox());
    let torque = (sample.energies.virial[1] - sample.energies.virial[2]).abs();

    Ok(vec![
        Invariant::new("values that are not finite", not_finite.len() as f64, 0.0, &not_finite.join(", ")),
        Invariant::new("max|F|", sample.max_force, force_tolerance, "the state is not relaxed"),
        no_pair("crossing outlines", crossing),
        no_pair("disks at one place", coincident),
        Invariant::new("stresses virial and centroid", sample.energies.stress_mismatch(), unbalanced + rounding, ""),
        Invariant::new("stress xy less yx", torque, rounding, ""),
        Invariant::new("particles and voids, less the box", (filled - 1.0).abs(), 1e-12, "parts of the box"),
        Invariant::new("contacts seen from one side", one_sided, 0.0, ""),
        Invariant::new("contact forces, action less reaction", unequal, ROUNDING * largest, ""),
    ])
}

/// The largest contact force, the number of contacts that only one of the two particles sees, and the largest sum of a
/// force and its reaction.
fn contact_symmetry<M: Model>(system: &mut System<M>) -> Result<[f64; 3], EngineError> {
    let contacts = system.contacts()?;
    let mut words = Vec::new();
    for (&id, touching) in system.particles().id.iter().zip(&contacts) {
        for &(other, force) in touching {
            words.push((id as u64) << 32 | other as u64);
            words.extend(force.map(f64::to_bits));
        }
    }
    // the root has seen all
    Ok(system.comm.max_each(asymmetry(&system.comm.gather(words).concat())))
}

/// The same from words: both ids, and the force on the first.
fn asymmetry(words: &[u64]) -> [f64; 3] {
    let mut pairs: BTreeMap<(u32, u32), (u32, Vec2)> = BTreeMap::new();
    let mut largest = 0.0f64;
    for entry in words.chunks_exact(3) {
        let (a, b) = ((entry[0] >> 32) as u32, entry[0] as u32);
        let force = [f64::from_bits(entry[1]), f64::from_bits(entry[2])];
        largest = largest.max(norm(force));
        let pair = pairs.entry((a.min(b), a.max(b))).or_insert((0, [0.0; 2]));
        *pair = (pair.0 + 1, add(pair.1, force));
    }
    let one_sided = pairs.values().filter(|(sides, _)| *sides != 2).count() as f64;
    let unequal = pairs.values().map(|(_, sum)| norm(*sum)).fold(0.0, f64::max);
    [largest, one_sided, unequal]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::comm::Comm;
    use crate::geometry::PeriodicBox;
    use crate::minimize::Report;
    use crate::model::SoftDisks;
    use crate::observe::Rattlers;
    use crate::particles::{Bodies, Particles};

    fn contact(a: u64, b: u64, force: Vec2) -> [u64; 3] {
        [a << 32 | b, force[0].to_bits(), force[1].to_bits()]
    }

    #[test]
    fn contacts_have_two_sides_and_equal_forces() {
        let balanced = [contact(3, 5, [0.3, 0.4]), contact(5, 3, [-0.3, -0.4])].concat();
        assert_eq!(asymmetry(&balanced), [0.5, 0.0, 0.0]);
        let one_sided = [balanced.clone(), contact(5, 7, [0.0, 0.1]).to_vec()].concat();
        assert_eq!(asymmetry(&one_sided), [0.5, 1.0, 0.1]);
        let unequal = [contact(3, 5, [0.3, 0.4]), contact(5, 3, [-0.3, 0.4])].concat();
        assert_eq!(asymmetry(&unequal), [0.5, 0.0, 0.8]);
    }

    /// A state in balance, and a sample of it that tells of other voids or of a number that is none.
    #[test]
    fn altered_samples_do_not_hold() {
        let pbox = PeriodicBox::square(6.0);
        let mut disks = Particles::empty(&Bodies::Disks);
        [[0.0, 0.0], [2.0, 2.0]].iter().zip(0..).for_each(|(&x, id)| disks.push(id, 1.0, &[pbox.frac(x)]));
        let model = SoftDisks { epsilon: 1.0, smallest: 1.0 };
        let mut system = System::new(Comm::alone(), model, pbox, &pbox, disks, 0.3).unwrap();
        let sample = Sample::measure(&mut system, &Report::default(), Rattlers::default()).unwrap().0;
        let mut failing = |sample: &Sample| -> Vec<String> {
            let found = invariants(&mut system, sample, 1e-12).unwrap();
            found.into_iter().filter(|invariant| !invariant.holds()).map(|invariant| invariant.name).collect()
        };
        assert!(failing(&sample).is_empty());
        let mut altered = sample;
        altered.voids.area *= 1.0 - 1e-11;
        assert_eq!(failing(&altered), ["particles and voids, less the box"]);
        let altered = Sample { area_deviation: f64::NAN, ..sample };
        assert_eq!(failing(&altered), ["values that are not finite"]);
    }
}
