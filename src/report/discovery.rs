//! report.html of `discover`: the gap, where it is, what explains it, before and after.

use super::bend_map::bend_map;
use super::html::{definitions, escaped, list, style, table};
use super::plot::{Plot, Point, Series, Style};
use crate::discover::{Correction, Data, Discovery, Named, Next, Part, Verdict, Whereabouts};
use std::fmt::Write;

/// What the page is made of.
#[derive(Debug, Clone, Copy)]
pub struct Page<'a> {
    /// The answer.
    pub found: &'a Discovery,
    /// The samples.
    pub data: &'a Data,
    /// Where the gap is, where there is one.
    pub gap: Option<&'a Whereabouts>,
    /// What came of learning a correction, where it was asked for.
    pub correction: Option<&'a Correction>,
    /// The next experiment, where it was asked for and something is open.
    pub next: Option<&'a Next>,
}

impl Page<'_> {
    /// The page as HTML; it asks no other address for anything.
    pub fn html(&self) -> String {
        let found = self.found;
        let mut page = format!(
            "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
             <title>snakeloop: discover</title>\n<style>{}{STYLE}</style>\n</head>\n<body>\n<main>\n\
             <h1>What the model lacks: {}</h1>\n<p class=\"verdict\">{}</p>\n",
            style(),
            escaped(&heading(found)),
            escaped(&sentence(found))
        );
        page += &definitions("summary", &summary(found));
        page += GLOSSARY;
        page += &self.whereabouts();
        page += &effects(found);
        page += &self.before_and_after();
        let correction = self.correction.map(|c| paragraph("The correction", &capitalised(&c.words)));
        page += &correction.unwrap_or_default();
        page += &self.next.map(proposal).unwrap_or_default();
        page += &list("Remarks", "What was passed over, or could not be decided.", &found.remarks);
        page + "</main>\n</body>\n</html>\n"
    }

    fn whereabouts(&self) -> String {
        let Some(gap) = self.gap else { return String::new() };
        let mut section = paragraph("Where the gap is", &format!("It is {}.", gap.words()));
        let part = match gap.part {
            Part::Backbone(i) => format!("The gap of ε of backbone {i}"),
            Part::Common => "The part of the gap of ε that the backbones share".to_owned(),
            Part::Several => "The gap of ε of the backbone that has most of it".to_owned(),
        };
        let values = self.data.measured.iter().zip(&gap.gap_mm).map(|(m, gap)| (m.configuration, *gap));
        let values: Vec<_> = values.step_by(self.every()).collect();
        if let Some(map) = bend_map(&values, "mm").map(maud::Markup::into_string) {
            let _ = writeln!(
                section,
                "<figure class=\"map\"><h3>{part}, over the bends</h3>{map}<figcaption>Each dot is a bend, seen from the tip: \
                 its distance from the middle is θ, its direction δ. The larger the dot, the larger the gap that the model \
                 as given leaves.</figcaption></figure>"
            );
        }
        section
    }

    fn before_and_after(&self) -> String {
        let found = self.found;
        let named = found.verdict == Verdict::Named;
        let titles: &[&str] = if named { &["before", "after"] } else { &["as it is"] };
        let mut section = format!(
            "<h2>{}</h2>\n<p>Measured ε less what the model says, at every sample, on sweeps that the fit did not see. Noise alone \
             leaves {:.4} mm rms.</p>\n<div class=\"plots\">\n",
            if named { "Before and after" } else { "The gap of ε" },
            found.noise_floor_mm
        );
        let all = || found.residuals_mm.iter().flat_map(|sides| sides.iter().flat_map(|gap| gap.iter().copied()));
        let shown = vec![all().fold(f64::INFINITY, f64::min), all().fold(f64::NEG_INFINITY, f64::max)];
        for (what, x) in self.abscissae() {
            for (side, title) in titles.iter().enumerate() {
                let series = (0..self.data.backbones()).map(|i| Series {
                    name: format!("backbone {}", i + 1),
                    style: Style::Dots,
                    points: x
                        .iter()
                        .zip(&found.residuals_mm)
                        .step_by(self.every())
                        .map(|(&x, gaps)| Point { x, y: gaps[side][i], sd: 0.0 })
                        .collect(),
                });
                let plot = Plot {
                    x_label: what.into(),
                    y_label: "gap of ε (mm)".into(),
                    series: series.collect(),
                    y_shown: shown.clone(),
                };
                if let Some(svg) = plot.svg() {
                    let svg = svg.replace(" xmlns=\"http://www.w3.org/2000/svg\"", "");
                    let _ = writeln!(section, "<figure><h3>{title}, over {what}</h3>{svg}</figure>");
                }
            }
        }
        section + "</div>\n"
    }

    /// One of so many samples is drawn, so that a page of any experiment opens.
    fn every(&self) -> usize {
        self.data.len().div_ceil(MOST_DOTS)
    }

    fn abscissae(&self) -> Vec<(&'static str, Vec<f64>)> {
        let data = self.data;
        vec![
            ("θ (°)", data.measured.iter().map(|m| m.configuration.theta_deg()).collect()),
            ("δ (°)", data.measured.iter().map(|m| m.configuration.delta_deg()).collect()),
            ("time (s)", data.times_s.clone()),
        ]
    }
}

const GLOSSARY: &str = "<p>ε is how much further the actuators move (q̃, what their encoders read) than the snake's backbones do: what \
                        the actuation lines swallow. The gap is the measured ε less the model's; θ is the bend, δ its direction.</p>\n";

/// Dots of one series.
const MOST_DOTS: usize = 1500;

const STYLE: &str = "
.verdict { font-size: 1.15rem; color: var(--ink); max-width: 48rem; }
.equation { font-family: ui-monospace, monospace; color: var(--ink); overflow-wrap: anywhere; }
.map { max-width: 30rem; }
";

fn paragraph(title: &str, text: &str) -> String {
    format!("<h2>{}</h2>\n<p>{}</p>\n", escaped(title), escaped(text))
}

/// The next experiment.
fn proposal(next: &Next) -> String {
    let rows: Vec<[String; 2]> =
        next.candidates.iter().map(|(name, gain)| [name.replace('_', " "), format!("{gain:.2}")]).collect();
    let mut section = paragraph("The next experiment", &next.sentence());
    section += &table("Rides compared", ["ride", "told apart by, in squares of the noise per sample"], &rows);
    section + &list("Beyond reach", "Open as well, and not settled by this ride.", &next.beyond_reach)
}

/// The verdict in a word or two.
fn heading(found: &Discovery) -> String {
    match found.verdict {
        Verdict::None => "nothing".to_owned(),
        Verdict::Unexplained => "something without a name".to_owned(),
        Verdict::Named => {
            let names: Vec<String> = found.named.iter().map(|named| named.physics.name.replace('_', " ")).collect();
            names.join(" and ")
        }
    }
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
                    let size = parameters(found, named.physics.name).join(", ");
                    let or = match &named.indistinguishable_from[..] {
                        [] => String::new(),
                        rivals => format!(" (these data cannot tell it from {})", rivals.join(", ")),
                    };
                    format!("{} ({}: {size}){or}", named.physics.reading, named.physics.name)
                })
                .collect();
            format!("The data show {}.", readings.join(", and "))
        }
    }
}

/// "play_mm = 0.110 ± 0.001 mm" for each parameter, as far as its sd is worth digits.
fn parameters(found: &Discovery, name: &str) -> Vec<String> {
    let effects = &found.model.effects;
    let Some(k) = effects.iter().position(|effect| effect.physics.name == name) else { return Vec::new() };
    let sds = found.model.effect_sds(k);
    let values = effects[k].parameters().iter().zip(effects[k].values.iter().zip(&sds));
    values
        .map(|(spec, (value, sd))| {
            let unit = if spec.unit == "1" { "" } else { spec.unit };
            let digits = if *sd > 0.0 { (1.0 - sd.log10().floor()).clamp(0.0, 7.0) as usize } else { 4 };
            format!("{} = {value:.digits$} ± {sd:.digits$} {unit}", spec.name).trim_end().to_owned()
        })
        .collect()
}

fn summary(found: &Discovery) -> Vec<(String, String)> {
    let pair = |name: &str, value: String| (name.to_owned(), value);
    let (before, after) = (&found.before, &found.after);
    let sides = |before: f64, after: f64, unit: &str, digits: usize| match found.verdict {
        Verdict::Named => format!("{before:.digits$}{unit} before, {after:.digits$}{unit} after"),
        _ => format!("{before:.digits$}{unit}"),
    };
    vec![
        pair("Verdict", found.verdict.word().to_owned()),
        pair("Samples", found.samples.to_string()),
        pair("Gap of ε (rms)", sides(before.eps_mm, after.eps_mm, " mm", 4)),
        pair("Noise alone", format!("{:.4} mm", found.noise_floor_mm)),
        pair("Gap of θ (rms)", sides(before.theta_deg, after.theta_deg, "°", 3)),
        pair("Gap of δ (rms, θ ≥ 15°)", sides(before.delta_deg, after.delta_deg, "°", 3)),
    ]
}

fn effects(found: &Discovery) -> String {
    let mut section = String::new();
    if found.verdict == Verdict::Unexplained && !found.named.is_empty() {
        section += "<h2>What was considered</h2>\n<p>Each of these takes part of the gap away, but what is left is more than \
                    noise. It is evidence, not an answer.</p>\n";
    }
    if found.verdict == Verdict::Unexplained && found.named.is_empty() {
        section += "<h2>What was considered</h2>\n<p>Every effect of the library, alone and together with others; none takes enough \
                    of the gap away on sweeps left out.</p>\n";
    }
    for named in &found.named {
        section += &effect(found, named);
    }
    section
}

fn effect(found: &Discovery, named: &Named) -> String {
    let rivals: Vec<[String; 2]> =
        named.rivals.iter().take(6).map(|(name, worse)| [(*name).to_owned(), format!("{worse:.1}")]).collect();
    let mut section = format!(
        "<h2>{}</h2>\n<p>{}</p>\n<p class=\"equation\">{}</p>\n",
        escaped(named.physics.name),
        escaped(&capitalised(named.physics.reading)),
        escaped(named.physics.equation)
    );
    if !named.physics.form.is_empty() {
        section += &format!("<p>In the form: {}.</p>\n", escaped(named.physics.form));
    }
    let mut facts: Vec<(String, String)> = Vec::new();
    for parameter in parameters(found, named.physics.name) {
        if let Some((name, value)) = parameter.split_once(" = ") {
            facts.push((name.to_owned(), value.to_owned()));
        }
    }
    facts.push(("Gain in Schwarz's criterion (12 are asked)".to_owned(), format!("{:.1}", named.bic_gain)));
    facts.push(("Share of the unseen gap removed".to_owned(), format!("{:.1} %", 100.0 * named.held_out_gain)));
    facts.push(("Needed in resampled experiments".to_owned(), format!("{:.1} %", 100.0 * named.inclusion)));
    if !named.indistinguishable_from.is_empty() {
        facts.push(("These data cannot tell it from".to_owned(), named.indistinguishable_from.join(", ")));
    }
    section += &definitions("summary", &facts);
    let title = format!("What was tried in place of {}", named.physics.name);
    section += &table(&title, ["effect", "worse by (Schwarz's criterion)"], &rivals);
    section
        + "<p>Schwarz's criterion weighs what an answer leaves unexplained, in squares of the noise, against its number of parameters. \
           Less is better; what is worse by more than 6 is ruled out.</p>\n"
}

fn capitalised(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| format!("{}{}.", first.to_uppercase(), letters.as_str()))
}
