"""Gymnasium environments with images and discrete actions, driven by an `Agent`."""

import operator

import numpy as np

from ._adagio import RunOver
from ._agent import Agent


class Loop:
    """An agent in an environment: steps, episodes, trials.

    Parameters
    ----------
    env : gymnasium.Env
        With a ``Discrete`` action space. Its observations are images, or `image` makes one of them.
    action : list of str or dict, optional
        What the agent's actions are: names, or sections ``[[action]]`` of a scenario, such as ``{"name": "left", "turn_deg": 15,
        "inverse": "right"}``. Two more keys are for the loop: ``"action"``, the environment's number for it (by default its place
        in the list), and ``"repeat"``, how often that is done; the images between are observed.
    agent : Agent, optional
        One that is to be driven, with the actions above; by default a new one of the `settings`, see `Agent`.
    blocked : callable, optional
        Says of (observation, reward, info) whether something stopped the action.
    image : callable, optional
        Makes an image of an observation: uint8, (height, width, 3).
    pose : callable, optional
        Says of info where the robot truly is: (x, y, heading), metres and radians, or None. For goals by coordinates.
    reward : callable, optional
        Says of (observation, reward, info) what the agent is told of the reward: a number, numbers by the names of tasks, or
        None, as where no task has ``reward = "topic"``. By default the environment's.
    **settings
        Of the new agent.

    Attributes
    ----------
    agent : Agent
    steps : int
        Actions of the agent so far.

    Notes
    -----
    An episode's end is no transition, and a reset is a gap for slow features. ``terminated`` and ``truncated`` both end an
    episode; what an action was worth is the sum of the environment's rewards.
    """

    def __init__(self, env, *, action=None, agent=None, blocked=None, image=None, pose=None, reward=None, **settings):
        space = env.action_space
        if not hasattr(space, "n") or getattr(space, "shape", None) != ():
            raise TypeError(f"the environment's actions are {space}: an agent has discrete ones, of a space Discrete")
        count = int(space.n)
        first = int(getattr(space, "start", 0))
        if action is None:
            action = agent.actions if agent else [f"action {number}" for number in range(count)]
        listed = [{"name": of} if isinstance(of, str) else dict(of) for of in action]
        if not listed:
            raise ValueError("there are no actions: leave action out, or name some")
        self._does = []
        for number, of in enumerate(listed):
            does, repeat = operator.index(of.pop("action", number)), operator.index(of.pop("repeat", 1))
            if not 0 <= does < count or repeat < 1:
                raise ValueError(f"{of}: action = {does}, repeat = {repeat}: allowed are 0 to {count - 1}, and 1 or more")
            self._does.append((first + does, repeat))
        if agent is None:
            agent = Agent(action=listed, **settings)
        elif settings or agent.actions != [of["name"] for of in listed]:
            raise ValueError(f"settings and actions are those of a new agent, and one with {agent.actions} was given")
        self.env, self.agent, self.steps = env, agent, 0
        self._blocked = blocked or (lambda observation, reward, info: False)
        self._image = image or (lambda observation: observation)
        self._pose = pose or (lambda info: None)
        self._reward = reward or (lambda observation, reward, info: reward)
        self._action = None  # what is to be done next; None: an episode begins

    def reset(self, seed=None):
        """Begin an episode; what was before is over."""
        observation, info = self.env.reset(seed=seed)
        self._show(observation, info, reset=True)

    def step(self):
        """One action of the agent.

        Returns
        -------
        action : int
        reward : float
        terminated, truncated : bool
        info : dict

        Raises
        ------
        RunOver
            All actions of the run are done.
        """
        if self._action is None:
            self.reset()
        action = self._action
        does, repeat = self._does[action]
        total = 0.0
        for left in reversed(range(repeat)):
            observation, reward, terminated, truncated, info = self.env.step(does)
            total += float(reward)
            if terminated or truncated:
                break
            if left:
                self.agent.observe(self._picture(observation), pose=self._pose(info))
        done = bool(terminated or truncated)
        self.steps += 1
        self._action = None
        stopped = bool(self._blocked(observation, total, info))
        told = self._reward(observation, total, info)
        try:
            self._show(observation, info, reward=told, blocked=stopped, done=done)
        except RunOver:
            pass  # it was the last action: the next step says so
        return action, total, bool(terminated), bool(truncated), info

    def trials(self, count, task="goal", *, most=None, reset=None, there=None):
        """Episodes in which the agent is sent to a task's goal; it goes on learning.

        Parameters
        ----------
        count : int
            How many.
        task : str
            The task.
        most : int, optional
            Actions of an episode; by default the environment ends it.
        reset : callable, optional
            Is told the trial's number before it begins, to place what the environment begins with.
        there : callable, optional
            Says of info whether the robot has arrived; by default, a reward above 0 says so.

        Returns
        -------
        list of (bool, int)
            Whether it arrived, which ends the episode, and the actions that it took.
        """
        results = []
        for number in range(count):
            if reset:
                reset(number)
            self.agent.goto(task)
            self.reset()
            for done in range(1, (most or 10**9) + 1):
                _, reward, terminated, truncated, info = self.step()
                arrived = bool(there(info)) if there else reward > 0
                if terminated or truncated or arrived:
                    break
            results.append((arrived, done))
        self.agent.goto(None)
        return results

    def _show(self, observation, info, **came_to):
        self._action = self.agent.act(self._picture(observation), pose=self._pose(info), **came_to)

    def _picture(self, observation):
        return np.asarray(self._image(observation))


def run(env, *, steps=None, seed=None, on_step=None, **settings):
    """Explore, learn and act in an environment, in one continuous run.

    Parameters
    ----------
    env : gymnasium.Env
        With a ``Discrete`` action space and images.
    steps : int, optional
        Actions of this call, at most; by default as many as the agent's run has. Each end of an episode takes one of a run's, too.
    seed : int, optional
        Of the environment's first reset.
    on_step : callable, optional
        Is told (step, action, reward, done, info) of each action.
    **settings
        Those of `Loop` and `Agent`.

    Returns
    -------
    Agent
        It is open: `Agent.close` writes the report.
    """
    if settings.get("agent") is None and steps is not None:
        settings.setdefault("actions", steps)
    loop = Loop(env, **settings)
    loop.reset(seed)
    while steps is None or loop.steps < steps:
        try:
            action, reward, terminated, truncated, info = loop.step()
        except RunOver:
            break
        if on_step:
            on_step(loop.steps, action, reward, terminated or truncated, info)
    return loop.agent
