"""A robot over ROS 2 whose sensors fail at seeded moments, and a judge of what its driver does then.

    python faulty.py --faults 20 --seed 1 --kinds camera_stop,odom_stop,twice,estop

The topics are those of bridge.py, in real time, with a cheaply drawn picture; and /emergency_stop (Bool, 10 Hz).
The first fault begins when the robot has been driven for 2 s; later ones also wait until the robot is driven again.
Prints one line of JSON for each fault, with times in seconds of CLOCK_MONOTONIC, and exits with 1
unless all were played and are ok. A driver that stays stopped after an emergency stop is "not driven" from then on:
give it estop in a run of its own.

With --driver, the last argument, it starts the driver itself, and the driver can be what fails:

    python faulty.py --kinds agent_stop,agent_kill --driver adagio run scenarios/ros2.toml --out RUN

disk_full fills the file system of RUN, which must be a small one of its own; network takes down the device that is
named with --network, which must lead to the driver.
"""

import argparse
import json
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from std_msgs.msg import Bool

from robot import Link, Robot, Room, common_options, room_options, seconds, start_ros, steps, stop_ros

# What each kind does, and how the driver must answer it: stand within the freshness bound, after a second of motion, or
# within the bound of the emergency stop, for as long as the fault lasts; stop within the freshness bound, and go on as it
# likes, since its sensors are good (MOMENT); go on driving (None); say nothing, so that the robot stands by its own time-out
# (SILENCE); or end with an error, after a zero (END).
FRESHNESS, MOTION, EMERGENCY, MOMENT, SILENCE, END = "freshness", "motion", "emergency", "moment", "silence", "end"
KINDS = {
    "camera_stop": (FRESHNESS, "no images"),
    "camera_freeze": (MOTION, "the same pixels with new stamps"),
    "camera_late": (FRESHNESS, "images are sent 0.5 s after their stamps"),
    "camera_slightly_late": (None, "images are sent 0.1 s after their stamps"),
    "camera_size": (FRESHNESS, "images have half of their height"),
    "odom_stop": (FRESHNESS, "no odometry"),
    "scan_stop": (FRESHNESS, "no scans; only for a driver that uses them"),
    "nan": (FRESHNESS, "odometry has NaN for x and for the forward speed"),
    "stamp_jump": (MOMENT, "stamps of images and odometry are 10 s off, forward or backward by the seed"),
    "pause": (FRESHNESS, "no message on any topic, /clock included; the robot moves on"),
    "estop": (EMERGENCY, "/emergency_stop is true"),
    "out_of_order": (None, "the first image of the fault is sent after the second"),
    "twice": (None, "each image and each odometry is sent twice"),
    "network": (SILENCE, "10 s without a network"),
    "agent_stop": (SILENCE, "the driver's process is stopped"),
    "agent_kill": (SILENCE, "the driver's process is killed, and resumed afterwards"),
    "disk_full": (END, "the driver's log cannot grow; there is room again, and the run is resumed, when it has ended"),
}
DRIVER_KINDS = ["agent_stop", "agent_kill", "disk_full"]
DEFAULT_KINDS = [kind for kind in KINDS if kind not in ("scan_stop", "network", *DRIVER_KINDS)]
NORMAL = 2.0  # s between faults
LATE = {"camera_late": 0.5, "camera_slightly_late": 0.1}  # s
MOTION_BOUND = (0.1, 0.19)  # m, rad: motion with frozen pixels
MOTION_SECONDS = 1.0  # the longest that such a motion takes a robot that is driven
STAND_BOUND = 1.3  # s: the base's own time-out, and the time to brake
END_BOUND = 30.0  # s until a driver whose disk is full has ended
EMERGENCY_BOUND = 0.1  # s
COLOURS = np.array([[200, 60, 50], [70, 170, 60], [50, 90, 200], [210, 180, 50]])  # of the walls, in Room's order


class Camera:
    """Draws four walls of different colours, with stripes and darker with distance; 75 degrees wide."""

    def __init__(self, width, height):
        self.focal = width / 2 / math.tan(math.radians(75 / 2))
        self.columns = np.arctan((width / 2 - 0.5 - np.arange(width)) / self.focal)
        self.rows = (np.arange(height) + 0.5 - height / 2)[:, None]

    def draw(self, robot):
        angles = robot.heading + self.columns
        distance, wall = robot.room.cast(robot.x, robot.y, angles)
        along = np.where(wall % 2 == 0, robot.y + distance * np.sin(angles), robot.x + distance * np.cos(angles))
        light = (0.8 + 0.2 * np.sin(along * 20)) / (1 + 0.2 * distance)
        height = self.focal / (distance * np.cos(self.columns))  # of one metre, in pixels
        walls = (COLOURS[wall] * light[:, None]).astype(np.uint8)
        pixels = np.repeat(walls[None], len(self.rows), axis=0)
        pixels[self.rows < -1.0 * height] = (220, 220, 220)  # the ceiling is 1 m above the camera
        pixels[self.rows > 0.4 * height] = (90, 90, 95)  # the floor 0.4 m below it
        return pixels


class Driver:
    """The program that drives the robot, in a process of its own."""

    def __init__(self, command):
        self.program, self.run = command[0], command[command.index("--out") + 1] if "--out" in command else None
        self.process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        self.filler = None

    def signal(self, number):
        self.process.send_signal(number)

    def resume(self):
        self.process.wait()
        self.process = subprocess.Popen([self.program, "resume", self.run], stdout=subprocess.DEVNULL)

    def ended(self):
        return self.process.poll() is not None

    def fill_disk(self):
        self.filler = Path(self.run).parent / "filler"
        with open(self.filler, "wb", buffering=0) as filler:
            for size in (1 << 20, 1 << 12):
                try:
                    while filler.write(bytes(size)):
                        pass
                except OSError:
                    pass

    def begin(self, kind):
        {"agent_stop": lambda: self.signal(signal.SIGSTOP), "agent_kill": lambda: self.signal(signal.SIGKILL),
         "disk_full": self.fill_disk}[kind]()

    def end(self, kind):
        if self.filler:
            self.filler.unlink()
            self.filler = None
        if kind == "agent_stop":
            self.signal(signal.SIGCONT)
        else:
            self.resume()

    def close(self):
        """Ends it as Ctrl-C would; its exit code."""
        self.signal(signal.SIGINT)
        return self.process.wait(60)


class Fault:
    """One fault: what happens, for how long, and when the driver must have stopped."""

    def __init__(self, kind, rng):
        self.kind = kind
        self.answer = KINDS[kind][0]
        self.lead = rng.uniform(0, 0.5)  # s of normal driving before it, on top of NORMAL
        self.duration = rng.uniform(0.5, 2.0)
        if self.answer == MOTION:
            self.duration += MOTION_SECONDS  # else it could end before anyone has to notice it
        elif self.answer is None:
            self.duration += 1.0  # else it could lie between two actions
        elif self.answer == SILENCE:
            self.duration = 10.0 if kind == "network" else self.duration + STAND_BOUND
        elif self.answer == END:
            self.duration = END_BOUND  # or until it has ended
        self.jump = float(rng.choice((-10.0, 10.0)))  # s, of stamp_jump
        self.begin = self.due = self.end = None  # steady times
        self.images, self.place, self.stands, self.kept = 0, None, False, None


class Judge:
    """Plays the faults one after the other and judges the commands that were received meanwhile."""

    def __init__(self, options, robot, driver):
        rng = np.random.default_rng(options.seed)
        kinds = [options.kinds[i % len(options.kinds)] for i in range(options.faults)]
        self.plan = [Fault(kind, rng) for kind in rng.permutation(kinds).tolist()]
        self.options, self.robot, self.driver = options, robot, driver
        self.commands = []  # (steady receive time, whether it is zero), appended by the thread that receives
        self.fault = None  # the one that happens now
        self.all_ok, self.over = True, False

    def on_command(self, received, v, w):
        self.commands.append((received, v == 0.0 and w == 0.0))

    def driven(self):
        return bool(self.commands) and not self.commands[-1][1] and time.monotonic() - self.commands[-1][0] < 0.2

    def play(self):
        """Goes through the plan; call next() once a step."""
        while not self.plan:
            self.over = True  # whenever it is ended
            yield
        for number, fault in enumerate(self.plan):
            patient_until = time.monotonic() + self.options.patience
            while not self.driven():
                if time.monotonic() > patient_until:
                    print(json.dumps({"ok": False, "not_driven": True, "not_played": len(self.plan) - number}))
                    return
                yield
            normal_until = time.monotonic() + fault.lead + NORMAL * (number == 0)
            while time.monotonic() < normal_until:
                yield
            fault.begin = time.monotonic()
            bounds = {MOTION: MOTION_SECONDS, EMERGENCY: EMERGENCY_BOUND, SILENCE: self.options.margin, END: END_BOUND}
            bound = bounds.get(fault.answer, self.options.freshness + self.options.margin)
            fault.due = math.inf if fault.answer == MOTION else fault.begin + bound
            self.fault = fault
            self.change(fault.kind, begins=True)
            while time.monotonic() < fault.begin + fault.duration:
                robot = self.robot
                moves = abs(robot.v) > 0.02 or abs(robot.w) > 0.05
                if fault.kept and not fault.place:  # the first of the same pictures was sent
                    fault.place = (robot.x, robot.y, robot.heading)
                if fault.due == math.inf and fault.place:
                    x, y, heading = fault.place
                    moved = (math.dist((robot.x, robot.y), (x, y)), abs(math.remainder(robot.heading - heading, math.tau)))
                    if any(of > bound for of, bound in zip(moved, MOTION_BOUND)):
                        fault.due = time.monotonic() + self.options.freshness + self.options.margin
                if fault.answer == END and self.driver.ended():
                    break
                yield
            fault.stands = not moves
            self.fault, fault.end = None, time.monotonic()
            self.change(fault.kind, begins=False)
            while time.monotonic() < fault.end + NORMAL:
                yield
            while time.monotonic() < fault.end + self.options.patience and not self.driven():
                yield
            self.judge(fault, bound)
        self.over = True

    def change(self, kind, begins):
        """What is done to the driver or to the network when a fault begins or ends."""
        if kind in DRIVER_KINDS:
            (self.driver.begin if begins else self.driver.end)(kind)
        elif kind == "network":
            subprocess.run(["ip", "link", "set", self.options.network, "down" if begins else "up"], check=True)

    def judge(self, fault, bound):
        during = [(t, zero) for t, zero in self.commands if fault.begin <= t <= fault.end]
        zeros = [t for t, zero in during if zero]
        late = sum(not zero and t > fault.due for t, zero in during)
        resumed = next((t - fault.end for t, zero in self.commands if t > fault.end and not zero), None)
        if fault.answer == MOMENT:
            late = int(not any(t <= fault.due for t in zeros))
        told = bool(zeros) or fault.due == math.inf
        if fault.answer in (SILENCE, END):
            told = fault.stands if fault.answer == SILENCE else bool(during) and during[-1][1]
        ok = resumed is not None and (late == 0 and told if fault.answer else late > 0)
        self.all_ok &= ok
        print(json.dumps({
            "kind": fault.kind, "stop_expected": fault.answer is not None, "begin": round(fault.begin, 3),
            "end": round(fault.end, 3), "bound": bound,
            "first_zero_after": round(zeros[0] - fault.begin, 3) if zeros else None,
            "violations": late if fault.answer else 0,
            "resumed_after": None if resumed is None else round(resumed, 3), "ok": ok}), flush=True)


class FaultyLink(Link):
    """Sends what the fault of the moment leaves of the messages."""

    def __init__(self, robot, judge, options):
        super().__init__("faulty_robot", robot, options.stamped, options.record, judge.on_command)
        self.judge = judge
        self.emergency_publisher = self.create_publisher(Bool, "/emergency_stop", 10)
        self.late = []  # (step in which to send it, message)
        self.steps = 0

    def kind(self):
        return self.judge.fault.kind if self.judge.fault else None

    def send_image(self, message):
        fault, kind = self.judge.fault, self.kind()
        if kind in ("camera_stop", "pause"):
            return
        if fault:
            fault.images += 1
        if kind == "camera_freeze":
            fault.kept = fault.kept or message
            message.data = fault.kept.data
        elif kind == "camera_size":
            message.height //= 2
            message.data = message.data[:message.step * message.height]
        elif kind == "out_of_order" and fault.images == 1:
            fault.kept = message
            return
        self.move_stamp(message)
        if kind in LATE:
            self.late.append((self.steps + round(LATE[kind] / self.robot.STEP), message))
            return
        self.publish_image(message)
        if kind == "twice":
            self.publish_image(message)
        elif kind == "out_of_order" and fault.images == 2:
            self.publish_image(fault.kept)

    def send_late_images(self):
        self.steps += 1
        if self.kind() not in LATE:
            self.late.clear()  # those that are still under way when the fault ends are lost
        while self.late and self.late[0][0] <= self.steps:
            self.publish_image(self.late.pop(0)[1])

    def send_odometry(self, message):
        kind = self.kind()
        if kind in ("odom_stop", "pause"):
            return
        if kind == "nan":
            message.pose.pose.position.x = message.twist.twist.linear.x = math.nan
        self.move_stamp(message)
        self.odom_publisher.publish(message)
        if kind == "twice":
            self.odom_publisher.publish(message)

    def move_stamp(self, message):
        if self.kind() == "stamp_jump":
            message.header.stamp.sec, message.header.stamp.nanosec = seconds(max(0.0, self.now + self.judge.fault.jump))


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    room_options(parser)
    common_options(parser)
    parser.add_argument("--camera", type=int, nargs=2, default=(64, 48), metavar=("WIDTH", "HEIGHT"), help="pixels")
    parser.add_argument("--rate", type=float, default=30.0, help="images a second (default 30, at most 50)")
    parser.add_argument("--faults", type=int, default=len(DEFAULT_KINDS), help="how many (default: each kind once; 0: drive until a signal)")
    parser.add_argument("--kinds", type=lambda text: text.split(","), default=DEFAULT_KINDS,
                        help="of " + ",".join(KINDS) + " (default: all but scan_stop)")
    parser.add_argument("--freshness", type=float, default=0.25, help="s without a fresh message allowed (0.25)")
    parser.add_argument("--margin", type=float, default=0.1, help="s allowed on top (0.1)")
    parser.add_argument("--patience", type=float, default=30.0, help="s to wait for the driver (30)")
    parser.add_argument("--network", metavar="DEVICE", help="network device, of the kind network")
    parser.add_argument("--die", action="store_true", help="at the end, be killed: nobody on the network is told")
    parser.add_argument("--driver", nargs=argparse.REMAINDER, metavar="COMMAND", help="start it; the last argument")
    options = parser.parse_args()
    if unknown := set(options.kinds) - set(KINDS):
        parser.error(f"no such kind: {', '.join(sorted(unknown))}")
    if set(options.kinds) & set(DRIVER_KINDS) and not (options.driver and "--out" in options.driver):
        parser.error(f"{', '.join(DRIVER_KINDS)} need --driver with --out")
    if "network" in options.kinds and not options.network:
        parser.error("network needs --network")
    robot = Robot(Room(options.width, options.depth), options.seed)
    camera = Camera(*options.camera)
    driver = Driver(options.driver) if options.driver else None
    judge = Judge(options, robot, driver)
    start_ros()
    link = FaultyLink(robot, judge, options)
    emergency, images, play = False, 0, judge.play()
    for step in steps(link, 1.0, None):
        if next(play, "over") == "over":
            link.ended.set()
        robot.step(*link.target())
        pause = link.kind() == "pause"
        if not pause:
            link.publish_clock()
        if step % 2 == 0:  # 25 Hz
            link.send_odometry(link.odometry())
            if not pause:
                link.pose_publisher.publish(link.pose())
        if step % 5 == 0 and not pause and link.kind() != "scan_stop":
            link.scan_publisher.publish(link.scan())
        was, emergency = emergency, link.kind() == "estop"
        if (step % 5 == 0 or emergency != was) and not pause:
            link.emergency_publisher.publish(Bool(data=emergency))
        link.send_late_images()
        if link.now * options.rate >= images:
            images = int(link.now * options.rate) + 1
            link.send_image(link.image(camera.draw(robot)))
    ended = driver.close() if driver else 0
    if options.die:
        sys.stdout.flush()
        os.kill(os.getpid(), signal.SIGKILL)
    stop_ros(link)
    sys.exit(0 if judge.over and judge.all_ok and ended == 0 else 1)


if __name__ == "__main__":
    main()
