//! Eq. 26's Jacobian, and Eq. 5, 7 and 9, against finite differences.

use super::bending::paper_model;
use super::comparison::Comparison;
use crate::error::Result;
use crate::geometry::{Configuration, wrap_angle};
use crate::robot::{Model, PerBackbone};
use nalgebra::{Vector2, Vector6};
use serde::Serialize;

/// Step of the central differences of q̃, mm. Derived: ε^{1/3} of the millimetres that q̃ has, where rounding and curvature err alike.
const STEP_MM: f64 = 1e-5;

/// One entry of J̃_ψq at one pose.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct JacobianEntry {
    /// θ, degrees.
    pub theta_deg: f64,
    /// δ, degrees.
    pub delta_deg: f64,
    /// The angle that moves: `theta` or `delta`.
    pub angle: &'static str,
    /// The backbone that is commanded, 1 to 3.
    pub backbone: usize,
    /// By Eq. 26, rad/mm.
    pub equation_26_rad_per_mm: f64,
    /// By differences of where the model leads, rad/mm.
    pub differences_rad_per_mm: f64,
    /// Eq. 7's, without the lines' stretch, rad/mm.
    pub without_stretch_rad_per_mm: f64,
}

/// All six entries at sixteen poses.
///
/// # Errors
/// Those of the model; none at these poses.
pub fn equation_26() -> Result<Vec<JacobianEntry>> {
    let model = paper_model();
    let mut rows = Vec::new();
    for theta_deg in [5.0, 30.0, 60.0, 90.0] {
        for delta_deg in [0.0, 45.0, 120.0, -90.0] {
            let psi = Configuration::from_degrees(theta_deg, delta_deg);
            let ours = model.updated_jacobian(psi)?;
            let differences = by_differences(&model, psi)?;
            let plain = model.robot.jacobian_psi_q(psi).unwrap_or_default();
            for (axis, angle) in ["theta", "delta"].into_iter().enumerate() {
                rows.extend((0..ours.len()).map(|i| JacobianEntry {
                    theta_deg,
                    delta_deg,
                    angle,
                    backbone: i + 1,
                    equation_26_rad_per_mm: ours[i][axis],
                    differences_rad_per_mm: differences[i][axis],
                    without_stretch_rad_per_mm: plain[i][axis],
                }));
            }
        }
    }
    Ok(rows)
}

fn by_differences(model: &Model, psi: Configuration) -> Result<PerBackbone<Vector2<f64>>> {
    let q_tilde = model.command(psi);
    let mut columns = PerBackbone::repeat(q_tilde.len(), Vector2::zeros());
    for (i, column) in columns.iter_mut().enumerate() {
        let step = PerBackbone::ith(q_tilde.len(), i) * STEP_MM;
        let ahead = model.forward(&(q_tilde + step))?.configuration;
        let behind = model.forward(&(q_tilde - step))?.configuration;
        *column = Vector2::new(ahead.theta - behind.theta, wrap_angle(ahead.delta - behind.delta)) / (2.0 * STEP_MM);
    }
    Ok(columns)
}

/// What the differences say of Eq. 26, 5 and 9.
///
/// # Errors
/// Those of the model.
pub fn compared(entries: &[JacobianEntry]) -> Result<Vec<Comparison>> {
    let largest = |value: fn(&JacobianEntry) -> f64| entries.iter().map(|e| value(e).abs()).fold(0.0, f64::max);
    let miss = largest(|e| e.equation_26_rad_per_mm - e.differences_rad_per_mm);
    let scale = largest(|e| e.equation_26_rad_per_mm);
    let share = entries.iter().find(|e| (e.theta_deg, e.delta_deg, e.angle, e.backbone) == (90.0, 0.0, "theta", 1));
    let share = share.map_or(f64::NAN, |e| e.equation_26_rad_per_mm / e.without_stretch_rad_per_mm);
    let [printed, turned] = equation_9();
    Ok(vec![
        Comparison::new(
            "Eq. 26",
            "largest difference from finite differences, of the largest entry",
            "1",
            0.0,
            miss / scale,
            "The paper leaves α(ψ) open; here it is η κ Q(QᵗQ)⁻¹ times the Hessian of the elastic energy.",
        ),
        Comparison::new(
            "Eq. 26",
            "∂θ/∂q̃_1 at θ = 90°, δ = 0°, as a share of Eq. 7's",
            "1",
            None,
            share,
            "What the lines' stretch leaves of the Jacobian.",
        ),
        Comparison::new(
            "Eq. 5",
            "∂θ/∂q_1 at cos δ_1 = 0 and θ = 30°, Eq. 7's form",
            "rad/mm",
            None,
            at_zero_over_zero(),
            "Eq. 5 is 0/0 there (and as printed holds for θ_0 = 0); Eq. 7, read with Θ = θ_L − θ_0, is regular.",
        ),
        Comparison::new(
            "Eq. 9",
            "|d(E − τᵗq − w_eᵗx)/db| at rest under 0.2 N",
            "N·mm/rad",
            printed,
            turned,
            "At rest it must be zero. The paper's figure is with its plus before w_e, which is right for the wrench that the \
             snake applies; w_e applied on the snake takes a minus.",
        ),
    ])
}

/// Eq. 7's ∂θ/∂q_1 at δ = 90°, where Eq. 5 divides zero by zero.
fn at_zero_over_zero() -> f64 {
    let psi = Configuration::from_degrees(30.0, 90.0);
    paper_model().robot.jacobian_psi_q12(psi).map_or(f64::NAN, |jacobian| jacobian[(0, 0)])
}

/// What is left of the balance of a loaded snake with Eq. 9's sign as printed, and turned.
fn equation_9() -> [f64; 2] {
    let robot = paper_model().robot;
    let bend = Configuration::from_degrees(30.0, 20.0).bend_vector();
    let wrench = Vector6::new(0.2, 0.0, 0.0, 0.0, 0.0, 0.0);
    let tip = |b: Vector2<f64>| robot.frame_at(Configuration::from_bend_vector(b), robot.length_mm).translation.vector;
    let h = 1e-5;
    [-1.0, 1.0].map(|sign| {
        let tau = robot.actuation_forces(bend, Some(&(wrench * sign)));
        let total =
            |b: Vector2<f64>| robot.elastic_energy(b) - tau.dot(&(robot.displacement_by_bend() * b)) - 0.2 * tip(b).x;
        let slope = [0, 1].map(|axis| {
            let step = Vector2::ith(axis, h);
            (total(bend + step) - total(bend - step)) / (2.0 * h)
        });
        slope[0].hypot(slope[1])
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equation_26_is_the_derivative_and_equation_9_takes_a_minus() {
        let entries = equation_26().unwrap();
        assert_eq!(entries.len(), 4 * 4 * 6);
        let compared = compared(&entries).unwrap();
        assert!(compared[0].ours < 1e-6, "{}", compared[0].ours);
        assert!((0.2..0.6).contains(&compared[1].ours), "{}", compared[1].ours);
        // Twice the generalised force of 0.2 N on the tip, which moves by some 12 mm per rad.
        assert!(compared[3].ours < 1e-5 && compared[3].paper.unwrap() > 3.0, "{:?}", compared[3]);
    }
}
