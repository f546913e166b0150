//! A partial answer: effects that help, where what is left is more than noise.
//!
//! A real machine never lies wholly in a library. Beside the noise there is then a *discrepancy*, what the model misses: its variance
//! is learned from the residuals and added to that of the noise, so that a misfit is not read as evidence of millions of bits. As effects
//! are found it is learned anew, from what they leave together, for a bend at rest of 10° would hide a play of 3°.
//! Effects are added one by one, each the one that shrinks most what is left of sweeps that the fit did not see; of effects that do so
//! about equally well, the one that physics makes likelier. Those stay that help beside all the others, in every block of sweeps that
//! follow each other and in most bootstrap resamples of the sweeps.

use super::comparison::{Comparison, LEAST_INCLUSION};
use super::data::Data;
use super::fit::Fit;
use super::held_out::HeldOutResiduals;
use super::hypotheses::is_periodic;
use super::law;
use super::noise::Noise;
use super::residuals::Problem;
use super::search::{Named, added, by_bic, extensions};
use super::start::unknown_start;
use super::sweep_equations::SweepEquations;
use super::sweeps::FOLDS;
use crate::robot::effects::Role;
use crate::robot::{Model, Physics};
use crate::statistics::moments::rms;
use nalgebra::Vector2;
use std::cmp::Ordering;

/// The most effects of a partial answer.
///
/// Convention: a bound on computing time.
const MOST_EFFECTS: usize = 6;

/// Hypotheses of each step that are fitted to convergence.
///
/// Convention: a bound on computing time.
const FITTED: usize = 12;

/// How often the discrepancy is learned and the search done with it.
///
/// Convention: an iteration cap.
const MOST_SEARCHES: usize = 4;

/// A discrepancy that has shrunk below this share of what it was taken for makes the search go on.
///
/// Convention: less changes no decision.
const FINER: f64 = 0.75;

/// What no model of a real machine knows exactly: where it rests, and how its frame is turned.
const FRAME: [&str; 2] = ["rest_bend", "plane_misalignment"];

/// Each parameter of an effect needs as many sweeps.
///
/// Convention: two estimate a parameter and what is left beside it; on fewer, richer models do worse in directions they have not seen.
const SWEEPS_PER_PARAMETER: usize = 2;

/// An effect, and all of an answer together if it is not of the frame alone, must take away this share of what is left beyond noise, on sweeps that the fit did not see.
///
/// Convention: less is not worth a name while the rest is unknown.
const LEAST_SHARE: f64 = 0.2;

/// An effect of the frame may take away as little of it, if that is as much of what the model as given leaves: then other physics is not
/// likelier.
///
/// Fitted: to the sections v4_seg1, v4_seg2 and v6_seg2 of ContinuumRoboticsLab/opencr-mujoco; judged on v4_seg3 and v6_seg3.
const LEAST_SHARE_OF_FRAME: f64 = 0.05;

/// Effects of the frame that take away this share are no trace of something else.
///
/// Convention: half; what else there is, is then the smaller part.
const MOST_OF_IT: f64 = 0.5;

/// Effects are only looked for where the model as given misses this share of the bends (rms). Where it is nearer, what the library
/// lacks is imitated by effects that are not there: on sealed experiments 9000 and 9001 with a slip or a pull, in four of six.
///
/// Convention: 0.06 is 1° of 16°.
const LEAST_GAP: f64 = 0.06;

/// One of an effect's sizes must be this many of its standard deviations from zero.
///
/// Convention: the usual level of 5 %.
const LEAST_SIZE_IN_SDS: f64 = 2.0;

/// Effects whose held-out gains differ by less than this share are rivals that the data do not decide between.
///
/// Convention: decides between effects of which one is physically likelier.
const ALIKE: f64 = 0.1;

/// The same of two hystereses, which differ in the form of their loop.
///
/// Convention: half; a form that gains less than that is not the loop that the data show.
const ALIKE_IN_FORM: f64 = 0.5;

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

impl<'a> Partial<'a> {
    /// Of the samples under their noise; `fits` are fits of the model as given, of which the best is gone on from.
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
        let bends: Vec<Vector2<f64>> =
            problem.data.measured[unknown_start..].iter().map(|m| m.configuration.bend_vector()).collect();
        let gap = (bend_squares(&problem, &before) / bends.len() as f64).sqrt();
        let is_near = gap < LEAST_GAP * rms(bends.iter().map(|bend| bend.norm()));
        // A picture that stands still tells nothing of a snake that should have moved.
        let middle = bends.iter().sum::<Vector2<f64>>() / bends.len().max(1) as f64;
        let is_still = rms(bends.iter().map(|bend| (bend - middle).norm())) < gap;
        let mut answer = Self { problem, after: before.clone(), before, named: Vec::new() };
        if is_near || is_still {
            return answer;
        }
        // What effects do is discrepancy until they are found: it is learned from what is left with all that helps.
        for _ in 0..MOST_SEARCHES {
            answer.add_all();
            let finer = answer.learned_noise();
            if finer.discrepancy_rad > FINER * answer.problem.noise.discrepancy_rad {
                break;
            }
            answer = answer.under(&finer);
        }
        let frame = answer.frame_alone();
        let answer = answer.settled();
        // What follows the path may take the place of a bend at rest on a few sweeps and not hold on others: then neither is left.
        let answer = match frame.filter(|_| answer.named.is_empty()) {
            Some(frame) => frame.under(&frame.learned_noise()).settled(),
            None => answer,
        };
        let answer = Self { named: answer.named.clone(), ..answer.under(&answer.learned_noise()) };
        answer.or_nothing()
    }

    /// Adds effects as long as they help, the likeliest first, since on a few sweeps much can imitate it: where the snake rests and how its
    /// frame is turned, which no model knows exactly, then other statics, then what hangs on the path or the time.
    fn add_all(&mut self) {
        self.add((f64::NEG_INFINITY, 0.0), is_of_the_frame);
        self.add((0.0, LEAST_SHARE), |physics| is_believable(physics) && physics.is_static());
        self.add((0.0, LEAST_SHARE), is_believable);
    }

    /// The noise with the discrepancy that its last fit leaves.
    fn learned_noise(&self) -> Noise {
        self.problem.noise.with_discrepancy(&self.problem, &self.after)
    }

    /// Its fits under another noise.
    fn under(&self, noise: &Noise) -> Self {
        let problem = Problem::new(self.problem.data, noise, &self.after.model);
        let [before, after] = [&self.before, &self.after].map(|fit| problem.fit(&fit.model, Some(&fit.path), None));
        Self { problem, before, after, named: Vec::new() }
    }

    /// With those of its effects that are of the frame; none where it has no others.
    fn frame_alone(&self) -> Option<Self> {
        let mut model = self.after.model.clone();
        for k in (self.given()..model.effects.len()).rev() {
            if !is_of_the_frame(model.effects[k].physics) {
                model = model.without_effect(k);
            }
        }
        let has_others = model.effects.len() < self.after.model.effects.len();
        has_others.then(|| Self { after: self.problem.fit(&model, Some(&self.after.path), None), ..self.clone() })
    }

    /// The same answer fitted to all samples, of which its own were a part.
    pub fn of<'b>(&self, data: &'b Data) -> Partial<'b> {
        let stride = data.len().div_ceil(self.problem.data.len());
        let noise = Noise { unknown_start: self.problem.noise.unknown_start * stride, ..self.problem.noise };
        let problem = Problem::new(data, &noise, &self.before.model);
        let [before, after] = [&self.before, &self.after].map(|fit| problem.fit(&fit.model, None, None));
        Partial { problem, before, after, named: self.named.clone() }
    }

    /// The answer without what does not hold beside the rest. What is likelier beforehand is judged once all else holds.
    fn settled(mut self) -> Self {
        loop {
            self.prune();
            self.named = (self.given()..self.after.model.effects.len()).map(|k| self.describe(k)).collect();
            let unlikely = self.named.iter().enumerate().filter(|(_, named)| named.probability() < LEAST_INCLUSION);
            let first = unlikely.min_by(|(_, a), (_, b)| by_likelihood((a.physics, a.removes), (b.physics, b.removes)));
            let Some((place, _)) = first else { return self };
            self.after = self.without(self.given() + place);
        }
    }

    /// The answer, if all its effects together are worth naming. Effects of the frame alone may remove less than others must: they are
    /// worth it where no [law](super::law) leaves less. Where one does, they are its trace, unless they are most of the gap.
    fn or_nothing(mut self) -> Self {
        let is_frame_alone = self.named.iter().all(|named| is_of_the_frame(named.physics));
        let [before, after] = [&self.before, &self.after].map(|fit| HeldOutCosts::new(&self.problem, fit));
        let share = (before.total() - after.total()) / self.excess_of(&before);
        let no_law_leaves_less = || {
            let left_mm = HeldOutResiduals::new(&self.problem, &self.after).gap.eps_mm;
            law::left_mm(&self.problem, &self.before).is_none_or(|by_law| left_mm < by_law)
        };
        let is_worth_it = match is_frame_alone {
            true => !self.named.is_empty() && (share >= MOST_OF_IT || no_law_leaves_less()),
            false => share >= LEAST_SHARE,
        };
        if !is_worth_it {
            self.after = self.before.clone();
            self.named.clear();
        }
        self
    }

    /// Adds effects that `admits`, the one that helps most first, until none helps by a share of what is left. Those that are expected to
    /// gain less than `least` in the information criterion are not tried.
    fn add(&mut self, (least, least_share): (f64, f64), admits: impl Fn(&Physics) -> bool) {
        let most_parameters = self.before.parameter_count() + self.problem.data.sweep_count() / SWEEPS_PER_PARAMETER;
        while self.added() < MOST_EFFECTS {
            let now = HeldOutCosts::new(&self.problem, &self.after);
            let mut candidates: Vec<(Fit, f64)> = Vec::new();
            for fit in by_bic(extensions(&self.problem, &self.after, FITTED, least, &admits)) {
                let gain = now.total() - HeldOutCosts::new(&self.problem, &fit).total();
                let is_new = candidates.iter().all(|(other, _)| added(other).name != added(&fit).name);
                let is_affordable = fit.parameter_count() <= most_parameters;
                if is_new && is_affordable && gain > least_share * self.excess_of(&now) {
                    candidates.push((fit, gain));
                }
            }
            candidates.sort_by(|a, b| b.1.total_cmp(&a.1));
            let Some(place) = preferred(&candidates) else { return };
            self.after = candidates.swap_remove(place).0;
        }
    }

    /// Drops effects that do not help beside the others, the least helpful first.
    fn prune(&mut self) {
        let of_all = self.excess_of(&HeldOutCosts::new(&self.problem, &self.before));
        while self.added() > 0 {
            let with = HeldOutCosts::new(&self.problem, &self.after);
            let fitted = self.problem.with_clustered_covariance(&self.after);
            let each = (self.given()..self.after.model.effects.len()).map(|k| {
                let physics = self.after.model.effects[k].physics;
                let simpler = self.without(k);
                let costs = HeldOutCosts::new(&self.problem, &simpler);
                let gain = costs.total() - with.total();
                let inclusion = Comparison::new(self.problem.data, &self.after, &simpler, &[], 1.0).evidence.inclusion;
                let is_likely = is_of_the_frame(physics) && gain >= LEAST_SHARE_OF_FRAME * of_all;
                let least_share = if is_likely { LEAST_SHARE_OF_FRAME } else { LEAST_SHARE };
                let holds = gain >= least_share * self.excess_of(&costs)
                    && (is_likely || with.is_better_in_every_block(&costs) && has_eta(&fitted))
                    && has_size(&fitted, k)
                    && inclusion >= LEAST_INCLUSION;
                (simpler, (physics, gain), holds)
            });
            let failing = each.filter(|(_, _, holds)| !holds).min_by(|a, b| by_likelihood(a.1, b.1));
            match failing {
                Some((simpler, _, _)) => self.after = simpler,
                None => return,
            }
        }
    }

    /// The evidence for effect k of the answer, what could stand in its place, and what it removes beside the others.
    fn describe(&self, k: usize) -> Named {
        let (problem, physics) = (&self.problem, self.after.model.effects[k].physics);
        let simpler = self.without(k);
        let costs = [&self.before, &simpler, &self.after].map(|fit| HeldOutCosts::new(problem, fit));
        let gain = costs[1].total() - costs[2].total();
        let mut rivals: Vec<Fit> = Vec::new();
        for fit in by_bic(extensions(problem, &simpler, FITTED, f64::NEG_INFINITY, is_believable)) {
            let other = added(&fit);
            let is_new = rivals.iter().all(|rival| added(rival).name != other.name);
            if is_new && other.name != physics.name && !other.yields_to.contains(&physics.name) {
                rivals.push(fit);
            }
        }
        // Descriptions of one physics contradict each other in the form of a loop alone.
        let is_same_physics = |rival: &Fit| physics.is_hysteresis() && added(rival).is_hysteresis();
        let gain_of = |rival: &Fit| costs[1].total() - HeldOutCosts::new(problem, rival).total();
        let (alike, mut rivals): (Vec<Fit>, Vec<Fit>) = rivals.into_iter().partition(|rival| {
            let gained = gain_of(rival);
            gained > (1.0 - ALIKE) * gain || is_same_physics(rival) && gained > (1.0 - ALIKE_IN_FORM) * gain
        });
        rivals.retain(|rival| !is_same_physics(rival));
        if is_of_the_frame(physics) {
            rivals.retain(|rival| is_of_the_frame(added(rival)));
        }
        let excess = self.excess_of(&costs[0]);
        Named {
            physics,
            evidence: Comparison::new(problem.data, &self.after, &simpler, &rivals, excess).evidence,
            removes: (gain / excess).clamp(0.0, 1.0),
            indistinguishable_from: alike.iter().map(|rival| added(rival).name).collect(),
            alternatives: rivals.iter().map(|rival| (added(rival).name, rival.bic() - self.after.bic())).collect(),
        }
    }

    fn given(&self) -> usize {
        self.before.model.effects.len()
    }

    fn added(&self) -> usize {
        self.after.model.effects.len() - self.given()
    }

    /// The fit without effect k.
    fn without(&self, k: usize) -> Fit {
        self.problem.fit(&self.after.model.without_effect(k), Some(&self.after.path), None)
    }

    /// What costs are beyond those of noise.
    fn excess_of(&self, costs: &HeldOutCosts) -> f64 {
        (costs.total() - self.problem.expected_cost()).max(f64::MIN_POSITIVE)
    }

    /// The model of one of its fits, with a covariance that contains the discrepancy as it hangs together within sweeps.
    pub fn model(&self, fit: &Fit) -> Model {
        let left = self.problem.noise.with_discrepancy(&self.problem, fit);
        let problem = Problem::new(self.problem.data, &left, &fit.model);
        problem.with_clustered_covariance(&problem.fit(&fit.model, Some(&fit.path), None))
    }
}

/// What is left of sweeps that the fit did not see, in squares of noise and discrepancy.
#[derive(Debug, Clone)]
struct HeldOutCosts {
    /// Sweeps dealt to the folds in turn: between sweeps like those that were left out.
    interleaved: Vec<f64>,
    /// Sweeps that follow each other: beyond what the fit has seen.
    blocks: Vec<f64>,
}

impl HeldOutCosts {
    fn new(problem: &Problem, fit: &Fit) -> Self {
        let equations = SweepEquations::new(problem.data, fit);
        let blocks = problem.data.blocks();
        Self {
            interleaved: equations.held_out_costs(|sweep| sweep % FOLDS),
            blocks: equations.held_out_costs(|sweep| blocks[sweep]),
        }
    }

    /// The mean of both partitions.
    fn total(&self) -> f64 {
        0.5 * self.interleaved.iter().chain(&self.blocks).sum::<f64>()
    }

    fn is_better_in_every_block(&self, other: &Self) -> bool {
        self.blocks.iter().zip(&other.blocks).all(|(own, other)| own <= other)
    }
}

/// Periodic effects and those of time are not looked for: a wave with a pitch of its own fits any smooth gap over a few of its periods,
/// and a drift any slow change.
fn is_believable(physics: &Physics) -> bool {
    !physics.in_time && !is_periodic(physics)
}

/// Whether it is one of the effects that are likely beforehand, of which only another of them is a rival.
fn is_of_the_frame(physics: &Physics) -> bool {
    FRAME.contains(&physics.name)
}

/// The order in which effects that do not hold are dropped: those that are not of the frame, then by what they are worth.
fn by_likelihood(a: (&Physics, f64), b: (&Physics, f64)) -> Ordering {
    is_of_the_frame(a.0).cmp(&is_of_the_frame(b.0)).then(a.1.total_cmp(&b.1))
}

/// Whether η is clear of zero, as the forces of any snake make it: an effect that takes its place is none beside it.
fn has_eta(model: &Model) -> bool {
    model.estimate.is_some_and(|estimate| estimate.eta > LEAST_SIZE_IN_SDS * estimate.sd_eta())
}

/// Whether one of the sizes of effect k is clear of zero.
fn has_size(model: &Model, k: usize) -> bool {
    let effect = &model.effects[k];
    let values = effect.parameters().iter().zip(effect.values.iter().zip(model.effect_sds(k)));
    values
        .filter(|(spec, _)| matches!(spec.role, Role::Size { .. }))
        .any(|(_, (value, sd))| value.abs() > LEAST_SIZE_IN_SDS * sd)
}

/// The candidate to take, of candidates in the order of their gains: the first, unless another gains about as much that it yields to.
fn preferred(candidates: &[(Fit, f64)]) -> Option<usize> {
    let (first, gain) = candidates.first()?;
    let likelier =
        |(other, own): &(Fit, f64)| *own > (1.0 - ALIKE) * gain && added(first).yields_to.contains(&added(other).name);
    Some(candidates.iter().position(likelier).unwrap_or(0))
}

/// What a fit leaves of the bend, rad².
fn bend_squares(problem: &Problem, fit: &Fit) -> f64 {
    let known = problem.noise.unknown_start..problem.data.len();
    known.map(|k| problem.bend_gap(&fit.residuals, k).norm_squared()).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_are_compared_one_by_one_and_the_total_is_the_mean_of_both_partitions() {
        let costs = |blocks: [f64; 3]| HeldOutCosts { interleaved: vec![6.0, 4.0], blocks: blocks.to_vec() };
        assert_eq!(costs([5.0, 6.0, 9.0]).total(), 15.0);
        assert!(costs([5.0, 6.0, 8.0]).is_better_in_every_block(&costs([6.0, 6.0, 8.5])));
        assert!(!costs([5.0, 6.0, 9.0]).is_better_in_every_block(&costs([9.0, 9.0, 8.0])));
    }
}
