//! Statics: the elastic energy of the bent backbones and the forces that hold them, Eq. 9–11.
//!
//! Between base and end disk the backbones bend alike, through θ, each over its own length:
//!
//! ```text
//! E = E_p I_p θ² / (2 L) + Σ_i E_s I_s θ² / (2 L_i),      L_i = L + q_i = L + k_i·b,   k_i = row i of Q
//! ```
//!
//! All of it is a smooth function of the bend vector b, and so are ∇E and the Hessian H below:
//!
//! ```text
//! ∇E = (E_p I_p/L + Σ E_s I_s/L_i) b − Σ E_s I_s θ²/(2 L_i²) k_i
//! H  = (E_p I_p/L + Σ E_s I_s/L_i) I − Σ E_s I_s/L_i² (b k_iᵗ + k_i bᵗ) + Σ E_s I_s θ²/L_i³ k_i k_iᵗ
//! ```
//!
//! Eq. 9 with w_e the wrench applied on the snake by its environment: when ψ changes by dψ, the actuators' work τᵗdq and
//! the environment's w_eᵗdx together raise the elastic energy, so J_qψᵗ τ = ∇E − J_xψᵗ w_e. (The paper prints a plus,
//! which is right for the wrench that the snake applies.) In b the constraint is Qᵗτ = ∇_b E − J_xbᵗ w_e with a constant
//! Q, and Eq. 11's minimum-norm solution is τ = Q (QᵗQ)⁻¹ (…), which for backbones evenly spaced on a circle is 2/(n r²) Q (…). It
//! equals the paper's form wherever that one is defined, since a change of coordinates changes neither the constraint nor the norm.
//!
//! Effects may change the constants ([`Snake`]): backbones that are not evenly spaced on a circle, a load, a material that softens.

use super::kinematics::arc_functions;
use super::{PerBackbone, Robot};
use nalgebra::{Matrix2, Rotation2, Vector2, Vector3, Vector6};

/// Step of the central difference by which a load's share of the Hessian is taken, rad: the differences are good to the step's square.
///
/// Convention: numerical.
const LOAD_STEP_RAD: f64 = 1e-4;

/// The snake's constants, which effects may change.
#[derive(Debug, Clone)]
pub struct Snake {
    /// Distance r_i of each backbone from the middle, mm.
    pub radii_mm: PerBackbone,
    /// Unit vectors in {b} from the middle to each backbone.
    pub directions: PerBackbone<Vector2<f64>>,
    /// b_0, the bend at which the snake rests, rad.
    pub rest_bend: Vector2<f64>,
    /// k in ∇E (1 − k θ²), 1/rad².
    pub softening_per_rad2: f64,
    /// (a, b) of an energy K/3 (a (x³ − 3 x y²) + b (3 x² y − y³)) besides, with the stiffness K of the straight snake, 1/rad.
    pub threefold_per_rad: Vector2<f64>,
    /// A load that is spread evenly along the snake, N in all, in {b}.
    pub weight_n: Option<Vector3<f64>>,
    /// Force (N) at the centre of the end disk's far face, then moment (N·mm), that the environment applies on it, in {b}.
    pub wrench: Option<Vector6<f64>>,
}

impl Snake {
    /// A robot's snake as it was built, without a load.
    pub fn of(robot: &Robot) -> Self {
        Self {
            radii_mm: PerBackbone::repeat(robot.backbone_count(), robot.backbone_circle_radius_mm),
            directions: robot.backbone_directions(),
            rest_bend: Vector2::zeros(),
            softening_per_rad2: 0.0,
            threefold_per_rad: Vector2::zeros(),
            weight_n: None,
            wrench: None,
        }
    }

    /// Q, mm per rad: q = Q b; row i is −r_i d_i.
    pub fn q_by_bend(&self) -> PerBackbone<Vector2<f64>> {
        self.directions.zip_map(&self.radii_mm, |direction, radius_mm| direction * -radius_mm)
    }

    /// Turns the backbones about the middle by these angles, rad.
    pub fn turn_backbones(&mut self, angles: &PerBackbone) {
        self.directions = self.directions.zip_map(angles, |direction, angle| Rotation2::new(angle) * direction);
    }

    /// Adds a force (N) and a moment (N·mm) on the end disk, in {b}.
    pub fn add_wrench(&mut self, wrench: Vector6<f64>) {
        self.wrench = Some(self.wrench.unwrap_or_default() + wrench);
    }
}

/// Eq. 1 and 9–11 of one snake.
#[derive(Debug, Clone)]
pub struct Statics<'a> {
    robot: &'a Robot,
    snake: Snake,
    /// E_p I_p / L, N·mm.
    primary_n_mm: f64,
    /// E_s I_s, N·mm².
    secondary_n_mm2: f64,
    /// Q.
    q_by_bend: PerBackbone<Vector2<f64>>,
    /// Q (QᵗQ)⁻¹, 1/mm: from the generalised force on b to τ of least norm.
    forces_by_generalised: PerBackbone<Vector2<f64>>,
}

impl<'a> Statics<'a> {
    /// The statics of a robot whose snake has these constants.
    pub fn new(robot: &'a Robot, snake: Snake) -> Self {
        let q_by_bend = snake.q_by_bend();
        // Singular only where all backbones lie in one plane, which no robot's do: then there are no forces to speak of.
        let inverse_gram = q_by_bend.cross_gram(&q_by_bend).try_inverse().unwrap_or_else(Matrix2::zeros);
        Self {
            robot,
            primary_n_mm: robot.primary.bending_stiffness_n_mm2() / robot.length_mm,
            secondary_n_mm2: robot.secondary.bending_stiffness_n_mm2(),
            q_by_bend,
            forces_by_generalised: q_by_bend * inverse_gram,
            snake,
        }
    }

    /// The robot.
    pub fn robot(&self) -> &'a Robot {
        self.robot
    }

    /// The snake's constants.
    pub fn snake(&self) -> &Snake {
        &self.snake
    }

    /// Q, mm per rad.
    pub fn q_by_bend(&self) -> &PerBackbone<Vector2<f64>> {
        &self.q_by_bend
    }

    /// Eq. 1: q at a bend vector, mm; 0 where the snake rests.
    pub fn q_mm(&self, bend: Vector2<f64>) -> PerBackbone {
        self.q_by_bend * self.from_rest(bend)
    }

    /// A bend vector counted from where the snake rests, rad.
    pub fn from_rest(&self, bend: Vector2<f64>) -> Vector2<f64> {
        bend - self.snake.rest_bend
    }

    /// E at a bend vector, N·mm: the bending energy of all backbones, without softening, which is defined by its gradient.
    pub fn energy(&self, bend: Vector2<f64>) -> f64 {
        let lengths = self.q_mm(bend).add_scalar(self.robot.length_mm);
        let secondary = lengths.map(|length| self.secondary_n_mm2 / length).sum();
        0.5 * self.from_rest(bend).norm_squared() * (self.primary_n_mm + secondary)
    }

    /// ∇E, N·mm per rad, without softening and load.
    fn elastic_gradient(&self, bend: Vector2<f64>) -> Vector2<f64> {
        let squared = bend.norm_squared();
        let mut gradient = bend * self.primary_n_mm;
        for row in &self.q_by_bend {
            let length = self.robot.length_mm + row.dot(&bend);
            let per_length = self.secondary_n_mm2 / length;
            gradient += bend * per_length - row * (0.5 * per_length * squared / length);
        }
        gradient
    }

    /// The Hessian of E, N·mm per rad², without softening and load.
    fn elastic_hessian(&self, bend: Vector2<f64>) -> Matrix2<f64> {
        let mut hessian = Matrix2::identity() * self.primary_n_mm;
        for row in &self.q_by_bend {
            let length = self.robot.length_mm + row.dot(&bend);
            let per_length = self.secondary_n_mm2 / length;
            let mixed = bend * row.transpose();
            hessian += Matrix2::identity() * per_length - (mixed + mixed.transpose()) * (per_length / length)
                + row * row.transpose() * (per_length * bend.norm_squared() / length.powi(2));
        }
        hessian
    }

    /// The right-hand side of Eq. 9 in b, N·mm per rad: the generalised force that the backbones must exert, Qᵗτ.
    pub fn generalised_force(&self, bend: Vector2<f64>) -> Vector2<f64> {
        let own = self.from_rest(bend);
        let elastic = self.elastic_gradient(own) * (1.0 - self.snake.softening_per_rad2 * own.norm_squared());
        elastic + self.threefold_gradient(own) - self.load(bend)
    }

    /// The gradient of the threefold energy, N·mm per rad.
    fn threefold_gradient(&self, own: Vector2<f64>) -> Vector2<f64> {
        let (squares, product) = (own.x.powi(2) - own.y.powi(2), 2.0 * own.x * own.y);
        let [a, b] = self.snake.threefold_per_rad.into();
        Vector2::new(a * squares + b * product, b * squares - a * product) * self.straight_stiffness()
    }

    /// K, the bending stiffness of the straight snake, N·mm per rad.
    fn straight_stiffness(&self) -> f64 {
        self.primary_n_mm + self.q_by_bend.len() as f64 * self.secondary_n_mm2 / self.robot.length_mm
    }

    /// Its derivative by the bend vector, N·mm per rad².
    pub fn generalised_force_by_bend(&self, bend: Vector2<f64>) -> Matrix2<f64> {
        let softening = self.snake.softening_per_rad2;
        let own = self.from_rest(bend);
        let mut slope = self.elastic_hessian(own);
        if softening != 0.0 {
            slope *= 1.0 - softening * own.norm_squared();
            slope -= self.elastic_gradient(own) * own.transpose() * (2.0 * softening);
        }
        let [a, b] = (self.snake.threefold_per_rad * (2.0 * self.straight_stiffness())).into();
        let (along, across) = (a * own.x + b * own.y, b * own.x - a * own.y);
        slope += Matrix2::new(along, across, across, -along);
        if self.snake.wrench.is_some() || self.snake.weight_n.is_some() {
            slope -= Matrix2::from_columns(&[0, 1].map(|axis| {
                let step = Vector2::ith(axis, LOAD_STEP_RAD);
                (self.load(bend + step) - self.load(bend - step)) / (2.0 * LOAD_STEP_RAD)
            }));
        }
        slope
    }

    /// J_xbᵗ w_e of the wrench at the tip, and ∫ J_xbᵗ w ds of the load along the snake, N·mm per rad.
    fn load(&self, bend: Vector2<f64>) -> Vector2<f64> {
        let by_tip = |wrench: Vector6<f64>| self.robot.tip_jacobian_bend(bend).tr_mul(&wrench);
        let of_tip = self.snake.wrench.map_or_else(Vector2::zeros, by_tip);
        let Some(weight) = self.snake.weight_n else { return of_tip };
        // The middle of an arc is at L (f b, g), and the load works on it.
        let [_, versine_slope, _, turn, turn_slope] = arc_functions(bend.norm());
        let along = weight.xy().dot(&bend) * turn_slope + weight.z * versine_slope;
        of_tip + (weight.xy() * turn + bend * along) * self.robot.length_mm
    }

    /// Eq. 11: the forces τ (N, positive towards +q_i) of least norm that hold the snake at a bend vector.
    pub fn forces_n(&self, bend: Vector2<f64>) -> PerBackbone {
        self.forces_by_generalised * self.generalised_force(bend)
    }

    /// ∂τ/∂b, N per rad.
    pub fn forces_by_bend(&self, bend: Vector2<f64>) -> PerBackbone<Vector2<f64>> {
        self.forces_by_generalised * self.generalised_force_by_bend(bend)
    }
}

impl Robot {
    /// E, N·mm: the bending energy of all backbones at a bend vector (rad).
    pub fn elastic_energy(&self, bend: Vector2<f64>) -> f64 {
        Statics::new(self, Snake::of(self)).energy(bend)
    }

    /// Eq. 9–11: the forces τ (N, positive towards +q_i) of least norm that hold the snake at a bend vector.
    ///
    /// `wrench` is what the environment applies on the end disk: force (N) at the centre of its far face, then moment
    /// (N·mm), both in {b}.
    pub fn actuation_forces(&self, bend: Vector2<f64>, wrench: Option<&Vector6<f64>>) -> PerBackbone {
        Statics::new(self, Snake { wrench: wrench.copied(), ..Snake::of(self) }).forces_n(bend)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Configuration;
    use crate::robot::{Mechanics, Model};
    use approx::assert_relative_eq;
    use nalgebra::Vector3;
    use proptest::prelude::*;
    use std::f64::consts::PI;

    fn any_bend() -> impl Strategy<Value = Vector2<f64>> {
        (prop_oneof![Just(0.0), 0.0..1e-3f64, 0.0..2.1f64], -PI..PI)
            .prop_map(|(theta, delta)| Configuration::new(theta, delta).bend_vector())
    }

    proptest! {
        #[test]
        fn gradient_and_hessian_are_the_derivatives_of_the_energy(bend in any_bend(), backbones in 3..9u8) {
            let robot = Robot { backbones, ..Robot::default() };
            let statics = Statics::new(&robot, Snake::of(&robot));
            let h = 1e-4;
            for axis in 0..2 {
                let step = Vector2::ith(axis, h);
                let slope = (statics.energy(bend + step) - statics.energy(bend - step)) / (2.0 * h);
                prop_assert!((slope - statics.generalised_force(bend)[axis]).abs() < 1e-5);
                let bow = (statics.generalised_force(bend + step) - statics.generalised_force(bend - step)) / (2.0 * h);
                prop_assert!((bow - statics.generalised_force_by_bend(bend).column(axis)).norm() < 1e-5);
            }
        }

        #[test]
        fn the_forces_balance_the_work_and_none_smaller_do(
            bend in any_bend(), load in proptest::array::uniform6(-2.0..2.0f64), common in -5.0..5.0f64, backbones in 3..9u8
        ) {
            let robot = Robot { backbones, ..Robot::default() };
            let wrench = Vector6::from(load);
            let tau = robot.actuation_forces(bend, Some(&wrench));
            let work = robot.displacement_by_bend().tr_mul(&tau);
            let elastic = Statics::new(&robot, Snake::of(&robot)).generalised_force(bend);
            let needed = elastic - robot.tip_jacobian_bend(bend).transpose() * wrench;
            prop_assert!((work - needed).norm() < 1e-9);
            // The only freedom left is in forces that do no work; any of them makes τ longer.
            for part in robot.internal_parts() {
                prop_assert!((tau + part * common).norm() + 1e-12 >= tau.norm());
            }
        }

        #[test]
        fn equation_11_in_theta_and_delta_gives_the_same_forces(bend in any_bend()) {
            prop_assume!(bend.norm() > 1e-2);
            let robot = Robot::default();
            let psi = Configuration::from_bend_vector(bend);
            let jacobian = robot.jacobian_q_psi(psi);
            let gradient = crate::robot::kinematics::bend_by_configuration(psi).transpose()
                * Statics::new(&robot, Snake::of(&robot)).generalised_force(bend);
            let printed = jacobian * (jacobian.cross_gram(&jacobian).try_inverse().unwrap() * gradient);
            prop_assert!((printed - robot.actuation_forces(bend, None)).norm() < 1e-8);
        }
    }

    #[test]
    fn bending_in_a_plane_of_symmetry_needs_the_textbook_moment() {
        // To first order in θ all four tubes are beams of length L: the moment is 4 E I θ / L, and τ = −M/(1.5 r)(1, −½, −½).
        let robot = Robot::default();
        let theta = 1e-6;
        let moment = 4.0 * 54_000.0 * PI / 64.0 * (0.66f64.powi(4) - 0.5f64.powi(4)) * theta / 26.0;
        let tau = robot.actuation_forces(Vector2::new(theta, 0.0), None);
        let expected = PerBackbone::from([-1.0, 0.5, 0.5]) * (moment / 2.25);
        assert!((tau - expected).norm() < 1e-6 * expected.norm());
    }

    #[test]
    fn the_moment_and_the_forces_of_four_five_and_six_backbones_are_the_textbooks() {
        // n + 1 beams of length L: M = (n + 1) E I θ/L, held by τ_i = −2 M/(n r) cos(δ − a_i) with Σ τ_i q_i its work through θ.
        for n in [4u8, 5, 6] {
            let robot = Robot { backbones: n, ..Robot::default() };
            let (theta, delta, count) = (1e-6, 0.7, f64::from(n));
            let bend = Configuration::new(theta, delta).bend_vector();
            let stiffness = 54_000.0 * PI / 64.0 * (0.66f64.powi(4) - 0.5f64.powi(4));
            let moment = (count + 1.0) * stiffness * theta / 26.0;
            let tau = robot.actuation_forces(bend, None);
            let azimuth = |i: usize| -2.0 * PI * i as f64 / count;
            let expected =
                PerBackbone::from_fn(usize::from(n), |i| -2.0 * moment / (count * 1.5) * (delta - azimuth(i)).cos());
            assert!((tau - expected).norm() < 1e-6 * expected.norm(), "{n}: {tau:?} {expected:?}");
            let q = robot.displacement_by_bend() * bend;
            assert_relative_eq!(tau.dot(&q), moment * theta, max_relative = 1e-6);
            assert!(q.sum().abs() < 1e-20);
            assert_relative_eq!(q.norm_squared(), count / 2.0 * (1.5 * theta).powi(2), max_relative = 1e-9);
        }
    }

    #[test]
    fn a_wrench_that_pushes_the_tip_along_the_bend_relieves_the_actuators() {
        let robot = Robot::default();
        let bend = Vector2::new(0.5, 0.0);
        let push = Vector6::new(0.2, 0.0, 0.0, 0.0, 0.0, 0.0);
        assert!(robot.actuation_forces(bend, Some(&push)).norm() < robot.actuation_forces(bend, None).norm());
    }

    #[test]
    fn the_loaded_snake_rests_where_energy_is_least() {
        // With the actuators' forces held, total energy E − τᵗq − f·x has its minimum at the bend they were computed for.
        let robot = Robot::default();
        let bend = Vector2::new(0.4, 0.3);
        let force = Vector3::new(0.1, -0.2, 0.3);
        let tau = robot.actuation_forces(bend, Some(&Vector6::new(force.x, force.y, force.z, 0.0, 0.0, 0.0)));
        let total = |b: Vector2<f64>| {
            let tip = robot.frame_at(Configuration::from_bend_vector(b), robot.length_mm).translation.vector;
            robot.elastic_energy(b) - tau.dot(&(robot.displacement_by_bend() * b)) - force.dot(&tip)
        };
        let h = 1e-4;
        for axis in 0..2 {
            let step = Vector2::ith(axis, h);
            assert!((total(bend + step) - total(bend - step)).abs() / (2.0 * h) < 1e-5);
            assert!(total(bend + step * 100.0) > total(bend));
        }
    }

    #[test]
    fn what_bends_nothing_is_spanned_by_the_internal_parts() {
        for backbones in 3..=8 {
            let robot = Robot { backbones, ..Robot::default() };
            let parts: Vec<_> = robot.internal_parts().collect();
            assert_eq!(parts.len(), usize::from(backbones) - 2);
            for (a, part) in parts.iter().enumerate() {
                assert!(robot.bend_by_displacement().tr_mul(part).norm() < 1e-12);
                for (b, other) in parts.iter().enumerate() {
                    assert_relative_eq!(part.dot(other), if a == b { 1.0 } else { 0.0 }, epsilon = 1e-12);
                }
            }
            assert!((parts[0] - parts[0].map(|_| parts[0].mean())).norm() < 1e-12, "the first is the common part");
            let any = PerBackbone::from_fn(parts[0].len(), |i| (1.7 * i as f64).sin());
            let sum = parts.iter().fold(any * 0.0, |sum, part| sum + *part * part.dot(&any));
            let model = Model { robot, ..Model::default() };
            let mechanics = Mechanics::new(&model);
            assert!((sum - mechanics.internal_part(&any)).norm() < 1e-12);
            assert!((mechanics.internal_part(&sum) - sum).norm() < 1e-12);
        }
    }
}
