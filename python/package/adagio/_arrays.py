"""Arguments as arrays that the library takes."""

from __future__ import annotations

import numpy as np
from sklearn.utils.validation import check_array


def states(name, values):
    """Features or points of states as an array of float64."""
    return check_array(values, dtype=np.float64, order="C", input_name=name)


def numbers(name, values):
    """A list of numbers as an array of float64."""
    values = np.asarray(values)
    if values.ndim != 1:
        raise ValueError(f"{name} must be a list of numbers, but has {values.ndim} dimensions")
    if values.dtype.kind not in "iufb":
        raise TypeError(f"{name} must be numbers, but has the type {values.dtype}")
    return np.ascontiguousarray(values, dtype=np.float64)


def action_numbers(actions):
    """Actions as an array of int64."""
    values = np.asarray(actions)
    if values.ndim != 1:
        raise ValueError(f"actions must be a list of whole numbers, but has {values.ndim} dimensions")
    if values.dtype.kind not in "iu":
        raise TypeError(f"actions must be whole numbers, but has the type {values.dtype}")
    if values.dtype == np.uint64 and values.size and values.max() > np.iinfo(np.int64).max:
        raise ValueError(f"action {values.max()} is not allowed: it does not fit into 63 bits")
    return np.ascontiguousarray(values, dtype=np.int64)


def flags(terminal, n):
    """Where episodes end, as an array of bool."""
    if terminal is None:
        return np.zeros(n, dtype=bool)
    values = np.asarray(terminal)
    if values.ndim != 1:
        raise ValueError(f"terminal must be a list of True and False, but has {values.ndim} dimensions")
    if values.dtype != bool:
        raise TypeError(f"terminal must be True or False, but has the type {values.dtype}")
    return np.ascontiguousarray(values)


def number_of_actions(n_actions, actions):
    """As many as were told, or as were seen."""
    if n_actions is not None:
        return n_actions
    return max(0, int(actions.max(initial=-1)) + 1)
