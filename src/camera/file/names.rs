//! What programs call the parts of a camera.
//!
//! | part | names |
//! | --- | --- |
//! | size | `image_width` and `image_height`, `width` and `height`, `w` and `h`; `image_size`, `img_size`, `size`, `resolution`, `imsize` (a list or a map) |
//! | matrix | `camera_matrix`, `K`, `mtx`, `matrix`, `intrinsic_matrix`; `intrinsics`, `intrinsic` (fx, fy, cx, cy); `fx`, `fy`, `cx`, `cy`, or `f` and `ar` |
//! | distortion | `distortion_coefficients`, `D`, `dist`, `dist_coeffs`, `distortion_coeffs`, `distortions`, `distortion`; `k1`, `k2`, `p1`, `p2`, `k3` … |
//! | model | `distortion_model`, `camera_model`, `fisheye_model` |
//!
//! Small and capital letters and `_` do not count (`image_Width`, `cameraMatrix`), nor what stands before a dot (`Camera.fx`). Sources: the
//! samples and writers of OpenCV, ROS's camera_calibration and `ros2 topic echo`, Kalibr, anipose, calib.io, ORB-SLAM.

use super::tree::Node;
use crate::camera::message::Window;
use crate::error::Error;
use std::path::Path;

const WIDTHS: [&str; 4] = ["imagewidth", "width", "w", "imgwidth"];
const HEIGHTS: [&str; 4] = ["imageheight", "height", "h", "imgheight"];
const SIZES: [&str; 7] = ["imagesize", "imgsize", "size", "resolution", "imsize", "imageresolution", "framesize"];
const MATRICES: [&str; 7] = ["cameramatrix", "k", "mtx", "matrix", "intrinsicmatrix", "intrinsics", "intrinsic"];
const DISTORTIONS: [&str; 9] = [
    "distortioncoefficients",
    "d",
    "dist",
    "distcoeffs",
    "distcoeff",
    "distortioncoeffs",
    "distortions",
    "distortion",
    "distcoefficients",
];
/// The coefficients in OpenCV's order.
const COEFFICIENTS: [&str; 14] =
    ["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "taux", "tauy"];

/// What programs call the fisheye of OpenCV, which is the equidistant model of ROS and Kalibr.
pub const FISHEYES: [&str; 3] = ["equidistant", "fisheye", "kannala_brandt"];

/// A value with the key that it stands under.
pub struct Found<T> {
    /// The key as the file has it.
    pub key: String,
    /// The value.
    pub value: T,
}

impl Found<&Node> {
    /// What is wrong with a text where numbers should be.
    fn unread(&self) -> Option<Wrong> {
        let Node::Text(text) = self.value else { return None };
        let shown: String = text.split_whitespace().collect::<Vec<_>>().join(" ").chars().take(40).collect();
        let what =
            if ["", "null"].contains(&shown.as_str()) { "nothing".to_owned() } else { format!("the text {shown:?}") };
        Some(Wrong::at(
            &self.key,
            format!("holds {what}, expected numbers in a list such as [0.0, 0.0], with decimal points"),
        ))
    }
}

/// What is wrong with a camera, and at which key.
pub struct Wrong {
    key: Option<String>,
    why: String,
}

impl Wrong {
    /// At a key.
    pub fn at(key: &str, why: impl Into<String>) -> Self {
        Self { key: Some(key.to_owned()), why: why.into() }
    }

    fn missing(what: &str) -> Self {
        Self { key: None, why: what.to_owned() }
    }

    /// As an error about a file, with the key's line, or the keys that were found.
    pub fn error(self, path: &Path, text: &str, tree: &Node) -> Error {
        let Some(key) = self.key else {
            /// Keys that a message lists. Convention: as many as a line holds.
            const MOST: usize = 24;
            let mut keys: Vec<String> = tree.maps().into_iter().flat_map(|(place, map)| names(&place, map)).collect();
            let more = if keys.len() > MOST { ", …" } else { "" };
            keys.truncate(MOST);
            let found = if keys.is_empty() { "none".to_owned() } else { keys.join(", ") };
            return Error::content(
                path,
                format!(
                    "{}; the keys found are {found}{more}. The book lists the names that are read (reference, Camera files); or write camera = {{ \
                     K = …, dist = …, size = … }} into experiment.toml",
                    self.why
                ),
            );
        };
        let message = format!("{key}: {}", self.why);
        match text.lines().position(|line| line.contains(&key)) {
            Some(line) => Error::at_line(path, line as u64 + 1, message),
            None => Error::content(path, message),
        }
    }
}

/// The keys of a map, each with those that lead to it.
fn names(place: &str, map: &Node) -> Vec<String> {
    let Node::Map(members) = map else { return Vec::new() };
    let dot = if place.is_empty() { "" } else { "." };
    members.iter().map(|(key, _)| format!("{place}{dot}{key}")).collect()
}

/// A key as keys are compared.
fn plain(key: &str) -> String {
    let last = key.rsplit('.').next().unwrap_or(key);
    last.chars().filter(|c| c.is_alphanumeric()).flat_map(char::to_lowercase).collect()
}

/// The one camera of a file.
pub struct Camera<'a> {
    /// The map that has its matrix.
    own: &'a Node,
    /// All maps, those around its own first.
    all: Vec<&'a Node>,
}

impl<'a> Camera<'a> {
    /// The map that has a camera matrix.
    ///
    /// # Errors
    /// None, or several.
    pub fn find(tree: &'a Node) -> Result<Self, Wrong> {
        let maps = tree.maps();
        let cameras: Vec<&(String, &Node)> = maps.iter().filter(|(_, map)| matrix_of(map).is_some()).collect();
        match cameras[..] {
            [] => {
                let around = Self { own: tree, all: maps.iter().map(|(_, map)| *map).collect() };
                around.is_fisheye()?;
                let unread = around.get(&MATRICES).or_else(|| around.get(&["fx"])).and_then(|found| found.unread());
                Err(unread.unwrap_or_else(|| {
                    Wrong::missing("no camera matrix (camera_matrix, K, mtx, intrinsics, or fx, fy, cx, cy)")
                }))
            }
            [(place, own)] => {
                let is_around = |other: &str| place.starts_with(other);
                let (around, others): (Vec<_>, Vec<_>) = maps.iter().partition(|(other, _)| is_around(other));
                let all = around.into_iter().rev().chain(others).map(|(_, map)| *map).collect();
                Ok(Self { own, all })
            }
            ref several => {
                let places: Vec<&str> = several.iter().map(|(place, _)| place.as_str()).collect();
                Err(Wrong::missing(&format!(
                    "{} cameras ({}), expected one; give a file with the one of this view",
                    several.len(),
                    places.join(", ")
                )))
            }
        }
    }

    /// The first value under one of these names, in the camera's own map or around it, else anywhere.
    fn get(&self, names: &[&str]) -> Option<Found<&'a Node>> {
        self.all.iter().find_map(|map| member(map, names))
    }

    /// Width and height, px.
    ///
    /// # Errors
    /// No size, or none of two numbers.
    pub fn size(&self) -> Result<Found<[f64; 2]>, Wrong> {
        let listed = |found: &Found<&Node>| match found.value.numbers() {
            Ok(numbers) => <[f64; 2]>::try_from(numbers).ok(),
            Err(_) => pair(found.value).map(|(width, height)| [width.value, height.value]),
        };
        for map in &self.all {
            if let Some((width, height)) = wide_and_high(map) {
                let (Some(wide), Some(high)) = (width.value.number(), height.value.number()) else {
                    let key = if width.value.number().is_none() { &width.key } else { &height.key };
                    return Err(Wrong::at(key, "expected a whole number of pixels, at least 1"));
                };
                let is_pixels = |value: f64| value.fract() == 0.0 && value >= 1.0;
                return Ok(Found { key: if is_pixels(wide) { height.key } else { width.key }, value: [wide, high] });
            }
            let sized = member(map, &SIZES).and_then(|found| Some(Found { value: listed(&found)?, key: found.key }));
            if let Some(found) = sized {
                return Ok(found);
            }
        }
        Err(Wrong::missing("no width and height of the pictures (image_width and image_height, size, resolution)"))
    }

    /// The camera matrix, by rows.
    ///
    /// # Errors
    /// Another number of elements, or something that is no number.
    pub fn matrix(&self) -> Result<Found<[f64; 9]>, Wrong> {
        let Some(Found { key, value }) = matrix_of(self.own) else {
            return Err(Wrong::missing("no camera matrix"));
        };
        let numbers = match value {
            Matrix::Node(node) => node.numbers().map_err(|why| Wrong::at(&key, why))?,
            Matrix::Numbers(numbers) => numbers.to_vec(),
        };
        let value = match numbers[..] {
            [fx, fy, cx, cy] => [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
            _ => <[f64; 9]>::try_from(numbers)
                .map_err(|numbers| Wrong::at(&key, format!("{} numbers, expected 9 (3×3)", numbers.len())))?,
        };
        Ok(Found { key, value })
    }

    /// The distortion coefficients in OpenCV's order.
    ///
    /// # Errors
    /// None, or something that is no number.
    pub fn distortion(&self) -> Result<Found<Vec<f64>>, Wrong> {
        if let Some(Found { key, value }) = self.get(&DISTORTIONS).filter(|found| !matches!(found.value, Node::Text(_)))
        {
            return match value.numbers() {
                Ok(numbers) => Ok(Found { key, value: numbers }),
                // A map of k1, k2, …
                Err(why) => {
                    coefficients(value).map(|value| Found { key: key.clone(), value }).ok_or(Wrong::at(&key, why))
                }
            };
        }
        let single = self.all.iter().find_map(|map| coefficients(map));
        let single = single.map(|value| Found { key: "k1".to_owned(), value });
        single.ok_or_else(|| {
            let unread = self.get(&DISTORTIONS).and_then(|found| found.unread());
            unread.unwrap_or(Wrong::missing(
                "no distortion coefficients (distortion_coefficients, D, dist, dist_coeffs, k1 …)",
            ))
        })
    }

    /// Whether the model is the fisheye; else it is the standard one.
    ///
    /// # Errors
    /// Another model, by name.
    pub fn is_fisheye(&self) -> Result<bool, Wrong> {
        const STANDARD: [&str; 8] = [
            "",
            "plumb_bob",
            "rational_polynomial",
            "radtan",
            "none",
            "pinhole",
            "opencv",
            "libcalib::cameramodelopencv",
        ];
        for names in [["distortionmodel"], ["cameramodel"], ["modeltype"], ["polymorphicname"]] {
            let Some(Found { key, value }) = self.get(&names) else { continue };
            let Node::Text(model) = value else {
                return Err(Wrong::at(&key, "not a name, expected plumb_bob or rational_polynomial"));
            };
            let model = model.to_lowercase();
            if FISHEYES.contains(&model.as_str()) {
                return Ok(true);
            }
            if !STANDARD.contains(&model.as_str()) {
                let message = format!("{model}, expected plumb_bob, rational_polynomial, radtan or equidistant");
                return Err(Wrong::at(&key, message));
            }
        }
        let flag = self.get(&["fisheyemodel", "fisheye"]).map(|found| found.value);
        Ok(flag.is_some_and(|value| *value != Node::Number(0.0) && *value != Node::Text("false".into())))
    }

    /// The part of the sensor that the pictures show, where the file tells it, as ROS's messages do.
    ///
    /// # Errors
    /// Something that is no number.
    pub fn window(&self) -> Result<Window, Wrong> {
        let number = |map: &Node, key: &str| map.get(key).and_then(Node::number).unwrap_or(0.0);
        let own = |key: &'static str| self.get(&[key]).and_then(|found| found.value.number()).unwrap_or(0.0);
        let roi = self.get(&["roi", "regionofinterest"]).map(|found| found.value);
        let of_roi = |key: &str| roi.map_or(0.0, |roi| number(roi, key));
        let binning = [own("binningx"), own("binningy")];
        let numbers =
            [binning[0], binning[1], of_roi("x_offset"), of_roi("y_offset"), of_roi("width"), of_roi("height")];
        if numbers.iter().any(|value| value.fract() != 0.0 || *value < 0.0 || *value > 1e6) {
            return Err(Wrong::at("roi", format!("binning and window {numbers:?}, expected whole numbers of pixels")));
        }
        let [binning_x, binning_y, x, y, width, height] = numbers.map(|value| value as u32);
        Ok(Window { binning: [binning_x, binning_y], offset: [x, y], size: [width, height] })
    }
}

/// The member of a map under one of these names.
fn member<'a>(map: &'a Node, names: &[&str]) -> Option<Found<&'a Node>> {
    let Node::Map(members) = map else { return None };
    let of_name = |name: &&str| members.iter().find(|(key, _)| plain(key) == **name);
    names.iter().find_map(of_name).map(|(key, value)| Found { key: key.clone(), value })
}

fn wide_and_high(map: &Node) -> Option<(Found<&Node>, Found<&Node>)> {
    // The window of a message has a width and a height as well.
    if member(map, &["xoffset"]).is_some() {
        return None;
    }
    member(map, &WIDTHS).zip(member(map, &HEIGHTS))
}

fn pair(map: &Node) -> Option<(Found<f64>, Found<f64>)> {
    let (width, height) = wide_and_high(map)?;
    let number = |found: Found<&Node>| Some(Found { value: found.value.number()?, key: found.key });
    number(width).zip(number(height))
}

/// Where a matrix stands.
enum Matrix<'a> {
    /// Under a name of its own.
    Node(&'a Node),
    /// In four numbers: fx, fy, cx, cy.
    Numbers([f64; 4]),
}

/// What a map has as a camera's matrix.
fn matrix_of(map: &Node) -> Option<Found<Matrix<'_>>> {
    let number = |names: &[&str]| member(map, names).and_then(|found| found.value.number());
    let is_matrix = |node: &Node| matches!(node, Node::List(_)) || node.get("data").is_some();
    if let Some(Found { key, value }) =
        MATRICES.iter().find_map(|name| member(map, &[name]).filter(|f| is_matrix(f.value)))
    {
        return Some(Found { key, value: Matrix::Node(value) });
    }
    let centre = number(&["cx", "ppx"]).zip(number(&["cy", "ppy"]))?;
    let focal = number(&["fx"]).zip(number(&["fy"]));
    // calib.io has one focal length, and how many times it the other is.
    let focal = focal.or_else(|| number(&["f"]).zip(number(&["ar"])).map(|(f, ratio)| (f, f * ratio)));
    let (fx, fy) = focal?;
    Some(Found { key: "cx".to_owned(), value: Matrix::Numbers([fx, fy, centre.0, centre.1]) })
}

/// The coefficients that a map has one by one, as many as are needed for the last of them.
fn coefficients(map: &Node) -> Option<Vec<f64>> {
    let each = COEFFICIENTS.map(|name| member(map, &[name]).and_then(|found| found.value.number()));
    let last = each.iter().rposition(Option::is_some)?;
    let count = [4, 5, 8, 12, 14].into_iter().find(|count| *count > last)?;
    Some(each[..count].iter().map(|coefficient| coefficient.unwrap_or(0.0)).collect())
}
