//! Redundancy: what to do with the force that all backbones can share.
//!
//! n backbones bend two ways, so forces may differ from Eq. 11's by any N common to all of them: it does no work on the snake,
//! whose base takes it up. Eq. 11 is N = 0, and with it the strain in the lines is least: Σ (η τ_i + N)² grows with N² because the
//! η τ_i sum to zero, and the central backbone carries n N. With three backbones this is all of the redundancy. More backbones have
//! n − 3 further ways to press against each other, which are left at Eq. 11's zero.
//!
//! Limits of the actuation unit change that. With τ̃_i = (η τ_i + N + f_s) e^{2μφ} (Eq. 13) the least strain within them is
//!
//! ```text
//! min ½ Σ (η τ_i + N)²   subject to   least ≤ τ̃_i ≤ most  for every i
//! ```
//!
//! a quadratic program in one unknown, whose solution is N = 0 clamped to the interval that the limits leave. Where they leave none,
//! N goes to the middle of the contradiction, by which both limits are missed alike, and the pose counts as outside them.
//! A force N stretches every line by κN, which is added to q̃: the choice shows in the table and in the bend not at all.

use super::{Mechanics, Model, PerBackbone};
use crate::error::{Error, Result};
use crate::geometry::Configuration;

/// What the actuation unit can do: forces τ̃, N, positive where they push.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ForceLimits {
    least_n: f64,
    most_n: f64,
}

impl ForceLimits {
    /// Limits of τ̃, N; the pull is negative.
    ///
    /// # Errors
    /// [`Error::Usage`] where they are not finite or not in order.
    pub fn new(least_n: f64, most_n: f64) -> Result<Self> {
        if !(least_n.is_finite() && most_n.is_finite() && least_n < most_n) {
            return Err(Error::Usage(format!(
                "force limits {least_n} and {most_n} N: expected the largest pull (negative), then the largest push"
            )));
        }
        Ok(Self { least_n, most_n })
    }

    fn contain(&self, force_n: f64) -> bool {
        (self.least_n - 1e-9..=self.most_n + 1e-9).contains(&force_n)
    }
}

/// How the backbones share the load at one pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sharing {
    /// N: the force common to all backbones, N; positive pushes.
    pub common_n: f64,
    /// τ̃: what the actuation unit must exert on each, N.
    pub actuation_n: PerBackbone,
    /// κN: what it adds to every q̃, mm.
    pub shift_mm: f64,
    /// Whether every τ̃_i lies within the limits.
    pub within: bool,
}

impl Model {
    /// The forces of least strain within limits that hold the snake at a pose.
    pub fn sharing(&self, psi: Configuration, limits: &ForceLimits) -> Sharing {
        let tau_n = Mechanics::new(self).forces_at(psi.bend_vector()) * self.parameters().x;
        let capstan = self.friction.capstan_factor(self.robot.line.cone_bend_angle());
        let static_n = self.friction.static_force_n;
        let at_least = limits.least_n / capstan - static_n - tau_n.min();
        let at_most = limits.most_n / capstan - static_n - tau_n.max();
        let common_n = if at_least <= at_most { 0.0f64.clamp(at_least, at_most) } else { 0.5 * (at_least + at_most) };
        let actuation_n = tau_n.map(|tau| (tau + common_n + static_n) * capstan);
        Sharing {
            common_n,
            actuation_n,
            shift_mm: common_n * self.line_compliance_mm_per_n(),
            within: actuation_n.iter().all(|&force| limits.contain(force)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Estimate;
    use nalgebra::Matrix2;
    use proptest::prelude::*;

    fn paper() -> Model {
        let estimate = Estimate { eta: 1.221, lambda_mm: 0.1765, covariance: Matrix2::zeros(), samples: 10 };
        Model { estimate: Some(estimate), ..Model::default() }
    }

    proptest! {
        #[test]
        fn no_common_force_within_the_limits_strains_less(
            theta_deg in 0.0..90.0f64, delta_deg in -180.0..180.0f64, pull in -80.0..-5.0f64, push in 5.0..80.0f64
        ) {
            let model = paper();
            let psi = Configuration::from_degrees(theta_deg, delta_deg);
            let limits = ForceLimits::new(pull, push).unwrap();
            let sharing = model.sharing(psi, &limits);
            let tau = model.robot.actuation_forces(psi.bend_vector(), None) * 1.221;
            let capstan = model.friction.capstan_factor(41f64.to_radians());
            let actuation = |n: f64| tau.map(|tau| (tau + n + model.friction.static_force_n) * capstan);
            let strain = |n: f64| tau.add_scalar(n).norm_squared();
            let within = |n: f64| actuation(n).iter().all(|force| (pull..=push).contains(force));
            // By trying: every common force from −100 to 100 N.
            let tried = (-10_000..=10_000).map(|k| f64::from(k) * 0.01).filter(|&n| within(n));
            let best = tried.min_by(|a, b| strain(*a).total_cmp(&strain(*b)));
            match best {
                Some(best) => {
                    prop_assert!(sharing.within);
                    prop_assert!(strain(sharing.common_n) <= strain(best) + 1e-9);
                    prop_assert!((sharing.common_n - best).abs() < 0.02);
                }
                // Limits that leave less than the trials' step may still be met.
                None => prop_assert!(!sharing.within || pull - push > -400.0),
            }
            prop_assert!((sharing.actuation_n - actuation(sharing.common_n)).norm() < 1e-9);
        }
    }

    #[test]
    fn the_common_force_bends_nothing_and_is_what_the_forward_problem_finds() {
        let model = paper();
        let psi = Configuration::from_degrees(60.0, 35.0);
        let sharing = model.sharing(psi, &ForceLimits::new(-80.0, 12.0).unwrap());
        assert!(sharing.within && sharing.common_n < -5.0, "{sharing:?}");
        assert!((sharing.actuation_n.max() - 12.0).abs() < 1e-9);
        let back = model.forward(&model.command(psi).add_scalar(sharing.shift_mm)).unwrap();
        assert!((back.configuration.theta - psi.theta).abs() < 1e-9);
        assert!((back.internal_force_n - sharing.common_n).abs() < 1e-9);
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
