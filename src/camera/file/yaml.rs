//! Camera files in YAML: OpenCV's FileStorage, whose matrices are tagged, and ROS `camera_info`, whose are not.

use super::{Entry, NotAFile, Value, joined};
use crate::camera::Lens;
use saphyr::{LoadableYamlNode, MarkedYaml, Scalar, YamlData};
use std::fmt::Write as _;

/// Deeper nesting is no camera file, and would let a parser that follows it run out of stack.
///
/// Convention: a limit on what is read.
const DEEPEST: usize = 100;

/// What stands at the top level of a file.
pub fn entries(text: &str) -> Result<Vec<Entry>, NotAFile> {
    let text = without_directive(text);
    let brackets = text.bytes().filter(|b| b"[{".contains(b)).count();
    let indents = text.lines().map(|line| line.len() - line.trim_start_matches([' ', '-', '?', ':']).len()).max();
    if brackets > DEEPEST || indents > Some(DEEPEST) {
        return Err(NotAFile { line: 1, message: "nested too deeply for a camera file".into() });
    }
    let documents = MarkedYaml::load_from_str(&text).map_err(|e| NotAFile {
        line: e.marker().line() as u64,
        message: format!("neither a YAML nor an XML camera file: {}", e.info()),
    })?;
    let Some(root) = documents.first() else {
        return Err(NotAFile { line: 1, message: "empty; expected a camera file".into() });
    };
    let YamlData::Mapping(members) = &untagged(root).data else { return Ok(Vec::new()) };
    let entry = |(key, node): (&MarkedYaml, &MarkedYaml)| match &key.data {
        YamlData::Value(Scalar::String(name)) => {
            Some(Entry { key: name.to_string(), line: node.span.start.line() as u64, value: value(node) })
        }
        _ => None,
    };
    Ok(members.iter().filter_map(entry).collect())
}

/// The text with a leading `%YAML:1.0` or `%YAML 1.2` line blanked: the first is OpenCV's own and not YAML.
fn without_directive(text: &str) -> String {
    match text.split_once('\n') {
        Some((first, rest)) if first.starts_with("%YAML") => format!("\n{rest}"),
        _ => text.to_owned(),
    }
}

fn value(node: &MarkedYaml) -> Value {
    if let Some(number) = number(node) {
        return Value::Number(number);
    }
    match &untagged(node).data {
        YamlData::Value(Scalar::String(text)) => Value::Text(text.to_string()),
        YamlData::Mapping(_) => matrix(node).unwrap_or(Value::Other),
        _ => Value::Other,
    }
}

/// `{rows, cols, data}`.
fn matrix(node: &MarkedYaml) -> Option<Value> {
    let YamlData::Sequence(items) = &untagged(member(node, "data")?).data else { return None };
    let count = |name| member(node, name).and_then(number);
    Some(Value::Matrix {
        shape: count("rows").zip(count("cols")),
        data: items.iter().map(|item| number(item).filter(|v| v.is_finite())).collect(),
    })
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

/// As OpenCV's FileStorage writes it.
pub fn opencv(lens: &Lens, coefficients: &[f64]) -> String {
    let mut text = format!("%YAML:1.0\n---\nimage_width: {}\nimage_height: {}\n", lens.width, lens.height);
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
    let model = if coefficients.len() <= 5 { "plumb_bob" } else { "rational_polynomial" };
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
