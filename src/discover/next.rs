//! The next experiment: the ride on which what these data cannot tell apart would differ most.
//!
//! Optimal discrimination over a few candidate rides: each rival is fitted to noise-free data of the other along the ride, with η,
//! λ and its own parameters free, and what it cannot follow, in squares of the noise, is the noncentrality of the test
//! between them. The ride wins on which the least of all the questions' noncentralities per sample is largest.

use super::data::Data;
use super::fit::Problem;
use super::plans::{Plan, plans, repeated};
use super::search::{Named, with_effect};
use super::verdict::{Discovery, Verdict};
use crate::observation::{Measured, Measurement, Status, Waypoint};
use crate::robot::effects::{Confounded, Poses, physics};
use crate::robot::{Effect, LIBRARY, Model, PerBackbone, Physics};
use crate::simulate::Plant;
use rayon::prelude::*;
use serde_json::{Value, json};
use std::f64::consts::PI;

/// The noncentrality that decides: Schwarz's criterion then differs by more than 12 in all but one experiment in 200.
const DECIDES: f64 = 50.0;
/// The most times that a ride is repeated to get there.
const MOST_REPEATS: usize = 4;

/// Rivals of one effect that are asked about.
const MOST_RIVALS: usize = 5;
/// A rival that leaves less than so many squares of the noise more fits as well.
const FITS_AS_WELL: f64 = 6.0;

/// What is to be told apart.
#[derive(Debug, Clone)]
struct Question {
    words: String,
    asks: Asks,
}

#[derive(Debug, Clone)]
enum Asks {
    /// Which of two models holds.
    Which([Box<Model>; 2]),
    /// Whether an effect of the size that matters is there; it is the last of the model's.
    Whether(Box<Model>),
    /// The value of a parameter of the model: effect, parameter.
    Value(Box<Model>, usize, usize),
}

/// The proposed experiment.
#[derive(Debug, Clone)]
pub struct Next {
    /// What these data leave open and the ride would settle, in sentences.
    pub because: Vec<String>,
    /// What is open and no candidate would settle, in words.
    pub beyond_reach: Vec<String>,
    /// The ride's name, and what it brings out.
    pub plan: (&'static str, &'static str),
    /// The poses.
    pub waypoints: Vec<Waypoint>,
    /// The q̃ that the model as found would command at each, mm.
    pub commands_mm: Vec<PerBackbone>,
    /// By how many squares of the noise the wrong answer to the hardest question is expected to miss.
    pub noncentrality: f64,
    /// The candidates, with the least noncentrality per sample of each; the best first.
    pub candidates: Vec<(&'static str, f64)>,
}

/// Proposes the next experiment; none where nothing is open that a ride could settle.
pub fn next_experiment(found: &Discovery, data: &Data) -> Option<Next> {
    let eye = Eye::of(data);
    let own: Vec<Waypoint> = (0..data.len())
        .map(|k| Waypoint { time_s: data.times_s[k], configuration: data.measured[k].configuration })
        .collect();
    let mut questions = rivals(found, data);
    questions.extend(values(found));
    let blind = unseen(found);
    let seen = |question: &Question| eye.noncentrality(question, &own) >= DECIDES;
    questions.extend(blind.into_par_iter().filter(|question| !seen(question)).collect::<Vec<_>>());
    if data.one_plane {
        questions.extend(alike_on_one_plane(&found.model));
    }
    if questions.is_empty() {
        return None;
    }

    let plans = plans(data);
    let work: Vec<(usize, usize)> = (0..plans.len()).flat_map(|p| (0..questions.len()).map(move |q| (p, q))).collect();
    let gains: Vec<f64> =
        work.par_iter().map(|&(p, q)| eye.noncentrality(&questions[q], &plans[p].waypoints)).collect();
    let gain = |p: usize, q: usize| gains[p * questions.len() + q];
    let settles = |p: usize, q: usize| gain(p, q) * MOST_REPEATS as f64 >= DECIDES;
    let (within, beyond): (Vec<usize>, Vec<usize>) =
        (0..questions.len()).partition(|&q| (0..plans.len()).any(|p| settles(p, q)));
    // The ride that settles the most questions; among those the one that does it with the fewest samples.
    let merit = |p: usize| {
        let settled: Vec<f64> = within.iter().filter(|&&q| settles(p, q)).map(|&q| gain(p, q)).collect();
        (settled.len(), settled.into_iter().fold(f64::INFINITY, f64::min) / plans[p].waypoints.len() as f64)
    };
    let mut order: Vec<(usize, (usize, f64))> = (0..plans.len()).map(|p| (p, merit(p))).collect();
    order.sort_by(|a, b| b.1.0.cmp(&a.1.0).then(b.1.1.total_cmp(&a.1.1)));
    let (best, (settled, per_sample)) = *order.first()?;
    if settled == 0 {
        return None;
    }
    let Plan { name, words, waypoints } = &plans[best];
    let once = per_sample * waypoints.len() as f64;
    let repeats = ((DECIDES / once).ceil() as usize).clamp(1, MOST_REPEATS);
    let waypoints = repeated(waypoints, repeats);
    let samples = Plant { model: found.model.clone(), sd_encoder_mm: 0.0 }.run(&waypoints, 0);
    let words_of = |q: &usize| questions[*q].words.clone();
    Some(Next {
        because: within.iter().filter(|q| settles(best, **q)).map(words_of).collect(),
        beyond_reach: beyond.iter().chain(within.iter().filter(|q| !settles(best, **q))).map(words_of).collect(),
        plan: (*name, *words),
        commands_mm: samples.iter().map(|sample| sample.reading.q_mm).collect(),
        waypoints,
        noncentrality: once * repeats as f64,
        candidates: order.iter().map(|&(p, (_, per_sample))| (plans[p].name, finite(per_sample))).collect(),
    })
}

fn finite(value: f64) -> f64 {
    if value.is_finite() { value } else { 0.0 }
}

/// Each effect found against everything that the data cannot tell it from, fitted to them.
fn rivals(found: &Discovery, data: &Data) -> Vec<Question> {
    if found.verdict != Verdict::Named {
        return Vec::new();
    }
    let problem = Problem::new(data, &found.model);
    let given = found.model.effects.len().saturating_sub(found.named.len());
    let pairs: Vec<(usize, &str)> = found
        .named
        .iter()
        .enumerate()
        .flat_map(|(k, named)| {
            open_rivals(named, &found.model, data.len()).into_iter().map(move |rival| (given + k, rival))
        })
        .collect();
    let question = |(k, rival): (usize, &str)| {
        let physics = physics(rival)?;
        let without = problem.fit(&found.model.without_effect(k), None, None);
        let other = with_effect(&problem, &without, physics).model;
        let words =
            format!("{} and {rival} explain these data about equally well", found.model.effects[k].physics.name);
        Some(Question { words, asks: Asks::Which([Box::new(found.model.clone()), Box::new(other)]) })
    };
    pairs.into_par_iter().filter_map(question).collect()
}

/// The rivals that were not ruled out, and those that only their number of parameters rules out: what is simpler is likelier, but
/// a ride may show otherwise.
fn open_rivals(named: &Named, model: &Model, samples: usize) -> Vec<&'static str> {
    let backbones = model.robot.backbone_count();
    let parameters = |physics: &Physics| (physics.parameters)(backbones).len() as f64;
    let fits_as_well = |&&(rival, worse): &&(&'static str, f64)| {
        let more = physics(rival).map_or(0.0, parameters) - parameters(named.physics);
        worse - more.max(0.0) * ((backbones * samples) as f64).ln() < FITS_AS_WELL
    };
    let mut open = named.indistinguishable_from.clone();
    open.extend(named.rivals.iter().filter(fits_as_well).map(|(rival, _)| *rival));
    open.sort_unstable();
    open.dedup();
    open.truncate(MOST_RIVALS);
    open
}

/// Parameters found whose sd is more than a third of the size that matters.
fn values(found: &Discovery) -> Vec<Question> {
    let mut questions = Vec::new();
    for (k, effect) in found.model.effects.iter().enumerate() {
        for (j, (spec, sd)) in effect.parameters().iter().zip(&found.model.effect_sds(k)).enumerate() {
            if sd / spec.typical > 1.0 / 3.0 && *sd > 0.1 * effect.values[j].abs() {
                let words = format!(
                    "the data hardly pin {} of {}: {:.3} ± {sd:.3} {}",
                    spec.name, effect.physics.name, effect.values[j], spec.unit
                );
                questions.push(Question { words, asks: Asks::Value(Box::new(found.model.clone()), k, j) });
            }
        }
    }
    questions
}

/// Every effect that neither the model has nor another question is about, at a size that matters.
fn unseen(found: &Discovery) -> Vec<Question> {
    let model = &found.model;
    let asked = |physics: &Physics| {
        found.named.iter().any(|named| open_rivals(named, model, found.samples).contains(&physics.name))
    };
    let question = |physics: &'static Physics| {
        let words = format!("{} could hide in these data", physics.name);
        Some(Question { words, asks: Asks::Whether(Box::new(with_typical(model, physics)?)) })
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
        Some(Question { words, asks: Asks::Which(models.map(Box::new)) })
    };
    pairs.filter_map(question).collect()
}

/// The model with an effect of the size that matters besides; none where it has the effect.
fn with_typical(model: &Model, physics: &'static Physics) -> Option<Model> {
    let effect = Effect::of(physics, physics.example(model.robot.backbone_count()));
    let absent = model.effects.iter().all(|effect| effect.physics != physics);
    absent.then(|| Model { effects: [&model.effects[..], &[effect]].concat(), ..model.clone() })
}

/// The eye and the encoders that made the data, as another experiment would have them.
struct Eye {
    sigma_theta: f64,
    /// σ across the bend: σ_δ is this over sin θ.
    sigma_across: f64,
    sd_encoder_mm: f64,
}

impl Eye {
    fn of(data: &Data) -> Self {
        let median = |mut values: Vec<f64>| {
            values.sort_by(f64::total_cmp);
            values.get(values.len() / 2).copied()
        };
        let bent = data.measured.iter().filter(|m| m.configuration.theta > 0.2);
        let across = bent.map(|m| m.sigma_delta * m.configuration.theta.sin().abs()).collect();
        let along = data.measured.iter().map(|m| m.sigma_theta).collect();
        Self {
            sigma_theta: median(along).unwrap_or(0.002),
            sigma_across: median(across).unwrap_or(0.004),
            sd_encoder_mm: data.sd_encoder_mm,
        }
    }

    /// By how many squares of the noise the wrong answer misses what the right one predicts along a ride.
    fn noncentrality(&self, question: &Question, waypoints: &[Waypoint]) -> f64 {
        match &question.asks {
            Asks::Which([a, b]) => self.miss(a, b, waypoints).min(self.miss(b, a, waypoints)),
            Asks::Whether(with) => {
                let mut without = with.as_ref().clone();
                without.effects.pop();
                self.miss(with, &without, waypoints)
            }
            // That of a change of the parameter by the size that matters.
            Asks::Value(model, k, j) => {
                let Some(data) = self.data(model, waypoints) else { return 0.0 };
                let problem = Problem::new(&data, model);
                let fitted = problem.with_covariance(&problem.fit(model, None, None));
                let (sd, typical) = (fitted.effect_sds(*k)[*j], model.effects[*k].parameters()[*j].typical);
                if sd > 0.0 { (typical / sd).powi(2) } else { 0.0 }
            }
        }
    }

    /// What is left, in squares of the noise, when `rival` is fitted to what `truth` does.
    fn miss(&self, truth: &Model, rival: &Model, waypoints: &[Waypoint]) -> f64 {
        let Some(data) = self.data(truth, waypoints) else { return 0.0 };
        let cost = |model: &Model| Problem::new(&data, model).fit(model, None, None).cost;
        (cost(rival) - cost(truth)).max(0.0)
    }

    /// What a ride would give without noise, with the sigmas that noise would have.
    fn data(&self, truth: &Model, waypoints: &[Waypoint]) -> Option<Data> {
        let samples = Plant { model: truth.clone(), sd_encoder_mm: 0.0 }.run(waypoints, 0);
        let measurement = |sample: &crate::simulate::Sample| {
            let sine = sample.apparent.theta.sin().abs().max(1e-3);
            let measured = Measured {
                configuration: sample.apparent,
                sigma_theta: self.sigma_theta,
                sigma_delta: (self.sigma_across / sine).min(PI),
                correlation: 0.0,
            };
            Measurement {
                index: sample.reading.index,
                time_s: Some(sample.reading.time_s),
                status: Status::Ok,
                measured: Some(measured),
                quality: None,
                view: None,
            }
        };
        let measurements: Vec<_> = samples.iter().map(measurement).collect();
        let readings: Vec<_> = samples.iter().map(|sample| sample.reading).collect();
        Data::new(&measurements, &readings, self.sd_encoder_mm).ok()
    }
}

impl Next {
    /// Why, and what to do, in words.
    pub fn sentence(&self) -> String {
        let last = self.waypoints.last().map_or(0.0, |waypoint| waypoint.time_s);
        format!(
            "Open: {}. The next experiment: {} ({} poses in {last:.0} s). There the wrong answer would leave about {:.0} more in \
             squares of the noise than the right one; {DECIDES:.0} are enough to tell.",
            self.because.join("; "),
            self.plan.1,
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
            "plan": self.plan.0,
            "why": self.plan.1,
            "words": self.sentence(),
            "poses": self.waypoints.len(),
            "seconds": self.waypoints.last().map(|waypoint| waypoint.time_s),
            "noncentrality": self.noncentrality,
            "candidates": candidates,
        })
    }
}
