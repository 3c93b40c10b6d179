"""Kernel rows and the Nyström map of scikit-learn."""

import numpy as np
from sklearn.kernel_approximation import Nystroem
from sklearn.metrics.pairwise import rbf_kernel

from worker import STATE, timed


def _frames(folder, begin, end):
    return np.array(np.load(folder / "frames.npy", mmap_mode="r")[begin:end])


def kernel_rows(folder, m, n, sigma):
    """Kernel rows of the `n` frames behind the first `m`, in the single precision of the frames."""
    members, x = _frames(folder, 0, m), _frames(folder, m, m + n)
    rows, seconds = timed(lambda: rbf_kernel(x, members, gamma=1 / (2 * sigma**2)))
    return {"seconds": seconds, "first": float(rows[0, 0])}


def nystroem(folder, m, sigma):
    """The map over the first `m` frames: asked for as many components as there are frames, it takes them all."""
    nystroem = Nystroem(kernel="rbf", gamma=1 / (2 * sigma**2), n_components=m, random_state=0)
    STATE["nystroem"], seconds = timed(lambda: nystroem.fit(_frames(folder, 0, m)))
    return {"seconds": seconds}


def transform(folder, m, n):
    x = _frames(folder, m, m + n)
    STATE["z"], seconds = timed(lambda: STATE["nystroem"].transform(x))
    return {"seconds": seconds}


def products(folder):
    """Largest difference between scalar products of the mapped frames and of our coordinates of them."""
    v, z = np.load(folder / "coordinates.npy"), STATE["z"].astype(np.float64)
    return {"difference": float(np.abs(v @ v.T - z @ z.T).max())}
