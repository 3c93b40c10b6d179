"""Somebody beside a robot, with ROS's own tools: hears what a run publishes, and asks it for things by topics.

    python person.py --task centre

Pauses the run and lets it go on, drives by hand, sends the robot to a place that does not exist and to one that does, moves a goal, and
ends the run. Prints one line of JSON with what was heard; exits with 1 where an answer did not come within --patience.
"""

import argparse
import json
import sys
import time

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, Twist
from nav_msgs.msg import OccupancyGrid, Odometry
from rcl_interfaces.msg import Log
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Image
from std_msgs.msg import Bool, Empty, String
from visualization_msgs.msg import MarkerArray


class Person(Node):
    def __init__(self, task, patience):
        super().__init__("person")
        self.patience = patience
        self.heard, self.parts, self.said, self.way = {}, {}, [], 0.0
        self.place = None
        for kind, topic in [(Image, "/adagio/observation"), (MarkerArray, "/adagio/markers"),
                            (OccupancyGrid, f"/adagio/value/{task}"), (DiagnosticArray, "/diagnostics")]:
            self.create_subscription(kind, topic, lambda message, topic=topic: self.hear(topic, message), 10)
        self.create_subscription(Log, "/rosout", self.hear_words, 10)
        self.create_subscription(Odometry, "/odom", self.hear_odometry, qos_profile_sensor_data)
        self.say = {topic: self.create_publisher(kind, topic, 10) for kind, topic in [
            (Bool, "/adagio/pause"), (Empty, "/adagio/go_on"), (Empty, "/adagio/stop"), (String, "/adagio/goto"),
            (PoseStamped, f"/adagio/goal/{task}"), (PoseStamped, "/goal_pose"), (Twist, "/cmd_vel_teleop")]}

    def hear(self, topic, message):
        self.heard[topic] = message
        if topic == "/diagnostics":
            for part in message.status:
                if part.name.startswith("/adagio: "):
                    self.parts[part.name.removeprefix("/adagio: ")] = part.message

    def hear_words(self, message):
        if message.name.startswith("adagio"):
            self.said.append(message.msg)

    def hear_odometry(self, message):
        place = (message.pose.pose.position.x, message.pose.pose.position.y)
        if self.place:
            self.way += ((place[0] - self.place[0]) ** 2 + (place[1] - self.place[1]) ** 2) ** 0.5
        self.place = place

    def wait(self, what, until, meanwhile=None):
        """Until a condition holds; `meanwhile` is done 20 times a second."""
        patient_until = time.monotonic() + self.patience
        while not until():
            if time.monotonic() > patient_until:
                print(json.dumps({"waited_for": what, "parts": self.parts, "said": self.said[-5:],
                                  "heard": sorted(self.heard)}), flush=True)
                sys.exit(1)
            if meanwhile:
                meanwhile()
            rclpy.spin_once(self, timeout_sec=0.05)

    def rest(self, seconds):
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            rclpy.spin_once(self, timeout_sec=0.05)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--task", default="centre")
    parser.add_argument("--patience", type=float, default=40.0, help="s to wait for each answer (40)")
    options = parser.parse_args()
    rclpy.init()
    person = Person(options.task, options.patience)
    found = lambda topic: person.say[topic].get_subscription_count() > 0
    person.wait("the run", lambda: {"/adagio/observation", "/adagio/markers"} <= set(person.heard) and all(map(found, person.say)))
    person.wait("motion", lambda: person.way > 0.5)

    person.wait("a pause", lambda: person.parts.get("run") == "paused", lambda: person.say["/adagio/pause"].publish(Bool(data=True)))
    way = person.way
    person.rest(2.0)
    paused_way = person.way - way
    person.say["/adagio/go_on"].publish(Empty())
    person.wait("going on", lambda: person.way > way + 0.5)

    by_hand = Twist()
    by_hand.linear.x = 0.3
    person.wait("driving by hand", lambda: "driven by a person" in person.parts.get("robot", ""),
                lambda: person.say["/cmd_vel_teleop"].publish(by_hand))
    by_hand.linear.x, by_hand.angular.z = 0.0, 0.6
    until = time.monotonic() + 6.0
    person.wait("the end of driving by hand", lambda: time.monotonic() > until,
                lambda: person.say["/cmd_vel_teleop"].publish(by_hand))
    person.wait("letting go", lambda: "driven by a person" not in person.parts.get("robot", ""))

    person.say["/adagio/goto"].publish(String(data="nowhere"))
    person.wait("a refusal", lambda: any("nowhere" in text for text in person.said))
    goal = PoseStamped()
    goal.pose.position.x, goal.pose.position.y = 1.0, 1.0
    person.say[f"/adagio/goal/{options.task}"].publish(goal)
    person.say["/adagio/goto"].publish(String(data=options.task))
    person.rest(3.0)
    person.say["/adagio/stop"].publish(Empty())
    person.rest(1.0)
    markers = {marker.ns for marker in person.heard["/adagio/markers"].markers}
    image = person.heard["/adagio/observation"]
    print(json.dumps({"paused_way": paused_way, "parts": sorted(person.parts), "markers": sorted(markers),
                      "observation": [image.width, image.height, len(image.data)],
                      "refusal": next(text for text in person.said if "nowhere" in text)}), flush=True)


if __name__ == "__main__":
    main()
