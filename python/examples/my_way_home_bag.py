"""ViZDoom's "My Way Home", learned from a bag of random actions, and then three places in it as goals.

    pip install vizdoom gymnasium rosbags
    python my_way_home_bag.py --steps 40000 --seed 1 --out runs/doom-bag-1

Macro-actions and maze are those of my_way_home.py. The actions are random ones, ahead as often as both turns together; what the
camera saw, which action began when, and where the player was go into a ROS 2 bag, which `adagio replay` learns from as from any
other program's. Where the player was is for rewards and for judging, never for features. Then the policy of each place drives
from the game's own starts, for 2 100 tics at most, and learns nothing more; prints a line of JSON for each place.
"""

import json
import math
import os
import subprocess
from pathlib import Path

import numpy as np
from curve import options
from my_way_home import AHEAD, LEFT, RIGHT, TURN, UNITS, MyWayHome
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from vizdoom import GameVariable

import adagio

# Metres: the middles of the room in the west, a dead end, and of the southernmost one. The vest is where the game rewards.
PLACES = {"west": (240 / UNITS, -176 / UNITS), "south": (504 / UNITS, -624 / UNITS)}
RADIUS = 1.0
ACTION_NS = 5 * 10**8  # images are as far apart, whatever the game's clock says
PAUSE_NS = 10**10  # between episodes
NAMES = {AHEAD: "forward", LEFT: "left", RIGHT: "right"}  # of actions in bags
SCENARIO = f"""
name = "my way home"
[robot]
body = "program"
pose = "known"
action_seconds = {ACTION_NS / 1e9}
[topics]
action = "/action"
[[action]]
name = "forward"
forward = {45 / UNITS}
[[action]]
name = "left"
turn_deg = {TURN}
inverse = "right"
[[action]]
name = "right"
turn_deg = {-TURN}
inverse = "left"
[[task]]
name = "vest"
reward = "topic"
topic = "/vest"
"""
GOAL = """
[[task]]
name = "{}"
goal = [{}, {}]
radius = {}
"""

store = get_typestore(Stores.ROS2_HUMBLE)


def of(name, **fields):
    package, kind = name.split("/")
    return store.types[f"{package}/msg/{kind}"](**fields)


class Recorder:
    """A bag of images, poses, names of actions and rewards."""

    def __init__(self, path):
        self.writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
        self.writer.open()
        kinds = {"/camera/image_raw": "sensor_msgs/Image", "/pose": "geometry_msgs/PoseStamped", "/action": "std_msgs/String",
                 "/vest": "std_msgs/Float64"}
        self.topics = {topic: (self.writer.add_connection(topic, kind.replace("/", "/msg/"), typestore=store), kind)
                       for topic, kind in kinds.items()}

    def write(self, topic, stamp, **fields):
        connection, kind = self.topics[topic]
        message = store.serialize_cdr(of(kind, **fields), connection.msgtype)
        self.writer.write(connection, stamp, message)

    def header(self, stamp, frame):
        time = of("builtin_interfaces/Time", sec=stamp // 10**9, nanosec=stamp % 10**9)
        return of("std_msgs/Header", stamp=time, frame_id=frame)

    def see(self, stamp, picture, pose):
        x, y, heading = pose
        at = of("geometry_msgs/Point", x=x, y=y, z=0.0)
        turned = of("geometry_msgs/Quaternion", x=0.0, y=0.0, z=math.sin(heading / 2), w=math.cos(heading / 2))
        self.write("/pose", stamp, header=self.header(stamp, "map"),
                   pose=of("geometry_msgs/Pose", position=at, orientation=turned))
        height, width, _ = picture.shape
        self.write("/camera/image_raw", stamp, header=self.header(stamp, "camera"), height=height, width=width,
                   encoding="rgb8", is_bigendian=0, step=3 * width, data=picture.reshape(-1))


def pose_of(game):
    x, y, angle = (game.get_game_variable(v) for v in (GameVariable.POSITION_X, GameVariable.POSITION_Y, GameVariable.ANGLE))
    return x / UNITS, y / UNITS, math.radians(angle)


def record(env, path, steps, seed):
    """A bag of random actions; how many episodes there were, and how often the vest was met."""
    recorder, draw, stamp = Recorder(path), np.random.default_rng(seed), 10**9
    picture, _ = env.reset(seed=seed)
    recorder.see(stamp, picture, pose_of(env.game))
    episodes = met = 0
    for _ in range(steps):
        action = AHEAD if draw.random() < 0.5 else int(draw.choice([LEFT, RIGHT]))
        recorder.write("/action", stamp + 1, data=NAMES[action])
        picture, reward, arrived, over, _ = env.step(action)
        stamp += ACTION_NS
        recorder.write("/vest", stamp, data=reward)
        recorder.see(stamp, picture, pose_of(env.game))
        if arrived or over:
            picture, _ = env.reset()
            episodes, met, stamp = episodes + 1, met + arrived, stamp + PAUSE_NS
            recorder.see(stamp, picture, pose_of(env.game))
    recorder.writer.close()
    return episodes, met


def trial(env, policy, goal):
    """The actions to a goal from a start of the game; None: it does not arrive. Without a goal, the game says so."""
    picture, _ = env.reset()
    policy.reset()
    blocked, actions = False, 0
    while True:
        action = policy.act(picture, blocked=blocked)
        picture, _, arrived, over, info = env.step((AHEAD, LEFT, RIGHT)[action])
        blocked, actions = info["blocked"], actions + 1
        if goal:
            arrived = math.dist(pose_of(env.game)[:2], goal) <= RADIUS
        if arrived or over:
            return actions if arrived else None


def main():
    parser = options(__doc__, 40_000, "random actions")
    parser.set_defaults(out="my-way-home-bag")
    parser.add_argument("--no-places", action="store_true", help="without a memory of where the player may be")
    given = parser.parse_args()
    out = Path(given.out)
    out.mkdir(parents=True)
    env = MyWayHome()
    episodes, met = record(env, out / "bag", given.steps, given.seed)
    goals = [GOAL.format(name, *at, RADIUS) for name, at in PLACES.items()]
    (out / "scenario.toml").write_text(SCENARIO + "".join(goals))
    program = os.environ.get("ADAGIO_PROGRAM", "adagio")
    sets = [f"seed={given.seed}", f"actions={given.steps}", f"value.places={str(not given.no_places).lower()}"]
    command = [program, "replay", out / "bag", "--scenario", out / "scenario.toml", "--no-evaluate", "--out", out / "run"]
    subprocess.run([*map(str, command), *(part for key in sets for part in ("--set", key))], check=True)
    run = adagio.open(out / "run")
    env.reset(seed=given.seed + 1)
    for name in ("vest", *PLACES):
        policy = run.policy(name)
        taken = [trial(env, policy, PLACES.get(name)) for _ in range(given.trials)]
        arrived = [actions for actions in taken if actions is not None]
        print(json.dumps({"goal": name, "episodes": episodes, "vest_met": met, "success": len(arrived) / len(taken),
                          "mean_actions": float(np.mean(arrived or [0]))}), flush=True)


if __name__ == "__main__":
    main()
