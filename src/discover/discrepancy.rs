//! What discrepancy.json says.

use super::discovery::Discovery;
use super::held_out::Gap;
use super::posterior::Candidate;
use super::search::Named;
use crate::estimate;
use crate::verdict::Verdict;
use serde_json::{Map, Value, json};

/// Alternatives that are listed.
///
/// Convention: a display choice.
const MOST_ALTERNATIVES: usize = 5;

impl Discovery {
    /// discrepancy.json.
    pub fn json(&self) -> Value {
        let given = self.given_effects();
        let effects: Vec<Value> =
            self.named.iter().enumerate().map(|(k, named)| self.effect_json(named, given + k)).collect();
        let x = self.model.parameters();
        let structure = &self.structure_after;
        let follows: Vec<_> =
            structure.follows.iter().map(|(what, z)| json!({"what": what, "standard_errors": z})).collect();
        let structures: Vec<_> = self.structures.iter().map(structure_json).collect();
        json!({
            "verdict": self.verdict.word(),
            "effects": effects,
            "structures": structures,
            "gap": gap_json(&self.before, &self.after, self.noise_floor_mm),
            "eta": x.x,
            "lambda_mm": x.y,
            "samples": self.samples,
            "noise": {"encoder_mm": self.noise.sd_encoder_mm, "eye_factor": self.noise.eye_factor},
            "residuals": {
                "mean_square_bend": structure.mean_square[0],
                "mean_square_common": structure.mean_square[1],
                "successive_correlation_standard_errors": structure.successive,
                "follow": follows,
            },
            "remarks": self.remarks,
        })
    }

    /// One effect; it is effect k of the model where the model has it.
    fn effect_json(&self, named: &Named, k: usize) -> Value {
        let effect = self.model.effects.get(k).filter(|effect| effect.physics == named.physics);
        let mut parameters = Map::new();
        if let Some(effect) = effect {
            for ((spec, value), sd) in effect.parameters().iter().zip(&effect.values).zip(&self.model.effect_sds(k)) {
                parameters.insert(spec.name.into(), json!({"value": value, "sd": sd, "unit": spec.unit}));
            }
        }
        let alternatives = named.alternatives.iter().take(MOST_ALTERNATIVES);
        let alternatives: Vec<_> =
            alternatives.map(|(name, worse)| json!({"name": name, "bic_worse": worse})).collect();
        json!({
            "name": named.physics.name,
            "form": named.physics.form,
            "equation": named.physics.equation,
            "reading": named.physics.reading,
            "parameters": parameters,
            "removes": named.removes,
            "probability": named.probability(),
            "evidence": {
                "bic_gain": named.evidence.bic_gain,
                "held_out_gain": named.evidence.held_out_gain,
                "inclusion_probability": named.evidence.inclusion,
                "rivals": alternatives,
            },
            "indistinguishable_from": named.indistinguishable_from,
        })
    }
}

/// A structure that the data leave open.
fn structure_json(candidate: &Candidate) -> Value {
    json!({"effects": candidate.effects, "probability": candidate.probability})
}

/// The entry `gap`.
fn gap_json(before: &Gap, after: &Gap, noise_floor_mm: f64) -> Value {
    json!({
        "before_mm": before.eps_mm,
        "after_mm": after.eps_mm,
        "noise_floor_mm": noise_floor_mm,
        "before_theta_deg": before.theta_deg,
        "after_theta_deg": after.theta_deg,
        "before_delta_deg": before.delta_deg,
        "after_delta_deg": after.delta_deg,
    })
}

/// discrepancy.json of data of which no physics is named, because the verdict on them says that something else is wrong, such as the
/// wiring of the log; with the gap that the model leaves, and the remarks on the data.
pub fn nothing_named(left: &estimate::gap::Gap, verdict: &Verdict, remarks: &[String]) -> Value {
    let gap = Gap::from(*left);
    json!({
        "verdict": "unexplained",
        "effects": [],
        "gap": gap_json(&gap, &gap, left.noise_floor_mm),
        "reasons": verdict.reasons,
        "samples": left.samples,
        "remarks": remarks,
    })
}
