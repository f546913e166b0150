"""Writes ride.mcap, a ride with frames, joints, lens and a tracker's poses, by the Python package rosbags, which shares no code with this
project. The frames and the encoders are those of a folder that snakeloop rendered; the tip's poses are arcs in closed form.

    printf '[estimate]\neta = 1.221\nlambda_mm = 0.1765\nsd_eta = 0.0\nsd_lambda_mm = 0.0\ncorrelation = 0.0\nsamples = 0\n' > hidden.toml
    snakeloop simulate --model hidden.toml --sweeps 0,120,-120 --sweep-poses 6 --round-poses 12 -o made
    snakeloop render --poses made/truth.csv --scene tests/golden/ride/scene.toml --jpeg 80 -o made
    pip install numpy rosbags && python tests/golden/ride/ride.py made tests/golden/ride

Poses: every one of made/truth.csv, after a straight one. Frames: every sixth of them.
"""

import csv
import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)
T = STORE.types
START_S = 1_700_000_000
LENGTH_MM = 26.0
FRAMES_EVERY = 6
# Where the base is in the tracker's frame: turned by 50° about (1, 2, 2)/3, and moved, mm.
BASE_TURN = np.array([np.cos(np.radians(25)), *(np.sin(np.radians(25)) * np.array([1, 2, 2]) / 3)])
BASE_MM = np.array([120.0, -40.0, 300.0])
NOISE_MM, NOISE_RAD = 0.03, 0.001


def product(a, b):
    """Of quaternions w, x, y, z."""
    w = a[0] * b[0] - a[1:] @ b[1:]
    return np.array([w, *(a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:]))])


def turned(q, v):
    conjugate = q * np.array([1, -1, -1, -1])
    return product(product(q, np.array([0, *v])), conjugate)[1:]


def tip(theta, delta):
    """Position, mm, and orientation of the tip of an arc, in the base's frame."""
    lean = np.array([np.cos(delta), np.sin(delta), 0.0])
    radius = LENGTH_MM / theta if theta else np.inf
    position = np.array([0, 0, LENGTH_MM]) if theta == 0 else radius * ((1 - np.cos(theta)) * lean + np.sin(theta) * np.array([0, 0, 1]))
    axis = np.array([-np.sin(delta), np.cos(delta), 0.0])
    return position, np.array([np.cos(theta / 2), *(np.sin(theta / 2) * axis)])


def header(time_s):
    nanoseconds = round(time_s * 1e9)
    stamp = T["builtin_interfaces/msg/Time"](sec=START_S + nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
    return T["std_msgs/msg/Header"](stamp=stamp, frame_id="tracker")


def pose(time_s, theta, delta, noise):
    position, orientation = tip(theta, delta)
    x, y, z = (BASE_MM + turned(BASE_TURN, position) + noise.normal(0, NOISE_MM, 3)) / 1000
    small = np.array([1, *(noise.normal(0, NOISE_RAD, 3) / 2)])
    q = product(product(BASE_TURN, orientation), small)
    w, i, j, k = q / np.linalg.norm(q)
    return T["geometry_msgs/msg/PoseStamped"](
        header=header(time_s),
        pose=T["geometry_msgs/msg/Pose"](
            position=T["geometry_msgs/msg/Point"](x=x, y=y, z=z),
            orientation=T["geometry_msgs/msg/Quaternion"](x=i, y=j, z=k, w=w),
        ),
    )


def joints(time_s, q_mm):
    return T["sensor_msgs/msg/JointState"](
        header=header(time_s), name=["b1", "b2", "b3"], position=np.array(q_mm) / 1000, velocity=np.array([]), effort=np.array([])
    )


def camera_info():
    """That of scene.toml."""
    return T["sensor_msgs/msg/CameraInfo"](
        header=header(0.0),
        height=240,
        width=427,
        distortion_model="plumb_bob",
        d=np.zeros(5),
        k=np.array([1427.45, 0, 213.0, 0, 1427.45, 119.5, 0, 0, 1]),
        r=np.eye(3).ravel(),
        p=np.zeros(12),
        binning_x=0,
        binning_y=0,
        roi=T["sensor_msgs/msg/RegionOfInterest"](x_offset=0, y_offset=0, height=0, width=0, do_rectify=False),
    )


def messages(made):
    """Topic, time in s, message."""
    rows = lambda name: list(csv.DictReader((made / name).open()))
    noise = np.random.default_rng(1)
    yield "/camera/camera_info", 0.0, camera_info()
    yield "/tip", 0.0, pose(0.0, 0.0, 0.0, noise)
    for k, (truth, log) in enumerate(zip(rows("truth.csv"), rows("encoders.csv"))):
        time_s = float(log["time_s"])
        theta, delta = np.radians(float(truth["theta_deg"])), np.radians(float(truth["delta_deg"]))
        yield "/tip", time_s, pose(time_s, theta, delta, noise)
        yield "/joint_states", time_s, joints(time_s, [float(log[f"q{i}_mm"]) for i in (1, 2, 3)])
        if k % FRAMES_EVERY == 3:
            data = np.frombuffer((made / f"frames/{k:05}.jpg").read_bytes(), np.uint8)
            frame = T["sensor_msgs/msg/CompressedImage"](header=header(time_s), format="jpeg", data=data)
            yield "/camera/image_raw/compressed", time_s, frame


def main(made, out):
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "bag"
        writer = Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP)
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        with writer:
            connections = {}
            for topic, time_s, message in sorted(messages(made), key=lambda entry: entry[1]):
                kind = message.__msgtype__
                connection = connections.get(topic) or writer.add_connection(topic, kind, typestore=STORE)
                connections[topic] = connection
                writer.write(connection, START_S * 10**9 + round(time_s * 1e9), STORE.serialize_cdr(message, kind))
        shutil.copy(next(bag.glob("*.mcap")), out / "ride.mcap")
    shutil.copy(made / "straight.jpg", out / "straight.jpg")
    shutil.copy(made / "truth.csv", out / "truth.csv")


main(Path(sys.argv[1]), Path(sys.argv[2]))
