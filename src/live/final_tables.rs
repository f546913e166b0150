//! The tables that stand at the end of a run: measurements.csv and encoders.csv for the other commands, and stem.csv where a stem was
//! followed. They are written under temporary names as the run goes on, so that its end takes no longer after hours than after a minute.

use super::online_estimator::Update;
use crate::error::{Error, Result};
use crate::estimate::{Reason, StemAngle, StemRow};
use crate::observation::{EncoderReading, Measurement};
use crate::record::{PendingFile, encoders_csv, measurements_csv, stems_csv};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Rows written at a time. Convention: a resource limit, and few, because the loop waits for them.
const AT_ONCE: usize = 100;

/// The tables of a run while it goes on.
pub struct FinalTables {
    measurements: Csv<Measurement>,
    readings: Csv<EncoderReading>,
    stem: Option<Csv<StemRow>>,
}

impl FinalTables {
    /// Begins the tables of a folder, for a robot with so many backbones; stem.csv only where a stem is followed.
    ///
    /// # Errors
    /// A folder that cannot be written to.
    pub fn begin(output: &Path, backbones: usize, with_stem: bool) -> Result<Self> {
        let stem = with_stem.then(|| Csv::begin(output.join("stem.csv"), stems_csv)).transpose()?;
        Ok(Self {
            measurements: Csv::begin(output.join("measurements.csv"), measurements_csv)?,
            readings: Csv::begin(output.join("encoders.csv"), move |rows| encoders_csv(rows, backbones))?,
            stem,
        })
    }

    /// Adds a measurement, the reading that belongs to it, and what the estimator made of them.
    ///
    /// # Errors
    /// A disk that is full or gone.
    pub fn add(&mut self, measurement: &Measurement, reading: Option<&EncoderReading>, update: &Update) -> Result<()> {
        self.measurements.add(measurement.clone())?;
        reading.map_or(Ok(()), |reading| self.readings.add(*reading))?;
        match (&mut self.stem, update.stem) {
            (Some(stem), Some(angle)) => stem.add(stem_row(measurement, angle, update.step.reason.as_ref())),
            _ => Ok(()),
        }
    }

    /// Gives the tables their names.
    ///
    /// # Errors
    /// A disk that is full or gone.
    pub fn finish(self) -> Result<()> {
        self.measurements.finish()?;
        self.stem.map_or(Ok(()), Csv::finish)?;
        self.readings.finish()
    }
}

fn stem_row(measurement: &Measurement, angle: StemAngle, reason: Option<&Reason>) -> StemRow {
    StemRow {
        index: measurement.index,
        time_s: measurement.time_s,
        phi: angle.phi,
        sd_phi: angle.sd,
        reason: reason.map(ToString::to_string),
    }
}

/// The text of a CSV file with these rows.
type TextOf<T> = Box<dyn Fn(&[T]) -> String + Send>;

/// A CSV file that is written piece by piece.
struct Csv<T> {
    path: PathBuf,
    file: PendingFile,
    text_of: TextOf<T>,
    rows: Vec<T>,
    begun: bool,
}

impl<T> Csv<T> {
    fn begin(path: PathBuf, text_of: impl Fn(&[T]) -> String + Send + 'static) -> Result<Self> {
        let file = PendingFile::create(&path)?;
        Ok(Self { path, file, text_of: Box::new(text_of), rows: Vec::new(), begun: false })
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
        self.file.write_all(&text.as_bytes()[from..]).map_err(Error::io(&self.path, "write"))
    }

    fn finish(mut self) -> Result<()> {
        self.write()?;
        self.file.commit()
    }
}

#[cfg(test)]
mod tests {
    use super::super::online_estimator::OnlineEstimator;
    use super::*;
    use crate::estimate::Options;
    use crate::geometry::Configuration;
    use crate::observation::{Measured, Status};
    use crate::robot::{Model, PerBackbone};
    use std::fs;

    /// Bytes of all files of a folder.
    fn bytes_in(folder: &Path) -> u64 {
        fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().metadata().unwrap().len()).sum()
    }

    #[test]
    fn few_rows_are_left_for_the_end_and_a_folder_that_was_removed_costs_none() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("out");
        let mut estimator = OnlineEstimator::new(Model::default(), Options::default(), None).unwrap();
        let mut tables = FinalTables::begin(&out, 3, false).unwrap();
        let (mut measurements, mut readings) = (Vec::new(), Vec::new());
        for index in 0..250 {
            let measured = Measured::independent(Configuration::new(0.002 * index as f64, 0.3), 0.001, 0.02, 0.1);
            let (time_s, view) = (index as f64 / 60.0, Some("side".into()));
            let measurement = Measurement {
                index,
                time_s: Some(time_s),
                status: Status::Ok,
                measured: Some(measured),
                quality: None,
                view,
            };
            // Every third frame has no reading.
            let reading = EncoderReading::new(index, time_s, PerBackbone::from([0.1, -0.2, 0.3]));
            let reading = Some(reading).filter(|_| index % 3 > 0);
            let update = estimator.update(&measurement, reading.as_ref());
            tables.add(&measurement, reading.as_ref(), &update).unwrap();
            measurements.push(measurement);
            readings.extend(reading);
            if index == 120 {
                assert!(bytes_in(&out) >= measurements_csv(&measurements[..100]).len() as u64);
                fs::remove_dir_all(&out).unwrap();
            }
        }
        tables.finish().unwrap();
        assert_eq!(fs::read_to_string(out.join("measurements.csv")).unwrap(), measurements_csv(&measurements));
        assert_eq!(fs::read_to_string(out.join("encoders.csv")).unwrap(), encoders_csv(&readings, 3));
        assert_eq!(fs::read_dir(&out).unwrap().count(), 2, "no temporary file stays behind");
    }
}
