//! The summary on the standard output: the onset with its bracket, then one line a sample.

use crate::observe::Sample;
use crate::protocol::Onset;
use crate::scene::{Model, Scene};

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

/// The whole table, every line ended. Energies, forces and stresses are in the units of its header.
pub fn table(scene: &Scene, samples: &[Sample]) -> String {
    let line = |cells: [String; 8]| {
        let padded: Vec<String> = cells.iter().zip(WIDTHS).map(|(cell, width)| format!("{cell:>width$}")).collect();
        padded.join("  ").trim_end().to_string() + "\n"
    };
    // what is sheared is told by its strain first
    let is_sheared = scene.shear.until != 0.0;
    let strained = |strain: &str, cells: [String; 8]| {
        let line = line(cells);
        if is_sheared { format!("{strain:>8}  {line}") } else { line }
    };
    let header = header(scene.model());
    let mut text = strained("strain", header.map(|[name, _]| name.to_string()));
    text += &strained("", header.map(|[_, unit]| unit.to_string()));
    for sample in samples {
        text += &strained(
            &format!("{:.6}", sample.strain),
            [
                format!("{:.6}", sample.density.packing_fraction),
                format!("{:.6}", sample.density.reduced_number_density),
                format!("{:.3}", sample.contact_number),
                format!("{:.5}", sample.shape_parameter.relative),
                format!("{:.5e}", sample.pressure() / scene.pressure_unit()),
                // the units of length are 1, so that energies and forces have one unit
                format!("{:.6e}", sample.energies.total / scene.force_unit()),
                format!("{:.1e}", sample.max_force / scene.force_unit()),
                sample.iterations.to_string(),
            ],
        );
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
            "onset: phi_J = 0.843123450 in [0.843123350, 0.843123450]"
        );
    }

    #[test]
    fn columns_line_up() {
        let scene = Scene::parse("model = 'sp'\n[potential]\nepsilon = 2.0", "test", &[]).unwrap();
        let mut sample = Sample { contact_number: 3.97, max_force: 4e-13, iterations: 12345, ..Sample::default() };
        sample.density.packing_fraction = 0.84;
        sample.density.reduced_number_density = 0.8401;
        let text = table(&scene, &[sample, sample]);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 4);
        assert_eq!(lines[0].len(), lines[2].len());
        assert!(lines[2].starts_with("0.840000  0.840100   3.970"), "{text}");
        assert!(lines[2].contains(" 2.0e-13 "), "{text}");

        let scene = Scene::parse("model = 'sp'\nshear.until = 0.1", "test", &[]).unwrap();
        sample.strain = 0.05;
        let text = table(&scene, &[sample]);
        let lines: Vec<&str> = text.lines().collect();
        assert!(lines[0].starts_with("  strain       rho") && lines[2].starts_with("0.050000  0.840000"), "{text}");
    }
}
