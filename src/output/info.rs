//! What a results file holds, in words.

use super::error::OutputError;
use super::read::Results;
use crate::comm::Comm;
use std::fmt::Write;
use std::path::Path;

/// A summary of a results file: what was run, by which version, and a table of its samples. For one rank.
pub fn info(path: &Path) -> Result<String, OutputError> {
    let results = Results::open(&Comm::alone(), path)?;
    let series = results.series()?;
    let header = &results.header;
    let kind = if results.model() == "sp" { "soft disks (sp)" } else { "deformable particles (dp)" };
    let mut out = format!("{}\n", path.display());
    let mut line = |name: &str, value: &str| {
        let _ = writeln!(out, "  {name:<10} {value}");
    };
    line("status", results.failure.as_deref().unwrap_or("complete"));
    line("model", &format!("{kind}, {} particles, seed {}", results.particles, header.seed));
    let constants: String = header.potential.iter().map(|(name, value)| format!(", {name} = {value}")).collect();
    line("potential", &format!("{}{constants}", header.contact));
    line("units", &header.units);
    line("written by", &format!("jamhpc {} ({})", results.version, results.git_hash));
    line("samples", &results.frames.to_string());

    // headings are those of a run's table, numbers in the units of the file
    let columns = [
        ("packing_fraction", "rho"),
        ("reduced_number_density", "phi"),
        ("contact_number", "z"),
        ("shape_parameter_relative", if results.model() == "sp" { "A" } else { "A relative" }),
        ("pressure", "p"),
        ("energy_total", "U"),
        ("max_force", "max|F|"),
    ];
    let is_sheared = series.iter().any(|(name, values)| name == "strain" && values.iter().any(|&x| x != 0.0));
    let shown: Vec<(&str, &Vec<f64>)> = is_sheared
        .then_some(("strain", "strain"))
        .into_iter()
        .chain(columns)
        .filter_map(|(name, heading)| series.iter().find(|(n, _)| n == name).map(|(_, values)| (heading, values)))
        .collect();
    if results.frames > 0 && !shown.is_empty() {
        let headings: String = shown.iter().map(|(heading, _)| format!(" {heading:>12}")).collect();
        let _ = writeln!(out, "\n{:>7}{headings}", "frame");
        for k in 0..results.frames {
            let row: String = shown.iter().map(|(_, values)| format!(" {:>12}", number(values[k]))).collect();
            let _ = writeln!(out, "{k:>7}{row}");
        }
    }
    let _ = write!(out, "\nscene:\n{}\n", header.scene.trim_end());
    Ok(out)
}

/// Seven digits, in powers of ten where the number is small or large.
fn number(x: f64) -> String {
    if x == 0.0 || (1e-3..1e5).contains(&x.abs()) { format!("{x:.6}") } else { format!("{x:.5e}") }
}
