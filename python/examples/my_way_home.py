"""ViZDoom's "My Way Home": a vest somewhere in a maze of rooms, and 17 places to start from.

    pip install vizdoom gymnasium
    python my_way_home.py --steps 25000 --seed 1 --out runs/doom-1

Macro-actions: a turn of 45 degrees (2 tics), ahead by about 0.7 m (7 tics of the key, 16 in all). The game ends an episode at the
vest, or after 2 100 tics. At each quarter of the steps, and at their end, the agent is sent to the vest from the game's own
starts; prints a line of JSON for each.
"""

import math
import tempfile
from pathlib import Path

import gymnasium
import numpy as np
import vizdoom
from curve import curve, most, options
from vizdoom import Button, GameVariable

from adagio.gym import Loop

LEFT, RIGHT, AHEAD = range(3)
TURN = 45  # degrees
KEY_TICS, AHEAD_TICS, TURN_TICS = 7, 16, 2
UNITS = 64  # of the map in a metre
BLOCKED = 20  # units: less than that is no way for 16 tics
SHAPE = (120, 160, 3)
ACTIONS = [
    {"name": "left", "turn_deg": TURN, "inverse": "right"},
    {"name": "right", "turn_deg": -TURN, "inverse": "left"},
    {"name": "ahead", "forward": 45 / UNITS},
]


class Doom(gymnasium.Env):
    """A game with macro-actions. The reward is 1 for what it rewards; `info` says whether the player was stopped by a wall."""

    action_space = gymnasium.spaces.Discrete(len(ACTIONS))
    observation_space = gymnasium.spaces.Box(0, 255, SHAPE, np.uint8)

    def __init__(self):
        self.game = game = vizdoom.DoomGame()
        self.load(game)
        game.set_doom_config_path(str(Path(tempfile.mkdtemp()) / "vizdoom.ini"))  # else it goes to the current folder
        game.set_window_visible(False)
        game.set_screen_resolution(vizdoom.ScreenResolution.RES_160X120)
        game.set_screen_format(vizdoom.ScreenFormat.RGB24)
        game.set_render_hud(False)
        game.set_render_weapon(False)
        game.set_render_crosshair(False)
        game.set_available_buttons([Button.MOVE_FORWARD, Button.TURN_LEFT_RIGHT_DELTA])
        game.init()
        self.picture = np.zeros(SHAPE, np.uint8)

    def load(self, game):
        """Tell the game what is to be played, before it begins."""
        raise NotImplementedError

    def see(self):
        if state := self.game.get_state():  # there is none behind an episode's end
            self.picture = np.ascontiguousarray(state.screen_buffer)
        return self.picture

    def place(self):
        return [self.game.get_game_variable(of) for of in (GameVariable.POSITION_X, GameVariable.POSITION_Y)]

    def reset(self, *, seed=None, options=None):
        if seed is not None:
            self.game.set_seed(seed)
        self.game.new_episode()
        return self.see(), {}

    def step(self, action):
        before, reward = self.place(), 0.0
        for tic in range(AHEAD_TICS if action == AHEAD else TURN_TICS):
            if self.game.is_episode_finished():
                break
            key = action == AHEAD and tic < KEY_TICS
            turn = {LEFT: -TURN, RIGHT: TURN}.get(action, 0) if tic == 0 else 0
            reward += self.game.make_action([int(key), turn])
        arrived, over = reward > 0.5, self.game.is_episode_finished()
        stopped = action == AHEAD and not over and math.dist(self.place(), before) < BLOCKED
        return self.see(), float(arrived), arrived, over and not arrived, {"blocked": stopped}


class MyWayHome(Doom):
    def load(self, game):
        game.load_config(str(Path(vizdoom.scenarios_path) / "my_way_home.cfg"))


def main():
    parser = options(__doc__, 100_000)
    parser.add_argument("--no-places", action="store_true", help="without a memory of where the player may be")
    given = parser.parse_args()
    loop = Loop(MyWayHome(), action=ACTIONS, blocked=lambda _, __, info: info["blocked"], seed=given.seed, out=given.out,
                actions=most(given.steps, given.trials, 2100 // TURN_TICS), value={"places": not given.no_places})
    loop.reset(given.seed)
    curve(loop, given.steps, given.trials)


if __name__ == "__main__":
    main()
