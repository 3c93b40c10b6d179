"""Slow features that follow a stream."""

import numpy as np

from adagio import IncSFA, SFA

TIME = np.arange(60_000)
SOURCES = np.column_stack([np.sin(TIME / 50), np.cos(TIME / 9), np.sin(TIME / 2)])
SERIES = SOURCES @ np.random.default_rng(1).standard_normal((3, 3))


def test_it_finds_what_linear_slow_features_are():
    found, exact = IncSFA(2, random_state=0).fit(SERIES), SFA(2).fit(SERIES)
    correlations = np.corrcoef(found.transform(SERIES).T, exact.transform(SERIES).T)[:2, 2:]
    assert np.abs(np.diag(correlations)).min() > 0.98
    # √2 sin(t/50) has the slowness 1/50².
    np.testing.assert_allclose(found.delta_values_, [50**-2.0, 9**-2.0], rtol=0.2)


def test_parts_give_the_bits_of_the_whole():
    x = SERIES[:3000]
    whole, parts = IncSFA(2, random_state=5).fit(x), IncSFA(2, random_state=5)
    for part in np.split(x, [1, 2, 1500, 1501]):
        parts.partial_fit(part)
    np.testing.assert_array_equal(parts.components_, whole.components_)
    np.testing.assert_array_equal(parts.delta_values_, whole.delta_values_)


def test_time_is_that_of_the_samples():
    x = SERIES[:3000]
    slow = IncSFA(1, random_state=5, dt=0.1).fit(x)
    timed = IncSFA(1, random_state=5).fit(x, times=0.1 * np.arange(3000))
    np.testing.assert_allclose(slow.delta_values_, timed.delta_values_, rtol=1e-6)
    jumps = IncSFA(1, random_state=5).fit(x, lengths=[1] * 1500 + [1500])
    np.testing.assert_allclose(np.abs(jumps.components_).sum() > 0, True)
    assert not np.array_equal(jumps.components_, IncSFA(1, random_state=5).fit(x).components_)
