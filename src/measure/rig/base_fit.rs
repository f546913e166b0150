//! Fits the straight snake to its picture: the place of its base before the grid target.
//!
//! Rounds of projecting the model's outline, matching the picture's edges near it and moving the base, the search narrowing from
//! round to round. While the search is wide the loss is Huber's, for a whole family of edges may be far off because the model is, and
//! must go on pulling; then Tukey's biweight, to which what is still far off counts nothing.

use super::base_problem::BaseProblem;
use super::colours::Colours;
use super::error::{RigError, SnakePart};
use super::parameters::{Rig, RigOptions};
use super::placement::{PLACEMENT, Placement};
use super::snake_search::SnakeStart;
use super::tilt::{TILT_SIGMAS, of_its_own_tilt, seeming_tilt_sigma};
use crate::camera::{Frame, Lens};
use crate::geometry::{Configuration, Pose};
use crate::measure::body::{Outline, Projection};
use crate::measure::fit::{
    BIASES, Correspondences, EdgeBias, FINE_SEARCH_PX, Filters, PartVisibility, RobustPhase, UNKNOWN_SHAPE_RAD, excess,
    inliers, noise_model, systematic_covariance,
};
use crate::measure::target::{Grid, GridPattern};
use crate::robot::Robot;
use crate::statistics::cluster::clustered_covariance;
use crate::statistics::least_squares::{Options, Solution, solve};
use nalgebra::{DMatrix, DVector};

/// How far from the outline edges are searched for in each round, px.
///
/// Fitted: by hand on the project's renders (tests/eye/robustness), from the holder's end being found to some 10 px down to the fine search;
/// not judged elsewhere.
const SEARCHES_PX: [f64; 11] = [14.0, 12.0, 10.0, 8.0, 7.0, 6.0, 5.0, 4.0, 3.0, 3.0, 3.0];
/// How far a round is iterated before the fine search, whose rounds end where rounding does.
///
/// Convention: a straight snake takes four iterations to the end of what rounding leaves; another object takes up to hundreds, and a
/// round that goes on from there finds other edges anyway.
const COARSE_ITERATIONS: usize = 10;
/// The appearance is learned anew every so many rounds.
///
/// Convention: a limit of time.
const LEARNING_ROUNDS: usize = 3;
/// How far outside the snake's border its edges may be seen, px (1σ), and what stands for none at all: while the model is off, a bias would
/// take the blame and carry scale and tilt away. So would a tilt, by which rims that mirror the target seem to lie where they do not: until then the
/// snake is held as parallel to a grid that is known well as a jig holds it.
///
/// Fitted: the former by hand to the rigs of tests/eye/uncertainty, where edges of tubes lie up to 0.25 px outside; not judged elsewhere.
const BIAS_SIGMA_PX: f64 = 0.3;
const NO_BIAS_PX: f64 = 1e-3;
/// Fewest edges, and least share of the places, with which a round goes on.
///
/// Convention: eight parameters, and a third of the outline; whether the model is right is judged at the end.
const FEWEST_EDGES: usize = 40;
const LEAST_SHARE: f64 = 1.0 / 3.0;
/// Share of the straight snake's outline that must be confirmed by edges.
///
/// Convention: a majority.
const LEAST_AGREEING: f64 = 0.5;
/// Before squares of which one colour is like the snake's, half of the outline may have no edge at all. Where every part is visible all the
/// same, at least this share of the edges found must agree.
///
/// Convention: nearly all; of edges at random within the last search a third would lie as near.
const LEAST_AGREEING_OF_FOUND: f64 = 0.9;
/// An edge bias beyond this, px, is no edge's but a wrong model's; blurred edges are displaced by as much more as they are wider than
/// a pixel.
///
/// Derived: four times what is known of it beforehand.
const MOST_BIAS_PX: f64 = 4.0 * BIAS_SIGMA_PX;
/// Edges that scatter by more than this about the model, px, are not its own; blurred ones scatter by as much more as they are wider than
/// a pixel.
///
/// Derived: half of the 3 px/√3 by which edges at random within the last search scatter.
const MOST_RMS_PX: f64 = 0.87;
/// A camera whose direction is less certain than this, rad (1σ), was not found.
///
/// Convention: a tenth of a radian: up to there a covariance describes a direction, and bent frames refine it.
const MOST_TURN_SIGMA: f64 = 0.1;
/// So long as edges are searched for further away than this, px, the border is not known so well that colours beside it are asked for most.
///
/// Convention: about the width of the border's surroundings that are then asked.
const WELL_PLACED_PX: f64 = 5.0;
/// The bend of a straight snake.
pub const STRAIGHT: Configuration = Configuration { theta: 0.0, delta: 0.0 };

/// The picture of the straight snake, and what is known about it.
#[derive(Clone, Copy)]
pub struct StraightPicture<'a> {
    pub frame: &'a Frame,
    pub lens: &'a Lens,
    pub robot: &'a Robot,
    pub options: &'a RigOptions,
}

/// The edges of one round, their weights' roots, and the fit to them.
struct Round {
    edges: Correspondences,
    roots: Vec<f64>,
    solution: Solution,
}

/// The state of the fit between rounds.
struct BaseFit<'a> {
    picture: StraightPicture<'a>,
    grid: &'a Grid,
    /// Whether the grid is known roughly, and may be tilted as well as the snake.
    is_rough: bool,
    placement: Placement,
    bias: EdgeBias,
    learned: Option<Colours>,
    last: Option<Round>,
}

/// Fits the base from where the snake was found to begin.
///
/// # Errors
///
/// Why the picture does not show the straight snake before this grid.
pub fn fit_base(picture: StraightPicture, start: &SnakeStart, grid: &Grid) -> Result<Rig, RigError> {
    BaseFit::from_start(picture, start, grid, false)?.rig()
}

/// The camera's pose to the base before a grid that is known roughly, whose lines the eye cannot look through yet: how far they scatter the edges
/// is not asked.
///
/// # Errors
///
/// Why the picture does not show the straight snake there.
pub fn place_base(picture: StraightPicture, start: &SnakeStart, grid: &Grid) -> Result<Pose, RigError> {
    let fit = BaseFit::from_start(picture, start, grid, true)?;
    match fit.confirmed() {
        Ok(_) | Err(RigError::EdgesScattered { .. }) => Ok(fit.placement.camera_from_base(picture.options, grid)),
        Err(error) => Err(error),
    }
}

/// What the picture says of a base that it confirms.
struct Confirmed {
    covariance: DMatrix<f64>,
    edge_rms_px: f64,
}

impl<'a> BaseFit<'a> {
    /// The fit after all its rounds, before a grid that is known well or roughly.
    fn from_start(
        picture: StraightPicture<'a>,
        start: &SnakeStart,
        grid: &'a Grid,
        is_rough: bool,
    ) -> Result<Self, RigError> {
        let options = picture.options;
        let placement = Placement::from_picture(picture.lens, options, grid, &start.base, start.axis);
        let behind = || {
            let target_mm = grid.distance_mm(&picture.lens.ray(&start.base));
            RigError::BehindCamera { target_mm, standoff_mm: options.standoff_mm }
        };
        let mut fit = Self {
            picture,
            grid,
            is_rough,
            placement: placement.ok_or_else(behind)?,
            bias: noise_model().unknown_bias(),
            learned: None,
            last: None,
        };
        for (round, search_px) in SEARCHES_PX.into_iter().enumerate() {
            fit.improve(round, search_px)?;
        }
        Ok(fit)
    }

    /// How the camera sees a base at this place.
    fn view(&self, placement: &Placement) -> Projection<'a> {
        let StraightPicture { lens, robot, options, .. } = self.picture;
        Projection { lens, camera_from_base: placement.camera_from_base(options, self.grid), robot }
    }

    /// One round: edges within `search_px` of the outline, and the base and the biases that agree with them best.
    fn improve(&mut self, round: usize, search_px: f64) -> Result<(), RigError> {
        let view = self.view(&self.placement);
        let mut outline = Outline::new(&view, STRAIGHT);
        // The model's own outline tells which pixels are snake, the better the better it lies.
        if round.is_multiple_of(LEARNING_ROUNDS) || self.learned.is_none() {
            let is_well_placed = search_px <= WELL_PLACED_PX;
            let before = self.learned.take();
            let colours = Colours::learn(&self.picture, &view, &outline, is_well_placed, before.as_ref());
            self.learned = match colours {
                Some(colours) if is_well_placed => Some(colours.through(&self.picture, self.grid, &view, &outline)),
                colours => colours,
            };
        }
        let edges = self.edges(&mut outline, search_px)?;
        let is_coarse = search_px > FINE_SEARCH_PX;
        let phase = if is_coarse { RobustPhase::Monotone } else { RobustPhase::Redescending };
        let roots = phase.roots(&edges.residuals(&view, STRAIGHT, self.bias));
        let held = if self.is_rough { seeming_tilt_sigma() } else { TILT_SIGMAS[0] };
        let (bias_sigma_px, tilt_sigma) =
            if is_coarse { (NO_BIAS_PX, held) } else { (BIAS_SIGMA_PX, seeming_tilt_sigma()) };
        let mut options = Options::default();
        if is_coarse {
            options.most_iterations = COARSE_ITERATIONS;
        }
        let solution = self.solve(&edges, &roots, (bias_sigma_px, tilt_sigma), &options)?;
        (self.placement, self.bias) = BaseProblem::at(&solution.parameters);
        self.last = Some(Round { edges, roots, solution });
        Ok(())
    }

    /// The picture's edges near the outline, looked for with the filter that suits the blur of those found before.
    fn edges(&self, outline: &mut Outline, search_px: f64) -> Result<Correspondences, RigError> {
        let finder = self.learned.as_ref().ok_or(RigError::NoContrast)?.finder();
        let filters = match &self.last {
            None => Filters::uniform(finder),
            Some(Round { edges, .. }) if search_px > FINE_SEARCH_PX => Filters::coarse(&finder, edges.blur.clone()),
            Some(Round { edges, .. }) => {
                let fine = Filters::fine(&finder, edges.blur.clone());
                fine.predict(outline);
                fine
            }
        };
        let edges = Correspondences::find(outline, &filters, search_px, |_| true);
        let (found, places) = (edges.len(), edges.searched().len());
        let is_enough = found >= FEWEST_EDGES && found as f64 >= LEAST_SHARE * places as f64;
        if is_enough { Ok(edges) } else { Err(RigError::TooFewEdges { edges: found, places }) }
    }

    /// The placement and the biases that agree best with weighted edges and with what is known beforehand.
    fn solve(
        &self,
        edges: &Correspondences,
        roots: &[f64],
        (bias_sigma_px, tilt_sigma): (f64, f64),
        options: &Options,
    ) -> Result<Solution, RigError> {
        let start = self.placement.0.iter().copied().chain(self.bias.to_array());
        let start = DVector::from_iterator(PLACEMENT + BIASES, start);
        let StraightPicture { lens, robot, options: stated, .. } = self.picture;
        let grid = self.grid;
        let problem = BaseProblem { lens, robot, options: stated, grid, edges, roots, bias_sigma_px, tilt_sigma };
        solve(&problem, start, options).map_err(|_| RigError::Undetermined)
    }

    /// What the last round says, if the picture confirms it.
    fn confirmed(&self) -> Result<Confirmed, RigError> {
        let (Some(Round { edges, roots, solution }), Some(learned)) = (&self.last, &self.learned) else {
            return Err(RigError::Undetermined);
        };
        let robot = self.picture.robot;
        let view = self.view(&self.placement);
        let residuals_px = edges.in_px(&edges.residuals(&view, STRAIGHT, self.bias));
        let (agreeing, edge_rms_px) = inliers(&residuals_px, roots);
        let covariance = covariance(edges, roots, solution, &view, edge_rms_px).ok_or(RigError::Undetermined)?;
        let finder = learned.finder();
        let seen_by = |view: &Projection| PartVisibility::new(&Outline::new(view, STRAIGHT), &finder);
        let visibility = seen_by(&view);
        let are_all_visible = visibility.are_all_faintly_visible(last_part(robot));
        self.check_agreement(edges, agreeing, are_all_visible, edge_rms_px)?;
        let further_up = || {
            let camera_from_base = view.camera_from_base * Pose::translation(0.0, 0.0, robot.disk_pitch_mm());
            seen_by(&Projection { camera_from_base, ..view.clone() })
        };
        check_visibility(&visibility, further_up, robot)?;
        let most_rms_px = MOST_RMS_PX * edges.blur.px.max(1.0);
        if edge_rms_px > most_rms_px {
            return Err(RigError::EdgesScattered { rms_px: edge_rms_px, most_rms_px });
        }
        Ok(Confirmed { covariance, edge_rms_px })
    }

    /// The rig of the last round, if the picture confirms it.
    fn rig(self) -> Result<Rig, RigError> {
        let Confirmed { covariance, edge_rms_px } = self.confirmed()?;
        let learned = self.learned.ok_or(RigError::Undetermined)?;
        let options = self.picture.options;
        let sheet_sigma = (0..3).map(|axis| self.grid.turn_covariance[(axis, axis)]).fold(0.0, f64::max).sqrt();
        if sheet_sigma > MOST_TURN_SIGMA {
            let (sigma_deg, most_deg) = (sheet_sigma.to_degrees(), MOST_TURN_SIGMA.to_degrees());
            let (bow_mm, waves_mm) = (self.grid.sheet.shape.rms_mm(), self.grid.waves_mm);
            return Err(RigError::SheetNotFlat { bow_mm, waves_mm, sigma_deg, most_deg });
        }
        let (placement, covariance) = of_its_own_tilt(&self.placement, covariance);
        let pose_covariance = placement.pose_covariance(&covariance, options, self.grid);
        let turn_sigma = (0..3).map(|axis| pose_covariance[(axis, axis)]).fold(0.0, f64::max).sqrt();
        if turn_sigma > MOST_TURN_SIGMA {
            let (sigma_deg, most_deg) = (turn_sigma.to_degrees(), MOST_TURN_SIGMA.to_degrees());
            return Err(RigError::UncertainDirection { sigma_deg, most_deg });
        }
        Ok(Rig {
            camera_from_base: placement.camera_from_base(options, self.grid),
            pose_covariance,
            camera_from_grid: self.grid.sheet.camera_from_grid,
            sheet_shape: self.grid.sheet.shape,
            grid_pitch_mm: options.grid_pitch_mm,
            pattern: GridPattern::dark(self.grid.kind),
            appearance: learned.appearance,
            print: learned.print,
            edge_bias: self.bias,
            mode_sigma_rad: UNKNOWN_SHAPE_RAD,
            grid_rms_px: self.grid.rms_px,
            edge_rms_px,
        })
    }

    /// Whether enough of the outline agrees with the model, without a bias that no edge has.
    fn check_agreement(
        &self,
        edges: &Correspondences,
        agreeing: usize,
        are_all_visible: bool,
        rms_px: f64,
    ) -> Result<(), RigError> {
        let is_confirmed_throughout =
            are_all_visible && agreeing as f64 >= LEAST_AGREEING_OF_FOUND * edges.len() as f64;
        let agreeing = agreeing as f64 / edges.searched().len().max(1) as f64;
        let [side, tube, rim, ..] = self.bias.to_array();
        let bias_px = [side, tube, rim].into_iter().max_by(|a, b| a.abs().total_cmp(&b.abs())).unwrap_or_default();
        let most_bias_px = MOST_BIAS_PX * edges.blur.px.max(1.0);
        let is_confirmed = agreeing >= LEAST_AGREEING || is_confirmed_throughout;
        if !is_confirmed || bias_px.abs() > most_bias_px {
            let least_agreeing = LEAST_AGREEING;
            return Err(RigError::ModelDisagrees { agreeing, least_agreeing, bias_px, most_bias_px, rms_px });
        }
        Ok(())
    }
}

/// Covariance of placement and biases: cluster-robust, and what errs alike on all pieces added, as many times as the edges scatter more than they may.
fn covariance(
    edges: &Correspondences,
    roots: &[f64],
    solution: &Solution,
    view: &Projection,
    edge_rms_px: f64,
) -> Option<DMatrix<f64>> {
    let (jacobian, residuals, independent) = (&solution.jacobian, &solution.residuals, solution.covariance()?);
    let design_effect = noise_model().design_effect;
    let clustered = clustered_covariance(jacobian, residuals, &independent, edges.clusters(), design_effect)?;
    let systematic = systematic_covariance(edges, jacobian, &independent, view, roots, edge_rms_px);
    let excess = excess(residuals, roots);
    Some((clustered + systematic) * excess)
}

/// The number of the snake's last part: its end disk, or the tool on it.
fn last_part(robot: &Robot) -> u8 {
    robot.body.spacer_disk_count + 1 + u8::from(robot.body.tool.is_some())
}

/// Whether holder, first and end disk, and a tool, are seen where the model says, or at least all parts faintly. The first disk may stand before
/// something that looks like it, if a snake one disk further up is not seen: where the model lies a disk too low, that one is.
fn check_visibility(
    visibility: &PartVisibility,
    further_up: impl FnOnce() -> PartVisibility,
    robot: &Robot,
) -> Result<(), RigError> {
    let last = last_part(robot);
    if visibility.are_all_faintly_visible(last) {
        return Ok(());
    }
    let end = robot.body.spacer_disk_count + 1;
    let tool = robot.body.tool.map(|_| (SnakePart::Tool, end + 1));
    let parts = [(SnakePart::Holder, 0), (SnakePart::EndDisk, end)];
    if let Some((part, _)) = parts.into_iter().chain(tool).find(|&(_, part)| !visibility.is_visible(part)) {
        return Err(RigError::PartNotVisible(part));
    }
    let is_placed = visibility.is_visible(1) || !further_up().is_visible(last);
    is_placed.then_some(()).ok_or(RigError::PartNotVisible(SnakePart::FirstDisk))
}
