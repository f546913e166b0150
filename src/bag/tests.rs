use super::messages::{CameraInfo, CompressedImage, JointState, StampedPose};
use super::*;
use std::fs;
use std::io::Cursor;

/// Written by the Python package rosbags: tests/golden/ros2.py.
const GOLDEN: &str = "tests/golden/ros2.mcap";

fn topic(bag: &Path, topic: &str) -> Topic {
    Topic { bag: bag.to_owned().into(), topic: topic.to_owned() }
}

#[test]
fn messages_of_another_program_are_read_with_their_times() {
    let states: Vec<JointState> = topic(Path::new(GOLDEN), "/joint_states").all().unwrap().0;
    assert_eq!(
        states.iter().map(|state| state.stamp_s - 1.7e9).map(|s| (10.0 * s).round()).collect::<Vec<_>>(),
        [0.0, 2.0, 4.0, 6.0]
    );
    assert_eq!(states[2].names, ["b3", "b1", "b2", "grip"]);
    assert_eq!(states[1].positions, [0.003, 0.001, 0.002, 9.0]);
    let info: CameraInfo = topic(Path::new(GOLDEN), "/camera/camera_info").first().unwrap();
    assert_eq!((info.width, info.height, info.distortion_model.as_str()), (640, 480, "plumb_bob"));
    assert_eq!((info.matrix[0], info.matrix[5], info.distortion[4]), (900.0, 240.5, 0.03));
    for name in ["/tip/pose", "/tip/transform"] {
        let pose: StampedPose = topic(Path::new(GOLDEN), name).first().unwrap();
        assert_eq!(pose.position_m.as_slice(), [0.1, -0.2, 0.3]);
        assert_eq!((pose.orientation.w, pose.orientation.j), (0.8, 0.6));
    }
}

#[test]
fn messages_are_written_byte_by_byte_as_another_program_writes_them() {
    let message = topic(Path::new(GOLDEN), "/camera/image_raw/compressed").messages().unwrap().next().unwrap().unwrap();
    let mut cdr = Cdr::new(&message.cdr).unwrap();
    assert_eq!((cdr.i32(), cdr.u32(), cdr.text()), (Ok(1_700_000_000), Ok(100_000_000), Ok("world".to_owned())));
    let picture = CompressedImage::read(&mut cdr).unwrap();
    assert_eq!(picture.encoded(1_700_000_000_100_000_000, "world"), message.cdr);

    let message = topic(Path::new(GOLDEN), "/joint_states").messages().unwrap().nth(1).unwrap().unwrap();
    let state: JointState = message.decoded().unwrap();
    let cdr = JointState::encoded(1_700_000_000_200_000_000, &state.names, &state.positions);
    assert_eq!(Message { cdr, ..message }.decoded::<JointState>().unwrap(), state);
}

/// The golden file's messages in chunks of another compression.
fn rewritten(compression: Option<mcap::Compression>) -> Vec<u8> {
    let mut file = Cursor::new(Vec::new());
    let options = mcap::WriteOptions::new().compression(compression).chunk_size(Some(1000));
    let mut writer = options.create(&mut file).unwrap();
    for message in mcap::MessageStream::new(&fs::read(GOLDEN).unwrap()).unwrap() {
        writer.write(&message.unwrap()).unwrap();
    }
    writer.finish().unwrap();
    drop(writer);
    file.into_inner()
}

#[test]
fn chunks_may_be_compressed_and_a_file_may_end_anywhere() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    let expected: Vec<JointState> = topic(Path::new(GOLDEN), "/joint_states").all().unwrap().0;
    for compression in [None, Some(mcap::Compression::Zstd), Some(mcap::Compression::Lz4)] {
        let whole = rewritten(compression);
        fs::write(&path, &whole).unwrap();
        let joints = topic(&path, "/joint_states");
        assert_eq!(joints.all::<JointState>().unwrap(), (expected.clone(), Vec::new()), "{compression:?}");
        assert_eq!(joints.counted_by_summary(&path), Some(expected.len()), "{compression:?}");
        let mut counts = Vec::new();
        for kept in (0..whole.len()).step_by(97) {
            fs::write(&path, &whole[..kept]).unwrap();
            let read: Vec<Message> = joints.messages().unwrap().map_while(Result::ok).collect();
            let states: Vec<JointState> = read.iter().map(|message| message.decoded().unwrap()).collect();
            assert_eq!(states, expected[..states.len()], "{kept} bytes");
            assert_eq!(joints.count().unwrap(), states.len(), "{kept} bytes");
            counts.push(states.len());
        }
        assert!(counts.is_sorted() && counts.last() == Some(&4), "{counts:?}");
    }
}

/// Forty messages of one topic in chunks of a few, and what they say.
fn forty_messages(path: &Path) -> Vec<JointState> {
    let options = mcap::WriteOptions::new().compression(None).chunk_size(Some(400));
    let mut writer = options.create(fs::File::create(path).unwrap()).unwrap();
    let schema = writer.add_schema("sensor_msgs/msg/JointState", "ros2msg", b"").unwrap();
    let channel = writer.add_channel(schema, "/joints", "cdr", &BTreeMap::new()).unwrap();
    for k in 0..40u64 {
        let time_ns = 1_700_000_000_000_000_000 + k;
        let header =
            mcap::records::MessageHeader { channel_id: channel, sequence: 0, log_time: time_ns, publish_time: time_ns };
        let cdr = JointState::encoded(time_ns, &["b1".to_owned(), "b2".to_owned()], &[k as f64, -1.0]);
        writer.write_to_known_channel(&header, &cdr).unwrap();
    }
    writer.finish().unwrap();
    topic(path, "/joints").all().unwrap().0
}

#[test]
fn a_damaged_chunk_costs_its_messages_alone_and_those_behind_it_keep_their_places() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    let expected = forty_messages(&path);
    let (whole, joints) = (fs::read(&path).unwrap(), topic(&path, "/joints"));
    assert_eq!(expected.len(), 40);
    let (mut resumed, mut lost_at_most) = (0, 0);
    for at in (0..whole.len()).step_by(13) {
        let mut bytes = whole.clone();
        bytes[at] ^= 255;
        fs::write(&path, bytes).unwrap();
        let read: Vec<Option<JointState>> =
            joints.messages().unwrap().map(|message| message.ok()?.decoded().ok()).collect();
        for (k, state) in read.iter().enumerate() {
            assert!(state.as_ref().is_none_or(|state| *state == expected[k]), "byte {at}: message {k}");
        }
        let lost = read.iter().filter(|state| state.is_none()).count();
        let (states, faults) = joints.all::<JointState>().unwrap_or_default();
        if faults.first().is_some_and(|fault| fault.contains("this message is lost")) {
            (resumed, lost_at_most) = (resumed + 1, lost_at_most.max(lost));
            assert_eq!((read.len(), states.len()), (40, 40 - lost));
            assert!(faults[0].ends_with(&format!(": {} of 40 messages were read", 40 - lost)), "{faults:?}");
        }
    }
    assert!(
        resumed > whole.len() / 13 / 2 && lost_at_most < 6,
        "{resumed} times of {}, {lost_at_most}",
        whole.len() / 13
    );
}

#[test]
fn what_is_not_there_is_named_with_what_is() {
    let golden = Path::new(GOLDEN);
    let said = |found: Result<JointState>| found.unwrap_err().to_string();
    let missing = said(topic(golden, "/joints").first());
    assert!(missing.contains("ros2.mcap: topic /joints: no message; the recording has "), "{missing}");
    assert!(missing.contains("/joint_states (sensor_msgs/msg/JointState)"), "{missing}");
    let other = said(topic(golden, "/tip/pose").first());
    assert!(other.contains("messages of type geometry_msgs/PoseStamped, expected sensor_msgs/JointState"), "{other}");
    assert!(said(topic(Path::new("nowhere.mcap"), "/a").first()).contains("nowhere.mcap: cannot read"));
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    fs::write(&path, "this is no recording at all, and long enough").unwrap();
    assert!(said(topic(&path, "/a").first()).contains("no readable recording (MCAP)"));
    let mut writer = mcap::Writer::new(fs::File::create(&path).unwrap()).unwrap();
    let channel = writer.add_channel(0, "/a", "json", &BTreeMap::new()).unwrap();
    let header = mcap::records::MessageHeader { channel_id: channel, sequence: 0, log_time: 0, publish_time: 0 };
    writer.write_to_known_channel(&header, b"{}").unwrap();
    writer.finish().unwrap();
    assert!(said(topic(&path, "/a").first()).contains("expected cdr"));
}

#[test]
fn cut_messages_are_errors_and_no_panic() {
    for name in ["/joint_states", "/camera/camera_info", "/tip/transform"] {
        let message = topic(Path::new(GOLDEN), name).messages().unwrap().next().unwrap().unwrap();
        for kept in 0..message.cdr.len() {
            let cut = Message { cdr: message.cdr[..kept].to_vec(), ..message.clone() };
            let (states, infos, poses) =
                (cut.decoded::<JointState>(), cut.decoded::<CameraInfo>(), cut.decoded::<StampedPose>());
            // Of a CameraInfo more follows than is read, of a JointState the velocities.
            assert!(states.is_ok() || infos.is_ok() || poses.is_err(), "{name} {kept}");
        }
        let claims = [&message.cdr[..4], &[0xff; 40]].concat();
        assert!(Message { cdr: claims, ..message.clone() }.decoded::<JointState>().is_err());
    }
}

#[test]
fn a_few_bytes_that_claim_to_be_a_gigabyte_take_no_memory() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    let claimed = 900u64 << 20;
    fs::write(&path, [&b"\x89MCAP0\r\n\x01"[..], &claimed.to_le_bytes(), &[0; 100]].concat()).unwrap();
    let refused = topic(&path, "/joint_states").all::<JointState>().unwrap_err().to_string();
    assert!(refused.contains("no readable recording (MCAP)"), "{refused}");
}

#[test]
fn what_ros_records_otherwise_is_told_with_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let said = |path: PathBuf| {
        let topic = Topic { bag: path.into(), topic: "/tip".to_owned() };
        topic.messages().err().expect("an error").to_string()
    };
    let file = |bytes: &[u8]| {
        let path = folder.path().join("run");
        std::fs::write(&path, bytes).unwrap();
        path
    };
    assert!(said(folder.path().to_owned()).contains("a folder without metadata.yaml and *.mcap"));
    assert!(said(file(b"SQLite format 3\0\x10\0")).contains("storage_id: mcap"));
    assert!(said(file(&[0x28, 0xb5, 0x2f, 0xfd, 0x24])).contains("unpack it (zstd -d)"));
    assert!(Cdr::new(&[0x28, 0xb5, 0x2f, 0xfd, 0x24]).err().unwrap().contains("ros2 bag convert"));
}
