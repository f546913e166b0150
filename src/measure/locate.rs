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
    /// Middle of the far end, px.
    pub tip: Point2<f64>,
    /// Direction from the holder to the tip.
    pub axis: Unit<Vector2<f64>>,
    /// Width of disks and holder, px.
    pub width_px: f64,
    /// What tells snake from paper in this picture.
    pub appearance: Appearance,
}

/// Side of the blocks of pixels that are looked at as one.
const BLOCK: usize = 4;

/// Finds the unbent snake: the largest object that differs from the paper, long and straight, cut by one border.
///
/// # Errors
///
/// A sentence that says what was not found.
pub fn locate_straight(frame: &Frame) -> Result<StraightSnake, String> {
    let mut mask = largest_component(&unlike_paper(frame));
    let mut appearance = None;
    for _ in 0..2 {
        let learned = Appearance::learn(frame, |x, y| Some(block_is_set(&mask, x, y)))
            .ok_or("nothing in the picture stands out from the background")?;
        mask = largest_component(&above_half(&learned.plane(frame).shrunk(BLOCK)));
        appearance = Some(learned);
    }
    let LongShape { tip, axis, width_px } = measure_shape(&mask)?;
    Ok(StraightSnake { tip, axis, width_px, appearance: appearance.ok_or("no appearance was learned")? })
}

fn block_is_set(mask: &GrayImage, x: u32, y: u32) -> bool {
    mask.get_pixel_checked(x / BLOCK as u32, y / BLOCK as u32).is_some_and(|p| p.0[0] > 0)
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

/// A long object cut by the picture's border, px of the full picture.
struct LongShape {
    tip: Point2<f64>,
    axis: Unit<Vector2<f64>>,
    width_px: f64,
}

/// Tip, axis and width of the object in a mask of blocks.
fn measure_shape(mask: &GrayImage) -> Result<LongShape, String> {
    let (w, h) = (mask.width(), mask.height());
    let inside: Vec<Vector2<f64>> = mask
        .enumerate_pixels()
        .filter(|(_, _, p)| p.0[0] > 0)
        .map(|(x, y, _)| Vector2::new(f64::from(x), f64::from(y)))
        .collect();
    if inside.len() < 100 {
        return Err("no object stands out from the paper; is the snake in the picture?".into());
    }
    let at_border: Vec<_> = inside
        .iter()
        .filter(|p| p.x < 1.0 || p.y < 1.0 || p.x > f64::from(w) - 2.0 || p.y > f64::from(h) - 2.0)
        .collect();
    if at_border.is_empty() {
        return Err(
            "the object that stands out does not reach the picture's border, as the snake's holder would".into()
        );
    }
    let root = at_border.iter().copied().sum::<Vector2<f64>>() / at_border.len() as f64;
    let mean = inside.iter().sum::<Vector2<f64>>() / inside.len() as f64;
    let scatter: nalgebra::Matrix2<f64> = inside.iter().map(|p| (p - mean) * (p - mean).transpose()).sum();
    let eigen = scatter.symmetric_eigen();
    let major = eigen.eigenvalues.imax();
    if eigen.eigenvalues[major] < 9.0 * eigen.eigenvalues[1 - major] {
        return Err(
            "the object that stands out is not long and straight; take the picture with the snake unbent".into()
        );
    }
    let mut axis = eigen.eigenvectors.column(major).into_owned();
    if axis.dot(&(mean - root)) < 0.0 {
        axis = -axis;
    }
    let across = Vector2::new(-axis.y, axis.x);

    // Slices across the axis: those through disks and holder have the full width.
    let mut slices = std::collections::BTreeMap::new();
    for p in &inside {
        let (along, side) = (axis.dot(&(p - mean)), across.dot(&(p - mean)));
        let slice = slices.entry(along.round() as i64).or_insert((side, side));
        *slice = (slice.0.min(side), slice.1.max(side));
    }
    let mut widths: Vec<f32> = slices.values().map(|(low, high)| (high - low + 1.0) as f32).collect();
    widths.sort_by(f32::total_cmp);
    let width = f64::from(widths[widths.len() * 85 / 100]);
    let full: Vec<(f64, f64)> = slices
        .iter()
        .filter(|(_, (low, high))| (high - low + 1.0 - width).abs() < 0.15 * width)
        .map(|(&along, (low, high))| (along as f64, (low + high) / 2.0))
        .collect();
    let line = fit_line(&full).ok_or("the snake's axis could not be determined")?;
    let last = *slices.keys().next_back().ok_or("the snake's tip was not found")? as f64;
    let in_blocks = mean + axis * (last + 0.5) + across * (line.0 + line.1 * (last + 0.5));
    let tip = Point2::from(in_blocks * BLOCK as f64).map(|v| v + (BLOCK as f64 - 1.0) / 2.0);
    Ok(LongShape { tip, axis: Unit::new_normalize(axis + across * line.1), width_px: width * BLOCK as f64 })
}

/// Least-squares line y = a + b x.
fn fit_line(points: &[(f64, f64)]) -> Option<(f64, f64)> {
    let n = points.len() as f64;
    let (mx, my) = points.iter().fold((0.0, 0.0), |(a, b), (x, y)| (a + x / n, b + y / n));
    let (sxx, sxy) = points.iter().fold((0.0, 0.0), |(a, b), (x, y)| (a + (x - mx).powi(2), b + (x - mx) * (y - my)));
    (sxx > 0.0).then(|| (my - sxy / sxx * mx, sxy / sxx))
}
