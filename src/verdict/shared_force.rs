//! Whether the readings show the force that backbones share within force limits, where somebody says that they were commanded so.
//!
//! A shared force bends nothing: it adds κf(ψ) to the part of q̃ that all readings have in common. What the readings have there beyond the model is
//! therefore κf, λ and noise. λ is not in the steps from pose to pose, so that they tell the limits: what those that were told leave of the steps is
//! compared with what no limits leave, and other ones. Limits that leave equally much cannot be told apart, and matter only if λ would be another.

use super::health::without_a_tenth;
use super::reason::{Code, Level, Reason};
use super::rules::{LEVEL_OF_TESTS, MEAN_SQUARE_OF_NOISE};
use crate::estimate::{MOST_JUDGED, NewPoses, Pair, pairs_without_effects, usable};
use crate::geometry::Configuration;
use crate::observation::{EncoderReading, Measurement};
use crate::robot::{ForceLimits, Model};
use crate::statistics::moments::mean;

/// Other limits that are tried, as multiples of those that are told.
///
/// Convention: half as large again and more, either way; nearer ones are told apart by a tenth of the force at most.
const MULTIPLES: [f64; 8] = [0.25, 1.0 / 3.0, 0.5, 2.0 / 3.0, 1.5, 2.0, 3.0, 4.0];
/// Limits that cannot be told apart matter if they make λ differ by more than this, mm.
///
/// Convention: a tenth of the largest λ that robots have.
const MATTERS_MM: f64 = 0.1;

/// The readings without the force that the backbones share within limits, and a reason where they do not show that force. The model has the η by
/// which the bends are explained.
pub fn without_shared_force(
    model: &Model,
    limits: &ForceLimits,
    (measurements, readings): (&[Measurement], &[EncoderReading]),
    sd_encoder_mm: f64,
) -> (Vec<EncoderReading>, Option<Reason>) {
    let without =
        |reading: &EncoderReading| EncoderReading { q_mm: model.without_sharing(&reading.q_mm, limits), ..*reading };
    let doubt = doubt_of_force_limits(model, limits, measurements, readings, sd_encoder_mm);
    (readings.iter().map(without).collect(), doubt)
}

/// A reason where the readings do not show the force that the limits tell.
fn doubt_of_force_limits(
    model: &Model,
    limits: &ForceLimits,
    measurements: &[Measurement],
    readings: &[EncoderReading],
    sd_encoder_mm: f64,
) -> Option<Reason> {
    model.estimate()?;
    let poses = Poses::of(model, measurements, readings, sd_encoder_mm);
    let told = poses.explained_by(Some(*limits));
    let (least_n, most_n) = limits.ends_n();
    let multiples = MULTIPLES.iter().filter_map(|k| ForceLimits::new(k * least_n, k * most_n).ok()).map(Some);
    // Limits that act at no pose are none.
    let others: Vec<Explained> = [None].into_iter().chain(multiples).map(|other| poses.explained_by(other)).collect();
    let best = others.iter().min_by(|a, b| a.square_mm2.total_cmp(&b.square_mm2))?;
    let largest_mm = told.shifts_mm.iter().fold(0.0_f64, |most, mm| most.max(mm.abs()));
    let seen = format!("of the force that --force-limits tells, up to {largest_mm:.3} mm of q̃");
    let remedy = "give the limits of the table that commanded the robot, or leave --force-limits out if none did: η and the bends are right \
                  either way, and λ is not";
    // Twice the logarithm of the likelihood ratio where the noise's size is not known.
    let ratio = |better: &Explained, worse: &Explained| {
        told.steps as f64 * (worse.square_mm2 / better.square_mm2).ln() > -2.0 * LEVEL_OF_TESTS.ln()
    };
    // What is explained to the noise of the encoders needs no other limits.
    if ratio(best, &told) && told.square_mm2 > MEAN_SQUARE_OF_NOISE * poses.noise_mm2() {
        let which = match best.limits.map(|limits| limits.ends_n()) {
            Some((least, most)) => {
                format!("other force limits had acted, such as {least:.1},{most:.1} N").replace('-', "−")
            }
            None => "no force limits had acted".to_owned(),
        };
        let [told_mm, best_mm] = [&told, best].map(|explained| explained.square_mm2.sqrt());
        let text = format!(
            "the log reads as if {which}: {seen}, the readings differ from pose to pose by {told_mm:.3} mm, and then by {best_mm:.3} mm \
             ({} poses)",
            poses.all.len()
        );
        return Some(Reason::new(Code::ForceLimits, Level::Look, text, remedy));
    }
    let lambda_mm =
        |one: &Explained| (mean(one.shifts_mm.iter().copied()) - mean(told.shifts_mm.iter().copied())).abs();
    let open = others.iter().filter(|other| !ratio(&told, other)).map(lambda_mm).fold(0.0, f64::max);
    (open > MATTERS_MM).then(|| {
        let text = format!(
            "the poses do not tell whether these force limits acted: {seen}, other limits or none explain the readings as well, and make λ \
             differ by up to {open:.2} mm ({} poses)",
            poses.all.len()
        );
        let remedy = "make sure that these are the limits of the table that commanded the robot, or measure from nearly straight to the largest \
                      bend, where the limits begin to act";
        Reason::new(Code::ForceLimits, Level::Look, text, remedy)
    })
}

/// Poses that differ.
struct Poses {
    /// Where each is, and what the model leaves of what the readings have in common, mm.
    all: Vec<(Configuration, f64)>,
    /// The model without effects.
    plain: Model,
    sd_encoder_mm: f64,
}

/// What some limits leave.
struct Explained {
    /// `None` for no limits.
    limits: Option<ForceLimits>,
    /// What they add to each reading at each pose, mm.
    shifts_mm: Vec<f64>,
    /// Steps from pose to pose that are counted: all but the largest tenth.
    steps: usize,
    /// Mean square of what is left of these, mm².
    square_mm2: f64,
}

impl Poses {
    fn of(model: &Model, measurements: &[Measurement], readings: &[EncoderReading], sd_encoder_mm: f64) -> Self {
        let plain = model.plain();
        let mut new_poses = NewPoses::default();
        let pose = |(measurement, reading): Pair| {
            let (measured, q_mm) = usable(plain.robot.backbone_count(), &measurement, reading.as_ref()).ok()?;
            let psi = measured.configuration;
            new_poses.is_new(psi.bend_vector()).then(|| (psi, (q_mm - plain.command(psi)).mean()))
        };
        let all = pairs_without_effects(model, measurements, readings).filter_map(pose).take(MOST_JUDGED).collect();
        Self { all, plain, sd_encoder_mm }
    }

    /// The encoders' own share of a step of the readings' mean, mm².
    fn noise_mm2(&self) -> f64 {
        2.0 * self.sd_encoder_mm.powi(2) / self.plain.robot.backbone_count() as f64
    }

    fn explained_by(&self, limits: Option<ForceLimits>) -> Explained {
        let shift =
            |psi: &Configuration| limits.map_or(0.0, |limits| self.plain.sharing(*psi, &limits).shift_mm.mean());
        let shifts_mm: Vec<f64> = self.all.iter().map(|(psi, _)| shift(psi)).collect();
        let left: Vec<f64> = self.all.iter().zip(&shifts_mm).map(|((_, seen), shift)| seen - shift).collect();
        let mut squares: Vec<f64> = left.windows(2).map(|pair| (pair[1] - pair[0]).powi(2)).collect();
        squares.sort_unstable_by(f64::total_cmp);
        let steps = without_a_tenth(squares.len());
        // Below the encoders' noise nothing tells limits apart.
        let square_mm2 = mean(squares[..steps].iter().copied()).max(self.noise_mm2());
        Explained { limits, shifts_mm, steps, square_mm2 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::{BendingExperiment, Plant, SimulatedEye};

    /// What is said of a simulated robot that was commanded within some limits, where others are told.
    fn said(acted: Option<(f64, f64)>, told: (f64, f64)) -> Option<String> {
        let model = Model { eta: 1.221, lambda_mm: 0.1765, samples: Some(9), ..Model::default() };
        let plant = Plant { model: model.clone(), sd_encoder_mm: 0.0015 };
        let samples = plant.run(&BendingExperiment::default().waypoints().unwrap(), 3);
        let limits = |(least, most)| ForceLimits::new(least, most).unwrap();
        let reading = |row: &EncoderReading| {
            let shift = |acted| model.sharing(model.forward(&row.q_mm).unwrap().configuration, &limits(acted)).shift_mm;
            EncoderReading { q_mm: acted.map_or(row.q_mm, |acted| row.q_mm + shift(acted)), ..*row }
        };
        let readings: Vec<_> = samples.iter().map(|sample| reading(&sample.reading)).collect();
        let measurements = SimulatedEye::default().observe(&samples, 4);
        doubt_of_force_limits(&model, &limits(told), &measurements, &readings, 0.0015).map(|reason| reason.text)
    }

    #[test]
    fn limits_that_did_not_act_are_told_and_those_that_did_are_not() {
        for limits in [(-60.0, 15.0), (-20.0, 5.0)] {
            assert_eq!(said(Some(limits), limits), None, "{limits:?}");
            let words = said(None, limits).unwrap();
            assert!(words.starts_with("the log reads as if no force limits had acted"), "{limits:?}: {words}");
        }
        // Limits that no pose meets make no difference.
        assert_eq!(said(None, (-1000.0, 1000.0)), None);
        for (acted, told) in
            [((-60.0, 15.0), (-20.0, 5.0)), ((-20.0, 5.0), (-60.0, 15.0)), ((-20.0, 5.0), (-30.0, 7.5))]
        {
            let words = said(Some(acted), told);
            assert!(
                words.as_ref().is_some_and(|words| words.contains("other force limits")),
                "{acted:?} {told:?}: {words:?}"
            );
        }
    }
}
