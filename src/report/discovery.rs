//! report.html of `discover`: the gap, where it is, what explains it, before and after.

use super::html::{definitions, escaped, list, style, table};
use super::plot::{Plot, Point, Series, Style};
use crate::discover::{Data, Discovery, Next, Verdict};

/// The page.
pub fn discovery_html(found: &Discovery, data: &Data, next: Option<&Next>) -> String {
    let mut page = format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <title>snakeloop: discover</title>\n<style>{}</style>\n</head>\n<body>\n<main>\n<h1>What the model lacks</h1>\n<p>{}</p>\n",
        style(),
        escaped(&sentence(found))
    );
    page += &definitions("summary", &summary(found));
    page += &effects(found);
    page += "<h2>The gap of ε</h2>\n<div class=\"plots\">\n";
    let before = if found.verdict == Verdict::Named { "before" } else { "gap" };
    for (what, x) in abscissae(data) {
        for (when, side) in [(before, 0), ("after", 1)] {
            if side == 1 && found.verdict != Verdict::Named {
                continue;
            }
            let series = (0..3).map(|i| Series {
                name: format!("backbone {}", i + 1),
                style: Style::Dots,
                points: x
                    .iter()
                    .zip(&found.residuals_mm)
                    .map(|(&x, gaps)| Point { x, y: gaps[side][i], sd: 0.0 })
                    .collect(),
            });
            let plot = Plot { x_label: what.into(), y_label: "gap of ε (mm)".into(), series: series.collect() };
            if let Some(svg) = plot.svg() {
                let svg = svg.replace(" xmlns=\"http://www.w3.org/2000/svg\"", "");
                page += &format!(
                    "<figure><h3>{when}, over {what}</h3>{svg}<figcaption>Measured ε less the model's, on sweeps that the \
                     fit did not see.</figcaption></figure>\n"
                );
            }
        }
    }
    page += "</div>\n";
    page += &next.map(proposal).unwrap_or_default();
    page += &list("Remarks", "What was passed over, or could not be decided.", &found.remarks);
    page + "</main>\n</body>\n</html>\n"
}

/// The next experiment.
fn proposal(next: &Next) -> String {
    let rows: Vec<[String; 2]> =
        next.candidates.iter().map(|(name, gain)| [name.replace('_', " "), format!("{gain:.2}")]).collect();
    format!(
        "<h2>The next experiment</h2>\n<p>{}</p>\n{}",
        escaped(&next.sentence()),
        table("Rides compared", ["ride", "told apart by, in squares of the noise per sample"], &rows)
    ) + &list("Beyond reach", "Open as well, and not settled by this ride.", &next.beyond_reach)
}

/// The verdict in a sentence.
pub fn sentence(found: &Discovery) -> String {
    match found.verdict {
        Verdict::None => {
            "Nothing is missing that these data could show: the gap is the measurements' own noise.".into()
        }
        Verdict::Unexplained => {
            let most = found.structure_after.follows.first();
            let follows = most.map(|(what, _)| format!(" It follows {what} most.")).unwrap_or_default();
            format!("Something is missing, and no effect of the library accounts for it.{follows}")
        }
        Verdict::Named => {
            let readings: Vec<String> = found
                .named
                .iter()
                .map(|named| {
                    format!(
                        "{} ({}{})",
                        named.physics.reading,
                        named.physics.name,
                        parameters(found, named.physics.name)
                    )
                })
                .collect();
            format!("The data show {}.", readings.join(", and "))
        }
    }
}

/// ": play_mm = 0.110 ± 0.001 mm".
fn parameters(found: &Discovery, name: &str) -> String {
    let Some(effect) = found.model.effects.iter().find(|effect| effect.physics.name == name) else {
        return String::new();
    };
    let values = effect.physics.parameters.iter().zip(effect.values.iter().zip(&effect.sds));
    let texts: Vec<String> = values
        .map(|(spec, (value, sd))| {
            let unit = if spec.unit == "1" { "" } else { spec.unit };
            format!("{} = {value:.4} ± {sd:.4} {unit}", spec.name).trim_end().to_owned()
        })
        .collect();
    format!(": {}", texts.join(", "))
}

fn summary(found: &Discovery) -> Vec<(String, String)> {
    let pair = |name: &str, value: String| (name.to_owned(), value);
    let (before, after) = (&found.before, &found.after);
    vec![
        pair("Verdict", found.verdict.word().to_owned()),
        pair("Samples", found.samples.to_string()),
        pair("Gap of ε", format!("{:.4} mm before, {:.4} mm after", before.eps_mm, after.eps_mm)),
        pair("Noise alone", format!("{:.4} mm", found.noise_floor_mm)),
        pair("Gap of θ", format!("{:.3}° before, {:.3}° after", before.theta_deg, after.theta_deg)),
        pair("Gap of δ", format!("{:.3}° before, {:.3}° after", before.delta_deg, after.delta_deg)),
    ]
}

fn effects(found: &Discovery) -> String {
    let mut section = String::new();
    if found.verdict == Verdict::Unexplained && !found.named.is_empty() {
        section += "<p>What follows takes part of the gap away, but leaves more than noise. It is evidence, not an answer.</p>\n";
    }
    for named in &found.named {
        let rivals: Vec<[String; 2]> =
            named.rivals.iter().take(6).map(|(name, worse)| [(*name).to_owned(), format!("{worse:.1}")]).collect();
        section += &format!(
            "<h2>{}</h2>\n<p>{}</p>\n<p>{}</p>\n",
            escaped(named.physics.name),
            escaped(named.physics.equation),
            escaped(named.physics.reading)
        );
        let mut facts = vec![
            ("Gain in Schwarz's criterion".to_owned(), format!("{:.1}", named.bic_gain)),
            ("Share of the unseen gap removed".to_owned(), format!("{:.1} %", 100.0 * named.held_out_gain)),
            ("Needed in resampled experiments".to_owned(), format!("{:.1} %", 100.0 * named.inclusion)),
        ];
        if !named.indistinguishable_from.is_empty() {
            let names = named.indistinguishable_from.join(", ");
            facts.push(("These data cannot tell it from".to_owned(), names));
        }
        section += &definitions("summary", &facts);
        section += &table("Rivals in its place", ["effect", "worse by (Schwarz's criterion)"], &rivals);
    }
    section
}

fn abscissae(data: &Data) -> Vec<(&'static str, Vec<f64>)> {
    vec![
        ("θ (°)", data.measured.iter().map(|m| m.configuration.theta_deg()).collect()),
        ("δ (°)", data.measured.iter().map(|m| m.configuration.delta_deg()).collect()),
        ("time (s)", data.times_s.clone()),
    ]
}
