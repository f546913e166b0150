//! Calibrates a rig from a picture of the straight snake before the grid target: first the sheet, then the snake.

use super::alignment::aligned_starts;
use super::base_fit::{StraightPicture, fit_base, place_base};
use super::base_problem::STANDOFF_SIGMA_MM;
use super::body_template::BodyTemplate;
use super::error::{CalibrationStep, RigError};
use super::parameters::{Rig, RigOptions};
use super::scale::{contradiction, pattern_of};
use super::sketch::RigSketch;
use super::snake_search::{SnakeStart, search_everywhere, search_nearby};
use crate::camera::Lens;
use crate::measure::target::{Grid, PictureRegion, SheetHypothesis, SheetSearch};
use nalgebra::{Point2, Point3};
use std::ops::Range;

/// A snake further from where the standoff puts it than this many times the standoff's precision contradicts what was stated.
///
/// Convention: a wrong millimetre of the standoff is the fit's to find (1.5 mm), a wrong pitch is the user's.
const FAR_OFF_SIGMAS: f64 = 15.0;
/// The least width of a snake, px.
///
/// Convention: twelve cells across are looked at, of one pixel and more.
const LEAST_WIDTH_PX: f64 = 12.0;
/// The least width of a snake, as a share of the picture's longer side.
///
/// Convention: a snake of an eightieth of the picture is a twelfth as long as it.
const LEAST_WIDTH: f64 = 1.0 / 80.0;
/// The largest width of a snake, as a share of the picture's longer side.
///
/// Convention: a snake that is wider than a third of the picture is not seen whole.
const MOST_WIDTH: f64 = 0.35;
/// How many rulings are taken for the stated one, until one fits.
///
/// Convention: a limit of time; in every picture that is accepted it was the first or the second.
const MOST_RULINGS: usize = 3;
/// How many places of the snake are tried before each ruling.
///
/// Convention: a limit of time; in every picture that is accepted it was the first or the second.
const MOST_STARTS: usize = 2;
/// A snake that explains so many times less of the picture than another is not looked at.
///
/// Convention: as of one that is half as wide and explains as large a share of what is around it.
const DWARFED: f64 = 4.0;
/// Snakes whose widths differ by less than this share are searched for once.
///
/// Derived: a twentieth of the length is a third of a width at the tip, a cell and a half.
const SAME_WIDTH: f64 = 0.05;
/// The pitches, in units of the stated one, with which the snake's size is tried where none fits as stated.
///
/// Convention: inches for centimetres, halves, doubles and what lies between, in steps that the matched filter bridges.
const OTHER_PITCHES: [f64; 8] = [0.5, 2.0, 0.7, 1.4, 0.4, 2.54, 0.25, 4.0];

/// Finds the rig in a picture of the straight snake before the grid target, and notes in the sketch what it saw.
///
/// 1. The sheet is where the picture is periodic in two directions. Its clearest ruling gives its pose and shape.
/// 2. Each ruling in turn is taken for the one of the stated pitch; scale and standoff then say how wide the snake is, and a matched filter of
///    the straight body finds it.
/// 3. The snake lies parallel to the sheet, `standoff_mm` before it; its edges give the base's place and direction, and refine standoff and
///    parallelism within what a jig can do. The first place that the edges confirm is the snake's.
///
/// # Errors
///
/// Why the try that came furthest ended, with the values that tell.
pub fn find_rig(picture: StraightPicture, sketch: &mut RigSketch) -> Result<Rig, RigError> {
    let StraightPicture { frame, lens, robot, options } = picture;
    if (frame.width, frame.height) != (lens.width, lens.height) {
        let (picture_px, lens_px) = ([frame.width, frame.height], [lens.width, lens.height]);
        return Err(RigError::WrongSize { picture_px, lens_px });
    }
    let search = SheetSearch::new(frame, lens, options.grid_pitch_mm);
    let region = region_of(&search, lens);
    sketch.sheet.clone_from(&region.0);
    if search.hypotheses.is_empty() {
        return Err(RigError::NoSheet);
    }
    let tries = Tries { picture, search: &search, region: &region, template: BodyTemplate::of(robot) };
    let (mut rulings, mut refused): (Vec<Ruling>, _) = (Vec::new(), None);
    for hypothesis in &search.hypotheses {
        let outcome = tries.ruling(hypothesis, &rulings).and_then(|mut ruling| {
            // A snake that explains most of what is seen around it is asked for its edges before others are looked for.
            let is_asked = ruling.explains_most() && !ruling.is_dwarfed(&rulings);
            let rig = is_asked.then(|| tries.rig(&mut ruling, sketch)).transpose();
            rulings.push(ruling);
            rig
        });
        match outcome {
            Ok(Some(rig)) => return Ok(rig),
            Ok(None) => {}
            Err(error) => refused = Some(error.or_further(refused)),
        }
    }
    rulings.sort_by(|a, b| b.gain().total_cmp(&a.gain()));
    for k in 0..rulings.len().min(MOST_RULINGS) {
        if rulings[k].is_tried || rulings[k].is_dwarfed(&rulings) {
            continue;
        }
        match tries.rig(&mut rulings[k], sketch) {
            Ok(rig) => return Ok(rig),
            Err(error) => refused = Some(error.or_further(refused)),
        }
    }
    let best = rulings.first();
    match refused {
        Some(error) if error.step() < CalibrationStep::Scale => {
            let contradiction = tries.contradiction(best.map_or(0.0, Ruling::gain), sketch);
            let no_snake = || match best {
                _ if !search.is_print => RigError::NoSheet,
                Some(best) if !best.explains_most() => {
                    RigError::NoForm { explained: best.explained(), source: Box::new(error) }
                }
                _ => error,
            };
            Err(contradiction.unwrap_or_else(no_snake))
        }
        // Edges may confirm a small thing for the snake where a larger one explains the picture better.
        Some(error @ RigError::PitchContradiction { .. }) => {
            Err(tries.contradiction(best.map_or(0.0, Ruling::gain), sketch).unwrap_or(error))
        }
        error => Err(error.unwrap_or(RigError::NoSheet)),
    }
}

/// The part of the picture that shows the sheet: the hull of the windows that saw it, and half of their reach around.
pub(super) fn region_of(search: &SheetSearch, lens: &Lens) -> PictureRegion {
    let reach_px = search.reach_px;
    let corners = search.seen.iter().flat_map(|at| {
        [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(x, y)| {
            let inside = |v: f64, length: u32| v.clamp(-1.0, f64::from(length));
            [inside(at.x + x * reach_px, lens.width), inside(at.y + y * reach_px, lens.height)]
        })
    });
    PictureRegion::around(corners.map(Into::into))
}

/// What is tried with one picture.
struct Tries<'a> {
    picture: StraightPicture<'a>,
    search: &'a SheetSearch,
    region: &'a PictureRegion,
    template: BodyTemplate,
}

/// A ruling taken for the one of the stated pitch, and where a snake of the size that follows may be before it.
struct Ruling {
    hypothesis: SheetHypothesis,
    width_px: f64,
    found: Vec<SnakeStart>,
    is_tried: bool,
}

impl Ruling {
    /// Whether a snake of this size explains most of what is seen of it and around it.
    fn explains_most(&self) -> bool {
        self.explained() > 0.5
    }

    /// The share of what is seen of it and around it that a snake of this size explains.
    fn explained(&self) -> f64 {
        self.found.first().map_or(0.0, |start| start.fit.share)
    }

    /// Whether a snake of another size, whose edges were asked for, explains far more of the picture: if its edges do not confirm it, something stands
    /// there that the model does not know, and a small thing elsewhere is not the snake.
    fn is_dwarfed(&self, others: &[Self]) -> bool {
        let is_larger = |other: &Self| other.squares_px2() > DWARFED * self.squares_px2();
        others.iter().any(|other| other.is_tried && other.explains_most() && is_larger(other))
    }

    /// How well a snake of this size explains what is around it.
    fn gain(&self) -> f64 {
        self.found.first().map_or(0.0, |start| start.fit.gain)
    }

    /// How much of the picture a snake of this size explains, px².
    fn squares_px2(&self) -> f64 {
        self.found.first().map_or(0.0, |start| start.fit.squares_px2)
    }
}

impl Tries<'_> {
    /// Looks for the snake if this ruling is the one of the stated pitch; where another one asked for a snake of the same size, it was
    /// looked for already.
    fn ruling(&self, hypothesis: &SheetHypothesis, known: &[Ruling]) -> Result<Ruling, RigError> {
        let StraightPicture { frame, lens, options, .. } = self.picture;
        let (width_px, pitch_px) = (self.width_px(hypothesis), hypothesis.pitch_px);
        if width_px.is_nan() || width_px <= 0.0 {
            let target_mm = hypothesis.distance_mm(&lens.ray(&self.region.middle()));
            return Err(RigError::BehindCamera { target_mm, standoff_mm: options.standoff_mm });
        }
        let side_px = f64::from(frame.width.max(frame.height));
        let widths: Range<f64> = LEAST_WIDTH_PX.max(LEAST_WIDTH * side_px)..MOST_WIDTH * side_px;
        if !widths.contains(&width_px) {
            return Err(RigError::NoSnake { pitch_px, width_px });
        }
        let same = known.iter().find(|other| (other.width_px / width_px - 1.0).abs() < SAME_WIDTH);
        let found = match same {
            Some(other) => other.found.clone(),
            None => search_everywhere(frame, &self.template, width_px, self.region, |_| true),
        };
        let is_found = !found.is_empty();
        is_found
            .then(|| Ruling { hypothesis: hypothesis.clone(), width_px, found, is_tried: false })
            .ok_or(RigError::NoSnake { pitch_px, width_px })
    }

    /// The rig if this ruling is the one of the stated pitch.
    fn rig(&self, ruling: &mut Ruling, sketch: &mut RigSketch) -> Result<Rig, RigError> {
        let StraightPicture { frame, .. } = self.picture;
        ruling.is_tried = true;
        let Ruling { hypothesis, width_px, found, .. } = ruling;
        let starts = search_nearby(frame, &self.template, *width_px, self.region, found);
        if sketch.bodies.is_empty() {
            sketch.see_snake(hypothesis.lines_px(), self.strips(&starts, *width_px));
        }
        let rough = hypothesis.rough_grid();
        let (mut refused, mut tried) = (None, Vec::new());
        for start in starts.iter().take(MOST_STARTS) {
            let along = aligned_starts(self.picture, start, &rough);
            if along.is_empty() {
                refused = refused.or(Some(RigError::NoContrast));
            }
            for aligned in along {
                // Starts one behind the other on one axis lead to the same places.
                if tried.iter().any(|other| aligned.is_same(other, *width_px)) {
                    continue;
                }
                tried.push(aligned);
                match fit_along(self.picture, &aligned, &rough) {
                    Err(error) => refused = refused.or(Some(error)),
                    Ok(fitted) => match self.rig_at(hypothesis, &fitted, *width_px) {
                        Ok(rig) => {
                            sketch.see_snake(hypothesis.lines_px(), self.strips(&[*start], *width_px));
                            return Ok(rig);
                        }
                        Err(error) => {
                            refused = refused.or(Some(error));
                            break;
                        }
                    },
                }
            }
        }
        let pitch_px = hypothesis.pitch_px;
        Err(refused.unwrap_or(RigError::NoSnake { pitch_px, width_px: *width_px }))
    }

    /// The rig of a snake that edges confirmed before a ruling: the sheet is measured anew without what the snake hides of it.
    fn rig_at(&self, hypothesis: &SheetHypothesis, start: &SnakeStart, width_px: f64) -> Result<Rig, RigError> {
        let StraightPicture { lens, robot, options, .. } = self.picture;
        let (body, pitch_px) = (start.covered(&self.template, width_px), hypothesis.pitch_px);
        let grid = self.search.refined(lens, hypothesis, Some(&body)).ok_or(RigError::SheetNotMeasured { pitch_px })?;
        let rig = fit_base(self.picture, start, &grid)?;
        if (rig.standoff_mm() - options.standoff_mm).abs() > FAR_OFF_SIGMAS * STANDOFF_SIGMA_MM {
            return Err(contradiction(robot, options, &rig));
        }
        self.as_stated(&grid, Rig { pattern: pattern_of(self.picture, &grid), ..rig })
    }

    /// The rig, unless its lines are not as far apart as was stated: every other one is missing, or there are as many between. The scale is right
    /// all the same, since the snake's size says which overtone of the pattern was found.
    fn as_stated(&self, grid: &Grid, rig: Rig) -> Result<Rig, RigError> {
        let StraightPicture { lens, robot, options, .. } = self.picture;
        match self.search.other_ruling(lens, grid) {
            Some(factor) => Err(RigError::PitchContradiction {
                stated_mm: options.grid_pitch_mm,
                found_mm: factor * options.grid_pitch_mm,
                diameter_mm: robot.body.disk_diameter_mm,
            }),
            None => Ok(rig),
        }
    }

    /// The boxes of places of a snake so many px wide.
    fn strips(&self, starts: &[SnakeStart], width_px: f64) -> Vec<[Point2<f64>; 4]> {
        starts.iter().map(|start| start.strip(&self.template, width_px)).collect()
    }

    /// How wide the snake is if this ruling has the stated pitch, px; not positive where it would be behind the camera.
    fn width_px(&self, hypothesis: &SheetHypothesis) -> f64 {
        let StraightPicture { lens, robot, options, .. } = self.picture;
        let distance_mm = hypothesis.distance_mm(&lens.ray(&self.region.middle())) - options.standoff_mm;
        lens.focal_px.x * robot.body.disk_diameter_mm / distance_mm
    }

    /// The contradiction of a snake that fits before the sheet if its lines are further apart than was stated, or closer, and that explains the
    /// picture better than any of the stated size did.
    fn contradiction(&self, as_stated: f64, sketch: &mut RigSketch) -> Option<RigError> {
        let clearest = self.search.hypotheses.first()?;
        let tried = OTHER_PITCHES
            .iter()
            .filter_map(|&factor| Some((factor, self.ruling(&clearest.with_pitch_times(factor), &[]).ok()?)));
        let (factor, Ruling { hypothesis, width_px, found, .. }) =
            tried.max_by(|(_, a), (_, b)| a.gain().total_cmp(&b.gain()))?;
        let StraightPicture { frame, robot, options, lens } = self.picture;
        let start = search_nearby(frame, &self.template, width_px, self.region, &found).into_iter().next()?;
        if found.first()?.fit.gain <= as_stated {
            return None;
        }
        let other = RigOptions { grid_pitch_mm: factor * options.grid_pitch_mm, ..*options };
        let body = start.covered(&self.template, width_px);
        let grid = self.search.refined(lens, clearest, Some(&body))?.with_pitch_times(factor);
        let rig = fit_base(StraightPicture { options: &other, ..self.picture }, &start, &grid).ok()?;
        sketch.see_snake(hypothesis.lines_px(), self.strips(&[start], width_px));
        Some(contradiction(robot, options, &rig))
    }
}

/// Where a snake's edges put its base before a sheet that is known roughly, if they confirm it.
fn fit_along(picture: StraightPicture, start: &SnakeStart, grid: &Grid) -> Result<SnakeStart, RigError> {
    let camera_from_base = place_base(picture, start, grid)?;
    let on_axis = |z_mm: f64| picture.lens.project(&(camera_from_base * Point3::new(0.0, 0.0, z_mm)));
    let (base, tip) = (on_axis(0.0), on_axis(picture.robot.length_mm));
    Ok(SnakeStart { base, axis: (tip - base).normalize(), ..*start })
}
