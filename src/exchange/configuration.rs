use super::Problem;
use super::reader::{Object, Range, wrong};
use crate::geometry::{Frac, PeriodicBox, Polygon, Vec2, sub};
use crate::particles::{Bodies, Particles};
use serde::Serialize;
use serde_json::Value;

/// A configuration as it stands in an exchange file. Positions are Cartesian in the cell a₁ = (lx, 0), a₂ = (xy, ly),
/// in any periodic image; particle m is the m-th of each list.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "model")]
pub enum Configuration {
    /// Soft disks.
    #[serde(rename = "sp")]
    Sp {
        #[serde(rename = "box")]
        cell: Cell,
        epsilon: f64,
        diameters: Vec<f64>,
        positions: Vec<Vec2>,
    },
    /// Deformable particles.
    #[serde(rename = "dp")]
    Dp {
        #[serde(rename = "box")]
        cell: Cell,
        line_tension: f64,
        k_area: f64,
        epsilon: f64,
        delta: f64,
        contact: ContactForm,
        n_vertices: Vec<u32>,
        a0: Vec<f64>,
        /// All particles' vertices in order, counter-clockwise, each particle whole.
        vertices: Vec<Vec2>,
    },
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Cell {
    pub lx: f64,
    pub ly: f64,
    pub xy: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum ContactForm {
    VertexEdge,
    EdgeEdge,
}

/// Notes and reports of earlier runs, which the reader skips at the top level.
const SKIPPED: [&str; 2] = ["note", "minimize"];
const SP_KEYS: [&str; 7] = ["model", "box", "epsilon", "diameters", "positions", SKIPPED[0], SKIPPED[1]];
const DP_KEYS: [&str; 12] = [
    "model",
    "box",
    "line_tension",
    "k_area",
    "epsilon",
    "delta",
    "contact",
    "n_vertices",
    "a0",
    "vertices",
    SKIPPED[0],
    SKIPPED[1],
];

impl Configuration {
    /// Reads a configuration, which may also stand under the key `input` of a larger object (whose other keys are then
    /// ignored). The keys `note` and `minimize` are skipped; `box.xy` may be left out (0), and so may `contact`
    /// ("vertex-edge").
    pub fn read(text: &str) -> Result<Configuration, Problem> {
        let text = text.trim_start_matches('\u{feff}');
        if text.trim().is_empty() {
            return Err(Problem::Empty);
        }
        let whole: Value = serde_json::from_str(text).map_err(|e| Problem::Syntax(e.to_string()))?;
        let value = whole.get("input").unwrap_or(&whole);
        let top = if whole.get("input").is_some() { "input" } else { "the top level" };
        let map = value.as_object().ok_or_else(|| wrong(top.to_string(), "an object", value))?;

        // which keys are known depends on the model
        let configuration = match Object::unchecked(map).word("model", &["sp", "dp"])? {
            "sp" => Self::read_disks(&Object::new(map, "", &SP_KEYS)?)?,
            _ => Self::read_polygons(&Object::new(map, "", &DP_KEYS)?)?,
        };
        configuration.check_lengths()?;
        configuration.check_outlines()?;
        Ok(configuration)
    }

    fn read_disks(top: &Object) -> Result<Self, Problem> {
        Ok(Configuration::Sp {
            cell: Cell::read(top)?,
            epsilon: top.number("epsilon", Range::Positive)?,
            diameters: top.numbers("diameters", Range::Positive)?,
            positions: top.points("positions")?,
        })
    }

    fn read_polygons(top: &Object) -> Result<Self, Problem> {
        Ok(Configuration::Dp {
            cell: Cell::read(top)?,
            line_tension: top.number("line_tension", Range::NotNegative)?,
            k_area: top.number("k_area", Range::NotNegative)?,
            epsilon: top.number("epsilon", Range::Positive)?,
            delta: top.number("delta", Range::Positive)?,
            contact: ContactForm::read(top)?,
            n_vertices: top.vertex_counts("n_vertices")?,
            a0: top.numbers("a0", Range::Positive)?,
            vertices: top.points("vertices")?,
        })
    }

    fn check_lengths(&self) -> Result<(), Problem> {
        let same = |key, got, expected, why| {
            if got == expected { Ok(()) } else { Err(Problem::Length { key, got, expected, why }) }
        };
        let some = |key: &str, n: usize| {
            let expected = || "a list with at least one particle".to_string();
            if n > 0 {
                Ok(())
            } else {
                Err(Problem::Wrong { key: key.to_string(), expected: expected(), got: "empty".to_string() })
            }
        };
        match self {
            Configuration::Sp { diameters, positions, .. } => {
                some("diameters", diameters.len())?;
                same("positions", positions.len(), diameters.len(), "one position for each of `diameters`")
            }
            Configuration::Dp { n_vertices, a0, vertices, .. } => {
                some("n_vertices", n_vertices.len())?;
                same("a0", a0.len(), n_vertices.len(), "one rest area for each of `n_vertices`")?;
                let points = n_vertices.iter().map(|&n| n as usize).sum();
                same("vertices", vertices.len(), points, "one vertex for each that `n_vertices` announces")
            }
        }
    }

    /// Every polygon whole, counter-clockwise and uncrossed.
    fn check_outlines(&self) -> Result<(), Problem> {
        let Configuration::Dp { cell, vertices, .. } = self else { return Ok(()) };
        let pbox = self.pbox();
        for (particle, points) in self.polygons().enumerate() {
            let corners = &vertices[points];
            let n = corners.len();
            for edge in 0..n {
                let next = (edge + 1) % n;
                let along = sub(corners[next], corners[edge]);
                let rows = along[1] / cell.ly;
                let columns = (along[0] - rows * cell.xy) / cell.lx;
                // not "≥": NaN is refused too
                if !(rows.abs() < 0.5 && columns.abs() < 0.5) {
                    return Err(Problem::LongEdge { particle, edge, next });
                }
            }
            let points: Vec<Frac> = corners.iter().map(|&corner| pbox.frac(corner)).collect();
            let polygon = Polygon::from_vertices(&pbox, &points);
            if polygon.crosses_itself() {
                return Err(Problem::CrossesItself { particle });
            }
            if polygon.area() == 0.0 {
                return Err(Problem::NoArea { particle });
            }
            if polygon.area() < 0.0 {
                return Err(Problem::Clockwise { particle });
            }
        }
        Ok(())
    }

    fn cell(&self) -> Cell {
        match self {
            Configuration::Sp { cell, .. } | Configuration::Dp { cell, .. } => *cell,
        }
    }

    pub fn pbox(&self) -> PeriodicBox {
        let Cell { lx, ly, xy } = self.cell();
        PeriodicBox::new(lx, ly, xy)
    }

    /// Ranges of vertices, particle by particle; nothing for disks.
    fn polygons(&self) -> impl Iterator<Item = std::ops::Range<usize>> + '_ {
        let counts: &[u32] = match self {
            Configuration::Sp { .. } => &[],
            Configuration::Dp { n_vertices, .. } => n_vertices,
        };
        counts.iter().scan(0, |end, &n| {
            let start = *end;
            *end += n as usize;
            Some(start..*end)
        })
    }

    /// The particles that rank `rank` of `size` brings, with their places in the lists as global ids.
    pub fn particles(&self, rank: usize, size: usize) -> Particles {
        let pbox = self.pbox();
        let share = |n: usize| n * rank / size..n * (rank + 1) / size;
        match self {
            Configuration::Sp { diameters, positions, .. } => {
                let mut disks = Particles::empty(&Bodies::Disks);
                for m in share(diameters.len()) {
                    disks.push(m as u32, diameters[m], &[pbox.frac(positions[m])]);
                }
                disks
            }
            Configuration::Dp { n_vertices, a0, vertices, .. } => {
                let mut polygons = Particles::empty(&Bodies::Polygons { first: vec![0] });
                let here = share(n_vertices.len());
                for (m, points) in self.polygons().enumerate().filter(|(m, _)| here.contains(m)) {
                    let points: Vec<Frac> = vertices[points].iter().map(|&vertex| pbox.frac(vertex)).collect();
                    polygons.push(m as u32, a0[m], &points);
                }
                polygons
            }
        }
    }

    /// The same particles with their points elsewhere.
    pub fn at(mut self, points: Vec<Vec2>) -> Self {
        match &mut self {
            Configuration::Sp { positions, .. } => *positions = points,
            Configuration::Dp { vertices, .. } => *vertices = points,
        }
        self
    }
}

impl Cell {
    fn read(top: &Object) -> Result<Cell, Problem> {
        let cell = top.object("box", "box.", &["lx", "ly", "xy"])?;
        Ok(Cell {
            lx: cell.number("lx", Range::Positive)?,
            ly: cell.number("ly", Range::Positive)?,
            xy: if cell.has("xy") { cell.number("xy", Range::Any)? } else { 0.0 },
        })
    }
}

impl ContactForm {
    fn read(top: &Object) -> Result<ContactForm, Problem> {
        if !top.has("contact") {
            return Ok(ContactForm::VertexEdge);
        }
        match top.word("contact", &["vertex-edge", "edge-edge"])? {
            "edge-edge" => Ok(ContactForm::EdgeEdge),
            _ => Ok(ContactForm::VertexEdge),
        }
    }
}
