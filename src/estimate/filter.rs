//! The recursion of Eq. 19 in square-root information form.
//!
//! The filter keeps the upper triangle U and y with UᵗU = Σ HᵗR⁻¹H and Uᵗy = Σ HᵗR⁻¹z over all rows so far; a new row, whitened by its
//! own covariance R, is stacked below and the triangle restored by orthogonal rotations (Bierman, *Factorization Methods for
//! Discrete Sequential Estimation*, 1977, ch. V). Eq. 19's P_k = (HᵗH)⁻¹ over all rows so far is U⁻¹U⁻ᵗ, symmetric and positive by
//! construction, and x̂ = U⁻¹y is what Eq. 19 arrives at. There is no prior: the first rows alone make the first estimate.

use super::Row;
use nalgebra::{Matrix2, Matrix2x3, Matrix3, SMatrix, Vector2};

/// The largest standard deviation of η, and of λ in mm, that counts as knowing them: an estimate with more is none.
const KNOWN_SD: f64 = 1.0;
/// The standard deviation, likewise, at which fading memory stops to forget.
const FADED_SD: f64 = 0.5;

/// What all rows so far say about x = (η, λ).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Filter {
    upper: Matrix2<f64>,
    y: Vector2<f64>,
    rows: usize,
}

impl Default for Filter {
    /// Nothing known.
    fn default() -> Self {
        Self { upper: Matrix2::zeros(), y: Vector2::zeros(), rows: 0 }
    }
}

impl Filter {
    /// What these rows say together.
    pub fn of<'a>(rows: impl IntoIterator<Item = &'a Row>) -> Self {
        rows.into_iter().fold(Self::default(), |mut filter, row| {
            filter.absorb(row);
            filter
        })
    }

    /// Adds a row. One whose covariance is not positive definite, or whose numbers or their squares are not all finite, says
    /// nothing and changes nothing.
    pub fn absorb(&mut self, row: &Row) {
        let Some(factor) = row.covariance.cholesky() else { return };
        let whitened_h = factor.l_dirty().solve_lower_triangular(&row.h);
        let whitened_z = factor.l_dirty().solve_lower_triangular(&row.z);
        let (Some(h), Some(z)) = (whitened_h, whitened_z) else { return };
        let mut stacked = SMatrix::<f64, 5, 3>::zeros();
        stacked.fixed_view_mut::<2, 2>(0, 0).copy_from(&self.upper);
        stacked.fixed_view_mut::<2, 1>(0, 2).copy_from(&self.y);
        stacked.fixed_view_mut::<3, 2>(2, 0).copy_from(&h);
        stacked.fixed_view_mut::<3, 1>(2, 2).copy_from(&z);
        let triangle = stacked.qr().r();
        // Where the row, or the square of a number in it, is not finite.
        if !triangle.iter().all(|value| value.is_finite()) {
            return;
        }
        self.restore(triangle);
        self.rows += 1;
    }

    /// Adds what other rows say: UᵗU and Uᵗy of both are summed, so that the order of rows and of parts makes no difference but
    /// rounding.
    pub fn join(&mut self, other: &Self) {
        let mut stacked = SMatrix::<f64, 4, 3>::zeros();
        for (at, part) in [(0, &*self), (2, other)] {
            stacked.fixed_view_mut::<2, 2>(at, 0).copy_from(&part.upper);
            stacked.fixed_view_mut::<2, 1>(at, 2).copy_from(&part.y);
        }
        self.restore(stacked.qr().r());
        self.rows += other.rows;
    }

    fn restore(&mut self, triangle: Matrix3<f64>) {
        self.upper = triangle.fixed_view::<2, 2>(0, 0).into();
        self.y = triangle.fixed_view::<2, 1>(0, 2).into();
    }

    /// Fading memory: scales all information so far by `keep` in (0, 1], except along directions where so little is known
    /// that forgetting more would leave nothing. However long nothing excites a direction, the largest eigenvalue of P
    /// grows to `FADED_SD`² and stays there, or where it was if it was above. x̂ does not move.
    ///
    /// With U = W S Vᵗ, both sides of U x = y are multiplied by D Wᵗ, D being what is kept of each singular value. Nothing is
    /// squared, so what is barely known survives beside what is known 10⁸ times better.
    pub fn fade(&mut self, keep: f64) {
        let svd = self.upper.svd(true, false);
        let Some(w) = svd.u else { return };
        let kept = svd.singular_values.map(|value| keep.sqrt().max((1.0 / (FADED_SD * value)).min(1.0)));
        let faded = Matrix2::from_diagonal(&kept) * w.transpose();
        let both = faded * Matrix2x3::from_columns(&[self.upper.column(0), self.upper.column(1), self.y.column(0)]);
        let triangle = both.qr().r();
        self.upper = triangle.fixed_view::<2, 2>(0, 0).into();
        self.y = triangle.fixed_view::<2, 1>(0, 2).into();
    }

    /// x̂ and P, without inflation; `None` while the rows do not pin both parameters.
    pub fn solution(&self) -> Option<(Vector2<f64>, Matrix2<f64>)> {
        let inverse = self.upper.solve_upper_triangular(&Matrix2::identity())?;
        let covariance = inverse * inverse.transpose();
        let known = covariance.diagonal().iter().all(|variance| *variance < KNOWN_SD.powi(2));
        known.then(|| (inverse * self.y, covariance))
    }

    /// How many rows were added.
    pub fn rows(&self) -> usize {
        self.rows
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix3x2, Vector3};
    use proptest::prelude::*;

    fn any_row() -> impl Strategy<Value = Row> {
        (proptest::array::uniform3(-2.0..2.0f64), proptest::array::uniform3(-1.0..1.0f64), 1e-3..1.0f64).prop_map(
            |(z, elastic, sd)| {
                let h = Matrix3x2::from_columns(&[Vector3::from(elastic), Vector3::repeat(1.0)]);
                let skew = Vector3::from(elastic) * sd;
                Row { z: z.into(), h, covariance: Matrix3::identity() * sd.powi(2) + skew * skew.transpose() }
            },
        )
    }

    /// The normal equations over all rows at once, in plain form.
    fn batch(rows: &[Row], keep: f64) -> (Vector2<f64>, Matrix2<f64>) {
        let mut information = Matrix2::zeros();
        let mut right = Vector2::zeros();
        for (age, row) in rows.iter().rev().enumerate() {
            let weight = row.covariance.try_inverse().unwrap() * keep.powi(age as i32);
            information += row.h.transpose() * weight * row.h;
            right += row.h.transpose() * weight * row.z;
        }
        let covariance = information.try_inverse().unwrap();
        (covariance * right, covariance)
    }

    proptest! {
        #[test]
        fn recursion_and_batch_agree(rows in proptest::collection::vec(any_row(), 2..60)) {
            let (x, covariance) = batch(&rows, 1.0);
            prop_assume!(covariance.diagonal().max() < 0.9);
            let (ours, p) = Filter::of(&rows).solution().unwrap();
            prop_assert!((ours - x).norm() <= 1e-9 * x.norm(), "{ours} {x}");
            prop_assert!((p - covariance).norm() <= 1e-9 * covariance.norm());
        }

        #[test]
        fn parts_joined_in_any_order_are_the_recursion_over_all(
            rows in proptest::collection::vec(any_row(), 4..60), parts in 1..9usize
        ) {
            let whole = Filter::of(&rows);
            let Some((x, covariance)) = whole.solution() else { return Ok(()) };
            prop_assume!(covariance.diagonal().max() < 0.9);
            let mut joined = Filter::default();
            for part in (0..parts).rev() {
                joined.join(&Filter::of(rows.iter().skip(part).step_by(parts)));
            }
            let (ours, p) = joined.solution().unwrap();
            prop_assert!((ours - x).norm() <= 1e-9 * x.norm(), "{ours} {x}");
            prop_assert!((p - covariance).norm() <= 1e-9 * covariance.norm());
            prop_assert_eq!(joined.rows(), whole.rows());
        }

        #[test]
        fn fading_memory_is_a_batch_with_fading_weights(rows in proptest::collection::vec(any_row(), 20..60)) {
            let keep = 0.95;
            let mut filter = Filter::default();
            for row in &rows {
                filter.fade(keep);
                filter.absorb(row);
            }
            let (x, covariance) = batch(&rows, keep);
            prop_assume!(covariance.diagonal().max() < 0.5);
            let (ours, p) = filter.solution().unwrap();
            // The floor of what is kept plays a part only while next to nothing is known.
            prop_assert!((ours - x).norm() < 0.05 * (1.0 + x.norm()));
            prop_assert!((p - covariance).norm() < 0.3 * covariance.norm());
        }

        #[test]
        fn the_covariance_stays_symmetric_positive_and_bounded(
            rows in proptest::collection::vec(any_row(), 2..20), keep in 0.01..0.999f64
        ) {
            // After some rows, a long time in which only λ is excited.
            let mut filter = Filter::of(&rows);
            prop_assume!(filter.solution().is_some_and(|(_, p)| p.symmetric_eigenvalues().max() < FADED_SD.powi(2)));
            for _ in 0..2000 {
                filter.fade(keep);
                filter.absorb(&Row {
                    z: Vector3::repeat(0.2),
                    h: Matrix3x2::from_columns(&[Vector3::zeros(), Vector3::repeat(1.0)]),
                    covariance: Matrix3::identity() * 1e-4,
                });
            }
            let information = filter.upper.transpose() * filter.upper;
            let p = information.try_inverse().unwrap();
            prop_assert!(p[(0, 1)] == p[(1, 0)] || (p[(0, 1)] - p[(1, 0)]).abs() < 1e-12);
            prop_assert!(p.symmetric_eigenvalues().min() > 0.0);
            prop_assert!(p.symmetric_eigenvalues().max() <= (1.0 + 1e-9) * FADED_SD.powi(2), "{p}");
            prop_assert!((filter.upper.solve_upper_triangular(&filter.y).unwrap().y - 0.2).abs() < 1e-3);
        }
    }

    #[test]
    fn a_straight_snake_alone_tells_nothing_of_eta() {
        let row = Row {
            z: Vector3::repeat(0.2),
            h: Matrix3x2::from_columns(&[Vector3::zeros(), Vector3::repeat(1.0)]),
            covariance: Matrix3::identity() * 1e-4,
        };
        assert!(Filter::of(&[row, row, row]).solution().is_none());
    }

    #[test]
    fn a_row_without_a_proper_covariance_changes_nothing() {
        let mut filter = Filter::default();
        let h = Matrix3x2::repeat(1.0);
        filter.absorb(&Row { z: Vector3::zeros(), h, covariance: Matrix3::zeros() });
        filter.absorb(&Row { z: Vector3::zeros(), h, covariance: Matrix3::repeat(f64::NAN) });
        assert_eq!(filter, Filter::default());
    }
}
