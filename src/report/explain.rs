//! One frame, stage by stage: pictures of what the eye saw and a page that says what to look for in them.

use super::overlay::{Shape, angles, overlay, rgb, stroke};
use super::page::{document, figure};
use super::plot::{Plot, Point, Series, Style};
use crate::camera::Frame;
use crate::geometry::Configuration;
use crate::measure::{Explanation, SearchedPoint, WeightedEdge};
use crate::observation::{Measurement, Status};
use crate::robot::BendProfile;
use crate::statistics::order::median;
use image::{Rgb, RgbImage, imageops};
use maud::html;
use nalgebra::Point2;
use std::collections::BTreeMap;
use std::f64::consts::FRAC_1_SQRT_2;

// Colours. Convention: display choices.
const GRID: Rgb<u8> = Rgb([0, 200, 255]);
/// Convention: a display choice.
const AGREES: Rgb<u8> = Rgb([40, 235, 70]);
/// Convention: a display choice.
const DISAGREES: Rgb<u8> = Rgb([255, 50, 50]);
/// Convention: a display choice.
const NO_EDGE: Rgb<u8> = Rgb([80, 130, 255]);
/// Colours of the coarse search's candidates, best first.
///
/// Convention: a display choice.
const CANDIDATES: [Rgb<u8>; 6] = [
    Rgb([255, 70, 70]),
    Rgb([255, 160, 0]),
    Rgb([235, 225, 0]),
    Rgb([60, 220, 90]),
    Rgb([0, 200, 255]),
    Rgb([220, 110, 255]),
];
/// What the plot of the residuals shows.
const LEFT_BY_THE_FIT: &str = "How far to the left of the best fit's outline the edges lie, looking from the base to the tip, by their place \
    along the snake (medians over a millimetre). Both sides off together: the snake runs elsewhere there, in the pattern of its shape. Off the opposite way: it \
    looks wider or narrower there. A few places alone: something is in front of it or behind it.";
/// Two stages beside each other where there is room, and none higher than a screen: each opens in full.
const STYLE: &str = "
table { align-self: start; }
.stages { display: grid; gap: 1rem; margin: 1rem 0; align-items: start; grid-template-columns: repeat(auto-fit, minmax(min(100%, 30rem), 1fr)); }
.stages img { width: auto; max-width: 100%; max-height: 90vh; margin: 0 auto; }
";
/// How much larger the picture of the edges is than the frame. Convention: a display choice.
const ENLARGED: u32 = 4;

/// One stage's picture.
#[derive(Debug, Clone)]
pub struct Stage {
    /// Its file's name.
    pub file: &'static str,
    /// What it shows and what to look for.
    pub caption: String,
    /// The picture.
    pub picture: RgbImage,
}

/// Draws every stage. `shape` gives the model's shape at a bend of the explanation.
pub fn stages(
    frame: &Frame,
    explanation: &Explanation,
    measurement: &Measurement,
    shape: impl Fn(BendProfile) -> Shape,
) -> Vec<Stage> {
    let unit = f64::from(frame.height.min(frame.width)) / 720.0;
    let stage = |file, caption: &str, picture| Stage { file, caption: caption.to_owned(), picture };
    let mut stages = vec![
        stage("1-frame.png", "The frame as it was read.", rgb(frame)),
        stage(
            "2-discriminant.png",
            "How much each pixel looks like the snake rather than the grid target behind it, by the colours learned from the \
             straight picture: the snake should be light, the target dark and its lines hardly seen.",
            rgb(&explanation.discriminant),
        ),
    ];

    let mut picture = faded(frame);
    for line in &explanation.grid {
        stroke(&mut picture, line, 0.6 * unit, GRID);
    }
    stages.push(stage(
        "3-grid.png",
        "The grid as the rig predicts it. If these lines are beside the printed ones, camera or target have moved since the rig \
         was calibrated, or the lens is another one.",
        picture,
    ));

    let mut picture = faded(frame);
    for (bend, colour) in explanation.candidates.iter().zip(CANDIDATES).rev() {
        stroke(&mut picture, &shape((*bend).into()).arc, 3.0 * unit, colour);
    }
    stages.push(stage(
        "4-search.png",
        "The candidates of the coarse search; red is the best, then orange, yellow, green, blue and violet. One of them should lie \
         roughly on the snake.",
        picture,
    ));

    if !explanation.points.is_empty() {
        let caption = format!(
            "The best fit's outline and the edges found near it, {ENLARGED} times as large. Green: an edge that agrees; red: \
             one that does not and hardly counts, with a line from where it was expected; blue: no edge where one should \
             be. Points on the holder and beside another part of the snake, which the fit leaves out, are drawn as well. {}",
            counted(&explanation.points)
        );
        stages.push(Stage { file: "5-edges.png", caption, picture: edges(frame, &explanation.points) });
    }

    let drawn = explanation.fits.first().map(|profile| shape(*profile));
    stages.push(stage(
        "6-model.png",
        "The best fit, whatever the verdict on it: outline, central backbone, base (green) and tip (magenta).",
        overlay(frame, measurement, drawn.as_ref()),
    ));
    stages
}

/// The frame, paler, so that lines on it can be seen.
fn faded(frame: &Frame) -> RgbImage {
    let mut picture = rgb(frame);
    picture.iter_mut().for_each(|v| *v = (127 + u16::from(*v) / 2) as u8);
    picture
}

/// The part of the frame with the points in it, enlarged, with every point and its edge.
fn edges(frame: &Frame, points: &[SearchedPoint]) -> RgbImage {
    /// Convention: a display choice, as the widths of the lines are.
    const MARGIN_PX: f64 = 15.0;
    let bound = |value: f64, size: u32| value.clamp(0.0, f64::from(size - 1)) as u32;
    let start = |axis: usize| points.iter().map(|p| p.expected[axis]).fold(f64::INFINITY, f64::min) - MARGIN_PX;
    let end = |axis: usize| points.iter().map(|p| p.expected[axis]).fold(0.0, f64::max) + MARGIN_PX;
    let (x0, y0) = (bound(start(0), frame.width), bound(start(1), frame.height));
    let (x1, y1) = (bound(end(0), frame.width), bound(end(1), frame.height));
    let part = imageops::crop_imm(&rgb(frame), x0, y0, x1 - x0 + 1, y1 - y0 + 1).to_image();
    let mut picture =
        imageops::resize(&part, ENLARGED * part.width(), ENLARGED * part.height(), imageops::FilterType::Triangle);
    let scale = f64::from(ENLARGED);
    // Pixel centres are at integers in both.
    let enlarged = |p: &Point2<f64>| {
        let to = |value: f64, from: u32| scale * (value - f64::from(from) + 0.5) - 0.5;
        Point2::new(to(p.x, x0), to(p.y, y0))
    };
    for point in points {
        let expected = enlarged(&point.expected);
        match point.edge {
            None => stroke(&mut picture, &[expected], 1.3 * scale, NO_EDGE),
            Some(WeightedEdge { pixel, weight, .. }) => {
                let seen = enlarged(&pixel);
                let mix = |k: usize| {
                    (f64::from(AGREES.0[k]) * weight + f64::from(DISAGREES.0[k]) * (1.0 - weight)).round() as u8
                };
                let colour = Rgb([mix(0), mix(1), mix(2)]);
                stroke(&mut picture, &[expected, seen], 0.25 * scale, colour);
                stroke(&mut picture, &[seen], 1.3 * scale, colour);
            }
        }
    }
    picture
}

fn counted(points: &[SearchedPoint]) -> String {
    /// Weight of an edge in the fit above which it is said to agree. Convention: a display choice.
    const AGREES_FROM: f64 = 0.25;
    let agree = points.iter().filter(|p| p.edge.is_some_and(|edge| edge.weight > AGREES_FROM)).count();
    let missing = points.iter().filter(|p| p.edge.is_none()).count();
    format!(
        "{} points: {agree} agree, {} disagree, {missing} show no edge.",
        points.len(),
        points.len() - agree - missing
    )
}

/// What a status means and what to do about it.
fn meaning(status: &Status) -> &'static str {
    match status {
        Status::Ok => "Measured.",
        Status::NoSnake => {
            "Nothing here looks like the snake: is it in the picture (1), does it stand out from the target (2), and did the \
             search find it (4)? A light that changed much since the straight picture can do this."
        }
        Status::Occluded => {
            "Too little of the snake's outline is confirmed by edges (5): something hides it or the model lies wrong (6)."
        }
        Status::Ambiguous => "Two bends explain the picture about equally well, so that neither is given.",
        Status::UnknownShape => {
            "The outline contradicts an arc, or the shape that this snake had in the sequence. Either the best shape (6) leaves part of it \
             unexplained, as the edges beside the drawn outline (5) show, or several shapes explain it. If three frames or more of this snake \
             refine the rig, its shape is known."
        }
        Status::Blurred => "The outline is too blurred for its edges to be placed: focus, or a shorter exposure.",
        Status::Saturated => "Nearly all of the picture is black or white: exposure.",
        Status::OutOfFrame => "Too much of the snake lies outside the picture.",
        Status::CameraMoved => {
            "The holder, the grid or both are not where the rig says: the camera moved. `--follow` follows it; or calibrate \
             the rig anew."
        }
        Status::BaseMoved => {
            "The holder is not where the rig says though the grid is: the snake's base moved. Calibrate the rig anew."
        }
        Status::GridLost => "The camera was to be followed, but neither the grid nor the holder tells where it is.",
        Status::ViewsDisagree => {
            "The views contradict each other: did one camera move, or were its frames taken at another time?"
        }
        Status::Unreadable => "The picture could not be read.",
        Status::WrongSize => "The picture is not of the size that the camera file says.",
        Status::TrackerLost | Status::TrackerJump | Status::Other(_) => "",
    }
}

/// The page that shows the stages; their files lie beside it.
pub fn page(title: &str, explanation: &Explanation, measurement: &Measurement, stages: &[Stage]) -> String {
    let content = html! {
        h1 { (title) ": " (measurement.status) }
        p { (meaning(&measurement.status)) }
        .plots {
            table {
                @for (name, value) in figures(explanation, measurement) { tr { th { (name) } td { (value) } } }
            }
            (figure("What the best fit leaves", &residuals(&explanation.points), LEFT_BY_THE_FIT))
        }
        .stages {
            @for Stage { file, caption, .. } in stages {
                figure {
                    h3 { (file.trim_end_matches(".png").replacen('-', ". ", 1)) }
                    a href=(file) { img src=(file) alt=(caption); }
                    figcaption { (caption) }
                }
            }
        }
    };
    document(title, STYLE, &content)
}

/// The residuals of the best fit along the snake, at the borders of its two sides: their median over every millimetre.
fn residuals(points: &[SearchedPoint]) -> Plot {
    /// A border whose normal is within 45° of the picture's left or right of the snake is one of its sides. Convention: a display choice.
    const SIDEWARD: f64 = FRAC_1_SQRT_2;
    let of_side = |name: &str, side: f64| {
        let mut by_mm: BTreeMap<i64, Vec<f32>> = BTreeMap::new();
        for point in points.iter().filter(|point| point.leftward * side > SIDEWARD) {
            if let Some(edge) = point.edge {
                by_mm.entry(point.s_mm.floor() as i64).or_default().push((side * edge.offset_px) as f32);
            }
        }
        let middle = |(mm, mut offsets): (i64, Vec<f32>)| Point {
            x: mm as f64 + 0.5,
            y: f64::from(median(&mut offsets)),
            sd: 0.0,
        };
        Series { name: name.to_owned(), style: Style::Band, points: by_mm.into_iter().map(middle).collect() }
    };
    Plot {
        x_label: "place along the snake, mm".to_owned(),
        y_label: "edge left of the fit, px".to_owned(),
        series: vec![of_side("left side", 1.0), of_side("right side", -1.0)],
        y_shown: vec![-1.0, 1.0],
    }
}

fn figures(explanation: &Explanation, measurement: &Measurement) -> Vec<(&'static str, String)> {
    let mut figures = Vec::new();
    if let Some(measured) = &measurement.measured {
        let (theta, delta) = angles(measured);
        figures.extend([("θ", theta), ("δ", delta)]);
    }
    for (name, profile) in ["best fit", "second fit"].into_iter().zip(&explanation.fits) {
        let psi = Configuration::from_bend_vector(profile.tip);
        figures.push((name, format!("θ {:.2}°, δ {:.2}°", psi.theta_deg(), psi.delta_deg()).replace('-', "−")));
    }
    if let Some(quality) = &measurement.quality {
        figures.push(("edges that agree", quality.edges.to_string()));
        figures.push(("share of the outline", format!("{:.0} %", 100.0 * quality.inlier_fraction)));
        figures.push(("their scatter", format!("{:.2} px", quality.rms_px)));
    }
    let disks = explanation.disks.iter().map(|(disk, share)| format!("{disk}: {:.0} %", 100.0 * share));
    figures.push(("of each disk's outline, from the base", disks.collect::<Vec<_>>().join(", ")));
    figures
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Samples;
    use crate::measure::FrameMeasurement;

    fn frame() -> Frame {
        Frame { width: 64, height: 48, channels: 1, samples: Samples::Bits8(vec![100; 64 * 48]) }
    }

    fn explanation(points: Vec<SearchedPoint>) -> Explanation {
        Explanation {
            measurement: FrameMeasurement { status: Status::NoSnake, measured: None, bend: None, quality: None },
            discriminant: frame(),
            grid: vec![vec![Point2::new(10.0, 0.0), Point2::new(10.0, 47.0)]],
            candidates: vec![Configuration::from_degrees(30.0, 0.0)],
            fits: if points.is_empty() { Vec::new() } else { vec![Configuration::from_degrees(31.0, 2.0).into()] },
            disks: Vec::new(),
            points,
        }
    }

    fn measurement() -> Measurement {
        Measurement { index: 7, time_s: None, status: Status::NoSnake, measured: None, quality: None, view: None }
    }

    #[test]
    fn points_are_drawn_where_they_are_and_as_they_agree() {
        let point = |x: f64, weight: f64| SearchedPoint {
            expected: Point2::new(x, 24.0),
            s_mm: 0.0,
            leftward: 1.0,
            edge: Some(WeightedEdge { pixel: Point2::new(x, 24.0), offset_px: 0.0, weight }),
        };
        let missing = SearchedPoint { expected: Point2::new(40.0, 24.0), s_mm: 0.0, leftward: 1.0, edge: None };
        let picture = edges(&frame(), &[point(20.0, 1.0), point(30.0, 0.0), missing]);
        // The part starts 15 px left of the first point and above them all.
        assert_eq!(picture.dimensions(), (4 * (40 - 20 + 31), 4 * 31));
        let at = |x: u32| *picture.get_pixel(4 * (x - 5) + 2, 4 * (24 - 9) + 2);
        assert_eq!([at(20), at(30), at(40)], [AGREES, DISAGREES, NO_EDGE]);
        assert_eq!(at(25), Rgb([100; 3]));
    }

    #[test]
    fn a_frame_without_any_fit_has_its_page_too() {
        let explained = explanation(Vec::new());
        let stages = stages(&frame(), &explained, &measurement(), |_| Shape::default());
        let files: Vec<&str> = stages.iter().map(|stage| stage.file).collect();
        assert_eq!(files, ["1-frame.png", "2-discriminant.png", "3-grid.png", "4-search.png", "6-model.png"]);
        let page = page("a <lab>, frame 7", &explained, &measurement(), &stages);
        assert!(page.contains("a &lt;lab&gt;, frame 7: no_snake") && page.contains("src=\"3-grid.png\""), "{page}");
        assert!(page.contains("Nothing here looks like the snake"), "{page}");
    }

    /// A snake 0.5 px to the left of the fit over its upper half: the left border lies outside, the right one inside.
    #[test]
    fn the_residuals_show_where_along_the_snake_it_runs_elsewhere() {
        let point = |s_mm: f64, leftward: f64| {
            let offset_px = if s_mm > 13.0 { 0.5 * leftward } else { 0.0 };
            let edge = Some(WeightedEdge { pixel: Point2::origin(), offset_px, weight: 1.0 });
            SearchedPoint { expected: Point2::origin(), s_mm, leftward, edge }
        };
        let upper_border = point(20.0, 0.1);
        let points = [point(20.0, 1.0), point(20.0, -1.0), point(5.0, 0.9), upper_border];
        let plot = residuals(&points);
        let places = |side: usize| -> Vec<[f64; 2]> { plot.series[side].points.iter().map(|p| [p.x, p.y]).collect() };
        assert_eq!(places(0), [[5.5, 0.0], [20.5, 0.5]]);
        assert_eq!(places(1), [[20.5, 0.5]]);
    }

    #[test]
    fn points_are_counted() {
        let edge = |weight| Some(WeightedEdge { pixel: Point2::origin(), offset_px: 0.0, weight });
        let point = |edge| SearchedPoint { expected: Point2::new(20.0, 20.0), s_mm: 0.0, leftward: 1.0, edge };
        let points = [point(edge(1.0)), point(edge(0.1)), point(None), point(edge(0.9))];
        assert_eq!(counted(&points), "4 points: 2 agree, 1 disagree, 1 show no edge.");
    }
}
