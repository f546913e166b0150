//! At the end of a run: the journal as measurements.csv and encoders.csv, for all other commands, and where a stem was followed
//! as stem.csv.

use super::journal::{Entry, JOURNAL, read};
use super::learner::Learner;
use crate::error::{Error, Result};
use crate::estimate::{Reason, StemAngle, StemRow};
use crate::observation::Measurement;
use crate::record::{PendingFile, encoders_csv, measurements_csv, stems_csv};
use std::io::Write;
use std::path::Path;

/// Rows that are written at a time, so that a long run needs no memory.
const AT_ONCE: usize = 1000;

/// Writes measurements.csv and encoders.csv from the journal of a folder. A learner that follows a stem goes through it once more, for
/// stem.csv.
///
/// # Errors
/// A journal that cannot be read, a file that cannot be written.
pub fn write(output: &Path, mut learner: Learner) -> Result<()> {
    let backbones = learner.model().robot.backbone_count();
    let [measurements_path, readings_path, stem_path] =
        ["measurements.csv", "encoders.csv", "stem.csv"].map(|name| output.join(name));
    let mut measurements = Csv::create(&measurements_path, measurements_csv)?;
    let mut readings = Csv::create(&readings_path, |rows| encoders_csv(rows, backbones))?;
    let mut stem = if learner.stem().is_some() { Some(Csv::create(&stem_path, stems_csv)?) } else { None };
    learner.reset()?;
    let mut failed = None;
    read(&output.join(JOURNAL), |entry| {
        let written = match entry {
            Entry::Reset => learner.reset().map(|_| ()),
            Entry::Measured(measurement, reading) => {
                let followed = stem.as_mut().map_or(Ok(()), |stem| {
                    let learned = learner.take(&measurement, reading.as_ref());
                    learned.stem.map_or(Ok(()), |angle| stem.add(stem_row(&measurement, angle, learned.step.reason)))
                });
                let read = reading.map_or(Ok(()), |reading| readings.add(reading));
                measurements.add(measurement).and(read).and(followed)
            }
        };
        failed = failed.take().or(written.err());
    })?;
    failed.map_or(Ok(()), Err)?;
    measurements.finish()?;
    stem.map_or(Ok(()), Csv::finish)?;
    readings.finish()
}

fn stem_row(measurement: &Measurement, angle: StemAngle, reason: Option<Reason>) -> StemRow {
    StemRow {
        index: measurement.index,
        time_s: measurement.time_s,
        phi: angle.phi,
        sd_phi: angle.sd,
        reason: reason.map(|reason| reason.to_string()),
    }
}

/// A CSV file that is written piece by piece.
struct Csv<'a, T, F> {
    path: &'a Path,
    file: PendingFile,
    text_of: F,
    rows: Vec<T>,
    begun: bool,
}

impl<'a, T, F: Fn(&[T]) -> String> Csv<'a, T, F> {
    fn create(path: &'a Path, text_of: F) -> Result<Self> {
        Ok(Self { path, file: PendingFile::create(path)?, text_of, rows: Vec::new(), begun: false })
    }

    fn add(&mut self, row: T) -> Result<()> {
        self.rows.push(row);
        if self.rows.len() == AT_ONCE { self.write() } else { Ok(()) }
    }

    fn write(&mut self) -> Result<()> {
        let text = (self.text_of)(&self.rows);
        // The header stands before the first piece only.
        let from = if self.begun { text.find('\n').map_or(0, |end| end + 1) } else { 0 };
        self.begun = true;
        self.rows.clear();
        self.file.write_all(&text.as_bytes()[from..]).map_err(Error::io(self.path, "write"))
    }

    fn finish(mut self) -> Result<()> {
        self.write()?;
        self.file.commit()
    }
}
