//! `merge`: the shards of a run to what one run would have written.
//!
//! The rows are put in order and gone through once more: the estimator's weights and its gate hang on the estimate so far, so that
//! sums over shards would agree with one run up to rounding only if nothing were ever rejected.

use super::console::Console;
use super::measuring::{Origin, SHARD, Summary};
use super::run::{Inputs, finish};
use crate::input::{PICTURE_BYTES, read_bytes};
use crate::record::{
    Experiment, MeasurementRows, PendingFile, measurement_line, measurements_header, write_atomically,
};
use crate::{Error, Result};
use std::fs;
use std::io::Write;
use std::iter::Peekable;
use std::path::{Path, PathBuf};

/// Put the shards of a run together: writes into OUT the same files, byte by byte, as one run over all frames
///
/// Every shard is a folder that `run --shard I/N` or `measure --shard I/N` wrote. Call it from the folder in which the shards were
/// called: the experiment is found where it was then.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  snakeloop run fixtures/bending --shard 1/2 -o part1 && \
                  snakeloop run fixtures/bending --shard 2/2 -o part2 && snakeloop merge part1 part2 -o out")]
pub struct Args {
    /// The shards' folders, all of them, in any order
    #[arg(required = true, value_name = "SHARD_DIR")]
    shards: Vec<PathBuf>,
    /// The folder to write to; created where it is missing
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
}

impl Args {
    pub fn run(&self, console: &Console) -> Result<()> {
        if self.shards.iter().any(|shard| is_same(shard, &self.output)) {
            let message = format!("{} is a shard; write to another folder", self.output.display());
            return Err(Error::Usage(message));
        }
        let origin = self.origin()?;
        let experiment = Experiment::read(&origin.experiment)?;
        origin.check(&experiment)?;
        self.join_rows()?;
        let Some(settings) = origin.run else {
            let summary = Summary::of(&self.output, None)?;
            console.result(&summary, || summary.text());
            return Ok(());
        };
        self.copy_overlays()?;
        let inputs = Inputs::read(console, &experiment)?;
        let summary = finish(&experiment, &inputs, settings, &self.output, None)?;
        console.result(&summary, || summary.text());
        Ok(())
    }

    /// What all shards are made from.
    ///
    /// # Errors
    /// A shard that is not done, is missing, is there twice, or is of another run.
    fn origin(&self) -> Result<Origin> {
        let mut first: Option<(Origin, &Path)> = None;
        let mut parts: Vec<usize> = Vec::new();
        let mut rows = 0;
        for folder in &self.shards {
            let path = folder.join(SHARD);
            if folder.is_dir() && !path.exists() {
                let message = format!("no {SHARD}: the shard is not done; call it again with --resume");
                return Err(Error::content(folder, message));
            }
            let origin = Origin::read(&path)?;
            let done = origin.done.ok_or_else(|| Error::content(&path, "done is missing; measure the shard again"))?;
            if parts.contains(&origin.shard.part) {
                return Err(Error::content(&path, format!("shard {} is there twice; leave one out", origin.shard)));
            }
            parts.push(origin.shard.part);
            rows += done.rows;
            match &first {
                None => first = Some((origin, folder)),
                Some((first, other)) => {
                    let alike = |origin: &Origin| {
                        let mut alike = origin.clone();
                        alike.shard.part = 1;
                        alike.done = None;
                        alike
                    };
                    if let Some(difference) = alike(first).difference(&alike(&origin))? {
                        let message = format!("another run's shard than {}: {difference}", other.display());
                        return Err(Error::content(&path, message));
                    }
                }
            }
        }
        let Some((origin, folder)) = first else {
            return Err(Error::Usage("give the shards' folders".to_owned()));
        };
        let missing: Vec<_> = (1..=origin.shard.of).filter(|part| !parts.contains(part)).collect();
        if !missing.is_empty() {
            let missing: Vec<_> = missing.iter().map(|part| format!("{part}/{}", origin.shard.of)).collect();
            return Err(Error::Usage(format!("shards are missing: {}", missing.join(", "))));
        }
        match origin.done {
            Some(done) if done.of != rows => {
                let message = format!("the shards have {rows} rows together, expected {}; measure them again", done.of);
                Err(Error::content(&folder.join(SHARD), message))
            }
            _ => Ok(origin),
        }
    }

    /// Writes measurements.csv from those of the shards, in order of the index.
    fn join_rows(&self) -> Result<()> {
        let open = |folder: &PathBuf| Ok(MeasurementRows::open(&folder.join("measurements.csv"))?.peekable());
        let mut shards: Vec<Peekable<MeasurementRows>> = self.shards.iter().map(open).collect::<Result<_>>()?;
        let path = self.output.join("measurements.csv");
        let mut file = PendingFile::create(&path)?;
        let mut write = |line: String| writeln!(file, "{line}").map_err(Error::io(&path, "write"));
        write(measurements_header())?;
        // An error comes first and is told; who has no more rows comes last.
        let place = |rows: &mut Peekable<MeasurementRows>| match rows.peek() {
            None => u64::MAX,
            Some(row) => row.as_ref().map_or(0, |row| row.index),
        };
        loop {
            let places: Vec<u64> = shards.iter_mut().map(place).collect();
            let first = (0..shards.len()).min_by_key(|&shard| places[shard]);
            let Some(row) = first.and_then(|first| shards[first].next()) else { break };
            write(measurement_line(&row?))?;
        }
        file.commit()
    }

    fn copy_overlays(&self) -> Result<()> {
        for folder in self.shards.iter().map(|shard| shard.join("overlays")).filter(|folder| folder.is_dir()) {
            for entry in fs::read_dir(&folder).map_err(Error::io(&folder, "read"))? {
                let path = entry.map_err(Error::io(&folder, "read"))?.path();
                // What a shard that was killed left under a temporary name stays there.
                if let (Some(name), Some("jpg")) = (path.file_name(), path.extension().and_then(|e| e.to_str())) {
                    let picture = read_bytes(&path, PICTURE_BYTES)?;
                    write_atomically(&self.output.join("overlays").join(name), &picture)?;
                }
            }
        }
        Ok(())
    }
}

fn is_same(a: &Path, b: &Path) -> bool {
    matches!((a.canonicalize(), b.canonicalize()), (Ok(a), Ok(b)) if a == b)
}
