//! An experiment as it would have been without a model's effects.

use super::mechanics::Mechanics;
use super::{Model, PerBackbone};
use crate::geometry::Configuration;

/// One instant of an experiment: what encoders read and what the eye measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation {
    /// Time, s.
    pub time_s: f64,
    /// q̃, mm.
    pub q_mm: PerBackbone,
    /// The measured configuration.
    pub configuration: Configuration,
}

impl Model {
    /// The experiment as it would have been without the model's effects: what its effects did to q̃ and to the measured
    /// bend is taken off, so that the [plain](Self::plain) model leaves the same gap of these as the model does of the
    /// given ones. Observations come in the order of time.
    pub fn without_effects(&self, observations: &[Observation]) -> Vec<Observation> {
        if self.effects.is_empty() {
            return observations.to_vec();
        }
        let Some(first) = observations.first() else { return Vec::new() };
        let (mechanics, plain) = (Mechanics::new(self), self.plain());
        let plain = Mechanics::new(&plain);
        let times_s: Vec<f64> = observations.iter().map(|o| o.time_s).collect();
        let q_tilde: Vec<PerBackbone> = observations.iter().map(|o| o.q_mm).collect();
        // From where the eye measured the snake: of several bends that a steep screw error allows, the one that it had.
        let shown: Vec<_> = observations.iter().map(|o| mechanics.true_bend(o.configuration.bend_vector())).collect();
        let (path, _) = mechanics.solve_path_near(&times_s, &q_tilde, &shown, Some(first.configuration.bend_vector()));
        let bends: Vec<_> = path.iter().map(|solution| solution.bend).collect();
        let exposed = mechanics.exposed_bends(&times_s, &bends);
        let remains = observations.iter().enumerate().map(|(k, observation)| {
            let q_mm = plain.command(bends[k], None) + path[k].residual_mm;
            let configuration = Configuration::from_bend_vector(shown[k] + bends[k] - exposed[k]);
            Observation { q_mm, configuration, ..*observation }
        });
        remains.collect()
    }
}
