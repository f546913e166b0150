//! The eye: frames to θ and δ.
//!
//! A frame goes through these stages, see [`Eye::measure`]:
//!
//! 1. Coarse search: the bends of a lattice with the most contrast across their outlines are candidates. It looks at the whole frame, made smaller.
//! 2. First try: the best candidate, or the one that is expected, goes through stages 3 to 6 with no other beside it but its mirrored solution.
//!    Only its surroundings are looked at. The answer stands where it agrees with nearly all of the outline and no other bend comes near to it.
//! 3. Coarse fits: each candidate is fitted to the whole frame from wide search distances; the best one's mirrored solution as well.
//! 4. Refinement: the best of them are fitted until they converge.
//! 5. Selection among the local minima: the best is fitted in the fine stage, and so is every other that may explain the picture
//!    as well, its mirrored solution among them.
//! 6. Verdict: the status, and for [`Status::Ok`] the bend with its covariance, to which the rig's uncertainty is added.

use super::fitter::Fitter;
use super::minima::leading_home;
use super::selection::{Attempt, Selection};
use crate::camera::{Frame, Lens};
use crate::geometry::Pose;
use crate::measure::body::{Outline, Projection};
use crate::measure::fit::{BendFit, CoarseSearch, EdgeFinder, FitSchedule, ProfileCovariance, Shrink, noise_model};
use crate::measure::image::appearance::Appearance;
use crate::measure::image::exposure::is_saturated;
use crate::measure::image::plane::{Plane, Region};
use crate::measure::measurement::{Bend, FrameMeasurement};
use crate::measure::rig::{DriftCheck, Rig, RigDriftMonitor, lit_region};
use crate::measure::target::{PrintProfile, look_through};
use crate::observation::{Quality, Shape, Status};
use crate::robot::{BendProfile, Robot};
use nalgebra::{Matrix6, Vector2};
use std::sync::{Arc, OnceLock};

/// How many candidates the coarse search hands on.
///
/// Fitted: by hand on renders; judged by `tests/eye/robustness`.
const CANDIDATES: usize = 6;
/// How far around the outline of the bend that a fit starts from a frame is looked at, px.
///
/// Convention: twice the first search distance of the fits; a snake that is further off is searched everywhere, which takes longer but costs no
/// accuracy.
const NEAR_REACH_PX: f64 = 28.0;
/// A snake that is shorter in the picture is called small, px.
///
/// Convention: the book's advice. In 36 photo-real frames the median σ of θ is 0.03° at 488 px; averaged over 2×2 and 3×3 px, 0.09° at 245
/// px and 0.15° at 163 px.
const SMALL_PX: f64 = 300.0;
/// The share of the outline outside the picture from which on the snake is out of frame.
///
/// Convention: the majority.
const OUT_OF_FRAME: f64 = 0.5;
/// The blur from which on a frame is blurred, σ in px.
///
/// Fitted: by hand on renders; judged by the blurred frames of `tests/eye/robustness`.
const BLURRED_PX: f64 = 5.0;

/// The variance of a fit with any shape, in units of what its edges and priors give: the shape is chosen by the picture that it is then fitted
/// to.
///
/// Fitted: to 166 lone frames of `tests/eye/robustness` (seeds 21000 to 21063) whose shape is no arc's: with 1.6 χ² of θ and δ was 1.87 and 1.82.
const ANY_SHAPE_VARIANCE: f64 = 2.9;

/// Measures the snake in the frames of one calibrated view.
#[derive(Debug, Clone)]
pub struct Eye {
    pub(super) lens: Lens,
    pub(super) rig: Rig,
    pub(super) robot: Robot,
    /// The coarse search, made when a frame first asks for it, and the camera's pose that it is made for.
    pub(super) search: Arc<OnceLock<CoarseSearch>>,
    pub(super) search_pose: Pose,
    /// What of the sheet is behind every pixel, and behind every pixel of the coarse search, made when a frame first asks for it; `None` where the
    /// eye does not look through its lines.
    pub(super) sheet: Arc<OnceLock<Option<(Plane, Plane)>>>,
    pub(super) drift_monitor: Arc<RigDriftMonitor>,
    /// The pose's covariance as calibrated, before a moving camera was followed.
    pub(super) calibrated_covariance: Matrix6<f64>,
}

/// The stages of one measurement.
pub(super) struct MeasurementStages {
    /// Bends that the coarse search found, best first.
    pub candidates: Vec<Vector2<f64>>,
    /// The local minima, best first; the first is fitted in the fine stage.
    pub fits: Vec<BendFit>,
    pub measurement: FrameMeasurement,
}

/// A frame, and what is known of all of it before any part is looked at.
pub(super) struct Exposed<'a> {
    pub frame: &'a Frame,
    /// What tells snake from target at its exposure.
    pub appearance: Appearance,
    /// The noise of a pixel, σ of the discriminant.
    pub noise: f64,
}

/// The verdict on a frame, and the fits that it is drawn from.
struct Conclusion {
    /// The local minima, best first.
    fits: Vec<BendFit>,
    /// What was tried.
    attempts: Vec<Attempt>,
    drift: DriftCheck,
    measurement: FrameMeasurement,
}

impl Conclusion {
    /// Whether a snake was measured that needs no comparison with other candidates.
    fn is_certain(&self) -> bool {
        self.measurement.status == Status::Ok && self.fits.first().is_some_and(BendFit::explains_all)
    }
}

impl Eye {
    /// An eye for one view. The first frame that is looked for everywhere takes longer than others: the coarse search is made then, if it was
    /// not [prepared](Self::prepare).
    pub fn new(lens: Lens, rig: Rig, robot: Robot) -> Self {
        let (search, sheet) = Default::default();
        let (search_pose, calibrated_covariance) = (rig.camera_from_base, rig.pose_covariance);
        let view = Projection { lens: &lens, camera_from_base: rig.camera_from_base, robot: &robot };
        let drift_monitor = Arc::new(RigDriftMonitor::new(&lens, &rig, &view));
        Self { lens, rig, robot, search, search_pose, sheet, drift_monitor, calibrated_covariance }
    }

    /// The coarse search; made now if no frame asked for it before.
    pub(super) fn search(&self) -> &CoarseSearch {
        if let Some(made) = self.search.get() {
            return made;
        }
        // Made outside of the lock: a thread of a pool that waits here for others may be given the next frame, which asks as well.
        let made = CoarseSearch::new(&self.lens, self.search_pose, &self.robot);
        self.search.get_or_init(|| made)
    }

    /// How much smaller than a frame is the picture that the coarse search reads.
    fn shrink(&self) -> Shrink {
        let Self { lens, robot, .. } = self;
        Shrink::suiting(&Projection { lens, camera_from_base: self.search_pose, robot })
    }

    /// What of the sheet is behind every pixel, large and small; made now if no frame asked for it before.
    fn sheet(&self) -> Option<&(Plane, Plane)> {
        if let Some(made) = self.sheet.get() {
            return made.as_ref();
        }
        let whole = Region::whole(self.lens.width, self.lens.height);
        let picture = |print: &PrintProfile| {
            let large = print.picture(&self.lens, &self.rig.sheet(), self.rig.grid_pitch_mm, &whole);
            let small = self.shrink().plane(&large);
            (large, small)
        };
        let made = self.rig.print.as_ref().map(picture);
        self.sheet.get_or_init(|| made).as_ref()
    }

    /// Makes the coarse search and the picture of the sheet now, and not when the first frame asks for them.
    pub fn prepare(&self) {
        self.search();
        self.sheet();
    }

    /// The lens that this eye sees through.
    pub fn lens(&self) -> &Lens {
        &self.lens
    }

    /// The rig that this eye measures by.
    pub fn rig(&self) -> &Rig {
        &self.rig
    }

    /// How this eye projects the snake.
    pub fn projection(&self) -> Projection<'_> {
        Projection { lens: &self.lens, camera_from_base: self.rig.camera_from_base, robot: &self.robot }
    }

    /// What a picture in which the snake is small costs; `None` where it is large enough.
    pub fn small_picture(&self) -> Option<String> {
        let length_px = self.projection().straight_length_px();
        (length_px < SMALL_PX).then(|| {
            format!(
                "the snake is only {length_px:.0} px long in the picture (σ of θ is about 0.03° at 490 px, 0.09° at 245 px, 0.15° at 163 px): \
                 bring the camera nearer, or take larger pictures, for {SMALL_PX} px or more"
            )
        })
    }

    /// Measures one frame: θ and δ in the base's axes.
    pub fn measure(&self, frame: &Frame) -> FrameMeasurement {
        self.measure_in_stages(&self.exposed(frame), None).measurement
    }

    /// Measures one frame of a snake whose bend vector is expected to be about this: the candidate nearest to it is tried first, and not the
    /// best. Says the same as [`measure`](Self::measure), sooner where the best is not the right one.
    pub fn measure_expected(&self, frame: &Frame, expected: Vector2<f64>) -> FrameMeasurement {
        self.measure_in_stages(&self.exposed(frame), Some(expected)).measurement
    }

    /// Measures a frame of a sequence whose `last` bend vector is known: fits from there, and searches everywhere only where that
    /// does not give a snake that agrees with nearly all of the outline. Says the same as [`measure`](Self::measure) to about a hundredth of a
    /// degree, sooner.
    pub fn track(&self, frame: &Frame, last: Vector2<f64>) -> FrameMeasurement {
        if let Some(status) = self.unusable(frame) {
            return FrameMeasurement::failed(status, None);
        }
        let exposed = self.exposed(frame);
        let near = self.fit_near(&exposed, last, &FitSchedule::FROM_NEAR);
        let near = near.map(|near| self.conclude_alone(near, &exposed, &FitSchedule::TRACKED_FINE));
        let certain = near.filter(Conclusion::is_certain).map(|near| near.measurement);
        certain.unwrap_or_else(|| self.search_everywhere(&exposed, None).measurement)
    }

    /// Measures one frame, whose bend may be expected, and keeps what its stages found.
    pub(super) fn measure_in_stages(&self, exposed: &Exposed, expected: Option<Vector2<f64>>) -> MeasurementStages {
        if let Some(status) = self.unusable(exposed.frame) {
            let measurement = FrameMeasurement::failed(status, None);
            return MeasurementStages { candidates: Vec::new(), fits: Vec::new(), measurement };
        }
        self.search_everywhere(exposed, expected)
    }

    /// Measures a frame from the candidates of the coarse search, the one nearest to an expected bend first.
    fn search_everywhere(&self, exposed: &Exposed, expected: Option<Vector2<f64>>) -> MeasurementStages {
        let candidates = self.search().candidates(&self.overview(exposed), self.rig.appearance.two_sided, CANDIDATES);
        let fit_from = |candidate| {
            let near = self.fit_near(exposed, candidate, &FitSchedule::FROM_CANDIDATE);
            near.filter(|(_, minimum)| minimum.is_promising())
        };
        let first = expected.or(candidates.first().copied());
        let first = first.and_then(|bend| leading_home(&candidates, bend, fit_from, |(_, minimum)| minimum.bend()));
        let minimum = first.as_ref().map(|(_, minimum)| minimum.clone());
        let alone = first.map(|first| self.conclude_alone(first, exposed, &FitSchedule::FINE));
        let Conclusion { fits, measurement, .. } = match alone {
            Some(alone) if alone.is_certain() => alone,
            alone => {
                let plane = self.plane(exposed, &Region::whole(exposed.frame.width, exposed.frame.height));
                let fitter = self.fitter(&plane, exposed);
                self.conclude(fitter.minima(&candidates, minimum), alone, exposed.frame, &fitter, &FitSchedule::FINE)
            }
        };
        MeasurementStages { candidates, fits, measurement }
    }

    /// The fit from a bend, and the region around that bend that it looked at; `None` where it leaves that.
    fn fit_near(&self, exposed: &Exposed, bend: Vector2<f64>, schedule: &FitSchedule) -> Option<(Plane, BendFit)> {
        let view = self.projection();
        let region = view.image_region(BendProfile::arc(bend), NEAR_REACH_PX);
        let plane = self.plane(exposed, &region);
        let fitter = self.fitter(&plane, exposed);
        let fit = fitter.fit(fitter.start(bend), schedule)?;
        // A snake that reaches out of the region was not seen whole.
        region.contains(&view.image_region(fit.profile, Outline::REACH_PX)).then_some((plane, fit))
    }

    /// The verdict on a minimum that is the only one, from the region that it was found in.
    fn conclude_alone(&self, (plane, minimum): (Plane, BendFit), exposed: &Exposed, fine: &FitSchedule) -> Conclusion {
        self.conclude(vec![minimum], None, exposed.frame, &self.fitter(&plane, exposed), fine)
    }

    /// A frame at its own exposure.
    pub(super) fn exposed<'a>(&self, frame: &'a Frame) -> Exposed<'a> {
        let appearance = self.rig.appearance.exposed_as(frame, &lit_region(&self.projection()));
        let noise = appearance.noise(frame);
        Exposed { frame, appearance, noise }
    }

    /// The picture of one channel in which the snake is about 1 and the background about 0, over a region of a frame.
    pub(super) fn plane(&self, exposed: &Exposed, region: &Region) -> Plane {
        let mut plane = exposed.appearance.plane_within(exposed.frame, region);
        if let Some((sheet, _)) = self.sheet() {
            look_through(&mut plane, sheet);
        }
        plane
    }

    /// The same of all of a frame, as small as the coarse search reads it.
    fn overview(&self, exposed: &Exposed) -> Plane {
        let Exposed { frame, appearance, .. } = exposed;
        let mut overview = self.shrink().overview(appearance, frame);
        if let Some((_, sheet)) = self.sheet() {
            look_through(&mut overview, sheet);
        }
        overview
    }

    /// Why a frame cannot be measured whatever it shows.
    fn unusable(&self, frame: &Frame) -> Option<Status> {
        if (frame.width, frame.height) != (self.lens.width, self.lens.height) {
            return Some(Status::WrongSize);
        }
        is_saturated(frame).then_some(Status::Saturated)
    }

    /// Fits to what is seen of a frame.
    fn fitter<'a>(&'a self, plane: &'a Plane, exposed: &Exposed) -> Fitter<'a> {
        let finder = EdgeFinder::with_noise(plane, self.rig.appearance.two_sided, exposed.noise);
        Fitter { view: self.projection(), rig: &self.rig, finder }
    }

    /// Selects among the minima and gives the verdict on the best, beside the check of whether camera, base and target are where the
    /// rig says. What an `earlier` conclusion on fewer minima of this frame found out is not found out again.
    fn conclude(
        &self,
        minima: Vec<BendFit>,
        earlier: Option<Conclusion>,
        frame: &Frame,
        fitter: &Fitter,
        fine: &FitSchedule,
    ) -> Conclusion {
        let (known, drift) = earlier.map(|earlier| (earlier.attempts, earlier.drift)).unzip();
        let select = || fitter.select(minima, known.unwrap_or_default(), fine);
        let check = || drift.unwrap_or_else(|| self.drift_monitor.check(frame, &fitter.finder));
        let (selection, drift) = rayon::join(select, check);
        let Selection { fits, has_fine_fit, attempts, refusal } = selection;
        let mut measurement = match fits.first().filter(|_| has_fine_fit) {
            Some(best) => self.verdict(best, refusal),
            None => FrameMeasurement::failed(Status::NoSnake, None),
        };
        if let Some(quality) = &mut measurement.quality {
            quality.base_moved_px = drift.base.map(|base| base.by.norm());
            quality.grid_moved_px = drift.grid.map(|grid| grid.px);
        }
        if let Some(status) = drift.status() {
            measurement = FrameMeasurement::failed(status, measurement.quality);
        }
        Conclusion { fits, attempts, drift, measurement }
    }

    /// The measurement of a fit that can be believed, or why it cannot.
    fn verdict(&self, fit: &BendFit, refusal: Option<Status>) -> FrameMeasurement {
        let quality = Quality {
            edges: fit.inliers,
            inlier_fraction: fit.inlier_fraction(),
            rms_px: fit.rms_px,
            ..Quality::default()
        };
        if let Some(status) = refusal_by_edges(fit) {
            return FrameMeasurement::failed(status, Some(quality));
        }
        let by_rig = fit.by_pose * symmetric_root(&(self.rig.pose_covariance * noise_model().pose_variance));
        let by_choice = if fit.of_any_shape { ANY_SHAPE_VARIANCE - 1.0 } else { 0.0 };
        let of_choice = (fit.covariance - fit.doubt) * by_choice;
        let covariance = fit.covariance + fit.scatter + of_choice + by_rig * by_rig.transpose();
        let quality = Quality { shape: shape(&fit.profile, &covariance), profile: Some(fit.profile), ..quality };
        if !fit.evidence.shows_tip() {
            return FrameMeasurement::failed(Status::Occluded, Some(quality));
        }
        if let Some(status) = refusal {
            return FrameMeasurement::failed(status, Some(quality));
        }
        let covariance = covariance.fixed_view::<2, 2>(0, 0).into_owned();
        let by_rig = by_rig.fixed_rows::<2>(0).into_owned();
        FrameMeasurement::of(Bend { vector: fit.bend(), covariance, by_rig }, quality)
    }
}

/// The symmetric root of a covariance: what six independent unit errors do. It changes continuously with the covariance, so that the errors
/// keep their meaning from frame to frame while a moving camera is followed.
fn symmetric_root(covariance: &Matrix6<f64>) -> Matrix6<f64> {
    let mut eigen = covariance.symmetric_eigen();
    eigen.eigenvalues.apply(|variance| *variance = variance.max(0.0).sqrt());
    eigen.recompose()
}

/// How a profile departs from an arc. `None` where its covariance is not positive definite.
fn shape(profile: &BendProfile, covariance: &ProfileCovariance) -> Option<Shape> {
    let along = profile.tip.try_normalize(0.0).unwrap_or(Vector2::x());
    let across = Vector2::new(-along.y, along.x);
    let block = |k: usize| covariance.fixed_view::<2, 2>(2 * k, 2 * k).into_owned();
    let sigma = |k: usize, direction: Vector2<f64>| direction.dot(&(block(k) * direction)).max(0.0).sqrt();
    // e of the linear change of curvature is −4 a_1.
    let departure = profile.modes[0] * -4.0;
    Some(Shape {
        tip_theta: profile.tip.norm(),
        sigma_tip_theta: sigma(0, along),
        along: departure.dot(&along),
        sigma_along: 4.0 * sigma(1, along),
        across: departure.dot(&across),
        sigma_across: 4.0 * sigma(1, across),
        chi2: profile.modes[0].dot(&(block(1).cholesky()?.solve(&profile.modes[0]))),
    })
}

/// Why the edges of a fit do not suffice for a measurement.
fn refusal_by_edges(fit: &BendFit) -> Option<Status> {
    if fit.out_of_frame > OUT_OF_FRAME {
        Some(Status::OutOfFrame)
    } else if !fit.evidence.shows_snake() {
        // Of a snake that is half hidden the tubes near the base are seen.
        Some(if fit.evidence.of_tubes() > 0.0 { Status::Occluded } else { Status::NoSnake })
    } else {
        (fit.blur.px > BLURRED_PX).then_some(Status::Blurred)
    }
}
