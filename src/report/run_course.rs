//! The course of a run, for its report: angles, estimate and residuals over time, or over the frames where not all have a time.

use super::plot::{Plot, Point, Series, Style};
use super::run_history::RunHistory;
use super::run_plots::Titled;
use crate::estimate::{EstimateRow, EtaLambda, Verdict};
use crate::observation::{Measured, Measurement};

/// The measured angles over the course of a run.
pub fn angles_over_time(history: &RunHistory) -> [Titled; 2] {
    let rows = &history.plotted[..];
    let axis = Axis::of(rows);
    let angle = |value: fn(&Measured) -> (f64, f64)| angle_series(rows, &axis, value);
    [
        axis.plot(
            "Bend θ",
            "θ (°)",
            angle(|m| (m.configuration.theta_deg(), m.sigma_theta.to_degrees())),
            "Measured bend from straight, with bars of ±1σ (often smaller than the dot).",
        ),
        axis.plot(
            "Azimuth δ",
            "δ (°)",
            angle(|m| (m.configuration.delta_deg(), m.sigma_delta.to_degrees())),
            "Measured azimuth of the bend, with bars of ±1σ. Near straight δ means little and its bar is long.",
        ),
    ]
}

/// The estimate and what it leaves over the course of a run.
pub fn course(history: &RunHistory) -> Vec<Titled> {
    let rows = &history.plotted[..];
    let axis = Axis::of(rows);
    let one = |style, value: Value| vec![series(rows, &axis, "", style, value)];
    let estimate =
        |value: fn(&EtaLambda) -> (f64, f64)| one(Style::Band, &move |_, row| row.estimate.as_ref().map(value));
    let backbones = rows.iter().find_map(|(_, row)| Some(row.residual_mm?.len())).unwrap_or(0);
    let residual = |i: usize| {
        series(rows, &axis, &format!("backbone {}", i + 1), Style::Dots, &|_, row| Some((row.residual_mm?[i], 0.0)))
    };
    vec![
        axis.plot("Force scale η", "η", estimate(|e| (e.eta, e.sd_eta)), ESTIMATE),
        axis.plot("Backlash λ", "λ (mm)", estimate(|e| (e.lambda_mm, e.sd_lambda_mm)), ESTIMATE),
        axis.plot_with_zero(
            "Reprojection residuals",
            "rms (px)",
            one(Style::Dots, &|m, _| Some((m.quality?.rms_px, 0.0))),
            "Root mean square distance of the edges in each frame from the fitted outline.",
        ),
        axis.plot_with_zero(
            "Residuals of ε",
            "residual (mm)",
            (0..backbones).map(residual).collect(),
            "Measured ε less what the estimate before it predicted. A pattern here is something the model does not know.",
        ),
    ]
}

/// A value of a row with its σ, where the row has it.
type Value<'a> = &'a dyn Fn(&Measurement, &EstimateRow) -> Option<(f64, f64)>;

/// What stands below the plots of η and λ.
const ESTIMATE: &str = "The estimate after each measurement, with its band of ±1σ.";

/// A value with its σ over the course of the run, of the rows that have it.
fn series(rows: &[(Measurement, EstimateRow)], axis: &Axis, name: &str, style: Style, value: Value) -> Series {
    let point = |(m, row): &(Measurement, EstimateRow)| {
        let (y, sd) = value(m, row)?;
        Some(Point { x: axis.place(row.index, row.time_s), y, sd })
    };
    Series { name: name.to_owned(), style, points: rows.iter().filter_map(point).collect() }
}

/// The measured angles, those apart that the estimator rejected.
fn angle_series(rows: &[(Measurement, EstimateRow)], axis: &Axis, angle: fn(&Measured) -> (f64, f64)) -> Vec<Series> {
    let of = |name: &str, rejected: bool| {
        series(rows, axis, name, Style::Dots, &|m, row| {
            let is_of_these = (row.verdict == Verdict::Rejected) == rejected;
            m.measured.as_ref().filter(|_| is_of_these).map(angle)
        })
    };
    let mut both = vec![of("used", false), of("rejected", true)];
    both.retain(|series| !series.points.is_empty());
    both
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

    /// A plot along this axis.
    fn plot(&self, title: &'static str, y_label: &str, series: Vec<Series>, caption: &str) -> Titled {
        let plot = Plot { x_label: self.label().into(), y_label: y_label.into(), series, y_shown: vec![] };
        Titled { title, caption: caption.to_owned(), plot }
    }

    /// The same with a line at zero.
    fn plot_with_zero(&self, title: &'static str, y_label: &str, series: Vec<Series>, caption: &str) -> Titled {
        let Titled { title, caption, plot } = self.plot(title, y_label, series, caption);
        Titled { title, caption, plot: Plot { y_shown: vec![0.0], ..plot } }
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
