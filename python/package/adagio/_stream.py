"""What the estimators of slow features have in common: samples go into a stream, and its model is solved when it is
needed."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, ClassNamePrefixFeaturesOutMixin, TransformerMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from ._arrays import numbers

if TYPE_CHECKING:
    from typing_extensions import Self  # in typing from 3.11 on


class StreamEstimator(ClassNamePrefixFeaturesOutMixin, TransformerMixin, BaseEstimator):
    """An estimator over a stream. Subclasses have ``_begin(x)``, a stream, and ``_solve()``, its model."""

    def fit(
        self,
        X: ArrayLike,
        y: None = None,
        lengths: Sequence[int] | None = None,
        times: ArrayLike | None = None,
    ) -> Self:
        """Learn from a series.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            Samples in their order. An array of float64 in C order is not copied.
        y : None
            Not used.
        lengths : sequence of int, optional
            Lengths of separate sequences, one after the other. No derivative is taken from one to the next.
        times : array-like of shape (n_samples,), optional
            Time of each sample, ascending within a sequence. In place of `dt`.

        Returns
        -------
        self : object
        """
        x = validate_data(self, X, dtype=np.float64, order="C", ensure_min_samples=2)
        stream = self._begin(x)
        stream.push(x, self.dt, _lengths(lengths), _times(times))
        self._take(stream)
        self._solved()
        return self

    def partial_fit(
        self,
        X: ArrayLike,
        y: None = None,
        lengths: Sequence[int] | None = None,
        times: ArrayLike | None = None,
    ) -> Self:
        """Go on learning with more samples.

        Without `lengths`, the first sample follows the last one of the call before. With `lengths`, it begins a new
        sequence.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            Samples in their order. An array of float64 in C order is not copied.
        y : None
            Not used.
        lengths : sequence of int, optional
            Lengths of separate sequences, one after the other.
        times : array-like of shape (n_samples,), optional
            Time of each sample. Given for all samples of a sequence, or for none.

        Returns
        -------
        self : object
        """
        stream = getattr(self, "_stream", None)
        x = validate_data(self, X, dtype=np.float64, order="C", reset=stream is None)
        if stream is None:
            stream = self._begin(x)
        stream.push(x, self.dt, _lengths(lengths), _times(times))
        self._take(stream)
        return self

    def transform(self, X: ArrayLike) -> NDArray[np.float64]:
        """Slow features of samples.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            Samples in any order.

        Returns
        -------
        features : ndarray of shape (n_samples, n_components)
            Slowest first; mean 0 and variance 1 over the samples of the fit. Signs are arbitrary.
        """
        model = self._solved()
        return model.apply(validate_data(self, X, dtype=np.float64, order="C", reset=False))

    def fit_transform(
        self,
        X: ArrayLike,
        y: None = None,
        lengths: Sequence[int] | None = None,
        times: ArrayLike | None = None,
    ) -> NDArray[np.float64]:
        """Learn from a series, and give the features of its samples.

        Parameters
        ----------
        X, y, lengths, times
            As for :meth:`fit`.

        Returns
        -------
        features : ndarray of shape (n_samples, n_components)
            As from :meth:`transform`.
        """
        return self.fit(X, y, lengths=lengths, times=times).transform(X)

    @property
    def delta_values_(self) -> NDArray[np.float64]:
        """Slowness of each feature: the mean square of its derivative, ascending."""
        return self._solved().slowness

    @property
    def _n_features_out(self):
        return len(self.delta_values_)

    def _take(self, stream):
        self._stream = stream
        self._model = None

    def _solved(self):
        """The model of all samples so far."""
        check_is_fitted(self)
        if self._model is None:
            self._model = self._solve()
        return self._model

    def __sklearn_is_fitted__(self):
        return hasattr(self, "_stream")


def _lengths(lengths):
    return None if lengths is None else [operator.index(length) for length in lengths]


def _times(times):
    return None if times is None else numbers("times", times)
