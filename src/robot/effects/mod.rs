//! Effects: physics of a real actuation line and a real eye that the paper's Eq. 18 leaves out.
//!
//! Each effect is one [`Physics`], which says all that the program knows of it: a name, an equation, a reading in words, parameters
//! with units and ranges, where a search for them starts, the one function by which it acts, what it must know of the path, what it
//! is confounded with. A [`Model`](super::Model) holds a list of [`Effect`]s, and everything that predicts obeys them through
//! [`mechanics`](super::mechanics). They act in these places:
//!
//! | where | what it is given | what it changes |
//! | --- | --- | --- |
//! | [`Changes::Line`] | the bend, τ, how the snake got there | a summand of ε, mm |
//! | [`Changes::Formula`] | the same | the same, as a user's formula says |
//! | [`Changes::Encoders`] | q̃ | what the encoders read beyond the lines' motion, mm |
//! | [`Changes::Drive`] | q̃ and what was read before | the travel of the lines that a reading leads to |
//! | [`Changes::Snake`] | the snake's constants | geometry, stiffness or load, and so q and τ |
//! | [`Changes::Eye`] | the bend | the bend that is measured |
//! | [`Changes::Exposure`] | nothing | the time at which a frame was exposed |
//! | [`Changes::Neighbours`] | what neighbouring sections' encoders read | the readings, before anything else |
//!
//! Some physics can be written down in more than one way, and no convention says which is meant: whether a play is crossed at
//! once or by travel, whether a screw's error follows what its encoder reads or what its nut travels. They are [forms](Physics::form)
//! of one name. `discover` tries all and names the effect; the form goes into the model with it.
//!
//! A user's own effect is a [`Definition`] with a formula; once checked it is a [`Physics`] as well.

mod actuator;
mod definition;
mod drive;
mod eye;
mod formula;
mod friction;
mod hysteresis;
mod physics;
mod rig;
mod section;
mod snake;
#[cfg(test)]
mod tests;
mod time;
mod variables;

pub use definition::{Defined, Definition, HALF_GAP};
pub use formula::Formula;
pub use physics::{Changes, Confounded, Instant, ParameterSpec, Phases, Physics, Poses, Role, Starts};
pub use rig::RIG_ERROR;
pub use variables::Variable;

/// The name of a bend at rest.
pub const REST_BEND: &str = "rest_bend";

/// The name of a force on the tip.
pub const TIP_LOAD: &str = "tip_load";

/// The name of the gain of a command, beside which η is told by what is known of it beforehand.
pub const COMMAND_GAIN: &str = "command_gain";

use super::BACKBONES;
use crate::error::{ArgumentError, Result};

/// Every effect that `discover` searches for, in every form; the first form of a name has none.
pub static LIBRARY: [&Physics; 47] = [
    &friction::LOAD_DIRECTED_BACKLASH,
    &friction::LOAD_DIRECTED_WIDTH,
    &friction::LOAD_DIRECTED_GRADUAL,
    &friction::MOTION_DIRECTED_BACKLASH,
    &friction::MOTION_DIRECTED_PLAY,
    &friction::PLAY_AT_BEND,
    &friction::CAPSTAN_PLAY,
    &hysteresis::DISTRIBUTED_FRICTION,
    &hysteresis::DISTRIBUTED_PER_BACKBONE,
    &hysteresis::BOUC_WEN,
    &hysteresis::BOUC_WEN_PER_BACKBONE,
    &friction::TENDON_SLACK,
    &friction::DEAD_BAND,
    &friction::DISC_FRICTION,
    &friction::CONE_FRICTION_REVERSAL,
    &friction::CONE_FRICTION_STATIC,
    &friction::CONE_FRICTION_MOTION,
    &actuator::ACTUATOR_SCALE,
    &actuator::ACTUATOR_OFFSET,
    &actuator::SCREW_PERIODIC,
    &actuator::SCREW_PHASES,
    &actuator::SCREW_TRAVEL,
    &actuator::SCREW_TRAVEL_PHASES,
    &snake::SUPERELASTIC_SOFTENING,
    &snake::CUBIC_STIFFNESS,
    &snake::THREEFOLD_STIFFNESS,
    &snake::REST_BEND,
    &snake::DEAD_WEIGHT,
    &snake::TIP_LOAD,
    &eye::PLANE_MISALIGNMENT,
    &eye::BEND_OFFSET,
    &eye::NON_CIRCULAR_SHAPE,
    &time::THERMAL_DRIFT,
    &time::CREEP,
    &time::CREEP_SETTLED,
    &time::CREEP_SOFTENING,
    &time::CREEP_LOGARITHMIC,
    &time::VISCOUS_DRAG,
    &eye::CAMERA_LATENCY,
    &snake::BACKBONE_RADII,
    &snake::BACKBONE_RADIUS,
    &snake::BACKBONE_RADII_AND_MEAN,
    &snake::BACKBONE_RADII_IN_Q,
    &snake::BACKBONE_AZIMUTH,
    &snake::BACKBONE_AZIMUTH_IN_Q,
    &snake::PRIMARY_COMPRESSION,
    &snake::BACKBONE_SHORTENING,
];

/// Couplings with neighbouring sections, which `discover` searches for where the log has their readings.
pub static COUPLINGS: [&Physics; 3] =
    [&section::SECTION_COUPLING, &section::SECTION_COUPLING_SECOND, &section::SECTION_COUPLING_BOTH];

/// What the drive does between the readings and the lines, which `discover` searches for as well.
pub static DRIVE: [&Physics; 7] = [
    &drive::BACKLASH,
    &drive::BACKLASH_PER_BACKBONE,
    &drive::BACKLASH_GROWING,
    &drive::BACKLASH_SPREAD,
    &drive::BACKLASH_UNEVEN,
    &drive::FRICTION_OF_THE_COMMAND,
    &drive::COMMAND_GAIN,
];

/// Every effect of the library: those of a section alone, of its drive and of its neighbours.
pub fn all() -> impl Iterator<Item = &'static Physics> {
    LIBRARY.into_iter().chain(DRIVE).chain(COUPLINGS)
}

/// Every physics of this name, the first form first; those that `discover` does not search for come last.
pub fn forms(name: &str) -> impl Iterator<Item = &'static Physics> {
    all().chain([&snake::TIP_WRENCH]).filter(move |physics| physics.name == name)
}

/// The first form of the physics of this name.
pub fn physics(name: &str) -> Option<&'static Physics> {
    forms(name).next()
}

/// Forms that older versions wrote into models, and the form that each is now.
const FORMER_FORMS: [(&str, &str, &str); 1] = [("viscous_drag", "speed since the sample before", "")];

/// The form of an effect that is meant by one written into a model.
fn current<'f>(name: &str, form: &'f str) -> &'f str {
    let former = FORMER_FORMS.iter().find(|(effect, former, _)| *effect == name && *former == form);
    former.map_or(form, |(_, _, now)| now)
}

/// An effect with the values of its parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct Effect {
    /// What it is.
    pub physics: &'static Physics,
    /// Values of its parameters.
    pub values: Vec<f64>,
    /// Where it was found; empty where nobody says.
    pub found: String,
}

impl Effect {
    /// An effect of a physics with these values.
    pub fn of(physics: &'static Physics, values: Vec<f64>) -> Self {
        Self { physics, values, found: String::new() }
    }

    /// The specifications of its values.
    pub fn parameters(&self) -> &'static [ParameterSpec] {
        self.physics.parameters_of(self.values.len())
    }

    /// An effect on a robot of so many backbones with known values: in the given form, else in the first whose parameters these
    /// are.
    ///
    /// # Errors
    /// [`ArgumentError`] for a name or form that is not in the library, an unknown or missing parameter, a value out of its range.
    pub fn new(name: &str, form: Option<&str>, parameters: &[(String, f64)], backbones: usize) -> Result<Self> {
        let fits = |physics: &&Physics| {
            let specs = physics.parameters_on(backbones);
            specs.len() == parameters.len()
                && specs.iter().all(|spec| parameters.iter().any(|(name, _)| name == spec.name))
        };
        let Some(first) = physics(name) else {
            let mut known: Vec<_> = all().map(|physics| physics.name.to_owned()).collect();
            known.dedup();
            return Err(ArgumentError::Unknown { what: "effect".into(), name: name.into(), known }.into());
        };
        let physics = match form {
            None => forms(name).find(fits).unwrap_or(first),
            Some(form) => forms(name).find(|physics| physics.form == current(name, form)).ok_or_else(|| {
                let known = forms(name).map(|physics| format!("{:?}", physics.form)).collect();
                ArgumentError::Unknown { what: format!("effect {name}: form"), name: form.into(), known }
            })?,
        };
        Self::with_parameters(physics, parameters, backbones)
    }

    /// An effect of a physics on a robot of so many backbones, its parameters by name.
    ///
    /// # Errors
    /// [`ArgumentError`] for an unknown or missing parameter, or a value out of its range.
    pub fn with_parameters(physics: &'static Physics, parameters: &[(String, f64)], backbones: usize) -> Result<Self> {
        let (name, specs) = (physics.name, physics.parameters_on(backbones));
        let takes = || specs.iter().map(|p| p.name).collect();
        if let Some((unknown, _)) = parameters.iter().find(|(n, _)| !specs.iter().any(|p| p.name == n)) {
            let (effect, parameter) = (name.to_owned(), unknown.clone());
            return Err(ArgumentError::UnknownParameter { effect, parameter, takes: takes() }.into());
        }
        let mut values = Vec::new();
        for spec in specs {
            let Some((_, value)) = parameters.iter().find(|(n, _)| n == spec.name) else {
                let (effect, parameter) = (name.to_owned(), spec.name);
                return Err(ArgumentError::MissingParameter { effect, parameter, takes: takes() }.into());
            };
            let (least, most) = spec.range;
            if !(least..=most).contains(value) {
                let (quantity, expected) =
                    (format!("effect {name}: {}", spec.name), format!("{least} to {most} ({})", spec.unit));
                return Err(ArgumentError::out_of_range(quantity, *value, "", expected).into());
            }
            values.push(*value);
        }
        Ok(Self::of(physics, values))
    }

    /// An effect as it is written on a command line: `name:parameter=value,parameter=value`, on a robot of as many backbones as
    /// its parameters are for.
    ///
    /// # Errors
    /// As [`new`](Self::new), and [`ArgumentError::Syntax`] for another form.
    pub fn parse(text: &str) -> Result<Self> {
        let form = || ArgumentError::Syntax {
            what: "effect",
            text: text.to_owned(),
            expected: "name:parameter=value,parameter=value",
        };
        let (name, list) = text.split_once(':').ok_or_else(form)?;
        let mut parameters: Vec<(String, f64)> = Vec::new();
        for pair in list.split(',') {
            let (key, value) = pair.split_once('=').ok_or_else(form)?;
            let key = key.trim().to_owned();
            if parameters.iter().any(|(given, _)| *given == key) {
                let expected = "each parameter once";
                return Err(ArgumentError::Syntax { what: "effect", text: text.to_owned(), expected }.into());
            }
            parameters.push((key, value.trim().parse().map_err(|_| form())?));
        }
        let on = |backbones| Self::new(name.trim(), None, &parameters, backbones);
        BACKBONES.map(on).find(Result::is_ok).unwrap_or_else(|| on(*BACKBONES.start()))
    }
}
