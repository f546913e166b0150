//! A recording read back by a reader of its own, after the MCAP specification.

use super::*;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
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
}

/// The messages of a recording: topic, time in ns, JSON; found by way of summary, chunk indexes and message indexes.
fn messages(recording: &[u8]) -> Vec<(String, u64, serde_json::Value)> {
    let (magic, end) = (b"\x89MCAP0\r\n", recording.len() - 8);
    assert!(recording.starts_with(magic) && recording.ends_with(magic));
    let (kind, mut footer) = Reader(&recording[end - 29..end]).record();
    assert_eq!(kind, 0x02);
    let summary = Reader(&recording[footer.number(8) as usize..end - 29]).records();
    let schemas: BTreeMap<u64, (String, serde_json::Value)> = of_kind(&summary, 0x03)
        .map(|mut schema| {
            let (number, name, encoding) = (schema.number(2), schema.text(), schema.text());
            assert_eq!(encoding, "jsonschema");
            (number, (name, serde_json::from_str(&schema.text()).unwrap()))
        })
        .collect();
    let channels: BTreeMap<u64, (String, &serde_json::Value)> = of_kind(&summary, 0x04)
        .map(|mut channel| {
            let (number, schema, topic) = (channel.number(2), channel.number(2), channel.text());
            assert_eq!(channel.text(), "json");
            let (name, schema) = &schemas[&schema];
            assert!(*name == format!("snakeloop{}", topic.replace('/', ".")) || name == "foxglove.CompressedImage");
            (number, (topic, schema))
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
                let (topic, schema) = &channels[&channel];
                let json: serde_json::Value = serde_json::from_slice(message.0).unwrap();
                for (field, value) in json.as_object().unwrap().iter().filter(|(_, value)| !value.is_object()) {
                    let kind = if value.is_string() { "string" } else { "number" };
                    assert_eq!(schema["properties"][field]["type"], kind, "{field}");
                }
                in_chunk.push((place, (topic.clone(), time, json)));
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
            "index,time_s,eta,lambda_mm,status,reason\n3,0.5000,,,skipped,too_few\n5,1.5,1.25,-0.0625,used,\n",
        ),
        ("log/encoders.csv", "\u{feff}index, time_s,\"q1_mm\"\r\n3,0.25,+1e-1\r\n5,1,two\r\n\r\n6,2.5,.5"),
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
    let picture = |sec: u64, nsec: u64, format: &str, bytes: &[u8]| {
        let timestamp = serde_json::json!({"sec": sec, "nsec": nsec});
        serde_json::json!({"timestamp": timestamp, "frame_id": "side", "format": format, "data": STANDARD.encode(bytes)})
    };
    let late = 1_700_000_000_062_500_000;
    let expected = [
        ("/encoders", 250_000_000, serde_json::json!({"index": 3, "time_s": 0.25, "q1_mm": 0.1})),
        ("/camera/side", 500_000_000, picture(0, 500_000_000, "png", PNG)),
        (
            "/measurement",
            500_000_000,
            serde_json::json!({"index": 3, "time_s": 0.5, "theta_deg": 30.25, "delta_deg": -170.0, "status": "ok"}),
        ),
        (
            "/estimate",
            500_000_000,
            serde_json::json!({"index": 3, "time_s": 0.5, "status": "skipped", "reason": "too_few"}),
        ),
        (
            "/estimate",
            1_500_000_000,
            serde_json::json!({"index": 5, "time_s": 1.5, "eta": 1.25, "lambda_mm": -0.0625, "status": "used"}),
        ),
        ("/encoders", 2_500_000_000, serde_json::json!({"index": 6, "time_s": 2.5, "q1_mm": 0.5})),
        ("/camera/side", late, picture(1_700_000_000, 62_500_000, "jpeg", JPEG)),
        ("/measurement", late, serde_json::json!({"index": 5, "time_s": 1_700_000_000.062_5, "status": "no_snake"})),
        (
            "/measurement",
            1_700_000_001_000_000_000,
            serde_json::json!({"index": 6, "time_s": 1_700_000_001, "theta_deg": 9, "delta_deg": 9, "status": "ok"}),
        ),
    ];
    let bytes = fs::read(&path).unwrap();
    assert_eq!(messages(&bytes), expected.map(|(topic, time, json)| (topic.to_owned(), time, json)));

    assert_eq!(recorded.messages["/camera/side"], 2);
    let remarks = recorded.remarks.join("\n");
    for expected in [
        "measurements.csv:3: time_s is empty",
        "log/encoders.csv:3: q1_mm is \"two\", expected a number; row left out",
        "/camera/side: 1 frames are gone, or neither PNG nor JPEG",
        "view top: ",
    ] {
        assert!(remarks.contains(expected), "{expected:?} in {remarks}");
    }
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
    assert!(found.iter().zip(0_u64..).all(|((_, time, json), k)| *time == k * 125_000_000 && json["index"] == k));
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
        ("index,time_s\n0,\n", "measurements.csv: no row has a time"),
        ("index,time_s\n0,-1\n0,1,2\n", "measurements.csv: no row has a time"),
        (&format!("index,time_s\n0,{}\n", "0".repeat(20_000)), "measurements.csv:2: the line is too long"),
    ] {
        fs::write(folder.path().join("measurements.csv"), table).unwrap();
        let said = refused();
        assert!(said.contains(expected), "{table:.60}: {said}");
    }
}
