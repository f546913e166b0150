"""Another DDS implementation on the loopback, which plays a laboratory's ROS 2: the Python package cyclonedds, with its own library.

  ros2.py --check                          whether the package is there
  ros2.py play DOMAIN FOLDER [KEY=VALUE…]  publishes frames and encoders.csv of an experiment
  ros2.py listen DOMAIN                    prints what `snakeloop live` publishes, a line of JSON a message
  ros2.py ask DOMAIN X Y                   asks what to command for a bend (rad) and prints the answer, or null after three seconds
  ros2.py strange DOMAIN KIND              publishes on the image topic what does not belong there: "text" or "garbage"

Topics and types have the names that ROS 2 gives them in DDS.
"""

import csv
import io
import json
import os
import sys
import time
from dataclasses import dataclass
from pathlib import Path

# The loopback alone, without multicast.
os.environ.setdefault(
    "CYCLONEDDS_URI",
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='lo'/></Interfaces><AllowMulticast>false</AllowMulticast>"
    "</General><Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>10</MaxAutoParticipantIndex>"
    "<Peers><Peer address='127.0.0.1'/></Peers></Discovery></Domain></CycloneDDS>",
)

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import array, float64, int32, sequence, uint8, uint32
from cyclonedds.internal import InvalidSample
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration


def ros(package, name):
    return f"{package}.msg.dds_.{name}_"


@final
@dataclass
class Time(IdlStruct, typename=ros("builtin_interfaces", "Time")):
    sec: int32
    nanosec: uint32

    @staticmethod
    def of(seconds):
        nanoseconds = round(seconds * 1e9)
        return Time(nanoseconds // 10**9, nanoseconds % 10**9)


@final
@dataclass
class Header(IdlStruct, typename=ros("std_msgs", "Header")):
    stamp: Time
    frame_id: str


@final
@dataclass
class Image(IdlStruct, typename=ros("sensor_msgs", "Image")):
    header: Header
    height: uint32
    width: uint32
    encoding: str
    is_bigendian: uint8
    step: uint32
    data: sequence[uint8]


@final
@dataclass
class CompressedImage(IdlStruct, typename=ros("sensor_msgs", "CompressedImage")):
    header: Header
    format: str
    data: sequence[uint8]


@final
@dataclass
class RegionOfInterest(IdlStruct, typename=ros("sensor_msgs", "RegionOfInterest")):
    x_offset: uint32
    y_offset: uint32
    height: uint32
    width: uint32
    do_rectify: bool


@final
@dataclass
class CameraInfo(IdlStruct, typename=ros("sensor_msgs", "CameraInfo")):
    header: Header
    height: uint32
    width: uint32
    distortion_model: str
    d: sequence[float64]
    k: array[float64, 9]
    r: array[float64, 9]
    p: array[float64, 12]
    binning_x: uint32
    binning_y: uint32
    roi: RegionOfInterest


@final
@dataclass
class JointState(IdlStruct, typename=ros("sensor_msgs", "JointState")):
    header: Header
    name: sequence[str]
    position: sequence[float64]
    velocity: sequence[float64]
    effort: sequence[float64]


@final
@dataclass
class String(IdlStruct, typename=ros("std_msgs", "String")):
    data: str


@final
@dataclass
class Vector3(IdlStruct, typename=ros("geometry_msgs", "Vector3")):
    x: float64
    y: float64
    z: float64


@final
@dataclass
class Vector3Stamped(IdlStruct, typename=ros("geometry_msgs", "Vector3Stamped")):
    header: Header
    vector: Vector3


@final
@dataclass
class MultiArrayDimension(IdlStruct, typename=ros("std_msgs", "MultiArrayDimension")):
    label: str
    size: uint32
    stride: uint32


@final
@dataclass
class MultiArrayLayout(IdlStruct, typename=ros("std_msgs", "MultiArrayLayout")):
    dim: sequence[MultiArrayDimension]
    data_offset: uint32


@final
@dataclass
class Float64MultiArray(IdlStruct, typename=ros("std_msgs", "Float64MultiArray")):
    layout: MultiArrayLayout
    data: sequence[float64]


@final
@dataclass
class KeyValue(IdlStruct, typename=ros("diagnostic_msgs", "KeyValue")):
    key: str
    value: str


@final
@dataclass
class DiagnosticStatus(IdlStruct, typename=ros("diagnostic_msgs", "DiagnosticStatus")):
    level: uint8
    name: str
    message: str
    hardware_id: str
    values: sequence[KeyValue]


@final
@dataclass
class DiagnosticArray(IdlStruct, typename=ros("diagnostic_msgs", "DiagnosticArray")):
    header: Header
    status: sequence[DiagnosticStatus]


# As rclcpp's and rclpy's defaults: reliable, the last ten.
DEFAULT = Qos(
    Policy.Reliability.Reliable(duration(seconds=1)),
    Policy.History.KeepLast(10),
    Policy.DataRepresentation(use_cdrv0_representation=True),
)
SENSOR_DATA = Qos(
    Policy.Reliability.BestEffort, Policy.History.KeepLast(5), Policy.DataRepresentation(use_cdrv0_representation=True)
)
IMAGE, INFO, JOINTS = "rt/camera/image_raw", "rt/camera/camera_info", "rt/joint_states"


def writer(participant, name, kind, qos=DEFAULT):
    return DataWriter(participant, Topic(participant, name, kind, qos=qos), qos=qos)


def reader(participant, name, kind, qos=DEFAULT):
    return DataReader(participant, Topic(participant, name, kind, qos=qos), qos=qos)


def until_matched(*writers):
    while not all(writer.get_matched_subscriptions() for writer in writers):
        time.sleep(0.01)


def picture_message(path, encoding, header):
    """A picture file as a message: as it is, or its pixels in an encoding."""
    if encoding == "compressed":
        return CompressedImage(header, path.suffix[1:], path.read_bytes())
    from PIL import Image as Picture

    picture = Picture.open(io.BytesIO(path.read_bytes())).convert("L" if encoding == "mono8" else "RGB")
    pixels = picture.tobytes() if encoding != "bgr8" else picture.tobytes("raw", "BGR")
    step = len(pixels) // picture.height
    return Image(header, picture.height, picture.width, encoding, 0, step, pixels)


def joint_messages(header, position, apart):
    names = ["b1", "b2", "b3"]
    if apart:
        return [JointState(header, [name], [q], [], []) for name, q in zip(names, position)]
    return [JointState(header, ["grip", *names], [0.5, *position], [], [])]


def play(domain, folder, **options):
    """Plays an experiment in its own order, with the times of now.

    encoding=compressed|rgb8|bgr8|mono8, period=S, rounds=N, apart=1 for a message a joint, repeat=1 for every message twice, drop=N to leave out
    every Nth picture, joint_faults=1 for a contradiction beside every reading, info=1 for the camera's lens beside, offset=S for a clock of its own,
    blind=1 to wait for no reader, stay=1 to stay at the end, qos=sensor.
    """
    encoding, apart = options.get("encoding", "compressed"), "apart" in options
    period, rounds, drop = float(options.get("period", 0.2)), int(options.get("rounds", 1)), int(options.get("drop", 0))
    offset, qos = float(options.get("offset", 0)), SENSOR_DATA if options.get("qos") == "sensor" else DEFAULT
    with open(folder / "encoders.csv", newline="") as file:
        rows = [(int(row["index"]), [float(row[f"q{i}_mm"]) for i in (1, 2, 3)]) for row in csv.DictReader(file)]
    frames = {int(path.stem): path for path in (folder / "frames").glob("*.jpg")}
    template = Header(Time(0, 0), "camera")
    kept = [(picture_message(frames[index], encoding, template), q) for index, q in rows if index in frames]
    participant = DomainParticipant(domain)
    images = writer(participant, IMAGE, CompressedImage if encoding == "compressed" else Image, qos)
    joints = writer(participant, JOINTS, JointState, qos)
    infos = writer(participant, INFO, CameraInfo)
    info = camera_info(folder) if "info" in options else None
    if "blind" not in options:
        until_matched(images, joints)
        # What was just matched may take a moment to be written to.
        time.sleep(0.3)
    due = time.time()
    for number in range(rounds * len(kept)):
        picture, q = kept[number % len(kept)]
        time.sleep(max(0, due - time.time()))
        header = Header(Time.of(due + offset), "camera")
        if info:
            info.header = header
            infos.write(info)
        for _ in range(2 if "repeat" in options else 1):
            for message in joint_messages(header, q, apart):
                joints.write(message)
            if "joint_faults" in options:
                joints.write(JointState(header, ["b2"], [q[1] + 3], [], []))
            if not (drop and number % drop == drop - 1):
                picture.header = header
                images.write(picture)
        due += period
    print("done", flush=True)
    time.sleep(1 if "stay" not in options else 600)


def camera_info(folder):
    """The lens of a camera file of the fixtures."""
    import re

    text = (folder / "camera.yaml").read_text()
    numbers = lambda name: [float(x) for x in re.search(name + r":.*?data:\s*\[(.*?)\]", text, re.S)[1].split(",")]
    size = [int(re.search(rf"image_{side}:\s*(\d+)", text)[1]) for side in ("width", "height")]
    k, d = numbers("camera_matrix"), numbers("distortion_coefficients")
    identity = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    projection = [*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0]
    roi = RegionOfInterest(0, 0, 0, 0, False)
    return CameraInfo(Header(Time(0, 0), ""), size[1], size[0], "plumb_bob", d, k, identity, projection, 0, 0, roi)


def listen(domain):
    participant = DomainParticipant(domain)
    readers = {
        "bend": reader(participant, "rt/snakeloop/bend", Vector3Stamped),
        "estimate": reader(participant, "rt/snakeloop/estimate", Float64MultiArray),
        "diagnostics": reader(participant, "rt/diagnostics", DiagnosticArray),
        "overlay": reader(participant, "rt/snakeloop/overlay/compressed", CompressedImage, SENSOR_DATA),
    }
    print(json.dumps({"topic": "ready"}), flush=True)
    while True:
        for topic, messages in readers.items():
            for message in messages.take(N=100):
                if isinstance(message, InvalidSample):
                    continue  # A publisher that is gone.
                print(json.dumps({"topic": topic, "at": time.time(), **shown(topic, message)}), flush=True)
        time.sleep(0.002)


def shown(topic, message):
    if topic == "estimate":
        return {"label": message.layout.dim[0].label, "data": list(message.data)}
    stamp = {"sec": message.header.stamp.sec, "nanosec": message.header.stamp.nanosec}
    if topic == "bend":
        vector = message.vector
        return {"stamp": stamp, "frame": message.header.frame_id, "vector": [vector.x, vector.y, vector.z]}
    if topic == "overlay":
        return {"stamp": stamp, "format": message.format, "bytes": len(message.data), "jpeg": bytes(message.data[:3]).hex()}
    status = message.status[0]
    return {"level": status.level, "name": status.name, "message": status.message, "values": {v.key: v.value for v in status.values}}


def ask(domain, x, y):
    participant = DomainParticipant(domain)
    requests = writer(participant, "rt/snakeloop/command", Vector3Stamped)
    answers = reader(participant, "rt/snakeloop/command/answer", Float64MultiArray)
    until_matched(requests)
    while not answers.get_matched_publications():
        time.sleep(0.01)
    time.sleep(0.3)
    requests.write(Vector3Stamped(Header(Time.of(time.time()), ""), Vector3(x, y, 0.0)))
    until = time.time() + 3
    while time.time() < until:
        for answer in answers.take(N=10):
            print(json.dumps(dict(zip(answer.layout.dim[0].label.split(","), answer.data))), flush=True)
            return
        time.sleep(0.005)
    print("null", flush=True)


def strange(domain, kind):
    participant = DomainParticipant(domain)
    if kind == "text":
        messages, message = writer(participant, IMAGE, String), String("hello")
    else:
        messages = writer(participant, IMAGE, Image)
        message = Image(Header(Time(0, 0), ""), 480, 640, "rgb8", 0, 1920, b"short")
    print("done", flush=True)
    for _ in range(600):
        if kind != "text":
            message.header = Header(Time.of(time.time()), "")
        messages.write(message)
        time.sleep(0.1)


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["--check"]:
            pass
        case ["play", domain, folder, *options]:
            play(int(domain), Path(folder), **dict(option.split("=", 1) for option in options))
        case ["listen", domain]:
            listen(int(domain))
        case ["ask", domain, x, y]:
            ask(int(domain), float(x), float(y))
        case ["strange", domain, kind]:
            strange(int(domain), kind)
        case _:
            sys.exit(__doc__)
