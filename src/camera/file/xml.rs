//! Camera files in XML: OpenCV's FileStorage.

use super::{Entry, NotAFile, Value, joined};
use crate::camera::Lens;
use roxmltree::{Document, Node, ParsingOptions};
use std::fmt::Write as _;

/// More elements and texts than this are no camera file.
///
/// Convention: a limit on what is read.
const MOST_NODES: u32 = 100_000;

/// What stands at the top level of a file, below `<opencv_storage>`.
pub fn entries(text: &str) -> Result<Vec<Entry>, NotAFile> {
    // Without a DTD there are no entities, which could stand for more text than there is memory.
    let options = ParsingOptions { allow_dtd: false, nodes_limit: MOST_NODES, ..ParsingOptions::default() };
    let document = Document::parse_with_options(text, options).map_err(|e| NotAFile {
        line: u64::from(e.pos().row),
        message: format!("neither a YAML nor an XML camera file: {e}"),
    })?;
    let root = document.root_element();
    if root.tag_name().name() != "opencv_storage" {
        return Err(NotAFile {
            line: line_of(&document, &root),
            message: format!("<{}>, expected a camera file with <opencv_storage>", root.tag_name().name()),
        });
    }
    let entry = |node: Node| Entry {
        key: node.tag_name().name().to_owned(),
        line: line_of(&document, &node),
        value: value(&node),
    };
    Ok(root.children().filter(Node::is_element).map(entry).collect())
}

fn line_of(document: &Document, node: &Node) -> u64 {
    u64::from(document.text_pos_at(node.range().start).row)
}

fn value(node: &Node) -> Value {
    if let Some(data) = member(node, "data") {
        let count = |name| member(node, name).and_then(number);
        let finite = |word: &str| word.parse().ok().filter(|v: &f64| v.is_finite());
        return Value::Matrix {
            shape: count("rows").zip(count("cols")),
            data: text(&data).split_whitespace().map(finite).collect(),
        };
    }
    // OpenCV puts texts with blanks in them between quotation marks.
    number(*node).map_or_else(|| Value::Text(text(node).trim().trim_matches('"').to_owned()), Value::Number)
}

fn member<'a>(node: &Node<'a, 'a>, name: &str) -> Option<Node<'a, 'a>> {
    node.children().find(|child| child.has_tag_name(name))
}

fn number(node: Node) -> Option<f64> {
    text(&node).trim().parse().ok()
}

fn text<'a>(node: &Node<'a, 'a>) -> &'a str {
    node.text().unwrap_or_default()
}

/// As OpenCV's FileStorage writes it.
pub fn opencv(lens: &Lens, coefficients: &[f64]) -> String {
    let mut text = format!(
        "<?xml version=\"1.0\"?>\n<opencv_storage>\n<image_width>{}</image_width>\n<image_height>{}</image_height>\n",
        lens.width, lens.height
    );
    for (key, rows, values) in
        [("camera_matrix", 3, lens.matrix().as_slice()), ("distortion_coefficients", 1, coefficients)]
    {
        let (cols, data) = (values.len() / rows, joined(values, " "));
        // Writing to a String cannot fail.
        let _ = write!(
            text,
            "<{key} type_id=\"opencv-matrix\">\n  <rows>{rows}</rows>\n  <cols>{cols}</cols>\n  <dt>d</dt>\n  \
             <data>\n    {data}</data></{key}>\n"
        );
    }
    text + "</opencv_storage>\n"
}
