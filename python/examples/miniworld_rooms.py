"""MiniWorld's rooms as they are shipped, but for the box, which stays where it is.

    pip install miniworld gymnasium
    python miniworld_rooms.py --world OneRoom --steps 50000 --seed 1 --out runs/one-room-1

As shipped the red box is somewhere else in each episode: then there is no place to learn the way to, and a method that learns
places cannot learn it. Macro-actions are three of MiniWorld's steps each (45 degrees, 0.45 m); images between are observed. At each
quarter of the environment's steps, and at their end, the agent is sent to the box from MiniWorld's own random starts; prints a
line of JSON for each. Renders in software (EGL).
"""

import argparse
import json

import pyglet

pyglet.options["headless"] = True  # EGL; must come before the import of miniworld

import gymnasium
import miniworld  # registers its worlds
import numpy as np
from miniworld.entity import Box

from adagio.gym import Loop

BOXES = {"OneRoom": (7.5, 0, 7.5), "FourRooms": (4.0, 0, 4.0), "Hallway": (10.0, 0, 0.0)}  # m; y is up
REPEAT = 3
ACTIONS = [
    {"name": "left", "action": 0, "repeat": REPEAT, "turn_deg": 15.0 * REPEAT, "inverse": "right"},
    {"name": "right", "action": 1, "repeat": REPEAT, "turn_deg": -15.0 * REPEAT, "inverse": "left"},
    {"name": "ahead", "action": 2, "repeat": REPEAT, "forward": 0.15 * REPEAT},
]


class SameBox(gymnasium.Wrapper):
    """The box stays; `info` says whether the last action moved the agent."""

    def __init__(self, world):
        super().__init__(gymnasium.make(f"MiniWorld-{world}-v0", window_width=80, window_height=60).unwrapped)
        place = self.env.place_entity

        def place_entity(entity, **arguments):
            return place(entity, **({"pos": np.array(BOXES[world])} if isinstance(entity, Box) else arguments))

        self.env.place_entity = place_entity

    def step(self, action):
        before = (*self.env.agent.pos, self.env.agent.dir)
        observation, reward, terminated, truncated, info = self.env.step(action)
        info["blocked"] = np.allclose(before, (*self.env.agent.pos, self.env.agent.dir))
        return observation, reward, terminated, truncated, info


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--world", choices=BOXES, default="OneRoom")
    parser.add_argument("--steps", type=int, default=50_000, help="of the environment, without those of trials (50 000)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--trials", type=int, default=100, help="at each quarter (100)")
    parser.add_argument("--out", help="folder of the run")
    options = parser.parse_args()
    env = SameBox(options.world)
    actions = options.steps // REPEAT
    most = actions + 4 * options.trials * env.unwrapped.max_episode_steps // REPEAT
    # As many frames as an action has, and as long as its way is.
    loop = Loop(env, action=ACTIONS, blocked=lambda _, __, info: info["blocked"], actions=most, seed=options.seed,
                out=options.out, robot={"frames_per_action": REPEAT, "forward": 0.15 * REPEAT})
    loop.reset(options.seed)
    boxes = trials = 0
    for quarter in range(1, 5):
        while loop.steps - trials < actions * quarter // 4:
            boxes += loop.step()[1] > 0
        before = loop.steps
        results = loop.trials(options.trials)
        trials += loop.steps - before
        arrived = [steps for arrives, steps in results if arrives]
        print(json.dumps({"steps": REPEAT * (loop.steps - trials), "steps_of_trials": REPEAT * trials, "boxes_met": boxes,
                          "success": len(arrived) / len(results), "mean_actions": float(np.mean(arrived or [0]))}), flush=True)
    loop.agent.close()


if __name__ == "__main__":
    main()
