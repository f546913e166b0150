//! Which effects: forward steps over a small beam, exchange, backward elimination, and what the rivals say.

use super::chance::Chance;
use super::data::{Data, FOLDS};
use super::fit::{Fit, Problem, normal_equations};
use crate::robot::effects::{Phases, Starts};
use crate::robot::{Effect, LIBRARY, Model, PerBackbone, Physics};
use nalgebra::{DMatrix, DVector};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use rayon::prelude::*;
use std::f64::consts::TAU;

/// What a rival may fall short by in Schwarz's criterion and still not be ruled out.
const NOT_RULED_OUT: f64 = 6.0;
/// The most effects that are named at once.
const MOST_EFFECTS: usize = 3;
/// First effects from which second ones are tried.
const BEAM: usize = 4;
/// The most promising starts from a fit that are followed to their end.
const FOLLOWED: usize = 8;
/// An effect that removes less than this share of the gap's excess over noise may be the shape of another that the library
/// does not have quite right.
const LEAST_SHARE: f64 = 0.004;
/// The share of resamplings in which an effect must be needed: what a few samples ask for is not.
const LEAST_INCLUSION: f64 = 0.9;
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
pub fn search(problem: &Problem, before: Fit, chance: &Chance) -> Found {
    let given = before.model.effects.len();
    let search = Search { problem, before, chance, given };
    let best = search.forward();
    let best = search.exchange(best);
    let after = search.eliminate(best);
    let named = (given..after.model.effects.len()).map(|k| search.describe(&after, k)).collect();
    Found { before: search.before, after, named }
}

struct Search<'a> {
    problem: &'a Problem<'a>,
    before: Fit,
    chance: &'a Chance,
    given: usize,
}

impl Search<'_> {
    fn forward(&self) -> Fit {
        let mut best = self.before.clone();
        let mut beam = vec![self.before.clone()];
        for _ in 0..MOST_EFFECTS {
            let mut next: Vec<Fit> = beam.iter().flat_map(|fit| one_more(self.problem, fit, FOLLOWED, 0.0)).collect();
            next.sort_by(|a, b| a.bic().total_cmp(&b.bic()));
            let mut kept: Vec<Fit> = Vec::new();
            for fit in next {
                if kept.len() < BEAM && kept.iter().all(|other| !same_effects(&other.model, &fit.model)) {
                    kept.push(fit);
                }
            }
            let Some(first) = kept.first() else { break };
            if !self.worth(&best, first) {
                break;
            }
            best = first.clone();
            beam = kept;
        }
        best
    }

    /// Replaces each effect found by any other as long as that is better.
    fn exchange(&self, mut best: Fit) -> Fit {
        for _ in 0..MOST_EFFECTS {
            if best.model.effects.len() < self.given + 2 {
                return best;
            }
            let better = (self.given..best.model.effects.len())
                .flat_map(|k| one_more(self.problem, &self.without(&best, k), FOLLOWED, 0.0))
                .min_by(|a, b| a.bic().total_cmp(&b.bic()));
            match better {
                Some(fit) if fit.bic() < best.bic() - 0.1 => best = fit,
                _ => return best,
            }
        }
        best
    }

    /// Drops effects that the others have made superfluous.
    fn eliminate(&self, mut best: Fit) -> Fit {
        while best.model.effects.len() > self.given {
            let lesser = (self.given..best.model.effects.len())
                .map(|k| self.without(&best, k))
                .min_by(|a, b| a.bic().total_cmp(&b.bic()));
            match lesser {
                Some(lesser) if !self.worth(&lesser, &best) => best = lesser,
                _ => break,
            }
        }
        best
    }

    /// The fit without effect k.
    fn without(&self, fit: &Fit, k: usize) -> Fit {
        let model = fit.model.without_effect(k);
        let without = self.problem.fit(&model, Some(&fit.path), None);
        // One start may lead to a lesser answer than another.
        if model.effects.len() == self.given && self.before.cost < without.cost { self.before.clone() } else { without }
    }

    /// Whether a fit with one effect more is worth it: by Schwarz's criterion beyond what chance gives the best of the library,
    /// by its share of the gap, on sweeps left out, and on sweeps drawn anew.
    fn worth(&self, lesser: &Fit, fit: &Fit) -> bool {
        let data = self.problem.data;
        let excess = (self.before.cost - data.numbers() as f64).max(0.0);
        if lesser.bic() - fit.bic() < self.chance.least_gain || lesser.cost - fit.cost < LEAST_SHARE * excess {
            return false;
        }
        let both = [Left::of(data, fit), Left::of(data, lesser)];
        let wins = resampled_wins(data, &both)[0] as f64;
        both[0].unseen(data) < both[1].unseen(data) && wins >= LEAST_INCLUSION * RESAMPLINGS as f64
    }

    /// The evidence for effect k of the answer.
    fn describe(&self, after: &Fit, k: usize) -> Named {
        let data = self.problem.data;
        let physics = after.model.effects[k].physics;
        let without = self.without(after, k);
        let mut rivals: Vec<Fit> = Vec::new();
        let mut tried = one_more(self.problem, &without, 2 * FOLLOWED, f64::NEG_INFINITY);
        tried.sort_by(|a, b| a.bic().total_cmp(&b.bic()));
        for fit in tried {
            let name = added(&fit).name;
            if name != physics.name && rivals.iter().all(|rival| added(rival).name != name) {
                rivals.push(fit);
            }
        }
        let all: Vec<Left> = [after, &without].into_iter().chain(&rivals).map(|fit| Left::of(data, fit)).collect();
        let wins = resampled_wins(data, &all);
        let (lost, kept) = (all[1].unseen(data), all[0].unseen(data));
        let open = |(k, fit): &(usize, &Fit)| fit.bic() - after.bic() < NOT_RULED_OUT || wins[k + 2] > RESAMPLINGS / 20;
        Named {
            physics,
            bic_gain: without.bic() - after.bic(),
            held_out_gain: if lost > 0.0 { 1.0 - kept / lost } else { 0.0 },
            inclusion: wins[0] as f64 / RESAMPLINGS as f64,
            indistinguishable_from: rivals.iter().enumerate().filter(open).map(|(_, fit)| added(fit).name).collect(),
            rivals: rivals.iter().map(|fit| (added(fit).name, fit.bic() - after.bic())).collect(),
        }
    }
}

/// The best fit with one effect more, of this name.
pub(super) fn with_effect(problem: &Problem, fit: &Fit, physics: &'static Physics) -> Fit {
    let fits = starts(problem, fit)
        .into_iter()
        .filter(|(other, _)| other.name == physics.name)
        .map(|(_, model)| problem.fit(&model, Some(&fit.path), None));
    fits.min_by(|a, b| a.bic().total_cmp(&b.bic())).unwrap_or_else(|| fit.clone())
}

/// The effect that a fit was given last.
fn added(fit: &Fit) -> &'static Physics {
    fit.model.effects.last().map_or(LIBRARY[0], |effect| effect.physics)
}

/// The fits with one effect more that promise most, each followed to its end. Those that promise less than `least` in Schwarz's
/// criterion are left out.
fn one_more(problem: &Problem, fit: &Fit, followed: usize, least: f64) -> Vec<Fit> {
    let price = (problem.data.numbers() as f64).ln();
    let squares: f64 = fit.residuals.iter().map(|r| r.norm_squared()).sum();
    let mut starts: Vec<(f64, &Physics, Model)> = starts(problem, fit)
        .into_par_iter()
        .map(|(physics, model)| {
            let (_, left) = problem.prospect(&model, &fit.path);
            (squares - left - (physics.parameters)(problem.data.backbones()).len() as f64 * price, physics, model)
        })
        .filter(|(gain, _, _)| *gain > least)
        .collect();
    starts.sort_by(|a, b| b.0.total_cmp(&a.0));
    // Two starts of a form at most.
    let mut chosen: Vec<(&Physics, Model)> = Vec::new();
    for (_, physics, model) in starts {
        if chosen.len() < followed && chosen.iter().filter(|(other, _)| *other == physics).count() < 2 {
            chosen.push((physics, model));
        }
    }
    chosen.into_par_iter().map(|(_, model)| problem.fit(&model, Some(&fit.path), None)).collect()
}

/// Every effect whose name the model does not have, at each of its starts.
pub fn starts(problem: &Problem, fit: &Fit) -> Vec<(&'static Physics, Model)> {
    let new = LIBRARY.into_iter().filter(|physics| fit.model.effects.iter().all(|e| e.physics.name != physics.name));
    let screws = if new.clone().any(|physics| matches!(physics.starts, Starts::Periodogram(_))) {
        screw_starts(problem, fit)
    } else {
        Vec::new()
    };
    new.flat_map(|physics| {
        let starts: Vec<Vec<f64>> = match physics.starts {
            Starts::Periodogram(phases) => {
                screws.iter().filter(|(own, _)| *own == phases).map(|(_, start)| start.clone()).collect()
            }
            Starts::At(_) | Starts::Nowhere => physics.given_starts(problem.data.backbones()).collect(),
        };
        starts.into_iter().map(move |values| {
            let mut model = fit.model.clone();
            model.effects.push(Effect::of(physics, values));
            (physics, model)
        })
    })
    .collect()
}

/// Whether two models have effects of the same names.
fn same_effects(a: &Model, b: &Model) -> bool {
    a.effects.len() == b.effects.len()
        && a.effects.iter().all(|effect| b.effects.iter().any(|other| other.physics.name == effect.physics.name))
}

/// The frequencies of a screw's error that are tried, 1/mm.
pub fn screw_frequencies(data: &Data) -> Vec<f64> {
    let (least, most) =
        data.q_mm.iter().flat_map(|q| q.iter()).fold((f64::MAX, f64::MIN), |(a, b), &q| (a.min(q), b.max(q)));
    let step = 0.35 / (most - least).max(0.5);
    std::iter::successors(Some(0.2), |frequency| Some(frequency + step)).take_while(|f| *f < 4.0).collect()
}

/// What waves of q̃ of one frequency do to the residuals: sine and cosine of each backbone.
pub fn screw_waves(problem: &Problem, frequency: f64) -> DMatrix<f64> {
    let n = problem.data.backbones();
    let mut waves = DMatrix::zeros(problem.data.numbers(), 2 * n);
    for (k, q) in problem.data.q_mm.iter().enumerate() {
        for i in 0..n {
            let (sin, cos) = (TAU * frequency * q[i]).sin_cos();
            for (c, unit) in problem.response(k, &PerBackbone::ith(n, i)).iter().enumerate() {
                waves[(n * k + c, 2 * i)] = unit * sin;
                waves[(n * k + c, 2 * i + 1)] = unit * cos;
            }
        }
    }
    waves
}

/// The same waves in all backbones: one sine and one cosine.
pub fn common_waves(waves: &DMatrix<f64>) -> DMatrix<f64> {
    DMatrix::from_fn(waves.nrows(), 2, |row, c| waves.row(row).iter().skip(c).step_by(2).sum())
}

/// Where to look for a screw's pitch: the best of a periodogram of the residuals over q̃, with η, λ and the other
/// parameters free; two starts with one phase, two with one for each backbone.
fn screw_starts(problem: &Problem, fit: &Fit) -> Vec<(Phases, Vec<f64>)> {
    let residual = super::fit::stacked(&fit.residuals);
    let p = fit.jacobian.ncols();
    let own = fit.jacobian.transpose() * &fit.jacobian;
    let own_right = fit.jacobian.transpose() * &residual;
    let solve = |waves: &DMatrix<f64>| -> Option<(f64, DVector<f64>)> {
        let m = waves.ncols();
        let mut information = DMatrix::zeros(p + m, p + m);
        information.view_mut((0, 0), (p, p)).copy_from(&own);
        let cross = waves.transpose() * &fit.jacobian;
        information.view_mut((p, 0), (m, p)).copy_from(&cross);
        information.view_mut((0, p), (p, m)).copy_from(&cross.transpose());
        information.view_mut((p, p), (m, m)).copy_from(&(waves.transpose() * waves));
        let mut right = DVector::zeros(p + m);
        right.rows_mut(0, p).copy_from(&own_right);
        right.rows_mut(p, m).copy_from(&(waves.transpose() * &residual));
        for j in 0..p + m {
            information[(j, j)] *= 1.0 + 1e-9;
        }
        let solution = information.cholesky()?.solve(&right);
        Some((right.dot(&solution), -solution.rows(p, m).into_owned()))
    };
    let mut powers: [Vec<(f64, Vec<f64>)>; 2] = Default::default();
    for frequency in screw_frequencies(problem.data) {
        let waves = screw_waves(problem, frequency);
        let common = common_waves(&waves);
        for (powers, waves) in powers.iter_mut().zip([&common, &waves]) {
            let phases = waves.ncols() / 2;
            let Some((power, solution)) = solve(waves) else { continue };
            let parts = (0..phases).map(|i| (solution[2 * i], solution[2 * i + 1]));
            let amplitude = parts.clone().map(|(a, b)| a.hypot(b)).sum::<f64>() / phases as f64;
            let angles = parts.map(|(a, b)| b.atan2(a).to_degrees());
            let start = [amplitude.min(0.4), 1.0 / frequency].into_iter().chain(angles).collect();
            powers.push((power, start));
        }
    }
    [Phases::Common, Phases::PerBackbone]
        .into_iter()
        .zip(powers)
        .flat_map(|(phases, mut powers)| {
            powers.sort_by(|a, b| b.0.total_cmp(&a.0));
            powers.into_iter().take(2).map(move |(_, start)| (phases, start))
        })
        .collect()
}

/// The residuals of each sample under a fit that it had no part in, and their robust squares.
pub fn held_out(problem: &Problem, fit: &Fit) -> (Vec<Fit>, f64) {
    let fits: Vec<Fit> =
        (0..FOLDS).into_par_iter().map(|fold| problem.fit(&fit.model, Some(&fit.path), Some(fold))).collect();
    let total = (0..problem.data.len()).map(|k| fits[problem.data.fold(k)].loss(k)).sum();
    (fits, total)
}

/// A fit near its answer, sweep by sweep: what it costs there and how its parameters pull. With it, fits to other selections
/// of sweeps are one linear step away.
struct Left {
    cost: Vec<f64>,
    information: Vec<DMatrix<f64>>,
    gradient: Vec<DVector<f64>>,
}

impl Left {
    fn of(data: &Data, fit: &Fit) -> Self {
        let sweeps = data.sweeps.last().map_or(1, |last| last + 1);
        let mut left = Self { cost: vec![0.0; sweeps], information: Vec::new(), gradient: Vec::new() };
        for k in 0..data.len() {
            left.cost[data.sweeps[k]] += fit.loss(k);
        }
        let mut first = 0;
        for sweep in 0..sweeps {
            let count = data.sweeps[first..].iter().take_while(|s| **s == sweep).count();
            let n = data.backbones();
            let rows = fit.jacobian.rows(n * first, n * count).into_owned();
            let (information, gradient) = normal_equations(&rows, &fit.residuals[first..first + count], |_| 1.0);
            left.information.push(information);
            left.gradient.push(gradient);
            first += count;
        }
        left
    }

    /// The step of the parameters for sweeps that count so often.
    fn step(&self, counts: &[f64]) -> DVector<f64> {
        let p = self.gradient[0].len();
        let mut information = DMatrix::identity(p, p) * 1e-9;
        let mut gradient = DVector::zeros(p);
        for ((own, right), &count) in self.information.iter().zip(&self.gradient).zip(counts) {
            information += own * count;
            gradient.axpy(-count, right, 1.0);
        }
        for j in 0..p {
            // A direction that these sweeps do not see stays where it is.
            let own: f64 = self.information.iter().map(|own| own[(j, j)]).sum();
            information[(j, j)] += 1e-6 * own;
        }
        information.cholesky().map_or(DVector::zeros(p), |factor| factor.solve(&gradient))
    }

    /// What a sweep costs after a step.
    fn cost(&self, sweep: usize, step: &DVector<f64>) -> f64 {
        self.cost[sweep] + 2.0 * self.gradient[sweep].dot(step) + step.dot(&(&self.information[sweep] * step))
    }

    /// The robust squares of sweeps left out, each fold under a fit to the others.
    fn unseen(&self, data: &Data) -> f64 {
        let sweeps = self.cost.len();
        let fold = |sweep: usize| sweep % FOLDS;
        debug_assert!(data.sweeps.last().is_none_or(|last| last + 1 == sweeps));
        (0..FOLDS)
            .map(|out| {
                let counts: Vec<f64> = (0..sweeps).map(|sweep| f64::from(u8::from(fold(sweep) != out))).collect();
                let step = self.step(&counts);
                (0..sweeps).filter(|&sweep| fold(sweep) == out).map(|sweep| self.cost(sweep, &step)).sum::<f64>()
            })
            .sum()
    }
}

/// How often each of several fits is the best by Schwarz's criterion when whole sweeps are drawn anew and all are fitted to
/// them, to first order.
fn resampled_wins(data: &Data, fits: &[Left]) -> Vec<usize> {
    let sweeps = fits[0].cost.len();
    let price = (data.numbers() as f64).ln();
    let mut wins = vec![0; fits.len()];
    let mut random = StdRng::seed_from_u64(1);
    for _ in 0..RESAMPLINGS {
        let mut counts = vec![0.0; sweeps];
        for _ in 0..sweeps {
            counts[random.random_range(0..sweeps)] += 1.0;
        }
        let costs = fits.iter().map(|fit| {
            let step = fit.step(&counts);
            let cost: f64 = (0..sweeps).map(|sweep| counts[sweep] * fit.cost(sweep, &step)).sum();
            cost + fit.gradient[0].len() as f64 * price
        });
        if let Some((best, _)) = costs.enumerate().min_by(|a, b| a.1.total_cmp(&b.1)) {
            wins[best] += 1;
        }
    }
    wins
}
