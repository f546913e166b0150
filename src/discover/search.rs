//! The search for the structure (set of effects) of the highest score: the logarithm of its held-out
//! [predictive density](super::predictive_density), and what physics expects beforehand.
//!
//! It is made first beside noise alone, where every effect is as unlikely as any other: a machine that lies in the library is explained by one to three
//! of them, and what they leave is noise. Where they leave more, it is made again beside a discrepancy, where some effects are expected
//! ([`Physics::log_prior`]): no model of a machine knows its gain and its bend at rest exactly. There it begins with both.
//!
//! The search adds the effect that raises the score most as long as one is asked for, drops what is not asked for beside the rest, and puts another effect
//! in the place of one where that is better. An effect is asked for where the structure with it is probably better, over a bootstrap of the stretches.
//! Every structure whose score counts is a converged fit.

use super::fit::{Fit, normal_equations, prior_precision};
use super::hypotheses::{Hypothesis, has, hypotheses};
use super::posterior::Candidate;
use super::predictive_density::{Beside, Judged};
use super::residuals::Problem;
use super::structure::mean_square_quantile;
use super::structure_weights::{RESAMPLES, Weighed, weights};
use crate::robot::effects::{COMMAND_GAIN, Changes, Effect, ParameterSpec, REST_BEND, Role, physics};
use crate::robot::{Model, Physics};
use nalgebra::{DMatrix, Vector2};
use rayon::prelude::*;

/// The most effects beside noise, and beside a discrepancy.
///
/// Convention: a bound on computing time.
const MOST_EFFECTS: [usize; 2] = [3, 8];

/// Single effects that the search beside noise goes on from.
///
/// Convention: a bound on computing time.
const BEAM_WIDTH: usize = 3;

/// Where the best of the beam leaves squares of so many times the noise's, no exchange of effects is tried beside noise.
///
/// Convention: a bound on computing time; an rms of thirty times the noise is no effect taken for one that looks alike.
const HOPELESS: f64 = 1000.0;

/// Hypotheses of each step that are fitted to convergence.
///
/// Convention: a bound on computing time.
const FITTED: usize = 8;

/// Fits of one form from different starts among them.
///
/// Convention: a bound on computing time.
const FITTED_PER_FORM: usize = 2;

/// An effect takes the place of another where the score is higher by this.
///
/// Convention: above what the tolerance of a fit moves it by; odds of 1.1 to 1.
const LEAST_GAIN: f64 = 0.1;

/// An effect stands where the structure with it is better than the one without with this probability; one that physics expects stands where
/// that is likelier than not.
///
/// Source: that a difference exceeds one of its standard errors; the rule of one standard error of Breiman et al. 1984, Classification and
/// Regression Trees, 3.4.3.
const CLEARLY: f64 = 0.84;

/// The logarithm of the odds beforehand of each effect beside noise alone.
///
/// Convention: e⁻⁶ each for some thirty effects: a model to which nothing is lacking is likelier than all with one effect more together.
const LOG_PRIOR_BESIDE_NOISE: f64 = -6.0;

/// Beside a discrepancy an effect takes at least this share of the gap beyond noise away, on stretches that it was not fitted to.
///
/// Convention: what takes less is written as 0 %.
const LEAST_REMOVED: f64 = 0.02;

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

/// A parameter within this share of its typical size of an end of its range lies there.
///
/// Convention: numerical.
const AT_END: f64 = 1e-6;

/// How often a fit that has not converged goes on from where it ended.
///
/// Convention: an iteration cap.
const RESTARTS: usize = 2;

/// What has a smaller share of the probability of another is ruled out beside it.
///
/// Convention: the usual level of 5 %.
const OPEN: f64 = 0.05;

/// What speaks for an effect.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Evidence {
    /// Twice how much lower the score of the structure without it is, on the scale of an information criterion.
    pub bic_gain: f64,
    /// The share of the held-out squares that it removes; negative where it makes predictions worse.
    pub held_out_gain: f64,
    /// The probability of all structures with it among those that were compared.
    pub inclusion: f64,
}

/// An effect that stands in the search's answer.
#[derive(Debug, Clone)]
pub struct Named {
    /// What it is.
    pub physics: &'static Physics,
    /// What speaks for it; its inclusion is judged among all alternatives.
    pub evidence: Evidence,
    /// The share of the held-out excess over noise that it takes away.
    pub removes: f64,
    /// Effects that explain the data about as well in its place.
    pub indistinguishable_from: Vec<&'static str>,
    /// Every alternative in its place, with by how much twice its score is lower; the best first.
    pub alternatives: Vec<(&'static str, f64)>,
}

impl Named {
    /// The probability that it is there, by Laplace's rule of succession over the resamples. In a partial answer a play or friction stands for
    /// those of [`indistinguishable_from`](Self::indistinguishable_from) as well, which describe the same loop.
    pub fn probability(&self) -> f64 {
        (self.evidence.inclusion * RESAMPLES as f64 + 1.0) / (RESAMPLES as f64 + 2.0)
    }
}

/// What a search comes to.
#[derive(Debug, Clone)]
pub struct Found<'a> {
    /// The samples, whitened by the noise and by what the answer leaves.
    pub problem: Problem<'a>,
    /// The model with the effects.
    pub fit: Fit,
    /// The effects, in the order of the model's.
    pub named: Vec<Named>,
    /// The structures that the data leave open, the most probable first.
    pub structures: Vec<Candidate>,
    /// The squares in held-out stretches, in units of the noise's: of the model as given, of the answer, and of noise.
    pub squares: [f64; 3],
}

/// A converged fit with its score.
#[derive(Debug, Clone)]
struct Structure {
    fit: Fit,
    weighed: Weighed,
    /// The squares that the refits without each stretch leave in it, in units of the noise's.
    squares: f64,
    /// Whether a parameter lies at the end of its range, where it is not what the effect means: such a structure is no answer, but another effect
    /// beside it may bring the parameter back.
    is_at_end: bool,
}

impl Structure {
    fn score(&self) -> f64 {
        self.weighed.score()
    }

    /// By how much the probability that it is better than another, of the two, exceeds the one that is asked of what it has beyond the other.
    fn excess_over(&self, other: &Self) -> f64 {
        let asked = if self.weighed.log_prior > other.weighed.log_prior { 0.5 } else { CLEARLY };
        weights(&[&self.weighed, &other.weighed])[0] - asked
    }
}

/// The structure of the highest score that a search from the model as given comes to; `before` is its fit.
pub fn search<'a>(problem: &Problem<'a>, before: &Fit, beside: Beside) -> Found<'a> {
    let judged = Judged::new(problem, before, beside);
    Search { problem: problem.clone(), judged, before: before.clone(), beside, gap: 0.0, scored: Vec::new() }.found()
}

struct Search<'a> {
    problem: Problem<'a>,
    judged: Judged,
    before: Fit,
    beside: Beside,
    /// The squares beyond noise in held-out stretches that the model as given leaves.
    gap: f64,
    /// Every structure that was fitted to convergence.
    scored: Vec<Structure>,
}

impl<'a> Search<'a> {
    fn found(mut self) -> Found<'a> {
        let Some(bare) = self.structure(self.before.clone()) else {
            return Found {
                problem: self.problem,
                fit: self.before,
                named: Vec::new(),
                structures: Vec::new(),
                squares: [0.0; 3],
            };
        };
        self.gap = bare.squares - self.judged.noise_squares(&self.problem);
        let mut best = match self.beside {
            Beside::Noise => self.best_of_beam(&bare),
            Beside::Discrepancy => {
                let framed = self.with_frame().unwrap_or_else(|| bare.clone());
                self.grown(framed)
            }
        };
        let is_hopeless = self.beside == Beside::Noise
            && best.squares > HOPELESS * self.judged.noise_squares(&self.problem);
        if !is_hopeless {
            best = self.settled(best);
        }
        if self.beside == Beside::Noise {
            best = self.with_what_is_likelier_than_a_lag(best);
        }
        if best.excess_over(&bare) <= 0.0 {
            best = bare.clone();
        }
        let named = (self.given()..best.fit.model.effects.len()).map(|k| self.describe(&best, &bare, k)).collect();
        let squares = [bare.squares, best.squares, self.judged.noise_squares(&self.problem)];
        Found { structures: self.open(), problem: self.problem, fit: best.fit, named, squares }
    }

    /// The best of the structures that the likeliest single effects lead to. Where one of them leaves no more than noise, the others are not gone on from: they come
    /// at best to its equal, with an effect more.
    fn best_of_beam(&mut self, bare: &Structure) -> Structure {
        let problem = self.problem.clone();
        let (mut best, mut under) = (bare.clone(), problem.clone());
        for first in self.with_one_more(bare, &bare.fit, |_| true).into_iter().take(BEAM_WIDTH) {
            self.problem = problem.clone();
            let first = self.under_its_own_discrepancy(first);
            let grown = self.grown(first);
            if grown.score() > best.score() {
                (best, under) = (grown, self.problem.clone());
            }
            if best.squares
                < self.judged.noise_squares(&under) * mean_square_quantile(self.problem.data.residual_count() as f64)
            {
                break;
            }
        }
        self.problem = under;
        best
    }

    /// A structure with what is asked for beside it.
    fn grown(&mut self, mut best: Structure) -> Structure {
        while best.fit.model.effects.len() < self.given() + MOST_EFFECTS[self.beside as usize] {
            let Some(better) = self.with_one_more(&best, &best.fit, |_| true).into_iter().next() else { break };
            best = self.under_its_own_discrepancy(better);
        }
        best
    }

    /// Whether what a structure has beyond a simpler one is asked for.
    fn asks_for(&self, structure: &Structure, simpler: &Structure) -> bool {
        let least = if self.beside == Beside::Discrepancy { LEAST_REMOVED * self.gap } else { f64::NEG_INFINITY };
        !structure.is_at_end && structure.excess_over(simpler) > 0.0 && simpler.squares - structure.squares > least
    }

    /// With an unknown gain and an unknown bend at rest.
    fn with_frame(&mut self) -> Option<Structure> {
        let mut model = self.before.model.clone();
        let backbones = self.problem.data.backbones();
        for physics in FRAME.into_iter().filter_map(physics).filter(|physics| !has(&self.before.model, physics.name)) {
            model.effects.push(Effect::of(physics, vec![0.0; physics.parameters_on(backbones).len()]));
        }
        let fit = self.problem.fit(&model, Some(&self.before.path), None);
        let structure = self.structure(fit)?;
        Some(self.under_its_own_discrepancy(structure))
    }

    /// What is not asked for beside the rest dropped, and another effect put in the place of one where that is better.
    fn settled(&mut self, mut best: Structure) -> Structure {
        for _ in 0..2 * MOST_EFFECTS[self.beside as usize] {
            let effects = self.given()..best.fit.model.effects.len();
            let simpler = effects.map(|k| (best.fit.model.without_effect(k), best.fit.path.clone())).collect();
            let others = self.structures(simpler);
            let not_asked = others.iter().filter(|simpler| !simpler.is_at_end && !self.asks_for(&best, simpler));
            if let Some(simpler) = not_asked.min_by(|a, b| best.excess_over(a).total_cmp(&best.excess_over(b))) {
                best = self.under_its_own_discrepancy(simpler.clone());
                continue;
            }
            let other = others.iter().filter_map(|without| self.exchanged(&best, without));
            let other = other.max_by(|a, b| a.score().total_cmp(&b.score()));
            match other.filter(|other| other.score() > best.score() + LEAST_GAIN) {
                Some(other) => best = self.under_its_own_discrepancy(other),
                None => match self.with_one_for_two(&best, &others) {
                    Some(other) => best = self.under_its_own_discrepancy(other),
                    None => break,
                },
            }
        }
        best
    }

    /// The best with one effect in the place of two, where these are not asked for beside it: what is nearly the right effect is put right by another.
    /// Beside noise alone; `others` lack one effect each.
    fn with_one_for_two(&mut self, best: &Structure, others: &[Structure]) -> Option<Structure> {
        let least = self.given() + 3;
        if self.beside == Beside::Discrepancy || best.fit.model.effects.len() < least {
            return None;
        }
        let mut models: Vec<Model> = Vec::new();
        for without in others {
            let effects = self.given()..without.fit.model.effects.len();
            models.extend(effects.map(|k| without.fit.model.without_effect(k)));
        }
        let name = |model: &Model| model.effects.iter().map(|effect| effect.physics.name).collect::<Vec<_>>();
        models.sort_by_key(name);
        models.dedup_by_key(|model| name(model));
        let starts = models.into_iter().map(|model| (model, best.fit.path.clone())).collect();
        let simplest = self.structures(starts);
        let with_one: Vec<Structure> =
            simplest.iter().filter_map(|simple| self.with_one_more(simple, &simple.fit, |_| true).into_iter().next()).collect();
        let one = with_one.into_iter().max_by(|a, b| a.score().total_cmp(&b.score()))?;
        (!self.asks_for(best, &one)).then_some(one)
    }

    /// The best with another effect in the place of the one that `without` lacks of `best`: with any beside noise, and beside a discrepancy with a hysteresis
    /// in the place of a hysteresis. The fits begin with the other effects as they are in `best`: without the one, they may have gone far.
    fn exchanged(&mut self, best: &Structure, without: &Structure) -> Option<Structure> {
        let has_hysteresis = |of: &Structure| of.fit.model.effects.iter().any(|e| e.physics.is_hysteresis());
        let admits: fn(&Physics) -> bool = match self.beside {
            Beside::Noise => |_| true,
            Beside::Discrepancy if has_hysteresis(best) && !has_hysteresis(without) => Physics::is_hysteresis,
            Beside::Discrepancy => return None,
        };
        let is_lacking = |&k: &usize| !without.weighed.has(best.fit.model.effects[k].physics.name);
        let lacking = (self.given()..best.fit.model.effects.len()).find(is_lacking)?;
        let from = self.problem.evaluated(&best.fit.model.without_effect(lacking), Some(&best.fit.path));
        self.with_one_more(without, &from, admits).into_iter().next()
    }

    /// Play or friction in the place of a clock's lag, where the data do not rule it out.
    fn with_what_is_likelier_than_a_lag(&mut self, best: Structure) -> Structure {
        let yields_to = |effect: &Effect| match effect.physics.changes {
            Changes::Exposure(_) => effect.physics.yields_to,
            _ => &[],
        };
        let effects = &best.fit.model.effects;
        let lag = effects.iter().skip(self.given()).find(|effect| !yields_to(effect).is_empty());
        let Some(lag) = lag else { return best };
        let is_in_its_place = |other: &&Structure| {
            other.fit.model.effects.len() == effects.len()
                && !other.weighed.has(lag.physics.name)
                && yields_to(lag).iter().any(|name| other.weighed.has(name) && !best.weighed.has(name))
                && other.score() > best.score() + OPEN.ln()
        };
        let other = self.scored.iter().filter(is_in_its_place).max_by(|a, b| a.score().total_cmp(&b.score()));
        other.cloned().unwrap_or(best)
    }

    /// The structures with one effect more that is asked for beside `best`, of those that a linear step about a start beside the model of `from` scores highest,
    /// and does not rule out beside `best`; the best first, one for each name.
    fn with_one_more(&mut self, best: &Structure, from: &Fit, admits: fn(&Physics) -> bool) -> Vec<Structure> {
        let half_mm = self.judged.half_range * self.before.model.robot.backbone_circle_radius_mm;
        let hypotheses = hypotheses(&self.problem, from, (self.beside, half_mm), admits);
        let promised = hypotheses.into_par_iter().filter_map(|hypothesis| {
            let score = self.promised(from, &hypothesis)? + self.log_prior(&hypothesis.start);
            (score > best.score() + OPEN.ln()).then_some((score, hypothesis))
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
        let starts = chosen.into_iter().map(|hypothesis| (hypothesis.start, from.path.clone())).collect();
        let mut asked = self.structures(starts);
        asked.retain(|more| self.asks_for(more, best));
        asked.sort_by(|a, b| b.score().total_cmp(&a.score()));
        let mut names: Vec<&str> = Vec::new();
        asked.retain(|more| {
            let name = more.weighed.effects.last().map_or("", |physics| physics.name);
            let is_new = !names.contains(&name);
            names.push(name);
            is_new
        });
        asked
    }

    /// The score that a linear step about the start of a hypothesis promises, but for its prior.
    fn promised(&self, fit: &Fit, hypothesis: &Hypothesis) -> Option<f64> {
        let (problem, own) = (&self.problem, fit.parameter_count()..hypothesis.start.parameter_count());
        let prediction = problem.predict(&hypothesis.start, Some(&fit.path));
        let changes_others = self.beside == Beside::Discrepancy && hypothesis.physics.is_hysteresis();
        let jacobian = if changes_others {
            problem.jacobian(&hypothesis.start, &prediction, 0..own.end)
        } else {
            let columns = problem.jacobian(&hypothesis.start, &prediction, own);
            let mut all = DMatrix::zeros(columns.nrows(), fit.parameter_count() + columns.ncols());
            all.columns_mut(0, fit.parameter_count()).copy_from(&fit.jacobian);
            all.columns_mut(fit.parameter_count(), columns.ncols()).copy_from(&columns);
            all
        };
        let precision = prior_precision(&hypothesis.start);
        Some(self.judged.density(problem, &prediction.residuals, &jacobian, &precision)?.total())
    }

    /// The structures of models, each fitted from its values and from a path near its own; those whose fits do not converge are left out.
    fn structures(&mut self, starts: Vec<(Model, Vec<Vector2<f64>>)>) -> Vec<Structure> {
        let of_start =
            |(model, path): (Model, Vec<Vector2<f64>>)| self.scored(self.problem.fit(&model, Some(&path), None));
        let structures: Vec<Structure> = starts.into_par_iter().filter_map(of_start).collect();
        self.scored.extend(structures.iter().filter(|structure| !structure.is_at_end).cloned());
        structures
    }

    /// The structure of a fit; none where it does not converge.
    fn structure(&mut self, fit: Fit) -> Option<Structure> {
        let structure = self.scored(fit).filter(|structure| !structure.is_at_end)?;
        self.scored.push(structure.clone());
        Some(structure)
    }

    /// A fit with its score, gone on with until it has converged; none where it does not.
    fn scored(&self, mut fit: Fit) -> Option<Structure> {
        for _ in 0..RESTARTS {
            if promises(&fit) < PROMISES {
                break;
            }
            fit = self.problem.fit(&fit.model, Some(&fit.path), None);
        }
        let is_scored = promises(&fit) < PROMISES && self.has_sizes(&fit.model);
        let density = self.judged.of_fit(&self.problem, &fit).filter(|_| is_scored)?;
        let effects = fit.model.effects.iter().skip(self.given()).map(|effect| effect.physics).collect();
        let weighed = Weighed { effects, stretches: density.stretches, log_prior: self.log_prior(&fit.model) };
        let is_at_end = self.is_at_end(&fit.model);
        Some(Structure { fit, weighed, squares: density.squares, is_at_end })
    }

    /// Whether every effect beyond those that were given is there.
    fn has_sizes(&self, model: &Model) -> bool {
        let is_there = |(spec, value): (&ParameterSpec, &f64)| {
            matches!(spec.role, Role::Size { .. }) && value.abs() > LEAST_SIZE * spec.typical
        };
        let has_size = |effect: &Effect| effect.parameters().iter().zip(&effect.values).any(is_there);
        model.effects.iter().skip(self.given()).all(has_size)
    }

    /// Whether a parameter of an effect beyond those that were given lies at the end of its range.
    fn is_at_end(&self, model: &Model) -> bool {
        let is_at_end = |(spec, value): (&ParameterSpec, &f64)| !is_inside(spec, *value);
        let effects = model.effects.iter().skip(self.given());
        effects.flat_map(|effect| effect.parameters().iter().zip(&effect.values)).any(is_at_end)
    }

    /// A structure fitted anew where its own discrepancy, which is smaller than that of the structure before, belongs to the noise.
    fn under_its_own_discrepancy(&mut self, structure: Structure) -> Structure {
        let noise = self.problem.noise.with_discrepancy(&self.problem, &structure.fit);
        self.problem = Problem::new(self.problem.data, &noise, &structure.fit.model);
        let fit = self.problem.fit(&structure.fit.model, Some(&structure.fit.path), None);
        self.structure(fit).unwrap_or(structure)
    }

    /// The logarithm of what is expected beforehand of a model's effects beyond those that were given.
    fn log_prior(&self, model: &Model) -> f64 {
        let of_effect = |effect: &Effect| match self.beside {
            Beside::Noise => LOG_PRIOR_BESIDE_NOISE - 0.5 * effect.physics.prior_penalty,
            Beside::Discrepancy => effect.physics.log_prior - 0.5 * effect.physics.prior_penalty,
        };
        model.effects.iter().skip(self.given()).map(of_effect).sum()
    }

    /// The evidence for effect k of the answer, and what it removes beside the others.
    fn describe(&mut self, best: &Structure, bare: &Structure, k: usize) -> Named {
        let physics = best.fit.model.effects[k].physics;
        let simpler = self.problem.fit(&best.fit.model.without_effect(k), Some(&best.fit.path), None);
        let simpler = self.structure(simpler).unwrap_or_else(|| bare.clone());
        let removed = simpler.squares - best.squares;
        let weights = weights(&self.weighed());
        let probability = |holds: &dyn Fn(&Weighed) -> bool| {
            let own = self.scored.iter().zip(&weights).filter(|(own, _)| holds(&own.weighed));
            own.map(|(_, weight)| weight).sum::<f64>()
        };
        let own = probability(&|own| own.has(physics.name));
        let mut alike: Vec<&'static str> = Vec::new();
        let mut alternatives: Vec<(&'static str, f64)> = Vec::new();
        let in_its_place = |of: &Weighed, other: &str| of.has(other) && !of.has(physics.name);
        for other in
            self.scored.iter().filter(|other| !other.weighed.has(physics.name)).flat_map(|o| &o.weighed.effects)
        {
            if has(&best.fit.model, other.name) || alternatives.iter().any(|(name, _)| *name == other.name) {
                continue;
            }
            let others = self.scored.iter().filter(|own| in_its_place(&own.weighed, other.name));
            let score = others.map(Structure::score).fold(f64::NEG_INFINITY, f64::max);
            alternatives.push((other.name, 2.0 * (best.score() - score)));
            let may_be = self.beside == Beside::Noise || physics.is_hysteresis() && other.is_hysteresis();
            if may_be && probability(&|own| in_its_place(own, other.name)) > OPEN * own {
                alike.push(other.name);
            }
        }
        alternatives.sort_by(|a, b| a.1.total_cmp(&b.1));
        let of_one_loop = |own: &Weighed| self.beside == Beside::Discrepancy && alike.iter().any(|name| own.has(name));
        let inclusion = probability(&|own| own.has(physics.name) || of_one_loop(own));
        Named {
            physics,
            evidence: Evidence {
                bic_gain: 2.0 * (best.score() - simpler.score()),
                held_out_gain: removed / simpler.squares,
                inclusion,
            },
            removes: (removed / self.gap).clamp(0.0, 1.0),
            indistinguishable_from: alike,
            alternatives,
        }
    }

    /// The structures that the data leave open, the most probable first.
    fn open(&self) -> Vec<Candidate> {
        let weights = weights(&self.weighed());
        let most = weights.iter().copied().fold(0.0, f64::max);
        let open = || weights.iter().zip(&self.scored).filter(|(weight, _)| **weight > OPEN * most);
        let sum: f64 = open().map(|(weight, _)| weight).sum();
        let candidate = |(weight, structure): (&f64, &Structure)| Candidate {
            effects: structure.weighed.effects.iter().map(|physics| physics.name).collect(),
            probability: weight / sum,
            model: structure.fit.model.clone(),
        };
        let mut open: Vec<Candidate> = open().map(candidate).collect();
        open.sort_by(|a, b| b.probability.total_cmp(&a.probability));
        open
    }

    fn weighed(&self) -> Vec<&Weighed> {
        self.scored.iter().map(|structure| &structure.weighed).collect()
    }

    fn given(&self) -> usize {
        self.before.model.effects.len()
    }
}

/// Whether a parameter lies at no end of its range, but for rounding.
fn is_inside(spec: &ParameterSpec, value: f64) -> bool {
    let (least, most) = spec.range;
    let slack = AT_END * spec.typical;
    value > least + slack && value < most - slack
}

/// The share of its cost that a fit's own next step promises to take away; of parameters at the end of their range none goes on.
fn promises(fit: &Fit) -> f64 {
    let (information, gradient) = normal_equations(&fit.jacobian, &fit.residuals);
    let specs = fit.model.parameter_specs();
    let inside: Vec<usize> = (0..specs.len())
        .filter(|&j| is_inside(&specs[j], fit.model.parameter_values()[j]))
        .collect();
    let information = information.select_rows(&inside).select_columns(&inside);
    let gradient = gradient.select_rows(&inside);
    let precision = DMatrix::from_diagonal(&prior_precision(&fit.model).select_rows(&inside));
    let promised = (information + precision).cholesky().map_or(0.0, |factor| gradient.dot(&factor.solve(&gradient)));
    promised / fit.cost.max(f64::MIN_POSITIVE)
}
