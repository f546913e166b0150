//! The rows of measurements.csv while frames are being measured: one line a row, in order, written as soon as it is known.
//!
//! The [file](LineFile) begins with what the rows are made from (TOML, each line behind `# `); a run may go on with it only if it would make
//! the same rows. Then come header and rows as in measurements.csv. Once a second they are brought to the disk, which is what a loss of
//! power can cost. From the first line on that is torn or makes no sense the journal is cut off when it is opened again. Other runs are
//! kept out of the folder by [`OutputFolder`](super::OutputFolder).

use super::line_file::{LineFile, Lines};
use super::measurements::{RowReader, measurement_line, measurements_header};
use super::write::{remove_if_there, write_atomically};
use crate::error::{Error, Result};
use crate::observation::Measurement;
use std::path::Path;
use std::time::{Duration, Instant};

/// The journal's name in the output folder.
pub const JOURNAL: &str = "measurements.journal";

/// The longest time that a row waits to be brought to the disk.
///
/// Convention: how much a power cut may cost.
const SYNC_EVERY: Duration = Duration::from_secs(1);

/// A journal of measurements that is being written.
#[derive(Debug)]
pub struct MeasurementJournal {
    file: LineFile,
    /// Where the header begins.
    head: u64,
    last: Option<u64>,
    rows: usize,
    synced: Instant,
}

impl MeasurementJournal {
    /// Begins a journal in a folder, which is created if it is missing; one that an earlier run left is replaced.
    ///
    /// # Errors
    /// A folder that cannot be written to.
    pub fn create(folder: &Path, origin: &toml::Table) -> Result<Self> {
        let path = folder.join(JOURNAL);
        let head: String = origin.to_string().lines().map(|line| format!("# {line}\n")).collect();
        write_atomically(&path, (head.clone() + &measurements_header() + "\n").as_bytes())?;
        Ok(Self { file: LineFile::open(path)?, head: head.len() as u64, last: None, rows: 0, synced: Instant::now() })
    }

    /// Opens the journal that an earlier run left, to go on with it; begins one where there is none.
    ///
    /// # Errors
    /// A journal that was made from something else (the message names it), or that cannot be read or written.
    pub fn resume(folder: &Path, origin: &toml::Table) -> Result<Self> {
        let path = folder.join(JOURNAL);
        if !path.exists() {
            return Self::create(folder, origin);
        }
        let file = LineFile::open(path.clone())?;
        let mut lines = Lines::open(&path)?;
        let mut former = String::new();
        let mut head = 0;
        let header = loop {
            let line = lines.next_line()?;
            let Some(of_head) = line.as_deref().and_then(|line| line.strip_prefix("# ")) else { break line };
            former += &(of_head.to_owned() + "\n");
            head = lines.end;
        };
        if header.is_none_or(|header| header != measurements_header()) {
            return Err(not_ours(&path, "no header of measurements.csv follows"));
        }
        let former: toml::Table = toml::from_str(&former).map_err(|e| not_ours(&path, e.message()))?;
        compare(&path, &former, origin)?;
        let (mut whole, mut last, mut rows) = (lines.end, None, 0);
        let reader = RowReader::default();
        while let Some(line) = lines.next_line()? {
            let Some(row) = reader.read(&line).ok().filter(|row| last.is_none_or(|last| row.index > last)) else {
                break;
            };
            (whole, last, rows) = (lines.end, Some(row.index), rows + 1);
        }
        file.cut(whole)?;
        Ok(Self { file, head, last, rows, synced: Instant::now() })
    }

    /// The index of the last row.
    pub fn last(&self) -> Option<u64> {
        self.last
    }

    /// How many rows there are.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        self.file.path()
    }

    /// Appends a row; its index must be above all before.
    ///
    /// # Errors
    /// A disk that is full or gone.
    pub fn append(&mut self, measurement: &Measurement) -> Result<()> {
        self.file.append(measurement_line(measurement))?;
        (self.last, self.rows) = (Some(measurement.index), self.rows + 1);
        if self.synced.elapsed() >= SYNC_EVERY {
            self.file.sync().map_err(Error::io(self.path(), "write"))?;
            self.synced = Instant::now();
        }
        Ok(())
    }

    /// Writes header and rows as a file of their own: measurements.csv. The journal stays until it is [removed](Self::remove).
    ///
    /// # Errors
    /// A disk that is full or gone.
    pub fn publish(&self, path: &Path) -> Result<()> {
        self.file.copy_from(self.head, path)
    }

    /// Removes the journal, once all that is made from it is written. One that somebody else removed is no error.
    ///
    /// # Errors
    /// A folder that does not let it go.
    pub fn remove(self) -> Result<()> {
        remove_if_there(self.path())
    }
}

fn not_ours(path: &Path, why: &str) -> Error {
    Error::content(path, format!("its head cannot be read ({why}); remove it, or start again without resuming"))
}

/// An error that names the first thing in which what the rows were made from differs from what they would be made from now.
fn compare(path: &Path, former: &toml::Table, now: &toml::Table) -> Result<()> {
    match difference(former, now) {
        None => Ok(()),
        Some(difference) => Err(Error::content(
            path,
            format!(
                "this journal was left by another run: {difference}. To continue it, \
                 call the command as then; to start again, do not resume"
            ),
        )),
    }
}

/// In words, the first key in which two tables differ.
pub fn difference(former: &toml::Table, now: &toml::Table) -> Option<String> {
    let keys = former.keys().chain(now.keys().filter(|key| !former.contains_key(*key)));
    keys.filter(|key| former.get(*key) != now.get(*key)).find_map(|key| match (former.get(key), now.get(key)) {
        (Some(toml::Value::Table(former)), Some(toml::Value::Table(now))) => difference(former, now),
        (former, now) => {
            let shown = |value: Option<&toml::Value>| value.map_or("not there".to_owned(), ToString::to_string);
            Some(format!("{key} was {} then and is {} now", shown(former), shown(now)))
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observation::Status;
    use crate::record::MeasurementRows;
    use proptest::prelude::*;

    fn origin(text: &str) -> toml::Table {
        toml::from_str(text).unwrap()
    }

    fn row(index: u64) -> Measurement {
        let status = if index.is_multiple_of(2) { Status::Unreadable } else { Status::NoSnake };
        Measurement { index, time_s: Some(0.5), status, measured: None, quality: None, view: Some("side".into()) }
    }

    fn published(journal: &MeasurementJournal) -> Vec<u64> {
        let path = journal.path().with_file_name("measurements.csv");
        journal.publish(&path).unwrap();
        MeasurementRows::open(&path).unwrap().map(|row| row.unwrap().index).collect()
    }

    #[test]
    fn wherever_a_journal_is_cut_all_whole_rows_remain_and_it_goes_on() {
        let origin = origin("a = 1\n[b]\nc = 'x'");
        let folder = tempfile::tempdir().unwrap();
        let mut journal = MeasurementJournal::create(folder.path(), &origin).unwrap();
        let head = std::fs::metadata(journal.path()).unwrap().len() as usize;
        (0..5).for_each(|index| journal.append(&row(index)).unwrap());
        let path = journal.path().to_owned();
        drop(journal);
        let bytes = std::fs::read(&path).unwrap();
        for cut in head..=bytes.len() {
            std::fs::write(&path, &bytes[..cut]).unwrap();
            let whole = bytes[head..cut].iter().filter(|&&byte| byte == b'\n').count();
            let mut journal = MeasurementJournal::resume(folder.path(), &origin).unwrap();
            assert_eq!((journal.rows(), journal.last()), (whole, (whole as u64).checked_sub(1)), "{cut}");
            journal.append(&row(77)).unwrap();
            let expected: Vec<u64> = (0..whole as u64).chain([77]).collect();
            assert_eq!(published(&journal), expected);
        }
    }

    #[test]
    fn what_follows_a_line_that_makes_no_sense_is_measured_again() {
        let folder = tempfile::tempdir().unwrap();
        for nonsense in ["\0\0\0\0", "1,2,3", &measurement_line(&row(0)), "\u{fffd}"] {
            let mut journal = MeasurementJournal::create(folder.path(), &origin("")).unwrap();
            journal.append(&row(0)).unwrap();
            journal.file.append(nonsense).unwrap();
            journal.append(&row(2)).unwrap();
            drop(journal);
            let journal = MeasurementJournal::resume(folder.path(), &origin("")).unwrap();
            assert_eq!(published(&journal), [0], "{nonsense:?}");
        }
    }

    #[test]
    fn a_journal_of_something_else_is_refused_and_the_difference_named() {
        let folder = tempfile::tempdir().unwrap();
        drop(MeasurementJournal::create(folder.path(), &origin("follow = false\n[inputs]\n'a.csv' = '12'")).unwrap());
        let refused = |text: &str| MeasurementJournal::resume(folder.path(), &origin(text)).unwrap_err().to_string();
        let message = refused("follow = false\n[inputs]\n'a.csv' = '13'");
        assert!(message.contains("a.csv was \"12\" then and is \"13\" now"), "{message}");
        assert!(message.contains(JOURNAL) && message.contains("do not resume"), "{message}");
        assert!(refused("follow = true\n[inputs]\n'a.csv' = '12'").contains("follow was false then and is true now"));
        assert!(refused("[inputs]\n'a.csv' = '12'").contains("follow was false then and is not there now"));
        std::fs::write(folder.path().join(JOURNAL), format!("# a = = 1\n{}\n", measurements_header())).unwrap();
        assert!(refused("").contains("its head cannot be read"));
    }

    proptest! {
        #[test]
        fn any_bytes_are_gone_on_with_or_refused(
            head in prop_oneof![Just("# a = 1\n".to_owned()), "(# .{0,20}\n){0,3}"],
            header in any::<bool>(),
            rows in proptest::collection::vec(any::<u8>(), 0..200)
        ) {
            let folder = tempfile::tempdir().unwrap();
            let header = if header { measurements_header() + "\n" } else { String::new() };
            std::fs::write(folder.path().join(JOURNAL), [head.as_bytes(), header.as_bytes(), &rows].concat()).unwrap();
            if let Ok(mut journal) = MeasurementJournal::resume(folder.path(), &origin("a = 1")) {
                let (rows, next) = (journal.rows(), journal.last().map_or(0, |last| last + 1));
                journal.append(&row(next)).unwrap();
                drop(journal);
                let journal = MeasurementJournal::resume(folder.path(), &origin("a = 1")).unwrap();
                prop_assert_eq!((journal.rows(), journal.last()), (rows + 1, Some(next)));
            }
        }
    }
}
