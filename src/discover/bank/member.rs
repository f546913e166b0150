//! One structure of the bank: an extended Kalman filter over its numbers, in square-root information form.

use crate::discover::fit::{LOSS, scales};
use crate::discover::posterior::Candidate;
use crate::discover::residuals::{Problem, Residual};
use crate::robot::Model;
use crate::robot::effects::{ParameterSpec, RIG_ERROR};
use crate::statistics::information::SquareRootInformation;
use nalgebra::{DMatrix, DVector};
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt;

/// Samples after which 1/e of what a sample said is left.
///
/// Convention: as long as a log that `discover` names an effect from usually is.
pub const MEMORY: f64 = 200.0;

/// The least probability of a structure, so that one that has become true can come back.
///
/// Convention: a sample or two in which it predicts better by 3σ then bring it back.
pub const LEAST_PROBABILITY: f64 = 1e-3;

/// A number that lies further than this many standard deviations from where it was has moved.
///
/// Source: any table of the normal distribution: one in 16,000. The five numbers of a usual structure over a hundred memories are 500
/// independent looks, of which 3 % make a false notice.
const MOVED_SIGMAS: f64 = 4.0;

/// One structure with the filter of its numbers.
#[derive(Debug, Clone)]
pub struct Member {
    pub effects: Vec<&'static str>,
    /// With the numbers as they stand.
    pub model: Model,
    /// What is known of the numbers in units of their scales.
    pub information: SquareRootInformation,
    /// How many times as large the variance of each number is as that of samples that do not hang together.
    pub inflation: DVector<f64>,
    pub ln_probability: f64,
    /// What the discovery said of it.
    pub ln_given: f64,
    /// Of each number, where it was when it was last said where it is.
    pub told: Vec<Known>,
}

/// What was known of a number at a time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Known {
    pub value: f64,
    pub sd: f64,
    pub time_s: f64,
}

/// What a filter made of one sample: the logarithm of the density of its innovation, and the mean square of that, whitened.
#[derive(Debug, Clone, Copy)]
pub struct Score {
    pub ln_density: f64,
    pub mean_square: f64,
}

/// A structure as it stands.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Followed {
    /// Its effects beyond those of the model as given.
    pub effects: Vec<&'static str>,
    /// Its probability among those that are followed.
    pub probability: f64,
    /// η, λ and the parameters of all effects, those as `effect.parameter`.
    pub parameters: BTreeMap<String, Number>,
}

/// A number of a structure.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Number {
    /// Its value.
    pub value: f64,
    /// Its standard deviation.
    pub sd: f64,
    /// Its unit.
    pub unit: &'static str,
}

/// A number that has moved.
#[derive(Debug, Clone, PartialEq)]
pub struct Moved {
    /// η, λ, or the parameter as `effect.parameter`.
    pub name: String,
    /// What it was.
    pub from: Number,
    /// What it is.
    pub to: Number,
    /// In how long, s.
    pub seconds: f64,
}

impl fmt::Display for Moved {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { name, from, to, seconds } = self;
        // Two digits of the standard deviation.
        let decimals = (1.0 - to.sd.max(1e-9).log10().floor()).clamp(0.0, 9.0) as usize;
        let unit = if to.unit == "1" { String::new() } else { format!(" {}", to.unit) };
        let ([was, was_sd], [is, is_sd]) = ([from.value, from.sd], [to.value, to.sd]);
        write!(
            f,
            "{name} has moved within {seconds:.0} s: it was {was:.decimals$} ± {was_sd:.decimals$}{unit}, and is {is:.decimals$} ± {is_sd:.decimals$}{unit}"
        )
    }
}

impl Member {
    /// With the covariance that its fit to the problem's samples has.
    pub fn new(problem: &Problem, candidate: &Candidate, time_s: f64) -> Self {
        let model = problem.with_covariance(&problem.evaluated(&candidate.model, None));
        let typical = scales(&model);
        let mut covariance = model.covariance();
        covariance.iter_mut().enumerate().for_each(|(at, value)| {
            *value /= typical[at % typical.len()] * typical[at / typical.len()];
        });
        let ln_probability = candidate.probability.max(LEAST_PROBABILITY).ln();
        let n = typical.len();
        let start = DVector::from_vec(model.parameter_values()).component_div(&typical);
        // Of what the fit does not determine nothing is known, and no sample is accounted for.
        let information =
            SquareRootInformation::of(&start, &covariance).unwrap_or_else(|| SquareRootInformation::none(n));
        let mut member = Self {
            effects: candidate.effects.clone(),
            inflation: DVector::repeat(n, 1.0),
            model,
            information,
            ln_probability,
            ln_given: ln_probability,
            told: Vec::new(),
        };
        member.told = member.known(time_s);
        member
    }

    /// Takes a problem's samples one after the other, with residuals that are linearised where its numbers stand before them.
    pub fn update(&mut self, problem: &Problem) -> Vec<Score> {
        let typical = scales(&self.model);
        let start = DVector::from_vec(self.model.parameter_values()).component_div(&typical);
        let prediction = problem.predict(&self.model, None);
        let jacobian = problem.jacobian(&self.model, &prediction, 0..start.len());
        let mut x = start.clone();
        let take = |(k, residual): (usize, &Residual)| {
            let by_x = jacobian.rows(residual.len() * k, residual.len()).into_owned();
            let innovation = DVector::from_iterator(residual.len(), residual.iter().copied()) + &by_x * (&x - &start);
            self.walk(&x);
            let score = self.correct(&x, &by_x, &innovation);
            self.information.solution().into_iter().for_each(|(next, _)| x = next);
            score.unwrap_or(Score { ln_density: f64::NEG_INFINITY, mean_square: 1.0 })
        };
        let scores = prediction.residuals.iter().enumerate().map(take).collect();
        let values = x.component_mul(&typical);
        let within = |(value, spec): (&f64, &ParameterSpec)| value.clamp(spec.range.0, spec.range.1);
        let values: Vec<f64> = values.iter().zip(&self.model.parameter_specs()).map(within).collect();
        self.model = self.model.with_parameter_values(&values);
        scores
    }

    /// The covariance of the numbers in units of their scales.
    fn covariance(&self) -> DMatrix<f64> {
        let n = self.information.count();
        self.information.solution().map_or_else(|| DMatrix::zeros(n, n), |(_, covariance)| covariance)
    }

    /// The random walk about x before a sample. No standard deviation grows beyond a number's scale, or what it was if it was above, however long
    /// no sample speaks of it.
    fn walk(&mut self, x: &DVector<f64>) {
        let growth = (1.0 - 1.0 / MEMORY).recip().sqrt();
        let by = self.covariance().diagonal().map(|variance| variance.sqrt().recip().clamp(1.0, growth));
        self.information.walk(x, &by);
    }

    /// Learns from an innovation about x in units of its noise, whose derivatives these are. Like the fit, it bounds the influence of what
    /// lies far out. `None` if the innovation says nothing.
    fn correct(&mut self, x: &DVector<f64>, by_x: &DMatrix<f64>, innovation: &DVector<f64>) -> Option<Score> {
        let (_, covariance) = self.information.solution()?;
        let spread = by_x * covariance * by_x.transpose() + DMatrix::identity(innovation.len(), innovation.len());
        let lower = spread.cholesky()?.l();
        let white = lower.solve_lower_triangular(innovation)?;
        let bounded = &lower * white.map(|r| r * LOSS.weight(r));
        if !self.information.absorb(by_x, &(by_x * x - bounded)) {
            return None;
        }
        let cost: f64 = white.iter().map(|&r| LOSS.rho(r)).sum();
        let ln_volume: f64 = lower.diagonal().iter().map(|side| side.ln()).sum();
        Some(Score { ln_density: -0.5 * cost - ln_volume, mean_square: white.norm_squared() / white.len() as f64 })
    }

    /// How many times as large the variances of another covariance of its numbers are as those of its own, number by number; at least once.
    pub fn design_effects(&self, covariance: &DMatrix<f64>) -> DVector<f64> {
        let own = self.covariance().diagonal().component_mul(&scales(&self.model).map(|scale| scale * scale));
        covariance.diagonal().component_div(&own).map(|ratio| if ratio.is_finite() { ratio.max(1.0) } else { 1.0 })
    }

    /// Knows each number as much less certainly, from now on; numbers beyond the last of these factors as before.
    pub fn inflate(&mut self, factors: &DVector<f64>, time_s: f64) {
        self.inflation.iter_mut().zip(factors).for_each(|(own, factor)| *own = *factor);
        self.told = self.known(time_s);
    }

    /// What is known of each number.
    pub fn known(&self, time_s: f64) -> Vec<Known> {
        let variances = self.covariance().diagonal().component_mul(&self.inflation);
        let sds = variances.map(|variance| variance.max(0.0).sqrt());
        let sds = sds.component_mul(&scales(&self.model));
        let values = self.model.parameter_values();
        values.into_iter().zip(sds.iter()).map(|(value, &sd)| Known { value, sd, time_s }).collect()
    }

    /// Which of its numbers are none of the robot's: the rig's error is the experiment's.
    fn of_rig(&self) -> Vec<bool> {
        let of_effects = self
            .model
            .effects
            .iter()
            .flat_map(|effect| std::iter::repeat_n(effect.physics == &RIG_ERROR, effect.values.len()));
        [false, false].into_iter().chain(of_effects).collect()
    }

    /// Its numbers that have moved since it was said where they are, which is hereby said.
    pub fn moved(&mut self, time_s: f64) -> Vec<Moved> {
        let (names, specs, of_rig) = (self.model.parameter_names(), self.model.parameter_specs(), self.of_rig());
        let mut moved = Vec::new();
        for (j, now) in self.known(time_s).into_iter().enumerate() {
            let before = self.told[j];
            if of_rig[j] || (now.value - before.value).abs() <= MOVED_SIGMAS * now.sd.hypot(before.sd) {
                continue;
            }
            let number = |known: Known| Number { value: known.value, sd: known.sd, unit: specs[j].unit };
            let seconds = time_s - before.time_s;
            moved.push(Moved { name: names[j].clone(), from: number(before), to: number(now), seconds });
            self.told[j] = now;
        }
        moved
    }

    pub fn followed(&self) -> Followed {
        let (names, specs) = (self.model.parameter_names(), self.model.parameter_specs());
        let numbers = self.known(0.0).into_iter().zip(&specs);
        let numbers = numbers.map(|(known, spec)| Number { value: known.value, sd: known.sd, unit: spec.unit });
        let named = names.into_iter().zip(numbers).zip(self.of_rig());
        let parameters = named.filter(|(_, of_rig)| !of_rig).map(|(named, _)| named).collect();
        Followed { effects: self.effects.clone(), probability: self.ln_probability.exp(), parameters }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::discover::fixture::{experiment, truth};
    use crate::discover::noise::Noise;

    #[test]
    fn a_sample_within_the_bound_is_learned_from_by_kalmans_equations() {
        let data = experiment(1);
        let problem = Problem::new(&data, &Noise::stated(&data), &truth());
        let candidate = Candidate { effects: Vec::new(), probability: 1.0, model: truth() };
        let mut member = Member::new(&problem, &candidate, 0.0);
        let x = DVector::from_vec(truth().parameter_values()).component_div(&scales(&truth()));
        let before = member.covariance();
        member.walk(&x);
        let p = &before * (1.0 + 1.0 / (MEMORY - 1.0));
        assert!((member.covariance() - &p).norm() < 1e-9 * p.norm());
        let by_x = DMatrix::from_fn(3, 2, |a, b| 40.0 * (1.3 * a as f64 + 2.1 * b as f64).sin());
        let innovation = DVector::from_column_slice(&[0.5, -1.2, 0.8]);
        let score = member.correct(&x, &by_x, &innovation).unwrap();
        let spread = &by_x * &p * by_x.transpose() + DMatrix::identity(3, 3);
        let inverse = spread.clone().try_inverse().unwrap();
        let gain = &p * by_x.transpose() * &inverse;
        let (after, covariance) = member.information.solution().unwrap();
        assert!((after - (&x - &gain * &innovation)).norm() < 1e-9 * x.norm());
        assert!((covariance - (&p - &gain * &by_x * &p)).norm() < 1e-9 * p.norm());
        let ln_density = -0.5 * (innovation.dot(&(inverse * &innovation)) + spread.determinant().ln());
        assert!((score.ln_density - ln_density).abs() < 1e-9, "{} {ln_density}", score.ln_density);
    }
}
