//! What an effect says of itself: its equation, its parameters, what it changes, and how it is searched for.

use super::formula::Formula;
use super::variables::Variable;
use crate::robot::drive::Drive;
use crate::robot::history::{Arrival, History, Motion};
use crate::robot::line::Line;
use crate::robot::statics::Snake;
use crate::robot::{BACKBONES, NEIGHBOURS, PerBackbone};
use nalgebra::Vector2;

/// A parameter of an effect.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ParameterSpec {
    /// Its name; ends in the unit where it has one.
    pub name: &'static str,
    /// Its unit, `1` for a number without.
    pub unit: &'static str,
    /// Least and largest value that such a robot can have.
    pub range: (f64, f64),
    /// A change of this size matters: for a size about 0.05 mm of effect on the paper's robot. The unit of steps in a fit.
    pub typical: f64,
    /// What the parameter does to the effect.
    pub role: Role,
}

/// What a parameter does to its effect.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Role {
    /// The effect is proportional to it, or nearly so, and there is none at zero.
    Size {
        /// Whether it has either sign in nature; else simulated experiments draw it positive.
        either_sign: bool,
    },
    /// It says which shape the effect has, as a time constant or a pitch does.
    Shape {
        /// A value that such a robot may well have.
        example: f64,
        /// Between which values simulated experiments draw it.
        drawn: (f64, f64),
    },
}

impl ParameterSpec {
    /// A size that may have either sign.
    pub const fn size(name: &'static str, unit: &'static str, most: f64, typical: f64) -> Self {
        Self { name, unit, range: (-most, most), typical, role: Role::Size { either_sign: true } }
    }

    /// A size that is positive in nature. A fit may make it negative, where the range allows it.
    pub const fn positive(name: &'static str, unit: &'static str, range: (f64, f64), typical: f64) -> Self {
        Self { name, unit, range, typical, role: Role::Size { either_sign: false } }
    }
}

/// One parameter for each backbone, whose name has the backbone's number between the two texts; others may come first.
macro_rules! per_backbone {
    ([$($first:expr,)*] $spec:ident, $before:literal, $after:literal) => {
        [
            $($first,)*
            $spec(concat!($before, "1", $after)),
            $spec(concat!($before, "2", $after)),
            $spec(concat!($before, "3", $after)),
            $spec(concat!($before, "4", $after)),
            $spec(concat!($before, "5", $after)),
            $spec(concat!($before, "6", $after)),
            $spec(concat!($before, "7", $after)),
            $spec(concat!($before, "8", $after)),
        ]
    };
    ($spec:ident, $before:literal, $after:literal) => {
        per_backbone!([] $spec, $before, $after)
    };
}
pub(super) use per_backbone;

/// The snake at one instant, as effects on the line see it.
#[derive(Debug, Clone, Copy)]
pub struct Instant<'a> {
    /// The snake's constants, with the effects on them applied.
    pub snake: &'a Snake,
    /// The actuation line's constants, η and λ.
    pub line: &'a Line,
    /// The bend vector, rad.
    pub bend: Vector2<f64>,
    /// q, mm.
    pub q_mm: PerBackbone,
    /// τ of Eq. 11, N, positive towards +q, before η.
    pub tau_n: PerBackbone,
    /// q + ε of what stands before the effect in the model, mm.
    pub line_mm: PerBackbone,
    /// How the snake got there.
    pub motion: &'a Motion,
    /// What that has come to.
    pub arrival: &'a Arrival,
}

/// What an effect changes, and how. The parameters come in the order of [`Physics::parameters`].
#[derive(Debug, Clone, Copy)]
pub enum Changes {
    /// A summand of ε, mm.
    Line(fn(&Instant, &[f64]) -> PerBackbone),
    /// The same as a user's formula.
    Formula(&'static Formula),
    /// What the encoders read beyond the lines' motion, mm, from q̃.
    Encoders(fn(&PerBackbone, &[f64]) -> PerBackbone),
    /// What lies between the readings and the travel of the lines.
    Drive(fn(&mut Drive, &[f64])),
    /// The snake's constants: geometry, stiffness or load, and so q and τ.
    Snake(fn(&mut Snake, &[f64])),
    /// The bend vector that the eye measures, from the true one, rad.
    Eye(fn(Vector2<f64>, &[f64]) -> Vector2<f64>),
    /// The time at which a frame was exposed: so many seconds before the encoders' reading.
    Exposure(fn(&[f64]) -> f64),
    /// The bend, times the circle's radius (mm), by which neighbouring sections lead the lines, from the neighbours' own.
    Neighbours(fn(&[Vector2<f64>; NEIGHBOURS], &[f64]) -> Vector2<f64>),
}

/// Where a search for an effect's parameters starts.
#[derive(Debug, Clone, Copy)]
pub enum Starts {
    /// At these values, those that are not named at 0; several where the fit is not nearly linear.
    At(&'static [&'static [f64]]),
    /// At the peaks of a periodogram of the residuals over q̃. The parameters are an amplitude (mm), a pitch (mm), then phases
    /// (degrees).
    Periodogram(Phases),
    /// Nowhere: it is not searched for.
    Nowhere,
}

/// Which phases a periodic effect has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phases {
    /// One for all backbones.
    Common,
    /// One for each backbone.
    PerBackbone,
}

/// Another effect, or η or λ, that looks alike.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Confounded {
    /// The other effect's name, or `eta` or `lambda_mm`.
    pub with: &'static str,
    /// On which data.
    pub on: Poses,
}

/// The data on which two effects look alike.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Poses {
    /// Any.
    Any,
    /// All bends lie in one plane.
    OnePlane,
}

/// One effect's physics: all that the program knows of it.
#[derive(Debug, Clone, Copy)]
pub struct Physics {
    /// Its canonical name.
    pub name: &'static str,
    /// Which of the forms of this name it is; empty for the first. Forms are one physics written down in different ways, where
    /// no convention says which.
    pub form: &'static str,
    /// Its equation.
    pub equation: &'static str,
    /// What it means, in words that follow "the data show".
    pub reading: &'static str,
    /// Its parameters on a robot of so many backbones. More backbones never mean fewer parameters. Those of a formula are its own;
    /// [`parameters_on`](Self::parameters_on) gives either.
    pub parameters: fn(usize) -> &'static [ParameterSpec],
    /// Where a search for its parameters starts.
    pub starts: Starts,
    /// What it changes.
    pub changes: Changes,
    /// What must be known of the path, beside the bend and the time.
    pub history: Option<fn(&mut History, &[f64])>,
    /// Whether it depends on the time, beside the path.
    pub in_time: bool,
    /// Which neighbouring sections' readings it follows.
    pub follows_neighbour: [bool; NEIGHBOURS],
    /// The largest first parameter for which its equation has one answer, given the others; none where any has.
    pub largest_size: Option<fn(&[f64]) -> f64>,
    /// Effects that it tells of as well: they are not looked for beside it, and beside a discrepancy it is tried in their place.
    pub includes: &'static [&'static str],
    /// What it must gain in Schwarz's criterion beyond the price of its parameters before it is believed.
    pub prior_penalty: f64,
    /// The logarithm of the odds beforehand that any machine with cable or rod drives has it, where a discrepancy beside it is expected.
    pub log_prior: f64,
    /// What it is confounded with by its equation; a search finds out what a given experiment confounds besides.
    pub confounded_with: &'static [Confounded],
}

/// The logarithm of the prior odds of a bend at rest: no machine is quite straight.
///
/// Convention: a prior is a choice; e¹.
pub(super) const EXPECTED: f64 = 1.0;

/// That of a gain, and of a frame that is turned.
///
/// Convention: as [`EXPECTED`]; there as likely as not.
pub(super) const OPEN: f64 = 0.0;

/// That of a backlash.
///
/// Convention: as [`EXPECTED`]; e⁻¹.
pub(super) const USUAL: f64 = -1.0;

/// That of what many machines have: friction, a stiffness that is not constant, a load, slack.
///
/// Convention: as [`EXPECTED`]; e⁻³.
pub(super) const FREQUENT: f64 = -3.0;

/// That of all else: drags, drifts, clocks, errors of single parts.
///
/// Convention: as [`EXPECTED`]; e⁻⁶.
pub(super) const UNUSUAL: f64 = -6.0;

/// What most effects have in common: one form, a nearly linear fit that starts at zero, no history.
pub(super) const LINEAR: Physics = Physics {
    name: "",
    form: "",
    equation: "",
    reading: "",
    parameters: |_| &[],
    starts: Starts::At(&[&[]]),
    changes: Changes::Line(|at, _| at.q_mm * 0.0),
    history: None,
    in_time: false,
    follows_neighbour: [false; NEIGHBOURS],
    largest_size: None,
    includes: &[],
    prior_penalty: 0.0,
    log_prior: UNUSUAL,
    confounded_with: &[],
};

/// Shares of the typical size that differ from one parameter to the next, so that an example is not hidden in η and λ, which are
/// what the backbones share.
///
/// Convention: any that differ.
const EXAMPLE_SHARES: [f64; 8] = [1.0, -0.7, 0.4, -0.9, 0.6, -0.3, 0.8, -0.5];

impl PartialEq for Physics {
    fn eq(&self, other: &Self) -> bool {
        self.name == other.name && self.form == other.form && self.equation == other.equation
    }
}

impl Physics {
    /// Its parameters on a robot of so many backbones.
    pub fn parameters_on(&self, backbones: usize) -> &'static [ParameterSpec] {
        match self.changes {
            Changes::Formula(formula) => formula.parameters(),
            _ => (self.parameters)(backbones),
        }
    }

    /// Whether it is a matter of the pose alone, however the snake got there.
    pub fn is_static(&self) -> bool {
        let has_memory = matches!(self.changes, Changes::Formula(formula) if formula.has_memory());
        self.history.is_none() && !has_memory && !self.in_time
    }

    /// Whether it is play or friction: it depends on the path and not on the speed along it.
    pub fn is_hysteresis(&self) -> bool {
        let mut history = History::default();
        if let (Some(needs), false) = (self.history, self.in_time) {
            needs(&mut history, &self.example(*BACKBONES.start()));
        }
        (history.direction || history.drive || history.has_hysteresis()) && !history.goes_by_time()
    }

    /// Whether the data must say at which period a search for it starts.
    pub fn is_periodic(&self) -> bool {
        matches!(self.starts, Starts::Periodogram(_))
    }

    /// Says to a history what it must know of the path.
    pub(in crate::robot) fn note_history(&self, history: &mut History, values: &[f64]) {
        if let Some(needs) = self.history {
            needs(history, values);
        }
        let Changes::Formula(formula) = self.changes else { return };
        history.direction |= formula.has(Variable::Direction);
        history.speed |= formula.has(Variable::Speed);
        if let Some(half_mm) = formula.half_gap_mm(values) {
            history.add_formula_play(half_mm);
        }
    }

    /// Its parameters' values where a search starts, on a robot of so many backbones; none where data must say them.
    pub fn given_starts(&self, backbones: usize) -> impl Iterator<Item = Vec<f64>> {
        let starts = match self.starts {
            Starts::At(starts) => starts,
            Starts::Periodogram(_) | Starts::Nowhere => &[],
        };
        let count = self.parameters_on(backbones).len();
        starts.iter().map(move |start| {
            let mut values = start.to_vec();
            values.resize(count, 0.0);
            values
        })
    }

    /// Its parameters at a size that matters, on a robot of so many backbones.
    pub fn example(&self, backbones: usize) -> Vec<f64> {
        let value = |(spec, share): (&ParameterSpec, f64)| match spec.role {
            Role::Size { either_sign: true } => share * spec.typical,
            Role::Size { either_sign: false } => share.abs() * spec.typical,
            Role::Shape { example, .. } => example,
        };
        self.parameters_on(backbones).iter().zip(EXAMPLE_SHARES.into_iter().cycle()).map(value).collect()
    }

    /// The specifications of so many values, whatever the robot.
    pub(super) fn parameters_of(&self, values: usize) -> &'static [ParameterSpec] {
        // More backbones never mean fewer parameters, so that the number of values tells the list.
        let lists = BACKBONES.map(|backbones| self.parameters_on(backbones));
        lists.into_iter().find(|list| list.len() >= values).unwrap_or_default()
    }
}
