"""For tests. A world: random pictures in a ring, and an agent that goes round; the program, and other processes."""

import json
import os
import signal
import subprocess
import sys
import textwrap
from contextlib import contextmanager
from pathlib import Path

import numpy as np

import adagio

HERE = Path(__file__).parent
PLACES = 24
GOAL = 0


class Ring:
    """Places in a ring, with a picture each; an action goes on by some places."""

    def __init__(self, n_actions, seed=0):
        draw = np.random.default_rng(seed)
        self.pictures = draw.integers(0, 256, (PLACES, 20, 40, 3), dtype=np.uint8)
        self.moves = [(1 + number // 2) * (-1) ** number for number in range(n_actions)]
        self.starts = np.random.default_rng(seed + 1)
        self.reset()

    @property
    def actions(self):
        listed = [{"name": f"by {move}"} for move in self.moves]
        for move, action in zip(self.moves, listed):
            if -move in self.moves:
                action["inverse"] = f"by {-move}"
        return listed

    def reset(self):
        self.at = int(self.starts.integers(GOAL + 1, PLACES))
        return self.picture

    def step(self, action):
        """The reward of an action."""
        self.at = (self.at + self.moves[action]) % PLACES
        return float(self.at == GOAL)

    @property
    def picture(self):
        return self.pictures[self.at]

    def shortest(self):
        """Actions of the shortest way from here."""
        reached, n = {self.at}, 0
        while GOAL not in reached:
            reached, n = {(at + move) % PLACES for at in reached for move in self.moves}, n + 1
        return n


def agent_of(ring, out, **settings):
    """An agent that soon acts on what it has learned."""
    defaults = {"action": ring.actions, "actions": 2000, "policy": {"explore_share": 0.2, "pursue_share": 0.5}}
    return adagio.Agent(out=out, **{**defaults, **settings})


def drive(agent, ring, actions):
    """Episodes until the run is over or some actions are done; how many there were."""
    action = agent.act(ring.reset(), reset=True)
    done = 0
    try:
        while done < actions:
            reward = ring.step(action)
            done += 1
            action = agent.act(ring.picture, reward=reward, done=reward > 0)
            if reward > 0:
                action = agent.act(ring.reset())
    except adagio.RunOver:
        pass
    return done


def program(*arguments):
    """What the program ``adagio`` prints; it must succeed."""
    built = HERE.parents[1] / "target" / "release" / "adagio"
    path = os.environ.get("ADAGIO_PROGRAM", built)
    assert Path(path).is_file(), f"{path} is missing: cargo build --release, or ADAGIO_PROGRAM"
    done = subprocess.run([path, *map(str, arguments)], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, f"adagio {arguments}: {done.stdout}{done.stderr}"
    return done.stdout


def script(text, *arguments, **options):
    """A Python process that runs a text."""
    command = [sys.executable, "-c", textwrap.dedent(text), *map(str, arguments)]
    return subprocess.Popen(command, cwd=HERE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options)


def finished(process, seconds=60):
    """What it has printed; it must end well, and in time."""
    printed, errors = process.communicate(timeout=seconds)
    assert process.returncode == 0, errors
    return printed


def replayed_digest(run):
    """The digest of a run that its log repeats bit for bit."""
    printed = program("replay", run, "--verify")
    return printed.split("digest ")[1].split()[0]


def report_of(run):
    return json.loads((Path(run) / "report.json").read_text())


@contextmanager
def dask_that_loses_a_worker():
    """An engine of two Dask workers, one of which is killed while it works."""
    from distributed import Client, LocalCluster  # it takes a second, which scripts need not wait

    with (
        LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None, host="127.0.0.1") as cluster,
        Client(cluster) as client,
    ):
        workers = [int(pid) for pid in client.run(os.getpid).values()]

        class Engine:
            killed = False

            def submit(self, function, *arguments):
                future = client.submit(function, *arguments)
                if not self.killed:
                    self.killed = True
                    os.kill(workers[0], signal.SIGKILL)
                return future

        engine = Engine()
        yield engine
        assert engine.killed
