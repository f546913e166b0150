//! The numbers that describe one robot: Table I, Section III-B and the body as a camera sees it.

use super::{BACKBONES, PerBackbone};
use nalgebra::Vector2;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;
use std::sync::LazyLock;

/// A super-elastic NiTi tube.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tube {
    /// Outer diameter d_o, mm.
    pub outer_diameter_mm: f64,
    /// Inner diameter d_i, mm.
    pub inner_diameter_mm: f64,
    /// Young's modulus E, GPa.
    pub youngs_modulus_gpa: f64,
}

impl Tube {
    /// Young's modulus E, MPa (N/mm²).
    pub fn youngs_modulus_mpa(&self) -> f64 {
        self.youngs_modulus_gpa * 1000.0
    }

    /// Second moment of area I = π (d_o⁴ − d_i⁴) / 64, mm⁴.
    pub fn second_moment_mm4(&self) -> f64 {
        PI / 64.0 * (self.outer_diameter_mm.powi(4) - self.inner_diameter_mm.powi(4))
    }

    /// Bending stiffness E I, N·mm².
    pub fn bending_stiffness_n_mm2(&self) -> f64 {
        self.youngs_modulus_mpa() * self.second_moment_mm4()
    }

    /// Axial stiffness E A, N.
    pub fn axial_stiffness_n(&self) -> f64 {
        self.youngs_modulus_mpa() * self.area_mm2()
    }

    /// Cross-sectional area A = π (d_o² − d_i²) / 4, mm².
    pub fn area_mm2(&self) -> f64 {
        PI / 4.0 * (self.outer_diameter_mm.powi(2) - self.inner_diameter_mm.powi(2))
    }
}

/// The line between the actuation unit and the snake: holder and cone (Fig. 3, Section III-B).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ActuationLine {
    /// Length L_d of the backbones in the DDU holder, mm.
    pub holder_length_mm: f64,
    /// Radius of each of the cone channel's two circular sections, mm.
    pub cone_bend_radius_mm: f64,
    /// Angle φ of each of the two sections, degrees.
    pub cone_bend_angle_deg: f64,
    /// Length of the cone channel's tangential straight portion, mm. The paper does not print it.
    pub cone_straight_mm: f64,
}

impl ActuationLine {
    /// φ in radians.
    pub fn cone_bend_angle(&self) -> f64 {
        self.cone_bend_angle_deg.to_radians()
    }

    /// The line's total bending angle, rad: both sections of the cone.
    pub fn total_angle(&self) -> f64 {
        2.0 * self.cone_bend_angle()
    }

    /// The same line bent through another total angle (rad), its length kept: a flexible stem in another shape.
    pub fn bent_through(&self, total_angle: f64) -> Self {
        let length_mm = self.cone_length_mm();
        let radius_mm = self.cone_bend_radius_mm.min(length_mm / total_angle.max(f64::MIN_POSITIVE));
        Self {
            cone_bend_radius_mm: radius_mm,
            cone_bend_angle_deg: 0.5 * total_angle.to_degrees(),
            cone_straight_mm: (length_mm - radius_mm * total_angle).max(0.0),
            ..*self
        }
    }

    /// Length L_c of the backbones in the cone, mm: two circular sections and the straight portion.
    pub fn cone_length_mm(&self) -> f64 {
        2.0 * self.cone_bend_radius_mm * self.cone_bend_angle() + self.cone_straight_mm
    }
}

/// The body as a camera sees it: disks on the tubes, on a holder of the disks' diameter.
///
/// A spacer disk is square to the backbone at its own middle; the end disk is square to it at L, where its far face is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Body {
    /// Outer diameter of the disks and of the holder below the base disk, mm.
    pub disk_diameter_mm: f64,
    /// Thickness of a disk, mm.
    pub disk_thickness_mm: f64,
    /// Number of spacer disks between base disk and end disk.
    pub spacer_disk_count: u8,
    /// Arc lengths of the spacer disks' middles, mm, from the base on; `None` where they divide L evenly.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub disk_positions_mm: Option<Vec<f64>>,
    /// What is mounted on the end disk.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tool: Option<Tool>,
}

/// A rigid cylinder on the end disk's far face, along the tip's direction.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tool {
    /// Length beyond the end disk's far face, mm.
    pub length_mm: f64,
    /// Outer diameter, mm.
    pub diameter_mm: f64,
}

/// One robot: everything that does not change from experiment to experiment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Robot {
    /// Length L of the primary backbone from the base disk's top face to the end disk's far face, mm.
    pub length_mm: f64,
    /// Radius r of the circle of secondary backbones, mm.
    pub backbone_circle_radius_mm: f64,
    /// Number n of secondary backbones, evenly spaced, within [`BACKBONES`]; three in the paper.
    #[serde(default = "three", skip_serializing_if = "is_three")]
    pub backbones: u8,
    /// The central backbone.
    pub primary: Tube,
    /// Each of the secondary backbones.
    pub secondary: Tube,
    /// Holder and cone.
    pub line: ActuationLine,
    /// Disks and holder.
    pub body: Body,
}

/// The paper's number of secondary backbones.
fn three() -> u8 {
    3
}

fn is_three(backbones: &u8) -> bool {
    *backbones == three()
}

/// Unit vectors from the middle to the backbones, by how many there are from the least that there can be: every ε needs them, and
/// sines are slow.
static DIRECTIONS: LazyLock<Vec<PerBackbone<Vector2<f64>>>> = LazyLock::new(|| {
    let directions = |n: usize| {
        PerBackbone::from_fn(n, |i| {
            let (sin, cos) = (-(i as f64) * (2.0 * PI / n as f64)).sin_cos();
            Vector2::new(cos, sin)
        })
    };
    BACKBONES.map(directions).collect()
});

impl Default for Robot {
    /// Table I and Section III-B of the paper.
    fn default() -> Self {
        let tube = Tube { outer_diameter_mm: 0.66, inner_diameter_mm: 0.50, youngs_modulus_gpa: 54.0 };
        Self {
            length_mm: 26.0,
            backbone_circle_radius_mm: 1.5,
            backbones: three(),
            primary: tube,
            secondary: tube,
            line: ActuationLine {
                holder_length_mm: 480.0,
                cone_bend_radius_mm: 20.0,
                cone_bend_angle_deg: 41.0,
                cone_straight_mm: 0.0,
            },
            body: Body {
                disk_diameter_mm: 4.2,
                disk_thickness_mm: 0.6,
                spacer_disk_count: 6,
                disk_positions_mm: None,
                tool: None,
            },
        }
    }
}

impl Robot {
    /// n, the number of secondary backbones; never beyond what there can be.
    pub fn backbone_count(&self) -> usize {
        usize::from(self.backbones).clamp(*BACKBONES.start(), *BACKBONES.end())
    }

    /// β = 2π/n, the angle between neighbouring secondary backbones.
    pub fn beta(&self) -> f64 {
        2.0 * PI / self.backbone_count() as f64
    }

    /// Distance between the middles of neighbouring spacer disks, mm, where they divide L evenly; else its mean.
    pub fn disk_pitch_mm(&self) -> f64 {
        self.length_mm / (f64::from(self.body.spacer_disk_count) + 1.0)
    }

    /// Arc lengths of the spacer disks' middles, mm.
    pub fn spacer_middles_mm(&self) -> Vec<f64> {
        let evenly = || (1..=self.body.spacer_disk_count).map(|k| f64::from(k) * self.disk_pitch_mm()).collect();
        self.body.disk_positions_mm.clone().unwrap_or_else(evenly)
    }

    /// K_d⁻¹ = L_d / (E_s A), mm/N: compliance of a backbone in the DDU holder, Eq. 17.
    pub fn holder_compliance_mm_per_n(&self) -> f64 {
        self.line.holder_length_mm / self.secondary.axial_stiffness_n()
    }

    /// K_c⁻¹ = L_c / (E_s A), mm/N: compliance of a backbone in the snake cone, Eq. 17.
    pub fn cone_compliance_mm_per_n(&self) -> f64 {
        self.line.cone_length_mm() / self.secondary.axial_stiffness_n()
    }

    /// Unit vectors in {b} from the middle to the secondary backbones.
    pub fn backbone_directions(&self) -> PerBackbone<Vector2<f64>> {
        DIRECTIONS[self.backbone_count() - BACKBONES.start()]
    }

    /// Azimuths of the secondary backbones in {b}, rad: −(i−1)·β.
    pub fn backbone_azimuths(&self) -> PerBackbone {
        PerBackbone::from_fn(self.backbone_count(), |i| -(i as f64) * self.beta())
    }
}
