//! Whether the snake's holder is where the rig says, from its edges in a frame: it does not bend with the snake.

use crate::geometry::{Configuration, perturbed};
use crate::measure::body::{BodyPoint, Outline, OutlinePoint, Piece, Projection};
use crate::measure::fit::{EdgeBias, EdgeFinder, noise_model};
use crate::measure::target::{GridShift, RobustLinear};
use nalgebra::{DMatrix, DVector, Matrix3, Matrix3x6, Matrix6, Point2, RowVector6, Vector2, Vector3, Vector6};

/// Edges need this much of free background and of snake on their sides, px, for the edge filter's assumptions to hold.
///
/// Convention: a little more than the filter is wide.
const CLEAR_PX: f64 = 5.0;
/// The most places of the holder that are looked at.
///
/// Convention: a limit of time.
const MOST_PLACES: usize = 90;
/// Least share of the places, and fewest places, that must have their edge.
///
/// Convention: a majority, and twice as many as parameters.
const LEAST_SHARE: f64 = 0.5;
const FEWEST_PLACES: f64 = 12.0;
/// How far from their places edges are searched for, px: coarsely first, then near the shift that was found.
///
/// Fitted: by hand on the project's renders (tests/eye/drift.rs); a holder that moved by more is not seen, or followed anew.
const SEARCHES_PX: [f64; 3] = [12.0, 5.0, 4.0];
/// What is known of the shift beforehand, px (1σ): without the base's rim nothing tells a shift along the holder.
///
/// Convention: about the widest search.
const SHIFT_SIGMA_PX: f64 = 10.0;
/// How far the light of a frame may shift the holder's edges outwards, px (1σ).
///
/// Fitted: by hand on the project's renders (tests/eye/drift.rs); not judged elsewhere.
pub const LIGHT_SIGMA_PX: f64 = 0.1;
/// How far light and shadow may shift a holder or a target at rest as a whole, px (1σ).
///
/// Fitted: by hand on the project's renders (tests/eye/drift.rs), whose holders at rest are found within 0.35 px and whose targets within 0.2 px; not judged
/// elsewhere.
pub const SHADED_PX: f64 = 0.08;
/// The holder went with the target if its shift is so much nearer to the target's than to none, in squared distances.
///
/// Convention: an odds ratio of e^(a quarter of the squared shift) for normal errors.
const NEARER: f64 = 0.5;
/// Step of central differences of the camera's motion, rad and mm.
///
/// Convention: far below what edges tell, far above rounding.
const STEP: f64 = 1e-4;

const STRAIGHT: Configuration = Configuration { theta: 0.0, delta: 0.0 };

/// The holder's shift in the picture: right and down at its middle, and its turn clockwise as a shift at
/// [`BaseShift::ARM_PX`]; px.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BaseShift {
    pub by: Vector3<f64>,
    pub covariance: Matrix3<f64>,
}

impl BaseShift {
    /// Where a turn is told as a shift, px from the middle.
    ///
    /// Convention: a unit.
    pub const ARM_PX: f64 = 100.0;

    /// Squared distance of the shift from another, in units of its covariance.
    pub fn distance2(&self, other: &Vector3<f64>) -> f64 {
        let off = self.by - other;
        self.covariance.cholesky().map_or(0.0, |factor| off.dot(&factor.solve(&off)))
    }

    /// Squared distance of the shift from none, in units of its covariance and of what light does.
    pub fn departure2(&self) -> f64 {
        let covariance = self.covariance + Matrix3::identity() * SHADED_PX.powi(2);
        Self { by: self.by, covariance }.distance2(&Vector3::zeros())
    }

    /// Whether the holder moved as the target did rather than stayed.
    pub fn went_with(&self, grid: &GridShift) -> bool {
        let with = Vector3::new(grid.at_base.x, grid.at_base.y, self.by.z);
        self.distance2(&with) < NEARER * self.distance2(&Vector3::zeros())
    }
}

/// The places of the holder's border that are looked at in every frame, made ready once.
#[derive(Debug)]
pub struct BaseMonitor {
    places: Vec<OutlinePoint>,
    /// The middle of these places.
    pub middle: Point2<f64>,
    bias: EdgeBias,
    /// The covariance of the shift of a holder at rest: how well the rig knows where it is seen.
    at_rest: Matrix3<f64>,
}

/// An edge of the holder.
pub struct HolderEdge {
    body: BodyPoint,
    normal: Vector2<f64>,
    /// From the holder's middle, in units of [`BaseShift::ARM_PX`].
    arm: Vector2<f64>,
    pub is_side: bool,
    /// How far outside its place it is, px.
    pub distance_px: f64,
    pub sigma_px: f64,
}

impl BaseMonitor {
    /// For a view whose pose is known with this covariance (see [`perturbed`]) and whose light displaces the holder's edges by this bias.
    pub fn new(view: &Projection, pose_covariance: &Matrix6<f64>, bias: EdgeBias) -> Self {
        let is_clear = |p: &OutlinePoint| {
            matches!(p.piece, Piece::HolderSide(_) | Piece::BaseRim) && p.gap_px >= CLEAR_PX && p.depth_px >= CLEAR_PX
        };
        let clear: Vec<OutlinePoint> = Outline::new(view, STRAIGHT).points.into_iter().filter(is_clear).collect();
        let step = clear.len().div_ceil(MOST_PLACES).max(1);
        let places: Vec<OutlinePoint> = clear.into_iter().step_by(step).collect();
        let sum = places.iter().map(|p| p.pixel.coords).sum::<Vector2<f64>>();
        let middle = Point2::from(sum / places.len().max(1) as f64);
        let mut monitor = Self { middle, places, bias, at_rest: Matrix3::zeros() };
        let by_camera = monitor.shift_by_camera(view);
        monitor.at_rest = by_camera * pose_covariance * by_camera.transpose();
        monitor
    }

    /// The holder's shift with each component of the camera's motion (see [`perturbed`]): the least-squares shift of its places.
    fn shift_by_camera(&self, view: &Projection) -> Matrix3x6<f64> {
        let (mut information, mut moved) =
            (Matrix3::from_diagonal_element(SHIFT_SIGMA_PX.powi(-2)), Matrix3x6::zeros());
        for edge in self.edges_near(&Vector3::zeros(), |_| Some((0.0, 0.0))) {
            let by_shift = edge.by_shift();
            information += by_shift * by_shift.transpose();
            moved += by_shift * RowVector6::from(edge.by_camera(view));
        }
        information.cholesky().map_or_else(Matrix3x6::zeros, |factor| factor.solve(&moved))
    }

    /// The holder's shift and turn in the picture; `None` where too little of it is seen.
    pub fn shift(&self, finder: &EdgeFinder) -> Option<BaseShift> {
        self.shift_of(|point, search_px| finder.find(point, search_px).map(|edge| (edge.offset_px, edge.sigma_px)))
    }

    /// The same from a function that gives, near a place of the border, how far outside it an edge lies and the edge's σ, px: of the shift that is
    /// found coarsely first and the one that is found near rest the one that the edges tell better. What is printed beside the holder may have stronger
    /// edges than the holder has, and edges of both agree on no shift.
    fn shift_of(&self, mut edge: impl FnMut(&OutlinePoint, f64) -> Option<(f64, f64)>) -> Option<BaseShift> {
        let near_rest = self.shift_within(&SEARCHES_PX[SEARCHES_PX.len() - 1..], &mut edge);
        let found = [self.shift_within(&SEARCHES_PX, &mut edge), near_rest].into_iter().flatten();
        let volume = |shift: &BaseShift| shift.covariance.determinant();
        found.min_by(|one, other| volume(one).total_cmp(&volume(other)))
    }

    /// The shift from searches within these distances, px, one after the other.
    fn shift_within(
        &self,
        searches_px: &[f64],
        edge: &mut impl FnMut(&OutlinePoint, f64) -> Option<(f64, f64)>,
    ) -> Option<BaseShift> {
        let enough = (LEAST_SHARE * self.places.len() as f64).max(FEWEST_PLACES);
        let prior = [SHIFT_SIGMA_PX, SHIFT_SIGMA_PX, SHIFT_SIGMA_PX, LIGHT_SIGMA_PX, LIGHT_SIGMA_PX];
        let mut by = Vector3::zeros();
        let mut fit = None;
        for search_px in searches_px {
            let edges = self.edges_near(&by, |point| edge(point, *search_px));
            if (edges.len() as f64) < enough {
                return None;
            }
            let row = |e: &HolderEdge| {
                let by_shift = e.by_shift();
                [by_shift.x, by_shift.y, by_shift.z, f64::from(e.is_side), f64::from(!e.is_side)]
            };
            let design = DMatrix::from_fn(edges.len(), 5, |r, c| row(&edges[r])[c] / edges[r].sigma_px);
            let seen = DVector::from_fn(edges.len(), |r, _| edges[r].distance_px / edges[r].sigma_px);
            let is_coarse = *search_px == SEARCHES_PX[0];
            let found = RobustLinear::fit(&design, &seen, &prior, !is_coarse)?;
            by = found.parameters.fixed_rows::<3>(0).into_owned();
            fit = Some(found);
        }
        let found = fit?;
        let covariance = found.covariance.fixed_view::<3, 3>(0, 0) * noise_model().design_effect + self.at_rest;
        (found.agreeing as f64 >= enough).then_some(BaseShift { by, covariance })
    }

    /// The holder's edges near their places once it is shifted.
    pub fn edges(&self, finder: &EdgeFinder, by: &Vector3<f64>) -> Vec<HolderEdge> {
        let search_px = SEARCHES_PX[SEARCHES_PX.len() - 1];
        self.edges_near(by, |point| finder.find(point, search_px).map(|edge| (edge.offset_px, edge.sigma_px)))
    }

    fn edges_near(
        &self,
        by: &Vector3<f64>,
        mut edge: impl FnMut(&OutlinePoint) -> Option<(f64, f64)>,
    ) -> Vec<HolderEdge> {
        let mut near = |point: &OutlinePoint| {
            let normal = point.normal.into_inner();
            let arm = (point.pixel - self.middle) / BaseShift::ARM_PX;
            let shift = Vector2::new(by.x - by.z * arm.y, by.y + by.z * arm.x);
            let (offset_px, sigma_px) = edge(&OutlinePoint { pixel: point.pixel + shift, ..*point })?;
            Some(HolderEdge {
                body: point.body,
                normal,
                arm,
                is_side: matches!(point.piece, Piece::HolderSide(_)),
                distance_px: offset_px + normal.dot(&shift) - self.bias.of(point.piece),
                sigma_px: sigma_px.hypot(noise_model().edge_floor_px),
            })
        };
        self.places.iter().filter_map(&mut near).collect()
    }
}

impl HolderEdge {
    /// How far the border moves outwards, px, with each component of the holder's shift (see [`BaseShift`]).
    fn by_shift(&self) -> Vector3<f64> {
        self.normal.push(self.normal.y * self.arm.x - self.normal.x * self.arm.y)
    }

    /// How far the border moves outwards, px, with each component of the camera's motion (see [`perturbed`]).
    pub fn by_camera(&self, view: &Projection) -> [f64; 6] {
        let pixel = |axis: usize, step: f64| {
            let mut by = Vector6::zeros();
            by[axis] = step;
            let moved = Projection { camera_from_base: perturbed(&view.camera_from_base, &by), ..view.clone() };
            moved.holder_pixel(&self.body)
        };
        std::array::from_fn(|axis| self.normal.dot(&(pixel(axis, STEP) - pixel(axis, -STEP))) / (2.0 * STEP))
    }
}

#[cfg(test)]
mod tests {
    use super::super::parameters::tests::rig;
    use super::*;
    use crate::measure::target::DETECTION_SIGMAS;
    use crate::robot::Robot;
    use crate::simulate::scene::Scene;
    use rand::{SeedableRng, rngs::StdRng};
    use rand_distr::{Distribution, Normal};

    /// The shift that is seen of a holder that moved (px right, px down, turn as px at the arm) under a noise of its edges, all of
    /// which light displaces by `light_px`.
    fn seen(moved: Vector3<f64>, light_px: f64, seed: u64) -> Option<BaseShift> {
        let (lens, robot) = (Scene::default().lens, Robot::default());
        let view = Projection { lens: &lens, camera_from_base: rig().camera_from_base, robot: &robot };
        let monitor = BaseMonitor::new(&view, &Matrix6::zeros(), EdgeBias::default());
        let mut random = StdRng::seed_from_u64(seed);
        let noise = Normal::new(0.0, 0.1).unwrap();
        let true_place = |point: &OutlinePoint| {
            // The place on the outline that the monitor shifted this one from, by its body point.
            let arm = (view.holder_pixel(&point.body) - monitor.middle) / BaseShift::ARM_PX;
            view.holder_pixel(&point.body) + Vector2::new(moved.x - moved.z * arm.y, moved.y + moved.z * arm.x)
        };
        monitor.shift_of(|point, search_px| {
            let offset_px = point.normal.dot(&(true_place(point) - point.pixel)) + light_px + noise.sample(&mut random);
            (offset_px.abs() < search_px).then_some((offset_px, 0.08))
        })
    }

    #[test]
    fn a_holder_at_rest_gives_no_alarm_and_one_that_moved_does() {
        let alarms = (0..300)
            .filter(|&seed| seen(Vector3::zeros(), 0.05, seed).unwrap().departure2() > DETECTION_SIGMAS.powi(2))
            .count();
        assert_eq!(alarms, 0);
        for seed in 0..50 {
            for moved in [Vector3::new(1.0, 0.0, 0.0), Vector3::new(-4.0, 0.5, 1.0), Vector3::new(0.0, 0.0, 3.0)] {
                let shift = seen(moved, 0.05, seed).unwrap();
                assert!(shift.departure2() > DETECTION_SIGMAS.powi(2), "{moved}: {shift:?}");
                assert!((shift.by.x - moved.x).abs() < 0.3, "{moved}: {shift:?}");
            }
        }
    }

    #[test]
    fn strong_edges_beside_a_holder_at_rest_do_not_move_it() {
        let (lens, robot) = (Scene::default().lens, Robot::default());
        let view = Projection { lens: &lens, camera_from_base: rig().camera_from_base, robot: &robot };
        let monitor = BaseMonitor::new(&view, &Matrix6::zeros(), EdgeBias::default());
        // Wherever the search reaches as far, print 6 px to the right has the stronger edge at three of five places.
        let mut place = 0;
        let seen = |point: &OutlinePoint, search_px: f64| {
            place += 1;
            let at = |right_px: f64| {
                point.normal.dot(&(view.holder_pixel(&point.body) + Vector2::new(right_px, 0.0) - point.pixel))
            };
            let found = [at(6.0), at(0.0)].into_iter().skip(usize::from(place % 5 < 2));
            found.into_iter().find(|offset_px| offset_px.abs() < search_px).map(|offset_px| (offset_px, 0.08))
        };
        let shift = monitor.shift_of(seen).unwrap();
        assert!(shift.by.norm() < 0.05, "{shift:?}");
    }

    #[test]
    fn the_covariance_of_the_shift_is_that_of_its_scatter_times_the_design_effect() {
        // The noise that the edges state with their systematic error, 0.08 ⊕ 0.06 px, is the 0.1 px that they have.
        let shifts: Vec<BaseShift> = (0..300).filter_map(|seed| seen(Vector3::zeros(), 0.0, seed)).collect();
        let mean = shifts.iter().map(|shift| shift.by.x.powi(2)).sum::<f64>() / shifts.len() as f64;
        let predicted = shifts[0].covariance[(0, 0)] / noise_model().design_effect;
        // 300 draws tell a variance to 8 %; the prediction also allows for light, which here is none.
        assert!(mean < 1.25 * predicted && mean > 0.1 * predicted, "{mean} seen, {predicted} predicted");
    }

    /// A camera that is turned and moved by what its pose leaves open shows the holder elsewhere by no more than that.
    #[test]
    fn the_shift_of_a_holder_at_rest_scatters_as_the_pose_does() {
        let (lens, robot) = (Scene::default().lens, Robot::default());
        let view = Projection { lens: &lens, camera_from_base: rig().camera_from_base, robot: &robot };
        let sd = Vector6::new(1e-3, 1e-3, 2e-3, 0.02, 0.03, 0.1);
        let covariance = Matrix6::from_diagonal(&sd.component_mul(&sd));
        let monitor = BaseMonitor::new(&view, &covariance, EdgeBias::default());
        let mut random = StdRng::seed_from_u64(4);
        let mut chi2 = 0.0;
        for _ in 0..100 {
            let by = sd.map(|sd| sd * Normal::new(0.0, 1.0).unwrap().sample(&mut random));
            let moved = Projection { camera_from_base: perturbed(&view.camera_from_base, &by), ..view.clone() };
            let shift = monitor.shift_of(|point, _| {
                let offset = moved.holder_pixel(&point.body) - point.pixel;
                Some((point.normal.dot(&offset), 1e-3))
            });
            chi2 += shift.unwrap().distance2(&Vector3::zeros()) / 100.0;
        }
        // Three degrees of freedom, the mean of 100 draws; the noise that the edges state widens the covariance.
        assert!((1.5..3.6).contains(&chi2), "{chi2}");
    }

    #[test]
    fn a_holder_that_is_hidden_has_no_shift() {
        assert_eq!(seen(Vector3::new(60.0, 0.0, 0.0), 0.0, 1), None);
    }
}
