//! Finds the unbent snake in a picture of which nothing is known but the camera: the start of a rig calibration.

use super::appearance::Appearance;
use super::plane::{Plane, median};
use crate::camera::Frame;
use image::{GrayImage, Luma};
use imageproc::contrast::otsu_level;
use imageproc::region_labelling::{Connectivity, connected_components};
use nalgebra::{DMatrix, DVector, Point2, Unit, Vector2};

/// The unbent snake in a picture, roughly.
#[derive(Debug, Clone)]
pub struct StraightSnake {
    /// Middle of the holder's upper end, where the snake begins, px.
    pub base: Point2<f64>,
    /// Direction from the holder to the tip.
    pub axis: Unit<Vector2<f64>>,
    /// Width of the holder, px.
    pub width_px: f64,
    /// What tells snake from paper in this picture.
    pub appearance: Appearance,
}

/// Side of the blocks of pixels that are looked at as one.
const BLOCK: usize = 4;

/// Finds the unbent snake by its holder: the largest thick object that differs from the paper and is cut by a border.
///
/// Printed lines are thinner than three blocks and are dropped first. Then the holder's own colour tells snake from
/// paper, and its sides and its upper end are looked for in that.
///
/// # Errors
///
/// A sentence that says what was not found.
pub fn locate_straight(frame: &Frame) -> Result<StraightSnake, String> {
    let no_object = "no object stands out from the paper; is the snake in the picture?";
    let mut object = largest_component(&opened(&unlike_paper(frame)));
    let mut learned = None;
    for _ in 0..2 {
        let appearance = Appearance::learn(frame, |x, y| Some(block_is_set(&object, x, y))).ok_or(no_object)?;
        object = largest_component(&opened(&above_half(&appearance.plane(frame).shrunk(BLOCK))));
        learned = Some(appearance);
    }
    let appearance = learned.ok_or(no_object)?;
    let rough = rough_axis(&object)?;
    let plane = appearance.plane(frame);
    let (base, axis, width_px) = follow_holder(&plane, &rough)?;
    Ok(StraightSnake { base, axis, width_px, appearance })
}

fn block_is_set(mask: &GrayImage, x: u32, y: u32) -> bool {
    mask.get_pixel_checked(x / BLOCK as u32, y / BLOCK as u32).is_some_and(|p| p.0[0] > 0)
}

/// Drops what is thinner than three blocks.
fn opened(mask: &GrayImage) -> GrayImage {
    imageproc::morphology::open(mask, imageproc::distance_transform::Norm::LInf, 1)
}

/// Blocks whose colour is unlike that of the paper, a smooth surface that fills most of the picture.
fn unlike_paper(frame: &Frame) -> GrayImage {
    let channels: Vec<Plane> = (0..frame.channels).map(|c| smoothed(&channel(frame, c).shrunk(BLOCK))).collect();
    let (width, height) = (channels[0].width, channels[0].height);
    let mut distance = vec![0.0_f32; width * height];
    for plane in &channels {
        let residual = minus_smooth_surface(plane);
        let mut size: Vec<f32> = residual.iter().map(|r| r.abs()).collect();
        let scale = (1.4826 * median(&mut size)).max(0.5);
        for (d, r) in distance.iter_mut().zip(&residual) {
            *d += (r / scale).powi(2);
        }
    }
    // The square root of the distance squeezes the range so that neither a black snake nor a highlight rules the threshold.
    let values: Vec<f32> = distance.iter().map(|d| d.sqrt().sqrt()).collect();
    let top = values.iter().copied().fold(f32::MIN_POSITIVE, f32::max);
    let scaled = GrayImage::from_fn(width as u32, height as u32, |x, y| {
        Luma([(values[y as usize * width + x as usize] / top * 255.0) as u8])
    });
    let level = otsu_level(&scaled);
    GrayImage::from_fn(width as u32, height as u32, |x, y| {
        Luma([if scaled.get_pixel(x, y).0[0] > level { 255 } else { 0 }])
    })
}

fn channel(frame: &Frame, c: usize) -> Plane {
    let data = frame.data.iter().skip(c).step_by(frame.channels).copied().collect();
    Plane { width: frame.width as usize, height: frame.height as usize, data }
}

/// The mean over 3 × 3 blocks.
fn smoothed(plane: &Plane) -> Plane {
    let mut data = Vec::with_capacity(plane.data.len());
    for y in 0..plane.height as i64 {
        for x in 0..plane.width as i64 {
            let sum: f32 = (-1..=1)
                .flat_map(|dy| (-1..=1).map(move |dx| (dx, dy)))
                .map(|(dx, dy)| plane.get(x + dx, y + dy))
                .sum();
            data.push(sum / 9.0);
        }
    }
    Plane { width: plane.width, height: plane.height, data }
}

/// What remains of a plane after a quadratic surface, fitted to the majority of it, is taken away.
fn minus_smooth_surface(plane: &Plane) -> Vec<f32> {
    let (w, h) = (plane.width, plane.height);
    let terms = |k: usize| {
        let (x, y) = ((k % w) as f64 / w as f64 - 0.5, (k / w) as f64 / h as f64 - 0.5);
        DVector::from_column_slice(&[1.0, x, y, x * x, x * y, y * y])
    };
    let mut level = plane.data.clone();
    let start = f64::from(median(&mut level));
    let mut surface = DVector::from_column_slice(&[start, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let mut residual = Vec::new();
    for _ in 0..6 {
        residual = (0..w * h).map(|k| plane.data[k] - surface.dot(&terms(k)) as f32).collect::<Vec<_>>();
        let mut size: Vec<f32> = residual.iter().map(|r| r.abs()).collect();
        let limit = (2.5 * 1.4826 * median(&mut size)).max(0.5);
        let mut normal = DMatrix::identity(6, 6) * 1e-9;
        let mut right = DVector::zeros(6);
        for k in (0..w * h).step_by(7).filter(|&k| residual[k].abs() < limit) {
            let t = terms(k);
            right += &t * f64::from(plane.data[k]);
            normal += &t * t.transpose();
        }
        match normal.cholesky() {
            Some(factor) => surface = factor.solve(&right),
            None => break,
        }
    }
    residual
}

fn above_half(plane: &Plane) -> GrayImage {
    GrayImage::from_fn(plane.width as u32, plane.height as u32, |x, y| {
        Luma([if plane.get(i64::from(x), i64::from(y)) > 0.5 { 255 } else { 0 }])
    })
}

/// Keeps the largest connected component only.
fn largest_component(mask: &GrayImage) -> GrayImage {
    let labels = connected_components(mask, Connectivity::Eight, Luma([0]));
    let mut sizes = std::collections::HashMap::new();
    for label in labels.pixels().map(|p| p.0[0]).filter(|&l| l > 0) {
        *sizes.entry(label).or_insert(0_usize) += 1;
    }
    let largest = sizes.into_iter().max_by_key(|&(label, size)| (size, label)).map_or(0, |(label, _)| label);
    GrayImage::from_fn(mask.width(), mask.height(), |x, y| {
        Luma([if largest > 0 && labels.get_pixel(x, y).0[0] == largest { 255 } else { 0 }])
    })
}

/// A line along the holder, px of the full picture.
struct Axis {
    /// Where the object is cut by the picture's border.
    root: Point2<f64>,
    /// Into the picture.
    direction: Vector2<f64>,
    /// A guess of the holder's width.
    width_px: f64,
}

/// The object's middle line near the border that cuts it.
fn rough_axis(object: &GrayImage) -> Result<Axis, String> {
    let (w, h) = (object.width(), object.height());
    let inside: Vec<Point2<f64>> = object
        .enumerate_pixels()
        .filter(|(_, _, p)| p.0[0] > 0)
        .map(|(x, y, _)| Point2::new(f64::from(x), f64::from(y)) * BLOCK as f64)
        .collect();
    if inside.len() < 50 {
        return Err("no object stands out from the paper; is the snake in the picture?".into());
    }
    // The border with most of the object on it is the one the holder comes from.
    let (right, bottom) = (f64::from((w - 1) * BLOCK as u32), f64::from((h - 1) * BLOCK as u32));
    let borders: [(fn(&Point2<f64>) -> f64, f64, Vector2<f64>); 4] = [
        (|p| p.y, bottom, -Vector2::y()),
        (|p| p.y, 0.0, Vector2::y()),
        (|p| p.x, 0.0, Vector2::x()),
        (|p| p.x, right, -Vector2::x()),
    ];
    let on = |(coordinate, at, _): &(fn(&Point2<f64>) -> f64, f64, Vector2<f64>)| -> Vec<Vector2<f64>> {
        inside.iter().filter(|p| (coordinate(p) - at).abs() < 1.5 * BLOCK as f64).map(|p| p.coords).collect()
    };
    let (cut, inward) = borders.iter().map(|b| (on(b), b.2)).max_by_key(|(cut, _)| cut.len()).unwrap_or_default();
    if cut.is_empty() {
        return Err("the object that stands out does not reach the picture's border, as the snake's holder would".into());
    }
    let root = Point2::from(cut.iter().sum::<Vector2<f64>>() / cut.len() as f64);
    let across = Vector2::new(-inward.y, inward.x);
    let side = cut.iter().map(|p| across.dot(p));
    let (low, high) = side.fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(v), high.max(v)));
    let width_px = high - low + BLOCK as f64;
    // The object within about one width of the border shows which way it goes.
    let near: Vec<Vector2<f64>> =
        inside.iter().map(|p| p - root).filter(|d| (0.0..1.5 * width_px).contains(&inward.dot(d))).collect();
    let (sxx, sxy) = near.iter().fold((0.0, 0.0), |(sxx, sxy), d| {
        let (x, y) = (inward.dot(d), across.dot(d));
        (sxx + x * x, sxy + x * y)
    });
    let slope = if sxx > 0.0 { sxy / sxx } else { 0.0 };
    Ok(Axis { root, direction: (inward + across * slope).normalize(), width_px })
}

/// Follows the holder's two sides from the border to its upper end: the end's middle, the direction and the width.
fn follow_holder(plane: &Plane, rough: &Axis) -> Result<(Point2<f64>, Unit<Vector2<f64>>, f64), String> {
    const STEP_PX: f64 = 2.0;
    let mut axis = rough.direction;
    let mut root = rough.root.coords;
    let mut width = rough.width_px;
    for _ in 0..8 {
        let across = Vector2::new(-axis.y, axis.x);
        // Slices that are snake from side to side, from the border on.
        let mut slices: Vec<(f64, f64, f64)> = Vec::new();
        let mut along = 2.0 * STEP_PX;
        let mut missed = 0;
        while missed < 4 {
            let centre = Point2::from(root + axis * along);
            match slice(plane, &centre, across, width) {
                Some((middle, full)) => {
                    slices.push((along, middle, full));
                    missed = 0;
                }
                None => missed += 1,
            }
            along += STEP_PX;
        }
        if slices.len() < 8 {
            return Err("the snake's holder was not found at the picture's border: it must be seen for at least half its \
                        width below the snake"
                .into());
        }
        let line: Vec<(f64, f64)> = slices.iter().map(|(along, middle, _)| (*along, *middle)).collect();
        let (offset, slope) = fit_line(&line).ok_or("the holder's direction could not be determined")?;
        let mut widths: Vec<f32> = slices.iter().map(|(_, _, full)| *full as f32).collect();
        width = f64::from(median(&mut widths));
        let last = slices[slices.len() - 1].0;
        root += across * offset;
        axis = (axis + across * slope).normalize();
        let end = root + axis * last;
        if slope.abs() < 0.005 && offset.abs() < 1.5 {
            return Ok((Point2::from(end), Unit::new_normalize(axis), width));
        }
    }
    Err("the holder's sides are not straight; take the picture with nothing across the holder".into())
}

/// The middle (px from `centre`) and width of a slice that is snake throughout, if it is about `width` wide.
fn slice(plane: &Plane, centre: &Point2<f64>, across: Vector2<f64>, width: f64) -> Option<(f64, f64)> {
    let at = |offset: f64| plane.sample(&(centre + across * offset));
    let within = |p: Point2<f64>| p.x >= 0.0 && p.y >= 0.0 && p.x < plane.width as f64 && p.y < plane.height as f64;
    let reach = 0.75 * width;
    if !within(centre + across * reach) || !within(centre - across * reach) {
        return None;
    }
    // A highlight may be as bright as paper, but not over a quarter of the holder; the tubes above it leave more free.
    let count = (0.8 * width) as i32;
    let solid = (0..=count).filter(|k| at((f64::from(*k) / f64::from(count) - 0.5) * 0.8 * width) > 0.4).count();
    if (solid as f64) < 0.75 * f64::from(count + 1) {
        return None;
    }
    // From the paper inwards to where the snake begins for good: print is thin.
    const THICKER_THAN_PRINT_PX: i32 = 8;
    let side = |sign: f64| -> Option<f64> {
        let begins = |d: &f64| (0..THICKER_THAN_PRINT_PX).all(|k| at(sign * (d - f64::from(k))) > 0.5);
        (0..(0.5 * width) as i32).map(|k| reach - f64::from(k)).find(begins)
    };
    let (left, right) = (side(-1.0)?, side(1.0)?);
    Some(((right - left) / 2.0, left + right))
}

/// Least-squares line y = a + b x.
fn fit_line(points: &[(f64, f64)]) -> Option<(f64, f64)> {
    let n = points.len() as f64;
    let (mx, my) = points.iter().fold((0.0, 0.0), |(a, b), (x, y)| (a + x / n, b + y / n));
    let (sxx, sxy) = points.iter().fold((0.0, 0.0), |(a, b), (x, y)| (a + (x - mx).powi(2), b + (x - mx) * (y - my)));
    (sxx > 0.0).then(|| (my - sxy / sxx * mx, sxy / sxx))
}
