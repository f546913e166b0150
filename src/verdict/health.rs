//! What a model leaves of the measurements, in one place: the innovations, whitened by the stated noise of measurements and encoders.
//!
//! A residual has a part that bends and a part common to all backbones. The bending part decides whether the table is right. Its noise
//! is that of the measured bend and the assumed noise of an encoder reading. It is not learned from the common part: a jitter that all readings share, a
//! scale of one encoder or a load that the backbones share move the common part, and say nothing of the noise of the bending part. The
//! common part moves neither θ nor δ, so that its noise is learned from its own scatter.
//!
//! Both parts are judged by their mean square, so that the size of a gap counts as well as the number of poses. The largest tenth is left
//! out, as hands and reflections may spoil that many frames. The bending part is judged besides by what it has of mistakes of a known form,
//! where noise hides them from the mean square ([`systematic`](super::systematic)). Which single cause accounts for a gap is asked in
//! [`cause`](super::cause).

use super::reason::{Code, Level, Reason};
use super::rules::{MEAN_SQUARE_OF_NOISE, NORMAL_QUANTILE, REJECTED_IN_ORDER, new_poses};
use super::systematic::{AffineFit, ScaleFit, agreeing};
use crate::estimate::{self, LinearisedMeasurement, PlainSample, Weighting, Whitened, line_share};
use crate::robot::data_range::ASKED_FOR;
use crate::robot::{Model, PerBackbone};
use crate::statistics::chi_square;
use crate::statistics::moments::{mean, rms};
use crate::statistics::order::mad_scale;
use nalgebra::{Matrix2, Matrix2x6, Vector2};
use std::cell::OnceCell;

/// Mean square of normal values of which the largest tenth is left out: of pairs (χ² with two degrees of freedom), and of single ones.
///
/// Derived: (1 − α − α ln(1/α)) / (1 − α), and P(χ²_3 < Φ⁻¹(0.95)²) / (1 − α), with α = 0.1.
pub(super) const TRIMMED_MEAN_SQUARE: [f64; 2] = [0.744_157, 0.623_236];

/// A model that misses more than this share of the bends says nothing of them. Convention: half; it then explains three quarters of their variance.
const MOST_MISSED: f64 = 0.5;

/// A gap is surely no larger than it seems and so many of its standard deviations. Convention: 95 %.
const SURELY_SDS: f64 = 2.0;

/// What to do about a gap.
const NAMED_BY_DISCOVER: &str = "`snakeloop discover` names what the model lacks; where it names nothing, check camera.yaml (focal length, \
                                 picture size), grid_pitch_mm, standoff_mm and the straight picture";

/// What to do about a gap that is the same in all poses.
const ZEROED_BENT: &str = "zero the encoders while the snake is straight, and log anew; if they were, `snakeloop discover` names what bends it at rest";

/// What the model leaves of one pose.
#[derive(Clone)]
pub(super) struct Innovation {
    /// The frame's index.
    pub index: u64,
    /// The bending part, in units of its standard deviations.
    pub bending: Vector2<f64>,
    /// What η adds to it by a unit, likewise.
    pub by_eta: Vector2<f64>,
    /// What each encoder's reading adds to it by a mm, likewise.
    pub by_reading: PerBackbone<Vector2<f64>>,
    /// L⁻¹ of the bending part's covariance L Lᵗ, 1/mm.
    pub whitener: Matrix2<f64>,
    /// What the rig's six unit errors add to the bending part, in units of its standard deviations.
    pub by_rig: Matrix2x6<f64>,
    /// The bend seen, rad.
    pub bend: Vector2<f64>,
    /// The common part, mm (√n times its mean).
    pub common_mm: f64,
    /// The reading, mm.
    pub q_mm: PerBackbone,
    /// Size of the bending part, mm.
    missed_mm: f64,
    /// What compensation by the naive model moves the bending part by, mm.
    compensated_mm: f64,
}

impl Innovation {
    fn of(sd_encoder_mm: f64, plain: &Model, sample: &PlainSample) -> Option<Self> {
        let PlainSample { index, measured, q_mm, .. } = sample;
        let robot = &plain.robot;
        let plainly = estimate::Sample { measured: *measured, q_tilde: *q_mm, came: None };
        let one = LinearisedMeasurement::new(plain, Weighting::Measured, sd_encoder_mm, &plainly);
        let residual = one.residual(plain.parameters().as_slice());
        let whitened = Whitened::new(&residual, &one.covariance)?;
        let whitener = one.covariance.fixed_view::<2, 2>(0, 0).into_owned().cholesky()?.l().try_inverse()?;
        let whiten = |column: Vector2<f64>| whitener * column;
        let by_reading = PerBackbone::from_fn(q_mm.len(), |i| {
            let alone = PerBackbone::from_fn(q_mm.len(), |j| if i == j { 1.0 } else { 0.0 });
            whiten(robot.bend_and_common(&alone).xy())
        });
        let naive = plain.without_estimate();
        let psi = measured.configuration;
        let compensation = naive.command(psi) - robot.joint_displacements(psi);
        let innovation = Self {
            index: *index,
            bending: whitened.bending,
            by_eta: whiten(one.h.column(0).xy()),
            by_reading,
            whitener,
            by_rig: whitener * one.by_rig.fixed_view::<2, 6>(0, 0),
            bend: psi.bend_vector(),
            common_mm: residual.z,
            q_mm: *q_mm,
            missed_mm: residual.xy().norm(),
            compensated_mm: robot.bend_and_common(&compensation).xy().norm(),
        };
        innovation.bending.norm_squared().is_finite().then_some(innovation)
    }

    /// What an encoder's relative error adds to the bending part by a unit, in units of its standard deviations.
    pub fn by_scale(&self, backbone: usize) -> Vector2<f64> {
        self.by_reading[backbone] * self.q_mm[backbone]
    }
}

/// The innovations at poses that differ.
pub(super) struct Health {
    /// Of the bending part, the largest tenth left out; in order of time.
    pub innovations: Vec<Innovation>,
    /// All of them.
    pub all: Vec<Innovation>,
    /// All but the tenth that agrees least with any affine gap; found where it is asked for, since live judges each frame by the bending part alone.
    agreeing: OnceCell<Vec<Innovation>>,
    /// Squares of the common part in units of its noise, the largest tenth left out.
    common: Vec<f64>,
    /// ∂θ by a bending part of q̃, rad per mm.
    pub bend_by_mm: f64,
    sd_encoder_mm: f64,
}

impl Health {
    /// What a model leaves of samples, whose readings have this standard deviation, mm.
    pub fn of(model: &Model, sd_encoder_mm: f64, samples: &[PlainSample]) -> Self {
        let plain = model.plain();
        let poses = new_poses(samples).filter_map(|sample| Innovation::of(sd_encoder_mm, &plain, sample));
        let innovations: Vec<Innovation> = poses.collect();
        let noise_mm = common_noise_mm(&innovations, |one| one.common_mm).max(sd_encoder_mm);
        let common = innovations.iter().map(|one| (one.common_mm / noise_mm).powi(2)).collect();
        // QᵗQ is n r²/2 times the identity, and η's share of q̃ is k.
        let robot = &plain.robot;
        let length = robot.backbone_circle_radius_mm * (robot.backbone_count() as f64 / 2.0).sqrt();
        let bend_by_mm =
            1.0 / (length * (1.0 + plain.parameters().x * line_share(&plain)).abs().max(f64::MIN_POSITIVE));
        let all = innovations.clone();
        let innovations = without_largest(innovations, |one| one.bending.norm_squared());
        let common = without_largest(common, |square| *square);
        Self { innovations, all, agreeing: OnceCell::new(), common, bend_by_mm, sd_encoder_mm }
    }

    pub fn agreeing(&self) -> &[Innovation] {
        self.agreeing.get_or_init(|| agreeing(&self.all))
    }

    /// The rms of the bending part in units of its noise.
    pub fn missed(&self) -> f64 {
        rms(self.innovations.iter().map(|one| one.bending.norm()))
    }

    /// The rms of the bending part in units of its noise, if it is above what counts as noise.
    pub fn bending_above_noise(&self) -> Option<f64> {
        let squares: Vec<f64> = self.innovations.iter().map(|one| one.bending.norm_squared()).collect();
        above_noise(&squares, 2)
    }

    /// The same of what the readings have in common.
    pub fn common_above_noise(&self) -> Option<f64> {
        above_noise(&self.common, 1)
    }

    /// Whether the bends are missed by more than noise.
    pub fn has_gap(&self) -> bool {
        self.bending_above_noise().is_some() || self.systematic().is_some()
    }

    /// By how much the affine part of the gap moves a bend of the data, rad, and of which form it is; if it is more than noise accounts for, as a
    /// whole or as a single encoder's scale, and may be more than a table may be wrong by.
    fn systematic(&self) -> Option<(f64, String)> {
        let affine = AffineFit::of(self.agreeing().iter())?;
        let most = self.bend_by_mm * affine.most_mm;
        let scale = || self.scales().into_iter().find(ScaleFit::is_beyond_chance);
        let (sds, form) = match affine.is_beyond_chance() {
            true => (affine.sds(), "in proportion to the bend or by a constant".to_owned()),
            false => scale().map(|scale| (scale.sds(), format!("as where {}", scale.text())))?,
        };
        // What is as large as so many of its standard deviations is as uncertain as their inverse.
        (most * (1.0 + SURELY_SDS / sds) > ASKED_FOR).then_some((most, form))
    }

    /// What speaks against a model whose log has no encoder that stands still throughout, or is wired as it is read: the gap, and which single encoder or
    /// which homing accounts for it.
    pub fn reasons(&self, model: &Model, is_moving: bool, is_wired: bool) -> Vec<Reason> {
        let rehomed = self.rehomed(model);
        // What a step of all readings leaves in common is told with it.
        let gap = self.gap().filter(|_| rehomed.is_none());
        let stuck = is_moving.then(|| self.encoder_stuck()).flatten();
        let scale = is_wired.then(|| self.encoder_scale()).flatten();
        let step = rehomed.or_else(|| is_wired.then(|| self.encoder_step()).flatten());
        [stuck, scale, gap, step].into_iter().flatten().collect()
    }

    /// The gap, if there is one: of the bends, of the form of a known mistake, or of what the readings have in common.
    fn gap(&self) -> Option<Reason> {
        let poses = self.all.len();
        let systematic = || {
            let (most, form) = self.systematic()?;
            Some(format!("the model misses the bends by up to {:.2}° {form} ({poses} poses)", most.to_degrees()))
        };
        let common = || {
            let times = self.common_above_noise()?;
            Some(format!(
                "the model misses what the readings have in common by {times:.1} times the noise ({poses} poses)"
            ))
        };
        let look = |text| Reason::new(Code::GapAboveNoise, Level::Look, text, NAMED_BY_DISCOVER);
        self.missed_bends().or_else(|| systematic().or_else(common).map(look))
    }

    /// Bends that the model misses by more than noise: red if by more than compensation changes them, or by a large share of what they are.
    pub fn missed_bends(&self) -> Option<Reason> {
        let times = self.bending_above_noise()?;
        let missed_mm = rms(self.innovations.iter().map(|one| one.missed_mm));
        let compensated_mm = rms(self.innovations.iter().map(|one| one.compensated_mm));
        let missed_deg = (self.bend_by_mm * missed_mm).to_degrees();
        let bent_deg = rms(self.innovations.iter().map(|one| one.bend.norm())).to_degrees();
        let red = if missed_mm > compensated_mm {
            Some(format!("all that compensation changes is {compensated_mm:.3} mm"))
        } else if missed_deg > MOST_MISSED * bent_deg {
            Some(format!("the bends themselves are {bent_deg:.1}°"))
        } else {
            None
        };
        let at_rest = self.at_rest();
        let missed = if missed_deg > 180.0 { "more than 180°".to_owned() } else { format!("{missed_deg:.2}°") };
        let text = format!(
            "the model misses the bends by {times:.1} times the noise: {missed}, or {missed_mm:.3} mm of q̃ ({} poses){}",
            self.all.len(),
            at_rest.as_ref().map(|rest| format!("; {rest}")).unwrap_or_default()
        );
        let what_to_do = if at_rest.is_some() { ZEROED_BENT } else { NAMED_BY_DISCOVER };
        Some(match red {
            Some(beside) => Reason::new(Code::GapAboveNoise, Level::DoNotUse, format!("{text}; {beside}"), what_to_do),
            None => {
                let sd = self.sd_encoder_mm;
                let remedy = format!("{what_to_do}; if the encoders are noisier than {sd} mm, give --encoder-sd");
                Reason::new(Code::GapAboveNoise, Level::Look, text, remedy)
            }
        })
    }
}

/// Noise of the common part, mm: the scatter of its steps from one pose to the next, which a median keeps from jumps.
pub(super) fn common_noise_mm(innovations: &[Innovation], common_mm: impl Fn(&Innovation) -> f64) -> f64 {
    let steps = innovations.windows(2).map(|pair| common_mm(&pair[1]) - common_mm(&pair[0]));
    mad_scale(steps) / 2f64.sqrt()
}

/// How many of so many things are kept where a tenth of them, one at least, is left out.
pub(super) fn without_a_tenth(count: usize) -> usize {
    count.saturating_sub((REJECTED_IN_ORDER * count as f64).ceil() as usize)
}

/// All but the largest tenth; in their order.
pub(super) fn without_largest<T>(items: Vec<T>, size: impl Fn(&T) -> f64) -> Vec<T> {
    let mut sizes: Vec<f64> = items.iter().map(&size).collect();
    sizes.sort_unstable_by(f64::total_cmp);
    match without_a_tenth(sizes.len()).checked_sub(1) {
        Some(last) => items.into_iter().filter(|item| size(item) <= sizes[last]).collect(),
        None => Vec::new(),
    }
}

/// The rms in units of the noise, if squares of so many numbers each are larger than what counts as noise allows.
fn above_noise(squares: &[f64], numbers: usize) -> Option<f64> {
    let nominal = numbers as f64 * TRIMMED_MEAN_SQUARE[2 - numbers];
    let most = MEAN_SQUARE_OF_NOISE
        * TRIMMED_MEAN_SQUARE[2 - numbers]
        * chi_square::quantile((numbers * squares.len()) as f64, NORMAL_QUANTILE);
    let times = (mean(squares.iter().copied()) / nominal).sqrt();
    (!squares.is_empty() && squares.iter().sum::<f64>() > most).then_some(times)
}
