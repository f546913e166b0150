"""Writes ros2.mcap, a recording by the Python package rosbags, which shares no code with this project.

    pip install numpy pillow rosbags && python tests/golden/ros2.py tests/golden/ros2.mcap
"""

import io
import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image as Pillow
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)
T = STORE.types
START_S = 1_700_000_000


def header(k):
    stamp = T["builtin_interfaces/msg/Time"](sec=START_S, nanosec=100_000_000 * k)
    return T["std_msgs/msg/Header"](stamp=stamp, frame_id="world")


def levels(channels):
    """Pixels of a picture of 6 × 4: 40 x + 10 y + channel."""
    y, x, c = np.mgrid[0:4, 0:6, 0:channels]
    return (40 * x + 10 * y + c).astype(np.uint8)


def image(encoding, pixels, padding=3):
    height, width = pixels.shape[:2]
    rows = pixels.reshape(height, -1)
    padded = np.pad(rows, ((0, 0), (0, padding)), constant_values=255)
    return T["sensor_msgs/msg/Image"](
        header=header(0), height=height, width=width, encoding=encoding, is_bigendian=0, step=padded.shape[1], data=padded.ravel()
    )


def png(pixels):
    file = io.BytesIO()
    Pillow.fromarray(pixels).save(file, "PNG")
    return np.frombuffer(file.getvalue(), np.uint8)


def messages():
    """Topic, time in steps of 0.1 s, message."""
    for k in range(3):
        frame = T["sensor_msgs/msg/CompressedImage"](header=header(2 * k + 1), format="png", data=png(levels(3)))
        yield "/camera/image_raw/compressed", 2 * k + 1, frame
    yield "/raw/mono8", 0, image("mono8", levels(1)[..., 0])
    yield "/raw/bgr8", 0, image("bgr8", levels(3)[..., ::-1])
    yield "/raw/rgb8", 0, image("rgb8", levels(3))
    mosaic = np.empty((4, 6), np.uint8)
    mosaic[0::2, 0::2], mosaic[1::2, 1::2] = 200, 50
    mosaic[0::2, 1::2], mosaic[1::2, 0::2] = 100, 100
    yield "/raw/bayer", 0, image("bayer_rggb8", mosaic)
    matrix = np.array([900, 0, 320.5, 0, 910, 240.5, 0, 0, 1], float)
    yield "/camera/camera_info", 0, T["sensor_msgs/msg/CameraInfo"](
        header=header(0),
        height=480,
        width=640,
        distortion_model="plumb_bob",
        d=np.array([0.1, -0.2, 0.001, 0.002, 0.03]),
        k=matrix,
        r=np.eye(3).ravel(),
        p=np.zeros(12),
        binning_x=0,
        binning_y=0,
        roi=T["sensor_msgs/msg/RegionOfInterest"](x_offset=0, y_offset=0, height=0, width=0, do_rectify=False),
    )
    # Every 0.2 s; the joints in another order than the backbones.
    for k in range(4):
        positions = np.array([0.003, 0.001, 0.002, 9.0]) * k
        yield "/joint_states", 2 * k, T["sensor_msgs/msg/JointState"](
            header=header(2 * k), name=["b3", "b1", "b2", "grip"], position=positions, velocity=np.array([]), effort=np.array([])
        )
    point = T["geometry_msgs/msg/Point"](x=0.1, y=-0.2, z=0.3)
    turn = T["geometry_msgs/msg/Quaternion"](x=0.0, y=0.6, z=0.0, w=0.8)
    pose = T["geometry_msgs/msg/Pose"](position=point, orientation=turn)
    yield "/tip/pose", 1, T["geometry_msgs/msg/PoseStamped"](header=header(1), pose=pose)
    shift = T["geometry_msgs/msg/Vector3"](x=0.1, y=-0.2, z=0.3)
    transform = T["geometry_msgs/msg/Transform"](translation=shift, rotation=turn)
    yield "/tip/transform", 1, T["geometry_msgs/msg/TransformStamped"](header=header(1), child_frame_id="tip", transform=transform)


def main(path):
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "bag"
        writer = Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP)
        with writer:
            connections = {}
            for topic, step, message in sorted(messages(), key=lambda entry: entry[1]):
                kind = message.__msgtype__
                connection = connections.get(topic) or writer.add_connection(topic, kind, typestore=STORE)
                connections[topic] = connection
                time_ns = START_S * 1_000_000_000 + 100_000_000 * step
                writer.write(connection, time_ns, STORE.serialize_cdr(message, kind))
        shutil.copy(next(bag.glob("*.mcap")), path)


main(sys.argv[1])
