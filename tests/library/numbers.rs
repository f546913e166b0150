//! The estimator's arithmetic over a very long life: against the batch solution, and with a forgetting factor while
//! nothing excites it.

use nalgebra::{Matrix2, Matrix3, Matrix3x6, Matrix3xX, Vector2, Vector3};
use rand::{RngExt, SeedableRng, rngs::StdRng};
use snakeloop::estimate::{Estimator, InformationFilter, LinearisedMeasurement, Options, Verdict, Weighting};
use snakeloop::geometry::Configuration;
use snakeloop::observation::Waypoint;
use snakeloop::robot::Model;
use snakeloop::simulate::{BendingExperiment, Plant, SimulatedEye};

const ETA: f64 = 1.221;
const LAMBDA_MM: f64 = 0.1765;

fn assert_symmetric_and_positive(p: &Matrix2<f64>) {
    assert_eq!(p[(0, 1)], p[(1, 0)]);
    assert!(p.symmetric_eigenvalues().min() > 0.0, "{p}");
}

/// The normal equations over many rows of few kinds: what repeats is counted, so that next to nothing is rounded.
#[derive(Default)]
struct Batch {
    information: Matrix2<f64>,
    right: Vector2<f64>,
}

impl Batch {
    fn add(&mut self, h: &Matrix3xX<f64>, weight: &Matrix3<f64>, rows: u64, sum_of_z: &Vector3<f64>) {
        self.information += h.transpose() * weight * h * rows as f64;
        self.right += h.transpose() * weight * sum_of_z;
    }

    fn assert_agrees_with(&self, x: &Vector2<f64>, p: &Matrix2<f64>) {
        let covariance = self.information.try_inverse().unwrap();
        let expected = covariance * self.right;
        let (in_x, in_p) = ((x - expected).norm() / expected.norm(), (p - covariance).norm() / covariance.norm());
        println!("relative distance from batch: x̂ {in_x:.1e}, P {in_p:.1e}");
        assert!(in_x < 1e-6 && in_p < 1e-6, "{in_x} {in_p}");
    }
}

/// x̂ and P of η and λ.
fn of_filter(filter: &InformationFilter) -> (Vector2<f64>, Matrix2<f64>) {
    let (x, p) = filter.solution().unwrap();
    (x.fixed_rows::<2>(0).into_owned(), p.fixed_view::<2, 2>(0, 0).into_owned())
}

/// Whole multiples of 2⁻⁴⁰ mm, whose sums over 10⁷ rows are exact.
fn on_a_grid(value: f64) -> f64 {
    let steps = 2f64.powi(40);
    (value * steps).round() / steps
}

#[test]
fn ten_million_rows_are_the_batch_solution() {
    let mut random = StdRng::seed_from_u64(1);
    let x = Vector2::new(ETA, LAMBDA_MM);
    let mut kinds: Vec<(LinearisedMeasurement, u64, Vector3<f64>)> = (0..97)
        .map(|_| {
            let elastic = Vector3::from_fn(|_, _| random.random_range(-0.3..0.3));
            let h = Matrix3xX::from_columns(&[elastic, Vector3::repeat(1.0)]);
            // The camera's noise along the bend is a hundred times that of the encoders.
            let along = elastic * random.random_range(0.1..1.0);
            let covariance = Matrix3::identity() * 0.0015f64.powi(2) + along * along.transpose();
            (
                LinearisedMeasurement { z: Vector3::zeros(), h, covariance, by_rig: Matrix3x6::zeros() },
                0,
                Vector3::zeros(),
            )
        })
        .collect();
    let mut filter = InformationFilter::default();
    for k in 0..10_000_000 {
        let kind = k % kinds.len();
        let (row, rows, sum_of_z) = &mut kinds[kind];
        let noise = Vector3::from_fn(|_, _| random.random_range(-0.01..0.01));
        row.z = (&row.h * x + noise).map(on_a_grid);
        *rows += 1;
        *sum_of_z += row.z;
        filter.absorb(row);
        if k % 1_000_000 == 999_999 {
            assert_symmetric_and_positive(&of_filter(&filter).1);
        }
    }
    assert_eq!(filter.measurements(), 10_000_000);
    let mut batch = Batch::default();
    for (row, rows, sum_of_z) in &kinds {
        batch.add(&row.h, &row.covariance.try_inverse().unwrap(), *rows, sum_of_z);
    }
    let (found, p) = of_filter(&filter);
    batch.assert_agrees_with(&found, &p);
}

fn plant() -> Plant {
    let mut model = Model::default();
    // Friction constants taken for exact: the rows are the only source of uncertainty.
    (model.friction.sd_mu, model.friction.sd_static_force_n) = (0.0, 0.0);
    Plant { model: Model { eta: ETA, lambda_mm: LAMBDA_MM, samples: Some(0), ..model }, sd_encoder_mm: 0.0015 }
}

fn naive() -> Model {
    plant().model.without_estimate()
}

/// The paper's form of the whole estimator (start, gate, consistency) over many updates, against batch least squares.
fn estimator_against_batch(updates: usize) {
    let samples = plant().run(&BendingExperiment { jitter_deg: 1.5, ..Default::default() }.waypoints().unwrap(), 3);
    let measurements = SimulatedEye::default().observe(&samples, 4);
    let start = naive();
    let options = Options { weighting: Weighting::Flat { sigma_deg: 1.0 }, gate: f64::INFINITY, ..Options::default() };
    let mut estimator = Estimator::new(&start, options).unwrap();
    let mut counts = vec![0u64; samples.len()];
    for k in 0..updates {
        let kind = k % samples.len();
        let step = estimator.update(&measurements[kind], Some(&samples[kind].reading));
        assert_eq!(step.verdict, Verdict::Used);
        counts[kind] += 1;
        if k % (updates / 10) == updates / 10 - 1 {
            assert_symmetric_and_positive(&step.estimate.unwrap().covariance);
        }
    }
    let sigma_mm = start.robot.backbone_circle_radius_mm * 1f64.to_radians();
    let weight = Matrix3::identity() / sigma_mm.powi(2);
    let mut batch = Batch::default();
    for ((measurement, sample), &rows) in measurements.iter().zip(&samples).zip(&counts) {
        // Eq. 20 from the model's own q, τ and ε_0.
        let psi = measurement.measured.unwrap().configuration;
        let z = sample.reading.q_mm - start.robot.joint_displacements(psi) - start.epsilon_fixed();
        let elastic = start.robot.actuation_forces(psi.bend_vector(), None) * start.line_compliance_mm_per_n();
        let h = Matrix3xX::from_columns(&[Vector3::from_column_slice(&elastic), Vector3::repeat(1.0)]);
        batch.add(&h, &weight, rows, &(Vector3::from_column_slice(&z) * rows as f64));
    }
    let found = estimator.model().estimate().unwrap();
    // What is published is P inflated by what the residuals show; x̂ is as it is.
    let p = batch.information.try_inverse().unwrap();
    batch.assert_agrees_with(&Vector2::new(found.eta, found.lambda_mm), &p);
    assert_eq!(found.samples, updates);
}

#[test]
fn a_million_updates_of_the_estimator_are_the_batch_solution() {
    estimator_against_batch(1_000_000);
}

#[test]
#[ignore = "takes ten times as long as the million above, and is the same test"]
fn ten_million_updates_of_the_estimator_are_the_batch_solution() {
    estimator_against_batch(10_000_000);
}

#[test]
fn forgetting_does_not_wind_up_while_nothing_moves() {
    let bending = plant().run(&BendingExperiment { jitter_deg: 1.5, ..Default::default() }.waypoints().unwrap(), 3);
    let eye = SimulatedEye { sigma_theta_deg: 0.1, sigma_across_deg: 0.1 };
    let measured = eye.observe(&bending, 4);
    for (forgetting, theta_deg) in [(0.9, 0.0), (0.99, 0.0), (0.999, 0.0), (1.0, 0.0), (0.99, 0.3), (0.99, 30.0)] {
        let mut estimator = Estimator::new(&naive(), Options { forgetting, ..Options::default() }).unwrap();
        let excite = |estimator: &mut Estimator| {
            for (measurement, sample) in measured.iter().zip(&bending) {
                estimator.update(measurement, Some(&sample.reading));
            }
            estimator.model().estimate().unwrap()
        };
        excite(&mut estimator);
        // The snake stands still for a long time; the camera goes on measuring, with its noise.
        let configuration = Configuration::from_degrees(theta_deg, 20.0);
        let still: Vec<_> = (0..30_000).map(|k| Waypoint::new(f64::from(k), configuration)).collect();
        let still = plant().run(&still, 7);
        let (mut widest, mut farthest) = (0f64, 0f64);
        for (measurement, sample) in eye.observe(&still, 8).iter().zip(&still) {
            let estimate = estimator.update(measurement, Some(&sample.reading)).estimate.unwrap();
            assert_symmetric_and_positive(&estimate.covariance);
            widest = widest.max(estimate.sd_eta());
            farthest = farthest.max((estimate.eta - ETA).abs() / estimate.sd_eta());
        }
        let says = format!(
            "factor {forgetting}, θ = {theta_deg}°: sd of η at most {widest:.3}, η off by at most {farthest:.1} sd"
        );
        println!("{says}");
        // Forgetting ends at an sd of 0.5. The scatter of the last few residuals, ten at a factor of 0.9, is put on top.
        assert!(widest < 3.0 && farthest < 6.0, "{says}");
        let after = excite(&mut estimator);
        assert!((after.eta - ETA).abs() < 4.0 * after.sd_eta() && after.sd_eta() < 0.004, "{says}; then {after:?}");
    }
}
