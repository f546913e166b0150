//! Camera files in XML: OpenCV's FileStorage.

use super::joined;
use super::tree::{Node as Tree, NotAFile};
use crate::camera::Lens;
use roxmltree::{Document, Node, ParsingOptions};
use std::fmt::Write as _;

/// More elements and texts than this are no camera file.
///
/// Convention: a limit on what is read.
const MOST_NODES: u32 = 100_000;

/// What stands below `<opencv_storage>`.
pub fn tree(text: &str) -> Result<Tree, NotAFile> {
    // Without a DTD there are no entities, which could stand for more text than there is memory.
    let options = ParsingOptions { allow_dtd: false, nodes_limit: MOST_NODES, ..ParsingOptions::default() };
    let document = Document::parse_with_options(text, options).map_err(|e| NotAFile {
        line: u64::from(e.pos().row),
        message: format!("no camera file that can be read (XML: {e})"),
    })?;
    let root = document.root_element();
    if root.tag_name().name() != "opencv_storage" {
        return Err(NotAFile {
            line: u64::from(document.text_pos_at(root.range().start).row),
            message: format!("<{}>, expected a camera file with <opencv_storage>", root.tag_name().name()),
        });
    }
    Ok(value(&root, DEEPEST))
}

/// Deeper nesting is no camera file.
///
/// Convention: a limit on what is read.
const DEEPEST: usize = 20;

fn value(node: &Node, deepest: usize) -> Tree {
    let mut members = node.children().filter(Node::is_element).peekable();
    if members.peek().is_some() && deepest > 0 {
        return Tree::Map(
            members.map(|child| (child.tag_name().name().to_owned(), value(&child, deepest - 1))).collect(),
        );
    }
    // OpenCV puts texts with blanks in them between quotation marks, and numbers of a list between blanks.
    let text = node.text().unwrap_or_default().trim();
    let numbers: Option<Vec<Tree>> =
        text.split_whitespace().map(|word| Some(Tree::Number(word.parse().ok()?))).collect();
    match numbers {
        Some(numbers) if numbers.len() == 1 && node.tag_name().name() != "data" => Tree::of_text(text),
        Some(numbers) if !numbers.is_empty() => Tree::List(numbers),
        _ if node.tag_name().name() == "data" => Tree::List(text.split_whitespace().map(Tree::of_text).collect()),
        _ => Tree::Text(text.trim_matches('"').to_owned()),
    }
}

/// As OpenCV's FileStorage writes it.
pub fn opencv(lens: &Lens, coefficients: &[f64]) -> String {
    let mut text = format!(
        "<?xml version=\"1.0\"?>\n<opencv_storage>\n<image_width>{}</image_width>\n<image_height>{}</image_height>\n",
        lens.width, lens.height
    );
    if lens.fisheye.is_some() {
        text += "<fisheye_model>1</fisheye_model>\n";
    }
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
