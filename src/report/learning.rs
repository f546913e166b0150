//! How the error of the table falls while the loop learns.

use super::plot::{Plot, Point, Series, Style};
use crate::closed_loop::Cycle;

/// Smaller errors are drawn as this, degrees. Convention: a display choice.
const LEAST_DEG: f64 = 1e-4;

/// The table's rms error and each command's own over the number of measurements, as SVG; `naive_deg` is the error before any.
pub fn learning_curve(naive_deg: f64, cycles: &[Cycle]) -> Option<String> {
    let point =
        |measurements: usize, error_deg: f64| Point { x: measurements as f64, y: error_deg.max(LEAST_DEG), sd: 0.0 };
    let after = cycles.iter().enumerate().map(|(k, cycle)| point(k + 1, cycle.table_error_deg));
    let table = [point(0, naive_deg)].into_iter().chain(after).collect();
    let own = cycles.iter().enumerate().map(|(k, cycle)| point(k, cycle.error_deg)).collect();
    let series = vec![
        Series { name: "table, rms over the workspace".into(), style: Style::Band, points: table },
        Series { name: "each command".into(), style: Style::Dots, points: own },
    ];
    let plot = Plot {
        x_label: "measurements".into(),
        y_label: "bending error, degrees".into(),
        series,
        y_shown: vec![0.01, 10.0],
    };
    plot.log_svg()
}
