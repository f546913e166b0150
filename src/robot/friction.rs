//! Friction in the snake cone: Eq. 12–14 and the calibration of Table II.
//!
//! # What the paper's numbers are
//!
//! Least squares through Table II gives τ̃ = 1.2804 τ + 250.8 gf, hence μ = ln 1.2804 / (2φ) = 0.1727, as printed, and
//! f_s = 250.8 / 1.2804 = 195.87 gf. At standard gravity that is 1.9209 N; the printed 1.959 N takes g = 10 m/s².
//! [`Friction::default`] is the former, [`Friction::paper_printed`] the latter.
//!
//! Eq. 14 with the stated limits of ±25 g and ±1 g gives df_s = 0.18 N (the paper: 0.020 N), and a dμ that falls with
//! the load, through the paper's 0.0135 at about 760 g. Neither says how well ten points pin a line; the standard errors of the fit
//! do, and they are what a [`Friction`] carries.

use crate::error::{DataError, Result};
use crate::statistics::line::Line;
use crate::statistics::moments::rms;
use nalgebra::Matrix2;
use serde::{Deserialize, Serialize};

/// Standard gravity, m/s².
///
/// Source: 3rd General Conference on Weights and Measures, 1901.
pub const STANDARD_GRAVITY: f64 = 9.80665;

/// The largest friction coefficient of a wire in its channel.
///
/// Convention: dry metal on metal stays below 1; the paper's cone has 0.17.
const MOST_MU: f64 = 1.0;
/// A slope that is beyond what friction can make by no more than so many of its standard errors may be noise. Convention: three.
const CHANCE_SDS: f64 = 3.0;

/// The friction constants of one snake cone, and how well they are known.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Friction {
    /// Friction coefficient μ between a backbone and the cone's channel.
    pub mu: f64,
    /// Equivalent static friction f_s, N.
    pub static_force_n: f64,
    /// Standard deviation of μ.
    pub sd_mu: f64,
    /// Standard deviation of f_s, N.
    pub sd_static_force_n: f64,
    /// Correlation of their errors, in [−1, 1].
    pub correlation: f64,
}

impl Default for Friction {
    /// The least-squares fit of Table II at standard gravity.
    fn default() -> Self {
        Self { mu: 0.1727, static_force_n: 1.9209, sd_mu: 0.0091, sd_static_force_n: 0.1304, correlation: -0.827 }
    }
}

impl Friction {
    /// The constants as the paper prints them, with f_s at g = 10 m/s². The standard deviations are the fit's.
    pub fn paper_printed() -> Self {
        Self { static_force_n: 1.959, sd_static_force_n: 0.1330, ..Self::default() }
    }

    /// e^{2μφ}, the capstan factor of the cone's two sections of angle φ (rad), Eq. 12.
    pub fn capstan_factor(&self, phi: f64) -> f64 {
        (2.0 * self.mu * phi).exp()
    }

    /// Eq. 13: τ̃ = (τ + f_s) e^{2μφ}, N, the force from the actuation unit behind a backbone's force τ (N).
    pub fn actuation_force_n(&self, tau_n: f64, phi: f64) -> f64 {
        (tau_n + self.static_force_n) * self.capstan_factor(phi)
    }

    /// Covariance of (μ, f_s in N).
    pub fn covariance(&self) -> Matrix2<f64> {
        let cross = self.correlation * self.sd_mu * self.sd_static_force_n;
        Matrix2::new(self.sd_mu.powi(2), cross, cross, self.sd_static_force_n.powi(2))
    }
}

/// One weighing of the calibration experiment: forces as the masses that they balance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrictionSample {
    /// Number in the table.
    pub index: u64,
    /// τ: the calibration weight at the backbone's end, g.
    pub tau_g: f64,
    /// The limit of its error, g.
    pub tau_limit_g: f64,
    /// τ̃: the force scale's reading at the other end, g.
    pub tau_tilde_g: f64,
    /// The limit of its error, g.
    pub tau_tilde_limit_g: f64,
}

/// Table II of the paper.
pub fn table_ii() -> Vec<FrictionSample> {
    // Source: Table II, in gram-force.
    const TAU: [f64; 10] = [0.0, 100.0, 200.0, 300.0, 400.0, 500.0, 700.0, 1000.0, 1500.0, 1800.0];
    const TAU_TILDE: [f64; 10] = [255.0, 420.0, 525.0, 630.0, 750.0, 850.0, 1150.0, 1500.0, 2150.0, 2600.0];
    (1..)
        .zip(TAU.into_iter().zip(TAU_TILDE))
        .map(|(index, (tau_g, tau_tilde_g))| FrictionSample {
            index,
            tau_g,
            tau_limit_g: 1.0,
            tau_tilde_g,
            tau_tilde_limit_g: 25.0,
        })
        .collect()
}

/// What the calibration experiment says about μ and f_s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrictionFit {
    /// Number of weighings.
    pub samples: usize,
    /// φ of each of the cone's two sections, rad.
    pub phi: f64,
    /// Friction coefficient.
    pub mu: f64,
    /// f_s as the mass it balances, g.
    pub static_g: f64,
    /// Covariance of (μ, f_s in g), from the scatter about the line.
    pub covariance: Matrix2<f64>,
    /// Scatter of τ̃ about the line, g (with n − 2 degrees of freedom).
    pub scatter_g: f64,
    /// Root mean square of the stated limits of τ, g.
    pub tau_limit_g: f64,
    /// Root mean square of the stated limits of τ̃, g.
    pub tau_tilde_limit_g: f64,
}

impl FrictionFit {
    /// μ as the paper prints it. Source: its Section III-B.
    pub const PAPER_MU: f64 = 0.1727;
    /// f_s as the paper prints it, N. Source: its Section III-B.
    pub const PAPER_STATIC_FORCE_N: f64 = 1.959;
    /// dμ as the paper prints it. Source: its Eq. 14.
    pub const PAPER_MU_LIMIT: f64 = 0.0135;
    /// df_s as the paper prints it, N. Source: its Eq. 14.
    pub const PAPER_STATIC_FORCE_LIMIT_N: f64 = 0.020;

    /// The least-squares line τ̃ = e^{2μφ} (τ + f_s) through the weighings, for sections of angle `phi` (rad).
    ///
    /// # Errors
    /// [`DataError`] with fewer than three weighings, no spread in τ, a line that falls or one below the origin.
    pub fn of(samples: &[FrictionSample], phi: f64) -> Result<Self> {
        let n = samples.len() as f64;
        if samples.len() < 3 {
            return Err(DataError::TooFewWeighings { found: samples.len(), needed: 3 }.into());
        }
        let Line { slope, intercept, mean_x: tau, spread_x: spread } =
            Line::through(samples.iter().map(|s| (s.tau_g, s.tau_tilde_g)));
        // The comparisons are written so that NaN fails them.
        let sensible = spread > 0.0 && slope > 0.0 && intercept >= 0.0 && phi > 0.0 && phi.is_finite();
        let residuals = samples.iter().map(|s| (s.tau_tilde_g - slope * s.tau_g - intercept).powi(2));
        let variance = residuals.sum::<f64>() / (n - 2.0);
        let slope_variance = variance / spread;
        let most_slope = (2.0 * MOST_MU * phi).exp();
        let chance = CHANCE_SDS * slope_variance.sqrt();
        let is_friction = slope + chance >= 1.0 && slope - chance <= most_slope;
        if !(sensible && is_friction && slope.is_finite() && intercept.is_finite()) {
            return Err(DataError::NotFriction { slope, intercept_g: intercept, most_slope }.into());
        }
        let cross = -tau * slope_variance;
        let intercept_variance = variance / n + tau * tau * slope_variance;
        // μ = ln(slope)/(2φ), f_s = intercept/slope.
        let by_line = Matrix2::new(1.0 / (2.0 * phi * slope), 0.0, -intercept / slope.powi(2), 1.0 / slope);
        Ok(Self {
            samples: samples.len(),
            phi,
            mu: slope.ln() / (2.0 * phi),
            static_g: intercept / slope,
            covariance: by_line * Matrix2::new(slope_variance, cross, cross, intercept_variance) * by_line.transpose(),
            scatter_g: variance.sqrt(),
            tau_limit_g: rms(samples.iter().map(|s| s.tau_limit_g)),
            tau_tilde_limit_g: rms(samples.iter().map(|s| s.tau_tilde_limit_g)),
        })
    }

    /// Standard error of μ.
    pub fn sd_mu(&self) -> f64 {
        self.covariance[(0, 0)].sqrt()
    }

    /// f_s and its standard error, N, for a gravity in m/s².
    pub fn static_force_n(&self, gravity: f64) -> (f64, f64) {
        let newton_per_g = gravity / 1000.0;
        (self.static_g * newton_per_g, self.covariance[(1, 1)].sqrt() * newton_per_g)
    }

    /// The constants for a model, at standard gravity.
    pub fn friction(&self) -> Friction {
        let (static_force_n, sd_static_force_n) = self.static_force_n(STANDARD_GRAVITY);
        let correlation = self.covariance[(0, 1)] / (self.covariance[(0, 0)] * self.covariance[(1, 1)]).sqrt();
        Friction {
            mu: self.mu,
            static_force_n,
            sd_mu: self.sd_mu(),
            sd_static_force_n,
            // Points exactly on a line have no errors to correlate.
            correlation: if correlation.is_finite() { correlation.clamp(-1.0, 1.0) } else { 0.0 },
        }
    }

    /// Eq. 14 recomputed: df_s = e^{−2μφ} dτ̃ − dτ, N at standard gravity, with the stated limits of error.
    pub fn static_force_limit_n(&self) -> f64 {
        let capstan = (2.0 * self.mu * self.phi).exp();
        (self.tau_tilde_limit_g / capstan - self.tau_limit_g) * STANDARD_GRAVITY / 1000.0
    }

    /// Eq. 14 recomputed: dμ = (dτ̃/τ̃ − dτ/(f_s + τ)) / (2φ) at a load τ (g), with the stated limits of error.
    pub fn mu_limit(&self, tau_g: f64) -> f64 {
        let behind = tau_g + self.static_g;
        let tau_tilde_g = behind * (2.0 * self.mu * self.phi).exp();
        (self.tau_tilde_limit_g / tau_tilde_g - self.tau_limit_g / behind) / (2.0 * self.phi)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;
    use rand::SeedableRng;
    use rand_distr::{Distribution, Normal};

    fn phi() -> f64 {
        41f64.to_radians()
    }

    #[test]
    fn table_ii_gives_the_papers_mu_and_both_readings_of_its_static_force() {
        let fit = FrictionFit::of(&table_ii(), phi()).unwrap();
        assert!((fit.mu - 0.1727).abs() < 5e-5, "μ = {}", fit.mu);
        assert!((fit.static_g - 195.87).abs() < 5e-3, "f_s = {} g", fit.static_g);
        assert!((fit.static_force_n(STANDARD_GRAVITY).0 - 1.9209).abs() < 5e-5);
        assert!((fit.static_force_n(10.0).0 - FrictionFit::PAPER_STATIC_FORCE_N).abs() < 5e-4);
    }

    #[test]
    fn the_built_in_constants_are_the_fits() {
        let fit = FrictionFit::of(&table_ii(), phi()).unwrap();
        let (fitted, built_in) = (fit.friction(), Friction::default());
        assert!((fitted.mu - built_in.mu).abs() < 5e-5);
        assert!((fitted.static_force_n - built_in.static_force_n).abs() < 5e-5);
        assert!((fitted.sd_mu - built_in.sd_mu).abs() < 5e-5, "{}", fitted.sd_mu);
        assert!((fitted.sd_static_force_n - built_in.sd_static_force_n).abs() < 5e-5, "{}", fitted.sd_static_force_n);
        assert!((fitted.correlation - built_in.correlation).abs() < 5e-4, "{}", fitted.correlation);
        let printed = Friction::paper_printed();
        assert!((fit.static_force_n(10.0).1 - printed.sd_static_force_n).abs() < 5e-5);
    }

    #[test]
    fn equation_14_does_not_give_what_the_paper_prints() {
        let fit = FrictionFit::of(&table_ii(), phi()).unwrap();
        assert!((fit.static_force_limit_n() - 0.18).abs() < 0.005, "{}", fit.static_force_limit_n());
        assert!(fit.mu_limit(0.0) > 0.05 && fit.mu_limit(1800.0) < 0.008);
        assert!((fit.mu_limit(763.0) - FrictionFit::PAPER_MU_LIMIT).abs() < 2e-4, "{}", fit.mu_limit(763.0));
    }

    #[test]
    fn standard_errors_are_those_of_repeated_experiments() {
        let (mu, static_g, scatter) = (0.17, 190.0, 30.0);
        let mut random = rand::rngs::StdRng::seed_from_u64(1);
        let noise = Normal::new(0.0, scatter).unwrap();
        let fits: Vec<_> = (0..3000)
            .map(|_| {
                let mut samples = table_ii();
                for sample in &mut samples {
                    let exact = (sample.tau_g + static_g) * (2.0 * mu * phi()).exp();
                    sample.tau_tilde_g = exact + noise.sample(&mut random);
                }
                FrictionFit::of(&samples, phi()).unwrap()
            })
            .collect();
        let mean = |value: &dyn Fn(&FrictionFit) -> f64| fits.iter().map(value).sum::<f64>() / fits.len() as f64;
        let mu_variance = mean(&|f| (f.mu - mu).powi(2));
        let static_variance = mean(&|f| (f.static_g - static_g).powi(2));
        // A variance of 3000 draws scatters by √(2/3000), 2.6 %: three of that.
        assert_relative_eq!(mean(&|f| f.covariance[(0, 0)]), mu_variance, max_relative = 0.08);
        assert_relative_eq!(mean(&|f| f.covariance[(1, 1)]), static_variance, max_relative = 0.08);
    }

    #[test]
    fn equation_13_at_no_load_is_the_static_part() {
        let friction = Friction::default();
        assert_relative_eq!(friction.actuation_force_n(0.0, phi()), 1.9209 * (2.0 * 0.1727 * phi()).exp());
    }

    #[test]
    fn weighings_that_cannot_be_a_cone_are_an_error() {
        let table = table_ii();
        let falling: Vec<_> = table.iter().map(|s| FrictionSample { tau_tilde_g: -s.tau_tilde_g, ..*s }).collect();
        let same: Vec<_> = table.iter().map(|s| FrictionSample { tau_g: 5.0, ..*s }).collect();
        // Newtons in a column of grams, either way round.
        let newtons: Vec<_> =
            table.iter().map(|s| FrictionSample { tau_tilde_g: s.tau_tilde_g / 102.0, ..*s }).collect();
        let grams: Vec<_> = table.iter().map(|s| FrictionSample { tau_g: s.tau_g / 102.0, ..*s }).collect();
        for bad in [&table[..2], &falling, &same, &newtons, &grams] {
            assert!(FrictionFit::of(bad, phi()).is_err());
        }
    }
}
