//! The rig once more, from frames of a sequence: bent snakes tell what the straight one could not.
//!
//! A straight snake hardly tells how far it leans towards the camera. Snakes bent to all sides do: every frame's bend is
//! its own, but all share one camera, one base and one light. Each round fits every frame's bend, eliminates it from the frame's normal equations
//! (the Schur complement), and takes one Gauss–Newton step of what all frames share, with the straight picture's result as the
//! prior.

use super::parameters::Rig;
use crate::camera::Lens;
use crate::geometry::perturbed;
use crate::measure::body::{Outline, Piece, Projection};
use crate::measure::fit::{
    BIASES, BendFit, Correspondences, EdgeFinder, Filters, FitSchedule, Linearised, RobustPhase, Start, State, excess,
    fit_bend, inliers, learned_mode_sigmas, noise_model,
};
use crate::measure::image::plane::Plane;
use crate::robot::{PROFILE, Robot};
use crate::statistics::moments::mean;
use nalgebra::{DMatrix, DVector, Matrix6, SMatrix, SVector};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Fewest frames that refine a rig.
///
/// Convention: three bends to different sides are the least that tell a lean from a bend.
const FEWEST_FRAMES: usize = 3;
/// Rounds of matching and moving.
///
/// Fitted: by hand on the project's renders, where each round left about a quarter of what was to go; not judged elsewhere.
const ROUNDS: usize = 3;
/// Rounds in which step and weights of the clusters follow each other.
///
/// Convention: a cap on a fixed point that is reached sooner.
const INFLATION_ROUNDS: usize = 6;
/// The share of the prior's information that stands for none, where the frames have none.
///
/// Convention: far below what any frame tells, far above rounding.
const LEAST_OF_PRIOR: f64 = 1e-6;
/// How far from the outline edges are searched for, px, ...
///
/// Convention: as the last stage of a measurement.
const SEARCH_PX: f64 = 3.0;
/// ... and how a frame's bend is fitted with a shape of its own, ...
///
/// Convention: as the fine stage of a measurement, which it comes from.
const SHAPE: FitSchedule =
    FitSchedule { searches_px: &[SEARCH_PX], rounds: 2, converged_rad: 2e-5, ..FitSchedule::FINE };
/// ... and follows in a round.
///
/// Derived: what of the bend is not followed yet is eliminated, so that one round is enough for a Gauss–Newton step of all.
const FOLLOWING: FitSchedule = FitSchedule { rounds: 1, ..SHAPE };

/// What all frames of a sequence share: the camera's pose (see [`perturbed`]) and the edges' biases (px).
///
/// Convention: a count.
const SHARED: usize = 6 + BIASES;
type Shared = SVector<f64, SHARED>;
type SharedInformation = SMatrix<f64, SHARED, SHARED>;

/// What some edges say of what all frames share: JᵗJ as if they were independent, and Jᵗr.
#[derive(Debug, Clone, Copy)]
struct NormalEquations {
    information: SharedInformation,
    slope: Shared,
}

/// What one frame says of what all share, its own bend being free.
#[derive(Debug, Clone)]
struct SharedEvidence {
    /// By the clusters of edges that err alike ([`Piece::cluster`]).
    clusters: BTreeMap<Piece, NormalEquations>,
    /// Jᵗr of each of [`Correspondences::systematic_modes`].
    modes: Vec<Shared>,
    /// See [`excess`].
    excess: f64,
}

/// The picture around the snake in one frame, in the channel that shows it; what lies further away is not kept.
pub struct SnakePlane {
    pub plane: Plane,
    /// The noise of the whole picture, σ of a pixel.
    pub noise: f64,
}

/// A rig refined from frames, each as the plane that shows the snake and the fit that its bend starts from. `None` where too few frames can be fitted, or they do not determine what they share.
pub fn refined_rig(
    lens: &Lens,
    robot: &Robot,
    calibrated: &Rig,
    planes: &[SnakePlane],
    mut starts: Vec<Start>,
) -> Option<Rig> {
    let prior = Prior::new(calibrated, noise_model().frame_bias_sigma())?;
    let follow = |rig: &Rig, SnakePlane { plane, noise }: &SnakePlane, start: &mut Start, schedule: &FitSchedule| {
        let view = Projection { lens, camera_from_base: rig.camera_from_base, robot };
        let finder = EdgeFinder::with_noise(plane, rig.appearance.two_sided, *noise);
        start.state.bias = rig.edge_bias;
        let fit = fit_bend(&view, &finder, start.clone(), rig.prior(), schedule)?;
        *start = fit.start();
        Some(fit)
    };
    // What was fitted under the prior of any snake says how far this one departs from an arc, and no more.
    let with_shape = planes.par_iter().zip(&mut starts);
    let with_shape: Vec<BendFit> =
        with_shape.filter_map(|(frame, start)| follow(calibrated, frame, start, &SHAPE)).collect();
    if with_shape.len() < FEWEST_FRAMES {
        return None;
    }
    let mode_sigma_rad = learned_mode_sigmas(&with_shape, &calibrated.pose_covariance);
    let mut rig = Rig { mode_sigma_rad, ..calibrated.clone() };
    let mut moved = Shared::zeros();
    for _ in 0..ROUNDS {
        let evidence = |(frame, start): (&SnakePlane, &mut Start)| {
            let fit = follow(&rig, frame, start, &FOLLOWING)?;
            shared_evidence(lens, robot, &rig, frame, &fit, planes.len())
        };
        let evidence: Vec<SharedEvidence> = planes.par_iter().zip(&mut starts).filter_map(evidence).collect();
        if evidence.len() < FEWEST_FRAMES {
            return None;
        }
        let (step, covariance) = prior.combined(&moved, &evidence)?;
        moved += step;
        rig = Rig { mode_sigma_rad, ..moved_rig(calibrated, &moved, &covariance) };
    }
    Some(rig)
}

/// The rig after a motion of the camera and a change of the biases, with this covariance of both.
fn moved_rig(rig: &Rig, by: &Shared, covariance: &SharedInformation) -> Rig {
    Rig {
        camera_from_base: perturbed(&rig.camera_from_base, &by.fixed_rows::<6>(0).into_owned()),
        pose_covariance: covariance.fixed_view::<6, 6>(0, 0).into_owned(),
        edge_bias: rig.edge_bias.moved(&by.as_slice()[6..]),
        ..rig.clone()
    }
}

/// Looks at a frame whose bend is known nearly, and lets the bend follow pose and bias.
///
/// Edges of the holder count for what one of so many `frames` adds to them: but for noise they err alike in the straight picture and in every frame, since
/// light and camera stay, and the straight picture's pose has that already.
///
/// `None` where the edges do not determine the bend.
fn shared_evidence(
    lens: &Lens,
    robot: &Robot,
    rig: &Rig,
    SnakePlane { plane, noise }: &SnakePlane,
    fit: &BendFit,
    frames: usize,
) -> Option<SharedEvidence> {
    let view = &Projection { lens, camera_from_base: rig.camera_from_base, robot };
    let finder = EdgeFinder::with_noise(plane, rig.appearance.two_sided, *noise);
    let (prior, state) = (rig.prior(), &State { profile: fit.profile, bias: rig.edge_bias });
    let mut outline = Outline::new(view, state.profile);
    let filters = Filters::fine(&finder, fit.blur.clone());
    filters.predict(&mut outline);
    let edges = Correspondences::find(&outline, &filters, SEARCH_PX, |_| true);
    let residuals = edges.residuals(view, state.profile, state.bias);
    let roots = RobustPhase::Redescending.roots(&residuals);
    let (_, scatter_px) = inliers(&edges.in_px(&residuals), &roots);
    let counted: Vec<f64> = roots.iter().zip(edges.roots_of_news(frames)).map(|(root, news)| root * news).collect();
    let Linearised { residuals, by_state, by_pose } = Linearised::new(&edges, view, state, &counted, None);
    let excess = excess(&residuals, &counted);
    let (bend, bias) = (by_state.columns(0, PROFILE).into_owned(), by_state.columns(PROFILE, BIASES));
    let shared =
        DMatrix::from_fn(by_pose.nrows(), SHARED, |r, c| if c < 6 { by_pose[(r, c)] } else { bias[(r, c - 6)] });
    let known = prior.rows(state).map(|(_, root)| root * root);
    let precision = DVector::from_fn(PROFILE, |k, _| k.checked_sub(2).map_or(0.0, |k| known[k]));
    let projected = without(&shared, &bend, &precision)?;
    let row = |row: usize| Shared::from_iterator(projected.row(row).iter().copied());
    let mut clusters: BTreeMap<Piece, NormalEquations> = BTreeMap::new();
    for (k, cluster) in edges.clusters().enumerate() {
        clusters.entry(cluster).or_insert_with(NormalEquations::none).add_row(&row(k), residuals[k]);
    }
    let modes = edges.systematic_modes(view, &counted, scatter_px);
    let modes = modes.iter().map(|mode| Shared::from_iterator(projected.tr_mul(mode).iter().copied()));
    Some(SharedEvidence { clusters, modes: modes.collect(), excess })
}

/// The columns of `shared` without what the columns of `own` could have done as well, whose parameters are known beforehand to
/// this `precision`: without any, the projection onto the orthogonal complement. `None` where the latter are linearly dependent.
fn without(shared: &DMatrix<f64>, own: &DMatrix<f64>, precision: &DVector<f64>) -> Option<DMatrix<f64>> {
    let information = own.tr_mul(own) + DMatrix::from_diagonal(precision);
    Some(shared - own * information.cholesky()?.solve(&own.tr_mul(shared)))
}

impl NormalEquations {
    /// Of no edges.
    fn none() -> Self {
        Self { information: SharedInformation::zeros(), slope: Shared::zeros() }
    }

    fn add_row(&mut self, row: &Shared, residual: f64) {
        self.information += row * row.transpose();
        self.slope += row * residual;
    }

    fn add(&mut self, other: &Self) {
        self.information += other.information;
        self.slope += other.slope;
    }
}

/// What the straight picture told of what all frames share.
struct Prior {
    information: SharedInformation,
}

impl Prior {
    /// `None` where the rig's pose covariance is not positive definite.
    fn new(rig: &Rig, bias_sigma: [f64; BIASES]) -> Option<Self> {
        let pose: Matrix6<f64> = rig.pose_covariance.cholesky()?.inverse();
        let information = SharedInformation::from_fn(|r, c| match (r < 6, c < 6) {
            (true, true) => pose[(r, c)],
            _ if r == c => bias_sigma[r - 6].powi(-2),
            _ => 0.0,
        });
        Some(Self { information })
    }

    /// The next step after `moved` from all evidence and this prior, and the covariance after it.
    ///
    /// Errors along one piece of the body are the same in every frame (they share its shading), so pieces, not edges and not
    /// frames, are the clusters: their information counts as much less as their scores scatter more than they should. What edges in all frames scatter more
    /// than they may widens the covariance as it does a frame's.
    fn combined(&self, moved: &Shared, evidence: &[SharedEvidence]) -> Option<(Shared, SharedInformation)> {
        let mut clusters: BTreeMap<Piece, NormalEquations> = BTreeMap::new();
        for (piece, equations) in evidence.iter().flat_map(|e| &e.clusters) {
            clusters.entry(*piece).or_insert_with(NormalEquations::none).add(equations);
        }
        let (parameters, count) = (SHARED as f64, clusters.len() as f64);
        if count <= parameters {
            return None;
        }
        let mut all = NormalEquations::none();
        clusters.values().for_each(|cluster| all.add(cluster));
        // Where no face is seen at a glancing angle, the edges say nothing of what it mirrors.
        let alone = (all.information + self.information * LEAST_OF_PRIOR).cholesky()?.inverse();
        let determined = (alone * all.information).trace();
        let modes = evidence.first().map_or(0, |e| e.modes.len());
        let modes = (0..modes).map(|mode| evidence.iter().map(|e| e.modes[mode]).sum::<Shared>());
        let systematic: SharedInformation = modes.map(|slope| slope * slope.transpose()).sum();
        let excess = mean(evidence.iter().map(|e| e.excess));
        let mut step = -alone * all.slope;
        let mut covariance = alone;
        for _ in 0..INFLATION_ROUNDS {
            let scores = clusters.values().map(|cluster| cluster.slope + cluster.information * step);
            let meat = scores.map(|s| s * s.transpose()).sum::<SharedInformation>() * (count / (count - parameters));
            let inflation = ((alone * meat).trace() / determined).max(1.0) * excess;
            let bread = (self.information + all.information / inflation).cholesky()?.inverse();
            step = -bread * (self.information * moved + all.slope / inflation);
            covariance = bread * (self.information + (meat + systematic) * (excess / inflation.powi(2))) * bread;
        }
        Some((step, covariance))
    }
}

#[cfg(test)]
mod tests {
    use super::super::parameters::tests::rig;
    use super::*;
    use rand::{RngExt, SeedableRng, rngs::StdRng};
    use rand_distr::{Distribution, Normal};

    #[test]
    fn what_a_frames_own_bend_could_do_is_no_evidence() {
        let own = DMatrix::from_fn(7, 2, |r, c| ((r + 1) as f64).powi(c as i32));
        let shared = DMatrix::from_fn(7, 3, |r, c| ((r * (c + 2)) as f64).sin());
        let left = without(&shared, &own, &DVector::zeros(2)).unwrap();
        assert!(own.tr_mul(&left).amax() < 1e-12);
        // The same least squares: the shared parameters of a joint fit and those of the projected rows.
        let seen = nalgebra::DVector::from_fn(7, |r, _| (r as f64).cos());
        let both = DMatrix::from_fn(7, 5, |r, c| if c < 3 { shared[(r, c)] } else { own[(r, c - 3)] });
        let joint = both.tr_mul(&both).cholesky().unwrap().solve(&both.tr_mul(&seen));
        let alone = left.tr_mul(&left).cholesky().unwrap().solve(&left.tr_mul(&seen));
        assert!((joint.rows(0, 3) - alone).amax() < 1e-9);
    }

    /// Evidence of frames with this true motion, each cluster of which errs by a common amount beside its edges' noise.
    fn evidence(truth: &Shared, common_sigma: f64, seed: u64) -> Vec<SharedEvidence> {
        let mut random = StdRng::seed_from_u64(seed);
        let noise = Normal::new(0.0, 1.0).unwrap();
        let pieces: Vec<Piece> = (1..=20).flat_map(|k| [Piece::Rim(k, true), Piece::Rim(k, false)]).collect();
        let common: Vec<f64> = pieces.iter().map(|_| common_sigma * noise.sample(&mut random)).collect();
        let frame = |random: &mut StdRng| {
            let mut clusters = BTreeMap::new();
            for (piece, common) in pieces.iter().zip(&common) {
                let mut equations = NormalEquations::none();
                for _ in 0..6 {
                    let row = Shared::from_fn(|_, _| random.random_range(-30.0..30.0));
                    // r = J (x − truth) + errors, at x = 0.
                    equations.add_row(&row, -row.dot(truth) + common + noise.sample(random));
                }
                clusters.insert(*piece, equations);
            }
            SharedEvidence { clusters, modes: Vec::new(), excess: 1.0 }
        };
        (0..8).map(|_| frame(&mut random)).collect()
    }

    /// A prior of unit variances, and what frames are to tell.
    fn unit_prior_and_truth() -> (Prior, Shared) {
        let rig = Rig { pose_covariance: Matrix6::identity(), ..rig() };
        (Prior::new(&rig, [1.0; BIASES]).unwrap(), Shared::from_fn(|r, _| 0.01 * (r as f64 - 4.0)))
    }

    #[test]
    fn frames_tell_what_they_share_with_the_covariance_that_they_state() {
        let (prior, truth) = unit_prior_and_truth();
        for common_sigma in [0.0, 1.0] {
            let normalised = (0..100).map(|seed| {
                let (step, covariance) =
                    prior.combined(&Shared::zeros(), &evidence(&truth, common_sigma, seed)).unwrap();
                let off = step - truth;
                off.dot(&covariance.cholesky().unwrap().solve(&off)) / SHARED as f64
            });
            let chi2 = mean(normalised);
            // 900 degrees of freedom tell it to 5 %; 40 clusters tell their own scatter less well, which makes it larger.
            assert!((0.8..1.6).contains(&chi2), "common error {common_sigma}: {chi2}");
        }
    }

    #[test]
    fn edges_that_scatter_more_than_they_may_leave_as_much_wider_a_covariance() {
        let (prior, truth) = unit_prior_and_truth();
        let as_told = evidence(&truth, 1.0, 1);
        let more: Vec<_> = as_told.iter().map(|e| SharedEvidence { excess: 4.0, ..e.clone() }).collect();
        let traces = [&as_told, &more].map(|e| prior.combined(&Shared::zeros(), e).unwrap().1.trace());
        // The prior tells little beside eight frames, so that four times the variance is nearly all of it.
        assert!((3.5..4.05).contains(&(traces[1] / traces[0])), "{traces:?}");
    }

    #[test]
    fn what_no_frame_tells_keeps_its_prior_and_the_rest_is_told() {
        let (prior, truth) = unit_prior_and_truth();
        let mut evidence = evidence(&truth, 0.0, 1);
        for equations in evidence.iter_mut().flat_map(|frame| frame.clusters.values_mut()) {
            // What was displaced by the last parameter is no more.
            equations.slope += equations.information.column(SHARED - 1) * truth[SHARED - 1];
            equations.information.column_mut(SHARED - 1).fill(0.0);
            equations.information.row_mut(SHARED - 1).fill(0.0);
            equations.slope[SHARED - 1] = 0.0;
        }
        let (step, covariance) = prior.combined(&Shared::zeros(), &evidence).unwrap();
        assert!(step[SHARED - 1].abs() < 1e-9 && (covariance[(SHARED - 1, SHARED - 1)] - 1.0).abs() < 1e-9);
        let off = (step - truth).rows(0, SHARED - 1).amax();
        assert!(off < 0.01, "{off}");
    }

    #[test]
    fn a_prior_that_is_sure_is_not_moved() {
        let mut rig = rig();
        rig.pose_covariance = Matrix6::from_diagonal_element(1e-14);
        let prior = Prior::new(&rig, [1e-7; BIASES]).unwrap();
        let truth = Shared::from_element(0.01);
        let (step, _) = prior.combined(&Shared::zeros(), &evidence(&truth, 0.0, 1)).unwrap();
        assert!(step.norm() < 1e-6, "{step}");
    }

    #[test]
    fn a_moved_rig_has_its_pose_perturbed_and_its_biases_shifted() {
        let mut by = Shared::zeros();
        by[5] = 2.0;
        by[7] = 0.1;
        let moved = moved_rig(&rig(), &by, &SharedInformation::identity());
        assert_eq!(moved.camera_from_base.translation.z, rig().camera_from_base.translation.z + 2.0);
        assert_eq!(moved.edge_bias.tube_px, rig().edge_bias.tube_px + 0.1);
        assert_eq!(moved.pose_covariance, Matrix6::identity());
    }
}
