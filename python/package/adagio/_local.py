"""Values of actions from the transitions nearby."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator
from sklearn.utils.validation import check_is_fitted

from . import _adagio
from ._arrays import action_numbers, flags, number_of_actions, numbers, states

if TYPE_CHECKING:
    from typing_extensions import Self  # in typing from 3.11 on


class LocalValues(BaseEstimator):
    """Values of actions by fitted Q iteration: each is a linear regression over the nearest transitions with that
    action.

    States are points whose distances say how near they are, such as slow features.

    Parameters
    ----------
    n_neighbors : int, default=16
        Transitions with the same action that a value is estimated from.
    ridge : float, default=0.3
        Ridge on the slopes of the regression, in mean squared distances of the neighbours. Large values leave a
        weighted mean.
    gamma : float, default=0.9
        Discount per action, in [0, 1).
    n_actions : int, optional
        Number of actions, at most 32; by default as many as were seen.

    Attributes
    ----------
    n_iter_ : int
        Sweeps done.
    converged_ : bool
        Whether values settled. It does not say that the policy is good.
    arrival_ : float
        Share of the transitions after which the greedy policy arrives at a reward.
    n_features_in_ : int
        Number of coordinates of a point.

    References
    ----------
    Ernst, Geurts & Wehenkel, Journal of Machine Learning Research 6 (2005); Ormoneit & Sen, Machine Learning 49 (2002).

    Examples
    --------
    A corridor from 0 to 1, steps of 0.1 to the left (0) and right (1), the goal at its right end.

    >>> import numpy as np
    >>> from adagio import LocalValues
    >>> x, actions = np.repeat(np.arange(50) / 50, 2), np.tile([0, 1], 50)
    >>> following = np.where(actions == 1, x + 0.1, np.maximum(x - 0.1, 0))
    >>> arrived = following >= 1
    >>> values = LocalValues(n_neighbors=4)
    >>> values = values.fit(x[:, None], actions, arrived.astype(float), following[:, None], terminal=arrived)
    >>> values.policy([[0.33]]), values.arrival_
    (array([1]), 1.0)
    """

    def __init__(
        self,
        n_neighbors: int = 16,
        *,
        ridge: float = 0.3,
        gamma: float = 0.9,
        n_actions: int | None = None,
    ) -> None:
        self.n_neighbors = n_neighbors
        self.ridge = ridge
        self.gamma = gamma
        self.n_actions = n_actions

    def fit(
        self,
        points: ArrayLike,
        actions: ArrayLike,
        rewards: ArrayLike,
        next_points: ArrayLike,
        *,
        terminal: ArrayLike | None = None,
    ) -> Self:
        """Learn from transitions.

        Parameters
        ----------
        points : array-like of shape (n_samples, n_features)
            States before each action.
        actions : array-like of int of shape (n_samples,)
            Action taken, from 0 on.
        rewards : array-like of shape (n_samples,)
            Reward received.
        next_points : array-like of shape (n_samples, n_features)
            States after each action.
        terminal : array-like of bool of shape (n_samples,), optional
            Whether the episode ended with the transition.

        Returns
        -------
        self : object
        """
        points, next_points = states("points", points), states("next_points", next_points)
        actions = action_numbers(actions)
        self._fit = _adagio.LocalValues.fit(
            points,
            actions,
            numbers("rewards", rewards),
            next_points,
            flags(terminal, len(next_points)),
            number_of_actions(self.n_actions, actions),
            self.n_neighbors,
            self.ridge,
            self.gamma,
        )
        self.n_features_in_ = points.shape[1]
        return self

    def action_values(self, points: ArrayLike) -> NDArray[np.float64]:
        """Values of all actions.

        Parameters
        ----------
        points : array-like of shape (n_samples, n_features)
            States.

        Returns
        -------
        q : ndarray of shape (n_samples, n_actions)
            Values; minus infinity for an action that was never tried.
        """
        return self._fitted().action_values(states("points", points))

    def policy(self, points: ArrayLike) -> NDArray[np.int64]:
        """The action of the largest value.

        Parameters
        ----------
        points : array-like of shape (n_samples, n_features)
            States.

        Returns
        -------
        actions : ndarray of int of shape (n_samples,)
        """
        return self._fitted().policy(states("points", points))

    def _fitted(self):
        check_is_fitted(self)
        return self._fit

    @property
    def n_iter_(self) -> int:
        """Sweeps done."""
        return self._fitted().iterations

    @property
    def converged_(self) -> bool:
        """Whether values settled."""
        return self._fitted().converged

    @property
    def arrival_(self) -> float:
        """Share of the transitions after which the greedy policy arrives."""
        return self._fitted().arrival

    def __sklearn_is_fitted__(self):
        return hasattr(self, "_fit")
