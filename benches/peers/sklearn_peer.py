"""Kernel rows and the Nyström map of scikit-learn."""

import numpy as np
from sklearn.kernel_approximation import Nystroem
from sklearn.metrics.pairwise import rbf_kernel

from worker import STATE, timed


def _frames(folder, begin, end, kind):
    """Frames in a precision, by its name. In `float32` the result is too, but distances are computed in chunks that are
    brought to `float64` and back (`euclidean_distances`): either precision may be the faster one."""
    return np.load(folder / "frames.npy", mmap_mode="r")[begin:end].astype(kind)


def kernel_rows(folder, m, n, sigma, kind):
    """Kernel rows of the `n` frames behind the first `m`."""
    members, x = _frames(folder, 0, m, kind), _frames(folder, m, m + n, kind)
    rows, seconds = timed(lambda: rbf_kernel(x, members, gamma=1 / (2 * sigma**2)))
    return {"seconds": seconds, "first": float(rows[0, 0])}


def nystroem(folder, m, sigma, kind):
    """The map over the first `m` frames: asked for as many components as there are frames, it takes them all."""
    nystroem = Nystroem(kernel="rbf", gamma=1 / (2 * sigma**2), n_components=m, random_state=0)
    members = _frames(folder, 0, m, kind)
    STATE["nystroem", kind], seconds = timed(lambda: nystroem.fit(members))
    return {"seconds": seconds}


def transform(folder, m, n, kind):
    x = _frames(folder, m, m + n, kind)
    STATE["z", kind], seconds = timed(lambda: STATE["nystroem", kind].transform(x))
    return {"seconds": seconds}


def products(folder, kind):
    """Largest difference between scalar products of the mapped frames and of our coordinates of them."""
    v, z = np.load(folder / "coordinates.npy"), STATE["z", kind].astype(np.float64)
    return {"difference": float(np.abs(v @ v.T - z @ z.T).max())}
