//! Fits the snake's bend to the edges of one picture.

use super::edges::EdgeFinder;
use super::grid::nudged;
use super::outline::{BodyPoint, Outline, Piece, Projection};
use super::plane::median;
use super::solve::minimise;
use crate::geometry::{Configuration, Pose};
use nalgebra::{DMatrix, DVector, Matrix2, Matrix2x6, Point2, Point3, Vector2};
use std::collections::BTreeMap;

/// A border point of the model and the edge that was found near it.
#[derive(Debug, Clone, Copy)]
struct Match {
    body: BodyPoint,
    piece: Piece,
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
    /// Places of the outline that were looked at.
    pub places: usize,
}

/// Systematic error of a single edge's place, px: what shading and print do to it however clean it looks.
const EDGE_FLOOR_PX: f64 = 0.08;

impl Matches {
    /// Finds the edges within `search_px` of the model's outline.
    pub fn find(outline: &Outline, finder: &mut EdgeFinder, search_px: f64, is_wanted: impl Fn(Piece) -> bool) -> Self {
        // Close to another part the edge's surroundings are not what the edge filter assumes.
        const CLEAR_PX: f64 = 4.0;
        let clear =
            outline.points.iter().filter(|p| p.gap_px >= CLEAR_PX && p.depth_px >= CLEAR_PX && is_wanted(p.piece));
        let mut found = Self { matches: Vec::new(), sections_mm: Vec::new(), section_of: Vec::new(), places: 0 };
        for point in clear {
            found.places += 1;
            let Some(edge) = finder.find(point, search_px) else { continue };
            // Points come section by section.
            if found.sections_mm.last() != Some(&point.body.s_mm) {
                found.sections_mm.push(point.body.s_mm);
            }
            found.section_of.push(found.sections_mm.len() - 1);
            found.matches.push(Match {
                body: point.body,
                piece: point.piece,
                seen: point.pixel + point.normal.into_inner() * edge.offset_px,
                normal: point.normal.into_inner(),
                sigma_px: edge.sigma_px.hypot(EDGE_FLOOR_PX),
                blur_px: edge.blur_px,
            });
        }
        found
    }

    pub fn len(&self) -> usize {
        self.matches.len()
    }

    /// How far outside the model's border each edge lies, px.
    pub fn distances_px(&self, view: &Projection, psi: Configuration) -> Vec<f64> {
        let frames: Vec<Pose> =
            self.sections_mm.iter().map(|&s| view.camera_from_base * view.robot.frame_at(psi, s)).collect();
        let points = self.matches.iter().zip(&self.section_of);
        points
            .map(|(m, &section)| {
                let expected = view.lens.project(&(frames[section] * Point3::from(m.body.local)));
                m.normal.dot(&(m.seen - expected))
            })
            .collect()
    }

    /// The same in units of σ, for edges that lie `bias_px` outside the true border.
    pub fn residuals(&self, view: &Projection, psi: Configuration, bias_px: f64) -> Vec<f64> {
        let distances = self.distances_px(view, psi);
        distances.iter().zip(&self.matches).map(|(d, m)| (d - bias_px) / m.sigma_px).collect()
    }

    /// The piece of the body of every edge.
    pub fn pieces(&self) -> Vec<Piece> {
        self.matches.iter().map(|m| m.piece).collect()
    }

    /// Median blur of the edges, px.
    fn blur_px(&self) -> f64 {
        f64::from(median(&mut self.matches.iter().map(|m| m.blur_px as f32).collect::<Vec<_>>()))
    }

    /// Derivatives of the weighted residuals by the camera's pose (see [`nudged`]).
    fn pose_jacobian(&self, view: &Projection, psi: Configuration, roots: &[f64]) -> DMatrix<f64> {
        let mut jacobian = DMatrix::zeros(self.len(), 6);
        for column in 0..6 {
            const STEP: f64 = 1e-4;
            let moved = |by: f64| {
                let mut x = DVector::zeros(6);
                x[column] = by;
                let moved = Projection { camera_from_base: nudged(&view.camera_from_base, &x), ..view.clone() };
                self.residuals(&moved, psi, 0.0)
            };
            let change = moved(STEP).into_iter().zip(moved(-STEP)).map(|(ahead, behind)| ahead - behind);
            for (row, (change, root)) in change.zip(roots).enumerate() {
                jacobian[(row, column)] = root * change / (2.0 * STEP);
            }
        }
        jacobian
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
        let cluster = pieces.get(row).copied().ok_or(row);
        let score = scores.entry(cluster).or_insert_with(|| DVector::zeros(parameters));
        *score += jacobian.row(row).transpose() * residuals[row];
    }
    let clusters = scores.len() as f64;
    if clusters <= parameters as f64 {
        return None;
    }
    let meat = scores.values().fold(DMatrix::zeros(parameters, parameters), |sum, s| sum + s * s.transpose());
    Some(&bread * meat * &bread * (clusters / (clusters - parameters as f64)))
}

/// The share of edges that count at least half, and their scatter, px.
pub(super) fn inliers(distances_px: &[f64], bias_px: f64, roots: &[f64]) -> (usize, f64) {
    let kept: Vec<f64> = distances_px.iter().zip(roots).filter(|(_, w)| **w > 0.5).map(|(d, _)| d - bias_px).collect();
    let rms = (kept.iter().map(|d| d * d).sum::<f64>() / kept.len().max(1) as f64).sqrt();
    (kept.len(), rms)
}

/// The snake's bend in one picture.
#[derive(Debug, Clone)]
pub(super) struct BendFit {
    pub bend: Vector2<f64>,
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
}

/// What is known of the edges' bias before the picture is looked at.
#[derive(Debug, Clone, Copy)]
pub(super) struct BiasPrior {
    pub mean_px: f64,
    pub sigma_px: f64,
}

/// Fits bend and edge bias by matching edges within ever smaller distances; at the last one it stops once nothing moves.
///
/// `None` where too little of the outline has edges, or the bend leaves what a snake can do.
pub(super) fn fit_bend(
    view: &Projection,
    finder: &mut EdgeFinder,
    start: Vector2<f64>,
    bias: BiasPrior,
    searches_px: &[f64],
) -> Option<BendFit> {
    const FURTHEST_RAD: f64 = 2.2;
    const FEWEST_EDGES: usize = 30;
    const CONVERGED_RAD: f64 = 2e-5;
    let (mut bend, mut bias_px) = (start, bias.mean_px);
    let mut last = None;
    for &search_px in searches_px {
        let psi = Configuration::from_bend_vector(bend);
        let outline = Outline::new(view, psi, if search_px > SETTLED_PX { 2 } else { 4 });
        // The holder and the base disk do not bend.
        let matches =
            Matches::find(&outline, finder, search_px, |p| !matches!(p, Piece::HolderSide(_) | Piece::BaseRim));
        if matches.len() < FEWEST_EDGES {
            return None;
        }
        let roots = robust_weights(&matches.residuals(view, psi, bias_px), search_px > SETTLED_PX);
        let weighted = |x: &DVector<f64>| {
            let psi = Configuration::from_bend_vector(Vector2::new(x[0], x[1]));
            let edges = matches.residuals(view, psi, x[2]);
            let prior = (x[2] - bias.mean_px) / bias.sigma_px;
            DVector::from_iterator(edges.len() + 1, edges.iter().zip(&roots).map(|(r, w)| r * w).chain([prior]))
        };
        let start = DVector::from_column_slice(&[bend.x, bend.y, bias_px]);
        let solution = minimise(weighted, start, &DVector::from_column_slice(&[1e-5, 1e-5, 1e-3]))?;
        let moved = (Vector2::new(solution.parameters[0], solution.parameters[1]) - bend).norm();
        (bend, bias_px) = (Vector2::new(solution.parameters[0], solution.parameters[1]), solution.parameters[2]);
        if bend.norm() > FURTHEST_RAD {
            return None;
        }
        last = Some((matches, roots, outline.out_of_frame, search_px, solution));
        if Some(&search_px) == searches_px.last() && moved < CONVERGED_RAD {
            break;
        }
    }

    let (matches, roots, out_of_frame, search_px, solution) = last?;
    let psi = Configuration::from_bend_vector(bend);
    let independent = solution.covariance()?;
    let clustered = clustered_covariance(&solution.jacobian, &solution.residuals, &matches.pieces())?;
    let gain =
        &independent * solution.jacobian.rows(0, matches.len()).transpose() * matches.pose_jacobian(view, psi, &roots);
    let distances = matches.distances_px(view, psi);
    let (inliers, rms_px) = inliers(&distances, bias_px, &roots);
    let near: f64 = distances.iter().map(|d| 1.0 - ((d - bias_px) / search_px).powi(2).min(1.0)).sum();
    let block = |c: &DMatrix<f64>| Matrix2::new(c[(0, 0)], c[(0, 1)], c[(1, 0)], c[(1, 1)]);
    Some(BendFit {
        bend,
        covariance: block(&clustered) + block(&independent),
        by_pose: Matrix2x6::from_fn(|row, column| -gain[(row, column)]),
        places: matches.places,
        inliers,
        rms_px,
        blur_px: matches.blur_px(),
        out_of_frame,
        cost: 1.0 - near / matches.places as f64,
    })
}
