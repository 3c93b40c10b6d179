"""`experiment`: an experiment of the thesis over many seeds."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from . import _adagio
from ._engine import engine


def experiment(
    name: str,
    seeds: Iterable[int] = range(11, 61),
    *,
    client: Any = None,
    quick: bool = False,
    smoke: bool = False,
    vectors: int | None = None,
    world: str | None = None,
    data: Iterable[str | os.PathLike[str]] = (),
    out: str | os.PathLike[str] | None = None,
    cache: str | os.PathLike[str] | None = None,
) -> dict[str, Any]:
    """Repeat an experiment of the thesis for many seeds, as ``adagio experiment`` does, one task for each seed.

    Each finished setting of a seed is a small file in ``cache``, and what is there is not computed again: after a
    crash, a killed worker or Ctrl-C the same call continues. At the end tables and plots are made of all seeds, with bands
    over them. They are the same on any number of workers.

    Parameters
    ----------
    name : str
        Which one; ``adagio experiment`` lists them, and so does the error for an unknown one.
    seeds : whole numbers
        Any seeds, 1000 at most; each counts once.
    client : optional
        Who does it: anything with ``submit(function, *arguments)`` that gives futures, such as ``dask.distributed.Client`` or
        ``concurrent.futures.ProcessPoolExecutor``. Its workers must have this package, and ``cache`` under the same path. A task
        uses all cores of its worker, unless ``RAYON_NUM_THREADS`` is set there. Without, this process does one seed after the other.
        Where this process has run an agent or experiments itself, its child processes must be spawned, not forked
        (``mp_context=multiprocessing.get_context("spawn")``).
    quick : bool
        A coarse version, in minutes.
    smoke : bool
        Only see that everything runs, in seconds: the numbers mean nothing.
    vectors : int, optional
        Support vectors in place of the size's own number; the most of them, where an experiment has several.
    world : str, optional
        Of the experiment ``"worlds"``: one world alone, the name of its scenario.
    data : paths
        Of ``"digits"`` and ``"receptive-fields"``: folders of packages that ship data; without, that of ``python3`` and ``node_modules``.
    out : path, optional
        Folder for tables and plots, which must not exist yet; without, a new one under ``experiments/NAME``.
    cache : path, optional
        Folder where finished settings are kept and looked for; without, ``experiments/NAME/cache``.

    Returns
    -------
    dict
        ``result.json``, with its folder as ``"folder"``.

    Raises
    ------
    ValueError
        No such experiment or world, no seeds, data that are not there, a folder that exists already.
    RuntimeError
        A file cannot be read or written, or the experiment fails.
    """
    what = (name, quick, smoke, vectors, world, [Path(folder).absolute() for folder in data])
    out, cache = (None if path is None else Path(path) for path in (out, cache))
    result, folder = _adagio.experiment(what, list(seeds), out, cache, engine(client, _adagio.experiment_seed))
    return {**json.loads(result), "folder": Path(folder)}
