//! Camera files: OpenCV's FileStorage, YAML and XML, and ROS `camera_info` YAML.
//!
//! All keep the same four things under the same names: `image_width`, `image_height`, `camera_matrix` (3×3) and
//! `distortion_coefficients` (k1 k2 p1 p2 \[k3 \[k4 k5 k6 \[s1 s2 s3 s4\]\]\]). ROS adds `distortion_model`.

mod xml;
mod yaml;

use super::Lens;
use crate::error::{Error, Result};
use crate::input::read_text;
use nalgebra::{Point2, Vector2};
use std::path::Path;

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
    /// Reads a camera file of any of the three kinds; its content tells which, not its name.
    ///
    /// # Errors
    /// A file that cannot be read, is neither YAML nor XML, lacks one of the four keys, or holds something in them that is
    /// no camera of this model: another shape, a skewed or non-finite matrix, a fisheye `distortion_model`.
    pub fn read(path: &Path) -> Result<Self> {
        let text = read_text(path)?;
        Self::parse(path, &text)
    }

    /// The camera file's text; `path` is for error messages only.
    fn parse(path: &Path, text: &str) -> Result<Self> {
        let text = text.trim_start_matches('\u{feff}');
        let entries = if text.trim_start().starts_with('<') { xml::entries(text) } else { yaml::entries(text) };
        let entries = entries.map_err(|NotAFile { line, message }| Error::at_line(path, line, message))?;
        let file = CameraFile { path, entries };

        file.check_distortion_model()?;
        let (width, height) = (file.size("image_width")?, file.size("image_height")?);
        let matrix = file.numbers("camera_matrix")?;
        let [fx, skew, cx, z0, fy, cy, z1, z2, one] = <[f64; 9]>::try_from(matrix)
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
        distortion[..coefficients.len()].copy_from_slice(coefficients);

        Ok(Self { width, height, focal_px: Vector2::new(fx, fy), centre_px: Point2::new(cx, cy), distortion })
    }

    /// The camera file's text, with as few distortion coefficients (5, 8 or 12) as hold all that are not zero. Numbers
    /// survive the round trip exactly.
    pub fn to_file(&self, format: CameraFormat) -> String {
        let used = self.distortion.iter().rposition(|&k| k != 0.0).map_or(0, |last| last + 1);
        let count = [5, 8, 12].into_iter().find(|&n| n >= used).unwrap_or(12);
        let coefficients = &self.distortion[..count];
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

/// Numbers with as many digits as tell them apart, between separators.
fn joined(values: &[f64], separator: &str) -> String {
    values.iter().map(|v| format!("{v:?}")).collect::<Vec<_>>().join(separator)
}

/// Why a text is no YAML or XML at all.
struct NotAFile {
    line: u64,
    message: String,
}

/// What a file says under one key of its top level.
struct Entry {
    key: String,
    line: u64,
    value: Value,
}

enum Value {
    Number(f64),
    Text(String),
    Matrix {
        /// How many rows and columns it says that it has.
        shape: Option<(f64, f64)>,
        /// Its elements, row by row; `None` where one of them is no finite number.
        data: Option<Vec<f64>>,
    },
    Other,
}

/// A parsed file and its path, so that every complaint can name file, line and key.
struct CameraFile<'a> {
    path: &'a Path,
    entries: Vec<Entry>,
}

impl CameraFile<'_> {
    fn error(&self, key: &str, found: impl std::fmt::Display) -> Error {
        let message = format!("{key}: {found}");
        match self.find(key) {
            Some(entry) => Error::at_line(self.path, entry.line, message),
            None => Error::content(self.path, message),
        }
    }

    fn find(&self, key: &str) -> Option<&Entry> {
        self.entries.iter().find(|entry| entry.key == key)
    }

    fn get(&self, key: &str) -> Result<&Value> {
        let missing = || self.error(key, "missing; is this a camera file?");
        self.find(key).map(|entry| &entry.value).ok_or_else(missing)
    }

    /// A picture's width or height.
    fn size(&self, key: &str) -> Result<u32> {
        match *self.get(key)? {
            Value::Number(value) if value.fract() == 0.0 && (1.0..=100_000.0).contains(&value) => Ok(value as u32),
            _ => Err(self.error(key, "expected a whole number of pixels, at least 1")),
        }
    }

    /// The elements of a matrix, row by row.
    fn numbers(&self, key: &str) -> Result<&[f64]> {
        let Value::Matrix { shape, data } = self.get(key)? else {
            return Err(self.error(key, "no list `data`; expected rows, cols and data"));
        };
        let Some(data) = data else {
            return Err(self.error(key, "`data` holds something that is no finite number"));
        };
        if let Some((rows, cols)) = shape
            && rows * cols != data.len() as f64
        {
            return Err(self.error(key, format!("{} numbers for {rows} rows × {cols} columns", data.len())));
        }
        Ok(data)
    }

    /// ROS names its model; of these two the coefficients mean what OpenCV's do.
    fn check_distortion_model(&self) -> Result<()> {
        let found = match self.find("distortion_model").map(|entry| &entry.value) {
            None => return Ok(()),
            Some(Value::Text(name)) if ["plumb_bob", "rational_polynomial"].contains(&name.as_str()) => return Ok(()),
            Some(Value::Text(name)) => name,
            Some(_) => "not a name",
        };
        Err(self.error("distortion_model", format!("{found}, expected plumb_bob or rational_polynomial")))
    }
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
            ("image_width: 1280", "", "camera.yaml: image_width: missing"),
            ("image_height: 720", "image_height: 720.5", "camera.yaml:5: image_height: expected a whole number"),
            ("image_height: 720", "image_height: -1", "camera.yaml:5: image_height: expected a whole number"),
            ("0., 0., 1. ]", "0., 1. ]", "camera_matrix: 8 numbers for 3 rows × 3 columns"),
            ("data: [ 4861.2826321440971, 0.,", "data: [ 4861.2826321440971, .NaN,", "no finite number"),
            ("data: [ 4861.2826321440971, 0.,", "data: [ 4861.2826321440971, 0.5,", "expected [fx, 0, cx"),
            ("data: [ 4861.2826321440971, 0.,", "data: [ x, 0.,", "no finite number"),
            ("   cols: 5", "   cols: 4", "distortion_coefficients: 5 numbers for 1 rows × 4 columns"),
            ("image_width:", "distortion_model: equidistant\nimage_width:", "equidistant, expected plumb_bob"),
            ("data: [ -0.1", "data: [ -0.1, [", "neither a YAML nor an XML camera file"),
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
            ("<image_width>1280</image_width>\n", "", "camera.yaml: image_width: missing"),
            (">720<", ">seven<", "camera.yaml:5: image_height: expected a whole number"),
            ("<rows>3", "<rows>4", "camera.yaml:6: camera_matrix: 9 numbers for 4 rows × 3 columns"),
            ("0. 639.5", ".Nan 639.5", "camera.yaml:6: camera_matrix: `data` holds something that is no finite"),
            ("0. 639.5", "0.5 639.5", "expected [fx, 0, cx"),
            ("<data>\n    4861", "<dat>\n    4861", "neither a YAML nor an XML camera file"),
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
                centre_px: Point2::new(centre.0, centre.1), distortion,
            };
            for format in [CameraFormat::OpenCvYaml, CameraFormat::OpenCvXml, CameraFormat::Ros] {
                prop_assert_eq!(&parse(&lens.to_file(format)).unwrap(), &lens);
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
