"""A robot over ROS 2 that is ViZDoom's scenario "My Way Home", with the game's time on /clock.

    python doom.py --speed 4 --seconds 600

The topics and the end are those of bridge.py; 64 map units are one metre, and the player's radius is then 0.25 m.
The player slides along walls. When it takes the vest, the game starts again at a random place: /pose jumps, /odom
does not, and a line {"vest": simulated seconds} is printed.
"""

import argparse
import json
import math
import tempfile
from pathlib import Path

import vizdoom
from vizdoom import Button, GameVariable

from robot import Link, Robot, common_options, start_ros, steps, stop_ros

UNITS = 64  # of the map in a metre
THRUST = 32  # of MOVE_…_DELTA for one map unit a tic, measured
VARIABLES = (GameVariable.POSITION_X, GameVariable.POSITION_Y, GameVariable.ANGLE, GameVariable.VELOCITY_X,
             GameVariable.VELOCITY_Y)


class Player(Robot):
    """The player of the game, driven at a velocity against the game's momentum and friction."""

    STEP = 1 / 35  # s: one tic
    put = None  # the game puts its player where it likes

    def __init__(self, seed, resolution):
        self.game = game = vizdoom.DoomGame()
        game.load_config(str(Path(vizdoom.scenarios_path) / "my_way_home.cfg"))
        game.set_doom_config_path(str(Path(tempfile.mkdtemp()) / "vizdoom.ini"))  # else it goes to the current folder
        game.set_window_visible(False)
        game.set_screen_resolution(resolution)
        game.set_screen_format(vizdoom.ScreenFormat.RGB24)
        game.set_render_weapon(False)
        game.set_render_crosshair(False)
        game.set_available_buttons(
            [Button.MOVE_FORWARD_BACKWARD_DELTA, Button.MOVE_LEFT_RIGHT_DELTA, Button.TURN_LEFT_RIGHT_DELTA])
        game.set_episode_timeout(0)
        game.set_seed(seed)
        game.init()
        super().__init__(None, seed, self.place()[:3])
        self.vests = 0

    def place(self):
        """x, y (m), heading, and the momentum in x and y (map units a tic)."""
        x, y, angle, vx, vy = map(self.game.get_game_variable, VARIABLES)
        return x / UNITS, y / UNITS, math.remainder(math.radians(angle), math.tau), vx, vy

    def step(self, target_v, target_w):
        self.accelerate(target_v, target_w)
        x, y, heading, vx, vy = self.place()
        turn = self.w * self.STEP
        c, s = math.cos(heading + turn), math.sin(heading + turn)
        forward = self.v * self.STEP * UNITS - (vx * c + vy * s)
        right = -(vx * s - vy * c)
        # The game's turns and sideways moves are positive to the right.
        self.game.set_action([round(forward * THRUST), round(right * THRUST), -math.degrees(turn)])
        self.game.advance_action(1)  # with the picture: without it the variables are not updated
        if self.game.is_episode_finished():
            self.vests += 1
            self.game.new_episode()
            self.x, self.y, self.heading = self.place()[:3]
            return
        self.x, self.y, self.heading, *_ = self.place()
        moved = (self.x - x) * math.cos(heading + turn / 2) + (self.y - y) * math.sin(heading + turn / 2)
        self.blocked = moved < 0.5 * self.v * self.STEP
        self.count(moved, math.remainder(self.heading - heading, math.tau))

    def clearance(self):
        return None

    def picture(self):
        return self.game.get_state().screen_buffer


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    common_options(parser)
    parser.add_argument("--resolution", choices=("160X120", "320X240"), default="160X120", help="of the camera")
    parser.add_argument("--every", type=int, default=4, help="tics (of 1/35 s) from one image to the next (4)")
    parser.add_argument("--speed", type=float, default=1.0, help="times real time")
    parser.add_argument("--seconds", type=float, help="of simulated time to run (default: until a signal)")
    options = parser.parse_args()
    player = Player(options.seed, getattr(vizdoom.ScreenResolution, "RES_" + options.resolution))
    start_ros()
    link = Link("doom_robot", player, options.stamped, options.record)
    vests = 0
    for step in steps(link, options.speed, options.seconds):
        player.step(*link.target())
        if player.vests > vests:
            vests = player.vests
            print(json.dumps({"vest": round(link.now, 2)}), flush=True)
        link.publish_clock()
        link.odom_publisher.publish(link.odometry())
        link.pose_publisher.publish(link.pose())
        if step % options.every == 0:
            link.publish_image(link.image(player.picture()))
    stop_ros(link)
    player.game.close()


if __name__ == "__main__":
    main()
