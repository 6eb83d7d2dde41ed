use super::{Vec2, add, cross, dot, sub};

/// Parameter t ∈ [0, 1] of the point a + t (b − a) of a segment that is closest to p, given p − a and b − a.
/// A segment of length zero answers 0.
pub fn closest_on_segment(from_a: Vec2, edge: Vec2) -> f64 {
    let along = dot(from_a, edge);
    let length2 = dot(edge, edge);
    if along <= 0.0 {
        0.0
    } else if along >= length2 {
        1.0
    } else {
        along / length2
    }
}

/// Whether the segments a…a+u and b…b+v cross at inner points of both, given b − a, u and v. Touching ends and segments on
/// each other do not count: two circulo-lines that merely touch are a contact, not a crossing.
pub fn segments_cross(b_minus_a: Vec2, u: Vec2, v: Vec2) -> bool {
    let opposite = |p: f64, q: f64| (p > 0.0 && q < 0.0) || (p < 0.0 && q > 0.0);
    let b_end = add(b_minus_a, v);
    let a_from_b = [-b_minus_a[0], -b_minus_a[1]];
    opposite(cross(u, b_minus_a), cross(u, b_end)) && opposite(cross(v, a_from_b), cross(v, sub(u, b_minus_a)))
}

/// Whether they lie on each other in the same direction, so that the insides of two outlines are on the same side. Facets of
/// outlines that touch run in opposite directions.
pub fn segments_run_together(b_minus_a: Vec2, u: Vec2, v: Vec2) -> bool {
    let is_collinear = cross(u, v) == 0.0 && cross(u, b_minus_a) == 0.0;
    is_collinear && dot(u, v) > 0.0 && dot(u, b_minus_a) < dot(u, u) && dot(u, add(b_minus_a, v)) > 0.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn closest_points() {
        assert_eq!(closest_on_segment([0.5, 3.0], [2.0, 0.0]), 0.25);
        assert_eq!(closest_on_segment([-1.0, 3.0], [2.0, 0.0]), 0.0);
        assert_eq!(closest_on_segment([5.0, 3.0], [2.0, 0.0]), 1.0);
        assert_eq!(closest_on_segment([1.0, 1.0], [0.0, 0.0]), 0.0);
    }

    #[test]
    fn crossings() {
        assert!(segments_cross([1.0, -1.0], [2.0, 0.0], [0.0, 2.0]));
        assert!(!segments_cross([3.0, -1.0], [2.0, 0.0], [0.0, 2.0]));
        assert!(!segments_cross([1.0, 0.0], [2.0, 0.0], [0.0, 2.0])); // touching from above
        assert!(!segments_cross([1.0, 0.0], [2.0, 0.0], [2.0, 0.0])); // collinear
    }

    #[test]
    fn edges_on_each_other() {
        assert!(segments_run_together([1.0, 0.0], [2.0, 0.0], [2.0, 0.0]));
        assert!(segments_run_together([-1.0, 0.0], [2.0, 0.0], [2.0, 0.0]));
        assert!(segments_run_together([0.0, 0.0], [2.0, 1.0], [2.0, 1.0]));
        assert!(!segments_run_together([1.0, 0.0], [2.0, 0.0], [-2.0, 0.0])); // facets that touch
        assert!(!segments_run_together([2.0, 0.0], [2.0, 0.0], [2.0, 0.0])); // one after the other
        assert!(!segments_run_together([1.0, 1e-9], [2.0, 0.0], [2.0, 0.0]));
    }
}
