"""`Agent`: explores, learns and acts, called with one image after the other."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from . import _adagio


class Agent:
    """An agent that learns to navigate from images, while a program drives it.

    Parameters
    ----------
    scenario : path, optional
        A scenario file with ``robot.body = "program"``. Without one, the scenario is made of the settings: its tasks
        are those of ``task=``, or one named *goal* whose rewards are those that `act` is given.
    out : path, optional
        The folder of the run, which must not exist yet; by default a new one under ``logs/``.
    **settings
        Keys of scenarios by their sections: ``seed=3``, ``value={"gamma": 0.97}``, and, without a scenario file,
        ``action=[{"name": "left", "inverse": "right"}, ...]`` and ``task=[{"name": "vest", "reward": "topic"}, ...]``.
        ``adagio check`` prints all keys.

    Attributes
    ----------
    run : pathlib.Path
        The folder of the run.
    actions : list of str
        Names of the actions by their numbers.
    tasks : list of str
        Names of the tasks.

    Notes
    -----
    Images are learned from and decided on by the actors of ``adagio run``, on threads that do not hold the interpreter.
    In lockstep, the default, what is decided follows from the images alone, so that ``adagio replay RUN --verify``
    repeats it. One thread at a time may call it. Memory is bounded by the scenario's budgets. The log grows in the
    folder of the run.

    Examples
    --------
    >>> import tempfile
    >>> import numpy as np
    >>> import adagio
    >>> image = np.zeros((32, 64, 3), np.uint8)
    >>> folder = tempfile.TemporaryDirectory()
    >>> actions = [{"name": "left"}, {"name": "right"}, {"name": "ahead"}]
    >>> agent = adagio.Agent(out=folder.name + "/run", actions=20000, action=actions)
    >>> action = agent.act(image)  # the first image
    >>> action = agent.act(image, reward=1.0)  # the image behind that action, and what it came to
    >>> agent.close()["run"]["frames"]
    2
    >>> folder.cleanup()
    """

    def __init__(
        self,
        scenario: str | os.PathLike[str] | None = None,
        *,
        out: str | os.PathLike[str] | None = None,
        **settings: Any,
    ):
        text, sets = "", []
        if scenario is None:
            text = _toml(_with_defaults(settings))
        else:
            sets = [f"{key}={_value(value)}" for key, value in _flat(settings)]
        self._agent = _adagio.Agent.begin(scenario, text, sets, out)

    @classmethod
    def resume(cls, run: str | os.PathLike[str]) -> Agent:
        """Go on with a run that was interrupted or closed before its last action.

        Parameters
        ----------
        run : path
            Its folder. It is learned from its log, or its saved state is restored; nothing that it had recorded is
            lost.

        Returns
        -------
        Agent
            The next image belongs to no action.
        """
        agent = cls.__new__(cls)
        agent._agent = _adagio.Agent.resume(run)
        return agent

    @property
    def run(self) -> Path:
        return self._agent.run

    @property
    def actions(self) -> list[str]:
        return self._agent.actions

    @property
    def tasks(self) -> list[str]:
        return self._agent.tasks

    def act(
        self,
        image: np.ndarray,
        *,
        reward: float | Mapping[str, float] | None = None,
        pose: tuple[float, float, float] | None = None,
        blocked: bool = False,
        done: bool = False,
        reset: bool = False,
    ) -> int | None:
        """Show the image behind the last action, and decide on the next.

        Parameters
        ----------
        image : ndarray of uint8, (height, width, 3), (height, width, 1) or (height, width)
            What the camera sees. It is copied once.
        reward : float or dict, optional
            What the last action was worth, to all tasks with ``reward = "topic"``, or by their names.
        pose : (x, y, heading), optional
            Where the robot truly is, metres and radians: for goals by coordinates and drawings, never for features.
        blocked : bool
            Whether something stopped the last action.
        done : bool
            Whether an episode has ended. The next image is the first of another one.
        reset : bool
            Whether this image is the first of an episode, and not what the last action came to.

        Returns
        -------
        int or None
            The number of the action that is to follow; None at the end of an episode.

        Raises
        ------
        TypeError, ValueError
            An image of another type or shape; a reward that is not finite, or of a task that does not exist.
        RunOver
            The run is over: its last action is done, or it was closed. It is a RuntimeError.
        RuntimeError
            The run has failed, with the reason; another thread is in a call.

        Notes
        -----
        Ctrl-C raises KeyboardInterrupt while the agent decides. The image was shown then: the next call returns the
        action behind it, and looks at its own image only if that is a `reset`.
        """
        return self._agent.act(_pixels(image), _rewards(reward), _pose(pose), bool(blocked), bool(done), bool(reset))

    def observe(self, image: np.ndarray, *, pose: tuple[float, float, float] | None = None) -> None:
        """Show an image that was taken during the action that `act` gave: features learn from it, too.

        Parameters are those of `act`.
        """
        self._agent.observe(_pixels(image), _pose(pose))

    def mark(self, task: str) -> None:
        """The next image shows the goal of a task with ``goal = "shown"``; ``"forget NAME"`` takes such marks back."""
        self._agent.mark(task)

    def goto(self, task: str | None) -> None:
        """Drive to the goal of a task from the next image on, however long it takes; ``None``: by the schedule."""
        self._agent.goto("" if task is None else task)

    def close(self) -> dict[str, Any]:
        """End the run: the log is closed, ``report.json`` and the page with drawings are written.

        Returns
        -------
        dict
            What ``report.json`` holds.
        """
        return json.loads(self._agent.close())

    def __enter__(self) -> Agent:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _with_defaults(settings):
    """A scenario of settings alone is one of a program's robot, with a task that its rewards are for."""
    robot = {"body": "program", **settings.get("robot", {})}
    task = settings.get("task", [{"name": "goal", "reward": "topic"}])
    return {"name": "agent", **settings, "robot": robot, "task": task}


def _pixels(image):
    """An array that is not one of bytes is a mistake that no scaling can guess."""
    if not isinstance(image, np.ndarray) or image.dtype != np.uint8:
        found = getattr(image, "dtype", type(image).__name__)
        raise TypeError(f"an image is a NumPy array of uint8, not {found}")
    return image


def _rewards(reward):
    if reward is None:
        return []
    if isinstance(reward, Mapping):
        return [(task, float(value)) for task, value in reward.items()]
    return [(None, float(reward))]


def _pose(pose):
    if pose is None:
        return None
    x, y, heading = pose
    return float(x), float(y), float(heading)


def _flat(settings, above=""):
    """Keys with their sections and dots between, and their values."""
    for key, value in settings.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{above}{key}.")
        elif isinstance(value, (list, tuple)) and any(isinstance(entry, Mapping) for entry in value):
            raise ValueError(f"{above}{key}: a list of sections stands in the scenario file, or there is no such file")
        else:
            yield f"{above}{key}", value


def _toml(settings, above=""):
    """Settings as the text of a scenario: values first, then sections."""
    lines, sections = [], []
    for key, value in settings.items():
        if isinstance(value, Mapping):
            sections.append(f"[{above}{key}]\n{_toml(value, f'{above}{key}.')}")
        elif isinstance(value, (list, tuple)) and value and all(isinstance(entry, Mapping) for entry in value):
            sections += [f"[[{above}{key}]]\n{_toml(entry, f'{above}{key}.')}" for entry in value]
        else:
            lines.append(f"{key} = {_value(value)}")
    return "\n".join(lines + sections) + "\n"


def _value(value):
    """A value as TOML has it: JSON's texts, numbers, truth and lists are TOML's, too."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, (bool, int, float, str)):
        return json.dumps(value)
    if isinstance(value, (list, tuple, np.ndarray)):
        return "[" + ", ".join(_value(entry) for entry in value) + "]"
    raise TypeError(f"a setting is a number, a text, a list or a dict, not {type(value).__name__}")
