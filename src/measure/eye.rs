//! Frames to θ and δ.

use crate::camera::{Frame, Lens};
use crate::geometry::{Configuration, Pose, wrap_angle};
use crate::measure::body::{Outline, Projection};
use crate::measure::fit::{
    ALTERNATIVE_COST_RATIO, BendFit, BiasPrior, CoarseSearch, EdgeFinder, FitSchedule, Start, State, fit_bend,
};
use crate::measure::image::plane::{Plane, Region};
use crate::measure::rig::calibrate::Rig;
use crate::measure::rig::drift::Watch;
use crate::observation::{Measured, Quality, Status};
use crate::robot::Robot;
use nalgebra::{Matrix2, Matrix6, Vector2};
use rayon::prelude::*;
use std::f64::consts::PI;
use std::sync::Arc;

/// What one frame says.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameMeasurement {
    /// The verdict; anything but [`Status::Ok`] comes without angles.
    pub status: Status,
    /// The angles.
    pub measured: Option<Measured>,
    /// The same as a bend vector, which stays Gaussian near straight, for [`fused`](super::fused).
    pub bend: Option<Bend>,
    /// How good the fit was, where there was one.
    pub quality: Option<Quality>,
}

/// A bend vector θ (cos δ, sin δ) and its covariance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bend {
    /// rad.
    pub vector: Vector2<f64>,
    /// rad².
    pub covariance: Matrix2<f64>,
}

/// Measures the snake in the frames of one calibrated view.
#[derive(Debug, Clone)]
pub struct Eye {
    pub(crate) lens: Lens,
    pub(crate) rig: Rig,
    pub(crate) robot: Robot,
    /// The coarse search, and the camera's pose that it was made for.
    pub(crate) search: Arc<CoarseSearch>,
    pub(crate) search_pose: Pose,
    pub(crate) watch: Arc<Watch>,
    /// The pose's covariance as calibrated, before a camera that moves was followed.
    pub(crate) still_covariance: Matrix6<f64>,
}

/// What led to a measurement.
pub(crate) struct MeasurementStages {
    /// Bends that the coarse search found worth fitting, best first.
    pub candidates: Vec<Vector2<f64>>,
    /// Bends that were fitted to the end, best first.
    pub fits: Vec<BendFit>,
    pub measurement: FrameMeasurement,
}

/// Candidates of the coarse search that are looked at closely.
const CANDIDATES: usize = 6;
/// After a bend that moves the tip by less than about half a pixel, the same edges would be found again, rad.
const STILL_RAD: f64 = 1e-3;
/// The first look at a candidate, a closer one at the best of them, and the measurement itself.
const FIRST_LOOK: FitSchedule =
    FitSchedule { searches_px: &[14.0, 8.0], rounds: 2, is_fine: false, converged_rad: STILL_RAD };
const CLOSE_LOOK: FitSchedule =
    FitSchedule { searches_px: &[6.0, 3.0], rounds: 20, is_fine: false, converged_rad: STILL_RAD };
/// A look at once close, near the last frame's bend or a mirror image.
const NEAR_LOOK: FitSchedule = FitSchedule { searches_px: &[14.0, 6.0, 3.0], ..CLOSE_LOOK };
const MEASUREMENT: FitSchedule =
    FitSchedule { searches_px: &[3.0], rounds: 9, is_fine: true, converged_rad: STILL_RAD };
/// A closer look is worth while at candidates whose cost is within this factor of the best one's.
const WORTH_A_LOOK: f64 = 3.0;
/// The same beside a camera that does not wait: what another round would change is a hundredth of a degree.
const TRACKED_MEASUREMENT: FitSchedule = FitSchedule { rounds: 1, ..MEASUREMENT };
/// First looks that end closer together than this, rad, are worth only one closer look.
const ALIKE_RAD: f64 = 0.035;
/// Close looks that end closer together than this, rad, ended at one place.
const ONE_PLACE_RAD: f64 = 5e-3;
/// Measurements this near to one another, rad, are of a snake seen edge-on: disks look alike tilted either way. Which of
/// the two it is makes its sigma wide, no more.
const EDGE_ON_RAD: f64 = 0.1;
/// The same where a picture is coarse: so near that their tips' rims open by nearly the same, px.
const EDGE_ON_PX: f64 = 2.0;
/// How far the snake's outline may move between two frames of a tracked sequence, px.
const NEARBY_PX: f64 = 40.0;
/// How far the edges' bias may differ between the straight picture and a frame, px (1σ).
pub(crate) const FRAME_BIAS_SIGMA_PX: f64 = 0.05;
/// Share of the outline that must be confirmed by edges.
const ENOUGH_INLIERS: f64 = 0.45;
/// Share of the disks that must be where the fit says, most of their outline seen: one hidden and one half hidden is
/// allowed, but not both at the tip.
const ENOUGH_DISKS: f64 = 0.6;
/// Another bend explains a picture as well if its cost is within [`ALTERNATIVE_COST_RATIO`] of the best one's and the scatter of its
/// edges within this factor: over some sixty pieces of outline, 2.7σ of chance.
const AS_CLOSE: f64 = 1.3;

impl Eye {
    /// An eye for one view. Prepares the coarse search, which takes about as long as measuring a few frames.
    pub fn new(lens: Lens, rig: Rig, robot: Robot) -> Self {
        let search = Arc::new(CoarseSearch::new(&lens, rig.camera_from_base, &robot));
        let (search_pose, still_covariance) = (rig.camera_from_base, rig.pose_covariance);
        let view = Projection { lens: &lens, camera_from_base: rig.camera_from_base, robot: &robot };
        let watch = Arc::new(Watch::new(&lens, &rig, &view));
        Self { lens, rig, robot, search, search_pose, watch, still_covariance }
    }

    /// The rig that this eye measures by.
    pub fn rig(&self) -> &Rig {
        &self.rig
    }

    /// How this eye projects the snake.
    pub fn projection(&self) -> Projection<'_> {
        Projection { lens: &self.lens, camera_from_base: self.rig.camera_from_base, robot: &self.robot }
    }

    /// Measures one frame: θ and δ in the base's axes.
    pub fn measure(&self, frame: &Frame) -> FrameMeasurement {
        self.measure_in_stages(frame).measurement
    }

    /// Measures a frame of a sequence whose `last` bend vector is known: looks nearby first, and everywhere only where
    /// that does not convince. Says the same as [`measure`](Self::measure) to about a hundredth of a degree, sooner.
    pub fn track(&self, frame: &Frame, last: Vector2<f64>) -> FrameMeasurement {
        self.tracked(frame, last).unwrap_or_else(|| self.measure(frame))
    }

    /// Measures one frame and keeps what led to the verdict.
    pub(crate) fn measure_in_stages(&self, frame: &Frame) -> MeasurementStages {
        let mut look =
            MeasurementStages { candidates: Vec::new(), fits: Vec::new(), measurement: failed(Status::NoSnake, None) };
        if let Some(status) = self.unfit(frame) {
            return MeasurementStages { measurement: failed(status, None), ..look };
        }
        let plane = self.plane(frame, &Region::whole(frame.width, frame.height));
        let view = self.projection();
        let finder = EdgeFinder::new(&plane, self.rig.appearance.two_sided);
        let fit = |start: Start, schedule: &FitSchedule| fit_bend(&view, &finder, start, self.prior(), schedule);

        look.candidates = self.search.candidates(&plane, self.rig.appearance.two_sided, CANDIDATES);
        let first = |bend: Vector2<f64>| Some((bend, fit(self.start(bend), &FIRST_LOOK)?));
        let mut looks: Vec<(Vector2<f64>, BendFit)> = Vec::new();
        // Two at a time whatever the number of cores, so that the answer does not hang on it.
        for two in look.candidates.chunks(2) {
            looks.par_extend(two.par_iter().filter_map(|&bend| first(bend)));
            if looks.iter().any(|(_, look)| look.explains_all()) {
                break;
            }
        }
        // The search, whose picture is small, may have taken the best one for its twin, and a look from there ends between.
        let best = looks.iter().min_by(|(_, a), (_, b)| a.cost.total_cmp(&b.cost));
        let twin = best.and_then(|(candidate, _)| first(self.twin(*candidate)));
        looks.extend(twin);
        let mut looks = distinct(looks.into_iter().map(|(_, look)| look).collect(), ALIKE_RAD);
        looks.truncate(2);
        let least = looks.first().map_or(0.0, |best| best.cost);
        let worth = looks.par_iter().filter(|look| look.cost <= WORTH_A_LOOK * least);
        let close = worth.filter_map(|look| fit(look.start(), &CLOSE_LOOK)).collect();
        let (fits, measurement) = self.judged(close, frame, &finder, &MEASUREMENT);
        MeasurementStages { fits, measurement, ..look }
    }

    /// [`judge`](Self::judge), and what may be said once it is known where camera, base and paper are.
    fn judged(
        &self,
        looks: Vec<BendFit>,
        frame: &Frame,
        finder: &EdgeFinder,
        schedule: &FitSchedule,
    ) -> (Vec<BendFit>, FrameMeasurement) {
        let judge = || self.judge(looks, finder, schedule);
        let ((fits, mut measurement), watched) = rayon::join(judge, || self.watch.look(frame, finder));
        if let Some(quality) = &mut measurement.quality {
            quality.base_moved_px = watched.base.map(|base| base.by.norm());
            quality.grid_moved_px = watched.grid.map(|grid| grid.px);
        }
        match watched.status() {
            Some(status) => (fits, failed(status, measurement.quality)),
            None => (fits, measurement),
        }
    }

    /// What [`track`](Self::track) finds near the last bend; `None` where that is not sure to be the snake.
    fn tracked(&self, frame: &Frame, last: Vector2<f64>) -> Option<FrameMeasurement> {
        if self.unfit(frame).is_some() {
            return None;
        }
        let view = self.projection();
        let around = |bend, reach_px| view.image_region(Configuration::from_bend_vector(bend), reach_px);
        let region = around(last, NEARBY_PX);
        let plane = self.plane(frame, &region);
        let finder = EdgeFinder::within(&plane, self.rig.appearance.two_sided, &region);
        let near = fit_bend(&view, &finder, self.start(last), self.prior(), &NEAR_LOOK)?;
        // What is not in the region was not looked at.
        if !region.contains(&around(near.bend, Outline::REACH_PX)) {
            return None;
        }
        let (_, measurement) = self.judged(vec![near], frame, &finder, &TRACKED_MEASUREMENT);
        (measurement.status == Status::Ok).then_some(measurement)
    }

    /// The snakeness of a region of a frame, however it is exposed.
    pub(crate) fn plane(&self, frame: &Frame, region: &Region) -> Plane {
        self.rig.appearance.exposed_as(frame).plane_within(frame, region)
    }

    /// Why a frame is not worth looking at.
    fn unfit(&self, frame: &Frame) -> Option<Status> {
        if (frame.width, frame.height) != (self.lens.width, self.lens.height) {
            return Some(Status::WrongSize);
        }
        is_saturated(frame).then_some(Status::Saturated)
    }

    fn prior(&self) -> BiasPrior {
        BiasPrior { mean: self.rig.edge_bias, sigma_px: FRAME_BIAS_SIGMA_PX }
    }

    fn start(&self, bend: Vector2<f64>) -> Start {
        Start { state: State { bend, bias: self.rig.edge_bias }, blur_px: None }
    }

    /// Measures the best of some close looks, and judges whether anything else explains the picture as well.
    fn judge(
        &self,
        looks: Vec<BendFit>,
        finder: &EdgeFinder,
        schedule: &FitSchedule,
    ) -> (Vec<BendFit>, FrameMeasurement) {
        let view = self.projection();
        let fit = |start: Start, schedule: &FitSchedule| fit_bend(&view, finder, start, self.prior(), schedule);
        let fits = distinct(looks, ONE_PLACE_RAD);
        let Some(best) = fits.first() else { return (fits, failed(Status::NoSnake, None)) };
        // The best bend's twin, which leans the other way along the line of sight, may have been passed over.
        let look_at_twin = || {
            let twin = self.twin(best.bend);
            let is_close = (twin - best.bend).norm() < EDGE_ON_RAD;
            fit(self.start(twin), if is_close { &CLOSE_LOOK } else { &NEAR_LOOK })
        };
        let (twin, mut measured) = rayon::join(look_at_twin, || fit(best.start(), schedule));
        if let Some(twin) = twin.as_ref().filter(|twin| twin.cost < best.cost) {
            measured = fit(twin.start(), schedule);
        }
        let mut fits = distinct(fits.into_iter().chain(twin).collect(), ONE_PLACE_RAD);
        let Some(mut best) = measured else { return (fits, failed(Status::NoSnake, None)) };
        let as_good = |other: &BendFit, best: &BendFit| {
            other.cost < ALTERNATIVE_COST_RATIO * best.cost && other.rms_px < AS_CLOSE * best.rms_px
        };
        let edge_on_rad = EDGE_ON_RAD.max(2.0 * EDGE_ON_PX / view.diameter_px());
        let is_edge_on = |other: &BendFit, best: &BendFit| (other.bend - best.bend).norm() < edge_on_rad;
        // What looks as good may end near the same bend once it is measured as thoroughly.
        let rivals = fits[1..].iter().filter(|rival| as_good(rival, &fits[0]) || is_edge_on(rival, &fits[0]));
        let mut is_ambiguous = false;
        for other in rivals.filter_map(|rival| fit(rival.start(), schedule)) {
            if is_edge_on(&other, &best) {
                best = best.or(other);
            } else {
                is_ambiguous |= as_good(&other, &best);
            }
        }
        let mut measurement = self.verdict(&best);
        if measurement.status == Status::Ok {
            let visibility = best.visibility();
            if visibility.visible_disk_share() < ENOUGH_DISKS || !visibility.is_end_visible() {
                measurement = failed(Status::Occluded, measurement.quality);
            } else if is_ambiguous {
                measurement = failed(Status::Ambiguous, measurement.quality);
            }
        }
        fits[0] = best;
        (fits, measurement)
    }

    /// The bend whose outline is nearly the same from here: mirrored along the line of sight.
    fn twin(&self, bend: Vector2<f64>) -> Vector2<f64> {
        let sight = self.rig.camera_from_base.inverse() * self.rig.camera_from_base.translation.vector;
        let depth = sight.xy().normalize();
        bend - 2.0 * depth * depth.dot(&bend)
    }

    /// Angles and sigmas of a fit that can be trusted, or why it cannot.
    fn verdict(&self, fit: &BendFit) -> FrameMeasurement {
        let quality = quality(fit);
        const SOFT_PX: f64 = 5.0;
        const MOSTLY: f64 = 0.5;
        const HARDLY_ANY: f64 = 0.25;
        let status = if fit.out_of_frame > MOSTLY {
            Status::OutOfFrame
        } else if quality.inlier_fraction < HARDLY_ANY {
            Status::NoSnake
        } else if quality.inlier_fraction < ENOUGH_INLIERS {
            Status::Occluded
        } else if fit.blur_px > SOFT_PX {
            Status::Blurred
        } else {
            Status::Ok
        };
        if status != Status::Ok {
            return failed(status, Some(quality));
        }
        let departure = fit.departure(&self.projection(), &self.prior());
        let shape = departure.and_then(|departure| departure.measured(&self.rig.pose_covariance));
        let quality = Quality { shape, ..quality };
        let from_rig = fit.by_pose * self.rig.pose_covariance * fit.by_pose.transpose();
        FrameMeasurement::of(Bend { vector: fit.bend, covariance: fit.covariance + from_rig }, quality)
    }
}

impl FrameMeasurement {
    /// A snake that is bent like this.
    pub(crate) fn of(bend: Bend, quality: Quality) -> Self {
        let measured = in_polar_terms(bend.vector, &bend.covariance);
        Self { status: Status::Ok, measured: Some(measured), bend: Some(bend), quality: Some(quality) }
    }
}

pub(crate) fn failed(status: Status, quality: Option<Quality>) -> FrameMeasurement {
    FrameMeasurement { status, measured: None, bend: None, quality }
}

fn quality(fit: &BendFit) -> Quality {
    Quality { edges: fit.inliers, inlier_fraction: fit.inlier_fraction(), rms_px: fit.rms_px, ..Quality::default() }
}

/// Fits, best first; of those that ended this close together the best.
fn distinct(mut fits: Vec<BendFit>, apart_rad: f64) -> Vec<BendFit> {
    fits.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    let mut kept: Vec<BendFit> = Vec::new();
    for fit in fits {
        if kept.iter().all(|k| (k.bend - fit.bend).norm() > apart_rad) {
            kept.push(fit);
        }
    }
    kept
}

/// Whether nearly all of a picture is black or white, or most of it so overexposed that the snake's edges are no longer
/// where half the light is.
pub(crate) fn is_saturated(frame: &Frame) -> bool {
    const NEARLY_ALL: f64 = 0.98;
    const MOST: f64 = 0.5;
    let pixels = || (0..frame.samples.len() / frame.channels).step_by(101).map(|pixel| pixel * frame.channels);
    let share = |is_so: fn(f32) -> bool| {
        let is_all_so = |first: &usize| (0..frame.channels).all(|c| is_so(frame.samples.level(first + c)));
        pixels().filter(is_all_so).count() as f64 / pixels().count().max(1) as f64
    };
    let (white, black) = (share(|level| level >= 252.0), share(|level| level <= 3.0));
    white > MOST || white + black > NEARLY_ALL
}

/// θ, δ and their errors for a bend vector with a covariance (rad²).
///
/// Far from straight this is the linear propagation. Near straight δ may be anything, so the errors are mean squares over
/// the bend vector's distribution, here by a grid of ±3.5σ; where straight itself is as near as three sigmas reach, three
/// sigmas of δ reach all round.
fn in_polar_terms(bend: Vector2<f64>, covariance: &Matrix2<f64>) -> Measured {
    let configuration = Configuration::from_bend_vector(bend);
    let eigen = covariance.symmetric_eigen();
    let axes = eigen.eigenvectors * Matrix2::from_diagonal(&eigen.eigenvalues.map(|v| v.max(0.0).sqrt()));
    const HALF: i32 = 14;
    let (mut weights, mut tt, mut dd, mut td) = (0.0, 0.0, 0.0, 0.0);
    for i in -HALF..=HALF {
        for j in -HALF..=HALF {
            let z = Vector2::new(f64::from(i), f64::from(j)) * (3.5 / f64::from(HALF));
            let weight = (-0.5 * z.norm_squared()).exp();
            let other = Configuration::from_bend_vector(bend + axes * z);
            let theta = other.theta - configuration.theta;
            let delta = wrap_angle(other.delta - configuration.delta);
            weights += weight;
            tt += weight * theta * theta;
            dd += weight * delta * delta;
            td += weight * theta * delta;
        }
    }
    /// Squared distance within which lies as much of a Gaussian in two dimensions as within 3σ in one: −2 ln 0.0027.
    const THREE_SIGMAS: f64 = 11.83;
    let from_straight = covariance.try_inverse().map_or(0.0, |information| bend.dot(&(information * bend)));
    let all_round = if from_straight < THREE_SIGMAS { PI / 3.0 } else { 0.0 };
    Measured {
        configuration,
        sigma_theta: (tt / weights).sqrt(),
        sigma_delta: (dd / weights).sqrt().max(all_round),
        correlation: if tt * dd > 0.0 { (td / (tt * dd).sqrt()).clamp(-0.999, 0.999) } else { 0.0 },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;
    use rand::{SeedableRng, rngs::StdRng};
    use rand_distr::{Distribution, Normal};

    #[test]
    fn far_from_straight_the_polar_errors_are_those_of_linear_propagation() {
        let (theta, delta) = (0.8_f64, 0.6_f64);
        let bend = Configuration::new(theta, delta).bend_vector();
        let covariance = Matrix2::new(4e-6, 1e-6, 1e-6, 2e-6);
        let polar = in_polar_terms(bend, &covariance);
        let jacobian = Matrix2::new(delta.cos(), delta.sin(), -delta.sin() / theta, delta.cos() / theta);
        let linear = jacobian * covariance * jacobian.transpose();
        assert_relative_eq!(polar.sigma_theta, linear[(0, 0)].sqrt(), max_relative = 0.01);
        assert_relative_eq!(polar.sigma_delta, linear[(1, 1)].sqrt(), max_relative = 0.01);
        assert_relative_eq!(polar.covariance()[(0, 1)], linear[(0, 1)], epsilon = 2e-8);
    }

    #[test]
    fn at_straight_delta_is_anything() {
        let polar = in_polar_terms(Vector2::new(1e-9, 0.0), &(Matrix2::identity() * 1e-6));
        // A direction uniform over the circle has σ = π/√3.
        assert_relative_eq!(polar.sigma_delta, PI / 3.0_f64.sqrt(), max_relative = 0.05);
        assert!(polar.sigma_theta > 1e-3);
    }

    #[test]
    fn the_direction_is_within_three_sigmas_however_near_to_straight() {
        const SIGMA: f64 = 1e-3;
        const DRAWS: u32 = 20_000;
        let mut random = StdRng::seed_from_u64(7);
        let noise = Normal::new(0.0, SIGMA).unwrap();
        for theta in [0.0, 0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 10.0] {
            let truth = Vector2::new(theta * SIGMA, 0.0);
            let is_outside = |_: &u32| {
                let seen = truth + Vector2::from_fn(|_, _| noise.sample(&mut random));
                let polar = in_polar_terms(seen, &(Matrix2::identity() * SIGMA * SIGMA));
                wrap_angle(polar.configuration.delta).abs() > 3.0 * polar.sigma_delta
            };
            let outside = (0..DRAWS).filter(is_outside).count();
            assert!(outside as f64 / f64::from(DRAWS) < 0.01, "θ {theta} σ: {outside} of {DRAWS}");
        }
    }
}
