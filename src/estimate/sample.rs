//! Measurements beside the encoder log: what of them can be used, and how the snake came there.

use super::{Reason, usable};
use crate::geometry::Configuration;
use crate::observation::{EncoderReading, Measured, Measurement};
use crate::robot::{ForwardSolution, Mechanics, Model, Motion, PathPoint, PerBackbone, Predicted, Predictor};
use nalgebra::Vector2;
use std::cell::LazyCell;
use std::collections::HashMap;

/// A measurement with the encoder reading of its index, where there is one.
pub type Pair = (Measurement, Option<EncoderReading>);

/// A measurement that can be used and its reading, without what the model's effects did.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlainSample {
    /// The frame's index.
    pub index: u64,
    /// When the reading was taken, s.
    pub time_s: f64,
    /// The bend seen.
    pub measured: Measured,
    /// The reading, mm.
    pub q_mm: PerBackbone,
}

/// A measurement that can be used, with its reading and with how the snake came there.
#[derive(Debug, Clone)]
pub(crate) struct Sample {
    /// What the eye measured.
    pub measured: Measured,
    /// The reading, less what neighbouring sections added, mm.
    pub q_tilde: PerBackbone,
    /// What the model's effects remember of the readings before; `None` for a model without effects.
    pub came: Option<Came>,
}

/// How the snake came to a reading, by a model with effects.
#[derive(Debug, Clone)]
pub(crate) struct Came {
    /// The motion to it.
    pub motion: Motion,
    /// Where the reading led by the model as it stood then.
    pub solution: ForwardSolution,
    /// The bend at the reading less the one that its frame shows, rad.
    pub since_frame: Vector2<f64>,
    /// The same by models each of which has one uncertain parameter of the effects [nudged](Model::nudged).
    pub nudged: Vec<Nudged>,
}

/// How the snake came to a reading by a model with one parameter nudged.
#[derive(Debug, Clone)]
pub(crate) struct Nudged {
    /// Which of the model's parameters it is.
    pub parameter: usize,
    /// The unit in which it is estimated.
    pub unit: f64,
    /// The reading, less what neighbouring sections added, mm.
    pub q_tilde: PerBackbone,
    /// The motion to it.
    pub motion: Motion,
    /// The bend at the reading less the one that its frame shows, rad.
    pub since_frame: Vector2<f64>,
}

impl Nudged {
    /// The difference quotient of a change in mm that a model with the parameter nudged makes, mm per unit of the parameter.
    pub fn difference(&self, model: &Model, change_mm: impl FnOnce(&Mechanics) -> PerBackbone) -> PerBackbone {
        let (nudged, step) = model.nudged(self.parameter);
        change_mm(&Mechanics::new(&nudged)) / step
    }
}

impl Sample {
    /// The motion to the reading; none for a model without effects, to which none matters.
    pub fn motion(&self) -> Motion {
        self.came.as_ref().map_or_else(|| Motion::none(self.q_tilde.len()), |came| came.motion)
    }

    /// How the snake came to the reading by nudged models; none for a model whose effects have no uncertain parameter.
    pub fn nudged(&self) -> &[Nudged] {
        self.came.as_ref().map_or(&[], |came| &came.nudged)
    }

    /// The bend at the reading, from the measured one, rad.
    pub fn true_bend(&self, mechanics: &Mechanics) -> Vector2<f64> {
        let measured = self.measured.configuration.bend_vector();
        self.came.as_ref().map_or(measured, |came| mechanics.true_bend(measured) + came.since_frame)
    }

    /// The measurement and the reading as they would have been without the effects of a model, the one that it came by.
    pub fn without_effects(&self, model: &Model) -> (Measured, PerBackbone) {
        let Some(came) = &self.came else { return (self.measured, self.q_tilde) };
        let configuration = Configuration::from_bend_vector(self.true_bend(&Mechanics::new(model)));
        let plain = model.plain();
        let q_tilde = Mechanics::new(&plain).command(came.solution.bend, None) + came.solution.residual_mm;
        (Measured { configuration, ..self.measured }, q_tilde)
    }
}

/// Goes along an encoder log, and carries what a model's effects remember from reading to reading.
#[derive(Debug, Clone, Default)]
pub(crate) struct Follower {
    predictor: Predictor,
    /// What the effects remember if one of the model's parameters is nudged: which, its unit, and its predictor.
    nudged: Vec<(usize, f64, Predictor)>,
}

impl Follower {
    /// One that tells how what is remembered depends on these parameters, each with its unit, as well.
    pub fn by_parameters(parameters: impl Iterator<Item = (usize, f64)>) -> Self {
        let nudged = parameters.map(|(parameter, unit)| (parameter, unit, Predictor::default())).collect();
        Self { predictor: Predictor::default(), nudged }
    }

    /// Takes a reading whose frame was not measured: it drives whatever has a memory.
    pub fn pass(&mut self, model: &Model, reading: &EncoderReading) {
        self.follow(model, reading, None);
    }

    /// Takes a measurement and its reading.
    ///
    /// # Errors
    /// Why they cannot be used. The reading is followed nevertheless.
    pub fn take(
        &mut self,
        model: &Model,
        measurement: &Measurement,
        reading: Option<&EncoderReading>,
    ) -> Result<Sample, Reason> {
        let own = reading.map(|reading| reading.beside_resting_neighbours(model));
        let used = usable(model.robot.backbone_count(), measurement, own.as_ref());
        let seen = used.as_ref().ok().map(|(measured, _)| measured.configuration.bend_vector());
        let came = reading.and_then(|reading| self.follow(model, reading, seen));
        let (measured, q_tilde) = used?;
        // A reading of no time leads nowhere where the way matters.
        if came.is_none() && !model.effects.is_empty() {
            return Err(Reason::NotFinite);
        }
        Ok(Sample { measured, q_tilde, came })
    }

    fn follow(&mut self, model: &Model, reading: &EncoderReading, seen: Option<Vector2<f64>>) -> Option<Came> {
        let own = reading.beside_resting_neighbours(model);
        let is_one = own.q_mm.len() == model.robot.backbone_count() && is_finite(&own);
        if model.effects.is_empty() || !is_one {
            return None;
        }
        let mechanics = Mechanics::new(model);
        let predicted = self.predictor.predict(&mechanics, own.time_s, &own.q_mm, seen);
        let PathPoint { motion, solution, .. } = predicted.point;
        let line = LazyCell::new(|| mechanics.line_jacobian(solution.bend, &motion));
        let nudged = self.nudged.iter_mut().map(|(parameter, unit, predictor)| {
            let (nudged, _) = model.nudged(*parameter);
            let q_tilde = reading.beside_resting_neighbours(&nudged).q_mm;
            let near = (&predicted.point, &*line);
            let Predicted { point, shown } =
                predictor.predict_near(&Mechanics::new(&nudged), own.time_s, &q_tilde, near);
            let (motion, since_frame) = (point.motion, point.solution.bend - shown);
            Nudged { parameter: *parameter, unit: *unit, q_tilde, motion, since_frame }
        });
        Some(Came { motion, solution, since_frame: solution.bend - predicted.shown, nudged: nudged.collect() })
    }
}

fn is_finite(reading: &EncoderReading) -> bool {
    reading.time_s.is_finite() && reading.q_mm.iter().all(|q| q.is_finite())
}

/// An encoder log beside measurements that come in their order.
pub(super) struct Log<'a> {
    by_index: HashMap<u64, &'a EncoderReading>,
    /// In the order of time; empty for a model without effects, to which only the readings of measurements matter.
    in_time: Vec<&'a EncoderReading>,
    passed: usize,
}

impl<'a> Log<'a> {
    pub fn new(model: &Model, readings: &'a [EncoderReading]) -> Self {
        let by_index = readings.iter().map(|reading| (reading.index, reading)).collect();
        let mut in_time: Vec<&EncoderReading> =
            readings.iter().filter(|reading| !model.effects.is_empty() && is_finite(reading)).collect();
        in_time.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
        Self { by_index, in_time, passed: 0 }
    }

    /// The readings that came since the last measurement and before the one of this index, and that one's own.
    pub fn until(&mut self, index: u64) -> (&[&'a EncoderReading], Option<&'a EncoderReading>) {
        let own = self.by_index.get(&index).copied();
        let from = self.passed;
        if let Some(own) = own {
            let before = |reading: &&&EncoderReading| reading.time_s < own.time_s;
            self.passed += self.in_time[from..].iter().take_while(before).count();
        }
        (&self.in_time[from..self.passed], own)
    }
}

/// Measurements, each with its reading, as they would have been without a model's effects: what its effects did to the encoders and to the eye
/// is taken off, and from the readings what neighbouring sections did. Every reading drives what has a memory; what has no
/// angles or no reading stays as it is.
pub fn pairs_without_effects<'a>(
    model: &'a Model,
    measurements: &'a [Measurement],
    readings: &'a [EncoderReading],
) -> impl Iterator<Item = Pair> + 'a {
    let (mut log, mut follower) = (Log::new(model, readings), Follower::default());
    measurements.iter().cloned().map(move |mut measurement| {
        let (before, own) = log.until(measurement.index);
        before.iter().for_each(|reading| follower.pass(model, reading));
        let mut reading = own.map(|own| own.beside_resting_neighbours(model));
        if let (Ok(sample), Some(reading)) = (follower.take(model, &measurement, own), &mut reading) {
            let (measured, q_mm) = sample.without_effects(model);
            (measurement.measured, reading.q_mm) = (Some(measured), q_mm);
        }
        (measurement, reading)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observation::EncoderReading;
    use crate::robot::{Effect, LIBRARY};
    use crate::simulate::{BendingExperiment, Plant, SimulatedEye};

    fn without_effects(model: &Model, measurements: &[Measurement], readings: &[EncoderReading]) -> Vec<Pair> {
        pairs_without_effects(model, measurements, readings).collect()
    }

    /// Measurements without noise, and readings without any.
    fn exact(model: &Model) -> (Vec<Measurement>, Vec<EncoderReading>) {
        let trajectory = BendingExperiment { sweep_poses: 20, ..Default::default() }.waypoints().unwrap();
        let samples = Plant { model: model.clone(), sd_encoder_mm: 0.0 }.run(&trajectory, 1);
        let eye = SimulatedEye { sigma_theta_deg: 0.0, sigma_across_deg: 0.0 };
        (eye.observe(&samples, 2), samples.iter().map(|sample| sample.reading).collect())
    }

    #[test]
    fn what_the_effects_did_can_be_taken_off() {
        for physics in LIBRARY.into_iter().filter(|physics| physics.name != "camera_latency") {
            let model = Model { effects: vec![Effect::of(physics, physics.example(3))], ..Model::default() };
            let (measurements, readings) = exact(&model);
            let plain = model.plain();
            let left = |(measurement, reading): &Pair| {
                let psi = measurement.measured.unwrap().configuration;
                (reading.unwrap().q_mm - plain.command(psi)).norm()
            };
            let before = measurements.iter().cloned().zip(readings.iter().copied().map(Some));
            let before = before.map(|pair| left(&pair)).fold(0.0, f64::max);
            let after = without_effects(&model, &measurements, &readings).iter().map(left).fold(0.0, f64::max);
            assert!(before > 0.001 && after < 1e-6, "{} {}: {before} {after}", physics.name, physics.form);
        }
    }

    #[test]
    fn readings_without_a_measurement_drive_a_play_as_well() {
        let play =
            Effect::new("motion_directed_backlash", Some("crossed by travel"), &[("half_gap_mm".to_owned(), 0.2)], 3);
        let model = Model { effects: vec![play.unwrap()], ..Model::default() };
        let (all, readings) = exact(&model);
        // The turns at the tops of the sweeps are not seen.
        let seen = |m: &Measurement| m.index == 0 || m.measured.unwrap().configuration.theta_deg() < 45.0;
        let some: Vec<Measurement> = all.iter().filter(|m| seen(m)).cloned().collect();
        assert!(some.len() < all.len() - 30);
        let of_all = without_effects(&model, &all, &readings);
        for (measurement, reading) in without_effects(&model, &some, &readings) {
            let whole = of_all[measurement.index as usize].1.unwrap();
            assert!((reading.unwrap().q_mm - whole.q_mm).amax() < 1e-9, "{}", measurement.index);
        }
    }
}
