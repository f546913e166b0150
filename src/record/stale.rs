//! The mark of a table that stays although what was measured since does not confirm it: why, in each of the files that hold it.
//!
//! | file | mark |
//! | --- | --- |
//! | `model.toml` | a first line `# stale: why` |
//! | `compensation.csv` | a last column `stale`, 1 in every row |
//! | `compensation.json` | a first key `"stale"`: why |
//! | `compensation.h` | a first line `#define SNAKELOOP_STALE 1`, with why in a comment |
//!
//! Who does not know the mark reads the files as before: comments, further columns and further keys are passed over. The numbers stay as
//! they are, to the byte, and writing the files anew removes the mark.

use super::model::verdict_in;
use super::write::{Files, write_together};
use crate::error::{Error, Result};
use crate::input::read_text;
use crate::verdict::Level;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// How the mark of a model begins.
const IN_MODEL: &str = "# stale: ";
/// How the mark of a JSON file's second line begins.
const IN_JSON: &str = "  \"stale\": ";
/// How the mark of a C header begins.
const IN_HEADER: &str = "#define SNAKELOOP_STALE 1";
/// The column of a table.
const COLUMN: &str = ",stale";
/// What is added to the name of a stale file that cannot be marked.
const ASIDE: &str = "stale";

/// Marks the model and the tables of a folder as stale, and says why in one sentence; those that are not there are passed over. Where no mark can be
/// written, as on a full disk, the files are renamed, so that nobody takes them for right.
///
/// # Errors
/// A file that cannot be read or written.
pub fn mark_stale(folder: &Path, why: &str) -> Result<()> {
    let marked = set_mark(folder, Some(why))?;
    write_together(&marked).map_err(|error| put_aside(&marked, error))
}

/// Takes the mark away: what stands there is confirmed again.
///
/// # Errors
/// Those of [`mark_stale`].
pub fn unmark_stale(folder: &Path) -> Result<()> {
    write_together(&set_mark(folder, None)?)
}

/// The tables of a folder as they are marked beside a model that was learned anew, to be written together with it.
///
/// # Errors
/// A file that cannot be read.
pub fn tables_marked_stale(folder: &Path, why: &str) -> Result<Files> {
    mark_tables(folder, Some(&in_one_line(why)))
}

/// Renames files that could not be marked, which takes no room; the error, with what became of them.
fn put_aside(files: &Files, error: Error) -> Error {
    let aside = |path: &Path| path.with_added_extension(ASIDE);
    let is_moved = |(path, _): &&(PathBuf, String)| std::fs::rename(path, aside(path)).is_ok();
    let moved: Vec<String> = files.iter().filter(is_moved).map(|(path, _)| aside(path).display().to_string()).collect();
    match files.first() {
        Some((path, _)) if !moved.is_empty() => {
            let message = format!(
                "it is stale and cannot be marked so ({error}): it stands in {} now; make room on the disk",
                moved.join(", ")
            );
            Error::content(path, message)
        }
        _ => error,
    }
}

/// Why the model in a file is stale, if it is marked so.
pub fn stale_mark(model: &Path) -> Option<String> {
    let text = read_text(model).ok()?;
    text.lines().find_map(|line| line.strip_prefix(IN_MODEL)).map(str::to_owned)
}

/// The verdict in a model's file, if there is one: its level, and the worst reason in a sentence. It stands in a comment, mostly above all others,
/// and among the keys.
pub fn verdict_mark(model: &Path) -> Option<(String, Option<String>)> {
    let text = read_text(model).ok()?;
    in_comments(&text).or_else(|| verdict_in(&text))
}

fn in_comments(text: &str) -> Option<(String, Option<String>)> {
    let mut comments = text.lines().filter_map(|line| line.trim_start().strip_prefix('#')).map(str::trim);
    // However a person wrote it.
    let level =
        comments.find_map(|line| line.to_lowercase().strip_prefix("verdict:").map(|level| level.trim().to_owned()))?;
    let worst = comments.find_map(|line| line.strip_prefix("- "));
    Some((level, worst.map(str::to_owned)))
}

/// Why the model in a file must not be used, if the verdict above its keys says so.
pub fn do_not_use_mark(model: &Path) -> Option<String> {
    let (level, worst) = verdict_mark(model)?;
    (level == Level::DoNotUse.to_string()).then(|| worst.unwrap_or("its verdict is \"do not use\"".to_owned()))
}

fn set_mark(folder: &Path, why: Option<&str>) -> Result<Files> {
    let why = why.map(in_one_line);
    let model = changed(&folder.join("model.toml"), |text| in_model(text, why.as_deref()))?;
    Ok(model.into_iter().chain(mark_tables(folder, why.as_deref())?).collect())
}

fn mark_tables(folder: &Path, why: Option<&str>) -> Result<Files> {
    let csv = changed(&folder.join("compensation.csv"), |text| in_csv(text, why.is_some()))?;
    let json = changed(&folder.join("compensation.json"), |text| in_json(text, why))?;
    Ok([csv, json, marked_header(folder, why)?].into_iter().flatten().collect())
}

/// The C header of a folder with the mark, or without, if there is one and that changes it.
pub(super) fn marked_header(folder: &Path, why: Option<&str>) -> Result<Option<(PathBuf, String)>> {
    changed(&folder.join("compensation.h"), |text| in_header(text, why))
}

pub(super) fn in_one_line(why: &str) -> String {
    why.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// A file with other content, if it is there and the content is another.
fn changed(path: &Path, change: impl FnOnce(&str) -> String) -> Result<Option<(PathBuf, String)>> {
    let text = match read_text(path) {
        Err(Error::Io { source, .. }) if source.kind() == ErrorKind::NotFound => return Ok(None),
        read => read?,
    };
    let changed = change(&text);
    Ok((changed != text).then(|| (path.to_owned(), changed)))
}

fn in_model(text: &str, why: Option<&str>) -> String {
    let plain = if text.starts_with(IN_MODEL) { text.split_once('\n').map_or("", |(_, rest)| rest) } else { text };
    why.map_or(String::new(), |why| format!("{IN_MODEL}{why}\n")) + plain
}

pub(super) fn in_csv(text: &str, is_stale: bool) -> String {
    let was_stale = text.lines().next().is_some_and(|header| header.ends_with(COLUMN));
    let line = |(k, line): (usize, &str)| {
        let plain = if was_stale { line.rsplit_once(',').map_or(line, |(plain, _)| plain) } else { line };
        let mark = match (is_stale, k) {
            (false, _) => "",
            (true, 0) => COLUMN,
            (true, _) => ",1",
        };
        format!("{plain}{mark}\n")
    };
    text.lines().enumerate().map(line).collect()
}

pub(super) fn in_json(text: &str, why: Option<&str>) -> String {
    let Some(rest) = text.strip_prefix("{\n") else { return text.to_owned() };
    let plain = if rest.starts_with(IN_JSON) { rest.split_once('\n').map_or("", |(_, plain)| plain) } else { rest };
    let mark = why.map_or(String::new(), |why| format!("{IN_JSON}{},\n", serde_json::Value::from(why)));
    format!("{{\n{mark}{plain}")
}

pub(super) fn in_header(text: &str, why: Option<&str>) -> String {
    let plain = if text.starts_with(IN_HEADER) { text.split_once('\n').map_or("", |(_, rest)| rest) } else { text };
    // What could end the comment early does not belong there.
    why.map_or(String::new(), |why| format!("{IN_HEADER} /* {} */\n", why.replace("*/", ""))) + plain
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::{Worth, compensation_files, read_model, write_model};
    use crate::robot::Model;
    use std::collections::BTreeMap;

    #[test]
    fn the_mark_is_in_every_file_changes_no_number_and_goes_without_a_trace() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path();
        mark_stale(path, "nothing is there").unwrap();
        assert_eq!(std::fs::read_dir(path).unwrap().count(), 0);
        let names = ["model.toml", "compensation.csv", "compensation.json"];
        let files = || -> BTreeMap<&str, String> {
            names.iter().map(|name| (*name, std::fs::read_to_string(path.join(name)).unwrap())).collect()
        };
        write_model(&path.join("model.toml"), &Model::default()).unwrap();
        let (tables, _) = compensation_files(path, &Model::default(), "model.toml", Worth::default()).unwrap();
        write_together(&tables).unwrap();
        let plain = files();

        // Once more with another reason: there is one mark.
        mark_stale(path, "first").unwrap();
        mark_stale(path, "the gap is \"above\"\nnoise").unwrap();
        let marked = files();
        assert_eq!(stale_mark(&path.join("model.toml")).unwrap(), "the gap is \"above\" noise");
        assert_eq!(read_model(&path.join("model.toml")).unwrap(), Model::default());
        let json: serde_json::Value = serde_json::from_str(&marked["compensation.json"]).unwrap();
        assert_eq!(json["stale"], "the gap is \"above\" noise");
        let before: serde_json::Value = serde_json::from_str(&plain["compensation.json"]).unwrap();
        assert_eq!(json["rows"], before["rows"]);
        for (line, before) in marked["compensation.csv"].lines().zip(plain["compensation.csv"].lines()) {
            let mark = if before.starts_with("theta") { ",stale" } else { ",1" };
            assert_eq!(line, format!("{before}{mark}"));
        }
        unmark_stale(path).unwrap();
        assert_eq!(files(), plain);
        let by_hand = path.join("by_hand.toml");
        std::fs::write(&by_hand, format!("#Verdict:DO NOT USE\n{}", plain["model.toml"])).unwrap();
        assert!(do_not_use_mark(&by_hand).is_some());
        assert_eq!(stale_mark(&path.join("model.toml")), None);
    }
}
