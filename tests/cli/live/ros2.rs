//! A laboratory's ROS 2: another DDS implementation (the Python package cyclonedds, which brings its own library) plays camera and joints
//! on the loopback, and reads what is published.

use super::fixture::Live;
use crate::program::{Sandbox, number};
use serde_json::Value;
use std::fs;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU16, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, Instant};

/// ros2.py with these arguments, by the Python that SNAKELOOP_PYTHON names (python3 else).
fn script(arguments: &[&str]) -> Command {
    let python = std::env::var("SNAKELOOP_PYTHON").unwrap_or_else(|_| "python3".into());
    let mut command = Command::new(python);
    command.arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/cli/live/ros2.py")).args(arguments);
    command
}

/// Whether the other implementation is there; says so where it is not.
fn is_there() -> bool {
    let has_package = || script(&["--check"]).stderr(Stdio::null()).status().is_ok_and(|status| status.success());
    let found = cfg!(feature = "ros2") && has_package();
    if !found {
        println!(
            "NOT CHECKED: ROS 2; it needs --features ros2 and the Python package cyclonedds (pip install cyclonedds pillow)"
        );
    }
    found
}

/// A domain that no other test uses.
fn domain() -> String {
    static NEXT: AtomicU16 = AtomicU16::new(0);
    let of_process = std::process::id() as u16 % 12;
    (100 + 10 * of_process + NEXT.fetch_add(1, Ordering::Relaxed) % 10).to_string()
}

/// A program of the laboratory, ended when dropped.
struct Node(Child);

impl Node {
    fn start(arguments: &[&str]) -> Self {
        Self(script(arguments).stdout(Stdio::piped()).spawn().unwrap())
    }

    /// Waits for its next line.
    fn line(&mut self) -> String {
        let mut line = String::new();
        BufReader::new(self.0.stdout.as_mut().unwrap()).read_line(&mut line).unwrap();
        line.trim().to_owned()
    }
}

impl Drop for Node {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// What is published, as it comes.
struct Listener {
    _node: Node,
    heard: Arc<Mutex<Vec<Value>>>,
}

impl Listener {
    fn start(domain: &str) -> Self {
        let mut node = Node::start(&["listen", domain]);
        let lines = BufReader::new(node.0.stdout.take().unwrap()).lines();
        let heard = Arc::new(Mutex::new(Vec::new()));
        let theirs = Arc::clone(&heard);
        std::thread::spawn(move || {
            for line in lines.map_while(Result::ok) {
                theirs.lock().unwrap().push(serde_json::from_str::<Value>(&line).unwrap());
            }
        });
        let listener = Self { _node: node, heard };
        listener.until("ready", |heard| heard.iter().any(|message| message["topic"] == "ready"));
        listener
    }

    fn heard(&self) -> MutexGuard<'_, Vec<Value>> {
        self.heard.lock().unwrap()
    }

    /// What came on a topic.
    fn of(&self, topic: &str) -> Vec<Value> {
        self.heard().iter().filter(|message| message["topic"] == topic).cloned().collect()
    }

    fn until(&self, what: &str, wanted: impl Fn(&[Value]) -> bool) {
        let deadline = Instant::now() + Duration::from_secs(60);
        while !wanted(&self.heard()) {
            assert!(Instant::now() < deadline, "not in a minute: {what}: {:?}", self.heard());
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

const TOPICS: [&str; 9] = [
    "--ros2",
    "--image-topic",
    "/camera/image_raw",
    "--joint-topic",
    "/joint_states",
    "--joints",
    "b1,b2,b3",
    "--mm-per-unit",
    "1",
];

/// The experiment that is played.
fn bending() -> &'static str {
    concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/bending")
}

fn live(output: &Path, domain: &str, more: &[&str]) -> Live {
    let arguments = [&TOPICS[..], &["--domain", domain], more].concat();
    Live::start_on(Path::new(bending()), output, &arguments)
}

/// The numbers of a learned model.
fn learned(output: &Path) -> [f64; 2] {
    let model = snakeloop::record::read_model(&output.join("model.toml")).unwrap().estimate().unwrap();
    [model.eta, model.lambda_mm]
}

fn frames() -> u64 {
    fs::read_dir(Path::new(bending()).join("frames")).unwrap().count() as u64
}

/// Time between two pictures, s: long enough that none is dropped on a machine that does other things beside.
const PERIOD: &str = "period=1.0";

/// `cargo test --features ros2 --test cli live::ros2 -- --ignored`
#[test]
#[ignore = "needs the Python package cyclonedds; tools/test runs it where that is"]
fn eta_and_lambda_are_those_of_the_folder_to_the_last_digit() {
    if !is_there() {
        return;
    }
    let sandbox = Sandbox::new();
    let (folder, out) = (sandbox.join("folder"), sandbox.join("out"));
    let by_folder = sandbox.json(&format!("live {} --rate 1 -o folder", bending()));
    assert_eq!((number(&by_folder, "dropped"), number(&by_folder, "measured")), (0.0, frames() as f64));
    let domain = domain();
    let listener = Listener::start(&domain);
    let live = live(&out, &domain, &[]);
    let mut player = Node::start(&["play", &domain, bending(), PERIOD, "stay=1"]);
    assert_eq!(player.line(), "done");
    let state = live.until("all frames", |state| state["measured"] == frames());
    assert_eq!((&state["source"]["dropped"], &state["encoders"]["clock"]), (&0.into(), &"shared".into()), "{state:#}");
    // What is asked for is what the table says.
    let mut asked = Node::start(&["ask", &domain, "0.5", "0.3"]);
    let answer: Value = serde_json::from_str(&asked.line()).unwrap();
    let [x, y] = [0.5f64, 0.3];
    let (theta, delta) = (x.hypot(y).to_degrees(), y.atan2(x).to_degrees());
    let table = live.get(&format!("/api/table?theta={theta}&delta={delta}"));
    for i in 0..3 {
        let close = |name: &str, key: &str| (number(&answer, name) - table[key][i].as_f64().unwrap()).abs() < 1e-9;
        assert!(close(&format!("q_command{}_mm", i + 1), "q_command_mm"), "{answer} {table}");
        assert!(close(&format!("sd_q_command{}_mm", i + 1), "sd_q_command_mm"), "{answer} {table}");
    }
    assert_eq!(number(&answer, "extrapolated"), table["extrapolated"].as_f64().unwrap());
    assert!(live.finish().success());
    assert_eq!(learned(&out), learned(&folder));

    let estimates = listener.of("estimate");
    // To the last digit that the parser of JSON keeps.
    for (place, expected) in learned(&folder).into_iter().enumerate() {
        let published = estimates.last().unwrap()["data"][place].as_f64().unwrap();
        assert!((published - expected).abs() <= 2.0 * f64::EPSILON * expected.abs(), "{expected}: {estimates:?}");
    }
    assert_eq!(estimates[0]["label"], "eta,lambda_mm,sd_eta,sd_lambda_mm");
    // Every bend, by its picture's time.
    let rows = sandbox.measurements("out/measurements.csv");
    let bends = listener.of("bend");
    assert_eq!((rows.len(), bends.len() as u64), (bends.len(), frames()));
    for (row, bend) in rows.iter().zip(&bends) {
        let measured = row.measured.unwrap();
        let vector: Vec<f64> = bend["vector"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
        let expected = measured.configuration.bend_vector();
        assert!((vector[0] - expected.x).abs() < 1e-6 && (vector[1] - expected.y).abs() < 1e-6, "{bend} {row:?}");
        assert!(vector[2] >= measured.sigma_theta - 1e-6, "{bend} {row:?}");
        let stamp_s = bend["stamp"]["sec"].as_f64().unwrap() + 1e-9 * bend["stamp"]["nanosec"].as_f64().unwrap();
        assert!((stamp_s - row.time_s.unwrap()).abs() < 1e-3, "{bend} {row:?}");
    }
    assert!(listener.of("overlay").iter().any(|overlay| overlay["jpeg"] == "ffd8ff"));
    // Nothing before the first verdict.
    let heard = listener.heard();
    let place = |wanted: &dyn Fn(&Value) -> bool| heard.iter().position(wanted);
    let first_estimate = place(&|message| message["topic"] == "estimate").unwrap();
    assert!(place(&|message| message["level"] == 3).unwrap() < first_estimate, "{heard:?}");
    assert!(place(&|message| message["topic"] == "bend").unwrap() < first_estimate);
}

/// `cargo test --features ros2 --test cli live::ros2 -- --ignored`
#[test]
#[ignore = "needs the Python package cyclonedds; tools/test runs it where that is"]
fn raw_pictures_joints_apart_and_the_cameras_own_lens_and_clock() {
    if !is_there() {
        return;
    }
    let (sandbox, domain) = (Sandbox::new(), domain());
    sandbox.copy_bending(&[]);
    let named = sandbox.read("bending/experiment.toml");
    sandbox.write("bending/experiment.toml", &named.replace("camera = \"camera.yaml\"\n", ""));
    // A laboratory that runs already: joints of a message each, by a clock a million seconds behind, everything twice, every fifth picture lost.
    let options =
        ["encoding=rgb8", "period=0.7", "rounds=9", "info=1", "apart=1", "offset=-1000000", "repeat=1", "drop=5"];
    let player = Node::start(&[&["play", &domain, bending(), "blind=1", "qos=sensor"][..], &options].concat());
    let arguments = [&TOPICS[..], &["--domain", &domain]].concat();
    let live = Live::start_on(&sandbox.join("bending"), &sandbox.join("out"), &arguments);
    let state = live.until("some frames", |state| state["measured"].as_u64() > Some(frames()));
    let notices = state["notices"].to_string();
    assert!(notices.contains("s behind this machine's clock"), "{state:#}");
    assert!(notices.contains("as when one is sent twice"), "{state:#}");
    // Nothing was learned from another moment's reading.
    let estimate = &state["estimate"];
    assert!((number(estimate, "eta") - 1.221).abs() < 0.02, "{state:#}");
    assert!((number(estimate, "lambda_mm") - 0.1765).abs() < 0.01, "{state:#}");
    drop(player);
    live.until("the loss", |state| state["source"]["state"] == "lost" && state["encoders"]["state"] == "lost");
    // It is started anew, and another listener comes late.
    let options = ["encoding=rgb8", "period=0.7", "rounds=3", "offset=-1000000", "blind=1"];
    let _again = Node::start(&[&["play", &domain, bending()][..], &options].concat());
    live.until("its return", |state| state["source"]["state"] == "running" && state["encoders"]["state"] == "running");
    let before = state["measured"].as_u64();
    live.until("more", |state| state["measured"].as_u64() > before.map(|before| before + 3));
    let late = Listener::start(&domain);
    late.until("an estimate for who comes late", |heard| heard.iter().any(|message| message["topic"] == "estimate"));
    let state = live.get("/api/state");
    assert!(!state["notices"].to_string().contains("two publishers"), "{state:#}");
    assert!(live.finish().success());
}

/// `cargo test --features ros2 --test cli live::ros2 -- --ignored`
#[test]
#[ignore = "needs the Python package cyclonedds; tools/test runs it where that is"]
fn strangers_contradictions_and_second_publishers_are_told_and_nothing_is_learned_from_them() {
    if !is_there() {
        return;
    }
    let (sandbox, domain) = (Sandbox::new(), domain());
    let listener = Listener::start(&domain);
    let live = live(&sandbox.join("out"), &domain, &[]);
    let text_node = Node::start(&["strange", &domain, "text"]);
    live.until("a text", |state| {
        state["notices"]
            .to_string()
            .contains("/camera/image_raw is published as std_msgs/String, expected sensor_msgs/Image")
    });
    drop(text_node);
    // The pictures, then garbage of the right type beside them, and a joint that says two things.
    let mut first =
        Node::start(&["play", &domain, bending(), "period=0.5", "rounds=4", "encoding=mono8", "joint_faults=1"]);
    live.until("three measurements", |state| state["measured"].as_u64() > Some(2));
    let garbage = Node::start(&["strange", &domain, "garbage"]);
    let state = live.until("both are told", |state| {
        let notices = state["notices"].to_string();
        notices.contains("/camera/image_raw has two publishers")
            && notices.contains("/joint_states says two things of joint")
    });
    assert_eq!(state["latest"]["status"], "ok", "{state:#}");
    // Every reading was contradicted, so that nothing was learned, and nothing is answered.
    let state = live.until("the first verdict", |state| {
        state["verdict"]["level"] == "do_not_use" || state["measured"].as_u64() > Some(12)
    });
    let mut asked = Node::start(&["ask", &domain, "0.5", "0.3"]);
    let answer = asked.line();
    let (status, body) = live.ask("GET", "/api/table?theta=30&delta=30", "", "");
    assert_eq!((status == 200, answer == "null"), (false, true), "{answer} {status} {body} {state:#}");
    assert!(listener.of("estimate").is_empty(), "{:?}", listener.of("estimate"));
    assert!(listener.of("diagnostics").iter().all(|message| message["level"] != 0));
    drop(garbage);
    first.0.kill().unwrap();
    assert!(live.finish().success());
}

/// Without ROS 2, as without the topics' nodes, the call says what to do.
#[test]
fn a_call_that_cannot_work_is_told() {
    let sandbox = Sandbox::new();
    let call = |more: &str| sandbox.fail(&format!("live {} -o out {more}", bending()), 2);
    assert!(call("--image-topic /image").contains("--ros2"));
    assert!(call("--ros2 --joint-topic /joints").contains("--joints"));
    assert!(call("--ros2 --domain 233").contains("232"));
    let (built, expected) = match cfg!(feature = "ros2") {
        true => ("--ros2 --joint-topic /joints --joints b1,b2", "--joints b1,b2: expected 3, one for each backbone"),
        false => ("--ros2", "this build has no ROS 2: build with --features ros2"),
    };
    let said = call(built);
    assert!(said.contains(expected), "{said}");
}
