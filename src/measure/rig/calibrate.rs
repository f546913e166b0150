//! Where the grid and the snake's base are, seen from one camera: the rig.

use crate::camera::{Frame, Lens};
use crate::geometry::{Configuration, Pose};
use crate::measure::body::{Outline, Projection};
use crate::measure::fit::{
    Correspondences, EdgeBias, EdgeFinder, FINE_SEARCH_PX, PartVisibility, RobustPhase, fine_filter, inliers,
    predict_blur, systematic_covariance,
};
use crate::measure::image::appearance::Appearance;
use crate::measure::image::plane::Plane;
use crate::measure::rig::drift::{Print, PrintWatch};
use crate::measure::rig::locate::{Colours, Holder, SnakeStart, find_start, locate_holders};
use crate::measure::rig::refusal::{Refusal, Step};
use crate::measure::rig::scale::contradiction;
use crate::measure::target::grid::{Grid, Pattern, find_grid};
use crate::robot::Robot;
use crate::statistics::cluster::clustered_covariance;
use crate::statistics::least_squares::{self, Solution, minimise};
use nalgebra::{
    DMatrix, DVector, Matrix3, Matrix6, Point2, Point3, Rotation3, Translation3, UnitQuaternion, Vector2, Vector3,
};

/// A calibrated view: everything that does not change from frame to frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Rig {
    /// The camera's pose to the snake's base.
    pub camera_from_base: Pose,
    /// Covariance of that pose: a small turn about the base's origin (rad) and a shift (mm), both along the camera's axes.
    pub pose_covariance: Matrix6<f64>,
    /// The camera's pose to the grid.
    pub camera_from_grid: Pose,
    /// Pitch of the grid's lines, mm.
    pub grid_pitch_mm: f64,
    /// What is printed there.
    pub print: Print,
    /// What tells snake from paper.
    pub appearance: Appearance,
    /// How far outside the snake's true border its edges are seen.
    pub edge_bias: EdgeBias,
    /// Scatter of the grid about its pose, px.
    pub grid_rms_px: f64,
    /// Scatter of the straight snake's edges about the model, px.
    pub edge_rms_px: f64,
}

impl Rig {
    /// The rig of a view that looks from elsewhere: `self` was calibrated as if image right were the base's x,
    /// `delta_offset` (rad) is the azimuth in {b} that it is.
    #[must_use]
    pub fn looking_from(mut self, delta_offset: f64) -> Self {
        self.camera_from_base.rotation *= azimuth(delta_offset);
        self
    }
}

impl Rig {
    /// Distance from the snake's base back to the paper, mm.
    pub(crate) fn standoff_mm(&self) -> f64 {
        let normal = self.camera_from_grid * Vector3::z();
        normal.dot(&(self.camera_from_grid.translation.vector - self.camera_from_base.translation.vector))
    }
}

/// The base's axes in those of a view whose image right is at this azimuth of the base, rad.
fn azimuth(delta_offset: f64) -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -delta_offset)
}

/// What is known about a rig before it is calibrated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RigOptions {
    /// Pitch of the grid's finest lines (or side of a checkerboard's squares), mm.
    pub grid_pitch_mm: f64,
    /// Distance from the snake's axis back to the grid plane, mm.
    pub standoff_mm: f64,
    /// Azimuth in {b} of the direction that points to this view's image right, rad.
    pub delta_offset: f64,
}

/// How far the standoff may be from what was said, mm (1σ): a ruler's precision.
const STANDOFF_SIGMA_MM: f64 = 0.1;
/// How far the snake may be from parallel to the grid, rad (1σ).
const TILT_SIGMA: f64 = 0.1 * std::f64::consts::PI / 180.0;

/// A snake further from where the standoff puts it than this many times that precision contradicts what was said.
const FAR_OFF_SIGMAS: f64 = 15.0;
/// Share of the straight snake's outline that must be confirmed by edges.
const ENOUGH_INLIERS: f64 = 0.5;
/// How far outside the snake's border its edges may be seen, px (1σ), and what stands for none at all.
const STRAIGHT_BIAS_SIGMA_PX: f64 = 0.3;
const NO_BIAS_PX: f64 = 1e-3;
/// A camera whose direction is less certain than this, rad (1σ), was not found: a grid in good view tells it to 0.02° to 0.3°.
const MOST_TURN_SIGMA: f64 = 1.0 * std::f64::consts::PI / 180.0;
/// What tells snake from paper is asked for most where edges are placed, so near the border, px: a JPEG and many a camera
/// keep less of the colours than of the brightness, and what looks the most unlike far from it has the worst edges. Pixels that an
/// edge mixes of both sides lie between the two and change nothing.
const BORDER_PX: f64 = 2.0;
const BORDER_WEIGHT: f64 = 20.0;
/// So long as edges are searched for further away than this, px, the border is not known so well.
const WELL_PLACED_PX: f64 = 5.0;
/// An edge bias beyond this, px, is no edge's but a wrong model's; soft edges are displaced by as much more as they are wider than
/// a pixel.
const MOST_BIAS_PX: f64 = 0.8;

/// Calibrates a rig from a picture of the unbent snake before the grid.
///
/// 1. The snake is the large, long object that is unlike the paper; its width tells the scale. Where there are several,
///    each is tried in turn.
/// 2. The grid near the pitch that this scale predicts gives the camera's pose to the paper.
/// 3. The snake lies parallel to the paper, `standoff_mm` before it; its edges give the base's place and direction, and
///    refine standoff and parallelism within what a ruler can do.
///
/// # Errors
///
/// A sentence that says which step failed and what to do.
pub fn calibrate_rig(frame: &Frame, lens: &Lens, robot: &Robot, options: &RigOptions) -> Result<Rig, String> {
    if (frame.width, frame.height) != (lens.width, lens.height) {
        return Err(format!(
            "the picture is {}×{} px but the camera file says {}×{}; use the camera file of this camera and resolution",
            frame.width, frame.height, lens.width, lens.height
        ));
    }
    let looks = Colours::of(frame);
    let (mut holders, mut refused) = (Vec::new(), None);
    for colours in &looks {
        match locate_holders(frame, colours) {
            Ok(found) => holders.extend(found.into_iter().map(|holder| (colours, holder))),
            Err(message) => refused = Some(Refusal::at(Step::Holder)(message).telling(refused)),
        }
    }
    for (colours, holder) in &holders {
        match calibrate_from(frame, colours, lens, robot, options, holder) {
            Ok(rig) => return Ok(rig),
            Err(refusal) => refused = Some(refusal.telling(refused)),
        }
    }
    // With another pitch it may be plain what is wrong.
    for factor in [0.5, 2.0] {
        if refused.as_ref().is_some_and(|refusal| refusal.step == Step::Scale) {
            break;
        }
        let other = RigOptions { grid_pitch_mm: factor * options.grid_pitch_mm, ..*options };
        let rig = holders
            .iter()
            .find_map(|(colours, holder)| calibrate_from(frame, colours, lens, robot, &other, holder).ok());
        refused = rig.map(|rig| contradiction(robot, options, &rig)).or(refused);
    }
    Err(refused.map_or_else(|| "no holder was found".into(), |refusal| refusal.message))
}

/// Calibrates the rig if this is the holder.
fn calibrate_from(
    frame: &Frame,
    colours: &Colours,
    lens: &Lens,
    robot: &Robot,
    options: &RigOptions,
    holder: &Holder,
) -> Result<Rig, Refusal> {
    let diameter_mm = robot.body.disk_diameter_mm;
    let pitch_px = |width_px: f64| {
        let distance_mm = lens.focal_px.x * diameter_mm / width_px;
        lens.focal_px.x * options.grid_pitch_mm / (distance_mm + options.standoff_mm)
    };
    let across = Vector2::new(-holder.axis.y, holder.axis.x);
    let corridor = |p: &Point2<f64>| across.dot(&(p - holder.root)).abs() < 1.1 * holder.width_px;
    // What was seen of the holder may be only its dark side, and thin lines have an overtone of twice their number; or
    // a shadow was seen with it.
    let mut refused = None;
    let mut tried: Vec<f64> = Vec::new();
    for (narrowest, widest) in [(0.85, 2.2), (1.25, 2.2), (0.45, 0.85)] {
        let range = pitch_px(narrowest * holder.width_px)..=pitch_px(widest * holder.width_px);
        let grid = find_grid(frame, lens, options.grid_pitch_mm, range, holder.axis, corridor);
        let rig = grid.map_err(Refusal::at(Step::Grid)).and_then(|grid| {
            let distance_mm = grid.distance_mm(&lens.ray(&holder.root));
            if tried.iter().any(|other| (distance_mm / other - 1.0).abs() < 0.05) {
                return Err(Refusal::at(Step::Grid)("this grid was tried".into()));
            }
            tried.push(distance_mm);
            calibrate_on(frame, colours, lens, robot, options, holder, &grid)
        });
        match rig {
            Ok(rig) => return Ok(rig),
            Err(refusal) => refused = Some(refusal.telling(refused)),
        }
    }
    Err(refused.unwrap_or_else(|| Refusal::at(Step::Grid)("no grid was found".into())))
}

/// Calibrates the rig if these are the holder and the grid.
fn calibrate_on(
    frame: &Frame,
    colours: &Colours,
    lens: &Lens,
    robot: &Robot,
    options: &RigOptions,
    holder: &Holder,
    grid: &Grid,
) -> Result<Rig, Refusal> {
    // The snake is nearer than the grid by the standoff; where it is cut by the border its holder is this wide.
    let distance_mm = grid.distance_mm(&lens.ray(&holder.root)) - options.standoff_mm;
    if distance_mm <= 0.0 {
        let message = "the standoff puts the snake behind the camera; check standoff_mm and grid_pitch_mm";
        return Err(Refusal::at(Step::Grid)(message.into()));
    }
    let width_px = lens.focal_px.x * robot.body.disk_diameter_mm / distance_mm;
    let start = find_start(colours, holder, width_px).map_err(Refusal::at(Step::Start))?;
    // Disks look alike: where the first start ends in a snake that is not all there, it may be a disk or two off, or between them.
    let pitch_px = lens.focal_px.x * robot.disk_pitch_mm() / distance_mm;
    let moved = |disks: f64| SnakeStart { base: start.base + start.axis * (disks * pitch_px), axis: start.axis };
    let fitted = |start: &SnakeStart| {
        let rig = fit_base(frame, lens, robot, options, start, grid).map_err(Refusal::at(Step::Snake))?;
        if (rig.standoff_mm() - options.standoff_mm).abs() > FAR_OFF_SIGMAS * STANDOFF_SIGMA_MM {
            return Err(contradiction(robot, options, &rig));
        }
        Ok(Rig { print: print_of(frame, lens, grid, robot, options)?, ..rig })
    };
    fitted(&start).or_else(|refusal| {
        let others = [-1.0, 1.0, -0.5, 0.5, -1.5, 1.5, -2.0, 2.0];
        others.into_iter().find_map(|disks| fitted(&moved(disks)).ok()).ok_or(refusal)
    })
}

/// The base's place on the paper: x, y (mm, grid frame), turn γ, height above the standoff (mm), tilt out of the plane.
struct Placement(DVector<f64>);

impl Placement {
    /// The base's axes in the grid frame when nothing is turned: x right, y away, z up (the grid's −y).
    fn upright() -> Rotation3<f64> {
        Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[Vector3::x(), Vector3::z(), -Vector3::y()]))
    }

    fn grid_from_base(&self, options: &RigOptions) -> Pose {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.0[2]);
        let tilt = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), self.0[4]);
        let upright = UnitQuaternion::from_rotation_matrix(&Self::upright());
        let place = Translation3::new(self.0[0], self.0[1], self.0[3] - options.standoff_mm);
        Pose::from_parts(place, turn * upright * tilt * azimuth(options.delta_offset))
    }
}

fn fit_base(
    frame: &Frame,
    lens: &Lens,
    robot: &Robot,
    options: &RigOptions,
    snake: &SnakeStart,
    grid: &Grid,
) -> Result<Rig, String> {
    let mut placement = starting_placement(lens, options, snake, grid)?;
    let straight = Configuration::new(0.0, 0.0);
    let mut learned: Option<(Appearance, Plane)> = None;
    let mut edge_bias = EdgeBias::default();
    let mut outcome: Option<(Correspondences, Vec<f64>, Solution)> = None;
    for (round, search_px) in [14.0, 12.0, 10.0, 8.0, 7.0, 6.0, 5.0, 4.0, 3.0, 3.0, 3.0].into_iter().enumerate() {
        let pose = |p: &Placement| grid.camera_from_grid * p.grid_from_base(options);
        let view = Projection { lens, camera_from_base: pose(&placement), robot };
        let mut outline = Outline::new(&view, straight);
        // The model's own outline tells which pixels are snake, the better the better it lies.
        if round % 3 == 0 || learned.is_none() {
            let appearance = appearance_of(frame, &outline, search_px <= WELL_PLACED_PX);
            learned = appearance.map(|appearance| {
                let plane = appearance.plane(frame);
                (appearance, plane)
            });
        }
        let (appearance, plane) = learned.as_ref().ok_or("the snake does not stand out from the paper")?;
        let mut finder = EdgeFinder::new(plane, appearance.two_sided);
        if let Some((matches, ..)) = &outcome {
            let blur_px = matches.blur_px;
            if search_px > FINE_SEARCH_PX {
                finder = finder.coarse_for_blur(blur_px);
            } else {
                finder = fine_filter(&finder, &view, blur_px);
                predict_blur(&mut outline, blur_px, &finder);
            }
        }
        let matches = Correspondences::find(&outline, &finder, search_px, |_| true);
        if matches.len() < 40 || matches.len() * 3 < matches.searched().len() {
            return Err(format!(
                "only {} of {} places on the straight snake's outline show an edge; is the snake unbent, in focus, unlike the \
                 paper in colour and of the robot's dimensions?",
                matches.len(),
                matches.searched().len()
            ));
        }
        let phase = if search_px > FINE_SEARCH_PX { RobustPhase::Monotone } else { RobustPhase::Redescending };
        let roots = phase.roots(&matches.residuals(&view, straight, edge_bias));
        // While the model is off, a bias would take the blame and carry scale and tilt away.
        let bias_sigma_px = if search_px > FINE_SEARCH_PX { NO_BIAS_PX } else { STRAIGHT_BIAS_SIGMA_PX };
        let weighted = |x: &DVector<f64>| {
            let moved = Projection { camera_from_base: pose(&Placement(x.rows(0, 5).into_owned())), ..view.clone() };
            let edges = matches.residuals(&moved, straight, EdgeBias::default().moved(&x.as_slice()[5..]));
            let edges = edges.iter().zip(&roots).map(|(r, w)| r * w);
            let priors = [x[3] / STANDOFF_SIGMA_MM, x[4] / TILT_SIGMA].into_iter();
            let all: Vec<f64> = edges.chain(priors).chain(x.iter().skip(5).map(|bias| bias / bias_sigma_px)).collect();
            DVector::from_vec(all)
        };
        let start = edge_bias.to_array().into_iter().fold(placement.0.clone(), |x, bias| x.push(bias));
        let steps = DVector::from_column_slice(&[1e-4, 1e-4, 1e-5, 1e-4, 1e-5, 1e-3, 1e-3, 1e-3]);
        let solution = minimise(weighted, start, &steps, &least_squares::Options::default())
            .map_err(|_| "the fit of the snake's base did not converge")?;
        placement = Placement(solution.parameters.rows(0, 5).into_owned());
        edge_bias = EdgeBias::default().moved(&solution.parameters.as_slice()[5..]);
        outcome = Some((matches, roots, solution));
    }
    let (matches, roots, solution) = outcome.ok_or("no edges were looked for")?;

    let camera_from_base = grid.camera_from_grid * placement.grid_from_base(options);
    let view = Projection { lens, camera_from_base, robot };
    let (agreeing, edge_rms_px) = inliers(&matches.in_px(&matches.residuals(&view, straight, edge_bias)), &roots);
    let covariance = clustered_covariance(&solution.jacobian, &solution.residuals, matches.clusters())
        .zip(solution.covariance())
        .map(|(clustered, independent)| {
            let light = systematic_covariance(&matches, &solution.jacobian, &independent, &view, &roots, edge_rms_px);
            clustered + light
        })
        .ok_or("the snake's edges do not determine where its base is")?;
    let share = agreeing as f64 / matches.searched().len().max(1) as f64;
    let bias_px = edge_bias.to_array().into_iter().max_by(|a, b| a.abs().total_cmp(&b.abs())).unwrap_or_default();
    if share < ENOUGH_INLIERS || bias_px.abs() > MOST_BIAS_PX * matches.blur_px.max(1.0) {
        return Err(format!(
            "only {:.0} % of the straight snake's outline agrees with the model (edges lie {bias_px:.2} px outside it); \
             is the snake unbent, in focus, unlike the paper in colour and of the robot's dimensions?",
            100.0 * share
        ));
    }
    let (appearance, plane) = learned.ok_or("no appearance was learned")?;
    let finder = EdgeFinder::new(&plane, appearance.two_sided);
    let visibility = PartVisibility::new(&Outline::new(&view, straight), &finder);
    let end = robot.body.spacer_disk_count + 1;
    let ends = [("the holder", 0), ("the first disk", 1), ("the end disk", end)];
    if let Some((part, _)) = ends.into_iter().find(|&(_, part)| !visibility.is_visible(part))
        && !visibility.are_all_faintly_visible(end)
    {
        return Err(format!("{part} is not where the model says; is the snake unbent, and all of it in the picture?"));
    }
    let pose_covariance = nudge_covariance(&placement, &covariance, options, grid);
    let turn_sigma = (0..3).map(|axis| pose_covariance[(axis, axis)]).fold(0.0, f64::max).sqrt();
    if turn_sigma > MOST_TURN_SIGMA {
        return Err(format!(
            "snake and grid tell the camera's direction no better than to {:.1}° (1σ); is grid_pitch_mm that of its finest \
             lines, and enough of the grid in the picture?",
            turn_sigma.to_degrees()
        ));
    }
    Ok(Rig {
        camera_from_base,
        pose_covariance,
        camera_from_grid: grid.camera_from_grid,
        grid_pitch_mm: options.grid_pitch_mm,
        print: Print { pattern: grid.pattern, ..Print::default() },
        appearance,
        edge_bias,
        grid_rms_px: grid.rms_px,
        edge_rms_px,
    })
}

/// What is printed on the paper, and the colours in which it shows.
///
/// # Errors
///
/// A sentence, if the lines are not as far apart as was said: every other one is missing, or there are as many between them.
/// The scale is right all the same, since the snake's size says which overtone of the print was found; but not what was said.
fn print_of(frame: &Frame, lens: &Lens, grid: &Grid, robot: &Robot, options: &RigOptions) -> Result<Print, Refusal> {
    let print = Print { pattern: grid.pattern, ..Print::default() };
    let of = |pitch_mm: f64, print: &Print| {
        PrintWatch::new(lens, &grid.camera_from_grid, options.standoff_mm, pitch_mm, print)
    };
    let said_mm = options.grid_pitch_mm;
    let Some(watch) = of(said_mm, &print) else { return Ok(print) };
    let print = Print { weights: watch.weights_in(frame), ..print };
    let strength = |pitch_mm: f64| of(pitch_mm, &print).map_or(0.0, |watch| watch.strength(frame));
    let as_said = strength(said_mm);
    // Narrow lines' overtones are about as strong as their wave, and heavier lines among them add little to longer ones.
    const LONGER: f64 = 0.8;
    const SHORTER: f64 = 1.8;
    for (pitch_mm, ratio) in [(2.0 * said_mm, LONGER), (said_mm / 2.0, SHORTER)] {
        if grid.pattern == Pattern::Lines && strength(pitch_mm) > ratio * as_said {
            return Err(Refusal::at(Step::Scale)(format!(
                "the scale contradicts the snake's size: grid_pitch_mm = {said_mm}, but beside a snake {} mm thick the \
                 paper's lines are {pitch_mm:.2} mm apart. Measure the paper, and correct grid_pitch_mm",
                robot.body.disk_diameter_mm
            )));
        }
    }
    Ok(print)
}

/// The snake's base and direction, carried onto the plane in which it lies.
fn starting_placement(lens: &Lens, options: &RigOptions, snake: &SnakeStart, grid: &Grid) -> Result<Placement, String> {
    let grid_from_camera = grid.camera_from_grid.inverse();
    let eye = grid_from_camera * Point3::origin();
    let on_plane = |pixel: &Point2<f64>| -> Option<Point3<f64>> {
        let ray = grid_from_camera * lens.ray(pixel);
        let distance = (-options.standoff_mm - eye.z) / ray.z;
        (distance > 0.0).then(|| eye + ray * distance)
    };
    const AHEAD_PX: f64 = 300.0;
    let ahead = snake.base + snake.axis * AHEAD_PX;
    let (base, tip) =
        on_plane(&snake.base).zip(on_plane(&ahead)).ok_or("the standoff puts the snake behind the camera")?;
    let up = (tip - base).xy().normalize();
    // At γ = 0 the snake points along the grid's −y.
    let gamma = up.x.atan2(-up.y);
    Ok(Placement(DVector::from_column_slice(&[base.x, base.y, gamma, 0.0, 0.0])))
}

/// What tells snake from paper, learned from inside and outside of the outline: of one that is well placed, at its border above all.
fn appearance_of(frame: &Frame, outline: &Outline, is_well_placed: bool) -> Option<Appearance> {
    let (x0, y0, x1, y1) = outline.bounds();
    let margin = x1 - x0;
    let soft = is_well_placed.then(|| outline.blurred_silhouette(BORDER_PX));
    let is_at_border =
        |pixel: &Point2<f64>| soft.as_ref().is_some_and(|soft| (0.05..0.95).contains(&soft.sample(pixel)));
    Appearance::learn(frame, |x, y| {
        let pixel = Point2::new(f64::from(x), f64::from(y));
        let near = pixel.x > x0 - margin && pixel.x < x1 + margin && pixel.y > y0 - margin && pixel.y < y1 + margin;
        near.then(|| (outline.covers(&pixel), if is_at_border(&pixel) { BORDER_WEIGHT } else { 1.0 }))
    })
}

/// Covariance of placement and bias, as one of the camera's pose in the terms of [`Rig::pose_covariance`].
fn nudge_covariance(
    placement: &Placement,
    covariance: &DMatrix<f64>,
    options: &RigOptions,
    grid: &Grid,
) -> Matrix6<f64> {
    let pose = |x: &DVector<f64>| grid.camera_from_grid * Placement(x.clone()).grid_from_base(options);
    let centre = pose(&placement.0);
    let mut jacobian = DMatrix::zeros(6, 5);
    for k in 0..5 {
        const STEP: f64 = 1e-5;
        let mut moved = placement.0.clone();
        moved[k] += STEP;
        let moved = pose(&moved);
        let turn = (moved.rotation * centre.rotation.inverse()).scaled_axis() / STEP;
        let shift = (moved.translation.vector - centre.translation.vector) / STEP;
        jacobian.set_column(k, &DVector::from_iterator(6, turn.iter().chain(shift.iter()).copied()));
    }
    let placed = covariance.view((0, 0), (5, 5));
    let nudges = &jacobian * placed * jacobian.transpose();
    // The base is turned about its own axis as the grid is; the grid's own error adds to that of the placement on it.
    let from_grid = |r: usize, c: usize| if r == c && r < 3 { grid.rotation_variance[r] } else { 0.0 };
    Matrix6::from_fn(|r, c| nudges[(r, c)] + from_grid(r, c))
}
