"""Publishes one std_msgs/Empty on a topic as soon as somebody listens: python say.py /adagio/stop"""

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
publisher.publish(Empty())
rclpy.spin_once(node, timeout_sec=1.0)
