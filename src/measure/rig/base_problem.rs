//! The least squares of the straight snake's placement and of its edges' biases.

use super::base_fit::STRAIGHT;
use super::parameters::RigOptions;
use super::placement::{HEIGHT, PLACEMENT, Placement, TILT};
use crate::camera::Lens;
use crate::measure::body::Projection;
use crate::measure::fit::{BIASES, Correspondences, EdgeBias, Linearised, STATE, State, noise_model};
use crate::measure::target::Grid;
use crate::robot::Robot;
use crate::statistics::least_squares::Problem;
use nalgebra::{DMatrix, DVector};

/// How far the standoff may be from what was stated, mm (1σ).
///
/// Convention: a ruler's precision.
pub const STANDOFF_SIGMA_MM: f64 = 0.1;
/// The least squares of placement and biases: a row for each edge, then what is known beforehand.
///
/// What is known beforehand counts against as many edges as err alike (the noise model's design effect): what displaces all rims together looks like a lean. The
/// standoff alone gives way, so that a scale that was stated wrongly shows in it.
pub struct BaseProblem<'a> {
    pub lens: &'a Lens,
    pub robot: &'a Robot,
    pub options: &'a RigOptions,
    pub grid: &'a Grid,
    pub edges: &'a Correspondences,
    /// Roots of the edges' weights.
    pub roots: &'a [f64],
    pub bias_sigma_px: f64,
    /// How far from parallel to the grid the snake may seem, rad (1σ).
    pub tilt_sigma: f64,
}

impl BaseProblem<'_> {
    /// What is known beforehand: of which number, its mean and its standard deviation.
    fn known(&self) -> [(usize, f64, f64); 2 + BIASES] {
        let noise = noise_model();
        let root = noise.design_effect.sqrt();
        let bias = |k: usize, mean: f64, sigma: f64| (PLACEMENT + k, mean, sigma / root);
        [
            (HEIGHT, 0.0, STANDOFF_SIGMA_MM),
            (TILT, 0.0, self.tilt_sigma / root),
            bias(0, 0.0, self.bias_sigma_px),
            bias(1, 0.0, self.bias_sigma_px),
            bias(2, 0.0, self.bias_sigma_px),
            bias(3, noise.glare, noise.glare_sd),
            bias(4, noise.glare, noise.glare_sd),
        ]
    }

    /// How the camera sees a base at this place.
    fn view(&self, placement: &Placement) -> Projection<'_> {
        Projection {
            lens: self.lens,
            camera_from_base: placement.camera_from_base(self.options, self.grid),
            robot: self.robot,
        }
    }

    /// Placement and biases of the parameters.
    pub fn at(x: &DVector<f64>) -> (Placement, EdgeBias) {
        (Placement(x.rows(0, PLACEMENT).into_owned()), EdgeBias::default().moved(&x.as_slice()[PLACEMENT..]))
    }
}

impl Problem for BaseProblem<'_> {
    type Evaluation = DVector<f64>;

    fn evaluate(&self, x: &DVector<f64>, _: Option<&DVector<f64>>) -> Option<DVector<f64>> {
        let (placement, bias) = Self::at(x);
        let of_edges = self.edges.residuals(&self.view(&placement), STRAIGHT, bias);
        let weighted = of_edges.iter().zip(self.roots).map(|(r, root)| r * root);
        let known = self.known().into_iter().map(|(number, mean, sigma)| (x[number] - mean) / sigma);
        Some(DVector::from_vec(weighted.chain(known).collect()))
    }

    fn residuals(&self, residuals: &DVector<f64>) -> DVector<f64> {
        residuals.clone()
    }

    fn jacobian(&self, x: &DVector<f64>, _: &DVector<f64>) -> DMatrix<f64> {
        let (placement, bias) = Self::at(x);
        let state = State { profile: STRAIGHT.into(), bias };
        let linear = Linearised::new(self.edges, &self.view(&placement), &state, self.roots, None);
        let edges = self.edges.len();
        let known = self.known();
        let mut jacobian = DMatrix::zeros(edges + known.len(), PLACEMENT + BIASES);
        let by_placement = linear.by_pose * placement.motions(self.options, self.grid);
        jacobian.view_mut((0, 0), (edges, PLACEMENT)).copy_from(&by_placement);
        let by_bias = linear.by_state.columns(STATE - BIASES, BIASES);
        jacobian.view_mut((0, PLACEMENT), (edges, BIASES)).copy_from(&by_bias);
        for (row, (number, _, sigma)) in known.into_iter().enumerate() {
            jacobian[(edges + row, number)] = 1.0 / sigma;
        }
        jacobian
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measure::body::Outline;
    use crate::measure::target::{PatternKind, Sheet};
    use crate::simulate::scene::Scene;
    use crate::statistics::least_squares::central_differences;
    use nalgebra::{Matrix3, Vector3};

    #[test]
    fn the_jacobian_is_that_of_differences() {
        let (lens, robot) = (Scene::default().lens, Robot::default());
        let options = RigOptions { grid_pitch_mm: 1.0, standoff_mm: 25.0, delta_offset: 0.3 };
        let pose = crate::geometry::Pose::new(Vector3::new(3.0, 8.0, 260.0), Vector3::new(0.05, -0.04, 0.1));
        let grid = Grid {
            kind: PatternKind::Lines,
            sheet: Sheet::flat(pose),
            turn_covariance: Matrix3::zeros(),
            rms_px: 0.1,
            waves_mm: 0.0,
        };
        let placement = Placement(DVector::from_column_slice(&[1.0, 6.0, 0.05, 0.1, 0.01]));
        let view =
            Projection { lens: &lens, camera_from_base: placement.camera_from_base(&options, &grid), robot: &robot };
        let outline = Outline::new(&view, STRAIGHT);
        let displacements_px: Vec<f64> = (0..outline.points.len()).map(|k| (k as f64).sin()).collect();
        let edges = Correspondences::displaced(&outline, &displacements_px, 0.2);
        assert!(edges.len() > 200);
        let roots: Vec<f64> = (0..edges.len()).map(|k| 0.5 + 0.5 * (k as f64).cos().abs()).collect();
        let problem = BaseProblem {
            lens: &lens,
            robot: &robot,
            options: &options,
            grid: &grid,
            edges: &edges,
            roots: &roots,
            bias_sigma_px: 0.3,
            tilt_sigma: 0.01,
        };
        let biases = [0.1, -0.2, 0.05, 0.3, 0.2];
        let x = DVector::from_iterator(PLACEMENT + BIASES, placement.0.iter().copied().chain(biases));
        let at = problem.evaluate(&x, None).unwrap();
        let exact = problem.jacobian(&x, &at);
        let residuals = |x: &DVector<f64>| problem.evaluate(x, None).unwrap();
        let differences = central_differences(residuals, &x, &DVector::from_element(x.len(), 1e-5));
        for column in 0..x.len() {
            let (exact, differences) = (exact.column(column), differences.column(column));
            assert!(
                (exact - differences).amax() < 1e-4 * exact.amax(),
                "{column}: {} {}",
                exact.amax(),
                differences.amax()
            );
        }
    }
}
