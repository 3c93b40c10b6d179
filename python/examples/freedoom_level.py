"""A level of Freedoom, MAP01 of freedoom2.wad, which ViZDoom brings along: made by artists, and ten places in it as goals.

    pip install vizdoom gymnasium
    python freedoom_level.py --steps 40000 --seed 1 --out runs/freedoom-1

There are no monsters, and no door is opened: three halls, 73 square metres of floor. Macro-actions are those of my_way_home.py.
One continuous run without episodes. The engine's pose of the player is for rewards and for judging, never for features. At each
quarter of the steps, and at their end, the agent is sent to each place: it is put where it has been before, at least two radii
away, and has 100 actions; prints a line of JSON. To be put elsewhere is a gap for slow features, and no action.
"""

import json
import math
from pathlib import Path

import numpy as np
import vizdoom
from curve import most, options
from my_way_home import ACTIONS, TURN, UNITS, Doom
from vizdoom import GameVariable

from adagio.gym import Loop

WAD = str(Path(vizdoom.__file__).parent / "freedoom2.wad")
# Map units. Found by a flood from the level's start: in each cell of 32 × 32 units, ahead in eight headings from where it was
# reached first, until there were no new cells (293). The first place is drawn of them (numpy.random.default_rng(1)), each other
# is the one that is farthest from those before.
PLACES = [(301, -240), (-208, 4), (408, 240), (688, -124), (-48, -259),
          (84, -16), (453, -24), (550, -304), (274, 70), (-224, -189)]
RADIUS = 1.0  # m
MOST = 100  # actions of a trial
REST = 4  # tics behind a warp


class Level(Doom):
    """The level. It has neither rewards nor ends; `info` has the player's pose, metres and radians."""

    def load(self, game):
        game.set_doom_game_path(WAD)
        game.set_doom_scenario_path(WAD)
        game.set_doom_map("MAP01")
        game.add_game_args("-nomonsters +sv_cheats 1")  # cheats are for warps
        game.set_episode_timeout(0)  # none

    def pose(self):
        x, y = self.place()
        return x / UNITS, y / UNITS, math.radians(self.game.get_game_variable(GameVariable.ANGLE))

    def warp(self, x, y, turns):
        """Put the player elsewhere, in whole map units, and turn it; says whether the game did, which needs free floor there."""
        self.game.send_game_command(f"warp {x} {y}")
        self.game.make_action([0, turns * TURN])
        self.game.make_action([0, 0], REST)
        return math.dist(self.place(), (x, y)) < 8  # it may roll on a little

    def reset(self, *, seed=None, options=None):
        if seed is not None:
            super().reset(seed=seed)
            self.game.send_game_command("god")  # a floor that hurts would end the run
        return self.see(), {"pose": self.pose()}

    def step(self, action):
        picture, _, _, _, info = super().step(action)
        return picture, 0.0, False, False, {**info, "pose": self.pose()}


def distance(info, place):
    """Of the player to a place, metres."""
    return math.dist(info["pose"][:2], np.divide(place, UNITS))


def main():
    parser = options(__doc__, 40_000)
    parser.set_defaults(trials=10)  # for each place
    given = parser.parse_args()
    tasks = [{"name": f"place {number}", "goal": np.divide(at, UNITS), "radius": RADIUS} for number, at in enumerate(PLACES)]
    actions = most(given.steps, given.trials * len(PLACES), MOST)
    level = Level()
    # A program's robot has no pose by default, and goals by coordinates need one. Their rewards are not the environment's.
    loop = Loop(level, action=ACTIONS, blocked=lambda _, __, info: info["blocked"], pose=lambda info: info["pose"],
                reward=lambda *_: None, task=tasks, robot={"pose": "known"}, actions=actions, seed=given.seed, out=given.out)
    draw = np.random.default_rng(given.seed)
    loop.reset(given.seed)
    visited, trials = {}, 0  # the first place of the player in each cell of a quarter of a square metre
    for quarter in range(1, 5):
        while loop.steps - trials < given.steps * quarter // 4:
            x, y, _ = loop.step()[4]["pose"]
            visited.setdefault((x // 0.5, y // 0.5), (int(x * UNITS), int(y * UNITS)))
        before, results = loop.steps, []
        for task, goal in zip(tasks, PLACES):
            far = [at for at in visited.values() if math.dist(at, goal) > 2 * RADIUS * UNITS]
            starts = far or list(visited.values())  # after few steps there may be none

            def begin(_):
                while not level.warp(*starts[draw.integers(len(starts))], int(draw.integers(360 // TURN))):
                    pass  # a place that was rounded into a wall

            results.append(loop.trials(given.trials, task["name"], most=MOST, reset=begin,
                                       there=lambda info: distance(info, goal) <= RADIUS))
        trials += loop.steps - before
        arrived = [steps for of in results for arrives, steps in of if arrives]
        by_place = [sum(arrives for arrives, _ in of) / len(of) for of in results]
        print(json.dumps({"steps": loop.steps - trials, "steps_of_trials": trials, "cells_visited": len(visited),
                          "success": len(arrived) / sum(map(len, results)), "mean_steps": float(np.mean(arrived or [0])),
                          "success_of_each": by_place}), flush=True)
    loop.agent.close()


if __name__ == "__main__":
    main()
