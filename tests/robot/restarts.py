"""Kills the robot's program at seeded moments while it is driven, starts it again, and judges what its driver says meanwhile.

    python restarts.py --times 20 --seed 1 -- --stamped

Starts faulty.py without faults, with the options behind --, as the robot: a new one begins at the middle of the room, with a
clock and an odometry that begin at zero. The driver is started by somebody else. Zero must come within the bound after a kill, no
velocity before the new program has sent an image, and then the driver must go on.
Prints one line of JSON for each kill, and exits with 1 unless all are ok.
"""

import argparse
import json
import math
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import rclpy
from geometry_msgs.msg import Twist, TwistStamped
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node

from robot import start_ros


class Observer(Node):
    """Hears what the driver commands."""

    def __init__(self, stamped):
        super().__init__("observer")
        self.commands = []  # (steady time, whether it is zero)
        self.create_subscription(TwistStamped if stamped else Twist, "/cmd_vel", self.receive, 10)
        executor = SingleThreadedExecutor()
        executor.add_node(self)
        threading.Thread(target=self.spin, args=(executor,), daemon=True).start()

    def spin(self, executor):
        try:
            executor.spin()
        except ExternalShutdownException:
            pass

    def receive(self, message):
        twist = getattr(message, "twist", message)
        self.commands.append((time.monotonic(), twist.linear.x == 0.0 and twist.angular.z == 0.0))

    def drives(self, since):
        """The first velocity that is not zero since a time."""
        return next((at for at, zero in reversed(self.commands) if not zero and at > since), None)

    def wait_for_driving(self, since, patience):
        until = time.monotonic() + patience
        while time.monotonic() < until and not self.drives(since):
            time.sleep(0.02)
        return bool(self.drives(since))


def first_image(record):
    """When the robot's program sent its first image, on the steady clock."""
    lines = map(json.loads, record.read_text().splitlines())
    return next((line["steady"] for line in lines if "image" in line), math.inf)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--times", type=int, default=10, help="how often (10)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--bound", type=float, default=0.35, help="s until zero (0.25, and 0.1 of margin)")
    parser.add_argument("--patience", type=float, default=60.0, help="s to wait for the driver (60)")
    parser.add_argument("robot", nargs="*", help="options of faulty.py")
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    record = Path(tempfile.mkdtemp()) / "robot.jsonl"
    program = str(Path(__file__).with_name("faulty.py"))
    command = [sys.executable, program, "--faults", "0", "--record", str(record), *options.robot]
    start_ros()
    observer, all_ok = Observer("--stamped" in options.robot), True
    robot = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    try:
        for _ in range(options.times):
            if not observer.wait_for_driving(time.monotonic(), options.patience):
                print(json.dumps({"ok": False, "not_driven": True}))
                all_ok = False
                break
            time.sleep(rng.uniform(1.0, 3.0))
            observer.wait_for_driving(time.monotonic(), options.patience)
            killed = time.monotonic()
            robot.kill()
            robot.wait()
            away = rng.uniform(0.5, 8.0)
            time.sleep(away)
            started = time.monotonic()
            robot = subprocess.Popen(command, stdout=subprocess.DEVNULL)
            goes_on = observer.wait_for_driving(started, options.patience)
            sees = first_image(record)
            late = [at for at, zero in list(observer.commands) if not zero and killed + options.bound < at < sees]
            first = next((at for at, zero in list(observer.commands) if zero and at > killed), None)
            ok = goes_on and not late
            all_ok &= ok
            print(json.dumps({
                "away": round(away, 3), "zero_after": None if first is None else round(first - killed, 3), "violations": len(late),
                "goes_on_after": round(observer.drives(started) - started, 3) if goes_on else None, "ok": ok}), flush=True)
    finally:
        robot.kill()
        robot.wait()
    rclpy.try_shutdown()
    sys.exit(0 if all_ok else 1)


if __name__ == "__main__":
    main()
