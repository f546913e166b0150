//! Inputs as laboratories have them: each row is an experiment that is right and must be read as the plain one is, to the last figure, or one that
//! is wrong and must be told so, never *good*.

mod cameras;
mod frames;
mod logs;
mod recordings;
mod trackers;

use crate::program::{Sandbox, all_said, json};
use serde_json::Value;

/// What must come of an input.
pub enum Expected {
    /// All that `check` says of the plain experiment.
    Same,
    /// The level that the plain experiment has, with these words.
    Good(&'static str),
    /// Reasons that the plain experiment has not, or an error, with all of these words in what is said.
    Told(&'static [&'static str]),
}

/// An input: what is changed in the sandbox's folder `lab`, and what must come of it.
pub type Case = (&'static str, Box<dyn Fn(&Sandbox)>, Expected);

/// Holds `check` to every case; `plain` gives a sandbox with the experiment as it should be.
pub fn hold(plain: impl Fn() -> Sandbox, cases: Vec<Case>) {
    let as_it_should_be = checked(&plain());
    assert_ne!(as_it_should_be["verdict"]["level"], "do_not_use", "{as_it_should_be:#}");
    let mut missed = Vec::new();
    for (name, change, expected) in cases {
        let sandbox = plain();
        change(&sandbox);
        let output = sandbox.call("check lab --json");
        let said = all_said(&output);
        // Where the work could not begin there is no verdict.
        let found: Value = serde_json::from_slice(&output.stdout).unwrap_or_default();
        let is_as_it_should_be = found["verdict"]["level"] == as_it_should_be["verdict"]["level"];
        let holds = match expected {
            Expected::Same => figures(&found) == figures(&as_it_should_be),
            Expected::Good(words) => is_as_it_should_be && said.contains(words),
            Expected::Told(words) => {
                found["verdict"] != as_it_should_be["verdict"] && words.iter().all(|word| said.contains(word))
            }
        };
        if !holds || said.contains("panicked") {
            missed.push(format!("{name}: {said}"));
        }
    }
    assert!(missed.is_empty(), "{} cases:\n{}", missed.len(), missed.join("\n"));
}

/// What `check` finds, as JSON.
fn checked(sandbox: &Sandbox) -> Value {
    let output = sandbox.call("check lab --json");
    assert!(output.status.success(), "{}", all_said(&output));
    json(&String::from_utf8(output.stdout).unwrap())
}

/// The figures of a check: all but the names of files and how often the log has a row.
fn figures(check: &Value) -> (Value, Vec<Value>, Value) {
    let looks = check["looks"].as_array().into_iter().flatten();
    let figures = looks.filter(|look| !["files", "sizes", "clocks"].contains(&look["what"].as_str().unwrap()));
    (check["verdict"].clone(), figures.cloned().collect(), check["expected"].clone())
}

/// A case.
pub fn case(name: &'static str, change: impl Fn(&Sandbox) + 'static, expected: Expected) -> Case {
    (name, Box::new(change), expected)
}
