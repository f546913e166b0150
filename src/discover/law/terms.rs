//! The terms that a proposed law may have: products of up to three of bend, load, direction, play, speed and time, and saturations of q,
//! for all backbones alike or for one of them.

use crate::robot::effects::Variable;
use std::fmt;

/// The parameter of a law with a saturation: the q at which that has reached three quarters of its end, mm.
pub const SCALE: &str = "scale_mm";

/// What a term is a product of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Factor {
    /// Of which variable.
    pub variable: Variable,
    /// How it stands there.
    pub shape: Shape,
}

/// How a variable stands in a term.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shape {
    /// As it is.
    Plain,
    /// Its size, without the sign.
    Absolute,
    /// tanh of its share of the law's [scale](SCALE); for variables in mm.
    Saturating,
}

/// A parameter that is not linear, of which all terms of a law with it have the same value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shared {
    /// Half the width of the play.
    HalfGap,
    /// The scale of saturations.
    Scale,
}

/// A product of factors, for all backbones or for one.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Term {
    /// The factors; none for a constant.
    pub factors: Vec<Factor>,
    /// The backbone that it is for, counted from 1; none for all.
    pub on: Option<usize>,
}

const fn plain(variable: Variable) -> Factor {
    Factor { variable, shape: Shape::Plain }
}

const fn absolute(variable: Variable) -> Factor {
    Factor { variable, shape: Shape::Absolute }
}

const fn saturating(variable: Variable) -> Factor {
    Factor { variable, shape: Shape::Saturating }
}

const Q: Factor = plain(Variable::Q);
const Q_SIZE: Factor = absolute(Variable::Q);
const S: Factor = plain(Variable::Direction);
const P: Factor = plain(Variable::Play);
const V: Factor = plain(Variable::Speed);
const T: Factor = plain(Variable::Time);
const X: Factor = plain(Variable::X);
const Y: Factor = plain(Variable::Y);
const THETA: Factor = plain(Variable::Theta);
const LOAD: Factor = plain(Variable::Load);

/// What a backbone's own state gives.
const OWN: [&[Factor]; 37] = [
    &[Q, Q],
    &[Q, Q, Q],
    &[Q_SIZE],
    &[Q, Q_SIZE],
    &[Q_SIZE, Q_SIZE, Q_SIZE],
    &[saturating(Variable::Q)],
    &[THETA],
    &[THETA, THETA],
    &[THETA, THETA, THETA],
    &[Q, THETA],
    &[Q, THETA, THETA],
    &[LOAD],
    &[Q, LOAD],
    &[S],
    &[S, Q_SIZE],
    &[S, Q, Q],
    &[S, THETA],
    &[S, THETA, THETA],
    &[S, LOAD],
    &[P],
    &[P, Q_SIZE],
    &[P, Q, Q],
    &[P, THETA],
    &[P, THETA, THETA],
    &[P, LOAD],
    &[V],
    &[V, Q_SIZE],
    &[V, THETA],
    &[absolute(Variable::Speed)],
    &[T],
    &[T, T],
    &[T, T, T],
    &[T, Q],
    &[T, THETA],
    &[T, S],
    &[T, P],
    &[T, V],
];

/// What the bend gives to all backbones alike, or to one.
const OF_BEND: [&[Factor]; 9] = [&[X], &[Y], &[X, X], &[X, Y], &[Y, Y], &[X, X, X], &[X, X, Y], &[X, Y, Y], &[Y, Y, Y]];

/// All terms on a robot of so many backbones.
pub fn dictionary(backbones: usize) -> Vec<Term> {
    let for_all = OWN.iter().chain(&OF_BEND).map(|factors| Term { factors: factors.to_vec(), on: None });
    let for_one = |on: usize| {
        let neighbours = (1..=backbones).filter(move |other| *other != on).flat_map(of_neighbour);
        let own = OWN.iter().chain(&OF_BEND).map(|factors| factors.to_vec());
        let all = own.chain(neighbours).chain([Vec::new()]);
        all.map(move |factors| Term { factors, on: Some(on) }).collect::<Vec<_>>()
    };
    for_all.chain((1..=backbones).flat_map(for_one)).collect()
}

/// What another backbone gives.
fn of_neighbour(number: usize) -> [Vec<Factor>; 11] {
    let (other, size) = (plain(Variable::QOf(number)), absolute(Variable::QOf(number)));
    [
        vec![other],
        vec![size],
        vec![other, other],
        vec![other, size],
        vec![other, other, other],
        vec![size, size, size],
        vec![saturating(Variable::QOf(number))],
        vec![Q, other],
        vec![Q, size],
        vec![Q, Q, other],
        vec![Q, other, other],
    ]
}

impl Term {
    /// The parameter that is not linear in it; it has one at most.
    pub fn shared(&self) -> Option<Shared> {
        self.factors.iter().find_map(|factor| match factor {
            Factor { variable: Variable::Play, .. } => Some(Shared::HalfGap),
            Factor { shape: Shape::Saturating, .. } => Some(Shared::Scale),
            _ => None,
        })
    }

    /// The unit of its coefficient, so that the term is in mm.
    pub fn unit_of_coefficient(&self) -> String {
        // Powers of mm, rad, N and s.
        let mut powers = [1, 0, 0, 0];
        for factor in self.factors.iter().filter(|factor| factor.shape != Shape::Saturating) {
            match factor.variable {
                Variable::Q | Variable::QOf(_) | Variable::Play => powers[0] -= 1,
                Variable::X | Variable::Y | Variable::Theta => powers[1] -= 1,
                Variable::Load | Variable::Tau | Variable::TauOf(_) => powers[2] -= 1,
                Variable::Time => powers[3] -= 1,
                Variable::Speed => (powers[0], powers[3]) = (powers[0] - 1, powers[3] + 1),
                Variable::Direction | Variable::On(_) => {}
            }
        }
        let part = |sign: i32| {
            let named = powers.iter().zip(["mm", "rad", "N", "s"]).filter(|(power, _)| **power * sign > 0);
            let texts = named.map(|(power, unit)| match power.abs() {
                1 => unit.to_owned(),
                power => format!("{unit}^{power}"),
            });
            texts.collect::<Vec<_>>().join("·")
        };
        match (part(1), part(-1)) {
            (above, below) if below.is_empty() => {
                if above.is_empty() {
                    "1".to_owned()
                } else {
                    above
                }
            }
            (above, below) => format!("{}/{below}", if above.is_empty() { "1" } else { &above }),
        }
    }
}

impl fmt::Display for Factor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = self.variable.name();
        match self.shape {
            Shape::Plain => f.write_str(&name),
            Shape::Absolute => write!(f, "abs({name})"),
            Shape::Saturating => write!(f, "tanh({name} / {SCALE})"),
        }
    }
}

/// As a formula has it, without its coefficient: `on_1 * q_2 * abs(q_2)`.
impl fmt::Display for Term {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut texts: Vec<String> = self.on.map(|on| Variable::On(on).name()).into_iter().collect();
        let mut rest = &self.factors[..];
        while let [first, ..] = rest {
            let times = rest.iter().take_while(|factor| *factor == first).count();
            texts.push(if times > 1 { format!("{first}^{times}") } else { first.to_string() });
            rest = &rest[times..];
        }
        f.write_str(&texts.join(" * "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_term_stands_twice_and_units_make_millimetres() {
        let all = dictionary(3);
        for (k, term) in all.iter().enumerate() {
            assert!(term.factors.len() <= 3 && !all[..k].contains(term), "{term}");
        }
        let term = |factors: &[Factor], on| Term { factors: factors.to_vec(), on };
        for (term, text, unit) in [
            (term(&[Q, Q, Q], None), "q^3", "1/mm^2"),
            (term(&[absolute(Variable::QOf(2)); 3], Some(1)), "on_1 * abs(q_2)^3", "1/mm^2"),
            (term(&[S, THETA], None), "s * theta", "mm/rad"),
            (term(&[V], None), "v", "s"),
            (term(&[T, S], None), "t * s", "mm/s"),
            (term(&[P], None), "play", "1"),
            (term(&[saturating(Variable::QOf(2))], Some(1)), "on_1 * tanh(q_2 / scale_mm)", "mm"),
            (term(&[], Some(3)), "on_3", "mm"),
        ] {
            assert_eq!((term.to_string(), term.unit_of_coefficient()), (text.to_owned(), unit.to_owned()));
        }
    }
}
