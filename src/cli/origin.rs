//! What rows of measurements.csv were made from: only rows with the same origin belong together.

use super::checksum::Checksum;
use super::estimator::EstimatorArgs;
use super::inputs::CommandedArgs;
use super::overlays::Overlays;
use super::shard::Shard;
use super::views::OpenView;
use crate::input::{PICTURE_BYTES, read_bytes, read_text};
use crate::record::{Experiment, difference};
use crate::{Error, Result};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// What the rows of a finished shard are made from, and how many they are; its presence says that the shard is whole.
pub const SHARD: &str = "shard.toml";

/// The options of the call on which the results depend, besides those of the measuring.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, clap::Args)]
pub struct Settings {
    /// Which frames to draw with the model on them
    #[arg(long, value_enum, default_value_t = Overlays::Sample)]
    pub overlays: Overlays,
    #[command(flatten)]
    pub estimator: EstimatorArgs,
    #[command(flatten)]
    #[serde(flatten)]
    pub commanded: CommandedArgs,
}

/// Everything on which the rows of measurements.csv, and what is made of them, depend.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Origin {
    /// The program's version.
    snakeloop: String,
    /// The experiment as it was named in the call.
    pub experiment: PathBuf,
    /// The part of the frames.
    pub shard: Shard,
    follow: bool,
    /// What `run` does with the rows; `measure` leaves it at them.
    pub run: Option<Settings>,
    /// Checksums of the files read, by their path.
    inputs: BTreeMap<String, String>,
    /// Checksums of which frames there are and of those that the rig was refined from, by view.
    frames: BTreeMap<String, String>,
    /// In a shard that is done: its rows, and the rows of all shards.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub done: Option<Done>,
}

/// What a finished shard holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Done {
    /// Its own rows.
    pub rows: usize,
    /// Rows of all shards together.
    pub of: usize,
}

impl Origin {
    /// That of rows that are to be measured.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub fn new(
        named: &Path,
        experiment: &Experiment,
        views: &[OpenView],
        shard: Shard,
        follow: bool,
        run: Option<Settings>,
    ) -> Result<Self> {
        Ok(Self {
            snakeloop: env!("CARGO_PKG_VERSION").to_owned(),
            experiment: named.to_owned(),
            shard,
            follow,
            run,
            inputs: checksums(experiment)?,
            frames: views.iter().map(|view| (view.name().to_owned(), view.checksum().to_owned())).collect(),
            done: None,
        })
    }

    /// That of a finished shard.
    ///
    /// # Errors
    /// A file that cannot be read, or that another version wrote.
    pub fn read(path: &Path) -> Result<Self> {
        toml::from_str(&read_text(path)?).map_err(|e| Error::content(path, e.message()))
    }

    /// In words, the first thing in which two differ, apart from whether they are done.
    ///
    /// # Errors
    /// A number that TOML cannot hold.
    pub fn difference(&self, other: &Self) -> Result<Option<String>> {
        let [one, other] = [self, other].map(|origin| Self { done: None, ..origin.clone() }.table());
        Ok(difference(&one?, &other?))
    }

    /// As text, of a shard that is done.
    ///
    /// # Errors
    /// A number that TOML cannot hold.
    pub fn finished(self, done: Done) -> Result<String> {
        Ok(Self { done: Some(done), ..self }.table()?.to_string())
    }

    /// An error where files of the experiment are no longer what the rows were made from.
    pub fn check(&self, experiment: &Experiment) -> Result<()> {
        let now = checksums(experiment)?;
        match self.inputs.iter().find(|(path, checksum)| now.get(*path) != Some(*checksum)) {
            None => Ok(()),
            Some((path, _)) => {
                Err(Error::content(Path::new(path), "the file has changed since the shards were measured"))
            }
        }
    }

    /// As a table, to be written.
    ///
    /// # Errors
    /// A number that TOML cannot hold.
    pub fn table(&self) -> Result<toml::Table> {
        toml::Table::try_from(self).map_err(Error::encode("what the run is made from"))
    }
}

/// The files that an experiment names, but for the frames, each with its checksum.
fn checksums(experiment: &Experiment) -> Result<BTreeMap<String, String>> {
    let checksum_of = |path: PathBuf| {
        let mut checksum = Checksum::default();
        checksum.add(&read_bytes(&path, PICTURE_BYTES)?);
        Ok((path.display().to_string(), checksum.to_string()))
    };
    experiment.files().into_iter().map(checksum_of).collect()
}
