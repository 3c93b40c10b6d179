"""A robot with inertia, wheel slip and a camera in a walled room with boxes: MuJoCo, rendered without a window.

    pip install mujoco gymnasium
    python mujoco_robot.py --steps 10000 --seed 1 --out runs/mujoco-1

Two driven wheels with motors of limited torque, and a caster. Each action is a motion of a controller that sets wheel speeds with
limited acceleration, until the body is where it should be (1 cm, 1 degree) and stands still, or 2 s are over. The goal area is a
disc that cannot be seen: the place is to be learned. At each quarter of the steps, and at their end, the agent is sent to it from
random places; prints a line of JSON for each. Renders in software (EGL).
"""

import math
import os

os.environ.setdefault("MUJOCO_GL", "egl")  # must come before the import of mujoco

import gymnasium
import mujoco
import numpy as np
from curve import curve, most, options

from adagio.gym import Loop

SHAPE = (60, 80, 3)
ACTIONS = [
    {"name": "left", "turn_deg": 45, "inverse": "right"},
    {"name": "right", "turn_deg": -45, "inverse": "left"},
    {"name": "ahead", "forward": 0.3},
]
ROOM = np.array([2.0, 1.5])  # m from the middle to the walls
BOXES = {"red": (0.5, 0.1, 0.25, 0.2), "blue": (-0.8, -0.7, 0.2, 0.2), "green": (-0.7, 1.2, 0.2, 0.3)}  # x, y, halves of sides
GOAL, GOAL_RADIUS = np.array([1.3, -0.8]), 0.4
MARGIN = 0.25  # m from walls and boxes to the middle of a robot that starts
WHEEL, HALF_TRACK = 0.06, 0.12  # m: a wheel's radius, and from the middle to it
LONGEST = 100  # actions of an episode
TICK, STEPS_PER_TICK, TIMEOUT = 0.02, 4, 2.0  # s, of the controller
# The controller's two speeds are along the heading (m/s) and of the heading (rad/s).
TOP, ACCELERATION = np.array([0.6, 2.5]), np.array([1.5, 8.0])
TOLERANCE, STILL = np.array([0.01, math.radians(1)]), np.array([0.02, 0.1])
GAIN = 8.0  # 1/s, near the end of a motion
LOOKS = {
    "floor": 'builtin="checker" rgb1=".45 .4 .35" rgb2=".55 .5 .45"',
    "east": 'builtin="checker" rgb1=".8 .7 .2" rgb2=".3 .2 .1" mark="random" markrgb="1 1 1" random=".1"',
    "west": 'builtin="gradient" rgb1=".1 .6 .7" rgb2=".9 .9 .8" mark="random" markrgb="0 .1 .3" random=".1"',
    "north": 'builtin="flat" rgb1=".7 .3 .4" mark="random" markrgb=".95 .9 .6" random=".2"',
    "south": 'builtin="flat" rgb1=".3 .5 .25" mark="random" markrgb=".1 .1 .2" random=".3"',
    "red": 'builtin="checker" rgb1=".9 .1 .1" rgb2=".5 0 0"',
    "blue": 'builtin="flat" rgb1=".1 .2 .9" mark="cross" markrgb="1 1 1"',
    "green": 'builtin="gradient" rgb1=".1 .9 .2" rgb2="0 .2 0"',
}
MATERIALS = "".join(
    f'<texture name="{of}" {look} ' + ('type="cube" width="8"/>' if of in BOXES else 'type="2d" width="44" height="18"/>')
    + f'<material name="{of}" texture="{of}" specular="0"/>' for of, look in LOOKS.items())
SOLIDS = "".join(f'<geom type="box" size="{a} {b} .35" pos="{x} {y} .35" material="{of}"/>' for of, (x, y, a, b) in BOXES.items())
TYRE = f'<geom type="cylinder" size="{WHEEL} .015" zaxis="0 1 0" mass=".2" friction="0.7"/>'
MODEL = f"""
<mujoco>
  <option timestep="{TICK / STEPS_PER_TICK}" integrator="implicitfast"/>
  <visual><quality shadowsize="0" offsamples="0"/><headlight ambient=".6 .6 .6" diffuse=".4 .4 .4" specular="0 0 0"/></visual>
  <default><geom friction="0.3"/><joint axis="0 1 0" armature=".001" damping=".005"/></default>
  <default><velocity kv=".3" forcerange="-.6 .6"/></default>
  <asset>{MATERIALS}</asset>
  <worldbody>
    <geom type="plane" size="2 1.5 1" material="floor"/>
    <geom type="plane" size="1.5 .75 1" pos="2 0 .75" xyaxes="0 -1 0 0 0 1" material="east"/>
    <geom type="plane" size="1.5 .75 1" pos="-2 0 .75" xyaxes="0 1 0 0 0 1" material="west"/>
    <geom type="plane" size="2 .75 1" pos="0 1.5 .75" xyaxes="1 0 0 0 0 1" material="north"/>
    <geom type="plane" size="2 .75 1" pos="0 -1.5 .75" xyaxes="-1 0 0 0 0 1" material="south"/>
    {SOLIDS}
    <body name="robot">
      <freejoint/>
      <geom type="cylinder" size=".17 .03" pos="0 0 .02" mass="2" rgba=".2 .2 .2 1"/>
      <geom type="box" size=".08 .05 .02" pos="-.06 0 -.02" mass="2" contype="0" conaffinity="0"/>
      <geom type="sphere" size=".02" pos="-.13 0 -.04" mass=".05" friction="0.02" priority="1"/>
      <camera name="eye" pos=".08 0 .34" xyaxes="0 -1 0 0 0 1" fovy="60"/>
      <body pos="0 {HALF_TRACK} 0"><joint name="left"/>{TYRE}</body>
      <body pos="0 -{HALF_TRACK} 0"><joint name="right"/>{TYRE}</body>
    </body>
  </worldbody>
  <actuator><velocity joint="left"/><velocity joint="right"/></actuator>
</mujoco>
"""


class Robot(gymnasium.Env):
    """Motions of the robot. The reward is 1 in the goal area; `info` says whether something stopped a motion before its half."""

    action_space = gymnasium.spaces.Discrete(len(ACTIONS))
    observation_space = gymnasium.spaces.Box(0, 255, SHAPE, np.uint8)

    def __init__(self):
        self.model = mujoco.MjModel.from_xml_string(MODEL)
        self.data = mujoco.MjData(self.model)
        self.renderer = mujoco.Renderer(self.model, *SHAPE[:2])

    def see(self):
        self.renderer.update_scene(self.data, "eye")
        return self.renderer.render()

    def pose(self):
        w, x, y, z = self.data.qpos[3:7]
        return self.data.qpos[:2].copy(), math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))

    def free(self, place):
        boxes = np.array(list(BOXES.values()))
        return math.dist(place, GOAL) > GOAL_RADIUS and (abs(place - boxes[:, :2]) > boxes[:, 2:] + MARGIN).any(axis=1).all()

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        mujoco.mj_resetData(self.model, self.data)
        while not self.free(place := self.np_random.uniform(MARGIN - ROOM, ROOM - MARGIN)):
            pass
        half = self.np_random.uniform(-math.pi, math.pi) / 2
        self.data.qpos[:7] = [*place, WHEEL, math.cos(half), 0, 0, math.sin(half)]
        mujoco.mj_step(self.model, self.data, 20)  # it comes to rest on its wheels
        return self.see(), {}

    def drive(self, motion):
        """Moves by (m along the heading, radians to the left); what is left of both."""
        place, heading = self.pose()
        end, aim = place + motion[0] * np.array([math.cos(heading), math.sin(heading)]), heading + motion[1]
        speed = np.zeros(2)
        for _ in range(round(TIMEOUT / TICK)):
            place, heading = self.pose()
            forth = np.array([math.cos(heading), math.sin(heading)])
            left = np.array([(end - place) @ forth, math.remainder(aim - heading, math.tau)])
            moves = np.array([self.data.qvel[:2] @ forth, self.data.qvel[5]])
            if (abs(left) < TOLERANCE).all() and (abs(moves) < STILL).all():
                break
            wanted = np.minimum(np.minimum(TOP, np.sqrt(2 * ACCELERATION * abs(left))), GAIN * abs(left)) * np.sign(left)
            speed += np.clip(wanted - speed, -ACCELERATION * TICK, ACCELERATION * TICK)
            self.data.ctrl[:] = (speed[0] + np.array([-1, 1]) * HALF_TRACK * speed[1]) / WHEEL
            mujoco.mj_step(self.model, self.data, STEPS_PER_TICK)
        self.data.ctrl[:] = 0
        mujoco.mj_step(self.model, self.data, 20)  # the wheels come to rest
        return left

    def step(self, action):
        motion = np.array([ACTIONS[action].get("forward", 0), math.radians(ACTIONS[action].get("turn_deg", 0))])
        left = self.drive(motion)
        arrived = math.dist(self.pose()[0], GOAL) < GOAL_RADIUS
        return self.see(), float(arrived), arrived, False, {"blocked": bool(left @ motion > 0.5 * motion @ motion)}


def main():
    given = options(__doc__, 10_000).parse_args()
    env = gymnasium.wrappers.TimeLimit(Robot(), LONGEST)
    loop = Loop(env, action=ACTIONS, blocked=lambda _, __, info: info["blocked"], seed=given.seed, out=given.out,
                actions=most(given.steps, given.trials, LONGEST))
    loop.reset(given.seed)
    curve(loop, given.steps, given.trials)


if __name__ == "__main__":
    main()
