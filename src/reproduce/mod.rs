//! The paper's tables and figures, computed anew and set beside what it prints.
//!
//! Every [`Comparison`] holds one figure of the paper, the program's own, and why they differ where they do. The figures' data are
//! kept as plain rows, one structure a file ([`Reproduction::files`]), so that anybody can draw them again.
//!
//! Where the paper measured its robot, a simulated one is measured here ([`bending`]). It obeys Eq. 18 with the paper's η and
//! λ, and in a second form has the play that the paper's dial indicator found, taken up by each backbone in the direction of its load.

pub mod bending;
mod comparison;
pub mod friction;
pub mod jacobian;
pub mod recursion;

pub use bending::{BendingError, Compensation, SimulatedRobot, WorkspacePoint};
pub use comparison::{Comparison, PAPER_ETA, PAPER_LAMBDA_MM};
pub use friction::FrictionPoint;
pub use jacobian::JacobianEntry;
pub use recursion::RecursionStep;

use crate::error::Result;
use crate::record::csv_of;
use crate::robot::{Model, Robot};

/// All of it.
#[derive(Debug, Clone, PartialEq)]
pub struct Reproduction {
    /// Every figure beside the paper's, in the paper's order.
    pub comparisons: Vec<Comparison>,
    /// Table II and Fig. 8.
    pub friction: Vec<FrictionPoint>,
    /// Fig. 9.
    pub workspace: Vec<WorkspacePoint>,
    /// Fig. 10: δ = 0° and varying θ.
    pub by_theta: Vec<BendingError>,
    /// Fig. 11: θ = 30° and varying δ.
    pub by_delta: Vec<BendingError>,
    /// Table III.
    pub recursion: Vec<RecursionStep>,
    /// Eq. 26.
    pub jacobian: Vec<JacobianEntry>,
}

/// Computes everything. The same seed draws the same noise.
///
/// # Errors
/// Those of the model and the estimator; none with the paper's numbers.
pub fn reproduce(seed: u64) -> Result<Reproduction> {
    let (mut comparisons, friction) = friction::table_ii_and_figure_8()?;
    comparisons.splice(0..0, constants());
    let workspace = bending::figure_9();
    let by_theta = bending::figure_10(seed)?;
    let by_delta = bending::figure_11(seed)?;
    comparisons.extend(bending::compared(&workspace, &by_theta, &by_delta));
    let recursion = recursion::table_iii(seed);
    comparisons.extend(recursion::compared(&recursion));
    let jacobian = jacobian::equation_26()?;
    comparisons.extend(jacobian::compared(&jacobian)?);
    Ok(Reproduction { comparisons, friction, workspace, by_theta, by_delta, recursion, jacobian })
}

impl Reproduction {
    /// The CSV files: name and content, one a figure or table.
    ///
    /// # Errors
    /// [`Error::Encode`](crate::Error::Encode) for a row that cannot be written as CSV, which does not occur.
    pub fn files(&self) -> Result<Vec<(&'static str, String)>> {
        Ok(vec![
            ("comparisons.csv", csv_of(&self.comparisons)?),
            ("figure_8.csv", csv_of(&self.friction)?),
            ("figure_9.csv", csv_of(&self.workspace)?),
            ("figure_10.csv", csv_of(&self.by_theta)?),
            ("figure_11.csv", csv_of(&self.by_delta)?),
            ("table_iii.csv", csv_of(&self.recursion)?),
            ("equation_26.csv", csv_of(&self.jacobian)?),
        ])
    }
}

/// What Table I and Section V's prose imply.
fn constants() -> Vec<Comparison> {
    let robot = Robot::default();
    let degree_mm = robot.backbone_circle_radius_mm * 1f64.to_radians();
    let straight_line = (robot.line.cone_length_mm(), Model::default().line_compliance_mm_per_n());
    vec![
        Comparison::new(
            "Section III-B",
            "L_c, length of the backbones in the cone",
            "mm",
            None,
            straight_line.0,
            "Two sections of 41° with a radius of 20 mm. The straight portion between them is not printed; it is 0 here.",
        ),
        Comparison::new(
            "Eq. 16, 17",
            "κ = K_d⁻¹ + e^{2μφ} K_c⁻¹, stretch of a line per newton",
            "mm/N",
            None,
            straight_line.1,
            "From Table I. At θ = 90° the line takes up about as much as the snake needs, which is why compensation matters.",
        ),
        Comparison::new(
            "Section V",
            "σ = 1° as a length on ε",
            "mm",
            0.0294,
            degree_mm,
            format!(
                "r · 1°. The norm over three backbones is √(3/2) r · 1° = {:.4} mm; neither is the printed one.",
                1.5f64.sqrt() * degree_mm
            ),
        ),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_file_has_a_row_for_each_value_and_every_difference_its_reason() {
        let all = reproduce(1).unwrap();
        assert_eq!(all, reproduce(1).unwrap());
        for (name, text) in all.files().unwrap() {
            let mut reader = csv::Reader::from_reader(text.as_bytes());
            let header = reader.headers().unwrap().clone();
            assert!(!header.iter().any(str::is_empty), "{name}");
            assert!(reader.records().all(|record| record.is_ok_and(|record| record.len() == header.len())), "{name}");
        }
        assert!(all.comparisons.iter().all(|c| c.ours.is_finite() && !c.explanation.is_empty()));
    }

    #[test]
    fn the_printed_sigma_is_neither_reading_of_one_degree() {
        let sigma = &constants()[2];
        assert!((sigma.ours - 0.0262).abs() < 5e-5);
        assert!((1.5f64.sqrt() * sigma.ours - 0.0321).abs() < 5e-5);
    }
}
