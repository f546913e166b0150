//! At the end of a run: the journal as measurements.csv and encoders.csv, for all other commands.

use super::journal::{Entry, JOURNAL, read};
use crate::error::{Error, Result};
use crate::record::{PendingFile, encoders_csv, measurements_csv};
use std::io::Write;
use std::path::Path;

/// Rows that are written at a time, so that a long run needs no memory.
const AT_ONCE: usize = 1000;

/// Writes measurements.csv and the encoders.csv of so many backbones from the journal of a folder.
///
/// # Errors
/// A journal that cannot be read, a file that cannot be written.
pub fn write(output: &Path, backbones: usize) -> Result<()> {
    let [measurements_path, readings_path] = ["measurements.csv", "encoders.csv"].map(|name| output.join(name));
    let mut measurements = Csv::create(&measurements_path, measurements_csv)?;
    let mut readings = Csv::create(&readings_path, |rows| encoders_csv(rows, backbones))?;
    let mut failed = None;
    read(&output.join(JOURNAL), |entry| {
        if let Entry::Measured(measurement, reading) = entry {
            let written = measurements.add(measurement).and(reading.map_or(Ok(()), |reading| readings.add(reading)));
            failed = failed.take().or(written.err());
        }
    })?;
    failed.map_or(Ok(()), Err)?;
    measurements.finish()?;
    readings.finish()
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
