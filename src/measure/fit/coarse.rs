//! The coarse search: the bends of a lattice whose outlines have the most contrast in the picture at low resolution.

use crate::camera::Lens;
use crate::geometry::{Configuration, Pose};
use crate::measure::body::{Outline, Projection};
use crate::measure::image::plane::Plane;
use crate::robot::Robot;
use nalgebra::{Point2, Vector2};
use rayon::prelude::*;

/// By how much the picture is shrunk.
///
/// Fitted: by hand on renders, for speed; judged by `tests/robustness`.
const SHRINK: usize = 4;
/// The largest bend of the lattice, degrees.
///
/// Convention: the robot bends to 90°, and 20° are left for snakes that bend further than it.
const LARGEST_BEND_DEG: f64 = 110.0;
/// Distance between neighbouring bends, degrees.
///
/// Derived: the tip of a snake of L = 26 mm moves by L/2 · 4° = 0.9 mm, half of which the first stage of the fit, with its search
/// distance of 14 px, covers at up to 30 px/mm.
const SPACING_DEG: f64 = 4.0;
/// Candidates are at least this many spacings apart.
///
/// Derived: more than two rings of the lattice, so that neighbours of a candidate, whose outlines overlap its own, are none.
const APART_SPACINGS: f64 = 2.2;
/// Distance from the outline at which it is compared what lies inside and outside, px of the shrunk picture.
///
/// Fitted: by hand on renders; judged by `tests/robustness`.
const PAIR_DISTANCE_PX: f64 = 1.6;
/// The least free background beside an outline point, px of the shrunk picture.
///
/// Derived: the pair's outer pixel lies 1.6 px away, and half a pixel's diagonal further begins its neighbour.
const LEAST_GAP_PX: f64 = 2.5;
/// A bend with fewer pairs in the picture is no candidate.
///
/// Convention: a guard against scores from a few pixels at the picture's border.
const FEWEST_PAIRS: usize = 20;
/// The values of the picture between which contrast counts: 0 is background and 1 is snake, and a quarter beyond on either side.
///
/// Convention: bounds what a highlight may add.
const CONTRAST_RANGE: (f32, f32) = (-0.25, 1.25);
/// Values are counted in whole numbers of this part, whose sums do not depend on their order.
///
/// Convention: finer than the noise of any picture.
const VALUE_STEPS: f32 = 1000.0;

/// Pairs of pixels just inside and just outside the outlines of all bends of a lattice, for one view.
#[derive(Debug)]
pub(crate) struct CoarseSearch {
    bends: Vec<LatticeBend>,
}

#[derive(Debug)]
struct LatticeBend {
    bend: Vector2<f64>,
    /// (inside, outside) pixels of the shrunk picture, as indices into its rows one after the other.
    pairs: Vec<(u32, u32)>,
}

impl CoarseSearch {
    /// Projects every bend once; for a frame only pixels are looked up.
    pub fn new(lens: &Lens, camera_from_base: Pose, robot: &Robot) -> Self {
        let small = shrunk_lens(lens);
        let view = Projection { lens: &small, camera_from_base, robot };
        let bends = lattice().into_par_iter().map(|bend| LatticeBend { bend, pairs: pairs(&view, bend) }).collect();
        Self { bends }
    }

    /// The bends with the most contrast across their outlines, best first, at most `most`. `two_sided` pictures, whose background is
    /// darker than the snake in places and brighter in others, count contrast of either sign.
    pub fn candidates(&self, plane: &Plane, two_sided: bool, most: usize) -> Vec<Vector2<f64>> {
        let (least, largest) = CONTRAST_RANGE;
        let small: Vec<i16> =
            plane.shrunk::<SHRINK>().data.iter().map(|v| (VALUE_STEPS * v.clamp(least, largest)) as i16).collect();
        // The pixels are those of the lens; in a plane of another size some are missing.
        let value = |pixel: u32| small.get(pixel as usize).copied().map_or(0, i32::from);
        let contrast = |step: i32| if two_sided { step.abs() } else { step };
        let mut scored: Vec<(f64, Vector2<f64>)> = self
            .bends
            .iter()
            .filter(|b| b.pairs.len() >= FEWEST_PAIRS)
            .map(|b| {
                let total: i32 =
                    b.pairs.iter().map(|(inside, outside)| contrast(value(*inside) - value(*outside))).sum();
                (f64::from(total) / b.pairs.len() as f64, b.bend)
            })
            .collect();
        scored.sort_by(|a, b| b.0.total_cmp(&a.0));
        let apart_rad = APART_SPACINGS * SPACING_DEG.to_radians();
        let mut chosen: Vec<Vector2<f64>> = Vec::new();
        for (_, bend) in scored {
            if chosen.len() == most {
                break;
            }
            if chosen.iter().all(|other| (bend - other).norm() > apart_rad) {
                chosen.push(bend);
            }
        }
        chosen
    }
}

/// All bend vectors of a hexagonal lattice, which covers a disk with the fewest points, rad.
fn lattice() -> Vec<Vector2<f64>> {
    let spacing = SPACING_DEG.to_radians();
    // The lattice's axes enclose 60°: a disk of radius R reaches R/sin 60° along each.
    let count = (LARGEST_BEND_DEG / SPACING_DEG / 0.75_f64.sqrt()).ceil() as i32;
    (-count..=count)
        .flat_map(|i| (-count..=count).map(move |j| (f64::from(i), f64::from(j))))
        .map(|(i, j)| spacing * Vector2::new(i + j / 2.0, j * 0.75_f64.sqrt()))
        .filter(|bend| bend.norm() <= LARGEST_BEND_DEG.to_radians())
        .collect()
}

/// The pairs of pixels on both sides of the outline of a bend.
fn pairs(view: &Projection, bend: Vector2<f64>) -> Vec<(u32, u32)> {
    let outline = Outline::new(view, Configuration::from_bend_vector(bend));
    let points = outline.points.iter().filter(|p| p.body.s_mm > 0.0 && p.gap_px >= LEAST_GAP_PX);
    points
        .map(|p| {
            let step = p.normal.into_inner() * PAIR_DISTANCE_PX;
            (index(view.lens, p.pixel - step), index(view.lens, p.pixel + step))
        })
        .collect()
}

/// The pixel of a picture that is nearest to a point, as an index into its rows one after the other.
fn index(lens: &Lens, point: Point2<f64>) -> u32 {
    let nearest = |v: f64, count: u32| ((v + 0.5).max(0.0) as u32).min(count.saturating_sub(1));
    nearest(point.y, lens.height) * lens.width + nearest(point.x, lens.width)
}

/// The lens that would take the shrunk picture.
fn shrunk_lens(lens: &Lens) -> Lens {
    let factor = SHRINK as f64;
    Lens {
        width: lens.width / SHRINK as u32,
        height: lens.height / SHRINK as u32,
        focal_px: lens.focal_px / factor,
        centre_px: lens.centre_px.map(|c| (c - (factor - 1.0) / 2.0) / factor),
        distortion: lens.distortion,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_bend_is_further_from_the_lattice_than_a_hexagonal_one_leaves() {
        let lattice = lattice();
        // The circumradius of the lattice's triangles: 4°/√3.
        let furthest = SPACING_DEG.to_radians() / 3.0_f64.sqrt();
        let inner = (LARGEST_BEND_DEG - SPACING_DEG).to_radians();
        for k in 0..500 {
            // Fermat's spiral fills the disk evenly.
            let (radius, angle) = (inner * (f64::from(k) / 500.0).sqrt(), 2.399_963 * f64::from(k));
            let bend = radius * Vector2::new(angle.cos(), angle.sin());
            let nearest = lattice.iter().map(|other| (bend - other).norm()).fold(f64::INFINITY, f64::min);
            assert!(nearest <= furthest + 1e-9, "{bend}: {nearest}");
        }
    }

    #[test]
    fn shrinking_a_picture_is_shrinking_its_lens() {
        use nalgebra::Point3;
        let lens = Lens {
            width: 640,
            height: 480,
            focal_px: Vector2::new(900.0, 910.0),
            centre_px: Point2::new(321.0, 236.5),
            distortion: [0.0; 12],
        };
        let point = Point3::new(3.0, -2.0, 100.0);
        let (pixel, small) = (lens.project(&point), shrunk_lens(&lens).project(&point));
        // The centre of block x is at pixel 4 x + 1.5.
        assert!((pixel - Point2::from(small.coords * 4.0 + Vector2::new(1.5, 1.5))).norm() < 1e-9);
    }
}
