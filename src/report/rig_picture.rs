//! The straight picture with what its calibration saw drawn on it: the sheet's border, a few of its lines, and what was taken for the snake.

use super::overlay::{Shape, label, rgb, stroke};
use crate::camera::{Frame, Lens};
use crate::measure::{Projection, Rig, RigSketch, STRAIGHT};
use crate::robot::Robot;
use image::{Rgb, RgbImage};
use nalgebra::{Point2, Vector2};

// Colours. Convention: display choices.
const SHEET: Rgb<u8> = Rgb([255, 214, 0]);
/// Convention: a display choice.
const LINES: Rgb<u8> = Rgb([90, 160, 255]);
/// Convention: a display choice.
const BODY: Rgb<u8> = Rgb([255, 90, 40]);
/// Convention: a display choice.
const OTHER_BODY: Rgb<u8> = Rgb([160, 120, 200]);
/// Convention: a display choice.
const OUTLINE: Rgb<u8> = Rgb([0, 235, 255]);
/// Convention: a display choice.
const TEXT: Rgb<u8> = Rgb([255, 255, 255]);
/// The shorter side of a frame in which lengths are as below, px. Convention: a display choice.
const REFERENCE_SIDE_PX: f64 = 360.0;
/// Width of the lines, px. Convention: a display choice.
const WIDTH_PX: f64 = 1.0;
/// Convention: a display choice.
const TEXT_PX: f64 = 10.0;
/// Lines to either side of the sheet's middle, in both directions. Convention: a display choice.
const LINES_SHOWN: i32 = 10;
/// Characters in a line of text. Convention: a display choice.
const TEXT_COLUMNS: usize = 70;

/// Draws what a calibration saw, and what it said.
pub fn rig_picture(frame: &Frame, sketch: &RigSketch, said: &str) -> RgbImage {
    let mut picture = rgb(frame);
    let unit = f64::from(frame.height.min(frame.width)) / REFERENCE_SIDE_PX;
    if let (Some(lines_px), Some(middle)) = (sketch.lines_px, middle(&sketch.sheet)) {
        for line in lines(&middle, lines_px) {
            stroke(&mut picture, &line, 0.5 * WIDTH_PX * unit, LINES);
        }
    }
    let mut closed = |corners: &[Point2<f64>], colour| {
        let chain: Vec<Point2<f64>> = corners.iter().chain(corners.first()).copied().collect();
        stroke(&mut picture, &chain, WIDTH_PX * unit, colour);
    };
    closed(&sketch.sheet, SHEET);
    sketch.bodies.iter().skip(1).for_each(|body| closed(body, OTHER_BODY));
    sketch.bodies.iter().take(1).for_each(|body| closed(body, BODY));
    label(&mut picture, &wrapped(said), TEXT_PX * unit, TEXT, false);
    picture
}

/// Draws the straight snake of a rig that was found on such a picture.
pub fn draw_straight(picture: &mut RgbImage, rig: &Rig, lens: &Lens, robot: &Robot) {
    let unit = f64::from(picture.height().min(picture.width())) / REFERENCE_SIDE_PX;
    let view = Projection { lens, camera_from_base: rig.camera_from_base, robot };
    for point in Shape::of(&view, STRAIGHT).outline {
        stroke(picture, &[point], WIDTH_PX * unit, OUTLINE);
    }
}

/// The middle of some corners.
fn middle(corners: &[Point2<f64>]) -> Option<Point2<f64>> {
    let sum = corners.iter().map(|corner| corner.coords).sum::<Vector2<f64>>();
    (!corners.is_empty()).then(|| Point2::from(sum / corners.len() as f64))
}

/// Some lines of both directions around a place, the vectors from one to the next being these.
fn lines(middle: &Point2<f64>, [across, along]: [Vector2<f64>; 2]) -> Vec<[Point2<f64>; 2]> {
    let reach = f64::from(LINES_SHOWN);
    let of = |step: Vector2<f64>, other: Vector2<f64>| {
        (-LINES_SHOWN..=LINES_SHOWN).map(move |k| {
            let at = middle + step * f64::from(k);
            [at - other * reach, at + other * reach]
        })
    };
    of(across, along).chain(of(along, across)).collect()
}

/// A text in lines of at most so many characters, broken between words.
fn wrapped(text: &str) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in text.split_whitespace() {
        let line = lines.last_mut().filter(|line| line.chars().count() + word.chars().count() < TEXT_COLUMNS);
        match line {
            Some(line) if line.is_empty() => line.push_str(word),
            Some(line) => {
                line.push(' ');
                line.push_str(word);
            }
            None => lines.push(word.to_owned()),
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Samples;

    #[test]
    fn what_was_seen_is_drawn_where_it_is_and_said_in_full() {
        let frame = Frame { width: 360, height: 360, channels: 1, samples: Samples::Bits8(vec![100; 360 * 360]) };
        let square =
            |low: f64, high: f64| [(low, low), (high, low), (high, high), (low, high)].map(|(x, y)| Point2::new(x, y));
        let sketch = RigSketch {
            sheet: square(20.0, 340.0).to_vec(),
            lines_px: Some([Vector2::new(10.0, 0.0), Vector2::new(0.0, 10.0)]),
            bodies: vec![square(150.0, 200.0), square(250.0, 300.0)],
        };
        let picture = rig_picture(&frame, &sketch, "no snake was found");
        assert_eq!(picture.get_pixel(20, 200), &SHEET);
        assert_eq!(picture.get_pixel(150, 175), &BODY);
        assert_eq!(picture.get_pixel(250, 275), &OTHER_BODY);
        // A picture of which nothing was understood is drawn as well.
        rig_picture(&frame, &RigSketch::default(), "no printed grid was found");
    }

    #[test]
    fn text_is_broken_between_words() {
        let text = "word ".repeat(40);
        let lines = wrapped(&text);
        assert!(lines.len() > 2 && lines.iter().all(|line| line.chars().count() <= TEXT_COLUMNS));
        assert_eq!(lines.join(" "), text.trim());
    }
}
