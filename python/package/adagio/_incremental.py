"""Incremental slow feature analysis."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from sklearn.utils import check_random_state

from ._adagio import IncrementalStream
from ._stream import StreamEstimator


class IncSFA(StreamEstimator):
    """Slow feature analysis sample by sample, without any covariance matrix.

    Principal components make the samples white, minor components of the derivative are the slowest directions. Both
    follow the stream for ever, with a memory of some thousand samples: features adapt, and jitter. A sample costs
    O(n_features · n_whitened + n_whitened · n_components²). Where there is room for matrices, :class:`adagio.SFA` is
    exact.

    Parameters
    ----------
    n_components : int, optional
        Number of features; by default `n_whitened`.
    n_whitened : int, optional
        Number of principal components; by default as many as inputs.
    smallest_variance : float, default=1e-6
        Components whose variance is below this share of the largest are left out.
    start : float, default=1e-5
        Learning rate of the minor components at the first sample.
    peak : float, default=0.01
        Learning rate after `ramp` samples.
    ramp : int, default=10000
        Samples in which the learning rate rises.
    dt : float, default=1.0
        Time from one sample to the next, where no times are given.
    random_state : int, RandomState instance or None, default=None
        Of the first directions. An int for the same features every time.

    Attributes
    ----------
    delta_values_ : ndarray of shape (n_components,)
        Slowness of each feature, averaged over about the last 2000 samples.
    components_ : ndarray of shape (n_components, n_features_in_)
        Weights of the features.
    n_features_in_ : int
        Number of inputs.

    References
    ----------
    Kompella, Luciw & Schmidhuber, Neural Computation 24 (2012).

    Examples
    --------
    >>> import numpy as np
    >>> from adagio import IncSFA
    >>> t = np.arange(40_000)
    >>> slow, fast = np.sin(t / 50), np.cos(t / 3)
    >>> X = np.column_stack([slow + fast, slow - 0.5 * fast])
    >>> feature = IncSFA(1, random_state=0).fit_transform(X)[:, 0]
    >>> bool(abs(np.corrcoef(feature, slow)[0, 1]) > 0.99)
    True
    """

    def __init__(
        self,
        n_components: int | None = None,
        *,
        n_whitened: int | None = None,
        smallest_variance: float = 1e-6,
        start: float = 1e-5,
        peak: float = 0.01,
        ramp: int = 10_000,
        dt: float = 1.0,
        random_state: int | np.random.RandomState | None = None,
    ) -> None:
        self.n_components = n_components
        self.n_whitened = n_whitened
        self.smallest_variance = smallest_variance
        self.start = start
        self.peak = peak
        self.ramp = ramp
        self.dt = dt
        self.random_state = random_state

    def _begin(self, x):
        inputs = x.shape[1]
        whitened = inputs if self.n_whitened is None else self.n_whitened
        features = whitened if self.n_components is None else self.n_components
        seed = check_random_state(self.random_state).randint(2**31 - 1)
        return IncrementalStream(
            inputs, features, whitened, self.smallest_variance, self.start, self.peak, self.ramp, seed
        )

    def _solve(self):
        return self._stream

    @property
    def components_(self) -> NDArray[np.float64]:
        """Weights, features × inputs."""
        return self._solved().weights
