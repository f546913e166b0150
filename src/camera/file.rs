//! Camera files: OpenCV's FileStorage YAML and ROS `camera_info` YAML.
//!
//! Both keep the same four things under the same names: `image_width`, `image_height`, `camera_matrix` (3×3) and
//! `distortion_coefficients` (k1 k2 p1 p2 \[k3 \[k4 k5 k6 \[s1 s2 s3 s4\]\]\]). ROS adds `distortion_model`.

use super::Lens;
use crate::error::{Error, Result};
use nalgebra::{Point2, Vector2};
use saphyr::{LoadableYamlNode, MarkedYaml, Scalar, YamlData};
use std::fmt::Write as _;
use std::path::Path;

impl Lens {
    /// Reads a camera file.
    ///
    /// # Errors
    /// A file that cannot be read, is no YAML, lacks one of the four keys, or holds something in them that is no
    /// camera of this model: another shape, a skewed or non-finite matrix, a fisheye `distortion_model`.
    pub fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(Error::io(path, "read"))?;
        Self::from_yaml(path, &text)
    }

    /// The camera file's text; `path` is for error messages only.
    fn from_yaml(path: &Path, text: &str) -> Result<Self> {
        let documents = MarkedYaml::load_from_str(&without_directive(text)).map_err(|e| {
            Error::at_line(path, e.marker().line() as u64, format!("not a YAML camera file: {}", e.info()))
        })?;
        let file = CameraFile {
            path,
            root: documents.first().ok_or_else(|| Error::content(path, "empty; expected a camera file"))?,
        };

        file.check_distortion_model()?;
        let (width, height) = (file.size("image_width")?, file.size("image_height")?);
        let matrix = file.numbers("camera_matrix")?;
        let [fx, skew, cx, z0, fy, cy, z1, z2, one] = <[f64; 9]>::try_from(matrix.as_slice())
            .map_err(|_| file.error("camera_matrix", format!("{} numbers, expected 9 (3×3)", matrix.len())))?;
        if [skew, z0, z1, z2, one] != [0.0, 0.0, 0.0, 0.0, 1.0] || fx <= 0.0 || fy <= 0.0 {
            let expected = "expected [fx, 0, cx, 0, fy, cy, 0, 0, 1] with positive fx, fy";
            return Err(file.error("camera_matrix", format!("{matrix:?}, {expected}")));
        }
        let coefficients = file.numbers("distortion_coefficients")?;
        if ![4, 5, 8, 12].contains(&coefficients.len()) {
            let message = format!("{} numbers, expected 4, 5, 8 or 12", coefficients.len());
            return Err(file.error("distortion_coefficients", message));
        }
        let mut distortion = [0.0; 12];
        distortion[..coefficients.len()].copy_from_slice(&coefficients);

        Ok(Self { width, height, focal_px: Vector2::new(fx, fy), centre_px: Point2::new(cx, cy), distortion })
    }

    /// The camera file's text, as OpenCV's FileStorage writes and reads it, with as few distortion coefficients (5, 8
    /// or 12) as hold all that are not zero. Numbers survive the round trip exactly.
    pub fn to_opencv_yaml(&self) -> String {
        let used = self.distortion.iter().rposition(|&k| k != 0.0).map_or(0, |last| last + 1);
        let count = [5, 8, 12].into_iter().find(|&n| n >= used).unwrap_or(12);
        let Self { focal_px: f, centre_px: c, .. } = self;
        let mut text = format!("%YAML:1.0\n---\nimage_width: {}\nimage_height: {}\n", self.width, self.height);
        push_matrix(&mut text, "camera_matrix", 3, 3, &[f.x, 0.0, c.x, 0.0, f.y, c.y, 0.0, 0.0, 1.0]);
        push_matrix(&mut text, "distortion_coefficients", 1, count, &self.distortion[..count]);
        text
    }
}

fn push_matrix(text: &mut String, key: &str, rows: usize, cols: usize, values: &[f64]) {
    let values: Vec<String> = values.iter().map(|v| format!("{v:?}")).collect();
    let data = values.join(", ");
    // Writing to a String cannot fail.
    let _ = write!(text, "{key}: !!opencv-matrix\n   rows: {rows}\n   cols: {cols}\n   dt: d\n   data: [ {data} ]\n");
}

/// The text with a leading `%YAML:1.0` or `%YAML 1.2` line blanked: the first is OpenCV's own and not YAML.
fn without_directive(text: &str) -> String {
    let text = text.trim_start_matches('\u{feff}');
    match text.split_once('\n') {
        Some((first, rest)) if first.starts_with("%YAML") => format!("\n{rest}"),
        _ => text.to_owned(),
    }
}

/// A parsed file and its path, so that every complaint can name file, line and key.
struct CameraFile<'a> {
    path: &'a Path,
    root: &'a MarkedYaml<'a>,
}

impl<'a> CameraFile<'a> {
    fn error(&self, key: &str, found: impl std::fmt::Display) -> Error {
        let message = format!("{key}: {found}");
        match self.find(key) {
            Some(node) => Error::at_line(self.path, node.span.start.line() as u64, message),
            None => Error::content(self.path, message),
        }
    }

    fn find(&self, key: &str) -> Option<&'a MarkedYaml<'a>> {
        member(self.root, key)
    }

    fn get(&self, key: &str) -> Result<&'a MarkedYaml<'a>> {
        self.find(key).ok_or_else(|| self.error(key, "missing; is this a camera file?"))
    }

    /// A picture's width or height.
    fn size(&self, key: &str) -> Result<u32> {
        let value = number(self.get(key)?);
        match value {
            Some(value) if value.fract() == 0.0 && (1.0..=100_000.0).contains(&value) => Ok(value as u32),
            _ => Err(self.error(key, "expected a whole number of pixels, at least 1")),
        }
    }

    /// The elements of a matrix `{rows, cols, data}`, row by row.
    fn numbers(&self, key: &str) -> Result<Vec<f64>> {
        let node = self.get(key)?;
        let data = member(node, "data").and_then(|data| match &untagged(data).data {
            YamlData::Sequence(items) => Some(items),
            _ => None,
        });
        let Some(data) = data else { return Err(self.error(key, "no list `data`; expected {rows, cols, data}")) };
        let values: Option<Vec<f64>> = data.iter().map(|item| number(item).filter(|v| v.is_finite())).collect();
        let Some(values) = values else {
            return Err(self.error(key, "`data` holds something that is no finite number"));
        };
        let count = |name| member(node, name).and_then(number);
        if let (Some(rows), Some(cols)) = (count("rows"), count("cols"))
            && rows * cols != values.len() as f64
        {
            return Err(self.error(key, format!("{} numbers for {rows} rows × {cols} columns", values.len())));
        }
        Ok(values)
    }

    /// ROS names its model; of these two the coefficients mean what OpenCV's do.
    fn check_distortion_model(&self) -> Result<()> {
        let Some(node) = self.find("distortion_model") else { return Ok(()) };
        match &untagged(node).data {
            YamlData::Value(Scalar::String(name)) if ["plumb_bob", "rational_polynomial"].contains(&name.as_ref()) => {
                Ok(())
            }
            other => {
                let found = match other {
                    YamlData::Value(Scalar::String(name)) => name.to_string(),
                    _ => "not a name".to_owned(),
                };
                Err(self.error("distortion_model", format!("{found}, expected plumb_bob or rational_polynomial")))
            }
        }
    }
}

/// The node below its tags: `!!opencv-matrix {…}` is `{…}`.
fn untagged<'a>(node: &'a MarkedYaml<'a>) -> &'a MarkedYaml<'a> {
    match &node.data {
        YamlData::Tagged(_, inner) => untagged(inner),
        _ => node,
    }
}

fn member<'a>(node: &'a MarkedYaml<'a>, key: &str) -> Option<&'a MarkedYaml<'a>> {
    match &untagged(node).data {
        YamlData::Mapping(entries) => entries.iter().find_map(|(k, value)| match &k.data {
            YamlData::Value(Scalar::String(name)) if name == key => Some(value),
            _ => None,
        }),
        _ => None,
    }
}

fn number(node: &MarkedYaml) -> Option<f64> {
    match &untagged(node).data {
        YamlData::Value(Scalar::Integer(value)) => Some(*value as f64),
        YamlData::Value(Scalar::FloatingPoint(value)) => Some(value.into_inner()),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn parse(text: &str) -> Result<Lens> {
        Lens::from_yaml(Path::new("camera.yaml"), text)
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
            ("image_width: 1280", "", "camera.yaml: image_width: missing"),
            ("image_height: 720", "image_height: 720.5", "camera.yaml:5: image_height: expected a whole number"),
            ("image_height: 720", "image_height: -1", "camera.yaml:5: image_height: expected a whole number"),
            ("0., 0., 1. ]", "0., 1. ]", "camera_matrix: 8 numbers for 3 rows × 3 columns"),
            ("data: [ 4861.2826321440971, 0.,", "data: [ 4861.2826321440971, .NaN,", "no finite number"),
            ("data: [ 4861.2826321440971, 0.,", "data: [ 4861.2826321440971, 0.5,", "expected [fx, 0, cx"),
            ("data: [ 4861.2826321440971, 0.,", "data: [ x, 0.,", "no finite number"),
            ("   cols: 5", "   cols: 4", "distortion_coefficients: 5 numbers for 1 rows × 4 columns"),
            ("image_width:", "distortion_model: equidistant\nimage_width:", "equidistant, expected plumb_bob"),
            ("data: [ -0.1", "data: [ -0.1, [", "not a YAML camera file"),
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
        assert!(message.contains("7 numbers, expected 4, 5, 8 or 12"), "{message}");
    }

    #[test]
    fn a_missing_file_is_named() {
        let message = Lens::read(Path::new("no/such.yaml")).unwrap_err().to_string();
        assert!(message.starts_with("no/such.yaml: cannot read"), "{message}");
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
                centre_px: Point2::new(centre.0, centre.1), distortion,
            };
            prop_assert_eq!(parse(&lens.to_opencv_yaml()).unwrap(), lens);
        }

        #[test]
        fn no_text_panics(text in "\\PC*") {
            let _ = parse(&text);
        }
    }
}
