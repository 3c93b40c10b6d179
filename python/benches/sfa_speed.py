"""Linear slow feature analysis beside sklearn-sfa: the same series, one process, one after the other.

``python python/benches/sfa_speed.py`` prints the time of each fit and the largest difference of features, signs aside.
OpenBLAS must not be told another processor than there is: unset OPENBLAS_CORETYPE and OPENBLAS_L2_SIZE.
"""

from __future__ import annotations

import argparse
import os
import statistics
import time

import numpy as np
import sksfa

from adagio import SFA


def series(samples: int, channels: int, seed: int) -> np.ndarray:
    """Mixed noise of as many time constants as there are channels.

    It ends where it began: sklearn-sfa takes the mean off the derivative, which then is zero.
    """
    random = np.random.default_rng(seed)
    sources = random.standard_normal((samples, channels))
    # A circular filter of the first order: the memory of source i is i/channels.
    memory = np.arange(1, channels + 1) / (channels + 1)
    frequencies = np.exp(-2j * np.pi * np.fft.rfftfreq(samples - 1))[:, None]
    spectrum = np.fft.rfft(sources[:-1], axis=0) / (1 - memory * frequencies)
    sources[:-1] = np.fft.irfft(spectrum, samples - 1, axis=0)
    sources[-1] = sources[0]
    return np.ascontiguousarray(sources @ random.standard_normal((channels, channels)))


def difference(ours: np.ndarray, theirs: np.ndarray) -> float:
    """Largest difference of features of standard deviation 1, signs aside."""
    # Theirs have variance 1 when they are divided by n - 1.
    theirs = theirs * np.sqrt(len(theirs) / (len(theirs) - 1))
    signs = np.sign((ours * theirs).sum(axis=0))
    return float(np.abs(ours - signs * theirs).max())


def timed(fit):
    start = time.perf_counter()
    fitted = fit()
    return time.perf_counter() - start, fitted


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=20_000)
    parser.add_argument("--channels", type=int, default=200)
    parser.add_argument("--features", type=int, help="default: all")
    parser.add_argument("--rounds", type=int, default=5)
    asked = parser.parse_args()
    for name in ("OPENBLAS_CORETYPE", "OPENBLAS_L2_SIZE"):
        if name in os.environ:
            print(f"{name} = {os.environ[name]}: the times of sklearn-sfa may be too long")
    x = series(asked.samples, asked.channels, seed=1)
    features = asked.features or asked.channels
    ours, theirs = [], []
    for _ in range(asked.rounds):
        taken, sfa = timed(lambda: SFA(features).fit(x))
        ours.append(taken)
        taken, other = timed(lambda: sksfa.SFA(features).fit(x))
        theirs.append(taken)
        print(f"adagio {ours[-1]:.3f} s, sklearn-sfa {theirs[-1]:.3f} s")
    ratio = statistics.median(theirs) / statistics.median(ours)
    print(f"{asked.samples} × {asked.channels}, {features} features, medians: {statistics.median(ours):.3f} s", end="")
    print(f" and {statistics.median(theirs):.3f} s, {ratio:.1f} × the speed")
    print(f"largest difference of features: {difference(sfa.transform(x), other.transform(x)):.1e}")


if __name__ == "__main__":
    main()
