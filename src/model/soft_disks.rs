use super::stiffness::{Block, Elastic, add_elastic, of_separation, scaled, strained, times};
use super::{Harmonic, Model, Outline, Terms, View, add_outer};
use crate::geometry::{Vec2, dot};
use crate::neighbor::{Candidates, DiskList};
use crate::particles::Bodies;
use std::ops::Range;

/// Soft disks (SP model, paper Eq. 5): U = Σ ε/2 (1 − r/σ_ij)² over overlapping pairs, σ_ij the mean diameter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SoftDisks {
    /// Energy scale ε.
    pub epsilon: f64,
    /// Smallest diameter, which sets the stiffest contact.
    pub smallest: f64,
}

impl SoftDisks {
    #[inline(always)]
    fn law(&self, a: f64, b: f64) -> Harmonic {
        Harmonic { epsilon: self.epsilon, delta: 0.5 * (a + b) }
    }

    /// Overlapping neighbours of disk i: index, vector from the neighbour to i, its length, and the law of the pair.
    #[inline(always)]
    fn overlaps<'a>(
        &'a self,
        view: &'a View<DiskList>,
        i: usize,
    ) -> impl Iterator<Item = (u32, Vec2, f64, Harmonic)> + 'a {
        let size = &view.particles.size;
        view.lists.neighbors.row(i).iter().filter_map(move |&j| {
            let d = view.displacement(i as u32, j);
            let law = self.law(size[i], diameter(view, j));
            let r2 = dot(d, d);
            (r2 < law.delta * law.delta).then(|| (j, d, r2.sqrt(), law))
        })
    }
}

/// Diameter of an own or foreign disk.
#[inline(always)]
fn diameter(view: &View<DiskList>, j: u32) -> f64 {
    match (j as usize).checked_sub(view.particles.len()) {
        Some(foreign) => view.particles.foreign[foreign].size,
        None => view.particles.size[j as usize],
    }
}

impl Model for SoftDisks {
    type List = DiskList;

    const BODIES: bool = false;

    fn bodies(&self) -> Bodies {
        Bodies::Disks
    }

    fn range(&self, largest_size: f64) -> f64 {
        largest_size
    }

    fn list(&self, candidates: &Candidates, skin: f64) -> DiskList {
        DiskList::new(candidates, skin)
    }

    fn forces(&self, view: &View<DiskList>, particles: Range<usize>, forces: &mut [Vec2]) {
        for (force, i) in forces.iter_mut().zip(particles) {
            let mut sum = [0.0; 2];
            for (_, d, r, law) in self.overlaps(view, i) {
                // coincident centres push nowhere: the direction is undefined, and a random start leaves it at once
                let f = if r > 0.0 { law.force_over_distance(r) } else { 0.0 };
                sum[0] += f * d[0];
                sum[1] += f * d[1];
            }
            *force = sum;
        }
    }

    fn lighten(&self, _view: &View<DiskList>, _particles: Range<usize>, forces: &[Vec2], lightened: &mut [Vec2]) {
        lightened.copy_from_slice(forces);
    }

    fn terms(&self, view: &View<DiskList>, i: usize) -> Terms {
        let mut terms = Terms::default();
        self.overlaps(view, i).for_each(|(_, d, r, law)| {
            terms.contact += 0.5 * law.energy(r);
            let f = if r > 0.0 { law.force_over_distance(r) } else { 0.0 };
            add_outer(&mut terms.virial, 0.5, [f * d[0], f * d[1]], d);
        });
        terms.centroid = terms.virial;
        terms
    }

    fn for_each_contact(&self, view: &View<DiskList>, i: usize, mut visit: impl FnMut(u32, Vec2)) {
        self.overlaps(view, i).for_each(|(j, d, r, law)| {
            let f = if r > 0.0 { law.force_over_distance(r) } else { 0.0 };
            visit(j, [f * d[0], f * d[1]]);
        });
    }

    fn own_area(&self, view: &View<DiskList>, i: usize) -> f64 {
        0.25 * std::f64::consts::PI * view.particles.size[i] * view.particles.size[i]
    }

    fn outline(&self, view: &View<DiskList>, i: usize) -> Outline {
        let radius = 0.5 * view.particles.size[i];
        // δ of the pair is the sum of the two radii
        let overlaps = self.overlaps(view, i).map(|(_, d, _, law)| ([-d[0], -d[1]], law.delta - radius)).collect();
        Outline::Disk { radius, overlaps }
    }

    fn stiffness(&self, view: &View<DiskList>, i: usize, mut add: impl FnMut(usize, u32, Block)) {
        for (j, r, d, law) in self.overlaps(view, i).filter(|&(_, _, d, _)| d > 0.0) {
            let block = of_separation(law, r, d);
            add(0, i as u32, block);
            add(0, j, scaled(-1.0, block));
        }
    }

    fn area_stiffness(&self, _view: &View<DiskList>, _i: usize, _gradient: &mut [Vec2]) -> f64 {
        0.0
    }

    fn elastic(&self, view: &View<DiskList>, i: usize) -> Elastic {
        let mut elastic = [0.0; 10];
        for (_, r, d, law) in self.overlaps(view, i).filter(|&(_, _, d, _)| d > 0.0) {
            let block = of_separation(law, r, d);
            add_elastic(&mut elastic, |a, b| 0.5 * dot(strained(a, r), times(&block, strained(b, r))));
        }
        elastic
    }

    fn time_step(&self) -> f64 {
        // 0.6 √(m σ²/ε): 0.8 and more never converge (dense packings have ω_max up to about 2.6 of that unit)
        0.6 * self.smallest / self.epsilon.sqrt()
    }

    fn step_cap(&self) -> f64 {
        0.1 * self.smallest
    }
}
