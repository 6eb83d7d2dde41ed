//! The summary on the standard output: the onset with its bracket, then one line a sample.

use crate::protocol::Onset;
use crate::scene::Model;

/// What the table shows of one sample; a number that does not exist is NaN.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    /// rho, true area fraction.
    pub packing_fraction: f64,
    /// phi, area of the undeformed particles over the area of the box.
    pub reduced_number_density: f64,
    pub contact_number: f64,
    pub shape_parameter: f64,
    pub pressure: f64,
    pub energy: f64,
    pub max_force: f64,
    pub iterations: u64,
}

/// The names and units of the columns, one model's.
fn header(model: Model) -> [[&'static str; 2]; 8] {
    match model {
        Model::Sp => [
            ["rho", ""],
            ["phi", ""],
            ["z", ""],
            ["A", ""],
            ["p", "eps/sigma_S^2"],
            ["U", "eps"],
            ["max|F|", "eps/sigma_S"],
            ["iterations", ""],
        ],
        Model::Dp => [
            ["rho", ""],
            ["phi", ""],
            ["z", ""],
            ["A relative", ""],
            ["p", "gamma/l"],
            ["U", "gamma l"],
            ["max|F|", "gamma"],
            ["iterations", ""],
        ],
    }
}

const WIDTHS: [usize; 8] = [8, 8, 6, 10, 13, 12, 11, 10];

/// The whole table, every line ended.
pub fn table(model: Model, rows: &[Row]) -> String {
    let line = |cells: [String; 8]| {
        let padded: Vec<String> = cells.iter().zip(WIDTHS).map(|(cell, width)| format!("{cell:>width$}")).collect();
        padded.join("  ").trim_end().to_string() + "\n"
    };
    let header = header(model);
    let mut text = line(header.map(|[name, _]| name.to_string()));
    text += &line(header.map(|[_, unit]| unit.to_string()));
    for row in rows {
        text += &line([
            format!("{:.6}", row.packing_fraction),
            format!("{:.6}", row.reduced_number_density),
            format!("{:.3}", row.contact_number),
            format!("{:.5}", row.shape_parameter),
            format!("{:.5e}", row.pressure),
            format!("{:.6e}", row.energy),
            format!("{:.1e}", row.max_force),
            row.iterations.to_string(),
        ]);
    }
    text
}

/// `onset: rho_J = 0.8337 in [0.8335, 0.8337]`, with as many digits as the bracket has.
pub fn onset_line(model: Model, onset: &Onset) -> String {
    let name = match model {
        Model::Sp => "phi_J",
        Model::Dp => "rho_J",
    };
    let width = onset.density - onset.unjammed;
    let digits = (1.0 - width.log10()).ceil().clamp(4.0, 12.0) as usize;
    let Onset { density, unjammed, .. } = onset;
    format!("onset: {name} = {density:.digits$} in [{unjammed:.digits$}, {density:.digits$}]")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bracket_decides_the_digits() {
        let onset = |density, unjammed| Onset { density, unjammed, pressure: 1e-6, steps: 9 };
        assert_eq!(onset_line(Model::Dp, &onset(0.8337, 0.8335)), "onset: rho_J = 0.83370 in [0.83350, 0.83370]");
        assert_eq!(
            onset_line(Model::Sp, &onset(0.84312345, 0.84312335)),
            "onset: phi_J = 0.84312345 in [0.84312335, 0.84312345]"
        );
    }

    #[test]
    fn columns_line_up() {
        let row = Row {
            packing_fraction: 0.84,
            reduced_number_density: 0.8401,
            contact_number: 3.97,
            shape_parameter: 1.02,
            pressure: 1.3e-6,
            energy: 271.3,
            max_force: 9.9e-10,
            iterations: 12345,
        };
        let text = table(Model::Dp, &[row, row]);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 4);
        assert_eq!(lines[0].len(), lines[2].len());
        assert!(lines[2].starts_with("0.840000  0.840100   3.970"), "{text}");
    }
}
