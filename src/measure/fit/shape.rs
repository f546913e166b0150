//! Whether the snake is bent to a circle: a score test on the fit of one.
//!
//! The alternative is the simplest departure from a circle, [`Curve`]'s: two parameters beside bend and edge bias. One Gauss–Newton step
//! in all parameters from the fitted circle gives their estimate, and the bend after that step is the tip's own.
//!
//! Source: C. R. Rao, "Large sample tests of statistical hypotheses", Proc. Camb. Phil. Soc. 44, 1948, for the score test.

use super::correspondences::Correspondences;
use super::linearised::{LEAST_SCALE, Linearised};
use super::state::{BiasPrior, STATE, State};
use super::uncertainty::{FitCovariance, RobustPhase};
use crate::measure::body::Projection;
use crate::observation::Shape;
use crate::robot::{BendProfile, Curve};
use crate::statistics::robust::Irls;
use nalgebra::{DMatrix, DVector, Matrix2, Matrix4, Matrix6, SMatrix, Vector2, Vector4};

/// Reweightings in which edges that the circle made outliers may count again.
///
/// Convention: an iteration cap.
const REWEIGHTINGS: usize = 5;
/// Step of the departure for central differences, rad.
///
/// Convention: far above rounding, far below where the residuals bend.
const DIFFERENCE_RAD: f64 = 1e-4;
/// Indices of the parameters that are reported: the bend vector and the departure.
const REPORTED: [usize; 4] = [0, 1, STATE, STATE + 1];

/// How the snake departs from the circle in one picture.
#[derive(Debug, Clone)]
pub(crate) struct Departure {
    /// The bend from base to tip and the departure, rad along x_b and y_b each.
    found: Vector4<f64>,
    /// Covariance from this picture alone.
    covariance: Matrix4<f64>,
    /// Change with the camera's pose (see [`perturbed`](crate::geometry::perturbed)).
    by_pose: SMatrix<f64, 4, 6>,
}

/// The step from the circle of a state, fitted to these edges, to the curve that fits them best. `None` where they do not determine
/// it.
pub(super) fn departure(
    view: &Projection,
    edges: &Correspondences,
    state: &State,
    prior: &BiasPrior,
    scatter_px: f64,
) -> Option<Departure> {
    let linear = Linearised::new(edges, view, state).with_prior(prior, state);
    let by_departure = [Vector2::x(), Vector2::y()].map(|axis| derivatives_by_departure(view, edges, state, axis));
    let jacobian = DMatrix::from_fn(linear.by_state.nrows(), STATE + 2, |r, c| match c {
        0..STATE => linear.by_state[(r, c)],
        // Rows beyond the edges are the prior of the biases.
        _ => by_departure[c - STATE].get(r).copied().unwrap_or(0.0),
    });
    let irls =
        Irls { loss: RobustPhase::Redescending.loss(), least_scale: LEAST_SCALE, rounds: REWEIGHTINGS, tolerance: 0.0 };
    let fit = irls.fit(&jacobian, &linear.residuals, edges.len())?;
    let (step, roots) = (fit.parameters, fit.weights.map(f64::sqrt));
    let weighted = |rows: &DMatrix<f64>| {
        let mut rows = rows.clone();
        rows.column_iter_mut().for_each(|mut column| column.component_mul_assign(&roots));
        rows
    };
    let jacobian = weighted(&jacobian);
    let residuals: DVector<f64> = linear.residuals.component_mul(&roots) + &jacobian * &step;
    let covariance = FitCovariance::new(edges, &jacobian, &residuals, view, roots.as_slice(), scatter_px)?;
    let gain = &covariance.independent * jacobian.tr_mul(&weighted(&linear.by_pose));
    Some(Departure {
        found: Vector4::new(state.bend.x + step[0], state.bend.y + step[1], step[STATE], step[STATE + 1]),
        covariance: covariance.total(&REPORTED)?.fixed_view::<4, 4>(0, 0).into_owned(),
        by_pose: SMatrix::from_fn(|r, c| -gain[(REPORTED[r], c)]),
    })
}

/// The derivatives of the edges' residuals by the departure along an axis, by central differences.
fn derivatives_by_departure(view: &Projection, edges: &Correspondences, state: &State, axis: Vector2<f64>) -> Vec<f64> {
    let residuals = |sign: f64| {
        let mut profile = BendProfile::arc(state.bend);
        // A bend rate (b + e (2u − 1))/L is the profile b u − e u (1 − u), of which the first mode is 4 u (1 − u).
        profile.modes[0] = axis * (-sign * DIFFERENCE_RAD / 4.0);
        let curve = Curve::new(view.robot, &profile);
        edges.residuals_along(view, |s_mm| curve.frame_at(s_mm), state.bias)
    };
    let pairs = residuals(1.0).into_iter().zip(residuals(-1.0));
    pairs.map(|(ahead, behind)| (ahead - behind) / (2.0 * DIFFERENCE_RAD)).collect()
}

impl Departure {
    /// The tip's bend and the departure along and across it, with what the uncertainty of the rig's pose adds.
    pub fn shape(&self, pose_covariance: &Matrix6<f64>) -> Option<Shape> {
        let covariance = self.covariance + self.by_pose * pose_covariance * self.by_pose.transpose();
        let (bend, departure) = (self.found.fixed_rows::<2>(0), self.found.fixed_rows::<2>(2));
        let of_bend: Matrix2<f64> = covariance.fixed_view::<2, 2>(0, 0).into_owned();
        let of_departure: Matrix2<f64> = covariance.fixed_view::<2, 2>(2, 2).into_owned();
        let along = if bend.norm() > 0.0 { bend.normalize() } else { Vector2::x() };
        let across = Vector2::new(-along.y, along.x);
        let sigma = |of: &Matrix2<f64>, direction: &Vector2<f64>| direction.dot(&(of * direction)).max(0.0).sqrt();
        Some(Shape {
            tip_theta: bend.norm(),
            sigma_tip_theta: sigma(&of_bend, &along),
            along: departure.dot(&along),
            sigma_along: sigma(&of_departure, &along),
            across: departure.dot(&across),
            sigma_across: sigma(&of_departure, &across),
            chi2: departure.dot(&(of_departure.cholesky()?.solve(&departure))),
        })
    }
}
