//! What a result was made from, so that it can be cited and made again: program, date, options, and the files read with their SHA-256.

use crate::error::{Error, Result};
use crate::instant::utc;
use serde::Serialize;
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::fs::File;
use std::io;
use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

/// The program with its version and, in a release build of a checkout, its commit.
pub const PROGRAM: &str = concat!("snakeloop ", env!("SNAKELOOP_VERSION"));

/// What a result was made from; `[provenance]` of model.toml and the end of every report.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Provenance {
    program: &'static str,
    date: String,
    command: String,
    #[serde(skip_serializing_if = "toml::Table::is_empty")]
    options: toml::Table,
    /// SHA-256 of the files read, by their path.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    inputs: BTreeMap<String, String>,
}

impl Provenance {
    /// That of what this command makes now. The environment variable SOURCE_DATE_EPOCH (<https://reproducible-builds.org/specs/source-date-epoch>)
    /// sets the date, in Unix seconds, so that two runs give the same bytes.
    pub fn new(command: &str) -> Self {
        let stated = std::env::var("SOURCE_DATE_EPOCH").ok().and_then(|seconds| seconds.parse().ok());
        let now = || SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs());
        Self {
            program: PROGRAM,
            date: utc(stated.unwrap_or_else(now)),
            command: command.to_owned(),
            options: toml::Table::new(),
            inputs: BTreeMap::new(),
        }
    }

    /// With these options of the call.
    ///
    /// # Errors
    /// A number that TOML cannot hold.
    pub fn with_options(mut self, options: &impl Serialize) -> Result<Self> {
        self.options.extend(toml::Table::try_from(options).map_err(Error::encode("the options"))?);
        Ok(self)
    }

    /// With these files as inputs, by their paths; a folder, as a recording may be, is passed over.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub fn with_inputs<P: AsRef<Path>>(self, files: impl IntoIterator<Item = P>) -> Result<Self> {
        files.into_iter().try_fold(self, |made_from, file| {
            let path = file.as_ref();
            made_from.with_input(&path.display().to_string(), path)
        })
    }

    /// With a file as an input under this name.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub fn with_input(mut self, name: &str, path: &Path) -> Result<Self> {
        if !path.is_dir() {
            let mut sum = Sha256::new();
            let read = File::open(path).and_then(|mut file| io::copy(&mut file, &mut sum));
            read.map_err(Error::io(path, "read"))?;
            let digits = sum.finalize().iter().map(|byte| format!("{byte:02x}")).collect();
            self.inputs.insert(name.to_owned(), digits);
        }
        Ok(self)
    }

    /// The inputs that a result was made from as well, by the text of its file in TOML: those with the same contents.
    pub fn inputs_shared_with(&self, result: &str) -> Vec<&str> {
        let result: toml::Table = toml::from_str(result).unwrap_or_default();
        let inputs = result.get("provenance").and_then(|made_from| made_from.get("inputs")?.as_table());
        let is_in = |sum: &str| inputs.is_some_and(|inputs| inputs.values().any(|other| other.as_str() == Some(sum)));
        self.inputs.iter().filter(|(_, sum)| is_in(sum)).map(|(path, _)| path.as_str()).collect()
    }

    /// As a table of TOML.
    ///
    /// # Errors
    /// A number that TOML cannot hold.
    pub(super) fn table(&self) -> Result<toml::Table> {
        toml::Table::try_from(self).map_err(Error::encode("what the model was made from"))
    }

    /// Names and values, as a report lists them.
    pub fn lines(&self) -> Vec<(String, String)> {
        let options: Vec<String> = self.options.iter().map(|(name, value)| shown(name, value)).collect();
        let mut lines = vec![
            ("program".to_owned(), self.program.to_owned()),
            ("date".to_owned(), self.date.clone()),
            ("command".to_owned(), self.command.clone()),
        ];
        lines.extend((!options.is_empty()).then(|| ("options".to_owned(), options.join(", "))));
        lines.extend(self.inputs.iter().map(|(path, sum)| (path.clone(), format!("SHA-256 {sum}"))));
        lines
    }
}

/// An option with its value; those of a group one by one.
fn shown(name: &str, value: &toml::Value) -> String {
    match value {
        toml::Value::Table(group) => {
            group.iter().map(|(name, value)| shown(name, value)).collect::<Vec<_>>().join(", ")
        }
        toml::Value::String(text) => format!("{name} = {text}"),
        other => format!("{name} = {other}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_result_names_program_date_options_and_inputs() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("abc");
        std::fs::write(&path, "abc").unwrap();
        #[derive(Serialize)]
        struct Options {
            gate: f64,
            overlays: &'static str,
        }
        let options = Options { gate: 4.5, overlays: "none" };
        let made = Provenance::new("run").with_options(&options).unwrap().with_inputs([&path]).unwrap();
        // The digest of "abc" is that of FIPS 180-2, appendix B.1.
        let sum = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        let lines = made.lines();
        for line in [
            ("command", "run"),
            ("options", "gate = 4.5, overlays = none"),
            (path.to_str().unwrap(), &format!("SHA-256 {sum}")),
        ] {
            assert!(lines.contains(&(line.0.to_owned(), line.1.to_owned())), "{line:?} of {lines:?}");
        }
        let table = made.table().unwrap();
        assert_eq!(table["inputs"][path.to_str().unwrap()].as_str(), Some(sum));
        assert!(
            table["date"].as_str().unwrap().ends_with('Z') && table["program"].as_str().unwrap().contains("snakeloop")
        );
        assert!(Provenance::new("run").with_inputs([folder.path().join("none")]).is_err());
        // The same contents under another name are the same input.
        let result = format!("[provenance.inputs]\n\"elsewhere\" = \"{sum}\"\n");
        assert_eq!(made.inputs_shared_with(&result), [path.to_str().unwrap()]);
        assert!(made.inputs_shared_with("[provenance.inputs]\nabc = \"00\"").is_empty());
        assert!(made.inputs_shared_with("no TOML").is_empty());
    }
}
