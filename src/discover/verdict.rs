//! The verdict: named, none or unexplained.

use super::chance::Chance;
use super::data::Data;
use super::fit::{Fit, Problem, Residual};
use super::search::{Found, Named, held_out, search};
use crate::error::Result;
use crate::robot::effects::RIG_ERROR;
use crate::robot::{Effect, Estimate, Mechanics, Model, PerBackbone, Physics};
use crate::simulate::score::LEAST_THETA_FOR_DELTA;
use nalgebra::{DMatrix, DVector};
use serde_json::{Map, Value, json};

/// A gap whose mean square exceeds noise by more than this many standard errors is not noise.
const SIGNIFICANT: f64 = 4.0;
/// The share of the gap's excess over noise that a shape not quite right may leave under a right name.
const LEFT_BY_SHAPE: f64 = 0.04;

/// The answer of a discovery.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// Effects of the library account for the gap.
    Named,
    /// The gap is noise.
    None,
    /// There is a gap, and the library does not account for it.
    Unexplained,
}

impl Verdict {
    /// As discrepancy.json has it.
    pub fn word(self) -> &'static str {
        match self {
            Self::Named => "named",
            Self::None => "none",
            Self::Unexplained => "unexplained",
        }
    }
}

/// The gap on sweeps that the fit did not see.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gap {
    /// rms of ε over all backbones, mm.
    pub eps_mm: f64,
    /// rms of θ, degrees.
    pub theta_deg: f64,
    /// rms of δ over bends of 15° or more, degrees.
    pub delta_deg: f64,
}

/// What residuals still follow.
#[derive(Debug, Clone, PartialEq)]
pub struct Structure {
    /// Mean square of the whitened residuals of the bend and of what bends nothing; 1 is noise.
    pub mean_square: [f64; 2],
    /// Correlation of successive residuals, in standard errors: bend along and across, common part, further internal parts.
    pub successive: Vec<f64>,
    /// What the residuals follow most, in words, with the F-like statistic in standard errors.
    pub follows: Vec<(&'static str, f64)>,
}

impl Structure {
    /// Whether a part (0 bend, 1 what bends nothing) exceeds noise, and not only because sigmas are too small: it has an order.
    fn exceeds(&self, part: usize, samples: usize) -> bool {
        let own = if part == 0 { &self.successive[..2] } else { &self.successive[2..] };
        let freedom = (samples * own.len()) as f64;
        let ordered = own.iter().fold(0.0f64, |most, correlation| most.max(correlation.abs()));
        let follows = self.follows.iter().map(|(_, z)| *z).fold(0.0, f64::max);
        self.mean_square[part] > 1.0 + SIGNIFICANT * (2.0 / freedom).sqrt() && (ordered > 3.5 || follows > 5.0)
    }

    fn excess(&self, part: usize) -> f64 {
        (self.mean_square[part] - 1.0).max(0.0)
    }
}

/// What `discover` found.
#[derive(Debug, Clone)]
pub struct Discovery {
    /// The answer.
    pub verdict: Verdict,
    /// The effects, where the verdict is named; those that explain most where it is unexplained, as evidence only.
    pub named: Vec<Named>,
    /// The model: with the effects where they are named, else as given with η and λ at their best.
    pub model: Model,
    /// The gap before, on sweeps left out.
    pub before: Gap,
    /// The gap after, on sweeps left out.
    pub after: Gap,
    /// What noise alone leaves of ε, mm.
    pub noise_floor_mm: f64,
    /// What the residuals followed before.
    pub structure_before: Structure,
    /// What they follow after.
    pub structure_after: Structure,
    /// Gap of ε at every sample before and after, mm, on sweeps left out.
    pub residuals_mm: Vec<[PerBackbone; 2]>,
    /// Samples used.
    pub samples: usize,
    /// What was passed over or could not be decided.
    pub remarks: Vec<String>,
}

/// Compares what a model says with what was measured, and names what is missing.
///
/// # Errors
/// What [`Data::new`] refuses.
pub fn discover(model: &Model, data: &Data) -> Result<Discovery> {
    let model = with_estimate(model);
    let rough = Problem::new(data, &model).fit(&model, None, None);
    // The noise, where η and λ put it.
    let problem = Problem::new(data, &rough.model);
    let before = problem.fit(&rough.model, Some(&rough.path), None);
    let chance = Chance::of(&problem, &before);
    let Found { before, after, named } = search(&problem, before, &chance);
    let (unseen_before, unseen_after) = (Unseen::of(&problem, &before), Unseen::of(&problem, &after));
    let (structure_before, structure_after) = (structure(data, &before), structure(data, &after));
    let exceeds = |structure: &Structure| (0..2).any(|part| structure.exceeds(part, data.len()));
    let shape_only = (0..2).all(|part| {
        let (left, all) = (structure_after.excess(part), structure_before.excess(part));
        !structure_after.exceeds(part, data.len()) || left < LEFT_BY_SHAPE * all
    });
    let verdict = match (named.is_empty(), exceeds(&structure_after)) {
        (true, false) => Verdict::None,
        (false, _) if shape_only => Verdict::Named,
        _ => Verdict::Unexplained,
    };
    let kept = if verdict == Verdict::Named { &after } else { &before };
    let mut fitted = problem.with_covariance(kept);
    for effect in &mut fitted.effects {
        if effect.found.is_empty() {
            effect.found = format!("discover, {} samples", data.len());
        }
    }
    let mut remarks = data.remarks.clone();
    remarks.extend(unpinned(&fitted));
    remarks.extend(chance.hidden.iter().map(|physics| hidden(physics, data.backbones())));
    let unseen_kept = if verdict == Verdict::Named { &unseen_after } else { &unseen_before };
    let residuals_mm = unseen_before.eps.iter().zip(&unseen_kept.eps).map(|(a, b)| [*a, *b]).collect();
    Ok(Discovery {
        verdict,
        named,
        before: unseen_before.gap,
        after: unseen_kept.gap,
        noise_floor_mm: (mean((0..data.len()).map(|k| problem.floor_mm2(k)))).sqrt(),
        structure_after: if verdict == Verdict::Named { structure_after } else { structure_before.clone() },
        structure_before,
        residuals_mm,
        model: fitted,
        samples: data.len(),
        remarks,
    })
}

/// [`discover`] for measurements that come from frames, which share the error of their rig: it is left free with every fit, and
/// is no part of the model that comes out.
///
/// # Errors
/// As [`discover`].
pub fn discover_in_frames(mut model: Model, data: &Data) -> Result<Discovery> {
    model.effects.push(Effect::of(&RIG_ERROR, vec![0.0; (RIG_ERROR.parameters)(data.backbones()).len()]));
    let mut found = discover(&model, data)?;
    if let Some(k) = found.model.effects.iter().position(|effect| effect.physics == &RIG_ERROR) {
        let (effect, sds) = (found.model.effects[k].clone(), found.model.effect_sds(k));
        found.model = found.model.without_effect(k);
        let texts = effect.parameters().iter().zip(effect.values.iter().zip(&sds));
        let texts: Vec<String> =
            texts.map(|(spec, (value, sd))| format!("{} = {value:.3} ± {sd:.3}°", spec.name)).collect();
        found.remarks.push(format!("the rig's own error, the same in all frames, was left free: {}", texts.join(", ")));
    }
    Ok(found)
}

/// η = 1, λ = 0 where nothing was estimated, so that there is something to fit.
fn with_estimate(model: &Model) -> Model {
    let x = model.parameters();
    let estimate = Estimate { eta: x.x, lambda_mm: x.y, covariance: model.parameter_covariance(), samples: 0 };
    Model { estimate: Some(estimate), ..model.clone() }
}

/// Parameters that the data do not pin, in words.
fn unpinned(model: &Model) -> Vec<String> {
    let mut remarks = Vec::new();
    for (k, effect) in model.effects.iter().enumerate() {
        for ((spec, value), sd) in effect.parameters().iter().zip(&effect.values).zip(&model.effect_sds(k)) {
            if *sd > 10.0 * spec.typical && *sd > value.abs() {
                remarks.push(format!("{}: the data do not pin {}", effect.physics.name, spec.name));
            }
        }
    }
    remarks
}

/// An effect, or a part of it, that η and λ hide.
fn hidden(physics: &Physics, backbones: usize) -> String {
    let form = if physics.form.is_empty() { String::new() } else { format!(" ({})", physics.form) };
    let part = if (physics.parameters)(backbones).len() > 1 { "a part of " } else { "" };
    format!("{part}{}{form} could hide in η and λ: these data cannot tell it from them", physics.name)
}

/// The gap of every sample under a fit that it had no part in.
struct Unseen {
    eps: Vec<PerBackbone>,
    gap: Gap,
}

impl Unseen {
    fn of(problem: &Problem, fit: &Fit) -> Self {
        let data = problem.data;
        let (fits, _) = held_out(problem, fit);
        let own = |k: usize| &fits[data.fold(k)];
        let eps: Vec<_> = (0..data.len()).map(|k| problem.eps_gap_mm(own(k), k)).collect();
        let bend: Vec<_> = (0..data.len()).map(|k| problem.bend_gap(own(k), k)).collect();
        let theta = |k: usize| data.measured[k].configuration.theta;
        let far = || (0..data.len()).filter(|&k| theta(k) >= LEAST_THETA_FOR_DELTA);
        let gap = Gap {
            eps_mm: mean(eps.iter().map(|e| e.norm_squared() / e.len() as f64)).sqrt(),
            theta_deg: mean(bend.iter().map(|b| b.x.powi(2))).sqrt().to_degrees(),
            delta_deg: mean(far().map(|k| (bend[k].y / theta(k)).powi(2))).sqrt().to_degrees(),
        };
        Self { eps, gap }
    }
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
    if count > 0.0 { sum / count } else { 0.0 }
}

/// What a fit's residuals still follow. Single samples far out count as six sigma.
fn structure(data: &Data, fit: &Fit) -> Structure {
    let clipped: Vec<Residual> = fit.residuals.iter().map(|r| r.map(|r| r.clamp(-6.0, 6.0))).collect();
    let n = clipped.len() as f64;
    // The parameters have taken their share of the freedom.
    let numbers = data.numbers() as f64;
    let freedom = numbers / (numbers - fit.parameters as f64);
    let square = |of: &[f64]| of.iter().map(|r| r * r).sum::<f64>() / of.len() as f64;
    let mean_square = [
        mean(clipped.iter().map(|r| square(&r[..2]))) * freedom,
        mean(clipped.iter().map(|r| square(&r[2..]))) * freedom,
    ];
    let successive = (0..data.backbones()).map(|c| {
        let squares: f64 = clipped.iter().map(|r| r[c] * r[c]).sum();
        let products: f64 = clipped.windows(2).map(|pair| pair[0][c] * pair[1][c]).sum();
        if squares > 0.0 { products / squares * n.sqrt() } else { 0.0 }
    });
    let successive = successive.collect();
    let mut follows: Vec<(&'static str, f64)> =
        regressors(data, fit).into_iter().map(|(name, columns)| (name, follows(&clipped, &columns))).collect();
    follows.sort_by(|a, b| b.1.total_cmp(&a.1));
    Structure { mean_square, successive, follows }
}

/// Families of functions that residuals may follow, evaluated at the samples.
fn regressors(data: &Data, fit: &Fit) -> Vec<(&'static str, Vec<Vec<f64>>)> {
    let columns = |functions: &dyn Fn(usize) -> Vec<f64>| -> Vec<Vec<f64>> {
        let rows: Vec<Vec<f64>> = (0..data.len()).map(functions).collect();
        (0..rows[0].len()).map(|c| rows.iter().map(|row| row[c]).collect()).collect()
    };
    let motions = Mechanics::new(&fit.model).motions_from_readings(&data.times_s, &fit.path, &data.q_mm);
    let last = data.times_s[data.len() - 1] - data.times_s[0];
    let theta = |k: usize| fit.path[k].norm();
    let delta = |k: usize| fit.path[k].y.atan2(fit.path[k].x);
    vec![
        ("the bend θ", columns(&|k| vec![theta(k), theta(k).powi(2), theta(k).powi(3)])),
        (
            "the azimuth δ",
            columns(&|k| {
                (1..=3)
                    .flat_map(|m| {
                        let (s, c) = (f64::from(m) * delta(k)).sin_cos();
                        [s, c]
                    })
                    .collect()
            }),
        ),
        ("the direction of motion", columns(&|k| motions[k].direction.iter().copied().collect())),
        ("the speed", columns(&|k| motions[k].speed_mm_per_s.iter().copied().collect())),
        (
            "time",
            columns(&|k| {
                let t = (data.times_s[k] - data.times_s[0]) / last;
                vec![t, t * t, (9.0 * t).sin(), (9.0 * t).cos()]
            }),
        ),
        ("q̃", columns(&|k| data.q_mm[k].iter().flat_map(|q| [q.powi(2), q.powi(3)]).collect())),
    ]
}

/// How much of the residuals a family takes, in standard errors of what it would take of noise.
fn follows(residuals: &[Residual], columns: &[Vec<f64>]) -> f64 {
    let n = residuals.len();
    let mut design = DMatrix::from_fn(n, columns.len() + 1, |k, c| if c == 0 { 1.0 } else { columns[c - 1][k] });
    for mut column in design.column_iter_mut() {
        let norm = column.norm();
        if norm > 0.0 {
            column.unscale_mut(norm);
        }
    }
    let information = design.transpose() * &design + DMatrix::identity(columns.len() + 1, columns.len() + 1) * 1e-9;
    let Some(factor) = information.cholesky() else { return 0.0 };
    let worst = (0..residuals[0].len()).map(|c| {
        let r = DVector::from_iterator(n, residuals.iter().map(|r| r[c]));
        let right = design.transpose() * &r;
        let taken = right.dot(&factor.solve(&right));
        let variance = (r.norm_squared() - taken).max(1e-12) / n as f64;
        let freedom = columns.len() as f64 + 1.0;
        (taken / variance - freedom) / (2.0 * freedom).sqrt()
    });
    worst.fold(0.0, f64::max)
}

impl Discovery {
    /// discrepancy.json.
    pub fn json(&self) -> Value {
        let given = self.model.effects.len().saturating_sub(self.named.len());
        let entry = |(named, k): (&Named, usize)| {
            let effect = self.model.effects.get(given + k).filter(|effect| effect.physics == named.physics);
            let mut parameters = Map::new();
            if let Some(effect) = effect {
                for ((spec, value), sd) in
                    effect.parameters().iter().zip(&effect.values).zip(&self.model.effect_sds(given + k))
                {
                    parameters.insert(spec.name.into(), json!({"value": value, "sd": sd, "unit": spec.unit}));
                }
            }
            let rivals: Vec<_> =
                named.rivals.iter().take(5).map(|(name, worse)| json!({"name": name, "bic_worse": worse})).collect();
            json!({
                "name": named.physics.name,
                "form": named.physics.form,
                "equation": named.physics.equation,
                "reading": named.physics.reading,
                "parameters": parameters,
                "evidence": {
                    "bic_gain": named.bic_gain,
                    "held_out_gain": named.held_out_gain,
                    "inclusion_probability": named.inclusion,
                    "rivals": rivals,
                },
                "indistinguishable_from": named.indistinguishable_from,
            })
        };
        let effects: Vec<Value> = (0..self.named.len()).map(|k| entry((&self.named[k], k))).collect();
        let named = self.verdict == Verdict::Named;
        let x = self.model.parameters();
        let follows: Vec<_> =
            self.structure_after.follows.iter().map(|(what, z)| json!({"what": what, "standard_errors": z})).collect();
        json!({
            "verdict": self.verdict.word(),
            "effects": if named { effects.clone() } else { Vec::new() },
            "considered": if named { Vec::new() } else { effects },
            "gap": {
                "before_mm": self.before.eps_mm,
                "after_mm": self.after.eps_mm,
                "noise_floor_mm": self.noise_floor_mm,
                "before_theta_deg": self.before.theta_deg,
                "after_theta_deg": self.after.theta_deg,
                "before_delta_deg": self.before.delta_deg,
                "after_delta_deg": self.after.delta_deg,
            },
            "eta": x.x,
            "lambda_mm": x.y,
            "samples": self.samples,
            "residuals": {
                "mean_square_bend": self.structure_after.mean_square[0],
                "mean_square_common": self.structure_after.mean_square[1],
                "successive_correlation_standard_errors": self.structure_after.successive,
                "follow": follows,
            },
            "remarks": self.remarks,
        })
    }
}
