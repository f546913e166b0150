//! Camera files: OpenCV's FileStorage in YAML and XML, ROS `camera_info` and its messages as text, and what other programs write in YAML, JSON or
//! TOML.
//!
//! Whatever the file, it is read into one tree ([`tree`]), and the numbers of a camera are found in it by the names that programs give them
//! ([`names`]).

mod names;
mod tree;
mod xml;
mod yaml;

use super::Lens;
use crate::content;
use crate::error::{ArgumentError, Error, Result};
use crate::input::{SETTINGS_BYTES, read_bytes, text_in};
use nalgebra::{Point2, Vector2};
pub(super) use names::FISHEYES;
use names::{Camera, Found};
use serde::Deserialize;
use std::path::Path;
use tree::Node;

/// A camera as experiment.toml may hold it: `{ K = [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], dist = [k1, k2, p1, p2, k3], size = [width, height] }`.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraNumbers {
    /// The camera matrix, by rows.
    #[serde(rename = "K")]
    pub matrix: [[f64; 3]; 3],
    /// The distortion coefficients in OpenCV's order; none where it is left out.
    #[serde(default)]
    pub dist: Vec<f64>,
    /// Width and height of the pictures, px.
    pub size: [u32; 2],
    /// Whether the coefficients are those of OpenCV's fisheye.
    #[serde(default)]
    pub fisheye: bool,
}

/// The kinds of camera files that can be written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CameraFormat {
    /// OpenCV's FileStorage in YAML.
    OpenCvYaml,
    /// OpenCV's FileStorage in XML.
    OpenCvXml,
    /// ROS `camera_info` YAML, as its package `camera_calibration` writes it.
    Ros,
}

impl Lens {
    /// Reads a camera file; its content tells of which kind it is, not its name.
    ///
    /// # Errors
    /// A file that cannot be read, is no text of these kinds, holds no camera or several, or one that is not of this model: a skewed or
    /// non-finite matrix, another number of coefficients, another distortion model. What is missing is told with the keys that were found.
    pub fn read(path: &Path) -> Result<Self> {
        let bytes = read_bytes(path, SETTINGS_BYTES)?;
        if let Some(found) = content::name_of(&bytes) {
            let message = format!(
                "{found}, expected a camera file as text; write the numbers into experiment.toml: camera = {{ K = [[fx, 0, cx], [0, fy, cy], \
                 [0, 0, 1]], dist = [k1, k2, p1, p2, k3], size = [width, height] }}"
            );
            return Err(Error::content(path, message));
        }
        Self::parse(path, &text_in(&bytes))
    }

    /// The camera file's text; `path` is for error messages only.
    fn parse(path: &Path, text: &str) -> Result<Self> {
        let text = text.trim_start_matches('\u{feff}');
        let tree = Node::parse(text).map_err(|tree::NotAFile { line, message }| Error::at_line(path, line, message))?;
        let camera = Camera::find(&tree);
        let lens = camera.and_then(|camera| Self::of_camera(&camera));
        lens.map_err(|wrong| wrong.error(path, text, &tree))
    }

    fn of_camera(camera: &Camera) -> std::result::Result<Self, names::Wrong> {
        let Found { key, value: [width, height] } = camera.size()?;
        let size = |pixels: f64| match pixels {
            pixels if pixels.fract() == 0.0 && (1.0..=100_000.0).contains(&pixels) => Ok(pixels as u32),
            _ => Err(names::Wrong::at(&key, "expected a whole number of pixels, at least 1")),
        };
        let (width, height) = (size(width)?, size(height)?);
        let is_fisheye = camera.is_fisheye()?;
        let Found { key: of_matrix, value: matrix } = camera.matrix()?;
        let Found { key: of_distortion, value: coefficients } = camera.distortion()?;
        let lens = Self::of_parts((width, height), matrix, &coefficients, is_fisheye);
        let lens = lens.map_err(|wrong| match wrong {
            WrongPart::Matrix(why) => names::Wrong::at(&of_matrix, why),
            WrongPart::Distortion(why) => names::Wrong::at(&of_distortion, why),
        })?;
        lens.windowed(&camera.window()?).map_err(|why| names::Wrong::at("roi", why))
    }

    /// A lens from its numbers, as experiment.toml may hold them.
    ///
    /// # Errors
    /// [`ArgumentError::Camera`]: a matrix that is skewed or no camera's, another number of coefficients, a size of nothing.
    pub fn of_numbers(numbers: &CameraNumbers) -> Result<Self> {
        let [width, height] = numbers.size;
        let matrix = [numbers.matrix[0], numbers.matrix[1], numbers.matrix[2]].concat();
        let matrix = <[f64; 9]>::try_from(matrix).unwrap_or_default();
        let wrong = |why: String| ArgumentError::Camera(why).into();
        if width == 0 || height == 0 {
            return Err(wrong(format!("size = [{width}, {height}], expected width and height in pixels")));
        }
        Self::of_parts((width, height), matrix, &numbers.dist, numbers.fisheye).map_err(|part| match part {
            WrongPart::Matrix(why) => wrong(format!("K: {why}")),
            WrongPart::Distortion(why) => wrong(format!("dist: {why}")),
        })
    }

    /// A lens from its size, px, its matrix by rows, and its coefficients in OpenCV's order, the fisheye's where it is one.
    ///
    /// # Errors
    /// Which part is none of these models, and why.
    pub(super) fn of_parts(
        (width, height): (u32, u32),
        matrix: [f64; 9],
        coefficients: &[f64],
        is_fisheye: bool,
    ) -> std::result::Result<Self, WrongPart> {
        let [fx, skew, cx, z0, fy, cy, z1, z2, one] = matrix;
        let is_plain = [skew, z0, z1, z2, one] == [0.0, 0.0, 0.0, 0.0, 1.0];
        if !is_plain || !matrix.iter().all(|value| value.is_finite()) || fx <= 0.0 || fy <= 0.0 {
            let expected = "expected [fx, 0, cx, 0, fy, cy, 0, 0, 1] with positive fx, fy";
            return Err(WrongPart::Matrix(format!("{matrix:?}, {expected}")));
        }
        if !coefficients.iter().all(|value| value.is_finite()) {
            return Err(WrongPart::Distortion(format!("{coefficients:?}, expected finite numbers")));
        }
        let (focal_px, centre_px) = (Vector2::new(fx, fy), Point2::new(cx, cy));
        let lens = Self { width, height, focal_px, centre_px, distortion: [0.0; 12], fisheye: None };
        if is_fisheye {
            let four = <[f64; 4]>::try_from(coefficients);
            let wrong =
                || WrongPart::Distortion(format!("{} numbers, expected the 4 of a fisheye", coefficients.len()));
            return Ok(Self { fisheye: Some(four.map_err(|_| wrong())?), ..lens });
        }
        Ok(Self { distortion: standard(coefficients).map_err(WrongPart::Distortion)?, ..lens })
    }

    /// The camera file's text, with as few distortion coefficients (5, 8 or 12) as hold all that are not zero. Numbers
    /// survive the round trip exactly.
    pub fn to_file(&self, format: CameraFormat) -> String {
        let used = self.distortion.iter().rposition(|&k| k != 0.0).map_or(0, |last| last + 1);
        let count = [5, 8, 12].into_iter().find(|&n| n >= used).unwrap_or(12);
        let coefficients = self.fisheye.as_ref().map_or(&self.distortion[..count], |fisheye| &fisheye[..]);
        match format {
            CameraFormat::OpenCvYaml => yaml::opencv(self, coefficients),
            CameraFormat::OpenCvXml => xml::opencv(self, coefficients),
            CameraFormat::Ros => yaml::ros(self, coefficients),
        }
    }

    /// The camera matrix, row by row.
    fn matrix(&self) -> [f64; 9] {
        let Self { focal_px: f, centre_px: c, .. } = self;
        [f.x, 0.0, c.x, 0.0, f.y, c.y, 0.0, 0.0, 1.0]
    }
}

/// The twelve coefficients that these stand for.
fn standard(coefficients: &[f64]) -> std::result::Result<[f64; 12], String> {
    if ![0, 4, 5, 8, 12, 14].contains(&coefficients.len()) {
        return Err(format!("{} numbers, expected 0, 4, 5, 8, 12 or 14", coefficients.len()));
    }
    let tilt = coefficients.get(12..).unwrap_or_default();
    if tilt.iter().any(|&angle| angle != 0.0) {
        return Err(format!(
            "a tilted sensor (the last two of 14 coefficients are {tilt:?}), which is not read; calibrate without CALIB_TILTED_MODEL"
        ));
    }
    let mut distortion = [0.0; 12];
    let count = coefficients.len().min(12);
    distortion[..count].copy_from_slice(&coefficients[..count]);
    Ok(distortion)
}

/// Numbers with as many digits as tell them apart, between separators.
fn joined(values: &[f64], separator: &str) -> String {
    values.iter().map(|v| format!("{v:?}")).collect::<Vec<_>>().join(separator)
}

/// Which part of a camera is not of this model, and why.
pub(super) enum WrongPart {
    /// The camera matrix.
    Matrix(String),
    /// The distortion coefficients.
    Distortion(String),
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn parse(text: &str) -> Result<Lens> {
        Lens::parse(Path::new("camera.yaml"), text)
    }

    /// As OpenCV 4.6's FileStorage writes it.
    const OPENCV: &str = "%YAML:1.0
---
calibration_time: \"Tue May  5 11:00:00 2026\"
image_width: 1280
image_height: 720
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 4861.2826321440971, 0., 639.5, 0., 4861.2826321440971, 359.5,
       0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ -0.10000000000000001, 0.029999999999999999,
       4.0000000000000002e-04, 5.9999999999999995e-04, 0. ]
";

    /// As ROS's camera_calibration package writes it.
    const ROS: &str = "image_width: 640
image_height: 480
camera_name: narrow_stereo
camera_matrix:
  rows: 3
  cols: 3
  data: [438.5, 0, 305.5, 0, 437.25, 243.75, 0, 0, 1]
distortion_model: rational_polynomial
distortion_coefficients:
  rows: 1
  cols: 8
  data: [-0.36, 0.12, 0.001, -0.0005, 0.01, 0.02, 0.03, 0.04]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
";

    #[test]
    fn reads_opencv_yaml_of_either_header() {
        for text in [OPENCV.to_owned(), OPENCV.replace("%YAML:1.0", "%YAML 1.2"), OPENCV.replace("%YAML:1.0\n", "")] {
            let lens = parse(&text).unwrap();
            assert_eq!((lens.width, lens.height), (1280, 720));
            assert_eq!(lens.focal_px, Vector2::new(4861.282632144097, 4861.282632144097));
            assert_eq!(lens.centre_px, Point2::new(639.5, 359.5));
            assert_eq!(lens.distortion[..6], [-0.1, 0.03, 0.0004, 0.0006, 0.0, 0.0]);
        }
    }

    #[test]
    fn reads_ros_camera_info() {
        let lens = parse(ROS).unwrap();
        assert_eq!(lens.focal_px, Vector2::new(438.5, 437.25));
        assert_eq!(lens.distortion, [-0.36, 0.12, 0.001, -0.0005, 0.01, 0.02, 0.03, 0.04, 0.0, 0.0, 0.0, 0.0]);
    }

    #[test]
    fn complaints_name_file_line_and_key() {
        let edits = [
            ("image_width: 1280", "", "no width and height of the pictures"),
            ("image_height: 720", "image_height: 720.5", "camera.yaml:5: image_height: expected a whole number"),
            ("image_height: 720", "image_height: -1", "camera.yaml:5: image_height: expected a whole number"),
            ("0., 0., 1. ]", "0., 1. ]", "camera_matrix: 8 numbers for 3 rows × 3 columns"),
            ("data: [ 4861.2826321440971, 0.,", "data: [ 4861.2826321440971, .NaN,", "no finite number"),
            ("data: [ 4861.2826321440971, 0.,", "data: [ 4861.2826321440971, 0.5,", "expected [fx, 0, cx"),
            ("data: [ 4861.2826321440971, 0.,", "data: [ x, 0.,", "no finite number"),
            ("   cols: 5", "   cols: 4", "distortion_coefficients: 5 numbers for 1 rows × 4 columns"),
            ("image_width:", "distortion_model: fov\nimage_width:", "fov, expected plumb_bob"),
            ("data: [ -0.1", "data: [ -0.1, [", "no camera file that can be read"),
        ];
        for (from, to, expected) in edits {
            assert!(OPENCV.contains(from), "{from}");
            let message = parse(&OPENCV.replacen(from, to, 1)).unwrap_err().to_string();
            assert!(message.contains(expected), "expected {expected:?}, got {message:?}");
        }
        for text in ["", "[1, 2]", "hello", "a: &a [*a]"] {
            parse(text).unwrap_err();
        }
        let seven = "   cols: 7\n   dt: d\n   data: [ 0, 0, 0, 0, 0, 0, 0 ]\n";
        let message = parse(&(OPENCV.split_once("   cols: 5").unwrap().0.to_owned() + seven)).unwrap_err().to_string();
        assert!(message.contains("7 numbers, expected 0, 4, 5, 8, 12 or 14"), "{message}");
    }

    #[test]
    fn a_missing_file_is_named() {
        let message = Lens::read(Path::new("no/such.yaml")).unwrap_err().to_string();
        assert!(message.starts_with("no/such.yaml: cannot read"), "{message}");
    }

    /// As OpenCV 4.6's FileStorage writes it.
    const XML: &str = "<?xml version=\"1.0\"?>
<opencv_storage>
<calibration_time>\"Tue May  5 11:00:00 2026\"</calibration_time>
<image_width>1280</image_width>
<image_height>720</image_height>
<camera_matrix type_id=\"opencv-matrix\">
  <rows>3</rows>
  <cols>3</cols>
  <dt>d</dt>
  <data>
    4861.2826321440971 0. 639.5 0. 4861.2826321440971 359.5 0. 0. 1.</data></camera_matrix>
<distortion_coefficients type_id=\"opencv-matrix\">
  <rows>1</rows>
  <cols>5</cols>
  <dt>d</dt>
  <data>
    -0.10000000000000001 0.029999999999999999 4.0000000000000002e-04
    5.9999999999999995e-04 0.</data></distortion_coefficients>
</opencv_storage>
";

    #[test]
    fn xml_says_what_yaml_says() {
        for text in [XML.to_owned(), format!("\u{feff}{XML}"), XML.split_once('\n').unwrap().1.to_owned()] {
            assert_eq!(parse(&text).unwrap(), parse(OPENCV).unwrap());
        }
    }

    #[test]
    fn complaints_about_xml_name_file_line_and_key() {
        let edits = [
            ("<image_width>1280</image_width>\n", "", "no width and height of the pictures"),
            (">720<", ">seven<", "camera.yaml:5: image_height: expected a whole number"),
            ("<rows>3", "<rows>4", "camera.yaml:6: camera_matrix: 9 numbers for 4 rows × 3 columns"),
            ("0. 639.5", ".Nan 639.5", "camera.yaml:6: camera_matrix: holds something that is no finite"),
            ("0. 639.5", "0.5 639.5", "expected [fx, 0, cx"),
            ("<data>\n    4861", "<dat>\n    4861", "no camera file that can be read"),
            ("opencv_storage>", "storage>", "camera.yaml:2: <storage>, expected a camera file with <opencv_storage>"),
        ];
        for (from, to, expected) in edits {
            assert!(XML.contains(from), "{from}");
            let text = if from == "opencv_storage>" { XML.replace(from, to) } else { XML.replacen(from, to, 1) };
            let message = parse(&text).unwrap_err().to_string();
            assert!(message.contains(expected), "expected {expected:?}, got {message:?}");
        }
    }

    #[test]
    fn ros_gets_its_model_and_its_other_matrices() {
        let mut lens = parse(OPENCV).unwrap();
        let text = lens.to_file(CameraFormat::Ros);
        assert!(text.contains("distortion_model: plumb_bob\n"), "{text}");
        assert!(text.contains("rectification_matrix:\n  rows: 3\n  cols: 3\n  data: [1.0, 0.0, 0.0,"), "{text}");
        let projection = "projection_matrix:\n  rows: 3\n  cols: 4\n  data: [4861.282632144097, 0.0, 639.5, 0.0, ";
        assert!(text.contains(projection), "{text}");
        lens.distortion[7] = 0.1;
        assert!(lens.to_file(CameraFormat::Ros).contains("distortion_model: rational_polynomial\n"));
    }

    #[test]
    fn a_file_nested_without_end_is_refused_in_peace() {
        let deep = |open: &str| open.repeat(200_000);
        for open in ["[", "{a: ", "- ", "? ", "a: [", "<a>", "<opencv_storage>", "!t [", "&a [", "\n -", "a:\n "] {
            parse(&deep(open)).unwrap_err();
        }
        let indented: String = (0..3000).map(|k| format!("{}a:\n", " ".repeat(k))).collect();
        parse(&indented).unwrap_err();
    }

    #[test]
    fn what_stands_for_more_than_it_is_long_is_refused_in_peace() {
        // Each line stands for nine of the line above it; each entity for ten of the one before.
        let laughs = |k: usize| format!("l{k}: &l{k} [{}]\n", vec![format!("*l{}", k - 1); 9].join(","));
        let yaml = format!("l0: &l0 [x]\n{}", (1..12).map(laughs).collect::<String>());
        let message = parse(&yaml).unwrap_err().to_string();
        assert!(message.contains("camera.yaml:") && message.contains("alias"), "{message}");

        let entity = |k: usize| format!("<!ENTITY l{k} \"{}\">", format!("&l{};", k - 1).repeat(10));
        let entities: String = (1..12).map(entity).collect();
        let xml = format!(
            "<?xml version=\"1.0\"?>\n<!DOCTYPE o [<!ENTITY l0 \"x\">{entities}]>\n<opencv_storage>&l11;</opencv_storage>"
        );
        let message = parse(&xml).unwrap_err().to_string();
        assert!(message.contains("DTD"), "{message}");

        let many = format!("<opencv_storage>{}</opencv_storage>", "<a/>".repeat(200_000));
        let message = parse(&many).unwrap_err().to_string();
        assert!(message.contains("nodes limit"), "{message}");
        let deep = "<opencv_storage>".to_owned() + &"<a>".repeat(90_000) + &"</a>".repeat(90_000) + "</opencv_storage>";
        assert!(parse(&deep).is_err());
    }

    proptest! {
        #[test]
        fn what_is_written_is_read_back_exactly(
            size in (1u32..10_000, 1u32..10_000), focal in (1.0..1e5, 1.0..1e5), centre in (-1e4..1e4, -1e4..1e4),
            used in 0usize..=12, coefficients in proptest::array::uniform12(-1e3..1e3f64),
        ) {
            let mut distortion = [0.0; 12];
            distortion[..used].copy_from_slice(&coefficients[..used]);
            let lens = Lens {
                width: size.0, height: size.1, focal_px: Vector2::new(focal.0, focal.1),
                centre_px: Point2::new(centre.0, centre.1), distortion, fisheye: None,
            };
            let fisheye = Lens { fisheye: coefficients.first_chunk().copied(), distortion: [0.0; 12], ..lens.clone() };
            for format in [CameraFormat::OpenCvYaml, CameraFormat::OpenCvXml, CameraFormat::Ros] {
                prop_assert_eq!(&parse(&lens.to_file(format)).unwrap(), &lens);
                prop_assert_eq!(&parse(&fisheye.to_file(format)).unwrap(), &fisheye);
            }
        }

        #[test]
        fn no_text_panics(text in "\\PC*") {
            let _ = parse(&text);
            let _ = parse(&format!("<opencv_storage>{text}</opencv_storage>"));
        }

        /// A good file with a stretch of it replaced is read or refused, whatever its kind.
        #[test]
        fn no_damaged_file_panics(which in 0usize..3, at in 0usize..700, length in 0usize..40, put in "\\PC{0,8}") {
            let text = [OPENCV, ROS, XML][which];
            let (from, to) = (at.min(text.len()), (at + length).min(text.len()));
            let _ = parse(&format!("{}{put}{}", &text[..from], &text[to..]));
        }
    }
}
