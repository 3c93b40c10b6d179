"""Slow feature analysis, support vectors and values of actions, from streams.

`Agent` explores, learns and acts while a program drives a robot, or an environment, with it; :mod:`adagio.gym` drives
Gymnasium's. `open` gives a recorded run as arrays, `learn` makes one model
of many, and `experiment` repeats the thesis's experiments. All other classes are estimators in the manner of scikit-learn. What
they compute is the Rust library ``adagio``.

========================  =============================================================
:class:`SFA`              linear slow features of a series, or of a stream
:class:`KernelSFA`        slow features that are smooth functions of the sample
:class:`IncSFA`           slow features that follow a stream, without covariances
:class:`ALD`              support vectors by approximate linear dependence
:class:`LSPI`             values of actions, linear in features
:class:`LocalValues`      values of actions, from the transitions nearby
========================  =============================================================
"""

from ._adagio import RunOver
from ._agent import Agent
from ._ald import ALD
from ._experiment import experiment
from ._incremental import IncSFA
from ._kernel import KernelSFA
from ._linear import SFA
from ._local import LocalValues
from ._lspi import LSPI
from ._many import learn
from ._run import Policy, Run, open

__all__ = [
    "ALD", "Agent", "IncSFA", "KernelSFA", "LSPI", "LocalValues", "Policy", "Run", "RunOver", "SFA", "experiment",
    "learn", "open",
]  # fmt: skip
