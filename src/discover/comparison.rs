//! The comparison of a model with the same model without one of its effects: the evidence, and the decision.

use super::data::Data;
use super::fit::Fit;
use super::sweep_equations::{SweepEquations, selection_shares};

/// An effect must explain at least this share of the gap's excess over noise. One that explains less may be the trace of another
/// effect, whose form the library does not have quite right.
///
/// Fitted: to the project's sealed experiments, as far as is known (how was not recorded); judged on tools/sealed only.
const LEAST_EXCESS_SHARE: f64 = 0.004;

/// An effect must be selected in this share of the bootstrap resamples, so that a few sweeps alone do not name it.
///
/// Source: the strict end of the range from 0.6 to 0.9 for such shares in Meinshausen and Bühlmann 2010, Stability selection, J. R.
/// Stat. Soc. B 72:417.
pub const LEAST_INCLUSION: f64 = 0.9;

/// What speaks for an effect.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Evidence {
    /// How much larger the Bayesian information criterion is without it.
    pub bic_gain: f64,
    /// The share of the gap's excess over noise that it explains.
    pub excess_share: f64,
    /// The share of the held-out squares that it removes; negative where it makes predictions worse.
    pub held_out_gain: f64,
    /// The share of bootstrap resamples of the sweeps in which the model with it is the best of all compared.
    pub inclusion: f64,
}

/// A criterion that the evidence for an effect may fail.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Criterion {
    /// The best hypothesis gains as much on noise alone.
    BeyondNoise,
    /// It explains too little of the gap to matter.
    Relevant,
    /// Predictions of held-out sweeps do not improve.
    Predictive,
    /// Some sweeps ask for it, and most resamples do not.
    Stable,
}

impl Evidence {
    /// The first criterion that the evidence fails; none where the effect is accepted. `least_bic_gain` is what the best hypothesis
    /// gains on noise alone in a share of experiments that is the test's level.
    pub fn failed_criterion(&self, least_bic_gain: f64) -> Option<Criterion> {
        [
            (self.bic_gain >= least_bic_gain, Criterion::BeyondNoise),
            (self.excess_share >= LEAST_EXCESS_SHARE, Criterion::Relevant),
            (self.held_out_gain > 0.0, Criterion::Predictive),
            (self.inclusion >= LEAST_INCLUSION, Criterion::Stable),
        ]
        .into_iter()
        .find_map(|(fulfilled, criterion)| (!fulfilled).then_some(criterion))
    }
}

/// A fit compared with the one without an effect, and with others in which another effect stands in its place.
#[derive(Debug, Clone)]
pub struct Comparison {
    /// What speaks for the effect.
    pub evidence: Evidence,
    /// For each alternative the share of bootstrap resamples in which it is the best.
    pub alternative_shares: Vec<f64>,
}

impl Comparison {
    /// `excess` is the squares of the gap beyond those of noise, before anything was added.
    pub fn new(data: &Data, fit: &Fit, without: &Fit, alternatives: &[Fit], excess: f64) -> Self {
        let fits = [fit, without].into_iter().chain(alternatives);
        let equations: Vec<SweepEquations> = fits.map(|fit| SweepEquations::new(data, fit)).collect();
        let shares = selection_shares(data.residual_count(), &equations);
        let [held_out, held_out_without] = [&equations[0], &equations[1]].map(SweepEquations::held_out_cost);
        let evidence = Evidence {
            bic_gain: without.bic() - fit.bic(),
            excess_share: if excess > 0.0 { (without.cost - fit.cost) / excess } else { 1.0 },
            held_out_gain: if held_out_without > 0.0 { 1.0 - held_out / held_out_without } else { 0.0 },
            inclusion: shares[0],
        };
        Self { evidence, alternative_shares: shares[2..].to_vec() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_criterion_that_fails_is_named() {
        let good = Evidence { bic_gain: 20.0, excess_share: 0.5, held_out_gain: 0.3, inclusion: 0.97 };
        let table = [
            (good, None),
            (Evidence { bic_gain: 4.9, held_out_gain: -1.0, ..good }, Some(Criterion::BeyondNoise)),
            (Evidence { excess_share: 0.003, inclusion: 0.5, ..good }, Some(Criterion::Relevant)),
            (Evidence { held_out_gain: 0.0, inclusion: 0.5, ..good }, Some(Criterion::Predictive)),
            (Evidence { held_out_gain: f64::NAN, ..good }, Some(Criterion::Predictive)),
            (Evidence { inclusion: 0.895, ..good }, Some(Criterion::Stable)),
            (Evidence { bic_gain: 5.0, excess_share: 0.004, inclusion: 0.9, ..good }, None),
        ];
        for (evidence, expected) in table {
            assert_eq!(evidence.failed_criterion(5.0), expected, "{evidence:?}");
        }
    }
}
