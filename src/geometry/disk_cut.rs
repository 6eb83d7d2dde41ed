use super::{Vec2, dot, norm};

/// A disk cut along the radical axes of its overlaps: its own share of the union.
///
/// The shares of all disks (power cells within the disks) tile the union of the disks, whatever the multiplicity of
/// the overlaps, so the packing fraction is the sum of these areas over the area of the box. The paper's Eq. 10, the
/// kite without its two circular sectors, and Eq. 12 are not used.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DiskCut {
    pub area: f64,
    /// Length of the share's outline: exposed arcs and cut edges; all of it for each of equal disks at one place.
    pub perimeter: f64,
}

/// Cuts a disk of radius `radius` at the origin by its neighbours, given as (centre, radius). Neighbours that do not
/// overlap it change nothing. Cost O(k²) in the number k of overlaps.
pub fn cut_disk(radius: f64, neighbors: &[(Vec2, f64)]) -> DiskCut {
    // the half plane kept by neighbour j: r·n_j ≤ h_j
    let mut planes: Vec<(Vec2, f64)> = Vec::with_capacity(neighbors.len());
    // equal disks at one place have equal parts of it
    let mut sharers = 1.0;
    for &(center, other) in neighbors {
        let d = norm(center);
        if d >= radius + other {
            continue;
        }
        if d == 0.0 {
            if other > radius {
                return DiskCut::default();
            }
            sharers += if other == radius { 1.0 } else { 0.0 };
            continue;
        }
        let h = 0.5 * (d + (radius - other) * (radius + other) / d);
        if h <= -radius {
            return DiskCut::default();
        }
        if h < radius {
            planes.push(([center[0] / d, center[1] / d], h));
        }
    }
    let mut cut = DiskCut::default();
    for (j, &(_, h)) in planes.iter().enumerate() {
        let length = kept_chord(radius, &planes, j);
        cut.perimeter += length;
        cut.area += 0.5 * h * length; // triangle from the centre to the cut edge, signed
    }
    let arc_length = radius * exposed_angle(&planes, radius);
    cut.area = (cut.area + 0.5 * radius * arc_length) / sharers;
    cut.perimeter += arc_length;
    cut
}

/// Half of the chord at distance `h` from the centre.
fn half_chord(radius: f64, h: f64) -> f64 {
    ((radius - h) * (radius + h)).max(0.0).sqrt()
}

/// Length of the part of plane j's chord that all other planes keep.
fn kept_chord(radius: f64, planes: &[(Vec2, f64)], j: usize) -> f64 {
    let (n, h) = planes[j];
    let half = half_chord(radius, h);
    let tangent = [-n[1], n[0]];
    let (mut low, mut high) = (-half, half);
    for (i, &(m, g)) in planes.iter().enumerate() {
        if i == j {
            continue;
        }
        // (h n + s t)·m ≤ g
        let (slope, room) = (dot(tangent, m), g - h * dot(n, m));
        if slope == 0.0 {
            // parallel planes: the stricter one keeps its chord, the first of two equal ones
            if room < 0.0 || (room == 0.0 && dot(n, m) > 0.0 && i < j) {
                return 0.0;
            }
        } else if slope > 0.0 {
            high = high.min(room / slope);
        } else {
            low = low.max(room / slope);
        }
    }
    (high - low).max(0.0)
}

/// Angle of the circle that no plane cuts away.
fn exposed_angle(planes: &[(Vec2, f64)], radius: f64) -> f64 {
    use std::f64::consts::{PI, TAU};
    let mut hidden: Vec<(f64, f64)> = Vec::with_capacity(planes.len() + 1);
    for &(n, h) in planes {
        // exact also where two circles only just overlap, unlike the arc cosine of h/radius
        let (center, half) = (n[1].atan2(n[0]), half_chord(radius, h).atan2(h));
        let (start, end) = (center - half, center + half);
        if start < -PI {
            hidden.push((start + TAU, PI));
            hidden.push((-PI, end));
        } else if end > PI {
            hidden.push((start, PI));
            hidden.push((-PI, end - TAU));
        } else {
            hidden.push((start, end));
        }
    }
    hidden.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (mut exposed, mut reached) = (0.0, -PI);
    for (start, end) in hidden {
        if start > reached {
            exposed += start - reached;
        }
        reached = f64::max(reached, end);
    }
    exposed + (PI - reached).max(0.0)
}

/// Area of the lens common to two disks of radii a and b at distance d: the two circular segments.
#[cfg(test)]
fn lens(a: f64, b: f64, d: f64) -> f64 {
    let part = |r: f64, h: f64| r * r * (h / r).acos() - h * (r * r - h * h).sqrt();
    let h = 0.5 * (d + (a * a - b * b) / d);
    part(a, h) + part(b, d - h)
}

#[cfg(test)]
mod tests {
    use super::super::{cross, sub};
    use super::*;
    use std::f64::consts::PI;

    fn union(disks: &[(Vec2, f64)]) -> f64 {
        (0..disks.len())
            .map(|i| {
                let others: Vec<_> =
                    (0..disks.len()).filter(|&j| j != i).map(|j| (sub(disks[j].0, disks[i].0), disks[j].1)).collect();
                cut_disk(disks[i].1, &others).area
            })
            .sum()
    }

    #[test]
    fn a_free_disk_is_whole() {
        let c = cut_disk(0.7, &[([1.5, 0.0], 0.5)]);
        assert!((c.area - PI * 0.49).abs() < 1e-15 && (c.perimeter - 2.0 * PI * 0.7).abs() < 1e-14);
    }

    #[test]
    fn two_disks_lose_their_lens() {
        for (a, b, d) in [(0.5, 0.7, 1.1), (0.5, 0.7, 0.3), (0.5, 0.5, 1e-3), (0.7, 0.5, 1.1999999)] {
            let u = union(&[([0.3, 0.2], a), ([0.3 + d * 0.6, 0.2 + d * 0.8], b)]);
            assert!((u - (PI * (a * a + b * b) - lens(a, b, d))).abs() < 1e-12, "{a} {b} {d}");
        }
    }

    #[test]
    fn contained_and_coincident_disks() {
        assert!((union(&[([0.0, 0.0], 1.0), ([0.1, 0.0], 0.5)]) - PI).abs() < 1e-14);
        assert_eq!(cut_disk(0.5, &[([0.0, 0.0], 1.0)]).area, 0.0);
        let thrice = [([0.3, 0.2], 0.5), ([0.3, 0.2], 0.5), ([1.2, 0.2], 0.5), ([0.3, 0.2], 0.5)];
        assert!((union(&thrice) - union(&thrice[1..3])).abs() < 1e-15);
    }

    #[test]
    fn disks_that_only_just_overlap() {
        // what the lens takes away is far below rounding
        for overlap in [1e-15, 1e-13, 1e-11, 1e-10] {
            let (cut, whole) = (cut_disk(0.5, &[([1.0 - overlap, 0.0], 0.5)]), 0.25 * PI);
            assert!((cut.area - whole).abs() < 2e-15, "{overlap}: {:e}", cut.area - whole);
        }
    }

    #[test]
    fn triple_overlap_against_counting() {
        let disks = [([0.0, 0.0], 0.5), ([0.55, 0.1], 0.6), ([0.2, 0.6], 0.4), ([0.3, 0.3], 0.2)];
        let n = 2000;
        let hits = (0..n * n)
            .filter(|k| {
                let p =
                    [-0.6 + 1.9 * ((k % n) as f64 + 0.5) / n as f64, -0.6 + 1.9 * ((k / n) as f64 + 0.5) / n as f64];
                disks.iter().any(|&(c, r)| norm(sub(p, c)) < r)
            })
            .count();
        assert!((union(&disks) - hits as f64 * (1.9 / n as f64).powi(2)).abs() < 2e-4);
    }

    #[test]
    fn orientation_of_the_cut_does_not_matter() {
        let (c, s) = (0.3f64.cos(), 0.3f64.sin());
        let turn = |p: Vec2| [c * p[0] - s * p[1], s * p[0] + c * p[1]];
        let others = [([0.8, 0.0], 0.5), ([-0.2, 0.7], 0.4), ([-0.6, -0.5], 0.6)];
        let turned: Vec<_> = others.iter().map(|&(p, r)| (turn(p), r)).collect();
        let (a, b) = (cut_disk(0.5, &others), cut_disk(0.5, &turned));
        assert!((a.area - b.area).abs() < 1e-14 && (a.perimeter - b.perimeter).abs() < 1e-14);
        assert!(cross([1.0, 0.0], turn([1.0, 0.0])) > 0.0);
    }
}
