//! `discover` as a whole, and what it gives.

use super::confounding::confounded;
use super::data::Data;
use super::held_out::{Gap, HeldOutResiduals};
use super::null_distribution::largest_gain_of_noise;
use super::residuals::Problem;
use super::search::{Found, Named, search};
use super::structure::Structure;
use super::tangent_spaces::tangent_spaces;
use super::verdict::Verdict;
use crate::robot::effects::RIG_ERROR;
use crate::robot::{Effect, Estimate, Model, PerBackbone, Physics};

/// A parameter whose standard deviation is beyond this many typical sizes is remarked.
///
/// Convention: decides about a remark only.
const UNDETERMINED_SIZES: f64 = 10.0;

/// What `discover` found.
#[derive(Debug, Clone)]
pub struct Discovery {
    /// The answer.
    pub verdict: Verdict,
    /// The effects, where the verdict is named; those that explain most where it is unexplained, as evidence only.
    pub named: Vec<Named>,
    /// The gain in the information criterion that is asked of an effect.
    pub least_bic_gain: f64,
    /// The model: with the effects where they are named, else as given with η and λ at their best.
    pub model: Model,
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

/// Compares what a model predicts with what was measured, and names what is missing.
pub fn discover(model: &Model, data: &Data) -> Discovery {
    let model = with_estimate(model);
    let rough = Problem::new(data, &model).fit(&model, None, None);
    // The noise is taken anew where η and λ put it.
    let problem = Problem::new(data, &rough.model);
    let before = problem.fit(&rough.model, Some(&rough.path), None);

    let spaces = tangent_spaces(&problem, &before);
    let least_bic_gain = largest_gain_of_noise(&spaces);
    let Found { before, after, named } = search(&problem, before, least_bic_gain);

    let (structure_before, structure_after) = (Structure::new(data, &before), Structure::new(data, &after));
    let verdict = Verdict::new(!named.is_empty(), &structure_before, &structure_after);
    let accepted = verdict == Verdict::Named;
    let kept = if accepted { &after } else { &before };
    let fitted = with_origin(problem.with_covariance(kept), data);
    let held_out_before = HeldOutResiduals::new(&problem, &before);
    let held_out = if accepted { HeldOutResiduals::new(&problem, &after) } else { held_out_before.clone() };

    let mut remarks = data.remarks.clone();
    remarks.extend(undetermined(&fitted));
    remarks.extend(confounded(&spaces, least_bic_gain).into_iter().map(|effect| about_confounded(effect, data)));
    Discovery {
        verdict,
        named,
        least_bic_gain,
        model: fitted,
        before: held_out_before.gap,
        after: held_out.gap,
        noise_floor_mm: problem.noise_floor_mm(),
        structure_after: if accepted { structure_after } else { structure_before.clone() },
        structure_before,
        residuals_mm: held_out_before.eps_mm.into_iter().zip(held_out.eps_mm).map(|(a, b)| [a, b]).collect(),
        samples: data.len(),
        remarks,
    }
}

/// [`discover`] for measurements that come from frames. They share the error of their rig, which is fitted as a nuisance parameter
/// with every model, and is no part of the model that comes out.
pub fn discover_in_frames(mut model: Model, data: &Data) -> Discovery {
    model.effects.push(Effect::of(&RIG_ERROR, vec![0.0; (RIG_ERROR.parameters)(data.backbones()).len()]));
    let mut found = discover(&model, data);
    if let Some(k) = found.model.effects.iter().position(|effect| effect.physics == &RIG_ERROR) {
        let (effect, sds) = (found.model.effects[k].clone(), found.model.effect_sds(k));
        found.model = found.model.without_effect(k);
        let texts = effect.parameters().iter().zip(effect.values.iter().zip(&sds));
        let texts: Vec<String> =
            texts.map(|(spec, (value, sd))| format!("{} = {value:.3} ± {sd:.3}°", spec.name)).collect();
        found
            .remarks
            .push(format!("the rig's own error, the same in all frames, was fitted as well: {}", texts.join(", ")));
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

fn about_confounded(physics: &Physics, data: &Data) -> String {
    let form = if physics.form.is_empty() { String::new() } else { format!(" ({})", physics.form) };
    let part = if (physics.parameters)(data.backbones()).len() > 1 { "a part of " } else { "" };
    format!("{part}{}{form} is confounded with η and λ: these data cannot tell it from them", physics.name)
}
