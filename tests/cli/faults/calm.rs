//! Files that would command wrongly without a word: cut short, older than those beside them, washed of their mark, or looked up too coarsely.

use super::fixture::{run, sandbox};
use crate::program::{Sandbox, all_said, data, json, number};
use snakeloop::record::{encoders_csv, read_encoders};
use snakeloop::robot::PerBackbone;
use std::fs;

/// A simulated experiment in `lab`, what is learned from it in `out`, and what is learned from a log with two columns exchanged in `bad`. Another
/// model that must not be used, and whose numbers could be a robot's, is in `plausible`.
fn learned() -> Sandbox {
    let sandbox = Sandbox::new();
    sandbox.write_hidden_model();
    sandbox.simulate("lab", "--model hidden.toml --seed 3");
    sandbox.succeed(&format!("estimate {} -o out", data("lab")));
    let log = read_encoders(&sandbox.join("lab/encoders.csv"), 3).unwrap().rows;
    let exchanged = log.iter().map(|row| snakeloop::observation::EncoderReading {
        q_mm: PerBackbone::from([row.q_mm[0], row.q_mm[2], row.q_mm[1]]),
        ..*row
    });
    fs::create_dir(sandbox.join("miswired")).unwrap();
    fs::copy(sandbox.join("lab/measurements.csv"), sandbox.join("miswired/measurements.csv")).unwrap();
    sandbox.write("miswired/encoders.csv", &encoders_csv(&exchanged.collect::<Vec<_>>(), 3));
    sandbox.succeed(&format!("estimate {} -o bad", data("miswired")));
    sandbox.succeed(&format!("estimate {} --model bad/model.toml --even-if-bad -o plausible", data("lab")));
    for model in ["bad/model.toml", "plausible/model.toml"] {
        assert!(sandbox.read(model).starts_with("# verdict: do not use"));
    }
    sandbox
}

/// One pose, asked of a model.
fn invert(model: &str) -> String {
    format!("invert --model {model} --theta-deg 60 --delta-deg 20")
}

#[test]
fn the_mark_of_a_model_is_found_whatever_was_done_to_its_file() {
    let sandbox = learned();
    let marked = sandbox.read("plausible/model.toml");
    let without_comments = marked.lines().filter(|line| !line.starts_with('#')).collect::<Vec<_>>().join("\n");
    for (name, text) in [
        ("blank.toml", format!("\n{marked}")),
        ("own.toml", format!("# copied by Ann\n\n{marked}")),
        ("windows.toml", marked.replace('\n', "\r\n")),
        // As programs write that read TOML, change a number and write it.
        ("tool.toml", without_comments),
    ] {
        sandbox.write(name, &text);
        let said = sandbox.fail(&invert(name), 1);
        assert!(said.contains("must not be used: the starting model"), "{name}: {said}");
    }
}

#[test]
fn a_model_that_must_not_be_used_comes_out_of_no_command_without_its_mark() {
    let sandbox = learned();
    sandbox.succeed(&format!("discover {} --model plausible/model.toml -o found --quiet", data("miswired")));
    let said = sandbox.fail(&invert("found/model.toml"), 1);
    assert!(said.contains("must not be used"), "{said}");
    let said = sandbox.fail(&format!("force {} --model plausible/model.toml -o force", data("lab")), 1);
    assert!(said.contains("must not be used"), "{said}");
}

#[test]
fn a_model_that_was_cut_short_is_refused_or_known_for_naive() {
    let sandbox = learned();
    let play = "--effect load_directed_backlash:play_mm=0.12";
    sandbox.simulate("play", &format!("--model hidden.toml --seed 5 {play}"));
    sandbox.succeed(&format!("discover {} -o found --quiet", data("play")));
    let whole = sandbox.read("found/model.toml");
    assert!(whole.contains("[[effect]]") && whole.contains("[covariance]"), "{whole}");
    let asked = |model: &str| sandbox.call(&format!("{} --json", invert(model)));
    let right = json(&String::from_utf8(asked("found/model.toml").stdout).unwrap());
    let (mut refused, mut naive, mut same) = (0, 0, 0);
    for (cut, _) in whole.match_indices('\n') {
        sandbox.write("cut.toml", &whole[..=cut]);
        let answer = asked("cut.toml");
        if !answer.status.success() {
            refused += 1;
        } else if all_said(&answer).contains("nothing was learned yet") {
            naive += 1;
        } else {
            let found = json(&String::from_utf8(answer.stdout).unwrap());
            assert_eq!(number(&found, "qc1_mm"), number(&right, "qc1_mm"), "{}", &whole[..=cut]);
            same += 1;
        }
    }
    assert!(refused > 10 && naive > 0 && same > 0, "{refused}, {naive}, {same}");
}

#[test]
fn no_two_files_of_a_folder_command_differently() {
    let sandbox = learned();
    sandbox.succeed("table --model out/model.toml --c-header -o out");
    let header = sandbox.read("out/compensation.h");
    let first = |text: &str| text.lines().find(|line| line.starts_with("    {{")).unwrap().to_owned();
    // Another robot is learned into the same folder: its model stands beside the former one's tables.
    sandbox.write("other.toml", &sandbox.read("hidden.toml").replace("eta = 1.221", "eta = 1.8"));
    sandbox.simulate("other", "--model other.toml --seed 4");
    sandbox.succeed(&format!("estimate {} -o out", data("other")));
    for (name, mark) in
        [("csv", ",stale\n"), ("json", "\"stale\": \"`estimate` has learned"), ("h", "SNAKELOOP_STALE 1")]
    {
        assert!(sandbox.read(&format!("out/compensation.{name}")).contains(mark), "{name}");
    }
    // A new table takes the mark away, and the header is the same table.
    sandbox.succeed("table --model out/model.toml -o out");
    let renewed = sandbox.read("out/compensation.h");
    assert!(!renewed.contains("STALE") && first(&renewed) != first(&header));
    let q = sandbox.read("out/compensation.csv").lines().nth(30).unwrap().split(',').nth(5).unwrap().to_owned();
    assert!(renewed.contains(&format!("{{{q}, ")), "{q}");
    // Over a grid that a header cannot have the one that stands there says that it is no longer the table.
    sandbox.succeed("table --model out/model.toml --delta-deg 0:90:10 -o out");
    assert!(sandbox.read("out/compensation.h").starts_with("#define SNAKELOOP_STALE 1 /* compensation.csv"));
}

#[test]
fn a_stale_model_makes_stale_tables_and_an_amber_one_is_told() {
    let sandbox = learned();
    let model = sandbox.read("out/model.toml");
    sandbox.write("stale.toml", &format!("# stale: the encoders stand still\n{model}"));
    sandbox.succeed("table --model stale.toml --c-header -o table");
    assert!(sandbox.read("table/compensation.csv").lines().next().unwrap().ends_with(",stale"));
    assert_eq!(json(&sandbox.read("table/compensation.json"))["stale"], "the encoders stand still");
    assert!(sandbox.read("table/compensation.h").starts_with("#define SNAKELOOP_STALE 1"));
    assert_eq!(sandbox.json(&invert("stale.toml"))["stale"], "the encoders stand still");
    sandbox
        .write("amber.toml", &model.replace("# verdict: good", "# verdict: look at this\n# - the gap is above noise"));
    let said = all_said(&sandbox.call(&invert("amber.toml")));
    assert!(said.contains("to be looked at before it is used: the gap is above noise"), "{said}");
}

#[test]
fn a_header_over_a_grid_too_coarse_to_interpolate_is_refused() {
    let sandbox = learned();
    let grid = "--theta-deg 0:75:25 --delta-deg=-180:90:90";
    let said = sandbox.fail(&format!("table --model out/model.toml {grid} --c-header -o coarse"), 2);
    assert!(said.contains("of bend off the model") && said.contains("smaller steps"), "{said}");
    assert!(!sandbox.join("coarse/compensation.csv").exists());
}

#[test]
fn a_shard_whose_rows_were_cut_is_not_merged() {
    let sandbox = sandbox();
    run(&sandbox, "part1", "--shard 1/2 --overlays none");
    run(&sandbox, "part2", "--shard 2/2 --overlays none");
    let rows = sandbox.read("part2/measurements.csv");
    let cut = rows.trim_end().rfind('\n').unwrap();
    sandbox.write("part2/measurements.csv", &rows[..=cut]);
    let said = sandbox.fail("merge part1 part2 -o merged", 1);
    assert!(said.contains("part2/measurements.csv") && said.contains("3 rows, expected 4"), "{said}");
    assert!(!sandbox.join("merged/compensation.csv").exists());
}
