//! What of a file was passed over, and why: said row by row, up to a bound.

use std::fmt;
use std::path::{Path, PathBuf};

/// Something in a file that was passed over, and why. The rest of the file was used.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Warning {
    /// The file.
    pub path: PathBuf,
    /// The line, counted from 1, of a file that has lines.
    pub line: Option<u64>,
    /// What was found, and what was done about it.
    pub message: String,
    /// What kind of thing it is.
    pub fault: Fault,
}

/// What kind of thing was passed over.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// A row or a message that makes no sense.
    Row,
    /// What two rows or messages say of one index or one moment differs; neither is used.
    Contradiction,
    /// A recording that was cut off or is damaged.
    Damage,
    /// Time stamps by which nothing can be matched.
    Clock,
}

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.line {
            Some(line) => write!(f, "{}:{line}: {}", self.path.display(), self.message),
            None => write!(f, "{}: {}", self.path.display(), self.message),
        }
    }
}

/// The warnings about one file, of which only so many are kept: a file of nothing but faults is soon known for what it is.
pub(in crate::record) struct Warnings<'a> {
    path: &'a Path,
    first: Vec<Warning>,
    others: u64,
}

impl<'a> Warnings<'a> {
    /// Convention: a resource limit.
    const MOST: usize = 1000;

    /// None yet, of a file.
    pub fn new(path: &'a Path) -> Self {
        Self { path, first: Vec::new(), others: 0 }
    }

    /// Notes a row that was passed over.
    pub fn push(&mut self, line: u64, message: String) {
        self.told(line, message, Fault::Row);
    }

    /// Notes a fault of another kind.
    pub fn told(&mut self, line: u64, message: String, fault: Fault) {
        if self.first.len() < Self::MOST {
            self.first.push(Warning { path: self.path.to_owned(), line: Some(line), message, fault });
        } else {
            self.others += 1;
        }
    }

    /// In order of their lines; the last tells how many more there were.
    pub fn in_order(mut self) -> Vec<Warning> {
        self.first.sort_by_key(|warning| warning.line);
        if let (true, Some(last)) = (self.others > 0, self.first.last()) {
            let message = format!("and {} more rows with faults", self.others);
            self.first.push(Warning { message, ..last.clone() });
        }
        self.first
    }
}
