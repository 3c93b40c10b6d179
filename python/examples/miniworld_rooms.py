"""MiniWorld's rooms as they are shipped, but for the box, which stays where it is; and three own levels on its engine.

    pip install miniworld gymnasium
    python miniworld_rooms.py --world OneRoom --steps 50000 --seed 1 --out runs/one-room-1

As shipped the red box is somewhere else in each episode: then there is no place to learn the way to, and a method that learns
places cannot learn it. Macro-actions are three of MiniWorld's steps each (45 degrees, 0.45 m); images between are observed. At
each quarter of the environment's steps, and at their end, the agent is sent to the box from MiniWorld's own random starts; prints
a line of JSON for each. Renders in software (EGL).

WallGap, StarMaze and FourColoredRooms are own levels after Lange, Engelhardt, Konen and Wiskott 2024, "Interpretable
Brain-Inspired Representations Improve RL Performance on Visual Navigation Tasks": the fork of MiniWorld that the paper used is
not on the package index. Sizes, textures and the box's place are chosen here.
"""

import pyglet

pyglet.options["headless"] = True  # EGL; must come before the import of miniworld

import gymnasium
import numpy as np
from curve import curve, most, options
from miniworld import envs
from miniworld.entity import Box

from adagio.gym import Loop

REPEAT = 3
ACTIONS = [
    {"name": "left", "action": 0, "repeat": REPEAT, "turn_deg": 15.0 * REPEAT, "inverse": "right"},
    {"name": "right", "action": 1, "repeat": REPEAT, "turn_deg": -15.0 * REPEAT, "inverse": "left"},
    {"name": "ahead", "action": 2, "repeat": REPEAT, "forward": 0.15 * REPEAT},
]
TEXTURES = ["brick_wall", "wood", "slime", "metal_grill", "picket_fence"]  # of walls


class WallGap(envs.WallGap):
    """WallGap as shipped, but the agent starts in either room: two equal rooms, and a building far away, above their walls."""

    def place_agent(self, **_):
        return super().place_agent()


class FourColoredRooms(envs.FourRooms):
    """FourRooms as shipped, but the walls of each room have a texture of their own."""

    def add_rect_room(self, **sides):
        return super().add_rect_room(wall_tex=TEXTURES[len(self.rooms)], **sides)


class StarMaze(envs.FourRooms):
    """Five arms of 5 m around a pentagon, each with a wall texture of its own; actions, steps and end are those of FourRooms."""

    def _gen_world(self):
        angles = np.radians(36 - 72 * np.arange(5))  # falling: outlines are counter-clockwise from above, where z points down
        corners = 2 * np.column_stack([np.cos(angles), np.sin(angles)])
        hub = self.add_room(outline=corners)
        for edge, texture in enumerate(TEXTURES):
            start, end = corners[edge], corners[(edge + 1) % 5]
            ahead = 5 * (start + end) / np.linalg.norm(start + end)
            arm = self.add_room(outline=np.array([end, start, start + ahead, end + ahead]), wall_tex=texture)
            for room, side in (hub, edge), (arm, 0):
                room.add_portal(side, start_pos=0, end_pos=np.linalg.norm(arm.outline[1] - arm.outline[0]))
        self.box = self.place_entity(Box(color="red"))
        self.place_agent()


WORLDS = {  # level, and where its box stays, m; y is up
    "OneRoom": (envs.OneRoom, (7.5, 0, 7.5)),
    "FourRooms": (envs.FourRooms, (4.0, 0, 4.0)),
    "Hallway": (envs.Hallway, (10.0, 0, 0.0)),
    "TMaze": (envs.TMaze, (10.0, 0, -6.0)),  # the left end, as in TMazeLeft
    "Sidewalk": (envs.Sidewalk, (-1.5, 0, 11.0)),  # a step into the street ends an episode too
    "WallGap": (WallGap, (4.0, 0, -4.0)),
    "StarMaze": (StarMaze, (5.8, 0, 0.0)),
    "FourColoredRooms": (FourColoredRooms, (4.0, 0, 4.0)),
}


class SameBox(gymnasium.Wrapper):
    """The box stays; `info` says whether the last action moved the agent."""

    def __init__(self, world):
        level, box = WORLDS[world]
        super().__init__(level(window_width=80, window_height=60))
        place = self.env.place_entity

        def place_entity(entity, **arguments):
            return place(entity, **({"pos": np.array(box)} if isinstance(entity, Box) else arguments))

        self.env.place_entity = place_entity

    def step(self, action):
        before = (*self.env.agent.pos, self.env.agent.dir)
        observation, reward, terminated, truncated, info = self.env.step(action)
        info["blocked"] = np.allclose(before, (*self.env.agent.pos, self.env.agent.dir))
        return observation, reward, terminated, truncated, info


def main():
    parser = options(__doc__, 50_000, of="steps of the environment")
    parser.add_argument("--world", choices=WORLDS, default="OneRoom")
    parser.add_argument("--places", action="store_true", help="with a memory of where the agent may be")
    given = parser.parse_args()
    env = SameBox(given.world)
    actions, longest = given.steps // REPEAT, env.unwrapped.max_episode_steps // REPEAT + 1
    # As many frames as an action has, and as long as its way is.
    loop = Loop(env, action=ACTIONS, blocked=lambda _, __, info: info["blocked"], actions=most(actions, given.trials, longest),
                seed=given.seed, out=given.out, robot={"frames_per_action": REPEAT, "forward": 0.15 * REPEAT},
                value={"places": given.places})
    loop.reset(given.seed)
    curve(loop, actions, given.trials, REPEAT)


if __name__ == "__main__":
    main()
