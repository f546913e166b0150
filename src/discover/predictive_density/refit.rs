//! A structure fitted to all stretches but one, to first order, and how well it foretells that one.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// Degrees of freedom of Student's t.
///
/// Convention: the usual choice for a robust error model (Lange, Little and Taylor 1989, J. Am. Stat. Assoc. 84:881, estimate 4 in several sets).
pub(super) const DEGREES_OF_FREEDOM: f64 = 4.0;

/// Normal equations of whitened rows, the residual as their last column.
#[derive(Debug, Clone)]
pub(super) struct Equations {
    pub(super) products: DMatrix<f64>,
    pub(super) log_variances: f64,
    pub(super) count: f64,
}

impl Equations {
    pub(super) fn zero(columns: usize) -> Self {
        Self { products: DMatrix::zeros(columns, columns), log_variances: 0.0, count: 0.0 }
    }

    pub(super) fn add(&mut self, innovation: &DVector<f64>, variance: f64) {
        self.products.ger(1.0 / variance, innovation, innovation, 1.0);
        self.log_variances += variance.ln();
        self.count += 1.0;
    }

    /// Adds others whose variances are so many times what they were whitened by.
    pub(super) fn add_scaled(&mut self, other: &Self, factor: f64) {
        self.products += &other.products / factor;
        self.log_variances += other.log_variances + other.count * factor.ln();
        self.count += other.count;
    }

    pub(super) fn information(&self) -> DMatrix<f64> {
        let p = self.products.nrows() - 1;
        self.products.view((0, 0), (p, p)).into_owned()
    }

    pub(super) fn gradient(&self) -> DVector<f64> {
        let p = self.products.nrows() - 1;
        self.products.view((0, p), (p, 1)).column(0).into_owned()
    }

    pub(super) fn squares(&self) -> f64 {
        let p = self.products.nrows() - 1;
        self.products[(p, p)]
    }
}

/// A fit to all stretches but one, to first order.
pub(super) struct Refit {
    information: DMatrix<f64>,
    pub(super) factor: Cholesky<f64, Dyn>,
    pub(super) step: DVector<f64>,
}

impl Refit {
    pub(super) fn new(rest: &Equations, precision: &DVector<f64>) -> Option<Self> {
        let information = rest.information() + DMatrix::from_diagonal(precision);
        let factor = information.clone().cholesky()?;
        let step = -factor.solve(&rest.gradient());
        Some(Self { information, factor, step })
    }

    /// The logarithm of the density of a stretch that it did not see, but for a constant.
    pub(super) fn foretells(&self, stretch: &Equations) -> Option<f64> {
        let own = stretch.information();
        let (gradient, step) = (stretch.gradient(), &self.step);
        let left = stretch.squares() + 2.0 * gradient.dot(step) + step.dot(&(&own * step));
        let slope = gradient + &own * step;
        let both = (&self.information + own).cholesky()?;
        let squares = (left - slope.dot(&both.solve(&slope))).max(0.0);
        let log_determinant = stretch.log_variances + log_determinant(&both) - log_determinant(&self.factor);
        let nu = DEGREES_OF_FREEDOM;
        Some(-0.5 * log_determinant - 0.5 * (nu + stretch.count) * (squares / nu).ln_1p())
    }
}

fn log_determinant(factor: &Cholesky<f64, Dyn>) -> f64 {
    2.0 * factor.l_dirty().diagonal().iter().map(|x| x.ln()).sum::<f64>()
}
