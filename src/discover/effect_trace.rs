//! What an effect does over the motion: the loop of the bend over the command, and the gap over what the effect follows, with the effect
//! and without it.

use super::data::Data;
use super::discovery::Discovery;
use super::residuals::Problem;
use crate::robot::{Mechanics, PerBackbone};
use crate::statistics::correlation::correlation_ratio;
use nalgebra::{Rotation2, Vector2};

/// Classes of equal count into which a quantity is divided, to see how much of an effect follows it.
///
/// Convention: fine enough for a wave of a few periods.
const CLASSES: usize = 16;

/// An effect of the answer at every sample.
#[derive(Debug, Clone)]
pub struct EffectTrace {
    /// The backbone on which it does most, counted from 1.
    pub backbone: usize,
    /// That backbone's q̃, mm.
    pub command_mm: Vec<f64>,
    /// The bend towards that backbone that was measured, degrees.
    pub measured_deg: Vec<f64>,
    /// The same by the model without the effect, all else fitted anew, and with it, degrees.
    pub modelled_deg: [Vec<f64>; 2],
    /// What both leave of that backbone's ε, mm.
    pub gap_mm: [Vec<f64>; 2],
    /// The quantity, with its unit, whose classes explain most of what the effect does.
    pub follows: String,
    /// Its values.
    pub followed: Vec<f64>,
}

/// A trace of each effect that was found, in the order of [`Discovery::named`].
pub fn effect_traces(found: &Discovery, data: &Data) -> Vec<EffectTrace> {
    if !found.verdict.has_effects() {
        return Vec::new();
    }
    let problem = Problem::new(data, &found.noise, &found.model);
    let prediction = problem.predict(&found.model, None);
    let path = prediction.path();
    let bends: Vec<Vector2<f64>> = data.log.samples.iter().map(|&at| path[at]).collect();
    let with = prediction.residuals;
    let effects = found.given_effects()..found.model.effects.len();
    let trace = |k: usize| {
        let without = problem.fit(&found.model.without_effect(k), None, None).residuals;
        let gaps = [&without, &with].map(|residuals| -> Vec<PerBackbone> {
            (0..data.len()).map(|k| problem.eps_gap_mm(residuals, k)).collect()
        });
        let does: Vec<PerBackbone> = gaps[0].iter().zip(&gaps[1]).map(|(without, with)| *without - *with).collect();
        let size = |i: usize| does.iter().map(|does| does[i].powi(2)).sum::<f64>();
        let i = (0..data.backbones()).max_by(|&a, &b| size(a).total_cmp(&size(b))).unwrap_or(0);
        let towards = found.model.robot.backbone_directions()[i];
        let measured = |k: usize| data.measured[k].configuration.bend_vector();
        let modelled = |residuals: &[PerBackbone], k: usize| {
            let gap = Rotation2::new(data.measured[k].configuration.delta) * problem.bend_gap(residuals, k);
            (measured(k) - gap).dot(&towards).to_degrees()
        };
        let does: Vec<f64> = does.iter().map(|does| does[i]).collect();
        let in_time = found.model.effects[k].physics.in_time;
        let (follows, followed) = most_followed(&does, quantities(found, data, (&bends, i), in_time));
        EffectTrace {
            backbone: i + 1,
            command_mm: data.q_mm.iter().map(|q| q[i]).collect(),
            measured_deg: (0..data.len()).map(|k| measured(k).dot(&towards).to_degrees()).collect(),
            modelled_deg: [&without, &with].map(|residuals| (0..data.len()).map(|k| modelled(residuals, k)).collect()),
            gap_mm: gaps.map(|gaps| gaps.iter().map(|gap| gap[i]).collect()),
            follows,
            followed,
        }
    };
    effects.map(trace).collect()
}

/// What an effect on backbone i may follow, each with its unit, at every sample. Within a sweep nearly everything follows the time, which
/// is therefore one of them for effects of time alone.
fn quantities(
    found: &Discovery,
    data: &Data,
    (bends, i): (&[Vector2<f64>], usize),
    in_time: bool,
) -> Vec<(String, Vec<f64>)> {
    let mechanics = Mechanics::new(&found.model);
    let load = |bend: &Vector2<f64>| mechanics.forces_n(*bend).iter().map(|tau| tau.abs()).sum();
    let angles = |of: fn(&crate::geometry::Configuration) -> f64| -> Vec<f64> {
        data.measured.iter().map(|measured| of(&measured.configuration)).collect()
    };
    let moved = data.log.samples.iter().map(|&at| data.log.q_mm[at][i] - data.log.q_mm[at.saturating_sub(1)][i]);
    let mut quantities = vec![
        ("θ (°)".to_owned(), angles(|configuration| configuration.theta_deg())),
        ("δ (°)".to_owned(), angles(|configuration| configuration.delta_deg())),
        (format!("q̃ of backbone {} (mm)", i + 1), data.q_mm.iter().map(|q| q[i]).collect()),
        ("load (N)".to_owned(), bends.iter().map(load).collect()),
        (format!("motion of q̃ of backbone {} since the reading before (mm)", i + 1), moved.collect()),
    ];
    if in_time {
        quantities.push(("time (s)".to_owned(), data.times_s.clone()));
    }
    quantities
}

/// The quantity whose classes explain most of some values.
fn most_followed(values: &[f64], quantities: Vec<(String, Vec<f64>)>) -> (String, Vec<f64>) {
    let share = |(_, quantity): &(String, Vec<f64>)| correlation_ratio(quantity, values, CLASSES);
    quantities.into_iter().max_by(|a, b| share(a).total_cmp(&share(b))).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::discover::{Verdict, discover};
    use crate::robot::{Model, effects};
    use crate::simulate::Sealed;

    #[test]
    fn the_trace_of_a_play_is_a_loop_that_the_effect_closes() {
        let play = effects::physics("play_at_bend").unwrap();
        let sealed = Sealed::new(&[play], 1000).unwrap();
        let data = Data::new(&sealed.measurements, &sealed.readings, 0.0015).unwrap();
        let found = discover(&Model::default(), &data);
        assert_eq!(found.verdict, Verdict::Named);
        let [trace] = &effect_traces(&found, &data)[..] else { panic!("one effect") };
        let squares = |gaps: &[f64]| gaps.iter().map(|gap| gap * gap).sum::<f64>();
        assert!(squares(&trace.gap_mm[1]) < 0.05 * squares(&trace.gap_mm[0]));
        // A bend misses by as much as ε does, over the backbones' circle.
        let missed = |side: usize| trace.measured_deg.iter().zip(&trace.modelled_deg[side]).map(|(a, b)| a - b);
        let [without, with] = [0, 1].map(|side| squares(&missed(side).collect::<Vec<_>>()));
        assert!(with < 0.1 * without, "{with} of {without}");
    }
}
