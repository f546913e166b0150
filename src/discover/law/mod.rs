//! A law proposed where the library leaves a gap: a short formula that a person can read, chosen by what is left of sweeps that the fit
//! did not see.
//!
//! A law is a sum of a few [terms](terms) with coefficients. At the bends that the eye saw, the gap of ε is linear in the coefficients,
//! so that terms are [selected](selection) among hundreds by linear least squares. The selection itself is judged as well: it is
//! repeated without each block of sweeps that follow each other, and the model with the law that comes out, fitted as it stands to the
//! other blocks, must predict that block better than the model without one, and leave at most half of the squares of all blocks. A law that
//! fails is not kept. The law that is kept goes into the model as the effect `proposed_law`, a formula like a user's own; beyond the values
//! that it was learned from it goes on straight.

mod selection;
mod terms;

use super::data::Data;
use super::discovery::Discovery;
use super::fit::Fit;
use super::held_out::HeldOutResiduals;
use super::residuals::{Problem, Residual};
use super::sweeps::FOLDS;
use super::verdict::Verdict;
use crate::robot::effects::{Defined, Definition, HALF_GAP, Variable};
use crate::robot::{Effect, Mechanics, Model, Motion, PerBackbone, Play};
use crate::statistics::moments::{mean, rms};
use nalgebra::{DMatrix, DVector, Rotation2, Vector2};
use rayon::prelude::*;
use selection::{Blocks, Selection, Sums, Tried};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use terms::{SCALE, Shape, Shared, Term, dictionary};

/// The name of the effect.
pub const PROPOSED_LAW: &str = "proposed_law";

/// Samples are thinned evenly until no more than these are left.
///
/// Convention: a bound on computing time.
const MOST_SAMPLES: usize = 2000;

/// Half widths of plays that are tried, evenly spaced in their logarithm.
///
/// Convention: each about three times the one before; the fit finds its way within a factor of two.
const WIDTHS: usize = 6;

/// Scales of saturations that are tried, each a third of the one before, from a third of the largest |q| on.
///
/// Convention: a larger one differs little from a cubic, a smaller one little from a step; the fit finds its way within a factor of two.
const SCALES: usize = 3;

/// A scale may be so many times the largest or the least that is tried, or a part of it.
///
/// Convention: a range that a fit does not reach.
const RANGE_OF_SCALE: f64 = 10.0;

/// The least half width in units of the encoders' noise.
///
/// Convention: less cannot be seen.
const LEAST_WIDTH: f64 = 5.0;

/// A law must take away this share of the squares of the gap, on blocks that it was chosen without.
///
/// Convention: half; less is not worth a formula that nobody can explain.
const LEAST_SHARE: f64 = 0.5;

/// A coefficient may be so many times its first value.
///
/// Convention: a range that a fit does not reach.
const RANGE_OF_COEFFICIENT: f64 = 30.0;

/// What came of looking for a law.
#[derive(Debug, Clone)]
pub struct ProposedLaw {
    /// The model with the law; none where none helps on every block of sweeps left out.
    pub model: Option<Model>,
    /// rms of the gap of ε without it, on blocks of sweeps left out, mm.
    pub before_mm: f64,
    /// The same with a law that was chosen and fitted without each block.
    pub after_mm: f64,
    /// What was done and why, in words, with the law.
    pub words: String,
}

/// Looks for a law where the verdict is `unexplained` or `partly`.
pub fn propose_law(found: &Discovery, data: &Data) -> ProposedLaw {
    match found.verdict {
        Verdict::Unexplained | Verdict::Partly => proposed(found, data),
        Verdict::None => unneeded(found, "the gap is noise, and there is nothing to gain"),
        Verdict::Named => unneeded(found, "the effects that were named account for the gap"),
    }
}

fn unneeded(found: &Discovery, reason: &str) -> ProposedLaw {
    let words = format!("no law was looked for: {reason}");
    ProposedLaw { model: None, before_mm: found.after.eps_mm, after_mm: found.after.eps_mm, words }
}

fn proposed(found: &Discovery, data: &Data) -> ProposedLaw {
    let problem = Problem::new(data, &found.noise, &found.model);
    let fit = problem.fit(&found.model, None, None);
    let candidates = Candidates::new(&problem, &fit);
    let blocks = candidates.blocks();
    let judged = Judged::new(&candidates, &blocks);
    let (before_mm, after_mm) = (judged.rms_mm(0), judged.rms_mm(1));
    match judged.helps().then(|| candidates.fitted(&blocks)).flatten() {
        Some(model) => {
            let law = in_words(&model);
            let words = format!(
                "a law is proposed: {law}. Chosen and fitted without a fifth of the sweeps, it leaves {after_mm:.4} mm of \
                 {before_mm:.4} mm there. It is no explanation, and holds for this robot within what it was learned from"
            );
            ProposedLaw { model: Some(model), before_mm, after_mm, words }
        }
        None => ProposedLaw {
            model: None,
            before_mm,
            after_mm: before_mm,
            words: "no law is proposed: none of bend, load, direction, play, speed and time takes enough away of every fifth of the \
                    sweeps that it was chosen without"
                .to_owned(),
        },
    }
}

/// The law of a model with its coefficients: "ε_i += 0.0210 ± 0.0003 on_1 * abs(q_2)^3 …".
fn in_words(model: &Model) -> String {
    let Some(k) = model.effects.iter().position(|effect| effect.physics.name == PROPOSED_LAW) else {
        return String::new();
    };
    let effect = &model.effects[k];
    let values = effect.parameters().iter().zip(effect.values.iter().zip(model.effect_sds(k)));
    let values = values.map(|(spec, (value, sd))| format!("{} = {value:.3e} ± {sd:.1e} {}", spec.name, spec.unit));
    format!("{} with {}", effect.physics.equation, values.collect::<Vec<_>>().join(", "))
}

/// A term that may be chosen, with the value of the parameter in it that is not linear.
struct Candidate {
    term: Term,
    tried: Option<Tried>,
    /// The rms of its summand of ε where its coefficient is 1, mm.
    scale: f64,
}

/// All terms at the samples, and what they do to the residuals.
struct Candidates<'a> {
    problem: &'a Problem<'a>,
    fit: &'a Fit,
    /// The samples that are used.
    samples: Vec<usize>,
    /// The gap of ε at the bends that the eye saw, as whitened residuals of each sample.
    residuals: Vec<Residual>,
    states: States,
    all: Vec<Candidate>,
}

impl<'a> Candidates<'a> {
    fn new(problem: &'a Problem<'a>, fit: &'a Fit) -> Self {
        let data = problem.data;
        let stride = data.len().div_ceil(MOST_SAMPLES);
        let samples: Vec<usize> = (problem.noise.unknown_start..data.len()).step_by(stride).collect();
        let path = seen(problem, fit);
        let mechanics = Mechanics::new(&fit.model);
        let q_mm = data.log.own_q_mm(&fit.model);
        let motions = mechanics.motions_from_readings(&data.log.times_s, &path, &q_mm);
        let gap = |k: usize| {
            let at = data.log.samples[k];
            q_mm[at] - mechanics.command(path[at], Some(&motions[at]))
        };
        let residuals = (0..data.len()).map(|k| -problem.response(k, &gap(k))).collect();
        let states = States::new(problem, &mechanics, (&path, &motions));
        let values = |term: &Term| match term.shared() {
            Some(shared) => (0..states.tried_mm(shared).len()).map(|place| Some(Tried { shared, place })).collect(),
            None => vec![None],
        };
        let with_values = |term: Term| values(&term).into_iter().map(move |tried| (term.clone(), tried));
        let scaled = |(term, tried): (Term, Option<Tried>)| {
            let summands = samples.iter().flat_map(|&k| states.summand_mm(&term, tried, k).to_vec());
            Candidate { scale: rms(summands), term, tried }
        };
        let all = dictionary(data.backbones()).into_iter().flat_map(with_values).map(scaled);
        let all = all.filter(|candidate| candidate.scale > 0.0).collect();
        Self { problem, fit, samples, residuals, states, all }
    }

    /// How many columns there are: the model's parameters, then the candidates' coefficients.
    fn columns(&self) -> usize {
        self.fit.parameter_count() + self.all.len()
    }

    /// A column at sample k: the residuals' derivatives by a parameter or a coefficient.
    fn column(&self, column: usize, k: usize) -> Residual {
        let n = self.problem.data.backbones();
        let Some(own) = column.checked_sub(self.fit.parameter_count()) else {
            return Residual::from_fn(n, |c| self.fit.jacobian[(n * k + c, column)]);
        };
        let Candidate { term, tried, scale } = &self.all[own];
        self.problem.response(k, &(self.states.summand_mm(term, *tried, k) / *scale))
    }

    fn blocks(&self) -> Blocks {
        let (data, columns) = (self.problem.data, self.columns());
        let of_sweep = data.blocks();
        let mut blocks: Blocks = std::array::from_fn(|_| Sums::zero(columns));
        for &k in &self.samples {
            let residuals = DVector::from_iterator(data.backbones(), self.residuals[k].iter().copied());
            let mut rows = DMatrix::zeros(data.backbones(), columns);
            for (column, mut place) in rows.column_iter_mut().enumerate() {
                place.iter_mut().zip(&self.column(column, k)).for_each(|(place, value)| *place = *value);
            }
            blocks[of_sweep[data.sweeps[k]]].add(&rows, &residuals);
        }
        blocks
    }

    fn selection(&self, blocks: &Blocks, without: Option<usize>) -> Selection {
        let tried: Vec<Option<Tried>> = self.all.iter().map(|candidate| candidate.tried).collect();
        Selection::new(blocks, (self.fit.parameter_count(), &tried), without)
    }

    /// The model with the law that was selected, which holds within the values of the samples that were seen; none where there is no law.
    fn start(&self, selection: &Selection, is_seen: impl Fn(usize) -> bool) -> Option<Model> {
        let fixed = self.fit.parameter_count();
        let columns = selection.columns();
        let x = selection.solution(&columns)?;
        let chosen: Vec<(&Candidate, f64)> = columns
            .iter()
            .zip(&x)
            .filter_map(|(&column, &x)| Some((&self.all[column.checked_sub(fixed)?], x)))
            .map(|(candidate, x)| (candidate, x / candidate.scale))
            .collect();
        let (definition, values) = self.states.definition(&chosen, is_seen)?;
        let effect = Effect::of(definition.physics().ok()?, values);
        let found = format!("discover --correction, {} samples", self.problem.data.len());
        let mut start = self.fit.model.clone();
        start.effects.push(Effect { found, ..effect });
        Some(start)
    }

    /// The model with the law of all samples, fitted; none where there is no law, or where it does not help as it stands.
    fn fitted(&self, blocks: &Blocks) -> Option<Model> {
        let start = self.start(&self.selection(blocks, None), |_| true)?;
        let fitted = self.problem.fit(&start, Some(&self.fit.path), None);
        let gap = |fit: &Fit| HeldOutResiduals::new(self.problem, fit).gap.eps_mm;
        (gap(&fitted) < gap(self.fit)).then(|| self.problem.with_clustered_covariance(&fitted))
    }
}

/// The bend at every reading: where the eye saw it, what it saw; else what the fit implies, rad.
fn seen(problem: &Problem, fit: &Fit) -> Vec<Vector2<f64>> {
    let mut path = fit.path.clone();
    for (k, (&at, measured)) in problem.data.log.samples.iter().zip(&problem.data.measured).enumerate() {
        path[at] += Rotation2::new(measured.configuration.delta) * problem.bend_gap(&fit.residuals, k);
    }
    path
}

/// What is left of each block by laws that were chosen and fitted without it: of every sample the mean square of the gap of ε over the
/// backbones, without a law and with it, mm². Both are predictions from the readings, as a model with the law makes them.
struct Judged {
    blocks: Vec<Vec<[f64; 2]>>,
}

impl Judged {
    fn new(candidates: &Candidates, blocks: &Blocks) -> Self {
        let Candidates { problem, fit, .. } = candidates;
        let (data, of_sweep) = (problem.data, problem.data.blocks());
        let block = |block: usize| {
            let is_seen = |k: usize| of_sweep[data.sweeps[k]] != block;
            let fitted = |start: &Model| problem.fit_to(start, Some(&fit.path), is_seen);
            let base = fitted(&fit.model);
            let with =
                candidates.start(&candidates.selection(blocks, Some(block)), is_seen).map(|start| fitted(&start));
            let sides = [&base, with.as_ref().unwrap_or(&base)];
            let left = |k: usize| {
                sides.map(|fit| {
                    let gap = problem.eps_gap_mm(&fit.residuals, k);
                    gap.norm_squared() / gap.len() as f64
                })
            };
            (problem.noise.unknown_start..data.len()).filter(|k| !is_seen(*k)).map(left).collect()
        };
        Self { blocks: (0..FOLDS).into_par_iter().map(block).collect() }
    }

    /// Without a law (side 0) or with it (side 1).
    fn rms_mm(&self, side: usize) -> f64 {
        mean(self.blocks.iter().flatten().map(|sides| sides[side])).sqrt()
    }

    /// On every block, and enough on all together.
    fn helps(&self) -> bool {
        let sum = |block: &[[f64; 2]], side: usize| block.iter().map(|sides| sides[side]).sum::<f64>();
        let on_every_block =
            self.blocks.iter().filter(|block| !block.is_empty()).all(|block| sum(block, 1) < sum(block, 0));
        on_every_block && self.rms_mm(1).powi(2) < (1.0 - LEAST_SHARE) * self.rms_mm(0).powi(2)
    }
}

/// The variables of the terms at every sample.
struct States {
    variables: Vec<(Variable, Vec<PerBackbone>)>,
    /// Where q stands in a play of each width, mm.
    plays: Vec<Vec<PerBackbone>>,
    half_widths_mm: Vec<f64>,
    scales_mm: Vec<f64>,
}

impl States {
    fn new(problem: &Problem, mechanics: &Mechanics, (path, motions): (&[Vector2<f64>], &[Motion])) -> Self {
        let (n, log) = (problem.data.backbones(), &problem.data.log);
        let value = |variable: Variable, at: usize| {
            mechanics
                .instant(path[at], &motions[at], |instant| PerBackbone::from_fn(n, |i| variable.value(instant, i, 0)))
        };
        use Variable::{Direction, Load, Q, QOf, Speed, Theta, Time, X, Y};
        let names = [Q, Direction, Speed, Time, X, Y, Theta, Load].into_iter().chain((1..=n).map(QOf));
        let variables = names.map(|name| (name, log.samples.iter().map(|&at| value(name, at)).collect())).collect();
        let q: Vec<PerBackbone> = (0..log.q_mm.len()).map(|at| value(Q, at)).collect();
        let most = q.iter().map(|q| q.amax()).fold(0.0, f64::max);
        let least = (LEAST_WIDTH * problem.noise.sd_encoder_mm).min(most);
        let width = |w: usize| least * (0.5 * most / least).max(1.0).powf(w as f64 / (WIDTHS - 1) as f64);
        let half_widths_mm: Vec<f64> = (0..WIDTHS).map(width).collect();
        let plays = half_widths_mm.iter().map(|half| {
            let all = play(&q, *half);
            log.samples.iter().map(|&at| all[at]).collect()
        });
        let scales_mm = (1..=SCALES).map(|s| most / 3f64.powi(s as i32)).collect();
        Self { variables, plays: plays.collect(), half_widths_mm, scales_mm }
    }

    /// The values that are tried of a parameter, mm.
    fn tried_mm(&self, shared: Shared) -> &[f64] {
        match shared {
            Shared::HalfGap => &self.half_widths_mm,
            Shared::Scale => &self.scales_mm,
        }
    }

    fn of(&self, variable: Variable) -> &[PerBackbone] {
        self.variables.iter().find(|(own, _)| *own == variable).map_or(&[], |(_, values)| values)
    }

    /// A term with coefficient 1 at sample k, mm.
    fn summand_mm(&self, term: &Term, tried: Option<Tried>, k: usize) -> PerBackbone {
        let n = self.of(Variable::Q)[k].len();
        let values = |variable: Variable| match (variable, tried) {
            (Variable::Play, Some(tried)) => self.plays[tried.place][k],
            _ => self.of(variable)[k],
        };
        let on = PerBackbone::from_fn(n, |i| f64::from(u8::from(term.on.is_none_or(|on| on == i + 1))));
        term.factors.iter().fold(on, |product, factor| {
            let values = values(factor.variable);
            product.component_mul(&match (factor.shape, tried) {
                (Shape::Absolute, _) => values.map(f64::abs),
                (Shape::Saturating, Some(tried)) => values.map(|q| (q / self.scales_mm[tried.place]).tanh()),
                _ => values,
            })
        })
    }

    /// The law of these terms and coefficients, learned from the samples that were seen, and its parameters' values in their order; none
    /// without terms.
    fn definition(
        &self,
        chosen: &[(&Candidate, f64)],
        is_seen: impl Fn(usize) -> bool,
    ) -> Option<(Definition, Vec<f64>)> {
        if chosen.is_empty() {
            return None;
        }
        let mut parameters: BTreeMap<String, (Defined, f64)> = BTreeMap::new();
        let mut texts = Vec::new();
        let mut domain = BTreeMap::new();
        for (place, (candidate, value)) in chosen.iter().enumerate() {
            let (term, name) = (&candidate.term, format!("c{}", place + 1));
            let text = term.to_string();
            texts.push(format!("{name} * {text}"));
            let most = 10f64.powf((RANGE_OF_COEFFICIENT * value.abs()).log10().ceil());
            let defined = Defined { unit: term.unit_of_coefficient(), range: [-most, most], starts: Vec::new() };
            parameters.insert(name, (defined, *value));
            if let Some(Tried { shared, place }) = candidate.tried {
                let (name, range) = self.range_of_shared(shared);
                let start = self.tried_mm(shared)[place];
                let defined = Defined { unit: "mm".into(), range, starts: vec![start] };
                parameters.insert(name.to_owned(), (defined, start));
            }
            for factor in &term.factors {
                if let Some(range) = self.range_of(factor.variable, &is_seen) {
                    domain.insert(factor.variable.name(), range);
                }
            }
        }
        let values = parameters.values().map(|(_, value)| *value).collect();
        let definition = Definition {
            name: PROPOSED_LAW.to_owned(),
            formula: texts.join(" + "),
            reading: "a gap without a name, which a law takes off that was learned from it".to_owned(),
            parameters: parameters.into_iter().map(|(name, (defined, _))| (name, defined)).collect(),
            domain,
        };
        Some((definition, values))
    }

    /// The name and the range of a parameter that is not linear, mm.
    fn range_of_shared(&self, shared: Shared) -> (&'static str, [f64; 2]) {
        let most = self.of(Variable::Q).iter().map(|q| q.amax()).fold(0.0, f64::max);
        match shared {
            Shared::HalfGap => (HALF_GAP, [0.0, 2.0 * most]),
            Shared::Scale => (SCALE, [most / 3f64.powi(SCALES as i32) / RANGE_OF_SCALE, RANGE_OF_SCALE * most]),
        }
    }

    /// The least and the largest value of a variable at the samples that were seen; none of those that have ends of their own.
    fn range_of(&self, variable: Variable, is_seen: impl Fn(usize) -> bool) -> Option<[f64; 2]> {
        if matches!(variable, Variable::Direction | Variable::Play | Variable::On(_)) {
            return None;
        }
        let seen: Vec<&PerBackbone> =
            self.of(variable).iter().enumerate().filter(|(k, _)| is_seen(*k)).map(|(_, values)| values).collect();
        let values = || seen.iter().flat_map(|values| values.iter().copied());
        Some([values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max)])
    }
}

/// Where q stands in a play of this half width at every reading, from the middle at rest, mm.
fn play(q_mm: &[PerBackbone], half_mm: f64) -> Vec<PerBackbone> {
    let Some(first) = q_mm.first() else { return Vec::new() };
    let (rest, half) = (PerBackbone::repeat(first.len(), 0.0), PerBackbone::repeat(first.len(), half_mm));
    let steps = q_mm.iter().scan((rest, rest), |(play, before), q| {
        *play = Play::crossed(*play, *q - *before, &half);
        *before = *q;
        Some(*play)
    });
    steps.collect()
}

impl ProposedLaw {
    /// The effect of the model; none where no law is proposed.
    pub fn effect(&self) -> Option<&Effect> {
        self.model.as_ref()?.effects.iter().find(|effect| effect.physics.name == PROPOSED_LAW)
    }

    /// The entry `correction` of discrepancy.json.
    pub fn json(&self) -> Value {
        json!({
            "kept": self.model.is_some(),
            "name": self.effect().map(|effect| effect.physics.name),
            "equation": self.effect().map(|effect| effect.physics.equation),
            "before_mm": self.before_mm,
            "after_mm": self.after_mm,
            "words": self.words,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_play_follows_within_its_width() {
        let q: Vec<PerBackbone> = [0.0, 0.3, 0.5, 0.4, 0.1, -0.2].map(|q| PerBackbone::from([q, -q, 0.0])).to_vec();
        let stands: Vec<f64> = play(&q, 0.2).iter().map(|play| play[0]).collect();
        let expected = [0.0, 0.2, 0.2, 0.1, -0.2, -0.2];
        assert!(stands.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{stands:?}");
    }
}
