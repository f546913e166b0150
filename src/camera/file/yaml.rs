//! Camera files in YAML: OpenCV's FileStorage, whose matrices are tagged, and ROS `camera_info`, whose are not.

use super::joined;
use super::tree::{Node, NotAFile};
use crate::camera::Lens;
use saphyr::{LoadableYamlNode, MarkedYaml, Scalar, YamlData};
use std::fmt::Write as _;

/// Deeper nesting is no camera file, and would let a parser that follows it run out of stack.
///
/// Convention: a limit on what is read.
const DEEPEST: usize = 100;

/// The file's first document.
pub fn tree(text: &str) -> Result<Node, NotAFile> {
    let text = without_directive(text);
    let brackets = text.bytes().filter(|b| b"[{".contains(b)).count();
    let indents = text.lines().map(|line| line.len() - line.trim_start_matches([' ', '-', '?', ':']).len()).max();
    if brackets > DEEPEST || indents > Some(DEEPEST) {
        return Err(NotAFile { line: 1, message: "nested too deeply for a camera file".into() });
    }
    let documents = MarkedYaml::load_from_str(&text).map_err(|e| NotAFile {
        line: e.marker().line() as u64,
        message: format!("no camera file that can be read (YAML: {})", e.info()),
    })?;
    match documents.first() {
        Some(root) => Ok(node(root)),
        None => Err(NotAFile { line: 1, message: "empty; expected a camera file".into() }),
    }
}

/// The text with a leading `%YAML:1.0` or `%YAML 1.2` line blanked: the first is OpenCV's own and not YAML.
fn without_directive(text: &str) -> String {
    match text.split_once('\n') {
        Some((first, rest)) if first.starts_with("%YAML") => format!("\n{rest}"),
        _ => text.to_owned(),
    }
}

fn node(yaml: &MarkedYaml) -> Node {
    match &yaml.data {
        // `!!opencv-matrix {…}` is `{…}`.
        YamlData::Tagged(_, inner) => node(inner),
        YamlData::Value(Scalar::Integer(value)) => Node::Number(*value as f64),
        YamlData::Value(Scalar::FloatingPoint(value)) => Node::Number(value.into_inner()),
        YamlData::Value(Scalar::String(text)) => Node::of_text(text),
        YamlData::Sequence(items) => Node::List(items.iter().map(node).collect()),
        YamlData::Mapping(members) => {
            let member = |(key, value): (&MarkedYaml, &MarkedYaml)| match &key.data {
                YamlData::Value(Scalar::String(name)) => Some((name.to_string(), node(value))),
                _ => None,
            };
            Node::Map(members.iter().filter_map(member).collect())
        }
        _ => Node::Text(String::new()),
    }
}

/// As OpenCV's FileStorage writes it.
pub fn opencv(lens: &Lens, coefficients: &[f64]) -> String {
    let mut text = format!("%YAML:1.0\n---\nimage_width: {}\nimage_height: {}\n", lens.width, lens.height);
    if lens.fisheye.is_some() {
        text += "fisheye_model: 1\n";
    }
    for (key, rows, values) in
        [("camera_matrix", 3, lens.matrix().as_slice()), ("distortion_coefficients", 1, coefficients)]
    {
        let (cols, data) = (values.len() / rows, joined(values, ", "));
        // Writing to a String cannot fail.
        let _ =
            write!(text, "{key}: !!opencv-matrix\n   rows: {rows}\n   cols: {cols}\n   dt: d\n   data: [ {data} ]\n");
    }
    text
}

/// As ROS's camera_calibration writes it, for a picture that is not rectified: the identity as rectification, and the
/// camera matrix as projection. More than five coefficients are ROS's `rational_polynomial`.
pub fn ros(lens: &Lens, coefficients: &[f64]) -> String {
    let model = match (lens.fisheye, coefficients.len()) {
        (Some(_), _) => "equidistant",
        (None, 0..=5) => "plumb_bob",
        (None, _) => "rational_polynomial",
    };
    let [fx, _, cx, _, fy, cy, ..] = lens.matrix();
    let rectification = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let projection = [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0];
    let matrix = |key: &str, rows: usize, values: &[f64]| {
        let (cols, data) = (values.len() / rows, joined(values, ", "));
        format!("{key}:\n  rows: {rows}\n  cols: {cols}\n  data: [{data}]\n")
    };
    [
        format!("image_width: {}\nimage_height: {}\ncamera_name: camera\n", lens.width, lens.height),
        matrix("camera_matrix", 3, &lens.matrix()),
        format!("distortion_model: {model}\n"),
        matrix("distortion_coefficients", 1, coefficients),
        matrix("rectification_matrix", 3, &rectification),
        matrix("projection_matrix", 3, &projection),
    ]
    .concat()
}
