"""Trials on a robot that is being driven: from drawn starts to goals, judged by the simulator's own pose.

    python trials.py --trials 200 --after 15000 --low 0.3 0.3 --high 3.7 2.7

When the run has done --after actions, it is paused, the robot is put somewhere (/set_pose, which bridge.py has), and the run is
sent to each of its goals in turn (/adagio/goto); learning goes on meanwhile. A trial is won if the run says that it has arrived within --limit
seconds of simulated time and the robot's true place is within the goal then. At the end the run is stopped. Prints one line of JSON
for each trial, and one for each goal; exits with 1 unless all trials were done.
"""

import argparse
import json
import math
import sys
import time

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Bool, Empty, String
from visualization_msgs.msg import Marker, MarkerArray

OUTSIDE = 0.1  # m: starts are at least so far outside of the goal


class Judge(Node):
    def __init__(self, patience):
        super().__init__("judge")
        self.patience = patience
        self.run, self.actions, self.told = None, 0, 0
        self.goals, self.place, self.now = {}, None, 0.0
        self.create_subscription(DiagnosticArray, "/diagnostics", self.hear_diagnostics, 10)
        self.create_subscription(MarkerArray, "/adagio/markers", self.hear_markers, 10)
        # The newest alone: a simulator that is ahead of real time says more than anyone needs.
        newest = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        self.create_subscription(PoseStamped, "/pose", self.hear_pose, newest)
        self.put = self.create_publisher(PoseStamped, "/set_pose", 10)
        self.pause = self.create_publisher(Bool, "/adagio/pause", 10)
        self.go_on = self.create_publisher(Empty, "/adagio/go_on", 10)
        self.goto = self.create_publisher(String, "/adagio/goto", 10)
        self.stop = self.create_publisher(Empty, "/adagio/stop", 10)

    def hear_diagnostics(self, message):
        for part in message.status:
            if part.name == "/adagio: run":
                self.run, self.told = part.message, self.told + 1
                self.actions = int(next(value.value for value in part.values if value.key == "actions"))

    def hear_markers(self, message):
        goals = [marker for marker in message.markers if marker.ns == "goals"]
        for circle, name in zip(goals[::2], goals[1::2]):
            assert (circle.type, name.type) == (Marker.CYLINDER, Marker.TEXT_VIEW_FACING)
            self.goals[name.text] = (circle.pose.position.x, circle.pose.position.y, circle.scale.x / 2)

    def hear_pose(self, message):
        self.place = (message.pose.position.x, message.pose.position.y)
        self.now = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec

    def from_goal(self, place, task):
        x, y, radius = self.goals[task]
        return math.hypot(place[0] - x, place[1] - y) - radius

    def wait(self, what, until, meanwhile=None, patience=None):
        """Until a condition holds; `meanwhile` is done twice a second."""
        begun, done = time.monotonic(), -math.inf
        while not until():
            if time.monotonic() > begun + (patience or self.patience):
                print(json.dumps({"waited_for": what, "run": self.run, "actions": self.actions}), flush=True)
                sys.exit(1)
            if meanwhile and time.monotonic() > done + 0.5:
                meanwhile()
                done = time.monotonic()
            rclpy.spin_once(self, timeout_sec=0.05)
            time.sleep(0.01)

    def tellings(self, count):
        """A condition: the run has told of itself so many times from now on."""
        told = self.told + count
        return lambda: self.told >= told

    def trial(self, task, start, limit):
        self.wait("a pause", lambda: self.run == "paused", lambda: self.pause.publish(Bool(data=True)))
        pose = PoseStamped()
        pose.pose.position.x, pose.pose.position.y = start[:2]
        pose.pose.orientation.z, pose.pose.orientation.w = math.sin(start[2] / 2), math.cos(start[2] / 2)
        near = lambda: math.dist(self.place, start[:2]) < 0.01
        self.wait("the robot to be there", near, lambda: self.put.publish(pose))
        # What was done before the pause is told by then.
        self.wait("the run to tell of itself", self.tellings(2))
        actions, begun = self.actions, self.now
        self.goto.publish(String(data=task))
        self.go_on.publish(Empty())
        arrived = lambda: self.run == "paused" and self.actions > actions
        self.wait("the end of a trial", lambda: arrived() or self.now > begun + limit)
        won = arrived() and self.from_goal(self.place, task) <= 0
        return {"task": task, "start": [round(of, 3) for of in start], "won": won, "actions": self.actions - actions,
                "seconds": round(self.now - begun, 1), "from_goal": round(self.from_goal(self.place, task), 3)}


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--trials", type=int, default=200, help="for each goal (200)")
    parser.add_argument("--after", type=int, default=15000, help="actions before the first one (15000)")
    parser.add_argument("--low", type=float, nargs=2, required=True, metavar=("X", "Y"), help="corner of the floor where starts are")
    parser.add_argument("--high", type=float, nargs=2, required=True, metavar=("X", "Y"), help="the other corner")
    parser.add_argument("--limit", type=float, default=120.0, help="s of simulated time for a trial (120)")
    parser.add_argument("--patience", type=float, default=60.0, help="s to wait for an answer (60)")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    rclpy.init()
    judge = Judge(options.patience)
    judge.wait("the run", lambda: judge.actions >= options.after and judge.goals and judge.place, patience=1e6)
    results = []
    for _ in range(options.trials):
        for task in sorted(judge.goals):
            start = None
            while start is None or judge.from_goal(start, task) < OUTSIDE:
                start = (*rng.uniform(options.low, options.high), rng.uniform(-math.pi, math.pi))
            results.append(judge.trial(task, start, options.limit))
            print(json.dumps(results[-1]), flush=True)
    judge.wait("the end of the run", judge.tellings(1), lambda: judge.stop.publish(Empty()))
    for task in sorted(judge.goals):
        of = [result for result in results if result["task"] == task]
        won = [result["actions"] for result in of if result["won"]]
        print(json.dumps({"task": task, "trials": len(of), "won": len(won), "share": len(won) / len(of),
                          "mean_actions": round(sum(won) / max(1, len(won)), 2)}), flush=True)


if __name__ == "__main__":
    main()
