"""`open`: a recorded run as arrays, and what its newest model makes of images."""

from __future__ import annotations

import json
import operator
import os
import tempfile
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from . import _adagio
from ._agent import _pixels, _pose


def open(run: str | os.PathLike[str]) -> Run:
    """Open a recorded run.

    Parameters
    ----------
    run : path
        Its folder, or a log file. It may be going on: what is in its log by now is there.

    Returns
    -------
    Run

    Raises
    ------
    RuntimeError
        It is no run, or cannot be read.
    """
    return Run(run)


class Table(Mapping[str, np.ndarray]):
    """Arrays by their names, each read when it is asked for; ``repr`` says what each is."""

    def __init__(self, name, archive, about):
        self._name, self._archive, self._about, self._read = name, archive, about, {}

    def __getitem__(self, name):
        if name not in self._about:
            raise KeyError(f"{self._name} has no array {name!r}: there are {', '.join(self._about)}")
        if name not in self._read:
            self._read[name] = self._archive[name]
        return self._read[name]

    def __iter__(self):
        return iter(self._about)

    def __len__(self):
        return len(self._about)

    def __repr__(self):
        lines = [f"  {name} {tuple(of['shape'])} {of['dtype']}: {of['meaning']}" for name, of in self._about.items()]
        return "\n".join([f"{self._name}:", *lines])


def _table(name: str, doc: str) -> Any:
    """A property: a table, by its name."""
    return property(lambda run: run._table(name), doc=doc)


class Run:
    """A recorded run: what ``adagio export`` writes, and what the newest model makes of images.

    Its log is read when it is opened. Arrays are made when the first one is asked for, in a temporary folder whose name
    is removed again; they are read from there one by one.

    Attributes
    ----------
    scenario : str
        The complete scenario, as TOML.
    actions, tasks : list of str
        Names by numbers.
    report : dict or None
        What ``report.json`` holds; None before the run has ended.
    about : dict
        What is in the tables, as ``about.json`` says it.

    Examples
    --------
    Two images of a run that two actions were decided on in.

    >>> import tempfile
    >>> import numpy as np
    >>> import adagio
    >>> image = np.zeros((32, 64, 3), np.uint8)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with adagio.Agent(out=folder + "/run", action=[{"name": "left"}, {"name": "right"}]) as agent:
    ...         _ = agent.act(image), agent.act(image, reward=0.5)
    ...     run = adagio.open(agent.run)
    ...     run.actions, run.frames["observation"].shape, run.transitions["rewards"].tolist()
    (['left', 'right'], (2, 16, 32, 3), [[0.5]])
    """

    def __init__(self, run: str | os.PathLike[str]):
        self._run = Path(run)
        self._recorded = _adagio.Recorded(self._run)
        self._tables = None

    frames = _table("frames", "One row for each frame; with a model its features, Q-values and places, too.")
    transitions = _table("transitions", "One row for each action that was completed.")
    decisions = _table("decisions", "One row for each decision.")
    prospects = _table("prospects", "One row for each decision of a pursuit of which something is expected.")
    places = _table("places", "One row for each decision where places are told. RuntimeError where they are not.")
    models = _table("models", "One row for each model that was made during the run.")
    growth = _table("growth", "One row for each block of frames that went through the dictionary.")
    accepted = _table("accepted", "One row for each frame that became a support vector.")
    evaluations = _table("evaluations", "One row for each trial of a policy during the run.")
    model = _table("model", "The newest model itself. RuntimeError where there is none.")

    @property
    def scenario(self) -> str:
        return self._recorded.scenario

    @property
    def actions(self) -> list[str]:
        return self._recorded.actions

    @property
    def tasks(self) -> list[str]:
        return self._recorded.tasks

    @property
    def report(self) -> dict[str, Any] | None:
        folder = self._run if self._run.is_dir() else self._run.parent
        try:
            return json.loads((folder / "report.json").read_text(encoding="utf-8"))
        except FileNotFoundError:
            return None

    @property
    def about(self) -> dict[str, Any]:
        self._export()
        return self._about

    def features(self, images: np.ndarray | Sequence[np.ndarray]) -> np.ndarray:
        """Slow features of images, by the newest model.

        Parameters
        ----------
        images : ndarray of uint8, or a sequence of such
            One image, (height, width, 3), (height, width, 1) or (height, width); several, (n, height, width, 3) or
            (n, height, width, 1), or in a list. Of any size that is not smaller than an observation: the run's vision
            makes observations of them.

        Returns
        -------
        features : ndarray of shape (n, k)
            The constant one first, then the slowest; n = 1 for one image.

        Raises
        ------
        RuntimeError
            The run has no model.
        """
        return self._recorded.features(_stack(images))

    def q_values(self, images: np.ndarray | Sequence[np.ndarray], task: str | int) -> np.ndarray:
        """Values of all actions, by the newest model.

        Parameters
        ----------
        images : ndarray of uint8, or a sequence of such
            As for `features`.
        task : str or int
            A task's name or number.

        Returns
        -------
        q : ndarray of shape (n, n_actions)

        Raises
        ------
        RuntimeError
            The run has no model.
        ValueError
            There is no such task.
        """
        return self._recorded.q_values(_stack(images), self._number(task))

    def policy(self, task: str | int) -> Policy:
        """Drive to the goal of a task, by the newest model, which learns nothing more.

        Parameters
        ----------
        task : str or int
            A task's name or number.

        Returns
        -------
        Policy

        Raises
        ------
        RuntimeError
            The run has no model.
        ValueError
            There is no such task.
        """
        return Policy(self._recorded.pilot(self._number(task)))

    def __repr__(self):
        return f"<adagio.Run {str(self._run)!r}>"

    def _number(self, task):
        if not isinstance(task, str):
            return operator.index(task)
        if task not in self.tasks:
            raise ValueError(f"there is no task {task!r}: there are {', '.join(self.tasks)}")
        return self.tasks.index(task)

    def _table(self, name):
        self._export()
        if name not in self._tables:
            without = "places are not told in this run (value.places)"
            raise RuntimeError(without if name == "places" else self._recorded.without_model())
        return self._tables[name]

    def _export(self):
        if self._tables is not None:
            return
        with tempfile.TemporaryDirectory(prefix="adagio-") as folder:
            about = json.loads(self._recorded.export(folder))
            files = {Path(file).stem: (file, arrays) for file, arrays in about["files"].items()}
            # A file that is open can be read when its name is gone.
            tables = {name: Table(name, np.load(Path(folder, file)), of) for name, (file, of) in files.items()}
        if about["damaged"]:
            warnings.warn(f"{about['damaged']} frames or records of {self._run} could not be used", stacklevel=4)
        self._about, self._tables = about, tables


class Policy:
    """The policy of a task, of `Run.policy`: its best actions with the reflexes of the run's scenario and, where the run has
    ``value.places``, a memory of where the robot may be. The run may be of any kind, another program's bag too.
    """

    def __init__(self, pilot: _adagio.Pilot):
        self._pilot = pilot

    def act(
        self, image: np.ndarray, *, blocked: bool = False, odometry: tuple[float, float, float] | None = None
    ) -> int | None:
        """Decide on the next action.

        Parameters
        ----------
        image : ndarray of uint8, (height, width, 3), (height, width, 1) or (height, width)
            What the camera sees behind the action before, or first of all.
        blocked : bool
            Whether something stopped that action.
        odometry : (x, y, heading), optional
            Where the robot counts itself to be, metres and radians, from anywhere on: for a run whose maps are of odometry.

        Returns
        -------
        int or None
            The number of the action. None: the robot is where the goal was shown. Other goals are for the caller to know.

        Raises
        ------
        TypeError, ValueError
            An image of another type or shape; odometry that is not finite.
        """
        return self._pilot.act(_pixels(image), bool(blocked), _pose(odometry))

    def reset(self) -> None:
        """The robot is put somewhere: the next image is the first one."""
        self._pilot.reset()


def _stack(images):
    """Images one by one."""
    if not isinstance(images, np.ndarray):
        return [_pixels(image) for image in images]
    _pixels(images)
    return list(images) if images.ndim == 4 else [images]
