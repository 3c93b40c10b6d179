"""Calls that are wrong, drawn from a seed; each must raise an Exception. For test_agent.py.

    bad_calls.py FOLDER CALLS [SEED]

Prints how many calls of what raised which exceptions; exit code 1 where one did not.
"""

import collections
import random
import shutil
import sys
import threading
import time
from pathlib import Path

import gymnasium
import numpy as np
from rings import Ring, agent_of, drive

import adagio
import adagio.gym

HUGE = np.broadcast_to(np.uint8(7), (1 << 20, 1 << 20, 3))
IMAGES = {
    "None": None,
    "text": "image",
    "number": 3,
    "list": [[[1, 2, 3]]],
    "float64": np.zeros((20, 40, 3)),
    "float32": np.full((20, 40, 3), np.nan, np.float32),
    "int8": np.zeros((20, 40, 3), np.int8),
    "uint16": np.zeros((20, 40, 3), np.uint16),
    "bool": np.zeros((20, 40, 3), bool),
    "objects": np.full((20, 40, 3), None, object),
    "no dimension": np.uint8(1),
    "one number": np.array(1, np.uint8),
    "a line": np.zeros(40, np.uint8),
    "four channels": np.zeros((20, 40, 4), np.uint8),
    "two channels": np.zeros((20, 40, 2), np.uint8)[::-1],
    "channels first": np.zeros((3, 20, 40), np.uint8),
    "five dimensions": np.zeros((1, 1, 20, 40, 3), np.uint8),
    "no lines": np.zeros((0, 40, 3), np.uint8),
    "no columns": np.zeros((20, 0, 3), np.uint8)[:, ::-1],
    "too small": np.zeros((20, 40, 3), np.uint8)[::-2, ::-2],
    "huge": HUGE,
    "huge, upside down": HUGE[::-1],
    "long": HUGE[0],
}
NAN, INF = float("nan"), float("inf")
REWARDS = [NAN, -INF, "much", [], [1.0, 2.0], {"nope": 1.0}, {"goal": NAN}, {3: 1.0}, 1 + 2j, object(), np.ones(2)]
POSES = [5, (1, 2), (1, 2, 3, 4), (NAN, 0, 0), (0, INF, 0), ("a", "b", "c"), np.ones((3, 2)), {}, (None,) * 3, 10**400]
TRUTHS = [np.ones(2), np.zeros((2, 2), bool)]
NAMES = [None, 3, b"goal", "nope", "forget nope", "\ud800", "goal\0", ["goal"], NAN, "x" * 100_000]
PATHS = [None, 3, 1.5, [], "nowhere", "no\0where", Path("/"), Path("/dev/null"), __file__, "\ud800", object()]
SETTINGS = [
    {"nope": 1},
    {"seed": -1},
    {"seed": 1.5},
    {"seed": None},
    {"actions": 0},
    {"actions": 10**18},
    {"actions": "many"},
    {"name": "\ud800"},
    {"robot": 3},
    {"robot": {"body": "disc"}},
    {"robot": {"nope": 1}},
    {"task": 3},
    {"task": []},
    {"task": [{"name": "a", "reward": "topic"}] * 2},
    {"task": [{"name": "a"}]},
    {"action": [{"name": "a"}] * 2},
    {"action": [{"name": "a", "inverse": "b"}]},
    {"action": [{"name": f"a{number}"} for number in range(40)]},
    {"action": "ab"},
    {"value": {"gamma": NAN}},
    {"value": {"gamma": 2.0}},
    {"value": {"gamma": "\n"}},
    {"value": np.ones((2, 2))},
    {"vision": {"width": -1}},
    {"vision": {"width": 10**30}},
    {"vision": {"width": 1024, "height": 1024}, "dictionary": {"budget": 20_000}},
    {"dictionary": {"budget": 10**9}},
    {"log": {"budget_mb": INF}},
    {"a b": 1},
    {"x\n[robot]\ny": 1},
    {1: 2},
    {"seed": object()},
    {"out": 3},
    {"out": "\0"},
    {"out": "/dev/null/run"},
    {"scenario": "nowhere.toml"},
    {"scenario": "/"},
    {"scenario": __file__},
    {"scenario": 3},
]


class World(gymnasium.Env):
    """An environment that does one thing wrong."""

    def __init__(self, **wrong):
        self.action_space = wrong.pop("space", gymnasium.spaces.Discrete(3))
        self.begin = wrong.pop("begin", (np.zeros((20, 40, 3), np.uint8), {}))
        self.came = wrong.pop("came", (np.zeros((20, 40, 3), np.uint8), 0.0, False, False, {}))

    def reset(self, seed=None):
        return self.begin

    def step(self, action):
        return self.came


GOOD = np.zeros((20, 40, 3), np.uint8)
LOOPS = [
    (None, {}),
    (3, {}),
    (World(space=gymnasium.spaces.Box(0, 1)), {}),
    (World(space=gymnasium.spaces.MultiBinary(2)), {}),
    (World(space=gymnasium.spaces.Discrete(40)), {}),
    (World(space=None), {}),
    (World(begin=None), {}),
    (World(begin=(None, {})), {}),
    (World(begin=(np.zeros(3), {})), {}),
    (World(came=None), {}),
    (World(came=(None, 0.0, False, False, {})), {}),
    (World(came=(GOOD, None, False, False, {})), {}),
    (World(came=(GOOD, NAN, False, False, {})), {}),
    (World(came=(GOOD, 0.0, np.ones(2), False, {})), {}),
    (World(came=(GOOD, 0.0, False)), {}),
    (World(), {"steps": "many"}),
    (World(), {"steps": NAN}),
    (World(), {"steps": 1.5}),
    (World(), {"steps": -3}),
    (World(), {"action": 3}),
    (World(), {"action": []}),
    (World(), {"action": [3]}),
    (World(), {"action": ["a", "a"]}),
    (World(), {"action": ["a", "b", "c", "d"]}),
    (World(), {"action": [{"name": "a", "action": -1}, "b"]}),
    (World(), {"action": [{"name": "a", "action": 0.5}, "b"]}),
    (World(), {"action": [{"name": "a", "repeat": 0}, "b"]}),
    (World(), {"action": [{"name": "a", "repeat": None}, "b"]}),
    (World(), {"agent": 3}),
    (World(), {"blocked": 3}),
    (World(), {"blocked": lambda *_: np.ones(2)}),
    (World(), {"image": 3}),
    (World(), {"image": lambda observation: observation.astype(float)}),
    (World(), {"on_step": 3}),
    (World(), {"nope": 3}),
]


def main():
    folder, calls = Path(sys.argv[1]), int(sys.argv[2])
    seed = int(sys.argv[3]) if len(sys.argv) > 3 else 0
    dice = random.Random(seed)
    ring = Ring(3)
    live = agent_of(ring, folder / "live", actions=10**6)
    live.act(ring.picture)
    closed = agent_of(ring, folder / "closed", actions=1000)
    drive(closed, ring, 700)
    closed.close()
    run = adagio.open(closed.run)
    policy = run.policy("goal")
    empty = agent_of(ring, folder / "empty")
    empty.act(ring.picture)
    empty.close()
    without_model = adagio.open(empty.run)

    def image():
        name = dice.choice(list(IMAGES))
        return name, IMAGES[name]

    def in_act():
        """Calls while another thread is in one, which takes some time; the first of them that is not refused."""
        slow = agent_of(ring, folder / "new", robot={"action_seconds": 0.8}, agent={"speed": 1.0})
        slow.act(ring.picture)
        acting = threading.Thread(target=slow.act, args=(ring.picture,))
        acting.start()
        time.sleep(0.1)
        calls = {
            "act": lambda: slow.act(ring.picture),
            "observe": lambda: slow.observe(ring.picture),
            "mark": lambda: slow.mark("goal"),
            "goto": lambda: slow.goto("goal"),
            "close": slow.close,
        }
        ended = {name: attempt(call) for name, call in calls.items()}
        acting.join()
        slow.close()
        return next(((n, e) for n, e in ended.items() if type(e) is not RuntimeError), ("close", ended["close"]))

    def with_settings():
        settings = dice.choice(SETTINGS)
        out = folder / "new"
        return repr(settings), attempt(lambda: adagio.Agent(**{"out": out, "action": ring.actions, **settings}))

    def with_loop():
        env, settings = dice.choice(LOOPS)
        out = folder / "loop"
        ended = attempt(lambda: adagio.gym.run(env, **{"steps": 20, "out": out, **settings}))
        return f"{env} {settings}", ended

    def one_of(of, call):
        value = dice.choice(of)
        return repr(value)[:60], attempt(lambda: call(value))

    def with_image(call):
        name, value = image()
        return name, attempt(lambda: call(value))

    def after_close():
        names = ["act", "observe", "mark", "goto"]
        name = dice.choice(names)
        value = ring.picture if name in names[:2] else "goal"
        return name, attempt(lambda: getattr(closed, name)(value))

    def without():
        name = dice.choice(["features", "q_values", "model", "policy"])
        calls = {
            "features": lambda: without_model.features(ring.picture),
            "q_values": lambda: without_model.q_values(ring.picture, "goal"),
            "model": lambda: without_model.model,
            "policy": lambda: without_model.policy("goal"),
        }
        return name, attempt(calls[name])

    tasks = [*NAMES, 99, -1, 2**70]
    kinds = {
        "act image": (6, lambda: with_image(live.act)),
        "act reward": (3, lambda: one_of(REWARDS, lambda of: live.act(ring.picture, reward=of))),
        "act pose": (3, lambda: one_of(POSES, lambda of: live.act(ring.picture, pose=of))),
        "act blocked": (1, lambda: one_of(TRUTHS, lambda of: live.act(ring.picture, blocked=of))),
        "act done": (1, lambda: one_of(TRUTHS, lambda of: live.act(ring.picture, done=of))),
        "act unknown": (1, lambda: one_of(["x", "dones"], lambda of: live.act(ring.picture, **{of: 1}))),
        "observe image": (3, lambda: with_image(live.observe)),
        "observe pose": (2, lambda: one_of(POSES, lambda of: live.observe(ring.picture, pose=of))),
        "mark": (2, lambda: one_of([*NAMES, "", "goal"], live.mark)),
        "goto": (2, lambda: one_of(NAMES[1:], live.goto)),
        "settings": (6, with_settings),
        "resume": (2, lambda: one_of(PATHS, adagio.Agent.resume)),
        "open": (2, lambda: one_of(PATHS, adagio.open)),
        "features": (4, lambda: with_image(run.features)),
        "features of a list": (2, lambda: with_image(lambda of: run.features([ring.picture, of]))),
        "q_values image": (2, lambda: with_image(lambda of: run.q_values(of, "goal"))),
        "q_values task": (2, lambda: one_of(tasks, lambda of: run.q_values(ring.picture, of))),
        "policy": (2, lambda: one_of(tasks, run.policy)),
        "policy image": (2, lambda: with_image(policy.act)),
        "policy odometry": (2, lambda: one_of(POSES, lambda of: policy.act(ring.picture, odometry=of))),
        "policy blocked": (1, lambda: one_of(TRUTHS, lambda of: policy.act(ring.picture, blocked=of))),
        "tables": (1, lambda: one_of(["x", 3, None, b"pose"], lambda of: run.frames[of])),
        "without a model": (1, without),
        "gym": (6, with_loop),
        "after close": (2, after_close),
        "from another thread": (0.5, in_act),
    }
    raised, quiet = collections.defaultdict(collections.Counter), []
    names, weights = list(kinds), [weight for weight, _ in kinds.values()]
    for call in range(calls):
        name = dice.choices(names, weights)[0]
        print(f"\r{call} {name}", end="", file=sys.stderr, flush=True)
        begin = time.monotonic()
        what, ended = kinds[name][1]()
        if not isinstance(ended, Exception) or time.monotonic() - begin > 10:
            quiet.append(f"{name}: {what[:200]}: {ended!r} after {time.monotonic() - begin:.1f} s")
        raised[name][type(ended).__name__] += 1
        for made in (folder / "new", folder / "loop"):
            shutil.rmtree(made, ignore_errors=True)
    for name, counts in raised.items():
        print(f"{name}: {', '.join(f'{count} {kind}' for kind, count in counts.items())}")
    live.act(ring.picture)
    report = live.close()
    print(f"{report['run']['actions']} actions of the run that went on")
    print(*sorted(set(quiet)), sep="\n")
    sys.exit(bool(quiet))


def attempt(call):
    """What a call has raised."""
    try:
        return call()
    except BaseException as ended:  # a panic is no Exception
        return ended


if __name__ == "__main__":
    main()
