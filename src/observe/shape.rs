use crate::geometry::{cut_disk, rounded_area};
use crate::model::Outline;
use std::f64::consts::PI;

/// Area and outline of one particle, by itself and with its shell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shape {
    /// Polygon area a. Of a disk: what is left of it when it is cut along the radical axes of its overlaps, so that
    /// the areas of all disks tile their union exactly.
    pub area: f64,
    /// Length p of the polygon; of a cut disk its exposed arcs and cut edges.
    pub perimeter: f64,
    /// Undeformed a₀, or πσ²/4.
    pub rest_area: f64,
    /// What a polygon has besides; nothing for a disk.
    pub polygon: Option<PolygonShape>,
}

/// What only polygons have.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PolygonShape {
    pub n_vertices: usize,
    /// Width δ of the circulo-lines.
    pub delta: f64,
}

/// 𝒜 = p²/4πa in three readings: 1 for a circle, more for anything else.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct ShapeParameter {
    /// Of the polygon, or of the cut disk.
    pub polygon: f64,
    /// Of the polygon over the regular N_v-gon's N_v tan(π/N_v)/π: 1 for a particle that nothing deforms. This is the
    /// reading that matches the paper's figures.
    pub relative: f64,
    /// Of the outer rounded outline: length p + πδ, area a + pδ/2 + πδ²/4 (exact for convex polygons; elsewhere too
    /// large by about (δ/2)² θ³/24 for each corner that turns inwards by θ).
    pub shell: f64,
}

impl Shape {
    pub fn of(outline: &Outline) -> Shape {
        match outline {
            Outline::Disk { radius, overlaps } => {
                let cut = cut_disk(*radius, overlaps);
                Shape { area: cut.area, perimeter: cut.perimeter, rest_area: PI * radius * radius, polygon: None }
            }
            Outline::Polygon { polygon, rest_area, delta } => Shape {
                area: polygon.area(),
                perimeter: polygon.perimeter(),
                rest_area: *rest_area,
                polygon: Some(PolygonShape { n_vertices: polygon.edges.len(), delta: *delta }),
            },
        }
    }

    /// Area with the shell: a + pδ/2 + πδ²/4 of a polygon, the area itself of a cut disk.
    pub fn covered_area(&self) -> f64 {
        self.polygon.map_or(self.area, |p| rounded_area(self.area, self.perimeter, p.delta))
    }

    /// Area that the particle covers when nothing deforms it: the regular polygon of area a₀ with its shell, or πσ²/4.
    pub fn undeformed_area(&self) -> f64 {
        self.polygon.map_or(self.rest_area, |p| {
            let perimeter = (4.0 * PI * regular_shape_parameter(p.n_vertices) * self.rest_area).sqrt();
            rounded_area(self.rest_area, perimeter, p.delta)
        })
    }

    /// Shape parameter in all readings; none for a disk of which nothing is left or a polygon without area.
    pub fn parameter(&self) -> Option<ShapeParameter> {
        if self.area <= 0.0 {
            return None;
        }
        let polygon = shape_parameter(self.perimeter, self.area);
        Some(match self.polygon {
            // a disk has no corners to compare with and no shell
            None => ShapeParameter { polygon, relative: polygon, shell: polygon },
            Some(p) => ShapeParameter {
                polygon,
                relative: polygon / regular_shape_parameter(p.n_vertices),
                shell: shape_parameter(self.perimeter + PI * p.delta, self.covered_area()),
            },
        })
    }
}

/// p²/4πa.
fn shape_parameter(perimeter: f64, area: f64) -> f64 {
    perimeter * perimeter / (4.0 * PI * area)
}

/// N tan(π/N)/π: 𝒜 of the regular polygon with N vertices.
fn regular_shape_parameter(n_vertices: usize) -> f64 {
    let n = n_vertices as f64;
    n * (PI / n).tan() / PI
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Polygon, Vec2};
    use std::f64::consts::TAU;

    fn polygon(vertices: &[Vec2], rest_area: f64, delta: f64) -> Shape {
        let n = vertices.len();
        let edge = |i: usize| [vertices[(i + 1) % n][0] - vertices[i][0], vertices[(i + 1) % n][1] - vertices[i][1]];
        let polygon = Polygon { edges: (0..n).map(edge).collect() };
        Shape::of(&Outline::Polygon { polygon, rest_area, delta })
    }

    fn regular(n: usize) -> Vec<Vec2> {
        (0..n).map(|k| (TAU * k as f64 / n as f64).sin_cos()).map(|(s, c)| [c, s]).collect()
    }

    #[test]
    fn a_regular_polygon_is_relatively_round() {
        for n in [3, 4, 12, 17] {
            let area = 0.5 * n as f64 * (TAU / n as f64).sin();
            let shape = polygon(&regular(n), area, 0.1);
            let a = shape.parameter().unwrap();
            assert!((a.relative - 1.0).abs() < 1e-14, "{n}");
            assert!((shape.covered_area() - shape.undeformed_area()).abs() < 1e-14);
            assert!(1.0 < a.shell && a.shell < a.polygon);
        }
    }

    #[test]
    fn a_square_with_its_shell() {
        let a = polygon(&[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]], 1.0, 0.2).parameter().unwrap();
        assert!((a.polygon - 4.0 / PI).abs() < 1e-15);
        let (length, area) = (4.0 + 0.2 * PI, 1.0 + 0.4 + 0.01 * PI);
        assert!((a.shell - length * length / (4.0 * PI * area)).abs() < 1e-15);
    }

    #[test]
    fn wide_shells_make_everything_round() {
        assert!((polygon(&regular(5), 1.0, 1e4).parameter().unwrap().shell - 1.0).abs() < 1e-7);
    }

    #[test]
    fn disks() {
        let free = Shape::of(&Outline::Disk { radius: 0.7, overlaps: vec![] });
        assert!((free.parameter().unwrap().polygon - 1.0).abs() < 1e-15);
        let cut = Shape::of(&Outline::Disk { radius: 0.5, overlaps: vec![([0.9, 0.0], 0.5)] });
        assert!(cut.area < cut.rest_area && cut.parameter().unwrap().polygon > 1.0);
        let swallowed = Shape::of(&Outline::Disk { radius: 0.5, overlaps: vec![([0.0, 0.1], 0.9)] });
        assert_eq!((swallowed.area, swallowed.parameter()), (0.0, None));
    }
}
