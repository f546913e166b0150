//! Whether the snake is bent to a circle: a score test on the fit of one.
//!
//! The departure that is asked for is the simplest there is, [`Curve`]'s: two more parameters beside bend and edge bias. Where
//! the fit of the circle stands, a Gauss-Newton step in all of them says how far the picture would go if it might, and the
//! bend after that step is the tip's own.

use super::correspondences::{BiasPrior, Correspondences, STATE, State};
use super::solve::covariance;
use super::uncertainty::{clustered_covariance, robust_weights, systematic_covariance, whole_covariance};
use crate::measure::body::Projection;
use crate::observation::Shape;
use crate::robot::{BendProfile, Curve};
use nalgebra::{DMatrix, DVector, Matrix2, Matrix4, Matrix6, SMatrix, Vector2, Vector4};

/// How the snake departs from the circle in one picture.
#[derive(Debug, Clone)]
pub(crate) struct Departure {
    /// The bend from base to tip and the departure, rad along x_b and y_b each.
    found: Vector4<f64>,
    /// Covariance from this picture alone.
    covariance: Matrix4<f64>,
    /// Change with the camera's pose (see [`nudged`](crate::measure::target::grid::nudged)).
    by_pose: SMatrix<f64, 4, 6>,
}

/// The step from the circle of a state, fitted to these edges, to the curve that they would rather have. `None` where they
/// do not tell.
pub(crate) fn departure(
    view: &Projection,
    matches: &Correspondences,
    state: &State,
    prior: &BiasPrior,
    scatter_px: f64,
) -> Option<Departure> {
    /// Rounds in which edges that the circle took for outliers may come back.
    const ROUNDS: usize = 5;
    const STEP_RAD: f64 = 1e-4;
    let column = |e: Vector2<f64>| {
        let residuals = |sign: f64| {
            let curve = {
                let mut profile = BendProfile::arc(state.bend);
                profile.modes[0] = e * (-sign * STEP_RAD / 4.0);
                Curve::new(view.robot, &profile)
            };
            matches.residuals_along(view, |s_mm| curve.frame_at(s_mm), state.bias)
        };
        let slopes = residuals(1.0).into_iter().zip(residuals(-1.0));
        slopes.map(|(ahead, behind)| (ahead - behind) / (2.0 * STEP_RAD)).collect::<Vec<f64>>()
    };
    let columns = [column(Vector2::x()), column(Vector2::y())];
    let edges = matches.linearised(view, state).with_prior(prior, state);
    let all = DMatrix::from_fn(edges.by_state.nrows(), STATE + 2, |r, c| match c {
        0..STATE => edges.by_state[(r, c)],
        // Rows beyond the edges are what is known beforehand of the bias.
        _ => columns[c - STATE].get(r).copied().unwrap_or(0.0),
    });
    let weighted = |rows: &DMatrix<f64>, roots: &DVector<f64>| {
        let mut rows = rows.clone();
        rows.column_iter_mut().for_each(|mut column| column.component_mul_assign(roots));
        rows
    };
    let mut step = DVector::zeros(STATE + 2);
    let mut roots = DVector::from_element(all.nrows(), 1.0);
    let mut jacobian = all.clone();
    for _ in 0..ROUNDS {
        let left = &edges.residuals + &all * &step;
        let counted = robust_weights(&left.as_slice()[..matches.len()], false);
        roots.rows_mut(0, matches.len()).copy_from_slice(&counted);
        jacobian = weighted(&all, &roots);
        step = -(covariance(&jacobian)? * jacobian.tr_mul(&edges.residuals.component_mul(&roots)));
    }
    let independent = covariance(&jacobian)?;
    let residuals = edges.residuals.component_mul(&roots) + &jacobian * &step;
    let clustered = clustered_covariance(&jacobian, &residuals, &matches.pieces())?;
    let light = systematic_covariance(matches, &jacobian, &independent, view, roots.as_slice(), scatter_px);
    let gain = &independent * jacobian.tr_mul(&weighted(&edges.by_pose, &roots));
    const KEPT: [usize; 4] = [0, 1, STATE, STATE + 1];
    let covariance = whole_covariance([&clustered, &independent, &light], &KEPT)?;
    Some(Departure {
        found: Vector4::new(state.bend.x + step[0], state.bend.y + step[1], step[STATE], step[STATE + 1]),
        covariance: covariance.fixed_view::<4, 4>(0, 0).into_owned(),
        by_pose: SMatrix::from_fn(|r, c| -gain[(KEPT[r], c)]),
    })
}

impl Departure {
    /// The departure along and across the bend and what the tip's tangent turns by, with what the rig's pose adds to their
    /// errors.
    pub fn measured(&self, pose_covariance: &Matrix6<f64>) -> Option<Shape> {
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
