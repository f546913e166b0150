//! The fit of the noise model's numbers: those that make the errors of rigs whose bends are known likeliest.
//!
//! A rig's bends share its error, so that all its errors are one vector with one covariance. Its density is Student's t in place of normal: what one
//! material or light does to all edges of a rig, and the model does not know, must not widen all others. Experiments beside each other in one folder are
//! of one kind, and each kind counts alike, however many it has: what is compared is the sum over the kinds of the mean of ln L over their bends.

use super::{FITTED, NoiseModel};
use crate::camera::read_frame;
use crate::measure::{Eye, RigOptions, calibrate_rig};
use crate::record::{Experiment, RigSource, read_model};
use crate::robot::Model;
use nalgebra::{DMatrix, DVector, Matrix2, Matrix2x6, Vector2};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{PoisonError, RwLock};

/// Degrees of freedom of the t of one rig's errors.
const FREEDOM: f64 = 6.0;
/// What a bend that is not measured costs: a model that loses what it cannot explain is no better one.
///
/// Convention: as much as an error of 4.9 σ (½ · 4.9² = 12).
const LOST: f64 = 12.0;
/// What a straight picture that is refused costs.
///
/// Convention: as much as four of its bends.
const REFUSED: f64 = 50.0;
/// The factors by which a number is changed, the coarse one first.
const FACTORS: [f64; 2] = [1.5, 1.2];
/// A change is taken if what is compared grows by more.
const LEAST_GAIN: f64 = 0.02;

static IN_USE: RwLock<NoiseModel> = RwLock::new(FITTED);

/// The noise model in use: the fitted one, unless another is tried.
pub(crate) fn noise_model() -> NoiseModel {
    *IN_USE.read().unwrap_or_else(PoisonError::into_inner)
}

/// A number of the model, by its name.
type Number = (&'static str, fn(&mut NoiseModel) -> &mut f64);

const NUMBERS: [Number; 12] = [
    ("design_effect", |model| &mut model.design_effect),
    ("own_variance", |model| &mut model.own_variance),
    ("pose_variance", |model| &mut model.pose_variance),
    ("frame_bias_px", |model| &mut model.frame_bias_px),
    ("edge_floor_px", |model| &mut model.edge_floor_px),
    ("tube_floor_px", |model| &mut model.tube_floor_px),
    ("rim_mode_px", |model| &mut model.rim_mode_px),
    ("side_mode_px", |model| &mut model.side_mode_px),
    ("side_taper_px", |model| &mut model.side_taper_px),
    ("glare", |model| &mut model.glare),
    ("glare_sd", |model| &mut model.glare_sd),
    ("uneven_glare", |model| &mut model.uneven_glare),
];

/// One error of a bend vector, rad, with its covariance and the part of it that the rig's other bends share.
struct BendError {
    error: Vector2<f64>,
    covariance: Matrix2<f64>,
    by_rig: Matrix2x6<f64>,
    /// The azimuth of the bend, rad.
    delta: f64,
}

/// What came of one rig.
enum Outcome {
    Refused,
    Measured { errors: Vec<BendError>, lost: usize },
}

/// What some rigs of one kind say of a model.
#[derive(Default)]
struct Score {
    log_likelihood: f64,
    bends: usize,
    lost: usize,
    refused: usize,
    /// Squares of the errors along the bend and across it, rad².
    squares: [f64; 2],
    /// The same in units of their variances.
    chi2: [f64; 2],
    within_95: usize,
}

impl Score {
    fn add(&mut self, outcome: &Outcome) {
        let Outcome::Measured { errors, lost } = outcome else {
            self.refused += 1;
            self.log_likelihood -= REFUSED;
            return;
        };
        self.lost += lost;
        self.bends += errors.len();
        self.log_likelihood += log_density(errors) - LOST * *lost as f64;
        for BendError { error, covariance, delta, .. } in errors {
            let along = Vector2::new(delta.cos(), delta.sin());
            for (axis, direction) in [along, Vector2::new(-along.y, along.x)].into_iter().enumerate() {
                let square = error.dot(&direction).powi(2);
                self.squares[axis] += square;
                self.chi2[axis] += square / direction.dot(&(covariance * direction));
            }
            let distance2 = covariance.cholesky().map_or(f64::INFINITY, |root| error.dot(&root.solve(error)));
            // −2 ln 0.05.
            self.within_95 += usize::from(distance2 < 5.991);
        }
    }

    /// The mean of ln L over the bends.
    fn mean(&self) -> f64 {
        self.log_likelihood / (self.bends + self.lost).max(1) as f64
    }

    fn tell(&self) -> String {
        let Self { bends, lost, refused, squares, chi2, within_95, .. } = self;
        let count = (*bends).max(1) as f64;
        let [along, across] = squares.map(|sum| (sum / count).sqrt().to_degrees());
        let [chi2_along, chi2_across] = chi2.map(|sum| sum / count);
        format!(
            "ln L {:.3} a bend; {bends} bends, {lost} lost, {refused} rigs refused; {along:.3}° along, {across:.3}° across, chi² {chi2_along:.2}, \
             {chi2_across:.2}; {:.1} % within 95 %",
            self.mean(),
            100.0 * *within_95 as f64 / count
        )
    }
}

/// What is compared: each kind counts alike.
fn sum_of_means(kinds: &BTreeMap<PathBuf, Score>) -> f64 {
    kinds.values().map(Score::mean).sum()
}

/// ln of the density of one rig's errors, but for a constant of their number.
fn log_density(errors: &[BendError]) -> f64 {
    let size = 2 * errors.len();
    let mut covariance = DMatrix::zeros(size, size);
    for (a, one) in errors.iter().enumerate() {
        for (b, other) in errors.iter().enumerate() {
            let block = if a == b { one.covariance } else { one.by_rig * other.by_rig.transpose() };
            covariance.view_mut((2 * a, 2 * b), (2, 2)).copy_from(&block);
        }
    }
    let error = DVector::from_iterator(size, errors.iter().flat_map(|e| [e.error.x, e.error.y]));
    let Some(root) = covariance.cholesky() else { return f64::NEG_INFINITY };
    let log_determinant = 2.0 * root.l_dirty().diagonal().iter().map(|v| v.ln()).sum::<f64>();
    let distance2 = error.dot(&root.solve(&error));
    -0.5 * log_determinant - 0.5 * (FREEDOM + size as f64) * (distance2 / (FREEDOM - 2.0)).ln_1p()
}

/// The experiments that an environment variable names.
fn experiments(variable: &str) -> Vec<PathBuf> {
    let paths =
        std::env::var_os(variable).unwrap_or_else(|| panic!("{variable} names no experiments; see tools/fit-noise"));
    std::env::split_paths(&paths).collect()
}

/// The true bend vectors, rad, by the frames' indices.
fn truth(experiment: &Path) -> BTreeMap<u64, Vector2<f64>> {
    let mut reader = csv::Reader::from_path(experiment.join("truth.csv")).unwrap();
    let rows = reader.deserialize::<BTreeMap<String, f64>>().map(Result::unwrap);
    rows.map(|row| {
        let delta = row["delta_deg"].to_radians();
        (row["index"] as u64, Vector2::new(delta.cos(), delta.sin()) * row["theta_deg"].to_radians())
    })
    .collect()
}

/// Calibrates, refines and measures one experiment.
fn outcome(folder: &Path) -> Outcome {
    let experiment = Experiment::read(folder).unwrap();
    let view = &experiment.views[0];
    let lens = view.lens().unwrap();
    let robot = experiment.robot.as_ref().map_or_else(Model::default, |file| read_model(file).unwrap()).robot;
    let RigSource::Straight { picture, grid_pitch_mm, standoff_mm } = &view.rig else { panic!("no straight picture") };
    let options = RigOptions {
        grid_pitch_mm: *grid_pitch_mm,
        standoff_mm: *standoff_mm,
        delta_offset: view.delta_offset_deg.to_radians(),
    };
    let Ok(rig) = calibrate_rig(&read_frame(picture).unwrap(), &lens, &robot, &options) else {
        return Outcome::Refused;
    };
    let truth = truth(folder);
    let frames: Vec<(u64, PathBuf)> = std::fs::read_dir(folder.join("frames"))
        .unwrap()
        .map(|entry| {
            let path = entry.unwrap().path();
            let name = path.file_stem().unwrap().to_str().unwrap().to_owned();
            (name.trim_start_matches(|c: char| !c.is_ascii_digit()).parse().unwrap(), path)
        })
        .collect::<BTreeMap<_, _>>()
        .into_iter()
        .collect();
    let read = |(index, path): &(u64, PathBuf)| (*index, read_frame(path).unwrap());
    let frames: Vec<_> = frames.iter().map(read).collect();
    let eye = Eye::new(lens, rig, robot).refined(frames.par_iter().map(|(_, frame)| frame.clone()));
    let error = |(index, frame): &(u64, crate::camera::Frame)| {
        let bend = eye.measure(frame).bend?;
        let (error, delta) = (bend.vector - truth[index], truth[index].y.atan2(truth[index].x));
        Some(BendError { error, covariance: bend.covariance, by_rig: bend.by_rig, delta })
    };
    let errors: Vec<BendError> = frames.iter().filter_map(error).collect();
    Outcome::Measured { lost: frames.len() - errors.len(), errors }
}

/// What experiments say of a model, by the folders that they are in.
fn scores(model: NoiseModel, experiments: &[PathBuf]) -> BTreeMap<PathBuf, Score> {
    *IN_USE.write().unwrap() = model;
    let mut kinds: BTreeMap<PathBuf, Score> = BTreeMap::new();
    for experiment in experiments {
        let kind = experiment.parent().map(Path::to_owned).unwrap_or_default();
        kinds.entry(kind).or_default().add(&outcome(experiment));
    }
    kinds
}

fn tell(half: &str, kinds: &BTreeMap<PathBuf, Score>) {
    println!("{half}: {:.3} in all", sum_of_means(kinds));
    kinds.iter().for_each(|(kind, score)| println!("  {}: {}", kind.display(), score.tell()));
}

#[test]
#[ignore = "fits the noise model, which takes hours: tools/fit-noise"]
fn the_likeliest_noise_model() {
    let (fitted, judged) = (experiments("SNAKELOOP_FITTED"), experiments("SNAKELOOP_JUDGED"));
    let mut model = FITTED;
    let as_it_is = scores(model, &fitted);
    let mut best = sum_of_means(&as_it_is);
    tell("fitted, as it is", &as_it_is);
    tell("judged, as it is", &scores(model, &judged));
    for factor in FACTORS {
        let mut has_changed = true;
        while has_changed {
            has_changed = false;
            for (name, number) in NUMBERS {
                for by in [factor, 1.0 / factor] {
                    let mut other = model;
                    *number(&mut other) *= by;
                    let tried = sum_of_means(&scores(other, &fitted));
                    println!("{name} × {by:.3}: {:+.3}", tried - best);
                    if tried > best + LEAST_GAIN {
                        (model, best, has_changed) = (other, tried, true);
                        break;
                    }
                }
            }
        }
    }
    println!("{model:#?}");
    tell("fitted", &scores(model, &fitted));
    tell("judged", &scores(model, &judged));
}

#[test]
fn the_density_of_a_rigs_errors_is_that_of_student_and_knows_what_they_share() {
    let bend = |error: f64, shared: f64| {
        let mut by_rig = Matrix2x6::zeros();
        by_rig[(0, 0)] = shared;
        let covariance = Matrix2::identity() + by_rig * by_rig.transpose();
        BendError { error: Vector2::new(error, 0.0), covariance, by_rig, delta: 0.0 }
    };
    // t with ν degrees of freedom in two dimensions, of covariance 1: (1 + x²/(ν − 2))^−(ν/2 + 1).
    let alone = log_density(&[bend(2.0, 0.0)]) - log_density(&[bend(0.0, 0.0)]);
    assert!((alone + 4.0 * 2.0f64.ln()).abs() < 1e-12, "{alone}");
    // Two that err alike are likelier if they share an error than if each has its own.
    let alike = |shared| log_density(&[bend(3.0, shared), bend(3.0, shared)]);
    assert!(alike(2.0) > alike(0.0));
}
