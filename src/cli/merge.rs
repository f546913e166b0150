//! `merge`: the shards of a run to what one run would have written.
//!
//! The rows are put in order and gone through once more: the estimator's weights and its gate hang on the estimate so far, so that
//! sums over shards would agree with one run up to rounding only if nothing were ever rejected.

use super::console::Console;
use super::inputs::{files_read, maker};
use super::measuring::Summary;
use super::origin::{Done, Origin, SHARD};
use super::run::{Inputs, OUTPUTS, finish};
use super::verdict::VerdictArgs;
use super::views::reasons_of_sheets_again;
use crate::cli::failure::Failure;
use crate::input::{PICTURE_BYTES, read_bytes};
use crate::record::{
    Experiment, MeasurementRows, OutputFolder, PendingFile, measurement_line, measurements_header, write_atomically,
};
use crate::{Error, Result};
use std::collections::BTreeSet;
use std::fs;
use std::io::Write;
use std::iter::Peekable;
use std::path::{Path, PathBuf};

/// Join the shards of a run: writes into OUT the same files, byte by byte but for the date, as one run over all frames
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
    /// The folder to write to; created if it is missing
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    #[command(flatten)]
    verdict: VerdictArgs,
}

impl Args {
    pub fn run(&self, console: &Console) -> Result<(), Failure> {
        if self.shards.iter().any(|shard| is_same(shard, &self.output)) {
            let message = format!("{} is a shard; write to another folder", self.output.display());
            return Err(Failure::Usage(message));
        }
        let (origin, rows_of) = self.origin()?;
        let experiment = Experiment::read(&origin.experiment)?;
        origin.check(&experiment)?;
        let of_shards = self.shards.iter().map(|shard| shard.join("measurements.csv"));
        let inputs = files_read(&experiment, &[]).into_iter().chain(of_shards).collect::<Vec<_>>();
        let mut out = OutputFolder::claim(&self.output, &OUTPUTS, &inputs)?;
        out.made_by(&maker("run", &experiment), &OUTPUTS)?;
        self.join_rows(&rows_of)?;
        let Some(settings) = origin.run else {
            let summary = Summary::of(&self.output, None)?;
            summary.tell(console, &experiment);
            return Ok(());
        };
        self.copy_overlays()?;
        let inputs = Inputs::read(console, &experiment)?;
        let sheets = reasons_of_sheets_again(&experiment, inputs.robot(), &self.output);
        let summary = finish(&experiment, &inputs, sheets, settings, &self.output, None)?;
        summary.tell(console, &experiment);
        summary.require_table(&experiment)?;
        self.verdict.check(&summary.verdict)
    }

    /// What all shards are made from, and how many rows each has.
    ///
    /// # Errors
    /// A shard that is not done, is missing, is there twice, or is of another run.
    fn origin(&self) -> Result<(Origin, Vec<usize>), Failure> {
        let shards = self.shards.iter().map(|folder| finished(folder)).collect::<Result<Vec<_>>>()?;
        let Some((first, done)) = shards.first() else {
            return Err(Failure::Usage("give the shards' folders".to_owned()));
        };
        let mut parts = BTreeSet::new();
        for ((origin, _), folder) in shards.iter().zip(&self.shards) {
            let path = folder.join(SHARD);
            if !parts.insert(origin.shard.part) {
                return Err(
                    Error::content(&path, format!("shard {} is there twice; leave one out", origin.shard)).into()
                );
            }
            let mut as_first = origin.clone();
            as_first.shard.part = first.shard.part;
            if let Some(difference) = first.difference(&as_first)? {
                let other = self.shards[0].display();
                return Err(Error::content(&path, format!("another run's shard than {other}: {difference}")).into());
            }
        }
        let of = first.shard.of;
        let missing: Vec<_> =
            (1..=of).filter(|part| !parts.contains(part)).map(|part| format!("{part}/{of}")).collect();
        if !missing.is_empty() {
            return Err(Failure::Usage(format!("shards are missing: {}", missing.join(", "))));
        }
        let rows: usize = shards.iter().map(|(_, done)| done.rows).sum();
        if rows != done.of {
            let message = format!("the shards have {rows} rows together, expected {}; measure them again", done.of);
            return Err(Error::content(&self.shards[0].join(SHARD), message).into());
        }
        Ok((first.clone(), shards.iter().map(|(_, done)| done.rows).collect()))
    }

    /// Writes measurements.csv from those of the shards, which have so many rows, in order of the index.
    ///
    /// # Errors
    /// A shard with another number of rows than it was measured with; a file that cannot be read or written.
    fn join_rows(&self, rows_of: &[usize]) -> Result<()> {
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
        let (mut joined, mut last) = (vec![0; shards.len()], None);
        loop {
            let places: Vec<u64> = shards.iter_mut().map(place).collect();
            let first = (0..shards.len()).min_by_key(|&shard| places[shard]);
            let Some((first, row)) = first.and_then(|first| Some((first, shards[first].next()?))) else { break };
            joined[first] += 1;
            let row = row?;
            if last.is_some_and(|last| row.index <= last) {
                let message = format!(
                    "frame {} stands twice or out of order: the file was changed; measure the shard again",
                    row.index
                );
                return Err(Error::content(&self.shards[first].join("measurements.csv"), message));
            }
            last = Some(row.index);
            write(measurement_line(&row))?;
        }
        for ((folder, found), expected) in self.shards.iter().zip(joined).zip(rows_of) {
            if found != *expected {
                let message = format!(
                    "{found} rows, expected {expected}: the file was cut short or changed; copy or measure the shard again"
                );
                return Err(Error::content(&folder.join("measurements.csv"), message));
            }
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

/// What a shard is made from and holds, once it is done.
fn finished(folder: &Path) -> Result<(Origin, Done)> {
    let path = folder.join(SHARD);
    if folder.is_dir() && !path.exists() {
        let message = format!("no {SHARD}: the shard is not done; call the shard again with --resume");
        return Err(Error::content(folder, message));
    }
    let origin = Origin::read(&path)?;
    let done = origin.done.ok_or_else(|| Error::content(&path, "done is missing; measure the shard again"))?;
    Ok((origin, done))
}

fn is_same(a: &Path, b: &Path) -> bool {
    matches!((a.canonicalize(), b.canonicalize()), (Ok(a), Ok(b)) if a == b)
}
