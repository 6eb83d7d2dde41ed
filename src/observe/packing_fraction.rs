use super::Shape;
use crate::comm::Comm;

/// How much of the box the particles take up.
///
/// For disks ρ is the exact area of their union. For deformable particles it is Σ (a + pδ/2 + πδ²/4)/A, shells
/// included: exact as long as all polygons are convex and no shells overlap. `double_counted` and `n_not_convex` say
/// how far a state is from that; at force balance shells overlap by about 10⁻⁵ δ (10⁻³ δ with soft contacts).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PackingFraction {
    /// φ: areas of the undeformed particles (regular polygons with their shells) over the area of the box.
    pub reduced_number_density: f64,
    /// ρ
    pub packing_fraction: f64,
    /// Estimate from above of the part of ρ that is counted twice where shells overlap: half of Σ p × deepest overlap
    /// over A. 0 for disks.
    pub double_counted: f64,
    /// Deformable particles with a corner that turns inwards; there the shell's area is too large by about
    /// (δ/2)² θ³/24 for a corner that turns by θ.
    pub n_not_convex: u64,
}

impl PackingFraction {
    /// From the shapes of all own particles. Collective.
    pub fn of(comm: &Comm, shapes: &[Shape], box_area: f64) -> PackingFraction {
        let row = |s: &Shape| {
            let overlap = s.polygon.map_or(0.0, |p| p.overlap);
            [s.undeformed_area(), s.covered_area(), 0.5 * s.perimeter * overlap]
        };
        let [undeformed, covered, twice] = comm.sum_terms(shapes.len(), |p| row(&shapes[p])).map(|sum| sum / box_area);
        let not_convex = shapes.iter().filter(|s| s.polygon.is_some_and(|p| !p.is_convex)).count();
        PackingFraction {
            reduced_number_density: undeformed,
            packing_fraction: covered,
            double_counted: twice,
            n_not_convex: comm.sum_count(not_convex as u64),
        }
    }

    /// Whether ρ is the area of the union to within rounding.
    pub fn is_exact(&self) -> bool {
        self.n_not_convex == 0 && self.double_counted <= 1e-15 * self.packing_fraction
    }
}
