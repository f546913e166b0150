//! Which effects: forward steps over a small beam, exchange, backward elimination, and what the rivals say.

use super::data::{Data, FOLDS};
use super::fit::{Fit, Problem};
use crate::robot::{Effect, LIBRARY, Model, Physics};
use nalgebra::{DMatrix, DVector, Matrix2xX, Vector3};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use rayon::prelude::*;
use std::f64::consts::TAU;

/// What an effect must gain in Schwarz's criterion, beyond the price of its parameters: eighteen are tried.
const LEAST_GAIN: f64 = 12.0;
/// What a rival may fall short by in Schwarz's criterion and still not be ruled out.
const NOT_RULED_OUT: f64 = 6.0;
/// The most effects that are named at once.
const MOST_EFFECTS: usize = 3;
/// First effects from which second ones are tried.
const BEAM: usize = 4;
/// An effect that removes less than this share of the gap's excess over noise may be the shape of another that the library
/// does not have quite right.
const LEAST_SHARE: f64 = 0.004;
/// Resamplings of the sweeps.
const RESAMPLINGS: usize = 200;

/// An effect that stands in the search's answer.
#[derive(Debug, Clone)]
pub struct Named {
    /// What it is.
    pub physics: &'static Physics,
    /// How much worse Schwarz's criterion is without it.
    pub bic_gain: f64,
    /// The share of the held-out robust squares that it removes.
    pub held_out_gain: f64,
    /// The share of resampled experiments in which it is needed and none replaces it.
    pub inclusion: f64,
    /// Effects that would do as well in its place.
    pub indistinguishable_from: Vec<&'static str>,
    /// Every rival in its place, with how much worse Schwarz's criterion is; the best first.
    pub rivals: Vec<(&'static str, f64)>,
}

/// What the search found.
#[derive(Debug, Clone)]
pub struct Found {
    /// The model as given, with η and λ at their best.
    pub before: Fit,
    /// The model with the effects found.
    pub after: Fit,
    /// The effects found, in the order of the model's.
    pub named: Vec<Named>,
}

/// Searches. `given` effects of the model stay in it.
pub fn search(problem: &Problem, model: &Model) -> Found {
    let given = model.effects.len();
    let before = problem.fit(&with_estimate(model), None, None);
    let best = forward(problem, &before, given);
    let best = exchange(problem, &before, best, given);
    let after = eliminate(problem, &before, best, given);
    let named = (given..after.model.effects.len()).map(|k| describe(problem, &before, &after, k)).collect();
    Found { before, after, named }
}

/// η = 1, λ = 0 where nothing was estimated, so that there is something to fit.
fn with_estimate(model: &Model) -> Model {
    let x = model.parameters();
    let covariance = model.parameter_covariance();
    let estimate = crate::robot::Estimate { eta: x.x, lambda_mm: x.y, covariance, samples: 0 };
    Model { estimate: Some(estimate), ..model.clone() }
}

fn forward(problem: &Problem, before: &Fit, given: usize) -> Fit {
    let mut best = before.clone();
    let mut beam = vec![before.clone()];
    for _ in 0..MOST_EFFECTS {
        let mut next: Vec<Fit> = beam
            .iter()
            .flat_map(|fit| LIBRARY.into_iter().map(move |physics| (fit, physics)))
            .collect::<Vec<_>>()
            .into_par_iter()
            .filter(|(fit, physics)| fit.model.effects.iter().all(|effect| effect.physics != *physics))
            .map(|(fit, physics)| with_effect(problem, fit, physics))
            .collect();
        next.sort_by(|a, b| a.bic().total_cmp(&b.bic()));
        next.dedup_by(|a, b| same_effects(&a.model, &b.model, given));
        next.truncate(BEAM);
        let Some(first) = next.first() else { break };
        if !worth(problem, before, &best, first) {
            break;
        }
        best = first.clone();
        beam = next;
    }
    best
}

/// Replaces each effect found by any other as long as that is better.
fn exchange(problem: &Problem, before: &Fit, mut best: Fit, given: usize) -> Fit {
    for _ in 0..MOST_EFFECTS {
        if best.model.effects.len() < given + 2 {
            return best;
        }
        let better = (given..best.model.effects.len())
            .flat_map(|k| replacements(problem, before, &best, k))
            .map(|(_, fit)| fit)
            .min_by(|a, b| a.bic().total_cmp(&b.bic()));
        match better {
            Some(fit) if fit.bic() < best.bic() => best = fit,
            _ => return best,
        }
    }
    best
}

/// Drops effects that the others have made superfluous.
fn eliminate(problem: &Problem, before: &Fit, mut best: Fit, given: usize) -> Fit {
    while best.model.effects.len() > given + 1 {
        let lesser = (given..best.model.effects.len())
            .map(|k| problem.fit(&without_effect(&best.model, k), Some(&best.path), None))
            .min_by(|a, b| a.bic().total_cmp(&b.bic()));
        match lesser {
            Some(lesser) if !worth(problem, before, &lesser, &best) => best = lesser,
            _ => break,
        }
    }
    best
}

/// Whether a fit with one effect more is worth it: by Schwarz's criterion, by its share of the gap, and on sweeps left out.
fn worth(problem: &Problem, before: &Fit, lesser: &Fit, fit: &Fit) -> bool {
    let noise = 3.0 * problem.data.len() as f64;
    let excess = (before.cost - noise).max(0.0);
    lesser.bic() - fit.bic() > LEAST_GAIN
        && lesser.cost - fit.cost > LEAST_SHARE * excess
        && held_out(problem, fit).1 < held_out(problem, lesser).1
}

/// The residuals of each sample under a fit that it had no part in, and their robust squares.
pub fn held_out(problem: &Problem, fit: &Fit) -> (Vec<Fit>, f64) {
    let fits: Vec<Fit> =
        (0..FOLDS).into_par_iter().map(|fold| problem.fit(&fit.model, Some(&fit.path), Some(fold))).collect();
    let total = (0..problem.data.len()).map(|k| fits[problem.data.fold(k)].loss(k)).sum();
    (fits, total)
}

/// The best fit with one effect more.
pub(super) fn with_effect(problem: &Problem, fit: &Fit, physics: &'static Physics) -> Fit {
    let starts: Vec<Vec<f64>> = if physics.name == "screw_periodic" {
        screw_starts(problem, fit)
    } else {
        physics.starts.iter().map(|start| start.to_vec()).collect()
    };
    let fits = starts.into_iter().map(|values| {
        let mut model = fit.model.clone();
        model.effects.push(Effect { physics, sds: vec![0.0; values.len()], values, found: String::new() });
        problem.fit(&model, Some(&fit.path), None)
    });
    fits.min_by(|a, b| a.cost.total_cmp(&b.cost)).unwrap_or_else(|| fit.clone())
}

/// Where to look for a screw's pitch: the two best of a periodogram of the residuals over q̃, with η, λ and the other
/// parameters free.
fn screw_starts(problem: &Problem, fit: &Fit) -> Vec<Vec<f64>> {
    let data = problem.data;
    let (least, most) =
        data.q_mm.iter().flat_map(|q| q.iter()).fold((f64::MAX, f64::MIN), |(a, b), &q| (a.min(q), b.max(q)));
    let step = 0.35 / (most - least).max(0.5);
    let residual = DVector::from_iterator(3 * data.len(), fit.residuals.iter().flat_map(|r| [r.x, r.y, r.z]));
    let p = fit.jacobian.ncols();
    let own = fit.jacobian.transpose() * &fit.jacobian;
    let own_right = fit.jacobian.transpose() * &residual;
    let mut powers: Vec<(f64, Vec<f64>)> = Vec::new();
    let mut frequency = 0.2;
    while frequency < 4.0 {
        let mut waves = Matrix2xX::zeros(3 * data.len());
        for (k, q) in data.q_mm.iter().enumerate() {
            let (sin, cos): (Vec<f64>, Vec<f64>) = q.iter().map(|q| (TAU * frequency * q).sin_cos()).unzip();
            let (sin, cos) =
                (problem.response(k, &Vector3::from_vec(sin)), problem.response(k, &Vector3::from_vec(cos)));
            for c in 0..3 {
                waves[(0, 3 * k + c)] = sin[c];
                waves[(1, 3 * k + c)] = cos[c];
            }
        }
        let mut information = DMatrix::zeros(p + 2, p + 2);
        information.view_mut((0, 0), (p, p)).copy_from(&own);
        let cross = &waves * &fit.jacobian;
        information.view_mut((p, 0), (2, p)).copy_from(&cross);
        information.view_mut((0, p), (p, 2)).copy_from(&cross.transpose());
        information.view_mut((p, p), (2, 2)).copy_from(&(&waves * waves.transpose()));
        let mut right = DVector::zeros(p + 2);
        right.rows_mut(0, p).copy_from(&own_right);
        right.rows_mut(p, 2).copy_from(&(&waves * &residual));
        for j in 0..p + 2 {
            information[(j, j)] *= 1.0 + 1e-9;
        }
        if let Some(factor) = information.cholesky() {
            let solution = factor.solve(&right);
            let (a, b) = (-solution[p], -solution[p + 1]);
            let start = vec![a.hypot(b).min(0.4), 1.0 / frequency, b.atan2(a).to_degrees()];
            powers.push((right.dot(&solution), start));
        }
        frequency += step;
    }
    powers.sort_by(|a, b| b.0.total_cmp(&a.0));
    powers.into_iter().take(2).map(|(_, start)| start).collect()
}

pub(super) fn without_effect(model: &Model, k: usize) -> Model {
    let mut model = model.clone();
    model.effects.remove(k);
    model
}

fn same_effects(a: &Model, b: &Model, given: usize) -> bool {
    a.effects.len() == b.effects.len()
        && a.effects[given..]
            .iter()
            .all(|effect| b.effects[given..].iter().any(|other| other.physics == effect.physics))
}

/// Every other effect in the place of effect k.
fn replacements(problem: &Problem, before: &Fit, fit: &Fit, k: usize) -> Vec<(&'static Physics, Fit)> {
    let model = without_effect(&fit.model, k);
    let without = if model.effects.is_empty() { before.clone() } else { problem.fit(&model, Some(&fit.path), None) };
    LIBRARY
        .into_par_iter()
        .filter(|physics| fit.model.effects.iter().all(|effect| effect.physics != *physics))
        .map(|physics| (physics, with_effect(problem, &without, physics)))
        .collect()
}

/// The evidence for effect k of the answer.
fn describe(problem: &Problem, before: &Fit, after: &Fit, k: usize) -> Named {
    let mut without = problem.fit(&without_effect(&after.model, k), Some(&after.path), None);
    if after.model.effects.len() == 1 && before.cost < without.cost {
        without = before.clone();
    }
    let mut rivals = replacements(problem, before, after, k);
    rivals.sort_by(|a, b| a.1.bic().total_cmp(&b.1.bic()));
    let (lost, kept) = (held_out(problem, &without).1, held_out(problem, after).1);
    let all: Vec<&Fit> = rivals.iter().map(|(_, fit)| fit).chain([&without]).collect();
    let wins = resampled_wins(problem.data, after, &all);
    let indistinguishable = rivals
        .iter()
        .zip(&wins)
        .filter(|((_, fit), wins)| fit.bic() - after.bic() < NOT_RULED_OUT || **wins > RESAMPLINGS / 20);
    Named {
        physics: after.model.effects[k].physics,
        bic_gain: without.bic() - after.bic(),
        held_out_gain: if lost > 0.0 { 1.0 - kept / lost } else { 0.0 },
        inclusion: 1.0 - wins.iter().sum::<usize>() as f64 / RESAMPLINGS as f64,
        indistinguishable_from: indistinguishable.map(|((physics, _), _)| physics.name).collect(),
        rivals: rivals.iter().map(|(physics, fit)| (physics.name, fit.bic() - after.bic())).collect(),
    }
}

/// How often each rival beats the answer when whole sweeps are drawn anew, with the fits as they are.
fn resampled_wins(data: &Data, answer: &Fit, rivals: &[&Fit]) -> Vec<usize> {
    let sweeps = data.sweeps.last().map_or(1, |last| last + 1);
    let by_sweep = |fit: &Fit| {
        let mut sums = vec![0.0; sweeps];
        for k in 0..data.len() {
            sums[data.sweeps[k]] += fit.loss(k);
        }
        sums
    };
    let own = by_sweep(answer);
    let price = (3.0 * data.len() as f64).ln();
    let differences: Vec<Vec<f64>> =
        rivals.iter().map(|fit| by_sweep(fit).iter().zip(&own).map(|(theirs, own)| theirs - own).collect()).collect();
    let mut wins = vec![0; rivals.len()];
    let mut random = StdRng::seed_from_u64(1);
    for _ in 0..RESAMPLINGS {
        let drawn: Vec<usize> = (0..sweeps).map(|_| random.random_range(0..sweeps)).collect();
        let margins = differences.iter().zip(rivals).map(|(difference, fit)| {
            let more = fit.parameters as f64 - answer.parameters as f64;
            drawn.iter().map(|&sweep| difference[sweep]).sum::<f64>() + more * price
        });
        let best = margins.enumerate().min_by(|a, b| a.1.total_cmp(&b.1));
        if let Some((rival, margin)) = best
            && margin < 0.0
        {
            wins[rival] += 1;
        }
    }
    wins
}
