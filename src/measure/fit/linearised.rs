//! The edges' residuals linearised in bend, edge bias and camera pose, and the robust step that follows.

use super::correspondences::Correspondences;
use super::state::{FramePrior, PRIORS, STATE, State};
use super::uncertainty::{LEAST_SCALE, RobustPhase};
use crate::measure::body::Projection;
use crate::robot::PROFILE;
use crate::statistics::robust::Irls;
use nalgebra::{DMatrix, DVector, Matrix3, Point3, SVector, Vector3, Vector6};

/// The most reweightings of one linearisation.
///
/// Convention: an iteration cap.
const MOST_REWEIGHTINGS: usize = 10;
/// A reweighting that moves the state by less (rad and px) is the last: in the fine stage, ...
///
/// Convention: a tenth of what a fit must move by to go on.
pub(super) const REWEIGHTING_TOLERANCE: f64 = 1e-4;
/// ... and in the coarse stages, after which the fine one goes on.
///
/// Convention: what a fit must move by to go on.
pub(super) const COARSE_REWEIGHTING_TOLERANCE: f64 = 1e-3;

/// Residuals of edges in units of σ, times the roots of their weights, and their derivatives (rows: edges, then priors).
#[derive(Debug, Clone)]
pub(crate) struct Linearised {
    pub residuals: DVector<f64>,
    /// By bend profile (rad) and edge biases (px): the components of [`State`].
    pub by_state: DMatrix<f64>,
    /// By the camera's pose (see [`perturbed`](crate::geometry::perturbed)).
    pub by_pose: DMatrix<f64>,
}

/// One edge's residual, in units of σ, and its derivatives.
struct LinearisedEdge {
    residual: f64,
    by_state: [f64; STATE],
    /// The border point in the camera's frame, mm, and the residual's derivative by it.
    point: Point3<f64>,
    by_point: Vector3<f64>,
}

/// Linearises the residual of each edge at a state, in closed form.
fn linearised_edges(
    edges: &Correspondences,
    view: &Projection,
    state: &State,
) -> impl ExactSizeIterator<Item = LinearisedEdge> {
    let curve = view.curve(state.profile);
    // Each section's pose in {b} and, a row for each number of the profile, its twist there.
    let moving = |&s_mm: &f64| (curve.frame_at(s_mm).to_homogeneous(), curve.section_jacobian(s_mm).transpose());
    let sections: Vec<_> = edges.sections_mm.iter().map(moving).collect();
    let camera_from_base = view.camera_from_base.to_homogeneous();
    let turned: Matrix3<f64> = camera_from_base.fixed_view::<3, 3>(0, 0).into_owned();
    edges.all.iter().zip(&edges.section_of).map(move |(edge, &section)| {
        let (base_from_section, twist) = &sections[section];
        let arm = base_from_section.fixed_view::<3, 3>(0, 0) * edge.body.local;
        let in_base = arm + base_from_section.fixed_view::<3, 1>(0, 3);
        let point = Point3::from(turned * in_base + camera_from_base.fixed_view::<3, 1>(0, 3));
        let (expected, jacobian) = view.lens.project_with_jacobian(&point);
        // ∂(distance along the normal, in units of σ)/∂(point in the camera's frame, mm).
        let by_point = jacobian.tr_mul(&edge.normal) / edge.sigma_px;
        let distance_px = edge.normal.dot(&(edge.seen - expected));
        let (bias_px, by_bias) = state.bias.at(edge.piece, edge.face);
        let by_place = turned.tr_mul(&by_point);
        let by_turn = arm.cross(&by_place);
        let by_twist = Vector6::new(by_place.x, by_place.y, by_place.z, by_turn.x, by_turn.y, by_turn.z);
        let by_profile = twist * by_twist;
        let by_state = std::array::from_fn(|k| match k.checked_sub(PROFILE) {
            None => -by_profile[k],
            Some(bias) => -by_bias[bias] / edge.sigma_px,
        });
        LinearisedEdge { residual: (distance_px - bias_px) / edge.sigma_px, by_state, point, by_point }
    })
}

/// The Gauss–Newton step from a state under a robust loss, by iteratively reweighted least squares, and the square roots of the edges'
/// weights. `None` where the edges do not determine the state.
pub(crate) fn robust_step(
    edges: &Correspondences,
    view: &Projection,
    state: &State,
    prior: &FramePrior,
    phase: RobustPhase,
    tolerance: f64,
) -> Option<(SVector<f64, STATE>, Vec<f64>)> {
    let irls = Irls { loss: phase.loss(), least_scale: LEAST_SCALE, rounds: MOST_REWEIGHTINGS, tolerance };
    let mut offset = DVector::zeros(edges.len() + PRIORS);
    let mut design = DMatrix::zeros(edges.len() + PRIORS, STATE);
    let mut columns = columns::<STATE>(&mut design);
    for (row, edge) in linearised_edges(edges, view, state).enumerate() {
        offset[row] = edge.residual;
        columns.iter_mut().zip(edge.by_state).for_each(|(column, by)| column[row] = by);
    }
    write_prior(prior, state, edges.len(), &mut design, &mut offset);
    let fit = irls.fit(&design, &offset, edges.len())?;
    let step = SVector::from_column_slice(fit.parameters.as_slice());
    Some((step, fit.weights.iter().take(edges.len()).map(|weight| weight.sqrt()).collect()))
}

/// Writes a row for each number that has a prior, from the row `first` on.
fn write_prior(prior: &FramePrior, state: &State, first: usize, design: &mut DMatrix<f64>, offset: &mut DVector<f64>) {
    for (k, (off, root)) in prior.rows(state).into_iter().enumerate() {
        offset[first + k] = off;
        design[(first + k, 2 + k)] = root;
    }
}

/// The columns of a matrix that has so many.
fn columns<const COLUMNS: usize>(matrix: &mut DMatrix<f64>) -> [&mut [f64]; COLUMNS] {
    let rows = matrix.nrows().max(1);
    let mut columns = matrix.as_mut_slice().chunks_exact_mut(rows);
    std::array::from_fn(|_| columns.next().unwrap_or_default())
}

impl Linearised {
    /// Linearises the residuals of `edges` at a state, in closed form, and multiplies each by the root of its weight. After them comes a row
    /// for each number that has a prior, if there is one.
    pub fn new(
        edges: &Correspondences,
        view: &Projection,
        state: &State,
        roots: &[f64],
        prior: Option<&FramePrior>,
    ) -> Self {
        let rows = edges.len() + prior.map_or(0, |_| PRIORS);
        let mut linear = Self {
            residuals: DVector::zeros(rows),
            by_state: DMatrix::zeros(rows, STATE),
            by_pose: DMatrix::zeros(rows, 6),
        };
        let (mut by_state, by_pose) = (columns::<STATE>(&mut linear.by_state), columns::<6>(&mut linear.by_pose));
        for (row, (edge, root)) in linearised_edges(edges, view, state).zip(roots).enumerate() {
            linear.residuals[row] = edge.residual * root;
            by_state.iter_mut().zip(edge.by_state).for_each(|(column, by)| column[row] = by * root);
            let by_rotation = (edge.point.coords - view.camera_from_base.translation.vector).cross(&edge.by_point);
            for axis in 0..3 {
                by_pose[axis][row] = -by_rotation[axis] * root;
                by_pose[axis + 3][row] = -edge.by_point[axis] * root;
            }
        }
        if let Some(prior) = prior {
            write_prior(prior, state, edges.len(), &mut linear.by_state, &mut linear.residuals);
        }
        linear
    }
}

#[cfg(test)]
mod tests {
    use super::super::state::EdgeBias;
    use super::*;
    use crate::geometry::perturbed;
    use crate::measure::body::Outline;
    use crate::measure::fixture::Scene;
    use crate::robot::BendProfile;
    use nalgebra::{Vector2, Vector6};

    #[test]
    fn derivatives_by_state_and_pose_are_the_differences() {
        let mut scene = Scene::new(Vector3::new(0.1, -0.15, 0.05));
        scene.lens.distortion[0] = -0.1;
        let view = scene.view();
        let bias = EdgeBias { side_px: 0.1, tube_px: -0.2, rim_px: 0.05, glare: [0.3, 0.2] };
        let modes = [Vector2::new(0.05, -0.02), Vector2::new(-0.03, 0.01), Vector2::new(0.01, 0.02)];
        let profile = BendProfile { tip: Vector2::new(0.5, -0.7), modes };
        let state = State { profile, bias };
        let outline = Outline::spaced(&view, state.profile, 8.0);
        let displacements: Vec<f64> = (0..outline.points.len()).map(|k| 0.1 * (k as f64).sin()).collect();
        let edges = Correspondences::displaced(&outline, &displacements, 0.3);
        let linear = Linearised::new(&edges, &view, &state, &vec![1.0; edges.len()], None);
        assert!(edges.len() > 100, "{}", edges.len());

        const STEP: f64 = 1e-6;
        let differences = |ahead: Vec<f64>, behind: Vec<f64>| -> Vec<f64> {
            ahead.into_iter().zip(behind).map(|(ahead, behind)| (ahead - behind) / (2.0 * STEP)).collect()
        };
        let by_state = |k: usize| {
            let at = |step: f64| {
                let mut by = SVector::<f64, STATE>::zeros();
                by[k] = step;
                let moved = state.moved(&by);
                edges.residuals(&view, moved.profile, moved.bias)
            };
            differences(at(STEP), at(-STEP))
        };
        let by_pose = |k: usize| {
            let at = |step: f64| {
                let mut by = Vector6::zeros();
                by[k] = step;
                let moved = Projection { camera_from_base: perturbed(&view.camera_from_base, &by), ..view.clone() };
                edges.residuals(&moved, state.profile, state.bias)
            };
            differences(at(STEP), at(-STEP))
        };
        let check = |closed: &DMatrix<f64>, k: usize, differences: Vec<f64>| {
            let scale = closed.column(k).amax();
            for (row, difference) in differences.into_iter().enumerate() {
                let error = (closed[(row, k)] - difference).abs();
                assert!(error < 1e-5 * scale + 1e-8, "column {k}, row {row}: {} is {difference}", closed[(row, k)]);
            }
        };
        (0..STATE).for_each(|k| check(&linear.by_state, k, by_state(k)));
        (0..6).for_each(|k| check(&linear.by_pose, k, by_pose(k)));
        let residuals = edges.residuals(&view, state.profile, state.bias);
        assert!(linear.residuals.iter().zip(&residuals).all(|(a, b)| (a - b).abs() < 1e-9));
    }
}
