//! The book beside the program: what it says of commands, effects and statuses is what they say themselves.

use super::*;
use crate::observation::Status;
use crate::robot::BACKBONES;
use crate::robot::effects::{Changes, Physics, Poses, all};
use crate::verdict::Code;
use clap::CommandFactory;

fn with_all_below(command: &clap::Command) -> Vec<clap::Command> {
    let below = command.get_subcommands().flat_map(with_all_below);
    std::iter::once(command.clone()).chain(below).collect()
}

#[test]
fn every_command_has_an_example_and_every_flag_a_help_text() {
    Cli::command().debug_assert();
    for command in with_all_below(&Cli::command()) {
        let name = command.get_name().to_owned();
        assert!(command.get_about().is_some(), "{name}: no help text");
        let example = command.get_after_help().map(ToString::to_string).unwrap_or_default();
        assert!(example.contains("Example:\n  snakeloop "), "{name}: no example");
        for flag in command.get_arguments() {
            assert!(flag.get_help().is_some(), "{name} {}: no help text", flag.get_id());
        }
    }
}

/// docs/src/reference/commands.md as it must be: what --help says of every command.
fn reference() -> String {
    let mut text =
        "# Commands\n\nThe `--help` text of each command. Exit code 0 means done, 1 that the work failed, 2 wrong usage.\n"
            .to_owned();
    let mut root = Cli::command().term_width(100);
    root.build();
    for mut command in with_all_below(&root) {
        if command.get_name() == "help" || command.get_display_name().is_some_and(|name| name.contains("-help-")) {
            continue;
        }
        let name = command.get_display_name().unwrap_or("snakeloop").replace('-', " ");
        let help = command.render_long_help().to_string();
        let lines: Vec<&str> = help.lines().map(str::trim_end).collect();
        text += &format!("\n## {name}\n\n```text\n{}\n```\n", lines.join("\n").trim_end());
    }
    text
}

/// Compares a page of the book with what it must be, or writes it anew where WRITE_REFERENCE is set.
fn page_must_be(name: &str, text: &str) {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/src").join(name);
    if std::env::var_os("WRITE_REFERENCE").is_some() {
        std::fs::write(&path, text).unwrap();
    }
    let book = std::fs::read_to_string(&path).unwrap();
    assert!(
        book == text,
        "docs/src/{name} is not what the program says; write it anew with \
         WRITE_REFERENCE=1 cargo test --no-default-features --features cli --lib the_book_says"
    );
}

#[test]
fn the_book_says_of_every_command_what_help_says() {
    page_must_be("reference/commands.md", &reference());
}

/// What data show an effect, by what it needs to be seen.
fn shown_by(physics: &Physics) -> &'static str {
    match physics.changes {
        Changes::Neighbours(_) => {
            "neighbouring sections that move otherwise than this one, their readings in encoders.csv (`n1_q1_mm` …)"
        }
        Changes::Exposure(_) => "frames taken while the snake moves, with time stamps",
        _ if physics.history.is_some() && physics.in_time => "time stamps, and the same bends reached from both sides",
        _ if physics.history.is_some() => "the same bends reached from both sides: up and down again",
        _ if physics.in_time => "time stamps, slow and fast motion, and bends returned to after a while",
        Changes::Drive(_) => "the elastic part that all backbones share; hardly anything tells it from η",
        Changes::Encoders(_) => "many poses along each backbone's travel",
        Changes::Eye(_) | Changes::Snake(_) => "large bends in at least three directions of δ",
        Changes::Line(_) | Changes::Formula(_) => "bends up to the largest, in at least two planes",
    }
}

/// docs/src/reference/effects.md as it must be: what the library says of every effect.
fn catalogue() -> String {
    let mut text = "# The effects\n\n`discover` searches for physics that the paper's model leaves out. For each effect this page gives its meaning, its equation, its \
                    parameters, the data that show it, and the effects that are confounded with it by their equations (a given experiment may \
                    confound more; `discover` finds out which). Forms are different equations of one effect. `--effect NAME:PARAMETER=VALUE,...` \
                    switches an effect on in `simulate`, `table`, `invert` and `estimate`. The library itself writes this page.\n"
        .to_owned();
    let mut last = "";
    let mut names: Vec<&str> = Vec::new();
    for physics in all() {
        if !names.contains(&physics.name) {
            names.push(physics.name);
        }
    }
    for physics in names.into_iter().flat_map(|name| all().filter(move |physics| physics.name == name)) {
        if physics.name != last {
            let reading = physics.reading;
            text += &format!("\n## {}\n\nThe data show {reading}.\n", physics.name);
            text += &format!("\n- seen in: {}\n", shown_by(physics));
            let alike: Vec<String> = physics
                .confounded_with
                .iter()
                .map(|other| match other.on {
                    Poses::Any => format!("`{}`", other.with),
                    Poses::OnePlane => format!("`{}` where all bends lie in one plane", other.with),
                })
                .collect();
            if !alike.is_empty() {
                text += &format!("- confounded with: {}\n", alike.join(", "));
            }
            last = physics.name;
        }
        let form = if physics.form.is_empty() { String::new() } else { format!("Form *{}*: ", physics.form) };
        text += &format!("\n{form}`{}`\n", physics.equation);
        text += "\n| parameter | unit | least | largest |\n| --- | --- | --- | --- |\n";
        for spec in physics.parameters_on(*BACKBONES.start()) {
            text += &format!("| `{}` | {} | {} | {} |\n", spec.name, spec.unit, spec.range.0, spec.range.1);
        }
    }
    text
}

#[test]
fn the_book_says_of_every_effect_what_the_library_says() {
    page_must_be("reference/effects.md", &catalogue());
}

/// A page with the table between this comment and the next empty line as it must be.
fn with_table(page: &str, comment: &str, table: &str) -> String {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/src").join(page);
    let text = std::fs::read_to_string(path).unwrap();
    let (before, after) = text.split_once(&format!("{comment}\n\n")).expect("the comment");
    // What stands there already, as far as it is a table.
    let rest: String = after.split_inclusive('\n').skip_while(|line| line.starts_with('|')).collect();
    format!("{before}{comment}\n\n{table}{}{rest}", if rest.starts_with('\n') { "" } else { "\n" })
}

#[test]
fn the_book_says_of_every_status_what_a_report_says() {
    let mut table = "| status | what it means | what to do |\n| --- | --- | --- |\n".to_owned();
    for status in Status::ALL {
        let (meaning, remedy) = status.explained();
        table += &format!("| `{status}` | {meaning} | {remedy} |\n");
    }
    page_must_be("troubleshooting.md", &with_table("troubleshooting.md", "<!-- statuses -->", &table));
}

#[test]
fn the_book_says_of_every_verdict_code_what_is_seen_and_what_to_do() {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/src/reference/verdict.md");
    let page = std::fs::read_to_string(path).unwrap();
    for code in Code::ALL {
        let start = format!("| {} | ", serde_json::to_string(&code).unwrap().replace('"', "`"));
        let row = page.lines().find(|line| line.starts_with(&start)).unwrap_or_else(|| panic!("no row {start}"));
        assert!(row.split(" | ").filter(|cell| cell.len() > 10).count() >= 2, "{row}");
    }
}

#[test]
fn the_book_has_every_page_that_it_lists_and_lists_every_page() {
    let source = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/src");
    let summary = std::fs::read_to_string(source.join("SUMMARY.md")).unwrap();
    let listed: Vec<&str> = summary.split("](").skip(1).filter_map(|rest| rest.split(')').next()).collect();
    for page in &listed {
        let text = std::fs::read_to_string(source.join(page)).unwrap();
        assert!(text.starts_with("# "), "{page}");
        let links = text.split("](").skip(1).filter_map(|rest| rest.split(')').next());
        for link in links.filter(|link| link.ends_with(".md")) {
            let target = source.join(page).parent().unwrap().join(link);
            assert!(target.is_file(), "{page} points to {link}");
        }
    }
    for pattern in ["*.md", "*/*.md"] {
        for page in glob::glob(source.join(pattern).to_str().unwrap()).unwrap() {
            let page = page.unwrap().strip_prefix(&source).unwrap().to_str().unwrap().to_owned();
            assert!(page == "SUMMARY.md" || listed.contains(&page.as_str()), "{page} is not in SUMMARY.md");
        }
    }
}
