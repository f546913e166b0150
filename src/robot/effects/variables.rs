//! What a formula may speak of: the snake at one instant, as backbone i sees it.

use super::physics::Instant;
use crate::robot::{Mechanics, Model, Motion, PerBackbone, Robot};
use nalgebra::Vector2;

/// A variable of a formula.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Variable {
    /// `q`: q_i, mm.
    Q,
    /// `tau`: τ_i, N, before η.
    Tau,
    /// `s`: the direction in which q_i last moved, −1 or 1, 0 where it never moved.
    Direction,
    /// `v`: q̇_i, mm/s.
    Speed,
    /// `t`: time since the first reading, s; 0 for a single pose.
    Time,
    /// `x`: θ cos δ, rad.
    X,
    /// `y`: θ sin δ, rad.
    Y,
    /// `theta`: θ, rad.
    Theta,
    /// `load`: Σ|τ|, N.
    Load,
    /// `play`: where q_i stands in a play that it has to cross at a reversal, mm from the play's middle.
    Play,
    /// `q_1` …: q of the backbone of this number, mm; 0 where there is none.
    QOf(usize),
    /// `tau_1` …: τ of the backbone of this number, N; 0 where there is none.
    TauOf(usize),
    /// `on_1` …: 1 for the backbone of this number, 0 for the others.
    On(usize),
}

/// The variables without a number.
const PLAIN: [(&str, Variable); 10] = [
    ("q", Variable::Q),
    ("tau", Variable::Tau),
    ("s", Variable::Direction),
    ("v", Variable::Speed),
    ("t", Variable::Time),
    ("x", Variable::X),
    ("y", Variable::Y),
    ("theta", Variable::Theta),
    ("load", Variable::Load),
    ("play", Variable::Play),
];

/// The beginning of a name that ends in a backbone's number, and the variable of that backbone.
type Numbered = (&'static str, fn(usize) -> Variable);

/// The variables with a backbone's number.
const NUMBERED: [Numbered; 3] = [("q_", Variable::QOf), ("tau_", Variable::TauOf), ("on_", Variable::On)];

/// All variables, as a message lists them.
pub fn known_variables() -> String {
    let plain = PLAIN.iter().map(|(name, _)| (*name).to_owned());
    let numbered = NUMBERED.iter().map(|(name, _)| format!("{name}1 …"));
    plain.chain(numbered).collect::<Vec<_>>().join(", ")
}

impl Variable {
    /// The variable of this name.
    pub fn of(name: &str) -> Option<Self> {
        if let Some((_, variable)) = PLAIN.iter().find(|(own, _)| *own == name) {
            return Some(*variable);
        }
        let numbered = |(before, of): &Numbered| {
            let number = name.strip_prefix(before)?.parse().ok()?;
            (1..=*crate::robot::BACKBONES.end()).contains(&number).then(|| of(number))
        };
        NUMBERED.iter().find_map(numbered)
    }

    /// Its name.
    pub fn name(self) -> String {
        match self {
            Self::QOf(number) => format!("q_{number}"),
            Self::TauOf(number) => format!("tau_{number}"),
            Self::On(number) => format!("on_{number}"),
            plain => PLAIN.iter().find(|(_, own)| *own == plain).map_or("", |(name, _)| name).to_owned(),
        }
    }

    /// Its value for backbone i (from 0); `play` is the place of the formula's play among those of the motion.
    pub fn value(self, at: &Instant, i: usize, play: usize) -> f64 {
        let of = |values: &PerBackbone, number: usize| if number <= values.len() { values[number - 1] } else { 0.0 };
        match self {
            Self::Q => at.q_mm[i],
            Self::Tau => at.tau_n[i],
            Self::Direction => at.motion.direction[i],
            Self::Speed => at.arrival.speed_mm_per_s[i],
            Self::Time => at.motion.elapsed_s,
            Self::X => at.bend.x,
            Self::Y => at.bend.y,
            Self::Theta => at.bend.norm(),
            Self::Load => at.tau_n.iter().map(|tau| tau.abs()).sum(),
            Self::Play => at.arrival.hysteresis.play_mm[play][i],
            Self::QOf(number) => of(&at.q_mm, number),
            Self::TauOf(number) => of(&at.tau_n, number),
            Self::On(number) => f64::from(u8::from(number == i + 1)),
        }
    }

    /// What a function gives at a bend (x, y in rad) of the paper's robot with so many backbones that never moved.
    pub(super) fn at_bend<T>([x, y]: [f64; 2], backbones: usize, of: impl Fn(&Instant) -> T) -> T {
        let model = Model { robot: Robot { backbones: backbones as u8, ..Robot::default() }, ..Model::default() };
        Mechanics::new(&model).instant(Vector2::new(x, y), &Motion::none(backbones), of)
    }
}
