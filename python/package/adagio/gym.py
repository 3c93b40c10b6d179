"""Gymnasium environments with images and discrete actions, driven by an `Agent`."""

import numpy as np

from ._agent import Agent


def run(env, *, actions=None, agent=None, steps=None, seed=None, blocked=None, image=None, on_step=None, **settings):
    """Explore, learn and act in an environment, in one continuous run.

    Parameters
    ----------
    env : gymnasium.Env
        With a ``Discrete`` action space. Its observations are images, or `image` makes one of them.
    actions : list of str or dict, optional
        What the actions are, in the order of their numbers: names, or sections ``[[action]]`` of a scenario, such as
        ``{"name": "left", "turn_deg": 15, "inverse": "right"}``. There may be fewer than the environment has: the first ones.
    agent : Agent, optional
        One that is to be driven; by default a new one of the `settings`, see `Agent`.
    steps : int, optional
        Actions of this call; by default as many as the agent's run still has.
    seed : int, optional
        Of the environment's first reset.
    blocked : callable, optional
        Says of (observation, reward, info) whether something stopped the action.
    image : callable, optional
        Makes an image of an observation: uint8, (height, width, 3).
    on_step : callable, optional
        Is told (step, action, reward, done, info) of each action.

    Returns
    -------
    Agent
        It is open: `Agent.close` writes the report.

    Notes
    -----
    An episode's end is no transition, and a reset is a gap for slow features. ``terminated`` and ``truncated`` both end an
    episode; what an action was worth is the environment's reward.
    """
    count = int(env.action_space.n) - int(getattr(env.action_space, "start", 0))
    if agent is None:
        listed = [{"name": name} if isinstance(name, str) else dict(name) for name in actions or _numbered(count)]
        if len(listed) > count:
            raise ValueError(f"there are {len(listed)} actions, and the environment has {count}")
        settings.setdefault("actions", steps if steps is not None else 100_000)
        agent = Agent(action=listed, **settings)
    elif settings or actions is not None:
        raise ValueError("settings and actions are those of a new agent, and one was given")
    first = int(getattr(env.action_space, "start", 0))
    picture = image or (lambda observation: observation)
    observation, _ = env.reset(seed=seed)
    action = agent.act(np.asarray(picture(observation)))
    step = 0
    while steps is None or step < steps:
        observation, reward, terminated, truncated, info = env.step(first + action)
        step += 1
        done = bool(terminated or truncated)
        stopped = bool(blocked(observation, reward, info)) if blocked else False
        if on_step:
            on_step(step, action, reward, done, info)
        try:
            action = agent.act(np.asarray(picture(observation)), reward=float(reward), blocked=stopped, done=done)
            if done:
                observation, _ = env.reset()
                action = agent.act(np.asarray(picture(observation)))
        except RuntimeError:
            if steps is None:
                break
            raise
    return agent


def _numbered(count):
    return [f"action {number}" for number in range(count)]
