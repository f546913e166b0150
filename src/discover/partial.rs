//! A partial answer: effects that help, where what is left is more than noise.
//!
//! A real machine never lies wholly in a library. Structures are then compared by their held-out
//! [predictive density](super::predictive_density), in which what they miss is a correlated discrepancy, and by what physics expects beforehand
//! ([`Physics::log_prior`]): their score is the sum of both logarithms. The search begins with what no model of a machine knows
//! exactly, a gain and a bend at rest, adds the effect that raises the score most as long as one is asked for, and drops what is not
//! asked for beside the rest. An effect is asked for where the structure with it is probably better, over a bootstrap of the stretches.
//! Every structure whose score counts is a converged fit.

use super::data::Data;
use super::fit::{Fit, normal_equations, prior_precision};
use super::hypotheses::{Hypothesis, is_periodic};
use super::noise::Noise;
use super::predictive_density::Judged;
use super::residuals::Problem;
use super::search::Named;
use super::start::unknown_start;
use super::structure_weights::{Weighed, weights};
use crate::discover::comparison::Evidence;
use crate::robot::effects::{COMMAND_GAIN, Effect, ParameterSpec, REST_BEND, Role, physics};
use crate::robot::{Model, Physics};
use crate::statistics::moments::rms;
use nalgebra::{DMatrix, Vector2};
use rayon::prelude::*;

/// The most effects of a partial answer.
///
/// Convention: a bound on computing time.
const MOST_EFFECTS: usize = 8;

/// Hypotheses of each step that are fitted to convergence.
///
/// Convention: a bound on computing time.
const FITTED: usize = 8;

/// Fits of one form from different starts among them.
///
/// Convention: a bound on computing time.
const FITTED_PER_FORM: usize = 2;

/// Widths of plays that are tried, in halves of the range of the commands.
///
/// Convention: from the least that matters to nearly all, each about 1.4 times the one before, so that a fit finds its way between two.
const WIDTHS: [f64; 10] = [0.03, 0.05, 0.08, 0.12, 0.18, 0.26, 0.37, 0.5, 0.65, 0.85];

/// Travels over which a friction turns round that are tried, in the same unit.
///
/// Convention: each twice to three times the one before; the exponential of the loop changes that slowly.
const TRAVELS: [f64; 5] = [0.04, 0.1, 0.25, 0.6, 1.5];

/// A gap of frictions of which the travel is tried, in the same unit. The fit is linear in it.
///
/// Convention: any.
const GAP: f64 = 0.2;

/// A hysteresis takes the place of another where its score is higher by this.
///
/// Convention: above what the tolerance of a fit moves it by; odds of 1.1 to 1.
const LEAST_GAIN: f64 = 0.1;

/// An effect stands where the structure with it is better than the one without with this probability; one that physics expects stands where
/// that is likelier than not.
///
/// Source: that a difference exceeds one of its standard errors; the rule of one standard error of Breiman et al. 1984, Classification and
/// Regression Trees, 3.4.3.
const CLEARLY: f64 = 0.84;

/// What no model of a machine knows exactly.
const FRAME: [&str; 2] = [REST_BEND, COMMAND_GAIN];

/// A fit whose own next step promises this share of its cost has not converged.
///
/// Convention: less changes no comparison.
const PROMISES: f64 = 0.1;

/// An effect of which no size is above this share of a typical one is not there.
///
/// Convention: numerical; a typical size is about 0.05 mm of effect.
const LEAST_SIZE: f64 = 0.001;

/// How often a fit that has not converged goes on from where it ended.
///
/// Convention: an iteration cap.
const RESTARTS: usize = 2;

/// Effects are only looked for where the model as given misses this share of the bends (rms). Where it is nearer, what the library
/// lacks is imitated by effects that are not there: on sealed experiments 9000 and 9001 with a slip or a pull, in four of six.
///
/// Convention: 0.06 is 1° of 16°.
const LEAST_GAP: f64 = 0.06;

/// An answer takes at least this share of the gap beyond noise away. What takes less is the trace of something else.
///
/// Convention: a ninth less of the rms. Three tenths answer the same of what is in no library.
const LEAST_REMOVED: f64 = 0.2;

/// A hysteresis in whose place another has this probability does not stand alone.
///
/// Convention: the usual level of 5 %.
const OPEN: f64 = 0.05;

/// A partial answer.
#[derive(Debug, Clone)]
pub struct Partial<'a> {
    /// The samples, whitened by noise and discrepancy.
    pub problem: Problem<'a>,
    /// The model as given, with η and λ at their best.
    pub before: Fit,
    /// The model with the effects.
    pub after: Fit,
    /// The effects, in the order of the model's.
    pub named: Vec<Named>,
}

/// A converged fit with its score.
#[derive(Debug, Clone)]
struct Structure {
    fit: Fit,
    weighed: Weighed,
    /// The squares that the refits without each stretch leave in it, rad².
    squares: f64,
}

impl Structure {
    fn score(&self) -> f64 {
        self.weighed.score()
    }

    /// Whether what it has beyond another is asked for.
    fn is_better_than(&self, other: &Self) -> bool {
        self.preference(other) > self.asked_beside(other)
    }

    /// The probability that is asked of what it has beyond another.
    fn asked_beside(&self, other: &Self) -> f64 {
        if self.weighed.log_prior > other.weighed.log_prior { 0.5 } else { CLEARLY }
    }

    /// The probability that it is better, of the two.
    fn preference(&self, other: &Self) -> f64 {
        weights(&[self.weighed.clone(), other.weighed.clone()])[0]
    }
}

impl<'a> Partial<'a> {
    /// Of the samples under their noise; the search starts from the better of the two fits of the model as given.
    pub fn new(problem: &Problem<'a>, [one, other]: [&Fit; 2]) -> Self {
        let one_is_better = bend_squares(problem, one) < bend_squares(problem, other);
        let mut problem = problem.clone();
        let mut before = if one_is_better { one.clone() } else { other.clone() };
        let unknown_start = unknown_start(&problem, &before);
        // The weights follow from the discrepancy, and the discrepancy from the fit.
        for _ in 0..2 {
            let noise = Noise { unknown_start, ..problem.noise }.with_discrepancy(&problem, &before);
            problem = Problem::new(problem.data, &noise, &before.model);
            let [one, other] = [one, other].map(|fit| problem.fit(&fit.model, None, None));
            before = if one.cost < other.cost { one } else { other };
        }
        let answer = Self { problem, after: before.clone(), before, named: Vec::new() };
        if answer.is_near_or_still() { answer } else { Search::new(&answer).answer(answer) }
    }

    /// Whether there is no gap to speak of, or a picture that stands still, which tells nothing of a snake that should have moved.
    fn is_near_or_still(&self) -> bool {
        let known = self.problem.data.measured.iter().skip(self.problem.noise.unknown_start);
        let bends: Vec<Vector2<f64>> = known.map(|m| m.configuration.bend_vector()).collect();
        let gap = (bend_squares(&self.problem, &self.before) / bends.len() as f64).sqrt();
        let middle = bends.iter().sum::<Vector2<f64>>() / bends.len().max(1) as f64;
        gap < LEAST_GAP * rms(bends.iter().map(|bend| bend.norm()))
            || rms(bends.iter().map(|bend| (bend - middle).norm())) < gap
    }

    /// The same answer fitted to all samples, of which its own were a part.
    pub fn of<'b>(&self, data: &'b Data) -> Partial<'b> {
        let stride = data.len().div_ceil(self.problem.data.len());
        let noise = Noise { unknown_start: self.problem.noise.unknown_start * stride, ..self.problem.noise };
        let problem = Problem::new(data, &noise, &self.before.model);
        let [before, after] = [&self.before, &self.after].map(|fit| problem.fit(&fit.model, None, None));
        Partial { problem, before, after, named: self.named.clone() }
    }

    /// The model of one of its fits, with a covariance that contains the discrepancy as it hangs together within sweeps.
    pub fn model(&self, fit: &Fit) -> Model {
        let left = self.problem.noise.with_discrepancy(&self.problem, fit);
        let problem = Problem::new(self.problem.data, &left, &fit.model);
        problem.with_clustered_covariance(&problem.fit(&fit.model, Some(&fit.path), None))
    }
}

/// A search for the structure of the highest score.
struct Search<'a> {
    problem: Problem<'a>,
    judged: Judged,
    before: Fit,
    /// Every structure that was fitted to convergence.
    scored: Vec<Weighed>,
}

impl<'a> Search<'a> {
    fn new(answer: &Partial<'a>) -> Self {
        let judged = Judged::new(&answer.problem, &answer.before);
        Self { problem: answer.problem.clone(), judged, before: answer.before.clone(), scored: Vec::new() }
    }

    /// The answer that the search comes to from one without effects.
    fn answer(mut self, nothing: Partial<'a>) -> Partial<'a> {
        let Some(density) = self.judged.of_fit(&self.problem, &self.before) else { return nothing };
        let weighed = Weighed { effects: Vec::new(), stretches: density.stretches, log_prior: 0.0 };
        self.scored.push(weighed.clone());
        let bare = Structure { fit: self.before.clone(), weighed, squares: density.squares };
        let mut best = self.with_frame().unwrap_or_else(|| bare.clone());
        while best.fit.model.effects.len() < self.given() + MOST_EFFECTS {
            let Some(better) = self.best_with_one_more(&best, |_| true).filter(|more| more.is_better_than(&best))
            else {
                break;
            };
            best = self.under_its_own_discrepancy(better);
        }
        best = self.settled(best);
        // Anew, since the noise that both were whitened by is not the same.
        let anew = |fit: &Fit| self.problem.evaluated(&fit.model, Some(&fit.path));
        let [before, after] = [&bare, &best].map(|structure| bend_squares(&self.problem, &anew(&structure.fit)));
        let noise = 2.0 * self.problem.data.len() as f64 * self.problem.bend_noise_rad2();
        if !best.is_better_than(&bare) || before - after < LEAST_REMOVED * (before - noise) {
            return nothing;
        }
        let named = (self.given()..best.fit.model.effects.len()).map(|k| self.describe(&best, &bare, k)).collect();
        let before = self.problem.fit(&self.before.model, Some(&self.before.path), None);
        Partial { problem: self.problem, before, after: best.fit, named }
    }

    /// With an unknown gain and an unknown bend at rest.
    fn with_frame(&mut self) -> Option<Structure> {
        let mut model = self.before.model.clone();
        for physics in FRAME.into_iter().filter_map(physics) {
            if !has(&model, physics.name) {
                model
                    .effects
                    .push(Effect::of(physics, vec![0.0; physics.parameters_on(self.problem.data.backbones()).len()]));
            }
        }
        let fit = self.problem.fit(&model, Some(&self.before.path), None);
        let structure = self.structure(fit)?;
        Some(self.under_its_own_discrepancy(structure))
    }

    /// What is not asked for beside the rest dropped, and another hysteresis put in the place of one where that is better.
    fn settled(&mut self, mut best: Structure) -> Structure {
        for _ in 0..2 * MOST_EFFECTS {
            let simpler = (self.given()..best.fit.model.effects.len()).map(|k| best.fit.model.without_effect(k));
            let simpler = simpler.map(|model| (model, best.fit.path.clone())).collect();
            let others = self.structures(simpler);
            let excess = |simpler: &Structure| best.preference(simpler) - best.asked_beside(simpler);
            let least_missed = others.iter().min_by(|a, b| excess(a).total_cmp(&excess(b)));
            if let Some(simpler) = least_missed.filter(|simpler| excess(simpler) <= 0.0) {
                best = self.under_its_own_discrepancy(simpler.clone());
                continue;
            }
            let has_hysteresis = |of: &Structure| of.fit.model.effects.iter().any(|e| e.physics.is_hysteresis());
            let without = others.into_iter().find(|other| has_hysteresis(&best) && !has_hysteresis(other));
            let other = without.and_then(|without| self.best_with_one_more(&without, Physics::is_hysteresis));
            match other.filter(|other| other.score() > best.score() + LEAST_GAIN) {
                Some(other) => best = self.under_its_own_discrepancy(other),
                None => break,
            }
        }
        best
    }

    /// The best of the structures with one effect more, of those that a linear step about its start scores highest.
    fn best_with_one_more(&mut self, best: &Structure, admits: fn(&Physics) -> bool) -> Option<Structure> {
        let promised = self.hypotheses(&best.fit.model, admits).into_par_iter().filter_map(|hypothesis| {
            let score = self.promised(&best.fit, &hypothesis)? + log_prior(&hypothesis.start, self.given());
            Some((score, hypothesis))
        });
        let mut promised: Vec<(f64, Hypothesis)> = promised.collect();
        promised.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut chosen: Vec<Hypothesis> = Vec::new();
        for (_, hypothesis) in promised {
            let of_its_form = chosen.iter().filter(|other| other.physics == hypothesis.physics).count();
            if chosen.len() < FITTED && of_its_form < FITTED_PER_FORM {
                chosen.push(hypothesis);
            }
        }
        let starts = chosen.into_iter().map(|hypothesis| (hypothesis.start, best.fit.path.clone())).collect();
        self.structures(starts).into_iter().max_by(|a, b| a.score().total_cmp(&b.score()))
    }

    /// Every effect that the model lacks and that `admits`, at each of its starts. A model has one hysteresis at most: two of them describe one loop.
    fn hypotheses(&self, model: &Model, admits: fn(&Physics) -> bool) -> Vec<Hypothesis> {
        let hysteresis = model.effects.iter().any(|effect| effect.physics.is_hysteresis());
        let data = self.problem.data;
        let lacking = data.library.iter().filter(|physics| {
            admits(physics)
                && !has(model, physics.name)
                && is_believable(physics)
                && !(hysteresis && physics.is_hysteresis())
        });
        let each = lacking.flat_map(|physics| {
            let starts = self.starts(physics).into_iter();
            starts.map(|values| Hypothesis::new(model, physics, values))
        });
        each.collect()
    }

    /// Where the fits of an effect start: of what has a width or a travel, over the range of the commands.
    fn starts(&self, physics: &Physics) -> Vec<Vec<f64>> {
        let n = self.problem.data.backbones();
        let half_mm = self.judged.half_range * self.before.model.robot.backbone_circle_radius_mm;
        let given: Vec<Vec<f64>> = physics.given_starts(n).collect();
        let specs = physics.parameters_on(n);
        let with = |first: f64, second: Option<f64>| {
            let mut values = given[0].clone();
            values[0] = first;
            if let (Some(value), Some(second)) = (values.get_mut(1), second) {
                *value = second;
            }
            values.iter().zip(specs).map(|(value, spec)| value.clamp(spec.range.0, spec.range.1)).collect()
        };
        let is_width = specs[0].name == "half_gap_mm" && given.iter().any(|start| start[0] > 0.0);
        match specs.get(1) {
            Some(travel) if is_width && travel.unit == "mm" => {
                TRAVELS.iter().map(|share| with(GAP * half_mm, Some(share * half_mm))).collect()
            }
            _ if is_width => WIDTHS.iter().map(|share| with(share * half_mm, None)).collect(),
            _ => given,
        }
    }

    /// The score that a linear step about the start of a hypothesis promises, but for its prior.
    fn promised(&self, fit: &Fit, hypothesis: &Hypothesis) -> Option<f64> {
        let (problem, own) = (&self.problem, fit.parameter_count()..hypothesis.start.parameter_count());
        let prediction = problem.predict(&hypothesis.start, Some(&fit.path));
        let jacobian = if hypothesis.physics.is_hysteresis() {
            problem.jacobian(&hypothesis.start, &prediction, 0..own.end)
        } else {
            let columns = problem.jacobian(&hypothesis.start, &prediction, own);
            let mut all = DMatrix::zeros(columns.nrows(), fit.parameter_count() + columns.ncols());
            all.columns_mut(0, fit.parameter_count()).copy_from(&fit.jacobian);
            all.columns_mut(fit.parameter_count(), columns.ncols()).copy_from(&columns);
            all
        };
        Some(
            self.judged
                .density(problem, &prediction.residuals, &jacobian, &prior_precision(&hypothesis.start))?
                .total(),
        )
    }

    /// The structures of models, each fitted from its values and from a path near its own; those whose fits do not converge are left out.
    fn structures(&mut self, starts: Vec<(Model, Vec<Vector2<f64>>)>) -> Vec<Structure> {
        let fits: Vec<Fit> =
            starts.into_par_iter().map(|(model, path)| self.problem.fit(&model, Some(&path), None)).collect();
        fits.into_iter().filter_map(|fit| self.structure(fit)).collect()
    }

    /// The structure of a fit, gone on with until it has converged; none where it does not.
    fn structure(&mut self, mut fit: Fit) -> Option<Structure> {
        for _ in 0..RESTARTS {
            if promises(&fit) < PROMISES {
                break;
            }
            fit = self.problem.fit(&fit.model, Some(&fit.path), None);
        }
        let is_scored = promises(&fit) < PROMISES && self.is_inside(&fit.model);
        let density = self.judged.of_fit(&self.problem, &fit).filter(|_| is_scored)?;
        let log_prior = log_prior(&fit.model, self.given());
        let names = fit.model.effects.iter().skip(self.given()).map(|effect| effect.physics).collect();
        let weighed = Weighed { effects: names, stretches: density.stretches, log_prior };
        self.scored.push(weighed.clone());
        Some(Structure { fit, weighed, squares: density.squares })
    }

    /// Whether every effect beyond those that were given is there, and no parameter of one lies at the end of its range, where it is not what the
    /// effect means.
    fn is_inside(&self, model: &Model) -> bool {
        model.effects.iter().skip(self.given()).all(|effect| {
            let values = || effect.parameters().iter().zip(&effect.values);
            let is_there = |(spec, value): (&ParameterSpec, &f64)| {
                matches!(spec.role, Role::Size { .. }) && value.abs() > LEAST_SIZE * spec.typical
            };
            values().any(is_there) && values().all(|(spec, &value)| value > spec.range.0 && value < spec.range.1)
        })
    }

    /// A structure fitted anew where its own discrepancy, which is smaller than that of the structure before, belongs to the noise.
    fn under_its_own_discrepancy(&mut self, structure: Structure) -> Structure {
        let noise = self.problem.noise.with_discrepancy(&self.problem, &structure.fit);
        self.problem = Problem::new(self.problem.data, &noise, &structure.fit.model);
        let fit = self.problem.fit(&structure.fit.model, Some(&structure.fit.path), None);
        self.structure(fit).unwrap_or(structure)
    }

    /// The evidence for effect k of the answer, and what it removes beside the others.
    fn describe(&mut self, best: &Structure, bare: &Structure, k: usize) -> Named {
        let physics = best.fit.model.effects[k].physics;
        let simpler = self.problem.fit(&best.fit.model.without_effect(k), Some(&best.fit.path), None);
        let simpler = self.structure(simpler).unwrap_or_else(|| bare.clone());
        let excess = bare.squares - self.judged.noise_squares(&self.problem);
        let removed = simpler.squares - best.squares;
        let weights = weights(&self.scored);
        let probability = |holds: &dyn Fn(&Weighed) -> bool| {
            self.scored.iter().zip(&weights).filter(|(own, _)| holds(own)).map(|(_, weight)| weight).sum::<f64>()
        };
        let mut alike: Vec<&'static str> = Vec::new();
        let mut alternatives: Vec<(&'static str, f64)> = Vec::new();
        for other in self.scored.iter().filter(|other| !other.has(physics.name)).flat_map(|other| &other.effects) {
            let is_new = !has(&best.fit.model, other.name) && alternatives.iter().all(|(name, _)| *name != other.name);
            if !is_new {
                continue;
            }
            let own = self.scored.iter().filter(|own| own.has(other.name) && !own.has(physics.name));
            let score = own.map(Weighed::score).fold(f64::NEG_INFINITY, f64::max);
            alternatives.push((other.name, 2.0 * (best.score() - score)));
            let in_its_place = |own: &Weighed| own.has(other.name) && !own.has(physics.name);
            if physics.is_hysteresis() && other.is_hysteresis() && probability(&in_its_place) > OPEN {
                alike.push(other.name);
            }
        }
        alternatives.sort_by(|a, b| a.1.total_cmp(&b.1));
        let inclusion = probability(&|own| own.has(physics.name) || alike.iter().any(|name| own.has(name)));
        Named {
            physics,
            evidence: Evidence {
                bic_gain: 2.0 * (best.score() - simpler.score()),
                excess_share: removed / excess,
                held_out_gain: removed / simpler.squares,
                inclusion,
            },
            removes: (removed / excess).clamp(0.0, 1.0),
            indistinguishable_from: alike,
            alternatives,
        }
    }

    fn given(&self) -> usize {
        self.before.model.effects.len()
    }
}

/// Periodic effects and those of time are not looked for: a wave with a pitch of its own fits any smooth gap over a few of its periods,
/// and a drift or a creep any change from one run to the next.
fn is_believable(physics: &Physics) -> bool {
    !physics.in_time && !is_periodic(physics)
}

/// The logarithm of what physics expects beforehand of a model's effects beyond those that were given.
fn log_prior(model: &Model, given: usize) -> f64 {
    model.effects.iter().skip(given).map(|effect| effect.physics.log_prior - 0.5 * effect.physics.prior_penalty).sum()
}

/// Whether a model has an effect of this name.
fn has(model: &Model, name: &str) -> bool {
    model.effects.iter().any(|effect| effect.physics.name == name)
}

/// The share of its cost that a fit's own next step promises to take away; of parameters at the end of their range none goes on.
fn promises(fit: &Fit) -> f64 {
    let (information, gradient) = normal_equations(&fit.jacobian, &fit.residuals);
    let specs = fit.model.parameter_specs();
    let inside: Vec<usize> = (0..specs.len())
        .filter(|&j| {
            let (value, (least, most)) = (fit.model.parameter_values()[j], specs[j].range);
            let slack = 1e-6 * specs[j].typical;
            value > least + slack && value < most - slack
        })
        .collect();
    let information = information.select_rows(&inside).select_columns(&inside);
    let gradient = gradient.select_rows(&inside);
    let precision = DMatrix::from_diagonal(&prior_precision(&fit.model).select_rows(&inside));
    let promised = (information + precision).cholesky().map_or(0.0, |factor| gradient.dot(&factor.solve(&gradient)));
    promised / fit.cost.max(f64::MIN_POSITIVE)
}

/// What a fit leaves of the bend, rad².
fn bend_squares(problem: &Problem, fit: &Fit) -> f64 {
    let known = problem.noise.unknown_start..problem.data.len();
    known.map(|k| problem.bend_gap(&fit.residuals, k).norm_squared()).sum()
}
