use super::{Frac, PeriodicBox, Vec2, add, cross, norm, scale};
use std::f64::consts::PI;

/// A closed polygon made of its edge vectors, about its own first vertex: no coordinate of the box enters, so its
/// shape is as exact in a large box as in a small one, and it may be wider than half the box.
#[derive(Clone, Debug, Default)]
pub struct Polygon {
    /// Edge i runs from vertex i to vertex i + 1 (cyclic).
    pub edges: Vec<Vec2>,
}

impl Polygon {
    /// From the vertices in order, counter-clockwise, consecutive ones less than half the box apart.
    pub fn from_vertices(pbox: &PeriodicBox, vertices: &[Frac]) -> Self {
        let n = vertices.len();
        Polygon { edges: (0..n).map(|i| pbox.displacement(vertices[(i + 1) % n], vertices[i])).collect() }
    }

    /// Vertices relative to the first.
    pub fn offsets(&self) -> impl Iterator<Item = Vec2> + '_ {
        self.edges.iter().scan([0.0; 2], |at, &edge| {
            let here = *at;
            *at = add(*at, edge);
            Some(here)
        })
    }

    pub fn perimeter(&self) -> f64 {
        self.edges.iter().map(|&e| norm(e)).sum()
    }

    pub fn longest_edge(&self) -> f64 {
        self.edges.iter().map(|&e| norm(e)).fold(0.0, f64::max)
    }

    /// Signed area, positive when counter-clockwise.
    pub fn area(&self) -> f64 {
        0.5 * self.offsets().zip(&self.edges).map(|(r, &e)| cross(r, e)).sum::<f64>()
    }

    /// With its shell, see [`rounded_area`].
    pub fn rounded_area(&self, delta: f64) -> f64 {
        rounded_area(self.area(), self.perimeter(), delta)
    }

    /// Area centroid relative to the first vertex; the mean vertex where the area is zero.
    pub fn centroid(&self) -> Vec2 {
        let (mut area, mut moment) = (0.0, [0.0; 2]);
        for (r, &edge) in self.offsets().zip(&self.edges) {
            let c = cross(r, edge);
            area += c;
            moment = add(moment, scale(c, add(scale(2.0, r), edge)));
        }
        if area != 0.0 {
            scale(1.0 / (3.0 * area), moment)
        } else {
            scale(1.0 / self.edges.len() as f64, self.offsets().fold([0.0; 2], add))
        }
    }

    /// Whether two of its edges cross.
    pub fn crosses_itself(&self) -> bool {
        let at: Vec<Vec2> = self.offsets().collect();
        let n = self.edges.len();
        (0..n).any(|i| {
            (i + 2..n).any(|j| {
                let apart = [at[j][0] - at[i][0], at[j][1] - at[i][1]];
                (i > 0 || j + 1 < n) && super::segments_cross(apart, self.edges[i], self.edges[j])
            })
        })
    }
}

/// Area of a convex polygon with its circulo-line shell of width `delta`: a + p δ/2 + π δ²/4.
pub fn rounded_area(area: f64, perimeter: f64, delta: f64) -> f64 {
    area + 0.5 * delta * perimeter + 0.25 * PI * delta * delta
}

#[cfg(test)]
mod tests {
    use super::*;

    fn polygon(vertices: &[Vec2]) -> Polygon {
        let pbox = PeriodicBox::square(8.0);
        Polygon::from_vertices(&pbox, &vertices.iter().map(|&v| pbox.frac(v)).collect::<Vec<_>>())
    }

    #[test]
    fn a_rectangle_across_the_corner() {
        let p = polygon(&[[7.0, 7.5], [9.0, 7.5], [9.0, 8.5], [7.0, 8.5]]);
        assert!((p.area() - 2.0).abs() < 1e-15);
        assert!((p.perimeter() - 6.0).abs() < 1e-15);
        let c = p.centroid();
        assert!((c[0] - 1.0).abs() < 1e-15 && (c[1] - 0.5).abs() < 1e-15);
        assert!(!p.crosses_itself());
    }

    #[test]
    fn orientation_and_crossing() {
        assert!(polygon(&[[0.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, 0.0]]).area() < 0.0);
        assert!(polygon(&[[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]]).crosses_itself());
    }

    #[test]
    fn wider_than_half_the_box() {
        let p =
            polygon(&[[0.0, 0.0], [2.5, 0.0], [5.0, 0.0], [7.5, 0.0], [7.5, 1.0], [5.0, 1.0], [2.5, 1.0], [0.0, 1.0]]);
        assert!((p.area() - 7.5).abs() < 1e-14);
    }
}
