//! Hypotheses: the model with one effect of the library more, at the values where its fit begins.

use super::fit::Fit;
use super::periodogram;
use super::predictive_density::Beside;
use super::residuals::Problem;
use crate::robot::effects::{Changes, Starts};
use crate::robot::{Effect, Model, Physics};

/// Widths of plays that are tried, in halves of the range of the commands.
///
/// Convention: from the least that matters to nearly all, each about 1.4 times the one before, so that a fit finds its way between two.
const WIDTHS: [f64; 10] = [0.03, 0.05, 0.08, 0.12, 0.18, 0.26, 0.37, 0.5, 0.65, 0.85];

/// Travels over which a friction turns round that are tried, in the same unit.
///
/// Convention: each twice to three times the one before; the exponential of the loop changes that slowly.
const TRAVELS: [f64; 5] = [0.04, 0.1, 0.25, 0.6, 1.5];

/// The gap with which the travel of a friction is tried, in the same unit.
///
/// Convention: any; the fit is linear in it.
const GAP: f64 = 0.2;

/// A model with one effect more.
#[derive(Debug, Clone)]
pub struct Hypothesis {
    /// The effect that is added; the last of the model's.
    pub physics: &'static Physics,
    /// The model, the effect at its starting values.
    pub start: Model,
}

impl Hypothesis {
    /// A model with an effect at these values besides its own.
    pub fn new(model: &Model, physics: &'static Physics, values: Vec<f64>) -> Self {
        let mut start = model.clone();
        start.effects.push(Effect::of(physics, values));
        Self { physics, start }
    }
}

/// Every effect that is looked for beside noise or a discrepancy, that `admits` and whose name the fitted model does not have, in each of its
/// forms, at each of its starts. `half_mm` is half the range of the commands.
pub fn hypotheses(
    problem: &Problem,
    fit: &Fit,
    (beside, half_mm): (Beside, f64),
    admits: impl Fn(&Physics) -> bool,
) -> Vec<Hypothesis> {
    let is_lacking = |physics: &&Physics| {
        let is_looked_for = is_looked_for(physics, beside, problem.data.is_driven);
        admits(physics) && is_looked_for && is_compatible(&fit.model, physics, beside)
    };
    let lacking: Vec<&'static Physics> = problem.data.library.iter().copied().filter(is_lacking).collect();
    let has_periodic = lacking.iter().any(|physics| physics.is_periodic());
    let periodic = if has_periodic { periodogram::starts(problem, fit) } else { Vec::new() };
    let n = problem.data.backbones();
    let starts = |physics: &Physics| match (physics.starts, beside) {
        (Starts::Periodogram(phases), _) => {
            periodic.iter().filter(|(own, _)| *own == phases).map(|(_, start)| start.clone()).collect()
        }
        (_, Beside::Noise) => physics.given_starts(n).collect(),
        (_, Beside::Discrepancy) => starts_over(physics, n, half_mm),
    };
    let each = lacking.into_iter().flat_map(|physics| starts(physics).into_iter().map(move |values| (physics, values)));
    each.map(|(physics, values)| Hypothesis::new(&fit.model, physics, values)).collect()
}

/// Beside noise, the drive is not looked for: a plant that is near its model shows no row within a backlash, and says of it what
/// `motion_directed_backlash` says; its gain is another name of η. Only actuators that are driven to positions show rows within one. Beside a discrepancy, neither periodic effects nor those of time are: a wave with a
/// pitch of its own fits any smooth gap over a few of its periods, and a drift or a creep any change from one run to the next.
fn is_looked_for(physics: &Physics, beside: Beside, is_driven: bool) -> bool {
    match beside {
        Beside::Noise => !matches!(physics.changes, Changes::Drive(_)) || is_driven && physics.is_hysteresis(),
        Beside::Discrepancy => !physics.in_time && !physics.is_periodic(),
    }
}

/// Whether a model may have it besides its own, of which none tells of it already. Beside a discrepancy it has one hysteresis at most: two of them
/// describe one loop.
fn is_compatible(model: &Model, physics: &Physics, beside: Beside) -> bool {
    let has_hysteresis = || model.effects.iter().any(|effect| effect.physics.is_hysteresis());
    let is_second = beside == Beside::Discrepancy && physics.is_hysteresis() && has_hysteresis();
    let is_told = model.effects.iter().any(|effect| effect.physics.includes.contains(&physics.name));
    !has(model, physics.name) && !is_told && !is_second
}

/// Where the fits of an effect start: of what has a width or a travel, over the range of the commands.
fn starts_over(physics: &Physics, backbones: usize, half_mm: f64) -> Vec<Vec<f64>> {
    let given: Vec<Vec<f64>> = physics.given_starts(backbones).collect();
    let specs = physics.parameters_on(backbones);
    let mut shapes: Vec<&[f64]> = given.iter().map(|start| &start[1..]).collect();
    shapes.dedup();
    let with = |first: f64, second: Option<f64>, shape: &[f64]| {
        let mut values = [&[first], shape].concat();
        if let (Some(value), Some(second)) = (values.get_mut(1), second) {
            *value = second;
        }
        values.iter().zip(specs).map(|(value, spec)| value.clamp(spec.range.0, spec.range.1)).collect()
    };
    let is_width = specs[0].name == "half_gap_mm" && given.iter().any(|start| start[0] > 0.0);
    match specs.get(1) {
        Some(travel) if is_width && travel.unit == "mm" => {
            TRAVELS.iter().map(|share| with(GAP * half_mm, Some(share * half_mm), shapes[0])).collect()
        }
        _ if is_width => {
            shapes.iter().flat_map(|shape| WIDTHS.map(|share| with(share * half_mm, None, shape))).collect()
        }
        _ => given,
    }
}

/// Whether a model has an effect of this name.
pub fn has(model: &Model, name: &str) -> bool {
    model.effects.iter().any(|effect| effect.physics.name == name)
}

/// The best fit of the model with an effect of this name more, over its forms and starts; the fit itself where there is none.
pub fn best_with(problem: &Problem, fit: &Fit, name: &str) -> Fit {
    hypotheses(problem, fit, (Beside::Noise, 0.0), |physics| physics.name == name)
        .into_iter()
        .map(|hypothesis| problem.fit(&hypothesis.start, Some(&fit.path), None))
        .min_by(|a, b| a.bic().total_cmp(&b.bic()))
        .unwrap_or_else(|| fit.clone())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::discover::fixture::truth;
    use crate::robot::effects::{forms, physics};

    #[test]
    fn a_backlash_that_is_wider_to_one_side_is_tried_to_all_sides_and_stands_beside_no_bend_at_rest() {
        let uneven = forms("backlash").find(|physics| physics.form == "wider to one side").unwrap();
        let starts = starts_over(uneven, 3, 1.0);
        assert_eq!(starts.len(), 4 * WIDTHS.len());
        assert!(starts.iter().all(|start| WIDTHS.contains(&start[0]) && start[1].abs() + start[2].abs() == 0.4));
        let model = Hypothesis::new(&truth(), uneven, starts[0].clone()).start;
        let stands = |name| is_compatible(&model, physics(name).unwrap(), Beside::Discrepancy);
        assert!(!stands("rest_bend") && stands("command_gain") && !stands("bouc_wen"));
    }
}
