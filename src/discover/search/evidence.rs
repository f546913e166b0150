//! What speaks for each effect of the answer, and which structures the data leave open.

use super::scored::Structure;
use super::{OPEN, Search};
use crate::discover::hypotheses::has;
use crate::discover::posterior::Candidate;
use crate::discover::predictive_density::Beside;
use crate::discover::structure_weights::{RESAMPLES, Weighed, weights};
use crate::robot::Physics;
use std::collections::BTreeMap;

/// What speaks for an effect.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Evidence {
    /// Twice how much lower the score of the structure without it is, on the scale of an information criterion.
    pub bic_gain: f64,
    /// The share of the held-out squares that it removes; negative where it makes predictions worse.
    pub held_out_gain: f64,
    /// The probability of all structures with it among those that were compared.
    pub inclusion: f64,
}

/// An effect that stands in the search's answer.
#[derive(Debug, Clone)]
pub struct Named {
    /// What it is.
    pub physics: &'static Physics,
    /// What speaks for it; its inclusion is judged among all alternatives.
    pub evidence: Evidence,
    /// The share of the held-out excess over noise that it takes away.
    pub removes: f64,
    /// Effects that explain the data about as well in its place.
    pub indistinguishable_from: Vec<&'static str>,
    /// Every alternative in its place, with by how much twice its score is lower; the best first.
    pub alternatives: Vec<(&'static str, f64)>,
}

impl Named {
    /// The probability that it is there, by Laplace's rule of succession over the resamples. In a partial answer a play or friction stands for
    /// those of [`indistinguishable_from`](Self::indistinguishable_from) as well, which describe the same loop.
    pub fn probability(&self) -> f64 {
        (self.evidence.inclusion * RESAMPLES as f64 + 1.0) / (RESAMPLES as f64 + 2.0)
    }
}

impl Search<'_> {
    /// The evidence for effect k of the answer, and what it removes beside the others.
    pub(super) fn describe(&mut self, best: &Structure, bare: &Structure, k: usize) -> Named {
        let physics = best.fit.model.effects[k].physics;
        let simpler = self.problem.fit(&best.fit.model.without_effect(k), Some(&best.fit.path), None);
        let simpler = self.structure(simpler).unwrap_or_else(|| bare.clone());
        let removed = simpler.squares - best.squares;
        // The best score with each other effect in its place.
        let mut rivals: BTreeMap<&'static str, (&'static Physics, f64)> = BTreeMap::new();
        for own in self.scored.iter().filter(|own| !own.weighed.has(physics.name)) {
            for other in own.weighed.effects.iter().filter(|other| !has(&best.fit.model, other.name)) {
                let (_, score) = rivals.entry(other.name).or_insert((other, f64::NEG_INFINITY));
                *score = score.max(own.score());
            }
        }
        let is_alike = |(other, score): &&(&'static Physics, f64)| {
            let may_be = self.beside == Beside::Noise || physics.is_hysteresis() && other.is_hysteresis();
            may_be && *score > best.score() + OPEN.ln()
        };
        let alike: Vec<&'static str> = rivals.values().filter(is_alike).map(|(other, _)| other.name).collect();
        let worse = |(name, (_, score)): (&&'static str, &(_, f64))| (*name, 2.0 * (best.score() - score));
        let mut alternatives: Vec<(&'static str, f64)> = rivals.iter().map(worse).collect();
        alternatives.sort_by(|a, b| a.1.total_cmp(&b.1));
        let of_one_loop = |own: &Weighed| self.beside == Beside::Discrepancy && alike.iter().any(|name| own.has(name));
        let weights = weights(&self.weighed());
        let with_it = self
            .scored
            .iter()
            .zip(&weights)
            .filter(|(own, _)| own.weighed.has(physics.name) || of_one_loop(&own.weighed));
        let inclusion = with_it.map(|(_, weight)| weight).sum();
        Named {
            physics,
            evidence: Evidence {
                bic_gain: 2.0 * (best.score() - simpler.score()),
                held_out_gain: removed / simpler.squares,
                inclusion,
            },
            removes: (removed / self.gap).clamp(0.0, 1.0),
            indistinguishable_from: alike,
            alternatives,
        }
    }

    /// The structures that the data leave open, the most probable first.
    pub(super) fn open(&self) -> Vec<Candidate> {
        let weights = weights(&self.weighed());
        let most = weights.iter().copied().fold(0.0, f64::max);
        let open = || weights.iter().zip(&self.scored).filter(|(weight, _)| **weight > OPEN * most);
        let sum: f64 = open().map(|(weight, _)| weight).sum();
        let candidate = |(weight, structure): (&f64, &Structure)| Candidate {
            effects: structure.weighed.effects.iter().map(|physics| physics.name).collect(),
            probability: weight / sum,
            model: structure.fit.model.clone(),
        };
        let mut open: Vec<Candidate> = open().map(candidate).collect();
        open.sort_by(|a, b| b.probability.total_cmp(&a.probability));
        open
    }

    fn weighed(&self) -> Vec<&Weighed> {
        self.scored.iter().map(|structure| &structure.weighed).collect()
    }
}
