"""Publishes std_msgs/Empty on a topic for some seconds from when somebody listens: python say.py /adagio/stop

Once is not enough: who listens may not yet have found the publisher that has found it.
"""

import sys
import time

import rclpy
from std_msgs.msg import Empty

rclpy.init()
node = rclpy.create_node("say")
publisher = node.create_publisher(Empty, sys.argv[1], 10)
until = time.monotonic() + 20
while publisher.get_subscription_count() == 0:
    if time.monotonic() > until:
        sys.exit(f"nobody listens to {sys.argv[1]}")
    rclpy.spin_once(node, timeout_sec=0.05)
until = time.monotonic() + 3
while time.monotonic() < until:
    publisher.publish(Empty())
    rclpy.spin_once(node, timeout_sec=0.2)
