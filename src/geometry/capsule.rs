use super::{Vec2, closest_on_segment, cross, dot, norm, scale, sub};
use std::f64::consts::{PI, TAU};

/// All points within `radius` of a segment of length `length` along the unit vector `along`: a circulo-line, or a disk
/// where the length is 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Capsule {
    pub along: Vec2,
    pub length: f64,
    pub radius: f64,
    /// Reach to the left of the segment, between the normals at its ends, where it differs from `radius` by a hair.
    pub inner: f64,
}

impl Capsule {
    /// Whether a point, given relative to the start of the segment, lies inside.
    pub fn holds(&self, point: Vec2) -> bool {
        let (ahead, left) = (dot(self.along, point), cross(self.along, point));
        if left > 0.0 && ahead > 0.0 && ahead < self.length {
            return left < self.inner;
        }
        let axis = scale(self.length, self.along);
        let from_axis = sub(point, scale(closest_on_segment(point, axis), axis));
        dot(from_axis, from_axis) < self.radius * self.radius
    }
}

/// A part of the rounded outline of a particle, about one of its vertices (or the centre of a disk) as the origin.
/// It runs counter-clockwise around the particle; a place on it is the angle from its start, or the length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Piece {
    /// About the origin, from the direction `from` on.
    Arc { radius: f64, from: f64, sweep: f64 },
    /// At distance `radius` to the right of the edge that starts at the origin and runs along the unit vector `along`.
    Segment { radius: f64, along: Vec2, length: f64 },
}

impl Piece {
    /// The place where it ends.
    pub fn extent(&self) -> f64 {
        match *self {
            Piece::Arc { sweep, .. } => sweep,
            Piece::Segment { length, .. } => length,
        }
    }

    pub fn point(&self, place: f64) -> Vec2 {
        match *self {
            Piece::Arc { radius, from, .. } => {
                let (sin, cos) = (from + place).sin_cos();
                [radius * cos, radius * sin]
            }
            Piece::Segment { radius, along, .. } => {
                [radius * along[1] + place * along[0], place * along[1] - radius * along[0]]
            }
        }
    }

    /// Length between two places.
    pub fn length(&self, from: f64, to: f64) -> f64 {
        match *self {
            Piece::Arc { radius, .. } => radius * (to - from),
            Piece::Segment { .. } => to - from,
        }
    }

    /// Area between the part from one place to another and its chord.
    pub fn bulge(&self, from: f64, to: f64) -> f64 {
        match *self {
            Piece::Arc { radius, .. } => 0.5 * radius * radius * ((to - from) - (to - from).sin()),
            Piece::Segment { .. } => 0.0,
        }
    }

    /// Visits the parts that lie inside a capsule whose segment starts at `start`, as places from … to.
    pub fn inside(&self, start: Vec2, capsule: &Capsule, mut visit: impl FnMut(f64, f64)) {
        match *self {
            Piece::Segment { length, along, .. } => {
                let [low, high] = line_inside(sub(start, self.point(0.0)), along, capsule);
                if low < length && high > 0.0 && low < high {
                    visit(low.max(0.0), high.min(length));
                }
            }
            Piece::Arc { radius, from, sweep } => {
                // between two crossings with the capsule's caps and sides an arc is wholly inside or wholly outside
                let (mut places, mut n) = ([0.0; 10], 1);
                circle_crossings(radius, start, capsule, |angle| {
                    let place = (angle - from).rem_euclid(TAU);
                    if place < sweep {
                        places[n] = place;
                        n += 1;
                    }
                });
                places[n] = sweep;
                let places = &mut places[..=n];
                places.sort_unstable_by(f64::total_cmp);
                let mut begin = None;
                for part in places.windows(2) {
                    let is_inside = capsule.holds(sub(self.point(0.5 * (part[0] + part[1])), start));
                    match (begin, is_inside) {
                        (None, true) => begin = Some(part[0]),
                        (Some(low), false) => {
                            visit(low, part[0]);
                            begin = None;
                        }
                        _ => {}
                    }
                }
                if let Some(low) = begin {
                    visit(low, sweep);
                }
            }
        }
    }
}

/// The part of a line, given by a unit vector, that lies inside a capsule whose segment starts at `start` relative to
/// the line's origin: one interval, as capsules are convex. Empty when the first number is the larger.
fn line_inside(start: Vec2, line: Vec2, capsule: &Capsule) -> [f64; 2] {
    let Capsule { along, length, radius, inner } = *capsule;
    let mut whole = [f64::INFINITY, f64::NEG_INFINITY];
    let mut add = |low: f64, high: f64| {
        if low < high {
            whole = [whole[0].min(low), whole[1].max(high)];
        }
    };
    let mut disk = |center: Vec2| {
        let across = cross(line, center);
        let half2 = (radius - across) * (radius + across);
        if half2 > 0.0 {
            let middle = dot(line, center);
            add(middle - half2.sqrt(), middle + half2.sqrt());
        }
    };
    disk(start);
    if length > 0.0 {
        disk([start[0] + length * along[0], start[1] + length * along[1]]);
        let [low, high] = within(-cross(along, start), cross(along, line), -radius, inner);
        let [first, last] = within(-dot(along, start), dot(along, line), 0.0, length);
        add(low.max(first), high.min(last));
    }
    whole
}

/// Where low < value + slope t < high.
fn within(value: f64, slope: f64, low: f64, high: f64) -> [f64; 2] {
    if slope == 0.0 {
        let inside = low < value && value < high;
        return if inside { [f64::NEG_INFINITY, f64::INFINITY] } else { [f64::INFINITY, f64::NEG_INFINITY] };
    }
    let (a, b) = ((low - value) / slope, (high - value) / slope);
    [a.min(b), a.max(b)]
}

/// Visits all angles, eight at most, at which a circle about the origin may enter or leave a capsule whose segment
/// starts at `start`.
fn circle_crossings(circle: f64, start: Vec2, capsule: &Capsule, mut visit: impl FnMut(f64)) {
    let Capsule { along, length, radius, inner } = *capsule;
    let mut cap = |center: Vec2| {
        let d = norm(center);
        if d > (circle - radius).abs() && d < circle + radius {
            let cosine = (d * d + (circle - radius) * (circle + radius)) / (2.0 * circle * d);
            let (middle, half) = (center[1].atan2(center[0]), cosine.clamp(-1.0, 1.0).acos());
            visit(middle - half);
            visit(middle + half);
        }
    };
    cap(start);
    if length > 0.0 {
        cap([start[0] + length * along[0], start[1] + length * along[1]]);
        let direction = along[1].atan2(along[0]);
        for side in [-radius, inner] {
            let sine = (side + cross(along, start)) / circle;
            if sine.abs() < 1.0 {
                visit(direction + sine.asin());
                visit(direction + PI - sine.asin());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn unit(angle: f64) -> Vec2 {
        [angle.cos(), angle.sin()]
    }

    proptest! {
        #[test]
        fn parts_inside_are_those_that_a_capsule_holds(
            start in [-1.5..1.5f64, -1.5..1.5f64], turn in 0.0..TAU, length in 0.0..2.0f64, radius in 0.05..1.2f64,
            from in 0.0..TAU, sweep in 0.1..TAU, is_disk: bool, is_arc: bool,
        ) {
            let length = if is_disk { 0.0 } else { length };
            let capsule = Capsule { along: unit(turn), length, radius, inner: radius };
            let piece = if is_arc {
                Piece::Arc { radius: 0.7, from, sweep }
            } else {
                Piece::Segment { radius: 0.7, along: unit(from), length: sweep }
            };
            let mut parts = Vec::new();
            piece.inside(start, &capsule, |low, high| parts.push([low, high]));
            prop_assert!(parts.windows(2).all(|w| w[0][1] < w[1][0]));
            for k in 0..200 {
                let place = piece.extent() * (k as f64 + 0.5) / 200.0;
                let from_end = parts.iter().flatten().map(|end| (end - place).abs()).fold(1.0, f64::min);
                let found = parts.iter().any(|p| p[0] < place && place < p[1]);
                prop_assert!(from_end < 1e-7 || found == capsule.holds(sub(piece.point(place), start)));
            }
        }

        #[test]
        fn bulge_and_chord_make_the_sector(from in 0.0..TAU, sweep in 0.0..TAU) {
            let arc = Piece::Arc { radius: 0.8, from, sweep };
            let triangle = 0.5 * cross(arc.point(0.0), arc.point(sweep));
            prop_assert!((triangle + arc.bulge(0.0, sweep) - 0.32 * sweep).abs() < 1e-15);
            prop_assert!((arc.length(0.0, sweep) - 0.8 * sweep).abs() < 1e-15);
        }
    }
}
