//! The unit of the encoder log: whether the gain from implied to seen bend is one that the line can have.
//!
//! Without effects q̃ = q + ηκτ + common parts, all linear in b to a per mille, so that Q⁺q̃ = (1 + ηk) b with a k of the model: the gain g of the
//! wiring check and η are one number, η = (1/g − 1)/k. A log in another unit has another g, and nothing but the range of η that
//! robots have tells so.

use super::rules::NORMAL_QUANTILE;
use crate::estimate::{PlainSample, line_share};
use crate::robot::{MAX_THETA, Model};
use crate::statistics::order::{mad_scale, median};
use std::f64::consts::PI;
use std::ops::RangeInclusive;

/// η that such robots have.
///
/// Derived: η scales forces that hang on Young's modulus and on diameters. Superelastic NiTi has 28 to 83 GPa, half to one and a half
/// times what a model takes, and ±5 % of a wire's diameter are ±20 % of its bending stiffness; together 0.4 to 1.8. Beyond a
/// third and three times it is another robot, or another unit.
pub(super) const PLAUSIBLE_ETA: RangeInclusive<f64> = 1.0 / 3.0..=3.0;
/// Units in which logs are kept by mistake: what one is in mm, and its name.
///
/// Convention: the units' definitions; two and a half stand for a diameter in place of a radius, a pulley block, and counters that count
/// every edge twice.
const UNITS: [(f64, &str); 8] = [
    (1000.0, "in metres"),
    (10.0, "in centimetres"),
    (25.4, "in inches"),
    (0.001, "in micrometres"),
    (0.0254, "in thousandths of an inch"),
    (0.5, "twice too large (a diameter for a radius, a pulley block, edges counted twice)"),
    (2.0, "half as large as they should be (a radius for a diameter, a pulley block)"),
    (0.25, "four times too large (every edge of a quadrature encoder counted)"),
];
/// Units that are the machine's own: how large one can be, mm, what it is, and what `scale` is then. Nothing but the machine's drawing tells
/// them from a unit of the list that is about as large.
///
/// Convention: drums and pulleys that fit into an actuation unit; resolutions of encoders.
const OF_THE_MACHINE: [(RangeInclusive<f64>, &str, &str); 2] = [
    (2.0..=50.0, "in radians of a drum", "the drum's radius in mm"),
    (1e-6..=0.05, "in counts of an encoder", "the travel of one count in mm"),
];
/// A factor that no unit of the list gives is told where it is larger than this, or smaller than one over it.
///
/// Convention: a smaller one may as well be the robot's own, and is told as η out of range.
pub(super) const LEAST_UNNAMED: f64 = 2.0;

/// A unit that would make η plausible.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Unit {
    /// What one unit of the log is, mm.
    pub mm: f64,
    /// Its name, where the factor is that of a unit.
    pub name: Option<&'static str>,
    /// What else it may be: a unit of the machine's own, and what `scale` is then.
    pub of_the_machine: Option<(&'static str, &'static str)>,
    /// η in that unit.
    pub eta: f64,
    /// The factor at which η would be 1, two digits of it.
    pub mm_at_nominal_eta: f64,
    /// η as the log stands.
    pub eta_as_it_is: f64,
}

/// The unit that the log is kept in, where η is implausible as it stands and plausible in that unit.
pub(super) fn unit(model: &Model, gain: f64, sd_gain: f64) -> Option<Unit> {
    let k = line_share(model);
    let eta = |gain: f64| (1.0 / gain - 1.0) / k;
    let reach = NORMAL_QUANTILE * sd_gain;
    if gain.is_nan() || gain <= reach || k <= 0.0 {
        return None;
    }
    let (least, most) = (eta(gain + reach), eta(gain - reach));
    if most >= *PLAUSIBLE_ETA.start() && least <= *PLAUSIBLE_ETA.end() {
        return None;
    }
    let eta_as_it_is = eta(gain);
    let nominal = 1.0 / (1.0 + k);
    let named = UNITS.iter().filter(|(mm, _)| PLAUSIBLE_ETA.contains(&eta(gain / mm)));
    let distance = |mm: f64| (gain / mm / nominal).ln().abs();
    let mm_at_nominal_eta = two_digits(gain / nominal);
    let of_the_machine = OF_THE_MACHINE.iter().find(|(sizes, ..)| sizes.contains(&mm_at_nominal_eta));
    let of_the_machine = of_the_machine.map(|&(_, what, scale)| (what, scale));
    let unit = |mm: f64, name| Unit { mm, name, of_the_machine, eta: eta(gain / mm), mm_at_nominal_eta, eta_as_it_is };
    if let Some(&(mm, name)) = named.min_by(|a, b| distance(a.0).total_cmp(&distance(b.0))) {
        return Some(unit(mm, Some(name)));
    }
    let is_large = mm_at_nominal_eta.ln().abs() > LEAST_UNNAMED.ln();
    is_large.then(|| unit(mm_at_nominal_eta, None))
}

/// Least bends that the readings must imply for the angles' unit to be judged, rad; their median may not be above π either.
///
/// Convention: 5°, well above the noise of any measurement.
const LEAST_IMPLIED: f64 = 0.087;
/// Samples that must agree. Convention: fewer may agree by chance.
const LEAST_SAMPLES: usize = 3;
/// Ratios of a number in the column of θ to the bend that the readings imply, rad, such as radians give.
///
/// Derived: 1/(1 + ηk) with η in [`PLAUSIBLE_ETA`] and k up to 0.5, which is 0.4 to 0.9, and as much again for another line.
const RATIOS_OF_RADIANS: RangeInclusive<f64> = 0.2..=1.5;
/// Relative spread of the ratios (1.4826 times their median absolute deviation), below which the bends follow the readings.
///
/// Convention: noise about a snake that does not move has a spread of about 1.
const MOST_SPREAD: f64 = 0.3;

/// Whether the measured angles, which are taken for degrees, are radians: all are as small as radians are, and their numbers follow the
/// bends that the readings imply as radians would.
pub(super) fn angles_are_radians(model: &Model, samples: &[PlainSample]) -> bool {
    let small = |sample: &PlainSample| {
        let psi = sample.measured.configuration;
        psi.theta_deg() <= MAX_THETA && psi.delta_deg().abs() <= PI
    };
    let implied = |sample: &PlainSample| model.robot.bend_and_common(&sample.q_mm).xy().norm();
    let bent: Vec<&PlainSample> = samples.iter().filter(|sample| implied(sample) > LEAST_IMPLIED).collect();
    if bent.len() < LEAST_SAMPLES || !samples.iter().all(small) {
        return false;
    }
    let ratios = || bent.iter().map(|sample| sample.measured.configuration.theta_deg() / implied(sample));
    let middle = median(&mut ratios().collect::<Vec<_>>());
    let spread = mad_scale(ratios().map(|ratio| ratio - middle)) / middle;
    let is_within = median(&mut bent.iter().map(|sample| implied(sample)).collect::<Vec<_>>()) <= PI;
    is_within && RATIOS_OF_RADIANS.contains(&middle) && spread < MOST_SPREAD
}

/// A number rounded to two significant digits.
fn two_digits(number: f64) -> f64 {
    format!("{number:.1e}").parse().unwrap_or(number)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Configuration;

    fn gain_of(model: &Model, mm: f64) -> f64 {
        let psi = Configuration::from_degrees(60.0, 20.0);
        let implied = model.robot.bend_by_displacement().tr_mul(&(model.command(psi) / mm));
        psi.bend_vector().norm() / implied.norm()
    }

    #[test]
    fn every_unit_is_found_on_any_plausible_robot_and_none_in_millimetres() {
        for eta in [0.5, 1.0, 1.221, 2.0] {
            let model = Model { eta, lambda_mm: 0.17, samples: Some(9), ..Model::default() };
            assert_eq!(unit(&model, gain_of(&model, 1.0), 1e-4), None);
            for (mm, _) in [UNITS[0], UNITS[2], UNITS[3], UNITS[4]] {
                let found = unit(&model, gain_of(&model, mm), 1e-4).unwrap();
                assert_eq!(found.mm, mm, "η {eta}: {found:?}");
            }
        }
        let model = Model { eta: 1.221, lambda_mm: 0.17, samples: Some(9), ..Model::default() };
        for mm in [0.5, 2.0, 10.0] {
            let found = unit(&model, gain_of(&model, mm), 1e-4).unwrap();
            assert!(found.mm == mm && (found.eta - 1.221).abs() < 0.01, "{found:?}");
        }
        // A drum of 8 mm is within what robots differ by from a centimetre, and one of 1 m is none.
        let drum = unit(&model, gain_of(&model, 8.0), 1e-4).unwrap();
        assert_eq!((drum.mm, drum.of_the_machine.map(|(what, _)| what)), (10.0, Some("in radians of a drum")));
        assert_eq!(unit(&model, gain_of(&model, 1000.0), 1e-4).unwrap().of_the_machine, None);
        let counts = unit(&model, gain_of(&model, 0.0001), 1e-9).unwrap();
        assert!(counts.name.is_none() && (counts.mm / 0.0001).ln().abs() < 0.2, "{counts:?}");
        assert_eq!(unit(&model, 1.5, 1.0), None, "a gain that is hardly known says nothing");
        assert_eq!(unit(&model, 0.0, 0.0), None);
    }
}
