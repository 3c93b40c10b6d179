"""Support vectors by approximate linear dependence."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, ClassNamePrefixFeaturesOutMixin, TransformerMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from ._adagio import Ald, width_for_share
from ._kernel import WIDTH_SAMPLES, WIDTH_SHARE

if TYPE_CHECKING:
    from typing_extensions import Self  # in typing from 3.11 on


class ALD(ClassNamePrefixFeaturesOutMixin, TransformerMixin, BaseEstimator):
    """A dictionary of samples that are not approximately linear combinations of each other in the space of a radial
    kernel.

    :meth:`transform` gives Newton coordinates ``v(x) = L⁻¹ k(x)``, with the kernel values ``k(x)`` of a sample with all
    support vectors and the Cholesky factor ``L`` of their kernel matrix. Products of coordinates are kernel values,
    ``v(x) @ v(y) ≈ k(x, y)``: a linear method on `v` is the kernel method.

    Parameters
    ----------
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

    Attributes
    ----------
    support_vectors_ : ndarray of shape (n_support_vectors, n_features_in_)
        Support vectors, in the order in which they were taken.
    indices_ : ndarray of shape (n_support_vectors,)
        Number of the sample that each was, over all calls.
    nu_ : float
        The threshold at this moment.
    sigma_ : float
        Width of the kernel.
    n_features_in_ : int
        Number of inputs.

    References
    ----------
    Engel, Mannor & Meir, IEEE Transactions on Signal Processing 52 (2004); Müller & Schaback, Journal of Approximation
    Theory 161 (2009).

    Examples
    --------
    >>> import numpy as np
    >>> from adagio import ALD
    >>> circle = np.column_stack([np.cos(np.arange(1000)), np.sin(np.arange(1000))])
    >>> ald = ALD(sigma=0.5).fit(circle)
    >>> len(ald.indices_) < 20
    True
    >>> v = ald.transform(circle)
    >>> bool((v * v).sum(axis=1).min() > 1 - 0.01 - 1e-12)
    True
    """

    def __init__(
        self,
        sigma: float | None = None,
        *,
        exponent: float = 2.0,
        nu: float = 0.01,
        budget: int = 2000,
        when_full: str = "stop",
    ) -> None:
        self.sigma = sigma
        self.exponent = exponent
        self.nu = nu
        self.budget = budget
        self.when_full = when_full

    def fit(self, X: ArrayLike, y: None = None) -> Self:
        """Choose support vectors among samples, in their order.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            Samples. An array of float64 in C order is not copied.
        y : None
            Not used.

        Returns
        -------
        self : object
        """
        x = validate_data(self, X, dtype=np.float64, order="C", ensure_min_samples=2)
        ald = self._begin(x)
        ald.observe(x)
        self._ald = ald
        return self

    def partial_fit(self, X: ArrayLike, y: None = None) -> Self:
        """Go on choosing among more samples.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            Samples. An array of float64 in C order is not copied.
        y : None
            Not used.

        Returns
        -------
        self : object
        """
        ald = getattr(self, "_ald", None)
        x = validate_data(self, X, dtype=np.float64, order="C", reset=ald is None)
        if ald is None:
            ald = self._begin(x)
        ald.observe(x)
        self._ald = ald
        return self

    def transform(self, X: ArrayLike) -> NDArray[np.float64]:
        """Newton coordinates of samples.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            Samples.

        Returns
        -------
        v : ndarray of shape (n_samples, n_support_vectors)
            Coordinates. Those that exist stay as they are when a support vector is added.
        """
        check_is_fitted(self)
        return self._ald.coordinates(validate_data(self, X, dtype=np.float64, order="C", reset=False))

    def _begin(self, x):
        sigma = self.sigma
        if sigma is None:
            sigma = width_for_share(x[:WIDTH_SAMPLES], self.nu, WIDTH_SHARE, self.exponent)
        return Ald(sigma, self.exponent, self.nu, self.budget, self.when_full)

    def _chosen(self):
        check_is_fitted(self)
        return self._ald

    @property
    def support_vectors_(self) -> NDArray[np.float64]:
        """Support vectors."""
        return self._chosen().support_vectors

    @property
    def indices_(self) -> NDArray[np.int64]:
        """Numbers of the samples that they were."""
        return self._chosen().indices

    @property
    def nu_(self) -> float:
        """The threshold at this moment."""
        return self._chosen().nu

    @property
    def sigma_(self) -> float:
        """Width of the kernel."""
        return self._chosen().sigma

    @property
    def _n_features_out(self):
        return len(self._chosen())

    def __sklearn_is_fitted__(self):
        return hasattr(self, "_ald")
