//! What a file says of a user's own effect: its formula's text, its parameters with units, ranges and starts.

use super::physics::{ParameterSpec, Role};
use super::variables::{Variable, known_variables};
use std::collections::BTreeMap;

/// The parameter of a formula with `play` that is half that play's width, mm.
pub const HALF_GAP: &str = "half_gap_mm";

/// A size is expected to be this share of its largest value; see [`ParameterSpec::typical`].
///
/// Convention: as of the library's plays, 0.05 mm of 1 mm.
const TYPICAL_SHARE: f64 = 0.05;

/// A user's own effect, as a file says it.
#[derive(Debug, Clone, PartialEq)]
pub struct Definition {
    /// Its name: small letters, digits and underscores.
    pub name: String,
    /// What it adds to ε_i, mm.
    pub formula: String,
    /// What it means, in words that follow "the data show"; may be empty.
    pub reading: String,
    /// Its parameters by name.
    pub parameters: BTreeMap<String, Defined>,
    /// Least and largest value of variables within which it holds; beyond it goes on as its tangent at that end, in time as its value there.
    pub domain: BTreeMap<String, [f64; 2]>,
}

/// A parameter of a user's own effect.
#[derive(Debug, Clone, PartialEq)]
pub struct Defined {
    /// Its unit, `1` for a number without.
    pub unit: String,
    /// Least and largest value. A parameter that may be zero is a size: without it there is no effect.
    pub range: [f64; 2],
    /// Where a search for it starts; empty: at zero for a size, in the middle of the range else.
    pub starts: Vec<f64>,
}

impl Definition {
    /// The parameters' ranges, starts and names, each without a fault.
    pub(super) fn checked_specs(&self) -> Result<Vec<ParameterSpec>, String> {
        let is_name = |name: &str| {
            name.starts_with(|c: char| c.is_ascii_lowercase())
                && name.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_')
        };
        if !is_name(&self.name) {
            return Err("a name is made of small letters, digits and underscores".to_owned());
        }
        let spec = |(name, defined): (&String, &Defined)| {
            if Variable::of(name).is_some() {
                return Err(format!("parameter {name} has the name of a variable ({})", known_variables()));
            }
            if !is_name(name) {
                return Err(format!("parameter {name:?}: a name is made of small letters, digits and underscores"));
            }
            defined.spec(name)
        };
        self.parameters.iter().map(spec).collect()
    }

    /// Every combination of the parameters' starts, in their order.
    pub(super) fn starts(&self) -> Vec<Vec<f64>> {
        self.parameters.values().fold(vec![Vec::new()], |combinations, defined| {
            let starts = defined.starts();
            let longer = |so_far: Vec<f64>| {
                starts.iter().map(move |start| [&so_far[..], &[*start]].concat()).collect::<Vec<_>>()
            };
            combinations.into_iter().flat_map(longer).collect()
        })
    }
}

impl Defined {
    /// Whether it may be zero.
    pub(super) fn is_size(&self) -> bool {
        (self.range[0]..=self.range[1]).contains(&0.0)
    }

    /// Where a search for it starts.
    pub(super) fn starts(&self) -> Vec<f64> {
        match &self.starts[..] {
            [] if self.is_size() => vec![0.0],
            [] => vec![0.5 * (self.range[0] + self.range[1])],
            starts => starts.to_vec(),
        }
    }

    /// What the program's own effects say of a parameter.
    fn spec(&self, name: &str) -> Result<ParameterSpec, String> {
        let [least, most] = self.range;
        if !(least.is_finite() && most.is_finite() && least < most) {
            return Err(format!(
                "parameter {name}: range = [{least}, {most}], expected the least value, then the largest"
            ));
        }
        if let Some(start) = self.starts.iter().find(|start| !(least..=most).contains(*start)) {
            return Err(format!("parameter {name}: start = {start} is outside its range [{least}, {most}]"));
        }
        let example = self.starts().into_iter().next().unwrap_or(least);
        let (typical, role) = if self.is_size() {
            (TYPICAL_SHARE * most.max(-least), Role::Size { either_sign: least < 0.0 })
        } else {
            (0.5 * example.abs(), Role::Shape { example, drawn: (least, most) })
        };
        Ok(ParameterSpec { name: kept(name), unit: kept(&self.unit), range: (least, most), typical, role })
    }
}

/// A text that stays where it is.
pub(super) fn kept(text: &str) -> &'static str {
    Box::leak(text.to_owned().into_boxed_str())
}
