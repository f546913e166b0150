//! What the renderer draws: a camera, the snake, the grid target behind it, the light and the sensor's faults.
//!
//! A scene is one TOML file. Colours are sRGB on the scale 0 to 255, as a picture of an evenly lit surface shows them.

use crate::camera::Lens;
use crate::error::{Error, Result};
use crate::geometry::{Configuration, Pose};
use crate::input::read_text;
use crate::robot::{BendProfile, MODES, Robot};
use nalgebra::{Matrix3, Point2, Rotation2, Rotation3, Translation3, UnitQuaternion, Vector2, Vector3};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// A colour, sRGB, 0 to 255.
pub type Colour = [f64; 3];

/// Everything that a picture depends on but the snake's bend and the noise's seed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scene {
    /// The lens and the picture's size.
    #[serde(with = "lens_as_table")]
    pub lens: Lens,
    /// Where the camera sees the base.
    pub view: Viewpoint,
    /// The snake.
    pub robot: Robot,
    /// e: a curvature that varies linearly, (b + e (2u − 1))/L, degrees along the bend and across it. It is −4 a_1 of a
    /// [`BendProfile`].
    #[serde(default, skip_serializing_if = "is_zero")]
    pub departure_deg: [f64; 2],
    /// The modes of a [`BendProfile`], degrees along the bend and across it; what `departure_deg` says comes on top.
    #[serde(default, skip_serializing_if = "are_zero")]
    pub modes_deg: [[f64; 2]; MODES],
    /// What the snake's surface looks like.
    pub surface: Surface,
    /// The paper behind the snake.
    pub paper: Paper,
    /// Where the light comes from and what it leaves dark.
    pub light: Light,
    /// What the sensor adds.
    pub sensor: Sensor,
    /// Wires between camera and snake.
    #[serde(default, rename = "wire", skip_serializing_if = "Vec::is_empty")]
    pub wires: Vec<Wire>,
}

/// A camera's pose: first the base frame upright before the camera, x_b to the right, z_b up, y_b away; then turned about
/// the camera's axes, yaw first, then pitch, then roll; then moved.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Viewpoint {
    /// About the camera's y axis (down), degrees: positive brings the snake's right side nearer.
    pub yaw_deg: f64,
    /// About the camera's x axis (right), degrees: positive brings the straight snake's tip nearer.
    pub pitch_deg: f64,
    /// About the camera's z axis (forward), degrees: positive turns the picture clockwise.
    pub roll_deg: f64,
    /// The base frame's origin in the camera's frame, mm.
    pub base_mm: [f64; 3],
}

/// A surface's colour and gloss (Blinn and Phong's reflection).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Surface {
    /// Colour under full light.
    pub colour: Colour,
    /// Brightness of the highlight, as a share of white.
    pub highlight: f64,
    /// How narrow the highlight is: the exponent of its cosine.
    pub shininess: f64,
}

/// A sheet parallel to the base's x–z plane, seen from y_b = −∞. It has no edge.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Paper {
    /// From the snake's axis back to the sheet, mm.
    pub standoff_mm: f64,
    /// The sheet's turn in its own plane, degrees: positive brings the sheet's x from x_b towards z_b.
    pub turn_deg: f64,
    /// Where a crossing of two heavy lines, or the corner of four squares, lies: (x, z) in {b}, mm.
    pub origin_mm: [f64; 2],
    /// Colour of the bare sheet.
    pub colour: Colour,
    /// What is printed on it.
    pub pattern: Pattern,
    /// Stains.
    #[serde(default, rename = "stain", skip_serializing_if = "Vec::is_empty")]
    pub stains: Vec<Stain>,
}

/// What is printed on the grid target.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Pattern {
    /// Nothing.
    Blank,
    /// Square grids of lines; where they cross, a later grid covers an earlier one.
    GraphPaper {
        /// The grids, finest first.
        lines: Vec<Lines>,
    },
    /// Squares, alternately dark and bare.
    Checkerboard {
        /// Side of a square, mm.
        square_mm: f64,
        /// Colour of the dark squares.
        colour: Colour,
    },
}

/// One grid of lines on the graph paper.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Lines {
    /// Distance between the lines' middles, mm.
    pub pitch_mm: f64,
    /// Width of a line, mm.
    pub width_mm: f64,
    /// Colour of the ink.
    pub colour: Colour,
}

/// A round stain on the grid target with a soft rim.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stain {
    /// Its middle: (x, z) in {b}, mm.
    pub centre_mm: [f64; 2],
    /// Its radius, mm; the rim takes the outer fifth.
    pub radius_mm: f64,
    /// The colour that white paper has under it.
    pub colour: Colour,
}

/// The light.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Light {
    /// The direction in {b} that the lamp lies in; its length does not matter.
    pub towards_lamp: [f64; 3],
    /// The share of the light that comes from all round, 0 to 1.
    pub ambient: f64,
    /// How much brighter the picture's right border is than its left, and its bottom than its top, as a share of the
    /// middle's brightness.
    pub gradient: [f64; 2],
    /// The share of brightness that is lost in the picture's corners.
    pub vignetting: f64,
    /// The share of light that the snake's shadow takes from the grid target, 0 (no shadow) to 1.
    pub shadow: f64,
    /// Softness of the shadow's rim, the σ of a Gaussian, mm on the grid target.
    pub shadow_blur_mm: f64,
}

/// What lens and sensor add to an ideal picture.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sensor {
    /// Rays through each pixel, a power of two up to 4096.
    pub rays_per_pixel: u32,
    /// σ of a Gaussian blur of the light, px.
    pub blur_px: f64,
    /// σ of Gaussian noise, grey levels of 255, independent in each pixel and channel.
    pub noise: f64,
}

/// A straight wire (or a finger, if wide) before the snake, in the picture's own coordinates.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Wire {
    /// One end, px.
    pub from_px: [f64; 2],
    /// The other end, px.
    pub to_px: [f64; 2],
    /// Its width, px; the ends are round.
    pub width_px: f64,
    /// Its colour.
    pub colour: Colour,
}

impl Viewpoint {
    /// The camera's pose, `camera_from_base`.
    pub fn camera_from_base(&self) -> Pose {
        let turned = |axis, angle_deg: f64| Rotation3::from_axis_angle(&axis, angle_deg.to_radians());
        let rotation = turned(Vector3::z_axis(), self.roll_deg)
            * turned(Vector3::x_axis(), self.pitch_deg)
            * turned(Vector3::y_axis(), self.yaw_deg)
            * Rotation3::from_matrix_unchecked(UPRIGHT);
        Pose::from_parts(Translation3::from(Vector3::from(self.base_mm)), UnitQuaternion::from(rotation))
    }

    /// The viewpoint of a camera's pose; the inverse of [`camera_from_base`](Self::camera_from_base).
    pub fn from_pose(camera_from_base: &Pose) -> Self {
        // roll · pitch · yaw; its third row is (−cos p sin y, sin p, cos p cos y), its second column starts with
        // (−sin r cos p, cos r cos p).
        let turns = camera_from_base.rotation.to_rotation_matrix().into_inner() * UPRIGHT.transpose();
        Self {
            yaw_deg: (-turns[(2, 0)]).atan2(turns[(2, 2)]).to_degrees(),
            pitch_deg: turns[(2, 1)].clamp(-1.0, 1.0).asin().to_degrees(),
            roll_deg: (-turns[(0, 1)]).atan2(turns[(1, 1)]).to_degrees(),
            base_mm: camera_from_base.translation.vector.into(),
        }
    }
}

/// x_b is the camera's x, y_b its z, z_b its −y.
///
/// Convention: the axes of camera and base.
const UPRIGHT: Matrix3<f64> = Matrix3::new(1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0);

impl Default for Scene {
    /// A clean, sharp, grey snake before blue graph paper, seen from 226 mm through a 4282 px lens, 1280×720.
    fn default() -> Self {
        Self {
            lens: Lens {
                width: 1280,
                height: 720,
                focal_px: Vector2::new(4282.34, 4282.34),
                centre_px: Point2::new(639.5, 359.5),
                distortion: [0.0; 12],
                fisheye: None,
            },
            view: Viewpoint { yaw_deg: 3.0, pitch_deg: 5.0, roll_deg: 2.0, base_mm: [-0.35, 9.96, 225.87] },
            robot: Robot::default(),
            departure_deg: [0.0; 2],
            modes_deg: [[0.0; 2]; MODES],
            surface: Surface { colour: [140.0, 140.0, 146.0], highlight: 0.3, shininess: 30.0 },
            paper: Paper {
                standoff_mm: 25.0,
                turn_deg: -1.5,
                origin_mm: [3.3, 5.8],
                colour: [184.0, 184.0, 181.0],
                pattern: Pattern::GraphPaper {
                    lines: vec![
                        Lines { pitch_mm: 1.0, width_mm: 0.06, colour: [160.0, 170.0, 178.0] },
                        Lines { pitch_mm: 5.0, width_mm: 0.10, colour: [137.0, 157.0, 176.0] },
                        Lines { pitch_mm: 10.0, width_mm: 0.18, colour: [118.0, 146.0, 175.0] },
                    ],
                },
                stains: Vec::new(),
            },
            light: Light {
                towards_lamp: [0.3, -0.8, 0.35],
                ambient: 0.45,
                gradient: [0.0, 0.0],
                vignetting: 0.0,
                shadow: 0.0,
                shadow_blur_mm: 1.0,
            },
            sensor: Sensor { rays_per_pixel: 16, blur_px: 0.5, noise: 0.0 },
            wires: Vec::new(),
        }
    }
}

impl Scene {
    /// Distance of the grid's lines, mm: the finest, or a checkerboard's squares.
    ///
    /// # Errors
    /// [`Error::Scene`] for blank paper.
    pub fn grid_pitch_mm(&self) -> Result<f64> {
        let pitch = match &self.paper.pattern {
            Pattern::GraphPaper { lines } => lines.iter().map(|lines| lines.pitch_mm).reduce(f64::min),
            Pattern::Checkerboard { square_mm, .. } => Some(*square_mm),
            Pattern::Blank => None,
        };
        pitch.ok_or_else(|| {
            Error::Scene("an experiment needs a grid: paper.pattern must be graph paper or a checkerboard")
        })
    }

    /// Reads a scene file.
    ///
    /// # Errors
    /// A file that cannot be read, is no scene, or describes one that cannot be drawn ([`check`](Self::check)).
    pub fn read(path: &Path) -> Result<Self> {
        let text = read_text(path)?;
        let scene: Self = toml::from_str(&text).map_err(|e| {
            let before = e.span().map_or(0, |span| span.start.min(text.len()));
            let line = 1 + text.bytes().take(before).filter(|&b| b == b'\n').count() as u64;
            Error::at_line(path, line, format!("not a scene: {}", e.message()))
        })?;
        scene.check().map_err(|e| Error::content(path, e.to_string()))?;
        Ok(scene)
    }

    /// The scene file's text.
    ///
    /// # Errors
    /// [`Error::Encode`] where a number of the scene has no place in TOML.
    pub fn to_toml(&self) -> Result<String> {
        toml::to_string(self).map_err(Error::encode("the scene"))
    }

    /// The bend along the snake when its tip has this bend.
    pub fn profile(&self, tip: Configuration) -> BendProfile {
        let in_base = |pair_deg: [f64; 2]| Rotation2::new(tip.delta) * Vector2::from(pair_deg).map(f64::to_radians);
        let mut modes = self.modes_deg.map(in_base);
        modes[0] -= in_base(self.departure_deg) / 4.0;
        BendProfile { tip: tip.bend_vector(), modes }
    }

    /// Whether the scene can be drawn.
    ///
    /// # Errors
    /// [`Error::Scene`] that names the first quantity which makes no picture.
    pub fn check(&self) -> Result<()> {
        let pixels = u64::from(self.lens.width) * u64::from(self.lens.height);
        let rules = [
            ((1..=100_000_000).contains(&pixels), "lens: the picture must have 1 to 100 million pixels"),
            (self.lens.focal_px.min() > 0.0, "lens.focal_px must be positive"),
            (self.robot.length_mm > 0.0, "robot.length_mm must be positive"),
            (self.robot.body.disk_thickness_mm > 0.0, "robot.body.disk_thickness_mm must be positive"),
            (self.departure_deg.iter().all(|e| e.abs() <= 90.0), "departure_deg must be −90 to 90"),
            (self.modes_deg.as_flattened().iter().all(|a| a.abs() <= 45.0), "modes_deg must be −45 to 45"),
            (self.paper.standoff_mm > 0.0, "paper.standoff_mm must be positive"),
            (
                self.sensor.rays_per_pixel.is_power_of_two() && self.sensor.rays_per_pixel <= 4096,
                "sensor.rays_per_pixel must be a power of two, 1 to 4096",
            ),
            ((0.0..=50.0).contains(&self.sensor.blur_px), "sensor.blur_px must be 0 to 50"),
            ((0.0..=255.0).contains(&self.sensor.noise), "sensor.noise must be 0 to 255"),
            ((0.0..=20.0).contains(&self.light.shadow_blur_mm), "light.shadow_blur_mm must be 0 to 20"),
            (Vector3::from(self.light.towards_lamp).norm() > 0.0, "light.towards_lamp must have a direction"),
        ];
        match rules.iter().find(|(holds, _)| !holds) {
            Some((_, rule)) => Err(Error::Scene(rule)),
            None => Ok(()),
        }
    }
}

fn is_zero(pair: &[f64; 2]) -> bool {
    *pair == [0.0; 2]
}

fn are_zero(pairs: &[[f64; 2]; MODES]) -> bool {
    pairs.iter().all(is_zero)
}

/// A lens as a table of plain numbers.
mod lens_as_table {
    use super::{Lens, Point2, Vector2};
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    #[derive(Serialize, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Table {
        width: u32,
        height: u32,
        focal_px: [f64; 2],
        centre_px: [f64; 2],
        distortion: [f64; 12],
    }

    pub fn serialize<S: Serializer>(lens: &Lens, serializer: S) -> Result<S::Ok, S::Error> {
        let Lens { width, height, distortion, .. } = *lens;
        Table { width, height, focal_px: lens.focal_px.into(), centre_px: lens.centre_px.into(), distortion }
            .serialize(serializer)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Lens, D::Error> {
        let Table { width, height, focal_px, centre_px, distortion } = Table::deserialize(deserializer)?;
        let (focal_px, centre_px) = (Vector2::from(focal_px), Point2::from(centre_px));
        Ok(Lens { width, height, focal_px, centre_px, distortion, fisheye: None })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_abs_diff_eq;
    use nalgebra::Point3;
    use proptest::prelude::*;

    #[test]
    fn an_upright_view_has_the_design_s_axes() {
        let view = Viewpoint { yaw_deg: 0.0, pitch_deg: 0.0, roll_deg: 0.0, base_mm: [0.0, 0.0, 200.0] };
        let pose = view.camera_from_base();
        assert_abs_diff_eq!(pose * Vector3::x(), Vector3::x(), epsilon = 1e-15); // to the image's right
        assert_abs_diff_eq!(pose * Vector3::y(), Vector3::z(), epsilon = 1e-15); // away from the camera
        assert_abs_diff_eq!(pose * Vector3::z(), -Vector3::y(), epsilon = 1e-15); // up
        assert_abs_diff_eq!(pose * Point3::origin(), Point3::new(0.0, 0.0, 200.0), epsilon = 1e-15);
    }

    #[test]
    fn turns_go_the_way_the_docs_say() {
        let depth = |view: Viewpoint, point: Vector3<f64>| (view.camera_from_base() * point).z;
        let still = Viewpoint { yaw_deg: 0.0, pitch_deg: 0.0, roll_deg: 0.0, base_mm: [0.0, 0.0, 200.0] };
        assert!(depth(Viewpoint { yaw_deg: 5.0, ..still }, Vector3::x()) < 0.0);
        assert!(depth(Viewpoint { pitch_deg: 5.0, ..still }, Vector3::z()) < 0.0);
        let right = Viewpoint { roll_deg: 5.0, ..still }.camera_from_base() * Vector3::x();
        assert!(right.y > 0.0, "clockwise: what was right goes down");
    }

    #[test]
    fn a_scene_survives_its_file() {
        let mut scene = Scene::default();
        scene.paper.stains.push(Stain { centre_mm: [1.0, 2.0], radius_mm: 3.0, colour: [200.0, 180.0, 120.0] });
        scene.wires.push(Wire { from_px: [0.0, 1.0], to_px: [5.0, 7.5], width_px: 4.0, colour: [10.0, 20.0, 30.0] });
        for pattern in [
            scene.paper.pattern.clone(),
            Pattern::Blank,
            Pattern::Checkerboard { square_mm: 2.0, colour: [10.0, 10.0, 10.0] },
        ] {
            scene.paper.pattern = pattern;
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("scene.toml");
            std::fs::write(&path, scene.to_toml().unwrap()).unwrap();
            assert_eq!(Scene::read(&path).unwrap(), scene);
        }
    }

    #[test]
    fn the_book_has_the_default_scene_and_all_that_may_be_added_to_it() {
        let page = include_str!("../../docs/src/reference/scene.md");
        let mut blocks = page.split("```toml\n").skip(1).map(|rest| rest.split("```").next().unwrap());
        let (whole, added) = (blocks.next().unwrap(), blocks.next().unwrap());
        assert_eq!(toml::from_str::<Scene>(whole).unwrap(), Scene::default());
        let (shape, tables) = added.split_once("\n[[").unwrap();
        let scene: Scene = toml::from_str(&format!("{shape}\n{whole}\n[[{tables}")).unwrap();
        scene.check().unwrap();
        assert_eq!((scene.paper.stains.len(), scene.wires.len()), (1, 1));
    }

    #[test]
    fn a_wrong_scene_file_is_told_apart() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.toml");
        let text = Scene::default().to_toml().unwrap();
        for (from, to, expected) in [
            ("ambient = 0.45", "ambient = \"much\"", "not a scene"),
            ("ambient = 0.45", "ambience = 0.45", "ambience"),
            ("rays_per_pixel = 16", "rays_per_pixel = 15", "power of two"),
            ("length_mm = 26.0", "length_mm = nan", "robot.length_mm must be positive"),
        ] {
            assert!(text.contains(from), "{from} in {text}");
            std::fs::write(&path, text.replacen(from, to, 1)).unwrap();
            let message = Scene::read(&path).unwrap_err().to_string();
            assert!(message.contains(expected), "expected {expected:?}, got {message:?}");
        }
    }

    proptest! {
        #[test]
        fn a_viewpoint_survives_its_pose(
            yaw_deg in -179.0..179.0, pitch_deg in -80.0..80.0, roll_deg in -179.0..179.0,
            base_mm in proptest::array::uniform3(-300.0..300.0f64),
        ) {
            let view = Viewpoint { yaw_deg, pitch_deg, roll_deg, base_mm };
            let back = Viewpoint::from_pose(&view.camera_from_base());
            prop_assert!((back.yaw_deg - yaw_deg).abs() < 1e-9);
            prop_assert!((back.pitch_deg - pitch_deg).abs() < 1e-9);
            prop_assert!((back.roll_deg - roll_deg).abs() < 1e-9);
            prop_assert_eq!(back.base_mm, base_mm);
        }
    }
}
