//! What one picture is fitted with: the bend and the biases of its edges, and what is known of the biases beforehand.

use super::noise_model::{BIAS_DESIGN_EFFECT, blur_growth};
use crate::geometry::Configuration;
use crate::measure::body::Piece;
use nalgebra::{SVector, Vector2};

/// How far outside the snake's true border its edges are seen, px.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct EdgeBias {
    /// At the sides of holder and disks, where a surface turns away from the camera: its brightness falls off towards the limb.
    pub side_px: f64,
    /// At the tubes' sides, where it does so within the few pixels that place an edge.
    pub tube_px: f64,
    /// At the sharp rims of the disks.
    pub rim_px: f64,
}

/// How many biases there are.
pub(crate) const BIASES: usize = 3;

impl EdgeBias {
    /// The index of the bias that the edges of a piece have.
    pub(super) fn kind(piece: Piece) -> usize {
        match piece {
            Piece::HolderSide(_) | Piece::DiskSide(..) => 0,
            Piece::Tube(..) => 1,
            Piece::BaseRim | Piece::Rim(..) => 2,
        }
    }

    /// The bias of a piece's edges, px.
    pub(crate) fn of(self, piece: Piece) -> f64 {
        self.to_array()[Self::kind(piece)]
    }

    pub(crate) fn to_array(self) -> [f64; BIASES] {
        [self.side_px, self.tube_px, self.rim_px]
    }

    pub(crate) fn moved(self, by: &[f64]) -> Self {
        Self { side_px: self.side_px + by[0], tube_px: self.tube_px + by[1], rim_px: self.rim_px + by[2] }
    }
}

/// A Gaussian prior of the three biases, independent of each other.
#[derive(Debug, Clone, Copy)]
pub(crate) struct BiasPrior {
    pub mean: EdgeBias,
    pub sigma_px: f64,
}

impl BiasPrior {
    /// The square root of the prior's weight, per px. Edges are whitened as if they were independent, so that the prior counts
    /// [`BIAS_DESIGN_EFFECT`] times to keep its share.
    pub(super) fn root(&self) -> f64 {
        BIAS_DESIGN_EFFECT.sqrt() / self.sigma_px
    }

    /// The prior for a picture of this blur.
    pub fn at_blur(self, blur_px: f64) -> Self {
        Self { sigma_px: self.sigma_px * blur_growth(blur_px), ..self }
    }

    /// How far a state's biases are from the prior's means, px.
    pub(super) fn offsets(&self, state: &State) -> [f64; BIASES] {
        let (biases, means) = (state.bias.to_array(), self.mean.to_array());
        std::array::from_fn(|k| biases[k] - means[k])
    }
}

/// What a picture is fitted with.
#[derive(Debug, Clone, Copy)]
pub(crate) struct State {
    /// The bend vector θ (cos δ, sin δ), rad.
    pub bend: Vector2<f64>,
    pub bias: EdgeBias,
}

/// How many numbers a [`State`] has: the bend vector's two and the biases.
pub(crate) const STATE: usize = 2 + BIASES;

impl State {
    pub fn psi(&self) -> Configuration {
        Configuration::from_bend_vector(self.bend)
    }

    pub fn moved(&self, by: &SVector<f64, STATE>) -> Self {
        Self { bend: self.bend + by.xy(), bias: self.bias.moved(&by.as_slice()[2..]) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_piece_has_the_bias_of_its_kind() {
        let bias = EdgeBias { side_px: 0.1, tube_px: 0.2, rim_px: 0.3 };
        let moved = EdgeBias::default().moved(&bias.to_array());
        assert_eq!(moved, bias);
        let of =
            [Piece::HolderSide(1), Piece::DiskSide(2, -1), Piece::Tube(3, 1, 4), Piece::BaseRim, Piece::Rim(5, true)];
        assert_eq!(of.map(|piece| bias.of(piece)), [0.1, 0.1, 0.2, 0.3, 0.3]);
    }
}
