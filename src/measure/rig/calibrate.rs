//! Calibrates a rig from a picture of the straight snake before the grid target.

use super::background::Colours;
use super::base_fit::{STANDOFF_SIGMA_MM, StraightPicture, fit_base};
use super::error::{CalibrationStep, RigError};
use super::holder_sides::{SnakeStart, find_start};
use super::locate::{Holder, locate_holders};
use super::parameters::{Rig, RigOptions};
use super::scale::{contradiction, pattern_of};
use crate::camera::{Frame, Lens};
use crate::measure::target::{Grid, find_grid};
use crate::robot::Robot;

/// A snake further from where the standoff puts it than this many times the standoff's precision contradicts what was stated.
///
/// Convention: a wrong millimetre of the standoff is the fit's to find (1.5 mm), a wrong pitch is the user's.
const FAR_OFF_SIGMAS: f64 = 15.0;
/// How wide the holder may be, in units of the width that was seen of it, in each of the searches for the grid: what was seen may be
/// only its dark side, and thin lines have an overtone of twice their number; or a shadow was seen with it.
///
/// Fitted: by hand to the rigs of tests/eye/robustness; not judged elsewhere.
const WIDTHS: [(f64, f64); 3] = [(0.85, 2.2), (1.25, 2.2), (0.45, 0.85)];
/// Grids whose distances differ by less than this share are the same.
///
/// Convention: half the least step between the searches.
const SAME_GRID: f64 = 0.05;
/// Disks by which the snake's start may be off, nearest first: disks look alike, and a start may lie between them.
///
/// Convention: two disks either way; more would be more than the holder's end is ever off.
const DISKS_OFF: [f64; 8] = [-1.0, 1.0, -0.5, 0.5, -1.5, 1.5, -2.0, 2.0];
/// Other pitches, in units of the one that was stated, with which it may be plain what is wrong.
///
/// Convention: every other line missing, or as many between.
const OTHER_PITCHES: [f64; 2] = [0.5, 2.0];

/// Calibrates a rig from a picture of the straight snake before the grid target.
///
/// 1. The snake is the large, long object that is unlike the target; its width tells the scale. Where there are several,
///    each is tried in turn.
/// 2. The grid near the pitch that this scale predicts gives the camera's pose to the target.
/// 3. The snake lies parallel to the target, `standoff_mm` before it; its edges give the base's place and direction, and
///    refine standoff and parallelism within what a ruler can do.
///
/// # Errors
///
/// Why the try that came furthest ended, with the values that tell.
pub fn calibrate_rig(frame: &Frame, lens: &Lens, robot: &Robot, options: &RigOptions) -> Result<Rig, RigError> {
    if (frame.width, frame.height) != (lens.width, lens.height) {
        let (picture_px, lens_px) = ([frame.width, frame.height], [lens.width, lens.height]);
        return Err(RigError::WrongSize { picture_px, lens_px });
    }
    let pictures = Colours::of(frame);
    let (mut holders, mut refused) = (Vec::new(), None);
    for colours in &pictures {
        match locate_holders(frame, colours) {
            Ok(found) => holders.extend(found.into_iter().map(|holder| (colours, holder))),
            Err(error) => refused = Some(error.or_further(refused)),
        }
    }
    for (colours, holder) in &holders {
        match calibrate_from(StraightPicture { frame, lens, robot, options }, colours, holder) {
            Ok(rig) => return Ok(rig),
            Err(error) => refused = Some(error.or_further(refused)),
        }
    }
    for factor in OTHER_PITCHES {
        if refused.as_ref().is_some_and(|error| error.step() == CalibrationStep::Scale) {
            break;
        }
        let other = RigOptions { grid_pitch_mm: factor * options.grid_pitch_mm, ..*options };
        let picture = StraightPicture { frame, lens, robot, options: &other };
        let rig = holders.iter().find_map(|(colours, holder)| calibrate_from(picture, colours, holder).ok());
        refused = rig.map(|rig| contradiction(robot, options, &rig)).or(refused);
    }
    Err(refused.unwrap_or(RigError::NoObject))
}

/// Calibrates the rig if this is the holder.
fn calibrate_from(picture: StraightPicture, colours: &Colours, holder: &Holder) -> Result<Rig, RigError> {
    let StraightPicture { frame, lens, robot, options } = picture;
    let pitch_px = |width_px: f64| {
        let distance_mm = lens.focal_px.x * robot.body.disk_diameter_mm / width_px;
        lens.focal_px.x * options.grid_pitch_mm / (distance_mm + options.standoff_mm)
    };
    let mut refused = None;
    let mut tried: Vec<f64> = Vec::new();
    for (narrowest, widest) in WIDTHS {
        let range = pitch_px(narrowest * holder.width_px)..=pitch_px(widest * holder.width_px);
        let grid = find_grid(frame, lens, options.grid_pitch_mm, &range, holder.axis, |p| holder.covers(p));
        let Some(grid) = grid else {
            let pitch_px = [*range.start(), *range.end()];
            let error = RigError::NoGrid { grid_pitch_mm: options.grid_pitch_mm, pitch_px };
            refused = Some(error.or_further(refused));
            continue;
        };
        let distance_mm = grid.distance_mm(&lens.ray(&holder.root));
        if tried.iter().any(|other| (distance_mm / other - 1.0).abs() < SAME_GRID) {
            continue;
        }
        tried.push(distance_mm);
        match calibrate_on(picture, colours, holder, &grid) {
            Ok(rig) => return Ok(rig),
            Err(error) => refused = Some(error.or_further(refused)),
        }
    }
    Err(refused.unwrap_or(RigError::NoObject))
}

/// Calibrates the rig if these are the holder and the grid.
fn calibrate_on(picture: StraightPicture, colours: &Colours, holder: &Holder, grid: &Grid) -> Result<Rig, RigError> {
    let StraightPicture { lens, robot, options, .. } = picture;
    // The snake is nearer than the grid by the standoff; where it is cut by the border its holder is this wide.
    let target_mm = grid.distance_mm(&lens.ray(&holder.root));
    let distance_mm = target_mm - options.standoff_mm;
    if distance_mm <= 0.0 {
        return Err(RigError::BehindCamera { target_mm, standoff_mm: options.standoff_mm });
    }
    let start = find_start(colours, holder, lens.focal_px.x * robot.body.disk_diameter_mm / distance_mm)?;
    // Where the first start ends in a snake that is not all there, it may be a disk or two off, or between them.
    let pitch_px = lens.focal_px.x * robot.disk_pitch_mm() / distance_mm;
    let moved = |disks: f64| SnakeStart { base: start.base + start.axis * (disks * pitch_px), axis: start.axis };
    fit_at(picture, &start, grid).or_else(|error| {
        let mut others = DISKS_OFF.into_iter();
        others.find_map(|disks| fit_at(picture, &moved(disks), grid).ok()).ok_or(error)
    })
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
