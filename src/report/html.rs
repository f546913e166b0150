//! report.html: one page that explains a run to a person. It holds its plots and pictures itself and asks no other
//! address for anything.

use super::course::Course;
use super::overlay::angles;
use super::plot::{GRID, INK, Plot, Point, Series, Style};
use crate::estimate::{EstimateRow, Verdict};
use crate::observation::Measurement;
use base64::prelude::{BASE64_STANDARD, Engine};
use std::fmt::Write;

/// A picture on the page.
#[derive(Debug, Clone)]
pub struct Picture {
    /// What stands below it.
    pub caption: String,
    /// The picture as a JPEG file.
    pub jpeg: Vec<u8>,
}

/// What the page is made of.
#[derive(Debug, Clone)]
pub struct Report<'a> {
    /// The heading.
    pub title: String,
    /// The figures that matter, by name.
    pub summary: Vec<(String, String)>,
    /// The rows that are shown.
    pub course: &'a Course,
    /// Frames with the model drawn on them.
    pub pictures: Vec<Picture>,
    /// What was passed over in the input.
    pub warnings: Vec<String>,
    /// What the run was made from: program, files, settings.
    pub provenance: Vec<(String, String)>,
}

impl Report<'_> {
    /// The page.
    pub fn html(&self) -> String {
        let mut page = format!(
            "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
             <title>{title}</title>\n<style>{style}</style>\n</head>\n<body>\n<main>\n<h1>{title}</h1>\n",
            title = escaped(&self.title),
            style = style()
        );
        page += &definitions("summary", &self.summary);
        page += &self.plots();
        page += &self.frames_not_measured();
        page += &self.measurements_not_used();
        page += &list("Warnings", "What was passed over in the input files.", &self.warnings);
        page += &self.pictures();
        page += "<h2>Made from</h2>\n";
        page += &definitions("provenance", &self.provenance);
        page += "</main>\n</body>\n</html>\n";
        page
    }

    fn plots(&self) -> String {
        let mut section = String::new();
        for (title, note, plot) in self.all_plots() {
            if let Some(svg) = plot.svg() {
                let svg = svg.replace(" xmlns=\"http://www.w3.org/2000/svg\"", "");
                let _ = writeln!(section, "<figure><h3>{title}</h3>{svg}<figcaption>{note}</figcaption></figure>");
            }
        }
        if section.is_empty() {
            section
        } else {
            format!("<h2>Course of the run</h2>\n<div class=\"plots\">\n{section}</div>\n")
        }
    }

    fn all_plots(&self) -> Vec<(&'static str, &'static str, Plot)> {
        let axis = Axis::of(&self.course.plotted);
        let plot = |y_label: &str, series| Plot {
            x_label: axis.label().into(),
            y_label: y_label.into(),
            series,
            y_shown: vec![],
        };
        let mut plots = vec![
            (
                "Bend θ",
                "Measured bend from straight, with bars of ±1σ (often smaller than the dot).",
                plot("θ (°)", self.angle_series(&axis, |m| (m.configuration.theta_deg(), m.sigma_theta.to_degrees()))),
            ),
            (
                "Azimuth δ",
                "Measured azimuth of the bend, with bars of ±1σ. Near straight δ means little and its bar is long.",
                plot("δ (°)", self.angle_series(&axis, |m| (m.configuration.delta_deg(), m.sigma_delta.to_degrees()))),
            ),
        ];
        let estimates = |value: fn(&crate::estimate::EtaLambda) -> (f64, f64)| {
            let points = self.course.plotted.iter().filter_map(|(_, row)| {
                let (y, sd) = value(row.estimate.as_ref()?);
                Some(Point { x: axis.place(row.index, row.time_s), y, sd })
            });
            vec![Series { name: String::new(), style: Style::Band, points: points.collect() }]
        };
        plots.push((
            "Force scale η",
            "The estimate after each measurement, with its band of ±1σ.",
            plot("η", estimates(|e| (e.eta, e.sd_eta))),
        ));
        plots.push((
            "Backlash λ",
            "The estimate after each measurement, with its band of ±1σ.",
            plot("λ (mm)", estimates(|e| (e.lambda_mm, e.sd_lambda_mm))),
        ));
        let backbones = self.course.plotted.iter().find_map(|(_, row)| Some(row.residual_mm?.len())).unwrap_or(0);
        let residuals = (0..backbones).map(|i| Series {
            name: format!("backbone {}", i + 1),
            style: Style::Dots,
            points: self
                .course
                .plotted
                .iter()
                .filter_map(|(_, row)| {
                    Some(Point { x: axis.place(row.index, row.time_s), y: row.residual_mm?[i], sd: 0.0 })
                })
                .collect(),
        });
        plots.push((
            "Residuals of ε",
            "Measured ε less what the estimate before it predicted. A pattern here is something the model does not know.",
            plot("residual (mm)", residuals.collect()),
        ));
        plots
    }

    /// The measured angles, those apart that the estimator rejected.
    fn angle_series(&self, axis: &Axis, angle: impl Fn(&crate::observation::Measured) -> (f64, f64)) -> Vec<Series> {
        let series = |name: &str, wanted: bool| Series {
            name: name.to_owned(),
            style: Style::Dots,
            points: self
                .course
                .plotted
                .iter()
                .filter(|(_, row)| (row.verdict == Verdict::Rejected) == wanted)
                .filter_map(|(m, _)| {
                    let (y, sd) = angle(m.measured.as_ref()?);
                    Some(Point { x: axis.place(m.index, m.time_s), y, sd })
                })
                .collect(),
        };
        let mut both = vec![series("used", false), series("rejected", true)];
        both.retain(|series| !series.points.is_empty());
        both
    }

    fn frames_not_measured(&self) -> String {
        let failed = self.course.unmeasured.iter();
        let rows: Vec<_> = failed.map(|m| [frame_name(m.index, &m.view), m.status.to_string()]).collect();
        if rows.is_empty() {
            return "<h2>Frames not measured</h2>\n<p>None: every frame was measured.</p>\n".to_owned();
        }
        let more = self.course.unmeasured_count - rows.len();
        table("Frames not measured", ["frame", "reason"], &rows) + &others(more, "measurements.csv")
    }

    fn measurements_not_used(&self) -> String {
        let unused = self.course.unused.iter();
        let rows: Vec<_> = unused
            .filter_map(|(m, row)| {
                let (theta, delta) = angles(m.measured.as_ref()?);
                let why = format!("{}: {}", row.verdict, row.reason.replace('_', " "));
                Some([frame_name(row.index, &row.view), theta, delta, why])
            })
            .collect();
        if rows.is_empty() {
            return String::new();
        }
        let more = self.course.unused_count - rows.len();
        table("Measurements not used", ["frame", "θ", "δ", "why"], &rows) + &others(more, "estimate.csv")
    }

    fn pictures(&self) -> String {
        if self.pictures.is_empty() {
            return String::new();
        }
        let mut section =
            "<h2>Frames</h2>\n<p>The model as it was fitted: centre line (orange) from base (green) to tip \
                           (magenta), outline (cyan).</p>\n<div class=\"pictures\">\n"
                .to_owned();
        for picture in &self.pictures {
            let _ = writeln!(
                section,
                "<figure><img loading=\"lazy\" alt=\"{caption}\" src=\"data:image/jpeg;base64,{data}\">\
                 <figcaption>{caption}</figcaption></figure>",
                caption = escaped(&picture.caption),
                data = BASE64_STANDARD.encode(&picture.jpeg)
            );
        }
        section + "</div>\n"
    }
}

/// What runs along the plots' x axis: time where every frame has one, else the frame's index.
enum Axis {
    Time,
    Index,
}

impl Axis {
    fn of(rows: &[(Measurement, EstimateRow)]) -> Self {
        if rows.iter().all(|(m, _)| m.time_s.is_some()) { Self::Time } else { Self::Index }
    }

    fn label(&self) -> &'static str {
        match self {
            Self::Time => "time (s)",
            Self::Index => "frame",
        }
    }

    fn place(&self, index: u64, time_s: Option<f64>) -> f64 {
        match self {
            Self::Time => time_s.unwrap_or(f64::NAN),
            Self::Index => index as f64,
        }
    }
}

/// What a list that was cut says of the rest.
fn others(more: usize, file: &str) -> String {
    if more == 0 { String::new() } else { format!("<p>And {more} more: see {file}.</p>\n") }
}

fn frame_name(index: u64, view: &Option<String>) -> String {
    match view {
        Some(view) => format!("{index} ({view})"),
        None => index.to_string(),
    }
}

pub(super) fn definitions(class: &str, pairs: &[(String, String)]) -> String {
    let rows: String =
        pairs.iter().map(|(k, v)| format!("<div><dt>{}</dt><dd>{}</dd></div>\n", escaped(k), escaped(v))).collect();
    format!("<dl class=\"{class}\">\n{rows}</dl>\n")
}

pub(super) fn table<const N: usize>(title: &str, header: [&str; N], rows: &[[String; N]]) -> String {
    let cells = |tag: &str, texts: &[String]| {
        texts.iter().map(|text| format!("<{tag}>{}</{tag}>", escaped(text))).collect::<String>()
    };
    let body: String = rows.iter().map(|row| format!("<tr>{}</tr>\n", cells("td", row))).collect();
    let head = cells("th", &header.map(str::to_owned));
    format!(
        "<h2>{} ({})</h2>\n<div class=\"wide\"><table>\n<tr>{head}</tr>\n{body}</table></div>\n",
        escaped(title),
        rows.len()
    )
}

pub(super) fn list(title: &str, note: &str, items: &[String]) -> String {
    if items.is_empty() {
        return String::new();
    }
    let items: String = items.iter().map(|item| format!("<li>{}</li>\n", escaped(item))).collect();
    format!("<h2>{title}</h2>\n<p>{note}</p>\n<ul>\n{items}</ul>\n")
}

/// Text as it must stand in HTML.
pub(super) fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

pub(super) fn style() -> String {
    format!(
        "
:root {{ color-scheme: light dark; --ink: #1b1f24; --soft: #59636e; --paper: #ffffff; --panel: #f5f6f8; --line: #d0d4da; }}
@media (prefers-color-scheme: dark) {{
  :root {{ --ink: #e6e9ee; --soft: #9aa4b0; --paper: #14171b; --panel: #1d2127; --line: #3a414a; }}
}}
* {{ box-sizing: border-box; }}
body {{ margin: 0; background: var(--paper); color: var(--ink); font: 16px/1.5 system-ui, sans-serif; }}
main {{ max-width: 76rem; margin: 0 auto; padding: 1rem; }}
h1 {{ font-size: 1.5rem; line-height: 1.25; overflow-wrap: anywhere; }}
h2 {{ font-size: 1.2rem; margin: 2rem 0 .5rem; }}
h3 {{ font-size: 1rem; margin: 0 0 .25rem; }}
p, figcaption, dt {{ color: var(--soft); }}
figure {{ margin: 0; padding: .75rem; background: var(--panel); border-radius: .5rem; }}
figcaption {{ font-size: .85rem; }}
.plots {{ display: grid; gap: 1rem; grid-template-columns: repeat(auto-fit, minmax(min(100%, 26rem), 1fr)); }}
.pictures {{ display: grid; gap: .75rem; grid-template-columns: repeat(auto-fill, minmax(min(100%, 17rem), 1fr)); }}
svg, img {{ display: block; width: 100%; height: auto; }}
svg [fill=\"{INK}\"] {{ fill: var(--ink); }}
svg [stroke=\"{INK}\"] {{ stroke: var(--ink); }}
svg [stroke=\"{GRID}\"] {{ stroke: var(--line); }}
.summary {{ display: grid; gap: .75rem; grid-template-columns: repeat(auto-fill, minmax(min(100%, 12rem), 1fr)); margin: 0; }}
.summary div {{ padding: .5rem .75rem; background: var(--panel); border-radius: .5rem; }}
.summary dt {{ font-size: .85rem; }}
.summary dd {{ margin: 0; font-size: 1.1rem; overflow-wrap: anywhere; }}
.provenance div {{ display: flex; flex-wrap: wrap; gap: 0 .75rem; }}
.provenance dt {{ min-width: 9rem; }}
.provenance dd {{ margin: 0; overflow-wrap: anywhere; }}
.wide {{ overflow-x: auto; }}
table {{ border-collapse: collapse; }}
th, td {{ padding: .25rem .75rem; text-align: left; border-bottom: 1px solid var(--line); }}
li {{ overflow-wrap: anywhere; }}
"
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::EtaLambda;
    use crate::geometry::Configuration;
    use crate::observation::{Measured, Status};
    use crate::robot::PerBackbone;

    fn measurement(index: u64, status: Status) -> Measurement {
        let measured = (status == Status::Ok).then(|| Measured {
            configuration: Configuration::from_degrees(5.0 * index as f64, 120.0),
            sigma_theta: 1e-3,
            sigma_delta: 5e-3,
            correlation: 0.0,
        });
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
        let mut course = Course::new(measurements.len());
        measurements.iter().zip(&estimates).for_each(|(measurement, row)| course.add(measurement, row));
        let page = Report {
            title: "bending <1>".into(),
            summary: vec![("η".into(), "1.200 ± 0.010".into())],
            course: &course,
            pictures: vec![Picture { caption: "frame 1".into(), jpeg: vec![0xff, 0xd8] }],
            warnings: vec!["a.csv:3: row skipped".into()],
            provenance: vec![("encoders".into(), "a & b.csv".into())],
        }
        .html();
        for expected in [
            "<h1>bending &lt;1&gt;</h1>",
            "1.200 ± 0.010",
            "<td>2</td><td>no_snake</td>",
            "rejected: outlier",
            "a.csv:3: row skipped",
            "a &amp; b.csv",
            "data:image/jpeg;base64,/9g=",
        ] {
            assert!(page.contains(expected), "{expected}");
        }
        assert_eq!(page.matches("<svg").count(), 5);
        assert!(!page.contains("http"), "no outside address");
    }

    #[test]
    fn a_run_without_a_single_measurement_has_its_page_too() {
        let mut course = Course::new(1);
        let skipped = EstimateRow { estimate: None, residual_mm: None, ..estimate(1, Verdict::Skipped, "unreadable") };
        course.add(&measurement(1, Status::Unreadable), &skipped);
        let page = Report {
            title: "nothing".into(),
            summary: vec![],
            course: &course,
            pictures: vec![],
            warnings: vec![],
            provenance: vec![],
        }
        .html();
        assert!(page.contains("unreadable") && !page.contains("<svg"));
    }
}
