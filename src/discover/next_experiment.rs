//! The next experiment: the trajectory on which the explanations that these data leave open would differ most.
//!
//! Optimal discrimination between models (A. C. Atkinson and V. V. Fedorov 1975, Biometrika 62:57) over a few candidates: each
//! alternative is fitted to noise-free data of the other along a candidate, with η, λ and its own parameters free. What it cannot
//! follow, in squares of the noise, is the noncentrality of the test between them. The trajectory that decides the most questions
//! wins, and among those the one with the largest least noncentrality per sample.

use super::candidate_trajectories::{CandidateTrajectory, candidate_trajectories, repeated, thinned};
use super::data::Data;
use super::discovery::Discovery;
use super::hypotheses::{Hypothesis, best_with};
use super::noise::Noise;
use super::residuals::Problem;
use super::search::Named;
use super::verdict::Verdict;
use crate::observation::{EncoderReading, Measured, Measurement, Status, Waypoint};
use crate::robot::effects::{Confounded, Poses, physics};
use crate::robot::{LIBRARY, Mechanics, Model, Observation, PerBackbone, Physics};
use crate::statistics::order::median;
use rayon::prelude::*;
use serde_json::{Value, json};
use std::f64::consts::PI;

/// An alternative whose criterion is higher by less than this is not ruled out.
///
/// Source: Kass and Raftery 1995, Bayes Factors, J. Am. Stat. Assoc. 90:773: 2 ln B above 6 is strong evidence.
const NOT_RULED_OUT: f64 = 6.0;

/// The noncentrality that decides.
///
/// Derived: with noncentrality c the costs of the wrong and the right model differ by c ± 2√c. From 50 on the difference exceeds
/// [`NOT_RULED_OUT`] in all but one experiment in a thousand.
const DECISIVE: f64 = 50.0;

/// The most times that a trajectory is repeated to get there.
///
/// Convention: what a laboratory would do.
const MOST_REPEATS: usize = 4;

/// Alternatives of one effect that are asked about.
///
/// Convention: a bound on computing time.
const MOST_ALTERNATIVES: usize = 5;

/// A parameter is asked about where its standard deviation is above this share of its typical size and of its value.
///
/// Convention: a choice of what is worth an experiment.
const UNCERTAIN: (f64, f64) = (1.0 / 3.0, 0.1);

/// The bend from which σ_δ shows the camera's noise across the bend, rad.
///
/// Convention: below it σ_δ says little about the camera.
const BENT: f64 = 0.2;

/// The noise of the camera where no sample is bent that far, rad: σ_θ, and σ across the bend.
///
/// Convention: that of the simulated eye.
const USUAL_SIGMAS: (f64, f64) = (0.002, 0.004);

/// The sine of the bend below which σ_δ does not grow further.
///
/// Convention: a numerical guard.
const LEAST_SINE: f64 = 1e-3;

/// What the data leave open.
#[derive(Debug, Clone)]
struct Question {
    words: String,
    about: About,
}

#[derive(Debug, Clone)]
enum About {
    /// Discrimination: which of two models holds.
    Models([Box<Model>; 2]),
    /// Detection: whether the last effect of the model is there.
    LastEffect(Box<Model>),
    /// Estimation: the value of a parameter of the model, by effect and parameter.
    Parameter(Box<Model>, usize, usize),
}

/// The proposed experiment.
#[derive(Debug, Clone)]
pub struct NextExperiment {
    /// What these data leave open and the trajectory would decide, in sentences.
    pub because: Vec<String>,
    /// What is open and no candidate would decide, in words.
    pub beyond_reach: Vec<String>,
    /// The trajectory's name, and what it shows.
    pub trajectory: (&'static str, &'static str),
    /// The poses.
    pub waypoints: Vec<Waypoint>,
    /// The q̃ that the model as found would command at each, mm.
    pub commands_mm: Vec<PerBackbone>,
    /// By how many squares of the noise the wrong answer to the hardest question is expected to miss.
    pub noncentrality: f64,
    /// The candidates, with the least noncentrality per sample of each; the best first.
    pub candidates: Vec<(&'static str, f64)>,
}

/// Proposes the next experiment of so many poses at most, if that is bounded; none where nothing is open that a candidate could decide.
pub fn next_experiment(found: &Discovery, data: &Data, poses: Option<usize>) -> Option<NextExperiment> {
    let noise = ExpectedNoise::of(data);
    let questions = questions(found, data, &noise);
    let mut candidates = candidate_trajectories(data);
    if let Some(most) = poses {
        candidates.iter_mut().for_each(|candidate| candidate.waypoints = thinned(&candidate.waypoints, most));
    }
    let table = Table::new(&questions, &candidates, poses, &noise);
    let (best, per_sample) = table.best()?;
    let CandidateTrajectory { name, words, waypoints } = &candidates[best];
    let once = per_sample * waypoints.len() as f64;
    let repeats = ((DECISIVE / once).ceil() as usize).clamp(1, table.most_repeats(best));
    let waypoints = repeated(waypoints, repeats);
    let (decided, open): (Vec<usize>, Vec<usize>) = (0..questions.len()).partition(|&q| table.decides(best, q));
    let words_of = |of: Vec<usize>| of.into_iter().map(|q| questions[q].words.clone()).collect();
    Some(NextExperiment {
        because: words_of(decided),
        beyond_reach: words_of(open),
        trajectory: (name, words),
        commands_mm: observations(&found.model, &waypoints).iter().map(|observation| observation.q_mm).collect(),
        waypoints,
        noncentrality: once * repeats as f64,
        candidates: table.ranked().into_iter().map(|(c, _, per_sample)| (candidates[c].name, per_sample)).collect(),
    })
}

/// The noncentrality of every question on every candidate.
struct Table<'a> {
    candidates: &'a [CandidateTrajectory],
    /// The most poses, if they are bounded.
    poses: Option<usize>,
    /// By candidate, then by question.
    noncentrality: Vec<Vec<f64>>,
}

impl<'a> Table<'a> {
    fn new(
        questions: &[Question],
        candidates: &'a [CandidateTrajectory],
        poses: Option<usize>,
        noise: &ExpectedNoise,
    ) -> Self {
        let of = |candidate: &CandidateTrajectory| {
            questions.par_iter().map(|question| noise.noncentrality(question, &candidate.waypoints)).collect()
        };
        Self { candidates, poses, noncentrality: candidates.par_iter().map(of).collect() }
    }

    /// The most times that a candidate may be repeated.
    fn most_repeats(&self, candidate: usize) -> usize {
        let own = self.candidates[candidate].waypoints.len().max(1);
        self.poses.map_or(MOST_REPEATS, |most| (most / own).clamp(1, MOST_REPEATS))
    }

    /// Whether a candidate decides a question, repeated if need be.
    fn decides(&self, candidate: usize, question: usize) -> bool {
        self.noncentrality[candidate][question] * self.most_repeats(candidate) as f64 >= DECISIVE
    }

    /// Each candidate with the number of questions that it decides and the least noncentrality per sample among those (0 where it
    /// decides none); the best first.
    fn ranked(&self) -> Vec<(usize, usize, f64)> {
        let rank = |candidate: usize| {
            let all = &self.noncentrality[candidate];
            let decided: Vec<f64> = (0..all.len()).filter(|&q| self.decides(candidate, q)).map(|q| all[q]).collect();
            let least = decided.iter().copied().fold(f64::INFINITY, f64::min);
            let samples = self.candidates[candidate].waypoints.len() as f64;
            (candidate, decided.len(), if decided.is_empty() { 0.0 } else { least / samples })
        };
        let mut ranked: Vec<(usize, usize, f64)> = (0..self.candidates.len()).map(rank).collect();
        ranked.sort_by(|a, b| b.1.cmp(&a.1).then(b.2.total_cmp(&a.2)));
        ranked
    }

    /// The best candidate and its least noncentrality per sample; none where no question is decided.
    fn best(&self) -> Option<(usize, f64)> {
        self.ranked().first().filter(|(_, decided, _)| *decided > 0).map(|&(candidate, _, least)| (candidate, least))
    }
}

/// Everything that the data leave open.
fn questions(found: &Discovery, data: &Data, noise: &ExpectedNoise) -> Vec<Question> {
    let own: Vec<Waypoint> =
        (0..data.len()).map(|k| Waypoint::new(data.times_s[k], data.measured[k].configuration)).collect();
    let mut questions = alternatives(found, data);
    questions.extend(uncertain_parameters(found));
    let undetected = undetected(found).into_par_iter();
    let undetected: Vec<_> = undetected.filter(|question| noise.noncentrality(question, &own) < DECISIVE).collect();
    questions.extend(undetected);
    if data.one_plane {
        questions.extend(alike_on_one_plane(&found.model));
    }
    questions
}

/// Each effect found against each alternative that is not ruled out, fitted to the data.
fn alternatives(found: &Discovery, data: &Data) -> Vec<Question> {
    if found.verdict != Verdict::Named {
        return Vec::new();
    }
    let problem = Problem::new(data, &found.noise, &found.model);
    let given = found.given_effects();
    let pairs: Vec<(usize, &str)> = found
        .named
        .iter()
        .enumerate()
        .flat_map(|(k, named)| {
            open_alternatives(named, &found.model, data.len()).into_iter().map(move |other| (given + k, other))
        })
        .collect();
    let question = |(k, name): (usize, &str)| {
        let without = problem.fit(&found.model.without_effect(k), None, None);
        let other = best_with(&problem, &without, name).model;
        let words = format!("{} and {name} explain these data about equally well", found.model.effects[k].physics.name);
        Question { words, about: About::Models([Box::new(found.model.clone()), Box::new(other)]) }
    };
    pairs.into_par_iter().map(question).collect()
}

/// The alternatives that were not ruled out, and those that only their number of parameters rules out: what is simpler is
/// likelier, but an experiment may show otherwise.
fn open_alternatives(named: &Named, model: &Model, samples: usize) -> Vec<&'static str> {
    let backbones = model.robot.backbone_count();
    let parameters = |physics: &Physics| physics.parameters_on(backbones).len() as f64;
    let fits_as_well = |&&(name, worse): &&(&'static str, f64)| {
        let more = physics(name).map_or(0.0, parameters) - parameters(named.physics);
        worse - more.max(0.0) * ((backbones * samples) as f64).ln() < NOT_RULED_OUT
    };
    let mut open = named.indistinguishable_from.clone();
    open.extend(named.alternatives.iter().filter(fits_as_well).map(|(name, _)| *name));
    open.sort_unstable();
    open.dedup();
    open.truncate(MOST_ALTERNATIVES);
    open
}

/// Parameters of the model that are hardly determined.
fn uncertain_parameters(found: &Discovery) -> Vec<Question> {
    let mut questions = Vec::new();
    for (k, effect) in found.model.effects.iter().enumerate() {
        for (j, (spec, sd)) in effect.parameters().iter().zip(&found.model.effect_sds(k)).enumerate() {
            if *sd > UNCERTAIN.0 * spec.typical && *sd > UNCERTAIN.1 * effect.values[j].abs() {
                let words = format!(
                    "the data hardly determine {} of {}: {:.3} ± {sd:.3} {}",
                    spec.name, effect.physics.name, effect.values[j], spec.unit
                );
                questions.push(Question { words, about: About::Parameter(Box::new(found.model.clone()), k, j) });
            }
        }
    }
    questions
}

/// Every effect that neither the model has nor another question is about, at its typical size.
fn undetected(found: &Discovery) -> Vec<Question> {
    let model = &found.model;
    let asked = |physics: &Physics| {
        found.named.iter().any(|named| open_alternatives(named, model, found.samples).contains(&physics.name))
    };
    let question = |physics: &'static Physics| {
        let words = format!("{} of its usual size could be there unseen", physics.name);
        Some(Question { words, about: About::LastEffect(Box::new(with_typical(model, physics)?)) })
    };
    LIBRARY.into_iter().filter(|physics| physics.form.is_empty() && !asked(physics)).filter_map(question).collect()
}

/// The pairs of effects that are confounded as long as the bends keep to one plane.
fn alike_on_one_plane(model: &Model) -> Vec<Question> {
    let one = |physics: &'static Physics| physics.confounded_with.iter().map(move |other| (physics, other));
    let pairs = LIBRARY.into_iter().flat_map(one).filter(|(a, b)| b.on == Poses::OnePlane && a.name < b.with);
    let question = |(a, b): (&'static Physics, &Confounded)| {
        let words = format!("the bends lie in one plane, where {} and {} look alike", a.name, b.with);
        let models = [with_typical(model, a)?, with_typical(model, physics(b.with)?)?];
        Some(Question { words, about: About::Models(models.map(Box::new)) })
    };
    pairs.filter_map(question).collect()
}

/// The model with an effect of its typical size besides; none where it has the effect.
fn with_typical(model: &Model, physics: &'static Physics) -> Option<Model> {
    let absent = model.effects.iter().all(|effect| effect.physics != physics);
    absent.then(|| Hypothesis::new(model, physics, physics.example(model.robot.backbone_count())).start)
}

/// The noise of camera and encoders that another experiment would have: that of the one at hand.
struct ExpectedNoise {
    sigma_theta: f64,
    /// σ across the bend: σ_δ is this over sin θ.
    sigma_across: f64,
    sd_encoder_mm: f64,
}

impl ExpectedNoise {
    fn of(data: &Data) -> Self {
        let median_or = |mut values: Vec<f64>, usual: f64| if values.is_empty() { usual } else { median(&mut values) };
        let bent = data.measured.iter().filter(|m| m.configuration.theta > BENT);
        let across = bent.map(|m| m.sigma_delta * m.configuration.theta.sin().abs()).collect();
        let along = data.measured.iter().map(|m| m.sigma_theta).collect();
        Self {
            sigma_theta: median_or(along, USUAL_SIGMAS.0),
            sigma_across: median_or(across, USUAL_SIGMAS.1),
            sd_encoder_mm: data.sd_encoder_mm,
        }
    }

    /// By how many squares of the noise the wrong answer to a question misses what the right one predicts along a trajectory.
    fn noncentrality(&self, question: &Question, waypoints: &[Waypoint]) -> f64 {
        match &question.about {
            About::Models([a, b]) => self.misfit(a, b, waypoints).min(self.misfit(b, a, waypoints)),
            About::LastEffect(with) => {
                let without = with.without_effect(with.effects.len() - 1);
                self.misfit(with, &without, waypoints)
            }
            // Of a change of the parameter by its typical size.
            About::Parameter(model, k, j) => {
                let Some(data) = self.noise_free(model, waypoints) else { return 0.0 };
                let problem = Problem::new(&data, &Noise::stated(&data), model);
                let fitted = problem.with_covariance(&problem.fit(model, None, None));
                let (sd, typical) = (fitted.effect_sds(*k)[*j], model.effects[*k].parameters()[*j].typical);
                if sd > 0.0 { (typical / sd).powi(2) } else { 0.0 }
            }
        }
    }

    /// The squares that are left when `alternative` is fitted to what `truth` does.
    fn misfit(&self, truth: &Model, alternative: &Model, waypoints: &[Waypoint]) -> f64 {
        let Some(data) = self.noise_free(truth, waypoints) else { return 0.0 };
        let cost = |model: &Model| Problem::new(&data, &Noise::stated(&data), model).fit(model, None, None).cost;
        (cost(alternative) - cost(truth)).max(0.0)
    }

    /// What a trajectory would give without noise, with the sigmas that noise would have.
    fn noise_free(&self, truth: &Model, waypoints: &[Waypoint]) -> Option<Data> {
        let rows = observations(truth, waypoints).into_iter().enumerate().map(|(index, observation)| {
            let Observation { time_s, q_mm, configuration } = observation;
            let index = index as u64;
            let sine = configuration.theta.sin().abs().max(LEAST_SINE);
            let sigma_delta = (self.sigma_across / sine).min(PI);
            let measured = Measured::independent(configuration, self.sigma_theta, sigma_delta, 0.0);
            let measurement = Measurement {
                index,
                time_s: Some(time_s),
                status: Status::Ok,
                measured: Some(measured),
                quality: None,
                view: None,
            };
            (measurement, EncoderReading::new(index, time_s, q_mm))
        });
        let (measurements, readings): (Vec<_>, Vec<_>) = rows.unzip();
        Data::new(&measurements, &readings, self.sd_encoder_mm).ok()
    }
}

/// What noise-free instruments observe along a trajectory.
fn observations(model: &Model, waypoints: &[Waypoint]) -> Vec<Observation> {
    let bends: Vec<_> = waypoints.iter().map(|waypoint| waypoint.configuration.bend_vector()).collect();
    let times_s: Vec<f64> = waypoints.iter().map(|waypoint| waypoint.time_s).collect();
    Mechanics::new(model).observations(&times_s, &bends)
}

impl NextExperiment {
    /// Why, and what to do, in words.
    pub fn sentence(&self) -> String {
        let last = self.waypoints.last().map_or(0.0, |waypoint| waypoint.time_s);
        format!(
            "Open: {}. The next experiment: {} ({} poses in {last:.0} s). There the wrong answer would leave about {:.0} more in \
             squares of the noise than the right one; {DECISIVE:.0} are enough to tell.",
            self.because.join("; "),
            self.trajectory.1,
            self.waypoints.len(),
            self.noncentrality
        )
    }

    /// The entry `next` of discrepancy.json; `file` is the trajectory's name.
    pub fn json(&self, file: &str) -> Value {
        let candidates: Vec<_> = self
            .candidates
            .iter()
            .map(|(name, gain)| json!({"plan": name, "noncentrality_per_sample": gain}))
            .collect();
        json!({
            "file": file,
            "because": self.because,
            "beyond_reach": self.beyond_reach,
            "plan": self.trajectory.0,
            "why": self.trajectory.1,
            "words": self.sentence(),
            "poses": self.waypoints.len(),
            "seconds": self.waypoints.last().map(|waypoint| waypoint.time_s),
            "noncentrality": self.noncentrality,
            "candidates": candidates,
        })
    }
}
