//! Faces of disks that are seen at a glancing angle, and where their edges lie.
//!
//! Every surface mirrors at a glancing angle (Fresnel's equations): the flat face of a disk then shows the target behind it and is
//! nearly as bright as that, whatever the snake is made of. Where the face is only a few pixels high in the picture, it and the wall
//! below it are one blurred edge, which lies between the face's rim and the wall's.
//!
//! A face of height h that lacks the share β of the contrast between snake and target has two steps, of 1 − β at its rim and of β
//! at the wall. After a blur of standard deviation s the slope along the normal, x outwards from the rim, is
//! (1 − β) φ(x/s) + β φ((x + h)/s), and its peak, by one Newton step from the rim,
//!
//! x = −β h e / (1 − β + β (1 − h²/s²) e), e = exp(−h²/2s²).
//!
//! Source: M. Born, E. Wolf, "Principles of Optics", 7th edition, 1999, section 1.5.2, for the reflectivity near grazing incidence.

use crate::measure::body::OutlinePoint;

/// The shares β for which there is one edge nearer to the rim than to the wall. β is negative of a face that differs more from the target
/// than the wall does.
///
/// Derived: at one half both steps are alike; some are left for the Newton step to hold. At −1 the wall differs half as much as the face.
const SHARES: std::ops::RangeInclusive<f64> = -1.0..=0.45;

/// A disk's flat face that is seen behind a border point.
#[derive(Debug, Clone, Copy)]
pub(super) struct SeenFace {
    /// Whether it is a disk's far face, turned to the tip.
    pub is_far: bool,
    /// h e, px.
    pull_px: f64,
    /// (1 − h²/s²) e.
    curvature: f64,
}

impl SeenFace {
    /// The face behind a border point in a picture whose edges, filtered, have this blur (σ, px); `None` where there is none.
    pub fn behind(point: &OutlinePoint, spread_px: f64) -> Option<Self> {
        let height = point.face_px / spread_px;
        if height <= 0.0 {
            return None;
        }
        let e = (-0.5 * height * height).exp();
        Some(Self { is_far: point.piece.is_far(), pull_px: point.face_px * e, curvature: (1.0 - height * height) * e })
    }

    /// How far outside the rim the edge lies for this share β, px, and its derivative by β; straight on beyond the shares for which
    /// the formula holds.
    pub fn displacement_px(&self, share: f64) -> (f64, f64) {
        let within = share.clamp(*SHARES.start(), *SHARES.end());
        let below = 1.0 + within * (self.curvature - 1.0);
        let slope = -self.pull_px / below.powi(2);
        (-within * self.pull_px / below + slope * (share - within), slope)
    }

    /// h e, px: the largest displacement to first order in β.
    pub fn pull_px(&self) -> f64 {
        self.pull_px
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measure::body::{BodyPoint, Piece};
    use nalgebra::{Point2, Unit, Vector2, Vector3};

    fn face(height_px: f64, spread_px: f64) -> SeenFace {
        let point = OutlinePoint {
            body: BodyPoint { s_mm: 0.0, local: Vector3::zeros() },
            piece: Piece::Rim(1, true),
            lateral: 0.0,
            face_px: height_px,
            pixel: Point2::origin(),
            normal: Unit::new_unchecked(Vector2::x()),
            gap_px: 10.0,
            depth_px: 10.0,
            predicted: None,
        };
        SeenFace::behind(&point, spread_px).unwrap()
    }

    /// Where two blurred steps, of 1 − β at 0 and of β at −h, are steepest: the highest of the peaks that a fine search finds.
    fn steepest(share: f64, height_px: f64, spread_px: f64) -> f64 {
        let bell = |x: f64| (-0.5 * (x / spread_px).powi(2)).exp();
        let slope = |x: f64| (1.0 - share) * bell(x) + share * bell(x + height_px);
        let places = (-10_000..5_000).map(|k| f64::from(k) * 1e-3);
        places.max_by(|&a, &b| slope(a).total_cmp(&slope(b))).unwrap()
    }

    #[test]
    fn the_edge_lies_where_two_blurred_steps_are_steepest() {
        for spread_px in [1.2, 2.0] {
            for height in [0.2, 0.6, 1.0, 1.5, 2.0, 3.0, 5.0] {
                for share in [-0.5, -0.2, 0.1, 0.25, 0.35] {
                    let (displacement_px, _) = face(height * spread_px, spread_px).displacement_px(share);
                    let expected_px = steepest(share, height * spread_px, spread_px);
                    // One Newton step; a tenth of the blur is what it leaves at most.
                    let off = (displacement_px - expected_px).abs() / spread_px;
                    assert!(off < 0.1, "β {share}, h {height} s: {displacement_px} px, not {expected_px}");
                }
            }
        }
    }

    #[test]
    fn its_derivative_is_the_difference_and_it_goes_straight_on_where_the_formula_ends() {
        let face = face(1.5, 1.4);
        for share in [-2.0, -0.5, 0.0, 0.3, 0.6] {
            let (_, slope_px) = face.displacement_px(share);
            let difference = (face.displacement_px(share + 1e-6).0 - face.displacement_px(share - 1e-6).0) / 2e-6;
            assert!((slope_px - difference).abs() < 1e-6, "{share}: {slope_px} {difference}");
        }
    }

    #[test]
    fn a_face_that_is_high_or_as_bright_as_the_wall_displaces_nothing() {
        assert!(face(8.0, 1.4).displacement_px(0.4).0.abs() < 1e-4);
        assert_eq!(face(1.0, 1.4).displacement_px(0.0).0, 0.0);
    }
}
