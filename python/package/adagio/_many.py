"""`learn`: one model from many logs."""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from . import _adagio
from ._agent import _flat, _value
from ._engine import engine


def learn(
    logs: Iterable[str | os.PathLike[str]],
    *,
    scenario: str | os.PathLike[str] | None = None,
    out: str | os.PathLike[str] | None = None,
    client: Any = None,
    evaluate: bool = False,
    **settings: Any,
) -> dict[str, Any]:
    """Learn one model from many recorded runs, as ``adagio learn`` does.

    Each log is worked on alone, and what is made of it is a file in the folder of the result. The same logs give the same
    bits on any number of workers; a part that is there is not made again.

    Parameters
    ----------
    logs : paths
        Run folders or log files, of one camera and one set of actions.
    scenario : path, optional
        Scenario file; without, that of the first log.
    out : path, optional
        Folder of the result: a new one, or one in which the same was begun.
    client : optional
        Who works on logs: anything with ``submit(function, *arguments)`` that gives futures, such as
        ``dask.distributed.Client`` or ``concurrent.futures.ProcessPoolExecutor``. Its workers must have this package, and the
        logs and ``out`` under the same paths. Without, this process does it.
    evaluate : bool
        Whether policies are tried in the scenario's simulated world.
    **settings
        Keys of the scenario that are changed, as for `Agent`.

    Returns
    -------
    dict
        ``report.json``, with the folder of the result as ``"run"``.

    Raises
    ------
    ValueError
        Logs of other cameras or other actions, the same log twice, a setting that is not valid.
    RuntimeError
        A part cannot be read or written, or no model can be made.

    Warns
    -----
    UserWarning
        A log that is damaged is left out.
    """

    if not isinstance(evaluate, bool):
        raise TypeError(f"evaluate is {evaluate!r}: True or False (keys of [evaluate] go into a scenario file)")
    sets = [f"{key}={_value(value)}" for key, value in _flat(settings)]
    scenario, out = (None if path is None else Path(path) for path in (scenario, out))
    report, run = _adagio.learn([Path(log) for log in logs], scenario, sets, out, evaluate, engine(client, _adagio.learn_part))
    report = json.loads(report)
    for log in report["learned_from"]["left_out"]:
        warnings.warn(f"{log}: it is left out", stacklevel=2)
    return {**report, "run": Path(run)}
