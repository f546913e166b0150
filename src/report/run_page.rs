//! report.html of `run`: one page that explains a run to a person.

use super::bend_map::{bend_map, strongest};
use super::overlay::angles;
use super::page::{definitions, document, figure, list, made_from, table};
use super::run_course::{angles_over_time, course};
use super::run_history::RunHistory;
use super::run_plots::{Sampled, Titled, command_over_theta, corrections_mm};
use super::verdict::verdict_box;
use crate::estimate::EstimateRow;
use crate::geometry::Configuration;
use crate::observation::{EncoderReading, Measured, Measurement};
use crate::quantity::decimal;
use crate::record::Provenance;
use crate::robot::{Model, TableRow};
use crate::verdict::Verdict as RunVerdict;
use base64::prelude::{BASE64_STANDARD, Engine};
use maud::{Markup, html};

/// A picture on the page.
#[derive(Debug, Clone)]
pub struct Picture {
    /// What stands below it.
    pub caption: String,
    /// The picture as a JPEG file.
    pub jpeg: Vec<u8>,
    /// Where it stands beside the page, in full.
    pub file: String,
    /// The part with the snake, as shares of its width and height.
    pub snake: Part,
}

/// A part of a picture, as shares of its width and height.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Part {
    /// Of the part's left border.
    pub left: f64,
    /// Of its upper border.
    pub top: f64,
    /// Its width.
    pub width: f64,
    /// Its height.
    pub height: f64,
}

impl Part {
    /// All of it.
    pub const WHOLE: Self = Self { left: 0.0, top: 0.0, width: 1.0, height: 1.0 };
}

/// What the page is made of.
#[derive(Debug, Clone)]
pub struct Report<'a> {
    /// The heading.
    pub title: String,
    /// Whether the result can be relied on.
    pub verdict: RunVerdict,
    /// The figures that matter, by name.
    pub summary: Vec<(String, String)>,
    /// What was learned; `None` without an estimate.
    pub model: Option<&'a Model>,
    /// The encoders' readings.
    pub readings: &'a [EncoderReading],
    /// The rows that are shown.
    pub history: &'a RunHistory,
    /// What the calibration of each view's rig saw, each with a caption: JPEG.
    pub rigs: Vec<(String, Vec<u8>)>,
    /// One frame at the largest bend, cut to the snake, as a JPEG file, and what stands below it.
    pub closeup: Option<(String, Vec<u8>)>,
    /// Frames with the model drawn on them.
    pub pictures: Vec<Picture>,
    /// What was passed over in the input.
    pub warnings: Vec<String>,
    /// What the run was made from.
    pub made_from: Provenance,
}

impl Report<'_> {
    /// The page.
    pub fn html(&self) -> String {
        let content = html! {
            h1 { (self.title) }
            (verdict_box(&self.verdict))
            (definitions("summary", &self.summary))
            p { (GLOSSARY) }
            (self.measured())
            (self.learned())
            (self.course())
            (self.all_frames())
            (self.frames_not_measured())
            (self.measurements_not_used())
            (list("Warnings", "Rows of the input files that were left out.", &self.warnings))
            (self.pictures())
            (made_from(&self.made_from))
        };
        document(&self.title, "", &content)
    }

    /// One frame as it was measured, and beside it the angles of all.
    fn measured(&self) -> Markup {
        html! {
            @if self.closeup.is_some() || self.history.plotted.iter().any(|(m, _)| m.measured.is_some()) {
                h2 { "What was measured" }
                .measured {
                    @if let Some((caption, jpeg)) = &self.closeup {
                        figure.closeup {
                            (embedded(jpeg, caption))
                            figcaption { (caption) " " (DRAWN) }
                        }
                    }
                    @for Titled { title, caption, plot } in &angles_over_time(self.history) { (figure(title, plot, caption)) }
                }
            }
        }
    }

    /// What the model that was learned does, and what to command by it.
    fn learned(&self) -> Markup {
        let Some(model) = self.model else { return html! {} };
        let sampled = Sampled::of(model, self.history, self.readings);
        let titled = |Titled { title, caption, plot }: &Titled| figure(title, plot, caption);
        let map = |title: &str, values: &[(Configuration, f64)], unit: &str, caption: &str| {
            html! {
                @if let Some(map) = bend_map(values, unit, strongest(values.iter().map(|(_, value)| *value))) {
                    figure { h3 { (title) } (map) figcaption { (caption) } }
                }
            }
        };
        let coverage = "Each dot is a measured bend, seen from the tip: its distance from the middle is θ, its direction δ. The larger the dot, \
                        the further the model misses it.";
        let corrections =
            "The largest |q̃ − q| of a backbone at each bend: how much more than the geometry says is to be commanded.";
        html! {
            h2 { "What was learned" }
            .plots.pairs {
                (titled(&sampled.missed_before()))
                (titled(&sampled.missed_after()))
                (titled(&sampled.epsilon_over_tau()))
                (map("Poses, and what the model misses of them", &sampled.misses_deg(), "°", coverage))
            }
            h2 { "What to command" }
            .plots {
                (titled(&command_over_theta(model)))
                (map("Compensation", &corrections_mm(model), "mm", corrections))
                figure { h3 { "The table in short" } (short_table(model)) figcaption { "All of it is in compensation.csv." } }
            }
        }
    }

    fn course(&self) -> Markup {
        let plots = course(self.history);
        html! {
            @if plots.iter().any(|titled| titled.plot.has_points()) {
                h2 { "Course of the run" }
                .plots.pairs {
                    @for Titled { title, caption, plot } in &plots { (figure(title, plot, caption)) }
                }
            }
        }
    }

    /// Every row that is plotted, with what became of it.
    fn all_frames(&self) -> Markup {
        let row = |(m, row): &(Measurement, EstimateRow)| {
            let angles = m.measured.as_ref().map(|measured| {
                let Measured { configuration, sigma_theta, sigma_delta, .. } = measured;
                [(configuration.theta_deg(), sigma_theta), (configuration.delta_deg(), sigma_delta)]
                    .map(|(angle_deg, sigma)| [decimal(angle_deg, 3), decimal(sigma.to_degrees(), 3)])
            });
            let [[theta, sd_theta], [delta, sd_delta]] = angles.unwrap_or_default();
            let time = m.time_s.map_or(String::new(), |time_s| decimal(time_s, 3));
            let rms = m.quality.map_or(String::new(), |quality| decimal(quality.rms_px, 2));
            let estimator = match row.reason.as_str() {
                "" => row.verdict.to_string(),
                reason => format!("{}: {}", row.verdict, reason.replace('_', " ")),
            };
            let status = m.status.to_string();
            [frame_name(m.index, &m.view), time, status, theta, sd_theta, delta, sd_delta, rms, estimator]
        };
        let rows: Vec<_> = self.history.plotted.iter().map(row).collect();
        let header = [
            "frame",
            "time (s)",
            "status",
            "θ (°)",
            "σ of θ (°)",
            "δ (°)",
            "σ of δ (°)",
            "edges, rms (px)",
            "for η and λ",
        ];
        html! { .scroll { (table("Frame by frame", header, &rows)) } }
    }

    fn frames_not_measured(&self) -> Markup {
        let failed = self.history.unmeasured.iter();
        let row = |m: &Measurement| {
            let (meaning, remedy) = m.status.explained();
            [frame_name(m.index, &m.view), m.status.to_string(), meaning.to_owned(), remedy.to_owned()]
        };
        let rows: Vec<_> = failed.map(row).collect();
        html! {
            @if rows.is_empty() {
                h2 { "Frames not measured" }
                p { "None: every frame was measured." }
            } @else {
                (table("Frames not measured", ["frame", "status", "what it means", "what to do"], &rows))
                (others(self.history.unmeasured_count - rows.len(), "measurements.csv"))
            }
        }
    }

    fn measurements_not_used(&self) -> Markup {
        let unused = self.history.unused.iter();
        let rows: Vec<_> = unused
            .filter_map(|(m, row)| {
                let (theta, delta) = angles(m.measured.as_ref()?);
                let why = format!("{}: {}", row.verdict, row.reason.replace('_', " "));
                Some([frame_name(row.index, &row.view), theta, delta, why])
            })
            .collect();
        html! {
            @if !rows.is_empty() {
                (table("Measurements not used", ["frame", "θ", "δ", "why"], &rows))
                (others(self.history.unused_count - rows.len(), "estimate.csv"))
            }
        }
    }

    fn pictures(&self) -> Markup {
        html! {
            @if !self.rigs.is_empty() {
                h2 { "The straight picture" }
                p { (STRAIGHT_PICTURE) }
                @for (caption, jpeg) in &self.rigs {
                    figure.closeup { (embedded(jpeg, caption)) figcaption { (caption) } }
                }
            }
            @if !self.pictures.is_empty() {
                h2 { "Frames" }
                p { (DRAWN) " Choose one to see it in full." }
                .pictures {
                    @for picture in &self.pictures { (thumbnail(picture)) }
                }
                dialog id="full" { img alt="The whole frame"; p {} }
            }
        }
    }
}

/// The words of the page.
const GLOSSARY: &str = "θ is the snake's bend from straight, δ the direction that it leans towards. The force scale η multiplies the forces that the \
     ideal model expects; λ is the backlash that all actuators share. q is how far a backbone must move in the snake for a bend, q̃ what to command, \
     and ε = q̃ − q the part that the actuation line takes up. Missed is the difference between measurement and model (root mean square). \
     ± is one standard deviation σ.";

/// What the colours on pictures mean.
const DRAWN: &str =
    "The model as it was fitted: centre line (orange) from base (green) to tip (magenta), outline (cyan).";

/// What is drawn on the straight picture.
const STRAIGHT_PICTURE: &str = "What the calibration of the rig saw: the part of the picture that shows the sheet, its lines, and the straight snake with its holder.";

/// A picture within the page.
fn embedded(jpeg: &[u8], alt: &str) -> Markup {
    html! { img alt=(alt) src={ "data:image/jpeg;base64," (BASE64_STANDARD.encode(jpeg)) }; }
}

/// A picture cut to the snake, which opens in full.
fn thumbnail(Picture { caption, jpeg, file, snake }: &Picture) -> Markup {
    let percent = |share: f64| format!("{:.2}%", 100.0 * share);
    let place = format!(
        "width:{};left:{};top:{}",
        percent(1.0 / snake.width),
        percent(-snake.left / snake.width),
        percent(-snake.top / snake.height)
    );
    html! {
        figure {
            a.full href=(file) title=(caption) {
                span.crop {
                    img loading="lazy" alt=(caption) style=(place)
                        src={ "data:image/jpeg;base64," (BASE64_STANDARD.encode(jpeg)) };
                }
            }
            figcaption { (caption) }
        }
    }
}

/// What to command for a few poses.
fn short_table(model: &Model) -> Markup {
    let poses = [30.0, 60.0, 90.0].into_iter().flat_map(|t| [-90.0, 0.0, 90.0, 180.0].map(|d| (t, d)));
    let rows: Vec<TableRow> = poses.map(|(t, d)| TableRow::new(model, Configuration::from_degrees(t, d))).collect();
    html! {
        .wide {
            table {
                tr {
                    th.number { "θ (°)" }
                    th.number { "δ (°)" }
                    @for i in 1..=model.robot.backbone_count() { th.number { "q̃" (i) " (mm)" } }
                }
                @for row in &rows {
                    tr {
                        td.number { (decimal(row.configuration.theta_deg(), 0)) }
                        td.number { (decimal(row.configuration.delta_deg(), 0)) }
                        @for q in &row.command_mm { td.number { (decimal(*q, 3)) } }
                    }
                }
            }
        }
    }
}

/// What a list that was cut says of the rest.
fn others(more: usize, file: &str) -> Markup {
    html! {
        @if more > 0 { p { "And " (more) " more: see " (file) "." } }
    }
}

fn frame_name(index: u64, view: &Option<String>) -> String {
    match view {
        Some(view) => format!("{index} ({view})"),
        None => index.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::{EtaLambda, Verdict};
    use crate::geometry::Configuration;
    use crate::observation::{Measured, Status};
    use crate::robot::PerBackbone;

    fn measurement(index: u64, status: Status) -> Measurement {
        let measured = (status == Status::Ok)
            .then(|| Measured::independent(Configuration::from_degrees(5.0 * index as f64, 120.0), 1e-3, 5e-3, 0.0));
        Measurement { index, time_s: Some(index as f64), status, measured, quality: None, view: None }
    }

    fn estimate(index: u64, verdict: Verdict, reason: &str) -> EstimateRow {
        EstimateRow {
            index,
            time_s: Some(index as f64),
            estimate: Some(EtaLambda { eta: 1.2, lambda_mm: 0.17, sd_eta: 0.01, sd_lambda_mm: 0.003 }),
            verdict,
            reason: reason.to_owned(),
            residual_mm: Some(PerBackbone::from([0.001, 0.002, -0.001])),
            view: None,
        }
    }

    #[test]
    fn the_page_shows_everything_and_reaches_for_nothing() {
        let measurements = [measurement(1, Status::Ok), measurement(2, Status::NoSnake), measurement(3, Status::Ok)];
        let estimates = [
            estimate(1, Verdict::Used, ""),
            estimate(2, Verdict::Skipped, "no_snake"),
            estimate(3, Verdict::Rejected, "outlier"),
        ];
        let history = RunHistory::of(&measurements, &estimates);
        let page = Report {
            title: "bending <1>".into(),
            verdict: RunVerdict::default(),
            summary: vec![("η".into(), "1.200 ± 0.010".into())],
            history: &history,
            model: Some(&Model::default()),
            readings: &[],
            rigs: vec![("View side".into(), vec![0xff, 0xd8])],
            closeup: Some(("frame 3".into(), vec![0xff, 0xd8])),
            pictures: vec![Picture {
                caption: "frame 1".into(),
                jpeg: vec![0xff, 0xd8],
                file: "overlays/side_00001.jpg".into(),
                snake: Part { left: 0.25, top: 0.5, width: 0.5, height: 0.5 },
            }],
            warnings: vec!["a.csv:3: row skipped".into()],
            made_from: Provenance::new("a & b"),
        }
        .html();
        for expected in [
            "<h1>bending &lt;1&gt;</h1>",
            "1.200 ± 0.010",
            "<td>2</td><td>no_snake</td><td>nothing in the picture looks like the snake</td>",
            "width:200.00%;left:-50.00%;top:-100.00%",
            "href=\"overlays/side_00001.jpg\"",
            "rejected: outlier",
            "a.csv:3: row skipped",
            "a &amp; b",
            "data:image/jpeg;base64,/9g=",
        ] {
            assert!(page.contains(expected), "{expected}");
        }
        // Five of the run's course, q̃ over θ, and the polar map of the compensation; no readings, so nothing of bends and forces.
        assert_eq!(page.matches("<svg").count(), 7);
        assert!(!page.contains("http"), "no outside address");
    }

    #[test]
    fn a_run_without_a_single_measurement_has_its_page_too() {
        let skipped = EstimateRow { estimate: None, residual_mm: None, ..estimate(1, Verdict::Skipped, "unreadable") };
        let history = RunHistory::of(&[measurement(1, Status::Unreadable)], &[skipped]);
        let page = Report {
            title: "nothing".into(),
            verdict: RunVerdict::default(),
            summary: vec![],
            history: &history,
            model: None,
            readings: &[],
            rigs: vec![],
            closeup: None,
            pictures: vec![],
            warnings: vec![],
            made_from: Provenance::new("run"),
        }
        .html();
        assert!(page.contains("unreadable") && !page.contains("<svg"));
    }
}
