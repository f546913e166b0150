//! The square-root information filter: recursive least squares of n parameters that never squares a number.
//!
//! The filter keeps the upper triangle U and y with UᵗU = Σ hhᵗ and Uᵗy = Σ hz over all rows hᵗx = z + noise so far, each in units of
//! its standard deviation. A new row is turned into the triangle by n Givens rotations. The covariance P = U⁻¹U⁻ᵗ is symmetric and
//! positive by construction, and x̂ = U⁻¹y is the least-squares solution over all rows; there is no prior but the rows that are given.
//!
//! Source: G. J. Bierman, *Factorization Methods for Discrete Sequential Estimation*, Academic Press 1977, ch. V; for the rotations
//! W. M. Gentleman, "Least Squares Computations by Givens Transformations without Square Roots", J. Inst. Maths Applics 12, 1973.

use nalgebra::allocator::Allocator;
use nalgebra::{DMatrix, DVector, DefaultAllocator, Dim, Dyn, OMatrix, OVector};

/// What all rows so far say about n parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct SquareRootInformation {
    upper: DMatrix<f64>,
    y: DVector<f64>,
}

impl SquareRootInformation {
    /// Nothing known of so many parameters.
    pub fn none(count: usize) -> Self {
        Self { upper: DMatrix::zeros(count, count), y: DVector::zeros(count) }
    }

    /// What an x̂ with its covariance stands for; `None` where that is not positive definite.
    pub fn of(x: &DVector<f64>, covariance: &DMatrix<f64>) -> Option<Self> {
        let mut information = Self::none(x.len());
        let identity = DMatrix::identity(x.len(), x.len());
        let whitener = covariance.clone().cholesky()?.l_dirty().solve_lower_triangular(&identity)?;
        information.absorb(&whitener, &(&whitener * x)).then_some(information)
    }

    /// The number of parameters.
    pub fn count(&self) -> usize {
        self.y.len()
    }

    /// Adds rows of a design matrix, h, and their measurements, z, both in units of the measurements' standard deviation.
    ///
    /// Rows whose numbers, or their squares, are not all finite change nothing; `false` says so.
    #[must_use]
    pub fn absorb<M: Dim>(&mut self, h: &OMatrix<f64, M, Dyn>, z: &OVector<f64, M>) -> bool
    where
        DefaultAllocator: Allocator<M, Dyn> + Allocator<M>,
    {
        let finite = h.iter().chain(z.iter()).all(|value| (value * value).is_finite());
        if finite {
            let mut row = DVector::zeros(self.count());
            for k in 0..z.len() {
                row.tr_copy_from(&h.row(k));
                self.rotate_in(&mut row, z[k]);
            }
        }
        finite
    }

    /// What these rows and others say of the same parameters together.
    pub fn and(mut self, other: &Self) -> Self {
        for (row, z) in other.upper.row_iter().zip(other.y.iter()) {
            self.rotate_in(&mut row.transpose(), *z);
        }
        self
    }

    /// Turns one row into the triangle: a Givens rotation for each of its numbers makes that number zero.
    fn rotate_in(&mut self, h: &mut DVector<f64>, mut z: f64) {
        for j in 0..self.count() {
            let length = self.upper[(j, j)].hypot(h[j]);
            if length == 0.0 {
                continue;
            }
            let (cosine, sine) = (self.upper[(j, j)] / length, h[j] / length);
            for k in j..self.count() {
                let (above, below) = (self.upper[(j, k)], h[k]);
                self.upper[(j, k)] = cosine * above + sine * below;
                h[k] = cosine * below - sine * above;
            }
            let above = self.y[j];
            self.y[j] = cosine * above + sine * z;
            z = cosine * z - sine * above;
        }
    }

    /// UᵗU, the information.
    pub fn matrix(&self) -> DMatrix<f64> {
        self.upper.tr_mul(&self.upper)
    }

    /// x̂ and its covariance P; `None` while the rows do not determine all parameters.
    pub fn solution(&self) -> Option<(DVector<f64>, DMatrix<f64>)> {
        let inverse = self.upper.solve_upper_triangular(&DMatrix::identity(self.count(), self.count()))?;
        Some((&inverse * &self.y, &inverse * inverse.transpose()))
    }

    /// What the rows say of the last so many parameters while the others are free: the triangle's last corner, y with it.
    pub fn of_last(&self, count: usize) -> Self {
        let first = self.count() - count;
        Self {
            upper: self.upper.view((first, first), (count, count)).into_owned(),
            y: self.y.rows(first, count).into_owned(),
        }
    }

    /// x̂ within the directions that are seen, by the direction and the standard deviation along it, its covariance there, and unit vectors along the
    /// others, in which x̂ has no part. U = W S Vᵗ: the standard deviation along a column of V is the inverse of its singular value.
    pub fn seen(
        &self,
        is_seen: impl Fn(&DVector<f64>, f64) -> bool,
    ) -> (DVector<f64>, DMatrix<f64>, Vec<DVector<f64>>) {
        let n = self.count();
        let (mut x, mut covariance, mut unseen) = (DVector::zeros(n), DMatrix::zeros(n, n), Vec::new());
        let svd = self.upper.clone().svd(true, true);
        let (Some(w), Some(v)) = (svd.u, svd.v_t) else { return (x, covariance, unseen) };
        for (k, value) in svd.singular_values.iter().enumerate() {
            let direction = v.row(k).transpose();
            if is_seen(&direction, value.recip()) {
                x += &direction * (w.column(k).dot(&self.y) / value);
                covariance += &direction * direction.transpose() / (value * value);
            } else {
                unseen.push(direction);
            }
        }
        (x, covariance, unseen)
    }

    /// Moves x̂ to x, and multiplies the standard deviation of each parameter by a factor: a random walk. Correlations stay.
    pub fn walk(&mut self, x: &DVector<f64>, factors: &DVector<f64>) {
        self.upper.column_iter_mut().zip(factors.iter()).for_each(|(mut column, factor)| column /= *factor);
        self.y = &self.upper * x;
    }

    /// Multiplies all information so far by the forgetting factor, in (0, 1], except along directions of which so little is known
    /// that forgetting more would leave nothing: however long no row speaks of a direction, the largest eigenvalue of P grows to
    /// `most_sd`² and stays there, or where it was if it was above. x̂ does not move.
    ///
    /// With U = W S Vᵗ, both sides of U x = y are multiplied by D Wᵗ, D being what is kept of each singular value. Nothing is squared,
    /// so what is barely known survives beside what is known 10⁸ times better.
    pub fn forget(&mut self, factor: f64, most_sd: f64) {
        let svd = self.upper.clone().svd(true, false);
        let Some(w) = svd.u else { return };
        let mut faded = Self::none(self.count());
        for (column, value) in w.column_iter().zip(svd.singular_values.iter()) {
            let kept = factor.sqrt().max((1.0 / (most_sd * value)).min(1.0));
            let w = column * kept;
            faded.rotate_in(&mut self.upper.tr_mul(&w), w.dot(&self.y));
        }
        *self = faded;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix2xX, Matrix3, RowDVector, Vector1, Vector2, Vector3};
    use proptest::prelude::*;

    type Rows = Vec<([f64; 3], f64)>;

    fn any_rows() -> impl Strategy<Value = Rows> {
        proptest::collection::vec((proptest::array::uniform3(-2.0..2.0f64), -1.0..1.0f64), 3..60)
    }

    /// Adds one row.
    fn absorb(filter: &mut SquareRootInformation, h: &[f64], z: f64) -> bool {
        filter.absorb(&RowDVector::from_row_slice(h), &Vector1::new(z))
    }

    fn filter(rows: &Rows) -> SquareRootInformation {
        let mut filter = SquareRootInformation::none(3);
        rows.iter().for_each(|(h, z)| assert!(absorb(&mut filter, h, *z)));
        filter
    }

    /// The normal equations over all rows at once, each row's information multiplied by factor^age.
    fn batch(rows: &Rows, factor: f64) -> Option<(Vector3<f64>, Matrix3<f64>)> {
        let (mut information, mut right) = (Matrix3::zeros(), Vector3::zeros());
        for (age, (h, z)) in rows.iter().rev().enumerate() {
            let (h, weight) = (Vector3::from(*h), factor.powi(age as i32));
            information += h * h.transpose() * weight;
            right += h * (z * weight);
        }
        let covariance = information.try_inverse()?;
        // Where the normal equations themselves lose digits they are no judge.
        (information.norm() * covariance.norm() < 1e5).then_some((covariance * right, covariance))
    }

    proptest! {
        #[test]
        fn the_recursion_and_the_normal_equations_agree(rows in any_rows()) {
            let Some((x, covariance)) = batch(&rows, 1.0) else { return Ok(()) };
            let (ours, p) = filter(&rows).solution().unwrap();
            prop_assert!((&ours - x).norm() <= 1e-8 * (1.0 + x.norm()), "{ours} {x}");
            prop_assert!((p - covariance).norm() <= 1e-8 * covariance.norm());
        }

        #[test]
        fn forgetting_is_exponential_weighting_where_enough_is_known(rows in any_rows(), factor in 0.5..1.0f64) {
            let mut ours = SquareRootInformation::none(3);
            for (h, z) in &rows {
                ours.forget(factor, f64::INFINITY);
                prop_assert!(absorb(&mut ours, h, *z));
            }
            let Some((x, covariance)) = batch(&rows, factor) else { return Ok(()) };
            let (ours, p) = ours.solution().unwrap();
            prop_assert!((&ours - x).norm() <= 1e-8 * (1.0 + x.norm()), "{ours} {x}");
            prop_assert!((p - covariance).norm() <= 1e-8 * covariance.norm());
        }
    }

    proptest! {
        #[test]
        fn what_is_said_of_the_last_is_the_schur_complement(rows in any_rows()) {
            let Some((x, covariance)) = batch(&rows, 1.0) else { return Ok(()) };
            let (ours, p) = filter(&rows).of_last(2).solution().unwrap();
            prop_assert!((ours - x.fixed_rows::<2>(1)).norm() <= 1e-8 * (1.0 + x.norm()));
            prop_assert!((p - covariance.fixed_view::<2, 2>(1, 1)).norm() <= 1e-8 * covariance.norm());
            // Where all is seen, what is seen is the solution.
            let (seen, within, unseen) = filter(&rows).seen(|_, _| true);
            prop_assert!((seen - x).norm() <= 1e-6 * (1.0 + x.norm()) && unseen.is_empty());
            prop_assert!((within - covariance).norm() <= 1e-6 * covariance.norm());
        }
    }

    proptest! {
        #[test]
        fn an_estimate_is_what_it_was_made_of_and_walks_by_its_factors(rows in any_rows()) {
            let Some((x, covariance)) = batch(&rows, 1.0) else { return Ok(()) };
            let (x, covariance) = (DVector::from_column_slice(x.as_slice()), DMatrix::from_column_slice(3, 3, covariance.as_slice()));
            let mut walked = SquareRootInformation::of(&x, &covariance).unwrap();
            let (moved, factors) = (&x * 1.5, Vector3::new(1.0, 1.1, 3.0));
            walked.walk(&moved, &DVector::from_column_slice(factors.as_slice()));
            let (ours, p) = walked.solution().unwrap();
            prop_assert!((ours - &moved).norm() <= 1e-8 * (1.0 + moved.norm()));
            let scale = Matrix3::from_diagonal(&factors);
            prop_assert!((p - scale * &covariance * scale).norm() <= 1e-8 * covariance.norm());
        }
    }

    #[test]
    fn a_direction_that_no_row_speaks_of_is_not_seen() {
        let mut filter = SquareRootInformation::none(3);
        let h = Matrix2xX::from_row_slice(&[2.0, 0.0, 0.0, 0.0, 3.0, 4.0]);
        assert!(filter.absorb(&h, &Vector2::new(2.0, 25.0)));
        let (x, covariance, unseen) = filter.seen(|_, sd| sd < 10.0);
        assert!((&x - Vector3::new(1.0, 3.0, 4.0)).norm() < 1e-12, "{x}");
        assert_eq!(unseen.len(), 1);
        assert!((unseen[0].dot(&Vector3::new(0.0, 0.8, -0.6)).abs() - 1.0).abs() < 1e-12);
        assert!((&covariance * &unseen[0]).norm() < 1e-12 && (covariance[(0, 0)] - 0.25).abs() < 1e-12);
    }

    #[test]
    fn what_is_barely_known_survives_beside_what_is_known_far_better() {
        let mut filter = SquareRootInformation::none(2);
        let h = Matrix2xX::from_row_slice(&[1e8, 1e8, 0.0, 2.0]);
        assert!(filter.absorb(&h, &Vector2::new(3e8, 4.0)));
        let (x, p) = filter.solution().unwrap();
        assert!((x - Vector2::new(1.0, 2.0)).norm() < 1e-12);
        assert!((p[(1, 1)] - 0.25).abs() < 1e-12);
        for _ in 0..1000 {
            filter.forget(0.9, 2.0);
        }
        let (x, p) = filter.solution().unwrap();
        assert!((&x - Vector2::new(1.0, 2.0)).norm() < 1e-6, "{x}");
        assert!((p.symmetric_eigenvalues().max() - 4.0).abs() < 1e-6, "{p}");
    }

    #[test]
    fn what_is_not_finite_or_not_enough_gives_no_answer() {
        let mut filter = SquareRootInformation::none(2);
        assert!(absorb(&mut filter, &[1.0, 1.0], 1.0));
        assert_eq!(filter.solution(), None);
        let before = filter.clone();
        assert!(!absorb(&mut filter, &[f64::NAN, 1.0], 1.0));
        assert!(!absorb(&mut filter, &[0.0, 1.0], f64::INFINITY));
        assert_eq!(filter, before);
    }
}
