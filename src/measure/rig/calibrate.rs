//! Calibrates a rig from a picture of the straight snake before the grid target.

use super::alignment::aligned_starts;
use super::background::Colours;
use super::base_fit::{STANDOFF_SIGMA_MM, StraightPicture, fit_base};
use super::error::{CalibrationStep, RigError};
use super::holder_sides::{SnakeStart, find_start, holders_at_border};
use super::locate::{Holder, MOST_WIDTH, locate_holders};
use super::parameters::{Rig, RigOptions};
use super::scale::{contradiction, pattern_of};
use crate::camera::{Frame, Lens};
use crate::measure::target::{Grid, find_grid};
use crate::robot::Robot;
use nalgebra::Point2;
use rayon::prelude::*;
use std::ops::{Range, RangeInclusive};

/// A snake further from where the standoff puts it than this many times the standoff's precision contradicts what was stated.
///
/// Convention: a wrong millimetre of the standoff is the fit's to find (1.5 mm), a wrong pitch is the user's.
const FAR_OFF_SIGMAS: f64 = 15.0;
/// How wide the holder may be, in units of the width that was seen of it, in each of the searches for the grid: what was seen may be
/// only its dark side, and thin lines have an overtone of twice their number; or a shadow was seen with it.
///
/// Fitted: by hand to the rigs of tests/eye/robustness; not judged elsewhere.
const WIDTHS: [(f64, f64); 3] = [(0.85, 2.2), (1.25, 2.2), (0.45, 0.85)];
/// How wide the holder may be in the end, in units of the width that was seen of it.
///
/// Derived: from the widths above, and a tenth more for a target that leans.
const SEEN_WIDTHS: Range<f64> = 0.4..2.45;
/// Ranges of the pitch that begin and end within this share of each other's are one.
///
/// Convention: far less than they are wide.
const SAME_RANGE: f64 = 0.15;
/// Starts of snakes whose places and widths differ by less than this share of the width are the same.
///
/// Convention: what follows searches further than that.
const SAME_START: f64 = 0.1;
/// Grids whose distances differ by less than this share are the same lines.
///
/// Convention: a line more or less among a hundred would change it by three times as much.
const SAME_GRID: f64 = 0.003;
/// Other pitches, in units of the one that was stated, with which it may be plain what is wrong.
///
/// Convention: every other line missing, or as many between.
const OTHER_PITCHES: [f64; 2] = [0.5, 2.0];

/// Finds the rig in a picture of the straight snake before the grid target.
///
/// 1. The snake is the large, long object that is unlike the target; its width tells the scale. Where there are several,
///    each is tried in turn.
/// 2. The grid near the pitch that this scale predicts gives the camera's pose to the target.
/// 3. The snake lies parallel to the target, `standoff_mm` before it; its silhouette tells where along its axis it begins, and its
///    edges give the base's place and direction, and refine standoff and parallelism within what a ruler can do.
///
/// # Errors
///
/// Why the try that came furthest ended, with the values that tell.
pub fn find_rig(frame: &Frame, lens: &Lens, robot: &Robot, options: &RigOptions) -> Result<Rig, RigError> {
    if (frame.width, frame.height) != (lens.width, lens.height) {
        let (picture_px, lens_px) = ([frame.width, frame.height], [lens.width, lens.height]);
        return Err(RigError::WrongSize { picture_px, lens_px });
    }
    let pictures = Colours::of(frame);
    let (mut holders, mut refused): (Vec<(&Colours, Holder)>, _) = (Vec::new(), None);
    for colours in &pictures {
        match locate_holders(frame, colours) {
            Ok(found) => holders.extend(found.into_iter().map(|holder| (colours, holder))),
            Err(error) => refused = Some(error.or_further(refused)),
        }
    }
    let mut search = Search::default();
    for (colours, holder) in &holders {
        let picture = StraightPicture { frame, lens, robot, options };
        match calibrate_from(picture, colours, holder, &mut search) {
            Ok(rig) => return Ok(rig),
            Err(error) => refused = Some(error.or_further(refused)),
        }
    }
    let picture = StraightPicture { frame, lens, robot, options };
    match refused {
        Some(error) if error.step() < CalibrationStep::Scale => {
            let cut = search.cut_by_the_border(picture, &pictures);
            cut.ok_or_else(|| search.contradiction(picture, &holders).unwrap_or(error))
        }
        error => Err(error.unwrap_or(RigError::NoObject)),
    }
}

/// What was found and tried so far: objects of other colours lead to the same grids and snakes.
#[derive(Default)]
struct Search {
    /// Holders, the range of the pitch, px, and the grid that was found in it.
    grids: Vec<(Holder, RangeInclusive<f64>, Option<Grid>)>,
    /// Where a snake of which width was looked for.
    starts: Vec<(Point2<f64>, f64)>,
}

impl Search {
    /// The grid beside a holder with a pitch in a range, px.
    fn grid(&mut self, picture: StraightPicture, holder: &Holder, range: &RangeInclusive<f64>) -> Option<Grid> {
        let is_near = |a: f64, b: f64| (a / b - 1.0).abs() < SAME_RANGE;
        let known = self.grids.iter().find(|(other, searched, _)| {
            let is_same_range = is_near(*searched.start(), *range.start()) && is_near(*searched.end(), *range.end());
            is_same_range && other.covers_like(holder)
        });
        if let Some((_, _, grid)) = known {
            return grid.clone();
        }
        let pitch_mm = picture.options.grid_pitch_mm;
        let grid = find_grid(picture.frame, picture.lens, pitch_mm, range, holder.axis, |p| holder.covers(p));
        self.grids.push((holder.clone(), range.clone(), grid.clone()));
        grid
    }

    /// Whether this is the first start there.
    fn is_new(&mut self, start: &SnakeStart, width_px: f64) -> bool {
        let near_px = SAME_START * width_px;
        let is_new = self
            .starts
            .iter()
            .all(|(base, width)| (base - start.base).norm() > near_px || (width - width_px).abs() > near_px);
        if is_new {
            self.starts.push((start.base, width_px));
        }
        is_new
    }

    /// The grids that were found, each once.
    fn distinct_grids(&self, lens: &Lens) -> Vec<Grid> {
        let ray = lens.ray(&lens.centre_px);
        let mut distinct: Vec<Grid> = Vec::new();
        for grid in self.grids.iter().filter_map(|(_, _, grid)| grid.as_ref()) {
            let is_same = |other: &Grid| (other.distance_mm(&ray) / grid.distance_mm(&ray) - 1.0).abs() < SAME_GRID;
            if !distinct.iter().any(is_same) {
                distinct.push(grid.clone());
            }
        }
        distinct
    }

    /// The rig of a snake that stood out too little to be an object, but whose holder the border cuts: a grid tells how wide it is.
    fn cut_by_the_border(&mut self, picture: StraightPicture, pictures: &[Colours]) -> Option<Rig> {
        let StraightPicture { lens, robot, options, .. } = picture;
        self.distinct_grids(lens).iter().find_map(|grid| {
            let distance_mm = grid.distance_mm(&lens.ray(&lens.centre_px)) - options.standoff_mm;
            let width_px = lens.focal_px.x * robot.body.disk_diameter_mm / distance_mm;
            if !(0.0..MOST_WIDTH * f64::from(lens.width.max(lens.height))).contains(&width_px) {
                return None;
            }
            let cut = |colours| holders_at_border(colours, width_px).into_iter().map(move |holder| (colours, holder));
            let mut holders = pictures.iter().flat_map(cut);
            holders.find_map(|(colours, holder)| calibrate_on(picture, colours, &holder, grid, self).ok())
        })
    }

    /// The contradiction of a snake that fits before a grid that was found, if its lines are half or twice as far apart as was stated.
    fn contradiction(&self, picture: StraightPicture, holders: &[(&Colours, Holder)]) -> Option<RigError> {
        let (colours, holder) = holders.first()?;
        let StraightPicture { lens, robot, options, .. } = picture;
        let grids = self.distinct_grids(lens);
        OTHER_PITCHES.into_par_iter().find_map_first(|factor| {
            let other = RigOptions { grid_pitch_mm: factor * options.grid_pitch_mm, ..*options };
            let picture = StraightPicture { options: &other, ..picture };
            let rig = grids.iter().find_map(|grid| {
                let mut afresh = Self::default();
                calibrate_on(picture, colours, holder, &grid.with_pitch_times(factor), &mut afresh).ok()
            });
            // Of lines that are closer or further apart than was looked for no grid was found yet.
            let rig = rig.or_else(|| calibrate_from(picture, colours, holder, &mut Self::default()).ok());
            rig.map(|rig| contradiction(robot, options, &rig))
        })
    }
}

/// Calibrates the rig if this is the holder.
fn calibrate_from(
    picture: StraightPicture,
    colours: &Colours,
    holder: &Holder,
    search: &mut Search,
) -> Result<Rig, RigError> {
    let StraightPicture { lens, robot, options, .. } = picture;
    let pitch_px = |width_px: f64| {
        let distance_mm = lens.focal_px.x * robot.body.disk_diameter_mm / width_px;
        lens.focal_px.x * options.grid_pitch_mm / (distance_mm + options.standoff_mm)
    };
    let mut refused = None;
    for (narrowest, widest) in WIDTHS {
        let range = pitch_px(narrowest * holder.width_px)..=pitch_px(widest * holder.width_px);
        let outcome = match search.grid(picture, holder, &range) {
            Some(grid) => calibrate_on(picture, colours, holder, &grid, search),
            None => {
                let pitch_px = [*range.start(), *range.end()];
                Err(RigError::NoGrid { grid_pitch_mm: options.grid_pitch_mm, pitch_px })
            }
        };
        match outcome {
            Ok(rig) => return Ok(rig),
            Err(error) => refused = Some(error.or_further(refused)),
        }
    }
    Err(refused.unwrap_or(RigError::NoObject))
}

/// Calibrates the rig if these are the holder and the grid.
fn calibrate_on(
    picture: StraightPicture,
    colours: &Colours,
    holder: &Holder,
    grid: &Grid,
    search: &mut Search,
) -> Result<Rig, RigError> {
    let StraightPicture { lens, robot, options, .. } = picture;
    // The snake is nearer than the grid by the standoff; where it is cut by the border its holder is this wide.
    let target_mm = grid.distance_mm(&lens.ray(&holder.root));
    let distance_mm = target_mm - options.standoff_mm;
    if distance_mm <= 0.0 {
        return Err(RigError::BehindCamera { target_mm, standoff_mm: options.standoff_mm });
    }
    let width_px = lens.focal_px.x * robot.body.disk_diameter_mm / distance_mm;
    if !SEEN_WIDTHS.contains(&(width_px / holder.width_px)) {
        return Err(RigError::NoHolder { width_px });
    }
    let rough = find_start(colours, holder, width_px)?;
    if !search.is_new(&rough, width_px) {
        return Err(RigError::NoHolder { width_px });
    }
    let starts = aligned_starts(picture, &rough, grid);
    let fits: Vec<_> = starts.par_iter().map(|start| fit_at(picture, start, grid)).collect();
    let mut refused = None;
    for fit in fits {
        match fit {
            Ok(rig) => return Ok(rig),
            Err(error) => refused = refused.or(Some(error)),
        }
    }
    Err(refused.unwrap_or(RigError::NoContrast))
}

/// Fits the snake from a start, and checks the scale.
fn fit_at(picture: StraightPicture, start: &SnakeStart, grid: &Grid) -> Result<Rig, RigError> {
    let StraightPicture { robot, options, .. } = picture;
    let rig = fit_base(picture, start, grid)?;
    if (rig.standoff_mm() - options.standoff_mm).abs() > FAR_OFF_SIGMAS * STANDOFF_SIGMA_MM {
        return Err(contradiction(robot, options, &rig));
    }
    Ok(Rig { pattern: pattern_of(picture, grid)?, ..rig })
}
