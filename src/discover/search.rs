//! The search for missing effects: stepwise selection over a beam of models, with exchange and backward elimination.

use super::comparison::{Comparison, Evidence};
use super::fit::Fit;
use super::hypotheses::{FirstStep, Hypothesis, first_steps, promised};
use super::residuals::Problem;
use super::structure::mean_square_quantile;
use super::sweep_equations::{RESAMPLES, SweepEquations};
use crate::robot::effects::Changes;
use crate::robot::{LIBRARY, Model, Physics};
use rayon::prelude::*;

/// An alternative that is worse by less than this in the information criterion is not ruled out.
///
/// Source: Kass and Raftery 1995, Bayes Factors, J. Am. Stat. Assoc. 90:773: 2 ln B above 6 is strong evidence.
pub const NOT_RULED_OUT: f64 = 6.0;

/// An alternative that is the best in more than this share of the bootstrap resamples is not ruled out either.
///
/// Convention: the usual level of 5 %.
const OFTEN_BEST: f64 = 0.05;

/// The most effects that are named at once.
///
/// Convention: a bound on computing time.
const MOST_EFFECTS: usize = 3;

/// Models that each forward step extends.
///
/// Convention: a bound on computing time.
const BEAM_WIDTH: usize = 4;

/// Hypotheses of each step that are fitted to convergence: those that a first Gauss–Newton step expects to gain most.
///
/// Convention: a bound on computing time.
const FITTED: usize = 8;

/// Fits of the same physics from different starts among them.
///
/// Convention: a bound on computing time.
const FITTED_PER_FORM: usize = 2;

/// An exchange must lower the information criterion by this.
///
/// Convention: a convergence tolerance, above that of the fits.
const LEAST_EXCHANGE_GAIN: f64 = 0.1;

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
    /// Every alternative in its place, with how much larger the information criterion is; the best first.
    pub alternatives: Vec<(&'static str, f64)>,
}

impl Named {
    /// The probability that it is there: the share of bootstrap resamples of the sweeps in which the model with it is the best of all
    /// compared, by Laplace's rule of succession. In a partial answer a play or friction stands for those of
    /// [`indistinguishable_from`](Self::indistinguishable_from) as well, which describe the same loop.
    pub fn probability(&self) -> f64 {
        (self.evidence.inclusion * RESAMPLES as f64 + 1.0) / (RESAMPLES as f64 + 2.0)
    }
}

/// The model with the effects found beyond those of the model at hand, `before`, which stay in it. `first` are the first steps of all
/// hypotheses about it, and `least_bic_gain` is what the best of them gains on noise alone.
pub fn search(problem: &Problem, before: &Fit, first: &[FirstStep], least_bic_gain: f64) -> Fit {
    let search = Search::new(problem, before, first, least_bic_gain);
    let exchanged = search.exchange(search.forward(BEAM_WIDTH));
    search.prefer(search.eliminate(exchanged))
}

/// The evidence for each effect that a search from there found, in the order of the model's; and the fits of what was compared with it:
/// the model without each effect, and with another in its place.
pub fn named(problem: &Problem, before: &Fit, first: &[FirstStep], after: &Fit) -> (Vec<Named>, Vec<Fit>) {
    let search = Search::new(problem, before, first, 0.0);
    let described = (search.given..after.model.effects.len()).map(|k| search.describe(after, k));
    let (named, rivals): (Vec<Named>, Vec<Vec<Fit>>) = described.unzip();
    (named, rivals.into_iter().flatten().collect())
}

/// The fits of a model with one effect more that promise not to be [ruled out](NOT_RULED_OUT), where each effect is charged
/// `least_bic_gain` besides; `first` as for the [search].
pub fn with_one_more(problem: &Problem, fit: &Fit, first: &[FirstStep], least_bic_gain: f64) -> Vec<Fit> {
    fitted_best(problem, fit, first, (FITTED, least_bic_gain - NOT_RULED_OUT))
}

/// The model with whatever effects lower the cost, none of them judged against noise.
pub fn explained(problem: &Problem, before: &Fit) -> Fit {
    Search::new(problem, before, &first_steps(problem, before, is_beside_noise), 0.0).forward(1)
}

/// Whether it is looked for where noise alone is expected beside it. The drive is looked for where a discrepancy is: a plant that is near its model
/// shows no row within a backlash, and says of it what `motion_directed_backlash` says; its gain is another name of η.
pub fn is_beside_noise(physics: &Physics) -> bool {
    !matches!(physics.changes, Changes::Drive(_))
}

struct Search<'a> {
    problem: &'a Problem<'a>,
    before: &'a Fit,
    /// The first steps from there.
    first: &'a [FirstStep],
    least_bic_gain: f64,
    /// The squares of the gap beyond those of noise, before anything was added.
    excess: f64,
    /// The number of effects that the model had.
    given: usize,
}

impl<'a> Search<'a> {
    fn new(problem: &'a Problem<'a>, before: &'a Fit, first: &'a [FirstStep], least_bic_gain: f64) -> Self {
        let given = before.model.effects.len();
        let excess = (before.cost - problem.data.residual_count() as f64).max(0.0);
        Self { problem, before, first, least_bic_gain, excess, given }
    }

    /// Adds effects one by one as long as the comparison accepts them. Where the best model leaves no more than noise, it alone is gone on
    /// from: of the others one more effect makes at best its equal, with a parameter more.
    fn forward(&self, width: usize) -> Fit {
        let count = self.problem.data.residual_count() as f64;
        let mut best = self.before.clone();
        let mut beam = vec![self.before.clone()];
        for _ in 0..MOST_EFFECTS {
            let extended = by_bic(beam.iter().flat_map(|fit| self.extensions(fit, FITTED, 0.0)).collect());
            let mut kept: Vec<Fit> = Vec::new();
            for fit in extended {
                if kept.len() < width && kept.iter().all(|other| !have_same_effects(&other.model, &fit.model)) {
                    kept.push(fit);
                }
            }
            let Some(first) = kept.first() else { break };
            if !self.accepts(first, &best) {
                break;
            }
            best = first.clone();
            let leaves_noise = best.cost < count * mean_square_quantile(count);
            kept.truncate(if leaves_noise { 1 } else { width });
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
                .flat_map(|k| self.extensions(&self.without(&best, k), FITTED, 0.0))
                .min_by(|a, b| a.bic().total_cmp(&b.bic()));
            match better {
                Some(fit) if fit.bic() < best.bic() - LEAST_EXCHANGE_GAIN => best = fit,
                _ => return best,
            }
        }
        best
    }

    /// Drops effects that the others have made superfluous.
    fn eliminate(&self, mut best: Fit) -> Fit {
        while best.model.effects.len() > self.given {
            let simpler = (self.given..best.model.effects.len())
                .map(|k| self.without(&best, k))
                .min_by(|a, b| a.bic().total_cmp(&b.bic()));
            match simpler {
                Some(simpler) if !self.accepts(&best, &simpler) => best = simpler,
                _ => break,
            }
        }
        best
    }

    /// Puts play or friction in the place of a clock's lag, where the data do not rule it out.
    fn prefer(&self, mut best: Fit) -> Fit {
        for k in self.given..best.model.effects.len() {
            let Physics { changes, yields_to, .. } = best.model.effects[k].physics;
            if !matches!(changes, Changes::Exposure(_)) {
                continue;
            }
            let without = self.without(&best, k);
            let likelier = |physics: &Physics| yields_to.contains(&physics.name);
            let others = by_bic(extensions(self.problem, &without, FITTED, f64::NEG_INFINITY, likelier));
            if let Some(other) = others.into_iter().next().filter(|other| other.bic() < best.bic() + NOT_RULED_OUT) {
                best = other;
            }
        }
        best
    }

    /// Whether a fit with one effect more is accepted.
    fn accepts(&self, fit: &Fit, simpler: &Fit) -> bool {
        let comparison = Comparison::new(self.problem.data, fit, simpler, &[], self.excess);
        comparison.evidence.failed_criterion(self.least_bic_gain).is_none()
    }

    /// The fit without effect k.
    fn without(&self, fit: &Fit, k: usize) -> Fit {
        let model = fit.model.without_effect(k);
        let without = self.problem.fit(&model, Some(&fit.path), None);
        // The same model may have been fitted better from its own start.
        if model.effects.len() == self.given && self.before.cost < without.cost { self.before.clone() } else { without }
    }

    /// [`extensions`] by any effect.
    fn extensions(&self, fit: &Fit, fitted: usize, least: f64) -> Vec<Fit> {
        fitted_best(self.problem, fit, self.first, (fitted, least))
    }

    /// The evidence for effect k of the answer; and the fits without it, and with what could stand in its place.
    fn describe(&self, after: &Fit, k: usize) -> (Named, Vec<Fit>) {
        let physics = after.model.effects[k].physics;
        let without = self.without(after, k);
        let mut alternatives: Vec<Fit> = Vec::new();
        for fit in by_bic(self.extensions(&without, 2 * FITTED, f64::NEG_INFINITY)) {
            let name = added(&fit).name;
            if name != physics.name && alternatives.iter().all(|other| added(other).name != name) {
                alternatives.push(fit);
            }
        }
        let comparison = Comparison::new(self.problem.data, after, &without, &alternatives, self.excess);
        let worse_by = |fit: &Fit| fit.bic() - after.bic();
        let [cost, cost_without] =
            [after, &without].map(|fit| SweepEquations::new(self.problem.data, fit).held_out_cost());
        let excess = cost_without - self.problem.data.residual_count() as f64;
        let open = alternatives.iter().zip(&comparison.alternative_shares);
        let open = open.filter(|(fit, share)| worse_by(fit) < NOT_RULED_OUT || **share > OFTEN_BEST);
        let named = Named {
            physics,
            evidence: comparison.evidence,
            removes: if excess > 0.0 { ((cost_without - cost) / excess).clamp(0.0, 1.0) } else { 0.0 },
            indistinguishable_from: open.map(|(fit, _)| added(fit).name).collect(),
            alternatives: alternatives.iter().map(|fit| (added(fit).name, worse_by(fit))).collect(),
        };
        (named, alternatives.into_iter().chain([without]).collect())
    }
}

/// The fits with one effect more, of those that `admits`, that a first step expects to gain most, each to convergence. Hypotheses that
/// are expected to gain less than `least` in the information criterion are left out.
pub fn extensions(
    problem: &Problem,
    fit: &Fit,
    fitted: usize,
    least: f64,
    admits: impl Fn(&Physics) -> bool,
) -> Vec<Fit> {
    fitted_best(problem, fit, &first_steps(problem, fit, admits), (fitted, least))
}

/// The fits to convergence of as many hypotheses about a fit as are to be fitted, those that promise to gain most, and more than `least`.
fn fitted_best(problem: &Problem, fit: &Fit, steps: &[FirstStep], (fitted, least): (usize, f64)) -> Vec<Fit> {
    let mut all = promised(problem, fit, steps);
    all.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut chosen: Vec<Hypothesis> = Vec::new();
    for (_, hypothesis) in all.into_iter().take_while(|(gain, _)| *gain > least) {
        let of_its_form = chosen.iter().filter(|other| other.physics == hypothesis.physics).count();
        if chosen.len() < fitted && of_its_form < FITTED_PER_FORM {
            chosen.push(hypothesis);
        }
    }
    chosen.into_par_iter().map(|hypothesis| problem.fit(&hypothesis.start, Some(&fit.path), None)).collect()
}

/// The best first.
pub fn by_bic(mut fits: Vec<Fit>) -> Vec<Fit> {
    fits.sort_by(|a, b| a.bic().total_cmp(&b.bic()));
    fits
}

/// The effect that a fit was given last.
pub fn added(fit: &Fit) -> &'static Physics {
    fit.model.effects.last().map_or(LIBRARY[0], |effect| effect.physics)
}

/// Whether two models have effects of the same names.
fn have_same_effects(a: &Model, b: &Model) -> bool {
    a.effects.len() == b.effects.len()
        && a.effects.iter().all(|effect| b.effects.iter().any(|other| other.physics.name == effect.physics.name))
}
