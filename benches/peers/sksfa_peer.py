"""SFA of sksfa (PyPI: sklearn-sfa) on our kernel rows."""

import numpy as np
from sksfa import SFA

from worker import timed


def sfa(folder, k):
    rows = np.load(folder / "rows.npy")
    solver = SFA(n_components=k)
    _, seconds = timed(lambda: solver.fit(rows))
    return {"seconds": seconds, "slowness": [float(value) for value in solver.delta_values_[:k]]}
