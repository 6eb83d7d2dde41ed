//! Points, boxes, segments, polygons, disks and rounded outlines in the periodic plane.
//!
//! Everything here is pure: no particle, no potential, no rank is known in this room.

mod capsule;
mod disk_cut;
mod exposure;
mod frac;
mod periodic_box;
mod polygon;
mod segment;

pub use capsule::{Capsule, Piece};
pub use disk_cut::{DiskCut, cut_disk};
pub use exposure::{Exposed, Exposure, Hidden};
pub use frac::Frac;
pub use periodic_box::{PeriodicBox, Region};
pub use polygon::{Polygon, rounded_area};
pub use segment::{closest_on_segment, segments_cross, segments_run_together};

/// A vector in the plane, components along x and y, in the scene's unit of length unless said otherwise.
pub type Vec2 = [f64; 2];

#[inline(always)]
pub fn add(a: Vec2, b: Vec2) -> Vec2 {
    [a[0] + b[0], a[1] + b[1]]
}

#[inline(always)]
pub fn sub(a: Vec2, b: Vec2) -> Vec2 {
    [a[0] - b[0], a[1] - b[1]]
}

#[inline(always)]
pub fn scale(s: f64, a: Vec2) -> Vec2 {
    [s * a[0], s * a[1]]
}

#[inline(always)]
pub fn dot(a: Vec2, b: Vec2) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

/// z component of the cross product: positive when `b` lies counter-clockwise of `a`.
#[inline(always)]
pub fn cross(a: Vec2, b: Vec2) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

#[inline(always)]
pub fn norm(a: Vec2) -> f64 {
    dot(a, a).sqrt()
}
