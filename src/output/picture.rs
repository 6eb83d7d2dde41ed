//! Figures of packings: particles in their periodic box, contacts, a colour bar and a caption.
//!
//! There is one drawing path. [`Packing::to_svg`] writes the figure, and [`Packing::to_png`]
//! rasterises exactly that SVG. Text is set in DejaVu Sans, compiled in, so a PNG is the same on
//! a machine with no fonts at all. The small SVG toolkit at the end of the file (text, numbers,
//! rasteriser) serves the plots too.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::{Arc, LazyLock};

use resvg::{tiny_skia, usvg};

use super::plot::{linear_ticks, number, tick_step};

/// Above this number of particles contacts are left out: they would be finer than a pixel and
/// only double the file.
pub const MAX_PARTICLES_WITH_CONTACTS: usize = 20_000;

/// Longer side of the drawn box, in SVG user units.
const BOX_SIZE: f64 = 1000.0;
/// Space between the parts of the figure, in user units.
const GAP: f64 = 24.0;
/// Height of the lettering, in user units.
const FONT: f64 = 26.0;
/// Fills are translucent so that overlaps of soft particles and the contact lines stay visible.
const FILL_OPACITY: f64 = 0.72;
/// Whiteness of the veil over what lies outside the box.
const VEIL_OPACITY: f64 = 0.62;
/// The strip around the box in which neighbouring images are shown is not wider than this part of the picture.
pub(super) const MARGIN: f64 = 0.06;
/// Particles that reach over more boxes than this are errors in the data and not drawn.
const MAX_BOXES: f64 = 10.0;
/// Boxes longer than this, in units of their width, are too thin to draw.
const MAX_ASPECT: f64 = 1000.0;
/// More integer values than this are drawn on the continuous scale.
const MAX_DISCRETE_LEVELS: i64 = 12;
/// The continuous scale is cut into this many colours, each written once in the file.
const COLOUR_LEVELS: f64 = 64.0;
/// Fill of particles without a value (NaN, infinite or missing).
const GREY_UNDEFINED: Colour = [0xe2, 0xe2, 0xe2];
/// Fill when all particles have the same value: a colour would suggest a contrast.
const GREY_CONSTANT: Colour = [0xa6, 0xac, 0xb4];

type Colour = [u8; 3];
type Point = [f64; 2];

/// What can go wrong when a figure is drawn.
#[derive(Debug, thiserror::Error)]
pub enum PictureError {
    /// The SVG could not be read back, e.g. more than a million elements.
    #[error("the drawing cannot be rasterised: {0}")]
    Svg(#[from] usvg::Error),
    /// The picture has no pixels, or more than can be allocated.
    #[error("cannot make a picture of {width} x {height} pixels")]
    Size {
        /// Requested width in pixels.
        width: u32,
        /// Height in pixels that follows from the shape of the figure.
        height: u32,
    },
    /// The PNG encoder failed.
    #[error("cannot encode the picture as PNG: {0}")]
    Png(String),
}

/// One particle's outline in Cartesian coordinates, in any periodic image.
#[derive(Debug, Clone, PartialEq)]
pub enum Outline {
    /// A disk.
    Disk {
        /// Centre, in units of length.
        center: [f64; 2],
        /// Diameter, in units of length.
        diameter: f64,
    },
    /// A polygon dilated by half its circulo-line width.
    RoundedPolygon {
        /// Vertices in order along the boundary (either sense), unwrapped: consecutive vertices
        /// are in the same periodic image.
        vertices: Vec<[f64; 2]>,
        /// Width of the circulo-lines; the drawn outline is the polygon dilated by `width / 2`.
        width: f64,
    },
}

/// A packing to be drawn: all lengths are in the same (arbitrary) unit.
#[derive(Debug, Clone, PartialEq)]
pub struct Packing {
    /// Box vectors as rows, `a1 = (lx, 0)` and `a2 = (xy, ly)`.
    pub cell: [[f64; 2]; 2],
    /// The part of either edge of the box that is shown, from the origin: 1 for all of it.
    pub part: f64,
    /// Outlines of the particles, in any periodic image; drawn in every image that is visible.
    pub outlines: Vec<Outline>,
    /// Value of each particle shown as its colour; a missing or non-finite value is drawn grey.
    /// An empty list gives grey particles and no colour bar.
    pub values: Vec<f64>,
    /// Name written along the colour bar, e.g. `z` or `pressure`; `_{..}` and `^{..}` make sub-
    /// and superscripts.
    pub value_name: String,
    /// Contacts as segments, the first end in any image, the second the minimal image of the
    /// first. Not drawn above [`MAX_PARTICLES_WITH_CONTACTS`] particles.
    pub contacts: Vec<[[f64; 2]; 2]>,
    /// Text under the figure, broken into lines to fit; the same markup as `value_name`.
    pub caption: String,
}

impl Packing {
    /// The figure as an SVG document.
    ///
    /// Particles outside the box are drawn paler, in a small margin. Outlines that are not finite
    /// or reach over many boxes are left out; a box without area gives the caption only.
    pub fn to_svg(&self) -> String {
        let mut body = String::new();
        let (mut width, mut height) = (BOX_SIZE / 2.0, 0.0_f64);
        if let Some(view) = View::new(self.cell, self.part, self.margin()) {
            let scale = ColourScale::of(&self.values);
            body += &self.draw_box(&view, &scale);
            let (bar, [right, bottom]) = draw_colour_bar(&scale, &self.value_name, &view);
            body += &bar;
            width = view.width.max(right);
            height = view.height.max(bottom) + 0.2 * FONT;
        }
        let caption = wrap(&self.caption, FONT, width);
        for line in &caption {
            height += 1.4 * FONT;
            body += &text([0.0, height], "start", FONT, line);
        }
        let descent = if caption.is_empty() { 0.0 } else { 0.3 * FONT };
        document(width, height + descent, GAP, &body)
    }

    /// The figure as a PNG image `width_px` pixels wide; the height follows from its shape.
    pub fn to_png(&self, width_px: u32) -> Result<Vec<u8>, PictureError> {
        rasterise(&self.to_svg(), width_px)
    }

    /// Width of the strip around the box in which neighbouring images are shown: about one
    /// particle, but small against the box.
    fn margin(&self) -> f64 {
        let side = self.part * area(self.cell).abs().sqrt();
        let (count, sum) = (self.outlines.iter().filter_map(bounding_circle))
            .fold((0.0, 0.0), |(n, s), (_, radius)| (n + 1.0, s + 2.0 * radius));
        if count == 0.0 { 0.02 * side } else { (0.75 * sum / count).max(0.012 * side).min(MARGIN * side) }
    }

    /// Particles and contacts in all visible images, the veil over the outside and the box.
    fn draw_box(&self, view: &View, scale: &ColourScale) -> String {
        let inside = view.parallelogram(0.0);
        let visible = view.parallelogram(view.margin);
        // Same name, same region: several figures can share one HTML page.
        let clip = format!("view{:x}", hash(&visible));
        let line = self.line_width(view);
        let mut svg =
            format!("<clipPath id=\"{clip}\"><path d=\"{visible}\"/></clipPath>\n<g clip-path=\"url(#{clip})\">\n");
        let _ = writeln!(
            svg,
            "<g stroke=\"#222\" stroke-width=\"{}\" stroke-linejoin=\"round\" fill-opacity=\"{FILL_OPACITY}\">",
            num(line)
        );
        for (colour, shapes) in self.shapes_by_colour(view, scale) {
            let _ = writeln!(svg, "<g fill=\"{}\">{shapes}</g>", hex(colour));
        }
        svg += "</g>\n";
        let is_inside = |(center, _): &(Point, f64)| !view.image_shifts(*center, 0.0).is_empty();
        let shown = self.outlines.iter().filter_map(bounding_circle).filter(is_inside).count();
        if shown <= MAX_PARTICLES_WITH_CONTACTS && !self.contacts.is_empty() {
            let _ = writeln!(
                svg,
                "<path d=\"{}\" fill=\"none\" stroke=\"#111\" stroke-width=\"{}\" stroke-linecap=\"round\"/>",
                self.contact_path(view),
                num(1.3 * line)
            );
        }
        let _ = write!(
            svg,
            "<path d=\"{visible}{inside}\" fill=\"#fff\" fill-opacity=\"{VEIL_OPACITY}\" fill-rule=\"evenodd\"/>\n</g>\n\
             <path d=\"{inside}\" fill=\"none\" stroke=\"#000\" stroke-width=\"2.4\" stroke-linejoin=\"miter\"/>\n"
        );
        svg
    }

    /// Every visible image of every particle as SVG elements, collected by colour.
    fn shapes_by_colour(&self, view: &View, scale: &ColourScale) -> BTreeMap<Colour, String> {
        let mut groups: BTreeMap<Colour, String> = BTreeMap::new();
        for (i, outline) in self.outlines.iter().enumerate() {
            let Some((center, radius)) = bounding_circle(outline) else {
                continue;
            };
            let shifts = view.image_shifts(center, radius + view.margin);
            if shifts.is_empty() {
                continue;
            }
            let value = self.values.get(i).copied().unwrap_or(f64::NAN);
            let group = groups.entry(scale.colour(value)).or_default();
            let shape = Shape::new(outline, view);
            for shift in shifts {
                *group += &shape.element(view, shift);
            }
        }
        groups
    }

    /// All visible images of all contacts as the data of one path.
    fn contact_path(&self, view: &View) -> String {
        let mut data = String::new();
        for &[from, to] in &self.contacts {
            let length = (to[0] - from[0]).hypot(to[1] - from[1]);
            let middle = [0.5 * (from[0] + to[0]), 0.5 * (from[1] + to[1])];
            if !(is_finite(middle) && length.is_finite()) {
                continue;
            }
            for shift in view.image_shifts(middle, 0.5 * length + view.margin) {
                let mut pen = Pen::at(view.to_drawing(add(from, shift)));
                pen.line_to(view.to_drawing(add(to, shift)));
                let _ = write!(data, "M{}{}", pair(pen.start), pen.data);
            }
        }
        data
    }

    /// Width of the outlines: thin against the particles, but not below what shows.
    fn line_width(&self, view: &View) -> f64 {
        let mut radii: Vec<f64> =
            (self.outlines.iter().filter_map(bounding_circle)).map(|(_, radius)| radius * view.scale).collect();
        radii.sort_by(f64::total_cmp);
        let median = radii.get(radii.len() / 2).copied().unwrap_or(BOX_SIZE);
        (0.045 * median).clamp(0.12, 1.6)
    }
}

// ---------------------------------------------------------------------------------------------
// Geometry of the periodic box
// ---------------------------------------------------------------------------------------------

/// Map from the box to the drawing: `y` points up in the box and down in the drawing.
struct View {
    /// What is framed: the box, or a part of it.
    cell: [Point; 2],
    part: f64,
    margin: f64,
    scale: f64,
    /// Left and top of the visible region, in units of length.
    corner: Point,
    /// Size of the visible region, in user units.
    width: f64,
    height: f64,
}

impl View {
    /// `None` if the box has no area, or next to none.
    fn new(cell: [Point; 2], part: f64, margin: f64) -> Option<Self> {
        let cell = upright(cell).map(|edge| scaled(edge, part));
        let usable = is_finite(cell[0]) && is_finite(cell[1]) && area(cell) != 0.0;
        let mut view = View { cell, part, margin, scale: 1.0, corner: [0.0, 0.0], width: 0.0, height: 0.0 };
        let corners = view.corners(margin);
        let bound = |axis: usize, pick: fn(f64, f64) -> f64, start| corners.iter().map(|p| p[axis]).fold(start, pick);
        let (left, right) = (bound(0, f64::min, f64::INFINITY), bound(0, f64::max, f64::NEG_INFINITY));
        let (bottom, top) = (bound(1, f64::min, f64::INFINITY), bound(1, f64::max, f64::NEG_INFINITY));
        view.scale = BOX_SIZE / (right - left).max(top - bottom);
        view.corner = [left, top];
        view.width = (right - left) * view.scale;
        view.height = (top - bottom) * view.scale;
        let drawable = view.scale.is_finite() && view.width.min(view.height) > BOX_SIZE / MAX_ASPECT;
        (usable && drawable).then_some(view)
    }

    fn to_drawing(&self, p: Point) -> Point {
        [(p[0] - self.corner[0]) * self.scale, (self.corner[1] - p[1]) * self.scale]
    }

    /// Corners of the box with its edges moved outwards by `margin`.
    fn corners(&self, margin: f64) -> [Point; 4] {
        let [e1, e2] = fractional_reach(self.cell, margin);
        [[-e1, -e2], [1.0 + e1, -e2], [1.0 + e1, 1.0 + e2], [-e1, 1.0 + e2]].map(|s| lattice(self.cell, s))
    }

    fn parallelogram(&self, margin: f64) -> String {
        let corners = self.corners(margin).map(|p| pair(self.to_drawing(p)));
        format!("M{}Z", corners.join("L"))
    }

    /// Lattice vectors that bring a circle of radius `reach` around `center` into the frame; none for a circle many times
    /// its size.
    fn image_shifts(&self, center: Point, reach: f64) -> Vec<Point> {
        let [a1, a2] = self.cell;
        // in units of what is framed, like all that follows
        let s = [
            (center[0] * a2[1] - center[1] * a2[0]) / area(self.cell),
            (center[1] * a1[0] - center[0] * a1[1]) / area(self.cell),
        ];
        let extent = fractional_reach(self.cell, reach);
        let period = 1.0 / self.part;
        // Damaged data: images without end, or positions lost in rounding.
        if !(extent.iter().all(|&e| e < MAX_BOXES) && s.iter().all(|x| x.abs() < 1e9)) {
            return Vec::new();
        }
        let range = |axis: usize| {
            let first = ((-s[axis] - extent[axis]) / period).ceil();
            let last = ((1.0 - s[axis] + extent[axis]) / period).floor();
            (0..=(last - first) as i64).map(move |n| (first + n as f64) * period) // of a part maybe none
        };
        let mut shifts = Vec::new();
        for n1 in range(0) {
            for n2 in range(1) {
                let image = [s[0] + n1, s[1] + n2];
                if distance_to_box(self.cell, image) <= reach {
                    shifts.push(lattice(self.cell, [n1, n2]));
                }
            }
        }
        shifts
    }
}

/// The same lattice with a tilt of at most one box length; a box sheared further would be drawn
/// as a sliver.
fn upright([a1, a2]: [Point; 2]) -> [Point; 2] {
    if a1[1] == 0.0 && a2[0].abs() > a1[0].abs() {
        let turns = (a2[0] / a1[0]).round();
        [a1, [a2[0] - turns * a1[0], a2[1]]]
    } else {
        [a1, a2]
    }
}

fn area([a1, a2]: [Point; 2]) -> f64 {
    a1[0] * a2[1] - a1[1] * a2[0]
}

/// The point `s1 a1 + s2 a2`.
fn lattice([a1, a2]: [Point; 2], s: Point) -> Point {
    [s[0] * a1[0] + s[1] * a2[0], s[0] * a1[1] + s[1] * a2[1]]
}

/// A distance `reach` normal to the box edges, in units of the box vectors.
fn fractional_reach([a1, a2]: [Point; 2], reach: f64) -> Point {
    let area = area([a1, a2]).abs();
    [reach * a2[0].hypot(a2[1]) / area, reach * a1[0].hypot(a1[1]) / area]
}

/// Distance of the point with box coordinates `s` from the box, zero inside.
fn distance_to_box(cell: [Point; 2], s: Point) -> f64 {
    if s.iter().all(|x| (0.0..=1.0).contains(x)) {
        return 0.0;
    }
    let corners = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]].map(|c| lattice(cell, c));
    let p = lattice(cell, s);
    (0..4).map(|i| distance_to_segment(p, corners[i], corners[(i + 1) % 4])).fold(f64::INFINITY, f64::min)
}

fn distance_to_segment(p: Point, from: Point, to: Point) -> f64 {
    let d = sub(to, from);
    let along = dot(sub(p, from), d) / dot(d, d);
    let foot = add(from, scaled(d, along.clamp(0.0, 1.0)));
    let gap = sub(p, foot);
    gap[0].hypot(gap[1])
}

/// A circle that holds the particle; `None` if the outline is empty or not finite.
fn bounding_circle(outline: &Outline) -> Option<(Point, f64)> {
    let (center, radius) = match outline {
        Outline::Disk { center, diameter } => (*center, 0.5 * diameter),
        Outline::RoundedPolygon { vertices, width } => {
            let sum = vertices.iter().fold([0.0, 0.0], |sum, &v| add(sum, v));
            let center = scaled(sum, 1.0 / vertices.len() as f64);
            let far = (vertices.iter().map(|&v| sub(v, center))).map(|d| d[0].hypot(d[1])).fold(0.0, f64::max);
            (center, far + 0.5 * width.max(0.0))
        }
    };
    (is_finite(center) && radius.is_finite() && radius > 0.0).then_some((center, radius))
}

// ---------------------------------------------------------------------------------------------
// Outlines as SVG elements
// ---------------------------------------------------------------------------------------------

/// A particle ready to be stamped at each of its images.
enum Shape {
    Disk {
        center: Point,
        radius: f64,
    },
    /// Path data relative to `start`, in user units; `anchor` is `start` in the unshifted image.
    Path {
        anchor: Point,
        data: String,
    },
}

impl Shape {
    fn new(outline: &Outline, view: &View) -> Self {
        match outline {
            Outline::Disk { center, diameter } => Shape::Disk { center: *center, radius: 0.5 * diameter * view.scale },
            Outline::RoundedPolygon { vertices, width } => {
                let drawn: Vec<Point> = vertices.iter().map(|&v| view.to_drawing(v)).collect();
                let radius = 0.5 * width.max(0.0) * view.scale;
                let pen = rounded_polygon(&drawn, radius);
                Shape::Path { anchor: pen.start, data: pen.data }
            }
        }
    }

    /// The SVG element of the image displaced by the lattice vector `shift`.
    fn element(&self, view: &View, shift: Point) -> String {
        match self {
            Shape::Disk { center, radius } => {
                let [x, y] = view.to_drawing(add(*center, shift));
                format!("<circle cx=\"{}\" cy=\"{}\" r=\"{}\"/>", num(x), num(y), num(*radius))
            }
            Shape::Path { anchor, data } => {
                let moved = [shift[0] * view.scale, -shift[1] * view.scale];
                format!("<path d=\"M{}{data}z\"/>", pair(add(*anchor, moved)))
            }
        }
    }
}

/// Boundary of a polygon (user units) dilated by `radius`: edges moved outwards, joined by an
/// arc where the polygon is convex and by their intersection where it is not, or where the arc
/// would be too short to see.
fn rounded_polygon(vertices: &[Point], radius: f64) -> Pen {
    let corners = oriented(vertices);
    let n = corners.len();
    if n < 2 {
        return circle(corners.first().copied().unwrap_or_default(), radius);
    }
    let normal = |i: usize| {
        let d = sub(corners[(i + 1) % n], corners[i]);
        scaled([d[1], -d[0]], 1.0 / d[0].hypot(d[1]))
    };
    let mut pen: Option<Pen> = None;
    for (i, &corner) in corners.iter().enumerate() {
        let (before, after) = (normal((i + n - 1) % n), normal(i));
        let turn = before[0] * after[1] - before[1] * after[0];
        let cosine = dot(before, after);
        let [first, last] = [before, after].map(|m| add(corner, scaled(m, radius)));
        let chord = sub(last, first);
        let (notch, flat) = (turn < -1e-9, chord[0].hypot(chord[1]) < 0.25);
        // The intersection runs away at sharp corners; a turn through 180 degrees is the round
        // end of a line.
        if (notch || flat) && cosine > -0.8 {
            let shift = scaled(add(before, after), radius / (1.0 + cosine));
            draw_to(&mut pen, add(corner, shift));
            continue;
        }
        draw_to(&mut pen, first);
        match pen.as_mut() {
            Some(pen) if !notch => pen.arc_to(last, radius),
            _ => draw_to(&mut pen, last),
        }
    }
    pen.unwrap_or_else(|| Pen::at([0.0, 0.0]))
}

fn draw_to(pen: &mut Option<Pen>, p: Point) {
    match pen {
        Some(pen) => pen.line_to(p),
        None => *pen = Some(Pen::at(p)),
    }
}

fn circle(center: Point, radius: f64) -> Pen {
    let mut pen = Pen::at([center[0] - radius, center[1]]);
    pen.arc_to([center[0] + radius, center[1]], radius);
    pen.arc_to([center[0] - radius, center[1]], radius);
    pen
}

/// The vertices without repetitions, in the sense for which `(dy, -dx)` points outwards.
fn oriented(vertices: &[Point]) -> Vec<Point> {
    let mut corners = vertices.to_vec();
    corners.dedup_by(|a, b| rounded(*a) == rounded(*b));
    while corners.len() > 1 && corners.first().map(|&p| rounded(p)) == corners.last().map(|&p| rounded(p)) {
        corners.pop();
    }
    let n = corners.len();
    let twice_area: f64 = (0..n).map(|i| area([corners[i], corners[(i + 1) % n]])).sum();
    if twice_area < 0.0 {
        corners.reverse();
    }
    corners
}

/// Writes relative path data. It moves on rounded positions, so rounding errors do not add up
/// along an outline.
pub(super) struct Pen {
    pub(super) start: Point,
    now: Point,
    pub(super) data: String,
}

impl Pen {
    pub(super) fn at(p: Point) -> Self {
        let start = rounded(p);
        Pen { start, now: start, data: String::new() }
    }

    pub(super) fn line_to(&mut self, p: Point) {
        self.write("l", "", p);
    }

    /// An arc in the sense of growing angle.
    fn arc_to(&mut self, p: Point, radius: f64) {
        let r = num(radius);
        self.write("a", &format!("{r} {r} 0 0 1 "), p);
    }

    fn write(&mut self, command: &str, arguments: &str, p: Point) {
        let next = rounded(p);
        if next != self.now {
            self.data += command;
            self.data += arguments;
            self.data += &pair(sub(next, self.now));
            self.now = next;
        }
    }
}

// ---------------------------------------------------------------------------------------------
// Colours
// ---------------------------------------------------------------------------------------------

/// How values become colours.
#[derive(Debug, PartialEq)]
enum ColourScale {
    /// No finite value at all.
    Undefined,
    Constant {
        value: f64,
        gaps: bool,
    },
    /// Small integers, e.g. contact numbers.
    Discrete {
        first: i64,
        last: i64,
        gaps: bool,
    },
    /// From `low` to `high`, both multiples of `step`.
    Continuous {
        low: f64,
        high: f64,
        gaps: bool,
    },
}

impl ColourScale {
    fn of(values: &[f64]) -> Self {
        let finite = || values.iter().copied().filter(|v| v.is_finite());
        let gaps = finite().count() < values.len();
        let min = finite().fold(f64::INFINITY, f64::min);
        let max = finite().fold(f64::NEG_INFINITY, f64::max);
        let span = max - min;
        if finite().next().is_none() || !span.is_finite() {
            return ColourScale::Undefined;
        }
        // Differences at the level of rounding are no contrast.
        if span <= 1e-12 * min.abs().max(max.abs()) {
            return ColourScale::Constant { value: min, gaps };
        }
        let integers = max.abs().max(min.abs()) < 1e6 && finite().all(|v| v == v.round());
        if integers && (span as i64) < MAX_DISCRETE_LEVELS {
            let (first, last) = (min as i64, max as i64);
            return ColourScale::Discrete { first, last, gaps };
        }
        // Ending on ticks makes the ends of the colour bar readable.
        let step = tick_step(span, 5.0);
        ColourScale::Continuous { low: (min / step).floor() * step, high: (max / step).ceil() * step, gaps }
    }

    fn colour(&self, value: f64) -> Colour {
        if !value.is_finite() {
            return GREY_UNDEFINED;
        }
        match *self {
            ColourScale::Undefined => GREY_UNDEFINED,
            ColourScale::Constant { .. } => GREY_CONSTANT,
            ColourScale::Discrete { first, last, .. } => viridis((value - first as f64) / (last - first) as f64),
            ColourScale::Continuous { low, high, .. } => {
                let level = COLOUR_LEVELS - 1.0;
                viridis(((value - low) / (high - low) * level).round() / level)
            }
        }
    }

    /// Whether the labels of the colour bar share a power of ten.
    fn has_factor(&self) -> bool {
        match *self {
            ColourScale::Continuous { low, high, .. } => linear_ticks(low, high, 5.0).factor.is_some(),
            _ => false,
        }
    }

    /// Whether some particle has no value.
    fn gaps(&self) -> bool {
        match *self {
            ColourScale::Undefined => false,
            ColourScale::Constant { gaps, .. }
            | ColourScale::Discrete { gaps, .. }
            | ColourScale::Continuous { gaps, .. } => gaps,
        }
    }
}

/// The viridis colour map at `t` in 0..1.
fn viridis(t: f64) -> Colour {
    const TABLE: [u32; 17] = [
        0x440154, 0x48186a, 0x472d7b, 0x424086, 0x3b528b, 0x33638d, 0x2c728e, 0x26828e, 0x21918c, 0x1fa088, 0x28ae80,
        0x3fbc73, 0x5ec962, 0x84d44b, 0xaddc30, 0xd8e219, 0xfde725,
    ];
    let at = t.clamp(0.0, 1.0) * (TABLE.len() - 1) as f64;
    let i = (at as usize).min(TABLE.len() - 2);
    let mix = at - i as f64;
    [16, 8, 0].map(|bits| {
        let [a, b] = [TABLE[i], TABLE[i + 1]].map(|c| f64::from((c >> bits) & 0xff));
        (a + mix * (b - a)).round() as u8
    })
}

fn hex([r, g, b]: Colour) -> String {
    format!("#{r:02x}{g:02x}{b:02x}")
}

/// The colour bar to the right of the box, and how far right and down it reaches.
fn draw_colour_bar(scale: &ColourScale, name: &str, view: &View) -> (String, Point) {
    let mut bar = Bar {
        left: view.width + GAP,
        svg: format!("<g fill-opacity=\"{FILL_OPACITY}\">\n"),
        labels: String::new(),
        label_width: 0.0,
    };
    // Single letters are mistaken for others when they are turned, z for N: they stand on top.
    let upright_name = text_width(name, FONT) < 2.0 * FONT;
    // Room for name and power of ten above the bar and for the grey block below it.
    let factor_row = if scale.has_factor() { Bar::ROW } else { 0.0 };
    let above = factor_row + if upright_name { Bar::ROW } else { 0.0 };
    let below = if scale.gaps() { 2.0 * Bar::WIDTH } else { 0.0 };
    let length = (view.height - above - below).clamp(220.0, 700.0);
    let top = above + (0.5 * (view.height - above - length - below)).max(0.0);
    let bottom = top + length;
    let middle = 0.5 * (top + bottom);
    let start = match *scale {
        ColourScale::Undefined => return (String::new(), [0.0, 0.0]),
        ColourScale::Constant { value, .. } => {
            let start = middle - 0.5 * Bar::WIDTH;
            bar.block(start, Bar::WIDTH, GREY_CONSTANT, &number(value));
            start
        }
        ColourScale::Discrete { first, last, .. } => {
            let count = (last - first + 1) as f64;
            let height = (length / count).min(60.0);
            let start = middle - 0.5 * height * count;
            for level in first..=last {
                let y = start + (last - level) as f64 * height;
                let label = number(level as f64);
                bar.block(y, height, scale.colour(level as f64), &label);
            }
            start
        }
        ColourScale::Continuous { low, high, .. } => {
            bar.gradient(low, high, top, bottom);
            top
        }
    };
    let mut right = bar.right();
    if upright_name {
        let at = [bar.left, start - factor_row - Bar::LIFT];
        bar.labels += &text(at, "start", FONT, name);
    } else {
        bar.labels += &text_upwards([right + 1.25 * FONT, middle], FONT, name);
        right += 1.6 * FONT;
    }
    if scale.gaps() {
        bar.block(bottom + Bar::WIDTH, Bar::WIDTH, GREY_UNDEFINED, "no value");
        right = right.max(bar.right());
    }
    let svg = format!("{}</g>\n{}", bar.svg, bar.labels);
    (svg, [right, bottom + below])
}

/// A colour bar being drawn.
struct Bar {
    left: f64,
    svg: String,
    labels: String,
    label_width: f64,
}

impl Bar {
    const WIDTH: f64 = 32.0;
    const TICK: f64 = 14.0;
    /// Height of a line of text above the bar, and of its baseline over what is below.
    const ROW: f64 = 1.5 * FONT;
    const LIFT: f64 = 0.7 * FONT;

    /// Right end of the labels.
    fn right(&self) -> f64 {
        self.left + Self::WIDTH + Self::TICK + self.label_width
    }

    /// A block of one colour with its label.
    fn block(&mut self, y: f64, height: f64, colour: Colour, label: &str) {
        self.rectangle(y, height, &hex(colour));
        self.label(y + 0.5 * height, label);
    }

    fn rectangle(&mut self, y: f64, height: f64, fill: &str) {
        let _ = writeln!(
            self.svg,
            "<rect x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\" fill=\"{fill}\" stroke=\"#000\" stroke-width=\"1.4\"/>",
            num(self.left),
            num(y),
            num(Self::WIDTH),
            num(height)
        );
    }

    fn label(&mut self, y: f64, label: &str) {
        let x = self.left + Self::WIDTH + Self::TICK;
        self.labels += &text([x, y + 0.36 * FONT], "start", FONT, label);
        self.label_width = self.label_width.max(text_width(label, FONT));
    }

    fn gradient(&mut self, low: f64, high: f64, top: f64, bottom: f64) {
        self.svg += "<linearGradient id=\"viridis\" x1=\"0\" y1=\"1\" x2=\"0\" y2=\"0\">";
        for stop in 0..=16 {
            let t = f64::from(stop) / 16.0;
            let _ = write!(self.svg, "<stop offset=\"{}\" stop-color=\"{}\"/>", num(t), hex(viridis(t)));
        }
        self.svg += "</linearGradient>\n";
        self.rectangle(top, bottom - top, "url(#viridis)");
        let ticks = linear_ticks(low, high, 5.0);
        for (value, label) in &ticks.major {
            let y = bottom - (value - low) / (high - low) * (bottom - top);
            let x = self.left + Self::WIDTH;
            let _ = writeln!(self.svg, "<path d=\"M{}h7\" stroke=\"#000\" stroke-width=\"1.4\"/>", pair([x, y]));
            self.label(y, label);
        }
        if let Some(factor) = ticks.factor {
            let at = [self.left, top - Self::LIFT];
            self.labels += &text(at, "start", FONT, &factor);
            self.label_width = self.label_width.max(text_width(&factor, FONT) - Self::WIDTH);
        }
    }
}

// ---------------------------------------------------------------------------------------------
// Points
// ---------------------------------------------------------------------------------------------

fn add(a: Point, b: Point) -> Point {
    [a[0] + b[0], a[1] + b[1]]
}

fn sub(a: Point, b: Point) -> Point {
    [a[0] - b[0], a[1] - b[1]]
}

fn scaled(a: Point, factor: f64) -> Point {
    [a[0] * factor, a[1] * factor]
}

fn dot(a: Point, b: Point) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

fn is_finite(p: Point) -> bool {
    p[0].is_finite() && p[1].is_finite()
}

/// To the hundredth of a user unit, the precision of the file.
fn rounded(p: Point) -> Point {
    p.map(|x| (100.0 * x).round() / 100.0)
}

fn hash(data: &str) -> u64 {
    let mut hasher = DefaultHasher::new();
    data.hash(&mut hasher);
    hasher.finish()
}

// ---------------------------------------------------------------------------------------------
// SVG toolkit, shared with the plots
// ---------------------------------------------------------------------------------------------

/// A number for the SVG file: two digits after the point, in as few characters as possible.
pub(super) fn num(x: f64) -> String {
    let fixed = format!("{x:.2}");
    let trimmed = fixed.trim_end_matches('0').trim_end_matches('.');
    match trimmed {
        "-0" | "0" => "0".to_owned(),
        other => match other.strip_prefix("-0.") {
            Some(digits) => format!("-.{digits}"),
            None => other.strip_prefix('0').unwrap_or(other).to_owned(),
        },
    }
}

/// A point for path data; a sign or a second decimal point serves as the separator.
pub(super) fn pair([x, y]: Point) -> String {
    let (x, y) = (num(x), num(y));
    let joined = y.starts_with('-') || (y.starts_with('.') && x.contains('.'));
    let separator = if joined { "" } else { " " };
    format!("{x}{separator}{y}")
}

/// A whole SVG document on white, `width` times `height` user units plus `border` on each side.
pub(super) fn document(width: f64, height: f64, border: f64, body: &str) -> String {
    let (full_width, full_height) = (width + 2.0 * border, height + 2.0 * border);
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{w}\" height=\"{h}\" viewBox=\"{x} {x} {w} {h}\" \
         font-family=\"DejaVu Sans,Verdana,Arial,Helvetica,sans-serif\">\n\
         <rect x=\"{x}\" y=\"{x}\" width=\"{w}\" height=\"{h}\" fill=\"#fff\"/>\n{body}</svg>\n",
        w = num(full_width),
        h = num(full_height),
        x = num(-border),
    )
}

/// The document with `key` in front of all names inside it: names are global to the page or document that holds it.
pub fn with_names(svg: &str, key: &str) -> String {
    let key: String = key.chars().filter(char::is_ascii_alphanumeric).collect();
    svg.replace(" id=\"", &format!(" id=\"n{key}-")).replace("url(#", &format!("url(#n{key}-"))
}

/// Several documents side by side in rows of `columns`, all of them as wide as the widest.
pub(super) fn side_by_side(svgs: &[&str], columns: usize) -> Result<String, PictureError> {
    let mut sizes = Vec::new();
    for svg in svgs {
        let size = parse(svg)?.size();
        sizes.push([f64::from(size.width()), f64::from(size.height())]);
    }
    let columns = columns.clamp(1, svgs.len().max(1));
    let cell = sizes.iter().fold([0.0; 2], |most: [f64; 2], s| [most[0].max(s[0]), most[1].max(s[1])]);
    let mut body = String::new();
    for (k, svg) in svgs.iter().enumerate() {
        let at = [(k % columns) as f64 * cell[0], (k / columns) as f64 * cell[1]];
        let place = format!("<svg x=\"{}\" y=\"{}\" xmlns=", num(at[0]), num(at[1]));
        body += &with_names(svg, &k.to_string()).replacen("<svg xmlns=", &place, 1);
    }
    let rows = svgs.len().div_ceil(columns);
    Ok(document(columns as f64 * cell[0], rows as f64 * cell[1], 0.0, &body))
}

/// A line of text with its baseline at `at`; `anchor` is `start`, `middle` or `end`.
pub(super) fn text(at: Point, anchor: &str, size: f64, content: &str) -> String {
    text_element(at, anchor, size, "", content)
}

/// A line of text that reads upwards, centred on `at`, its baseline to the right of the letters.
pub(super) fn text_upwards(at: Point, size: f64, content: &str) -> String {
    let turn = format!(" transform=\"rotate(-90 {} {})\"", num(at[0]), num(at[1]));
    text_element(at, "middle", size, &turn, content)
}

fn text_element([x, y]: Point, anchor: &str, size: f64, more: &str, content: &str) -> String {
    format!(
        "<text x=\"{}\" y=\"{}\" font-size=\"{}\" text-anchor=\"{anchor}\"{more}>{}</text>\n",
        num(x),
        num(y),
        num(size),
        markup(content, size)
    )
}

/// Text content as XML, with `_{..}` and `^{..}` turned into sub- and superscripts.
fn markup(content: &str, size: f64) -> String {
    let mut xml = String::new();
    let mut rest = content;
    // `dy` moves all the text that follows it, so each piece undoes the shift of the one before.
    let mut shifted = 0.0;
    while let Some((plain, mark, script, after)) = next_script(rest) {
        xml += &piece(plain, -shifted, size);
        if !plain.is_empty() {
            shifted = 0.0;
        }
        let shift = if mark == '^' { -0.36 } else { 0.22 } * size;
        xml += &piece(script, shift - shifted, 0.7 * size);
        if !script.is_empty() {
            shifted = shift;
        }
        rest = after;
    }
    xml + &piece(rest, -shifted, size)
}

fn piece(content: &str, dy: f64, size: f64) -> String {
    if content.is_empty() {
        return String::new();
    }
    format!("<tspan dy=\"{}\" font-size=\"{}\">{}</tspan>", num(dy), num(size), escape(content))
}

/// The text before the next script, `_` or `^`, the script, and the text after it.
fn next_script(content: &str) -> Option<(&str, char, &str, &str)> {
    let start = [content.find("_{"), content.find("^{")].into_iter().flatten().min()?;
    let mark = content[start..].chars().next()?;
    let (script, after) = content[start + 2..].split_once('}')?;
    Some((&content[..start], mark, script, after))
}

/// Text made safe for XML; characters that XML does not allow become blanks.
fn escape(content: &str) -> String {
    let mut safe = String::with_capacity(content.len());
    for c in content.chars() {
        match c {
            '&' => safe += "&amp;",
            '<' => safe += "&lt;",
            '>' => safe += "&gt;",
            '\u{fffe}' | '\u{ffff}' => safe.push(' '),
            c if c.is_control() => safe.push(' '),
            c => safe.push(c),
        }
    }
    safe
}

/// Advance width of a line of text in user units, measured by the engine that rasterises it.
pub(super) fn text_width(content: &str, size: f64) -> f64 {
    let svg = document(1.0, 1.0, 0.0, &text([0.0, 0.0], "start", size, content));
    let measure = |tree: usvg::Tree| {
        (tree.root().children().iter())
            .filter(|node| matches!(node, usvg::Node::Text(_)))
            .map(|node| f64::from(node.abs_bounding_box().right()))
            .fold(0.0, f64::max)
    };
    parse(&svg).map_or(0.6 * size * content.chars().count() as f64, measure)
}

/// Words broken into lines at most `width` wide; line breaks in the text are kept.
fn wrap(content: &str, size: f64, width: f64) -> Vec<String> {
    let mut lines = Vec::new();
    for paragraph in content.trim().lines() {
        let mut line = String::new();
        for word in paragraph.split_whitespace() {
            let longer = if line.is_empty() { word.to_owned() } else { format!("{line} {word}") };
            if line.is_empty() || text_width(&longer, size) <= width {
                line = longer;
            } else {
                lines.push(std::mem::replace(&mut line, word.to_owned()));
            }
        }
        lines.push(line);
    }
    lines
}

fn parse(svg: &str) -> Result<usvg::Tree, usvg::Error> {
    static FONTS: LazyLock<Arc<usvg::fontdb::Database>> = LazyLock::new(|| {
        let mut fonts = usvg::fontdb::Database::new();
        let sans: &'static [u8] = dejavu::sans::regular();
        fonts.load_font_source(usvg::fontdb::Source::Binary(Arc::new(sans)));
        Arc::new(fonts)
    });
    let options =
        usvg::Options { font_family: "DejaVu Sans".to_owned(), fontdb: FONTS.clone(), ..usvg::Options::default() };
    usvg::Tree::from_str(svg, &options)
}

/// The SVG document as a PNG image `width_px` pixels wide.
pub(super) fn rasterise(svg: &str, width_px: u32) -> Result<Vec<u8>, PictureError> {
    let tree = parse(svg)?;
    let zoom = width_px as f32 / tree.size().width();
    let height = (tree.size().height() * zoom).ceil() as u32;
    // The encoder's buffers are of the size of the picture; one side is limited to keep a
    // mistyped width from taking all the memory of the machine.
    let too_large = width_px.max(height) > 32_768;
    let mut pixels = (!too_large)
        .then(|| tiny_skia::Pixmap::new(width_px, height))
        .flatten()
        .ok_or(PictureError::Size { width: width_px, height })?;
    pixels.fill(tiny_skia::Color::WHITE);
    let transform = tiny_skia::Transform::from_scale(zoom, zoom);
    resvg::render(&tree, transform, &mut pixels.as_mut());
    pixels.encode_png().map_err(|error| PictureError::Png(error.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn documents_stand_side_by_side() {
        let square = |name: &str| document(10.0, 10.0, 0.0, &format!("<rect id=\"a\"/><use href=\"{name}\"/>"));
        let (a, b) = (square("one"), square("two"));
        let row = side_by_side(&[&a, &b, &a], 2).unwrap();
        let whole = usvg::roxmltree::Document::parse(&row).unwrap();
        assert_eq!(whole.root_element().attribute("width"), Some("20"));
        assert_eq!(whole.root_element().attribute("height"), Some("20"));
        assert!(row.contains("<svg x=\"10\" y=\"0\"") && row.contains("<svg x=\"0\" y=\"10\""));
        let names: Vec<&str> = whole.descendants().filter_map(|n| n.attribute("id")).collect();
        assert_eq!(names, ["n0-a", "n1-a", "n2-a"]);
        rasterise(&row, 40).unwrap();
    }

    #[test]
    fn a_part_shows_what_reaches_into_it() {
        // inside, far away, and beyond the corner of the box, where it reaches in through the periodic boundary
        let mut packing = disks(&[[2.0, 2.0], [8.0, 7.0], [9.8, 9.8]], SQUARE);
        let circles = |packing: &Packing| packing.to_svg().matches("<circle").count();
        let whole = circles(&packing);
        packing.part = 0.4;
        assert_eq!(circles(&packing), 2);
        assert!(whole > 2);
    }

    const SQUARE: [Point; 2] = [[10.0, 0.0], [0.0, 10.0]];

    fn disks(centers: &[Point], cell: [Point; 2]) -> Packing {
        let disk = |&center: &Point| Outline::Disk { center, diameter: 1.0 };
        Packing {
            cell,
            part: 1.0,
            outlines: centers.iter().map(disk).collect(),
            values: vec![3.0; centers.len()],
            value_name: "z".to_owned(),
            contacts: Vec::new(),
            caption: String::new(),
        }
    }

    fn images(packing: &Packing) -> usize {
        packing.to_svg().matches("<circle").count()
    }

    fn circle_centers(svg: &str) -> Vec<Point> {
        let document = usvg::roxmltree::Document::parse(svg).unwrap();
        let number = |node: usvg::roxmltree::Node, name| node.attribute(name).unwrap().parse::<f64>();
        (document.descendants().filter(|node| node.has_tag_name("circle")))
            .map(|node| [number(node, "cx").unwrap(), number(node, "cy").unwrap()])
            .collect()
    }

    fn pixels(png: &[u8]) -> tiny_skia::Pixmap {
        assert_eq!(&png[..8], b"\x89PNG\r\n\x1a\n");
        tiny_skia::Pixmap::decode_png(png).unwrap()
    }

    fn dark_pixels(png: &[u8]) -> usize {
        (pixels(png).pixels().iter()).filter(|p| p.red() < 80 && p.green() < 80 && p.blue() < 80).count()
    }

    #[test]
    fn particles_are_drawn_in_every_image_that_touches_the_box() {
        for cell in [SQUARE, [[10.0, 0.0], [3.0, 10.0]]] {
            assert_eq!(images(&disks(&[[0.0, 0.0]], cell)), 4, "across a corner");
            assert_eq!(images(&disks(&[[6.0, 0.1]], cell)), 2, "across an edge");
            assert_eq!(images(&disks(&[[6.5, 5.0]], cell)), 1, "inside");
            let far = lattice(cell, [7.0, -4.0]);
            assert_eq!(images(&disks(&[far], cell)), 4, "in a distant image");
        }
    }

    #[test]
    fn images_of_a_corner_particle_lie_on_the_corners_of_a_sheared_box() {
        let cell = [[10.0, 0.0], [3.0, 8.0]];
        let packing = disks(&[[0.0, 0.0]], cell);
        let view = View::new(cell, 1.0, packing.margin()).unwrap();
        let mut expected = view.corners(0.0).map(|p| rounded(view.to_drawing(p)));
        let mut drawn = circle_centers(&packing.to_svg());
        let by_place = |a: &Point, b: &Point| a.partial_cmp(b).unwrap();
        expected.sort_by(by_place);
        drawn.sort_by(by_place);
        assert_eq!(drawn, expected);
    }

    #[test]
    fn a_box_sheared_beyond_its_length_is_drawn_upright() {
        assert_eq!(upright([[2.0, 0.0], [5.5, 1.0]]), [[2.0, 0.0], [-0.5, 1.0]]);
        assert_eq!(upright([[2.0, 0.0], [1.5, 1.0]]), [[2.0, 0.0], [1.5, 1.0]]);
    }

    #[test]
    fn a_rounded_polygon_is_dilated_by_half_its_width_in_either_sense() {
        let notched = [[0.0, 0.0], [40.0, 0.0], [40.0, 30.0], [20.0, 10.0], [0.0, 30.0]];
        let reversed: Vec<Point> = notched.iter().rev().copied().collect();
        for vertices in [&notched[..], &reversed, &notched[..4], &notched[..2], &notched[..1]] {
            let pen = rounded_polygon(vertices, 5.0);
            let path = format!("<path d=\"M{}{}z\"/>", pair(pen.start), pen.data);
            let tree = parse(&document(100.0, 100.0, 0.0, &path)).unwrap();
            let drawn = tree.root().children()[1].bounding_box();
            let extent = |axis: usize, sign: f64| {
                (vertices.iter().map(|v| sign * v[axis])).fold(f64::NEG_INFINITY, f64::max) + 5.0
            };
            let found = [-drawn.left(), drawn.right(), -drawn.top(), drawn.bottom()];
            let expected = [extent(0, -1.0), extent(0, 1.0), extent(1, -1.0), extent(1, 1.0)];
            for (found, expected) in found.into_iter().zip(expected) {
                assert!((f64::from(found) - expected).abs() < 0.05, "{found} {expected}");
            }
        }
    }

    #[test]
    fn undefined_values_are_grey_and_others_are_not() {
        let scale = ColourScale::of(&[0.1, 0.7, f64::NAN]);
        assert_eq!(scale.colour(f64::NAN), GREY_UNDEFINED);
        assert_eq!(scale.colour(f64::INFINITY), GREY_UNDEFINED);
        assert_ne!(scale.colour(0.1), scale.colour(0.7));
        let grey = format!("<g fill=\"{}\"><circle", hex(GREY_UNDEFINED));
        let mut packing = disks(&[[3.0, 3.0], [7.0, 7.0]], SQUARE);
        packing.values = vec![1.0, 2.0];
        assert!(!packing.to_svg().contains(&grey));
        packing.values = vec![1.0, f64::NAN];
        assert!(packing.to_svg().contains(&grey));
        assert!(packing.to_svg().contains("no value"));
        packing.values = vec![1.0];
        assert!(packing.to_svg().contains(&grey), "missing value");
    }

    #[test]
    fn the_scale_suits_the_values() {
        let (first, last, gaps) = (2, 6, false);
        let contact_numbers = ColourScale::of(&[2.0, 6.0, 3.0]);
        assert_eq!(contact_numbers, ColourScale::Discrete { first, last, gaps });
        let (low, high) = (0.2, 1.0);
        let continuous = ColourScale::of(&[0.21, 0.97]);
        assert_eq!(continuous, ColourScale::Continuous { low, high, gaps });
        assert_eq!(continuous.colour(low), [0x44, 0x01, 0x54]);
        assert_eq!(continuous.colour(high), [0xfd, 0xe7, 0x25]);
        assert_eq!(ColourScale::of(&[0.5, 0.5]).colour(0.5), GREY_CONSTANT);
        assert_eq!(ColourScale::of(&[f64::NAN]), ColourScale::Undefined);
    }

    #[test]
    fn the_svg_is_well_formed_and_keeps_the_text() {
        let mut packing = disks(&[[0.0, 0.0]], SQUARE);
        packing.caption = "a < b & c ]]> \u{1}φ_{J} = 10^{−3}".to_owned();
        let svg = packing.to_svg();
        let document = usvg::roxmltree::Document::parse(&svg).unwrap();
        let words: String =
            (document.descendants()).filter(|node| node.is_text()).filter_map(|node| node.text()).collect();
        assert!(words.contains("a < b & c ]]>  φJ = 10−3"), "{words}");
    }

    #[test]
    fn contacts_are_drawn_up_to_the_stated_number_of_particles() {
        let contact = [[2.0, 2.0], [3.0, 2.0]];
        let mut packing = disks(&[[2.0, 2.0]], SQUARE);
        assert!(!packing.to_svg().contains("stroke-linecap"));
        packing.contacts = vec![contact];
        assert!(packing.to_svg().contains("stroke-linecap"));
        packing.outlines = vec![packing.outlines[0].clone(); MAX_PARTICLES_WITH_CONTACTS + 1];
        assert!(!packing.to_svg().contains("stroke-linecap"));
    }

    #[test]
    fn a_contact_across_an_edge_is_drawn_on_both_sides() {
        let mut packing = disks(&[], SQUARE);
        packing.contacts = vec![[[9.8, 5.0], [10.4, 5.0]]];
        let view = View::new(SQUARE, 1.0, packing.margin()).unwrap();
        assert_eq!(packing.contact_path(&view).matches('M').count(), 2);
    }

    #[test]
    fn the_png_shows_what_the_svg_says() {
        let mut packing = disks(&[[5.0, 5.0]], SQUARE);
        packing.values = vec![f64::NAN];
        let png = packing.to_png(300).unwrap();
        let image = pixels(&png);
        assert_eq!(image.width(), 300);
        let centre = image.pixel(150, 150).unwrap();
        let gap = image.pixel(80, 80).unwrap();
        assert_eq!((gap.red(), gap.green(), gap.blue()), (255, 255, 255));
        assert_eq!(centre.red(), centre.green());
        assert!(centre.red() < 245);
    }

    #[test]
    fn text_needs_no_installed_fonts() {
        let mut packing = disks(&[], SQUARE);
        packing.values = Vec::new();
        let without = dark_pixels(&packing.to_png(400).unwrap());
        packing.caption = "φ − φ_{J} ≥ 10^{−3} ± 1 × Å".to_owned();
        let with = dark_pixels(&packing.to_png(400).unwrap());
        assert!(with > without + 100, "{with} {without}");
        assert!(text_width("mm", 20.0) > 1.5 * text_width("ii", 20.0));
    }

    #[test]
    fn long_captions_are_broken() {
        let lines = wrap("one two three four five six seven", 20.0, 150.0);
        assert!(lines.len() > 1);
        assert!(lines.iter().all(|line| text_width(line, 20.0) <= 150.0));
        assert_eq!(lines.join(" "), "one two three four five six seven");
    }

    #[test]
    fn odd_data_give_a_picture_all_the_same() {
        let polygon = |vertices: Vec<Point>, width| Outline::RoundedPolygon { vertices, width };
        let mut packing = disks(&[[f64::NAN, 0.0], [1e300, -1e300], [5.0, 5.0]], SQUARE);
        packing.outlines.extend([
            polygon(Vec::new(), 1.0),
            polygon(vec![[1.0, 1.0]; 4], 0.0),
            polygon(vec![[1.0, 1.0], [f64::INFINITY, 2.0], [2.0, 2.0]], 0.1),
            polygon(vec![[1.0, 1.0], [2.0, 1.0], [1.0, 1.0], [2.0, 1.0]], -1.0),
            Outline::Disk { center: [1.0, 1.0], diameter: 1e12 },
            Outline::Disk { center: [1.0, 1.0], diameter: -1.0 },
        ]);
        packing.values = vec![1e308, -1e308, f64::NAN];
        packing.contacts = vec![[[f64::NAN; 2], [0.0, 0.0]], [[0.0, 0.0], [1e200, 0.0]]];
        let cells = [SQUARE, [[0.0; 2]; 2], [[f64::NAN; 2]; 2], [[1e-200, 0.0], [0.0, 1e200]]];
        for cell in cells {
            packing.cell = cell;
            let svg = packing.to_svg();
            assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
            packing.to_png(50).unwrap();
        }
    }

    #[test]
    fn impossible_sizes_are_errors() {
        let packing = disks(&[[0.0, 0.0]], SQUARE);
        assert!(matches!(packing.to_png(0), Err(PictureError::Size { width: 0, .. })));
        assert!(matches!(packing.to_png(1_000_000), Err(PictureError::Size { .. })));
    }

    #[test]
    fn numbers_are_short() {
        let cases = [(0.5, ".5"), (-0.25, "-.25"), (-0.001, "0"), (12.0, "12"), (100.0, "100")];
        for (value, expected) in cases {
            assert_eq!(num(value), expected);
        }
        assert_eq!(pair([0.5, 0.25]), ".5.25");
        assert_eq!(pair([1.0, -2.0]), "1-2");
        assert_eq!(pair([1.0, 0.5]), "1 .5");
    }
}
