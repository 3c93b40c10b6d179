"""The compiled part of ``adagio``; not for use from outside of the package."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt

_Floats = npt.NDArray[np.float64]
_Ints = npt.NDArray[np.int64]
_Flags = npt.NDArray[np.bool_]
_Pixels = npt.NDArray[np.uint8]

class RunOver(RuntimeError): ...

class Agent:
    @staticmethod
    def begin(scenario: Path | None, text: str, sets: list[str], out: Path | None) -> Agent: ...
    @staticmethod
    def resume(run: Path) -> Agent: ...
    run: Path
    actions: list[str]
    tasks: list[str]
    def act(
        self,
        image: _Pixels,
        rewards: list[tuple[str | None, float]],
        pose: tuple[float, float, float] | None,
        blocked: bool,
        done: bool,
        reset: bool,
    ) -> int | None: ...
    def observe(self, image: _Pixels, pose: tuple[float, float, float] | None) -> None: ...
    def mark(self, text: str) -> None: ...
    def goto(self, task: str) -> None: ...
    def close(self) -> str: ...

class Recorded:
    def __init__(self, run: Path) -> None: ...
    scenario: str
    actions: list[str]
    tasks: list[str]
    def export(self, out: str) -> str: ...
    def without_model(self) -> str | None: ...
    def features(self, images: list[_Pixels]) -> _Floats: ...
    def q_values(self, images: list[_Pixels], task: int) -> _Floats: ...
    def pilot(self, task: int) -> Pilot: ...

class Pilot:
    def act(self, image: _Pixels, blocked: bool, odometry: tuple[float, float, float] | None) -> int | None: ...
    def reset(self) -> None: ...

def learn(
    logs: list[Path], scenario: Path | None, sets: list[str], out: Path | None, evaluate: bool, engine: Callable[..., object]
) -> tuple[str, Path]: ...
def learn_part(
    verb: str, log: Path, frames: tuple[int, int], scenario: Path, dictionary: Path, out: Path
) -> None: ...

_What = tuple[str, bool, bool, int | None, str | None, list[Path]]

def experiment(
    what: _What, seeds: list[int], out: Path | None, cache: Path | None, engine: Callable[..., object]
) -> tuple[str, Path]: ...
def experiment_seed(what: _What, seed: int, cache: Path) -> None: ...

class LinearStream:
    def __init__(self) -> None: ...
    def push(self, x: _Floats, dt: float, lengths: list[int] | None = None, times: _Floats | None = None) -> None: ...
    def solve(self, features: int | None, regularizer: float) -> LinearModel: ...
    def __add__(self, other: LinearStream) -> LinearStream: ...

class LinearModel:
    def __init__(self, weights: _Floats, mean: _Floats, slowness: _Floats, rank_deficit: int) -> None: ...
    weights: _Floats
    mean: _Floats
    slowness: _Floats
    rank_deficit: int
    def apply(self, x: _Floats) -> _Floats: ...

class KernelStream:
    def __init__(
        self, sigma: float, exponent: float, nu: float, budget: int, when_full: str, retained: int
    ) -> None: ...
    def push(self, x: _Floats, dt: float, lengths: list[int] | None = None, times: _Floats | None = None) -> None: ...
    def solve(self, features: int, regularizer: float) -> KernelModel: ...

class KernelModel:
    def __init__(
        self,
        sigma: float,
        exponent: float,
        support_vectors: _Floats,
        projection: _Floats,
        offset: _Floats,
        slowness: _Floats,
    ) -> None: ...
    sigma: float
    support_vectors: _Floats
    slowness: _Floats
    def apply(self, x: _Floats) -> _Floats: ...

class IncrementalStream:
    def __init__(
        self,
        inputs: int,
        features: int,
        whitened: int,
        smallest_variance: float,
        start: float,
        peak: float,
        ramp: int,
        seed: int,
    ) -> None: ...
    weights: _Floats
    slowness: _Floats
    def push(self, x: _Floats, dt: float, lengths: list[int] | None = None, times: _Floats | None = None) -> None: ...
    def apply(self, x: _Floats) -> _Floats: ...

class Ald:
    def __init__(self, sigma: float, exponent: float, nu: float, budget: int, when_full: str) -> None: ...
    sigma: float
    nu: float
    support_vectors: _Floats
    indices: _Ints
    def observe(self, x: _Floats) -> None: ...
    def coordinates(self, x: _Floats) -> _Floats: ...
    def __len__(self) -> int: ...

class ActionWeights:
    def __init__(
        self, weights: _Floats, iterations: int, converged: bool, cycle: int | None, untried: list[int]
    ) -> None: ...
    weights: _Floats
    iterations: int
    converged: bool
    cycle: int | None
    def action_values(self, phi: _Floats) -> _Floats: ...
    def policy(self, phi: _Floats) -> _Ints: ...

class LocalValues:
    def __init__(self) -> None: ...
    iterations: int
    converged: bool
    arrival: float
    @staticmethod
    def fit(
        points: _Floats,
        taken: _Ints,
        rewards: _Floats,
        next: _Floats,
        ended: _Flags,
        n_actions: int,
        neighbours: int,
        ridge: float,
        gamma: float,
    ) -> LocalValues: ...
    def action_values(self, points: _Floats) -> _Floats: ...
    def policy(self, points: _Floats) -> _Ints: ...

def width_for_share(x: _Floats, nu: float, share: float, exponent: float) -> float: ...
def lspi(
    phi: _Floats,
    taken: _Ints,
    rewards: _Floats,
    next: _Floats,
    ended: _Flags,
    weights: _Floats,
    n_actions: int,
    gamma: float,
    ridge: float,
    mixing: float,
    max_iterations: int,
    tolerance: float,
    start: str,
    seed: int,
    soft: bool,
    closeness: float | None,
) -> ActionWeights: ...
