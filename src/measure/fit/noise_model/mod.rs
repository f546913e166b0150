//! The noise model of the edges: how far an edge may lie from the border that made it, for other reasons than the picture's noise.
//!
//! An edge has five errors. Each has its variance here, and nothing else in the fit decides on one:
//!
//! 1. Pixel noise, which the edge finder works out of each edge ([`Edge::sigma_px`](super::edges::Edge::sigma_px)).
//! 2. A floor for every single edge, by which shading and print displace it however clean it looks: [`edge_floor_px`].
//! 3. A bias of each kind of edge in each frame, which is fitted under a prior: [`FRAME_BIAS_SIGMA_PX`].
//! 4. What a disk's face mirrors where it is seen at a glancing angle, which is fitted under a prior as well: [`GLARE`].
//! 5. Systematic error modes, displacements of many edges at once that look like a bend: [`systematic_modes`].
//!
//! The figures were fitted to renders by the project's own path tracer of random rigs, lights and materials. Two surveys there judge
//! the whole model, not its single numbers:
//!
//! ```sh
//! cargo test --release --no-default-features --test uncertainty -- --ignored --nocapture
//! cargo test --release --no-default-features --test robustness -- --ignored --nocapture
//! ```

use super::edges::filter_px;
use super::state::{BIASES, EdgeBias};
use crate::measure::body::Piece;
use nalgebra::Vector2;

/// The standard deviation by which each bias of the edges differs between the straight picture and a frame, px.
///
/// Fitted: by hand on renders; judged as part of the whole by `tests/eye/uncertainty`.
const FRAME_BIAS_SIGMA_PX: f64 = 0.05;
/// What is known beforehand of [`EdgeBias::glare`]: its mean, ...
///
/// Fitted: by eye to the displacement of 1,400 edges at faces of 0 to 8 px on photo-real rigs of dark snakes (201, 205, 235, 240), where the
/// formula of `glancing` follows it with 0.3 to 0.5; with 0.25 ± 0.3 the errors of 18 rigs were 0.080° rms in place of 0.079°.
pub(crate) const GLARE: f64 = 0.35;
/// ... its standard deviation, ...
///
/// Fitted: together with its mean; brass and steel have from −0.3 to 0.5.
pub(crate) const GLARE_SIGMA: f64 = 0.2;
/// ... and by how much it differs between the straight picture and a frame, whose faces lie otherwise in the light (σ).
///
/// Convention: half of what is not known before any picture.
const FRAME_GLARE_SIGMA: f64 = 0.1;
/// By how much the share differs along the rims (σ): what the formula of `glancing` leaves of an edge's displacement is this share of h e.
///
/// Fitted: by eye, together with the above.
pub(super) const UNEVEN_GLARE: f64 = 0.2;
/// By how much each number of the edges' bias differs between the straight picture and a frame (σ).
///
/// Derived: from the above.
pub(crate) const FRAME_BIAS_SIGMA: [f64; BIASES] =
    [FRAME_BIAS_SIGMA_PX, FRAME_BIAS_SIGMA_PX, FRAME_BIAS_SIGMA_PX, FRAME_GLARE_SIGMA, FRAME_GLARE_SIGMA];
/// The share of the jackknife's variance over clusters that is a frame's own error; the rest is alike in all frames of a sequence, so that
/// the fit of the rig to them has it.
///
/// Fitted: by maximum likelihood, together with [`POSE_VARIANCE`], with errors that frames of one rig share, to the seventeen photo-real rigs of
/// even number and two bending experiments, 121 frames: it is largest at 0.4 and 1, and these lie on the wider side of its 95 % region, since a σ
/// too small misleads and one too large does not. On the rigs of odd number and two other experiments, 78 frames, the square of error over σ is
/// 0.99 in the mean, and 94 % lie within their 95 % ellipse.
pub(super) const OWN_VARIANCE: f64 = 0.5;
/// The variance that a rig's pose brings into a frame's bend, in units of what the rig's fit says.
///
/// Fitted: see [`OWN_VARIANCE`].
pub(crate) const POSE_VARIANCE: f64 = 1.5;
/// The design effect of the edges against the priors: how many neighbouring edges err alike and so count as one.
///
/// Fitted: by hand on renders; judged as part of the whole by `tests/eye/uncertainty`.
pub(crate) const DESIGN_EFFECT: f64 = 10.0;
/// Standard deviation of a single edge for other reasons than noise, px.
///
/// Fitted: by hand on renders; judged as part of the whole by `tests/eye/uncertainty`.
const EDGE_FLOOR_PX: f64 = 0.08;
/// The same at a tube, whose brightness changes within the pixels that place an edge.
///
/// Fitted: on the rigs of `tests/eye/uncertainty`, where edges of tubes lie up to 0.5 px outside the border, by a different amount on
/// each side, and those of disks at most 0.1 px.
const TUBE_FLOOR_PX: f64 = 0.3;
/// Standard deviation of each systematic mode of the rims, px.
///
/// Fitted: by hand to the covariance of the normalised errors on the rigs of `tests/eye/uncertainty`.
const RIM_MODE_PX: f64 = 0.0108;
/// Standard deviation of each systematic mode of the sides, px.
///
/// Fitted: to the rigs of `tests/eye/uncertainty`, where the sides of disks and holder are displaced to the right or to the left by
/// 0.011 px in the median rig and 0.04 px in one of ten.
const SIDE_MODE_PX: f64 = 0.0245;
/// Standard deviation at the base and at the tip of each mode of the sides that changes from one to the other, px: a shadow, or what lies
/// behind, turns a whole snake in the picture.
///
/// Fitted: by hand to the turns in the picture of refined photo-real rigs; the likelihood of 37 is largest near it. Their halves disagree, for the errors
/// have long tails: the rigs of even number and four of laboratories (500, 504, 508, 512) ask for 0.018, the rigs of odd number and the four others for
/// 0.07. With 0.049 the mean square of error over σ is 0.35 and 1.8, with 0.018 it would be 0.9 and 4.0. Nothing is left that judges it.
const SIDE_TAPER_PX: f64 = 0.049;
/// The scatter of the edges at which the modes are as large as that, px.
///
/// Fitted: the median over the rigs of `tests/eye/uncertainty`.
const TYPICAL_SCATTER_PX: f64 = 0.14;
/// The blur up to which the figures hold, σ in px; a picture of no more is called sharp.
///
/// Fitted: by hand, together with the two above.
pub(crate) const SHARP_PX: f64 = 1.5;
/// A snake whose disks are narrower than this, px, is small: its parts are hardly wider than the edge filter.
///
/// Fitted: by hand on the rigs of `tests/eye/uncertainty` and `tests/eye/robustness`.
pub(super) const SMALL_DIAMETER_PX: f64 = 40.0;

/// How many systematic modes there are.
///
/// Convention: a count.
pub(crate) const MODES: usize = 8;

/// The bias of a snake that was not seen yet.
pub(crate) const UNKNOWN_BIAS: EdgeBias = EdgeBias { side_px: 0.0, tube_px: 0.0, rim_px: 0.0, glare: [GLARE, GLARE] };

/// Standard deviation of a single edge for other reasons than the picture's noise, px.
pub(super) fn edge_floor_px(piece: Piece) -> f64 {
    if matches!(piece, Piece::Tube(..)) { TUBE_FLOOR_PX } else { EDGE_FLOOR_PX }
}

/// How many times further shading displaces edges in a picture of this blur than in a sharp one: a gradient of the brightness
/// beside an edge displaces it in proportion to blur² + filter² (both σ, px).
pub(super) fn blur_growth(blur_px: f64) -> f64 {
    let variance = |blur_px: f64| blur_px.powi(2) + filter_px(blur_px).powi(2);
    (variance(blur_px) / variance(SHARP_PX)).max(1.0)
}

/// What the size of the systematic modes depends on.
#[derive(Debug, Clone, Copy)]
pub(super) struct Conditions {
    /// Median blur of the edges, σ in px.
    pub blur_px: f64,
    /// The snake's diameter in the picture, px.
    pub diameter_px: f64,
    /// Root mean square distance of the edges from the fit, px: what displaces edges one by one displaces them together as well.
    pub scatter_px: f64,
}

impl Conditions {
    /// How many times larger than in a sharp picture of a large snake the modes are.
    pub fn growth(&self) -> f64 {
        blur_growth(self.blur_px)
            * (SMALL_DIAMETER_PX / self.diameter_px).max(1.0).powi(2)
            * (self.scatter_px / TYPICAL_SCATTER_PX)
    }
}

/// The displacement of an edge, px, in each systematic mode of one standard deviation; the modes are independent of each other.
///
/// Light and blur displace the edges of all disks alike, so that no number of disks averages it away: all rims along the snake, the
/// same at the rims' ends only, all ends rounded off, disks that look thicker towards one end of the snake, and all sides to the
/// right or downwards in the picture, alike or the base's one way and the tip's the other. `along` runs from −1 at the base to 1 at the tip; `lateral` is
/// [`OutlinePoint::lateral`](crate::measure::OutlinePoint::lateral).
pub(super) fn systematic_modes(piece: Piece, lateral: f64, along: f64, normal: &Vector2<f64>) -> [f64; MODES] {
    let end = lateral.powi(2);
    let of_rim = |face: f64| [face, face * end, end, along, 0.0, 0.0, 0.0, 0.0].map(|share| RIM_MODE_PX * share);
    match piece {
        Piece::Rim(_, far) => of_rim(if far { 1.0 } else { -1.0 }),
        Piece::BaseRim => of_rim(1.0),
        Piece::HolderSide(_) | Piece::DiskSide(..) | Piece::Tube(..) => {
            let [right, down] = [normal.x, normal.y];
            let (even, tapered) = (SIDE_MODE_PX, SIDE_TAPER_PX * along);
            [0.0, 0.0, 0.0, 0.0, right * even, down * even, right * tapered, down * tapered]
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_modes_are_as_large_as_stated_in_a_sharp_picture_of_a_large_snake_and_grow_from_there() {
        let typical = Conditions { blur_px: 1.0, diameter_px: 60.0, scatter_px: TYPICAL_SCATTER_PX };
        assert_eq!(typical.growth(), 1.0);
        assert_eq!(Conditions { diameter_px: 20.0, ..typical }.growth(), 4.0);
        assert_eq!(Conditions { scatter_px: 0.28, ..typical }.growth(), 2.0);
        // The filter is as wide as the blur between 1.2 and 3 px, so that the growth is that of the blur's square.
        let soft = Conditions { blur_px: 3.0, ..typical }.growth();
        assert!((soft - 4.0).abs() < 1e-12, "{soft}");
    }

    proptest! {
        #[test]
        fn more_blur_never_makes_shading_displace_less(a in 0.0..10.0f64, b in 0.0..10.0f64) {
            prop_assert!(blur_growth(a.min(b)) <= blur_growth(a.max(b)));
            prop_assert!(blur_growth(a) >= 1.0);
        }

        #[test]
        fn a_side_is_displaced_by_the_same_amount_whichever_way_it_faces(angle in 0.0..std::f64::consts::TAU) {
            let normal = Vector2::new(angle.cos(), angle.sin());
            let modes = systematic_modes(Piece::DiskSide(2, 1), 0.0, 0.3, &normal);
            let sigma = modes.iter().map(|mode| mode * mode).sum::<f64>().sqrt();
            prop_assert!((sigma - SIDE_MODE_PX.hypot(0.3 * SIDE_TAPER_PX)).abs() < 1e-12);
        }
    }
}
