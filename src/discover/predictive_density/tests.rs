use super::refit::DEGREES_OF_FREEDOM;
use super::*;
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;

/// Thirty rows of two components, two parameters and a residual, in stretches of five.
fn rows(judged: &Judged) -> Rows<'_> {
    let mut random = StdRng::seed_from_u64(3);
    let mut matrix = || DMatrix::from_fn(3, 30, |_, _| random.sample::<f64, _>(StandardNormal));
    let noise = vec![(0..30).map(|k| 0.1 + 0.01 * f64::from(k)).collect(), vec![0.2; 30]];
    Rows { judged, values: vec![matrix(), matrix()], noise, left: vec![0.9, 0.7] }
}

fn judged() -> Judged {
    let row = |k: usize| Row { sample: k, travel: 0.05 + 0.02 * (k % 3) as f64, stretch: k / 5 };
    let (components, units) = (vec![0, 1], vec![1.0; 2]);
    let kinds = kinds(Beside::Discrepancy);
    Judged { rows: (0..30).map(row).collect(), half_range: 1.0, main_direction: None, components, units, kinds }
}

const KIND: Kind = Kind { length: 0.3, independent: 0.4 };

/// The covariance of a stretch's rows under a discrepancy, written out.
fn covariance(rows: &Rows, stretch: usize, place: usize) -> DMatrix<f64> {
    let places: Vec<f64> = rows
        .judged
        .rows
        .iter()
        .scan(0.0, |at, row| {
            *at += row.travel;
            Some(*at)
        })
        .collect();
    DMatrix::from_fn(5, 5, |a, b| {
        let (a, b) = (5 * stretch + a, 5 * stretch + b);
        let relative = rows.noise[place][a] / rows.noise[place].iter().sum::<f64>() * 30.0;
        let noise = if a == b { KIND.independent * relative } else { 0.0 };
        let shared = (1.0 - KIND.independent) * (-(places[a] - places[b]).abs() / KIND.length).exp();
        rows.left[place] * (shared + noise)
    })
}

#[test]
fn the_filter_whitens_by_the_covariance_of_noise_and_discrepancy() {
    let judged = judged();
    let rows = rows(&judged);
    for place in 0..2 {
        let residuals = rows.values[place].row(2).transpose();
        let likelihoods = rows.likelihoods(place, KIND, &residuals);
        for (stretch, own) in rows.equations(place, KIND).iter().enumerate() {
            let covariance = covariance(&rows, stretch, place);
            let log_determinant = covariance.determinant().ln();
            let values = rows.values[place].columns(5 * stretch, 5).into_owned();
            let products = &values * covariance.try_inverse().unwrap() * values.transpose();
            assert!((&own.products - &products).amax() < 1e-10);
            assert!((own.log_variances - log_determinant).abs() < 1e-10 && own.count == 5.0);
            let [squares, log_variances, count] = likelihoods[stretch];
            assert!((squares - products[(2, 2)]).abs() < 1e-10 && (log_variances - log_determinant).abs() < 1e-10);
            assert_eq!(count, 5.0);
        }
    }
}

#[test]
fn a_stretch_is_foretold_by_the_density_of_students_t_with_the_uncertainty_of_the_parameters() {
    let judged = judged();
    let rows = rows(&judged);
    let white = Kind { length: 1.0, independent: 1.0 };
    let factors = [1.3, 0.6];
    let (mut rest, mut held_out) = (Equations::zero(3), Equations::zero(3));
    for (place, factor) in factors.into_iter().enumerate() {
        for (stretch, own) in rows.equations(place, white).iter().enumerate() {
            if stretch == 2 { held_out.add_scaled(own, factor) } else { rest.add_scaled(own, factor) }
        }
    }
    let refit = Refit::new(&rest, &DVector::repeat(2, 1e-4)).unwrap();
    // Rows of the stretch, each by its own variance.
    let (mut columns, mut log_variances) = (Vec::new(), 0.0);
    for (place, factor) in factors.into_iter().enumerate() {
        for k in 10..15 {
            let variance = factor * rows.left[place] * rows.noise[place][k] / rows.mean_noise(place);
            columns.push(rows.values[place].column(k) / variance.sqrt());
            log_variances += variance.ln();
        }
    }
    let slopes = DMatrix::from_fn(10, 2, |row, column| columns[row][column]);
    let left = DVector::from_fn(10, |row, _| columns[row][2]) + &slopes * &refit.step;
    let spread = DMatrix::identity(10, 10) + &slopes * refit.factor.inverse() * slopes.transpose();
    let squares = left.dot(&(spread.clone().try_inverse().unwrap() * &left));
    let log_determinant = spread.determinant().ln() + log_variances;
    let expected =
        -0.5 * log_determinant - 0.5 * (DEGREES_OF_FREEDOM + 10.0) * (1.0 + squares / DEGREES_OF_FREEDOM).ln();
    assert!((refit.foretells(&held_out).unwrap() - expected).abs() < 1e-9);
}

#[test]
fn of_noise_and_of_a_walk_the_kind_is_learned() {
    let mut random = StdRng::seed_from_u64(5);
    let row = |k: usize| Row { sample: k, travel: 0.05, stretch: k / 50 };
    let mut judged = Judged { rows: (0..300).map(row).collect(), ..judged() };
    judged.components = vec![0];
    let noise: Vec<f64> = (0..300).map(|_| random.sample::<f64, _>(StandardNormal)).collect();
    let kept = (-0.05f64 / 0.45).exp();
    let walk: Vec<f64> = noise
        .iter()
        .scan(0.0, |at, own| {
            *at = kept * *at + (1.0 - kept * kept).sqrt() * own;
            Some(*at)
        })
        .collect();
    for (values, is_walk) in [(&noise, false), (&walk, true)] {
        let values = vec![DMatrix::from_row_slice(1, 300, values)];
        let rows = Rows { judged: &judged, values, noise: vec![vec![1.0; 300]], left: vec![1.0] };
        for Learned { kind, factor } in rows.learned(0, &DVector::zeros(0), 0) {
            let Kind { length, independent } = judged.kinds[kind];
            assert_eq!(independent <= 0.03 && (0.2..=1.0).contains(&length), is_walk, "{length} {independent}");
            assert_eq!(independent == 1.0, !is_walk, "{length} {independent}");
            assert!((0.6..1.7).contains(&factor), "{factor}");
        }
    }
}
