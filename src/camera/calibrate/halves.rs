//! Two lenses, each from half of the pictures, compared in what they do to the snake's angles.

use super::fit::{Fit, parameters, with_parameters};
use crate::camera::{Board, Lens};
use crate::error::Result;
use nalgebra::{Matrix3, Point2, SMatrix, SVector, UnitQuaternion, Vector2, Vector3};
use serde::Serialize;

/// Two halves disagree where they differ by more than so many times what the sigmas predict.
///
/// Convention: two sigmas, about one in twenty where all is well; it warns and changes no result.
const DISAGREE: f64 = 2.0;

/// Two lenses, from every other picture and from the rest, compared in what they do to the snake's angles.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Halves {
    /// By how much a short straight piece of the snake seems turned in the picture's plane, from one lens to the other:
    /// root mean square over all directions and all places where corners were seen, as far out as both halves reach,
    /// degrees. A turn of the whole camera is taken out first, because the rig's calibration takes it up.
    pub rms_deg: f64,
    /// What the two halves' covariances predict for it, degrees.
    pub expected_deg: f64,
}

impl Halves {
    /// Whether the halves differ by more than twice what the sigmas predict: then something is wrong that the sigmas do
    /// not know of, a board that is not flat, a lens that moved or that the model does not fit.
    pub fn disagree(&self) -> bool {
        // NaN is no agreement.
        self.rms_deg.is_nan() || self.expected_deg.is_nan() || self.rms_deg > DISAGREE * self.expected_deg
    }
}

/// The comparison of the lens from every other picture with that from the rest.
///
/// # Errors
/// Whatever OpenCV refuses; boards that leave a half undetermined.
pub fn halves(board: &Board, views: &[&[Point2<f64>]], size: (u32, u32)) -> Result<Halves> {
    let [even_views, odd_views] =
        [0, 1].map(|start| views.iter().skip(start).step_by(2).copied().collect::<Vec<&[Point2<f64>]>>());
    let (even, odd) = (Fit::of(board, &even_views, size)?, Fit::of(board, &odd_views, size)?);
    // Farther from the middle than its own corners reach, a half's distortion is a guess.
    let radius = |corner: &Point2<f64>| (corner - even.lens.centre_px).norm();
    let reach = |views: &[&[Point2<f64>]]| views.iter().copied().flatten().map(radius).fold(0.0, f64::max);
    let both_reach = reach(&even_views).min(reach(&odd_views));
    let places: Vec<Point2<f64>> =
        views.iter().copied().flatten().copied().filter(|corner| radius(corner) <= both_reach).collect();
    let turns = turns(&even.lens, &odd.lens, &places);
    Ok(Halves {
        rms_deg: (turns.iter().map(|t| t * t).sum::<f64>() / turns.len() as f64).sqrt().to_degrees(),
        expected_deg: predicted_deg(&even.lens, &(even.covariance + odd.covariance), &places),
    })
}

/// Root mean square of the [`turns`] that parameters with this covariance cause, degrees.
pub fn predicted_deg(lens: &Lens, covariance: &SMatrix<f64, 9, 9>, places: &[Point2<f64>]) -> f64 {
    let values = parameters(lens);
    // Steps of a tenth of a sigma: small against what the lens does, large against rounding.
    let columns: Vec<Vec<f64>> = (0..9)
        .map(|k| {
            let step = 0.1 * covariance[(k, k)].sqrt();
            let moved = |by: f64| {
                let mut values = values;
                values[k] += by;
                turns(lens, &with_parameters(lens, &values), places)
            };
            moved(step).iter().zip(moved(-step)).map(|(a, b)| (a - b) / (2.0 * step)).collect()
        })
        .collect();
    let count = columns[0].len();
    let variance = |row: usize| {
        let slope = SVector::<f64, 9>::from_fn(|k, _| columns[k][row]);
        (slope.transpose() * covariance * slope).x
    };
    ((0..count).map(variance).sum::<f64>() / count as f64).sqrt().to_degrees()
}

/// By which angles, rad, short pieces of the picture (level, upright and along both diagonals) seem turned from one lens
/// to another, at each place. The turn of the whole camera that brings the two lenses' rays nearest is taken out first.
fn turns(one: &Lens, other: &Lens, places: &[Point2<f64>]) -> Vec<f64> {
    let turn = common_turn(places.iter().map(|place| (one.ray(place), other.ray(place))));
    let directions = [[0.5, 0.0], [0.0, 0.5], [0.35, 0.35], [0.35, -0.35]].map(Vector2::from);
    let turns_at = |place: &Point2<f64>| {
        let piece = |lens: &Lens, turn: &UnitQuaternion<f64>, direction: &Vector2<f64>| {
            let ideal = |pixel: Point2<f64>| {
                let ray = turn * lens.ray(&pixel);
                ray.xy() / ray.z
            };
            ideal(place + direction) - ideal(place - direction)
        };
        directions.map(|direction| {
            let (a, b) = (piece(one, &UnitQuaternion::identity(), &direction), piece(other, &turn, &direction));
            a.perp(&b).atan2(a.dot(&b))
        })
    };
    places.iter().flat_map(turns_at).collect()
}

/// The small turn that brings the second of each pair of unit vectors nearest to the first (least squares).
fn common_turn(pairs: impl Iterator<Item = (Vector3<f64>, Vector3<f64>)>) -> UnitQuaternion<f64> {
    let (normal, sum) = pairs.fold((Matrix3::zeros(), Vector3::zeros()), |(normal, sum), (a, b)| {
        (normal + Matrix3::identity() - b * b.transpose(), sum + b.cross(&a))
    });
    UnitQuaternion::from_scaled_axis(normal.try_inverse().map_or(Vector3::zeros(), |inverse| inverse * sum))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::calibrate::tests::lens;
    use approx::assert_abs_diff_eq;

    /// Places all over the picture.
    fn places() -> Vec<Point2<f64>> {
        (0..63).map(|k| Point2::new(f64::from(k % 9) * 71.0 + 35.5, f64::from(k / 9) * 68.5 + 34.0)).collect()
    }

    #[test]
    fn a_lens_agrees_with_itself_however_it_is_turned_or_scaled() {
        assert!(turns(&lens(), &lens(), &places()).iter().all(|t| t.abs() < 1e-12));
        // A moved principal point is nearly a turned camera, a longer lens a nearer snake.
        let pinhole = Lens { distortion: [0.0; 12], centre_px: Point2::new(319.5, 239.5), ..lens() };
        let moved = Lens { centre_px: Point2::new(320.5, 239.5), ..pinhole.clone() };
        assert!(turns(&pinhole, &moved, &places()).iter().all(|t| t.abs() < 2e-3));
        let longer = Lens { focal_px: 1.01 * pinhole.focal_px, ..pinhole.clone() };
        assert!(turns(&pinhole, &longer, &places()).iter().all(|t| t.abs() < 1e-12));
    }

    #[test]
    fn a_wrong_aspect_turns_the_diagonals() {
        let pinhole = Lens { distortion: [0.0; 12], centre_px: Point2::new(319.5, 239.5), ..lens() };
        let wide = Lens { focal_px: pinhole.focal_px.component_mul(&Vector2::new(1.001, 1.0)), ..pinhole.clone() };
        for four in turns(&pinhole, &wide, &places()).chunks(4) {
            assert_abs_diff_eq!(four[0], 0.0, epsilon = 1e-6);
            assert_abs_diff_eq!(four[1], 0.0, epsilon = 1e-6);
            assert_abs_diff_eq!(four[2], 0.0005, epsilon = 5e-6);
            assert_abs_diff_eq!(four[3], -0.0005, epsilon = 5e-6);
        }
    }
}
