//! Files that would command wrongly without a word: cut short, older than those beside them, washed of their mark, or looked up too coarsely.

use super::fixture::{run, sandbox};
use crate::program::{Sandbox, all_said, data, json, number};
use snakeloop::record::{encoders_csv, read_encoders};
use snakeloop::robot::PerBackbone;
use std::fs;
use std::path::Path;

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

#[test]
fn an_effect_that_stands_twice_in_a_model_is_refused_by_name_and_line() {
    let sandbox = learned();
    let model = sandbox.read("out/model.toml");
    let play = "\n[[effect]]\nname = \"load_directed_backlash\"\nparameters.play_mm = { value = 0.11, sd = 0.0004, unit = \"mm\" }\n";
    sandbox.write("once.toml", &format!("{model}{play}"));
    assert!(sandbox.call(&invert("once.toml")).status.success());
    sandbox.write("twice.toml", &format!("{model}{play}{play}"));
    let line = model.lines().count() + 6;
    for call in [invert("twice.toml"), "table --model twice.toml -o table".to_owned()] {
        let said = sandbox.fail(&call, 1);
        let expected = format!("twice.toml:{line}: effect load_directed_backlash stands twice");
        assert!(said.contains(&expected) && said.contains("take one of the two out"), "{said}");
    }
    assert!(!sandbox.join("table/compensation.csv").exists());
}

#[test]
fn a_model_of_four_backbones_takes_no_log_of_three_anywhere() {
    let sandbox = learned();
    let four = sandbox.read("out/model.toml").replace("[robot]\n", "[robot]\nbackbones = 4\n");
    sandbox.write("four.toml", &four);
    sandbox.copy_bending(&[2]);
    let settings = sandbox.read("bending/experiment.toml");
    sandbox.write("bending/experiment.toml", &format!("model = \"../four.toml\"\n{settings}"));
    for call in [
        format!("estimate {} --model four.toml -o four", data("lab")),
        format!("evaluate {} --model four.toml", data("lab")),
        format!("discover {} --model four.toml -o four", data("lab")),
        "run bending -o four --overlays none".to_owned(),
        "live bending -o four".to_owned(),
        "check bending".to_owned(),
    ] {
        let said = all_said(&sandbox.call(&call));
        let expected = "encoders.csv:1: q1_mm to q3_mm, expected q1_mm to q4_mm: the robot has 4 backbones";
        assert!(said.contains(expected), "{call}: {said}");
    }
    assert!(!sandbox.join("four/model.toml").exists());
    // Beside a robot of three in the same experiment.
    let paper = Path::new(env!("CARGO_MANIFEST_DIR")).join("calib/robot.toml");
    fs::copy(paper, sandbox.join("bending/robot.toml")).unwrap();
    sandbox.write("bending/experiment.toml", &format!("robot = \"robot.toml\"\nmodel = \"../four.toml\"\n{settings}"));
    let said = sandbox.fail("run bending -o four --overlays none", 1);
    assert!(said.contains("`model` is of a robot of 4 backbones, and `robot` has 3"), "{said}");
    let said = sandbox.fail("invert --model four.toml --qc-mm=1,2,3", 2);
    assert!(said.contains("3 numbers, expected 4"), "{said}");
}

#[test]
fn commands_that_bend_nothing_and_angles_beyond_once_round_are_told() {
    let sandbox = learned();
    let calm = sandbox.json("invert --model out/model.toml --theta-deg 30 --delta-deg 45");
    let command: Vec<String> = (1..4).map(|i| number(&calm, &format!("qc{i}_mm")).to_string()).collect();
    let back = sandbox.call(&format!("invert --model out/model.toml --qc-mm={}", command.join(",")));
    assert!(
        !all_said(&back).contains("bend nothing") && !all_said(&back).contains("bends nothing"),
        "{}",
        all_said(&back)
    );
    let pushed = sandbox.call("invert --model out/model.toml --qc-mm=5,5,5");
    let said = all_said(&pushed);
    assert!(
        said.contains("up to 4.8") && said.contains("bend nothing") && said.contains(" N each. Commands"),
        "{said}"
    );
    let pushed = sandbox.json("invert --model out/model.toml --qc-mm=5,5,5");
    assert!((number(&pushed, "internal1_mm") - 4.8).abs() < 0.05, "{pushed:#}");
    for delta in ["1e18", "-361", "721"] {
        let said = sandbox.fail(&format!("invert --model out/model.toml --theta-deg 30 --delta-deg={delta}"), 1);
        assert!(said.contains("δ from −360° to 360°"), "{said}");
    }
    assert!(sandbox.call("invert --model out/model.toml --theta-deg 30 --delta-deg=-360").status.success());
}

#[test]
fn a_log_that_was_cut_within_its_last_number_loses_that_row_and_says_so() {
    let sandbox = learned();
    let log = sandbox.read("lab/encoders.csv");
    let last = log.lines().count();
    sandbox.write("lab/encoders.csv", &log.trim_end()[..log.trim_end().len() - 4]);
    let said = all_said(&sandbox.call(&format!("estimate {} -o cut", data("lab"))));
    assert!(said.contains(&format!("encoders.csv:{last}: the file was cut in the middle of this line")), "{said}");
    assert!(said.contains("1 skipped"), "{said}");
}
