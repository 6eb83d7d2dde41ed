//! Line and scatter plots for papers: one set of axes or a grid of lettered panels.
//!
//! Like the pictures of packings, a plot is an SVG document, and its PNG is that document
//! rasterised. Names and labels may contain `_{..}` and `^{..}` for sub- and superscripts.

use std::collections::BTreeSet;
use std::fmt::Write as _;

use super::picture::{Pen, PictureError, document, num, pair, rasterise, text, text_upwards, text_width};

/// Frame of one panel, in SVG user units.
const FRAME: [f64; 2] = [440.0, 330.0];
/// Height of the lettering of labels and titles, in user units.
const FONT: f64 = 18.0;
/// Height of the tick labels and the legend, in user units.
const SMALL_FONT: f64 = 15.5;
const MAJOR_TICK: f64 = 7.0;
const MINOR_TICK: f64 = 4.0;
/// Length of the sample of a line in the legend.
const HANDLE: f64 = 30.0;
/// White space around the figure.
const BORDER: f64 = 12.0;
/// Lines with more points than this have no markers.
const MAX_POINTS_WITH_MARKERS: usize = 40;
/// Larger values are left out: their differences would overflow.
const LARGEST: f64 = 1e300;
/// Colours by Okabe and Ito, which colour-blind readers can tell apart.
const COLOURS: [&str; 7] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000"];
/// Line styles; the next one is taken when the colours are used up.
const DASHES: [&str; 3] = ["", "9 4", "2 3.5"];

type Point = [f64; 2];

/// One data set of a plot.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Series {
    /// Name in the legend; an empty name has no entry.
    pub name: String,
    /// Points `[x, y]` in the order in which a line joins them. A point that is not finite, or
    /// not positive on a logarithmic axis, is left out and interrupts the line.
    pub points: Vec<[f64; 2]>,
    /// Half lengths of the error bars in `y`, one per point.
    pub error: Option<Vec<f64>>,
    /// Whether the points are joined by a line; otherwise they are drawn as markers.
    pub line: bool,
    /// How it looks; by its place among the series if this does not say.
    pub style: Option<Style>,
}

/// The look of a series. Numbers beyond the last one start again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Style {
    /// One of seven colours.
    pub colour: usize,
    /// Disk, square, triangle, diamond, inverted triangle; a bare line has none.
    pub marker: Option<usize>,
    /// Full, dashed or dotted line.
    pub dash: usize,
}

/// One set of axes with its data.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Axes {
    /// Title above the frame; may be empty.
    pub title: String,
    /// Label of the horizontal axis.
    pub x_label: String,
    /// Label of the vertical axis.
    pub y_label: String,
    /// Logarithmic horizontal axis.
    pub log_x: bool,
    /// Logarithmic vertical axis.
    pub log_y: bool,
    /// The data; with none the frame is empty.
    pub series: Vec<Series>,
}

impl Axes {
    /// The plot as an SVG document.
    pub fn to_svg(&self) -> String {
        panels(std::slice::from_ref(self), 1).to_svg()
    }

    /// The plot as a PNG image `width_px` pixels wide.
    pub fn to_png(&self, width_px: u32) -> Result<Vec<u8>, PictureError> {
        panels(std::slice::from_ref(self), 1).to_png(width_px)
    }
}

/// Several plots in one figure; see [`panels`].
#[derive(Debug, Clone, Copy)]
pub struct Panels<'a> {
    axes: &'a [Axes],
    columns: usize,
}

/// A figure of several plots in rows of `columns`, lettered (a), (b), ... if there are several.
pub fn panels(axes: &[Axes], columns: usize) -> Panels<'_> {
    let columns = columns.clamp(1, axes.len().max(1));
    Panels { axes, columns }
}

impl Panels<'_> {
    /// The figure as an SVG document.
    pub fn to_svg(&self) -> String {
        let plots: Vec<Plot> =
            (self.axes.iter().enumerate()).map(|(i, axes)| Plot::new(axes, self.letter(i))).collect();
        // The same margins everywhere, so that the frames line up.
        let [left, right, top, bottom] = (plots.iter().map(Plot::margins))
            .fold([0.0; 4], |widest, own| std::array::from_fn(|side| f64::max(widest[side], own[side])));
        let cell = [left + FRAME[0] + right, top + FRAME[1] + bottom];
        let mut body =
            format!("<clipPath id=\"frame\"><rect width=\"{}\" height=\"{}\"/></clipPath>\n", FRAME[0], FRAME[1]);
        for (i, plot) in plots.iter().enumerate() {
            let x = (i % self.columns) as f64 * cell[0] + left;
            let y = (i / self.columns) as f64 * cell[1] + top;
            let (x, y) = (num(x), num(y));
            let _ = writeln!(body, "<g transform=\"translate({x} {y})\">\n{}</g>", plot.draw());
        }
        let rows = plots.len().div_ceil(self.columns);
        let size = [self.columns as f64 * cell[0], rows as f64 * cell[1]];
        document(size[0], size[1], BORDER, &body)
    }

    /// The figure as a PNG image `width_px` pixels wide.
    pub fn to_png(&self, width_px: u32) -> Result<Vec<u8>, PictureError> {
        rasterise(&self.to_svg(), width_px)
    }

    fn letter(&self, panel: usize) -> String {
        match u8::try_from(panel) {
            _ if self.axes.len() < 2 => String::new(),
            Ok(n) if n < 26 => format!("({})", char::from(b'a' + n)),
            _ => format!("({})", panel + 1),
        }
    }
}

/// One plot with its axes laid out. The origin of its drawing is the upper left corner of the
/// frame.
struct Plot<'a> {
    axes: &'a Axes,
    title: String,
    x: Axis,
    y: Axis,
    x_ticks: Ticks,
    y_ticks: Ticks,
    sketches: Vec<Sketch>,
    legend: Option<Legend>,
}

impl<'a> Plot<'a> {
    fn new(axes: &'a Axes, letter: String) -> Self {
        let visible = |p: &Point| drawable(p[0], axes.log_x) && drawable(p[1], axes.log_y);
        let points = || axes.series.iter().flat_map(|s| &s.points).filter(|p| visible(p));
        let bars = (axes.series.iter())
            .flat_map(|s| s.points.iter().zip(s.error.iter().flatten()))
            .filter(|(p, _)| visible(p))
            // an error as large as the value would stretch a logarithmic axis without end
            .map(|(p, e)| [p[1] - e.abs(), p[1] + e.abs(), 0.3 * p[1]])
            .flat_map(|[low, high, least]| [if axes.log_y { low.max(least) } else { low }, high]);
        let x = Axis::around(points().map(|p| p[0]), axes.log_x);
        let y = Axis::around(points().map(|p| p[1]).chain(bars), axes.log_y);
        let (x_ticks, y_ticks) = (horizontal_ticks(&x), y.ticks(6.0));
        let mut plot = Plot {
            axes,
            title: format!("{letter} {}", axes.title).trim().to_owned(),
            x,
            y,
            x_ticks,
            y_ticks,
            sketches: Vec::new(),
            legend: None,
        };
        plot.sketches = (axes.series.iter().enumerate())
            .map(|(index, series)| Sketch::new(&plot, index, series))
            .filter(|sketch| !sketch.runs.is_empty())
            .collect();
        plot.legend = Legend::new(&plot);
        plot
    }

    /// Room needed around the frame: left, right, top and bottom.
    fn margins(&self) -> [f64; 4] {
        [self.left(), self.right(), self.top(), self.bottom()]
    }

    fn left(&self) -> f64 {
        let label = if self.axes.y_label.is_empty() { 0.0 } else { 1.7 * FONT };
        self.y_ticks.label_width() + 12.0 + label
    }

    fn right(&self) -> f64 {
        let legend = self.legend.as_ref().map_or(0.0, Legend::outside);
        // The last label on the horizontal axis may stick out by half its width.
        legend.max(0.5 * self.x_ticks.label_width() + 6.0)
    }

    fn top(&self) -> f64 {
        let row = !self.title.is_empty() || self.y_ticks.factor.is_some();
        FONT * if row { 1.9 } else { 0.3 }
    }

    fn bottom(&self) -> f64 {
        let label = !self.axes.x_label.is_empty() || self.x_ticks.factor.is_some();
        1.8 * SMALL_FONT + if label { 1.6 } else { 0.4 } * FONT
    }

    fn draw(&self) -> String {
        let data: String = self.sketches.iter().map(Sketch::draw).collect();
        let mut svg = format!("<g clip-path=\"url(#frame)\">\n{data}</g>\n");
        if self.sketches.is_empty() {
            let middle = [0.5 * FRAME[0], 0.5 * FRAME[1]];
            let note = text(middle, "middle", FONT, "no data");
            let _ = writeln!(svg, "<g fill=\"#888\">\n{note}</g>");
        }
        svg += &self.draw_frame();
        svg + &self.legend.as_ref().map_or_else(String::new, Legend::draw)
    }

    /// A data point on the drawing, `None` if it has no place on the axes.
    fn place(&self, [x, y]: Point) -> Option<Point> {
        let (x, y) = (self.x.fraction(x)?, self.y.fraction(y)?);
        Some([x * FRAME[0], (1.0 - y) * FRAME[1]])
    }

    fn draw_frame(&self) -> String {
        let [width, height] = FRAME;
        let mut path = format!("M0 0H{width}V{height}H0Z");
        let mut labels = String::new();
        for (ticks, length) in [(self.x_ticks.positions(), MAJOR_TICK), (self.x_ticks.minor.clone(), MINOR_TICK)] {
            for x in (ticks.iter()).filter_map(|&v| self.x.fraction(v)) {
                let x = num(x * width);
                let _ = write!(path, "M{x} {height}v-{length}M{x} 0v{length}");
            }
        }
        for (ticks, length) in [(self.y_ticks.positions(), MAJOR_TICK), (self.y_ticks.minor.clone(), MINOR_TICK)] {
            for y in (ticks.iter()).filter_map(|&v| self.y.fraction(v)) {
                let y = num((1.0 - y) * height);
                let _ = write!(path, "M0 {y}h{length}M{width} {y}h-{length}");
            }
        }
        for (value, label) in &self.x_ticks.major {
            let x = self.x.fraction(*value).unwrap_or(0.0) * width;
            labels += &text([x, height + 1.35 * SMALL_FONT], "middle", SMALL_FONT, label);
        }
        for (value, label) in &self.y_ticks.major {
            let y = (1.0 - self.y.fraction(*value).unwrap_or(0.0)) * height;
            labels += &text([-7.0, y + 0.36 * SMALL_FONT], "end", SMALL_FONT, label);
        }
        format!(
            "<path d=\"{path}\" fill=\"none\" stroke=\"#000\" stroke-width=\"1.3\"/>\n{labels}{}",
            self.draw_labels()
        )
    }

    /// Title, axis labels and the common factors of the tick labels.
    fn draw_labels(&self) -> String {
        let [width, height] = FRAME;
        let mut svg = String::new();
        if let Some(factor) = &self.x_ticks.factor {
            let at = [width, height + self.bottom() - 0.35 * FONT];
            svg += &text(at, "end", SMALL_FONT, factor);
        }
        if let Some(factor) = &self.y_ticks.factor {
            svg += &text([0.0, -0.6 * FONT], "start", SMALL_FONT, factor);
        }
        let at = [0.5 * width, height + self.bottom() - 0.35 * FONT];
        let label = &self.axes.x_label;
        let room = if self.x_ticks.factor.is_some() { 0.6 * width } else { width };
        svg += &text(at, "middle", fitting_size(label, room), label);
        let at = [-self.y_ticks.label_width() - 12.0 - 0.6 * FONT, 0.5 * height];
        let label = &self.axes.y_label;
        svg += &text_upwards(at, fitting_size(label, height), label);
        // The title shares its row with the common factor of the vertical axis.
        let factor = self.y_ticks.factor.as_deref().unwrap_or_default();
        let room = width - 2.2 * text_width(factor, SMALL_FONT);
        let at = [0.5 * width, -0.6 * FONT];
        svg += &text(at, "middle", fitting_size(&self.title, room), &self.title);
        svg
    }
}

/// The font size at which a label fits into `room`.
fn fitting_size(label: &str, room: f64) -> f64 {
    let width = text_width(label, FONT);
    FONT * if width > room { room / width } else { 1.0 }
}

// ---------------------------------------------------------------------------------------------
// Data
// ---------------------------------------------------------------------------------------------

/// One series placed on the drawing.
struct Sketch {
    /// Uninterrupted stretches of points.
    runs: Vec<Vec<Point>>,
    /// Error bars as `[x, upper end, lower end]`.
    bars: Vec<[f64; 3]>,
    name: String,
    line: bool,
    /// Half the size of the markers, `None` for a bare line.
    marker: Option<f64>,
    style: Style,
}

impl Sketch {
    fn new(plot: &Plot, index: usize, series: &Series) -> Self {
        let mut runs = vec![Vec::new()];
        for &point in &series.points {
            match (plot.place(point), runs.last_mut()) {
                (Some(p), Some(run)) => run.push(p),
                _ => runs.push(Vec::new()),
            }
        }
        runs.retain(|run| !run.is_empty());
        let bars: Vec<[f64; 3]> = (series.points.iter())
            .zip(series.error.iter().flatten())
            .filter_map(|(&point, &error)| error_bar(plot, point, error))
            .collect();
        let count: usize = runs.iter().map(Vec::len).sum();
        // An isolated point has no line to show it.
        let plain = Style { colour: index, marker: Some(index), dash: index / COLOURS.len() };
        let style = series.style.unwrap_or(plain);
        let bare = style.marker.is_none()
            || series.line
                && count > MAX_POINTS_WITH_MARKERS
                && bars.is_empty()
                && runs.iter().all(|run| run.len() > 1);
        let marker = (!bare).then_some(if count > 300 { 2.2 } else { 4.0 });
        Sketch { runs, bars, name: series.name.trim().to_owned(), line: series.line, marker, style }
    }

    fn colour(&self) -> &'static str {
        COLOURS[self.style.colour % COLOURS.len()]
    }

    fn draw(&self) -> String {
        let mut path = String::new();
        for run in self.runs.iter().filter(|_| self.line) {
            path += &polyline(run);
        }
        let mut svg = self.stroke(&path);
        let mut bars = String::new();
        for &[x, upper, lower] in &self.bars {
            let (left, x) = (num(x - 3.5), num(x));
            let (upper, lower) = (num(upper), num(lower));
            let _ = write!(bars, "M{left} {upper}h7M{x} {upper}V{lower}M{left} {lower}h7");
        }
        if !bars.is_empty() {
            let colour = self.colour();
            let _ = writeln!(svg, "<path d=\"{bars}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.2\"/>");
        }
        svg + &self.markers(self.runs.iter().flatten().copied())
    }

    /// What stands for the series in the legend, around the origin.
    fn sample(&self) -> String {
        let line = format!("M{} 0h{HANDLE}", num(-0.5 * HANDLE));
        let line = if self.line { line } else { String::new() };
        self.stroke(&line) + &self.markers([[0.0, 0.0]].into_iter())
    }

    fn stroke(&self, path: &str) -> String {
        if path.is_empty() {
            return String::new();
        }
        let dash = DASHES[self.style.dash % DASHES.len()];
        format!(
            "<path d=\"{path}\" fill=\"none\" stroke=\"{}\" stroke-width=\"1.9\" stroke-linejoin=\"round\" stroke-dasharray=\"{}\"/>\n",
            self.colour(),
            if dash.is_empty() { "none" } else { dash }
        )
    }

    fn markers(&self, points: impl Iterator<Item = Point>) -> String {
        let Some(size) = self.marker else {
            return String::new();
        };
        let shape = marker_path(self.style.marker.unwrap_or(0), size);
        let mut seen = BTreeSet::new();
        let mut path = String::new();
        for p in points {
            // Points on top of each other are drawn once; it keeps large data sets small.
            if seen.insert(p.map(|x| (2.0 * x).round() as i64)) {
                let _ = write!(path, "M{}{shape}", pair(p));
            }
        }
        format!(
            "<path d=\"{path}\" fill=\"{}\" stroke=\"#fff\" stroke-width=\"{}\"/>\n",
            self.colour(),
            num(0.15 * size)
        )
    }

    /// Points the legend should keep clear of, close enough along lines to leave no gap.
    fn covered(&self) -> Vec<Point> {
        let mut covered: Vec<Point> = self.runs.iter().flatten().copied().collect();
        for ends in self.runs.iter().filter(|_| self.line).flat_map(|run| run.windows(2)) {
            let [from, to] = [ends[0], ends[1]];
            let steps = ((to[0] - from[0]).hypot(to[1] - from[1]) / 12.0).min(100.0) as usize;
            for step in 1..=steps {
                let t = step as f64 / (steps + 1) as f64;
                let at = |axis: usize| from[axis] + t * (to[axis] - from[axis]);
                covered.push([at(0), at(1)]);
            }
        }
        for &[x, upper, lower] in &self.bars {
            covered.extend([[x, upper], [x, lower]]);
        }
        covered
    }
}

/// An error bar on the drawing; one that reaches zero on a logarithmic axis runs to the frame.
fn error_bar(plot: &Plot, [x, y]: Point, error: f64) -> Option<[f64; 3]> {
    let [at, _] = plot.place([x, y])?;
    if !(error.is_finite() && error != 0.0) {
        return None;
    }
    let end = |value: f64, beyond: f64| plot.place([x, value]).map_or(beyond, |p| p[1]);
    let upper = end(y + error.abs(), -10.0);
    let lower = end(y - error.abs(), FRAME[1] + 10.0);
    Some([at, upper, lower])
}

/// Path data of a line through the points; steps too short to see are passed over.
fn polyline(run: &[Point]) -> String {
    let (Some(&first), Some(&last)) = (run.first(), run.last()) else {
        return String::new();
    };
    let mut pen = Pen::at(first);
    let mut drawn = first;
    for &p in run {
        if (p[0] - drawn[0]).abs().max((p[1] - drawn[1]).abs()) > 0.2 {
            pen.line_to(p);
            drawn = p;
        }
    }
    pen.line_to(last);
    format!("M{}{}", pair(pen.start), pen.data)
}

/// Path data, relative to its centre, of the marker of series `index`: disk, square, triangle,
/// diamond or inverted triangle.
fn marker_path(index: usize, size: f64) -> String {
    let closed = |points: &[Point]| {
        let mut pen = Pen::at([0.0, 0.0]);
        points.iter().for_each(|&p| pen.line_to(p));
        // The outline starts at the first corner, reached by a move.
        pen.data.replacen('l', "m", 1) + "z"
    };
    let (r, h, d) = (size, 0.9 * size, 1.3 * size);
    match index % 5 {
        0 => {
            let (r, w) = (num(r), num(2.0 * r));
            format!("m-{r} 0a{r} {r} 0 0 1 {w} 0a{r} {r} 0 0 1-{w} 0z")
        }
        1 => closed(&[[-h, -h], [h, -h], [h, h], [-h, h]]),
        2 => closed(&[[0.0, -1.25 * r], [1.15 * r, 0.8 * r], [-1.15 * r, 0.8 * r]]),
        3 => closed(&[[0.0, -d], [d, 0.0], [0.0, d], [-d, 0.0]]),
        _ => closed(&[[0.0, 1.25 * r], [-1.15 * r, -0.8 * r], [1.15 * r, -0.8 * r]]),
    }
}

// ---------------------------------------------------------------------------------------------
// Legend
// ---------------------------------------------------------------------------------------------

/// The legend: one line for each named series.
struct Legend {
    /// Names and samples.
    entries: Vec<(String, String)>,
    /// Font size.
    size: f64,
    extent: Point,
    /// Upper left corner on the drawing.
    corner: Point,
}

impl Legend {
    fn new(plot: &Plot) -> Option<Self> {
        let entries: Vec<(String, String)> = (plot.sketches.iter())
            .filter(|sketch| !sketch.name.is_empty())
            .map(|sketch| (sketch.name.clone(), sketch.sample()))
            .collect();
        if entries.is_empty() {
            return None;
        }
        let size = SMALL_FONT.min(0.95 * FRAME[1] / (1.4 * entries.len() as f64));
        let names = (entries.iter()).map(|(name, _)| text_width(name, size)).fold(0.0, f64::max);
        let lines = 1.4 * size * entries.len() as f64;
        let extent = [HANDLE + names + 22.0, lines + 6.0];
        let covered: Vec<Point> = plot.sketches.iter().flat_map(Sketch::covered).collect();
        Some(Legend {
            entries,
            size,
            extent,
            // Beside the frame rather than on top of the data.
            corner: free_corner(extent, &covered).unwrap_or([FRAME[0] + 8.0, 0.0]),
        })
    }

    /// Width it needs to the right of the frame.
    fn outside(&self) -> f64 {
        (self.corner[0] + self.extent[0] - FRAME[0]).max(0.0)
    }

    fn draw(&self) -> String {
        let mut svg = String::new();
        let [left, top] = self.corner;
        for (i, (name, sample)) in self.entries.iter().enumerate() {
            let y = top + 3.0 + (i as f64 + 0.5) * 1.4 * self.size;
            let [x, baseline] = [left + HANDLE + 14.0, y + 0.36 * self.size];
            let (at_x, at_y) = (num(left + 6.0 + 0.5 * HANDLE), num(y));
            let _ = writeln!(svg, "<g transform=\"translate({at_x} {at_y})\">\n{sample}</g>");
            svg += &text([x, baseline], "start", self.size, name);
        }
        svg
    }
}

/// Upper left corner of a legend of the given extent along the frame, corners preferred; `None`
/// if it would hide data everywhere.
fn free_corner(extent: Point, covered: &[Point]) -> Option<Point> {
    let gap = MAJOR_TICK + 5.0;
    let far = [0, 1].map(|axis| FRAME[axis] - extent[axis] - gap);
    let middle = [0, 1].map(|axis| 0.5 * (FRAME[axis] - extent[axis]));
    let places = [
        [far[0], gap],
        [gap, gap],
        [far[0], far[1]],
        [gap, far[1]],
        [far[0], middle[1]],
        [gap, middle[1]],
        [middle[0], gap],
        [middle[0], far[1]],
    ];
    let inside =
        |p: &Point, place: &Point| (0..2).all(|axis| (-6.0..=extent[axis] + 6.0).contains(&(p[axis] - place[axis])));
    let fits = |place: &Point| place[0] >= gap && place[1] >= gap;
    (places.into_iter()).find(|place| fits(place) && !covered.iter().any(|p| inside(p, place)))
}

// ---------------------------------------------------------------------------------------------
// Axes and ticks
// ---------------------------------------------------------------------------------------------

fn drawable(value: f64, log: bool) -> bool {
    value.is_finite() && value.abs() < LARGEST && (!log || value > 0.0)
}

/// The range of one axis; for a logarithmic axis `low` and `high` are decadic logarithms.
#[derive(Debug)]
struct Axis {
    log: bool,
    low: f64,
    high: f64,
}

impl Axis {
    /// The range of the values with some room on both sides.
    fn around(values: impl Iterator<Item = f64>, log: bool) -> Self {
        let (mut low, mut high) = values
            .filter(|&v| drawable(v, log))
            .map(|v| if log { v.log10() } else { v })
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
        if low > high {
            (low, high) = (0.0, 1.0);
        }
        let size = low.abs().max(high.abs());
        let span = high - low;
        let room = if span > 1e-9 * size {
            0.05 * span
        } else if log || size == 0.0 {
            0.5
        } else {
            0.1 * size
        };
        Axis { log, low: low - room, high: high + room }
    }

    /// Place of a value along the axis, 0 at its start and 1 at its end.
    fn fraction(&self, value: f64) -> Option<f64> {
        drawable(value, self.log).then(|| {
            let v = if self.log { value.log10() } else { value };
            (v - self.low) / (self.high - self.low)
        })
    }

    /// About `count` labelled ticks.
    fn ticks(&self, count: f64) -> Ticks {
        if self.log { log_ticks(self.low, self.high, count) } else { linear_ticks(self.low, self.high, count) }
    }
}

/// Ticks of a horizontal axis, as many as their labels leave room for.
fn horizontal_ticks(axis: &Axis) -> Ticks {
    let fits = |ticks: &Ticks| {
        let room = (ticks.major.len() as f64) * (ticks.label_width() + 14.0);
        room < FRAME[0]
    };
    let candidates = [6.0, 4.0, 3.0].map(|count| axis.ticks(count));
    let [.., sparse] = &candidates;
    (candidates.iter().find(|ticks| fits(ticks)).unwrap_or(sparse)).clone()
}

/// Ticks of an axis, in data values.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Ticks {
    /// Labelled ticks.
    pub(super) major: Vec<(f64, String)>,
    /// Short ticks without label.
    pub(super) minor: Vec<f64>,
    /// Power of ten by which all labels are to be multiplied.
    pub(super) factor: Option<String>,
}

impl Ticks {
    fn positions(&self) -> Vec<f64> {
        self.major.iter().map(|(value, _)| *value).collect()
    }

    fn label_width(&self) -> f64 {
        (self.major.iter()).map(|(_, label)| text_width(label, SMALL_FONT)).fold(0.0, f64::max)
    }
}

/// The step of 1, 2 or 5 times a power of ten that cuts `span` into about `count` parts.
pub(super) fn tick_step(span: f64, count: f64) -> f64 {
    let raw = span / count;
    let power = 10_f64.powf(raw.log10().floor());
    let leading = match raw / power {
        m if m < 1.5 => 1.0,
        m if m < 3.5 => 2.0,
        m if m < 7.5 => 5.0,
        _ => 10.0,
    };
    leading * power
}

/// Round values between `low` and `high`, at most a few dozen.
pub(super) fn linear_ticks(low: f64, high: f64, count: f64) -> Ticks {
    let step = tick_step(high - low, count);
    // A step of 2 is cut into halves, 1 and 5 into fifths.
    let leading = step / 10_f64.powf((step.log10() + 1e-9).floor());
    let parts = if (leading - 2.0).abs() < 0.5 { 4.0 } else { 5.0 };
    let size = low.abs().max(high.abs());
    let exponent = (size.log10() + 1e-9).floor();
    // Plain numbers where they are short, otherwise a common power of ten.
    let shift = if (-3.0..5.0).contains(&exponent) { 0.0 } else { exponent };
    let decimals = (shift - (step.log10() + 1e-9).floor()).clamp(0.0, 15.0) as usize;
    let label = |value: f64| decimal(value / 10_f64.powf(shift), decimals);
    Ticks {
        major: multiples(step, low, high).map(|v| (v, label(v))).collect(),
        minor: multiples(step / parts, low, high).collect(),
        factor: (shift != 0.0).then(|| format!("×{}", power_of_ten(shift as i32))),
    }
}

/// The multiples of `step` between `low` and `high`.
fn multiples(step: f64, low: f64, high: f64) -> impl Iterator<Item = f64> {
    let first = (low / step - 1e-6).ceil();
    let last = (high / step + 1e-6).floor();
    // Values so close that the step is lost in rounding, or not finite, get no ticks.
    let count = (last - first + 1.0).clamp(0.0, 200.0);
    (0..count as usize).map(move |n| (first + n as f64) * step)
}

/// Ticks between `10^low` and `10^high`: decades if there are several, otherwise 1, 2, 5, and
/// round numbers if the range is shorter still.
fn log_ticks(low: f64, high: f64, count: f64) -> Ticks {
    let stride = ((high - low) / count).ceil().max(1.0);
    let decades: Vec<f64> = multiples(stride, low, high).collect();
    let between = |digits: &[f64]| -> Vec<(f64, f64)> {
        multiples(1.0, low - 1.0, high)
            .flat_map(|n| digits.iter().map(move |&digit| (digit, n)))
            .filter(|(digit, n)| (low..=high).contains(&(n + digit.log10())))
            .collect()
    };
    let value = |(digit, n): (f64, f64)| digit * 10_f64.powf(n);
    let fine: Vec<f64> = if stride > 1.0 {
        multiples(1.0, low, high).map(|n| value((1.0, n))).collect()
    } else {
        between(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]).into_iter().map(value).collect()
    };
    if decades.len() > 2 || (decades.len() == 2 && high - low > 2.0) {
        let label = |&n: &f64| (10_f64.powf(n), power_of_ten(n as i32));
        return Ticks { major: decades.iter().map(label).collect(), minor: fine, factor: None };
    }
    let coarse = between(match count {
        c if c > 5.0 => &[1.0, 2.0, 5.0],
        c if c > 3.0 => &[1.0, 3.0],
        _ => &[1.0],
    });
    if coarse.len() < 2 {
        return linear_ticks(10_f64.powf(low), 10_f64.powf(high), count - 1.0);
    }
    Ticks {
        major: (coarse.into_iter()).map(|(digit, n)| (value((digit, n)), short_number(digit, n as i32))).collect(),
        minor: fine,
        factor: None,
    }
}

/// `digit * 10^n` in the shorter of its two usual forms.
fn short_number(digit: f64, n: i32) -> String {
    if (-3..=3).contains(&n) {
        decimal(digit * 10_f64.powi(n), (-n).max(0) as usize)
    } else if digit == 1.0 {
        power_of_ten(n)
    } else {
        format!("{digit}×{}", power_of_ten(n))
    }
}

/// A number on its own, to four significant digits.
pub(super) fn number(value: f64) -> String {
    let exponent = value.abs().log10().floor();
    if value == 0.0 || (-3.0..6.0).contains(&exponent) {
        let plain = decimal(value, (3.0 - exponent).clamp(0.0, 6.0) as usize);
        return match plain.split_once('.') {
            Some(_) => plain.trim_end_matches('0').trim_end_matches('.').to_owned(),
            None => plain,
        };
    }
    let leading = decimal(value / 10_f64.powf(exponent), 3);
    let leading = leading.trim_end_matches('0').trim_end_matches('.');
    format!("{leading}×{}", power_of_ten(exponent as i32))
}

fn power_of_ten(n: i32) -> String {
    format!("10^{{{}}}", n.to_string().replace('-', "−"))
}

/// A number with a fixed number of digits after the point, a true minus and no negative zero.
fn decimal(value: f64, digits: usize) -> String {
    let plain = format!("{value:.digits$}");
    match plain.strip_prefix('-') {
        Some(rest) if rest.chars().all(|c| matches!(c, '0' | '.')) => rest.to_owned(),
        Some(rest) => format!("−{rest}"),
        None => plain,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn series(points: &[Point]) -> Series {
        Series { name: "data".to_owned(), points: points.to_vec(), ..Series::default() }
    }

    fn axes(series: Vec<Series>) -> Axes {
        Axes { title: "title".to_owned(), x_label: "x".to_owned(), y_label: "y".to_owned(), series, ..Axes::default() }
    }

    /// Number of points of the first series that are on the drawing.
    fn points_drawn(axes: &Axes) -> usize {
        let plot = Plot::new(axes, String::new());
        let first = plot.sketches.first();
        first.map_or(0, |sketch| sketch.runs.iter().map(Vec::len).sum())
    }

    fn labels(ticks: &Ticks) -> Vec<&str> {
        ticks.major.iter().map(|(_, label)| label.as_str()).collect()
    }

    #[test]
    fn logarithmic_axes_leave_out_what_is_not_positive() {
        let mut plot = axes(vec![series(&[[1.0, 1.0], [-1.0, 2.0], [3.0, 0.0], [4.0, 5.0]])]);
        assert_eq!(points_drawn(&plot), 4);
        plot.log_x = true;
        assert_eq!(points_drawn(&plot), 3);
        plot.log_y = true;
        assert_eq!(points_drawn(&plot), 2);
    }

    #[test]
    fn points_without_a_place_interrupt_the_line() {
        let mut data = series(&[[0.0, 0.0], [1.0, 1.0], [2.0, f64::NAN], [3.0, 1.0], [4.0, 2.0]]);
        data.line = true;
        let plot = axes(vec![data]);
        let sketch = &Plot::new(&plot, String::new()).sketches[0];
        assert_eq!(sketch.runs.iter().map(Vec::len).collect::<Vec<_>>(), [2, 2]);
    }

    #[test]
    fn the_axes_hold_points_and_error_bars() {
        let mut data = series(&[[0.0, 1.0], [1.0, 2.0]]);
        data.error = Some(vec![0.5, 3.0]);
        let plot = axes(vec![data]);
        let plot = Plot::new(&plot, String::new());
        for [x, upper, lower] in &plot.sketches[0].bars {
            assert!(*x > 0.0 && *x < FRAME[0]);
            assert!(0.0 < *upper && upper < lower && *lower < FRAME[1]);
        }
        assert_eq!(plot.sketches[0].bars.len(), 2);
    }

    #[test]
    fn an_error_bar_down_to_zero_leaves_a_logarithmic_frame() {
        let mut data = series(&[[0.0, 1.0], [1.0, 10.0]]);
        data.error = Some(vec![2.0, 1.0]);
        let mut plot = axes(vec![data]);
        plot.log_y = true;
        let bars = Plot::new(&plot, String::new()).sketches[0].bars.clone();
        assert!(bars[0][2] > FRAME[1] && bars[1][2] < FRAME[1]);
    }

    #[test]
    fn linear_ticks_are_round_numbers() {
        assert_eq!(labels(&linear_ticks(-0.02, 1.02, 5.0)), ["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"]);
        assert_eq!(labels(&linear_ticks(-30.0, 30.0, 5.0)), ["−30", "−20", "−10", "0", "10", "20", "30"]);
        let small = linear_ticks(0.0, 3e-6, 5.0);
        assert_eq!(labels(&small), ["0.0", "0.5", "1.0", "1.5", "2.0", "2.5", "3.0"]);
        assert_eq!(small.factor.as_deref(), Some("×10^{−6}"));
        assert_eq!(labels(&linear_ticks(0.84119, 0.84121, 4.0))[1], "0.841195");
        assert_eq!(tick_step(1.0, 5.0), 0.2);
        assert_eq!(tick_step(70.0, 5.0), 10.0);
    }

    #[test]
    fn logarithmic_ticks_are_decades_where_there_are_decades() {
        let wide = log_ticks(-5.1, 0.1, 6.0);
        assert_eq!(labels(&wide)[..2], ["10^{−5}", "10^{−4}"]);
        assert_eq!(wide.major.len(), 6);
        assert_eq!(labels(&log_ticks(-0.1, 1.5, 6.0)), ["1", "2", "5", "10", "20"]);
        assert!(log_ticks(-30.0, 0.0, 6.0).major.len() <= 7);
        assert!(log_ticks(0.31, 0.46, 6.0).major.len() >= 2);
        for &(value, _) in &log_ticks(-0.1, 1.5, 6.0).major {
            assert!((-0.1..=1.5).contains(&value.log10()));
        }
    }

    #[test]
    fn single_numbers_are_written_as_on_paper() {
        let cases = [
            (0.0, "0"),
            (0.25, "0.25"),
            (-3.0, "−3"),
            (0.841_23, "0.8412"),
            (1.5e-7, "1.5×10^{−7}"),
            (120_000.0, "120000"),
        ];
        for (value, expected) in cases {
            assert_eq!(number(value), expected);
        }
    }

    #[test]
    fn the_legend_never_hides_data() {
        let corner = |points: &[Point]| {
            let plot = axes(vec![series(points)]);
            let legend = Plot::new(&plot, String::new()).legend;
            legend.map(|legend| legend.corner[0])
        };
        let falling = corner(&[[0.0, 1.0], [1.0, 0.0]]);
        assert!(falling.is_some_and(|x| x > 0.5 * FRAME[0] && x < FRAME[0]));
        let rising = corner(&[[0.0, 0.0], [1.0, 1.0]]);
        assert!(rising.is_some_and(|x| x < 0.5 * FRAME[0]));
        let everywhere: Vec<Point> = (0..900).map(|i| [f64::from(i % 30), f64::from(i / 30)]).collect();
        assert!(corner(&everywhere).is_some_and(|x| x > FRAME[0]));
        assert_eq!(corner(&[]), None);
    }

    #[test]
    fn odd_data_give_a_plot_all_the_same() {
        let sets: [&[Point]; 8] = [
            &[],
            &[[0.0, 0.0]],
            &[[3.0, 3.0]; 5],
            &[[f64::NAN, 1.0], [1.0, f64::INFINITY]],
            &[[-1e308, -1e308], [1e308, 1e308]],
            &[[-1e299, 1e299], [1e299, -1e299]],
            &[[1e-320, 1e-320], [2e-320, 3e-320]],
            &[[1.0, 1.0], [1.0 + 1e-15, 1.0 - 1e-15]],
        ];
        for points in sets {
            for (line, log) in [(true, false), (false, true)] {
                let mut data = series(points);
                data.line = line;
                data.error = Some(vec![f64::NAN, f64::INFINITY, -1.0]);
                let mut plot = axes(vec![data, Series::default()]);
                (plot.log_x, plot.log_y) = (log, log);
                let svg = plot.to_svg();
                assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
                plot.to_png(60).unwrap();
            }
        }
        assert!(axes(Vec::new()).to_svg().contains("no data"));
        assert!(!axes(vec![series(&[[1.0, 1.0]])]).to_svg().contains("no data"));
    }

    #[test]
    fn panels_are_lettered_and_in_rows() {
        let all = vec![axes(vec![series(&[[1.0, 2.0]])]); 5];
        let svg = panels(&all, 2).to_svg();
        assert_eq!(svg.matches("url(#frame)").count(), 5);
        assert!(svg.contains("(e) title") && !svg.contains("(f)"));
        assert!(!all[0].to_svg().contains("(a)"));
        let shape = |columns| {
            let svg = panels(&all, columns).to_svg();
            let document = resvg::usvg::roxmltree::Document::parse(&svg).unwrap();
            let side = |name| document.root_element().attribute(name).unwrap().parse::<f64>().unwrap();
            (side("width"), side("height"))
        };
        assert!(shape(1).0 < shape(2).0 && shape(2).0 < shape(5).0);
        assert!(shape(1).1 > shape(2).1 && shape(2).1 > shape(5).1);
        assert_eq!(shape(5), shape(50));
        panels(&[], 0).to_png(40).unwrap();
    }

    #[test]
    fn names_are_escaped() {
        let mut data = series(&[[1.0, 2.0]]);
        data.name = "<a> & \"b\"".to_owned();
        let svg = axes(vec![data]).to_svg();
        let document = resvg::usvg::roxmltree::Document::parse(&svg).unwrap();
        assert!(document.descendants().any(|node| node.text() == Some("<a> & \"b\"")));
    }

    #[test]
    fn the_png_has_the_colour_of_the_series() {
        let png = axes(vec![series(&[[1.0, 2.0]])]).to_png(500).unwrap();
        assert_eq!(&png[..8], b"\x89PNG\r\n\x1a\n");
        let image = resvg::tiny_skia::Pixmap::decode_png(&png).unwrap();
        assert_eq!(image.width(), 500);
        let blue = |p: &&resvg::tiny_skia::PremultipliedColorU8| (p.red(), p.green(), p.blue()) == (0x00, 0x72, 0xb2);
        assert!(image.pixels().iter().filter(blue).count() > 10);
    }
}
