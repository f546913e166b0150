"""The recording that the program's `export` writes, read by Python packages that share no code with it: mcap with mcap-ros2-support, and
rosbags. Both decode by the definitions in the file alone."""

import csv
import math
import os
import subprocess
from decimal import Decimal
from pathlib import Path

import pytest
from conftest import BENDING, ROOT

mcap = pytest.importorskip("mcap.reader")
mcap_ros2 = pytest.importorskip("mcap_ros2.decoder")
rosbags = pytest.importorskip("rosbags.highlevel")
typesys = pytest.importorskip("rosbags.typesys")
PROGRAM = Path(os.environ.get("SNAKELOOP_PROGRAM", ROOT / "target" / "debug" / "snakeloop"))
TABLES = {
    "measurement": """index,time_s,theta_deg,delta_deg,sigma_theta_deg,sigma_delta_deg,status,view
0,1700000000.25,5.6,-2.5,0.015,0.44,ok,side
2,1700000001,,,,,occluded,side
4,1700000002.5,60.9,3.3,0.017,0.049,ok,side
""",
    "estimate": """index,time_s,eta,lambda_mm,status,reason,residual1_mm
0,1700000000.25,,,skipped,too few,
4,1700000002.5,1.2208,0.1765,used,,-0.00125
""",
    "stem": "index,time_s,phi_deg,sd_phi_deg,status\n4,1700000002.5,90.25,0.5,used\n",
    "force": "index,time_s,fx_n,fy_n,fz_n,status\n4,1700000002.5,0.1,-0.2,,used\n",
}
WORDS = {"status", "reason", "view"}

pytestmark = pytest.mark.skipif(not PROGRAM.exists(), reason=f"{PROGRAM} is not built")


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    for name, text in TABLES.items():
        (folder / ("measurements.csv" if name == "measurement" else f"{name}.csv")).write_text(text)
    bag = folder / "run.mcap"
    subprocess.run([PROGRAM, "export", folder, "--experiment", BENDING, "-o", bag, "--quiet"], check=True)
    return bag


def read_by_mcap(bag):
    """Topic, type, time in ns and message, in the file's order."""
    with open(bag, "rb") as file:
        reader = mcap.make_reader(file, validate_crcs=True, decoder_factories=[mcap_ros2.DecoderFactory()])
        header, summary = reader.get_header(), reader.get_summary()
        assert header.profile == "ros2" and header.library.startswith("snakeloop ")
        assert all(schema.encoding == "ros2msg" for schema in summary.schemas.values())
        messages = reader.iter_decoded_messages(log_time_order=False)
        found = [(channel.topic, schema.name, message.log_time, ros) for schema, channel, message, ros in messages]
        assert summary.statistics.message_count == len(found)
        return found


def read_by_rosbags(bag):
    with rosbags.AnyReader([bag]) as reader:
        return [
            (connection.topic, connection.msgtype, time, reader.deserialize(raw, connection.msgtype))
            for connection, time, raw in reader.messages()
        ]


def nanoseconds(row):
    return int(10**9 * Decimal(row["time_s"]))


@pytest.mark.parametrize("read", [read_by_mcap, read_by_rosbags])
def test_every_row_and_frame_is_there_as_a_message_of_ros(bag, read):
    found = read(bag)
    times = [time for _, _, time, _ in found]
    assert times == sorted(times)
    by_topic = {}
    for topic, kind, time, message in found:
        assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == time
        by_topic.setdefault(topic, []).append((kind, time, message))

    for name, text in TABLES.items():
        rows = list(csv.DictReader(text.splitlines()))
        for (kind, time, message), row in zip(by_topic.pop(f"/{name}"), rows, strict=True):
            assert (kind, time) == (f"snakeloop_msgs/msg/{name.capitalize()}", nanoseconds(row))
            # Attributes of the class are the fields; some readers add their own behind a double underscore.
            fields = getattr(message, "__dataclass_fields__", None) or message.__slots__
            assert [field for field in fields if not field.startswith("__")] == ["header", *row]
            for column, text in row.items():
                value = getattr(message, column)
                if column in WORDS:
                    assert value == text
                else:
                    assert value == float(text) if text else math.isnan(value)

    rows = list(csv.DictReader(TABLES["measurement"].splitlines()))
    for (kind, time, message), row in zip(by_topic.pop("/camera/side/compressed"), rows, strict=True):
        assert (kind, time) == ("sensor_msgs/msg/CompressedImage", nanoseconds(row))
        assert (message.header.frame_id, message.format) == ("side", "jpeg")
        assert bytes(message.data) == (BENDING / "frames" / f"{int(row['index']):05}.jpg").read_bytes()

    with open(BENDING / "encoders.csv", newline="") as file:
        readings = list(csv.DictReader(file))
    assert len(readings) == 17
    for (kind, time, message), row in zip(by_topic.pop("/encoders"), readings, strict=True):
        assert (kind, time) == ("sensor_msgs/msg/JointState", nanoseconds(row))
        assert list(message.name) == ["q1", "q2", "q3"]
        assert list(message.position) == [float(row[f"q{k}_mm"]) / 1000 for k in (1, 2, 3)]
        assert len(message.velocity) == len(message.effort) == 0
    assert not by_topic


@pytest.mark.parametrize("release", ["ROS2_HUMBLE", "ROS2_JAZZY", "LATEST"])
def test_the_types_of_ros_are_what_ros_takes_them_for(bag, release):
    ros = typesys.get_typestore(typesys.Stores[release])
    with rosbags.AnyReader([bag]) as reader:
        kinds = {connection.msgtype for connection in reader.connections}
        known = {kind for kind in kinds if kind.startswith("sensor_msgs/")}
        assert len(kinds) == 6 and len(known) == 2
        for kind in known:
            assert reader.typestore.hash_rihs01(kind) == ros.hash_rihs01(kind)
