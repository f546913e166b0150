//! The noise model of the edges: how far an edge may lie from the border that made it, for other reasons than the picture's noise.
//!
//! An edge has five errors. Each has its variance here, and nothing else in the fit decides on one:
//!
//! 1. Pixel noise, which the edge finder works out of each edge ([`Edge::sigma_px`](super::edges::Edge::sigma_px)).
//! 2. A floor for every single edge, by which shading and print displace it however clean it looks, the more the wider it is: [`edge_floor_px`].
//! 3. A bias of each kind of edge in each frame, which is fitted under a prior: [`NoiseModel::frame_bias_px`].
//! 4. What a disk's face mirrors where it is seen at a glancing angle, which is fitted under a prior as well: [`NoiseModel::glare`].
//! 5. Systematic error modes, displacements of many edges at once that look like a bend: [`systematic_modes`].
//!
//! What sizes σ alone is fitted to rigs whose bends are known, all together and by maximum likelihood: `tools/fit-noise` does it, and the book's "How
//! well it measures" says with what result. Two surveys judge the whole model on renders by the project's own path tracer:
//!
//! ```sh
//! cargo test --release --no-default-features --test eye uncertainty -- --ignored --nocapture
//! cargo test --release --no-default-features --test eye robustness -- --ignored --nocapture
//! ```

#[cfg(test)]
mod fitting;

use super::edges::filter_px;
use super::state::{BIASES, EdgeBias};
use crate::measure::body::Piece;
use nalgebra::Vector2;

/// The noise model in use.
#[cfg(test)]
pub(crate) use fitting::noise_model;

/// The numbers of the noise model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct NoiseModel {
    /// The design effect of the edges against the priors: how many neighbouring edges err alike and so count as one.
    pub design_effect: f64,
    /// The share of the jackknife's variance over clusters that is a frame's own error; the rest is alike in all frames of a sequence, so that
    /// the fit of the rig to them has it.
    pub own_variance: f64,
    /// The variance that a rig's pose brings into a frame's bend, in units of what the rig's fit says.
    pub pose_variance: f64,
    /// By how much each bias of the edges differs between the straight picture and a frame (σ), px.
    pub frame_bias_px: f64,
    /// Standard deviation of a single edge of a sharp picture for other reasons than noise, px.
    pub edge_floor_px: f64,
    /// The same at a tube, whose brightness changes within the pixels that place an edge.
    pub tube_floor_px: f64,
    /// Standard deviation of each systematic mode of the rims, px.
    pub rim_mode_px: f64,
    /// Standard deviation of each systematic mode of the sides, px.
    pub side_mode_px: f64,
    /// Standard deviation at the base and at the tip of each mode of the sides that changes from one to the other, px: a shadow, or what lies
    /// behind, turns a whole snake in the picture.
    pub side_taper_px: f64,
    /// What is known beforehand of [`EdgeBias::glare`]: its mean, ...
    pub glare: f64,
    /// ... and its standard deviation.
    pub glare_sd: f64,
    /// By how much the share differs along the rims (σ): what the formula of `glancing` leaves of an edge's displacement is this share of h e.
    pub uneven_glare: f64,
}

/// The numbers in use.
///
/// Fitted: by maximum likelihood to 38 rigs of five kinds (photo-real ones, sheets of laboratories, photographed sheets, four experiments, own renders), each
/// kind counted alike, on the wider side of what is as likely; judged by 34 others. The likeliest design effect is 15; with it one more snake that is no arc is
/// measured falsely, so that it is as set by hand on renders. [`own_variance`](NoiseModel::own_variance) and the two of the sides were fitted anew, to
/// 38 such rigs, when frames no longer counted the holder's edges in full, and judged by 37 others; both floors were, to 55 rigs of six kinds (photo-real ones
/// averaged over 2×2 pixels as well), when filters became as fine as the blur, and judged by 47 others. See the book's "How well it measures".
const FITTED: NoiseModel = NoiseModel {
    design_effect: 10.0,
    own_variance: 0.24,
    pose_variance: 2.0,
    frame_bias_px: 0.035,
    edge_floor_px: 0.104,
    tube_floor_px: 0.154,
    rim_mode_px: 0.013,
    side_mode_px: 0.016,
    side_taper_px: 0.021,
    glare: 0.35,
    glare_sd: 0.15,
    uneven_glare: 0.2,
};

/// By how much a glare differs between the straight picture and a frame, whose faces lie otherwise in the light, in units of what is not known of it before
/// any picture (σ).
///
/// Convention: half.
const FRAME_GLARE_SHARE: f64 = 0.5;

/// The noise model in use.
#[cfg(not(test))]
pub(crate) const fn noise_model() -> NoiseModel {
    FITTED
}

impl NoiseModel {
    /// The bias of a snake that was not seen yet.
    pub fn unknown_bias(&self) -> EdgeBias {
        EdgeBias { side_px: 0.0, tube_px: 0.0, rim_px: 0.0, glare: [self.glare; 2] }
    }

    /// By how much each number of the edges' bias differs between the straight picture and a frame (σ).
    pub fn frame_bias_sigma(&self) -> [f64; BIASES] {
        let (bias_px, glare) = (self.frame_bias_px, FRAME_GLARE_SHARE * self.glare_sd);
        [bias_px, bias_px, bias_px, glare, glare]
    }
}

/// The scatter of the edges at which the modes are as large as that, px.
///
/// Fitted: the median over the rigs of `tests/eye/uncertainty`.
const TYPICAL_SCATTER_PX: f64 = 0.14;
/// The blur up to which the figures hold, σ in px; a picture of no more is called sharp.
///
/// Fitted: by hand, together with the two above.
pub(crate) const SHARP_PX: f64 = 1.5;
/// How many systematic modes there are.
///
/// Convention: a count.
pub(crate) const MODES: usize = 8;

/// Standard deviation of a single edge of this blur (σ, px) for other reasons than the picture's noise, px.
pub(super) fn edge_floor_px(piece: Piece, blur_px: f64) -> f64 {
    let noise = noise_model();
    let floor_px = if matches!(piece, Piece::Tube(..)) { noise.tube_floor_px } else { noise.edge_floor_px };
    floor_px * blur_growth(blur_px)
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
    /// The blur where the edge is, σ in px.
    pub blur_px: f64,
    /// Root mean square distance of the edges from the fit, px: what displaces edges one by one displaces them together as well.
    pub scatter_px: f64,
}

impl Conditions {
    /// How many times larger than in a sharp picture the modes are.
    pub fn growth(&self) -> f64 {
        blur_growth(self.blur_px) * (self.scatter_px / TYPICAL_SCATTER_PX)
    }
}

/// The displacement of an edge, px, in each systematic mode of one standard deviation; the modes are independent of each other.
///
/// Light and blur displace the edges of all disks alike, so that no number of disks averages it away: all rims along the snake, the
/// same at the rims' ends only, all ends rounded off, disks that look thicker towards one end of the snake, and all sides to the
/// right or downwards in the picture, alike or the base's one way and the tip's the other. `along` runs from −1 at the base to 1 at the tip; `lateral` is
/// [`OutlinePoint::lateral`](crate::measure::OutlinePoint::lateral).
pub(super) fn systematic_modes(piece: Piece, lateral: f64, along: f64, normal: &Vector2<f64>) -> [f64; MODES] {
    let (end, noise) = (lateral.powi(2), noise_model());
    let of_rim = |face: f64| [face, face * end, end, along, 0.0, 0.0, 0.0, 0.0].map(|share| noise.rim_mode_px * share);
    match piece {
        Piece::Rim(_, far) => of_rim(if far { 1.0 } else { -1.0 }),
        Piece::BaseRim => of_rim(1.0),
        Piece::HolderSide(_) | Piece::DiskSide(..) | Piece::Tube(..) => {
            let [right, down] = [normal.x, normal.y];
            let (even, tapered) = (noise.side_mode_px, noise.side_taper_px * along);
            [0.0, 0.0, 0.0, 0.0, right * even, down * even, right * tapered, down * tapered]
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn modes_and_floors_are_as_large_as_stated_in_a_sharp_picture_and_grow_from_there() {
        let typical = Conditions { blur_px: 1.0, scatter_px: TYPICAL_SCATTER_PX };
        assert_eq!(typical.growth(), 1.0);
        assert_eq!(Conditions { scatter_px: 0.28, ..typical }.growth(), 2.0);
        // The filter is as wide as the blur between 1.2 and 3 px, so that the growth is that of the blur's square.
        let soft = Conditions { blur_px: 3.0, ..typical }.growth();
        assert!((soft - 4.0).abs() < 1e-12, "{soft}");
        for (piece, floor_px) in [(Piece::BaseRim, FITTED.edge_floor_px), (Piece::Tube(1, 1, 2), FITTED.tube_floor_px)]
        {
            assert_eq!(edge_floor_px(piece, 1.0), floor_px);
            assert!((edge_floor_px(piece, 3.0) - 4.0 * floor_px).abs() < 1e-12);
        }
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
            prop_assert!((sigma - FITTED.side_mode_px.hypot(0.3 * FITTED.side_taper_px)).abs() < 1e-12);
        }
    }
}
