//! The verdict: named, partly, none or unexplained.

use super::structure::Structure;

/// The share of the gap's excess over noise that a right effect may leave, where its form is not quite that of the machine.
///
/// Fitted: to the project's sealed experiments, as far as is known (how was not recorded); judged on tools/sealed only.
const LEFT_BY_FORM: f64 = 0.04;

/// The answer of a discovery.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// Effects of the library account for the gap.
    Named,
    /// Effects of the library help on held-out sweeps, and more than noise is left.
    Partly,
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
            Self::Partly => "partly",
            Self::None => "none",
            Self::Unexplained => "unexplained",
        }
    }

    /// Whether the answer's effects are in the model.
    pub fn has_effects(self) -> bool {
        matches!(self, Self::Named | Self::Partly)
    }

    /// From whether the search found effects, and the structure of the residuals before and after; whether the answer is a partial one
    /// is another question. Effects are to account for all but the noise that was learned; without any, a gap that is no larger than the noise that is stated
    /// is none. Of actuators that are driven to positions the bend alone is to be accounted for: what bends nothing follows their commands, and no effect
    /// could change what it leaves.
    pub fn new(found_effects: bool, is_driven: bool, before: &Structure, after: &Structure) -> Self {
        let accounts_for =
            |part: usize| !after.exceeds_learned(part) || after.excess(part) < LEFT_BY_FORM * before.excess(part);
        let parts = if is_driven { 0..1 } else { 0..2 };
        match found_effects {
            true if parts.clone().all(accounts_for) => Self::Named,
            false if !parts.clone().any(|part| after.exceeds_noise(part)) => Self::None,
            _ => Self::Unexplained,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::structure::NoiseQuantiles;
    use super::*;

    /// Residuals with these mean squares of bend and common part, and with an order in both or in none.
    fn structure(mean_square: [f64; 2], has_order: bool) -> Structure {
        let noise = NoiseQuantiles { mean_square: [1.1, 1.2], successive: [3.0, 2.8], follows: 5.0 };
        let successive = vec![if has_order { 3.5 } else { 1.0 }; 3];
        Structure { mean_square, successive, follows: vec![("time", 2.0)], is_as_stated: [false; 2], noise }
    }

    #[test]
    fn the_verdict_follows_the_table() {
        let noise = structure([1.05, 1.1], false);
        let gap = structure([20.0, 30.0], true);
        for (found_effects, after, expected) in [
            (false, structure([1.05, 1.1], true), Verdict::None),
            // Sigmas that are stated too small: large, and without an order.
            (false, structure([3.0, 3.0], false), Verdict::None),
            (false, gap.clone(), Verdict::Unexplained),
            // As large as the noise that is stated, which hangs together from one sample to the next.
            (false, Structure { is_as_stated: [true; 2], ..structure([1.8, 1.0], true) }, Verdict::None),
            (false, Structure { is_as_stated: [true, false], ..gap.clone() }, Verdict::Unexplained),
            (true, noise, Verdict::Named),
            // The form of the effect leaves (1.5 − 1) / (20 − 1) = 2.6 % of the bend's gap, or (2 − 1) / 19 = 5.3 %.
            (true, structure([1.5, 1.0], true), Verdict::Named),
            (true, structure([2.0, 1.0], true), Verdict::Unexplained),
            (true, structure([1.0, 3.0], true), Verdict::Unexplained),
        ] {
            assert_eq!(Verdict::new(found_effects, false, &gap, &after), expected, "{after:?}");
        }
        let readings_alone = structure([1.0, 3.0], true);
        assert_eq!(Verdict::new(true, true, &gap, &readings_alone), Verdict::Named);
        assert_eq!(Verdict::new(true, true, &gap, &structure([3.0, 1.0], true)), Verdict::Unexplained);
    }
}
