//! report.html of `reproduce`: each of the paper's results beside this program's.

use super::page::{document, figure, made_from};
use super::plot::{Plot, Point, Series, Style};
use super::verdict::with_code;
use crate::record::Provenance;
use crate::reproduce::{BendingError, Comparison, Compensation, RecursionStep, Reproduction, SimulatedRobot};
use maud::{Markup, html};

/// The columns of the comparisons.
const COLUMNS: [&str; 7] = ["place", "quantity", "paper", "ours", "difference", "unit", "why"];

const STYLE: &str = "
td { vertical-align: top; }
td:first-child { white-space: nowrap; }
.plots { margin: 1rem 0; }
td.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
td.quantity { min-width: 11rem; }
td.why { min-width: 18rem; color: var(--soft); }
/* Too narrow for seven columns: a row becomes a list of its cells with their names. */
@media (max-width: 56rem) {
  .wide table, .wide tbody, .wide tr, .wide td { display: block; }
  .wide tr { padding: .5rem 0; border-bottom: 1px solid var(--line); }
  .wide tr:first-child, .wide td:empty { display: none; }
  .wide td, .wide td.number { display: flex; gap: .5rem; padding: 0; border: 0; text-align: left; white-space: normal; min-width: 0; }
  .wide td::before { content: attr(data-name); flex: 0 0 9.5rem; color: var(--soft); }
}
";

const LEAD: &str = "Every number and picture of the paper that can be computed, beside what this program gives. Where the two \
    differ the last column says why. Where the paper measured its robot, a simulated one is measured here: it obeys Eq. 18 with the \
    paper's η = 1.221 and λ = 0.1765 mm, and in a second form has play of ± 0.0875 mm that each backbone's load takes up, the \
    middle of what the paper's dial indicator found. Naive is compensation by the model alone, with η = 1 and λ = 0.";

/// The page as HTML; it asks no other address for anything.
pub fn page(all: &Reproduction) -> String {
    let theta_by_theta = bending(&all.by_theta, "desired θ (°)", |row| row.theta_deg, Angle::Theta);
    let mut angles_by_delta = bending(&all.by_delta, "desired δ (°)", |row| row.delta_deg, Angle::Theta);
    angles_by_delta.extend(bending(&all.by_delta, "desired δ (°)", |row| row.delta_deg, Angle::Delta));
    let section = |title: &str, places: &[&str], figures: &[Figure]| section(title, &all.comparisons, places, figures);
    let content = html! {
        h1 { "The paper, reproduced" }
        p { (LEAD) }
        (section("Friction: Table II, Fig. 8, Eq. 14", &["Table II", "Eq. 14", "Fig. 8"], &friction(all)))
        (section(
            "The line, and Fig. 9: backbone 1 over the workspace",
            &["Section III-B", "Eq. 16, 17", "Section V", "Fig. 9"],
            &workspace(all),
        ))
        (section("Fig. 10: bending errors at δ = 0°", &["Fig. 10"], &theta_by_theta))
        (section("Fig. 11: bending errors at θ = 30°", &["Fig. 11"], &angles_by_delta))
        (section("Table III: ten measurements", &["Table III"], &recursion(all)))
        (table_iii(all))
        (section("Jacobian and statics: Eq. 5, 9, 26", &["Eq. 5", "Eq. 9", "Eq. 26"], &jacobian(all)))
        (made_from(&Provenance::new("reproduce")))
    };
    document("snakeloop: the paper, reproduced", STYLE, &content)
}

/// A plot with its title and caption.
type Figure = (String, &'static str, Plot);

/// A heading, the comparisons of these places, and figures.
fn section(title: &str, comparisons: &[Comparison], places: &[&str], figures: &[Figure]) -> Markup {
    let optional = |value: Option<f64>| value.map_or("–".to_owned(), number);
    html! {
        h2 { (title) }
        .wide {
            table {
                tr { @for name in COLUMNS { th { (name) } } }
                @for row in comparisons.iter().filter(|row| places.contains(&row.place)) {
                    @let [place, quantity, paper, ours, difference, unit, why] = COLUMNS;
                    tr {
                        td data-name=(place) { span { (row.place) } }
                        td.quantity data-name=(quantity) { span { (row.quantity) } }
                        td.number data-name=(paper) { span { (optional(row.paper)) } }
                        td.number data-name=(ours) { span { (number(row.ours)) } }
                        td.number data-name=(difference) { span { (optional(row.difference())) } }
                        td data-name=(unit) { @if row.unit != "1" { span { (row.unit) } } }
                        td.why data-name=(why) { span { (with_code(&row.explanation)) } }
                    }
                }
            }
        }
        .plots.pairs[figures.len().is_multiple_of(2)] {
            @for (title, caption, plot) in figures { (figure(title, plot, caption)) }
        }
    }
}

/// A number with four decimals; in exponential form if they would all be zeros, and without decimals if it is a whole number. The limits
/// are display choices.
fn number(value: f64) -> String {
    let text = match value.abs() {
        size if size < 1e-12 => "0".to_owned(),
        size if size < 1e-4 => format!("{value:.1e}"),
        size if size >= 2.0 && size.fract() == 0.0 => format!("{value:.0}"),
        _ => format!("{value:.4}"),
    };
    text.replace('-', "−")
}

fn line(name: impl Into<String>, points: impl Iterator<Item = (f64, f64)>) -> Series {
    let points = points.map(|(x, y)| Point { x, y, sd: 0.0 }).collect();
    Series { name: name.into(), style: Style::Band, points }
}

fn plot(x_label: &str, y_label: &str, series: Vec<Series>) -> Plot {
    Plot { x_label: x_label.into(), y_label: y_label.into(), series, y_shown: vec![] }
}

fn friction(all: &Reproduction) -> Vec<Figure> {
    let measured = all.friction.iter().map(|p| Point { x: p.tau_g, y: p.tau_tilde_g, sd: p.tau_tilde_limit_g });
    let measured = Series { name: "Table II".into(), style: Style::Dots, points: measured.collect() };
    let eq_13 = line("Eq. 13", all.friction.iter().map(|p| (p.tau_g, p.equation_13_g)));
    let eq_12 = line("Eq. 12", all.friction.iter().map(|p| (p.tau_g, p.equation_12_g)));
    let off =
        all.friction.iter().map(|p| Point { x: p.tau_g, y: p.tau_tilde_g - p.equation_13_g, sd: p.tau_tilde_limit_g });
    let off = Series { name: String::new(), style: Style::Dots, points: off.collect() };
    vec![
        (
            "Fig. 8: actuation force over the backbone's force".into(),
            "Weighings with their limits of ±25 g, and the fitted lines.",
            plot("τ (g)", "τ̃ (g)", vec![measured, eq_13, eq_12]),
        ),
        (
            "What Eq. 13 leaves".into(),
            "Measured less fitted, with the limits of ±25 g.",
            plot("τ (g)", "τ̃ − Eq. 13 (g)", vec![off]),
        ),
    ]
}

fn workspace(all: &Reproduction) -> Vec<Figure> {
    let around = |length: fn(&crate::reproduce::WorkspacePoint) -> f64| {
        [90.0, 60.0, 30.0].map(|theta_deg: f64| {
            let ring = all.workspace.iter().filter(move |p| (p.theta_deg - theta_deg).abs() < 1e-6);
            line(format!("θ = {theta_deg}°"), ring.map(|p| (p.delta_deg, length(p))))
        })
    };
    let shown = vec![20.0, 32.0];
    let figure = |y_label: &str, series: [Series; 3]| Plot {
        y_shown: shown.clone(),
        ..plot("δ (°)", y_label, series.to_vec())
    };
    vec![
        (
            "Fig. 9: compensated length of backbone 1".into(),
            "L + q̃_1 with η = 1.221, λ = 0.1765 mm; rings of the surface that the paper draws. The whole grid is in figure_9.csv.",
            figure("L + q̃_1 (mm)", around(|p| p.compensated_mm)),
        ),
        ("The same without compensation".into(), "L + q_1 of Eq. 1.", figure("L + q_1 (mm)", around(|p| p.ideal_mm))),
    ]
}

#[derive(Clone, Copy, PartialEq)]
enum Angle {
    Theta,
    Delta,
}

fn bending(rows: &[BendingError], x_label: &str, x: fn(&BendingError) -> f64, angle: Angle) -> Vec<Figure> {
    let (y_label, of): (_, fn(&BendingError) -> f64) = match angle {
        Angle::Theta => ("error of θ (°)", |row| row.error_theta_deg),
        Angle::Delta => ("error of δ (°)", |row| row.error_delta_deg),
    };
    let all_four = [
        (Compensation::Naive, "naive"),
        (Compensation::Estimated, "estimated"),
        (Compensation::EstimatedWithPlay, "estimated, play known"),
        (Compensation::None, "none"),
    ];
    let figure = |robot: SimulatedRobot, without: bool| {
        let chosen = all_four.iter().filter(|(compensation, _)| without || *compensation != Compensation::None);
        let series = chosen.map(|(compensation, name)| {
            let of_these = rows.iter().filter(|row| (row.robot, row.compensation) == (robot, *compensation));
            line(*name, of_these.map(|row| (x(row), of(row))))
        });
        plot(x_label, y_label, series.filter(|series| !series.points.is_empty()).collect())
    };
    let mut figures = Vec::new();
    for (robot, name) in
        [(SimulatedRobot::Equation18, "Eq. 18's robot"), (SimulatedRobot::WithPlay, "The robot with play")]
    {
        // By symmetry Eq. 18's robot bends where it is told to, if not as far.
        if angle == Angle::Delta && robot == SimulatedRobot::Equation18 {
            continue;
        }
        if angle == Angle::Theta {
            let note = "Reached less desired, with each compensation.";
            figures.push((format!("{name}, {y_label}"), note, figure(robot, true)));
        }
        let note = "The same without the uncompensated errors; the goal is ±1°.";
        figures.push((format!("{name}, {y_label}, compensated"), note, figure(robot, false)));
    }
    figures
}

fn recursion(all: &Reproduction) -> Vec<Figure> {
    let figure =
        |paper: &dyn Fn(&RecursionStep) -> f64, ours: &dyn Fn(&RecursionStep) -> Option<(f64, f64)>, y_label: &str| {
            let printed = all.recursion.iter().map(|s| Point { x: s.measurement as f64, y: paper(s), sd: 0.0 });
            let simulated = all.recursion.iter().filter_map(|s| {
                let (y, sd) = ours(s)?;
                Some(Point { x: s.measurement as f64, y, sd })
            });
            let series = vec![
                Series { name: "simulated, Eq. 19".into(), style: Style::Band, points: simulated.collect() },
                Series { name: "printed".into(), style: Style::Dots, points: printed.collect() },
            ];
            plot("measurement", y_label, series)
        };
    let note = "Dots: Table III. Line and band: a simulated robot with the paper's final η and λ, ±1σ of Eq. 21.";
    vec![
        ("η̂".into(), note, figure(&|s| s.paper_eta, &|s| Some((s.eta?, s.sd_eta?)), "η")),
        ("λ̂".into(), note, figure(&|s| s.paper_lambda_mm, &|s| Some((s.lambda_mm?, s.sd_lambda_mm?)), "λ (mm)")),
    ]
}

fn table_iii(all: &Reproduction) -> Markup {
    const COLUMNS: [&str; 9] = [
        "No.",
        "η̂ printed",
        "η̂ simulated",
        "± Eq. 21",
        "rms of 400 repeats",
        "λ̂ printed (mm)",
        "λ̂ simulated (mm)",
        "± Eq. 21",
        "rms of 400 repeats",
    ];
    let cells = |step: &RecursionStep| {
        let number = |value: Option<f64>| value.map_or("–".to_owned(), |value| format!("{value:.4}"));
        [
            step.measurement.to_string(),
            number(Some(step.paper_eta)),
            number(step.eta),
            number(step.sd_eta),
            number(step.scatter_eta),
            number(Some(step.paper_lambda_mm)),
            number(step.lambda_mm),
            number(step.sd_lambda_mm),
            number(step.scatter_lambda_mm),
        ]
    };
    html! {
        .wide {
            table {
                tr { @for name in COLUMNS { th { (name) } } }
                @for step in &all.recursion {
                    tr { @for (name, cell) in COLUMNS.iter().zip(cells(step)) { td.number data-name=(name) { span { (cell) } } } }
                }
            }
        }
    }
}

fn jacobian(all: &Reproduction) -> Vec<Figure> {
    let at = |value: fn(&crate::reproduce::JacobianEntry) -> f64| {
        all.jacobian
            .iter()
            .filter(|e| e.angle == "theta" && e.backbone == 1 && e.delta_deg == 0.0)
            .map(move |e| (e.theta_deg, value(e)))
    };
    let series = vec![
        line("Eq. 26", at(|e| e.equation_26_rad_per_mm)),
        Series { style: Style::Dots, ..line("differences", at(|e| e.differences_rad_per_mm)) },
        line("Eq. 7", at(|e| e.without_stretch_rad_per_mm)),
    ];
    vec![(
        "∂θ/∂q̃_1 at δ = 0°".into(),
        "Eq. 26, finite differences of where the model leads, and Eq. 7 without the lines' stretch. All entries are in equation_26.csv.",
        plot("θ (°)", "rad/mm", series),
    )]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reproduce::reproduce;

    #[test]
    fn the_page_has_every_comparison_and_reaches_for_nothing() {
        let all = reproduce(1).unwrap();
        let page = page(&all);
        for row in &all.comparisons {
            assert!(page.contains(&with_code(&row.explanation).into_string()), "{row:?}");
        }
        assert!(page.matches("<svg").count() >= 14);
        assert!(!page.contains("http") && !page.contains("NaN"));
    }
}
