"""A robot over ROS 2 that is a MiniWorld room, with the simulator's time on /clock.

    python bridge.py --speed 4 --seconds 60 --record commands.jsonl

Publishes /camera/image_raw, /odom, /pose (the simulator's own, frame map), /clock and with --scan also /scan;
takes /cmd_vel and stops 0.5 simulated seconds after the last one, and /set_pose. Prints one line of JSON at the end.
"""

import argparse

import pyglet

pyglet.options["headless"] = True  # EGL; must come before the import of miniworld

import numpy as np
from gymnasium import spaces
from miniworld.miniworld import MiniWorldEnv, Room as MiniWorldRoom, gen_texcs_wall
from miniworld.opengl import Texture
from pyglet.gl import GL_QUADS, glBegin, glColor3f, glEnd, glNormal3f, glTexCoord2f, glVertex3f

from robot import Link, Robot, Room, common_options, room_options, start_ros, steps, stop_ros

WALLS = ("brick_wall", "slime", "water", "lava")  # at x = width, y = depth, x = 0, y = 0
FLOOR, CEILING = "asphalt", "ceiling_tiles"
CAMERA_HEIGHT, WALL_HEIGHT = 0.4, 1.5  # m; as on a small robot, so that floor and ceiling are seen too


class FourWalls(MiniWorldRoom):
    """MiniWorld's room has one texture for all walls; this one has one for each."""

    def _gen_static_data(self, params, rng):
        super()._gen_static_data(params, rng)
        self.wall_textures = [Texture.get(name) for name in WALLS]
        for i, texture in enumerate(self.wall_textures):
            length = np.linalg.norm(self.outline[(i + 1) % 4] - self.outline[i])
            self.wall_texcs[4 * i : 4 * i + 4] = gen_texcs_wall(texture, 0, 0, length, self.wall_height)

    def _render(self):
        walls, self.wall_verts = self.wall_verts, np.empty((0, 3))
        super()._render()  # floor and ceiling
        self.wall_verts = walls
        glColor3f(1, 1, 1)
        for i, texture in enumerate(self.wall_textures):
            texture.bind()
            glBegin(GL_QUADS)
            for corner in range(4 * i, 4 * i + 4):
                glNormal3f(*self.wall_norms[corner])
                glTexCoord2f(*self.wall_texcs[corner])
                glVertex3f(*walls[corner])
            glEnd()


class World(MiniWorldEnv):
    """One room and the camera. MiniWorld's floor is x and z, with z = −y of the map frame; its angles are the same."""

    def __init__(self, room, camera_width, camera_height, field_of_view):
        self.room, self.field_of_view = room, field_of_view
        # A small window: MiniWorld keeps a 16-fold multisampled frame buffer of its size.
        super().__init__(obs_width=camera_width, obs_height=camera_height, window_width=80, window_height=60)
        self.action_space = spaces.Discrete(1)

    def _gen_world(self):
        # The corners in MiniWorld's order: the walls are then those of WALLS.
        w, d = self.room.width, self.room.depth
        outline = np.array([[w, 0.0], [w, -d], [0.0, -d], [0.0, 0.0]])
        self.rooms.append(
            FourWalls(outline, floor_tex=FLOOR, ceil_tex=CEILING, wall_height=WALL_HEIGHT)
        )
        self.place_agent(pos=np.zeros(3), dir=0.0)

    def reset(self, **arguments):
        result = super().reset(**arguments)
        # After super: it sets these to MiniWorld's own values.
        self.agent.cam_height, self.agent.cam_fov_y = CAMERA_HEIGHT, self.field_of_view
        return result

    def picture(self, x, y, heading):
        self.agent.pos, self.agent.dir = np.array([x, 0.0, -y]), heading
        return self.render_obs()


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    room_options(parser)
    common_options(parser)
    parser.add_argument("--camera", type=int, nargs=2, default=(80, 60), metavar=("WIDTH", "HEIGHT"), help="pixels")
    parser.add_argument("--fov", type=float, default=60.0, help="vertical field of view, degrees")
    parser.add_argument("--rate", type=float, default=10.0, help="images per simulated second (default 10, at most 50)")
    parser.add_argument("--scan", action="store_true", help="publish /scan at 10 Hz")
    parser.add_argument("--speed", type=float, default=1.0, help="times real time")
    parser.add_argument("--seconds", type=float, help="of simulated time to run (default: until a signal)")
    parser.add_argument("--start", type=float, nargs=3, metavar=("X", "Y", "HEADING"), help="default: the middle")
    options = parser.parse_args()
    room = Room(options.width, options.depth)
    robot = Robot(room, options.seed, options.start)
    world = World(room, *options.camera, options.fov)
    start_ros()
    link = Link("miniworld_robot", robot, options.stamped, options.record)
    images = 0
    for step in steps(link, options.speed, options.seconds):
        robot.step(*link.target())
        link.publish_clock()
        if step % 2 == 0:  # 25 Hz
            link.odom_publisher.publish(link.odometry())
            link.pose_publisher.publish(link.pose())
        if options.scan and step % 5 == 0:
            link.scan_publisher.publish(link.scan())
        if link.now * options.rate >= images:
            images = int(link.now * options.rate) + 1
            link.publish_image(link.image(world.picture(robot.x, robot.y, robot.heading)))
    stop_ros(link)


if __name__ == "__main__":
    main()
