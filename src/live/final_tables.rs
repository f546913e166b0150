//! The tables written at the end of a run, from its journal: measurements.csv and encoders.csv for the other commands, and stem.csv
//! where a stem was followed.

use super::journal::{Entry, JOURNAL, read};
use super::online_estimator::OnlineEstimator;
use crate::error::{Error, Result};
use crate::estimate::{Reason, StemAngle, StemRow};
use crate::observation::Measurement;
use crate::record::{PendingFile, encoders_csv, measurements_csv, stems_csv};
use std::io::Write;
use std::path::Path;

/// Rows written at a time. Convention: a resource limit.
const AT_ONCE: usize = 1000;

/// Writes measurements.csv and encoders.csv from the journal of a folder. An estimator that follows a stem goes through the journal
/// once more, for stem.csv.
///
/// # Errors
/// A journal that cannot be read, a file that cannot be written.
pub fn write(output: &Path, mut estimator: OnlineEstimator) -> Result<()> {
    let backbones = estimator.model().robot.backbone_count();
    let [measurements_path, readings_path, stem_path] =
        ["measurements.csv", "encoders.csv", "stem.csv"].map(|name| output.join(name));
    let mut measurements = Csv::create(&measurements_path, measurements_csv)?;
    let mut readings = Csv::create(&readings_path, |rows| encoders_csv(rows, backbones))?;
    let mut stem = if estimator.stem().is_some() { Some(Csv::create(&stem_path, stems_csv)?) } else { None };
    estimator.reset()?;
    let mut failed = None;
    read(&output.join(JOURNAL), |entry| {
        let written = match entry {
            Entry::Reset => estimator.reset().map(|_| ()),
            Entry::Measured(measurement, reading) => {
                let followed = stem.as_mut().map_or(Ok(()), |stem| {
                    let update = estimator.update(&measurement, reading.as_ref());
                    update.stem.map_or(Ok(()), |angle| stem.add(stem_row(&measurement, angle, update.step.reason)))
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
