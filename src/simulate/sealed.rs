//! Sealed experiments: a plant with hidden effects of random size, on a random trajectory, with noise. What is hidden comes
//! back beside the data and is never shown to a search.

use super::plant::{Plant, SimulatedEye};
use super::trajectory::BendingExperiment;
use crate::error::Result;
use crate::observation::{EncoderReading, Measurement, Truth, Waypoint};
use crate::robot::effects::{ParameterSpec, Role};
use crate::robot::{Effect, Model, Observation, PerBackbone, Physics, Robot};
use crate::statistics::moments::rms;
use nalgebra::Vector2;
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use std::f64::consts::TAU;

/// The largest size that is drawn, as a share of the one beyond which an effect's equation has more than one answer.
///
/// Convention: how hard a sealed experiment may be.
const LARGEST_SHARE: f64 = 0.75;

/// The rms that an effect leaves in ε, mm.
///
/// Convention: it defines what a sealed experiment is.
const EFFECT_RMS_MM: std::ops::Range<f64> = 0.04..0.12;
/// The values of sizes before they are scaled to that, in typical sizes.
///
/// Convention: how much parameters of one effect differ from each other.
const TYPICAL_SIZES: std::ops::Range<f64> = 0.4..1.0;
/// η and λ (mm) that are drawn.
///
/// Convention: about the paper's 1.221 and 0.1765 mm.
const DRAWN_ETA: std::ops::Range<f64> = 0.9..1.5;
const DRAWN_LAMBDA_MM: std::ops::Range<f64> = 0.05..0.25;
/// The bend of a neighbouring section in each plane, rad.
///
/// Convention: as much as the section itself bends.
const NEIGHBOUR_BEND: std::ops::Range<f64> = 0.4..1.0;
/// Its period, s.
///
/// Convention: another pace than that of the section's own sweeps, which take 24 s.
const NEIGHBOUR_PERIOD_S: std::ops::Range<f64> = 15.0..50.0;
/// What makes the neighbours' random numbers others than the trajectory's.
///
/// Convention: any number.
const NEIGHBOURS_SEED: u64 = 0x6e65_6967;
/// Standard deviation of an encoder reading, mm.
///
/// Convention: the project's own; the default of every command that asks for it.
const SD_ENCODER_MM: f64 = 0.0015;

/// A sealed experiment.
#[derive(Debug, Clone)]
pub struct Sealed {
    /// What the plant obeys.
    pub truth: Model,
    /// What its eye measured.
    pub measurements: Vec<Measurement>,
    /// What its encoders read.
    pub readings: Vec<EncoderReading>,
    /// What a perfect eye would make of each frame: what to draw.
    pub shown: Vec<Truth>,
}

impl Sealed {
    /// About 320 samples of a plant with these effects, each of a size that leaves an rms of 0.04 to 0.12 mm in ε.
    ///
    /// # Errors
    /// None in practice: trajectories that it draws lie in the workspace.
    pub fn new(hidden: &[&'static Physics], seed: u64) -> Result<Self> {
        Self::of_poses(hidden, seed, 34, 48)
    }

    /// The same with as many poses on the way up each of the four sweeps, and as many in the round.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn of_poses(hidden: &[&'static Physics], seed: u64, sweep: usize, round: usize) -> Result<Self> {
        let mut random = StdRng::seed_from_u64(seed);
        let mut trajectory = ride(&mut random, seed, sweep, round)?;
        if hidden.iter().any(|physics| physics.follows_neighbour.contains(&true)) {
            move_neighbours(&mut trajectory, seed);
        }
        let mut truth = Model {
            eta: random.random_range(DRAWN_ETA),
            lambda_mm: random.random_range(DRAWN_LAMBDA_MM),
            samples: Some(0),
            ..Model::default()
        };
        for physics in hidden {
            let backbones = truth.robot.backbone_count();
            let mut effect = drawn(physics, backbones, &mut random);
            let size_mm = random.random_range(EFFECT_RMS_MM);
            // Twice, since not all effects are linear in their size.
            for _ in 0..2 {
                let alone =
                    Plant { model: Model { effects: vec![effect.clone()], ..truth.clone() }, sd_encoder_mm: 0.0 };
                let scale = size_mm / size(&alone, &trajectory).max(1e-9);
                for (value, spec) in effect.values.iter_mut().zip(physics.parameters_on(backbones)) {
                    if let Role::Size { .. } = spec.role {
                        *value = (*value * scale).clamp(spec.range.0, spec.range.1);
                    }
                }
                if let Some(largest) = physics.largest_size {
                    effect.values[0] = effect.values[0].min(LARGEST_SHARE * largest(&effect.values));
                }
            }
            truth.effects.push(effect);
        }
        Ok(Self::observed(truth, &trajectory, seed))
    }

    /// The same plant on another ride.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn another(&self, seed: u64) -> Result<Self> {
        let mut trajectory = ride(&mut StdRng::seed_from_u64(seed), seed, 34, 48)?;
        if self.truth.neighbours() > 0 {
            move_neighbours(&mut trajectory, seed);
        }
        Ok(Self::observed(self.truth.clone(), &trajectory, seed))
    }

    fn observed(truth: Model, trajectory: &[Waypoint], seed: u64) -> Self {
        let samples =
            Plant { model: truth.clone(), sd_encoder_mm: SD_ENCODER_MM }.run(trajectory, seed.wrapping_add(1));
        let measurements = SimulatedEye::default().observe(&samples, seed.wrapping_add(2));
        let shown = samples.iter().map(|sample| Truth { index: sample.truth.index, configuration: sample.apparent });
        Self { truth, measurements, shown: shown.collect(), readings: samples.iter().map(|s| s.reading).collect() }
    }
}

/// Four sweeps in planes all round and a round, with so many poses.
fn ride(random: &mut StdRng, seed: u64, sweep: usize, round: usize) -> Result<Vec<Waypoint>> {
    let planes = (0..4).map(|k| 90.0 * f64::from(k) + random.random_range(-40.0..40.0)).collect();
    BendingExperiment {
        sweep_delta_deg: planes,
        sweep_theta_deg: (random.random_range(3.0..8.0), random.random_range(65.0..85.0)),
        sweep_poses: sweep,
        round_theta_deg: random.random_range(25.0..50.0),
        round_poses: round,
        interval_s: 0.35,
        jitter_deg: 1.0,
        seed,
    }
    .waypoints()
}

/// Lets two neighbouring sections, the second of four backbones, bend in their own ways while the snake is led along a trajectory.
pub fn move_neighbours(trajectory: &mut [Waypoint], seed: u64) {
    let mut random = StdRng::seed_from_u64(seed ^ NEIGHBOURS_SEED);
    let sections = [3, 4].map(|backbones| Robot { backbones, ..Robot::default() });
    // Each coordinate of each bend a slow wave of its own.
    let waves: [[(f64, f64, f64); 2]; 2] = std::array::from_fn(|_| {
        std::array::from_fn(|_| {
            (
                random.random_range(NEIGHBOUR_BEND),
                random.random_range(NEIGHBOUR_PERIOD_S),
                random.random_range(0.0..TAU),
            )
        })
    });
    let bend = |axes: &[(f64, f64, f64); 2], time_s: f64| {
        let [x, y] = axes.map(|(size, period_s, phase)| size * (TAU * time_s / period_s + phase).sin());
        Vector2::new(x, y)
    };
    for waypoint in trajectory {
        waypoint.neighbours.q_mm = std::array::from_fn(|k| {
            let noise = PerBackbone::from_fn(sections[k].backbone_count(), |_| random.sample(StandardNormal));
            sections[k].displacement_by_bend() * bend(&waves[k], waypoint.time_s) + noise * SD_ENCODER_MM
        });
    }
}

/// rms over samples and backbones of what a plant's effects leave in ε, mm.
fn size(plant: &Plant, trajectory: &[Waypoint]) -> f64 {
    let plain = plant.model.plain();
    let observations: Vec<Observation> = plant
        .run(trajectory, 0)
        .iter()
        .map(|s| Observation { time_s: s.reading.time_s, q_mm: s.reading.q_mm, configuration: s.apparent })
        .collect();
    let left = |o: &Observation| o.q_mm - plain.command(o.configuration);
    rms(observations.iter().flat_map(|o| left(o).iter().copied().collect::<Vec<_>>()))
}

/// An effect with random parameters; sizes have their typical size, more or less.
fn drawn(physics: &'static Physics, backbones: usize, random: &mut StdRng) -> Effect {
    let specs = physics.parameters_on(backbones);
    let mut size = |spec: &ParameterSpec| {
        let negative = matches!(spec.role, Role::Size { either_sign: true }) && random.random_bool(0.5);
        let sign = if negative { -1.0 } else { 1.0 };
        sign * spec.typical * random.random_range(TYPICAL_SIZES)
    };
    let mut values: Vec<f64> = specs.iter().map(&mut size).collect();
    for (value, spec) in values.iter_mut().zip(specs) {
        if let Role::Shape { drawn: (least, most), .. } = spec.role {
            *value = random.random_range(least..most);
        }
    }
    Effect::of(physics, values)
}
