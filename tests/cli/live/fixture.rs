//! A small rendered experiment along a closed path, and a running `live` to ask.

use crate::scenes::smaller;
use nalgebra::Vector2;
use serde_json::Value;
use snakeloop::geometry::Configuration;
use snakeloop::observation::{EncoderReading, Truth};
use snakeloop::record::{encoders_csv, write_atomically};
use snakeloop::robot::{Model, PerBackbone};
use snakeloop::simulate::scene::{Scene, Sensor};
use snakeloop::simulate::{FrameFormat, write_experiment};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::OnceLock;
use std::time::{Duration, Instant};

/// Frames of the path; it is closed, so that it can be gone round and round.
pub const FRAMES: u64 = 24;
pub const ETA: f64 = 1.221;
pub const LAMBDA_MM: f64 = 0.1765;

/// The robot with what is to be learned.
pub fn robot() -> Model {
    Model { eta: ETA, lambda_mm: LAMBDA_MM, samples: Some(0), ..Model::default() }
}

/// The path at a share of its round, from 0 to 1 and on.
pub fn path(share: f64) -> Configuration {
    let angle = share * std::f64::consts::TAU;
    Configuration::from_bend_vector(Vector2::new(0.55 + 0.35 * angle.cos(), 0.45 * angle.sin()))
}

/// What the encoders read there.
pub fn encoders(share: f64) -> PerBackbone {
    robot().command(path(share))
}

/// The rendered experiment, made once: half-size pictures, and a log by index.
pub fn experiment() -> &'static Path {
    static FOLDER: OnceLock<tempfile::TempDir> = OnceLock::new();
    FOLDER
        .get_or_init(|| {
            let folder = tempfile::tempdir().unwrap();
            let bends: Vec<Configuration> = (0..FRAMES).map(|index| path(index as f64 / FRAMES as f64)).collect();
            write(folder.path(), &robot(), &bends);
            folder
        })
        .path()
}

/// Renders an experiment of a robot that is seen in these bends, and commanded to them.
pub fn write(folder: &Path, robot: &Model, bends: &[Configuration]) {
    let truths = bends.iter().zip(0..).map(|(&configuration, index)| Truth { index, configuration });
    let truths: Vec<Truth> = truths.collect();
    let reading =
        |truth: &Truth| EncoderReading::new(truth.index, 0.1 * truth.index as f64, robot.command(truth.configuration));
    let readings: Vec<EncoderReading> = truths.iter().map(reading).collect();
    write_atomically(&folder.join("encoders.csv"), encoders_csv(&readings, 3).as_bytes()).unwrap();
    // With fewer rays the renderer errs by more than the eye's sigmas, and `discover` rightly finds it unexplained.
    let sensor = Sensor { rays_per_pixel: 8, blur_px: 0.5, noise: 1.0 };
    let scene = Scene { sensor, ..smaller(Scene::default(), 2) };
    write_experiment(folder, &scene, &truths, FrameFormat::Jpeg(92), 1, &|| ()).unwrap();
}

/// A running `snakeloop live` that serves at a port of its own; killed when dropped.
pub struct Live {
    child: Child,
    pub address: SocketAddr,
}

impl Live {
    /// Starts it on the experiment and waits until it serves.
    pub fn start(output: &Path, arguments: &[&str]) -> Self {
        Self::start_on(experiment(), output, arguments)
    }

    /// Starts it on another experiment.
    pub fn start_on(experiment: &Path, output: &Path, arguments: &[&str]) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_snakeloop"))
            .args(["live", experiment.to_str().unwrap(), "--serve", "127.0.0.1:0", "-o", output.to_str().unwrap()])
            .args(arguments)
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut said = String::new();
        let mut lines = BufReader::new(child.stderr.take().unwrap());
        let address = loop {
            let before = said.len();
            assert!(lines.read_line(&mut said).unwrap() > 0, "it ended: {said}");
            if let Some(address) = said[before..].trim().strip_prefix("dashboard: http://") {
                break address.trim_end_matches('/').parse().unwrap();
            }
        };
        // Whatever else it says goes where the test's own words go.
        std::thread::spawn(move || lines.lines().map_while(Result::ok).for_each(|line| eprintln!("live: {line}")));
        Self { child, address }
    }

    /// The status and body of an answer.
    pub fn ask(&self, method: &str, target: &str, headers: &str, body: &str) -> (u16, String) {
        let mut stream = TcpStream::connect(self.address).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        let length = body.len();
        let host = if headers.to_lowercase().contains("host:") { String::new() } else { "Host: localhost\r\n".into() };
        let request = format!(
            "{method} {target} HTTP/1.1\r\n{host}Connection: close\r\n{headers}Content-Length: {length}\r\n\r\n{body}"
        );
        stream.write_all(request.as_bytes()).unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        let (head, body) = answer.split_once("\r\n\r\n").unwrap_or((&answer, ""));
        let status = head.split(' ').nth(1).and_then(|code| code.parse().ok()).unwrap_or(0);
        (status, body.to_owned())
    }

    pub fn get(&self, target: &str) -> Value {
        let (status, body) = self.ask("GET", target, "", "");
        assert_eq!(status, 200, "{target}: {body}");
        serde_json::from_str(&body).unwrap_or_else(|e| panic!("{target}: {e}: {body}"))
    }

    /// Waits until the state is as wanted, and gives it.
    pub fn until(&self, what: &str, wanted: impl Fn(&Value) -> bool) -> Value {
        let deadline = Instant::now() + Duration::from_secs(60);
        loop {
            let state = self.get("/api/state");
            if wanted(&state) {
                return state;
            }
            assert!(Instant::now() < deadline, "not in a minute: {what}: {state:#}");
            std::thread::sleep(Duration::from_millis(30));
        }
    }

    /// Ends it the hard way.
    pub fn kill(&mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }

    /// Ends it as Ctrl-C does.
    pub fn finish(mut self) -> ExitStatus {
        let asked = Command::new("kill").args(["-INT", &self.child.id().to_string()]).status().unwrap();
        assert!(asked.success());
        self.child.wait().unwrap()
    }
}

impl Drop for Live {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// η and λ of a state are those of the robot.
pub fn assert_learned(state: &Value) {
    let figure = |name: &str| state["estimate"][name].as_f64().unwrap();
    assert!((figure("eta") - ETA).abs() < 0.06, "{state:#}");
    assert!((figure("lambda_mm") - LAMBDA_MM).abs() < 0.02, "{state:#}");
}
