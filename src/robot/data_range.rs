//! The range of the data: which bends and directions a model was learned on, and what it may miss beyond.
//!
//! A bend counts for as much as it tells. One that is not far above its own σ tells nothing, and a direction is learned once it was bent so far
//! there that a robot which bends differently in this direction would have been noticed: an error that moves the largest bend by
//! `ASKED_FOR` moves a small bend by less, which σ of θ must not hide.
//!
//! Within the range the measurements have confirmed the model. Beyond its largest bend θ_m a stiffness that changes with the bend shows
//! itself, which nothing measured contradicts: the elastic part of ε is then wrong by a share κ (θ² − θ_m²). κ is not known; its standard
//! deviation is [`SD_OF_STIFFENING`], and σ of a prediction holds it.

use super::PerBackbone;
use super::model::Model;
use crate::geometry::Configuration;
use nalgebra::Vector2;
use std::f64::consts::{PI, TAU};

/// Sectors of the azimuth.
///
/// Convention: 30° each, half of the distance at which neighbouring backbones of six take over from each other.
const SECTORS: usize = 12;
/// Standard deviation of κ, by which the elastic part of ε may change with the square of the bend, 1/rad².
///
/// Fitted: to the tables of robots that soften by 0.1/rad² or stiffen by 0.3/rad² (`simulate --effect superelastic_softening`,
/// `cubic_stiffness`), learned on bends to 25° and 35° and judged at 45° to 75°: see
/// `robots_that_soften_or_stiffen_stay_within_what_the_sigma_allows`.
pub const SD_OF_STIFFENING: f64 = 0.2;

/// A pose counts as within the range up to so much beyond its largest bend, rad.
///
/// Convention: half a degree, the largest noise of a bend that is measured well; a table to 75° of data to 74.9° ends where they end.
const TOLERANCE: f64 = 0.5 * PI / 180.0;

/// A bend tells something from so many of its standard deviations on.
///
/// Convention: as where a verdict says that nothing bends; the gain is then known to a tenth.
const TELLING_SDS: f64 = 10.0;
/// What a table is asked to be right to, rad: a verdict tells of gaps, and `table` of poses, that are off by more. Convention: half a degree.
pub const ASKED_FOR: f64 = 0.5 * PI / 180.0;
/// A direction that was bent by this share of the largest bend is learned however large σ is.
///
/// Convention: half; an error of the gain there moves it by half of what it moves the largest bend.
const BENT_ENOUGH: f64 = 0.5;

/// The bends that a model was learned on.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct DataRange {
    theta_max: f64,
    directions: [Direction; SECTORS],
}

/// What was bent in a sector.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Direction {
    /// The largest bend, rad.
    theta_max: f64,
    /// The largest bend in units of its σ.
    sds: f64,
}

impl DataRange {
    /// Adds a bend with σ of θ and of δ, rad; of a snake that is nearly straight it says nothing.
    pub fn add(&mut self, psi: Configuration, sigma_theta: f64, sigma_delta: f64) {
        // What is known exactly, as in a simulation without noise, tells all.
        let sds = psi.theta / sigma_theta.max(f64::MIN_POSITIVE);
        if sds.is_nan() || sds < TELLING_SDS {
            return;
        }
        self.theta_max = self.theta_max.max(psi.theta);
        if sigma_delta < TAU / SECTORS as f64 / 2.0 {
            let direction = &mut self.directions[sector(psi.delta)];
            direction.theta_max = direction.theta_max.max(psi.theta);
            direction.sds = direction.sds.max(sds);
        }
    }

    /// The range that a file tells: the largest bend, rad, and azimuths, degrees.
    pub fn of(theta_max: f64, directions_deg: &[f64]) -> Self {
        let mut range = Self { theta_max, ..Self::default() };
        let learned = Direction { theta_max, sds: f64::INFINITY };
        directions_deg.iter().for_each(|delta| range.directions[sector(delta.to_radians())] = learned);
        range
    }

    /// Whether the snake bent so far in a sector that the largest bend there is known to what a table is asked for.
    fn is_learned(&self, sector: usize) -> bool {
        let Direction { theta_max, sds } = self.directions[sector];
        theta_max > 0.0 && (theta_max >= BENT_ENOUGH * self.theta_max || self.theta_max <= ASKED_FOR * sds)
    }

    /// The largest bend, rad.
    pub fn theta_max(&self) -> f64 {
        self.theta_max
    }

    /// The azimuths of the sectors in which the snake bent, each the middle of its 30°, degrees in (−180, 180].
    pub fn directions_deg(&self) -> Vec<f64> {
        let middle = |k: usize| 360.0 * k as f64 / SECTORS as f64;
        let mut seen: Vec<f64> = (0..SECTORS).filter(|&k| self.is_learned(k)).map(middle).collect();
        seen.iter_mut().filter(|delta| **delta > 180.0).for_each(|delta| *delta -= 360.0);
        seen.sort_by(f64::total_cmp);
        seen
    }

    /// Whether a pose lies within the range: bent no further than the largest bend, in a sector that was seen or next to one.
    pub fn covers(&self, psi: Configuration) -> bool {
        let own = sector(psi.delta);
        let near = [own, (own + 1) % SECTORS, (own + SECTORS - 1) % SECTORS];
        self.reaches(psi.theta) && (psi.theta == 0.0 || near.iter().any(|&k| self.is_learned(k)))
    }

    /// Whether a bend, rad, is no larger than the largest that was seen.
    pub fn reaches(&self, theta: f64) -> bool {
        theta <= self.theta_max + TOLERANCE
    }

    /// θ² − θ_m², rad²; 0 within the range.
    fn beyond(&self, theta: f64) -> f64 {
        (theta.powi(2) - self.theta_max.powi(2)).max(0.0)
    }
}

fn sector(delta: f64) -> usize {
    (delta / TAU * SECTORS as f64).round().rem_euclid(SECTORS as f64) as usize % SECTORS
}

impl Model {
    /// Standard deviation of q̃ at a bend because of what the data's range leaves open, mm, with its sign; zero within the range, and
    /// where none is known.
    pub(crate) fn beyond_data_mm(&self, bend: Vector2<f64>) -> PerBackbone {
        let elastic = self.epsilon_by_parameters(bend).column(0) * self.parameters().x;
        elastic * (SD_OF_STIFFENING * self.learned.map_or(0.0, |range| range.beyond(bend.norm())))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::{Options, estimate};
    use crate::observation::Waypoint;
    use crate::robot::Effect;
    use crate::simulate::{BendingExperiment, Plant, SimulatedEye};
    use crate::verdict::{Level, Subject};

    fn pose(theta_deg: f64, delta_deg: f64) -> Configuration {
        Configuration::from_degrees(theta_deg, delta_deg)
    }

    #[test]
    fn a_range_holds_what_was_added_and_its_neighbours_and_nothing_else() {
        let mut range = DataRange::default();
        assert!(range.covers(pose(0.0, 0.0)) && !range.covers(pose(1.0, 0.0)));
        range.add(pose(40.0, 10.0), 0.001, 0.01);
        range.add(pose(0.5, 90.0), 0.001, 0.9);
        assert_eq!((range.theta_max().to_degrees().round(), range.directions_deg()), (40.0, vec![0.0]));
        for (theta_deg, delta_deg, within) in
            [(40.0, 0.0, true), (40.0, 44.0, true), (20.0, -44.0, true), (20.0, 46.0, false), (41.0, 0.0, false)]
        {
            assert_eq!(range.covers(pose(theta_deg, delta_deg)), within, "{theta_deg} {delta_deg}");
        }
        range.add(pose(30.0, -179.0), 0.001, 0.01);
        assert_eq!(range.directions_deg(), [0.0, 180.0]);
        let read = DataRange::of(range.theta_max(), &range.directions_deg());
        assert_eq!((read.theta_max(), read.directions_deg()), (range.theta_max(), range.directions_deg()));
    }

    #[test]
    fn a_bend_that_tells_nothing_is_not_learned_from() {
        let deg = |angle: f64| angle.to_radians();
        let mut range = DataRange::default();
        range.add(pose(75.0, 0.0), deg(0.05), deg(0.1));
        // A degree towards −90° with σ of 0.5° or of 0.05° leaves a gain there of 38° or 3.8° at 75° open.
        range.add(pose(1.0, -90.0), deg(0.5), deg(14.0));
        range.add(pose(1.0, -90.0), deg(0.05), deg(3.0));
        // A frame that was hardly measured does not stretch the range.
        range.add(pose(110.0, 180.0), deg(15.0), deg(5.0));
        assert_eq!((range.theta_max().to_degrees().round(), range.directions_deg()), (75.0, vec![0.0]));
        // Ten degrees tell it to 0.4°, and half of the largest bend whatever the eye is worth.
        range.add(pose(10.0, -90.0), deg(0.05), deg(0.3));
        range.add(pose(40.0, 90.0), deg(0.5), deg(1.0));
        assert_eq!(range.directions_deg(), [-90.0, 0.0, 90.0]);
    }

    /// Robots whose second backbone moves more or less than it says bend differently towards ±90°. What was bent there by a few degrees decides
    /// whether that shows: where it cannot, the direction must not count as learned.
    #[test]
    fn a_direction_counts_where_a_robot_that_bends_differently_there_would_show() {
        let odd = Effect::parse("actuator_scale:scale_1=0,scale_2=0.1,scale_3=0").unwrap();
        let robot = Model { effects: vec![odd], eta: 1.221, lambda_mm: 0.1765, samples: Some(0), ..Model::default() };
        let across = pose(60.0, 90.0);
        let mut counted = Vec::new();
        for small_deg in [1.0, 2.0, 5.0, 10.0, 20.0, 40.0] {
            let bends = (1..=12).map(|k| pose(5.0 * f64::from(k), if k % 2 == 0 { 0.0 } else { 180.0 }));
            let small = (0..4).map(|k| pose(small_deg, if k % 2 == 0 { 90.0 } else { -90.0 }));
            let waypoints: Vec<_> =
                bends.chain(small).zip(0..).map(|(psi, k)| Waypoint::new(f64::from(k), psi)).collect();
            let samples = Plant { model: robot.clone(), sd_encoder_mm: 0.0015 }.run(&waypoints, 3);
            let readings: Vec<_> = samples.iter().map(|sample| sample.reading).collect();
            let measurements = SimulatedEye::default().observe(&samples, 4);
            let (_, model) = estimate(&Model::default(), Options::default(), &measurements, &readings).unwrap();
            let verdict = Subject::new(&model, 0.0015).verdict(&measurements, &readings);
            let off = model.command(across) - robot.command(across);
            let off_deg = (model.updated_jacobian_bend(across.bend_vector()).unwrap().tr_mul(&off)).norm().to_degrees();
            let counts = model.learned.unwrap().covers(across);
            println!("{small_deg}°: counts {counts}, {:?}, table {off_deg:.2}° off at 60°", verdict.level);
            assert!(!counts || verdict.level != Level::Good || off_deg < 0.5, "{small_deg}°");
            counted.push(counts);
        }
        assert_eq!((counted[0], counted[4], counted[5]), (false, true, true));
    }

    /// The errors of a table in units of its σ, at 45 to 75°, of a robot with an effect that is learned on bends to so many degrees.
    fn errors_in_sigmas(effect: &str, largest_deg: f64, seed: u64) -> Vec<f64> {
        let effects = vec![Effect::parse(effect).unwrap()];
        let robot = Model { effects, eta: 1.221, lambda_mm: 0.1765, samples: Some(0), ..Model::default() };
        let ride = BendingExperiment {
            sweep_theta_deg: (5.0, largest_deg),
            round_theta_deg: largest_deg,
            seed,
            ..BendingExperiment::default()
        };
        let plant = Plant { model: robot.clone(), sd_encoder_mm: 0.0015 };
        let samples = plant.run(&ride.waypoints().unwrap(), seed);
        let readings: Vec<_> = samples.iter().map(|sample| sample.reading).collect();
        let measurements = SimulatedEye::default().observe(&samples, seed + 1);
        let (_, model) = estimate(&Model::default(), Options::default(), &measurements, &readings).unwrap();
        let error = |k: u32| {
            let psi = pose(45.0 + 10.0 * f64::from(k % 4), 30.0 * f64::from(k));
            let (off, sd) = (model.command(psi) - robot.command(psi), model.command_sds(psi));
            off.norm() / sd.norm()
        };
        (0..12).map(error).collect()
    }

    #[test]
    fn robots_that_soften_or_stiffen_stay_within_what_the_sigma_allows() {
        let effects = [
            "superelastic_softening:softening_per_rad2=0.1",
            "cubic_stiffness:stiffening_per_rad2=0.1",
            "cubic_stiffness:stiffening_per_rad2=0.3",
        ];
        let mut errors = Vec::new();
        for (effect, largest_deg) in effects.iter().flat_map(|effect| [25.0, 35.0].map(|largest| (effect, largest))) {
            let own = errors_in_sigmas(effect, largest_deg, 3);
            println!("{effect}, to {largest_deg}°: {own:.2?}");
            errors.extend(own);
        }
        let rms = crate::statistics::moments::rms(errors.iter().copied());
        let worst = errors.iter().copied().fold(0.0, f64::max);
        println!("rms {rms:.2}, largest {worst:.2} σ");
        assert!((0.3..1.5).contains(&rms) && worst < 3.0, "rms {rms}, largest {worst} σ");
    }
}
