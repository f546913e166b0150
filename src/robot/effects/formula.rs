//! A user's own effect: a summand of ε_i that is given as a formula.
//!
//! A [`Definition`] is plain data, read from a file. [`Definition::physics`] checks it and makes of it a [`Physics`] like those of the
//! library, which is searched for, fitted, named and obeyed like them. A formula is parsed and evaluated by the crate `exmex`; no code is
//! run.

use super::definition::{Definition, HALF_GAP, kept};
use super::physics::{Changes, Instant, LINEAR, ParameterSpec, Physics, Starts, USUAL};
use super::variables::{Variable, known_variables};
use crate::error::ArgumentError;
use crate::robot::{BACKBONES, PerBackbone};
use exmex::{Express, FlatEx};
use std::sync::{Mutex, PoisonError};

/// The most variables and parameters of one formula.
///
/// Convention: a resource limit; a formula that a person can read has fewer.
const MOST_INPUTS: usize = 48;

/// The most characters of a formula.
///
/// Convention: a resource limit; parentheses within parentheses take memory as they are read.
const MOST_CHARACTERS: usize = 1000;

/// The most combinations of parameters at which a search starts.
///
/// Convention: a bound on computing time.
const MOST_STARTS: usize = 16;

/// The bends at which a formula must be finite, x and y in rad: straight, and 60° to four sides.
///
/// Convention: a check for divisions by zero.
const CHECKED_BENDS: [[f64; 2]; 5] = [[0.0, 0.0], [1.0, 0.1], [-0.1, 1.0], [-1.0, -0.1], [0.1, -1.0]];

/// The difference that makes the tangent at the end of a domain goes back inside by this share of what lies beyond.
///
/// Convention: numerical; the tangent is off by half of this share of the curvature's part.
const TANGENT_SHARE: f64 = 1e-5;

/// A formula made ready to be evaluated.
#[derive(Debug)]
pub struct Formula {
    /// What it was made from.
    pub definition: Definition,
    expression: FlatEx<f64>,
    /// What the expression is given, in its order.
    inputs: Vec<Input>,
    parameters: Vec<ParameterSpec>,
}

/// One input of the expression.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Input {
    Variable(Variable, [f64; 2]),
    Parameter(usize),
}

/// Every definition that was made to an effect. Effects stand in static places like the library's, since all of the program refers to
/// them so; one definition is kept once, however often it is read.
static DEFINED: Mutex<Vec<(Definition, &'static Physics)>> = Mutex::new(Vec::new());

impl Definition {
    /// Checks the definition and makes an effect of it.
    ///
    /// # Errors
    /// [`ArgumentError::Formula`] for a name that the library has, a formula that cannot be parsed, names in it that nobody knows,
    /// parameters that it does not have, ranges the wrong way round, and a value that is not finite anywhere within them.
    pub fn physics(self) -> Result<&'static Physics, ArgumentError> {
        let mut defined = DEFINED.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, physics)) = defined.iter().find(|(definition, _)| *definition == self) {
            return Ok(physics);
        }
        let fault = |why: String| ArgumentError::Formula { effect: self.name.clone(), why };
        let formula = Formula::new(self.clone()).map_err(fault)?;
        let physics: &'static Physics = Box::leak(Box::new(formula.into_physics()));
        defined.push((self, physics));
        Ok(physics)
    }

    /// The inputs of an expression that has variables of these names.
    fn inputs(&self, names: &[String]) -> Result<Vec<Input>, String> {
        let place = |name: &str| self.formula.find(name).map_or(0, |byte| self.formula[..byte].chars().count() + 1);
        let input = |name: &String| {
            if let Some(parameter) = self.parameters.keys().position(|own| own == name) {
                return Ok(Input::Parameter(parameter));
            }
            let variable = Variable::of(name).ok_or_else(|| {
                let parameters: Vec<&str> = self.parameters.keys().map(String::as_str).collect();
                format!(
                    "{name:?} at character {} of formula {:?} is not known; variables are {}, parameters here {}",
                    place(name),
                    self.formula,
                    known_variables(),
                    if parameters.is_empty() { "none".to_owned() } else { parameters.join(", ") }
                )
            })?;
            Ok(Input::Variable(variable, *self.domain.get(name).unwrap_or(&[f64::NEG_INFINITY, f64::INFINITY])))
        };
        let inputs: Vec<Input> = names.iter().map(input).collect::<Result<_, String>>()?;
        let has_play = inputs.iter().any(|input| matches!(input, Input::Variable(Variable::Play, _)));
        if has_play && !self.parameters.contains_key(HALF_GAP) {
            return Err(format!("a formula with play needs the parameter {HALF_GAP}, half the play's width"));
        }
        for name in self.parameters.keys().filter(|name| !(has_play && *name == HALF_GAP)) {
            if !names.contains(name) {
                return Err(format!("parameter {name} is not in formula {:?}", self.formula));
            }
        }
        for (name, [least, most]) in &self.domain {
            if !names.contains(name) || Variable::of(name).is_none() {
                return Err(format!("domain.{name}: the formula has no variable of this name"));
            }
            if !(least.is_finite() && most.is_finite() && least <= most) {
                return Err(format!("domain.{name} = [{least}, {most}]: expected the least value, then the largest"));
            }
        }
        Ok(inputs)
    }
}

impl Formula {
    fn new(definition: Definition) -> Result<Self, String> {
        let characters = definition.formula.chars().count();
        if characters > MOST_CHARACTERS {
            return Err(format!("formula has {characters} characters, expected {MOST_CHARACTERS} at most"));
        }
        let parameters = definition.checked_specs()?;
        let expression = exmex::parse::<f64>(&definition.formula)
            .map_err(|why| format!("formula {:?} cannot be read: {why}", definition.formula))?;
        let inputs = definition.inputs(expression.var_names())?;
        if inputs.len() > MOST_INPUTS {
            return Err(format!(
                "formula has {} variables and parameters, expected {MOST_INPUTS} at most",
                inputs.len()
            ));
        }
        // Counted before they are made: a file may ask for more than memory holds.
        let combinations = definition.parameters.values().map(|defined| defined.starts().len());
        let combinations = combinations.fold(1, usize::saturating_mul);
        if combinations > MOST_STARTS {
            return Err(format!("{combinations} combinations of starts, expected {MOST_STARTS} at most"));
        }
        let formula = Self { definition, expression, inputs, parameters };
        formula.require_finite()?;
        Ok(formula)
    }

    fn into_physics(self) -> Physics {
        let starts: Vec<&'static [f64]> =
            self.definition.starts().into_iter().map(|values| &*Box::leak(values.into_boxed_slice())).collect();
        let reading = match &self.definition.reading[..] {
            "" => format!("what the formula of {} says", self.definition.name),
            words => words.to_owned(),
        };
        Physics {
            name: kept(&self.definition.name),
            equation: kept(&format!("ε_i += {}", self.definition.formula)),
            reading: kept(&reading),
            starts: Starts::At(Box::leak(starts.into_boxed_slice())),
            in_time: self.has(Variable::Time),
            changes: Changes::Formula(Box::leak(Box::new(self))),
            log_prior: USUAL,
            ..LINEAR
        }
    }

    /// Its parameters, whatever the robot.
    pub fn parameters(&self) -> &[ParameterSpec] {
        &self.parameters
    }

    /// Whether a variable stands in it.
    pub fn has(&self, variable: Variable) -> bool {
        self.inputs.iter().any(|input| matches!(input, Input::Variable(own, _) if *own == variable))
    }

    /// Half the width of its play, mm; none where it has none.
    pub fn half_gap_mm(&self, values: &[f64]) -> Option<f64> {
        let place = self.parameters.iter().position(|spec| spec.name == HALF_GAP)?;
        self.has(Variable::Play).then(|| values[place])
    }

    /// Whether it depends on the path that led to the present bend.
    pub fn has_memory(&self) -> bool {
        [Variable::Play, Variable::Direction, Variable::Speed].into_iter().any(|variable| self.has(variable))
    }

    /// Whether some variable is beyond the domain at this instant; none where there is no domain.
    pub fn is_beyond_domain(&self, at: &Instant) -> Option<bool> {
        let beyond = |i: usize| {
            self.inputs.iter().any(|input| match input {
                Input::Variable(variable, [least, most]) => !(least..=most).contains(&&variable.value(at, i, 0)),
                Input::Parameter(_) => false,
            })
        };
        (!self.definition.domain.is_empty()).then(|| (0..at.q_mm.len()).any(beyond))
    }

    /// The summand of ε at an instant, mm; `play` is the place of its play among those of the motion.
    pub fn summand_mm(&self, at: &Instant, values: &[f64], play: usize) -> PerBackbone {
        PerBackbone::from_fn(at.q_mm.len(), |i| self.value_mm(at, values, (i, play)))
    }

    /// The same of backbone i. Beyond the domain it goes on straight, as its tangent at the end: a part of it that is linear, which η may
    /// cancel within the domain, is then cancelled beyond as well. Time alone is held at its end, since a drift may stop.
    fn value_mm(&self, at: &Instant, values: &[f64], (i, play): (usize, usize)) -> f64 {
        let (mut inputs, mut inside) = ([0.0; MOST_INPUTS], [0.0; MOST_INPUTS]);
        let mut is_beyond = false;
        for ((place, inside), input) in inputs.iter_mut().zip(&mut inside).zip(&self.inputs) {
            let mut beyond = 0.0;
            *place = match *input {
                Input::Variable(variable, [least, most]) => {
                    let value = variable.value(at, i, play);
                    let held = value.clamp(least, most);
                    beyond = if variable == Variable::Time { 0.0 } else { value - held };
                    held
                }
                Input::Parameter(k) => values[k],
            };
            *inside = *place - TANGENT_SHARE * beyond;
            is_beyond |= beyond != 0.0;
        }
        let value = |inputs: &[f64]| self.expression.eval(&inputs[..self.inputs.len()]).unwrap_or(f64::NAN);
        let at_end = value(&inputs);
        if is_beyond { at_end + (at_end - value(&inside)) / TANGENT_SHARE } else { at_end }
    }

    /// That the value is finite for the parameters' starts and ends at straight and far bends.
    fn require_finite(&self) -> Result<(), String> {
        let [start, ..] = &self.definition.starts()[..] else { return Ok(()) };
        let ends = self.definition.parameters.values().enumerate().flat_map(|(k, defined)| {
            let zero = defined.is_size().then_some(0.0);
            defined.range.into_iter().chain(zero).map(move |value| {
                let mut values = start.clone();
                values[k] = value;
                values
            })
        });
        for values in std::iter::once(start.clone()).chain(ends) {
            for bend in CHECKED_BENDS {
                let value = Variable::at_bend(bend, *BACKBONES.start(), |at| self.summand_mm(at, &values, 0));
                if value.iter().any(|value| !value.is_finite()) {
                    let values =
                        self.parameters.iter().zip(&values).map(|(spec, value)| format!("{} = {value}", spec.name));
                    return Err(format!(
                        "formula {:?} is not a finite number at x = {} and y = {} rad with {}: a division by zero, or a root or \
                         logarithm of nothing",
                        self.definition.formula,
                        bend[0],
                        bend[1],
                        values.collect::<Vec<_>>().join(", ")
                    ));
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::definition::Defined;
    use super::*;
    use crate::robot::effects::forms;
    use crate::robot::{Effect, Mechanics, Model};
    use nalgebra::Vector2;
    use std::collections::BTreeMap;

    fn definition(formula: &str, parameters: &[(&str, [f64; 2])]) -> Definition {
        let defined = |(name, range): &(&str, [f64; 2])| {
            ((*name).to_owned(), Defined { unit: "mm".into(), range: *range, starts: Vec::new() })
        };
        Definition {
            name: "own".into(),
            formula: formula.into(),
            reading: String::new(),
            parameters: parameters.iter().map(defined).collect(),
            domain: BTreeMap::new(),
        }
    }

    fn fault(definition: Definition) -> String {
        definition.physics().unwrap_err().to_string()
    }

    /// q̃ along a sweep up, down and across, by one effect.
    fn commands(physics: &'static Physics, values: &[f64]) -> Vec<PerBackbone> {
        let model = Model { effects: vec![Effect::of(physics, values.to_vec())], ..Model::default() };
        let mechanics = Mechanics::new(&model);
        let up_and_down = |k: i32| Vector2::new(0.1 + 0.04 * f64::from(15 - (k - 15).abs()), 0.02 * f64::from(k));
        let bends: Vec<_> = (0..40).map(up_and_down).collect();
        let times: Vec<f64> = (0..40).map(|k| 0.3 * f64::from(k)).collect();
        let motions = mechanics.motions(&times, &bends);
        bends.iter().zip(&motions).map(|(bend, motion)| mechanics.command(*bend, Some(motion))).collect()
    }

    #[test]
    fn a_formula_that_says_what_an_effect_of_the_library_does_is_that_effect() {
        for (formula, parameters, name, form) in [
            ("a_mm * tanh(tau / 0.3)", [("a_mm", [-1.0, 1.0])], "load_directed_backlash", ""),
            ("play", [("half_gap_mm", [0.0, 20.0])], "motion_directed_backlash", "crossed by travel"),
            ("a_mm * s", [("a_mm", [-1.0, 1.0])], "motion_directed_backlash", ""),
            ("a_mm * t", [("a_mm", [-1.0, 1.0])], "thermal_drift", ""),
        ] {
            let own = definition(formula, &parameters).physics().unwrap();
            let of_library = forms(name).find(|physics| physics.form == form).unwrap();
            for (a, b) in commands(own, &[0.05]).iter().zip(commands(of_library, &[0.05])) {
                assert!((*a - b).amax() < 1e-12, "{formula}: {a:?} {b:?}");
            }
            assert_eq!((own.is_static(), own.in_time), (of_library.is_static(), of_library.in_time), "{formula}");
        }
    }

    #[test]
    fn backbones_have_their_numbers_and_a_formula_goes_on_straight_beyond_its_domain() {
        let mut bounded = definition("a * on_2 * (theta^2 + q_3)", &[("a", [-1.0, 1.0])]);
        bounded.domain.insert("theta".into(), [0.0, 0.5]);
        let physics = bounded.physics().unwrap();
        let added = |theta: f64| {
            let model = Model { effects: vec![Effect::of(physics, vec![0.1])], ..Model::default() };
            let bend = Vector2::new(theta, 0.0);
            let mechanics = Mechanics::new(&model);
            let q_3 = mechanics.statics.q_mm(bend)[2];
            let plain = Model::default();
            (mechanics.command(bend, None) - Mechanics::new(&plain).command(bend, None), q_3)
        };
        // θ² from 0.5 on: 0.25 + 2 · 0.5 · 0.4.
        for (theta, square) in [(0.3, 0.09), (0.9, 0.65)] {
            let (added, q_3) = added(theta);
            assert!((added - PerBackbone::from([0.0, 0.1 * (square + q_3), 0.0])).amax() < 1e-6, "{added:?}");
        }
    }

    #[test]
    fn one_definition_is_one_effect_and_another_is_another() {
        let one = || definition("a * q^2", &[("a", [-1.0, 1.0])]);
        assert!(std::ptr::eq(one().physics().unwrap(), one().physics().unwrap()));
        assert!(one().physics().unwrap() != definition("a * q^3", &[("a", [-1.0, 1.0])]).physics().unwrap());
    }

    #[test]
    fn faults_are_named_with_their_place() {
        let a = [("a", [-1.0, 1.0])];
        for (formula, parameters, words) in [
            ("a * q + moon", &a[..], "\"moon\" at character 9"),
            ("a * q + b", &a[..], "parameters here a"),
            ("a * q_9", &a[..], "\"q_9\" at character 5"),
            ("a * (q", &a[..], "cannot be read"),
            ("", &a[..], "cannot be read"),
            ("q^2", &a[..], "parameter a is not in formula"),
            ("a / (q - q_1)", &a[..], "not a finite number at x = 0"),
            ("a * sqrt(q)", &a[..], "not a finite number"),
            ("q / a", &a[..], "with a = 0"),
            ("a * play", &a[..], "needs the parameter half_gap_mm"),
            ("a * q", &[("a", [1.0, -1.0])], "range = [1, -1]"),
            ("a * q", &[("a", [0.0, f64::INFINITY])], "expected the least value, then the largest"),
            ("tau * q", &[("tau", [0.0, 1.0])], "has the name of a variable"),
            ("A * q", &[("A", [0.0, 1.0])], "small letters"),
        ] {
            let said = fault(definition(formula, parameters));
            assert!(said.starts_with("effect own: ") && said.contains(words), "{formula}: {said}");
        }
        let deep = |levels: usize| format!("{}a * q{}", "(".repeat(levels), ")".repeat(levels));
        assert!(definition(&deep(450), &a).physics().is_ok());
        assert!(fault(definition(&deep(9000), &a)).contains("expected 1000 at most"));
        let many: Vec<String> = (0..40).map(|k| format!("c{k}")).collect();
        let ranges: Vec<_> = many.iter().map(|name| (name.as_str(), [-1.0, 1.0])).collect();
        let mut costly = definition(&many.join(" + "), &ranges);
        costly.parameters.values_mut().for_each(|defined| defined.starts = vec![0.1, 0.2]);
        assert!(fault(costly).contains("combinations of starts, expected 16 at most"));
        let mut outside = definition("a * q", &a);
        outside.parameters.get_mut("a").unwrap().starts = vec![0.1, 3.0];
        assert!(fault(outside).contains("start = 3 is outside its range"));
        let mut domain = definition("a * q", &a);
        domain.domain.insert("theta".into(), [0.0, 1.0]);
        assert!(fault(domain.clone()).contains("domain.theta"));
        domain.domain = BTreeMap::from([("q".into(), [1.0, 0.0])]);
        assert!(fault(domain).contains("domain.q = [1, 0]"));
    }

    #[test]
    fn a_sign_binds_before_a_power_and_a_power_before_a_product() {
        let value = |formula: &str| {
            let physics = definition(formula, &[("a", [0.0, 9.0])]).physics().unwrap();
            let Changes::Formula(formula) = physics.changes else { panic!("a formula") };
            Variable::at_bend([0.0, 0.0], 3, |at| formula.summand_mm(at, &[2.0], 0))[0]
        };
        for (formula, expected) in [
            ("3 * a^2 - 1", 11.0),
            ("-a^2", 4.0),
            ("-(a^2)", -4.0),
            ("2^-a", 0.25),
            ("max(a, 3) / 4", 0.75),
            ("atan2(a, 2)", 0.25 * std::f64::consts::PI),
        ] {
            assert!((value(formula) - expected).abs() < 1e-12, "{formula} = {}", value(formula));
        }
    }

    proptest::proptest! {
        #![proptest_config(proptest::prelude::ProptestConfig::with_cases(256))]
        #[test]
        fn no_text_panics(text in "[a-z0-9 ()+*/^.,{}\\-αx]{0,24}") {
            let _ = definition(&text, &[("a", [0.0, 1.0])]).physics();
        }
    }
}
