//! A frame with what was measured drawn on it.

use crate::camera::{Frame, Samples};
use crate::measure::{Outline, Projection};
use crate::observation::{Measured, Measurement, Status};
use crate::quantity::with_sd;
use crate::robot::BendProfile;
use ab_glyph::{FontRef, PxScale};
use image::imageops::{FilterType, resize};
use image::{Rgb, RgbImage};
use imageproc::drawing::{draw_text_mut, text_size};
use nalgebra::{Point2, Point3};
use std::collections::BTreeMap;
use std::ops::Range;

// Colours. Convention: display choices.
const ARC: Rgb<u8> = Rgb([255, 120, 0]);
/// Convention: a display choice.
const OUTLINE: Rgb<u8> = Rgb([0, 235, 255]);
/// Convention: a display choice.
const BASE: Rgb<u8> = Rgb([60, 230, 60]);
/// Convention: a display choice.
const TIP: Rgb<u8> = Rgb([255, 60, 220]);
/// Convention: a display choice.
const GOOD_TEXT: Rgb<u8> = Rgb([255, 255, 255]);
/// Convention: a display choice.
const BAD_TEXT: Rgb<u8> = Rgb([255, 190, 90]);
/// Convention: a display choice.
const BOX: Rgb<u8> = Rgb([16, 20, 26]);

// Lengths, px, in a frame whose shorter side has REFERENCE_SIDE_PX; they grow with the frame. Convention: display choices.
const REFERENCE_SIDE_PX: f64 = 360.0;
/// Convention: a display choice.
const OUTLINE_DOT_PX: f64 = 0.8;
/// Convention: a display choice.
const ARC_WIDTH_PX: f64 = 1.2;
/// Convention: a display choice.
const END_DOT_PX: f64 = 5.0;
/// Convention: a display choice.
const TEXT_PX: f64 = 11.0;
/// Text is not smaller, px. Convention: a display choice.
const MIN_TEXT_PX: f64 = 9.0;
/// Share of the box behind the text in its pixels. Convention: a display choice.
const BOX_OPACITY: f64 = 0.7;
/// An angle with a larger σ is told as unknown, degrees. Convention: a display choice.
const UNKNOWN_DEG: f64 = 90.0;
/// Points of the drawn arc. Convention: a display choice.
const ARC_POINTS: usize = 60;

/// The model's shape in one picture, px.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Shape {
    /// The central backbone from base to tip, as a chain of points.
    pub arc: Vec<Point2<f64>>,
    /// Points of the outline.
    pub outline: Vec<Point2<f64>>,
}

impl Shape {
    /// The model's shape at a bend, as a view shows it.
    pub fn of(view: &Projection, profile: impl Into<BendProfile>) -> Self {
        let profile = profile.into();
        let curve = view.curve(profile);
        let arc = (0..=ARC_POINTS).map(|i| {
            let s_mm = view.robot.length_mm * i as f64 / ARC_POINTS as f64;
            let point = Point3::from(curve.frame_at(s_mm).translation.vector);
            view.lens.project(&(view.camera_from_base * point))
        });
        let outline = Outline::new(view, profile);
        Self { arc: arc.collect(), outline: outline.points.iter().map(|point| point.pixel).collect() }
    }
}

/// Draws outline, arc, base (green), tip (magenta) and the measured angles on a copy of the frame.
///
/// A frame without angles gets its status instead.
pub fn overlay(frame: &Frame, measurement: &Measurement, shape: Option<&Shape>) -> RgbImage {
    drawn(frame, (measurement, &caption(measurement)), shape)
}

/// The same for a picture that has no number.
pub fn overlay_unnumbered(frame: &Frame, measurement: &Measurement, shape: Option<&Shape>) -> RgbImage {
    drawn(frame, (measurement, &answer(measurement)), shape)
}

fn drawn(frame: &Frame, (measurement, lines): (&Measurement, &[String]), shape: Option<&Shape>) -> RgbImage {
    let mut picture = rgb(frame);
    let unit = f64::from(frame.height.min(frame.width)) / REFERENCE_SIDE_PX;
    if let Some(shape) = shape {
        for point in &shape.outline {
            stroke(&mut picture, &[*point], OUTLINE_DOT_PX * unit, OUTLINE);
        }
        stroke(&mut picture, &shape.arc, ARC_WIDTH_PX * unit, ARC);
        if let (Some(base), Some(tip)) = (shape.arc.first(), shape.arc.last()) {
            stroke(&mut picture, &[*base], END_DOT_PX * unit, BASE);
            stroke(&mut picture, &[*tip], END_DOT_PX * unit, TIP);
        }
    }
    let colour = if measurement.status == Status::Ok { GOOD_TEXT } else { BAD_TEXT };
    // On the side where the snake is not, so that pictures cut to it are free of it.
    let middle_px = shape.and_then(|shape| Some((shape.arc.first()?.x + shape.arc.last()?.x) / 2.0));
    let at_right = middle_px.is_some_and(|x| x < f64::from(frame.width) / 2.0);
    label(&mut picture, lines, TEXT_PX * unit, colour, at_right);
    picture
}

/// A picture made so narrow, px, if it is wider.
pub fn narrowed(picture: RgbImage, most: u32) -> RgbImage {
    if picture.width() <= most {
        return picture;
    }
    let height = (u64::from(picture.height()) * u64::from(most) / u64::from(picture.width())).max(1) as u32;
    resize(&picture, most, height, FilterType::Triangle)
}

/// Whether a pixel of a picture that was drawn on, and may have been a JPEG file since, has the outline's colour.
pub fn is_drawn_on(pixel: &Rgb<u8>) -> bool {
    // Convention: what JPEG leaves of a line one px wide; nothing of the snake or a grid target is so much bluer and greener than red.
    let [red, green, blue] = pixel.0.map(i32::from);
    green - red > 110 && blue - red > 110
}

/// Paints a part of a picture as the outline is drawn.
#[cfg(test)]
pub fn paint_for_test(picture: &mut RgbImage, columns: Range<u32>, rows: Range<u32>) {
    for (x, y) in columns.flat_map(|x| rows.clone().map(move |y| (x, y))) {
        picture.put_pixel(x, y, OUTLINE);
    }
}

/// The text in the picture's corner: the frame, then θ ± σ and δ ± σ, or the reason why they are missing.
fn caption(measurement: &Measurement) -> Vec<String> {
    let view = measurement.view.as_ref().map(|view| format!(", {view}")).unwrap_or_default();
    let frame = format!("frame {}{view}", measurement.index);
    std::iter::once(frame).chain(answer(measurement)).collect()
}

/// θ ± σ and δ ± σ, or the reason why they are missing.
fn answer(measurement: &Measurement) -> Vec<String> {
    let mut lines = Vec::new();
    if measurement.status != Status::Ok {
        lines.push(measurement.status.to_string());
    }
    if let Some(measured) = &measurement.measured {
        let (theta, delta) = angles(measured);
        lines.extend([format!("θ {theta}"), format!("δ {delta}")]);
    }
    lines
}

/// θ ± σ and δ ± σ in degrees, for people.
pub fn angles(measured: &Measured) -> (String, String) {
    let psi = measured.configuration;
    (plus_minus(psi.theta_deg(), measured.sigma_theta), plus_minus(psi.delta_deg(), measured.sigma_delta))
}

/// An angle with its σ.
fn plus_minus(angle_deg: f64, sigma: f64) -> String {
    let sigma_deg = sigma.to_degrees();
    if sigma_deg > UNKNOWN_DEG { "unknown".to_owned() } else { with_sd(angle_deg, sigma_deg) + "°" }
}

pub(super) fn rgb(frame: &Frame) -> RgbImage {
    if let (Samples::Bits8(samples), 3) = (&frame.samples, frame.channels)
        && let Some(picture) = RgbImage::from_raw(frame.width, frame.height, samples.clone())
    {
        return picture;
    }
    let level = |value: f32| value.round().clamp(0.0, 255.0) as u8;
    RgbImage::from_fn(frame.width, frame.height, |x, y| match frame.channels {
        1 => Rgb([level(frame.get(x, y, 0)); 3]),
        _ => Rgb([0, 1, 2].map(|c| level(frame.get(x, y, c)))),
    })
}

/// Draws a chain of points as one line with round ends, `width` px wide, its border smoothed over a pixel. One point
/// alone is a dot. Points that are not in a picture (NaN, far away) are left out.
pub(super) fn stroke(picture: &mut RgbImage, chain: &[Point2<f64>], width: f64, colour: Rgb<u8>) {
    let (columns, rows) = (f64::from(picture.width()), f64::from(picture.height()));
    let near = |p: &&Point2<f64>| p.x > -columns && p.x < 2.0 * columns && p.y > -rows && p.y < 2.0 * rows;
    let chain: Vec<Point2<f64>> = chain.iter().filter(near).copied().collect();
    let segments: Vec<[Point2<f64>; 2]> = match chain[..] {
        [dot] => vec![[dot, dot]],
        _ => chain.windows(2).map(|pair| [pair[0], pair[1]]).collect(),
    };
    // Where segments overlap the line must not be blended twice, so each pixel's share is settled first.
    let mut shares = BTreeMap::new();
    let reach = width / 2.0 + 0.5;
    for segment in &segments {
        let [from, to] = segment;
        for y in pixels_between(from.y, to.y, reach, picture.height()) {
            for x in pixels_between(from.x, to.x, reach, picture.width()) {
                let share = reach - distance_to(segment, &Point2::new(f64::from(x), f64::from(y)));
                if share > 0.0 {
                    let most: &mut f64 = shares.entry((y, x)).or_default();
                    *most = most.max(share.min(1.0));
                }
            }
        }
    }
    for ((y, x), share) in shares {
        blend(picture.get_pixel_mut(x, y), colour, share);
    }
}

/// The pixel rows (or columns) within `reach` of two positions, as far as the picture goes.
fn pixels_between(a: f64, b: f64, reach: f64, size: u32) -> Range<u32> {
    let within = |position: f64| position.clamp(0.0, f64::from(size)) as u32;
    within((a.min(b) - reach).floor())..within((a.max(b) + reach).ceil() + 1.0)
}

fn distance_to([from, to]: &[Point2<f64>; 2], point: &Point2<f64>) -> f64 {
    let along = to - from;
    let share = if along.norm_squared() > 0.0 { (point - from).dot(&along) / along.norm_squared() } else { 0.0 };
    (from + along * share.clamp(0.0, 1.0) - point).norm()
}

fn blend(pixel: &mut Rgb<u8>, colour: Rgb<u8>, share: f64) {
    for (below, above) in pixel.0.iter_mut().zip(colour.0) {
        *below = (f64::from(*below) * (1.0 - share) + f64::from(above) * share).round() as u8;
    }
}

/// Writes lines of text on a dark box in the top left or right corner, `size` px high each.
pub(super) fn label(picture: &mut RgbImage, lines: &[String], size: f64, colour: Rgb<u8>, at_right: bool) {
    let Ok(font) = FontRef::try_from_slice(epaint_default_fonts::HACK_REGULAR) else { return };
    let size = size.max(MIN_TEXT_PX);
    let scale = PxScale::from(size as f32);
    let (step, pad) = ((1.25 * size) as u32, (0.5 * size) as u32);
    let width = lines.iter().map(|line| text_size(scale, &font, line).0).max().unwrap_or(0);
    let (wide, high) = ((width + 2 * pad).min(picture.width()), step * lines.len() as u32 + pad);
    let left = if at_right { picture.width() - wide } else { 0 };
    for y in 0..high.min(picture.height()) {
        for x in left..left + wide {
            blend(picture.get_pixel_mut(x, y), BOX, BOX_OPACITY);
        }
    }
    for (row, line) in lines.iter().enumerate() {
        let top = (pad / 2 + step * row as u32) as i32;
        draw_text_mut(picture, colour, (left + pad) as i32, top, scale, &font, line);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Configuration;
    use ab_glyph::Font;

    fn grey_frame() -> Frame {
        Frame { width: 200, height: 120, channels: 1, samples: Samples::Bits8(vec![100; 200 * 120]) }
    }

    fn measurement(theta_deg: f64, delta_deg: f64, sigma_deg: f64) -> Measurement {
        let sigma = sigma_deg.to_radians();
        Measurement {
            index: 12,
            time_s: None,
            status: Status::Ok,
            measured: Some(Measured::independent(Configuration::from_degrees(theta_deg, delta_deg), sigma, sigma, 0.0)),
            quality: None,
            view: Some("side".into()),
        }
    }

    #[test]
    fn the_font_has_the_letters_the_captions_use() {
        let font = FontRef::try_from_slice(epaint_default_fonts::HACK_REGULAR).unwrap();
        for letter in "θδ±°−_0123456789".chars() {
            assert_ne!(font.glyph_id(letter).0, 0, "{letter}");
        }
    }

    #[test]
    fn captions_carry_as_many_digits_as_the_sigma_deserves() {
        assert_eq!(
            caption(&measurement(30.0, -12.0, 0.05)),
            ["frame 12, side", "θ 30.000 ± 0.050°", "δ −12.000 ± 0.050°"]
        );
        assert_eq!(caption(&measurement(3.0, 12.0, 20.0))[2], "δ 12 ± 20°");
        assert_eq!(caption(&measurement(0.0, 0.0, 170.0))[2], "δ unknown");
        let failed = Measurement { status: Status::NoSnake, measured: None, ..measurement(0.0, 0.0, 1.0) };
        assert_eq!(caption(&failed), ["frame 12, side", "no_snake"]);
    }

    #[test]
    fn a_line_is_drawn_where_it_is_and_as_wide_as_it_is() {
        let mut picture = RgbImage::new(40, 40);
        stroke(&mut picture, &[Point2::new(5.0, 20.0), Point2::new(35.0, 20.0)], 5.0, Rgb([255; 3]));
        let column: Vec<u8> = (15..26).map(|y| picture.get_pixel(20, y).0[0]).collect();
        assert_eq!(column, [0, 0, 0, 255, 255, 255, 255, 255, 0, 0, 0]);
        let ink: u32 = picture.pixels().map(|p| u32::from(p.0[0])).sum();
        let area = 30.0 * 5.0 + std::f64::consts::PI * 2.5 * 2.5;
        assert!((f64::from(ink) / 255.0 - area).abs() < 0.03 * area);
    }

    #[test]
    fn points_outside_the_picture_do_no_harm() {
        let far = [Point2::new(f64::NAN, 3.0), Point2::new(1e12, -1e12), Point2::new(-30.0, -30.0)];
        let shape = Shape { arc: far.to_vec(), outline: far.to_vec() };
        let picture = overlay(&grey_frame(), &measurement(10.0, 10.0, 0.1), Some(&shape));
        assert_eq!(picture.get_pixel(150, 100), &Rgb([100; 3]));
    }

    #[test]
    fn base_and_tip_are_marked_at_the_ends_of_the_arc() {
        let arc = vec![Point2::new(100.0, 100.0), Point2::new(120.0, 80.0), Point2::new(170.0, 70.0)];
        let picture = overlay(&grey_frame(), &measurement(10.0, 10.0, 0.1), Some(&Shape { arc, outline: vec![] }));
        assert_eq!(picture.get_pixel(100, 100), &BASE);
        assert_eq!(picture.get_pixel(170, 70), &TIP);
    }
}
