//! The coarse search: which bends are worth fitting.

use crate::camera::Lens;
use crate::geometry::{Configuration, Pose};
use crate::measure::body::{Outline, Projection};
use crate::measure::image::plane::Plane;
use crate::robot::Robot;
use nalgebra::{Point2, Vector2};
use rayon::prelude::*;

/// How much smaller the picture is in which the search looks.
const SHRINK: usize = 4;
/// Largest bend that is looked for, degrees.
const FURTHEST_DEG: f64 = 110.0;
/// Distance between neighbouring bends, degrees: the tip moves by about a millimetre.
const SPACING_DEG: f64 = 4.0;

/// Pairs of places just inside and just outside the outlines of all bends the snake may take, for one view.
#[derive(Debug)]
pub(crate) struct CoarseSearch {
    bends: Vec<Bend>,
}

#[derive(Debug)]
struct Bend {
    bend: Vector2<f64>,
    /// (inside, outside) pixels of the shrunk picture, as indices into its rows one after the other.
    pairs: Vec<(u32, u32)>,
}

impl CoarseSearch {
    /// Projects every bend once; frames then only look pixels up.
    pub fn new(lens: &Lens, camera_from_base: Pose, robot: &Robot) -> Self {
        let small = shrunk_lens(lens);
        let view = Projection { lens: &small, camera_from_base, robot };
        let spacing = SPACING_DEG.to_radians();
        let count = (FURTHEST_DEG / SPACING_DEG).ceil() as i32;
        let lattice: Vec<Vector2<f64>> = (-count..=count)
            .flat_map(|i| (-count..=count).map(move |j| (f64::from(i), f64::from(j))))
            // A hexagonal lattice covers a disk with the fewest points.
            .map(|(i, j)| spacing * Vector2::new(i + j / 2.0, j * 0.75_f64.sqrt()))
            .filter(|bend| bend.norm() <= FURTHEST_DEG.to_radians())
            .collect();
        let bends = lattice.into_par_iter().map(|bend| Bend { bend, pairs: pairs(&view, bend) }).collect();
        Self { bends }
    }

    /// The bends that stand out, best first, by how much more snake-like their inside is than their outside.
    pub fn candidates(&self, plane: &Plane, two_sided: bool, most: usize) -> Vec<Vector2<f64>> {
        // In whole thousandths, whose sums need no order.
        let small: Vec<i32> =
            plane.shrunk(SHRINK).data.iter().map(|v| (1000.0 * v.clamp(-0.25, 1.25)) as i32).collect();
        // The pixels are those of the lens; a plane of another size would not be looked at.
        let look = |pixel: u32| small.get(pixel as usize).copied().unwrap_or(0);
        let contrast = |step: i32| if two_sided { step.abs() } else { step };
        let mut scored: Vec<(f64, Vector2<f64>)> = self
            .bends
            .iter()
            .filter(|b| b.pairs.len() >= 20)
            .map(|b| {
                let total: i32 = b.pairs.iter().map(|(inside, outside)| contrast(look(*inside) - look(*outside))).sum();
                (f64::from(total) / b.pairs.len() as f64, b.bend)
            })
            .collect();
        scored.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut chosen: Vec<Vector2<f64>> = Vec::new();
        for (_, bend) in scored {
            if chosen.len() == most {
                break;
            }
            if chosen.iter().all(|other| (bend - other).norm() > 2.2 * SPACING_DEG.to_radians()) {
                chosen.push(bend);
            }
        }
        chosen
    }
}

fn pairs(view: &Projection, bend: Vector2<f64>) -> Vec<(u32, u32)> {
    const DISTANCE_PX: f64 = 1.6;
    let outline = Outline::new(view, Configuration::from_bend_vector(bend));
    let points = outline.points.iter().filter(|p| p.body.s_mm > 0.0 && p.gap_px >= 2.5);
    points
        .map(|p| {
            let step = p.normal.into_inner() * DISTANCE_PX;
            (index(view.lens, p.pixel - step), index(view.lens, p.pixel + step))
        })
        .collect()
}

/// The pixel of a picture that is nearest to a place, as an index into its rows one after the other.
fn index(lens: &Lens, place: Point2<f64>) -> u32 {
    let nearest = |v: f64, count: u32| ((v + 0.5).max(0.0) as u32).min(count.saturating_sub(1));
    nearest(place.y, lens.height) * lens.width + nearest(place.x, lens.width)
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
