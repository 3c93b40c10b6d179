"""Bad calls: an exception with a text each; never a crash, never a hang, and objects go on working."""

import threading

import numpy as np
import pytest

from adagio import ALD, IncSFA, KernelSFA, LSPI, LocalValues, SFA, _adagio

X = np.random.default_rng(0).standard_normal((60, 3))
ACTIONS = np.arange(60) % 2
ALLOWED = (ValueError, TypeError, OverflowError, MemoryError, AttributeError)

# What no array of samples may be.
BAD_SAMPLES = [
    None, 1.0, "samples", object(), [], [[]], {}, b"bytes", np.zeros((0, 3)), np.zeros((60, 0)), X[0], X[None],
    np.where(np.arange(180).reshape(60, 3) == 77, np.nan, X), np.where(X > 2, np.inf, np.sign(X) * np.inf),
    X + 1j, np.full((60, 3), None), np.full((60, 3), "a"), [[1, 2], [3]],
    np.full((60, 3), 1e200) * np.sign(X), np.zeros(60, dtype=[("a", float)]),
]  # fmt: skip
BAD_NUMBERS = [
    None, "1", -1, 0, -0.5, np.nan, np.inf, -np.inf, 10**30, -(10**30), 2**63, 2**64, [], {}, object(), 1j, b"1", X,
    True, 0.5, 1e-320, 1e308,
]  # fmt: skip
BAD_LENGTHS = [
    1, -1, "60", [61], [-1, 61], [30, 31], [30.0, 30.0], [2**63, 2**63], [2**64], [None], X, [[60]],
    object(),
]  # fmt: skip
BAD_TIMES = [
    1, "t", np.zeros(60), np.arange(59), np.full(60, np.nan), -np.arange(60), X, [None] * 60, ["a"] * 60,
    object(), 1j * np.ones(60),
]  # fmt: skip
BAD_ACTIONS = [
    None, 1, "a", ACTIONS[:59], -ACTIONS, ACTIONS + 10**12, ACTIONS / 2, [None] * 60, X, [True] * 60,
    np.full(60, 2**63, np.uint64),
]  # fmt: skip
BAD_REWARDS = [
    None, 1, "a", X[:59, 0], np.full(60, np.nan), np.full(60, np.inf), [None] * 60, X, ["1"] * 60,
    1j * np.ones(60),
]  # fmt: skip
BAD_TERMINAL = [1, "a", np.zeros(60), np.zeros(59, bool), [None] * 60, np.zeros((60, 1), bool), object()]

TRANSFORMERS = {
    SFA: {},
    KernelSFA: {"n_components": 2},
    IncSFA: {"n_components": 2, "random_state": 0},
    ALD: {},
}
PARAMETERS = {
    SFA: ["n_components", "regularizer", "dt"],
    KernelSFA: ["n_components", "sigma", "exponent", "nu", "budget", "when_full", "regularizer", "retained", "dt"],
    IncSFA: ["n_components", "n_whitened", "smallest_variance", "start", "peak", "ramp", "dt", "random_state"],
    ALD: ["sigma", "exponent", "nu", "budget", "when_full"],
    LSPI: ["gamma", "ridge", "mixing", "max_iter", "tol", "start", "soft", "closeness", "n_actions", "random_state"],
    LocalValues: ["n_neighbors", "ridge", "gamma", "n_actions"],
}


def transitions(**changed):
    given = {"actions": ACTIONS, "rewards": X[:, 0], "following": X[::-1], "states": X, **changed}
    return given["states"], given["actions"], given["rewards"], given["following"]


def attempt(call):
    """Whether a call is refused; anything but an exception that is allowed fails the test."""
    try:
        call()
    except ALLOWED as error:
        assert str(error)
        return True
    return False


@pytest.mark.parametrize("kind", TRANSFORMERS, ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("bad", range(len(BAD_SAMPLES)))
def test_samples(kind, bad):
    fitted, bad = kind(**TRANSFORMERS[kind]).fit(X), BAD_SAMPLES[bad]
    before = fitted.transform(X)
    assert attempt(lambda: kind(**TRANSFORMERS[kind]).fit(bad)) or kind is ALD
    assert attempt(lambda: fitted.partial_fit(bad)) or kind in (ALD, KernelSFA)
    # Huge values have features, if large ones.
    attempt(lambda: fitted.transform(bad))
    if kind is SFA:
        np.testing.assert_array_equal(fitted.transform(X), before)
    assert np.isfinite(fitted.partial_fit(X).transform(X)).all()


@pytest.mark.parametrize("kind", [SFA, KernelSFA, IncSFA], ids=lambda kind: kind.__name__)
def test_lengths_and_times(kind):
    fitted = kind(**TRANSFORMERS[kind]).fit(X)
    for name, all_bad in (("lengths", BAD_LENGTHS), ("times", BAD_TIMES)):
        for bad in all_bad:
            for call in (kind(**TRANSFORMERS[kind]).fit, fitted.partial_fit):
                assert attempt(lambda: call(X, **{name: bad})), (name, bad)
    assert np.isfinite(fitted.partial_fit(X).transform(X)).all()
    timed = kind(**TRANSFORMERS[kind]).fit(X, times=np.arange(60))
    for times in (None, np.arange(60)):
        assert attempt(lambda: timed.partial_fit(X, times=times))
    assert np.isfinite(timed.partial_fit(X, times=np.arange(60) + 60).transform(X)).all()


@pytest.mark.parametrize("kind", PARAMETERS, ids=lambda kind: kind.__name__)
def test_parameters(kind):
    refused = 0
    for name in PARAMETERS[kind]:
        for bad in BAD_NUMBERS:
            estimator = kind(**{**TRANSFORMERS.get(kind, {}), name: bad})
            given = (X,) if kind in TRANSFORMERS else transitions()
            refused += attempt(lambda: estimator.fit(*given))
            if kind in TRANSFORMERS:
                attempt(lambda: estimator.partial_fit(X))
                attempt(lambda: estimator.transform(X))
    # Some are allowed for some parameters.
    assert refused > 0.5 * len(PARAMETERS[kind]) * len(BAD_NUMBERS)


@pytest.mark.parametrize("kind", [LSPI, LocalValues], ids=lambda kind: kind.__name__)
def test_transitions(kind):
    fitted = kind().fit(*transitions())
    values = fitted.action_values(X)
    for name, all_bad in {
        "states": BAD_SAMPLES, "following": BAD_SAMPLES, "actions": BAD_ACTIONS, "rewards": BAD_REWARDS
    }.items():  # fmt: skip
        for bad in all_bad:
            huge = isinstance(bad, np.ndarray) and bad.dtype == float and bad.shape == X.shape
            huge = huge and np.isfinite(bad).all()
            assert attempt(lambda: kind().fit(*transitions(**{name: bad}))) or huge, (name, bad)
    for bad in BAD_TERMINAL:
        assert attempt(lambda: kind().fit(*transitions(), terminal=bad)), bad
    for bad in BAD_SAMPLES:
        for call in (fitted.action_values, fitted.policy):
            attempt(lambda: call(bad))
    for wrong in (X[:, :2], np.column_stack([X, X])):
        assert attempt(lambda: fitted.action_values(wrong)) and attempt(lambda: fitted.policy(wrong))
    np.testing.assert_array_equal(fitted.action_values(X), values)


def test_wrong_order_of_calls():
    for kind in (*TRANSFORMERS, LSPI, LocalValues):
        for name in ("transform", "action_values", "policy", "get_feature_names_out"):
            if hasattr(kind, name):
                assert attempt(lambda: getattr(kind(), name)(X))
    for kind in TRANSFORMERS:
        fitted = kind(**TRANSFORMERS[kind]).fit(X)
        for other in (X[:, :2], np.column_stack([X, X])):
            assert attempt(lambda: fitted.transform(other)) and attempt(lambda: fitted.partial_fit(other))
        single = kind(**TRANSFORMERS[kind])
        single.partial_fit(X[:1]) if kind in (SFA, IncSFA) or single.set_params(sigma=1.0) else None
        attempt(lambda: single.partial_fit(X[:1]).transform(X))
    with pytest.raises(ValueError, match="slow features need at least 2 frames and 1 derivative: there are 1 and"):
        SFA().partial_fit(X[:1]).transform(X)
    with pytest.raises(ValueError, match="lambda = -1 is not allowed: it must be ≥ 0 and finite"):
        SFA(regularizer=-1).fit(X)
    with pytest.raises(ValueError, match=r"nu = 0 is not allowed: it must be > 0 and finite"):
        ALD(nu=0).fit(X)
    with pytest.raises(ValueError, match="lengths have the sum 61, but there are 60 samples"):
        SFA().fit(X, lengths=[30, 31])
    with pytest.raises(TypeError, match="actions must be whole numbers, but has the type float64"):
        LSPI().fit(*transitions(actions=ACTIONS / 1.0))


def test_seeded_calls_of_the_compiled_part():
    """Anything for any argument of any function and class, on several threads."""
    anything = [
        *BAD_SAMPLES, *BAD_NUMBERS, *BAD_LENGTHS, *BAD_TIMES, *BAD_ACTIONS, *BAD_TERMINAL, X, X.T, X[::2],
        X[:, 0].copy(), ACTIONS, X[:, 0] > 0, "stop", "uniform", "replace", 1.0, 1, 3, [60], X.astype(np.float32),
        {"a": X}, {"clock.last": "null"},
    ]  # fmt: skip
    made = [
        _adagio.LinearStream(), _adagio.KernelStream(1.0, 2.0, 0.1, 10, "stop", 100),
        _adagio.IncrementalStream(3, 2, 3, 1e-6, 1e-5, 0.01, 10, 0), _adagio.Ald(1.0, 2.0, 0.1, 10, "stop"),
        _adagio.LocalValues(), SFA().fit(X)._solved(), KernelSFA(1).fit(X)._solved(), LSPI().fit(*transitions())._fit,
    ]  # fmt: skip
    calls = [getattr(owner, name) for owner in (_adagio, *made) for name in dir(owner) if not name.startswith("__")]
    calls = [call for call in calls if callable(call)] + [owner.__setstate__ for owner in made[:5]]
    counts, faults = {"refused": 0, "allowed": 0}, []

    def run(seed):
        random = np.random.default_rng(seed)
        for _ in range(300):
            call = calls[random.integers(len(calls))]
            chosen = [anything[i] for i in random.integers(len(anything), size=random.integers(0, 12))]
            try:
                call(*chosen)
                counts["allowed"] += 1
            except (*ALLOWED, RuntimeError) as error:
                counts["refused"] += 1
                if "a fault of adagio" in str(error):
                    faults.append((call, chosen, error))
            except BaseException as error:
                faults.append((call, chosen, error))

    threads = [threading.Thread(target=run, args=(seed,)) for seed in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(timeout=120)
        assert not thread.is_alive(), "a call hangs"
    assert not faults, faults[:3]
    assert counts["refused"] > 800, counts
