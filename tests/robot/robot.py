"""The parts that the test robots share: a rectangular room, a robot that moves in it, and its ROS 2 topics.

Coordinates follow REP-103: metres and radians, x forward, y left, heading counter-clockwise.
The map frame has its origin in one corner of the room; the odom frame has it where the robot started.
"""

import array
import json
import math
import signal
import threading
import time

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped, Twist, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image, LaserScan

COMMAND_TIMEOUT = 0.5  # s of simulated time, as in ros2_controllers' diff_drive
MAX_SPEED, MAX_TURN = 0.5, 2.0  # m/s, rad/s: limits of nav2's velocity_smoother
ACCELERATION, TURN_ACCELERATION = 3.0, 3.5  # m/s², rad/s²: the same
SCAN_ANGLES = np.linspace(-math.pi, math.pi, 180, endpoint=False)


class Room:
    """A rectangle with one corner at the origin; walls are 0: x = width, 1: y = depth, 2: x = 0, 3: y = 0."""

    def __init__(self, width, depth):
        self.width, self.depth = width, depth

    def cast(self, x, y, angles):
        """Distance to the wall along each angle of the map frame, and the wall that is hit."""
        c, s = np.cos(angles), np.sin(angles)
        with np.errstate(divide="ignore"):
            to_x = np.where(c > 0, self.width - x, x) / np.abs(c)
            to_y = np.where(s > 0, self.depth - y, y) / np.abs(s)
        wall = np.where(to_x < to_y, np.where(c > 0, 0, 2), np.where(s > 0, 1, 3))
        return np.minimum(to_x, to_y), wall

    def clearance(self, x, y):
        return min(x, self.width - x, y, self.depth - y)


class Robot:
    """A disc with two driven wheels. Walls stop it; it can still turn there."""

    RADIUS = 0.25  # m
    STEP = 0.02  # s of simulated time: the motion is integrated at 50 Hz

    def __init__(self, room, seed, start=None):
        self.room = room
        self.rng = np.random.default_rng(seed)
        self.x, self.y, self.heading = start or (room.width / 2, room.depth / 2, 0.0)
        self.v = self.w = 0.0
        self.blocked = False
        self.odom = [0.0, 0.0, 0.0]
        # Wheels of a size and distance a little other than the odometry assumes.
        self.scale_v, self.scale_w = 1 + self.rng.normal(0, 0.01, 2)

    def step(self, target_v, target_w):
        """Moves for one STEP towards the commanded velocities."""
        self.accelerate(target_v, target_w)
        turn = self.w * self.STEP
        x = self.x + self.v * self.STEP * math.cos(self.heading + turn / 2)
        y = self.y + self.v * self.STEP * math.sin(self.heading + turn / 2)
        self.blocked = self.room.clearance(x, y) < self.RADIUS
        if self.blocked:
            self.v = 0.0
        else:
            self.x, self.y = x, y
        self.heading = math.remainder(self.heading + turn, math.tau)
        self.count(self.v * self.STEP, turn)

    def put(self, x, y, heading):
        """Carries it somewhere; its odometry begins anew there."""
        self.x, self.y, self.heading = x, y, heading
        self.v = self.w = 0.0
        self.odom = [0.0, 0.0, 0.0]

    def accelerate(self, target_v, target_w):
        most_v, most_w = ACCELERATION * self.STEP, TURN_ACCELERATION * self.STEP
        self.v += float(np.clip(target_v - self.v, -most_v, most_v))
        self.w += float(np.clip(target_w - self.w, -most_w, most_w))

    def count(self, forward, turn):
        """Odometry: adds an executed motion, with the errors of the wheels and 2 % of noise."""
        forward, turn = (forward * self.scale_v + self.rng.normal(0, 0.02 * abs(forward)),
                         turn * self.scale_w + self.rng.normal(0, 0.02 * abs(turn) + 0.002 * abs(forward)))
        self.odom[0] += forward * math.cos(self.odom[2] + turn / 2)
        self.odom[1] += forward * math.sin(self.odom[2] + turn / 2)
        self.odom[2] = math.remainder(self.odom[2] + turn, math.tau)

    def clearance(self):
        """Metres to the nearest wall; None where it is not known."""
        return self.room.clearance(self.x, self.y) - self.RADIUS


class Link(Node):
    """Topics of a robot. Commands are received in a thread of their own, so that their times are true."""

    def __init__(self, name, robot, stamped=False, record=None, on_command=None):
        super().__init__(name)
        self.robot = robot
        self.clock_publisher = self.create_publisher(Clock, "/clock", 10)
        self.image_publisher = self.create_publisher(Image, "/camera/image_raw", qos_profile_sensor_data)
        self.odom_publisher = self.create_publisher(Odometry, "/odom", 10)
        self.pose_publisher = self.create_publisher(PoseStamped, "/pose", 10)
        self.scan_publisher = self.create_publisher(LaserScan, "/scan", qos_profile_sensor_data)
        self.stamped, self.on_command = stamped, on_command
        self.create_subscription(TwistStamped if stamped else Twist, "/cmd_vel", self.receive, 10)
        if robot.put:
            self.create_subscription(PoseStamped, "/set_pose", self.receive_pose, 10)
        self.put = None  # where it is to be carried in the next step: x, y, heading
        self.now = 0.0  # simulated seconds
        self.command = (0.0, 0.0)
        self.command_time = -math.inf
        self.commands = 0
        self.ended = threading.Event()  # set by a signal, or by the program when it is done
        self.record = open(record, "w", buffering=1) if record else None
        self.executor_of_commands = SingleThreadedExecutor()
        self.executor_of_commands.add_node(self)
        self.thread = threading.Thread(target=self.spin, daemon=True)
        self.thread.start()

    def spin(self):
        try:
            self.executor_of_commands.spin()
        except ExternalShutdownException:
            pass

    def receive(self, message):
        received = time.monotonic()  # CLOCK_MONOTONIC, comparable between processes
        twist = message.twist if self.stamped else message
        v, w = twist.linear.x, twist.angular.z
        self.commands += 1
        if self.record:
            robot, line = self.robot, {"steady": received, "sim": round(self.now, 3), "v": v, "w": w}
            if self.stamped:
                line["stamp"] = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
            line.update(x=robot.x, y=robot.y, heading=robot.heading, true_v=robot.v, true_w=robot.w,
                        clearance=robot.clearance(), blocked=robot.blocked)
            self.record.write(json.dumps(line) + "\n")
        if self.on_command:
            self.on_command(received, v, w)
        if math.isfinite(v) and math.isfinite(w):
            self.command = (float(np.clip(v, -MAX_SPEED, MAX_SPEED)), float(np.clip(w, -MAX_TURN, MAX_TURN)))
            self.command_time = self.now

    def receive_pose(self, message):
        pose = message.pose
        self.put = (pose.position.x, pose.position.y, 2 * math.atan2(pose.orientation.z, pose.orientation.w))

    def target(self):
        """The velocities to drive at now: those of the last command, or zero after COMMAND_TIMEOUT."""
        return self.command if self.now - self.command_time < COMMAND_TIMEOUT else (0.0, 0.0)

    def publish_clock(self):
        message = Clock()
        message.clock.sec, message.clock.nanosec = seconds(self.now)
        self.clock_publisher.publish(message)

    def image(self, pixels):
        """The message for an array of height × width × 3 bytes."""
        message = Image(height=pixels.shape[0], width=pixels.shape[1], encoding="rgb8", step=3 * pixels.shape[1])
        self.stamp(message, "camera")
        message.data = array.array("B", pixels.tobytes())  # any other type is checked byte by byte, which is slow
        return message

    def publish_image(self, message):
        if self.record:
            stamp = [message.header.stamp.sec, message.header.stamp.nanosec]
            self.record.write(json.dumps({"steady": time.monotonic(), "image": stamp}) + "\n")
        self.image_publisher.publish(message)

    def odometry(self):
        message = Odometry(child_frame_id="base_link")
        self.stamp(message, "odom")
        set_pose(message.pose.pose, *self.robot.odom)
        message.twist.twist.linear.x = self.robot.v * self.robot.scale_v
        message.twist.twist.angular.z = self.robot.w * self.robot.scale_w
        return message

    def pose(self):
        message = PoseStamped()
        self.stamp(message, "map")
        set_pose(message.pose, self.robot.x, self.robot.y, self.robot.heading)
        return message

    def scan(self):
        robot = self.robot
        ranges, _ = robot.room.cast(robot.x, robot.y, robot.heading + SCAN_ANGLES)
        message = LaserScan(angle_min=-math.pi, angle_max=float(SCAN_ANGLES[-1]), range_min=0.1, range_max=10.0)
        self.stamp(message, "base_link")
        message.angle_increment = math.tau / len(SCAN_ANGLES)
        message.ranges = array.array("f", ranges.astype(np.float32).tobytes())
        return message

    def stamp(self, message, frame):
        message.header.frame_id = frame
        message.header.stamp.sec, message.header.stamp.nanosec = seconds(self.now)


def seconds(t):
    """A time as whole seconds and nanoseconds."""
    return divmod(round(t * 1e9), 1_000_000_000)


def set_pose(pose, x, y, heading):
    pose.position.x, pose.position.y = x, y
    pose.orientation.z, pose.orientation.w = math.sin(heading / 2), math.cos(heading / 2)


def steps(link, speed, duration):
    """Yields the number of each step of the robot at its time, with `speed` simulated seconds a second.

    Ends after `duration` simulated seconds (None: never), on SIGTERM or SIGINT, or when link.ended is set. A late step is not made up for:
    simulated time then runs slower. The last line printed has the speed that was reached.
    """
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: link.ended.set())
    begin = due = time.monotonic()
    cpu = time.process_time()
    step = 0
    while not link.ended.is_set() and (duration is None or step * link.robot.STEP < duration):
        step += 1
        link.now = step * link.robot.STEP
        if link.put:
            link.robot.put(*link.put)
            link.put = None
        yield step
        due = max(due + link.robot.STEP / speed, time.monotonic() - 0.1)
        time.sleep(max(0.0, due - time.monotonic()))
    wall = time.monotonic() - begin
    print(json.dumps({"simulated_s": round(link.now, 2), "real_s": round(wall, 2), "speed": round(link.now / wall, 2),
                      "commands": link.commands, "cpu": round((time.process_time() - cpu) / wall, 2)}), flush=True)


def start_ros():
    """Starts rclpy and leaves the signals to `steps`."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)


def stop_ros(link):
    link.executor_of_commands.shutdown()
    link.thread.join()  # else rclpy may abort the process
    link.destroy_node()
    rclpy.try_shutdown()


def room_options(parser):
    parser.add_argument("--width", type=float, default=4.0, help="of the room, m")
    parser.add_argument("--depth", type=float, default=3.0, help="of the room, m")


def common_options(parser):
    parser.add_argument("--stamped", action="store_true", help="take /cmd_vel as TwistStamped (default: Twist)")
    parser.add_argument("--record", metavar="FILE", help="write each image and command with its time and true pose (JSONL)")
    parser.add_argument("--seed", type=int, default=0)
