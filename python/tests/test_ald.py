"""Support vectors beside a reference in a few lines of NumPy."""

import numpy as np
import pytest

from adagio import ALD


def gaussian(a, b, sigma):
    return np.exp(-((a[:, None] - b[None]) ** 2).sum(axis=2) / (2 * sigma**2))


def reference(x, sigma, nu):
    """Numbers of the samples that are no approximate combinations of those before."""
    chosen = [0]
    for t in range(1, len(x)):
        k = gaussian(x[chosen], x[t : t + 1], sigma)[:, 0]
        residual = 1 - k @ np.linalg.solve(gaussian(x[chosen], x[chosen], sigma), k)
        if residual > nu:
            chosen.append(t)
    return chosen


X = np.random.default_rng(0).standard_normal((600, 3))


def test_support_vectors_are_those_of_the_definition():
    ald = ALD(sigma=1.2, nu=0.05).fit(X)
    chosen = reference(X, 1.2, 0.05)
    assert 30 < len(chosen) < 400
    np.testing.assert_array_equal(ald.indices_, chosen)
    np.testing.assert_array_equal(ald.support_vectors_, X[chosen])


def test_coordinates_are_those_of_the_cholesky_factor():
    ald = ALD(sigma=1.2, nu=0.05).fit(X)
    s = ald.support_vectors_
    expected = np.linalg.solve(np.linalg.cholesky(gaussian(s, s, 1.2)), gaussian(s, X, 1.2)).T
    np.testing.assert_allclose(ald.transform(X), expected, atol=1e-9)
    # What is missing of a sample is below the threshold.
    assert (1 - (expected**2).sum(axis=1)).max() <= 0.05 + 1e-9


def test_parts_give_the_whole():
    parts = ALD(sigma=1.2, nu=0.05)
    for part in np.split(X, [1, 100, 350]):
        parts.partial_fit(part)
    np.testing.assert_array_equal(parts.indices_, reference(X, 1.2, 0.05))


@pytest.mark.parametrize("when_full", ["stop", "raise_nu", "replace"])
def test_a_full_dictionary_keeps_its_budget_and_knows_its_samples(when_full):
    ald = ALD(sigma=0.7, nu=0.05, budget=50, when_full=when_full).fit(X)
    assert 30 <= len(ald.indices_) <= 50
    np.testing.assert_array_equal(ald.support_vectors_, X[ald.indices_])
    assert (ald.nu_ > 0.05) == (when_full == "raise_nu")
    assert ald.transform(X).shape == (600, len(ald.indices_))


def test_the_laplacian_kernel():
    ald = ALD(sigma=1.0, exponent=1.0, nu=0.1).fit(X)
    s = ald.support_vectors_
    v = ald.transform(s)
    distances = np.linalg.norm(s[:, None] - s[None], axis=2)
    np.testing.assert_allclose(v @ v.T, np.exp(-distances / np.sqrt(2)), atol=1e-6)
