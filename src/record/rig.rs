//! rig.toml: a calibrated view on disk.
//!
//! ```toml
//! [base]                    # the camera's pose to the snake's base
//! rotation = [[…], […], […]]      # rows of R in x_camera = R x_base + t
//! translation_mm = [x, y, z]
//! covariance = [[…] × 6]          # of a small turn (rad) and a shift (mm) along the camera's axes
//! [grid]                    # the camera's pose to the grid target's mean plane
//! [sheet]                   # how the printed sheet departs from a flat and square one; files of older versions have none
//! [print]                   # what is on it, and the colours in which it shows; files of older versions have none
//! [appearance]              # what tells snake from grid target
//! [lines]                   # how the printed lines look in that; files of older versions, and sheets that are not looked through, have none
//! [fit]                     # how well the calibration fitted
//! ```

use crate::error::{Error, Result};
use crate::geometry::Pose;
use crate::input::read_text;
use crate::measure::{Appearance, EdgeBias, GridPattern, PrintProfile, Rig, SheetShape, UNKNOWN_SHAPE_RAD};
use crate::record::{line_at, write_atomically};
use crate::robot::MODES;
use nalgebra::{Matrix3, Matrix6, Rotation3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use std::path::Path;

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct RigFile {
    base: BaseTable,
    grid: GridTable,
    #[serde(default)]
    sheet: Option<SheetTable>,
    #[serde(default)]
    print: GridPattern,
    appearance: Appearance,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    lines: Option<LinesTable>,
    fit: FitTable,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct BaseTable {
    rotation: [[f64; 3]; 3],
    translation_mm: [f64; 3],
    covariance: [[f64; 6]; 6],
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct GridTable {
    pitch_mm: f64,
    rotation: [[f64; 3]; 3],
    translation_mm: [f64; 3],
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct SheetTable {
    anisotropy: f64,
    shear_deg: f64,
    bow_mm: [f64; 3],
    centre_mm: [f64; 2],
    half_mm: [f64; 2],
}

impl SheetTable {
    fn of(shape: &SheetShape) -> Self {
        Self {
            anisotropy: shape.anisotropy,
            shear_deg: shape.shear.to_degrees(),
            bow_mm: shape.bow_mm,
            centre_mm: shape.centre_mm.into(),
            half_mm: shape.half_mm.into(),
        }
    }

    /// The shape; `None` where a number is not finite, or the sheet has no extent.
    fn shape(&self) -> Option<SheetShape> {
        let Self { anisotropy, shear_deg, bow_mm, centre_mm, half_mm } = *self;
        let numbers = bow_mm.iter().chain(&centre_mm).chain(&half_mm).chain([&anisotropy, &shear_deg]);
        let is_sheet = numbers.copied().all(f64::is_finite)
            && half_mm.iter().all(|half| *half > 0.0)
            && anisotropy.abs() < 1.0
            && shear_deg.abs() < 45.0;
        let (centre_mm, half_mm) = (centre_mm.into(), half_mm.into());
        is_sheet.then(|| SheetShape { anisotropy, shear: shear_deg.to_radians(), bow_mm, centre_mm, half_mm })
    }
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct LinesTable {
    paper: f32,
    across: Vec<f32>,
    along: Vec<f32>,
    /// The number across and along of each part of the sheet, and the contrast there.
    contrast: Vec<(i32, i32, f32)>,
}

impl LinesTable {
    fn of(print: &PrintProfile) -> Self {
        let PrintProfile { across, along, paper, contrast } = print.clone();
        let contrast = contrast.into_iter().map(|((x, y), contrast)| (x, y, contrast)).collect();
        Self { paper, across, along, contrast }
    }

    /// The print; `None` where a profile has not as many numbers as it must have, or one is not finite.
    fn print(self) -> Option<PrintProfile> {
        let Self { paper, across, along, contrast } = self;
        let contrast = contrast.into_iter().map(|(x, y, contrast)| ((x, y), contrast)).collect();
        Some(PrintProfile { across, along, paper, contrast }).filter(PrintProfile::is_sound)
    }
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FitTable {
    edge_bias_px: f64,
    /// Files of versions that told no rims, or no tubes, from sides have none.
    rim_bias_px: Option<f64>,
    tube_bias_px: Option<f64>,
    /// Files of versions that told no faces from walls have none.
    glare: Option<[f64; 2]>,
    edge_rms_px: f64,
    grid_rms_px: f64,
    /// Files of versions that took every snake for an arc have none.
    #[serde(default = "unknown_shape_deg")]
    mode_sigma_deg: [f64; MODES],
}

fn unknown_shape_deg() -> [f64; MODES] {
    UNKNOWN_SHAPE_RAD.map(f64::to_degrees)
}

impl Rig {
    /// Reads rig.toml.
    ///
    /// # Errors
    ///
    /// If the file cannot be read, is not such a file, or holds an impossible pose.
    pub fn read(path: &Path) -> Result<Self> {
        let text = read_text(path)?;
        let file: RigFile = toml::from_str(&text).map_err(|e| {
            let line = e.span().map(|span| line_at(&text, span.start));
            Error::Content { path: path.to_owned(), line, message: e.message().to_owned() }
        })?;
        let wrong = |what: &str| Error::content(path, format!("{what}; write the file anew with `calibrate rig`"));
        let (base, fit) = (&file.base, &file.fit);
        let numbers = base
            .covariance
            .iter()
            .flatten()
            .chain(&file.appearance.weights)
            .chain(&file.print.weights)
            .chain([&file.appearance.offset])
            .chain(&file.appearance.light);
        if !numbers
            .chain([&fit.edge_bias_px])
            .chain(&fit.rim_bias_px)
            .chain(&fit.tube_bias_px)
            .chain(fit.glare.iter().flatten())
            .all(|v| v.is_finite())
        {
            return Err(wrong("a number is not finite"));
        }
        if !fit.mode_sigma_deg.iter().all(|sigma| sigma.is_finite() && *sigma > 0.0) {
            return Err(wrong("mode_sigma_deg must be positive"));
        }
        if [&file.appearance.weights, &file.print.weights].iter().any(|weights| ![1, 3].contains(&weights.len())) {
            return Err(wrong(
                "the weights of [appearance] and [print] must each have one number (grey) or three (colour)",
            ));
        }
        Ok(Self {
            camera_from_base: pose(&base.rotation, &base.translation_mm)
                .ok_or_else(|| wrong("[base] is not a pose"))?,
            pose_covariance: Matrix6::from_fn(|r, c| (base.covariance[r][c] + base.covariance[c][r]) / 2.0),
            camera_from_grid: pose(&file.grid.rotation, &file.grid.translation_mm)
                .ok_or_else(|| wrong("[grid] is not a pose"))?,
            sheet_shape: match &file.sheet {
                Some(sheet) => sheet.shape().ok_or_else(|| wrong("[sheet] is not a sheet's shape"))?,
                None => SheetShape::default(),
            },
            grid_pitch_mm: file.grid.pitch_mm,
            pattern: file.print,
            appearance: file.appearance,
            print: file
                .lines
                .map(|lines| lines.print().ok_or_else(|| wrong("[lines] does not describe a print")))
                .transpose()?,
            edge_bias: EdgeBias {
                side_px: fit.edge_bias_px,
                tube_px: fit.tube_bias_px.unwrap_or(fit.edge_bias_px),
                rim_px: fit.rim_bias_px.unwrap_or(fit.edge_bias_px),
                glare: fit.glare.unwrap_or_default(),
            },
            mode_sigma_rad: fit.mode_sigma_deg.map(f64::to_radians),
            edge_rms_px: fit.edge_rms_px,
            grid_rms_px: fit.grid_rms_px,
        })
    }

    /// Writes rig.toml, whole or not at all.
    ///
    /// # Errors
    ///
    /// If the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let covariance = &self.pose_covariance;
        let (base, grid) = (rows(&self.camera_from_base), rows(&self.camera_from_grid));
        let file = RigFile {
            base: BaseTable {
                rotation: base.0,
                translation_mm: base.1,
                covariance: std::array::from_fn(|r| std::array::from_fn(|c| covariance[(r, c)])),
            },
            grid: GridTable { pitch_mm: self.grid_pitch_mm, rotation: grid.0, translation_mm: grid.1 },
            sheet: Some(SheetTable::of(&self.sheet_shape)),
            print: self.pattern.clone(),
            appearance: self.appearance.clone(),
            lines: self.print.as_ref().map(LinesTable::of),
            fit: FitTable {
                edge_bias_px: self.edge_bias.side_px,
                rim_bias_px: Some(self.edge_bias.rim_px),
                tube_bias_px: Some(self.edge_bias.tube_px),
                glare: Some(self.edge_bias.glare),
                edge_rms_px: self.edge_rms_px,
                grid_rms_px: self.grid_rms_px,
                mode_sigma_deg: self.mode_sigma_rad.map(f64::to_degrees),
            },
        };
        let text = toml::to_string(&file).map_err(|e| Error::content(path, e.to_string()))?;
        write_atomically(path, text.as_bytes())
    }
}

/// R by rows and t.
fn rows(pose: &Pose) -> ([[f64; 3]; 3], [f64; 3]) {
    let rotation = pose.rotation.to_rotation_matrix();
    (std::array::from_fn(|r| std::array::from_fn(|c| rotation[(r, c)])), pose.translation.vector.into())
}

/// The pose, if the matrix is a rotation to within rounding and everything is finite.
fn pose(rotation: &[[f64; 3]; 3], translation_mm: &[f64; 3]) -> Option<Pose> {
    let matrix = Matrix3::from_fn(|r, c| rotation[r][c]);
    let translation = Vector3::from(*translation_mm);
    let is_rotation = (matrix * matrix.transpose() - Matrix3::identity()).amax() < 1e-6 && matrix.determinant() > 0.0;
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix));
    (is_rotation && translation.iter().all(|v| v.is_finite()))
        .then(|| Pose::from_parts(Translation3::from(translation), rotation))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measure::PatternKind;

    /// A print with as many numbers as one must have, which are written with four places.
    fn print() -> PrintProfile {
        let profile = |factor: i32| (0..160).map(|k| (k * factor % 7) as f32 / 10.0).collect();
        let contrast = [((-3, 2), 0.75), ((0, 0), 1.0)].into();
        PrintProfile { across: profile(3), along: profile(2), paper: -0.0321, contrast }
    }

    fn rig() -> Rig {
        Rig {
            camera_from_base: Pose::new(Vector3::new(1.0, 2.0, 230.0), Vector3::new(1.5, 0.1, -0.05)),
            pose_covariance: Matrix6::from_diagonal_element(1e-6),
            camera_from_grid: Pose::new(Vector3::new(0.0, 0.0, 255.0), Vector3::new(0.02, 0.01, 0.03)),
            sheet_shape: SheetShape {
                anisotropy: 0.01,
                shear: 0.002,
                bow_mm: [0.3, -0.2, 0.1],
                centre_mm: [4.0, -3.0].into(),
                half_mm: [30.0, 20.0].into(),
            },
            grid_pitch_mm: 1.0,
            pattern: GridPattern { kind: PatternKind::Checkerboard, weights: vec![0.5, 0.25, -0.5] },
            appearance: Appearance {
                weights: vec![-1.0, 0.5, -2.0],
                offset: 1.25,
                two_sided: false,
                light: Some(-1.2),
            },
            mode_sigma_rad: [0.01, 0.005, 0.0025],
            print: Some(print()),
            edge_bias: EdgeBias { side_px: -0.05, tube_px: 0.2, rim_px: 0.01, glare: [0.3, 0.2] },
            grid_rms_px: 0.1,
            edge_rms_px: 0.12,
        }
    }

    #[test]
    fn what_is_written_is_read_again() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("rig.toml");
        rig().write(&path).unwrap();
        let read = Rig::read(&path).unwrap();
        assert!((read.camera_from_base.rotation.angle_to(&rig().camera_from_base.rotation)) < 1e-12);
        assert_eq!(read.camera_from_base.translation, rig().camera_from_base.translation);
        assert_eq!((read.pattern, read.appearance, read.edge_bias), (rig().pattern, rig().appearance, rig().edge_bias));
        assert_eq!(read.pose_covariance, rig().pose_covariance);
        assert_eq!(read.print, rig().print);
    }

    #[test]
    fn a_file_that_tells_no_tubes_from_sides_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("rig.toml");
        rig().write(&path).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::write(
            &path,
            text.lines().filter(|line| !line.starts_with("tube_bias_px")).collect::<Vec<_>>().join("\n"),
        )
        .unwrap();
        assert_eq!(
            Rig::read(&path).unwrap().edge_bias,
            EdgeBias { side_px: -0.05, tube_px: -0.05, rim_px: 0.01, glare: [0.3, 0.2] }
        );
    }

    #[test]
    fn a_mirrored_pose_and_an_unknown_key_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("rig.toml");
        rig().write(&path).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, text.replacen("rotation = [[", "rotation = [[-", 1)).unwrap();
        let message = Rig::read(&path).unwrap_err().to_string();
        assert!(message.contains("[base] is not a pose") || message.contains("expected"), "{message}");
        std::fs::write(&path, text.replace("[fit]", "[fit]\nedges = 3")).unwrap();
        let message = Rig::read(&path).unwrap_err().to_string();
        assert!(message.contains("edges") && message.contains("rig.toml:"), "{message}");
    }
}
