"""Linear slow features: a dense reference, another package, and how samples may come."""

import pickle

import numpy as np
import pytest
import scipy.linalg
import sksfa

from adagio import SFA


def series(samples=1500, channels=12, seed=0):
    """Mixed noise with memories from short to long."""
    random = np.random.default_rng(seed)
    sources = random.standard_normal((samples, channels))
    memory = np.linspace(0.1, 0.98, channels)
    for t in range(1, samples):
        sources[t] += memory * sources[t - 1]
    return sources @ random.standard_normal((channels, channels)) + 100 * random.standard_normal(channels)


def reference(x, regularizer=0.0, lengths=None, times=None):
    """Features and slowness by the generalised eigenvalues of dense matrices."""
    starts = np.cumsum([0, *lengths])[:-1] if lengths else [0]
    inner = np.setdiff1d(np.arange(1, len(x)), starts)
    steps = np.ones(len(inner)) if times is None else np.asarray(times)[inner] - np.asarray(times)[inner - 1]
    rates = (x[inner] - x[inner - 1]) / steps[:, None]
    rate = rates.T @ rates / len(rates)
    values, weights = scipy.linalg.eigh(rate + regularizer * np.eye(x.shape[1]), np.cov(x.T, ddof=0))
    slowness = np.einsum("ik,ij,jk->k", weights, rate, weights)
    return (x - x.mean(axis=0)) @ weights, slowness


def difference(a, b):
    """Largest difference of features, signs aside."""
    return np.abs(a - np.sign((a * b).sum(axis=0)) * b).max()


def equal(a, b):
    """Whether two have the same model, bit for bit."""
    names = ("components_", "mean_", "delta_values_")
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in names)


@pytest.mark.parametrize("regularizer", [0.0, 0.3])
def test_features_and_slowness_are_those_of_dense_eigenvalues(regularizer):
    x = series()
    sfa = SFA(regularizer=regularizer).fit(x)
    features, slowness = reference(x, regularizer)
    # Regularised features stand in the order of their own slowness.
    order = np.argsort(slowness)
    assert difference(sfa.transform(x), features[:, order]) < 1e-6
    np.testing.assert_allclose(sfa.delta_values_, slowness[order], rtol=1e-9)
    assert np.all(np.diff(sfa.delta_values_) >= 0)
    y = sfa.transform(x)
    np.testing.assert_allclose(y.T @ y / len(y), np.eye(12), atol=1e-9)


def test_features_are_those_of_sklearn_sfa():
    x = series(3000, 20, seed=1)
    # The mean of its derivative, which sklearn-sfa takes off, is zero for a series that ends where it began.
    x[-1] = x[0]
    theirs = sksfa.SFA(n_components=20).fit(x)
    ours = SFA(n_components=20).fit(x)
    # Its variance is 1 when divided by n − 1.
    scale = np.sqrt(len(x) / (len(x) - 1))
    assert difference(ours.transform(x), scale * theirs.transform(x)) < 1e-6
    # Its slowness is the variance, divided by n − 2.
    expected = theirs.delta_values_ * scale**2 * (len(x) - 2) / (len(x) - 1)
    np.testing.assert_allclose(ours.delta_values_, expected, rtol=1e-6)


def test_no_derivative_is_taken_across_the_borders_of_sequences():
    lengths = [400, 1, 0, 700, 399]
    x = series()
    x[400:] += 1000
    sfa = SFA().fit(x, lengths=lengths)
    features, slowness = reference(x, lengths=lengths)
    np.testing.assert_allclose(sfa.delta_values_, slowness, rtol=1e-6)
    assert difference(sfa.transform(x), features) < 1e-6
    assert not np.allclose(SFA().fit(x).delta_values_, slowness, rtol=0.01)


def test_times_of_samples():
    x = series()
    times = np.cumsum(np.random.default_rng(3).uniform(0.5, 2.0, len(x)))
    features, slowness = reference(x, times=times)
    sfa = SFA().fit(x, times=times)
    np.testing.assert_allclose(sfa.delta_values_, slowness, rtol=1e-9)
    assert difference(sfa.transform(x), features) < 1e-6
    # Time may begin anew with a sequence.
    lengths, again = [600, 900], np.concatenate([times[:600], times[600:] - times[600]])
    np.testing.assert_allclose(
        SFA().fit(x, lengths=lengths, times=again).delta_values_, reference(x, 0.0, lengths, times)[1], rtol=1e-9
    )
    # A regular step is the same as its times.
    np.testing.assert_allclose(
        SFA(dt=0.04).fit(x).delta_values_, SFA().fit(x, times=0.04 * np.arange(len(x))).delta_values_, rtol=1e-9
    )


def test_parts_give_the_bits_of_the_whole():
    x, random = series(), np.random.default_rng(4)
    whole, whole_timed = SFA(5).fit(x), SFA(5).fit(x, times=np.arange(len(x)) ** 1.1)
    for _ in range(10):
        cuts = np.sort(random.integers(0, len(x), random.integers(1, 40)))
        parts, timed = SFA(5), SFA(5)
        for part in np.split(np.arange(len(x)), cuts):
            if len(part):
                parts.partial_fit(x[part])
                timed.partial_fit(x[part], times=part**1.1)
                parts = pickle.loads(pickle.dumps(parts))
        assert equal(parts, whole) and equal(timed, whole_timed)
    single = SFA(5)
    for sample in x:
        single.partial_fit(sample[None])
    assert equal(single, whole)
    sequences = SFA(5).partial_fit(x[:700]).partial_fit(x[700:], lengths=[300, 500])
    assert equal(sequences, SFA(5).fit(x, lengths=[700, 300, 500]))


def test_sums_add():
    x = series()
    a, b = SFA(5, dt=0.5).fit(x[:600]), SFA(3, dt=0.5).partial_fit(x[600:])
    both, expected = a + b, SFA(5, dt=0.5).fit(x, lengths=[600, 900])
    np.testing.assert_allclose(both.delta_values_, expected.delta_values_, rtol=1e-9)
    assert difference(both.transform(x), expected.transform(x)) < 1e-9
    np.testing.assert_allclose(both.mean_, expected.mean_, rtol=1e-12)
    # What is pushed next follows the last sample of the second.
    assert both.partial_fit(x[:9]).delta_values_[0] != both.partial_fit(x[:9], lengths=[9]).delta_values_[0]
    goes_on = (SFA(5).fit(x[:600]) + SFA().fit(x[600:1000])).partial_fit(x[1000:])
    np.testing.assert_allclose(goes_on.delta_values_, SFA(5).fit(x, lengths=[600, 900]).delta_values_, rtol=1e-9)
    # An estimator that has seen nothing adds nothing, and terms stay as they were.
    assert equal(SFA(5, dt=0.5) + a, a) and equal(a + SFA(), a) and equal(a, SFA(5, dt=0.5).fit(x[:600]))
    assert sum((SFA().fit(part) for part in np.split(x, 5)), start=SFA(5)).n_features_in_ == 12
    with pytest.raises(ValueError, match="a frame's number of values has 3, but 12 is needed"):
        a + SFA().fit(x[:, :3])
    with pytest.raises(TypeError):
        a + 1


def test_channels_that_depend_on_each_other_are_counted():
    x = series()
    x = np.column_stack([x, x[:, 0], np.full(len(x), 7.0), x @ np.ones(12)])
    sfa = SFA().fit(x)
    assert sfa.rank_deficit_ == 3 and sfa.transform(x).shape == (len(x), 12)
    assert difference(sfa.transform(x), SFA().fit(x[:, :12]).transform(x[:, :12])) < 1e-5
    with pytest.raises(ValueError, match="13 features are asked for, but the observations span 12 directions only"):
        SFA(13).fit(x)


def test_an_array_in_c_order_is_not_copied(monkeypatch):
    seen = []
    push = SFA._begin
    x = series()

    class Spy:
        def __init__(self, stream):
            self.stream = stream

        def push(self, given, *rest):
            seen.append(given)
            self.stream.push(given, *rest)

        def solve(self, *rest):
            return self.stream.solve(*rest)

    monkeypatch.setattr(SFA, "_begin", lambda self, x: Spy(push(self, x)))
    SFA().fit(x)
    assert np.shares_memory(seen[0], x)
    # Others are converted.
    expected = SFA(3).fit(x).transform(x)
    for other in (np.asfortranarray(x), x[::-1][::-1], np.repeat(x, 2, axis=1)[:, ::2], x.tolist()):
        np.testing.assert_array_equal(SFA(3).fit(other).transform(other), expected)
    single = x.astype(np.float32)
    assert SFA(3).fit(single).transform(single).dtype == np.float64
