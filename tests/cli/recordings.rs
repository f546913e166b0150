//! ROS 2 recordings and trackers in place of picture files: tests/golden/ride, written by the Python package rosbags.

use crate::program::{ETA, LAMBDA_MM, Sandbox, all_said, json, number};
use snakeloop::geometry::{Configuration, wrap_angle};
use snakeloop::observation::{Measurement, Status, TrackerPose};
use snakeloop::record::{EncoderLog, Experiment, Source, encoders_csv, read_joints, read_truth, tracker_poses_of};
use std::fs;
use std::path::Path;

const JOINTS: &str = "encoders = { bag = \"ride.mcap\", topic = \"/joint_states\", joints = [\"b1\", \"b2\", \"b3\"], mm_per_unit = 1000.0 }\n";

/// A sandbox with the ride, and an experiment.toml with these encoders and this view or tracker.
fn sandbox(encoders: &str, source: &str) -> Sandbox {
    let sandbox = Sandbox::new();
    fs::create_dir(sandbox.join("ride")).unwrap();
    for name in ["ride.mcap", "straight.jpg"] {
        fs::copy(golden().join(name), sandbox.join("ride").join(name)).unwrap();
    }
    sandbox.write("ride/experiment.toml", &format!("{encoders}{source}"));
    sandbox
}

fn golden() -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/ride")
}

fn truth() -> Vec<Configuration> {
    read_truth(&golden().join("truth.csv")).unwrap().rows.iter().map(|row| row.configuration).collect()
}

/// Root mean squares of θ and δ (of δ where θ ≥ 15°), degrees, and the largest error of θ in σ.
fn errors(measurements: &[Measurement], truth: impl Fn(u64) -> Option<Configuration>) -> (f64, f64, f64) {
    let pairs = measurements.iter().filter_map(|m| Some((m.measured?, truth(m.index)?)));
    let pairs: Vec<_> = pairs.collect();
    let rms = |squares: Vec<f64>| (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
    let of_theta = pairs.iter().map(|(m, psi)| (m.configuration.theta_deg() - psi.theta_deg()).powi(2)).collect();
    let bent = pairs.iter().filter(|(_, psi)| psi.theta_deg() >= 15.0);
    let of_delta = bent.map(|(m, psi)| wrap_angle(m.configuration.delta - psi.delta).to_degrees().powi(2));
    let in_sigma = pairs.iter().map(|(m, psi)| (m.configuration.theta - psi.theta).abs() / m.sigma_theta);
    (rms(of_theta), rms(of_delta.collect()), in_sigma.fold(0.0, f64::max))
}

/// Whether what a run says of η and λ is the hidden robot's, within three sigmas.
fn found_the_robot(run: &serde_json::Value) {
    for (name, hidden) in [("eta", ETA), ("lambda_mm", LAMBDA_MM)] {
        let (found, sd) = (number(run, name), number(run, &format!("sd_{name}")));
        assert!((found - hidden).abs() < 3.0 * sd && sd < 0.02, "{name}: {found} ± {sd}");
    }
}

#[test]
fn a_run_takes_frames_lens_and_joints_from_a_recording() {
    let sandbox = sandbox(
        JOINTS,
        "[[view]]\nname = \"side\"\ncamera = { bag = \"ride.mcap\", topic = \"/camera/camera_info\" }\n\
         frames = { bag = \"ride.mcap\", topic = \"/camera/image_raw/compressed\" }\n\
         straight = \"straight.jpg\"\ngrid_pitch_mm = 1.0\nstandoff_mm = 25.0\n",
    );
    let run = sandbox.json("run ride -o out");
    assert_eq!(run["verdict"]["level"], "good", "{run:#}");
    found_the_robot(&run);
    let measurements = sandbox.measurements("out/measurements.csv");
    let truth = truth();
    // Every sixth pose has a frame, from the fourth on.
    let (theta, delta, in_sigma) = errors(&measurements, |index| truth.get(6 * index as usize + 3).copied());
    assert_eq!(measurements.len(), 8);
    // In these small pictures σ of θ is 0.18° to 0.68°.
    assert!(theta < 0.3 && delta < 1.5 && in_sigma < 2.0, "{theta}° {delta}° {in_sigma}");
    assert!((measurements[0].time_s.unwrap() - 1.7e9 - 1.749).abs() < 1e-3, "the header's stamp");

    let settings = sandbox.read("ride/experiment.toml").replace("image_raw/compressed", "image_raw");
    sandbox.write("ride/experiment.toml", &settings);
    let message = sandbox.fail("run ride -o other", 1);
    assert!(message.contains("ride.mcap") && message.contains("/camera/image_raw/compressed"), "{message}");
}

/// The measurements of a run whose frames and encoders are those of an experiment that was exported are the experiment's own.
#[test]
fn a_run_on_what_was_exported_measures_the_same() {
    let sandbox = Sandbox::new();
    let bending = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/bending");
    sandbox.succeed(&format!("run {} -o folder --overlays none", bending.display()));
    sandbox.succeed(&format!("export folder --experiment {} -o again/run.mcap", bending.display()));
    for name in ["camera.yaml", "straight.jpg"] {
        fs::copy(bending.join(name), sandbox.join("again").join(name)).unwrap();
    }
    let frames = "frames = { bag = \"run.mcap\", topic = \"/camera/side/compressed\" }";
    let encoders = "encoders = { bag = \"run.mcap\", topic = \"/encoders\", joints = [\"q1\", \"q2\", \"q3\"], mm_per_unit = 1000.0 }";
    let settings = fs::read_to_string(bending.join("experiment.toml")).unwrap();
    let settings =
        settings.replace("frames = \"frames/*.jpg\"", frames).replace("encoders = \"encoders.csv\"", encoders);
    sandbox.write("again/experiment.toml", &settings);
    sandbox.succeed("run again -o bag --overlays none");

    // A frame's index is its number in the folder, and its position in the recording.
    let without_index = |path: &str| -> Vec<String> {
        sandbox.read(path).lines().map(|line| line.split_once(',').unwrap().1.to_owned()).collect()
    };
    for name in ["measurements.csv", "estimate.csv"] {
        let (folder, bag) = (without_index(&format!("folder/{name}")), without_index(&format!("bag/{name}")));
        assert!(folder.len() > 10 && folder == bag, "{name}: {folder:#?} {bag:#?}");
    }
}

const TRACKER: &str = "[[tracker]]\nname = \"em\"\nposes = \"tip.csv\"\nstraight = 0\n";

const TOPIC: &str = "[[tracker]]\nname = \"em\"\nposes = { bag = \"ride.mcap\", topic = \"/tip\" }\nstraight = 0\n";

/// A sandbox whose tracker is a file of the ride's poses, each as `change` leaves it (x, y, z in mm and w, x, y, z of its orientation), and
/// whose encoders are a file, too.
pub fn tracked(change: impl Fn(usize, &mut [f64; 7])) -> Sandbox {
    let sandbox = sandbox(JOINTS, TOPIC);
    let experiment = Experiment::read(&sandbox.join("ride")).unwrap();
    let (Source::Topic(topic), Some(EncoderLog::Joints(joints))) =
        (&experiment.trackers[0].poses, &experiment.encoders)
    else {
        panic!("both are topics")
    };
    let row = |(k, pose): (usize, &TrackerPose)| {
        let (at, q) = (pose.position_mm.unwrap(), pose.orientation.unwrap());
        let mut numbers = [at.x, at.y, at.z, q.w, q.i, q.j, q.k];
        change(k, &mut numbers);
        let numbers: Vec<String> = numbers.iter().map(|number| format!("{number:.6}")).collect();
        format!("{k},{:.4},{}\n", pose.time_s, numbers.join(","))
    };
    let rows: String = tracker_poses_of(topic).unwrap().rows.iter().enumerate().map(row).collect();
    sandbox.write("ride/tip.csv", &format!("index,time_s,x_mm,y_mm,z_mm,qw,qx,qy,qz\n{rows}"));
    let readings = read_joints(joints, &experiment.stamps_s().unwrap(), 3).unwrap().readings;
    sandbox.write("ride/encoders.csv", &encoders_csv(&readings, 3));
    sandbox.write("ride/experiment.toml", &format!("encoders = \"encoders.csv\"\n{TRACKER}"));
    sandbox
}

#[test]
fn a_tracker_is_measured_like_a_camera_and_check_predicts_what_it_teaches() {
    let sandbox = tracked(|_, _| ());
    let run = sandbox.json("run ride -o out");
    assert_eq!(run["verdict"]["level"], "good", "{run:#}");
    found_the_robot(&run);
    let truth = truth();
    let measurements = sandbox.measurements("out/measurements.csv");
    let (theta, delta, in_sigma) = errors(&measurements, |index| truth.get((index as usize).checked_sub(1)?).copied());
    assert!(theta < 0.25 && delta < 0.5 && in_sigma < 4.0, "{theta}° {delta}° {in_sigma}");

    let check = sandbox.json("check ride");
    assert_eq!(check["verdict"]["level"], "good", "{check:#}");
    for name in ["sd_eta", "sd_lambda_mm"] {
        let ratio = number(&check["expected"], name) / number(&run, name);
        assert!((0.5..2.0).contains(&ratio), "{name}: {ratio} of the run's");
    }
    assert!(check["looks"].to_string().contains("em: registered from 49 poses"), "{check:#}");

    // The same poses as a topic of the recording: times and numbers differ by what the file rounds.
    sandbox.write("ride/experiment.toml", &format!("{JOINTS}{TOPIC}"));
    let eta = number(&sandbox.json("run ride -o bag"), "eta");
    assert!((eta - number(&run, "eta")).abs() < 1e-4, "{eta}");
}

#[test]
fn gaps_and_jumps_of_a_tracker_cost_their_poses_alone() {
    let sandbox = tracked(|k, pose| match k {
        12 => pose[1] += 30.0,
        20 => pose[3..].iter_mut().for_each(|q| *q *= 1.3),
        _ => (),
    });
    let lost = |row: &str| match row.strip_prefix("7,") {
        Some(rest) => format!("7,{},NaN,,,,,,\n", rest.split(',').next().unwrap()),
        None => format!("{row}\n"),
    };
    sandbox.write("ride/tip.csv", &sandbox.read("ride/tip.csv").lines().map(lost).collect::<String>());
    let output = sandbox.call("run ride -o out --json");
    assert!(output.status.success(), "{}", all_said(&output));
    assert!(all_said(&output).contains("tip.csv:22: qw,qx,qy,qz: length 1.300"), "{}", all_said(&output));
    let rows = sandbox.measurements("out/measurements.csv");
    let unmeasured: Vec<(u64, String)> =
        rows.iter().filter(|m| m.status != Status::Ok).map(|m| (m.index, m.status.to_string())).collect();
    assert_eq!(unmeasured, [(7, "tracker_lost".to_owned()), (12, "tracker_jump".to_owned())]);
    assert_eq!(rows.len(), 48, "49 poses less the row that was passed over");
    found_the_robot(&json(&String::from_utf8(output.stdout).unwrap()));
}

#[test]
fn a_tracker_in_another_unit_or_frame_is_told_so() {
    type Change = fn(usize, &mut [f64; 7]);
    let cases: [(Change, &str); 4] = [
        (|_, pose| pose[..3].iter_mut().for_each(|x| *x /= 1000.0), "look as if in metres; write them in mm"),
        (|_, pose| pose[..3].iter_mut().for_each(|x| *x *= 10.0), "check the unit"),
        (|_, pose| pose[1] = -pose[1], "unless the y axis of the positions is turned round; change its sign"),
        (|_, pose| pose[3..].rotate_left(1), "the order of quaternions (qw,qx,qy,qz)"),
    ];
    for (change, expected) in cases {
        let sandbox = tracked(change);
        let output = sandbox.call("run ride -o out");
        let said = all_said(&output);
        assert_eq!(output.status.code(), Some(1), "{said}");
        assert!(said.contains("tip.csv") && said.contains(expected), "{expected:?} is not in {said}");
        let check = sandbox.call("check ride --json");
        assert!(check.status.code() == Some(1) && all_said(&check).contains(expected), "{}", all_said(&check));
    }
}
