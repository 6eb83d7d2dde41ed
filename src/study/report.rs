//! The report of a study: tables and figures in one HTML file that needs no other.

use super::data::{Ensemble, Packings};
use super::densities::at_densities;
use super::figures::{self, NUMBERS};
use super::findings::{Finding, Findings, of_ensemble, of_size, table_size};
use super::paper::{self, Row};
use crate::output::picture::with_names;
use crate::output::plot::panels;
use crate::scene::Model;
use crate::statistics::Estimate;
use std::fmt::Write;

/// Everything that a study found, ensemble by ensemble.
pub fn findings(ensembles: &[Ensemble]) -> Vec<Findings> {
    let disks = |n_particles: usize| {
        let mut sizes = ensembles.iter().flat_map(|e| &e.sizes);
        sizes.find(|s| s.model == Model::Sp && s.n_particles == n_particles)
    };
    let of = |e: &Ensemble| {
        let deformable = e.sizes.iter().filter(|s| s.model == Model::Dp);
        let at_densities = deformable.map(|s| at_densities(s, disks(s.n_particles))).collect();
        [vec![of_ensemble(e)], e.sizes.iter().map(of_size).collect(), at_densities].concat()
    };
    ensembles.iter().flat_map(of).filter(|found: &Findings| !found.rows.is_empty()).collect()
}

/// All findings as a table for people and programs (CSV).
pub fn csv(all: &[Findings]) -> String {
    let mut out = "packings,symbol,found,standard_error,low_95,high_95,paper,sigmas,law\n".to_owned();
    for findings in all {
        for Finding { symbol, law, found, paper } in &findings.rows {
            let (paper, sigmas) = match paper {
                Some(p) => (p.to_string(), format!("{:.2}", found.sigmas(*p))),
                None => Default::default(),
            };
            let Estimate { value, error, interval: [low, high] } = found;
            let title = &findings.title;
            let _ = writeln!(out, "\"{title}\",{symbol},{value},{error},{low},{high},{paper},{sigmas},\"{law}\"");
        }
    }
    out
}

/// The report. `pictures` are SVG documents with captions.
pub fn html(
    name: &str,
    version: &str,
    ensembles: &[Ensemble],
    all: &[Findings],
    pictures: &[(String, String)],
) -> String {
    let mut body = format!("<h1>Study {}</h1>\n<p>jamhpc {version}. ", escape(name));
    body += "Errors are standard errors by resampling packings; intervals hold 95 % of the resamples. Moduli of soft \
             disks are in ε/σ<sub>LS</sub>², those of deformable particles in γ/l; the paper gives the latter in \
             ε<sub>r</sub>/l², so that only ratios compare.</p>\n";
    body += &packings_table(ensembles);
    for (table, symbol, law, pick) in TABLES {
        let _ = write!(body, "<h2>{table}</h2>\n{}", paper_table(ensembles, all, symbol, law, pick));
    }
    for (caption, svg) in pictures {
        let _ =
            writeln!(body, "<figure>{}<figcaption>{}</figcaption></figure>", with_names(svg, caption), escape(caption));
    }
    for number in NUMBERS {
        let Some(figure) = figures::figure(number, ensembles).filter(|f| !f.panels.is_empty()) else { continue };
        let svg = panels(&figure.panels, figure.columns).to_svg();
        let key = format!("figure {number}");
        let caption = figure.caption;
        let _ = writeln!(
            body,
            "<figure>{}<figcaption>As the paper's figure {number}: {caption}.</figcaption></figure>",
            with_names(&svg, &key)
        );
    }
    body += "<h2>All numbers</h2>\n";
    for findings in all {
        let _ = write!(body, "<h3>{}</h3>\n{}", escape(&findings.title), findings_table(findings));
    }
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>{}</title>{STYLE}</head>\n<body>\n{body}</body></html>\n",
        escape(name)
    )
}

const STYLE: &str = "<style>body{font-family:sans-serif;max-width:75em;margin:2em auto;padding:0 1em}\
    table{border-collapse:collapse;margin:1em 0}td,th{padding:.2em .8em;text-align:right;border-bottom:1px solid #ccc}\
    td:first-child,th:first-child,td.law{text-align:left}figure{margin:2em 0}svg{max-width:100%;height:auto}\
    figcaption{color:#444}</style>";

type Pick = fn(&Row) -> [f64; 2];

const TABLES: [(&str, &str, &str, Pick); 2] = [
    ("Table 1: Δz = z₀ Δ^0.5 + z₁ Δ", "z", "Δz", |row| row.contacts),
    ("Table 2: G = G₀ Δ^0.5 + G₁ Δ", "G", "G", |row| row.modulus),
];

fn packings_table(ensembles: &[Ensemble]) -> String {
    let mut rows = String::new();
    for s in ensembles.iter().flat_map(|e| &e.sizes) {
        let onsets = s.onsets();
        let mean = crate::statistics::mean(onsets.iter().copied());
        let spread = crate::statistics::spread(onsets.iter().copied());
        let error = spread / (onsets.len() as f64).sqrt();
        let [mean, spread] = match onsets.len() {
            0 => ["–".into(), "–".into()],
            1 => [format!("{mean:.5}"), "–".into()],
            _ if s.resolves_onsets() => [format!("{mean:.5} ± {error:.5}"), format!("{spread:.5}")],
            _ => [format!("{mean:.5}, to {:.5}", s.onset_excess()), "–".into()],
        };
        let reason = s.failures.first().map_or(String::new(), |reason| format!(", such as: {}", escape(reason)));
        let _ = writeln!(
            rows,
            "<tr><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}{reason}</td></tr>",
            escape(&s.ensemble),
            s.n_particles,
            s.all.len(),
            mean,
            spread,
            s.failures.len(),
        );
    }
    format!(
        "<table><tr><th>ensemble</th><th>N</th><th>packings</th><th>mean onset</th><th>spread</th>\
         <th>failed</th></tr>\n{rows}</table>\n"
    )
}

/// One of the paper's two tables: its amplitudes, ours, and the difference in our standard errors.
fn paper_table(ensembles: &[Ensemble], all: &[Findings], symbol: &str, of: &str, pick: Pick) -> String {
    let mut rows = String::new();
    for ensemble in ensembles {
        let Some(found) = table_size(ensemble).and_then(|s| of_table_size(s, all)) else { continue };
        let variants: &[(&str, Row)] = match ensemble.model {
            Model::Sp => &[("φ", paper::SP_PHI), ("ρ", paper::SP_RHO)],
            Model::Dp => &[("ρ", paper::DP_RHO)],
        };
        for (against, row) in variants {
            let law = format!("{of} = {symbol}_0 Δ{against}^0.5{}", if *against == "φ" { "," } else { " +" });
            let title = format!("{}({against})", found.title);
            let mut cells = format!("<td>{}</td>", escape(&title));
            for (k, paper) in pick(row).into_iter().enumerate() {
                let estimate = found.get(&format!("{symbol}_{k}"), &law);
                let comparable = symbol == "z" || ensemble.model == Model::Sp;
                cells += &match estimate {
                    Some(e) if comparable => {
                        format!("<td>{paper}</td><td>{}</td><td>{:+.1}</td>", plus_minus(&e), e.sigmas(paper))
                    }
                    Some(e) => format!("<td>{paper} ε<sub>r</sub>/l²</td><td>{}</td><td></td>", plus_minus(&e)),
                    None => format!("<td>{paper}</td><td></td><td></td>"),
                };
            }
            let ratio = pick(row)[1] / pick(row)[0];
            cells += &match found.get(&format!("{symbol}_1/{symbol}_0"), &law) {
                Some(e) => format!("<td>{ratio:.2}</td><td>{}</td>", plus_minus(&e)),
                None => "<td></td><td></td>".into(),
            };
            let _ = writeln!(rows, "<tr>{cells}</tr>");
        }
    }
    let heads: String = [0, 1]
        .iter()
        .map(|k| format!("<th>{symbol}<sub>{k}</sub> paper</th><th>ours</th><th>difference/σ</th>"))
        .collect();
    let ratio = format!("{symbol}<sub>1</sub>/{symbol}<sub>0</sub>");
    format!("<table><tr><th></th>{heads}<th>{ratio} paper</th><th>ours</th></tr>\n{rows}</table>\n")
}

fn of_table_size<'a>(size: &Packings, all: &'a [Findings]) -> Option<&'a Findings> {
    let title = format!("{}, N = {}", size.ensemble, size.n_particles);
    all.iter().find(|found| found.title == title)
}

fn findings_table(findings: &Findings) -> String {
    let mut rows = String::new();
    for Finding { symbol, law, found, paper } in &findings.rows {
        let [low, high] = found.interval;
        let (paper, sigmas) = match paper {
            Some(p) => (p.to_string(), format!("{:+.1}", found.sigmas(*p))),
            None => Default::default(),
        };
        let _ = writeln!(
            rows,
            "<tr><td>{}</td><td>{}</td><td>{low:.4} to {high:.4}</td><td>{paper}</td><td>{sigmas}</td>\
             <td class=\"law\">{}</td></tr>",
            escape(symbol),
            plus_minus(found),
            escape(law)
        );
    }
    format!(
        "<table><tr><th></th><th>found</th><th>95 %</th><th>paper</th><th>difference/σ</th>\
         <th>law and window</th></tr>\n{rows}</table>\n"
    )
}

/// A number and its error, as many digits as the error has two of.
pub fn plus_minus(e: &Estimate) -> String {
    if !(e.error > 0.0 && e.error.is_finite()) {
        return format!("{:.4}", e.value);
    }
    let digits = (1.0 - e.error.log10().floor()).clamp(0.0, 12.0) as usize;
    format!("{:.digits$} ± {:.digits$}", e.value, e.error)
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}
