//! Held-out residuals: each fold of sweeps under a fit to the others, so that nothing is judged on samples that its fit saw.

use super::fit::Fit;
use super::residuals::Problem;
use super::sweeps::FOLDS;
use crate::estimate::gap::{self, LEAST_THETA_FOR_DELTA};
use crate::robot::PerBackbone;
use crate::statistics::moments::rms;
use rayon::prelude::*;

/// The gap: of a search on sweeps that the fit did not see.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gap {
    /// rms of ε over all backbones, mm.
    pub eps_mm: f64,
    /// rms of θ, degrees.
    pub theta_deg: f64,
    /// rms of δ over bends of 15° or more, degrees.
    pub delta_deg: f64,
}

impl From<gap::Gap> for Gap {
    fn from(gap: gap::Gap) -> Self {
        Self { eps_mm: gap.rms_eps_mm, theta_deg: gap.rms_theta_deg, delta_deg: gap.rms_delta_deg }
    }
}

/// The fits that leave out one fold each.
pub fn held_out_fits(problem: &Problem, fit: &Fit) -> Vec<Fit> {
    (0..FOLDS).into_par_iter().map(|fold| problem.fit(&fit.model, Some(&fit.path), Some(fold))).collect()
}

/// What the model of a fit leaves of every sample, held out.
#[derive(Debug, Clone)]
pub struct HeldOutResiduals {
    /// The gap of ε, mm.
    pub eps_mm: Vec<PerBackbone>,
    /// Its size, and that of θ and δ, without a start that nobody knows.
    pub gap: Gap,
}

impl HeldOutResiduals {
    /// Fits anew without each fold.
    pub fn new(problem: &Problem, fit: &Fit) -> Self {
        let data = problem.data;
        let fits = held_out_fits(problem, fit);
        let residuals = |k: usize| &fits[data.fold(k)].residuals[..];
        let eps_mm: Vec<_> = (0..data.len()).map(|k| problem.eps_gap_mm(residuals(k), k)).collect();
        let bend: Vec<_> = (0..data.len()).map(|k| problem.bend_gap(residuals(k), k)).collect();
        let known = problem.noise.unknown_start..;
        let thetas = data.measured.iter().map(|measured| measured.configuration.theta);
        let far = bend.iter().zip(thetas).skip(known.start).filter(|(_, theta)| *theta >= LEAST_THETA_FOR_DELTA);
        let gap = Gap {
            eps_mm: rms(eps_mm[known.clone()].iter().flat_map(|eps| eps.iter().copied())),
            theta_deg: rms(bend[known].iter().map(|gap| gap.x)).to_degrees(),
            delta_deg: rms(far.map(|(gap, theta)| gap.y / theta)).to_degrees(),
        };
        Self { eps_mm, gap }
    }
}
