//! The edges' residuals linearised in bend, edge bias and camera pose, and the robust step that follows.

use super::correspondences::Correspondences;
use super::state::{FramePrior, PRIORS, STATE, State};
use super::uncertainty::{LEAST_SCALE, RobustPhase};
use crate::geometry::Pose;
use crate::measure::body::Projection;
use crate::robot::{Curve, PROFILE};
use crate::statistics::robust::Irls;
use nalgebra::{DMatrix, DVector, SVector, Vector3};

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

/// Residuals of edges in units of σ, and their derivatives (rows: edges).
#[derive(Debug, Clone)]
pub(crate) struct Linearised {
    pub residuals: DVector<f64>,
    /// By bend profile (rad) and edge biases (px): the components of [`State`].
    pub by_state: DMatrix<f64>,
    /// By the camera's pose (see [`perturbed`](crate::geometry::perturbed)).
    pub by_pose: DMatrix<f64>,
}

/// A section in the camera's frame, and how it moves with each number of the bend profile: translation (mm/rad) and rotation
/// (rad/rad).
struct MovingSection {
    camera_from_section: Pose,
    by_profile: [(Vector3<f64>, Vector3<f64>); PROFILE],
}

impl MovingSection {
    fn new(view: &Projection, curve: &Curve, s_mm: f64) -> Self {
        let twist = curve.section_jacobian(s_mm);
        let camera_from_base = view.camera_from_base.rotation.to_rotation_matrix();
        let in_camera = |row: usize, number: usize| camera_from_base * twist.fixed_view::<3, 1>(row, number);
        Self {
            camera_from_section: view.camera_from_base * curve.frame_at(s_mm),
            by_profile: std::array::from_fn(|number| (in_camera(0, number), in_camera(3, number))),
        }
    }
}

/// One edge's residual, in units of σ, and its derivatives.
struct LinearisedEdge {
    residual: f64,
    by_state: [f64; STATE],
    /// The border point in the camera's frame, mm, and the residual's derivative by it.
    point: Vector3<f64>,
    by_point: Vector3<f64>,
}

/// Linearises the residual of each edge at a state, in closed form.
fn linearised_edges(
    edges: &Correspondences,
    view: &Projection,
    state: &State,
) -> impl ExactSizeIterator<Item = LinearisedEdge> {
    let curve = view.curve(state.profile);
    let sections: Vec<MovingSection> =
        edges.sections_mm.iter().map(|&s_mm| MovingSection::new(view, &curve, s_mm)).collect();
    edges.all.iter().zip(&edges.section_of).map(move |(edge, &section)| {
        let MovingSection { camera_from_section, by_profile } = &sections[section];
        let arm = camera_from_section.rotation * edge.body.local;
        let point = camera_from_section.translation.vector + arm;
        let (expected, jacobian) = view.lens.project_with_jacobian(&point.into());
        // ∂(distance along the normal, in units of σ)/∂(point in the camera's frame, mm).
        let by_point = jacobian.transpose() * edge.normal / edge.sigma_px;
        let distance_px = edge.normal.dot(&(edge.seen - expected));
        let (bias_px, by_bias) = state.bias.at(edge.piece, edge.face);
        let by_turn = arm.cross(&by_point);
        let mut by_state = [0.0; STATE];
        for (by, (translation, rotation)) in by_state.iter_mut().zip(by_profile) {
            *by = -by_point.dot(translation) - by_turn.dot(rotation);
        }
        for (by, by_bias) in by_state[PROFILE..].iter_mut().zip(by_bias) {
            *by = -by_bias / edge.sigma_px;
        }
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
    for (row, edge) in linearised_edges(edges, view, state).enumerate() {
        offset[row] = edge.residual;
        (0..STATE).for_each(|k| design[(row, k)] = edge.by_state[k]);
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

impl Linearised {
    /// Linearises the residuals of `edges` at a state, in closed form.
    pub fn new(edges: &Correspondences, view: &Projection, state: &State) -> Self {
        let mut linear = Self {
            residuals: DVector::zeros(edges.len()),
            by_state: DMatrix::zeros(edges.len(), STATE),
            by_pose: DMatrix::zeros(edges.len(), 6),
        };
        for (row, edge) in linearised_edges(edges, view, state).enumerate() {
            linear.residuals[row] = edge.residual;
            (0..STATE).for_each(|k| linear.by_state[(row, k)] = edge.by_state[k]);
            let by_rotation = (edge.point - view.camera_from_base.translation.vector).cross(&edge.by_point);
            for axis in 0..3 {
                linear.by_pose[(row, axis)] = -by_rotation[axis];
                linear.by_pose[(row, axis + 3)] = -edge.by_point[axis];
            }
        }
        linear
    }

    /// With a row more for each number that has a prior.
    pub fn with_prior(self, prior: &FramePrior, state: &State) -> Self {
        let edges = self.residuals.len();
        let mut residuals = self.residuals.insert_rows(edges, PRIORS, 0.0);
        let mut by_state = self.by_state.insert_rows(edges, PRIORS, 0.0);
        write_prior(prior, state, edges, &mut by_state, &mut residuals);
        Self { residuals, by_state, by_pose: self.by_pose.insert_rows(edges, PRIORS, 0.0) }
    }

    /// With every row times the square root of its weight; rows beyond `roots` keep the weight 1.
    pub fn weighted(mut self, roots: &[f64]) -> Self {
        for (row, root) in roots.iter().enumerate() {
            self.residuals[row] *= root;
            self.by_state.row_mut(row).scale_mut(*root);
            self.by_pose.row_mut(row).scale_mut(*root);
        }
        self
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
        let linear = Linearised::new(&edges, &view, &state);
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
