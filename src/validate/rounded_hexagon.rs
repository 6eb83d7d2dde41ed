//! The hexagonal foam of rounded hexagons: what a crystal of equal deformable particles becomes as N_v → ∞.

use crate::comm::Comm;
use crate::engine::{EngineError, System};
use crate::geometry::{PeriodicBox, Vec2};
use crate::model::{Deformable, DeformableParameters, Harmonic, VertexEdge};
use crate::particles::{Bodies, Particles};
use std::f64::consts::{FRAC_PI_3, PI};

/// What the particles are made of; line tension γ = 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    pub rest_area: f64,
    pub k_area: f64,
    pub epsilon: f64,
    pub delta: f64,
}

/// 2√3 − π: what rounding a hexagon's corners by radius 1 takes from its area.
fn corner_area() -> f64 {
    2.0 * 3.0f64.sqrt() - PI
}

/// One cell of the foam at rest. Neighbours are a cell height 2h_a apart, and facets a distance δ, so that the hexagon
/// of the outline has the half height H = h_a − δ/2; its corners are arcs of radius r, the border radius. All outlines
/// bear one tension γ and hold the pressure k_a(a₀ − a) = γ/r.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RoundedHexagon {
    /// r
    pub border: f64,
    /// h_a
    pub half_height: f64,
    pub delta: f64,
    /// What its corners take from a hexagon's area, over r².
    corner_area: f64,
}

impl RoundedHexagon {
    /// From the border radius: a = a₀ − γ/(k_a r), and r² = (2√3 H² − a)/(2√3 − π).
    pub fn with_border(material: &Material, border: f64) -> Self {
        let area = material.rest_area - 1.0 / (material.k_area * border);
        let hexagon = ((area + corner_area() * border * border) / (2.0 * 3.0f64.sqrt())).sqrt();
        RoundedHexagon {
            border,
            half_height: hexagon + 0.5 * material.delta,
            delta: material.delta,
            corner_area: corner_area(),
        }
    }

    /// From ρ, shell included, by bisection.
    pub fn at_density(material: &Material, density: f64) -> Self {
        let (mut low, mut high) = (1e-6, 10.0 * material.rest_area.sqrt());
        for _ in 0..100 {
            let middle = 0.5 * (low + high);
            if Self::with_border(material, middle).packing_fraction() > density {
                low = middle;
            } else {
                high = middle;
            }
        }
        Self::with_border(material, 0.5 * (low + high))
    }

    /// The polygon in the same box that has `corners` vertices in place of each arc, from γ/r = k_a(a₀ − a) and
    /// a = 2√3 H² − 6 (tan π/6 − k tan(π/6k)) r² by bisection: its corners are parts of regular polygons around circles
    /// of radius r. It bears the pressure of the rounded hexagon with that r.
    pub fn with_corners(self, material: &Material, corners: usize) -> Self {
        let k = corners as f64;
        let corner_area = 6.0 * ((PI / 6.0).tan() - k * (PI / 6.0 / k).tan());
        let excess = |r: f64| {
            let area = 2.0 * 3.0f64.sqrt() * self.hexagon() * self.hexagon() - corner_area * r * r;
            material.k_area * (material.rest_area - area) - 1.0 / r
        };
        let (mut low, mut high) = (1e-6, self.hexagon());
        for _ in 0..100 {
            let middle = 0.5 * (low + high);
            if excess(middle) < 0.0 {
                low = middle;
            } else {
                high = middle;
            }
        }
        RoundedHexagon { border: 0.5 * (low + high), corner_area, ..self }
    }

    /// H
    pub fn hexagon(&self) -> f64 {
        self.half_height - 0.5 * self.delta
    }

    /// V = 2√3 h_a².
    pub fn cell_area(&self) -> f64 {
        2.0 * 3.0f64.sqrt() * self.half_height * self.half_height
    }

    /// ρ: the cell without the borders, whose radius is r + δ/2 outside the shells.
    pub fn packing_fraction(&self) -> f64 {
        1.0 - corner_area() * (self.border + 0.5 * self.delta).powi(2) / self.cell_area()
    }

    /// The same cell when the borders have another radius.
    pub fn with_other_border(self, border: f64) -> Self {
        RoundedHexagon { border, ..self }
    }

    /// P = γ(1/r − 1/H) H/h_a: facets of length 2(H − r)/√3 bear γ/r on cell sides of length 2h_a/√3.
    pub fn pressure(&self) -> f64 {
        (1.0 / self.border - 1.0 / self.hexagon()) * self.hexagon() / self.half_height
    }

    /// G of a dry foam with films of tension 2γ: γ/(√3 h), h = 2h_a/√3 (Princen, J. Colloid Interface Sci. 91, 160
    /// (1983)).
    pub fn dry_shear_modulus(&self) -> f64 {
        0.5 / self.half_height
    }

    /// G = γ(1 + δ/2r)/(√3 h): a film of thickness δ under the pressure γ/r bears the tension 2γ + δγ/r, and borders
    /// do not matter (decoration theorem).
    pub fn shear_modulus(&self) -> f64 {
        self.dry_shear_modulus() * self.film_tension(self.border)
    }

    /// Of a film, over 2γ.
    fn film_tension(&self, border: f64) -> f64 {
        1.0 + 0.5 * self.delta / border
    }

    /// r at a shear strain s. The films of a cell grow from 2√3 h_a to that times √(1 + s²/4), and what they take at a
    /// thickness δ comes from the borders.
    fn border_at(&self, strain: f64) -> f64 {
        let grown = 2.0 * 3.0f64.sqrt() * self.half_height * ((1.0 + 0.25 * strain * strain).sqrt() - 1.0);
        (self.border * self.border - self.delta * grown / self.corner_area).max(0.0).sqrt()
    }

    /// Shear stress along rows of cells when the border radius is the present one: τ = G s/√(1 + s²/4) (Princen 1983),
    /// G with the tension that the films have now.
    pub fn shear_stress(&self, strain: f64) -> f64 {
        self.shear_modulus() * strain / (1.0 + 0.25 * strain * strain).sqrt()
    }

    /// Strain at which the shrinking film has gone: its length between the corners of the dry foam is
    /// (2h_a/√3)(1 − (√3/2)s)/√(1 + s²/4), zero at s = 2/√3, and two borders take (r + δ/2)/√3 of it each.
    pub fn yield_strain(&self) -> f64 {
        let (mut low, mut high) = (0.0, 2.0 / 3.0f64.sqrt());
        for _ in 0..100 {
            let s = 0.5 * (low + high);
            let film = self.half_height * (1.0 - 0.75f64.sqrt() * s) / (1.0 + 0.25 * s * s).sqrt();
            if film > self.border_at(s) + 0.5 * self.delta {
                low = s;
            } else {
                high = s;
            }
        }
        0.5 * (low + high)
    }

    /// Points of the outline about its centre, equally far from each other along it, the first a quarter of that
    /// distance after the middle of a facet: vertices of facing facets then stand halfway between each other.
    fn outline(&self, n_vertices: usize) -> Vec<Vec2> {
        let facet = 2.0 * (self.hexagon() - self.border) / 3.0f64.sqrt();
        let sixth = facet + FRAC_PI_3 * self.border;
        let point = |k: usize| {
            let along = 6.0 * sixth * (k as f64 + 0.25) / n_vertices as f64;
            let (sector, u) = ((along / sixth).floor(), along % sixth);
            let (at, turn) = if u < 0.5 * facet {
                ([self.hexagon(), u], sector)
            } else if u < sixth - 0.5 * facet {
                let angle = (u - 0.5 * facet) / self.border;
                let [x, y] = [self.hexagon() - self.border, 0.5 * facet];
                ([x + self.border * angle.cos(), y + self.border * angle.sin()], sector)
            } else {
                ([self.hexagon(), u - sixth], sector + 1.0)
            };
            let (sin, cos) = (FRAC_PI_3 * turn).sin_cos();
            [cos * at[0] - sin * at[1], sin * at[0] + cos * at[1]]
        };
        (0..n_vertices).map(point).collect()
    }

    /// Such cells in a periodic box, rows along x, each an N_v-gon on the outline; `rows` is even.
    pub fn system(
        &self,
        comm: Comm,
        material: &Material,
        n_vertices: usize,
        columns: usize,
        rows: usize,
    ) -> Result<System<Deformable<VertexEdge>>, EngineError> {
        let spacing = 2.0 * self.half_height;
        let pbox = PeriodicBox::new(columns as f64 * spacing, rows as f64 * spacing * 0.75f64.sqrt(), 0.0);
        let outline = self.outline(n_vertices);
        let mut polygons = Particles::empty(&Bodies::Polygons { first: vec![0] });
        if comm.is_root() {
            for id in 0..columns * rows {
                let (column, row) = (id % columns, id / columns);
                let x = (column as f64 + 0.5 * (row % 2) as f64) * spacing;
                let y = row as f64 * spacing * 0.75f64.sqrt();
                let points: Vec<_> = outline.iter().map(|v| pbox.frac([x + v[0], y + v[1]])).collect();
                polygons.push(id as u32, material.rest_area, &points);
            }
        }
        let model = Deformable::new(DeformableParameters {
            line_tension: 1.0,
            k_area: material.k_area,
            contact: Harmonic { epsilon: material.epsilon, delta: material.delta },
            largest_area_per_vertex: material.rest_area / n_vertices as f64,
        });
        // shear narrows the box to that of half a period of tilt
        System::new(comm, model, pbox, &pbox.sheared(0.5 * pbox.lx() / pbox.ly()), polygons, 0.1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MATERIAL: Material = Material { rest_area: 0.7, k_area: 2000.0, epsilon: 1000.0, delta: 0.2 };

    impl RoundedHexagon {
        fn area(&self) -> f64 {
            2.0 * 3.0f64.sqrt() * self.hexagon().powi(2) - corner_area() * self.border * self.border
        }

        fn perimeter(&self) -> f64 {
            4.0 * 3.0f64.sqrt() * self.hexagon() - 2.0 * corner_area() * self.border
        }
    }

    /// Pressure, modulus and stress are derivatives of the energy γ p + k_a/2 (a − a₀)² of the cell.
    #[test]
    fn formulas_are_derivatives_of_the_energy() {
        let cell = RoundedHexagon::at_density(&MATERIAL, 0.98);
        assert!((cell.packing_fraction() - 0.98).abs() < 1e-12);
        assert!((MATERIAL.k_area * (MATERIAL.rest_area - cell.area()) - 1.0 / cell.border).abs() < 1e-8);
        let energy =
            |c: &RoundedHexagon| c.perimeter() + 0.5 * MATERIAL.k_area * (c.area() - MATERIAL.rest_area).powi(2);
        let near = |r: f64| RoundedHexagon::with_border(&MATERIAL, r);
        let (a, b) = (near(cell.border * (1.0 - 1e-5)), near(cell.border * (1.0 + 1e-5)));
        let pressure = -(energy(&b) - energy(&a)) / (b.cell_area() - a.cell_area());
        assert!((pressure / cell.pressure() - 1.0).abs() < 1e-6, "{pressure} {}", cell.pressure());
        // of the films that grow, at the expense of the borders
        let perimeter = |s: f64| {
            let grown = 4.0 * 3.0f64.sqrt() * cell.half_height * (1.0 + 0.25 * s * s).sqrt();
            grown - 2.0 * corner_area() * cell.border_at(s)
        };
        for s in [0.01, 0.2, 0.4] {
            let stress = (perimeter(s + 1e-5) - perimeter(s - 1e-5)) / 2e-5 / cell.cell_area();
            let expected = cell.with_other_border(cell.border_at(s)).shear_stress(s);
            assert!((stress / expected - 1.0).abs() < 1e-6, "{stress} {expected}");
        }
    }

    #[test]
    fn many_corners_make_arcs() {
        let cell = RoundedHexagon::at_density(&MATERIAL, 0.98);
        let error = |k: usize| cell.with_corners(&MATERIAL, k).border - cell.border;
        assert!(0.0 < error(1000) && error(1000) < 1e-6, "{}", error(1000));
        assert!((error(20) / error(40) - 4.0).abs() < 0.05);
    }

    #[test]
    fn limits() {
        let dry = RoundedHexagon::with_border(&Material { delta: 1e-9, k_area: 1e9, ..MATERIAL }, 1e-4);
        assert!((dry.yield_strain() - 2.0 / 3.0f64.sqrt()).abs() < 1e-3, "{}", dry.yield_strain());
        assert!((dry.perimeter().powi(2) / (4.0 * PI * dry.area()) - 2.0 * 3.0f64.sqrt() / PI).abs() < 1e-3);
        let outline = RoundedHexagon::at_density(&MATERIAL, 0.98).outline(600);
        let farthest = outline.iter().map(|v| v[0].hypot(v[1])).fold(0.0, f64::max);
        let cell = RoundedHexagon::at_density(&MATERIAL, 0.98);
        let corner = 2.0 * (cell.hexagon() - cell.border) / 3.0f64.sqrt() + cell.border;
        assert!((farthest - corner).abs() < 1e-4);
    }
}
