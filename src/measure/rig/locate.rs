//! Finds the unbent snake in a picture of which nothing is known but the camera: the start of a rig calibration.

use crate::camera::Frame;
use crate::measure::image::appearance::Appearance;
use crate::measure::image::plane::{Plane, median};
use image::{GrayImage, Luma};
use imageproc::contrast::otsu_level;
use imageproc::region_labelling::{Connectivity, connected_components};
use nalgebra::{DMatrix, DVector, Matrix6, Point2, Vector2, Vector6};

/// The snake's holder in a picture of which nothing is known, roughly.
#[derive(Debug, Clone)]
pub struct Holder {
    /// Where the holder is cut by the picture's border, px.
    pub root: Point2<f64>,
    /// From there towards the snake.
    pub axis: Vector2<f64>,
    /// Its width, px, or less: where it is lit it may look like paper.
    pub width_px: f64,
}

/// Where the snake begins, more precisely.
#[derive(Debug, Clone)]
pub struct SnakeStart {
    /// Middle of the holder's upper end, px.
    pub base: Point2<f64>,
    /// Direction from the holder to the tip.
    pub axis: Vector2<f64>,
}

/// Side of the blocks of pixels that are looked at as one.
const BLOCK: usize = 4;

/// The colours of a picture, channel by channel, or what the two colours of a checkerboard leave unexplained of them.
pub struct Colours {
    planes: Vec<Plane>,
    is_without_squares: bool,
}

impl Colours {
    /// How a picture may be looked at, most promising first: where it has a checkerboard, without its colours; and as it is.
    pub fn of(frame: &Frame) -> Vec<Self> {
        let planes: Vec<Plane> = (0..frame.channels).map(|c| channel(frame, c)).collect();
        let without = Squares::find(&planes).map(|squares| squares.unexplained(&planes));
        let without = without.map(|planes| Self { planes, is_without_squares: true });
        without.into_iter().chain([Self { planes, is_without_squares: false }]).collect()
    }
}

/// The two colours of a checkerboard, each a smooth surface in every channel.
struct Squares {
    surfaces: [Vec<Vector6<f64>>; 2],
}

impl Squares {
    /// The colours, if the picture has two that each cover much of it. In grey two levels explain all between them.
    fn find(planes: &[Plane]) -> Option<Self> {
        let shrunk: Vec<Plane> = planes.iter().map(|plane| plane.shrunk(BLOCK)).collect();
        let count = shrunk.first().map_or(0, |plane| plane.data.len());
        if planes.len() < 2 || count == 0 {
            return None;
        }
        let residuals: Vec<Vec<f32>> = shrunk.iter().map(minus_smooth_surface).collect();
        let colour = |k: usize| DVector::from_iterator(residuals.len(), residuals.iter().map(|r| f64::from(r[k])));
        let mean = (0..count).map(colour).sum::<DVector<f64>>() / count as f64;
        let scatter = (0..count).map(|k| colour(k) - &mean).map(|c| &c * c.transpose()).sum::<DMatrix<f64>>();
        let eigen = scatter.symmetric_eigen();
        let direction = eigen.eigenvectors.column(eigen.eigenvalues.imax());
        let along: Vec<f64> = (0..count).map(|k| direction.dot(&(colour(k) - &mean))).collect();

        // Two means: the border between the classes is half way between them.
        let mean_of = |border: f64, above: bool| {
            let class = along.iter().filter(|&&v| (v > border) == above);
            let (sum, number) = class.fold((0.0, 0.0), |(sum, number), v| (sum + v, number + 1.0));
            (sum / f64::max(number, 1.0), number / count as f64)
        };
        let border = (0..20).fold(0.0, |border, _| (mean_of(border, true).0 + mean_of(border, false).0) / 2.0);
        let ((high, share), (low, _)) = (mean_of(border, true), mean_of(border, false));
        let variance = along.iter().map(|v| v * v).sum::<f64>() / count as f64;
        // Each colour has half of the paper, and the snake and its shadow cover far less than a quarter of the picture. Of
        // values spread evenly two classes explain three quarters of the variance, of noise or shading less.
        let has_two = (0.25..0.75).contains(&share) && share * (1.0 - share) * (high - low).powi(2) > 0.75 * variance;
        if !has_two {
            return None;
        }

        let mut is_second: Vec<bool> = along.iter().map(|&v| v > border).collect();
        let fitted = |is_second: &[bool]| Self {
            surfaces: [false, true]
                .map(|class| shrunk.iter().map(|plane| smooth_surface(plane, |k| is_second[k] == class)).collect()),
        };
        for _ in 0..3 {
            let squares = fitted(&is_second);
            is_second = (0..count).map(|k| squares.second_share(&shrunk, k) > 0.5).collect();
        }
        Some(fitted(&is_second))
    }

    /// How much of the second colour is in the mixture of both that is nearest to a pixel's, 0 to 1.
    fn second_share(&self, planes: &[Plane], k: usize) -> f64 {
        let terms = terms(&planes[0], k);
        let (mut along, mut length) = (0.0, 0.0);
        for (c, plane) in planes.iter().enumerate() {
            let first = self.surfaces[0][c].dot(&terms);
            let apart = self.surfaces[1][c].dot(&terms) - first;
            along += apart * (f64::from(plane.data[k]) - first);
            length += apart * apart;
        }
        (along / length.max(1e-9)).clamp(0.0, 1.0)
    }

    /// What is left of each pixel's colour without the nearest mixture of both: borders between squares are mixtures.
    fn unexplained(&self, planes: &[Plane]) -> Vec<Plane> {
        let count = planes[0].data.len();
        let shares: Vec<f64> = (0..count).map(|k| self.second_share(planes, k)).collect();
        let left = |c: usize, k: usize| {
            let mixture = self.surfaces[0][c] * (1.0 - shares[k]) + self.surfaces[1][c] * shares[k];
            planes[c].data[k] - mixture.dot(&terms(&planes[c], k)) as f32
        };
        let plane = |c: usize| (0..count).map(|k| left(c, k)).collect();
        (0..planes.len()).map(|c| Plane::new(planes[c].width, planes[c].height, plane(c))).collect()
    }
}

/// Finds what may be the holder, most likely first: large thick objects that differ from the paper and are cut by a border.
///
/// Printed lines are thinner than three blocks and are dropped. The squares of a checkerboard are not; where their colours
/// do not tell them and they make up the largest object, the picture is looked at through ever larger means, in which
/// they vanish.
///
/// # Errors
///
/// A sentence that says what was not found.
pub fn locate_holders(frame: &Frame, colours: &Colours) -> Result<Vec<Holder>, String> {
    const MOST: usize = 3;
    let mut found: Vec<Holder> = Vec::new();
    let mut refused = None;
    let mut take = |outcome: Result<Holder, String>| match outcome {
        Ok(holder) if found.iter().any(|other| other.is_like(&holder)) => {}
        Ok(holder) => found.push(holder),
        Err(message) => refused = refused.take().or(Some(message)),
    };
    for object in components(&opened(&unlike_paper(colours, 1))).into_iter().take(MOST) {
        // One mix of channels cannot tell the snake from squares of two colours; what they leave unexplained has done so.
        let object = if colours.is_without_squares { Ok(object) } else { refined(frame, object) };
        take(object.and_then(|object| rough_axis(&object)));
    }
    for reach in [4, 8, 12, 18] {
        for object in components(&unlike_paper(colours, reach)).iter().take(1) {
            take(rough_axis(object));
        }
    }
    found.truncate(MOST);
    if found.is_empty() { Err(refused.unwrap_or_else(|| NOTHING.into())) } else { Ok(found) }
}

const NOTHING: &str = "no object stands out from the paper; is the snake in the picture?";

impl Holder {
    /// Whether two findings are the same object.
    fn is_like(&self, other: &Self) -> bool {
        let width_px = self.width_px.max(other.width_px);
        (self.root - other.root).norm() < 0.2 * width_px && (self.width_px - other.width_px).abs() < 0.2 * width_px
    }
}

/// The object as its own colours show it.
fn refined(frame: &Frame, object: GrayImage) -> Result<GrayImage, String> {
    let mut object = object;
    for _ in 0..2 {
        let appearance = Appearance::learn(frame, |x, y| Some((block_is_set(&object, x, y), 1.0))).ok_or(NOTHING)?;
        let overlap =
            |other: &GrayImage| other.pixels().zip(object.pixels()).filter(|(a, b)| a.0[0] & b.0[0] > 0).count();
        let others = components(&opened(&above_half(&appearance.plane(frame).shrunk(BLOCK))));
        object = others.into_iter().max_by_key(overlap).ok_or(NOTHING)?;
    }
    Ok(object)
}

fn block_is_set(mask: &GrayImage, x: u32, y: u32) -> bool {
    mask.get_pixel_checked(x / BLOCK as u32, y / BLOCK as u32).is_some_and(|p| p.0[0] > 0)
}

/// Drops what is thinner than three blocks.
fn opened(mask: &GrayImage) -> GrayImage {
    imageproc::morphology::open(mask, imageproc::distance_transform::Norm::LInf, 1)
}

/// Blocks whose colour, as a mean over `reach` blocks around them, is unlike that of the paper, a smooth surface that fills most of the picture.
fn unlike_paper(colours: &Colours, reach: i64) -> GrayImage {
    let channels: Vec<Plane> = colours.planes.iter().map(|plane| smoothed(&plane.shrunk(BLOCK), reach)).collect();
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
    let data = (c..frame.samples.len()).step_by(frame.channels).map(|k| frame.samples.level(k)).collect();
    Plane::new(frame.width as usize, frame.height as usize, data)
}

/// The mean over (2 reach + 1)² blocks.
fn smoothed(plane: &Plane, reach: i64) -> Plane {
    let pass = |plane: &Plane, dx: i64, dy: i64| {
        let (w, h) = (plane.width as i64, plane.height as i64);
        let mean = |x: i64, y: i64| (-reach..=reach).map(|k| plane.get(x + k * dx, y + k * dy)).sum::<f32>();
        let scale = 1.0 / (2 * reach + 1) as f32;
        let data = (0..w * h).map(|k| mean(k % w, k / w) * scale).collect();
        Plane::new(plane.width, plane.height, data)
    };
    pass(&pass(plane, 1, 0), 0, 1)
}

/// What remains of a plane after a quadratic surface, fitted to the majority of it, is taken away.
fn minus_smooth_surface(plane: &Plane) -> Vec<f32> {
    let surface = smooth_surface(plane, |_| true);
    (0..plane.data.len()).map(|k| plane.data[k] - surface.dot(&terms(plane, k)) as f32).collect()
}

/// The terms of a quadratic surface at a plane's pixel; the same for the same place of a plane of another size.
fn terms(plane: &Plane, k: usize) -> Vector6<f64> {
    let along = |at: usize, length: usize| at as f64 / length as f64 - 0.5;
    let (x, y) = (along(k % plane.width, plane.width), along(k / plane.width, plane.height));
    Vector6::new(1.0, x, y, x * x, x * y, y * y)
}

/// The quadratic surface of the majority of some of a plane's pixels.
fn smooth_surface(plane: &Plane, is_asked: impl Fn(usize) -> bool) -> Vector6<f64> {
    let asked: Vec<usize> = (0..plane.data.len()).filter(|&k| is_asked(k)).collect();
    let mut level: Vec<f32> = asked.iter().map(|&k| plane.data[k]).collect();
    let mut surface = Vector6::new(f64::from(median(&mut level)), 0.0, 0.0, 0.0, 0.0, 0.0);
    for _ in 0..6 {
        let residual = |k: usize| plane.data[k] - surface.dot(&terms(plane, k)) as f32;
        let mut size: Vec<f32> = asked.iter().map(|&k| residual(k).abs()).collect();
        let limit = (2.5 * 1.4826 * median(&mut size)).max(0.5);
        let mut normal = Matrix6::identity() * 1e-9;
        let mut right = Vector6::zeros();
        for &k in asked.iter().step_by(7).filter(|&&k| residual(k).abs() < limit) {
            let t = terms(plane, k);
            right += t * f64::from(plane.data[k]);
            normal += t * t.transpose();
        }
        match normal.cholesky() {
            Some(factor) => surface = factor.solve(&right),
            None => break,
        }
    }
    surface
}

fn above_half(plane: &Plane) -> GrayImage {
    GrayImage::from_fn(plane.width as u32, plane.height as u32, |x, y| {
        Luma([if plane.get(i64::from(x), i64::from(y)) > 0.5 { 255 } else { 0 }])
    })
}

/// The connected components that are large enough for a holder, the largest first.
fn components(mask: &GrayImage) -> Vec<GrayImage> {
    let labels = connected_components(mask, Connectivity::Eight, Luma([0]));
    let mut sizes = std::collections::BTreeMap::new();
    for label in labels.pixels().map(|p| p.0[0]).filter(|&l| l > 0) {
        *sizes.entry(label).or_insert(0_usize) += 1;
    }
    let mut large: Vec<(usize, u32)> =
        sizes.into_iter().filter(|&(_, size)| size >= SMALLEST).map(|(label, size)| (size, label)).collect();
    large.sort_by(|a, b| b.cmp(a));
    let only = |label: u32| {
        GrayImage::from_fn(mask.width(), mask.height(), |x, y| {
            Luma([if labels.get_pixel(x, y).0[0] == label { 255 } else { 0 }])
        })
    };
    large.into_iter().take(5).map(|(_, label)| only(label)).collect()
}

/// Fewer blocks than that are no holder.
const SMALLEST: usize = 50;

/// The object's middle line near the border that cuts it.
fn rough_axis(object: &GrayImage) -> Result<Holder, String> {
    let (w, h) = (object.width(), object.height());
    let inside: Vec<Point2<f64>> = object
        .enumerate_pixels()
        .filter(|(_, _, p)| p.0[0] > 0)
        .map(|(x, y, _)| Point2::new(f64::from(x), f64::from(y)) * BLOCK as f64)
        .collect();
    // The border with most of the object on it is the one the holder comes from.
    let (right, bottom) = (f64::from((w - 1) * BLOCK as u32), f64::from((h - 1) * BLOCK as u32));
    let borders = [(-Vector2::y(), bottom), (Vector2::y(), 0.0), (Vector2::x(), 0.0), (-Vector2::x(), right)];
    let on = |inward: Vector2<f64>, offset: f64| -> Vec<Vector2<f64>> {
        let from_border = |p: &&Point2<f64>| inward.dot(&p.coords) + offset < 1.5 * BLOCK as f64;
        inside.iter().filter(from_border).map(|p| p.coords).collect()
    };
    let cuts = borders.iter().map(|&(inward, offset)| (on(inward, offset), inward));
    let (cut, inward) = cuts.max_by_key(|(cut, _)| cut.len()).unwrap_or_default();
    if cut.is_empty() {
        return Err(
            "the object that stands out does not reach the picture's border, as the snake's holder would".into()
        );
    }
    let root = Point2::from(cut.iter().sum::<Vector2<f64>>() / cut.len() as f64);
    let across = Vector2::new(-inward.y, inward.x);
    let side = cut.iter().map(|p| across.dot(p));
    let (low, high) = side.fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(v), high.max(v)));
    let width_px = high - low + BLOCK as f64;
    if inside.len() as f64 > 0.3 * f64::from(w * h) || width_px > 0.4 * right.max(bottom) {
        return Err("what stands out from the paper is far too large for a snake's holder".into());
    }
    // The object within about one width of the border shows which way it goes.
    let near: Vec<Vector2<f64>> =
        inside.iter().map(|p| p - root).filter(|d| (0.0..1.5 * width_px).contains(&inward.dot(d))).collect();
    let (sxx, sxy) = near.iter().fold((0.0, 0.0), |(sxx, sxy), d| {
        let (x, y) = (inward.dot(d), across.dot(d));
        (sxx + x * x, sxy + x * y)
    });
    let slope = if sxx > 0.0 { sxy / sxx } else { 0.0 };
    Ok(Holder { root, axis: (inward + across * slope).normalize(), width_px })
}

/// Finds the holder's two sides, now that its width is known, and follows them to its upper end.
///
/// A side is a step of colour all along the holder: shading is smooth, print across the holder is here and there, and
/// print along it is too thin to be a step.
///
/// # Errors
///
/// A sentence that says what was not found.
pub fn find_start(colours: &Colours, holder: &Holder, width_px: f64) -> Result<SnakeStart, String> {
    let strip = Strip { channels: &colours.planes, root: holder.root, width_px };
    let mut best = (0.0, holder.axis, 0.0);
    for (reach, steps) in [(0.10, 10), (0.010, 5)] {
        let around = best.1;
        for k in -steps..=steps {
            let turn = reach * f64::from(k) / f64::from(steps);
            let axis = (around + Vector2::new(-around.y, around.x) * turn).normalize();
            let (strength, left) = strip.best_sides(axis);
            if strength > best.0 {
                best = (strength, axis, left);
            }
        }
    }
    let (_, axis, left) = best;
    let sides = strip.sides(axis, left, 0.0..0.9 * width_px);
    let mut end = None;
    let (mut along, mut missed) = (4.0, 0);
    let too_many = (0.05 * width_px).round().max(2.0) as i32;
    while missed < too_many {
        let here = strip.sides(axis, left, along - 3.0..along + 3.0);
        if here.0 > 0.4 * sides.0 && here.1 > 0.4 * sides.1 {
            end = Some(along);
            missed = 0;
        } else {
            missed += 1;
        }
        along += 2.0;
    }
    let end = end.filter(|end| *end > 0.5 * width_px).ok_or(
        "the snake's holder was not found at the picture's border: it must be seen for at least half its width below \
         the snake",
    )?;
    let across = Vector2::new(-axis.y, axis.x);
    Ok(SnakeStart { base: holder.root + axis * end + across * (left + width_px / 2.0), axis })
}

/// The picture around the holder, in coordinates along and across it.
struct Strip<'a> {
    channels: &'a [Plane],
    root: Point2<f64>,
    width_px: f64,
}

impl Strip<'_> {
    /// Length of the two means whose difference is a step, px: more than a printed line's width, less than the tubes lie
    /// inside the holder's sides.
    fn step_px(&self) -> i32 {
        (0.1 * self.width_px).round().max(3.0) as i32
    }

    /// The place of the left side, px across from the root, at which both sides are steepest, and how steep the weaker is.
    fn best_sides(&self, axis: Vector2<f64>) -> (f64, f64) {
        let reach = (1.6 * self.width_px) as i32;
        let steps = self.steps(axis, -reach..reach, 0.0..0.9 * self.width_px);
        let step = |t: i32| steps.get((t + reach) as usize).copied().unwrap_or(0.0);
        let width = self.width_px.round() as i32;
        let pairs = (-reach..reach - width).map(|t| (step(t).min(step(t + width)), f64::from(t)));
        pairs.max_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or_default()
    }

    /// How steep the two sides are over a part of the holder.
    fn sides(&self, axis: Vector2<f64>, left: f64, along: std::ops::Range<f64>) -> (f64, f64) {
        let at = |t: f64| {
            let middle = t.round() as i32;
            let off = (0.025 * self.width_px).round().max(1.0) as i32;
            self.steps(axis, middle - off..middle + off + 1, along.clone()).into_iter().fold(0.0, f64::max)
        };
        (at(left), at(left + self.width_px))
    }

    /// How steep the colours are at every px across, as a mean over short lengths of the holder: before a checkerboard
    /// a side may be a step up here and a step down there.
    fn steps(&self, axis: Vector2<f64>, across_px: std::ops::Range<i32>, along: std::ops::Range<f64>) -> Vec<f64> {
        const LENGTH_PX: f64 = 6.0;
        let lengths = ((along.end - along.start) / LENGTH_PX).round().max(1.0) as usize;
        let mut mean = vec![0.0; across_px.len()];
        for k in 0..lengths {
            let start = along.start + k as f64 * LENGTH_PX;
            let wider = across_px.start - self.step_px()..across_px.end + self.step_px();
            let profile = self.profile(axis, wider, start..start + LENGTH_PX);
            for (t, value) in mean.iter_mut().enumerate() {
                *value += self.step(&profile, t + self.step_px() as usize) / lengths as f64;
            }
        }
        mean
    }

    /// Mean colour over a part of the holder's length, for every px across; channel by channel.
    fn profile(
        &self,
        axis: Vector2<f64>,
        across_px: std::ops::Range<i32>,
        along: std::ops::Range<f64>,
    ) -> Vec<Vec<f64>> {
        let across = Vector2::new(-axis.y, axis.x);
        let rows = (along.end - along.start).max(1.0).ceil() as i32;
        let mean = |plane: &Plane, t: i32| {
            let places = (0..rows).map(|row| self.root + axis * (along.start + f64::from(row)) + across * f64::from(t));
            places.map(|p| f64::from(plane.sample(&p))).sum::<f64>() / f64::from(rows)
        };
        across_px.map(|t| self.channels.iter().map(|plane| mean(plane, t)).collect()).collect()
    }

    /// Distance between the mean colours on both sides of a place in a profile.
    fn step(&self, profile: &[Vec<f64>], at: usize) -> f64 {
        let reach = self.step_px() as usize;
        if at < reach || at + reach >= profile.len() {
            return 0.0;
        }
        let mean = |from: usize, c: usize| profile[from..from + reach].iter().map(|p| p[c]).sum::<f64>() / reach as f64;
        (0..self.channels.len()).map(|c| (mean(at + 1, c) - mean(at - reach, c)).powi(2)).sum::<f64>().sqrt()
    }
}
