//! A run as one recording (MCAP), to be looked at beside the robot's own in Foxglove and the like.
//!
//! | topic | one message |
//! | --- | --- |
//! | `/measurement`, `/estimate`, `/encoders`, `/stem`, `/force` | a row of measurements.csv, estimate.csv, encoders.csv, stem.csv, force.csv: the columns as fields, in their order; a field that is empty is left out |
//! | `/camera/NAME` | a frame of that view as it is on the disk (`foxglove.CompressedImage`) |
//!
//! Messages are JSON, their schemas JSON Schema, their times the rows' own `time_s`. All tables are gone through at once, row by row, so
//! that messages come in order of time and memory does not grow with the rows.

use super::columns::fields_of;
use super::mcap::Recorder;
use super::table::{Warning, Warnings};
use super::{Experiment, View};
use crate::camera::FrameSource;
use crate::error::{Error, Result};
use crate::input::{LINE_BYTES, PICTURE_BYTES, read_bytes, read_line};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use image::ImageFormat;
use serde::{Serialize, Serializer};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufReader;
use std::iter::Peekable;
use std::path::{Path, PathBuf};
use std::vec::IntoIter;

/// The tables that a run's folder may have, measurements first: to them frames belong.
const TABLES: [&str; 5] = ["measurement", "estimate", "encoders", "stem", "force"];

/// The columns that hold words; all others hold numbers.
const WORDS: [&str; 3] = ["status", "reason", "view"];

/// The part of Foxglove's schema that a frame needs.
const PICTURE_SCHEMA: &str = r#"{"title":"foxglove.CompressedImage","type":"object","properties":{"timestamp":{"type":"object","title":"time","properties":{"sec":{"type":"integer"},"nsec":{"type":"integer"}}},"frame_id":{"type":"string"},"format":{"type":"string"},"data":{"type":"string","contentEncoding":"base64"}}}"#;

/// What a recording holds.
#[derive(Debug, Default, Serialize)]
pub struct Recorded {
    /// How many messages each topic has.
    pub messages: BTreeMap<String, u64>,
    /// What was left out, and why.
    #[serde(skip)]
    pub remarks: Vec<String>,
}

/// Writes the run in a folder as an MCAP file: its tables, and with its experiment the encoder log (where the folder has none) and
/// those frames that are still there.
///
/// # Errors
/// A folder without measurements.csv, a table without a time column or with a line too long, rows that all lack their time; a file
/// that cannot be written.
pub fn write_recording(path: &Path, folder: &Path, experiment: Option<&Experiment>) -> Result<Recorded> {
    let mut recorder = Recorder::create(path)?;
    let mut recorded = Recorded::default();
    let paths: Vec<(&str, PathBuf)> =
        TABLES.iter().filter_map(|&name| Some((name, place(name, folder, experiment)?))).collect();
    let mut tables: Vec<Table> =
        paths.iter().map(|(name, path)| Table::open(name, path, &mut recorder)).collect::<Result<_>>()?;
    let mut cameras = Vec::new();
    for view in experiment.into_iter().flat_map(|experiment| &experiment.views) {
        match Camera::open(view, experiment.map_or(folder, Experiment::folder), &mut recorder)? {
            Ok(camera) => cameras.push(camera),
            Err(why) => recorded.remarks.push(format!("view {}: {why}; its frames are left out", view.name)),
        }
    }
    while let Some(first) = (0..tables.len()).filter(|&i| tables[i].next.is_some()).min_by_key(|&i| tables[i].time_ns())
    {
        let Some(row) = tables[first].take()? else { break };
        if let (0, Some(index)) = (first, row.index) {
            for camera in &mut cameras {
                camera.write(index, row.time_ns, &mut recorder)?;
            }
        }
        recorder.write(tables[first].channel, row.time_ns, &row.json)?;
    }
    for (topic, channel) in tables.iter().map(Table::topic).chain(cameras.iter().map(Camera::topic)) {
        recorded.messages.insert(topic, recorder.messages(channel));
    }
    if recorded.messages.values().all(|&messages| messages == 0) {
        let message = "no row has a time, by which a recording is ordered; measure with an encoder log, or a video";
        return Err(Error::content(&folder.join("measurements.csv"), message));
    }
    recorder.finish()?;
    for table in tables {
        recorded.remarks.extend(table.warnings.in_order().iter().map(Warning::to_string));
    }
    for camera in cameras.iter().filter(|camera| camera.missed > 0) {
        let (topic, _) = camera.topic();
        recorded.remarks.push(format!("{topic}: {} frames are gone, or neither PNG nor JPEG", camera.missed));
    }
    Ok(recorded)
}

/// Where a table stands; measurements must be there.
fn place(name: &str, folder: &Path, experiment: Option<&Experiment>) -> Option<PathBuf> {
    let plural = if name == "measurement" { "measurements" } else { name };
    let path = folder.join(format!("{plural}.csv"));
    let elsewhere = || experiment.and_then(|experiment| experiment.encoders.clone()).filter(|_| name == "encoders");
    if name == "measurement" || path.exists() { Some(path) } else { elsewhere() }
}

/// A table, gone through row by row; the next row is at hand.
struct Table<'a> {
    name: &'a str,
    channel: u16,
    path: &'a Path,
    lines: BufReader<File>,
    line: u64,
    columns: Vec<String>,
    next: Option<Row>,
    warnings: Warnings<'a>,
}

/// A row as a message.
struct Row {
    index: Option<u64>,
    time_ns: u64,
    json: Vec<u8>,
}

impl<'a> Table<'a> {
    fn open(name: &'a str, path: &'a Path, recorder: &mut Recorder) -> Result<Self> {
        let file = File::open(path).map_err(Error::io(path, "read"))?;
        let (lines, warnings) = (BufReader::new(file), Warnings::new(path));
        let mut table = Self { name, channel: 0, path, lines, line: 0, columns: Vec::new(), next: None, warnings };
        let header = table.next_line()?.unwrap_or_default();
        table.columns = fields_of(header.trim_start_matches('\u{feff}')).iter().map(str::to_owned).collect();
        let count = |name: &str| table.columns.iter().filter(|column| *column == name).count();
        if count("time_s") == 0 {
            return Err(Error::at_line(path, 1, "column time_s is missing; a recording is ordered by it"));
        }
        if let Some(twice) = table.columns.iter().find(|column| count(column) > 1) {
            return Err(Error::at_line(path, 1, format!("column {twice} is there twice; remove one")));
        }
        let kind = |column: &str| if WORDS.contains(&column) { "string" } else { "number" };
        let properties: Vec<String> = table
            .columns
            .iter()
            .map(|name| format!("{}:{{\"type\":\"{}\"}}", serde_json::Value::from(name.as_str()), kind(name)))
            .collect();
        let title = format!("snakeloop.{name}");
        let schema = format!(r#"{{"title":"{title}","type":"object","properties":{{{}}}}}"#, properties.join(","));
        table.channel = recorder.channel(&table.topic().0, &title, &schema)?;
        table.take()?;
        Ok(table)
    }

    /// The topic and its channel.
    fn topic(&self) -> (String, u16) {
        (format!("/{}", self.name), self.channel)
    }

    /// When the next row was.
    fn time_ns(&self) -> u64 {
        self.next.as_ref().map_or(u64::MAX, |row| row.time_ns)
    }

    /// Takes the row at hand and reads the one after; rows that make no sense are passed over and told.
    fn take(&mut self) -> Result<Option<Row>> {
        let taken = self.next.take();
        while let Some(line) = self.next_line()? {
            match self.row(&line) {
                _ if line.trim().is_empty() => {}
                Ok(row) => {
                    self.next = Some(row);
                    break;
                }
                Err(why) => self.warnings.push(self.line, format!("{why}; row left out")),
            }
        }
        Ok(taken)
    }

    fn next_line(&mut self) -> Result<Option<String>> {
        let mut text = Vec::new();
        self.line += 1;
        let read = read_line(&mut self.lines, LINE_BYTES, &mut text).map_err(Error::io(self.path, "read"))?;
        if read.length > LINE_BYTES as u64 {
            return Err(Error::at_line(self.path, self.line, "the line is too long for a row"));
        }
        Ok((read.length > 0).then(|| String::from_utf8_lossy(&text).into_owned()))
    }

    fn row(&self, line: &str) -> std::result::Result<Row, String> {
        let fields = fields_of(line);
        if fields.len() != self.columns.len() {
            return Err(format!("{} fields, expected {}", fields.len(), self.columns.len()));
        }
        let (mut index, mut time_ns, mut message) = (None, None, Vec::new());
        for (column, text) in self.columns.iter().map(String::as_str).zip(&fields) {
            if text.is_empty() {
                continue;
            }
            let field = if WORDS.contains(&column) { Field::Word(text) } else { Field::number(column, text)? };
            match (column, &field) {
                ("index", Field::Whole(number)) => index = Some(*number),
                ("time_s", field) => time_ns = Some(nanoseconds(field)?),
                _ => {}
            }
            message.push((column, field));
        }
        let time_ns = time_ns.ok_or("time_s is empty, and a recording is ordered by it")?;
        let json = serde_json::to_vec(&Message(message)).map_err(|e| e.to_string())?;
        Ok(Row { index, time_ns, json })
    }
}

/// A field of a message.
#[derive(Serialize)]
#[serde(untagged)]
enum Field<'a> {
    Whole(u64),
    Number(f64),
    Word(&'a str),
}

impl<'a> Field<'a> {
    fn number(column: &str, text: &'a str) -> std::result::Result<Self, String> {
        match (text.parse(), text.parse::<f64>()) {
            (Ok(whole), _) => Ok(Self::Whole(whole)),
            (_, Ok(number)) if number.is_finite() => Ok(Self::Number(number)),
            _ => Err(format!("{column} is {text:?}, expected a number")),
        }
    }
}

/// A time as MCAP has it. To the microsecond, for of today's time since 1970 a double holds no more.
fn nanoseconds(time_s: &Field) -> std::result::Result<u64, String> {
    let seconds = match *time_s {
        Field::Whole(whole) => whole as f64,
        Field::Number(number) => number,
        Field::Word(_) => f64::NAN,
    };
    // 2^64 ns are 584 years.
    if (0.0..1.8e10).contains(&seconds) {
        Ok((seconds * 1e6).round() as u64 * 1000)
    } else {
        Err(format!("time_s is {seconds}, expected 0 to 1.8e10"))
    }
}

/// A JSON object whose fields stand in order.
struct Message<'a>(Vec<(&'a str, Field<'a>)>);

impl Serialize for Message<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        serializer.collect_map(self.0.iter().map(|(column, field)| (column, field)))
    }
}

/// A view's frames, gone through in order of their index.
struct Camera<'a> {
    view: &'a str,
    channel: u16,
    files: Peekable<IntoIter<(u64, PathBuf)>>,
    missed: usize,
}

#[derive(Serialize)]
struct Picture<'a> {
    timestamp: Timestamp,
    frame_id: &'a str,
    format: &'a str,
    data: String,
}

#[derive(Serialize)]
struct Timestamp {
    sec: u64,
    nsec: u64,
}

impl<'a> Camera<'a> {
    /// A view's frames; in words, why there are none.
    fn open(view: &'a View, folder: &Path, recorder: &mut Recorder) -> Result<std::result::Result<Self, String>> {
        let files = match FrameSource::open(folder, &view.frames) {
            Ok(FrameSource::Pictures(files)) => files,
            Ok(FrameSource::Video(_)) | Err(Error::NoOpenCv { .. }) => {
                return Ok(Err("its frames are a video".to_owned()));
            }
            Err(error) => return Ok(Err(error.to_string())),
        };
        let files = files.into_iter().peekable();
        let mut camera = Self { view: &view.name, channel: 0, files, missed: 0 };
        camera.channel = recorder.channel(&camera.topic().0, "foxglove.CompressedImage", PICTURE_SCHEMA)?;
        Ok(Ok(camera))
    }

    /// The topic and its channel.
    fn topic(&self) -> (String, u16) {
        (format!("/camera/{}", self.view), self.channel)
    }

    /// Writes the frame of this index, where there is one that is still to come.
    fn write(&mut self, index: u64, time_ns: u64, recorder: &mut Recorder) -> Result<()> {
        while self.files.next_if(|(before, _)| *before < index).is_some() {}
        let Some((_, path)) = self.files.next_if(|(at, _)| *at == index) else { return Ok(()) };
        let bytes = read_bytes(&path, PICTURE_BYTES).unwrap_or_default();
        let format = match image::guess_format(&bytes) {
            Ok(ImageFormat::Png) => "png",
            Ok(ImageFormat::Jpeg) => "jpeg",
            _ => {
                self.missed += 1;
                return Ok(());
            }
        };
        let timestamp = Timestamp { sec: time_ns / 1_000_000_000, nsec: time_ns % 1_000_000_000 };
        let picture = Picture { timestamp, frame_id: self.view, format, data: STANDARD.encode(bytes) };
        let json = serde_json::to_vec(&picture).map_err(|e| Error::content(&path, e.to_string()))?;
        recorder.write(self.channel, time_ns, &json)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
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
            let (checksum, compression) = (chunk.number(4), chunk.text());
            assert_eq!((checksum, compression.as_str(), chunk.number(8)), (0, "", chunk.0.len() as u64));
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
            assert_eq!(in_chunk.len(), Reader(chunk.0).records().len());
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
            (
                "/measurement",
                late,
                serde_json::json!({"index": 5, "time_s": 1_700_000_000.062_5, "status": "no_snake"}),
            ),
            (
                "/measurement",
                1_700_000_001_000_000_000,
                serde_json::json!({"index": 6, "time_s": 1_700_000_001, "theta_deg": 9, "delta_deg": 9, "status": "ok"}),
            ),
        ];
        let bytes = fs::read(&path).unwrap();
        assert_eq!(messages(&bytes), expected.map(|(topic, time, json)| (topic.to_owned(), time, json)));
        // MCAP's own readers in Rust and Python found these messages in the golden file.
        assert!(bytes == fs::read("tests/golden/run.mcap").unwrap(), "not the golden file");

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
}
