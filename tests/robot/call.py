"""Calls a service of std_srvs/Trigger, with ROS's own client: python call.py /adagio/stop

Prints one line of JSON: how many of --times calls were answered, and the longest wait. Exits with 1 where one was not, within --patience.
"""

import argparse
import json
import sys
import time

import rclpy
from std_srvs.srv import Trigger

parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
parser.add_argument("service")
parser.add_argument("--times", type=int, default=1)
parser.add_argument("--fresh", action="store_true", help="a node and a client of its own for each call")
parser.add_argument("--patience", type=float, default=10.0, help="s to wait for the service, and for each answer (10)")
options = parser.parse_args()

answered, waits, node = 0, [], None
for _ in range(options.times):
    if options.fresh or not node:
        if node:
            rclpy.shutdown()
        rclpy.init()
        node = rclpy.create_node("call")
        client = node.create_client(Trigger, options.service)
        if not client.wait_for_service(timeout_sec=options.patience):
            sys.exit(f"nobody serves {options.service}")
    begun = time.monotonic()
    future = client.call_async(Trigger.Request())
    rclpy.spin_until_future_complete(node, future, timeout_sec=options.patience)
    if future.done() and future.result().success:
        answered += 1
        waits.append(time.monotonic() - begun)
print(json.dumps({"called": options.times, "answered": answered, "longest_s": max(waits, default=None)}))
sys.exit(answered != options.times)
