//! Rules that the sources keep: every constant says where its number comes from, and a test that it cites is there.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// What a constant's comment must contain one of: how it was derived, which source has it, to what it was fitted and where that was
/// judged, or that it is a format, a unit, a limit or a display choice on which no accuracy hangs.
const REASONS: [&str; 4] = ["Derived:", "Source:", "Fitted:", "Convention:"];

/// A constant of a number.
struct Constant {
    file: String,
    line: usize,
    name: String,
    reason: Option<&'static str>,
    /// The tests that its comment cites and that are not there.
    gone: Vec<String>,
}

#[test]
fn every_number_says_where_it_comes_from() {
    let constants = constants();
    assert!(constants.len() > 50, "only {} constants found: is src where it was?", constants.len());
    let mut rooms: BTreeMap<&str, Vec<&Constant>> = BTreeMap::new();
    for constant in &constants {
        rooms.entry(constant.file.split('/').next().unwrap()).or_default().push(constant);
    }
    let mut without = Vec::new();
    for (room, constants) in rooms {
        let with = |reason: &str| constants.iter().filter(|constant| constant.reason == Some(reason)).count();
        let counts = REASONS.map(|reason| format!("{reason} {}", with(reason)));
        let offenders = constants.iter().filter(|constant| constant.reason.is_none() || !constant.gone.is_empty());
        let offenders: Vec<_> =
            offenders.map(|c| format!("src/{}:{}: {} {}", c.file, c.line, c.name, c.gone.join(", "))).collect();
        println!("{room}: {} constants; {}; offenders {}", constants.len(), counts.join(", "), offenders.len());
        without.extend(offenders);
    }
    assert!(without.is_empty(), "{} constants without a reason that holds:\n{}", without.len(), without.join("\n"));
}

/// The constants of the sources, those of tests left out.
fn constants() -> Vec<Constant> {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files: Vec<PathBuf> =
        glob::glob(&format!("{}/**/*.rs", source.display())).unwrap().map(Result::unwrap).collect();
    files.sort();
    let texts: Vec<(PathBuf, String)> =
        files.into_iter().map(|path| (path.clone(), fs::read_to_string(path).unwrap())).collect();
    let of_tests: Vec<PathBuf> = texts.iter().flat_map(|(path, text)| test_modules(path, text)).collect();
    texts
        .iter()
        .filter(|(path, _)| {
            !of_tests.iter().any(|of_tests| path.starts_with(of_tests) || path == &of_tests.with_extension("rs"))
        })
        .flat_map(|(path, text)| {
            let file = path.strip_prefix(&source).unwrap().to_str().unwrap().to_owned();
            constants_of(&file, text)
        })
        .collect()
}

/// The paths, without `.rs`, of the modules that this file declares for tests only.
fn test_modules(path: &Path, text: &str) -> Vec<PathBuf> {
    let stem = path.file_stem().unwrap();
    let folder = if ["mod", "lib", "main"].contains(&stem.to_str().unwrap()) {
        path.parent().unwrap().to_owned()
    } else {
        path.with_extension("")
    };
    let lines: Vec<&str> = text.lines().collect();
    let declared = lines.windows(2).filter(|pair| pair[0].starts_with("#[cfg(") && pair[0].contains("test"));
    declared
        .filter_map(|pair| pair[1].trim_start_matches("pub(crate) ").strip_prefix("mod ")?.strip_suffix(';'))
        .map(|name| folder.join(name))
        .collect()
}

fn constants_of(file: &str, text: &str) -> Vec<Constant> {
    let lines: Vec<&str> = text.lines().collect();
    // Unit tests stand at the end of their file.
    let end = lines.windows(2).position(|pair| pair[0] == "#[cfg(test)]" && pair[1].starts_with("mod tests {"));
    let mut found = Vec::new();
    for (index, line) in lines[..end.unwrap_or(lines.len())].iter().enumerate() {
        if let Some(name) = number_constant(line) {
            // A constant right below another shares its comment, which then speaks of both.
            let above = lines[..index].iter().rposition(|line| number_constant(line).is_none());
            let comment = comment_above(&lines[..above.map_or(0, |last| last + 1)]);
            let reason = REASONS.into_iter().find(|reason| comment.contains(reason));
            let gone = gone(&comment);
            found.push(Constant { file: file.to_owned(), line: index + 1, name: name.to_owned(), reason, gone });
        }
    }
    found
}

/// The paths below `tests/` that a comment names and where there is neither a file nor a folder.
fn gone(comment: &str) -> Vec<String> {
    let is_of_path = |c: char| c.is_ascii_alphanumeric() || "/_.".contains(c);
    let words = comment.split(|c: char| !is_of_path(c)).map(|word| word.trim_end_matches('.'));
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let is_gone = |path: &&str| !root.join(path).exists() && !root.join(format!("{path}.rs")).exists();
    words.filter(|word| word.starts_with("tests/")).filter(is_gone).map(str::to_owned).collect()
}

/// The name of the constant that this line declares, if it is a number, several numbers or a time.
fn number_constant(line: &str) -> Option<&str> {
    let declared = line.trim_start().trim_start_matches("pub(crate) ").trim_start_matches("pub(super) ");
    let (name, rest) = declared.trim_start_matches("pub ").strip_prefix("const ")?.split_once(": ")?;
    let kind = rest.split(" =").next()?;
    let numbers = ["f64", "f32", "u8", "u16", "u32", "u64", "usize", "i8", "i16", "i32", "i64", "isize", "Duration"];
    let words = kind.split(|c: char| !c.is_alphanumeric());
    let of_numbers = words.filter(|word| !word.is_empty() && !word.starts_with(|c: char| c.is_ascii_digit()));
    let mut kinds = of_numbers.filter(|word| word.chars().any(char::is_lowercase)).peekable();
    (kinds.peek().is_some() && kinds.all(|word| numbers.contains(&word))).then_some(name)
}

/// The comment that stands right above, attributes passed over.
fn comment_above(lines: &[&str]) -> String {
    let above = lines.iter().rev().map(|line| line.trim_start()).filter(|line| !line.starts_with("#["));
    let mut comment: Vec<&str> = above.take_while(|line| line.starts_with("//")).collect();
    comment.reverse();
    comment.join("\n")
}
