//! Calls the program as a user does, in a temporary folder, and reads its exit code, its words and its files.

use serde_json::Value;
use snakeloop::observation::Measurement;
use snakeloop::record::read_measurements;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// η and λ (mm) of the simulated robots: the paper's Table III, last row.
pub const ETA: f64 = 1.221;
pub const LAMBDA_MM: f64 = 0.1765;

/// A temporary folder in which the program is called. Relative paths in the arguments are paths in it.
pub struct Sandbox {
    folder: tempfile::TempDir,
}

impl Sandbox {
    pub fn new() -> Self {
        Self { folder: tempfile::tempdir().unwrap() }
    }

    pub fn path(&self) -> &Path {
        self.folder.path()
    }

    /// The path of a file in the folder.
    pub fn join(&self, name: &str) -> PathBuf {
        self.path().join(name)
    }

    pub fn write(&self, name: &str, content: &str) {
        fs::write(self.join(name), content).unwrap();
    }

    pub fn read(&self, name: &str) -> String {
        fs::read_to_string(self.join(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
    }

    /// Number of lines of a table, without its header.
    pub fn rows(&self, name: &str) -> usize {
        self.read(name).lines().count() - 1
    }

    pub fn measurements(&self, name: &str) -> Vec<Measurement> {
        let table = read_measurements(&self.join(name)).unwrap();
        assert!(table.warnings.is_empty(), "{name}: {:?}", table.warnings);
        table.rows
    }

    /// The program with the arguments of this line, which are separated by spaces.
    pub fn command(&self, line: &str) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_snakeloop"));
        // One date for all results, so that the bytes of two runs compare.
        command.current_dir(self.path()).args(line.split_whitespace()).env("SOURCE_DATE_EPOCH", "1795660528");
        command
    }

    pub fn call(&self, line: &str) -> Output {
        self.command(line).output().unwrap()
    }

    /// Runs a command that must succeed and gives its standard output.
    pub fn succeed(&self, line: &str) -> String {
        let output = self.call(line);
        assert!(output.status.success(), "{line}: {}", all_said(&output));
        String::from_utf8(output.stdout).unwrap()
    }

    /// Runs a command that must succeed and gives what it prints with `--json`.
    pub fn json(&self, line: &str) -> Value {
        json(&self.succeed(&format!("{line} --json")))
    }

    /// Runs a command that must end with this exit code, and gives its standard error.
    pub fn fail(&self, line: &str, exit_code: i32) -> String {
        let output = self.call(line);
        let message = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(exit_code), "{line}: {message}");
        assert!(!message.contains("panicked"), "{line}: {message}");
        message
    }

    /// Simulates an experiment without pictures into the folder `out`: encoders, truth, and measurements with noise.
    pub fn simulate(&self, out: &str, more: &str) {
        self.succeed(&format!("simulate --observe --quiet -o {out} {more}"));
    }

    /// Writes the model `hidden.toml`: the paper's robot with the η and λ above, known exactly.
    pub fn write_hidden_model(&self) {
        self.write("hidden.toml", &known_estimate());
    }

    /// A copy of the bundled experiment, `bending`, with these of its frames.
    pub fn copy_bending(&self, frames: &[u64]) {
        let bundled = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/bending");
        fs::create_dir_all(self.join("bending/frames")).unwrap();
        let names = ["experiment.toml", "camera.yaml", "encoders.csv", "truth.csv", "straight.jpg"].map(str::to_owned);
        for name in names.into_iter().chain(frames.iter().map(|index| format!("frames/{index:05}.jpg"))) {
            fs::copy(bundled.join(&name), self.join("bending").join(&name)).unwrap();
        }
    }
}

/// Text that must be JSON.
pub fn json(text: &str) -> Value {
    serde_json::from_str(text).unwrap_or_else(|e| panic!("{e}: {text}"))
}

/// A member that must be a number.
pub fn number(value: &Value, key: &str) -> f64 {
    value[key].as_f64().unwrap_or_else(|| panic!("{key} is no number: {value:#}"))
}

/// The arguments that name the tables of an experiment in this folder.
pub fn data(folder: &str) -> String {
    format!("--measurements {folder}/measurements.csv --encoders {folder}/encoders.csv")
}

/// The table `[estimate]` of a model whose η and λ are known exactly.
pub fn known_estimate() -> String {
    format!(
        "[estimate]\neta = {ETA}\nsd_eta = 0.0\nlambda_mm = {LAMBDA_MM}\nsd_lambda_mm = 0.0\ncorrelation = 0.0\nsamples = 0\n"
    )
}

/// Standard output and standard error.
pub fn all_said(output: &Output) -> String {
    String::from_utf8_lossy(&[&output.stdout[..], &output.stderr[..]].concat()).into_owned()
}

pub fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}
