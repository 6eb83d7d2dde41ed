use crate::engine::{EngineError, System};
use crate::geometry::{Vec2, cut_disk, norm, sub};
use crate::model::{Model, Outline};
use std::f64::consts::PI;

/// Packing fractions of overlapping disks as the paper approximates them, to compare with the exact one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Approximations {
    /// Eqs. 9 and 10 as printed: φ less what Eq. 10 gives for each overlapping pair. That is not the lens that two
    /// disks share but the kite of their centres and the two points where their outlines cross, far too large for a
    /// small overlap; the two circular sectors are missing.
    pub eq9_eq10: f64,
    /// Eq. 9 with the exact lens, which is what the text describes. Exact while no three disks overlap.
    pub eq9: f64,
    /// Eq. 12 as printed, with exact lenses and exact areas common to three disks: twice the latter are added.
    pub eq12: f64,
    /// Eq. 12 with each triple added once, as inclusion and exclusion want it. Exact while no four disks overlap.
    pub eq12_once: f64,
}

impl Approximations {
    /// Of the present state; all zero for particles that are not disks. Collective.
    pub fn of<M: Model>(system: &mut System<M>) -> Result<Approximations, EngineError> {
        let rows = system.outlines(terms)?;
        let [own, kites, lenses, triples] =
            system.comm.sum_terms(rows.len(), |p| rows[p]).map(|sum| sum / system.pbox().area());
        Ok(Approximations {
            eq9_eq10: own - kites,
            eq9: own - lenses,
            eq12: own - lenses + 2.0 * triples,
            eq12_once: own - lenses + triples,
        })
    }

    /// All of them by the names that files give them.
    pub fn named(&self) -> [(&'static str, f64); 4] {
        [
            ("packing_fraction_eq9_eq10", self.eq9_eq10),
            ("packing_fraction_eq9", self.eq9),
            ("packing_fraction_eq12", self.eq12),
            ("packing_fraction_eq12_once", self.eq12_once),
        ]
    }
}

/// One disk's area and its shares, 1/2 and 1/3, of the kites, lenses and triple overlaps that it takes part in.
fn terms(outline: &Outline) -> [f64; 4] {
    let Outline::Disk { radius, overlaps } = outline else { return [0.0; 4] };
    let [mut kites, mut lenses, mut triples] = [0.0; 3];
    for (k, &(center, other)) in overlaps.iter().enumerate() {
        kites += 0.5 * kite(*radius, other, norm(center));
        lenses += 0.5 * lens(*radius, other, norm(center));
        for &(third, size) in overlaps[..k].iter().filter(|(third, size)| norm(sub(*third, center)) < other + size) {
            triples += common([([0.0; 2], *radius), (center, other), (third, size)]) / 3.0;
        }
    }
    [PI * radius * radius, kites, lenses, triples]
}

/// Eq. 10 with the sum and the difference of the radii for σ_ij and σ̄_ij; 0 where one disk holds the other.
fn kite(a: f64, b: f64, d: f64) -> f64 {
    let (sum, difference) = (a + b, a - b);
    0.5 * ((sum - d) * (d - difference) * (d + difference) * (d + sum)).max(0.0).sqrt()
}

/// Area that two overlapping disks share: two sectors less the kite.
fn lens(a: f64, b: f64, d: f64) -> f64 {
    if d <= (a - b).abs() {
        return PI * a.min(b).powi(2);
    }
    // of the chord's distances from the centres, the angles are as exact as the chord
    let half_chord = kite(a, b, d) / d;
    let along = 0.5 * (d + (a - b) * (a + b) / d);
    let segment = |r: f64, h: f64| {
        let half = half_chord.atan2(h);
        r * r * half - half_chord * h
    };
    segment(a, along) + segment(b, d - along)
}

/// Area common to three disks that overlap each other, by inclusion and exclusion from that of their union.
fn common(disks: [(Vec2, f64); 3]) -> f64 {
    let others = |i: usize| [1, 2].map(|step| disks[(i + step) % 3]);
    let about = |i: usize| others(i).map(|(center, radius)| (sub(center, disks[i].0), radius));
    let union: f64 = (0..3).map(|i| cut_disk(disks[i].1, &about(i)).area).sum();
    let areas: f64 = disks.iter().map(|(_, radius)| PI * radius * radius).sum();
    let pair = |i: usize| lens(disks[i].1, disks[(i + 1) % 3].1, norm(about(i)[0].0));
    (union - areas + (0..3).map(pair).sum::<f64>()).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::comm::Comm;
    use crate::geometry::PeriodicBox;
    use crate::minimize::{Fire, Goal, Minimizer};
    use crate::model::SoftDisks;
    use crate::observe::{PackingFraction, Shape};
    use crate::particles::{Bodies, Particles};

    #[test]
    fn a_small_overlap() {
        // two disks of diameter 1 that overlap by 5 %: Eq. 10 gives many times the lens
        let (wrong, right) = (kite(0.5, 0.5, 0.95), lens(0.5, 0.5, 0.95));
        assert!((right - (0.5 * 0.95f64.acos() - 0.475 * (1.0f64 - 0.95 * 0.95).sqrt())).abs() < 1e-15);
        assert!((wrong / right - 14.2).abs() < 0.3, "{}", wrong / right);
        assert_eq!(lens(0.7, 0.2, 0.3), PI * 0.2f64.powi(2));
        assert!(kite(0.7, 0.2, 0.3) == 0.0 && (lens(0.7, 0.2, 0.5 + 1e-9) - PI * 0.04).abs() < 1e-8);
    }

    #[test]
    fn three_disks_around_a_common_point() {
        // Reuleaux triangle: each disk's centre on the outline of the others
        let disks = [([0.0, 0.0], 1.0), ([1.0, 0.0], 1.0), ([0.5, 0.75f64.sqrt()], 1.0)];
        assert!((common(disks) - 0.5 * (PI - 3.0f64.sqrt())).abs() < 1e-14);
        assert!(common([([0.0, 0.0], 0.51), ([1.0, 0.0], 0.51), ([0.5, 0.75f64.sqrt()], 0.51)]) < 1e-15);
    }

    /// Errors of the approximations and ρ for a relaxed packing of 64 disks from a random start, at this φ.
    fn errors(phi: f64) -> Approximations {
        let mut disks = Particles::empty(&Bodies::Disks);
        let mut word = 5u64;
        let mut random = || {
            word = word.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            word as i64
        };
        for id in 0..64 {
            let at = crate::geometry::Frac::from_bits([random(), random()]);
            disks.push(id, if id % 2 == 0 { 1.0 } else { 1.4 }, &[at]);
        }
        let area: f64 = disks.size.iter().map(|d| 0.25 * PI * d * d).sum();
        let pbox = PeriodicBox::square((area / phi).sqrt());
        let model = SoftDisks { epsilon: 1.0, smallest: 1.0 };
        let mut system = System::new(Comm::alone(), model, pbox, &pbox, disks, 0.3).unwrap();
        let goal = Goal { force_tolerance: 1e-10, max_iterations: 100_000 };
        assert!(Fire.minimize(&mut system, &goal).unwrap().is_converged());
        let shapes: Vec<Shape> = system.outlines(Shape::of).unwrap();
        let rho = PackingFraction::of(&mut system, &shapes).unwrap().packing_fraction;
        let a = Approximations::of(&mut system).unwrap();
        Approximations {
            eq9_eq10: a.eq9_eq10 - rho,
            eq9: a.eq9 - rho,
            eq12: a.eq12 - rho,
            eq12_once: a.eq12_once - rho,
        }
    }

    #[test]
    fn relaxed_packings() {
        let at_one = errors(1.0);
        assert!((-0.55..-0.40).contains(&at_one.eq9_eq10), "{at_one:?}");
        assert!(at_one.eq9.abs() < 1e-3 && at_one.eq12_once.abs() < 1e-12, "{at_one:?}");
        let dense = errors(1.24);
        assert!((5e-4..6e-3).contains(&dense.eq12), "{dense:?}");
        assert!(dense.eq9 < 0.0 && dense.eq12_once.abs() < 0.1 * dense.eq12, "{dense:?}");
    }
}
