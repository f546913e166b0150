//! Against published problems, certified values and closed forms.

use super::*;

fn steps(scale: &[f64]) -> DVector<f64> {
    DVector::from_column_slice(scale) * 1e-6
}

#[test]
fn the_problem_of_rosenbrock_is_solved_from_the_usual_start() {
    // J. J. Moré, B. S. Garbow, K. E. Hillstrom, "Testing Unconstrained Optimization Software", ACM TOMS 7, 1981, no. 1.
    let residuals = |x: &DVector<f64>| DVector::from_column_slice(&[10.0 * (x[1] - x[0] * x[0]), 1.0 - x[0]]);
    let start = DVector::from_column_slice(&[-1.2, 1.0]);
    let found = minimise(residuals, start, &steps(&[1.0, 1.0]), &Options::default()).unwrap();
    assert!((found.parameters - DVector::from_element(2, 1.0)).norm() < 1e-8);
    assert!(found.cost < 1e-16, "{}", found.cost);
}

/// y = b1 (1 − e^{−b2 x}): Misra1a of NIST's Statistical Reference Datasets (StRD), nonlinear regression, with certified
/// values to eleven digits.
const MISRA_1A: [(f64, f64); 14] = [
    (10.07, 77.6),
    (14.73, 114.9),
    (17.94, 141.1),
    (23.93, 190.8),
    (29.61, 239.9),
    (35.18, 289.0),
    (40.02, 332.8),
    (44.82, 378.4),
    (50.76, 434.8),
    (55.05, 477.3),
    (61.01, 536.8),
    (66.40, 593.1),
    (75.47, 689.1),
    (81.78, 760.0),
];

fn misra_1a(x: &DVector<f64>) -> DVector<f64> {
    DVector::from_iterator(14, MISRA_1A.iter().map(|&(y, at)| x[0] * (1.0 - (-x[1] * at).exp()) - y))
}

#[test]
fn nists_misra1a_is_certified_from_both_starts_with_its_standard_deviations() {
    for start in [[500.0, 1e-4], [250.0, 5e-4]] {
        let start = DVector::from_column_slice(&start);
        let found = minimise(misra_1a, start, &steps(&[100.0, 1e-4]), &Options::default()).unwrap();
        assert!((found.parameters[0] / 2.389_421_291_8e2 - 1.0).abs() < 1e-8, "{}", found.parameters);
        assert!((found.parameters[1] / 5.501_564_318_1e-4 - 1.0).abs() < 1e-8);
        assert!((found.cost / 1.245_513_889_4e-1 - 1.0).abs() < 1e-9);
        let variance = found.cost / 12.0;
        let sd = found.covariance().unwrap().diagonal().map(|own| (own * variance).sqrt());
        assert!((sd[0] / 2.707_007_524_1 - 1.0).abs() < 1e-6, "{sd}");
        assert!((sd[1] / 7.266_868_841_7e-6 - 1.0).abs() < 1e-6);
    }
}

#[test]
fn a_minimum_outside_the_bounds_is_found_at_their_edge() {
    // Of Misra1a with b1 held to 230 at most, b2 is the root of the remaining slope.
    let upper = DVector::from_column_slice(&[230.0, 1.0]);
    let options = Options { bounds: Some((DVector::zeros(2), upper)), ..Options::default() };
    let start = DVector::from_column_slice(&[200.0, 5e-4]);
    let found = minimise(misra_1a, start, &steps(&[100.0, 1e-4]), &options).unwrap();
    assert_eq!(found.parameters[0], 230.0);
    let alone = |x: &DVector<f64>| misra_1a(&DVector::from_column_slice(&[230.0, x[0]]));
    let start = DVector::from_element(1, 5e-4);
    let alone = minimise(alone, start, &steps(&[1e-4]), &Options::default()).unwrap();
    assert!((found.parameters[1] / alone.parameters[0] - 1.0).abs() < 1e-7);
    assert!(found.parameters[1] > 5.5e-4);
}

#[test]
fn a_robust_loss_finds_hubers_location() {
    // Huber's estimate of location with limit k solves Σ ψ(y − m) = 0: of 0, 1, 2 and 30 with k = 3, three pull linearly
    // and one with k: 3 m − 3 = 3, so m = 2.
    let values = [0.0, 1.0, 2.0, 30.0];
    let residuals = |x: &DVector<f64>| DVector::from_iterator(4, values.iter().map(|y| x[0] - y));
    let options = Options { loss: Loss::Huber(3.0), ..Options::default() };
    let found = minimise(residuals, DVector::from_element(1, 20.0), &steps(&[1.0]), &options).unwrap();
    assert!((found.parameters[0] - 2.0).abs() < 1e-6, "{}", found.parameters[0]);
}

/// A line with a slope that its own evaluation remembers, and with rows that are left out.
struct Line {
    weights: DVector<f64>,
}

impl Problem for Line {
    /// The residuals, and how many evaluations led here one from the other.
    type Evaluation = (DVector<f64>, usize);

    fn evaluate(&self, x: &DVector<f64>, near: Option<&Self::Evaluation>) -> Option<Self::Evaluation> {
        let residuals = [x[0] - 1.0, x[0] + x[1] - 3.0, x[0] + 2.0 * x[1] - 5.0, x[0] + 3.0 * x[1] - 100.0];
        Some((DVector::from_column_slice(&residuals), near.map_or(0, |near| near.1 + 1)))
    }

    fn residuals(&self, evaluation: &Self::Evaluation) -> DVector<f64> {
        evaluation.0.clone()
    }

    fn jacobian(&self, _: &DVector<f64>, _: &Self::Evaluation) -> DMatrix<f64> {
        DMatrix::from_fn(4, 2, |r, c| if c == 0 { 1.0 } else { r as f64 })
    }

    fn weights(&self) -> Option<&DVector<f64>> {
        Some(&self.weights)
    }
}

#[test]
fn an_evaluation_starts_from_the_one_before_and_a_weight_of_zero_leaves_a_row_out() {
    let line = Line { weights: DVector::from_column_slice(&[1.0, 1.0, 1.0, 0.0]) };
    let found = solve(&line, DVector::zeros(2), &Options::default()).unwrap();
    assert!((found.parameters - DVector::from_column_slice(&[1.0, 2.0])).norm() < 1e-7);
    assert!(found.evaluation.1 > 0);
    assert_eq!(found.residuals.len(), 4, "the row that is left out has its residual");
}

#[test]
fn a_parameter_without_influence_stays_and_what_cannot_be_solved_is_said() {
    let deaf = |x: &DVector<f64>| DVector::from_column_slice(&[x[0] - 2.0, x[0] - 4.0]);
    let start = DVector::from_column_slice(&[0.0, 7.0]);
    let found = minimise(deaf, start, &steps(&[1.0, 1.0]), &Options::default()).unwrap();
    assert!((found.parameters[0] - 3.0).abs() < 1e-7 && found.parameters[1] == 7.0);
    assert!(found.covariance().is_none());

    let one = |x: &DVector<f64>| DVector::from_element(1, x[0] + x[1]);
    let failure = minimise(one, DVector::zeros(2), &steps(&[1.0, 1.0]), &Options::default()).unwrap_err();
    assert_eq!(failure, Failure::TooFewResiduals { residuals: 1, parameters: 2 });
    let nowhere = |_: &DVector<f64>| DVector::from_element(3, f64::NAN);
    let failure = minimise(nowhere, DVector::zeros(2), &steps(&[1.0, 1.0]), &Options::default()).unwrap_err();
    assert_eq!(failure, Failure::NotFinite);
}

/// y = x₀ + x₁ t at three t, of x = (−3, 4): the two parameters change nearly the same.
fn line(x: &DVector<f64>) -> DVector<f64> {
    DVector::from_iterator(3, [0.9, 1.0, 1.1].into_iter().map(|t| x[0] + 3.0 + (x[1] - 4.0) * t))
}

#[test]
fn what_leaves_the_box_is_carried_to_its_edge_and_the_others_follow() {
    let bounds = Some((DVector::repeat(2, -10.0), DVector::from_column_slice(&[10.0, 0.5])));
    let options = Options { bounds, most_iterations: 2, ..Options::default() };
    let found = minimise(line, DVector::zeros(2), &steps(&[1.0, 1.0]), &options).unwrap();
    // With x₁ = 0.5, the mean over t = 1: x₀ = −3 + 3.5. The projected step, (−3, 0.5), would lead uphill.
    assert!((found.parameters[0] - 0.5).abs() < 1e-4 && found.parameters[1] == 0.5, "{}", found.parameters);
}

#[test]
fn no_step_is_longer_than_the_longest() {
    let most_step = Some(DVector::from_column_slice(&[f64::INFINITY, 0.25]));
    for (most_iterations, most) in [(1, 0.25), (3, 0.75)] {
        let options = Options { most_step: most_step.clone(), most_iterations, ..Options::default() };
        let found = minimise(line, DVector::zeros(2), &steps(&[1.0, 1.0]), &options).unwrap();
        assert!((found.parameters[1] - most).abs() < 1e-12, "{}", found.parameters);
    }
}
