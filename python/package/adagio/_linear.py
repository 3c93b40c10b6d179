"""Linear slow feature analysis."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from sklearn.base import clone

from ._adagio import LinearStream
from ._stream import StreamEstimator


class SFA(StreamEstimator):
    """Slow feature analysis: the weighted sums of a series that change as slowly as possible.

    Features have mean 0, variance 1 and no correlation over the samples of the fit. The first one is the slowest.
    Sums over the samples are kept, and no samples. So :meth:`partial_fit` in a loop gives the bits of one :meth:`fit`,
    and estimators can be added: ``a + b`` has learned from the samples of both.

    Parameters
    ----------
    n_components : int, optional
        Number of features. By default as many as the samples have independent directions with variance.
    regularizer : float, default=0.0
        Punishes large weights: added to the slowness, times the squared norm of the weights.
    dt : float, default=1.0
        Time from one sample to the next, where no times are given.

    Attributes
    ----------
    delta_values_ : ndarray of shape (n_components,)
        Slowness of each feature: the mean square of its derivative, ascending.
    components_ : ndarray of shape (n_components, n_features_in_)
        Weights: the features of `x` are ``components_ @ (x - mean_)``.
    mean_ : ndarray of shape (n_features_in_,)
        Mean of the samples.
    rank_deficit_ : int
        Number of inputs that say nothing new.
    n_features_in_ : int
        Number of inputs.

    References
    ----------
    Wiskott & Sejnowski, Neural Computation 14 (2002).

    Examples
    --------
    >>> import numpy as np
    >>> from adagio import SFA
    >>> t = np.arange(2000)
    >>> slow, fast = np.sin(0.01 * t), np.sin(1.3 * t)
    >>> X = np.column_stack([0.1 * slow + fast, fast])
    >>> feature = SFA(n_components=1).fit_transform(X)[:, 0]
    >>> bool(abs(np.corrcoef(feature, slow)[0, 1]) > 0.9999)
    True
    """

    def __init__(self, n_components: int | None = None, *, regularizer: float = 0.0, dt: float = 1.0) -> None:
        self.n_components = n_components
        self.regularizer = regularizer
        self.dt = dt

    def _begin(self, x):
        return LinearStream()

    def _solve(self):
        return self._stream.solve(self.n_components, self.regularizer)

    @property
    def components_(self) -> NDArray[np.float64]:
        """Weights, features × inputs."""
        return self._solved().weights

    @property
    def mean_(self) -> NDArray[np.float64]:
        """Mean of the samples."""
        return self._solved().mean

    @property
    def rank_deficit_(self) -> int:
        """Number of inputs that say nothing new."""
        return self._solved().rank_deficit

    def __add__(self, other: SFA) -> SFA:
        """What was learned by both, with the parameters of the first; no derivative leads from one to the other."""
        if not isinstance(other, SFA):
            return NotImplemented
        both = clone(self)
        for part in (self, other):
            if hasattr(part, "_stream"):
                both._take(both._stream + part._stream if hasattr(both, "_stream") else part._stream + LinearStream())
                for name in ("n_features_in_", "feature_names_in_"):
                    if hasattr(part, name):
                        setattr(both, name, getattr(part, name))
        return both
