"""stable-baselines3's PPO or DQN in the worlds of `miniworld_rooms.py` and `my_way_home.py`, for comparison.

    pip install stable-baselines3 miniworld vizdoom gymnasium
    python baselines.py --world OneRoom --steps 30000 --seed 1

The environment, its macro-actions, its rewards and its episodes are the agent's. The networks are those of `CnnPolicy`, all settings
the package's own, but for DQN's buffer, which holds all steps. Trials are episodes from the environment's own starts, with actions
drawn from the policy and again with its best ones; nothing is learned in them. Prints a line of JSON at the end. PPO learns from 2 048
actions at a time, so that there may be more steps than were asked for.
"""

import json

import gymnasium
from curve import options


class Macro(gymnasium.Wrapper):
    """An action does several steps of the environment; its reward is their sum."""

    def __init__(self, env, actions):
        super().__init__(env)
        self.does = [(of.get("action", number), of.get("repeat", 1)) for number, of in enumerate(actions)]
        self.action_space = gymnasium.spaces.Discrete(len(actions))

    def step(self, action):
        does, repeat = self.does[int(action)]
        total = 0.0
        for _ in range(repeat):
            observation, reward, terminated, truncated, info = self.env.step(does)
            total += float(reward)
            if terminated or truncated:
                break
        return observation, total, terminated, truncated, info


def environment(world):
    """A world by its name, and how many of its steps are an action."""
    if world == "MyWayHome":
        import my_way_home

        return my_way_home.MyWayHome(), 1
    import miniworld_rooms as rooms

    return Macro(rooms.SameBox(world), rooms.ACTIONS), rooms.REPEAT


def trials(model, env, count, deterministic):
    """Share of episodes that end with a reward, as those of a box or a vest do."""
    arrived = 0
    for _ in range(count):
        observation, _ = env.reset()
        over = False
        while not over:
            action, _ = model.predict(observation, deterministic=deterministic)
            observation, reward, terminated, truncated, _ = env.step(int(action))
            over = terminated or truncated
        arrived += reward > 0
    return arrived / count


def main():
    import stable_baselines3
    import torch._dynamo  # noqa: F401  loads LLVM: behind that of Mesa, which draws MiniWorld, it ends the process
    from stable_baselines3.common.monitor import Monitor

    parser = options(__doc__, 30_000, of="steps of the environment")
    parser.add_argument("--world", default="OneRoom", help="of miniworld_rooms.py, or MyWayHome")
    parser.add_argument("--method", choices=["PPO", "DQN"], default="PPO")
    given = parser.parse_args()
    env, repeat = environment(given.world)
    actions = given.steps // repeat
    memory = {"buffer_size": actions} if given.method == "DQN" else {}
    model = getattr(stable_baselines3, given.method)("CnnPolicy", Monitor(env), seed=given.seed, device="cpu", **memory)
    env.reset(seed=given.seed)
    model.learn(actions)
    success = {name: trials(model, env, given.trials, best) for name, best in (("drawn", False), ("best", True))}
    print(json.dumps({"world": given.world, "method": given.method, "steps": repeat * model.num_timesteps, "success": success}))


if __name__ == "__main__":
    main()
