//! Fits the snake's bend to the edges of one picture.

use super::edges::{Edge, EdgeFinder, filter_px};
use super::outline::{BodyPoint, Outline, OutlinePoint, Piece, Projection, Softened};
use super::plane::median;
use super::proof::Proof;
use super::shape::{Departure, departure};
use super::solve::covariance;
use crate::geometry::{Configuration, Pose};
use nalgebra::{DMatrix, DVector, Matrix2, Matrix2x6, Point2, Point3, SMatrix, SVector, Vector2, Vector3};
use std::collections::BTreeMap;

/// How far outside the snake's true border its edges are seen, px.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct EdgeBias {
    /// At the sides of holder and disks, where a surface turns away from the camera: its shading bends over there, and what it
    /// mirrors is foreshortened.
    pub side_px: f64,
    /// At the tubes' sides, where it does so within the few pixels that place an edge.
    pub tube_px: f64,
    /// At the sharp rims of the disks.
    pub rim_px: f64,
}

/// How many biases there are.
pub(super) const BIASES: usize = 3;

impl EdgeBias {
    /// Which of them a piece has.
    fn kind(piece: Piece) -> usize {
        match piece {
            Piece::HolderSide(_) | Piece::DiskSide(..) => 0,
            Piece::Tube(..) => 1,
            Piece::BaseRim | Piece::Rim(..) => 2,
        }
    }

    pub(super) fn of(self, piece: Piece) -> f64 {
        self.to_array()[Self::kind(piece)]
    }

    pub(super) fn to_array(self) -> [f64; BIASES] {
        [self.side_px, self.tube_px, self.rim_px]
    }

    pub(super) fn moved(self, by: &[f64]) -> Self {
        Self { side_px: self.side_px + by[0], tube_px: self.tube_px + by[1], rim_px: self.rim_px + by[2] }
    }
}

/// A border point of the model and the edge that was found near it.
#[derive(Debug, Clone, Copy)]
struct Match {
    body: BodyPoint,
    piece: Piece,
    /// See [`OutlinePoint::lateral`].
    lateral: f64,
    /// Where the edge is, px.
    seen: Point2<f64>,
    /// Outward normal of the border.
    normal: Vector2<f64>,
    /// Standard deviation of the edge's place, px.
    sigma_px: f64,
    blur_px: f64,
}

/// The edges that were matched with a model's outline, and how well they agree with any other state of the model.
#[derive(Debug, Clone)]
pub(super) struct Matches {
    matches: Vec<Match>,
    /// The sections (arc lengths) on which the points lie, and which of them each point is on: many share one, and a
    /// section's frame is what costs most.
    sections_mm: Vec<f64>,
    section_of: Vec<usize>,
    /// Places of the outline that were looked at, and the edge that was found near each.
    asked: Vec<(Piece, Option<Edge>)>,
}

/// What light does to all rims alike and to all sides alike, px (1σ): see [`Matches::light_patterns`]. In renders of random rigs
/// the sides of disks and holder are seen further right or left by 0.011 px (median) to 0.04 px (one rig in ten).
const LIGHT_ON_RIMS_PX: f64 = 0.010;
const LIGHT_ON_SIDES_PX: f64 = 0.023;
/// The scatter of edges, px, for which that is true: the median over these rigs.
const TYPICAL_SCATTER_PX: f64 = 0.14;
/// The softest edges, px, for which it is.
const SHARP_PX: f64 = 1.5;
/// The softest that an edge may look, px: twice what is called blurred. What is flat looks as soft as one likes.
const SOFTEST_PX: f64 = 10.0;
/// Edges come in runs of about as many that err alike; what is known beforehand weighs against one of a run.
const ALIKE: f64 = 10.0;
/// The furthest that softness may displace an edge of the model, px, if the picture is sharp.
const ROUNDED_PX: f64 = 1.0;
/// Systematic error of a single edge's place, px: what shading and print do to it however clean it looks.
const EDGE_FLOOR_PX: f64 = 0.08;
/// The same at a tube, whose shading changes within the pixels that place an edge. In renders of random rigs edges of tubes lie
/// up to 0.5 px outside, by a different amount on each side, those of disks at most 0.1 px.
const TUBE_FLOOR_PX: f64 = 0.3;

/// How much further shading displaces edges this soft than sharp ones: a slope of the brightness beside an edge draws it in
/// proportion to blur² + filter².
fn softness(blur_px: f64) -> f64 {
    let drawn = |blur_px: f64| blur_px.powi(2) + filter_px(blur_px).powi(2);
    (drawn(blur_px) / drawn(SHARP_PX)).max(1.0)
}

/// Whether a border point's surroundings are what the edge filter assumes, with no other part close to it.
fn is_clear(point: &OutlinePoint) -> bool {
    const CLEAR_PX: f64 = 4.0;
    point.gap_px >= CLEAR_PX && point.depth_px >= CLEAR_PX
}

/// A snake whose disks are narrower, px, is small: its parts are hardly wider than what places an edge.
const SMALL_PX: f64 = 40.0;

/// The finder for edges this soft of an outline that lies well. A small snake has so few of them that noise does more harm than
/// shading: there it is never finer.
pub(super) fn settled<'a>(finder: &EdgeFinder<'a>, view: &Projection, blur_px: f64) -> EdgeFinder<'a> {
    if view.diameter_px() < SMALL_PX { finder.as_wide_as(blur_px) } else { finder.as_fine_as(blur_px) }
}

/// Looks at an outline's own silhouette as at a picture, with the same filter and as soft as a blur of σ = `blur_px` makes it:
/// corners and bends of the border, which a soft picture rounds off, are then rounded in both, and a part that is hardly wider
/// than the blur looks as much sharper in both.
pub(super) fn soften(outline: &mut Outline, blur_px: f64, finder: &EdgeFinder) {
    /// An edge that looks sharper than by this factor is hardly one.
    const LEAST: f64 = 0.3;
    let silhouette = outline.seen_through(blur_px);
    let finder = finder.for_model(&silhouette);
    let search_px = ROUNDED_PX * (blur_px / SHARP_PX).max(1.0);
    for point in outline.points.iter_mut().filter(|point| is_clear(point)) {
        point.softened = finder
            .find(point, search_px)
            .map(|edge| Softened { outside_px: edge.offset_px, looks_as_soft: (edge.blur_px / blur_px).max(LEAST) });
    }
}

impl Matches {
    /// Finds the edges within `search_px` of the model's outline, which may be [`soften`]ed.
    pub fn find(outline: &Outline, finder: &EdgeFinder, search_px: f64, is_wanted: impl Fn(Piece) -> bool) -> Self {
        let mut found = Self {
            matches: Vec::with_capacity(outline.points.len()),
            sections_mm: Vec::new(),
            section_of: Vec::with_capacity(outline.points.len()),
            asked: Vec::with_capacity(outline.points.len()),
        };
        for point in outline.points.iter().filter(|p| is_clear(p) && is_wanted(p.piece)) {
            let edge = finder.find(point, search_px);
            found.asked.push((point.piece, edge));
            let (Some(edge), Some(softened)) = (edge, point.softened) else { continue };
            let floor_px = if matches!(point.piece, Piece::Tube(..)) { TUBE_FLOOR_PX } else { EDGE_FLOOR_PX };
            // Points come section by section.
            if found.sections_mm.last() != Some(&point.body.s_mm) {
                found.sections_mm.push(point.body.s_mm);
            }
            found.section_of.push(found.sections_mm.len() - 1);
            found.matches.push(Match {
                body: point.body,
                piece: point.piece,
                lateral: point.lateral,
                seen: point.pixel + point.normal.into_inner() * (edge.offset_px - softened.outside_px),
                normal: point.normal.into_inner(),
                sigma_px: edge.sigma_px.hypot(floor_px),
                blur_px: (edge.blur_px / softened.looks_as_soft).min(SOFTEST_PX),
            });
        }
        found
    }

    pub fn len(&self) -> usize {
        self.matches.len()
    }

    /// How many places of the outline were looked at.
    pub fn places(&self) -> usize {
        self.asked.len()
    }

    /// How far outside its place, which is the model's border and its bias, each edge lies, px.
    pub fn misfits_px(&self, view: &Projection, psi: Configuration, bias: EdgeBias) -> Vec<f64> {
        self.misfits_along(view, |s_mm| view.robot.frame_at(psi, s_mm), bias)
    }

    /// The same for a snake whose sections have these frames by their arc length, mm.
    fn misfits_along(&self, view: &Projection, frame_at: impl Fn(f64) -> Pose, bias: EdgeBias) -> Vec<f64> {
        let frames: Vec<Pose> = self.sections_mm.iter().map(|&s| view.camera_from_base * frame_at(s)).collect();
        let points = self.matches.iter().zip(&self.section_of);
        points
            .map(|(m, &section)| {
                let expected = view.lens.project(&(frames[section] * Point3::from(m.body.local)));
                m.normal.dot(&(m.seen - expected)) - bias.of(m.piece)
            })
            .collect()
    }

    /// The misfits in units of σ.
    pub fn residuals(&self, view: &Projection, psi: Configuration, bias: EdgeBias) -> Vec<f64> {
        self.residuals_along(view, |s_mm| view.robot.frame_at(psi, s_mm), bias)
    }

    /// The same for a snake whose sections have these frames by their arc length, mm.
    pub fn residuals_along(&self, view: &Projection, frame_at: impl Fn(f64) -> Pose, bias: EdgeBias) -> Vec<f64> {
        let misfits = self.misfits_along(view, frame_at, bias);
        misfits.iter().zip(&self.matches).map(|(d, m)| d / m.sigma_px).collect()
    }

    /// The piece of the body of every edge.
    pub fn pieces(&self) -> Vec<Piece> {
        self.matches.iter().map(|m| m.piece).collect()
    }

    /// Median blur of the edges, px.
    pub fn blur_px(&self) -> f64 {
        f64::from(median(&mut self.matches.iter().map(|m| m.blur_px as f32).collect::<Vec<_>>()))
    }

    /// Errors, in units of σ and weighted, that light and softness make on all disks alike, so that no number of them
    /// averages them away: all rims shifted along the snake, the same at their ends only, all ends rounded off, disks
    /// that look thicker towards one end of the snake, and all sides shifted to the right or down in the picture. What
    /// displaces edges one by one displaces them together, too: the more they scatter, px, the more so.
    pub fn light_patterns(&self, view: &Projection, roots: &[f64], scatter_px: f64) -> Vec<DVector<f64>> {
        let more = softness(self.blur_px())
            * (SMALL_PX / view.diameter_px()).max(1.0).powi(2)
            * (scatter_px / TYPICAL_SCATTER_PX);
        let of_edge = |m: &Match| {
            let along = 2.0 * m.body.s_mm / view.robot.length_mm - 1.0;
            let end = m.lateral.powi(2);
            let of_rim = |face: f64| [face, face * end, end, along, 0.0, 0.0].map(|share| LIGHT_ON_RIMS_PX * share);
            match m.piece {
                Piece::Rim(_, far) => of_rim(if far { 1.0 } else { -1.0 }),
                Piece::BaseRim => of_rim(1.0),
                Piece::HolderSide(_) | Piece::DiskSide(..) | Piece::Tube(..) => {
                    [0.0, 0.0, 0.0, 0.0, m.normal.x, m.normal.y].map(|share| LIGHT_ON_SIDES_PX * share)
                }
            }
        };
        let edges: Vec<[f64; 6]> = self.matches.iter().map(of_edge).collect();
        let weight = |(m, root): (&Match, &f64)| root * more / m.sigma_px;
        let weights: Vec<f64> = self.matches.iter().zip(roots).map(weight).collect();
        let pattern = |k: usize| DVector::from_fn(self.len(), |edge, _| weights[edge] * edges[edge][k]);
        (0..6).map(pattern).collect()
    }

    /// The residuals at a state and what they do nearby.
    pub fn linearised(&self, view: &Projection, state: &State) -> Linearised {
        let psi = state.psi();
        // In the camera's axes, and what a rad of either component of the bend does there: shift (mm) and turn (rad).
        type Section = (Pose, [(Vector3<f64>, Vector3<f64>); 2]);
        let sections: Vec<Section> = self
            .sections_mm
            .iter()
            .map(|&s_mm| {
                let twist = view.robot.section_jacobian_bend(state.bend, s_mm);
                let seen = |row: usize, axis: usize| {
                    view.camera_from_base.rotation * twist.fixed_view::<3, 1>(row, axis).into_owned()
                };
                let by_bend = [0, 1].map(|axis| (seen(0, axis), seen(3, axis)));
                (view.camera_from_base * view.robot.frame_at(psi, s_mm), by_bend)
            })
            .collect();
        let mut linear = Linearised {
            residuals: DVector::zeros(self.len()),
            by_state: DMatrix::zeros(self.len(), STATE),
            by_pose: DMatrix::zeros(self.len(), 6),
        };
        for (row, (m, &section)) in self.matches.iter().zip(&self.section_of).enumerate() {
            let (frame, by_bend) = &sections[section];
            let arm = frame.rotation * m.body.local;
            let place = Point3::from(frame.translation.vector + arm);
            // How the place moves along the normal, in units of σ, for every mm that the point does.
            let across = view.lens.project_jacobian(&place).transpose() * m.normal / m.sigma_px;
            let distance_px = m.normal.dot(&(m.seen - view.lens.project(&place)));
            linear.residuals[row] = (distance_px - state.bias.of(m.piece)) / m.sigma_px;
            for (axis, (shift, turn)) in by_bend.iter().enumerate() {
                linear.by_state[(row, axis)] = -across.dot(&(shift + turn.cross(&arm)));
            }
            linear.by_state[(row, 2 + EdgeBias::kind(m.piece))] = -1.0 / m.sigma_px;
            let turned = (place.coords - view.camera_from_base.translation.vector).cross(&across);
            for axis in 0..3 {
                linear.by_pose[(row, axis)] = -turned[axis];
                linear.by_pose[(row, axis + 3)] = -across[axis];
            }
        }
        linear
    }
}

/// Residuals of matched edges, in units of σ, and how they follow what may be fitted (rows: edges).
#[derive(Debug, Clone)]
pub(super) struct Linearised {
    pub residuals: DVector<f64>,
    /// By bend vector (rad) and edge biases (px): the components of [`State`].
    pub by_state: DMatrix<f64>,
    /// By the camera's pose (see [`nudged`](super::grid::nudged)).
    pub by_pose: DMatrix<f64>,
}

impl Linearised {
    /// The step of the state after which the edges agree best, as far as they follow it as they do nearby, and the square
    /// roots of the weights that they then have.
    fn step(&self, prior: &BiasPrior, state: &State, settling: bool) -> Option<(SVector<f64, STATE>, Vec<f64>)> {
        const ROUNDS: usize = 10;
        const SETTLED: f64 = 1e-5;
        let known = ALIKE / prior.sigma_px.powi(2);
        let differs = prior.differs(state);
        let (mut step, mut roots) = (SVector::<f64, STATE>::zeros(), Vec::new());
        for _ in 0..ROUNDS {
            roots = robust_weights((&self.residuals + &self.by_state * step).as_slice(), settling);
            let mut information = SMatrix::<f64, STATE, STATE>::zeros();
            let mut slope = SVector::<f64, STATE>::zeros();
            for (k, differs) in differs.iter().enumerate() {
                information[(2 + k, 2 + k)] = known;
                slope[2 + k] = known * differs;
            }
            for (row, root) in roots.iter().enumerate() {
                let along = self.by_state.fixed_view::<1, STATE>(row, 0).transpose();
                information.syger(root * root, &along, &along, 1.0);
                slope += along * (root * root * self.residuals[row]);
            }
            information.fill_upper_triangle_with_lower_triangle();
            let before = step;
            step = -information.cholesky()?.solve(&slope);
            if (step - before).norm() < SETTLED {
                break;
            }
        }
        Some((step, roots))
    }

    /// With a row more for every bias: what is known of it beforehand.
    pub fn with_prior(self, prior: &BiasPrior, state: &State) -> Self {
        let edges = self.residuals.len();
        let root = ALIKE.sqrt() / prior.sigma_px;
        let mut residuals = self.residuals.insert_rows(edges, BIASES, 0.0);
        let mut by_state = self.by_state.insert_rows(edges, BIASES, 0.0);
        for (k, differs) in prior.differs(state).into_iter().enumerate() {
            residuals[edges + k] = root * differs;
            by_state[(edges + k, 2 + k)] = root;
        }
        Self { residuals, by_state, by_pose: self.by_pose.insert_rows(edges, BIASES, 0.0) }
    }

    /// With every row times the square root of its weight.
    pub fn weighted(mut self, roots: &[f64]) -> Self {
        for (row, root) in roots.iter().enumerate() {
            self.residuals[row] *= root;
            self.by_state.row_mut(row).scale_mut(*root);
            self.by_pose.row_mut(row).scale_mut(*root);
        }
        self
    }
}

/// Edges are searched for within this distance, px, once the model has settled.
pub(super) const SETTLED_PX: f64 = 4.0;

/// Square roots of the robust weights of residuals in units of their σ, the scale taken from their median.
///
/// While the model is still `settling`, Huber's: a whole family of edges may be far off because the model is, and must
/// go on pulling. Then Tukey's biweight: what is still far off is not the snake's outline and counts nothing.
pub(super) fn robust_weights(residuals: &[f64], settling: bool) -> Vec<f64> {
    let mut sizes: Vec<f32> = residuals.iter().map(|r| r.abs() as f32).collect();
    let scale = (1.4826 * f64::from(median(&mut sizes))).max(1.0);
    let huber = |r: f64| (1.345 * scale / r.abs().max(1e-12)).min(1.0).sqrt();
    let tukey = |r: f64| (1.0 - (r / (4.685 * scale)).powi(2)).max(0.0);
    residuals.iter().map(|&r| if settling { huber(r) } else { tukey(r) }).collect()
}

/// Covariance of a weighted fit that does not believe that errors along one piece of the body are independent: White's
/// sandwich with the pieces as clusters. `jacobian` and `residuals` are in units of σ and already weighted; rows beyond
/// `pieces` (priors) are pieces of their own.
///
/// Source: A. C. Cameron, D. L. Miller, "A Practitioner's Guide to Cluster-Robust Inference", 2015, Eq. 11 with the
/// finite-cluster factor.
pub(super) fn clustered_covariance(
    jacobian: &DMatrix<f64>,
    residuals: &DVector<f64>,
    pieces: &[Piece],
) -> Option<DMatrix<f64>> {
    let parameters = jacobian.ncols();
    let bread = (jacobian.transpose() * jacobian).cholesky()?.inverse();
    let mut scores: BTreeMap<Result<Piece, usize>, DVector<f64>> = BTreeMap::new();
    for row in 0..jacobian.nrows() {
        let cluster = pieces.get(row).map(|piece| piece.witness()).ok_or(row);
        let score = scores.entry(cluster).or_insert_with(|| DVector::zeros(parameters));
        score.iter_mut().zip(jacobian.row(row).iter()).for_each(|(sum, slope)| *sum += slope * residuals[row]);
    }
    let clusters = scores.len() as f64;
    if clusters <= parameters as f64 {
        return None;
    }
    let meat = scores.values().fold(DMatrix::zeros(parameters, parameters), |sum, s| sum + s * s.transpose());
    Some(&bread * meat * &bread * (clusters / (clusters - parameters as f64)))
}

/// What [`Matches::light_patterns`] add to the covariance of a fit to these edges, whose rows come first in `jacobian`.
pub(super) fn light_covariance(
    matches: &Matches,
    jacobian: &DMatrix<f64>,
    independent: &DMatrix<f64>,
    view: &Projection,
    roots: &[f64],
    scatter_px: f64,
) -> DMatrix<f64> {
    let edges = jacobian.rows(0, matches.len()).transpose();
    let shifts =
        matches.light_patterns(view, roots, scatter_px).into_iter().map(|pattern| independent * (&edges * pattern));
    shifts.fold(DMatrix::zeros(independent.nrows(), independent.ncols()), |sum, shift| sum + &shift * shift.transpose())
}

/// The share of edges that count at least half, and their scatter, px.
pub(super) fn inliers(misfits_px: &[f64], roots: &[f64]) -> (usize, f64) {
    let kept: Vec<f64> = misfits_px.iter().zip(roots).filter(|(_, w)| **w > 0.5).map(|(d, _)| *d).collect();
    let rms = (kept.iter().map(|d| d * d).sum::<f64>() / kept.len().max(1) as f64).sqrt();
    (kept.len(), rms)
}

/// Covariance of the `kept` parameters of a fit: [`clustered_covariance`], widened wherever it says less than independent edges
/// do, for the scores of a few pieces may agree by chance, and what light adds.
pub(super) fn whole_covariance(
    [clustered, independent, light]: [&DMatrix<f64>; 3],
    kept: &[usize],
) -> Option<DMatrix<f64>> {
    let block = |of: &DMatrix<f64>| DMatrix::from_fn(kept.len(), kept.len(), |r, c| of[(kept[r], kept[c])]);
    let root = block(independent).cholesky()?.l();
    let inverse = root.clone().try_inverse()?;
    let mut ratio = (&inverse * block(clustered) * inverse.transpose()).symmetric_eigen();
    ratio.eigenvalues.iter_mut().for_each(|value| *value = value.max(1.0));
    Some(&root * ratio.recompose() * root.transpose() + block(light))
}

/// Another bend explains a picture as well if its cost is within this factor of the best one's.
pub(super) const AS_GOOD: f64 = 1.5;

/// The snake's bend in one picture.
#[derive(Debug, Clone)]
pub(super) struct BendFit {
    pub bend: Vector2<f64>,
    pub bias: EdgeBias,
    /// Covariance of the bend vector from this picture alone, rad².
    pub covariance: Matrix2<f64>,
    /// Change of the bend vector with the camera's pose (see [`nudged`]).
    pub by_pose: Matrix2x6<f64>,
    /// Places of the outline in view.
    pub places: usize,
    /// Edges that agree with the model.
    pub inliers: usize,
    pub rms_px: f64,
    pub blur_px: f64,
    /// Share of the outline that lies outside the picture.
    pub out_of_frame: f64,
    /// Mean over all places of the squared distance, cut off at the last search distance, in units of that: 0 if every
    /// place has its edge where the model says, 1 if none has.
    pub cost: f64,
    /// The edges that were matched last.
    matches: Matches,
}

impl BendFit {
    /// How the snake departs from a circle; `None` where the edges do not tell.
    pub fn departure(&self, view: &Projection, bias: &BiasPrior) -> Option<Departure> {
        departure(view, &self.matches, &self.start().state, &bias.in_edges_as_soft_as(self.blur_px), self.rms_px)
    }

    /// What of the snake is there to be seen.
    pub fn proof(&self) -> Proof {
        Proof::of(&self.matches.asked)
    }

    /// Whether all of the outline is where the fit says, so that no other bend needs to be looked at.
    pub fn explains_all(&self) -> bool {
        const HARDLY_OFF: f64 = 0.01;
        const NEARLY_ALL: f64 = 0.95;
        if self.cost >= HARDLY_OFF || (self.inliers as f64) < NEARLY_ALL * self.places as f64 {
            return false;
        }
        let proof = self.proof();
        proof.disks_there() == 1.0 && proof.end_is_there()
    }

    /// The better of two that end close together, with the doubt which of them is right.
    pub fn or(self, other: Self) -> Self {
        let apart = self.bend - other.bend;
        let (mut better, worse) = if other.cost < self.cost { (other, self) } else { (self, other) };
        if worse.cost < AS_GOOD * better.cost {
            // The variance of two equally likely answers.
            better.covariance += apart * apart.transpose() / 4.0;
        }
        better
    }

    /// Where to go on from here.
    pub fn start(&self) -> Start {
        Start { state: State { bend: self.bend, bias: self.bias }, blur_px: Some(self.blur_px) }
    }
}

/// What is known of the edges' bias before the picture is looked at.
#[derive(Debug, Clone, Copy)]
pub(super) struct BiasPrior {
    pub mean: EdgeBias,
    pub sigma_px: f64,
}

impl BiasPrior {
    /// What is known of it in a picture this soft.
    fn in_edges_as_soft_as(self, blur_px: f64) -> Self {
        Self { sigma_px: self.sigma_px * softness(blur_px), ..self }
    }

    /// How far a state's biases are from their means, px.
    fn differs(&self, state: &State) -> [f64; BIASES] {
        let (biases, means) = (state.bias.to_array(), self.mean.to_array());
        std::array::from_fn(|k| biases[k] - means[k])
    }
}

/// What a picture is fitted with.
#[derive(Debug, Clone, Copy)]
pub(super) struct State {
    pub bend: Vector2<f64>,
    pub bias: EdgeBias,
}

/// How many numbers a [`State`] has: the bend vector's two and the biases.
pub(super) const STATE: usize = 2 + BIASES;

impl State {
    fn psi(&self) -> Configuration {
        Configuration::from_bend_vector(self.bend)
    }

    fn moved(&self, by: &SVector<f64, STATE>) -> Self {
        Self { bend: self.bend + by.xy(), bias: self.bias.moved(&by.as_slice()[2..]) }
    }
}

/// Moves a state to where matched edges agree with it best, and the square roots of the weights that they have there.
fn moved_to_edges(
    matches: &Matches,
    view: &Projection,
    start: State,
    bias: BiasPrior,
    settling: bool,
) -> Option<(State, Vec<f64>)> {
    const LINEARISATIONS: usize = 4;
    const FURTHEST_RAD: f64 = 0.2;
    /// Steps of the bend this short, rad, leave nothing of what is not linear; the bias is.
    const SHORT: f64 = 5e-3;
    let (mut state, mut roots) = (start, Vec::new());
    for _ in 0..LINEARISATIONS {
        let step;
        (step, roots) = matches.linearised(view, &state).step(&bias, &state, settling)?;
        let step = step * (FURTHEST_RAD / step.xy().norm()).min(1.0);
        if step.iter().any(|v| !v.is_finite()) {
            return None;
        }
        state = state.moved(&step);
        if step.xy().norm() < SHORT {
            break;
        }
    }
    Some((state, roots))
}

/// How thoroughly a picture is looked at.
#[derive(Debug, Clone, Copy)]
pub(super) struct Effort {
    /// Search distances, px, one a round of matching; the last one is kept until nothing moves.
    pub searches_px: &'static [f64],
    /// Most rounds.
    pub rounds: usize,
    /// Whether the start is as good as the answer, so that what disagrees with it is not the snake's outline. Then every
    /// place of it is asked; until then a few are enough to tell which bend it is.
    pub settled: bool,
    /// Nothing moves if the bend moves by less, rad.
    pub converged_rad: f64,
}

/// Where a fit starts.
#[derive(Debug, Clone, Copy)]
pub(super) struct Start {
    pub state: State,
    /// How soft the picture's edges are, if that is known.
    pub blur_px: Option<f64>,
}

/// Fits bend and edge bias by matching edges within ever smaller distances.
///
/// `None` where too little of the outline has edges, or the bend leaves what a snake can do.
pub(super) fn fit_bend(
    view: &Projection,
    finder: &EdgeFinder,
    start: Start,
    bias: BiasPrior,
    effort: &Effort,
) -> Option<BendFit> {
    const FURTHEST_RAD: f64 = 2.2;
    const LEAST_OUTLINE_PX: f64 = 60.0;
    /// While the bend moves by more, what disagrees with it may be right.
    const SETTLING_RAD: f64 = 2e-3;
    /// A bend that differs by less leaves the border on the same points of the body, near enough for a look. A measurement
    /// draws it anew: which rims of disks seen edge-on are on the border hangs on every hundredth of a degree.
    const CARRIED_RAD: f64 = 0.03;
    let Start { mut state, blur_px } = start;
    let mut settling = !effort.settled;
    let mut blur_px = blur_px.filter(|_| effort.settled);
    let bias = blur_px.map_or(bias, |blur_px| bias.in_edges_as_soft_as(blur_px));
    let mut filtered = blur_px.map_or_else(|| finder.clone(), |blur_px| settled(finder, view, blur_px));
    let spacing_px = if effort.settled { Outline::SPACING_PX } else { view.sparse_px() };
    let mut drawn: Option<(Vector2<f64>, Outline)> = None;
    let mut last = None;
    let searches = effort.searches_px.iter().chain(std::iter::repeat(effort.searches_px.last()?));
    for (round, &search_px) in searches.take(effort.rounds).enumerate() {
        let before = drawn.take();
        let (_, outline) = drawn.insert(match before {
            Some((at, mut outline)) if !effort.settled && (state.bend - at).norm() < CARRIED_RAD => {
                outline.carry(view, state.psi());
                (at, outline)
            }
            _ => {
                let mut outline = Outline::spaced(view, state.psi(), spacing_px);
                if let Some(blur_px) = blur_px {
                    soften(&mut outline, blur_px, &filtered);
                }
                (state.bend, outline)
            }
        });
        // The holder and the base disk do not bend.
        let matches =
            Matches::find(outline, &filtered, search_px, |p| !matches!(p, Piece::HolderSide(_) | Piece::BaseRim));
        if matches.len() as f64 * spacing_px < LEAST_OUTLINE_PX {
            return None;
        }
        let before = state.bend;
        let roots;
        (state, roots) = moved_to_edges(&matches, view, state, bias, settling || search_px > SETTLED_PX)?;
        if state.bend.norm() > FURTHEST_RAD {
            return None;
        }
        let moved_rad = (state.bend - before).norm();
        settling &= moved_rad > SETTLING_RAD;
        // A picture that was thought sharper than it is was looked at with too narrow a filter.
        let seen_px = matches.blur_px();
        match &mut blur_px {
            None => filtered = finder.as_wide_as(seen_px),
            Some(blur_px) if seen_px > SHARP_PX => {
                *blur_px = seen_px;
                filtered = settled(finder, view, seen_px);
            }
            Some(_) => {}
        }
        last = Some((matches, roots, search_px));
        if round + 1 >= effort.searches_px.len() && moved_rad < effort.converged_rad {
            break;
        }
    }

    let (matches, roots, search_px) = last?;
    let (_, outline) = drawn?;
    let psi = state.psi();
    let linear = matches.linearised(view, &state).weighted(&roots).with_prior(&bias, &state);
    let independent = covariance(&linear.by_state)?;
    let clustered = clustered_covariance(&linear.by_state, &linear.residuals, &matches.pieces())?;
    let misfits = matches.misfits_px(view, psi, state.bias);
    let (inliers, rms_px) = inliers(&misfits, &roots);
    let light = light_covariance(&matches, &linear.by_state, &independent, view, &roots, rms_px);
    let gain = &independent * linear.by_state.tr_mul(&linear.by_pose);
    let near: f64 = misfits.iter().map(|d| 1.0 - (d / search_px).powi(2).min(1.0)).sum();
    let covariance = whole_covariance([&clustered, &independent, &light], &[0, 1])?;
    Some(BendFit {
        bend: state.bend,
        bias: state.bias,
        covariance: covariance.fixed_view::<2, 2>(0, 0).into_owned(),
        by_pose: Matrix2x6::from_fn(|row, column| -gain[(row, column)]),
        places: matches.places(),
        inliers,
        rms_px,
        blur_px: matches.blur_px(),
        out_of_frame: outline.out_of_frame,
        cost: 1.0 - near / matches.places() as f64,
        matches,
    })
}

/// What all pictures of a sequence share: the camera's pose (see [`nudged`]) and the edges' biases (px).
pub(super) type Shared = SVector<f64, SHARED>;
pub(super) type SharedInformation = SMatrix<f64, SHARED, SHARED>;
const SHARED: usize = 6 + BIASES;

/// What one picture says of what all share, its own bend being free.
#[derive(Debug, Clone)]
pub(super) struct SharedEvidence {
    /// By what errs alike ([`Piece::witness`]): the information if every edge were a witness of its own, and the derivative of half the squared
    /// residuals.
    pub pieces: BTreeMap<Piece, (SharedInformation, Shared)>,
    /// That derivative for each of [`Matches::light_patterns`].
    pub light: Vec<Shared>,
}

/// Looks at a picture whose bend is known nearly, and lets the bend follow pose and bias.
///
/// `None` where the edges do not determine the bend.
pub(super) fn shared_evidence(
    view: &Projection,
    finder: &EdgeFinder,
    state: &State,
    blur_px: f64,
) -> Option<SharedEvidence> {
    let psi = state.psi();
    let mut outline = Outline::new(view, psi);
    let finder = settled(finder, view, blur_px);
    soften(&mut outline, blur_px, &finder);
    let matches = Matches::find(&outline, &finder, 3.0, |_| true);
    let residuals = matches.residuals(view, psi, state.bias);
    let roots = robust_weights(&residuals, false);
    let Linearised { by_state, by_pose: pose, .. } = matches.linearised(view, state).weighted(&roots);
    let (bend, bias) = (by_state.columns(0, 2), by_state.columns(2, BIASES));
    let shared = DMatrix::from_fn(pose.nrows(), SHARED, |r, c| if c < 6 { pose[(r, c)] } else { bias[(r, c - 6)] });
    // What the picture's own bend could have done as well is no evidence.
    let projected = &shared - bend * (bend.transpose() * bend).cholesky()?.solve(&(bend.transpose() * &shared));
    let mut pieces = BTreeMap::new();
    for (row, ((piece, residual), root)) in matches.pieces().into_iter().zip(residuals).zip(&roots).enumerate() {
        let along = Shared::from_iterator(projected.row(row).iter().copied());
        let (information, score) =
            pieces.entry(piece.witness()).or_insert((SharedInformation::zeros(), Shared::zeros()));
        *information += along * along.transpose();
        *score += along * (residual * root);
    }
    let (_, scatter_px) = inliers(&matches.misfits_px(view, psi, state.bias), &roots);
    let light = matches.light_patterns(view, &roots, scatter_px);
    let light = light.iter().map(|pattern| {
        let score = projected.transpose() * pattern;
        Shared::from_iterator(score.iter().copied())
    });
    Some(SharedEvidence { pieces, light: light.collect() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;
    use proptest::prelude::*;

    fn covariance_of(a: f64, b: f64, c: f64) -> Matrix2<f64> {
        let root = Matrix2::new(a, 0.0, b, c);
        root * root.transpose()
    }

    /// The whole covariance where light adds nothing.
    fn widened(clustered: &Matrix2<f64>, independent: &Matrix2<f64>) -> Matrix2<f64> {
        let dynamic = |m: &Matrix2<f64>| DMatrix::from_column_slice(2, 2, m.as_slice());
        let parts = [dynamic(clustered), dynamic(independent), DMatrix::zeros(2, 2)];
        whole_covariance(parts.each_ref(), &[0, 1]).unwrap().fixed_view::<2, 2>(0, 0).into_owned()
    }

    proptest! {
        #[test]
        fn what_is_at_least_another_is_no_less_than_either(
            (a, b, c) in (0.01..10.0, -10.0..10.0, 0.01..10.0),
            (d, e, f) in (0.01..10.0, -10.0..10.0, 0.01..10.0),
        ) {
            let (covariance, least) = (covariance_of(a, b, c), covariance_of(d, e, f));
            let widened = widened(&covariance, &least);
            let rounding = 1e-9 * widened.trace().powi(2) / least.determinant().sqrt();
            prop_assert!((widened - covariance).symmetric_eigenvalues().min() > -rounding);
            prop_assert!((widened - least).symmetric_eigenvalues().min() > -rounding);
        }
    }

    #[test]
    fn a_covariance_is_widened_only_where_it_says_less() {
        let covariance = Matrix2::from_diagonal(&Vector2::new(4.0, 0.1));
        let widened = widened(&covariance, &Matrix2::identity());
        assert_relative_eq!(widened, Matrix2::from_diagonal(&Vector2::new(4.0, 1.0)), epsilon = 1e-12);
    }

    #[test]
    fn every_piece_has_the_bias_of_its_kind() {
        let bias = EdgeBias { side_px: 0.1, tube_px: 0.2, rim_px: 0.3 };
        let moved = EdgeBias::default().moved(&bias.to_array());
        assert_eq!(moved, bias);
        let of =
            [Piece::HolderSide(1), Piece::DiskSide(2, -1), Piece::Tube(3, 1, 4), Piece::BaseRim, Piece::Rim(5, true)];
        assert_eq!(of.map(|piece| bias.of(piece)), [0.1, 0.1, 0.2, 0.3, 0.3]);
    }

    #[test]
    fn the_scores_of_one_tubes_side_are_one_witness() {
        // Two edges that pull together lie on rims of two disks, or on one tube.
        let jacobian = DMatrix::from_element(8, 1, 1.0);
        let residuals = DVector::from_column_slice(&[1.0, 1.0, 1.0, -1.0, 0.5, -0.5, 0.5, -0.5]);
        let rims: Vec<Piece> = (0..8).map(|k| Piece::Rim(k, false)).collect();
        let tube: Vec<Piece> =
            (0..8).map(|k| if k < 2 { Piece::Tube(1, 1, k) } else { Piece::Rim(k, false) }).collect();
        let apart = clustered_covariance(&jacobian, &residuals, &rims).unwrap()[(0, 0)];
        let together = clustered_covariance(&jacobian, &residuals, &tube).unwrap()[(0, 0)];
        // Σ s²: 1 + 1 + 1 + 1 + 4 · ¼ of eight witnesses, 4 + 1 + 1 + 4 · ¼ of seven.
        assert_relative_eq!(apart, 5.0 / 64.0 * 8.0 / 7.0, epsilon = 1e-12);
        assert_relative_eq!(together, 7.0 / 64.0 * 7.0 / 6.0, epsilon = 1e-12);
    }
}
