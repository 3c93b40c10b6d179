"""Promise: Gymnasium's environments are learned from as they are, episode by episode."""

import gymnasium
import numpy as np
import pytest
from rings import GOAL, PLACES, Ring, replayed_digest

import adagio
import adagio.gym

QUICK = {"policy": {"explore_share": 0.2}}


class RingEnv(gymnasium.Env):
    """Episodes end at the goal, or after some steps."""

    def __init__(self, n_actions=4, most=60, start=0):
        self.ring, self.most, self.first = Ring(n_actions), most, start
        self.observation_space = gymnasium.spaces.Box(0, 255, self.ring.picture.shape, np.uint8)
        self.action_space = gymnasium.spaces.Discrete(n_actions, start=start)
        self.seeds, self.lengths = [], []

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.seeds.append(seed)
        self.lengths.append(0)
        return self.ring.reset(), {"at": self.ring.at}

    def step(self, action):
        assert self.action_space.contains(action), action
        self.lengths[-1] += 1
        reward = self.ring.step(action - self.first)
        return self.ring.picture, reward, reward > 0, self.lengths[-1] == self.most, {"at": self.ring.at}


def test_it_learns_an_environment(tmp_path):
    env, told = RingEnv(), []
    agent = adagio.gym.run(
        env, steps=2000, seed=5, out=tmp_path / "run", on_step=lambda *step: told.append(step), **QUICK
    )
    assert env.seeds[0] == 5 and set(env.seeds[1:]) == {None}
    report = agent.close()
    # The end of each episode takes one of the run's actions.
    assert report["run"]["actions"] == 2000
    assert 2000 - len(env.lengths) <= len(told) <= 2000
    assert [step[0] for step in told] == list(range(1, len(told) + 1))
    assert all(reward == float(info["at"] == GOAL) for _, _, reward, _, info in told)
    assert max(env.lengths) <= 60
    late, early = np.mean(env.lengths[-20:-1]), np.mean(env.lengths[:20])
    print(f"{early:.1f} steps an episode at first, {late:.1f} at the end, of {len(env.lengths)}")
    assert late < 0.7 * early
    assert replayed_digest(agent.run) == report["digest"]
    run = adagio.open(agent.run)
    assert (run.frames["action"] < 0).sum() in (len(env.lengths), len(env.lengths) - 1)
    assert run.transitions["rewards"].sum() == sum(reward for _, _, reward, _, _ in told)


def test_both_ends_of_an_episode_are_no_transition(tmp_path):
    env, ends = RingEnv(most=3), []
    with adagio.gym.run(env, steps=300, out=tmp_path / "run", on_step=lambda *step: ends.append(step[3])) as agent:
        pass
    taken = adagio.open(agent.run).frames["action"].tolist()
    lengths = [len(part) for part in "".join("x" if of < 0 else "." for of in taken).split("x")[1:]]
    assert lengths[:-1] == env.lengths[: len(lengths) - 1] and set(lengths[:-1]) <= {1, 2, 3} and 3 in lengths
    assert sum(ends) >= len(lengths) - 1


def test_trials_send_the_agent_to_its_goal(tmp_path):
    env = RingEnv(most=200)
    loop = adagio.gym.Loop(env, out=tmp_path / "run", actions=5000, **QUICK)
    loop.reset(1)
    while loop.steps < 1500:
        loop.step()
    began = len(env.lengths)
    results = loop.trials(10)
    assert [steps for _, steps in results] == env.lengths[began : began + 10]
    assert all(arrived for arrived, _ in results) and np.mean([steps for _, steps in results]) < 10
    loop.agent.close()


class EndlessRing(RingEnv):
    """Neither rewards nor ends: only the pose says where the goals are."""

    def step(self, action):
        picture, _, _, _, info = super().step(action)
        return picture, 0.0, False, False, info


def pose_of(info):
    """Places are about 1 m apart on a circle; the robot looks out of it."""
    heading, radius = 2 * np.pi * info["at"] / PLACES, PLACES / (2 * np.pi)
    return radius * np.cos(heading), radius * np.sin(heading), heading


def test_goals_by_coordinates_are_judged_by_the_pose(tmp_path):
    env, goals, ends = EndlessRing(), {"near": 5, "far": 14}, []
    tasks = [{"name": name, "goal": pose_of({"at": at})[:2], "radius": 0.3} for name, at in goals.items()]
    settings = {"out": tmp_path / "run", "actions": 5000, "robot": {"pose": "known"}, "task": tasks, **QUICK}
    loop = adagio.gym.Loop(env, pose=pose_of, reward=lambda *_: None, **settings)
    loop.reset(1)
    while loop.steps < 1500:
        ends.append(loop.step()[4]["at"])
    for name, at in goals.items():
        began = len(env.lengths)
        results = loop.trials(10, name, most=60, there=lambda info: ends.append(info["at"]) or info["at"] == at)
        assert [steps for _, steps in results] == env.lengths[began:]
        assert all(arrived for arrived, _ in results) and np.mean([steps for _, steps in results]) < 10
    assert loop.trials(2, "far", most=3, there=lambda info: ends.append(info["at"])) == [(False, 3)] * 2
    loop.agent.close()
    rewards = adagio.open(loop.agent.run).transitions["rewards"]
    assert rewards.sum(axis=0).tolist() == [ends.count(at) for at in goals.values()]


def test_the_numbers_of_actions_are_the_environments(tmp_path):
    env = RingEnv(start=7)
    adagio.gym.run(env, steps=30, out=tmp_path / "start").close()
    env = RingEnv(start=7)
    listed = [{"name": "back", "action": 1, "inverse": "on"}, {"name": "on", "action": 0, "repeat": 3}]
    with adagio.gym.run(env, action=listed, steps=30, out=tmp_path / "listed") as agent:
        assert agent.actions == ["back", "on"]
    frames = adagio.open(agent.run).frames
    # Three images of each action that is repeated, one of the other.
    assert (frames["action"] == 1).sum() > 2 * (frames["boundary"] & (frames["action"] == 1)).sum()
    assert frames["boundary"][frames["action"] == 0].all()


def test_an_agent_goes_on_in_another_call(tmp_path):
    env = RingEnv()
    agent = adagio.gym.run(env, steps=50, out=tmp_path / "run", actions=150)
    assert adagio.gym.run(env, steps=50, agent=agent) is agent
    adagio.gym.run(env, agent=agent)
    report = agent.close()
    assert report["run"]["actions"] == 150
    run = adagio.open(agent.run)
    # Each call begins with a reset, which belongs to no action.
    assert (run.frames["action"] < 0).sum() in (len(env.lengths), len(env.lengths) - 1)
    replayed_digest(agent.run)


@pytest.mark.parametrize(
    ("wrong", "error"),
    [
        ({"action": ["a", "b", "c", "d", "e"]}, "allowed are 0 to 3"),
        ({"action": [{"name": "a", "repeat": 0}, "b"]}, "1 or more"),
        ({"action": ["a", "a"]}, "name"),
        ({"steps": 20, "nope": 1}, "nope is not a key"),
        ({"image": lambda observation: observation[:8]}, "smaller than an observation"),
        ({"image": lambda observation: observation[..., :2]}, "an image has the shape"),
    ],
)
def test_wrong_arguments_raise(wrong, error, tmp_path):
    with pytest.raises(ValueError, match=error):
        adagio.gym.run(RingEnv(), **{"steps": 20, "out": tmp_path / "run", **wrong})


def test_an_environment_of_another_kind_is_refused(tmp_path):
    env = RingEnv()
    for space in (gymnasium.spaces.Box(0, 1), gymnasium.spaces.MultiBinary(3)):
        env.action_space = space
        with pytest.raises(TypeError, match="Discrete"):
            adagio.gym.run(env, steps=20, out=tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_settings_with_an_agent_raise(tmp_path):
    with adagio.gym.run(RingEnv(), steps=20, out=tmp_path / "run", actions=100) as agent:
        with pytest.raises(ValueError, match="settings and actions are those of a new agent"):
            adagio.gym.run(RingEnv(), agent=agent, seed=1, value={"gamma": 0.5})
        with pytest.raises(ValueError, match="settings and actions are those of a new agent"):
            adagio.gym.run(RingEnv(), agent=agent, action=["x", "y"])
