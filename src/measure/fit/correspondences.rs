//! Matches a model's outline with a picture's edges, and says how well they agree with any state of the model.

use super::edges::{Edge, EdgeFinder, filter_px};
use super::uncertainty::robust_weights;
use crate::geometry::{Configuration, Pose};
use crate::measure::body::{BodyPoint, Outline, OutlinePoint, Piece, PredictedEdge, Projection};
use crate::measure::image::plane::median;
use nalgebra::{DMatrix, DVector, Point2, Point3, SMatrix, SVector, Vector2, Vector3};

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
pub(crate) const BIASES: usize = 3;

impl EdgeBias {
    /// Which of them a piece has.
    fn kind(piece: Piece) -> usize {
        match piece {
            Piece::HolderSide(_) | Piece::DiskSide(..) => 0,
            Piece::Tube(..) => 1,
            Piece::BaseRim | Piece::Rim(..) => 2,
        }
    }

    pub(crate) fn of(self, piece: Piece) -> f64 {
        self.to_array()[Self::kind(piece)]
    }

    pub(crate) fn to_array(self) -> [f64; BIASES] {
        [self.side_px, self.tube_px, self.rim_px]
    }

    pub(crate) fn moved(self, by: &[f64]) -> Self {
        Self { side_px: self.side_px + by[0], tube_px: self.tube_px + by[1], rim_px: self.rim_px + by[2] }
    }
}

/// What is known of the edges' bias before the picture is looked at.
#[derive(Debug, Clone, Copy)]
pub(crate) struct BiasPrior {
    pub mean: EdgeBias,
    pub sigma_px: f64,
}

impl BiasPrior {
    /// What is known beforehand, in units of σ per px: it weighs against one of a run of edges, which err alike.
    fn root(&self) -> f64 {
        /// Edges in such a run.
        const ALIKE: f64 = 10.0;
        ALIKE.sqrt() / self.sigma_px
    }

    /// What is known of it in a picture this soft.
    pub fn at_blur(self, blur_px: f64) -> Self {
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
pub(crate) struct State {
    pub bend: Vector2<f64>,
    pub bias: EdgeBias,
}

/// How many numbers a [`State`] has: the bend vector's two and the biases.
pub(crate) const STATE: usize = 2 + BIASES;

impl State {
    pub fn psi(&self) -> Configuration {
        Configuration::from_bend_vector(self.bend)
    }

    pub fn moved(&self, by: &SVector<f64, STATE>) -> Self {
        Self { bend: self.bend + by.xy(), bias: self.bias.moved(&by.as_slice()[2..]) }
    }
}

/// A border point of the model and the edge that was found near it.
#[derive(Debug, Clone, Copy)]
struct Correspondence {
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
}

/// The edges that were matched with a model's outline, and how well they agree with any other state of the model.
#[derive(Debug, Clone)]
pub(crate) struct Correspondences {
    matches: Vec<Correspondence>,
    /// The sections (arc lengths) on which the points lie, and which of them each point is on: many share one, and a
    /// section's frame is what costs most.
    sections_mm: Vec<f64>,
    section_of: Vec<usize>,
    /// Places of the outline that were looked at, and the edge that was found near each.
    asked: Vec<(Piece, Option<Edge>)>,
    /// Median blur of the edges, px.
    pub blur_px: f64,
}

/// What light does to all rims alike and to all sides alike, px (1σ): see [`Correspondences::systematic_modes`]. In renders of random rigs
/// the sides of disks and holder are seen further right or left by 0.011 px (median) to 0.04 px (one rig in ten).
const LIGHT_ON_RIMS_PX: f64 = 0.0108;
const LIGHT_ON_SIDES_PX: f64 = 0.0245;
/// The scatter of edges, px, for which that is true: the median over these rigs.
const TYPICAL_SCATTER_PX: f64 = 0.14;
/// The softest edges, px, for which it is.
pub(crate) const SHARP_PX: f64 = 1.5;
/// The softest that an edge may look, px: twice what is called blurred. What is flat looks as soft as one likes.
const SOFTEST_PX: f64 = 10.0;
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
pub(crate) fn fine_filter<'a>(finder: &EdgeFinder<'a>, view: &Projection, blur_px: f64) -> EdgeFinder<'a> {
    if view.diameter_px() < SMALL_PX { finder.coarse_for_blur(blur_px) } else { finder.fine_for_blur(blur_px) }
}

/// Looks at an outline's own silhouette as at a picture, with the same filter and as soft as a blur of σ = `blur_px` makes it:
/// corners and bends of the border, which a soft picture rounds off, are then rounded in both, and a part that is hardly wider
/// than the blur looks as much sharper in both.
pub(crate) fn predict_blur(outline: &mut Outline, blur_px: f64, finder: &EdgeFinder) {
    /// An edge that looks sharper than by this factor is hardly one.
    const LEAST: f64 = 0.3;
    let silhouette = outline.blurred_silhouette(blur_px);
    let finder = finder.for_model(&silhouette);
    let search_px = ROUNDED_PX * (blur_px / SHARP_PX).max(1.0);
    for point in outline.points.iter_mut().filter(|point| is_clear(point)) {
        point.predicted = finder
            .find(point, search_px)
            .map(|edge| PredictedEdge { offset_px: edge.offset_px, blur_ratio: (edge.blur_px / blur_px).max(LEAST) });
    }
}

impl Correspondences {
    /// Finds the edges within `search_px` of the model's outline, which may be [`predict_blur`]ed.
    pub fn find(outline: &Outline, finder: &EdgeFinder, search_px: f64, is_wanted: impl Fn(Piece) -> bool) -> Self {
        let mut found = Self {
            matches: Vec::with_capacity(outline.points.len()),
            sections_mm: Vec::new(),
            section_of: Vec::with_capacity(outline.points.len()),
            asked: Vec::with_capacity(outline.points.len()),
            blur_px: 0.0,
        };
        let mut blurs_px = Vec::with_capacity(outline.points.len());
        for point in outline.points.iter().filter(|p| is_clear(p) && is_wanted(p.piece)) {
            let edge = finder.find(point, search_px);
            found.asked.push((point.piece, edge));
            let (Some(edge), Some(predicted)) = (edge, point.predicted) else { continue };
            let floor_px = if matches!(point.piece, Piece::Tube(..)) { TUBE_FLOOR_PX } else { EDGE_FLOOR_PX };
            // Points come section by section.
            if found.sections_mm.last() != Some(&point.body.s_mm) {
                found.sections_mm.push(point.body.s_mm);
            }
            found.section_of.push(found.sections_mm.len() - 1);
            found.matches.push(Correspondence {
                body: point.body,
                piece: point.piece,
                lateral: point.lateral,
                seen: point.pixel + point.normal.into_inner() * (edge.offset_px - predicted.offset_px),
                normal: point.normal.into_inner(),
                sigma_px: edge.sigma_px.hypot(floor_px),
            });
            blurs_px.push((edge.blur_px / predicted.blur_ratio).min(SOFTEST_PX) as f32);
        }
        found.blur_px = f64::from(median(&mut blurs_px));
        found
    }

    pub fn len(&self) -> usize {
        self.matches.len()
    }

    /// Places of the outline that were looked at, and the edge that was found near each.
    pub fn asked(&self) -> &[(Piece, Option<Edge>)] {
        &self.asked
    }

    /// How many these are.
    pub fn places(&self) -> usize {
        self.asked.len()
    }

    /// How far outside its place, which is the model's border and its bias, each edge lies, in units of σ.
    pub fn residuals(&self, view: &Projection, psi: Configuration, bias: EdgeBias) -> Vec<f64> {
        self.residuals_along(view, |s_mm| view.robot.frame_at(psi, s_mm), bias)
    }

    /// The same for a snake whose sections have these frames by their arc length, mm.
    pub fn residuals_along(&self, view: &Projection, frame_at: impl Fn(f64) -> Pose, bias: EdgeBias) -> Vec<f64> {
        let frames: Vec<Pose> = self.sections_mm.iter().map(|&s| view.camera_from_base * frame_at(s)).collect();
        let points = self.matches.iter().zip(&self.section_of);
        points
            .map(|(m, &section)| {
                let expected = view.lens.project(&(frames[section] * Point3::from(m.body.local)));
                (m.normal.dot(&(m.seen - expected)) - bias.of(m.piece)) / m.sigma_px
            })
            .collect()
    }

    /// Residuals in px.
    pub fn in_px(&self, residuals: &[f64]) -> Vec<f64> {
        residuals.iter().zip(&self.matches).map(|(r, m)| r * m.sigma_px).collect()
    }

    /// The piece of the body of every edge.
    pub fn pieces(&self) -> Vec<Piece> {
        self.matches.iter().map(|m| m.piece).collect()
    }

    /// Errors, in units of σ and weighted, that light and softness make on all disks alike, so that no number of them
    /// averages them away: all rims shifted along the snake, the same at their ends only, all ends rounded off, disks
    /// that look thicker towards one end of the snake, and all sides shifted to the right or down in the picture. What
    /// displaces edges one by one displaces them together, too: the more they scatter, px, the more so.
    pub fn systematic_modes(&self, view: &Projection, roots: &[f64], scatter_px: f64) -> Vec<DVector<f64>> {
        let more = softness(self.blur_px)
            * (SMALL_PX / view.diameter_px()).max(1.0).powi(2)
            * (scatter_px / TYPICAL_SCATTER_PX);
        let of_edge = |m: &Correspondence| {
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
        let weight = |(m, root): (&Correspondence, &f64)| root * more / m.sigma_px;
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
            let (expected, slopes) = view.lens.project_with_jacobian(&place);
            // How the place moves along the normal, in units of σ, for every mm that the point does.
            let across = slopes.transpose() * m.normal / m.sigma_px;
            let distance_px = m.normal.dot(&(m.seen - expected));
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
pub(crate) struct Linearised {
    pub residuals: DVector<f64>,
    /// By bend vector (rad) and edge biases (px): the components of [`State`].
    pub by_state: DMatrix<f64>,
    /// By the camera's pose (see [`nudged`](crate::measure::target::grid::nudged)).
    pub by_pose: DMatrix<f64>,
}

impl Linearised {
    /// The step of the state after which the edges agree best, as far as they follow it as they do nearby, and the square
    /// roots of the weights that they then have.
    pub fn step(&self, prior: &BiasPrior, state: &State, settling: bool) -> Option<(SVector<f64, STATE>, Vec<f64>)> {
        const ROUNDS: usize = 10;
        const SETTLED: f64 = 1e-5;
        let known = prior.root().powi(2);
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
        let root = prior.root();
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_piece_has_the_bias_of_its_kind() {
        let bias = EdgeBias { side_px: 0.1, tube_px: 0.2, rim_px: 0.3 };
        let moved = EdgeBias::default().moved(&bias.to_array());
        assert_eq!(moved, bias);
        let of =
            [Piece::HolderSide(1), Piece::DiskSide(2, -1), Piece::Tube(3, 1, 4), Piece::BaseRim, Piece::Rim(5, true)];
        assert_eq!(of.map(|piece| bias.of(piece)), [0.1, 0.1, 0.2, 0.3, 0.3]);
    }
}
