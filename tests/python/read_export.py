#!/usr/bin/env python3
"""Open an export with numpy and print what is in it, as JSON.

    read_export.py FOLDER

For each array of each .npz file: its type, shape, and the sum of its numbers. Of `frames.npz` the numbers,
stamps, actions and poses of all frames and a hash of each observation; of the other tables all rows. From
`model.npz` the features and values of all frames are computed again, by the formulas in `about.json`;
`features_off` and `values_off` are the largest differences from those in `frames.npz`.

Exit codes: 0 done; 1 failed; 3 numpy is not installed.
"""

import hashlib
import json
import sys
from pathlib import Path

try:
    import numpy
except ImportError as missing:
    print(f"{missing} (pip install numpy)", file=sys.stderr)
    sys.exit(3)

ALL_ROWS = ["transitions", "decisions", "models", "growth", "accepted", "evaluations"]


def plain(array):
    """An array as lists, with null for what is not a number."""
    if array.dtype.kind == "f":
        return numpy.where(numpy.isnan(array), None, array.astype(object)).tolist()
    return array.tolist()


def computed_again(frames, model, about):
    """Features and values by the model, from the observations."""
    x = frames["observation"].reshape(len(frames["observation"]), -1).astype(numpy.float64)
    s = model["observation"].reshape(len(model["observation"]), -1).astype(numpy.float64)
    squared = (x**2).sum(1)[:, None] + (s**2).sum(1)[None, :] - 2 * x @ s.T
    distance = numpy.sqrt(numpy.maximum(squared, 0))
    width = numpy.sqrt(2) * about["model"]["sigma"]
    kernel = numpy.exp(-((distance / width) ** about["model"]["exponent"]))
    features = kernel @ model["projection"] - model["offset"]
    if "weights" in model:
        features = numpy.hstack([numpy.ones((len(x), 1)), features])
        return features, numpy.einsum("taf,nf->nta", model["weights"], features)
    p = model["instances"].shape[1]
    slowness = model["slowness"][:p]
    points = features[:, :p] / numpy.sqrt(numpy.maximum(slowness / slowness.mean(), 0.001))
    values = numpy.zeros((len(x), model["worth"].shape[1], 3))
    for action in range(3):
        chosen = model["instance_action"] == action
        instances, worth = model["instances"][chosen].astype(numpy.float64), model["worth"][chosen]
        for n, point in enumerate(points.astype(numpy.float32).astype(numpy.float64)):
            values[n, :, action] = local_value(point, instances, worth, about["model"])
    return numpy.hstack([numpy.ones((len(x), 1)), features]), values


def local_value(point, instances, worth, about):
    """By linear regression with ridge on the slopes, from the nearest instances of an action."""
    squared = ((instances - point) ** 2).sum(1)
    near = numpy.argsort(squared, kind="stable")[: about["neighbours"] + 1]
    reach = squared[near[-1]] if len(near) > about["neighbours"] else 2 * squared[near[-1]]
    near = near[: about["neighbours"]]
    squared = squared[near]
    weights = numpy.maximum(1 - squared / reach, 0)
    weights = numpy.maximum(weights / weights.mean(), 0.001)
    # As a regression with a constant that is not held back: the normal equations, in place of what the program solves.
    x = numpy.hstack([numpy.ones((len(near), 1)), instances[near] - point])
    ridge = about["local_ridge"] * squared.mean() * numpy.eye(x.shape[1])
    ridge[0, 0] = 0
    return numpy.linalg.solve(x.T @ (weights[:, None] * x) + ridge, x.T @ (weights[:, None] * worth[near]))[0]


def main():
    folder = Path(sys.argv[1])
    about = json.loads((folder / "about.json").read_text())
    result = {"arrays": {}}
    for file in sorted(folder.glob("*.npz")):
        with numpy.load(file) as archive:
            arrays = {name: archive[name] for name in archive.files}
        result["arrays"][file.name] = {
            name: {"dtype": array.dtype.str, "shape": list(array.shape), "sum": float(numpy.nansum(array))}
            for name, array in arrays.items()
        }
        if file.stem in ALL_ROWS:
            result[file.stem] = {name: plain(array) for name, array in arrays.items()}
        if file.stem == "frames":
            frames = arrays
            names = ["frame", "stamp_ns", "action", "boundary", "blocked", "pose", "odometry"]
            result["frames"] = {name: plain(arrays[name]) for name in names}
            rows = [hashlib.sha256(row.tobytes()).hexdigest() for row in arrays["observation"]]
            result["frames"]["observation_sha256"] = rows
    if about["model"] is not None:
        assert about["model"]["values"]
        with numpy.load(folder / "model.npz") as archive:
            features, values = computed_again(frames, archive, about)
        result["features_off"] = float(abs(features - frames["features"]).max())
        result["values_off"] = float(abs(values - frames["q_values"]).max())
        result["largest_value"] = float(abs(values).max())
    json.dump(result, sys.stdout, allow_nan=False)
    print()


if __name__ == "__main__":
    main()
