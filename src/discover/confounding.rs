//! Which effects are confounded with η and λ on these poses: what they do, η and λ could do as well.

use super::tangent_spaces::TangentSpace;
use crate::robot::Physics;
use nalgebra::DMatrix;

/// The size at which an effect must be distinguishable from η and λ, as the rms of its change of the residuals.
///
/// Convention: ten standard deviations of the noise of a sample, between 0.015 mm for the encoders and 0.1 mm for the eye.
const RMS_IN_SIGMAS: f64 = 10.0;

/// The effects of which some combination of parameters could not be named at that size. `gain_of_noise` is what the null
/// distribution asks of the best hypothesis.
pub fn confounded(spaces: &[TangentSpace], gain_of_noise: f64) -> Vec<&'static Physics> {
    let mut found: Vec<&'static Physics> = Vec::new();
    for space in spaces {
        let squares = RMS_IN_SIGMAS.powi(2) * space.columns.nrows() as f64;
        let needed = space.penalty + gain_of_noise;
        let Some(physics) = space.physics.filter(|physics| !found.contains(physics)) else { continue };
        if squares * least_share(&space.columns, &space.remaining) < needed {
            found.push(physics);
        }
    }
    found
}

/// The least share of an effect's squares that η and λ leave, over all combinations of its parameters: the smallest eigenvalue of
/// RᵗR relative to CᵗC, which is one less the largest squared canonical correlation of C with η and λ.
fn least_share(columns: &DMatrix<f64>, remaining: &DMatrix<f64>) -> f64 {
    let root = (columns.transpose() * columns).cholesky().and_then(|factor| factor.l().try_inverse());
    let Some(root) = root else { return 0.0 };
    (&root * (remaining.transpose() * remaining) * root.transpose()).symmetric_eigenvalues().min()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::LIBRARY;

    #[test]
    fn the_least_share_is_one_less_the_squared_correlation() {
        // A column at 60° to the nuisance direction keeps sin² 60° of its squares.
        let (sin, cos) = 60f64.to_radians().sin_cos();
        let columns = DMatrix::from_column_slice(2, 1, &[2.0 * cos, 2.0 * sin]);
        let remaining = DMatrix::from_column_slice(2, 1, &[0.0, 2.0 * sin]);
        assert!((least_share(&columns, &remaining) - 0.75).abs() < 1e-12);
    }

    #[test]
    fn two_parameters_are_as_confounded_as_their_worst_combination() {
        let columns = DMatrix::identity(3, 2);
        let remaining = DMatrix::from_row_slice(3, 2, &[0.5, -0.5, -0.5, 0.5, 0.0, 0.0]);
        assert!(least_share(&columns, &remaining).abs() < 1e-12);
        assert_eq!(least_share(&DMatrix::from_element(3, 2, 1.0), &remaining), 0.0);
    }

    #[test]
    fn an_effect_is_confounded_where_a_large_one_would_not_gain_enough() {
        let space = |kept: f64| {
            let columns = DMatrix::from_element(100, 1, 1.0);
            vec![TangentSpace { physics: Some(LIBRARY[0]), penalty: 6.0, remaining: &columns * kept.sqrt(), columns }]
        };
        // 10² · 100 · share against 6 + 4.
        assert!(confounded(&space(0.0011), 4.0).is_empty());
        assert_eq!(confounded(&space(0.0009), 4.0), [LIBRARY[0]]);
    }
}
