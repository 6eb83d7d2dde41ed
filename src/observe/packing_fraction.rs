use super::Shape;
use super::outlines::{Outlines, Thickness};
use crate::engine::{EngineError, System};
use crate::model::Model;
use crate::particles::Bodies;

/// How much of the box the particles take up.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PackingFraction {
    /// φ: areas of the undeformed particles (regular polygons with their shells) over the area of the box.
    pub reduced_number_density: f64,
    /// ρ: exact area of the union of all particles, disks or polygons with their shells, over that of the box.
    pub packing_fraction: f64,
    /// The areas that particles cover by themselves over that of the box: φ of disks, Σ (a + pδ/2 + πδ²/4)/A of
    /// deformable particles. What shells share is counted twice, and notches as if shells did not overlap in them.
    pub double_counted: f64,
}

impl PackingFraction {
    /// Of the present state; `shapes` are those of all own particles. Collective.
    pub fn of<M: Model>(system: &mut System<M>, shapes: &[Shape]) -> Result<PackingFraction, EngineError> {
        let is_polygons = matches!(system.particles().bodies, Bodies::Polygons { .. });
        let by_themselves = |s: &Shape| if is_polygons { s.covered_area() } else { s.rest_area };
        let [undeformed, double] =
            system.comm.sum_terms(shapes.len(), |p| [shapes[p].undeformed_area(), by_themselves(&shapes[p])]);
        // the shares of cut disks tile their union
        let shares: Vec<f64> =
            if is_polygons { union_shares(system)? } else { shapes.iter().map(|s| s.area).collect() };
        let [covered] = system.comm.sum_terms(shares.len(), |p| [shares[p]]);
        let box_area = system.pbox().area();
        Ok(PackingFraction {
            reduced_number_density: undeformed / box_area,
            packing_fraction: covered / box_area,
            double_counted: double / box_area,
        })
    }
}

/// For each own particle the area that it covers and no particle with a lower global id does. Collective.
fn union_shares<M: Model>(system: &mut System<M>) -> Result<Vec<f64>, EngineError> {
    let thickness = Thickness::of(system);
    system.with_whole_neighbors(|candidates| Outlines::new(candidates, thickness, |_| true).shares())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::comm::Comm;
    use crate::geometry::{PeriodicBox, Polygon, Vec2, add, closest_on_segment, norm, scale, sub};
    use crate::model::{Deformable, DeformableParameters, Harmonic, SoftDisks, VertexEdge};
    use crate::particles::Particles;
    use std::f64::consts::{PI, TAU};

    const DELTA: f64 = 0.2;

    fn polygons(pbox: PeriodicBox, all: &[Vec<Vec2>]) -> System<Deformable<VertexEdge>> {
        let mut particles = Particles::empty(&Bodies::Polygons { first: vec![0] });
        for (id, vertices) in all.iter().enumerate() {
            particles.push(id as u32, 1.0, &vertices.iter().map(|&v| pbox.frac(v)).collect::<Vec<_>>());
        }
        let contact = Harmonic { epsilon: 1.0, delta: DELTA };
        let parameters =
            DeformableParameters { line_tension: 1.0, k_area: 1.0, contact, largest_area_per_vertex: 0.25 };
        System::new(Comm::alone(), Deformable::new(parameters), pbox, &pbox, particles, 0.1).unwrap()
    }

    fn covered<M: Model>(system: &mut System<M>) -> f64 {
        union_shares(system).unwrap().iter().sum()
    }

    fn covered_by(pbox: PeriodicBox, all: &[Vec<Vec2>]) -> f64 {
        covered(&mut polygons(pbox, all))
    }

    fn square(x: f64, y: f64) -> Vec<Vec2> {
        vec![[x, y], [x + 1.0, y], [x + 1.0, y + 1.0], [x, y + 1.0]]
    }

    /// Area of a square of edge 1 with its shell.
    const ROUNDED: f64 = 1.0 + 4.0 * 0.5 * DELTA + PI * DELTA * DELTA / 4.0;

    /// Area that two disks of this radius at this distance share.
    fn lens(r: f64, d: f64) -> f64 {
        if 2.0 * r - d < 1e-8 {
            return 4.0 / 3.0 * r.sqrt() * (2.0 * r - d).powf(1.5);
        }
        2.0 * r * r * (0.5 * d / r).acos() - d * (r * r - 0.25 * d * d).sqrt()
    }

    /// Part of the box that is covered, by counting points of a fine grid.
    fn counted(pbox: PeriodicBox, all: &[Vec<Vec2>]) -> f64 {
        let n = 600;
        let polygons: Vec<_> = all
            .iter()
            .map(|v| {
                let points: Vec<_> = v.iter().map(|&v| pbox.frac(v)).collect();
                (points[0], Polygon::from_vertices(&pbox, &points))
            })
            .collect();
        let is_covered = |k: &usize| {
            let at = crate::geometry::Frac::from_fractions([
                ((k % n) as f64 + 0.5) / n as f64,
                ((k / n) as f64 + 0.5) / n as f64,
            ]);
            polygons.iter().any(|(first, polygon)| {
                let point = pbox.displacement(at, *first);
                let mut winding = 0.0;
                let near = polygon.offsets().zip(&polygon.edges).any(|(start, &edge)| {
                    let from = sub(point, start);
                    let to = sub(from, edge);
                    winding += crate::geometry::cross(from, to).atan2(crate::geometry::dot(from, to));
                    norm(sub(from, scale(closest_on_segment(from, edge), edge))) < 0.5 * DELTA
                });
                near || winding.abs() > PI
            })
        };
        pbox.area() * (0..n * n).filter(is_covered).count() as f64 / (n * n) as f64
    }

    #[test]
    fn convex_particles_by_themselves() {
        let pbox = PeriodicBox::new(6.0, 5.0, 1.0);
        let area = covered_by(pbox, &[square(5.5, 4.5), square(2.0, 1.0)]);
        assert!((area - 2.0 * ROUNDED).abs() < 1e-13, "{}", area - 2.0 * ROUNDED);
        // collapsed edges change nothing
        let collapsed = vec![[2.0, 1.0], [3.0, 1.0], [3.0, 1.0], [3.0, 1.0 + 1e-9], [3.0, 2.0], [2.0, 2.0]];
        assert!((covered_by(pbox, &[collapsed]) - ROUNDED).abs() < 1e-13);
    }

    #[test]
    fn facing_squares_share_a_strip() {
        let pbox = PeriodicBox::square(6.0);
        for gap in [0.0, 1e-15, 0.15, 0.01, 0.199_999_999, 0.2, 0.2 + 1e-15, 0.2 - 1e-15, 0.2 - 3e-14] {
            // a strip of length 1, and beyond its ends a half of the lens of two corners
            let shared = if gap < DELTA { (DELTA - gap) + lens(0.5 * DELTA, gap) } else { 0.0 };
            for squares in [[square(1.0, 1.0), square(2.0 + gap, 1.0)], [square(2.0 + gap, 1.0), square(1.0, 1.0)]] {
                let error = covered_by(pbox, &squares) - (2.0 * ROUNDED - shared);
                assert!(error.abs() < 1e-12, "{gap}: {error}");
            }
        }
    }

    #[test]
    fn two_that_meet_on_both_sides() {
        // longer than half the box: what is at its far end is nearer to its first vertex through the boundary
        let pbox = PeriodicBox::new(3.15, 5.0, 0.0);
        let rectangle = |x: f64, width: f64| {
            let middle = x + 0.5 * width;
            vec![[x, 1.0], [middle, 1.0], [x + width, 1.0], [x + width, 2.0], [middle, 2.0], [x, 2.0]]
        };
        let (long, short) = (rectangle(0.4, 1.9), rectangle(2.375, 1.1));
        let gap = 0.075;
        let shared = 2.0 * ((DELTA - gap) + lens(0.5 * DELTA, gap));
        // a square, and as much again of its middle
        let alone = 2.0 * ROUNDED + (1.9 + 1.1 - 2.0) * (1.0 + DELTA);
        for both in [[long.clone(), short.clone()], [short, long]] {
            let error = covered_by(pbox, &both) - (alone - shared);
            assert!(error.abs() < 1e-12, "{error}");
        }
    }

    #[test]
    fn almost_parallel_facets() {
        let pbox = PeriodicBox::square(6.0);
        for tilt in [1e-3, 1e-6, 1e-9, 1e-12, 1e-15] {
            // turned about the middle of its left edge, which the other shell touches
            let (s, c) = f64::sin_cos(tilt);
            let corner = |x: f64, y: f64| [2.0 + DELTA + c * x - s * y, 1.5 + s * x + c * y];
            let turned = vec![corner(0.0, -0.5), corner(1.0, -0.5), corner(1.0, 0.5), corner(0.0, 0.5)];
            let lost = 2.0 * ROUNDED - covered_by(pbox, &[square(1.0, 1.0), turned]);
            // a triangle of length 1/2
            assert!((lost - tilt / 8.0).abs() < 1e-12 + 0.4 * tilt.powf(1.5), "{tilt}: {lost}");
        }
    }

    #[test]
    fn a_honeycomb_without_gaps() {
        // hexagons of height H in cells of height H + δ/2: what is not covered are the corners, 2√3 − π each time
        let (n, cell) = (3, 0.6);
        let (inner, r) = (cell - 0.5 * DELTA, 0.5 * DELTA);
        let pbox = PeriodicBox::new(2.0 * cell * n as f64, 3.0f64.sqrt() * cell * n as f64, cell * n as f64);
        let hexagon = |k: usize| -> Vec<Vec2> {
            let (i, j) = ((k % n) as f64, (k / n) as f64);
            let center = [2.0 * cell * i + cell * j, 3.0f64.sqrt() * cell * j];
            let corner = |m: usize| {
                let (sin, cos) = (TAU * (m as f64 + 0.5) / 6.0).sin_cos();
                add(center, scale(inner / (PI / 6.0).cos(), [cos, sin]))
            };
            (0..6).map(corner).collect()
        };
        let area = covered_by(pbox, &(0..n * n).map(hexagon).collect::<Vec<_>>());
        let open = (n * n) as f64 * (2.0 * 3.0f64.sqrt() - PI) * r * r;
        assert!((area - (pbox.area() - open)).abs() < 1e-12 * pbox.area(), "{}", area - (pbox.area() - open));
    }

    #[test]
    fn a_notch_with_its_rounding() {
        let pbox = PeriodicBox::square(8.0);
        // a rectangle 3 by 1 with a triangular notch from above, of half width w and depth 0.8
        for w in [0.4f64, 0.05, 1e-3, 1e-7] {
            let shape =
                vec![[1.0, 1.0], [4.0, 1.0], [4.0, 2.0], [2.5 + w, 2.0], [2.5, 1.2], [2.5 - w, 2.0], [1.0, 2.0]];
            let whole = 3.0 + 8.0 * 0.5 * DELTA + PI * DELTA * DELTA / 4.0;
            // the notch is open above the meeting point of its two shells, if that lies below the upper shell
            let side = w.hypot(0.8);
            let (r, sine) = (0.5 * DELTA, w / side);
            // distance from the bottom along the side to the foot of the meeting point
            let meet = r * (1.0 - sine * sine).sqrt() / sine;
            let area = covered_by(pbox, std::slice::from_ref(&shape));
            if meet < side {
                // what is open: the notch less the shells of both sides, and between the caps above
                let turn = (0.8 / side).acos();
                let theta = 0.5 * PI - turn;
                let open = 0.8 * w - 2.0 * r * side + r * meet + 2.0 * r * w - r * r * theta;
                assert!((area - (whole - open)).abs() < 1e-12, "{w}: {}", area - (whole - open));
            } else {
                // only the two corners' circles and the line above leave a gap
                let gap = if w < r { 2.0 * r * w - (w * (r * r - w * w).sqrt() + r * r * (w / r).asin()) } else { 0.0 };
                assert!((area - (whole - gap)).abs() < 1e-12, "{w}: {}", area - (whole - gap));
            }
        }
    }

    #[test]
    fn awkward_shapes_against_counting() {
        let pbox = PeriodicBox::new(5.0, 4.5, 0.7);
        let star = |x: f64, y: f64, turn: f64, n: usize, deep: f64| -> Vec<Vec2> {
            let corner = |k: usize| {
                let radius = if k.is_multiple_of(2) { 0.9 } else { deep };
                let (sin, cos) = (turn + PI * k as f64 / n as f64).sin_cos();
                [x + radius * cos, y + radius * sin]
            };
            (0..2 * n).map(corner).collect()
        };
        let bottle = vec![
            [0.6, 2.6],
            [1.9, 2.6],
            [1.9, 3.9],
            [1.3, 3.9],
            [1.3, 3.6],
            [1.7, 3.6],
            [1.7, 2.8],
            [0.8, 2.8],
            [0.8, 3.6],
            [1.2, 3.6],
            [1.2, 3.9],
            [0.6, 3.9],
        ];
        let all = [star(1.2, 1.0, 0.3, 5, 0.4), star(3.0, 1.1, 0.2, 4, 0.5), star(4.3, 2.5, 0.9, 7, 0.7), bottle];
        let (area, count) = (covered_by(pbox, &all), counted(pbox, &all));
        assert!((area - count).abs() < 2e-3, "{area} {count}");
        let rounded: f64 = all
            .iter()
            .map(|v| Polygon::from_vertices(&pbox, &v.iter().map(|&v| pbox.frac(v)).collect::<Vec<_>>()))
            .map(|polygon| polygon.rounded_area(DELTA))
            .sum();
        assert!(rounded - area > 0.02, "there is something to see");
        // the order of ids decides who gives way, not the area
        let mut turned = all.to_vec();
        turned.reverse();
        assert!((covered_by(pbox, &turned) - area).abs() < 1e-12);
    }

    #[test]
    fn cut_disks_tile_the_same_union() {
        let pbox = PeriodicBox::new(9.0, 8.0, 1.5);
        let mut disks = Particles::empty(&Bodies::Disks);
        let mut word = 1u64;
        let mut random = || {
            word = word.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (word >> 11) as f64 / (1u64 << 53) as f64
        };
        for id in 0..80 {
            let at = crate::geometry::Frac::from_fractions([random(), random()]);
            disks.push(id, if id % 2 == 0 { 1.0 } else { 1.4 }, &[at]);
        }
        let model = SoftDisks { epsilon: 1.0, smallest: 1.0 };
        let mut system = System::new(Comm::alone(), model, pbox, &pbox, disks, 0.1).unwrap();
        let shapes: Vec<Shape> = system.outlines(Shape::of).unwrap();
        let cut: f64 = shapes.iter().map(|s| s.area).sum();
        assert!((covered(&mut system) - cut).abs() < 1e-12 * cut, "{} {cut}", covered(&mut system));
    }
}
