"""From image to command: how long after the image that ends an action the robot has its next velocity.

    python latency.py COMMANDS RUN

COMMANDS is what a robot of these tests wrote with --record, RUN the folder of the run that drove it. Both times are the robot's: when it began to
publish the image that a decision was made on, and when it received the first velocity after that that is not zero. Needs mcap-ros2-support.
Prints one line of JSON for each tenth of the decisions, and one for all.
"""

import json
import sys
from bisect import bisect_left
from pathlib import Path

from mcap_ros2.reader import read_ros2_messages


def percentile(values, share):
    return round(1000 * sorted(values)[min(len(values) - 1, int(share * len(values)))], 1)


def main(commands, run):
    images, driven = {}, []
    for line in map(json.loads, open(commands)):
        if "image" in line:
            images.setdefault(tuple(line["image"]), line["steady"])
        elif line["v"] or line["w"]:
            driven.append(line["steady"])
    waits, lost = [], 0
    for log in sorted(Path(run).glob("run_*.mcap")):
        for message in read_ros2_messages(log, topics=["/adagio/decision"]):
            stamp = message.ros_msg.header.stamp
            taken = images.get((stamp.sec, stamp.nanosec))
            after = bisect_left(driven, taken) if taken is not None else len(driven)
            if after < len(driven):
                waits.append(driven[after] - taken)
            else:
                lost += 1
    if not waits:
        sys.exit(f"no decision of {run} was made on an image of {commands}")
    parts = [waits[len(waits) * i // 10 : len(waits) * (i + 1) // 10] for i in range(10)]
    for part in [*filter(None, parts), waits]:
        print(json.dumps({"decisions": len(part), "median_ms": percentile(part, 0.5), "p99_ms": percentile(part, 0.99),
                          "most_ms": percentile(part, 1.0)}))
    if lost:
        print(json.dumps({"decisions_without_velocity": lost}))


if __name__ == "__main__":
    main(*sys.argv[1:])
