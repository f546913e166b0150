//! Measuring an experiment into a folder: row by row into a journal, at the end measurements.csv.

use super::console::Console;
use super::flow::{Flow, MeasuredFrames, Throughput};
use super::origin::{Done, Origin, SHARD, Settings};
use super::shard::Shard;
use super::trackers::OpenTracker;
use super::views::OpenView;
use crate::cli::failure::Failure;
use crate::observation::{EncoderReading, Measurement, commonest_status};
use crate::record::{
    Experiment, MeasurementJournal, MeasurementRows, remove_abandoned, remove_if_there, write_atomically,
};
use crate::robot::Model;
use crate::{Error, Result};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// How frames are gone through.
#[derive(Debug, clap::Args)]
pub struct MeasuringArgs {
    /// Follow a moving camera: find its position in every frame by grid and holder
    #[arg(long)]
    follow: bool,
    /// Continue an interrupted run: its measurements are in OUT/measurements.journal
    #[arg(long)]
    pub resume: bool,
    /// Number of threads [default: one per core]
    #[arg(long, value_name = "COUNT", value_parser = clap::value_parser!(u16).range(1..))]
    jobs: Option<u16>,
    /// Measure only the I-th of N parts of the frames: every N-th, from the I-th on. `merge` joins the parts
    #[arg(long, value_name = "I/N")]
    shard: Option<Shard>,
}

/// What became of measuring.
pub enum Measured {
    /// measurements.csv has every frame; the journal is to be removed when all that is made from it is written.
    Whole(MeasurementJournal, Throughput),
    /// One shard of several is done.
    Shard(Option<Throughput>),
}

impl MeasuringArgs {
    /// Sets how many threads work.
    ///
    /// # Errors
    /// A system that has no more threads to give.
    pub fn start_threads(&self) -> Result<(), Failure> {
        let Some(jobs) = self.jobs else { return Ok(()) };
        let pool = rayon::ThreadPoolBuilder::new().num_threads(usize::from(jobs)).build_global();
        pool.map_err(|e| Failure::Usage(format!("--jobs {jobs}: {e}")))
    }

    /// Measures what is not measured yet into the folder `output`, and writes measurements.csv there. `draw` sees every
    /// measured frame.
    ///
    /// # Errors
    /// A journal of another run, a folder of frames that went away, a disk that is full. What was measured is kept then.
    pub fn measure(
        &self,
        console: &Console,
        inputs: (&Path, &Experiment, &[OpenView], &[OpenTracker], &[EncoderReading], &Model),
        run: Option<Settings>,
        output: &Path,
        draw: impl Fn(&MeasuredFrames) -> Result<()> + Sync,
    ) -> Result<Measured> {
        let (named, experiment, views, trackers, encoders, model) = inputs;
        let shard = self.shard.unwrap_or(Shard::WHOLE);
        let origin = Origin::new(named, experiment, views, shard, self.follow, run)?;
        let marker = output.join(SHARD);
        if self.resume && marker.exists() {
            require_same(&marker, &origin)?;
            return Ok(Measured::Shard(None));
        }
        remove_if_there(&marker)?;
        let mut journal = match self.resume {
            true => MeasurementJournal::resume(output, &origin.table()?)?,
            false => MeasurementJournal::create(output, &origin.table()?)?,
        };
        remove_abandoned(&output.join("overlays"))?;
        if journal.rows() > 0 {
            console.say(format!("{} frames were measured before", journal.rows()));
        }
        let flow = Flow { views, trackers, encoders, model, follow: self.follow, shard, after: journal.last() };
        let flowed = flow.run(console, draw, |measurement| journal.append(&measurement)).inspect_err(|_| {
            console.say(format!("{} rows are kept in {}; --resume goes on", journal.rows(), journal.path().display()));
        })?;
        journal.publish(&output.join("measurements.csv"))?;
        if shard == Shard::WHOLE {
            return Ok(Measured::Whole(journal, flowed.throughput));
        }
        let done = Done { rows: journal.rows(), of: flowed.count };
        write_atomically(&marker, origin.finished(done)?.as_bytes())?;
        journal.remove()?;
        Ok(Measured::Shard(Some(flowed.throughput)))
    }
}

/// An error where a finished shard was made from something else.
fn require_same(marker: &Path, origin: &Origin) -> Result<()> {
    match Origin::read(marker)?.difference(origin)? {
        None => Ok(()),
        Some(difference) => {
            let message =
                format!("this shard is of another run: {difference}; choose another folder or leave --resume out");
            Err(Error::content(marker, message))
        }
    }
}

/// How many frames ended how.
#[derive(Debug, Default)]
pub struct Count {
    /// All rows.
    pub frames: usize,
    /// By status, `ok` among them.
    pub statuses: BTreeMap<String, usize>,
}

impl Count {
    /// Of measurements.
    pub fn of(measurements: &[Measurement]) -> Self {
        measurements.iter().fold(Self::default(), Self::with)
    }

    /// Of a measurements.csv.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub fn of_file(path: &Path) -> Result<Self> {
        MeasurementRows::open(path)?.try_fold(Self::default(), |count, row| Ok(count.with(&row?)))
    }

    /// With one more.
    fn with(mut self, measurement: &Measurement) -> Self {
        self.frames += 1;
        *self.statuses.entry(measurement.status.to_string()).or_default() += 1;
        self
    }

    /// An error where not a single frame has angles.
    pub fn require_some_measured(&self, experiment: &Experiment) -> Result<()> {
        if self.statuses.contains_key("ok") {
            return Ok(());
        }
        let reasons: Vec<_> = self.statuses.iter().map(|(status, count)| format!("{status} {count}")).collect();
        let message = format!(
            "none of the {} frames could be measured ({}); {}",
            self.frames,
            reasons.join(", "),
            commonest_status(&self.statuses).unwrap_or_else(|| "`snakeloop check` says more".to_owned())
        );
        Err(Error::content(&experiment.path, message))
    }
}

/// The result of measuring, as it is printed.
#[derive(Serialize)]
pub struct Summary {
    frames: usize,
    statuses: BTreeMap<String, usize>,
    #[serde(flatten)]
    throughput: Option<Throughput>,
    measurements: PathBuf,
}

impl Summary {
    /// Of the measurements.csv in a folder.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub fn of(output: &Path, throughput: Option<Throughput>) -> Result<Self> {
        let measurements = output.join("measurements.csv");
        let Count { frames, statuses } = Count::of_file(&measurements)?;
        Ok(Self { frames, statuses, throughput, measurements })
    }

    /// Prints the result, and what to do next.
    pub fn tell(&self, console: &Console, experiment: &Experiment) {
        console.result(self, || self.text());
        let log = experiment.encoders.as_ref().map_or("encoders.csv".into(), |log| log.path().display().to_string());
        let measurements = self.measurements.display();
        console.next(format_args!("snakeloop estimate --measurements {measurements} --encoders {log} -o estimated"));
    }

    /// Lines for people.
    pub fn text(&self) -> String {
        let statuses: Vec<_> = self.statuses.iter().map(|(status, count)| format!("{count} {status}")).collect();
        let speed = self.throughput.map(|throughput| {
            format!(
                "{:.1} frames/s, {:.0} % of it decoding\n",
                throughput.frames_per_second,
                100.0 * throughput.decoding_share
            )
        });
        format!(
            "{} frames: {}\n{}{}",
            self.frames,
            statuses.join(", "),
            speed.unwrap_or_default(),
            self.measurements.display()
        )
    }
}
