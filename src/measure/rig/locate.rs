//! Finds what may be the snake's holder in a picture of which nothing is known but the camera.

use super::background::{BLOCK, Colours};
use super::error::RigError;
use crate::camera::Frame;
use crate::measure::image::appearance::Appearance;
use crate::measure::image::plane::Plane;
use image::{GrayImage, Luma};
use imageproc::distance_transform::Norm;
use imageproc::region_labelling::{Connectivity, connected_components};
use nalgebra::{Matrix2, Point2, Vector2};
use std::collections::BTreeMap;

/// The most objects that are tried as holders.
///
/// Convention: a limit of time.
const MOST_HOLDERS: usize = 3;
/// The means, in blocks to either side, through which a picture is looked at so that squares of a checkerboard vanish in them.
///
/// Convention: squares of 16 to 72 px; wider ones are no larger than the holder in few pictures.
const REACHES: [i64; 4] = [4, 8, 12, 18];
/// Findings whose places differ by less than this share of the width, and whose widths differ by less than this ratio, are the same
/// object.
///
/// Convention: what follows searches sides and grids further than that.
const SAME_OBJECT: f64 = 0.2;
const SAME_WIDTH: f64 = 2.2;
/// Strips whose directions differ by less than this, rad (as a sine), are one.
///
/// Convention: what follows turns the axis by twice as much.
const SAME_DIRECTION: f64 = 0.05;
/// Rounds in which an object's own colours show it anew.
///
/// Convention: a cap; the second round confirms the first.
const COLOUR_ROUNDS: usize = 2;
/// Fewest blocks of a holder.
///
/// Convention: 800 px, a snake 28 px wide of which one width is seen; what is smaller is too small to be measured.
const SMALLEST: usize = 50;
/// The most components of a picture that are looked at.
///
/// Convention: a limit of time.
const MOST_COMPONENTS: usize = 5;
/// The largest width of a holder, as a share of the picture's longer side, and the largest share of the picture that it may cover.
///
/// Fitted: by hand on the project's renders (tests/eye/robustness) and frames; not judged elsewhere.
pub const MOST_WIDTH: f64 = 0.4;
const MOST_AREA: f64 = 0.3;
/// A block whose middle is this close to the border, in blocks, is cut by it.
///
/// Derived: the first block's and no more than the second one's.
const AT_BORDER: f64 = 1.5;
/// The length of the holder, in widths, that shows its direction.
///
/// Convention: about what is seen of a holder; a snake that is not straight has gone on less than a disk by then.
const AXIS_WIDTHS: f64 = 1.5;

/// The least ratio of the standard deviations along and across an object that no border cuts.
///
/// Derived: of a holder alone, seen for one and a half times its width and more.
const LEAST_ELONGATION: f64 = 1.5;
/// The share of such an object's length from which the width of its end is taken.
///
/// Convention: less than the holder's share.
const END_SHARE: f64 = 0.2;

/// The snake's holder in a picture of which nothing is known, roughly.
#[derive(Debug, Clone)]
pub struct Holder {
    /// Where the holder is cut by the picture's border, px.
    pub root: Point2<f64>,
    /// From there towards the snake.
    pub axis: Vector2<f64>,
    /// Its width, px, or less: where it is lit it may look like the target.
    pub width_px: f64,
}

impl Holder {
    /// Whether a pixel lies on the strip that holder and straight snake cover: a little wider than the holder, all along its axis.
    pub fn covers(&self, pixel: &Point2<f64>) -> bool {
        /// Half width of the strip, in widths of the holder.
        ///
        /// Convention: the holder may have been seen only half as wide as it is.
        const HALF_WIDTH: f64 = 1.1;
        let across = Vector2::new(-self.axis.y, self.axis.x);
        across.dot(&(pixel - self.root)).abs() < HALF_WIDTH * self.width_px
    }

    /// Whether another holder covers the same strip: the other end of the same object does.
    pub fn covers_like(&self, other: &Self) -> bool {
        self.covers(&other.root) && other.covers(&self.root) && self.axis.perp(&other.axis).abs() < SAME_DIRECTION
    }

    /// Whether two findings are the same object.
    fn is_like(&self, other: &Self) -> bool {
        let (wider, narrower) = (self.width_px.max(other.width_px), self.width_px.min(other.width_px));
        (self.root - other.root).norm() < SAME_OBJECT * wider && wider < SAME_WIDTH * narrower
    }
}

/// Finds what may be the holder, most likely first: large thick objects that differ from the target and are cut by a border.
///
/// Printed lines are thinner than three blocks and are dropped. The squares of a checkerboard are not; where their colours
/// do not tell them and they make up the largest object, the picture is looked at through ever larger means, in which
/// they vanish.
///
/// # Errors
///
/// Why nothing found is a holder.
pub fn locate_holders(frame: &Frame, colours: &Colours) -> Result<Vec<Holder>, RigError> {
    let mut found: Vec<Holder> = Vec::new();
    let mut refused = None;
    let mut take = |outcome: Result<Vec<Holder>, RigError>| match outcome {
        Ok(holders) => {
            for holder in holders {
                if !found.iter().any(|other| other.is_like(&holder)) {
                    found.push(holder);
                }
            }
        }
        Err(error) => refused = refused.take().or(Some(error)),
    };
    for object in components(&opened(&colours.unlike_target(1))).into_iter().take(MOST_HOLDERS) {
        // One mix of channels cannot tell the snake from squares of two colours; what they leave unexplained has done so.
        let object = if colours.is_without_squares { Ok(object) } else { in_its_own_colours(frame, object) };
        take(object.and_then(|object| holders_of(&object)));
    }
    for reach in REACHES {
        for object in components(&colours.unlike_target(reach)).iter().take(1) {
            take(holders_of(object));
        }
    }
    found.truncate(MOST_HOLDERS);
    if found.is_empty() { Err(refused.unwrap_or(RigError::NoObject)) } else { Ok(found) }
}

/// The object as its own colours show it.
fn in_its_own_colours(frame: &Frame, object: GrayImage) -> Result<GrayImage, RigError> {
    let mut object = object;
    for _ in 0..COLOUR_ROUNDS {
        let is_set = |x: u32, y: u32| {
            object.get_pixel_checked(x / BLOCK as u32, y / BLOCK as u32).is_some_and(|pixel| pixel.0[0] > 0)
        };
        let appearance = Appearance::learn(frame, |x, y| Some((is_set(x, y), 1.0))).ok_or(RigError::NoObject)?;
        let overlap =
            |other: &GrayImage| other.pixels().zip(object.pixels()).filter(|(a, b)| a.0[0] & b.0[0] > 0).count();
        let others = components(&opened(&above_half(&appearance.plane(frame).shrunk::<BLOCK>())));
        object = others.into_iter().max_by_key(overlap).ok_or(RigError::NoObject)?;
    }
    Ok(object)
}

/// Drops what is thinner than three blocks.
fn opened(mask: &GrayImage) -> GrayImage {
    imageproc::morphology::open(mask, Norm::LInf, 1)
}

/// Blocks that are more snake than target.
fn above_half(plane: &Plane) -> GrayImage {
    GrayImage::from_fn(plane.width as u32, plane.height as u32, |x, y| {
        Luma([if plane.get(i64::from(x), i64::from(y)) > 0.5 { 255 } else { 0 }])
    })
}

/// The connected components that are large enough for a holder, the largest first.
fn components(mask: &GrayImage) -> Vec<GrayImage> {
    let labels = connected_components(mask, Connectivity::Eight, Luma([0]));
    let mut sizes = BTreeMap::new();
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
    large.into_iter().take(MOST_COMPONENTS).map(|(_, label)| only(label)).collect()
}

/// The holders that an object may be, of a sensible size: cut by a border, or else either end of its longer axis.
fn holders_of(object: &GrayImage) -> Result<Vec<Holder>, RigError> {
    let (w, h) = (object.width(), object.height());
    let inside: Vec<Point2<f64>> = object
        .enumerate_pixels()
        .filter(|(_, _, p)| p.0[0] > 0)
        .map(|(x, y, _)| Point2::new(f64::from(x), f64::from(y)) * BLOCK as f64)
        .collect();
    let holders = match border_cut(&inside, w, h) {
        Some((cut, inward)) => vec![holder_at(&inside, &cut, inward)],
        None => ends_of(&inside).ok_or(RigError::ObjectWithinBorders)?.to_vec(),
    };
    let longer_side_px = f64::from((w.max(h) - 1) * BLOCK as u32);
    let (area_share, most_width_px) = (inside.len() as f64 / f64::from(w * h), MOST_WIDTH * longer_side_px);
    let width_px = holders.iter().map(|holder| holder.width_px).fold(0.0, f64::max);
    if area_share > MOST_AREA || width_px > most_width_px {
        return Err(RigError::ObjectTooLarge { width_px, most_width_px, area_share, most_area_share: MOST_AREA });
    }
    Ok(holders)
}

/// The holder whose end are these of an object's places, with the direction of the object's middle line near there.
fn holder_at(inside: &[Point2<f64>], cut: &[Point2<f64>], inward: Vector2<f64>) -> Holder {
    let root = Point2::from(cut.iter().map(|p| p.coords).sum::<Vector2<f64>>() / cut.len() as f64);
    let across = Vector2::new(-inward.y, inward.x);
    let side = cut.iter().map(|p| across.dot(&p.coords));
    let (low, high) = side.fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(v), high.max(v)));
    let width_px = high - low + BLOCK as f64;
    // The slope of the line through the root that is nearest to the object's blocks beside the border.
    let near = inside.iter().map(|p| p - root).filter(|d| (0.0..AXIS_WIDTHS * width_px).contains(&inward.dot(d)));
    let (sxx, sxy) = near.fold((0.0, 0.0), |(sxx, sxy), d| {
        let (x, y) = (inward.dot(&d), across.dot(&d));
        (sxx + x * x, sxy + x * y)
    });
    let slope = if sxx > 0.0 { sxy / sxx } else { 0.0 };
    Holder { root, axis: (inward + across * slope).normalize(), width_px }
}

/// The two ends of an object that no border cuts, as holders, the thicker one first; `None` of an object that is not long.
fn ends_of(inside: &[Point2<f64>]) -> Option<[Holder; 2]> {
    let count = inside.len() as f64;
    let middle = inside.iter().map(|p| p.coords).sum::<Vector2<f64>>() / count;
    let scatter = inside.iter().map(|p| p.coords - middle).map(|d| d * d.transpose()).sum::<Matrix2<f64>>() / count;
    let eigen = scatter.symmetric_eigen();
    let (long, short) = (eigen.eigenvalues.imax(), eigen.eigenvalues.imin());
    if eigen.eigenvalues[long] < LEAST_ELONGATION.powi(2) * eigen.eigenvalues[short] {
        return None;
    }
    let axis: Vector2<f64> = eigen.eigenvectors.column(long).into_owned();
    let along = |p: &Point2<f64>| axis.dot(&(p.coords - middle));
    let reach = inside.iter().map(along).fold((0.0, 0.0), |(low, high), v| (f64::min(low, v), f64::max(high, v)));
    let skewness = inside.iter().map(|p| along(p).powi(3)).sum::<f64>();
    let ends = [(axis, reach.0), (-axis, -reach.1)].map(|(inward, first)| {
        // The width near the end, of a uniform distribution's scatter.
        let near: Vec<f64> = inside
            .iter()
            .map(|p| p.coords - middle)
            .filter(|d| inward.dot(d) < first + END_SHARE * (reach.1 - reach.0))
            .map(|d| Vector2::new(-inward.y, inward.x).dot(&d))
            .collect();
        let mean = near.iter().sum::<f64>() / near.len() as f64;
        let variance = near.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / near.len() as f64;
        let width_px = (12.0 * variance).sqrt().max(BLOCK as f64);
        let root = Point2::from(middle + inward * first + Vector2::new(-inward.y, inward.x) * mean);
        Holder { root, axis: inward, width_px }
    });
    // The thicker half is nearer to the middle of the object's places, which lean the other way.
    let [low, high] = ends;
    Some(if skewness > 0.0 { [low, high] } else { [high, low] })
}

/// The places of an object on the border that most of it touches, and the direction inward from there; `None` where it touches none.
fn border_cut(inside: &[Point2<f64>], w: u32, h: u32) -> Option<(Vec<Point2<f64>>, Vector2<f64>)> {
    let (right, bottom) = (f64::from((w - 1) * BLOCK as u32), f64::from((h - 1) * BLOCK as u32));
    let borders = [(-Vector2::y(), bottom), (Vector2::y(), 0.0), (Vector2::x(), 0.0), (-Vector2::x(), right)];
    let on = |inward: Vector2<f64>, offset: f64| -> Vec<Point2<f64>> {
        let is_on = |p: &&Point2<f64>| inward.dot(&p.coords) + offset < AT_BORDER * BLOCK as f64;
        inside.iter().filter(is_on).copied().collect()
    };
    let cuts = borders.iter().map(|&(inward, offset)| (on(inward, offset), inward));
    cuts.max_by_key(|(cut, _)| cut.len()).filter(|(cut, _)| !cut.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A mask of 80 × 60 blocks, set where a bar of this half width (blocks) about a line from the bottom border is.
    fn bar(half_width: f64, slope: f64, length: f64) -> GrayImage {
        GrayImage::from_fn(80, 60, |x, y| {
            let up = 59.0 - f64::from(y);
            let off = f64::from(x) - 40.0 - slope * up;
            Luma([if off.abs() <= half_width && up <= length { 255 } else { 0 }])
        })
    }

    #[test]
    fn a_bar_from_the_border_is_a_holder_with_its_place_width_and_direction() {
        for slope in [0.0, 0.2, -0.35] {
            let holder = holders_of(&bar(5.0, slope, 30.0)).unwrap().remove(0);
            assert!((holder.root - Point2::new(160.0, 236.0)).norm() < 4.0, "{holder:?}");
            assert!((holder.width_px - 44.0).abs() <= 4.0, "{holder:?}");
            let expected = Vector2::new(slope, -1.0).normalize();
            assert!(holder.axis.angle(&expected).to_degrees() < 1.5, "{holder:?}");
            assert!(holder.covers(&(holder.root + holder.axis * 100.0)) && !holder.covers(&Point2::new(20.0, 200.0)));
        }
    }

    #[test]
    fn what_is_no_holder_is_told_why() {
        let middle = GrayImage::from_fn(80, 60, |x, y| {
            Luma([if (30..50).contains(&x) && (20..40).contains(&y) { 255 } else { 0 }])
        });
        assert_eq!(holders_of(&middle).unwrap_err(), RigError::ObjectWithinBorders);
        let Err(RigError::ObjectTooLarge { width_px, most_width_px, .. }) = holders_of(&bar(20.0, 0.0, 20.0)) else {
            panic!("a bar half as wide as the picture is no holder")
        };
        assert!(width_px > most_width_px);
    }

    #[test]
    fn the_thicker_end_of_an_object_within_the_borders_is_the_likelier_holder() {
        // A holder ten blocks wide up to its end, and a snake of every other pair of rows on top.
        let turned =
            |x: u32, y: u32, tip_up: bool| (f64::from(x) - 40.0, f64::from(if tip_up { 54 - y.min(54) } else { y }));
        for tip_up in [true, false] {
            let object = GrayImage::from_fn(80, 60, |x, y| {
                let (across, along) = turned(x, y, tip_up);
                let is_on = across.abs() <= 5.0 && (6.0..44.0).contains(&along);
                Luma([if is_on && (along < 22.0 || along as i64 / 2 % 2 == 0 || across.abs() < 2.0) { 255 } else { 0 }])
            });
            let holders = holders_of(&object).unwrap();
            let (root_y, inward) = if tip_up { (48.0, -1.0) } else { (6.0, 1.0) };
            assert_eq!(holders.len(), 2);
            assert!((holders[0].root - Point2::new(160.0, root_y * 4.0)).norm() < 8.0, "{holders:?}");
            assert!((holders[0].axis - Vector2::new(0.0, inward)).norm() < 0.05, "{holders:?}");
            assert!((holders[0].width_px - 44.0).abs() < 4.0, "{holders:?}");
            assert!((holders[1].axis + holders[0].axis).norm() < 1e-9);
        }
    }

    #[test]
    fn components_come_the_largest_first_and_small_ones_not_at_all() {
        let mask = GrayImage::from_fn(60, 40, |x, y| {
            let is_large = x < 20 && y < 20;
            let is_medium = (30..40).contains(&x) && y < 10;
            let is_small = (50..55).contains(&x) && y < 5;
            Luma([if is_large || is_medium || is_small { 255 } else { 0 }])
        });
        let sizes: Vec<usize> =
            components(&mask).iter().map(|c| c.pixels().filter(|pixel| pixel.0[0] > 0).count()).collect();
        assert_eq!(sizes, [400, 100]);
    }
}
