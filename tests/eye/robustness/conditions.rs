//! Frames as a lab takes them on a bad day: the same fault in the straight picture and in every frame of a sequence.

use super::disturbances::through_jpeg;
use crate::rigs::{self, Random};
use crate::scenes::{STRAIGHT, eye_with, frame_of, rig_options};
use nalgebra::{Point3, Vector2};
use rayon::prelude::*;
use snakeloop::camera::Frame;
use snakeloop::geometry::{Configuration, wrap_degrees};
use snakeloop::measure::calibrate_rig;
use snakeloop::simulate::render::render;
use snakeloop::simulate::scene::{Scene, Wire};

/// One bad day.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Condition {
    Clean,
    /// A cable hides 15 % of the snake's length, another part in every frame.
    Hidden,
    /// σ = 2 px.
    Blur,
    /// σ = 10 grey levels.
    Noise,
    /// Quality 60.
    Jpeg,
    /// The camera looks 15° up or down.
    Tilt,
    All,
}

impl Condition {
    pub const ALL: [Self; 7] = [Self::Clean, Self::Hidden, Self::Blur, Self::Noise, Self::Jpeg, Self::Tilt, Self::All];

    fn is(self, other: Self) -> bool {
        self == other || self == Self::All
    }
}

/// What became of a condition's frames.
pub struct Survey {
    pub frames: usize,
    /// Errors of θ and δ of the frames that were measured, degrees, and the same in units of σ.
    pub errors: Vec<([f64; 2], [f64; 2])>,
    /// What the others were called, and rigs that were refused.
    pub told: Vec<String>,
}

impl Survey {
    /// Root mean square errors of θ and δ, degrees.
    pub fn rms_deg(&self) -> [f64; 2] {
        [0, 1].map(|k| {
            (self.errors.iter().map(|(e, _)| e[k] * e[k]).sum::<f64>() / self.errors.len().max(1) as f64).sqrt()
        })
    }

    /// Mean square errors of θ and δ in units of σ.
    pub fn chi2(&self) -> [f64; 2] {
        [0, 1].map(|k| self.errors.iter().map(|(_, z)| z[k] * z[k]).sum::<f64>() / self.errors.len().max(1) as f64)
    }
}

/// Measures sequences of `frames` frames (θ from 15° to 90°) before varied rigs under one condition.
pub fn survey(condition: Condition, seeds: std::ops::Range<u64>, frames: usize) -> Survey {
    let mut survey = Survey { frames: 0, errors: Vec::new(), told: Vec::new() };
    for seed in seeds {
        survey.frames += frames;
        let mut random = Random::new(seed);
        let mut scene = rigs::at_scale(1.0, &mut random);
        if condition.is(Condition::Tilt) {
            scene.view.pitch_deg = if random.chance(0.5) { 15.0 } else { -15.0 };
        }
        if condition.is(Condition::Blur) {
            scene.sensor.blur_px = 2.0;
        }
        scene.sensor.noise = if condition.is(Condition::Noise) { 10.0 } else { 2.0 };
        let straight = taken(&scene, STRAIGHT, condition, seed);
        let bends: Vec<(Configuration, f64)> = (0..frames)
            .map(|_| {
                let psi = Configuration::from_degrees(random.between(15.0, 90.0), random.between(-180.0, 180.0));
                (psi, random.between(0.1, 0.9))
            })
            .collect();
        let pictures: Vec<Frame> = bends
            .par_iter()
            .enumerate()
            .map(|(k, &(psi, at))| {
                let mut scene = scene.clone();
                if condition.is(Condition::Hidden) {
                    scene.wires.push(cable(&scene, psi, at));
                }
                taken(&scene, psi, condition, 100 * seed + k as u64)
            })
            .collect();
        let rig = match calibrate_rig(&straight, &scene.lens, &scene.robot, &rig_options(&scene)) {
            Ok(rig) => rig,
            Err(why) => {
                survey.told.push(format!("rig {seed}: {why}"));
                continue;
            }
        };
        let eye = eye_with(&scene, rig).refined(pictures.par_iter().cloned());
        for (picture, (psi, _)) in pictures.iter().zip(&bends) {
            let measurement = eye.measure(picture);
            let Some(seen) = measurement.measured else {
                survey.told.push(format!("{} at {:.0}°, {:.0}°", measurement.status, psi.theta_deg(), psi.delta_deg()));
                continue;
            };
            let errors = [
                seen.configuration.theta_deg() - psi.theta_deg(),
                wrap_degrees(seen.configuration.delta_deg() - psi.delta_deg()),
            ];
            let sigmas = [seen.sigma_theta, seen.sigma_delta].map(f64::to_degrees);
            survey.errors.push((errors, [errors[0] / sigmas[0], errors[1] / sigmas[1]]));
        }
    }
    survey
}

fn taken(scene: &Scene, psi: Configuration, condition: Condition, seed: u64) -> Frame {
    let picture = render(scene, psi, seed);
    frame_of(if condition.is(Condition::Jpeg) { through_jpeg(&picture, 60) } else { picture })
}

/// A dark cable across the snake, as wide as 15 % of its length, its middle at this share of it.
fn cable(scene: &Scene, psi: Configuration, at: f64) -> Wire {
    let length_mm = scene.robot.length_mm;
    let pixel = |s_mm: f64| {
        let on_axis = scene.view.camera_from_base() * scene.robot.frame_at(psi, s_mm) * Point3::origin();
        scene.lens.project(&on_axis)
    };
    let (below, above) = (pixel((at - 0.075) * length_mm), pixel((at + 0.075) * length_mm));
    let along = above - below;
    let across = Vector2::new(-along.y, along.x).normalize() * f64::from(scene.lens.width);
    let middle = nalgebra::center(&below, &above).coords;
    Wire {
        from_px: (middle - across).into(),
        to_px: (middle + across).into(),
        width_px: along.norm().max(8.0),
        colour: [40.0; 3],
    }
}
