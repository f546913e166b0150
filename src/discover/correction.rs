//! A smooth correction where no effect explains the gap: ridge regression of the gap on powers of the bend, held to sweeps that
//! it did not see.

use super::data::Data;
use super::fit::{Fit, Problem, Residual};
use super::search::held_out;
use super::verdict::{Discovery, Verdict};
use crate::robot::effects::{LEARNED_CORRECTION, POWERS, TERMS, basis};
use crate::robot::{Effect, Mechanics, Model, PerBackbone};
use nalgebra::{DMatrix, DVector};
use serde_json::{Value, json};

/// Weights on the coefficients' squares that are tried.
const RIDGES: [f64; 9] = [1e-2, 1e-1, 1.0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6];
/// A coefficient's likely size, mm per radᵐ, is this over 2ᵐ.
const SIZE_MM: f64 = 0.1;
/// The least share of the gap's excess over noise that must go on sweeps left out.
const LEAST_SHARE: f64 = 0.15;
/// What is lost on some sweeps may be this share of what is gained on others.
const MOST_HARM: f64 = 0.25;

/// What came of learning a correction.
#[derive(Debug, Clone)]
pub struct Correction {
    /// The model with the correction; none where it would not have helped.
    pub model: Option<Model>,
    /// rms of the gap of ε without it, on sweeps left out, mm.
    pub before_mm: f64,
    /// The same with it.
    pub after_mm: f64,
    /// What was done and why, in words.
    pub words: String,
}

/// Learns a correction where the verdict is `unexplained`, and keeps it where it takes the gap away on sweeps left out.
pub fn learn_correction(found: &Discovery, data: &Data) -> Correction {
    if found.verdict != Verdict::Unexplained {
        let words = match found.verdict {
            Verdict::None => "no correction was learned: the gap is noise, and there is nothing to gain".to_owned(),
            _ => "no correction was learned: the effects that were named account for the gap".to_owned(),
        };
        return Correction { model: None, before_mm: found.after.eps_mm, after_mm: found.after.eps_mm, words };
    }
    let problem = Problem::new(data, &found.model);
    let fit = problem.fit(&found.model, None, None);
    let lesson = Lesson::new(&problem, &fit);
    let (fits, _) = held_out(&problem, &fit);

    let gap = |k: usize| problem.eps_gap_mm(&fits[data.fold(k)], k);
    let before: Vec<f64> = (0..data.len()).map(|k| mean_square(&gap(k))).collect();
    let trial = |ridge: f64| -> Option<(f64, Vec<f64>)> {
        let answers: Option<Vec<DVector<f64>>> =
            fits.iter().enumerate().map(|(fold, fit)| lesson.learn(&problem, fit, ridge, Some(fold))).collect();
        let answers = answers?;
        let left = |k: usize| mean_square(&(gap(k) - lesson.summand(k, &answers[data.fold(k)])));
        Some((ridge, (0..data.len()).map(left).collect()))
    };
    let best =
        RIDGES.into_iter().filter_map(trial).min_by(|a, b| a.1.iter().sum::<f64>().total_cmp(&b.1.iter().sum::<f64>()));
    let rms = |squares: &[f64]| (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
    let before_mm = rms(&before);
    let refused = |after_mm: f64| Correction {
        model: None,
        before_mm,
        after_mm,
        words: format!(
            "no correction was kept: on sweeps left out a smooth function of bend and direction leaves {after_mm:.4} mm of \
             {before_mm:.4} mm; the gap does not follow the bend"
        ),
    };
    let Some((ridge, after)) = best else { return refused(before_mm) };
    let after_mm = rms(&after);
    let gains = gains_by_sweep(data, &before, &after);
    let sum_of = |sign: f64| gains.iter().map(|gain| (sign * gain).max(0.0)).sum::<f64>();
    let (gained, lost) = (sum_of(1.0), sum_of(-1.0));
    let excess = before.iter().sum::<f64>() - found.noise_floor_mm.powi(2) * data.len() as f64;
    if gained - lost < LEAST_SHARE * excess || lost > MOST_HARM * gained {
        return refused(after_mm);
    }
    let Some(weights) = lesson.learn(&problem, &fit, ridge, None) else { return refused(after_mm) };
    let mut model = found.model.clone();
    model.effects.push(lesson.effect(&weights, data.len()));
    let words = format!(
        "a smooth correction was learned: on sweeps left out it leaves {after_mm:.4} mm of {before_mm:.4} mm. It is no \
         explanation, and holds for this robot, these bends and a motion like the one it was learned from"
    );
    Correction { model: Some(model), before_mm, after_mm, words }
}

/// Over the backbones.
fn mean_square(gap_mm: &PerBackbone) -> f64 {
    gap_mm.norm_squared() / gap_mm.len() as f64
}

/// How much each sweep gains, mm².
fn gains_by_sweep(data: &Data, before: &[f64], after: &[f64]) -> Vec<f64> {
    let mut gains = vec![0.0; data.sweeps.last().map_or(1, |last| last + 1)];
    for (k, (before, after)) in before.iter().zip(after).enumerate() {
        gains[data.sweeps[k]] += before - after;
    }
    gains
}

/// The functions at every sample, and what a summand of ε does to the residuals there.
struct Lesson<'a> {
    data: &'a Data,
    largest_theta: f64,
    /// The functions for each backbone.
    basis: Vec<PerBackbone<[f64; TERMS]>>,
    /// Response of the residuals to ε of each backbone.
    response: Vec<PerBackbone<Residual>>,
}

impl<'a> Lesson<'a> {
    fn new(problem: &Problem<'a>, fit: &Fit) -> Self {
        let data = problem.data;
        let motions = Mechanics::new(&fit.model).motions_from_readings(&data.times_s, &fit.path, &data.q_mm);
        let largest_theta = fit.path.iter().map(|bend| bend.norm()).fold(0.0, f64::max);
        let n = data.backbones();
        let at = |k: usize| motions[k].direction.map(|direction| basis(fit.path[k], direction, largest_theta));
        let response = |k: usize| PerBackbone::from_fn(n, |i| problem.response(k, &PerBackbone::ith(n, i)));
        let all = 0..data.len();
        Self { data, largest_theta, basis: all.clone().map(at).collect(), response: all.map(response).collect() }
    }

    /// The weights that leave least of a fit's residuals, those of the fold `without` apart.
    fn learn(&self, problem: &Problem, fit: &Fit, ridge: f64, without: Option<usize>) -> Option<DVector<f64>> {
        let weights = self.data.backbones() * TERMS;
        let mut information = DMatrix::zeros(weights, weights);
        let mut right = DVector::zeros(weights);
        for j in 0..weights {
            information[(j, j)] = ridge * (2f64.powi(POWERS[j % TERMS]) / SIZE_MM).powi(2);
        }
        for k in (0..self.data.len()).filter(|&k| without != Some(problem.data.fold(k))) {
            let r = fit.residuals[k];
            let response = &self.response[k];
            for (i, own) in self.basis[k].iter().enumerate() {
                for (a, left) in own.iter().enumerate() {
                    right[i * TERMS + a] -= left * response[i].dot(&r);
                    for (j, other) in self.basis[k].iter().enumerate() {
                        for (b, value) in other.iter().enumerate() {
                            information[(i * TERMS + a, j * TERMS + b)] += left * value * response[i].dot(&response[j]);
                        }
                    }
                }
            }
        }
        information.cholesky().map(|factor| factor.solve(&right))
    }

    /// The correction of ε at sample k, mm.
    fn summand(&self, k: usize, weights: &DVector<f64>) -> PerBackbone {
        PerBackbone::from_fn(self.data.backbones(), |i| {
            self.basis[k][i].iter().enumerate().map(|(j, value)| value * weights[i * TERMS + j]).sum()
        })
    }

    fn effect(&self, weights: &DVector<f64>, samples: usize) -> Effect {
        let mut values = vec![self.largest_theta.to_degrees().clamp(1.0, 120.0)];
        values.extend(weights.iter().map(|weight| weight.clamp(-50.0, 50.0)));
        let found = format!("discover --correction, {samples} samples");
        Effect { found, ..Effect::of(&LEARNED_CORRECTION, values) }
    }
}

impl Correction {
    /// The entry `correction` of discrepancy.json.
    pub fn json(&self) -> Value {
        json!({
            "kept": self.model.is_some(),
            "before_mm": self.before_mm,
            "after_mm": self.after_mm,
            "words": self.words,
        })
    }
}
