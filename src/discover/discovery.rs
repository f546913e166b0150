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
use super::search::{Found, Named, search};
use super::structure::Structure;
use super::verdict::Verdict;
use crate::robot::effects::RIG_ERROR;
use crate::robot::{Effect, Estimate, Model, PerBackbone, Physics};
use tracing::{info, info_span};

/// A parameter whose standard deviation is beyond this many typical sizes is remarked.
///
/// Convention: decides about a remark only.
const UNDETERMINED_SIZES: f64 = 10.0;

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
    let model = with_estimate(model);
    let few = data.thinned(SEARCHED_FIRST);
    let searched = Searched::new(&model, (data, &few), tell);
    let remarks = about_confounded(&confounded(&searched.problem, &searched.before), data);
    let Searched { judged, found, .. } = &searched;
    let Judged { verdict, structure_before, held_out_before, answer } = judged.clone();
    let (verdict, answer, held_out_before, structures) = match verdict {
        Verdict::Named | Verdict::None => {
            let named = if verdict == Verdict::Named { found.named.clone() } else { Vec::new() };
            let between = covariance_between(&found.structures, &answer.model, searched.problem.data);
            let mut model = answer.model.clone();
            model.set_covariance(&(model.covariance() + between));
            (verdict, Answer { model, named, ..answer }, held_out_before, found.structures.clone())
        }
        _ => {
            let (verdict, answer, held_out_before) = partly_answered(&searched, (&model, data), tell);
            (verdict, answer, held_out_before, Vec::new())
        }
    };
    info!(verdict = verdict.word(), effects = ?answer.named.iter().map(|named| named.physics.name).collect::<Vec<_>>(), "answered");
    let fitted = with_origin(answer.model, data);
    let remarks = data
        .remarks
        .iter()
        .cloned()
        .chain(about_start(&answer.noise, data))
        .chain(undetermined(&fitted))
        .chain(remarks);
    Discovery {
        verdict,
        named: answer.named,
        noise: answer.noise,
        structures,
        before: held_out_before.gap,
        after: answer.held_out.gap,
        noise_floor_mm: searched.problem.noise_floor_mm(),
        structure_after: answer.structure,
        structure_before,
        residuals_mm: held_out_before.eps_mm.into_iter().zip(answer.held_out.eps_mm).map(|(a, b)| [a, b]).collect(),
        samples: data.len(),
        remarks: remarks.collect(),
        model: fitted,
    }
}

/// What the search beside noise says, before a partial answer is thought of.
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
        let verdict = Verdict::new(helps, &structure_before, &answer.structure);
        Self { verdict, structure_before, held_out_before, answer }
    }
}

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
    /// Of many samples a part, `few`, is searched, and what was found is fitted to all. All are searched where they show more than that accounts
    /// for, unless the part does so as well.
    fn new(model: &Model, (data, few): (&'a Data, &'a Data), tell: Tell) -> Self {
        tell("learning the noise");
        let stated = Problem::new(data, &Noise::stated(data), model);
        let rough = stated.fit(model, None, None);
        // From all samples: between thinned ones effects change as quickly as noise.
        let learned = Noise::learned(&stated, &rough);
        tell("comparing effects");
        let searched = Self::of(few, &learned, &rough.model);
        if few.len() == data.len() || searched.judged.verdict == Verdict::Unexplained {
            return searched;
        }
        tell("fitting what was found to all samples");
        let judged = searched.judged_on(data);
        if judged.verdict == Verdict::Unexplained {
            tell("comparing effects on all samples");
            return Self::of(data, &learned, &rough.model);
        }
        Self { judged, ..searched }
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

    /// What was found, fitted to all samples, of which those that were searched are a part.
    fn judged_on(&self, data: &Data) -> Judged {
        let problem = Problem::new(data, &self.problem.noise, &self.found.fit.model);
        let [before, after] = [&self.before, &self.found.fit].map(|fit| problem.fit(&fit.model, None, None));
        Judged::new(&problem, &before, &after)
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
            structure: Structure::new(problem.data, fit),
        }
    }
}

/// The answer where the library does not account for the gap: what helps all the same, or nothing; and the held-out residuals before.
fn partly_answered(
    searched: &Searched,
    (given, data): (&Model, &Data),
    tell: Tell,
) -> (Verdict, Answer, HeldOutResiduals) {
    tell("looking for effects that help beside others");
    let problem = &searched.problem;
    let anew = problem.fit(given, None, None);
    let mut partial = Partial::new(problem, [&searched.before, &anew]);
    // What the residuals follow is told in units of the noise.
    let structure = |fit: &Fit| Structure::new(problem.data, &problem.evaluated(&fit.model, Some(&fit.path)));
    let of_searched = [partial.before.clone(), partial.after.clone()];
    if problem.data.len() < data.len() {
        tell("fitting what was found to all samples");
        partial = partial.of(data);
    }
    let before = HeldOutResiduals::new(&partial.problem, &partial.before);
    let held_out = HeldOutResiduals::new(&partial.problem, &partial.after);
    let helps = !partial.named.is_empty() && held_out.gap.theta_deg < before.gap.theta_deg;
    let (verdict, named) =
        if helps { (Verdict::Partly, partial.named.clone()) } else { (Verdict::Unexplained, Vec::new()) };
    let fit = if helps { &partial.after } else { &partial.before };
    let answer = Answer {
        model: partial.model(fit),
        named,
        noise: partial.problem.noise,
        held_out: if helps { held_out } else { before.clone() },
        structure: structure(&of_searched[usize::from(helps)]),
    };
    (verdict, answer, before)
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

/// η = 1, λ = 0 where nothing was estimated, so that there is something to fit.
fn with_estimate(model: &Model) -> Model {
    let x = model.parameters();
    let estimate = Estimate { eta: x.x, lambda_mm: x.y, covariance: model.parameter_covariance(), samples: 0 };
    Model { estimate: Some(estimate), ..model.clone() }
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
