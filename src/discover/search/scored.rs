//! Structures that are fitted to convergence, with their scores.

use super::{FRAME, OPEN, Search};
use crate::discover::fit::{Fit, normal_equations, prior_precision};
use crate::discover::hypotheses::Hypothesis;
use crate::discover::predictive_density::Beside;
use crate::discover::residuals::{Linearised, Problem};
use crate::discover::structure_weights::{Weighed, probability_over};
use crate::robot::effects::{Effect, ParameterSpec, Role};
use crate::robot::{Model, Physics};
use crate::statistics::student;
use nalgebra::{DMatrix, Vector2};
use rayon::prelude::*;

/// The logarithm of the odds beforehand of each effect beside noise alone.
///
/// Convention: e⁻⁶ each for some thirty effects: a model to which nothing is lacking is likelier than all with one effect more together.
const LOG_PRIOR_BESIDE_NOISE: f64 = -6.0;

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

/// An effect takes the place of another where the score is higher by this. If they are the same, fitted from elsewhere, the fit before has to be
/// [ruled out](OPEN).
///
/// Convention: above what the tolerance of a fit moves it by; odds of 1.1 to 1.
const LEAST_GAIN: f64 = 0.1;

/// An effect stands where the structure with it is better than the one without with this probability; one that physics expects stands where
/// that is likelier than not.
///
/// Source: that a difference exceeds one of its standard errors; the rule of one standard error of Breiman et al. 1984, Classification and
/// Regression Trees, 3.4.3.
const CLEARLY: f64 = 0.84;

/// A converged fit with its score.
#[derive(Debug, Clone)]
pub(super) struct Structure {
    pub(super) fit: Fit,
    pub(super) weighed: Weighed,
    /// The squares that the refits without each stretch leave in it, in units of the noise's.
    pub(super) squares: f64,
    /// Whether a parameter lies at the end of its range, where it is not what the effect means: such a structure is no answer, but another effect
    /// beside it may bring the parameter back.
    pub(super) is_at_end: bool,
}

impl Structure {
    pub(super) fn score(&self) -> f64 {
        self.weighed.score()
    }

    /// Its effects, each in its form, in the order of their names.
    pub(super) fn effects(&self) -> Vec<&'static Physics> {
        let mut effects = self.weighed.effects.clone();
        effects.sort_by_key(|physics| (physics.name, physics.form));
        effects
    }

    /// The name of the effect that was added last.
    pub(super) fn last_name(&self) -> &'static str {
        self.weighed.effects.last().map_or("", |physics| physics.name)
    }

    /// Whether it has the effects of another, and more parameters: one of them in a richer form.
    pub(super) fn is_richer_form_of(&self, other: &Self) -> bool {
        self.weighed.is_same(&other.weighed) && self.fit.parameter_count() > other.fit.parameter_count()
    }

    /// Whether it is the answer in the place of another: a richer form if it is clearly better than the plainer one.
    pub(super) fn takes_the_place_of(&self, other: &Self) -> bool {
        if self.is_richer_form_of(other) {
            return self.excess_over(other) > 0.0;
        }
        if other.is_richer_form_of(self) {
            return other.excess_over(self) <= 0.0;
        }
        let least = if self.effects() == other.effects() { -OPEN.ln() } else { LEAST_GAIN };
        self.score() > other.score() + least
    }

    /// Whether what it has beyond another is what no model of a machine knows exactly.
    pub(super) fn adds_frame_alone(&self, other: &Self) -> bool {
        let mut more = self.weighed.effects.iter().filter(|physics| !other.weighed.has(physics.name));
        more.all(|physics| FRAME.contains(&physics.name))
    }

    /// By how much the probability that it is better than another, of the two, exceeds the one that is asked of what it has beyond the other.
    pub(super) fn excess_over(&self, other: &Self) -> f64 {
        let (own, others) = (self.weighed.log_prior, other.weighed.log_prior);
        let is_expected =
            own > others || own == others && self.adds_frame_alone(other) && !self.is_richer_form_of(other);
        let asked = if is_expected { 0.5 } else { CLEARLY };
        probability_over(&self.weighed, &other.weighed) - asked
    }

    /// Whether it is clearly better than another, whatever is expected.
    pub(super) fn is_clear_beside(&self, other: &Self) -> bool {
        probability_over(&self.weighed, &other.weighed) > CLEARLY
    }
}

impl Search<'_> {
    /// The score that a linear step about the start of a hypothesis promises, but for its prior. `path` is that of the fit.
    ///
    /// Beside noise effects are small, and begin to first order about the path of the fit. A wide play is not, and changes what all others do.
    pub(super) fn promised(&self, (fit, path): (&Fit, &Linearised), hypothesis: &Hypothesis) -> Option<f64> {
        let (problem, start, own) =
            (&self.problem, &hypothesis.start, fit.parameter_count()..hypothesis.start.parameter_count());
        let changes_others = self.beside == Beside::Discrepancy && hypothesis.physics.is_hysteresis();
        let precision = prior_precision(start);
        let density = if changes_others {
            let prediction = problem.predict(start, Some(&fit.path));
            let jacobian = problem.jacobian(start, &prediction, 0..own.end);
            self.judged.density(problem, &prediction.residuals, &[&jacobian], &precision)?
        } else {
            let (residuals, columns) = problem.near(path, start, own);
            self.judged.density(problem, &residuals, &[&fit.jacobian, &columns], &precision)?
        };
        Some(density.total())
    }

    /// The structures of models, each fitted from its values and from a path near its own; those whose fits do not converge are left out.
    pub(super) fn structures(&mut self, starts: Vec<(Model, Vec<Vector2<f64>>)>) -> Vec<Structure> {
        let of_start =
            |(model, path): (Model, Vec<Vector2<f64>>)| self.scored(self.problem.fit(&model, Some(&path), None));
        let structures: Vec<Structure> = starts.into_par_iter().filter_map(of_start).collect();
        self.scored.extend(structures.iter().filter(|structure| !structure.is_at_end).cloned());
        structures
    }

    /// The same of starts that are compared with each other: those that are ruled out beside the best are fitted roughly.
    pub(super) fn structures_of_best(&mut self, starts: Vec<(Model, Vec<Vector2<f64>>)>) -> Vec<Structure> {
        let roughly =
            |(model, path): (Model, Vec<Vector2<f64>>)| self.scored(self.problem.fit_roughly(&model, Some(&path)));
        let rough: Vec<Structure> = starts.into_par_iter().filter_map(roughly).collect();
        let best = rough.iter().map(Structure::score).fold(f64::NEG_INFINITY, f64::max);
        let (open, mut ruled_out): (Vec<_>, Vec<_>) =
            rough.into_iter().partition(|structure| structure.score() > best + OPEN.ln());
        self.scored.extend(ruled_out.iter().filter(|structure| !structure.is_at_end).cloned());
        let mut structures = self.structures(open.into_iter().map(|own| (own.fit.model, own.fit.path)).collect());
        structures.append(&mut ruled_out);
        structures
    }

    /// The structure of a fit; none where it does not converge.
    pub(super) fn structure(&mut self, fit: Fit) -> Option<Structure> {
        let structure = self.scored(fit).filter(|structure| !structure.is_at_end)?;
        self.scored.push(structure.clone());
        Some(structure)
    }

    /// A fit with its score, gone on with until it has converged or brings nothing more; none where it does not converge.
    pub(super) fn scored(&self, mut fit: Fit) -> Option<Structure> {
        for _ in 0..RESTARTS {
            if promises(&fit) < PROMISES {
                break;
            }
            let next = self.problem.fit(&fit.model, Some(&fit.path), None);
            if next.cost >= fit.cost {
                break;
            }
            fit = next;
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

    /// The effects beside a discrepancy, beyond those that were given and what no model of a machine knows exactly, of which all sizes may be zero by their
    /// own standard deviations, over sweeps that are independent of each other. Such effects may foretell held-out stretches all the same, where what no
    /// library has looks like two large ones that cancel each other.
    pub(super) fn untold(&self, structure: &Structure) -> Vec<&'static str> {
        if self.beside == Beside::Noise {
            return Vec::new();
        }
        let model = self.problem.with_clustered_covariance(&structure.fit);
        let freedom = self.problem.data.sweep_count() as f64 - 1.0;
        let may_be_zero = |k: &usize| {
            let (effect, sds) = (&model.effects[*k], model.effect_sds(*k));
            let values = effect.parameters().iter().zip(effect.values.iter().zip(sds));
            let sizes = values.filter(|(spec, _)| matches!(spec.role, Role::Size { .. }));
            let sizes: Vec<f64> = sizes.map(|(_, (value, sd))| value.abs() / sd).collect();
            // Of either sign, and of any of them (Bonferroni).
            let most = student::upper_quantile(freedom, 0.5 * OPEN / sizes.len() as f64);
            !FRAME.contains(&effect.physics.name) && sizes.iter().all(|size| *size <= most)
        };
        let effects = self.given()..model.effects.len();
        effects.filter(may_be_zero).map(|k| model.effects[k].physics.name).collect()
    }

    /// Whether a parameter of an effect beyond those that were given lies at the end of its range.
    fn is_at_end(&self, model: &Model) -> bool {
        let is_at_end = |(spec, value): (&ParameterSpec, &f64)| !is_inside(spec, *value);
        let effects = model.effects.iter().skip(self.given());
        effects.flat_map(|effect| effect.parameters().iter().zip(&effect.values)).any(is_at_end)
    }

    /// A structure fitted anew where its own discrepancy, which is smaller than that of the structure before, belongs to the noise: under a large one of the
    /// bends, fits follow what bends nothing.
    pub(super) fn under_its_own_discrepancy(&mut self, structure: Structure) -> Structure {
        if self.beside == Beside::Noise {
            return structure;
        }
        let noise = self.problem.noise.with_discrepancy(&self.problem, &structure.fit);
        self.problem = Problem::new(self.problem.data, &noise, &structure.fit.model);
        let fit = self.problem.fit(&structure.fit.model, Some(&structure.fit.path), None);
        self.structure(fit).unwrap_or(structure)
    }

    /// The logarithm of what is expected beforehand of a model's effects beyond those that were given.
    pub(super) fn log_prior(&self, model: &Model) -> f64 {
        let of_effect = |effect: &Effect| match self.beside {
            Beside::Noise => LOG_PRIOR_BESIDE_NOISE - 0.5 * effect.physics.prior_penalty,
            Beside::Discrepancy => effect.physics.log_prior - 0.5 * effect.physics.prior_penalty,
        };
        model.effects.iter().skip(self.given()).map(of_effect).sum()
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
    let inside: Vec<usize> =
        (0..specs.len()).filter(|&j| is_inside(&specs[j], fit.model.parameter_values()[j])).collect();
    let information = information.select_rows(&inside).select_columns(&inside);
    let gradient = gradient.select_rows(&inside);
    let precision = DMatrix::from_diagonal(&prior_precision(&fit.model).select_rows(&inside));
    let promised = (information + precision).cholesky().map_or(0.0, |factor| gradient.dot(&factor.solve(&gradient)));
    promised / fit.cost.max(f64::MIN_POSITIVE)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::discover::data::Data;
    use crate::discover::fixture::{experiment, truth};
    use crate::discover::noise::Noise;
    use crate::robot::effects::{COMMAND_GAIN, physics};

    /// A structure with these effects and this score, at the true model.
    fn structure(problem: &Problem, names: &[&str], stretch: f64, log_prior: f64) -> Structure {
        let effects = names.iter().filter_map(|name| physics(name)).collect();
        let weighed = Weighed { effects, stretches: [stretch; 6], log_prior };
        Structure { fit: problem.evaluated(&truth(), None), weighed, squares: 0.0, is_at_end: false }
    }

    #[test]
    fn what_is_expected_stands_if_it_is_likelier_than_not_and_all_else_if_it_is_clearly_better() {
        let data = experiment(1);
        let problem = Problem::new(&data, &Noise::stated(&data), &truth());
        let of = |names: &[&str], stretch, log_prior| structure(&problem, names, stretch, log_prior);
        let bare = of(&[], 0.0, 0.0);
        // Two to one in all.
        let stretch = 2f64.ln() / 6.0;
        assert!(of(&[COMMAND_GAIN], stretch, 0.0).excess_over(&bare) > 0.0);
        assert!(of(&["creep"], stretch, 0.0).excess_over(&bare) < 0.0);
        // Ten to one.
        assert!(of(&["creep"], 10f64.ln() / 6.0, 0.0).excess_over(&bare) > 0.0);
        // Beside noise alone a gain is as unlikely as anything: two to one in all, after its prior.
        assert!(of(&[COMMAND_GAIN], stretch + 1.0, -6.0).excess_over(&bare) < 0.0);
    }

    #[test]
    fn an_effect_is_told_where_one_of_its_sizes_is_not_zero_within_its_own_sigma() {
        let mut data = experiment(1);
        let untold = |data: &Data, name: &str| {
            let problem = Problem::new(data, &Noise::stated(data), &truth());
            let search = Search::new(&problem, &problem.fit(&truth(), None, None), Beside::Discrepancy);
            let physics = physics(name).unwrap();
            let mut model = truth();
            model.effects.push(Effect::of(physics, vec![0.0; physics.parameters_on(3).len()]));
            let fit = problem.fit(&model, None, None);
            !search.untold(&Structure { fit, ..structure(&problem, &[], 0.0, 0.0) }).is_empty()
        };
        // Nothing is missing: a turn and a load are noise. A gain is expected, and need not be told.
        assert!(untold(&data, "plane_misalignment") && untold(&data, "tip_load") && !untold(&data, COMMAND_GAIN));
        data.measured.iter_mut().for_each(|measured| measured.configuration.delta += 0.1);
        assert!(!untold(&data, "plane_misalignment"));
    }

    #[test]
    fn a_parameter_lies_at_an_end_of_its_range_but_for_rounding() {
        let spec = &physics("creep").unwrap().parameters_on(3)[1];
        assert!(
            is_inside(spec, 8.0) && !is_inside(spec, spec.range.1) && !is_inside(spec, spec.range.1 * (1.0 - 1e-12))
        );
    }

    #[test]
    fn a_converged_fit_promises_nothing_and_one_far_off_much() {
        let data = experiment(1);
        let problem = Problem::new(&data, &Noise::stated(&data), &truth());
        let mut values = truth().parameter_values();
        values[1] += 0.5;
        let far = problem.evaluated(&truth().with_parameter_values(&values), None);
        assert!(promises(&far) > 3.0 * PROMISES, "{}", promises(&far));
        assert!(promises(&problem.fit(&far.model, None, None)) < 0.01);
    }
}
