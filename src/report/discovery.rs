//! report.html of `discover`: the gap, where it is, what explains it, before and after.

use super::bend_map::{bend_map, strongest};
use super::page::{definitions, document, figure, list, made_from, table};
use super::plot::{Plot, Point, Series, Style};
use crate::discover::{
    Candidate, Data, Discovery, EffectTrace, Gap, Localisation, Named, NextExperiment, ProposedLaw, Verdict,
    effect_traces,
};
use crate::quantity::with_sd;
use crate::record::Provenance;
use crate::robot::effects::REST_BEND;
use maud::{Markup, html};
use nalgebra::Vector2;

/// The most dots of one series.
///
/// Convention: pages with more are slow to open.
const MOST_DOTS: usize = 1500;

/// Alternatives that are listed under an effect.
///
/// Convention: a display choice.
const MOST_ALTERNATIVES: usize = 6;

const GLOSSARY: &str = "ε is how much further the actuators move (q̃, what their encoders read) than the snake's backbones do: what \
                        the actuation lines take up. The gap is the measured ε less the model's; θ is the bend, δ its direction.";

const STYLE: &str = "
.verdict { font-size: 1.15rem; color: var(--ink); max-width: 48rem; }
@media (min-width: 60rem) { .summary { grid-template-columns: repeat(3, 1fr); } }
.equation { font-family: ui-monospace, monospace; color: var(--ink); overflow-wrap: anywhere; }
";

/// What the page is made of.
#[derive(Debug, Clone, Copy)]
pub struct Page<'a> {
    /// The answer.
    pub found: &'a Discovery,
    /// The samples.
    pub data: &'a Data,
    /// Where the gap is, where there is one.
    pub gap: Option<&'a Localisation>,
    /// What came of looking for a law, where it was asked for.
    pub correction: Option<&'a ProposedLaw>,
    /// The next experiment, where it was asked for and something is open.
    pub next: Option<&'a NextExperiment>,
    /// What the answer was made from.
    pub made_from: &'a Provenance,
}

impl Page<'_> {
    /// The page as HTML; it asks no other address for anything.
    pub fn html(&self) -> String {
        let found = self.found;
        let traces = effect_traces(found, self.data);
        let content = html! {
            h1 { "What the model lacks: " (heading(found)) }
            p.verdict { (sentence(found)) }
            (definitions("summary", &summary(found)))
            p { (GLOSSARY) }
            @if let Some(gap) = self.gap { (self.localisation(gap)) }
            (considered(found))
            (structures(found))
            @for (k, named) in found.named.iter().enumerate() {
                (effect(found, named))
                @if let Some(trace) = traces.get(k) { (self.loops(trace)) }
            }
            (self.before_and_after())
            @if let Some(correction) = self.correction {
                h2 { "The proposed law" }
                @if let Some(effect) = correction.effect() { p.equation { (effect.physics.equation) } }
                p { (capitalised(&correction.words)) }
            }
            @if let Some(next) = self.next { (proposal(next)) }
            (list("Remarks", "Rows that were left out, and questions that stay open.", &found.remarks))
            (made_from(self.made_from))
        };
        document("snakeloop: discover", STYLE, &content)
    }

    /// Where the gap is, in words and as a map for each backbone, all on one scale.
    fn localisation(&self, gap: &Localisation) -> Markup {
        let before = || self.found.residuals_mm.iter().map(|[before, _]| before);
        let strongest = strongest(before().flat_map(|gap| gap.iter().copied()));
        let map = |i: usize| {
            let bends = self.data.measured.iter().map(|measured| measured.configuration);
            let values: Vec<_> = bends.zip(before().map(|gap| gap[i])).step_by(self.every()).collect();
            bend_map(&values, "mm", strongest)
        };
        html! {
            h2 { "Where the gap is" }
            p { "It is " (gap.words()) "." }
            .plots {
                @for i in 0..self.data.backbones() {
                    @if let Some(map) = map(i) {
                        figure { h3 { (format!("The gap of ε of backbone {} over the bends", i + 1)) } (map) }
                    }
                }
            }
            p {
                "Each dot is a bend, seen from the tip: its distance from the middle is θ, its direction δ. The larger the dot, the larger \
                 the gap that the model as given leaves."
            }
        }
    }

    /// The loops of an effect found: the bend over the command, and the gap over what the effect follows.
    fn loops(&self, trace: &EffectTrace) -> Markup {
        let EffectTrace { backbone, command_mm, measured_deg, modelled_deg, gap_mm, follows, followed } = trace;
        let beyond =
            |side: usize| measured_deg.iter().zip(&modelled_deg[side]).map(|(a, b)| a - b).collect::<Vec<f64>>();
        let beyond = [beyond(0), beyond(1)];
        let dots = |name: &str, x: &[f64], y: &[f64]| {
            let points = x.iter().zip(y).step_by(self.every()).map(|(&x, &y)| Point { x, y, sd: 0.0 });
            Series { name: name.to_owned(), style: Style::Dots, points: points.collect() }
        };
        let plot = |x_label: &str, y_label: &str, series: Vec<Series>| Plot {
            x_label: x_label.to_owned(),
            y_label: y_label.to_owned(),
            series,
            y_shown: if y_label.contains("missed") || y_label.contains("gap") { vec![0.0] } else { Vec::new() },
        };
        let command = format!("q̃ of backbone {backbone} (mm)");
        let bends = [("measured", measured_deg), ("by the model", &modelled_deg[1])];
        let sides = [("without it", 0), ("with it", 1)];
        let of_sides = |x: &[f64], y: &[Vec<f64>; 2]| sides.map(|(name, side)| dots(name, x, &y[side])).to_vec();
        html! {
            .plots {
                (figure("The bend over the command", &plot(&command, "bend towards it (°)",
                    bends.map(|(name, bend)| dots(name, command_mm, bend)).to_vec()), ""))
                (figure("What the model misses of it", &plot(&command, "bend missed (°)", of_sides(command_mm, &beyond)), ""))
                (figure("The gap over what the effect follows", &plot(follows, "gap of ε (mm)", of_sides(followed, gap_mm)), ""))
            }
            p {
                "Backbone " (backbone) " is where the effect does most. Without it all else is fitted anew; all samples are shown, as \
                 they were fitted."
            }
        }
    }

    fn before_and_after(&self) -> Markup {
        let found = self.found;
        let (heading, titles): (_, &[&str]) = match found.verdict {
            Verdict::Named | Verdict::Partly => ("Before and after", &["Before", "After"]),
            _ => ("The gap of ε", &["As it is"]),
        };
        html! {
            h2 { (heading) }
            p {
                "Measured ε less what the model says, at every sample, on held-out sweeps, which the fit did not see. Noise alone leaves "
                (format!("{:.4} mm rms.", found.noise_floor_mm))
            }
            .plots {
                @for (side, title) in titles.iter().enumerate() {
                    @for (what, x) in self.abscissae() {
                        (figure(&format!("{title}, over {what}"), &self.plot(what, &x, side), ""))
                    }
                }
            }
        }
    }

    /// The gap before (side 0) or after (1) over one quantity; all plots show the same range.
    fn plot(&self, what: &str, x: &[f64], side: usize) -> Plot {
        let gaps = &self.found.residuals_mm;
        let all = || gaps.iter().flat_map(|sides| sides.iter().flat_map(|gap| gap.iter().copied()));
        let points = |i: usize| {
            let shown = x.iter().zip(gaps).step_by(self.every());
            shown.map(|(&x, sides)| Point { x, y: sides[side][i], sd: 0.0 }).collect()
        };
        let series = (0..self.data.backbones()).map(|i| Series {
            name: format!("backbone {}", i + 1),
            style: Style::Dots,
            points: points(i),
        });
        Plot {
            x_label: what.into(),
            y_label: "gap of ε (mm)".into(),
            series: std::iter::once(self.noise(x)).chain(series).collect(),
            y_shown: vec![all().fold(f64::INFINITY, f64::min), 0.0, all().fold(f64::NEG_INFINITY, f64::max)],
        }
    }

    /// The gap that noise alone would leave, as a band over these places.
    fn noise(&self, x: &[f64]) -> Series {
        let ends =
            [x.iter().copied().fold(f64::INFINITY, f64::min), x.iter().copied().fold(f64::NEG_INFINITY, f64::max)];
        let points = ends.map(|x| Point { x, y: 0.0, sd: self.found.noise_floor_mm }).to_vec();
        Series { name: "noise alone".to_owned(), style: Style::Band, points }
    }

    /// One of so many samples is drawn, so that a page of any experiment opens.
    fn every(&self) -> usize {
        self.data.len().div_ceil(MOST_DOTS)
    }

    fn abscissae(&self) -> [(&'static str, Vec<f64>); 3] {
        let data = self.data;
        [
            ("θ (°)", data.measured.iter().map(|m| m.configuration.theta_deg()).collect()),
            ("δ (°)", data.measured.iter().map(|m| m.configuration.delta_deg()).collect()),
            ("time (s)", data.times_s.clone()),
        ]
    }
}

/// The next experiment.
fn proposal(next: &NextExperiment) -> Markup {
    let rows: Vec<[String; 2]> =
        next.candidates.iter().map(|(name, gain)| [name.replace('_', " "), format!("{gain:.2}")]).collect();
    let header = ["trajectory", "least noncentrality, in squares of the noise per sample"];
    html! {
        h2 { "The next experiment" }
        p { (next.sentence()) }
        (table("Trajectories compared", header, &rows))
        (list("Beyond reach", "Questions that this trajectory does not decide.", &next.beyond_reach))
    }
}

/// The verdict in a word or two.
fn heading(found: &Discovery) -> String {
    match found.verdict {
        Verdict::None => "nothing".to_owned(),
        Verdict::Unexplained => "something without a name".to_owned(),
        Verdict::Named | Verdict::Partly => {
            let names: Vec<String> = found.named.iter().map(|named| named.physics.name.replace('_', " ")).collect();
            names.join(" and ") + if found.verdict == Verdict::Partly { ", and something without a name" } else { "" }
        }
    }
}

/// The verdict and the gaps, in lines.
pub fn lines(found: &Discovery) -> String {
    let Discovery { before, after, noise_floor_mm, .. } = found;
    format!(
        "{}: {}\ngap of ε   {:.4} mm before, {:.4} mm after (noise alone: {noise_floor_mm:.4} mm)\n\
         gap of θ   {:.3}° before, {:.3}° after\ngap of δ   {:.3}° before, {:.3}° after",
        found.verdict.word(),
        sentence(found),
        before.eps_mm,
        after.eps_mm,
        before.theta_deg,
        after.theta_deg,
        before.delta_deg,
        after.delta_deg
    )
}

/// The verdict in a sentence.
pub fn sentence(found: &Discovery) -> String {
    match found.verdict {
        Verdict::None => "These data show nothing that the model lacks: the gap is the measurements' noise.".into(),
        Verdict::Unexplained => {
            let most = found.structure_after.follows.first();
            let follows = most.map(|(what, _)| format!(" It follows {what} most.")).unwrap_or_default();
            format!("Something is missing, and no effect of the library accounts for it.{follows}")
        }
        Verdict::Partly => {
            let each: Vec<String> = found.named.iter().map(|named| partial_reading(found, named)).collect();
            let most = found.structure_after.follows.first();
            let remains = match most {
                Some((what, _)) => format!("what remains follows {what}"),
                None => "what remains follows nothing that was measured".to_owned(),
            };
            capitalised(&format!("{}; {remains}", each.join("; ")))
        }
        Verdict::Named => {
            let readings: Vec<String> = found
                .named
                .iter()
                .map(|named| {
                    let size = parameters(found, named.physics.name);
                    let size = size.iter().map(|(name, value)| format!("{name} = {value}"));
                    let or = match &named.indistinguishable_from[..] {
                        [] => String::new(),
                        others => format!(" (these data cannot tell it from {})", others.join(", ")),
                    };
                    let size = size.collect::<Vec<_>>().join(", ");
                    let percent = percent(named.probability());
                    format!("{} ({}: {size}; {percent} %){or}", named.physics.reading, named.physics.name)
                })
                .collect();
            format!("The data show {}.", readings.join(", and "))
        }
    }
}

/// A probability in whole percent; nothing that data say is certain.
fn percent(probability: f64) -> u32 {
    (100.0 * probability).round().min(99.0) as u32
}

/// "play at the bend, 0.31 ± 0.02 mm (97 %), removes 59 % of the gap".
fn partial_reading(found: &Discovery, named: &Named) -> String {
    let sizes = match &parameters(found, named.physics.name)[..] {
        [(_, only)] => only.clone(),
        several => several.iter().map(|(name, value)| format!("{name} = {value}")).collect::<Vec<_>>().join(", "),
    };
    let or = match &named.indistinguishable_from[..] {
        [] => String::new(),
        others => format!(" (these data cannot tell it from {})", others.join(", ")),
    };
    format!(
        "{}, {sizes} ({} %), removes {:.0} % of the gap{or}",
        named.physics.name.replace('_', " "),
        percent(named.probability()),
        100.0 * named.removes
    )
}

/// "15.6 ± 0.1° towards −97°", of the components of a bend and their standard deviations, degrees.
fn rest_bend(values: &[f64], sds: &[f64]) -> String {
    let (bend, sd) = (Vector2::new(values[0], values[1]), Vector2::new(sds[0], sds[1]));
    let along = bend.component_mul(&sd).norm() / bend.norm().max(f64::MIN_POSITIVE);
    let towards = bend.y.atan2(bend.x).to_degrees();
    format!("{:.1} ± {along:.1}° towards {towards:.0}°", bend.norm()).replace('-', "−")
}

/// Each parameter's name and "0.110 ± 0.001 mm", with two digits of its standard deviation; a bend at rest as its size and direction.
fn parameters(found: &Discovery, name: &str) -> Vec<(String, String)> {
    let effects = &found.model.effects;
    let Some(k) = effects.iter().position(|effect| effect.physics.name == name) else { return Vec::new() };
    let sds = found.model.effect_sds(k);
    if effects[k].physics.name == REST_BEND {
        return vec![("bend".to_owned(), rest_bend(&effects[k].values, &sds))];
    }
    let values = effects[k].parameters().iter().zip(effects[k].values.iter().zip(sds));
    let written = values.map(|(spec, (value, sd))| {
        let unit = match spec.unit {
            "1" => String::new(),
            "deg" => "°".to_owned(),
            unit => format!(" {unit}"),
        };
        (spec.name.to_owned(), format!("{}{unit}", with_sd(*value, sd)))
    });
    written.collect()
}

/// The figures at the head of the page; without a gap after where nothing was found that changes it.
fn summary(found: &Discovery) -> Vec<(String, String)> {
    let Discovery { verdict, samples, before, noise_floor_mm, .. } = found;
    let after = verdict.has_effects().then_some(&found.after);
    let pair = |name: &str, value: String| (name.to_owned(), value);
    let sides = |of: fn(&Gap) -> f64, unit: &str, digits: usize| match after {
        Some(after) => format!("{:.digits$}{unit} before, {:.digits$}{unit} after", of(before), of(after)),
        None => format!("{:.digits$}{unit}", of(before)),
    };
    vec![
        pair("Verdict", verdict.word().to_owned()),
        pair("Samples", samples.to_string()),
        pair("Gap of ε (rms)", sides(|gap| gap.eps_mm, " mm", 4)),
        pair("Noise alone", format!("{noise_floor_mm:.4} mm")),
        pair("Gap of θ (rms)", sides(|gap| gap.theta_deg, "°", 3)),
        pair("Gap of δ (rms, θ ≥ 15°)", sides(|gap| gap.delta_deg, "°", 3)),
    ]
}

/// What to make of effects that stand under the verdict `unexplained`.
fn considered(found: &Discovery) -> Markup {
    html! {
        @if found.verdict == Verdict::Unexplained {
            h2 { "What was considered" }
            p {
                "Every effect of the library was tried, alone and together with others. None removes enough of the gap on held-out sweeps."
            }
        }
    }
}

/// The combinations of effects that the data leave open, where there is more than one.
fn structures(found: &Discovery) -> Markup {
    let row = |candidate: &Candidate| {
        let effects = if candidate.effects.is_empty() { "none".to_owned() } else { candidate.effects.join(", ") };
        [effects, format!("{} %", percent(candidate.probability))]
    };
    let rows: Vec<[String; 2]> = found.structures.iter().map(row).collect();
    html! {
        @if rows.len() > 1 {
            (table("Combinations that the data leave open", ["effects", "probability"], &rows))
            p {
                "Probabilities by how well each foretells stretches of the log that it was not fitted to, among these alone. An answer asks \
                 for more, so that it may have fewer effects than the most probable combination; the standard deviations hold what the \
                 choice between them does."
            }
        }
    }
}

fn effect(found: &Discovery, named: &Named) -> Markup {
    let alternatives = named.alternatives.iter().take(MOST_ALTERNATIVES);
    let alternatives: Vec<[String; 2]> =
        alternatives.map(|(name, worse)| [(*name).to_owned(), format!("{worse:.1}")]).collect();
    let evidence = &named.evidence;
    let mut facts = parameters(found, named.physics.name);
    facts.extend([
        ("Gain in the criterion".to_owned(), format!("{:.1}", evidence.bic_gain)),
        (
            "Share of the held-out gap beyond noise that it removes".to_owned(),
            format!("{:.1} %", 100.0 * named.removes),
        ),
        ("Probability".to_owned(), format!("{} %", percent(named.probability()))),
    ]);
    if !named.indistinguishable_from.is_empty() {
        facts.push(("These data cannot tell it from".to_owned(), named.indistinguishable_from.join(", ")));
    }
    let title = format!("What was tried in place of {}", named.physics.name);
    html! {
        h2 { (named.physics.name) }
        p { (capitalised(named.physics.reading)) }
        p.equation { (named.physics.equation) }
        @if !named.physics.form.is_empty() { p { "In the form: " (named.physics.form) "." } }
        (definitions("summary", &facts))
        @if !alternatives.is_empty() {
            (table(&title, ["effect", "worse by (criterion)"], &alternatives))
            p {
                "The criterion is −2 ln of the density that stretches of the log have which were not fitted, and of what is expected \
                 beforehand. Less is better; effects that are worse by more than 6 are ruled out."
            }
        }
    }
}

/// A sentence from words that begin with a small letter and end without a stop.
fn capitalised(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| format!("{}{}.", first.to_uppercase(), letters.as_str()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bend_at_rest_is_told_by_its_size_and_direction() {
        // √(1.9² + 15.4²) = 15.52, at 180° − atan(15.4 / 1.9) = 97.0° clockwise; across the bend the first component tells nothing.
        assert_eq!(rest_bend(&[-1.9, -15.4], &[0.4, 0.1]), "15.5 ± 0.1° towards −97°");
    }
}
