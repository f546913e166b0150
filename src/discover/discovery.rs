//! `discover` as a whole, and what it gives.

use super::confounding::confounded;
use super::data::Data;
use super::fit::Fit;
use super::held_out::{Gap, HeldOutResiduals};
use super::noise::Noise;
use super::partial::Partial;
use super::posterior::{Candidate, covariance_between};
use super::predictive_density::Beside;
use super::residuals::Problem;
use super::search::{Found, Named, OPEN, search};
use super::structure::Structure;
use super::verdict::Verdict;
use crate::robot::effects::{Changes, RIG_ERROR};
use crate::robot::{Effect, Model, PerBackbone, Physics};
use tracing::{info, info_span};

/// A parameter whose standard deviation is beyond this many typical sizes is remarked.
///
/// Convention: decides about a remark only.
const UNDETERMINED_SIZES: f64 = 10.0;

/// A lag is one of whole rows if it differs from that by no more than this many standard deviations.
///
/// Convention: the usual limit.
const LAG_SDS: f64 = 3.0;

/// So many samples are searched before all are.
///
/// Convention: a bound on computing time; the usual experiments are searched whole at once.
const SEARCHED_FIRST: usize = 400;

/// What `discover` found.
#[derive(Debug, Clone)]
pub struct Discovery {
    /// The answer.
    pub verdict: Verdict,
    /// The effects, where the verdict is named or partly.
    pub named: Vec<Named>,
    /// The noise that was learned, with the discrepancy where more than noise is left.
    pub noise: Noise,
    /// The model: with the effects where they are named, else as given with η and λ at their best.
    pub model: Model,
    /// The structures that the data leave open, the most probable first; of a verdict `named` or `none`.
    pub structures: Vec<Candidate>,
    /// The gap before, on held-out sweeps.
    pub before: Gap,
    /// The gap after, on held-out sweeps.
    pub after: Gap,
    /// The rms of ε that noise alone leaves, mm.
    pub noise_floor_mm: f64,
    /// The structure of the residuals before.
    pub structure_before: Structure,
    /// Their structure after.
    pub structure_after: Structure,
    /// Gap of ε at every sample before and after, mm, on held-out sweeps.
    pub residuals_mm: Vec<[PerBackbone; 2]>,
    /// Samples used.
    pub samples: usize,
    /// What was passed over or could not be decided.
    pub remarks: Vec<String>,
}

impl Discovery {
    /// The number of the model's effects that were given with it; those that were found come after them.
    pub fn given_effects(&self) -> usize {
        self.model.effects.len().saturating_sub(self.named.len())
    }
}

/// What is told in which stage a discovery is, in words.
pub type Tell<'a> = &'a dyn Fn(&'static str);

/// Compares what a model predicts with what was measured, and names what is missing.
pub fn discover(model: &Model, data: &Data) -> Discovery {
    discover_telling(model, data, &|_| ())
}

/// [`discover`], telling each stage.
pub fn discover_telling(model: &Model, data: &Data, tell: Tell) -> Discovery {
    let _stage = info_span!("discover", samples = data.len()).entered();
    let tell: Tell = &|stage| {
        info!("{stage}");
        tell(stage);
    };
    // η = 1, λ = 0 where nothing was estimated, so that there is something to fit.
    let model = Model { samples: Some(0), ..model.clone() };
    let driven = Data { is_driven: true, ..data.clone() };
    let [few, few_driven] = [data, &driven].map(|data| data.thinned(SEARCHED_FIRST));
    let (searched, is_driven) = Searched::likeliest(&model, [(data, &few), (&driven, &few_driven)], tell);
    let (Judged { verdict, structure_before, held_out_before: before, answer }, structures) =
        searched.answered(data, tell);
    info!(verdict = verdict.word(), effects = ?answer.named.iter().map(|named| named.physics.name).collect::<Vec<_>>(), "answered");
    let fitted = with_origin(answer.model, data);
    let remarks = data
        .remarks
        .iter()
        .cloned()
        .chain(is_driven.then(|| DRIVEN.to_owned()))
        .chain(about_start(&answer.noise, data))
        .chain(about_correlated_noise(&answer.structure, &answer.held_out.gap, data))
        .chain(about_lag(&fitted, data))
        .chain(undetermined(&fitted))
        .chain(about_confounded(&confounded(&searched.problem, &searched.before), data));
    Discovery {
        verdict,
        named: answer.named,
        noise: answer.noise,
        structures,
        before: before.gap,
        after: answer.held_out.gap,
        noise_floor_mm: searched.problem.noise_floor_mm(),
        structure_after: answer.structure,
        structure_before,
        residuals_mm: before.eps_mm.into_iter().zip(answer.held_out.eps_mm).map(|(a, b)| [a, b]).collect(),
        samples: data.len(),
        remarks: remarks.collect(),
        model: fitted,
    }
}

/// What a search says.
#[derive(Clone)]
struct Judged {
    verdict: Verdict,
    structure_before: Structure,
    held_out_before: HeldOutResiduals,
    /// With the effects that were found, which are not described yet, if they help.
    answer: Answer,
}

impl Judged {
    /// Whether what was found accounts for the gap.
    fn new(problem: &Problem, before: &Fit, after: &Fit) -> Self {
        let without = Answer::new(problem, before);
        let (structure_before, held_out_before) = (without.structure.clone(), without.held_out.clone());
        let has_found = after.model.effects.len() > before.model.effects.len();
        let with = has_found.then(|| Answer::new(problem, after));
        // An effect that does not shrink the gap on sweeps that the fit did not see is none.
        let with = with.filter(|with| with.held_out.gap.eps_mm < held_out_before.gap.eps_mm);
        let helps = with.is_some();
        let answer = with.unwrap_or(without);
        let verdict = Verdict::new(helps, problem.data.is_driven, &structure_before, &answer.structure);
        Self { verdict, structure_before, held_out_before, answer }
    }
}

/// What is said where the readings show nothing of what an effect does to their common part.
const DRIVEN: &str = "the part of the readings that bends nothing follows the model as it was given, as of actuators that are driven to positions: the \
                      effects were judged by the bends alone";

/// A search beside noise with all that it was made from.
struct Searched<'a> {
    /// The samples that were searched, under the noise that the answer leaves.
    problem: Problem<'a>,
    /// The model as given, with η and λ at their best.
    before: Fit,
    found: Found<'a>,
    judged: Judged,
}

impl<'a> Searched<'a> {
    /// The search of the samples as they are, unless the bends alone show what is missing, more than noise is left of them, and the search of the same samples
    /// as of actuators that are driven to positions is likelier; and whether it is. Both with a part of their samples.
    fn likeliest(model: &Model, [plain, driven]: [(&'a Data, &'a Data); 2], tell: Tell) -> (Self, bool) {
        tell("learning the noise");
        let searched = Self::new(model, plain, tell);
        let before = &searched.judged.structure_before;
        let bends_alone_show_it = before.exceeds_learned(0) && !before.exceeds_noise(1);
        if !bends_alone_show_it || !searched.leaves_more_than_noise() {
            return (searched, false);
        }
        tell("learning the noise of actuators that are driven to positions");
        let other = Self::new(model, driven, tell);
        if other.is_likelier_than(&searched) { (other, true) } else { (searched, false) }
    }

    /// The noise, and a rough fit of the model. From all samples: between thinned ones effects change as quickly as noise.
    fn noise_of(model: &Model, data: &Data) -> (Noise, Model) {
        let stated = Problem::new(data, &Noise::stated(data), model);
        let rough = stated.fit(model, None, None);
        (Noise::learned(&stated, &rough), rough.model)
    }

    /// The answer, with the structures that are left open: what was found, or what helps where that does not account for the gap.
    fn answered(&self, data: &Data, tell: Tell) -> (Judged, Vec<Candidate>) {
        let mut judged = self.judged.clone();
        match judged.verdict {
            Verdict::Named => judged.answer.named.clone_from(&self.found.named),
            Verdict::None => (),
            Verdict::Partly | Verdict::Unexplained => return (self.partly_answered(data, tell), Vec::new()),
        }
        let model = &mut judged.answer.model;
        let between = covariance_between(&self.found.structures, model, self.problem.data);
        model.covariance = model.covariance() + between;
        (judged, self.found.structures.clone())
    }

    /// Of many samples a part, `few`, is searched, and what was found is fitted to all.
    fn new(model: &Model, (data, few): (&'a Data, &'a Data), tell: Tell) -> Self {
        let (learned, rough) = &Self::noise_of(model, data);
        tell("comparing effects");
        let searched = Self::of(few, learned, rough);
        if few.len() == data.len() || searched.judged.verdict == Verdict::Unexplained {
            return searched;
        }
        tell("fitting what was found to all samples");
        let problem = Problem::new(data, &searched.problem.noise, &searched.found.fit.model);
        let [before, after] = [&searched.before, &searched.found.fit].map(|fit| problem.fit(&fit.model, None, None));
        Self { judged: Judged::new(&problem, &before, &after), ..searched }
    }

    /// The search takes the finer of what was stated and learned: what effects do from one sample to the next looks like noise until they are found. If
    /// what it finds leaves as much noise as was learned before, it is made again under that noise: the direction of a motion that is smaller than the noise
    /// of its readings follows that noise.
    fn of(data: &'a Data, learned: &Noise, model: &Model) -> Self {
        let problem = Problem::new(data, learned, model);
        let rough = problem.fit(model, None, None);
        let fine = learned.finer_of(&Noise::stated(data));
        let (searched, noise) = Self::under(&fine, learned, &problem, &rough);
        let is_as_large = noise == *learned && fine.is_finer_than(learned);
        if searched.judged.verdict == Verdict::Named && is_as_large {
            return Self::under(learned, learned, &problem, &rough).0;
        }
        searched
    }

    /// Under one noise; what was learned before counts unless effects account for a part of it. Also the noise that counts.
    fn under(noise: &Noise, learned: &Noise, problem: &Problem<'a>, rough: &Fit) -> (Self, Noise) {
        let data = problem.data;
        let under = Problem::new(data, &noise.with_discrepancy(problem, rough), &rough.model);
        let found = search(&under, &under.fit(&rough.model, Some(&rough.path), None), Beside::Noise);
        let finer = Noise::learned(&found.problem, &found.fit);
        let noise = if finer.is_finer_than(learned) { finer } else { *learned };
        let problem = Problem::new(data, &noise, &found.fit.model);
        let before = problem.fit(&rough.model, Some(&rough.path), None);
        let after = problem.fit(&found.fit.model, Some(&found.fit.path), None);
        let judged = Judged::new(&problem, &before, &after);
        (Self { problem, before, found, judged }, noise)
    }

    /// The answer where the library does not account for the gap: what helps all the same, or nothing.
    fn partly_answered(&self, data: &Data, tell: Tell) -> Judged {
        tell("looking for effects that help beside others");
        let partial = Partial::new(&self.problem, &self.before).of(data);
        let [before, after] = [&partial.before, &partial.after].map(|fit| HeldOutResiduals::new(&partial.problem, fit));
        let helps = !partial.named.is_empty() && after.gap.theta_deg < before.gap.theta_deg;
        let (verdict, fit, held_out, named) = match helps {
            true => (Verdict::Partly, &partial.after, after, partial.named.clone()),
            false => (Verdict::Unexplained, &partial.before, before.clone(), Vec::new()),
        };
        // What the residuals follow is told in units of the noise.
        let structure = Structure::new(&self.problem, &self.problem.evaluated(&fit.model, None));
        let answer = Answer { model: partial.model(fit), named, noise: partial.problem.noise, held_out, structure };
        Judged { verdict, held_out_before: before, answer, ..self.judged.clone() }
    }

    /// Whether more is left than noise, or clearly more than the noise that is stated.
    fn leaves_more_than_noise(&self) -> bool {
        let after = &self.judged.answer;
        let is_left = (0..2).any(|part| after.structure.exceeds_learned(part));
        is_left || Noise::stated(self.problem.data).is_finer_than(&after.noise)
    }

    /// Whether what it names rules out what another search of the same samples came to.
    fn is_likelier_than(&self, other: &Self) -> bool {
        self.judged.verdict == Verdict::Named
            && (other.judged.verdict != Verdict::Named || other.found.score < self.found.score + OPEN.ln())
    }
}

/// A fitted model, and what is to be said of it.
#[derive(Clone)]
struct Answer {
    model: Model,
    named: Vec<Named>,
    noise: Noise,
    held_out: HeldOutResiduals,
    structure: Structure,
}

impl Answer {
    /// Without effects that are described.
    fn new(problem: &Problem, fit: &Fit) -> Self {
        Self {
            model: problem.with_covariance(fit),
            named: Vec::new(),
            noise: problem.noise,
            held_out: HeldOutResiduals::new(problem, fit),
            structure: Structure::new(problem, fit),
        }
    }
}

/// [`discover`] for measurements that come from frames. They share the error of their rig, which is fitted as a nuisance parameter
/// with every model, and is no part of the model that comes out.
pub fn discover_in_frames(mut model: Model, data: &Data, tell: Tell) -> Discovery {
    model.effects.push(Effect::of(&RIG_ERROR, vec![0.0; RIG_ERROR.parameters_on(data.backbones()).len()]));
    let mut found = discover_telling(&model, data, tell);
    if let Some(k) = found.model.effects.iter().position(|effect| effect.physics == &RIG_ERROR) {
        let (effect, sds) = (found.model.effects[k].clone(), found.model.effect_sds(k));
        found.model = found.model.without_effect(k);
        let texts = effect.parameters().iter().zip(effect.values.iter().zip(&sds));
        let texts: Vec<String> =
            texts.map(|(spec, (value, sd))| format!("{} = {value:.3} ± {sd:.3}°", spec.name)).collect();
        found.remarks.push(format!(
            "the rig's own error, the same in all frames, was fitted as well: {}",
            texts.join(", ").replace('-', "−")
        ));
    }
    found
}

/// Effects of unknown origin were found here.
fn with_origin(mut model: Model, data: &Data) -> Model {
    for effect in model.effects.iter_mut().filter(|effect| effect.found.is_empty()) {
        effect.found = format!("discover, {} samples", data.len());
    }
    model
}

/// Remarks about parameters that the data do not determine.
fn undetermined(model: &Model) -> Vec<String> {
    let mut remarks = Vec::new();
    for (k, effect) in model.effects.iter().enumerate() {
        for ((spec, value), sd) in effect.parameters().iter().zip(&effect.values).zip(&model.effect_sds(k)) {
            if *sd > UNDETERMINED_SIZES * spec.typical && *sd > value.abs() {
                remarks.push(format!("{}: the data do not determine {}", effect.physics.name, spec.name));
            }
        }
    }
    remarks
}

/// A start of the log that was left out.
fn about_start(noise: &Noise, data: &Data) -> Option<String> {
    let count = noise.unknown_start;
    let last = data.indices[..count].last()?;
    Some(format!(
        "the first {count} samples (up to index {last}) lie outside what all others follow, as if something had moved the snake before the \
         log began: they are left out of the fit and of the gap. Lead the snake through a whole sweep before you record"
    ))
}

/// A bend whose residuals hang together from one sample to the next, and are no larger than the noise that is stated.
fn about_correlated_noise(structure: &Structure, gap: &Gap, data: &Data) -> Option<String> {
    if structure.exceeds_noise(0) || !structure.exceeds_learned(0) {
        return None;
    }
    let count = data.len() as f64;
    let correlation = structure.successive[..2].iter().copied().fold(0.0, f64::max) / count.sqrt();
    let interval_s = (data.times_s[data.len() - 1] - data.times_s[0]) / (count - 1.0);
    Some(format!(
        "what is left of the bend ({:.2}° in θ) is no larger than the noise that is stated, and alike from one sample to the next: a correlation of          {correlation:.2}, with a length of {:.1} s, as of a tracker that filters. No effect follows it, and none need be looked for",
        gap.theta_deg,
        interval_s / -correlation.min(1.0 - f64::EPSILON).ln()
    ))
}

/// A lag of the camera that the data cannot tell from rows of the log that stand elsewhere: one of whole rows, at even times.
fn about_lag(model: &Model, data: &Data) -> Option<String> {
    let place = model.effects.iter().position(|effect| matches!(effect.physics.changes, Changes::Exposure(_)))?;
    let (lag_s, sd_s) = (*model.effects[place].values.first()?, *model.effect_sds(place).first()?);
    let times_s = &data.log.times_s;
    let interval_s = (times_s[times_s.len() - 1] - times_s[0]) / (times_s.len() - 1) as f64;
    let rows = (lag_s / interval_s).round();
    let is_even =
        times_s.iter().enumerate().all(|(k, time_s)| (time_s - times_s[0] - k as f64 * interval_s).abs() < interval_s);
    let is_whole = rows != 0.0 && (lag_s - rows * interval_s).abs() < LAG_SDS * sd_s;
    (is_even && is_whole).then(|| {
        format!(
            "a log whose rows stand elsewhere would say the same as a late camera: [wiring] with index_shift = {}. Uneven times tell the two apart",
            -rows
        )
    })
}

/// The effects that the data cannot tell from η and λ, each form once.
fn about_confounded(confounded: &[&Physics], data: &Data) -> Option<String> {
    let name = |physics: &&Physics| {
        let form = if physics.form.is_empty() { String::new() } else { format!(" ({})", physics.form) };
        let part = if physics.parameters_on(data.backbones()).len() > 1 { "a part of " } else { "" };
        format!("{part}{}{form}", physics.name)
    };
    let names: Vec<String> = confounded.iter().map(name).collect();
    let are_found = !names.is_empty();
    are_found.then(|| format!("confounded with η and λ, from which these data cannot tell them: {}", names.join(", ")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::discover::fixture::{SD_ENCODER_MM, experiment, truth};
    use crate::geometry::Configuration;
    use crate::robot::effects::physics;
    use crate::simulate::Sealed;
    use nalgebra::{DMatrix, Rotation2, Vector2};

    #[test]
    fn of_actuators_that_are_driven_to_positions_the_bends_alone_name_an_effect() {
        let hidden = physics("load_directed_backlash").unwrap();
        let mut sealed = Sealed::of_poses(&[hidden], 3, 17, 24).unwrap();
        let data = |of: &Sealed| Data::new(&of.measurements, &of.readings, SD_ENCODER_MM).unwrap();
        let told = |found: &Discovery| found.remarks.iter().any(|remark| remark == DRIVEN);
        let names = |found: &Discovery| found.named.iter().map(|named| named.physics.name).collect::<Vec<_>>();
        let found = discover(&Model::default(), &data(&sealed));
        assert_eq!((names(&found), told(&found)), (vec![hidden.name], false));
        // The bends stay. What the backlash adds to all readings alike is taken up in forces: there the readings are those of the model without it.
        let common_mm = 0.15;
        for (k, reading) in sealed.readings.iter_mut().enumerate() {
            let noise_mm = SD_ENCODER_MM * (1.7 * k as f64).sin();
            reading.q_mm = reading.q_mm.add_scalar(common_mm + noise_mm - reading.q_mm.mean());
        }
        let found = discover(&Model::default(), &data(&sealed));
        assert_eq!((names(&found), told(&found)), (vec![hidden.name], true));
    }

    #[test]
    fn noise_that_hangs_together_is_none_as_long_as_it_is_no_larger_than_stated() {
        let told = |size: f64| {
            let mut sealed = Sealed::of_poses(&[], 5, 17, 24).unwrap();
            let (kept, mut held) = (0.7f64, Vector2::zeros());
            for (measurement, shown) in sealed.measurements.iter_mut().zip(&sealed.shown) {
                let (own, truth) = (measurement.measured.as_mut().unwrap(), shown.configuration);
                let turn = Rotation2::new(truth.delta);
                let error = turn.inverse() * (own.configuration.bend_vector() - truth.bend_vector());
                held = held * kept + error * (1.0 - kept * kept).sqrt();
                own.configuration = Configuration::from_bend_vector(truth.bend_vector() + turn * held * size);
            }
            let data = Data::new(&sealed.measurements, &sealed.readings, SD_ENCODER_MM).unwrap();
            let found = discover(&Model::default(), &data);
            (found.verdict, found.remarks.iter().any(|remark| remark.contains("alike from one sample to the next")))
        };
        assert_eq!(told(1.0), (Verdict::None, true));
        assert!(!told(3.0).1);
    }

    #[test]
    fn a_lag_of_whole_rows_at_even_times_may_be_rows_that_stand_elsewhere() {
        let mut data = experiment(1);
        let mut late = truth();
        late.effects.push(Effect::parse("camera_latency:latency_s=0.2").unwrap());
        late.covariance = DMatrix::identity(3, 3) * 1e-6;
        data.log.times_s = (0..data.log.times_s.len()).map(|k| 0.1 * k as f64).collect();
        assert!(about_lag(&late, &data).unwrap().contains("index_shift = -2"));
        data.log.times_s = data.log.times_s.iter().map(|time_s| 1.3 * time_s).collect();
        assert_eq!(about_lag(&late, &data), None);
        assert_eq!(about_lag(&Model::default(), &data), None);
    }
}
