//! The coarse search: the bends of a lattice whose outlines have the most contrast in the picture at low resolution.

use crate::camera::{Frame, Lens};
use crate::geometry::{Configuration, Pose};
use crate::measure::body::{Outline, Projection};
use crate::measure::image::appearance::Appearance;
use crate::measure::image::plane::Plane;
use crate::robot::Robot;
use nalgebra::{Point2, Vector2};
use rayon::prelude::*;
use std::ops::Range;

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
/// Fitted: by hand on renders; judged by `tests/eye/robustness`.
const PAIR_DISTANCE_PX: f64 = 1.6;
/// Distance between neighbouring pairs along the outline, as a share of the snake's diameter, and never less than the outline's own.
///
/// Derived: π/0.14 = 22 pairs around a disk's two rims and sides. Seven of sixteen pairs are read for every frame; a small snake has
/// none to spare.
const PAIRS_APART: f64 = 0.14;
/// The least diameter of the snake in the shrunk picture, px.
///
/// Derived: between disks, which are 0.88 diameters apart, a pixel then has 2.5 px of background on either side. Photo-real snakes 6.1 px wide are
/// found, and of snakes 4.6 px wide one in a hundred was taken for another bend.
const LEAST_DIAMETER_PX: f64 = 6.0;
/// The least free background beside an outline point, px of the shrunk picture.
///
/// Derived: the pair's outer pixel lies 1.6 px away, and half a pixel's diagonal further begins its neighbour.
const LEAST_GAP_PX: f64 = 2.5;
/// A bend with fewer pairs in the picture is no candidate.
///
/// Convention: a guard against scores from a few pixels at the picture's border; pairs lie 2 px or more apart, so that at least 40 px of outline
/// are judged.
const FEWEST_PAIRS: usize = 20;
/// One pair in so many is looked at of every bend, ...
///
/// Fitted: for speed; the bends of 200 photo-real frames are the same bytes as without. Judged by `tests/eye/robustness`.
const SIFTING_STRIDE: usize = 4;
/// ... and the others of one bend in so many, of those with the most contrast so far.
///
/// Fitted: together with the stride.
const SIFTED_OUT: usize = 4;
/// The values of the picture between which contrast counts: 0 is background and 1 is snake, and a quarter beyond on either side.
///
/// Convention: bounds what a highlight may add.
const CONTRAST_RANGE: (f32, f32) = (-0.25, 1.25);
/// Values are counted in whole numbers of this part, whose sums do not depend on their order.
///
/// Convention: finer than the noise of any picture.
const VALUE_STEPS: f32 = 1000.0;

/// The least and the number of places, in columns and in rows, from a pair's inner pixel to its outer one.
///
/// Derived: they lie twice [`PAIR_DISTANCE_PX`] apart, and each is rounded to the nearest pixel.
const LEAST_STEP: i32 = -4;
const STEPS: u32 = 9;
/// The bits of a pair that hold the index of its inner pixel.
///
/// Derived: what the places of the outer one leave of 32; a shrunk picture may have 16 million pixels.
const INDEX_BITS: u32 = 24;

/// Pairs of pixels just inside and just outside the outlines of all bends of a lattice, for one view.
///
/// The pairs of all bends lie one after the other: memory delivers what is read in its order several times as fast.
#[derive(Debug)]
pub(crate) struct CoarseSearch {
    bends: Vec<LatticeBend>,
    /// One pair in [`SIFTING_STRIDE`] of each outline.
    sifting: Vec<Pair>,
    /// All others.
    others: Vec<Pair>,
    /// The width of the shrunk picture, px.
    width: i32,
}

#[derive(Debug)]
struct LatticeBend {
    bend: Vector2<f64>,
    /// Which of the search's pairs are its.
    sifting: Range<usize>,
    others: Range<usize>,
}

/// An inner and an outer pixel of the shrunk picture: the index of the inner one in its rows one after the other, and above that the number of
/// the step to the outer one. So many are read for every frame that it takes as long as the memory needs to deliver them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Pair(u32);

impl Pair {
    /// `None` of pixels that lie further apart, or in a larger picture, than there is room for.
    fn new(inner: (i32, i32), outer: (i32, i32), width: i32) -> Option<Self> {
        let index = i64::from(inner.1) * i64::from(width) + i64::from(inner.0);
        let index = u32::try_from(index).ok().filter(|index| *index < 1 << INDEX_BITS)?;
        let place = |from: i32, to: i32| u32::try_from(to - from - LEAST_STEP).ok().filter(|place| *place < STEPS);
        let step = place(inner.0, outer.0)? + STEPS * place(inner.1, outer.1)?;
        Some(Self(step << INDEX_BITS | index))
    }

    /// By how much the index of the outer pixel is larger, for each number of a step.
    fn steps(width: i32) -> [i32; 1 << (u32::BITS - INDEX_BITS)] {
        std::array::from_fn(|step| {
            let (columns, rows) = (step as i32 % STEPS as i32, step as i32 / STEPS as i32);
            columns + LEAST_STEP + (rows + LEAST_STEP) * width
        })
    }

    /// The indices of both pixels.
    fn indices(self, steps: &[i32; 1 << (u32::BITS - INDEX_BITS)]) -> (usize, usize) {
        let inner = self.0 & ((1 << INDEX_BITS) - 1);
        (inner as usize, inner.wrapping_add_signed(steps[(self.0 >> INDEX_BITS) as usize]) as usize)
    }
}

/// By how much the pictures are shrunk that a coarse search looks at.
///
/// Fitted: four, by hand on renders, for speed; judged by `tests/eye/robustness`. Derived: half of it for a narrow snake.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Shrink {
    ToAHalf,
    ToAQuarter,
}

impl Shrink {
    /// For the pictures of a view.
    pub fn suiting(view: &Projection) -> Self {
        let is_wide_enough = view.diameter_px() / Self::ToAQuarter.times() as f64 >= LEAST_DIAMETER_PX;
        if is_wide_enough { Self::ToAQuarter } else { Self::ToAHalf }
    }

    /// How many times smaller.
    fn times(self) -> usize {
        match self {
            Self::ToAHalf => 2,
            Self::ToAQuarter => 4,
        }
    }

    /// A plane made so much smaller.
    pub fn plane(self, plane: &Plane) -> Plane {
        match self {
            Self::ToAHalf => plane.shrunk::<2>(),
            Self::ToAQuarter => plane.shrunk::<4>(),
        }
    }

    /// The plane of a frame, so much smaller.
    pub fn overview(self, appearance: &Appearance, frame: &Frame) -> Plane {
        match self {
            Self::ToAHalf => appearance.overview::<2>(frame),
            Self::ToAQuarter => appearance.overview::<4>(frame),
        }
    }
}

impl CoarseSearch {
    /// Projects every bend once; for a frame only pixels are looked up.
    pub fn new(lens: &Lens, camera_from_base: Pose, robot: &Robot) -> Self {
        let shrink = Shrink::suiting(&Projection { lens, camera_from_base, robot });
        let small = shrunk_lens(lens, shrink.times());
        let view = Projection { lens: &small, camera_from_base, robot };
        let pairs: Vec<_> = lattice().into_par_iter().map(|bend| (bend, pairs(&view, bend))).collect();
        let mut search = Self { bends: vec![], sifting: vec![], others: vec![], width: small.width as i32 };
        for (bend, pairs) in pairs.into_iter().filter(|(_, pairs)| pairs.len() >= FEWEST_PAIRS) {
            let (sifting, others) = (search.sifting.len(), search.others.len());
            for (k, pair) in pairs.into_iter().enumerate() {
                if k % SIFTING_STRIDE == 0 { search.sifting.push(pair) } else { search.others.push(pair) }
            }
            let (sifting, others) = (sifting..search.sifting.len(), others..search.others.len());
            search.bends.push(LatticeBend { bend, sifting, others });
        }
        search
    }

    /// The bends with the most contrast across their outlines in a picture that is [smaller](Shrink) than the lens', best first, at
    /// most `most`. `two_sided` pictures, whose background is darker than the snake in places and brighter in others, count contrast of either sign.
    pub fn candidates(&self, overview: &Plane, two_sided: bool, most: usize) -> Vec<Vector2<f64>> {
        let (least, largest) = CONTRAST_RANGE;
        let small: Vec<i16> = overview.data.iter().map(|v| (VALUE_STEPS * v.clamp(least, largest)) as i16).collect();
        // The pixels are those of the lens; in a plane of another size some are missing.
        let value = |pixel: usize| small.get(pixel).copied().map_or(0, i32::from);
        let steps = Pair::steps(self.width);
        let contrast = |pair: &Pair| {
            let (inside, outside) = pair.indices(&steps);
            value(inside) - value(outside)
        };
        let total = |pairs: &[Pair]| -> i32 {
            let contrasts = pairs.iter().map(contrast);
            if two_sided { contrasts.map(i32::abs).sum() } else { contrasts.sum() }
        };
        let mut sifted: Vec<(f64, i32, &LatticeBend)> = Vec::with_capacity(self.bends.len());
        for bend in &self.bends {
            let total = total(&self.sifting[bend.sifting.clone()]);
            sifted.push((f64::from(total) / bend.sifting.len() as f64, total, bend));
        }
        let left = sifted.len() / SIFTED_OUT;
        if left > 0 {
            sifted.select_nth_unstable_by(left, |a, b| b.0.total_cmp(&a.0));
            sifted.truncate(left);
        }
        let mean = |(_, sifting, bend): (f64, i32, &LatticeBend)| {
            let total = sifting + total(&self.others[bend.others.clone()]);
            (f64::from(total) / (bend.sifting.len() + bend.others.len()) as f64, bend.bend)
        };
        let mut scored: Vec<(f64, Vector2<f64>)> = sifted.into_iter().map(mean).collect();
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
fn pairs(view: &Projection, bend: Vector2<f64>) -> Vec<Pair> {
    let spacing_px = (PAIRS_APART * view.diameter_px()).max(Outline::SPACING_PX);
    Outline::free_points(view, Configuration::from_bend_vector(bend), spacing_px, LEAST_GAP_PX)
        .filter_map(|(pixel, normal)| {
            let step = normal.into_inner() * PAIR_DISTANCE_PX;
            let (inner, outer) = (nearest_pixel(view.lens, pixel - step), nearest_pixel(view.lens, pixel + step));
            Pair::new(inner, outer, view.lens.width as i32)
        })
        .collect()
}

/// Column and row of the pixel of a picture that is nearest to a point.
fn nearest_pixel(lens: &Lens, point: Point2<f64>) -> (i32, i32) {
    let nearest = |v: f64, count: u32| ((v + 0.5).max(0.0) as u32).min(count.saturating_sub(1)) as i32;
    (nearest(point.x, lens.width), nearest(point.y, lens.height))
}

/// The lens that would take the shrunk picture.
fn shrunk_lens(lens: &Lens, shrink: usize) -> Lens {
    let factor = shrink as f64;
    Lens {
        width: lens.width / shrink as u32,
        height: lens.height / shrink as u32,
        focal_px: lens.focal_px / factor,
        centre_px: lens.centre_px.map(|c| (c - (factor - 1.0) / 2.0) / factor),
        distortion: lens.distortion,
        fisheye: lens.fisheye,
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
    fn a_pair_holds_both_its_pixels() {
        let width = 320;
        let index = |(column, row): (i32, i32)| (row * width + column) as usize;
        let steps = Pair::steps(width);
        for dx in -4..=4 {
            for dy in -4..=4 {
                let (inner, outer) = ((17, 40), (17 + dx, 40 + dy));
                let pair = Pair::new(inner, outer, width).unwrap();
                assert_eq!(pair.indices(&steps), (index(inner), index(outer)));
            }
        }
        assert_eq!(Pair::new((17, 40), (22, 40), width), None);
        assert_eq!(Pair::new((0, 1 << 24), (0, 1 << 24), 1), None);
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
            fisheye: None,
        };
        let point = Point3::new(3.0, -2.0, 100.0);
        let (pixel, small) = (lens.project(&point), shrunk_lens(&lens, 4).project(&point));
        // The centre of block x is at pixel 4 x + 1.5.
        assert!((pixel - Point2::from(small.coords * 4.0 + Vector2::new(1.5, 1.5))).norm() < 1e-9);
    }
}
