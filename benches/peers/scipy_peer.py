"""The `k` slowest features by scipy: two dense solvers for a part of the spectrum, and ARPACK."""

import numpy as np
from scipy.linalg import blas, cholesky, eigh, solve_triangular
from scipy.sparse.linalg import LinearOperator, eigsh

from worker import STATE, timed

# The relative residual that is asked of ARPACK: ours, `adagio::slow::TOLERANCE`.
TOLERANCE = 1e-6


def moments(folder, regulariser):
    """The matrices of our moments: the covariance, and the rate with the regulariser."""
    rate = np.load(folder / "rate.npy")
    STATE["rate"] = np.asfortranarray(rate + regulariser * np.eye(len(rate)))
    STATE["covariance"] = np.asfortranarray(np.load(folder / "covariance.npy"))
    return {}


def dense(folder, k):
    m = len(STATE["rate"])
    subset = [m - k, m - 1]
    (mu, _), seconds = timed(lambda: eigh(STATE["covariance"], STATE["rate"], subset_by_index=subset, check_finite=False))
    return {"seconds": seconds, "objectives": sorted(1 / mu)}


def standard(folder, k):
    """The explicit standard problem R⁻¹CR⁻ᵀ with RRᵀ the regularised rate: two triangular solves in place, then LAPACK's
    `dsyevr` for the part of the spectrum."""
    m = len(STATE["rate"])
    subset = [m - k, m - 1]

    def work():
        factor = cholesky(STATE["rate"], lower=True, check_finite=False)
        matrix = STATE["covariance"].copy(order="F")
        matrix = blas.dtrsm(1.0, factor, matrix, lower=1, overwrite_b=1)
        matrix = blas.dtrsm(1.0, factor, matrix, side=1, lower=1, trans_a=1, overwrite_b=1)
        mu, u = eigh(matrix, subset_by_index=subset, driver="evr", overwrite_a=True, check_finite=False)
        return mu, solve_triangular(factor, u, lower=True, trans="T", check_finite=False)

    (mu, _), seconds = timed(work)
    return {"seconds": seconds, "objectives": sorted(1 / mu)}


def arpack(folder, k):
    """The largest eigenvalues of R⁻¹CR⁻ᵀ with RRᵀ the regularised rate, never formed."""
    m = len(STATE["rate"])

    def work():
        factor = cholesky(STATE["rate"], lower=True, check_finite=False)

        def apply(u):
            w = solve_triangular(factor, u, lower=True, trans="T", check_finite=False)
            return solve_triangular(factor, STATE["covariance"] @ w, lower=True, check_finite=False)

        operator = LinearOperator((m, m), matvec=apply, dtype=np.float64)
        # A start of its own, so that each run does the same.
        start = np.random.default_rng(0).standard_normal(m)
        mu, u = eigsh(operator, k=k, which="LA", tol=TOLERANCE, v0=start)
        return mu, solve_triangular(factor, u, lower=True, trans="T", check_finite=False)

    (mu, _), seconds = timed(work)
    return {"seconds": seconds, "objectives": sorted(1 / mu)}
