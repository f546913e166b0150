//! ROS 2 recordings as robots with several nodes, drivers and disks leave them.

use super::Expected::{Same, Told};
use super::{case, hold};
use crate::program::Sandbox;
use mcap::records::MessageHeader;
use snakeloop::bag::messages::JointState;
use snakeloop::record::{EncoderLog, Experiment};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

/// A message of the ride: its topic, the time of its header in ns, its type with its definition, and its bytes.
#[derive(Clone)]
struct Message {
    topic: String,
    time_ns: u64,
    kind: String,
    definition: Vec<u8>,
    cdr: Vec<u8>,
}

/// What the ride's recording holds of joints and poses.
fn ride() -> Vec<Message> {
    let bytes = fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/ride/ride.mcap")).unwrap();
    let messages = mcap::MessageStream::new(&bytes).unwrap().map(|message| message.unwrap());
    let of_topics = messages.filter(|message| ["/joint_states", "/tip"].contains(&message.channel.topic.as_str()));
    of_topics
        .map(|message| {
            let schema = message.channel.schema.clone().unwrap();
            let number = |at: usize| u64::from(u32::from_le_bytes(message.data[at..at + 4].try_into().unwrap()));
            Message {
                topic: message.channel.topic.clone(),
                time_ns: 1_000_000_000 * number(4) + number(8),
                kind: schema.name.clone(),
                definition: schema.data.to_vec(),
                cdr: message.data.to_vec(),
            }
        })
        .collect()
}

/// Writes messages as a recording.
fn write(path: &Path, messages: &[Message]) {
    write_with(mcap::WriteOptions::new(), path, messages);
}

fn write_with(options: mcap::WriteOptions, path: &Path, messages: &[Message]) {
    let mut writer = options.create(fs::File::create(path).unwrap()).unwrap();
    let mut channels = BTreeMap::new();
    for (sequence, message) in (0..).zip(messages) {
        let Message { topic, time_ns, kind, definition, cdr } = message;
        let channel = *channels.entry((topic.clone(), kind.clone())).or_insert_with(|| {
            let schema = writer.add_schema(kind, "ros2msg", definition).unwrap();
            writer.add_channel(schema, topic, "cdr", &BTreeMap::new()).unwrap()
        });
        let header = MessageHeader { channel_id: channel, sequence, log_time: *time_ns, publish_time: *time_ns };
        writer.write_to_known_channel(&header, cdr).unwrap();
    }
    writer.finish().unwrap();
}

fn is_joints(message: &Message) -> bool {
    message.topic == "/joint_states"
}

/// The joints of a message.
fn joints(message: &Message) -> (Vec<String>, Vec<f64>) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("one.mcap");
    write(&path, std::slice::from_ref(message));
    let settings = format!(
        "encoders = {{ bag = {path:?}, topic = \"/joint_states\", joints = [], mm_per_unit = 1.0 }}\n[[tracker]]\nname = \"a\"\nposes = \"a\"\nstraight = 0\n"
    );
    fs::write(folder.path().join("experiment.toml"), settings).unwrap();
    let Some(EncoderLog::Joints(topic)) = Experiment::read(folder.path()).unwrap().encoders else { panic!("a topic") };
    let state: JointState = topic.topic().first().unwrap();
    (state.names, state.positions)
}

/// A message of joints like another, with these joints at another time.
fn of_joints(like: &Message, time_ns: u64, names: &[&str], positions: &[f64]) -> Message {
    let names: Vec<String> = names.iter().map(|name| (*name).to_owned()).collect();
    Message { time_ns, cdr: JointState::encoded(time_ns, &names, positions), ..like.clone() }
}

/// The ride as a recording, `lab/run.mcap`, of which joints and poses are taken.
fn recorded() -> Sandbox {
    let sandbox = Sandbox::new();
    fs::create_dir(sandbox.join("lab")).unwrap();
    write(&sandbox.join("lab/run.mcap"), &ride());
    named(&sandbox, "\"run.mcap\"");
    sandbox
}

/// The experiment on a recording of this name.
fn named(sandbox: &Sandbox, bag: &str) {
    sandbox.write(
        "lab/experiment.toml",
        &format!(
            "encoders = {{ bag = {bag}, topic = \"/joint_states\", joints = [\"b1\", \"b2\", \"b3\"], mm_per_unit = 1000.0 }}\n\
             [[tracker]]\nname = \"em\"\nposes = {{ bag = {bag}, topic = \"/tip\" }}\nstraight = 0\n"
        ),
    );
}

/// The ride with other messages.
fn rewritten(change: impl Fn(Vec<Message>) -> Vec<Message> + 'static) -> impl Fn(&Sandbox) + 'static {
    move |sandbox| write(&sandbox.join("lab/run.mcap"), &change(ride()))
}

/// Each message of joints, and what another node sends beside it.
fn beside(other: impl Fn(&Message) -> Message + 'static) -> impl Fn(&Sandbox) + 'static {
    rewritten(move |messages| {
        let with = |message: Message| match is_joints(&message) {
            true => vec![other(&message), message],
            false => vec![message],
        };
        messages.into_iter().flat_map(with).collect()
    })
}

/// The ride in two files.
fn split(sandbox: &Sandbox, folder: &str) {
    let messages = ride();
    let (one, other) = messages.split_at(messages.len() / 2);
    fs::create_dir_all(sandbox.join(folder)).unwrap();
    write(&sandbox.join(&format!("{folder}/run_0.mcap")), one);
    write(&sandbox.join(&format!("{folder}/run_1.mcap")), other);
    fs::remove_file(sandbox.join("lab/run.mcap")).unwrap();
}

#[test]
fn a_recording_is_read_beside_what_else_is_in_it() {
    hold(
        recorded,
        vec![
            case(
                "a gripper of another node",
                beside(|message| of_joints(message, message.time_ns + 7, &["grip"], &[0.3])),
                Same,
            ),
            case(
                "another topic",
                rewritten(|messages| {
                    let rosout = Message {
                        topic: "/rosout".into(),
                        kind: "rcl_interfaces/msg/Log".into(),
                        ..messages[0].clone()
                    };
                    [vec![rosout], messages].concat()
                }),
                Same,
            ),
            case(
                "one message a joint",
                rewritten(|messages| {
                    let apart = |message: Message| {
                        if !is_joints(&message) {
                            return vec![message];
                        }
                        let (names, positions) = joints(&message);
                        let one = |(name, position): (&String, &f64)| {
                            of_joints(&message, message.time_ns, &[name], &[*position])
                        };
                        names.iter().zip(&positions).map(one).collect()
                    };
                    messages.into_iter().flat_map(apart).collect()
                }),
                Same,
            ),
            case("the same message twice", beside(Message::clone), Same),
            case(
                "a split recording, by its folder",
                |sandbox: &Sandbox| {
                    split(sandbox, "lab/run");
                    let metadata = "rosbag2_bagfile_information:\n  version: 9\n  storage_identifier: mcap\n  relative_file_paths:\n    - run_0.mcap\n    - run_1.mcap\n";
                    sandbox.write("lab/run/metadata.yaml", metadata);
                    named(sandbox, "\"run\"");
                },
                Same,
            ),
            case(
                "a split recording without metadata",
                |sandbox: &Sandbox| {
                    split(sandbox, "lab/run");
                    named(sandbox, "\"run\"");
                },
                Same,
            ),
            case(
                "a split recording, file by file",
                |sandbox: &Sandbox| {
                    split(sandbox, "lab");
                    named(sandbox, "[\"run_0.mcap\", \"run_1.mcap\"]");
                },
                Same,
            ),
            case(
                "messages that are cut",
                beside(|message| Message { cdr: message.cdr[..20].to_vec(), ..message.clone() }),
                Told(&["recording_damaged", "messages are passed over", "48 of 96 messages are passed over"]),
            ),
            case(
                "messages in bursts",
                rewritten(|messages| {
                    let mut kept = 0;
                    let burst = |message: &Message| {
                        kept += usize::from(is_joints(message));
                        !is_joints(message) || kept % 6 < 3
                    };
                    let mut burst = burst;
                    messages.into_iter().filter(|message| burst(message)).collect()
                }),
                Told(&["24 of 48 frames have no reading"]),
            ),
        ],
    );
}

#[test]
fn a_recording_that_cannot_be_meant_is_told() {
    let head = |bytes: &'static [u8]| move |sandbox: &Sandbox| fs::write(sandbox.join("lab/run.mcap"), bytes).unwrap();
    hold(
        recorded,
        vec![
            case(
                "two nodes that say other things of one moment",
                beside(|message| of_joints(message, message.time_ns, &["b1", "b2", "b3"], &[0.0; 3])),
                Told(&["contradictory_readings", "/joint_states has two different values", "nothing_to_judge"]),
            ),
            case(
                "stamps that are all zero",
                rewritten(|messages| {
                    let unset = |message: Message| match is_joints(&message) {
                        true => {
                            let (names, positions) = joints(&message);
                            let names: Vec<&str> = names.iter().map(String::as_str).collect();
                            of_joints(&message, 0, &names, &positions)
                        }
                        false => message,
                    };
                    messages.into_iter().map(unset).collect()
                }),
                Told(&["nothing_to_judge", "from 0.000 to 0.000 s (its driver does not set them)"]),
            ),
            case(
                "a recording that breaks off",
                |sandbox: &Sandbox| {
                    let bytes = fs::read(sandbox.join("lab/run.mcap")).unwrap();
                    fs::write(sandbox.join("lab/run.mcap"), &bytes[..bytes.len() - 300]).unwrap();
                },
                Told(&["recording_damaged", "the recording breaks off"]),
            ),
            case(
                "a byte in the middle of a recording that flipped",
                |sandbox: &Sandbox| {
                    let path = sandbox.join("lab/run.mcap");
                    write_with(mcap::WriteOptions::new().chunk_size(Some(1024)), &path, &ride());
                    let mut bytes = fs::read(&path).unwrap();
                    let middle = bytes.len() / 2;
                    bytes[middle] ^= 255;
                    fs::write(&path, bytes).unwrap();
                },
                Told(&["recording_damaged", "this message is lost: ", " messages were read"]),
            ),
            case("ROS 1", head(b"#ROSBAG V2.0\n"), Told(&["a recording of ROS 1", "rosbags-convert --src RUN.bag"])),
            case(
                "SQLite",
                head(b"SQLite format 3\0\x10\0\x01\x01"),
                Told(&["a recording in SQLite", "mcap convert RUN.db3 RUN.mcap"]),
            ),
            case("a table", head(b"index,time_s,q1_mm\n0,0,0\n0,0,0\n"), Told(&["no readable recording (MCAP)"])),
            case(
                "a folder that has no recording",
                |sandbox: &Sandbox| {
                    fs::create_dir(sandbox.join("lab/run")).unwrap();
                    named(sandbox, "\"run\"");
                },
                Told(&["a folder without metadata.yaml and *.mcap"]),
            ),
            case(
                "no such topic",
                |sandbox: &Sandbox| {
                    let settings = sandbox.read("lab/experiment.toml").replace("/joint_states", "/joints");
                    sandbox.write("lab/experiment.toml", &settings);
                },
                Told(&["topic /joints: no message", "/joint_states (sensor_msgs/msg/JointState)"]),
            ),
            case(
                "no such joint",
                |sandbox: &Sandbox| {
                    let settings = sandbox.read("lab/experiment.toml").replace("\"b3\"", "\"b4\"");
                    sandbox.write("lab/experiment.toml", &settings);
                },
                Told(&["no joint \\\"b4\\\"", "b1, b2, b3"]),
            ),
        ],
    );
}
