//! A recording read back by a reader of its own, after the MCAP specification, its messages by the definitions that stand in it; and by
//! the reader of `bag`.

use super::*;
use crate::bag::Topic;
use crate::record::{JointTopic, read_encoders, read_joints};
use serde_json::{Value, json};
use std::fs;

/// A record: its kind, and what it holds.
type Record<'a> = (u8, Reader<'a>);

/// Takes a recording apart, as the specification describes it.
#[derive(Clone, Copy)]
struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    fn bytes(&mut self, count: u64) -> &'a [u8] {
        let (bytes, rest) = self.0.split_at(count as usize);
        self.0 = rest;
        bytes
    }

    fn number(&mut self, bytes: u64) -> u64 {
        self.bytes(bytes).iter().rev().fold(0, |number, &byte| number << 8 | u64::from(byte))
    }

    fn sized(&mut self) -> Reader<'a> {
        let length = self.number(4);
        Reader(self.bytes(length))
    }

    fn text(&mut self) -> String {
        String::from_utf8(self.sized().0.to_vec()).unwrap()
    }

    fn record(&mut self) -> Record<'a> {
        let (kind, length) = (self.number(1), self.number(8));
        (kind as u8, Reader(self.bytes(length)))
    }

    fn records(mut self) -> Vec<Record<'a>> {
        std::iter::from_fn(|| (!self.0.is_empty()).then(|| self.record())).collect()
    }

    /// A number of a message of so many bytes, aligned to its size.
    fn aligned(&mut self, message: usize, bytes: usize) -> u64 {
        let at = message - self.0.len();
        self.bytes((at.next_multiple_of(bytes) - at) as u64);
        self.number(bytes as u64)
    }

    /// The value of a type in a message of so many bytes; of a header its time in ns and its frame.
    fn value(&mut self, message: usize, kind: &str) -> Value {
        if let Some(kind) = kind.strip_suffix("[]") {
            let count = self.aligned(message, 4);
            return (0..count).map(|_| self.value(message, kind)).collect();
        }
        match kind {
            "uint8" => json!(self.number(1)),
            "uint64" => json!(self.aligned(message, 8)),
            // Of what is no number JSON says null.
            "float64" => json!(f64::from_bits(self.aligned(message, 8))),
            "string" => {
                let length = self.aligned(message, 4);
                let text = self.bytes(length).strip_suffix(&[0]).unwrap();
                json!(std::str::from_utf8(text).unwrap())
            }
            "std_msgs/Header" => {
                let (sec, nanosec) = (self.aligned(message, 4), self.aligned(message, 4));
                json!([sec * 1_000_000_000 + nanosec, self.value(message, "string")])
            }
            other => panic!("type {other}"),
        }
    }

    /// A message in CDR as its definition says.
    fn message(mut self, definition: &str) -> Value {
        assert_eq!(self.bytes(4), [0, 1, 0, 0]);
        let (separator, length) = ("=".repeat(80), self.0.len());
        let mut types = definition.split(&separator);
        let fields = types.next().unwrap().lines().map(|line| line.split_once(' ').unwrap());
        let message = fields.map(|(kind, name)| (name.to_owned(), self.value(length, kind))).collect();
        assert!(self.0.is_empty());
        assert_eq!(types.next(), Some("\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"));
        assert_eq!(types.next(), Some("\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"));
        Value::Object(message)
    }
}

/// The messages of a recording: topic, time in ns, type and fields; found by way of summary, chunk indexes and message indexes.
fn messages(recording: &[u8]) -> Vec<(String, u64, String, Value)> {
    let (magic, end) = (b"\x89MCAP0\r\n", recording.len() - 8);
    assert!(recording.starts_with(magic) && recording.ends_with(magic));
    let (kind, mut footer) = Reader(&recording[end - 29..end]).record();
    assert_eq!(kind, 0x02);
    let summary = Reader(&recording[footer.number(8) as usize..end - 29]).records();
    let schemas: BTreeMap<u64, (String, String)> = of_kind(&summary, 0x03)
        .map(|mut schema| {
            let (number, name, encoding) = (schema.number(2), schema.text(), schema.text());
            assert_eq!(encoding, "ros2msg");
            (number, (name, schema.text()))
        })
        .collect();
    let channels: BTreeMap<u64, (String, &(String, String))> = of_kind(&summary, 0x04)
        .map(|mut channel| {
            let (number, schema, topic) = (channel.number(2), channel.number(2), channel.text());
            assert_eq!(channel.text(), "cdr");
            (number, (topic, &schemas[&schema]))
        })
        .collect();
    let mut found = Vec::new();
    for mut index in of_kind(&summary, 0x08) {
        let (first, last, start, length) = (index.number(8), index.number(8), index.number(8), index.number(8));
        let chunk = &recording[start as usize..(start + length) as usize];
        let [(0x06, mut chunk)] = Reader(chunk).records()[..] else { panic!("one chunk") };
        assert_eq!((chunk.number(8), chunk.number(8), chunk.number(8)), (first, last, chunk.0.len() as u64 - 16));
        let (_checksum, compression) = (chunk.number(4), chunk.text());
        assert_eq!((compression.as_str(), chunk.number(8)), ("", chunk.0.len() as u64));
        let mut places = index.sized();
        let mut in_chunk = Vec::new();
        while !places.0.is_empty() {
            let (channel, place) = (places.number(2), places.number(8) as usize);
            let (kind, mut of_channel) = Reader(&recording[place..]).record();
            assert_eq!((kind, of_channel.number(2)), (0x07, channel));
            let mut entries = of_channel.sized();
            while !entries.0.is_empty() {
                let (time, place) = (entries.number(8), entries.number(8) as usize);
                let (kind, mut message) = Reader(&chunk.0[place..]).record();
                let (number, _rank) = (message.number(2), message.number(4));
                assert_eq!((kind, number, message.number(8), message.number(8)), (0x05, channel, time, time));
                assert!((first..=last).contains(&time));
                let (topic, (kind, definition)) = &channels[&channel];
                let fields = message.message(definition);
                assert_eq!(fields["header"][0], time);
                in_chunk.push((place, (topic.clone(), time, kind.clone(), fields)));
            }
        }
        assert_eq!(in_chunk.len(), of_kind(&Reader(chunk.0).records(), 0x05).count());
        in_chunk.sort_by_key(|(place, _)| *place);
        found.extend(in_chunk.into_iter().map(|(_, message)| message));
    }
    let mut statistics = of_kind(&summary, 0x0b).next().unwrap();
    assert_eq!(statistics.number(8), found.len() as u64);
    found
}

fn of_kind<'a>(records: &[Record<'a>], kind: u8) -> impl Iterator<Item = Reader<'a>> {
    records.iter().filter(move |record| record.0 == kind).map(|record| record.1)
}

/// A run of four frames with its experiment.
fn run(folder: &Path) -> Experiment {
    for place in ["frames", "log"] {
        fs::create_dir(folder.join(place)).unwrap();
    }
    for (name, text) in [
        (
            "measurements.csv",
            "index,time_s,theta_deg,delta_deg,status\n3,0.5,30.25,-170,ok\n4,,31,0,ok\n\
         5,1700000000.0625,,,no_snake\n6,1700000001,9,9,ok\n",
        ),
        (
            "estimate.csv",
            "index,time_s,eta,lambda_mm,status,reason,Note\n3,0.5000,,,skipped,too_few,a\n5,1.5,1.25,-0.0625,used,,b\n",
        ),
        (
            "log/encoders.csv",
            "\u{feff}index, time_s,\"q1_mm\",n1_q1_mm,grip\r\n3,0.25,+1e2,-2,9\r\n5,1,two,0,9\r\n\r\n6,2.5,.5,,9\r\n7,2.75,.5,1,9",
        ),
        ("frames/00006.tif", "II*\0"),
        (
            "experiment.toml",
            "encoders = 'log/encoders.csv'\n\
         [[view]]\nname = 'side'\ncamera = 'c.yaml'\nframes = 'frames/*'\nrig = 'rig.toml'\n\
         [[view]]\nname = 'top'\ncamera = 'c.yaml'\nframes = 'gone/*.png'\nrig = 'rig.toml'\n",
        ),
    ] {
        fs::write(folder.join(name), text).unwrap();
    }
    fs::write(folder.join("frames/00003.png"), PNG).unwrap();
    fs::write(folder.join("frames/00005.jpg"), JPEG).unwrap();
    Experiment::read(folder).unwrap()
}

/// How such files begin; the rest goes through as it is.
const PNG: &[u8] = b"\x89PNG\r\n\x1a\nthe rest";
const JPEG: &[u8] = b"\xff\xd8\xff\xe0the rest";

#[test]
fn a_recording_has_the_tables_the_encoders_and_the_frames_in_order_of_time() {
    let folder = tempfile::tempdir().unwrap();
    let experiment = run(folder.path());
    let path = folder.path().join("new/run.mcap");
    let recorded = write_recording(&path, folder.path(), Some(&experiment)).unwrap();
    let late = 1_700_000_000_062_500_000;
    let last = 1_700_000_001_000_000_000;
    let joints = |time: u64, positions: [f64; 2]| {
        let none: [f64; 0] = [];
        json!({"header": [time, ""], "name": ["q1", "n1_q1"], "position": positions, "velocity": none, "effort": none})
    };
    let picture = |time: u64, format, bytes| json!({"header": [time, "side"], "format": format, "data": bytes});
    let expected = [
        ("/encoders", 250_000_000, "sensor_msgs/msg/JointState", joints(250_000_000, [0.1, -0.002])),
        ("/camera/side/compressed", 500_000_000, "sensor_msgs/msg/CompressedImage", picture(500_000_000, "png", PNG)),
        (
            "/measurement",
            500_000_000,
            "snakeloop_msgs/msg/Measurement",
            json!({"header": [500_000_000, ""], "index": 3, "time_s": 0.5, "theta_deg": 30.25, "delta_deg": -170.0, "status": "ok"}),
        ),
        (
            "/estimate",
            500_000_000,
            "snakeloop_msgs/msg/Estimate",
            json!({"header": [500_000_000, ""], "index": 3, "time_s": 0.5, "eta": null, "lambda_mm": null, "status": "skipped", "reason": "too_few"}),
        ),
        (
            "/estimate",
            1_500_000_000,
            "snakeloop_msgs/msg/Estimate",
            json!({"header": [1_500_000_000, ""], "index": 5, "time_s": 1.5, "eta": 1.25, "lambda_mm": -0.0625, "status": "used", "reason": ""}),
        ),
        ("/encoders", 2_750_000_000, "sensor_msgs/msg/JointState", joints(2_750_000_000, [0.0005, 0.001])),
        ("/camera/side/compressed", late, "sensor_msgs/msg/CompressedImage", picture(late, "jpeg", JPEG)),
        (
            "/measurement",
            late,
            "snakeloop_msgs/msg/Measurement",
            json!({"header": [late, ""], "index": 5, "time_s": 1_700_000_000.062_5, "theta_deg": null, "delta_deg": null, "status": "no_snake"}),
        ),
        (
            "/measurement",
            last,
            "snakeloop_msgs/msg/Measurement",
            json!({"header": [last, ""], "index": 6, "time_s": 1_700_000_001.0, "theta_deg": 9.0, "delta_deg": 9.0, "status": "ok"}),
        ),
    ];
    let bytes = fs::read(&path).unwrap();
    let named =
        |(topic, time, kind, fields): (&str, u64, &str, Value)| (topic.to_owned(), time, kind.to_owned(), fields);
    assert_eq!(messages(&bytes), expected.map(named));

    assert_eq!(recorded.messages["/camera/side/compressed"], 2);
    let remarks = recorded.remarks.join("\n");
    for expected in [
        "measurements.csv:3: time_s is empty",
        "estimate.csv:1: column \"Note\" is no name of a field in ROS (a-z, 0-9, single _); left out",
        "log/encoders.csv:1: column \"grip\" is no reading in mm; left out",
        "log/encoders.csv:3: q1_mm is \"two\", expected a number; row left out",
        "log/encoders.csv:5: n1_q1_mm is empty, expected a number; row left out",
        "/camera/side/compressed: 1 frames are gone, or neither PNG nor JPEG",
        "view top: ",
    ] {
        assert!(remarks.contains(expected), "{expected:?} in {remarks}");
    }
}

#[test]
fn encoders_are_read_again_as_they_are_in_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let readings: String = (0..1000)
        .map(|k| format!("{k},{:.4},{:.6},-0.1,{k}.3\n", 0.0333 * f64::from(k), -0.001_237 * f64::from(k)))
        .collect();
    for (name, text) in [
        ("encoders.csv", "index,time_s,q1_mm,q2_mm,q3_mm\n".to_owned() + &readings),
        ("measurements.csv", "index,time_s,theta_deg,delta_deg,status\n0,0,1,2,ok\n".to_owned()),
    ] {
        fs::write(folder.path().join(name), text).unwrap();
    }
    let path = folder.path().join("run.mcap");
    write_recording(&path, folder.path(), None).unwrap();
    let joints: JointTopic = toml::from_str(&format!(
        "bag = {path:?}\ntopic = \"/encoders\"\njoints = [\"q1\", \"q2\", \"q3\"]\nmm_per_unit = 1000.0\n"
    ))
    .unwrap();
    let stamps_s: Vec<(u64, f64)> =
        (0..).zip(joints.topic().messages().unwrap().map(|message| message.unwrap().stamp_s().unwrap())).collect();
    let again = read_joints(&joints, &stamps_s, 3).unwrap().readings;
    let log = read_encoders(&folder.path().join("encoders.csv"), 3).unwrap().rows;
    assert_eq!(again.len(), log.len());
    for (read, written) in again.iter().zip(&log) {
        assert!(read.index == written.index && (read.time_s - written.time_s).abs() < 1e-9, "{read:?} {written:?}");
        // A length that went through metres is off by the last bit of a double at most.
        assert!(
            read.q_mm.iter().zip(written.q_mm.iter()).all(|(a, b)| (a - b).abs() <= f64::EPSILON * b.abs()),
            "{read:?} {written:?}"
        );
    }
}

#[test]
fn a_view_has_a_topic_that_ros_allows() {
    let folder = tempfile::tempdir().unwrap();
    run(folder.path());
    let settings = fs::read_to_string(folder.path().join("experiment.toml")).unwrap().replace("'side'", "'2nd-side'");
    fs::write(folder.path().join("experiment.toml"), settings).unwrap();
    let path = folder.path().join("run.mcap");
    write_recording(&path, folder.path(), Some(&Experiment::read(folder.path()).unwrap())).unwrap();
    let topic = Topic { bag: path.into(), topic: "/camera/view_2nd_side/compressed".to_owned() };
    assert_eq!(topic.count().unwrap(), 2);
}

#[test]
fn a_long_recording_has_several_chunks() {
    let folder = tempfile::tempdir().unwrap();
    let rows: String = (0..30_000).map(|k| format!("{k},{},{}.5,12,ok\n", f64::from(k) / 8.0, k % 90)).collect();
    let table = "index,time_s,theta_deg,delta_deg,status\n".to_owned() + &rows;
    fs::write(folder.path().join("measurements.csv"), table).unwrap();
    let path = folder.path().join("run.mcap");
    write_recording(&path, folder.path(), None).unwrap();
    let found = messages(&fs::read(&path).unwrap());
    assert_eq!(found.len(), 30_000);
    assert!(
        found.iter().zip(0_u64..).all(|((_, time, _, fields), k)| *time == k * 125_000_000 && fields["index"] == k)
    );
}

#[test]
fn what_cannot_be_recorded_leaves_no_file_and_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    let refused = || {
        let said = write_recording(&path, folder.path(), None).unwrap_err().to_string();
        assert!(fs::read_dir(folder.path()).unwrap().all(|e| e.unwrap().path().extension().unwrap() == "csv"));
        said
    };
    assert!(refused().contains("measurements.csv: cannot read"));
    for (table, expected) in [
        ("", "measurements.csv:1: column time_s is missing"),
        ("index,status\n0,ok\n", "measurements.csv:1: column time_s is missing"),
        ("index,time_s,time_s\n", "measurements.csv:1: column time_s is there twice"),
        ("time_s,status\n0,ok\n", "measurements.csv:1: column index is missing"),
        ("index,time_s\n0,2147483648\n", "measurements.csv: no row has a time"),
        ("index,time_s\n0,\n", "measurements.csv: no row has a time"),
        ("index,time_s\n0,-1\n0,1,2\n", "measurements.csv: no row has a time"),
        (&format!("index,time_s\n0,{}\n", "0".repeat(20_000)), "measurements.csv:2: the line is too long"),
    ] {
        fs::write(folder.path().join("measurements.csv"), table).unwrap();
        let said = refused();
        assert!(said.contains(expected), "{table:.60}: {said}");
    }
}
