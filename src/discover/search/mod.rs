//! The search for the structure (set of effects) of the highest score: the logarithm of its held-out
//! [predictive density](super::predictive_density), and what physics expects beforehand.
//!
//! It is made first beside noise alone, where every effect is as unlikely as any other: a machine that lies in the library is explained by one to three
//! of them, and what they leave is noise. Where they leave more, it is made again beside a discrepancy, where some effects are expected
//! ([`Physics::log_prior`]): no model of a machine knows its gain and its bend at rest exactly. There it begins with both.
//!
//! The search adds the effect that raises the score most as long as one is asked for, drops what is not asked for beside the rest, and puts another effect
//! in the place of one where that is better. An effect is asked for where the structure with it is probably better, over a bootstrap of the stretches.
//! Beside a discrepancy it is also told by its own standard deviation: what no library has may look like two large effects that cancel each other, of which
//! the data tell neither.
//! Every structure whose score counts is a converged fit.

mod evidence;
mod scored;

pub use evidence::{Evidence, Named};

use super::fit::Fit;
use super::hypotheses::{Hypothesis, has, hypotheses};
use super::posterior::Candidate;
use super::predictive_density::{Beside, Judged};
use super::residuals::Problem;
use super::structure::mean_square_quantile;
use crate::robot::effects::{COMMAND_GAIN, Effect, REST_BEND, physics};
use crate::robot::{Model, Physics};
use nalgebra::Vector2;
use rayon::prelude::*;
use scored::Structure;
use tracing::debug;

/// The most effects beside noise, and beside a discrepancy.
///
/// Convention: a bound on computing time.
const MOST_EFFECTS: [usize; 2] = [3, 8];

/// Single effects that the search beside noise goes on from.
///
/// Convention: a bound on computing time.
const BEAM_WIDTH: usize = 3;

/// Where the best of the beam leaves squares of so many times the noise's, neither the rest of the beam nor an exchange of effects is tried beside noise.
///
/// Convention: a bound on computing time; an rms of five times the noise is no effect taken for one that looks alike.
const HOPELESS: f64 = 30.0;

/// Hypotheses of each step that are fitted to convergence.
///
/// Convention: a bound on computing time.
const FITTED: usize = 8;

/// Fits of one effect among them, each in another form.
///
/// Convention: a bound on computing time; half of them are of other effects.
const FITTED_OF_ONE: usize = FITTED / 2;

/// Beside a discrepancy an effect takes at least this share of the gap beyond noise away, on stretches that it was not fitted to.
///
/// Convention: a hundredth of the rms; what takes less is hardly worth a name, and imitates what no effect explains.
const LEAST_REMOVED: f64 = 0.02;

/// What no model of a machine knows exactly.
const FRAME: [&str; 2] = [REST_BEND, COMMAND_GAIN];

/// What has a smaller share of the probability of another is ruled out beside it.
///
/// Convention: the usual level of 5 %.
pub const OPEN: f64 = 0.05;

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
    /// The answer's score.
    pub score: f64,
}

/// The structure of the highest score that a search from the model as given comes to; `before` is its fit.
pub fn search<'a>(problem: &Problem<'a>, before: &Fit, beside: Beside) -> Found<'a> {
    Search::new(problem, before, beside).found()
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
    /// What one effect more brought to the structures that were gone on from.
    gone_on_from: Vec<(Vec<&'static Physics>, Vec<Structure>)>,
}

impl<'a> Search<'a> {
    fn new(problem: &Problem<'a>, before: &Fit, beside: Beside) -> Self {
        Self {
            problem: problem.clone(),
            judged: Judged::new(problem, before, beside),
            before: before.clone(),
            beside,
            gap: 0.0,
            scored: Vec::new(),
            gone_on_from: Vec::new(),
        }
    }

    fn found(mut self) -> Found<'a> {
        let Some(bare) = self.structure(self.before.clone()) else {
            let score = f64::NEG_INFINITY;
            return Found { problem: self.problem, fit: self.before, named: Vec::new(), structures: Vec::new(), score };
        };
        self.gap = bare.squares - self.judged.noise_squares(&self.problem);
        let mut best = match self.beside {
            Beside::Noise => {
                let best = self.best_of_beam(&bare);
                let is_hopeless = best.squares > HOPELESS * self.judged.noise_squares(&self.problem);
                if is_hopeless { best } else { self.settled(best) }
            }
            Beside::Discrepancy => {
                let framed = self.with_frame().unwrap_or_else(|| bare.clone());
                let grown = self.grown(framed);
                self.settled(grown)
            }
        };
        let is_better = match self.beside {
            Beside::Noise => best.excess_over(&bare) > 0.0,
            // The whole answer must be clear, also where each part of it is expected: a gain of nothing would be named. Both are scored under the
            // discrepancy that the answer leaves.
            Beside::Discrepancy => {
                let fit = self.problem.fit(&bare.fit.model, Some(&bare.fit.path), None);
                self.scored(fit).is_none_or(|bare| best.is_clear_beside(&bare))
            }
        };
        if !is_better {
            best = bare.clone();
        }
        let named = (self.given()..best.fit.model.effects.len()).map(|k| self.describe(&best, &bare, k)).collect();
        // What the answer leaves belongs to the noise of its numbers.
        let noise = self.problem.noise.with_discrepancy(&self.problem, &best.fit);
        let problem = Problem::new(self.problem.data, &noise, &best.fit.model);
        let fit = problem.fit(&best.fit.model, Some(&best.fit.path), None);
        Found { structures: self.open(), problem, fit, named, score: best.score() }
    }

    /// The best of the structures that the likeliest single effects lead to. Where one of them leaves no more than noise, the others are not gone on from: they come
    /// at best to its equal, with an effect more. Nor are they where it is [`HOPELESS`].
    fn best_of_beam(&mut self, bare: &Structure) -> Structure {
        let noise = self.judged.noise_squares(&self.problem);
        let mut best = bare.clone();
        for first in self.with_one_more(bare, &bare.fit).into_iter().take(BEAM_WIDTH) {
            let grown = self.grown(first);
            if grown.score() > best.score() {
                best = grown;
            }
            let is_noise = best.squares < noise * mean_square_quantile(self.problem.data.residual_count() as f64);
            if is_noise || best.squares > HOPELESS * noise {
                break;
            }
        }
        best
    }

    /// A structure with what is asked for beside it.
    fn grown(&mut self, mut best: Structure) -> Structure {
        while best.fit.model.effects.len() < self.given() + MOST_EFFECTS[self.beside as usize] {
            let Some(better) = self.with_one_more(&best, &best.fit).into_iter().next() else {
                break;
            };
            best = self.under_its_own_discrepancy(better);
        }
        best
    }

    /// Whether what a structure has beyond a simpler one is asked for.
    fn asks_for(&self, structure: &Structure, simpler: &Structure) -> bool {
        let is_asked_to_remove = self.beside == Beside::Discrepancy && !structure.adds_frame_alone(simpler);
        let least = if is_asked_to_remove { LEAST_REMOVED * self.gap } else { f64::NEG_INFINITY };
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

    /// What is not asked for beside the rest dropped, and beside noise another effect put in the place of one where that is better. Beside a discrepancy all
    /// that could take the place of a hysteresis was compared with it when it was found.
    fn settled(&mut self, mut best: Structure) -> Structure {
        for _ in 0..2 * MOST_EFFECTS[self.beside as usize] {
            let effects = self.given()..best.fit.model.effects.len();
            let simpler = effects.map(|k| (best.fit.model.without_effect(k), best.fit.path.clone())).collect();
            let others = self.structures(simpler);
            let untold = self.untold(&best);
            let is_asked_for = |simpler: &Structure| {
                untold.iter().all(|name| simpler.weighed.has(name)) && self.asks_for(&best, simpler)
            };
            let not_asked = others.iter().filter(|simpler| !simpler.is_at_end && !is_asked_for(simpler));
            if let Some(simpler) = not_asked.min_by(|a, b| best.excess_over(a).total_cmp(&best.excess_over(b))) {
                best = simpler.clone();
                continue;
            }
            if self.beside == Beside::Discrepancy {
                break;
            }
            let other = others.iter().filter_map(|without| self.exchanged(&best, without));
            let other = other.max_by(|a, b| a.score().total_cmp(&b.score()));
            let Some(other) = other.filter(|other| other.takes_the_place_of(&best)) else { break };
            best = other;
        }
        best
    }

    /// The best with another effect in the place of the one that `without` lacks of `best`. The fits begin with the other effects as they are in `best`:
    /// without the one, they may have gone far.
    fn exchanged(&mut self, best: &Structure, without: &Structure) -> Option<Structure> {
        let is_lacking = |&k: &usize| !without.weighed.has(best.fit.model.effects[k].physics.name);
        let lacking = (self.given()..best.fit.model.effects.len()).find(is_lacking)?;
        let from = self.problem.evaluated(&best.fit.model.without_effect(lacking), Some(&best.fit.path));
        self.with_one_more(without, &from).into_iter().next()
    }

    /// The structures with one effect more that is asked for beside `best`, the best first, one for each name: of its forms the best, unless a plainer
    /// one is about as good. What was gone on from once is not gone on from again.
    fn with_one_more(&mut self, best: &Structure, from: &Fit) -> Vec<Structure> {
        let key = best.effects();
        if let Some((_, to)) = self.gone_on_from.iter().find(|(from, _)| *from == key) {
            return to.clone();
        }
        let starts = self.promising(best, from);
        let mut asked = self.structures_of_best(starts);
        asked.retain(|more| self.asks_for(more, best));
        asked.sort_by(|a, b| b.score().total_cmp(&a.score()));
        let mut kept: Vec<Structure> = Vec::new();
        for more in asked {
            match kept.iter_mut().find(|own| own.last_name() == more.last_name()) {
                None => kept.push(more),
                Some(richer) if richer.is_richer_form_of(&more) && richer.excess_over(&more) <= 0.0 => *richer = more,
                Some(_) => (),
            }
        }
        let names = |of: &Structure| of.weighed.effects.iter().map(|physics| physics.name).collect::<Vec<_>>();
        debug!(from = ?names(best), score = best.score(), to = ?kept.iter().map(|more| (more.last_name(), more.score())).collect::<Vec<_>>(), "gone on");
        self.gone_on_from.push((key, kept.clone()));
        kept
    }

    /// The starts beside the model of `from` that a linear step about them scores highest, and does not rule out beside `best`.
    fn promising(&self, best: &Structure, from: &Fit) -> Vec<(Model, Vec<Vector2<f64>>)> {
        let half_mm = self.judged.half_range * self.before.model.robot.backbone_circle_radius_mm;
        let hypotheses = hypotheses(&self.problem, from, (self.beside, half_mm), |_| true);
        let path = self.problem.linearised(&from.model, &from.path);
        let promised = hypotheses.into_par_iter().filter_map(|hypothesis| {
            let hypothesis = self.in_the_place_of_what_it_includes(hypothesis);
            let score = self.promised((from, &path), &hypothesis)? + self.log_prior(&hypothesis.start);
            (score > best.score() + OPEN.ln()).then_some((score, hypothesis))
        });
        let mut promised: Vec<(f64, Hypothesis)> = promised.collect();
        promised.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut chosen: Vec<Hypothesis> = Vec::new();
        for (_, hypothesis) in promised {
            let has_form = chosen.iter().any(|other| other.physics == hypothesis.physics);
            let of_its_name = chosen.iter().filter(|other| other.physics.name == hypothesis.physics.name).count();
            if chosen.len() < FITTED && !has_form && of_its_name < FITTED_OF_ONE {
                chosen.push(hypothesis);
            }
        }
        chosen.into_iter().map(|hypothesis| (hypothesis.start, from.path.clone())).collect()
    }

    /// A hypothesis beside a discrepancy without the effects that it tells of as well.
    fn in_the_place_of_what_it_includes(&self, Hypothesis { physics, mut start }: Hypothesis) -> Hypothesis {
        let is_included = |effect: &Effect| physics.includes.contains(&effect.physics.name);
        if self.beside == Beside::Discrepancy {
            while let Some(k) = (self.given()..start.effects.len()).find(|&k| is_included(&start.effects[k])) {
                start = start.without_effect(k);
            }
        }
        Hypothesis { physics, start }
    }

    fn given(&self) -> usize {
        self.before.model.effects.len()
    }
}
