//! The journal: every measurement, written down before anything else is done with it.
//!
//! Each measurement or event is one line of JSON of a [file](LineFile). They are brought to the disk every second
//! ([`LineFile::sync`]); that much a loss of power can cost. A last line that is torn is cut off when the journal is opened again.

mod entry;

pub use entry::Entry;

use crate::error::{Error, Result};
use crate::record::line_file::{LineFile, Lines};
use entry::Line;
use std::path::Path;

/// The journal's name in the output folder.
pub const JOURNAL: &str = "journal.jsonl";

/// A journal that is being written.
#[derive(Debug)]
pub struct Journal {
    /// Its lines, to be brought to the disk and written anew where they are gone.
    pub(super) file: LineFile,
}

impl Journal {
    /// Begins a journal in a folder, which is created where it is missing. One without entries, which a run that failed at its start
    /// left, is taken over.
    ///
    /// # Errors
    /// A folder that has a journal already, or that cannot be written to.
    pub fn create(folder: &Path) -> Result<Self> {
        let path = folder.join(JOURNAL);
        std::fs::create_dir_all(folder).map_err(Error::io(folder, "create the folder"))?;
        let file = LineFile::open(path.clone())?;
        if std::fs::metadata(&path).map_err(Error::io(&path, "read"))?.len() > 0 {
            let message = "an earlier run left its journal here; go on with it (--resume) or choose another folder";
            return Err(Error::content(&path, message));
        }
        Ok(Self { file })
    }

    /// Opens the journal of an earlier run to go on with it, and gives `each` entry of it, in order; begins one where there is
    /// none. Says what could not be read.
    ///
    /// # Errors
    /// A file that cannot be read or written.
    pub fn resume(folder: &Path, each: impl FnMut(Entry)) -> Result<(Self, Option<String>)> {
        let path = folder.join(JOURNAL);
        if !path.exists() {
            return Ok((Self::create(folder)?, None));
        }
        let (whole, remark) = read(&path, each)?;
        let file = LineFile::open(path)?;
        file.cut(whole)?;
        Ok((Self { file }, remark))
    }

    /// Appends an entry.
    ///
    /// # Errors
    /// A disk that is full or gone.
    pub fn append(&mut self, entry: &Entry) -> Result<()> {
        let cannot = |e| Error::content(self.file.path(), format!("cannot write an entry: {e}"));
        self.file.append(serde_json::to_vec(&Line::from(entry)).map_err(cannot)?)
    }
}

/// Gives each entry of a journal, in order, and the length of what is whole; says what could not be read.
///
/// # Errors
/// A file that cannot be read.
pub fn read(path: &Path, mut each: impl FnMut(Entry)) -> Result<(u64, Option<String>)> {
    let mut lines = Lines::open(path)?;
    let mut bad = 0;
    while let Some(line) = lines.next_line()? {
        match serde_json::from_str::<Line>(&line).ok().and_then(Line::entry) {
            Some(entry) => each(entry),
            None => bad += 1,
        }
    }
    let remarks = [
        (bad > 0).then(|| format!("{bad} lines cannot be read and are left out")),
        lines.is_torn.then(|| "the last line is torn and was cut off".to_owned()),
    ];
    let remark = remarks.into_iter().flatten().collect::<Vec<_>>().join("; ");
    Ok((lines.end, (!remark.is_empty()).then(|| format!("{}: {remark}", path.display()))))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Configuration;
    use crate::input::LINE_BYTES;
    use crate::observation::{EncoderReading, Measured, Measurement, Quality, Shape, Status};
    use crate::record::measurement_line;
    use crate::robot::{Neighbours, PerBackbone};
    use proptest::prelude::*;

    fn entry(index: u64, theta: f64, with_reading: bool) -> Entry {
        let fitted_covariance = Some(nalgebra::Matrix2::new(2e-6, 1e-7, 1e-7, 3e-6));
        let measured =
            Measured { fitted_covariance, ..Measured::independent(Configuration::new(theta, 0.3), 0.001, 0.02, 0.1) };
        let time_s = index as f64 / 60.0;
        let measurement = Measurement {
            index,
            time_s: Some(time_s),
            status: Status::Ok,
            measured: Some(measured),
            quality: Some(Quality {
                edges: 400,
                inlier_fraction: 0.9,
                rms_px: 0.2,
                base_moved_px: Some(0.1),
                grid_moved_px: None,
                shape: Some(Shape {
                    tip_theta: theta + 0.01,
                    sigma_tip_theta: 0.002,
                    along: 0.03,
                    sigma_along: 0.004,
                    across: -0.05,
                    sigma_across: 0.006,
                    chi2: 7.5,
                }),
                profile: None,
            }),
            view: Some("side".into()),
        };
        let neighbours = Neighbours { q_mm: [PerBackbone::from([0.5, -0.25, -0.25]), PerBackbone::default()] };
        let q_mm = PerBackbone::from([0.1, -0.2, 0.3, 0.4]);
        let reading = EncoderReading { neighbours, ..EncoderReading::new(index, time_s, q_mm) };
        Entry::Measured(measurement, with_reading.then_some(reading))
    }

    fn entries_in(folder: &Path) -> Vec<Entry> {
        let mut entries = Vec::new();
        read(&folder.join(JOURNAL), |entry| entries.push(entry)).unwrap();
        entries
    }

    fn failed(index: u64) -> Entry {
        let measurement = Measurement {
            index,
            time_s: Some(1.0),
            status: Status::NoSnake,
            measured: None,
            quality: None,
            view: None,
        };
        Entry::Measured(measurement, None)
    }

    #[test]
    fn what_was_appended_is_there_again() {
        let folder = tempfile::tempdir().unwrap();
        let written = [entry(0, 0.5, true), failed(1), Entry::Reset, entry(2, 0.7, false)];
        let mut journal = Journal::create(folder.path()).unwrap();
        for entry in &written {
            journal.append(entry).unwrap();
        }
        for (read, written) in entries_in(folder.path()).iter().zip(&written) {
            match (read, written) {
                (Entry::Measured(a, q), Entry::Measured(b, p)) => {
                    // Every column of measurements.csv, to its last digit.
                    assert_eq!(measurement_line(a), measurement_line(b));
                    assert_eq!((a.time_s, q), (b.time_s, p));
                    let bend = |m: &Measurement| m.measured.map(|m| m.configuration.bend_vector());
                    if let (Some(a), Some(b)) = (bend(a), bend(b)) {
                        assert!((a - b).norm() < 1e-14);
                    }
                }
                pair => assert!(matches!(pair, (Entry::Reset, Entry::Reset))),
            }
        }
        let message = Journal::create(folder.path()).unwrap_err().to_string();
        assert!(message.contains("--resume"), "{message}");
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn wherever_a_journal_is_cut_all_whole_lines_remain(cut in 0usize..2000) {
            let folder = tempfile::tempdir().unwrap();
            let mut journal = Journal::create(folder.path()).unwrap();
            for index in 0..8 {
                journal.append(&entry(index, 0.1, true)).unwrap();
            }
            let path = folder.path().join(JOURNAL);
            let bytes = std::fs::read(&path).unwrap();
            let cut = cut.min(bytes.len());
            std::fs::write(&path, &bytes[..cut]).unwrap();
            let whole = bytes[..cut].iter().filter(|&&byte| byte == b'\n').count();
            let mut count = 0;
            let (mut journal, _) = Journal::resume(folder.path(), |_| count += 1).unwrap();
            prop_assert_eq!(count, whole);
            journal.append(&entry(99, 0.2, false)).unwrap();
            prop_assert_eq!(entries_in(folder.path()).len(), whole + 1);
        }
    }

    #[test]
    fn a_line_too_long_to_be_an_entry_is_left_out() {
        let folder = tempfile::tempdir().unwrap();
        let mut journal = Journal::create(folder.path()).unwrap();
        journal.append(&failed(1)).unwrap();
        journal.file.append("[".repeat(5_000_000)).unwrap();
        // Too long even where it would be an entry, were it cut.
        journal.file.append(String::from("{\"event\":\"reset\"}") + &" ".repeat(LINE_BYTES)).unwrap();
        journal.append(&failed(2)).unwrap();
        let mut count = 0;
        let (_, remark) = Journal::resume(folder.path(), |_| count += 1).unwrap();
        assert_eq!(count, 2);
        assert!(remark.unwrap().contains("2 lines cannot be read"));
    }

    #[test]
    fn a_journal_that_was_removed_is_written_anew_with_all_it_had() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("out");
        let mut journal = Journal::create(&out).unwrap();
        let to_sync = journal.file.clone();
        journal.append(&failed(1)).unwrap();
        assert!(!journal.file.restore().unwrap());
        for index in 2..4 {
            std::fs::remove_dir_all(&out).unwrap();
            assert!(journal.file.restore().unwrap());
            journal.append(&failed(index)).unwrap();
            to_sync.sync().unwrap();
            assert_eq!(entries_in(&out).len() as u64, index);
        }
        // So is one that somebody put another in the place of.
        std::fs::rename(out.join(JOURNAL), out.join("old")).unwrap();
        std::fs::write(out.join(JOURNAL), "").unwrap();
        assert!(journal.file.restore().unwrap());
        assert_eq!(entries_in(&out).len(), 3);
    }

    #[test]
    fn a_run_that_failed_at_its_start_is_not_in_the_way() {
        let folder = tempfile::tempdir().unwrap();
        drop(Journal::create(folder.path()).unwrap());
        Journal::create(folder.path()).unwrap().append(&failed(1)).unwrap();
        assert!(Journal::create(folder.path()).is_err());
    }

    #[test]
    fn a_line_of_an_earlier_version_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let first = r#"{"index":3,"time_s":0.5,"status":"ok","angles":[30.0,-20.0,0.1,0.2,0.0],"quality":[400,0.9,0.2],"q_mm":[0.1,0.2,0.3]}"#;
        let last = r#"{"index":4,"status":"ok","angles":[30.0,-20.0,0.1,0.2,0.5],"quality":[400,0.9,0.2],"moved_px":[0.5,null],"shape":[31.0,0.1,2.0,0.2,-3.0,0.3,7.5],"by_rig":[[1.0,2.0],[3.0,4.0],[0.0,0.0],[0.0,0.0],[0.0,0.0],[5.0,6.0]],"bend_covariance_rad2":[3e-6,1e-6,2e-6]}"#;
        std::fs::write(folder.path().join(JOURNAL), format!("{first}\n{last}\n")).unwrap();
        let entries = entries_in(folder.path());
        let [Entry::Measured(first, Some(reading)), Entry::Measured(last, None)] = &entries[..] else {
            panic!("{entries:?}")
        };
        assert_eq!((first.index, first.quality.unwrap().shape, reading.time_s), (3, None, 0.5));
        let (measured, quality) = (last.measured.unwrap(), last.quality.unwrap());
        assert_eq!((measured.correlation, quality.base_moved_px, quality.grid_moved_px), (0.5, Some(0.5), None));
        assert_eq!(measured.fitted_covariance, Some(nalgebra::Matrix2::new(3e-6, 1e-6, 1e-6, 2e-6)));
        assert_eq!(measured.by_rig.column(5).as_slice(), [5.0, 6.0].map(f64::to_radians));
        let shape = quality.shape.unwrap();
        assert_eq!((shape.tip_theta, shape.across, shape.chi2), (31f64.to_radians(), -3f64.to_radians(), 7.5));
    }

    #[test]
    fn lines_of_somebody_else_are_left_out_and_told() {
        let folder = tempfile::tempdir().unwrap();
        let mut journal = Journal::create(folder.path()).unwrap();
        journal.append(&failed(1)).unwrap();
        journal.file.append(b"not a line of ours\n\xff\xfe\n{\"event\":\"dance\"}").unwrap();
        journal.append(&failed(2)).unwrap();
        let mut count = 0;
        let (_, remark) = Journal::resume(folder.path(), |_| count += 1).unwrap();
        assert_eq!(count, 2);
        assert!(remark.unwrap().contains("3 lines cannot be read"));
    }
}
