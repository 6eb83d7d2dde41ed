//! Plateau borders between polygons with finitely many vertices.

use std::f64::consts::{FRAC_PI_3, PI};

/// The void where three equal polygons with shells of width δ/2 meet, their facets exactly δ apart.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Border {
    pub area: f64,
    pub perimeter: f64,
}

impl Border {
    /// Line tension γ and a pressure γ/r inside balance at a free vertex that turns by α between edges of length ℓ if
    /// ℓ = 2r tan(α/2): what stands for an arc is the part between two facets of a regular polygon around a circle of
    /// radius r. With k vertices on the way from one facet to the next each turns by α = π/3k.
    ///
    /// Outside the shell that circle has the radius R = r + δ/2. Of the triangle between the centres of three, each of
    /// edge 2R, the polygons cover k r² tan(α/2) each and their shells δ/2 · kℓ + π/6 (δ/2)². Where facets face each
    /// other their shells touch and enclose nothing, so that the void begins only at the first vertex, half an edge
    /// from where the circle touches the facet: its perimeter is that of k − 1 edges and of the shells' arcs.
    ///
    /// As k → ∞ these are three touching arcs of radius R, 𝒜 = π/(4√3 − 2π). At k = 1 they are too, of radius δ/2. In
    /// between 𝒜 is smaller by a part ∝ 1/k, the missing ends of the cusps.
    pub fn between_polygons(radius: f64, delta: f64, corners: usize) -> Border {
        let k = corners as f64;
        let (tangent, shell) = ((0.5 * FRAC_PI_3 / k).tan(), 0.5 * delta);
        let edge = 2.0 * radius * tangent;
        let covered = k * radius * radius * tangent + shell * k * edge + PI / 6.0 * shell * shell;
        Border {
            area: 3.0f64.sqrt() * (radius + shell).powi(2) - 3.0 * covered,
            perimeter: 3.0 * ((k - 1.0) * edge + FRAC_PI_3 * shell),
        }
    }

    /// p²/4πa
    pub fn shape_parameter(&self) -> f64 {
        self.perimeter * self.perimeter / (4.0 * PI * self.area)
    }

    /// r of three touching arcs that enclose as much, a = (√3 − π/2) r².
    pub fn radius(&self) -> f64 {
        (self.area / (3.0f64.sqrt() - 0.5 * PI)).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::super::plateau_shape_parameter;
    use super::*;

    #[test]
    fn arcs_at_both_ends() {
        let one = Border::between_polygons(0.7, 0.2, 1);
        assert!(
            (one.radius() - 0.1).abs() < 1e-13 && (one.shape_parameter() - plateau_shape_parameter()).abs() < 1e-11
        );
        let missing = |k: usize| {
            let border = Border::between_polygons(0.7, 0.2, k);
            (0.8 - border.radius(), plateau_shape_parameter() - border.shape_parameter())
        };
        let ((radius, shape), (finer_radius, finer_shape)) = (missing(1000), missing(2000));
        assert!(0.0 < radius && radius < 1e-6 && (radius / finer_radius - 4.0).abs() < 0.01);
        assert!(0.0 < shape && shape < 1e-2 && (shape / finer_shape - 2.0).abs() < 0.01);
    }
}
