//! Table II, Fig. 8 and Eq. 14: the friction of the snake cone.

use super::comparison::Comparison;
use crate::error::Result;
use crate::robot::friction::{STANDARD_GRAVITY, table_ii};
use crate::robot::{FrictionFit, FrictionSample, Robot};
use serde::Serialize;

/// The gravity that the paper's f_s takes, m/s². Derived: the printed 1.959 N over the 195.87 gf that Table II gives.
const PAPER_GRAVITY: f64 = 10.0;

/// One weighing of Table II with the fitted line of Fig. 8.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct FrictionPoint {
    /// τ, g.
    pub tau_g: f64,
    /// τ̃ as measured, g.
    pub tau_tilde_g: f64,
    /// The limit of its error, g.
    pub tau_tilde_limit_g: f64,
    /// τ̃ by Eq. 13 with the fitted μ and f_s, g.
    pub equation_13_g: f64,
    /// τ̃ by Eq. 12, without f_s, g.
    pub equation_12_g: f64,
}

/// The fit, its limits of error by Eq. 14, and the line through the points.
///
/// # Errors
/// Those of the fit; none with Table II.
pub fn table_ii_and_figure_8() -> Result<(Vec<Comparison>, Vec<FrictionPoint>)> {
    let weighings = table_ii();
    let fit = FrictionFit::of(&weighings, Robot::default().line.cone_bend_angle())?;
    let points = fitted_line(&fit, &weighings);
    let mut comparisons = compared_fit(&fit);
    comparisons.extend(compared_limits(&fit));
    comparisons.push(compared_scatter(&fit, &points));
    Ok((comparisons, points))
}

/// The weighings beside Eq. 12 and 13 (Fig. 8).
fn fitted_line(fit: &FrictionFit, weighings: &[FrictionSample]) -> Vec<FrictionPoint> {
    let capstan = (2.0 * fit.mu * fit.phi).exp();
    let point = |w: &FrictionSample| FrictionPoint {
        tau_g: w.tau_g,
        tau_tilde_g: w.tau_tilde_g,
        tau_tilde_limit_g: w.tau_tilde_limit_g,
        equation_13_g: capstan * (w.tau_g + fit.static_g),
        equation_12_g: capstan * w.tau_g,
    };
    weighings.iter().map(point).collect()
}

/// μ and f_s of Table II.
fn compared_fit(fit: &FrictionFit) -> Vec<Comparison> {
    let (standard_n, sd_n) = fit.static_force_n(STANDARD_GRAVITY);
    vec![
        Comparison::new(
            "Table II",
            "μ by least squares",
            "1",
            FrictionFit::PAPER_MU,
            fit.mu,
            format!("Agrees. Its standard error from the scatter is {:.4}.", fit.sd_mu()),
        ),
        Comparison::new(
            "Table II",
            "f_s by least squares, g = 10 m/s²",
            "N",
            FrictionFit::PAPER_STATIC_FORCE_N,
            fit.static_force_n(PAPER_GRAVITY).0,
            format!("{:.2} gf. The printed newtons take g = 10 m/s².", fit.static_g),
        ),
        Comparison::new(
            "Table II",
            "f_s by least squares, standard gravity",
            "N",
            FrictionFit::PAPER_STATIC_FORCE_N,
            standard_n,
            format!("The same weight in newtons, with a standard error of {sd_n:.2} N; the program uses this one."),
        ),
    ]
}

/// The limits of error of Eq. 14.
fn compared_limits(fit: &FrictionFit) -> [Comparison; 2] {
    let load_g = load_of_limit(fit, FrictionFit::PAPER_MU_LIMIT);
    [
        Comparison::new(
            "Eq. 14",
            "df_s",
            "N",
            FrictionFit::PAPER_STATIC_FORCE_LIMIT_N,
            fit.static_force_limit_n(),
            "e^{−2μφ}·25 g − 1 g, in newtons. The printed figure is about a tenth of it.",
        ),
        Comparison::new(
            "Eq. 14",
            "dμ at a load of 800 g",
            "1",
            FrictionFit::PAPER_MU_LIMIT,
            fit.mu_limit(800.0),
            format!(
                "dμ falls with the load: {:.3} without load, {:.4} at 1800 g; the printed one is that of {load_g:.0} g.",
                fit.mu_limit(0.0),
                fit.mu_limit(1800.0)
            ),
        ),
    ]
}

/// How many points of Fig. 8 lie within their limits of error.
fn compared_scatter(fit: &FrictionFit, points: &[FrictionPoint]) -> Comparison {
    let within = points.iter().filter(|p| (p.tau_tilde_g - p.equation_13_g).abs() <= p.tau_tilde_limit_g).count();
    Comparison::new(
        "Fig. 8",
        "points within their ±25 g of the fitted line",
        "of 10",
        None,
        within as f64,
        format!(
            "Scatter about the line {:.0} g: Eq. 13 holds about as well as the stated limits can tell.",
            fit.scatter_g
        ),
    )
}

/// The load (g) at which Eq. 14 gives this dμ, by bisection: dμ falls with the load.
fn load_of_limit(fit: &FrictionFit, limit: f64) -> f64 {
    let (mut low, mut high) = (0.0, 1e4);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if fit.mu_limit(middle) > limit { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_papers_figures_come_out_where_they_can() {
        let (comparisons, points) = table_ii_and_figure_8().unwrap();
        let ours = |k: usize| comparisons[k].ours;
        assert!((ours(0) - 0.1727).abs() < 5e-5 && (ours(1) - 1.959).abs() < 5e-4 && (ours(2) - 1.9209).abs() < 5e-5);
        assert!((ours(3) - 0.18).abs() < 5e-3);
        // The line of least squares leaves residuals that sum to zero, and so do their moments.
        let sum: f64 = points.iter().map(|p| p.tau_tilde_g - p.equation_13_g).sum();
        let moment: f64 = points.iter().map(|p| (p.tau_tilde_g - p.equation_13_g) * p.tau_g).sum();
        assert!(sum.abs() < 1e-9 && moment.abs() < 1e-6, "{sum} {moment}");
        let fit = FrictionFit::of(&table_ii(), 41f64.to_radians()).unwrap();
        assert!((load_of_limit(&fit, 0.0135) - 763.0).abs() < 15.0);
    }
}
