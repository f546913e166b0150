//! What one picture is fitted with: the bend along the snake and the biases of its edges, and what is known of them beforehand.

use super::glancing::SeenFace;
use super::noise_model::{blur_growth, noise_model};
use super::shape_prior::{LARGEST_SHAPE, UNKNOWN_SHAPE_RAD};
use crate::measure::body::Piece;
use crate::robot::{BendProfile, MODES, PROFILE};
use nalgebra::{DMatrix, Matrix6, SVector, Vector6};

/// How far outside the snake's true border its edges are seen, px.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct EdgeBias {
    /// At the sides of holder and disks, where a surface turns away from the camera: its brightness falls off towards the limb.
    pub side_px: f64,
    /// At the tubes' sides, where it does so within the few pixels that place an edge.
    pub tube_px: f64,
    /// At the sharp rims of the disks.
    pub rim_px: f64,
    /// The share of the contrast between snake and target that disks' faces lack where they are seen at a glancing angle and mirror
    /// the target: of near faces, turned to the base, and of far ones, turned to the tip.
    pub glare: [f64; 2],
}

/// How many biases there are.
///
/// Convention: a count.
pub(crate) const BIASES: usize = 5;

impl EdgeBias {
    /// The index of the bias that the edges of a piece have.
    pub(super) fn kind(piece: Piece) -> usize {
        match piece {
            Piece::HolderSide(_) | Piece::DiskSide(..) => 0,
            Piece::Tube(..) => 1,
            Piece::BaseRim | Piece::Rim(..) => 2,
        }
    }

    /// The bias of the edges of a piece that has no glancing face behind it, px.
    pub(crate) fn of(self, piece: Piece) -> f64 {
        self.to_array()[Self::kind(piece)]
    }

    /// The bias of an edge, px, and its derivative by each number.
    pub(super) fn at(self, piece: Piece, face: Option<SeenFace>) -> (f64, [f64; BIASES]) {
        let mut by = [0.0; BIASES];
        by[Self::kind(piece)] = 1.0;
        let bias_px = self.of(piece);
        let Some(face) = face else { return (bias_px, by) };
        let side = usize::from(face.is_far);
        let (displacement_px, slope_px) = face.displacement_px(self.glare[side]);
        by[3 + side] = slope_px;
        (bias_px + displacement_px, by)
    }

    pub(crate) fn to_array(self) -> [f64; BIASES] {
        let [near, far] = self.glare;
        [self.side_px, self.tube_px, self.rim_px, near, far]
    }

    pub(crate) fn from_array([side_px, tube_px, rim_px, near, far]: [f64; BIASES]) -> Self {
        Self { side_px, tube_px, rim_px, glare: [near, far] }
    }

    pub(crate) fn moved(self, by: &[f64]) -> Self {
        let numbers = self.to_array();
        Self::from_array(std::array::from_fn(|k| numbers[k] + by[k]))
    }
}

/// A χ² of the six components of the modes above this contradicts what a sequence told of the snake's shape.
///
/// Derived: it is exceeded once in 10,000 frames.
pub(crate) const CONTRADICTION_OF_KNOWN_CHI2: f64 = 27.9;
/// A χ² above this contradicts what is taken for granted before any sequence.
///
/// Derived: its mean. Edges are weighted as if only one of those that err alike counted, so that unspoilt pictures of arcs have 0.1 to 1.6 in the
/// survey of `tests/eye/robustness`, and half of those of other shapes more than 78; one that is doubted without need costs precision only.
pub(crate) const CONTRADICTION_OF_UNKNOWN_CHI2: f64 = 6.0;

/// A Gaussian prior of the modes of the bend profile and of the edges' biases, all independent of each other.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FramePrior {
    /// Standard deviation of either component of each mode about zero, rad.
    pub mode_sigma_rad: [f64; MODES],
    /// The χ² from which on a picture contradicts that, see [`contradiction`](Self::contradiction).
    pub contradiction_chi2: f64,
    pub bias: EdgeBias,
    /// Standard deviation of each of the bias' numbers, in their order.
    pub bias_sigma: [f64; BIASES],
}

/// How many of a state's numbers have a prior: all but the tip's bend vector.
///
/// Convention: a count.
pub(crate) const PRIORS: usize = STATE - 2;

impl FramePrior {
    /// The prior of a state's numbers from the third on: how far each is from its mean, in units of σ, and 1/σ. Edges are whitened
    /// as if they were independent, so that the prior counts as many times as edges err alike, to keep its share.
    pub fn rows(&self, state: &State) -> [(f64, f64); PRIORS] {
        let numbers = state.profile.to_array();
        let (biases, means) = (state.bias.to_array(), self.bias.to_array());
        std::array::from_fn(|k| {
            let (offset, sigma) = match k.checked_sub(PROFILE - 2) {
                None => (numbers[2 + k], self.mode_sigma_rad[k / 2]),
                Some(bias) => (biases[bias] - means[bias], self.bias_sigma[bias]),
            };
            let root = noise_model().design_effect.sqrt() / sigma;
            (offset * root, root)
        })
    }

    /// χ² by which the edges of a picture contradict this prior of the modes: of the modes that the edges would have under the prior
    /// for [any shape](Self::of_any_shape), in units of the sum of that estimate's covariance and the prior's. `None` where the covariance
    /// cannot be inverted.
    ///
    /// A fit under a narrow prior leaves modes â near zero however far from an arc the snake is, and what the edges ask for is left in
    /// their residuals. With the fit's covariance P of the modes and the prior's information D, the edges' own information is P⁻¹ − D,
    /// their estimate a = â + C D â with C = (P⁻¹ − D)⁻¹, and aᵗ (C + D⁻¹)⁻¹ a = âᵗ D â + (D â)ᵗ C (D â): the score test of the prior.
    /// Source: Engle, Wald, likelihood ratio, and Lagrange multiplier tests, Handbook of Econometrics 2, 1984.
    ///
    /// `independent` is the covariance of the state's numbers for independent edges, which [`rows`](Self::rows) are weighted for.
    pub fn contradiction(&self, profile: &BendProfile, independent: &DMatrix<f64>) -> Option<f64> {
        let information = |prior: &Self| {
            let of = |k: usize| noise_model().design_effect / prior.mode_sigma_rad[k / 2].powi(2);
            Matrix6::from_diagonal(&Vector6::from_fn(|k, _| of(k)))
        };
        let (known, any) = (information(self), information(&self.of_any_shape()));
        let modes = Vector6::from_fn(|k, _| profile.modes[k / 2][k % 2]);
        let fitted: Matrix6<f64> = independent.fixed_view::<6, 6>(2, 2).into_owned();
        let of_edges = (fitted.try_inverse()? - known + any).try_inverse()?;
        let pull = known * modes;
        Some((modes.dot(&pull) + pull.dot(&(of_edges * pull))) / noise_model().design_effect)
    }

    /// The prior of a snake of which nothing is known but the largest modes that any has.
    pub fn of_any_shape(self) -> Self {
        Self { mode_sigma_rad: UNKNOWN_SHAPE_RAD.map(|sigma| LARGEST_SHAPE * sigma), ..self }
    }

    /// The prior for a picture of this blur.
    pub fn at_blur(self, blur_px: f64) -> Self {
        let growth = blur_growth(blur_px);
        let [side, tube, rim, near, far] = self.bias_sigma;
        Self { bias_sigma: [side * growth, tube * growth, rim * growth, near, far], ..self }
    }
}

#[cfg(test)]
impl FramePrior {
    /// That of the unit tests: of a snake that is known to be an arc, without bias.
    pub const FIXTURE: Self = Self {
        mode_sigma_rad: [1e-3, 5e-4, 2e-4],
        contradiction_chi2: CONTRADICTION_OF_KNOWN_CHI2,
        bias: EdgeBias { side_px: 0.0, tube_px: 0.0, rim_px: 0.0, glare: [0.0; 2] },
        bias_sigma: [0.05, 0.05, 0.05, 0.1, 0.1],
    };
}

/// What a picture is fitted with.
#[derive(Debug, Clone, Copy)]
pub(crate) struct State {
    /// The bend along the snake.
    pub profile: BendProfile,
    pub bias: EdgeBias,
}

/// How many numbers a [`State`] has: those of the bend profile and the biases.
///
/// Convention: a count.
pub(crate) const STATE: usize = PROFILE + BIASES;

impl State {
    pub fn moved(&self, by: &SVector<f64, STATE>) -> Self {
        let (profile, bias) = by.as_slice().split_at(PROFILE);
        Self { profile: self.profile.stepped(profile), bias: self.bias.moved(bias) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;
    use rand::{SeedableRng, rngs::StdRng};
    use rand_distr::{Distribution, StandardNormal};

    /// Modes drawn from the prior and seen with errors of a known covariance have, on the average, a χ² of six; modes of three
    /// standard deviations more.
    #[test]
    fn the_contradiction_is_a_chi_squared_of_six_components() {
        const DRAWS: u32 = 4000;
        let prior = FramePrior::FIXTURE;
        let mut random = StdRng::seed_from_u64(5);
        let mut normal = move || -> Vector6<f64> { Vector6::from_fn(|_, _| StandardNormal.sample(&mut random)) };
        let sigma = Matrix6::from_diagonal(&Vector6::from_fn(|k, _| prior.mode_sigma_rad[k / 2]));
        // What edges say of the modes, as if they were independent: some components well, some hardly, and not one by one.
        let mix = Matrix6::from_fn(|r, c| if r == c { 1.0 } else { 0.3 / (1.0 + (r as f64 - c as f64).abs()) });
        let error = sigma * mix * Matrix6::from_diagonal(&Vector6::new(0.1, 0.3, 1.0, 0.5, 2.0, 0.2));
        let of_edges = (error * error.transpose() / noise_model().design_effect).try_inverse().unwrap();
        let known = (sigma * sigma / noise_model().design_effect).try_inverse().unwrap();
        let fitted = (of_edges + known).try_inverse().unwrap();
        let mut mean = |times: f64| {
            let chi2 = (0..DRAWS).map(|_| {
                let seen = sigma * normal() * times + error * normal();
                let modes = fitted * of_edges * seen;
                let profile = BendProfile {
                    tip: Vector2::zeros(),
                    modes: std::array::from_fn(|k| Vector2::new(modes[2 * k], modes[2 * k + 1])),
                };
                let mut independent = DMatrix::identity(STATE, STATE);
                independent.view_mut((2, 2), (6, 6)).copy_from(&fitted);
                prior.contradiction(&profile, &independent).unwrap()
            });
            chi2.sum::<f64>() / f64::from(DRAWS)
        };
        let (as_known, wider) = (mean(1.0), mean(3.0));
        // 4,000 draws of χ² with six degrees of freedom have a mean of 6 ± 0.055.
        assert!((as_known - 6.0).abs() < 0.25, "{as_known}");
        assert!(wider > 15.0, "{wider}");
    }

    #[test]
    fn every_piece_has_the_bias_of_its_kind() {
        let bias = EdgeBias { side_px: 0.1, tube_px: 0.2, rim_px: 0.3, glare: [0.1, 0.2] };
        let moved = EdgeBias::default().moved(&bias.to_array());
        assert_eq!(moved, bias);
        let of =
            [Piece::HolderSide(1), Piece::DiskSide(2, -1), Piece::Tube(3, 1, 4), Piece::BaseRim, Piece::Rim(5, true)];
        assert_eq!(of.map(|piece| bias.of(piece)), [0.1, 0.1, 0.2, 0.3, 0.3]);
        assert_eq!(of.map(|piece| bias.at(piece, None).0), [0.1, 0.1, 0.2, 0.3, 0.3]);
    }
}
