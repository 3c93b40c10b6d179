"""Slow features with a kernel: a slow sine that neither channel shows."""

import numpy as np
import pytest

from adagio import ALD, KernelSFA, SFA

TIME = np.linspace(0, 2 * np.pi, 2000, endpoint=False)
SERIES = np.column_stack([np.sin(TIME) + np.cos(11 * TIME) ** 2, np.cos(11 * TIME)])
SETTINGS = {"sigma": 1.5, "nu": 1e-5, "budget": 200}


def correlation(a, b):
    return abs(np.corrcoef(a, b)[0, 1])


def test_the_slowest_feature_is_the_hidden_sine():
    sfa = KernelSFA(1, **SETTINGS, dt=TIME[1]).fit(SERIES)
    assert correlation(sfa.transform(SERIES)[:, 0], np.sin(TIME)) > 0.999
    # √2 sin t has the slowness 1.
    assert sfa.delta_values_[0] == pytest.approx(1.0, rel=0.01)
    # The channels alone do not show it.
    assert correlation(SFA(1).fit_transform(SERIES)[:, 0], np.sin(TIME)) < 0.95


def test_the_width_is_chosen_where_none_is_given():
    sfa = KernelSFA(1).fit(SERIES)
    distances = np.linalg.norm(SERIES[:500, None] - SERIES[None, :500], axis=2)[np.triu_indices(500, 1)]
    # Few points span the plane: half the median distance.
    assert sfa.sigma_ == pytest.approx(0.5 * np.median(distances), rel=1e-3)
    assert correlation(sfa.transform(SERIES)[:, 0], np.sin(TIME)) > 0.99


def test_features_are_linear_ones_of_newton_coordinates():
    ald = ALD(sigma=1.5, nu=1e-3).fit(SERIES)
    v = ald.transform(SERIES)
    kernel = KernelSFA(3, sigma=1.5, nu=1e-3, regularizer=1e-6).fit(SERIES)
    np.testing.assert_array_equal(kernel.support_vectors_, ald.support_vectors_)
    linear = SFA(3, regularizer=1e-6).fit(v)
    np.testing.assert_allclose(kernel.delta_values_, linear.delta_values_, rtol=1e-6)
    assert np.abs(np.abs(kernel.transform(SERIES)) - np.abs(linear.transform(v))).max() < 1e-6


def test_parts_give_the_whole():
    whole = KernelSFA(3, **SETTINGS, regularizer=1e-6).fit(SERIES)
    parts = KernelSFA(3, **SETTINGS, regularizer=1e-6)
    for part in np.split(SERIES, [1, 77, 700, 701, 1500]):
        parts.partial_fit(part)
    np.testing.assert_allclose(parts.support_vectors_, whole.support_vectors_)
    np.testing.assert_allclose(parts.delta_values_, whole.delta_values_, rtol=1e-6)
    assert np.abs(np.abs(parts.transform(SERIES)) - np.abs(whole.transform(SERIES))).max() < 1e-6


def test_sequences_and_times():
    settings = {"n_components": 2, "sigma": 1.5, "nu": 1e-3, "regularizer": 1e-6}
    v = ALD(sigma=1.5, nu=1e-3).fit(SERIES).transform(SERIES)
    times = np.cumsum(np.random.default_rng(0).uniform(0.5, 2.0, len(SERIES)))
    for given in ({"lengths": [500, 1500]}, {"times": times}, {"lengths": [500, 1500], "times": times}):
        expected = SFA(2, regularizer=1e-6).fit(v, **given).delta_values_
        np.testing.assert_allclose(KernelSFA(**settings).fit(SERIES, **given).delta_values_, expected, rtol=1e-6)


@pytest.mark.parametrize("when_full", ["stop", "raise_nu", "replace"])
def test_a_full_dictionary_keeps_its_budget(when_full):
    sfa = KernelSFA(1, sigma=0.5, nu=1e-4, budget=40, when_full=when_full).fit(SERIES)
    assert len(sfa.support_vectors_) <= 40
    assert correlation(sfa.transform(SERIES)[:, 0], np.sin(TIME)) > 0.9
