//! What tells the straight snake from its target in the picture: learned from both sides of its outline, and the printed lines looked through.

use super::base_fit::{STRAIGHT, StraightPicture};
use crate::camera::Frame;
use crate::measure::body::{Outline, Projection};
use crate::measure::fit::EdgeFinder;
use crate::measure::image::appearance::{Appearance, Separation};
use crate::measure::image::plane::{Plane, Region};
use crate::measure::target::{Grid, PatternKind, PrintProfile, look_through};
use nalgebra::Point2;

/// How far around the snake the picture is looked at, px.
///
/// Derived: until it is learned anew the outline moves within three rounds' searches, 36 px at first, and an edge is searched for and its surroundings
/// are examined 30 px further at most.
const AROUND_PX: f64 = 70.0;
/// How far around the straight snake's axis what is printed is asked for where that is more, in its diameters.
///
/// Derived: colours are learned up to a diameter beside the outline, which is half a diameter from the axis.
const PRINT_DIAMETERS: f64 = 1.6;
/// How far around the outline pixels may show snake and target at once, px (σ of a blur of the silhouette).
///
/// Convention: a little more than lens and compression blur a sharp picture.
const BORDER_PX: f64 = 2.0;
/// Half the width of the strip below the modelled holder that is left out, in diameters of the holder.
///
/// Convention: its half width, and as much again.
const BELOW_HOLDER: f64 = 1.0;
/// A pixel whose share of the silhouette, blurred by that, is below this shows the target alone.
///
/// Convention: 1.6 σ of the blur outside.
const SNAKE_SHARE: f32 = 0.05;
/// Lines that are nearer to each other than this, px, are not looked through.
///
/// Derived: a line of a fifth of a pitch is then two pixels wide; a narrower one is washed out by lens and compression, and its profile is that of the
/// pixels that it was seen by.
const LEAST_PITCH_PX: f64 = 10.0;
/// How far around the straight snake the light is looked at, in its diameters.
///
/// Convention: six times as much sheet as snake, so that the median hardly changes where the snake is bent out of it, and near enough that a small
/// sheet fills it.
const LIT_DIAMETERS: f64 = 3.0;
/// How much of the print is looked through is told by one pixel of so many in each direction.
///
/// Convention: tens of thousands are left around a snake.
const STRIDE: usize = 3;

/// What tells snake from target, the picture around the snake seen through it, and the noise of that.
pub struct Colours {
    pub appearance: Appearance,
    /// How the sheet looks, where its lines are looked through.
    pub print: Option<PrintProfile>,
    plane: Plane,
    noise: f64,
    /// How much each pixel of the sheet counts when the colours are learned again: what is printed there is looked through, and the share of its
    /// variance that this leaves is what disturbs the edges.
    counts: Option<Plane>,
}

impl Colours {
    /// From a picture in which a view's outline tells which pixels are snake, where its lines were looked through before; `None` where snake and
    /// target do not differ.
    pub fn learn(
        StraightPicture { frame, .. }: &StraightPicture,
        view: &Projection,
        outline: &Outline,
        is_well_placed: bool,
        before: Option<&Self>,
    ) -> Option<Self> {
        let counts = before.and_then(|before| before.counts.as_ref());
        let mut appearance = appearance_of(frame, view, outline, is_well_placed, counts)?;
        appearance.light = appearance.median_light(frame, &lit_region(view));
        let region = view.image_region(STRAIGHT, AROUND_PX);
        let plane = appearance.plane_within(frame, &region);
        let noise = plane.noise(&region);
        Some(Self { appearance, print: None, plane, noise, counts: None })
    }

    /// The same with the lines of a grid looked through, if it has any that are seen.
    pub fn through(self, picture: &StraightPicture, grid: &Grid, view: &Projection, outline: &Outline) -> Self {
        let StraightPicture { frame, options, .. } = picture;
        let pitch_px = grid.sheet.length_px(view.lens, options.grid_pitch_mm);
        if grid.kind != PatternKind::Lines || pitch_px < LEAST_PITCH_PX {
            return self;
        }
        let silhouette = outline.blurred_silhouette(BORDER_PX);
        let is_target = |pixel: &Point2<f64>| silhouette.sample(pixel) < SNAKE_SHARE;
        let seen = self.appearance.plane(frame);
        let print = PrintProfile::learn(&seen, view.lens, &grid.sheet, options.grid_pitch_mm, is_target);
        let Some(print) = print else { return self };
        let around_px = AROUND_PX.max(PRINT_DIAMETERS * view.diameter_px());
        let around = view.image_region(STRAIGHT, around_px);
        let behind = print.picture(view.lens, &grid.sheet, options.grid_pitch_mm, &around);
        let counts = Some(counts(&print, &behind, &seen, is_target));
        let mut plane = self.plane;
        look_through(&mut plane, &behind);
        let noise = plane.noise(&view.image_region(STRAIGHT, AROUND_PX));
        Self { print: Some(print), plane, noise, counts, ..self }
    }

    /// Finds the picture's edges.
    pub fn finder(&self) -> EdgeFinder<'_> {
        EdgeFinder::with_noise(&self.plane, self.appearance.two_sided, self.noise)
    }
}

/// How much each pixel of a picture of the print counts: paper as one, its darkest or lightest line as the share of the print's variance that looking
/// through it leaves, and what lies between in proportion. What of the print is behind a snake, `is_target` does not tell.
fn counts(print: &PrintProfile, behind: &Plane, seen: &Plane, is_target: impl Fn(&Point2<f64>) -> bool) -> Plane {
    let lines = |b: f32| if b == 0.0 { 0.0 } else { (b - print.paper).abs() };
    let most = behind.data.iter().map(|&b| lines(b)).fold(f32::MIN_POSITIVE, f32::max);
    let (mut printed, mut left) = (f32::MIN_POSITIVE, 0.0);
    for (y, row) in behind.data.chunks_exact(behind.width.max(1)).enumerate().step_by(STRIDE) {
        for (x, &b) in row.iter().enumerate().step_by(STRIDE).filter(|(_, b)| **b != 0.0) {
            let pixel = Point2::new(x as f64, y as f64) + behind.first;
            if is_target(&pixel) {
                let discriminant = seen.get(pixel.x as i64, pixel.y as i64);
                printed += (discriminant - print.paper).powi(2);
                left += (discriminant - b).powi(2);
            }
        }
    }
    let share_seen_through = (1.0 - left / printed).max(0.0);
    let data = behind.data.iter().map(|&b| 1.0 - share_seen_through * lines(b) / most).collect();
    Plane { first: behind.first, ..Plane::new(behind.width, behind.height, data) }
}

/// The part of a picture whose light tells its exposure: around the straight snake.
pub fn lit_region(view: &Projection) -> Region {
    view.image_region(STRAIGHT, LIT_DIAMETERS * view.diameter_px())
}

/// What tells snake from target, learned from inside and outside of the outline: of one that is well placed, of all that the snake shows, of another
/// only of the mean. A pixel of the target counts as much as `counts` says, where that is known of it.
///
/// The holder goes on below what is modelled of it, for how far nobody knows: what lies there is neither.
pub fn appearance_of(
    frame: &Frame,
    view: &Projection,
    outline: &Outline,
    is_well_placed: bool,
    counts: Option<&Plane>,
) -> Option<Appearance> {
    let (x0, y0, x1, y1) = outline.bounds();
    let margin = x1 - x0;
    let (end, axis) = view.holder_end();
    let half_width_px = BELOW_HOLDER * view.diameter_px();
    let is_below_holder = |pixel: &Point2<f64>| {
        let from_end = pixel - end;
        axis.dot(&from_end) < 0.0 && axis.perp(&from_end).abs() < half_width_px
    };
    let separation = if is_well_placed { Separation::OfPixels } else { Separation::OfMeans };
    Appearance::learn(frame, separation, |x, y| {
        let pixel = Point2::new(f64::from(x), f64::from(y));
        let near = pixel.x > x0 - margin && pixel.x < x1 + margin && pixel.y > y0 - margin && pixel.y < y1 + margin;
        if !near {
            return None;
        }
        let is_snake = outline.covers(&pixel);
        let count = counts.filter(|_| !is_snake).map_or(1.0, |counts| f64::from(counts.sample(&pixel)));
        (is_snake || !is_below_holder(&pixel)).then_some((is_snake, count))
    })
}
