"""Exact search of nearest points by scikit-learn and faiss."""

import faiss
import numpy as np
from sklearn.neighbors import NearestNeighbors

from worker import STATE, timed


def _window(folder):
    return np.load(folder / "points.npy"), np.load(folder / "ends.npy")


def scikit_learn(folder, k, algorithm):
    points, ends = _window(folder)
    search = NearestNeighbors(n_neighbors=k, algorithm=algorithm, n_jobs=-1)
    (_, STATE["found"]), seconds = timed(lambda: search.fit(points).kneighbors(ends))
    return {"seconds": seconds}


def flat(folder, k):
    points, ends = _window(folder)

    def search():
        index = faiss.IndexFlatL2(points.shape[1])
        index.add(points)
        return index.search(ends, k)

    (_, STATE["found"]), seconds = timed(search)
    return {"seconds": seconds}


def nearest(folder, n):
    """The point that was found to be nearest to each of the first ends, by the search before."""
    return {"nearest": STATE["found"][:n, 0].tolist()}
