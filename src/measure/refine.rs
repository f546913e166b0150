//! The rig once more, from the whole sequence: bent snakes tell what the straight one could not.
//!
//! A straight snake hardly tells how far it leans towards the camera. Snakes bent to all sides do: every frame's bend is
//! its own, but all share one camera, one base and one light.

use crate::camera::Frame;
use crate::measure::body::{Outline, Piece, Projection};
use crate::measure::eye::{Eye, MeasurementStages};
use crate::measure::fit::{
    BIASES, BiasPrior, Correspondences, EdgeFinder, FRAME_BIAS_SIGMA_PX, FitSchedule, Linearised, RobustPhase, Start,
    State, fine_filter, fit_bend, inliers, predict_blur,
};
use crate::measure::image::plane::{Plane, Region};
use crate::measure::rig::calibrate::Rig;
use crate::measure::target::grid::nudged;
use crate::observation::Status;
use nalgebra::{DMatrix, DVector, Matrix6, SMatrix, SVector};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Frames fewer than this tell nothing worth having.
const FEWEST_FRAMES: usize = 3;
/// Rounds of matching and moving; each leaves about a quarter of what was to go.
const ROUNDS: usize = 3;
/// How a frame's bend follows in a round.
const FOLLOW: FitSchedule = FitSchedule { searches_px: &[3.0], rounds: 2, is_fine: true, converged_rad: 2e-5 };

/// What all pictures of a sequence share: the camera's pose (see [`nudged`]) and the edges' biases (px).
type Shared = SVector<f64, SHARED>;
type SharedInformation = SMatrix<f64, SHARED, SHARED>;
const SHARED: usize = 6 + BIASES;

/// What one picture says of what all share, its own bend being free.
#[derive(Debug, Clone)]
struct SharedEvidence {
    /// By what errs alike ([`Piece::cluster`]): the information if every edge were a witness of its own, and the derivative of half the squared
    /// residuals.
    pieces: BTreeMap<Piece, (SharedInformation, Shared)>,
    /// That derivative for each of [`Correspondences::systematic_modes`].
    light: Vec<Shared>,
}

impl Eye {
    /// This eye with its rig refined from frames of a sequence: the errors of pose and bias are then what the frames
    /// leave, not what the straight picture did. Frames that cannot be measured are passed over; where fewer than three
    /// can, the eye stays as it is.
    pub fn refined(self, frames: impl ParallelIterator<Item = Frame>) -> Self {
        match self.refined_rig(frames) {
            Some(rig) => Self::new(self.lens, rig, self.robot),
            None => self,
        }
    }

    fn refined_rig(&self, frames: impl ParallelIterator<Item = Frame>) -> Option<Rig> {
        let find = |frame: Frame| {
            let MeasurementStages { measurement, fits, .. } = self.measure_in_stages(&frame);
            let fit = fits.first().filter(|_| measurement.status == Status::Ok)?;
            Some((self.plane(&frame, &Region::whole(frame.width, frame.height)), fit.start()))
        };
        let (planes, mut starts): (Vec<Plane>, Vec<Start>) = frames.filter_map(find).unzip();
        let mut rig = self.rig.clone();
        let mut moved = Shared::zeros();
        for _ in 0..ROUNDS {
            let view = Projection { lens: &self.lens, camera_from_base: rig.camera_from_base, robot: &self.robot };
            let prior = BiasPrior { mean: rig.edge_bias, sigma_px: FRAME_BIAS_SIGMA_PX };
            let look = |(plane, start): (&Plane, &mut Start)| {
                let finder = EdgeFinder::new(plane, rig.appearance.two_sided);
                let state = State { bend: start.state.bend, bias: rig.edge_bias };
                let fit = fit_bend(&view, &finder, Start { state, ..*start }, prior, &FOLLOW)?;
                *start = fit.start();
                shared_evidence(&view, &finder, &State { bend: fit.bend, bias: rig.edge_bias }, fit.blur_px)
            };
            let seen: Vec<SharedEvidence> = planes.par_iter().zip(&mut starts).filter_map(look).collect();
            if seen.len() < FEWEST_FRAMES {
                return None;
            }
            let (step, covariance) = combine(&self.rig, &moved, &seen)?;
            moved += step;
            rig = self.rig.moved(&moved, covariance);
        }
        Some(rig)
    }
}

impl Rig {
    fn moved(&self, by: &Shared, covariance: SharedInformation) -> Self {
        let pose = DVector::from_column_slice(&by.as_slice()[..6]);
        Self {
            camera_from_base: nudged(&self.camera_from_base, &pose),
            pose_covariance: covariance.fixed_view::<6, 6>(0, 0).into_owned(),
            edge_bias: self.edge_bias.moved(&by.as_slice()[6..]),
            ..self.clone()
        }
    }
}

/// Looks at a picture whose bend is known nearly, and lets the bend follow pose and bias.
///
/// `None` where the edges do not determine the bend.
fn shared_evidence(view: &Projection, finder: &EdgeFinder, state: &State, blur_px: f64) -> Option<SharedEvidence> {
    let mut outline = Outline::new(view, state.psi());
    let finder = fine_filter(finder, view, blur_px);
    predict_blur(&mut outline, blur_px, &finder);
    let matches = Correspondences::find(&outline, &finder, 3.0, |_| true);
    let linear = Linearised::new(&matches, view, state);
    let roots = RobustPhase::Redescending.roots(linear.residuals.as_slice());
    let (_, scatter_px) = inliers(&matches.in_px(linear.residuals.as_slice()), &roots);
    let Linearised { residuals, by_state, by_pose: pose } = linear.weighted(&roots);
    let (bend, bias) = (by_state.columns(0, 2), by_state.columns(2, BIASES));
    let shared = DMatrix::from_fn(pose.nrows(), SHARED, |r, c| if c < 6 { pose[(r, c)] } else { bias[(r, c - 6)] });
    // What the picture's own bend could have done as well is no evidence.
    let projected = &shared - bend * (bend.transpose() * bend).cholesky()?.solve(&(bend.transpose() * &shared));
    let mut pieces = BTreeMap::new();
    for (row, cluster) in matches.clusters().enumerate() {
        let along = Shared::from_iterator(projected.row(row).iter().copied());
        let (information, score) = pieces.entry(cluster).or_insert((SharedInformation::zeros(), Shared::zeros()));
        *information += along * along.transpose();
        *score += along * residuals[row];
    }
    let light = matches.systematic_modes(view, &roots, scatter_px);
    let light = light.iter().map(|pattern| {
        let score = projected.transpose() * pattern;
        Shared::from_iterator(score.iter().copied())
    });
    Some(SharedEvidence { pieces, light: light.collect() })
}

/// The next step after `moved` from what is known of the rig, and the covariance after it.
///
/// Errors along one piece of the body are the same in every frame (they share its shading), so pieces, not edges and not
/// frames, are the witnesses: their information counts as much less as their scores scatter more than they should.
fn combine(rig: &Rig, moved: &Shared, evidence: &[SharedEvidence]) -> Option<(Shared, SharedInformation)> {
    const ROUNDS: usize = 6;
    let pose: Matrix6<f64> = rig.pose_covariance.cholesky()?.inverse();
    let prior = SharedInformation::from_fn(|r, c| match (r < 6, c < 6) {
        (true, true) => pose[(r, c)],
        _ if r == c => FRAME_BIAS_SIGMA_PX.powi(-2),
        _ => 0.0,
    });
    let mut pieces: BTreeMap<Piece, (SharedInformation, Shared)> = BTreeMap::new();
    for (piece, (information, score)) in evidence.iter().flat_map(|e| &e.pieces) {
        let sum = pieces.entry(*piece).or_insert((SharedInformation::zeros(), Shared::zeros()));
        *sum = (sum.0 + information, sum.1 + score);
    }
    let information: SharedInformation = pieces.values().map(|p| p.0).sum();
    let score: Shared = pieces.values().map(|p| p.1).sum();
    let alone = information.cholesky()?.inverse();
    let patterns = evidence.first().map_or(0, |e| e.light.len());
    let light = (0..patterns).map(|p| evidence.iter().map(|e| e.light[p]).sum::<Shared>());
    let light: SharedInformation = light.map(|s| s * s.transpose()).sum();
    let (parameters, clusters) = (Shared::zeros().len() as f64, pieces.len() as f64);
    if clusters <= parameters {
        return None;
    }
    let mut step = -alone * score;
    let mut covariance = alone;
    for _ in 0..ROUNDS {
        let left = pieces.values().map(|(information, score)| score + information * step);
        let meat = left.map(|s| s * s.transpose()).sum::<SharedInformation>() * (clusters / (clusters - parameters));
        let inflation = ((alone * meat).trace() / parameters).max(1.0);
        let bread = (prior + information / inflation).cholesky()?.inverse();
        step = -bread * (prior * moved + score / inflation);
        covariance = bread * (prior + (meat + light) / inflation.powi(2)) * bread;
    }
    Some((step, covariance))
}
