"""Slow feature analysis with a kernel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ._adagio import KernelStream, width_for_share
from ._stream import StreamEstimator

# The width is chosen from so many samples, such that ALD would keep this share of them; as the agent does it.
WIDTH_SAMPLES = 500
WIDTH_SHARE = 0.65


class KernelSFA(StreamEstimator):
    """Slow feature analysis in the space of a radial kernel: features are smooth functions of the sample.

    Support vectors are chosen by approximate linear dependence (:class:`adagio.ALD`) while samples come in. Sums over
    the coordinates of the samples are kept, and the coordinates of the last `retained` samples.

    Parameters
    ----------
    n_components : int, default=5
        Number of features.
    sigma : float, optional
        Width of the kernel ``exp(-(|x - y| / (sqrt(2) sigma))**exponent)``, a distance of samples. By default it is
        chosen from the first 500 samples of the first call: the width at which 65 % of them become support vectors, but
        at least half of their median distance.
    exponent : float, default=2.0
        2 for the Gaussian kernel, 1 for the Laplacian.
    nu : float, default=0.01
        A sample becomes a support vector where its squared distance from the span of the others is above this.
    budget : int, default=2000
        Largest number of support vectors.
    when_full : {"stop", "raise_nu", "replace"}, default="stop"
        At the budget: take no more, raise `nu` and thin out, or let the least independent ones leave.
    regularizer : float, default=1e-9
        Punishes large norms of the features in the space of the kernel.
    retained : int, default=20000
        Samples that are kept for support vectors that come later. Earlier samples count as zero in their coordinates.
    dt : float, default=1.0
        Time from one sample to the next, where no times are given.

    Attributes
    ----------
    delta_values_ : ndarray of shape (n_components,)
        Slowness of each feature: the mean square of its derivative, ascending.
    support_vectors_ : ndarray of shape (n_support_vectors, n_features_in_)
        Support vectors, in the order in which they were taken.
    sigma_ : float
        Width of the kernel.
    n_features_in_ : int
        Number of inputs.

    References
    ----------
    Böhmer, Grünewälder, Nickisch & Obermayer, Machine Learning 89 (2012).

    Examples
    --------
    >>> import numpy as np
    >>> from adagio import KernelSFA
    >>> t = np.linspace(0, 2 * np.pi, 2000)
    >>> fast = np.cos(11 * t)
    >>> X = np.column_stack([np.sin(t) + fast**2, fast])
    >>> feature = KernelSFA(1, sigma=1.5, nu=1e-5, budget=200).fit_transform(X)[:, 0]
    >>> bool(abs(np.corrcoef(feature, np.sin(t))[0, 1]) > 0.99)
    True
    """

    def __init__(
        self,
        n_components: int = 5,
        *,
        sigma: float | None = None,
        exponent: float = 2.0,
        nu: float = 0.01,
        budget: int = 2000,
        when_full: str = "stop",
        regularizer: float = 1e-9,
        retained: int = 20_000,
        dt: float = 1.0,
    ) -> None:
        self.n_components = n_components
        self.sigma = sigma
        self.exponent = exponent
        self.nu = nu
        self.budget = budget
        self.when_full = when_full
        self.regularizer = regularizer
        self.retained = retained
        self.dt = dt

    def _begin(self, x):
        sigma = self.sigma
        if sigma is None:
            sigma = width_for_share(x[:WIDTH_SAMPLES], self.nu, WIDTH_SHARE, self.exponent)
        return KernelStream(sigma, self.exponent, self.nu, self.budget, self.when_full, self.retained)

    def _solve(self):
        return self._stream.solve(self.n_components, self.regularizer)

    @property
    def support_vectors_(self) -> NDArray[np.float64]:
        """Support vectors."""
        return self._solved().support_vectors

    @property
    def sigma_(self) -> float:
        """Width of the kernel."""
        return self._solved().sigma
