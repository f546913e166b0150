//! A settings file as a tree, whether it is YAML, XML, JSON or TOML.

use super::{xml, yaml};

/// A value of a file.
#[derive(Debug, Clone, PartialEq)]
pub enum Node {
    /// A number.
    Number(f64),
    /// A word.
    Text(String),
    /// Values in their order.
    List(Vec<Node>),
    /// Values by their keys.
    Map(Vec<(String, Node)>),
}

/// Why a text is no settings file at all.
pub struct NotAFile {
    /// The line, from 1.
    pub line: u64,
    /// What was found.
    pub message: String,
}

impl Node {
    /// The tree of a text of any of the kinds.
    pub fn parse(text: &str) -> Result<Self, NotAFile> {
        match text.trim_start().bytes().next() {
            Some(b'<') => return xml::tree(text),
            Some(b'{') => {
                if let Ok(value) = serde_json::from_str(text) {
                    return Ok(Self::of_json(value));
                }
            }
            _ => {}
        }
        let yaml = yaml::tree(text);
        if matches!(yaml, Ok(Self::Map(_))) {
            return yaml;
        }
        match toml::from_str::<toml::Table>(text) {
            Ok(table) if !table.is_empty() => Ok(Self::of_toml(toml::Value::Table(table))),
            _ => yaml,
        }
    }

    /// A word, or the number that it is.
    pub fn of_text(text: &str) -> Self {
        text.trim().parse().map_or_else(|_| Self::Text(text.to_owned()), Self::Number)
    }

    fn of_json(value: serde_json::Value) -> Self {
        use serde_json::Value;
        match value {
            Value::Number(number) => Self::Number(number.as_f64().unwrap_or(f64::NAN)),
            Value::String(text) => Self::of_text(&text),
            Value::Array(items) => Self::List(items.into_iter().map(Self::of_json).collect()),
            Value::Object(members) => {
                Self::Map(members.into_iter().map(|(key, value)| (key, Self::of_json(value))).collect())
            }
            Value::Bool(_) | Value::Null => Self::Text(value.to_string()),
        }
    }

    fn of_toml(value: toml::Value) -> Self {
        use toml::Value;
        match value {
            Value::Integer(number) => Self::Number(number as f64),
            Value::Float(number) => Self::Number(number),
            Value::Array(items) => Self::List(items.into_iter().map(Self::of_toml).collect()),
            Value::Table(members) => {
                Self::Map(members.into_iter().map(|(key, value)| (key, Self::of_toml(value))).collect())
            }
            Value::String(text) => Self::of_text(&text),
            Value::Boolean(_) | Value::Datetime(_) => Self::Text(value.to_string()),
        }
    }

    /// The number of a number, or of what stands under `val` (as calib.io writes each) .
    pub fn number(&self) -> Option<f64> {
        match self {
            Self::Number(value) => Some(*value),
            Self::Map(_) => self.get("val")?.number(),
            _ => None,
        }
    }

    /// A member of a map.
    pub fn get(&self, key: &str) -> Option<&Self> {
        match self {
            Self::Map(members) => members.iter().find(|(name, _)| name == key).map(|(_, value)| value),
            _ => None,
        }
    }

    /// All numbers of a list, of a list of lists row by row, or of what stands under `data`; with the rows and columns that are told.
    ///
    /// # Errors
    /// Something else, in words.
    pub fn numbers(&self) -> Result<Vec<f64>, String> {
        match self {
            Self::Number(value) if value.is_finite() => Ok(vec![*value]),
            Self::List(items) => Ok(items.iter().map(Self::numbers).collect::<Result<Vec<_>, _>>()?.concat()),
            Self::Map(_) => {
                let data =
                    self.get("data").ok_or("no list `data`; expected rows, cols and data, or a list of numbers")?;
                let numbers = data.numbers()?;
                let count = |key| self.get(key).and_then(Self::number);
                match count("rows").zip(count("cols")) {
                    Some((rows, cols)) if rows * cols != numbers.len() as f64 => {
                        Err(format!("{} numbers for {rows} rows × {cols} columns", numbers.len()))
                    }
                    _ => Ok(numbers),
                }
            }
            _ => Err("holds something that is no finite number".to_owned()),
        }
    }

    /// The maps of the tree, each with the keys that lead to it, this one first.
    pub fn maps(&self) -> Vec<(String, &Self)> {
        let mut found = Vec::new();
        self.collect(String::new(), &mut found);
        found
    }

    fn collect<'a>(&'a self, place: String, found: &mut Vec<(String, &'a Self)>) {
        let below = |key: &str| if place.is_empty() { key.to_owned() } else { format!("{place}.{key}") };
        match self {
            Self::Map(members) => {
                found.push((place.clone(), self));
                members.iter().for_each(|(key, value)| value.collect(below(key), found));
            }
            Self::List(items) => {
                items.iter().enumerate().for_each(|(k, item)| item.collect(below(&k.to_string()), found));
            }
            Self::Number(_) | Self::Text(_) => {}
        }
    }
}
