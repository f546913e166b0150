//! Redundancy: what to do with the forces that do no work on the snake.
//!
//! n backbones bend two ways, so forces may differ from Eq. 11's by any f with Qᵗf = 0, of which there are n − 2: a force common to
//! all, which the base takes up through the central backbone, and with more than three backbones n − 3 ways to press against each
//! other. Eq. 11 is f = 0, and with it the strain in the lines is least: Σ (η τ_i + f_i)² = Σ (η τ_i)² + Σ f_i², since τ lies in the
//! span of Q.
//!
//! Limits of the actuation unit change that. With τ̃_i = (η τ_i + f_i + f_s) e^{2μφ} (Eq. 13) the least strain within them is
//!
//! ```text
//! min ½ Σ f_i²   subject to   Qᵗf = 0   and   least ≤ τ̃_i ≤ most  for every i
//! ```
//!
//! a quadratic program whose solution is f_i = Q_i·ν clamped to what the limits leave of it, ν being the two multipliers of Qᵗf = 0
//! (stationarity; the limits' own multipliers have the right sign by the clamp). Qᵗf grows with ν, so that ν is found by bisection in
//! one component within bisection in the other.
//!
//! Where the limits leave nothing they are widened alike until they do, so that none is missed by more than must be, and the pose
//! counts as outside them. Which widening that is the facets of the set of all Qᵗf tell: it is the sum of n segments in the plane,
//! and their directions bound it.
//!
//! A force f_i stretches its line by κf_i, which is added to q̃_i: the choice shows in the table and in the bend not at all.

use super::{Mechanics, Model, PerBackbone, Response};
use crate::error::{ArgumentError, Error, Result};
use crate::geometry::Configuration;
use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

/// A force counts as within limits that it misses by less than this, N.
///
/// Convention: numerical.
const LIMIT_TOLERANCE_N: f64 = 1e-9;
/// The multipliers ν are sought within so many times the largest limit of f: with the directions of three to eight backbones they lie
/// there.
///
/// Convention: the bracket of a bisection.
const FARTHEST_MULTIPLIER: f64 = 16.0;
/// Halvings of a bisection.
///
/// Convention: as many as resolve a double.
const BISECTIONS: usize = 60;

/// What the actuation unit can do: forces τ̃, N, positive where they push.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "(f64, f64)", into = "(f64, f64)")]
pub struct ForceLimits {
    least_n: f64,
    most_n: f64,
}

impl ForceLimits {
    /// Limits of τ̃, N; the pull is negative.
    ///
    /// # Errors
    /// [`ArgumentError::ForceLimits`] where they are not finite or not in order.
    pub fn new(least_n: f64, most_n: f64) -> Result<Self> {
        if !(least_n.is_finite() && most_n.is_finite() && least_n < most_n) {
            return Err(ArgumentError::ForceLimits { pull_n: least_n, push_n: most_n }.into());
        }
        Ok(Self { least_n, most_n })
    }

    /// The pull, which is negative, and the push, N.
    pub fn ends_n(&self) -> (f64, f64) {
        (self.least_n, self.most_n)
    }

    fn contain(&self, force_n: f64) -> bool {
        (self.least_n - LIMIT_TOLERANCE_N..=self.most_n + LIMIT_TOLERANCE_N).contains(&force_n)
    }
}

impl TryFrom<(f64, f64)> for ForceLimits {
    type Error = Error;

    fn try_from((least_n, most_n): (f64, f64)) -> Result<Self> {
        Self::new(least_n, most_n)
    }
}

impl From<ForceLimits> for (f64, f64) {
    fn from(limits: ForceLimits) -> Self {
        limits.ends_n()
    }
}

/// How the backbones share the load at one pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sharing {
    /// The mean of f, N; positive pushes. With three backbones it is the f of each.
    pub common_n: f64,
    /// τ̃: what the actuation unit must exert on each, N.
    pub actuation_n: PerBackbone,
    /// κf: what it adds to q̃, mm.
    pub shift_mm: PerBackbone,
    /// Whether every τ̃_i lies within the limits.
    pub within: bool,
}

impl Model {
    /// The forces of least strain within limits that hold the snake at a pose.
    pub fn sharing(&self, psi: Configuration, limits: &ForceLimits) -> Sharing {
        let tau_n = Mechanics::new(self).forces_n(psi.bend_vector()) * self.parameters().x;
        let capstan = self.friction.capstan_factor(self.robot.line.cone_bend_angle());
        let static_n = self.friction.static_force_n;
        let actuation = |added: PerBackbone| (tau_n + added).add_scalar(static_n) * capstan;
        let room = Room {
            directions: self.robot.backbone_directions(),
            least: (-tau_n).add_scalar(limits.least_n / capstan - static_n),
            most: (-tau_n).add_scalar(limits.most_n / capstan - static_n),
        };
        let added_n = room.least_forces();
        let actuation_n = actuation(added_n);
        Sharing {
            common_n: added_n.mean(),
            actuation_n,
            shift_mm: added_n * self.line_compliance_mm_per_n(),
            within: actuation_n.iter().all(|&force| limits.contain(force)),
        }
    }
}

impl Model {
    /// q̃ as it would be without the force that the backbones share within limits, mm: as it is commanded by a table that was made for these
    /// limits. The shared force bends nothing, so that the bend that q̃ leads to tells it. q̃ itself where the model has no answer for it.
    pub fn without_sharing(&self, q_tilde: &PerBackbone, limits: &ForceLimits) -> PerBackbone {
        let shift = |solution: Response| self.sharing(solution.configuration, limits).shift_mm;
        self.forward(q_tilde).map_or(*q_tilde, |solution| *q_tilde - shift(solution))
    }
}

/// What the limits leave of f, N.
struct Room {
    /// The backbones' directions: Q but for its scale.
    directions: PerBackbone<Vector2<f64>>,
    least: PerBackbone,
    most: PerBackbone,
}

impl Room {
    /// The smallest f that bends nothing, within the room or else within the least that must be added to it on all sides.
    fn least_forces(mut self) -> PerBackbone {
        let missing = self.missing();
        self.least = self.least.add_scalar(-missing);
        self.most = self.most.add_scalar(missing);
        let far = FARTHEST_MULTIPLIER * self.least.amax().max(self.most.amax());
        let y_of = |x| bisected(far, |y| self.bending(Vector2::new(x, y)).y);
        let x = bisected(far, |x| self.bending(Vector2::new(x, y_of(x))).x);
        self.forces(Vector2::new(x, y_of(x)))
    }

    /// By how much the room must grow on all sides for an f that bends nothing, N.
    fn missing(&self) -> f64 {
        let outwards = self.directions.iter().flat_map(|side| {
            let across = Vector2::new(-side.y, side.x);
            [across, -across]
        });
        let missing = outwards.map(|outwards| {
            let along = self.directions.map(|direction| direction.dot(&outwards));
            let (least, most) = (along.component_mul(&self.least), along.component_mul(&self.most));
            -least.zip_map(&most, f64::max).sum() / along.map(f64::abs).sum()
        });
        missing.fold(0.0, f64::max)
    }

    /// f for given multipliers.
    fn forces(&self, nu: Vector2<f64>) -> PerBackbone {
        let free = self.directions.map(|direction| direction.dot(&nu));
        // Not `clamp`, which panics where rounding has crossed two limits that are as good as one.
        free.zip_map(&self.least, f64::max).zip_map(&self.most, f64::min)
    }

    /// Qᵗf but for its scale; it grows with the multipliers.
    fn bending(&self, nu: Vector2<f64>) -> Vector2<f64> {
        self.directions.tr_mul(&self.forces(nu))
    }
}

/// Where a function that does not fall crosses zero between −far and far; the end that is nearer to it where it does not.
fn bisected(far: f64, grows: impl Fn(f64) -> f64) -> f64 {
    let (mut low, mut high) = (-far, far);
    for _ in 0..BISECTIONS {
        let middle = 0.5 * (low + high);
        match grows(middle) {
            value if value < 0.0 => low = middle,
            value if value > 0.0 => high = middle,
            _ => return middle,
        }
    }
    0.5 * (low + high)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Estimate;
    use proptest::prelude::*;

    fn paper() -> Model {
        Model { eta: 1.221, lambda_mm: 0.1765, samples: Some(10), ..Model::default() }
    }

    #[test]
    fn with_three_backbones_the_common_force_is_the_one_nearest_to_zero_within_the_limits() {
        // τ̃_i within the limits leaves an interval of common forces; if that is empty, its middle misses the limits least.
        let model = paper();
        let capstan = model.friction.capstan_factor(41f64.to_radians());
        let [mut inside, mut bound, mut outside] = [0; 3];
        for theta_deg in (0..=90).step_by(10) {
            for delta_deg in (-180..180).step_by(25) {
                let psi = Configuration::from_degrees(f64::from(theta_deg), f64::from(delta_deg));
                let tau = model.robot.actuation_forces(psi.bend_vector(), None) * 1.221;
                for (pull, push) in [(-80.0, 80.0), (-80.0, 12.0), (-25.0, 25.0), (-10.0, 60.0), (-8.0, 8.0)] {
                    let sharing = model.sharing(psi, &ForceLimits::new(pull, push).unwrap());
                    let room = |limit: f64| (-tau).add_scalar(limit / capstan - model.friction.static_force_n);
                    let (least, most) = (room(pull).max(), room(push).min());
                    let expected = if least <= most { 0f64.clamp(least, most) } else { 0.5 * (least + most) };
                    assert!((sharing.common_n - expected).abs() < 1e-9, "{psi:?}: {sharing:?}, expected {expected} N");
                    assert_eq!(sharing.within, least <= most + 1e-9, "{psi:?}: {least} to {most} N");
                    let actuation = (tau.add_scalar(expected + model.friction.static_force_n)) * capstan;
                    assert!((sharing.actuation_n - actuation).norm() < 1e-8);
                    *(if least > most {
                        &mut outside
                    } else if expected == 0.0 {
                        &mut inside
                    } else {
                        &mut bound
                    }) += 1;
                }
            }
        }
        assert!(inside > 50 && bound > 50 && outside > 50, "{inside} {bound} {outside}");
    }

    #[test]
    fn the_common_force_bends_nothing_and_is_what_the_forward_problem_finds() {
        let model = paper();
        let psi = Configuration::from_degrees(60.0, 35.0);
        let sharing = model.sharing(psi, &ForceLimits::new(-80.0, 12.0).unwrap());
        assert!(sharing.within && sharing.common_n < -5.0, "{sharing:?}");
        assert!((sharing.actuation_n.max() - 12.0).abs() < 1e-9);
        let back = model.forward(&(model.command(psi) + sharing.shift_mm)).unwrap();
        assert!((back.configuration.theta - psi.theta).abs() < 1e-9);
        assert!((back.internal_force_n - sharing.common_n).abs() < 1e-9);
    }

    #[test]
    fn lambda_is_found_behind_force_limits_once_the_estimator_knows_them() {
        use crate::estimate::{Options, estimate};
        use crate::simulate::{BendingExperiment, Plant, SimulatedEye};
        let limits = ForceLimits::new(-60.0, 15.0).unwrap();
        let plant = Plant { model: paper(), sd_encoder_mm: 0.0015 };
        let samples = plant.run(&BendingExperiment::default().waypoints().unwrap(), 4);
        let measurements = SimulatedEye::default().observe(&samples, 5);
        let shifted = samples.iter().map(|sample| {
            let shift = paper().sharing(sample.truth.configuration, &limits).shift_mm;
            crate::observation::EncoderReading { q_mm: sample.reading.q_mm + shift, ..sample.reading }
        });
        let readings: Vec<_> = shifted.collect();
        let learned =
            |readings: &[_]| estimate(&Model::default(), Options::default(), &measurements, readings).unwrap().1;
        let first = learned(&readings);
        let known = readings.iter().map(|reading| crate::observation::EncoderReading {
            q_mm: first.without_sharing(&reading.q_mm, &limits),
            ..*reading
        });
        let [before, after] = [first.estimate(), learned(&known.collect::<Vec<_>>()).estimate()].map(Option::unwrap);
        let off = |estimate: &Estimate| (estimate.lambda_mm - 0.1765).abs() / estimate.sd_lambda_mm();
        assert!((before.lambda_mm - 0.1765).abs() > 0.1, "{before:?}");
        assert!(off(&after) < 2.0 && after.sd_lambda_mm() < 0.01, "{after:?}");
        assert!((after.eta - 1.221).abs() < 3.0 * after.sd_eta(), "{after:?}");
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn with_four_backbones_no_sharing_strains_less(
            theta_deg in 0.0..90.0f64, delta_deg in -180.0..180.0f64, pull in -40.0..-2.0f64, push in 2.0..40.0f64
        ) {
            let mut model = paper();
            model.robot.backbones = 4;
            let psi = Configuration::from_degrees(theta_deg, delta_deg);
            let sharing = model.sharing(psi, &ForceLimits::new(pull, push).unwrap());
            let tau = model.robot.actuation_forces(psi.bend_vector(), None) * 1.221;
            let capstan = model.friction.capstan_factor(41f64.to_radians());
            let actuation = |f: PerBackbone| (tau + f).add_scalar(model.friction.static_force_n) * capstan;
            let missed = |f| actuation(f).iter().map(|force| (pull - force).max(force - push)).fold(0.0, f64::max);
            // By trying: all that four backbones can share is N common to them and M by which they press pairwise.
            let steps = || (-200..=200).map(|k| f64::from(k) * 0.3);
            let tried = steps().flat_map(|n| steps().map(move |m| PerBackbone::from([n + m, n - m, n + m, n - m])));
            let least_missed = tried.clone().map(missed).fold(f64::MAX, f64::min);
            let ours = sharing.shift_mm / model.line_compliance_mm_per_n();
            prop_assert!((sharing.actuation_n - actuation(ours)).norm() < 1e-9);
            prop_assert!((ours[0] - ours[2]).abs() < 1e-8 && (ours[1] - ours[3]).abs() < 1e-8, "bends: {ours:?}");
            prop_assert!(missed(ours) <= least_missed + 1e-8, "{} {least_missed}", missed(ours));
            prop_assert_eq!(sharing.within, missed(ours) < 1e-8);
            let best = tried.filter(|&f| missed(f) == 0.0).map(|f| f.norm()).fold(f64::MAX, f64::min);
            prop_assert!(ours.norm() <= best + 1e-8);
            // The grid has a point within half a step of the solution in N and in M.
            prop_assert!(!sharing.within || least_missed < 0.31 * capstan);
        }

        #[test]
        fn the_sharing_of_any_backbones_is_optimal(
            backbones in 3..9u8, theta_deg in 0.0..90.0f64, delta_deg in -180.0..180.0f64, pull in -40.0..-2.0f64,
            push in 2.0..40.0f64, other in proptest::array::uniform8(-40.0..40.0f64)
        ) {
            let mut model = paper();
            model.robot.backbones = backbones;
            let psi = Configuration::from_degrees(theta_deg, delta_deg);
            let limits = ForceLimits::new(pull, push).unwrap();
            let sharing = model.sharing(psi, &limits);
            let ours = sharing.shift_mm / model.line_compliance_mm_per_n();
            let directions = model.robot.backbone_directions();
            prop_assert!(directions.tr_mul(&ours).norm() < 1e-8);
            let back = model.forward(&(model.command(psi) + sharing.shift_mm)).unwrap();
            prop_assert!((back.configuration.bend_vector() - psi.bend_vector()).norm() < 1e-9);
            // Whatever else bends nothing: from f towards it strain grows, or a limit is passed at once.
            let other = PerBackbone::from_fn(usize::from(backbones), |i| other[i]);
            let other = other - directions * (directions.tr_mul(&other) * (2.0 / f64::from(backbones)));
            let capstan = model.friction.capstan_factor(41f64.to_radians());
            for size in [1e-3, 1e-2, 1e-1, 1.0] {
                let near = ours + (other - ours) * size;
                let actuation = sharing.actuation_n + (near - ours) * capstan;
                let missed = |forces: &PerBackbone| forces.iter().map(|f| (pull - f).max(f - push)).fold(0.0, f64::max);
                if sharing.within {
                    prop_assert!(missed(&actuation) > 1e-9 || near.norm() >= ours.norm() - 1e-8);
                } else {
                    prop_assert!(missed(&actuation) >= missed(&sharing.actuation_n) - 1e-8);
                }
            }
        }
    }

    #[test]
    fn backbones_that_need_no_relief_are_left_alone() {
        let mut model = paper();
        model.robot.backbones = 4;
        let psi = Configuration::from_degrees(60.0, 0.0);
        let free = model.sharing(psi, &ForceLimits::new(-500.0, 500.0).unwrap());
        assert!(free.within && free.common_n == 0.0);
        // Backbones 1 and 3 lie in the plane of the bend and carry it; 2 and 4 carry nothing.
        let limits = ForceLimits::new(free.actuation_n.min() - 5.0, free.actuation_n.max() - 1.0).unwrap();
        let sharing = model.sharing(psi, &limits);
        let relief = (sharing.actuation_n - free.actuation_n).map(|n| (n * 1e9).round() / 1e9 + 0.0);
        assert_eq!((sharing.within, relief), (true, PerBackbone::from([-1.0, 0.0, -1.0, 0.0])));
    }

    #[test]
    fn limits_that_do_not_bind_leave_equation_11() {
        let sharing =
            paper().sharing(Configuration::from_degrees(45.0, 0.0), &ForceLimits::new(-200.0, 200.0).unwrap());
        assert!(sharing.within && sharing.common_n == 0.0);
        let narrow = paper().sharing(Configuration::from_degrees(90.0, 0.0), &ForceLimits::new(-5.0, 5.0).unwrap());
        assert!(!narrow.within);
        assert!(
            ((narrow.actuation_n.max() - 5.0) - (-5.0 - narrow.actuation_n.min())).abs() < 1e-9,
            "both missed alike"
        );
        assert!(ForceLimits::new(5.0, -5.0).is_err() && ForceLimits::new(f64::NAN, 1.0).is_err());
    }
}
