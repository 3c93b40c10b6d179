#!/usr/bin/env python3
"""Write a ROS 2 bag (MCAP) with rosbags, as another robot's recorder would.

    write_bag.py FOLDER BAG [--only TOPIC,TOPIC,...]

FOLDER holds `frames.json`, a list of frames, and the files of pixels that it refers to by name, offset
and length. Images, poses and scans have header stamps; what has no header is only logged. Images are
logged LATENCY after their stamps. BAG is a new folder.

Exit codes: 0 written; 1 failed; 3 a package is not installed.
"""

import argparse
import json
import math
import sys
from pathlib import Path

try:
    import numpy
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore
except ImportError as missing:
    print(f"{missing} (pip install rosbags)", file=sys.stderr)
    sys.exit(3)

LATENCY_NS = 30_000_000
PADDING = 5

store = get_typestore(Stores.ROS2_HUMBLE)


def of(name):
    package, kind = name.split("/")
    return store.types[f"{package}/msg/{kind}"]


def header(stamp_ns, frame):
    time = of("builtin_interfaces/Time")(sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    return of("std_msgs/Header")(stamp=time, frame_id=frame)


def vector(x, y, z):
    return of("geometry_msgs/Vector3")(x=x, y=y, z=z)


def quaternion(heading):
    return of("geometry_msgs/Quaternion")(x=0.0, y=0.0, z=math.sin(heading / 2), w=math.cos(heading / 2))


def pose(x, y, heading):
    point = of("geometry_msgs/Point")(x=x, y=y, z=0.0)
    return of("geometry_msgs/Pose")(position=point, orientation=quaternion(heading))


def twist(speed, turn):
    return of("geometry_msgs/Twist")(linear=vector(speed, 0.0, 0.0), angular=vector(0.0, 0.0, turn))


class Pixels:
    """Parts of the files of pixels."""

    def __init__(self, folder):
        self.folder = folder
        self.files = {}

    def __call__(self, place):
        name, offset, length = place
        if name not in self.files:
            self.files[name] = (self.folder / name).read_bytes()
        return self.files[name][offset : offset + length]


def raw_image(stamp, rgb, width, height, encoding):
    lines = numpy.frombuffer(rgb, dtype=numpy.uint8).reshape(height, width, 3)
    if encoding == "bgr8":
        lines = lines[:, :, ::-1]
    elif encoding == "mono8":
        lines = lines.astype(numpy.uint16).sum(axis=2).astype(numpy.float64) / 3
        lines = lines.round().astype(numpy.uint8)
    lines = lines.reshape(height, -1)
    padded = numpy.full((height, lines.shape[1] + PADDING), 255, dtype=numpy.uint8)
    padded[:, : lines.shape[1]] = lines
    return of("sensor_msgs/Image")(
        header=header(stamp, "camera"),
        height=height,
        width=width,
        encoding=encoding,
        is_bigendian=0,
        step=padded.shape[1],
        data=padded.reshape(-1),
    )


def file_image(stamp, data, kind):
    data = numpy.frombuffer(data, dtype=numpy.uint8)
    return of("sensor_msgs/CompressedImage")(header=header(stamp, "camera"), format=kind, data=data)


def odometry(stamp, x, y, heading):
    none = numpy.zeros(36)
    at = of("geometry_msgs/PoseWithCovariance")(pose=pose(x, y, heading), covariance=none)
    moves = of("geometry_msgs/TwistWithCovariance")(twist=twist(0.0, 0.0), covariance=none)
    return of("nav_msgs/Odometry")(header=header(stamp, "odom"), child_frame_id="base_link", pose=at, twist=moves)


def transforms(stamp, x, y, heading):
    def stamped(parent, child, moved):
        return of("geometry_msgs/TransformStamped")(header=header(stamp, parent), child_frame_id=child, transform=moved)

    transform = of("geometry_msgs/Transform")
    lens = transform(translation=vector(0.1, 0.0, 0.5), rotation=quaternion(0.0))
    robot = transform(translation=vector(x, y, 0.0), rotation=quaternion(heading))
    return of("tf2_msgs/TFMessage")(
        transforms=[stamped("base_link", "camera", lens), stamped("odom", "base_link", robot)]
    )


def scan(stamp, ranges):
    return of("sensor_msgs/LaserScan")(
        header=header(stamp, "base_link"),
        angle_min=-math.pi,
        angle_max=math.pi,
        angle_increment=2 * math.pi / len(ranges),
        time_increment=0.0,
        scan_time=0.0,
        range_min=0.05,
        range_max=10.0,
        ranges=numpy.array(ranges, dtype=numpy.float32),
        intensities=numpy.zeros(0, dtype=numpy.float32),
    )


def messages(frame, pixels):
    """What is recorded with one frame: (topic, type, logged at, message)."""
    stamp, width, height = frame["stamp_ns"], frame["width"], frame["height"]
    seen = stamp + LATENCY_NS
    image, file = "sensor_msgs/Image", "sensor_msgs/CompressedImage"
    rgb = pixels(frame["rgb"])
    yield "/camera/image_raw", image, seen, raw_image(stamp, rgb, width, height, "bgr8")
    yield "/camera/mono", image, seen, raw_image(stamp, rgb, width, height, "mono8")
    yield "/camera/image_raw/compressed", file, seen, file_image(stamp, pixels(frame["jpeg"]), "bgr8; jpeg compressed")
    yield "/camera/lossless", file, seen, file_image(stamp, pixels(frame["png"]), "png")
    for at, x, y, heading in frame["odometry"]:
        yield "/odom", "nav_msgs/Odometry", at, odometry(at, x, y, heading)
        yield "/tf", "tf2_msgs/TFMessage", at, transforms(at, x, y, heading)
    at = of("geometry_msgs/PoseStamped")(header=header(stamp, "map"), pose=pose(*frame["pose"]))
    yield "/mocap", "geometry_msgs/PoseStamped", stamp, at
    yield "/scan", "sensor_msgs/LaserScan", stamp, scan(stamp, frame["scan"])
    for name in frame["marks"]:
        yield "/adagio/mark", "std_msgs/String", stamp, of("std_msgs/String")(data=name)
    yield "/docked", "std_msgs/Bool", stamp, of("std_msgs/Bool")(data=frame["docked"])
    yield "/charge", "std_msgs/Float32", stamp, of("std_msgs/Float32")(data=0.5 if frame["docked"] else -0.25)
    if frame["command"] is not None:
        told = twist(*frame["command"])
        yield "/cmd_vel", "geometry_msgs/Twist", stamp, told
        stamped = of("geometry_msgs/TwistStamped")(header=header(stamp, ""), twist=told)
        yield "/cmd_vel_stamped", "geometry_msgs/TwistStamped", seen, stamped
    if frame["next_action"] is not None:
        yield "/action", "std_msgs/Int32", stamp, of("std_msgs/Int32")(data=frame["next_action"])
        name = ["forward", "left", "right"][frame["next_action"]]
        yield "/action_name", "std_msgs/String", stamp, of("std_msgs/String")(data=name)


def main():
    parser = argparse.ArgumentParser(description="Write a bag with rosbags.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("bag", type=Path)
    parser.add_argument("--only", metavar="TOPICS")
    arguments = parser.parse_args()
    only = arguments.only.split(",") if arguments.only else None
    frames = json.loads((arguments.folder / "frames.json").read_text())
    pixels = Pixels(arguments.folder)
    recorded = [
        message for frame in frames for message in messages(frame, pixels) if only is None or message[0] in only
    ]
    recorded.sort(key=lambda message: message[2])
    with Writer(arguments.bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {}
        for topic, kind, at, message in recorded:
            name = kind.replace("/", "/msg/")
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, name, typestore=store)
            writer.write(connections[topic], at, store.serialize_cdr(message, name))


if __name__ == "__main__":
    main()
