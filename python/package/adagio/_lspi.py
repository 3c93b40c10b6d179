"""Least-squares policy iteration."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator
from sklearn.utils import check_random_state
from sklearn.utils.validation import check_is_fitted

from ._adagio import lspi
from ._arrays import action_numbers, flags, number_of_actions, numbers, states

if TYPE_CHECKING:
    from typing_extensions import Self  # in typing from 3.11 on


class LSPI(BaseEstimator):
    """Values of actions that are linear in features, and the policy that acts on them.

    Each policy is evaluated by least squares over all transitions (LSQ), then moved towards the greedy policy of its
    values.

    Parameters
    ----------
    gamma : float, default=0.9
        Discount per action, in [0, 1).
    ridge : float, default=0.0
        Added to the diagonal of the system of equations.
    mixing : float, default=0.3
        Share of the greedy policy in each step, in (0, 1]. With 1 this is the iteration of Lagoudakis & Parr, which can
        run in circles.
    max_iter : int, default=100
        Evaluations at most.
    tol : float, default=1e-6
        Converged where no weight changes by more than this share of the largest one.
    start : {"uniform", "drawn", "first"}, default="uniform"
        The first policy: all actions alike, one drawn for each transition, or the first action.
    soft : bool, default=False
        Let each action follow with the probability that it is the best one, in place of the greedy action.
    closeness : float, optional
        Weigh transitions more whose two best actions are close in value, the more the smaller this is.
    n_actions : int, optional
        Number of actions; by default as many as were seen.
    random_state : int, RandomState instance or None, default=None
        For ``start="drawn"``.

    Attributes
    ----------
    coef_ : ndarray of shape (n_actions, n_features_in_)
        Weights: the value of action `a` is ``coef_[a] @ phi``.
    n_iter_ : int
        Evaluations done.
    converged_ : bool
        Whether weights and policy stopped changing. It does not say that the policy is good.
    cycle_ : int or None
        Length of the circle that the policy ran in, if it did.
    n_features_in_ : int
        Number of features.

    References
    ----------
    Lagoudakis & Parr, Journal of Machine Learning Research 4 (2003).

    Examples
    --------
    One state; action 1 pays 1 for ever, action 0 pays nothing.

    >>> from adagio import LSPI
    >>> values = LSPI(mixing=1.0).fit([[1.0], [1.0]], [0, 1], [0.0, 1.0], [[1.0], [1.0]])
    >>> values.action_values([[1.0]]).round(6)
    array([[ 9., 10.]])
    """

    def __init__(
        self,
        gamma: float = 0.9,
        *,
        ridge: float = 0.0,
        mixing: float = 0.3,
        max_iter: int = 100,
        tol: float = 1e-6,
        start: str = "uniform",
        soft: bool = False,
        closeness: float | None = None,
        n_actions: int | None = None,
        random_state: int | np.random.RandomState | None = None,
    ) -> None:
        self.gamma = gamma
        self.ridge = ridge
        self.mixing = mixing
        self.max_iter = max_iter
        self.tol = tol
        self.start = start
        self.soft = soft
        self.closeness = closeness
        self.n_actions = n_actions
        self.random_state = random_state

    def fit(
        self,
        phi: ArrayLike,
        actions: ArrayLike,
        rewards: ArrayLike,
        next_phi: ArrayLike,
        *,
        terminal: ArrayLike | None = None,
        sample_weight: ArrayLike | None = None,
    ) -> Self:
        """Learn from transitions.

        Parameters
        ----------
        phi : array-like of shape (n_samples, n_features)
            Features before each action. Include a constant one.
        actions : array-like of int of shape (n_samples,)
            Action taken, from 0 on.
        rewards : array-like of shape (n_samples,)
            Reward received.
        next_phi : array-like of shape (n_samples, n_features)
            Features after each action.
        terminal : array-like of bool of shape (n_samples,), optional
            Whether the episode ended with the transition.
        sample_weight : array-like of shape (n_samples,), optional
            Weight of each transition.

        Returns
        -------
        self : object
        """
        phi, next_phi = states("phi", phi), states("next_phi", next_phi)
        actions = action_numbers(actions)
        weights = np.ones(len(phi)) if sample_weight is None else numbers("sample_weight", sample_weight)
        seed = check_random_state(self.random_state).randint(2**31 - 1)
        self._fit = lspi(
            phi,
            actions,
            numbers("rewards", rewards),
            next_phi,
            flags(terminal, len(next_phi)),
            weights,
            number_of_actions(self.n_actions, actions),
            self.gamma,
            self.ridge,
            self.mixing,
            self.max_iter,
            self.tol,
            self.start,
            seed,
            self.soft,
            self.closeness,
        )
        self.n_features_in_ = phi.shape[1]
        return self

    def action_values(self, phi: ArrayLike) -> NDArray[np.float64]:
        """Values of all actions.

        Parameters
        ----------
        phi : array-like of shape (n_samples, n_features)
            Features of states.

        Returns
        -------
        q : ndarray of shape (n_samples, n_actions)
            Values; minus infinity for an action that was never tried.
        """
        return self._fitted().action_values(states("phi", phi))

    def policy(self, phi: ArrayLike) -> NDArray[np.int64]:
        """The action of the largest value.

        Parameters
        ----------
        phi : array-like of shape (n_samples, n_features)
            Features of states.

        Returns
        -------
        actions : ndarray of int of shape (n_samples,)
        """
        return self._fitted().policy(states("phi", phi))

    def _fitted(self):
        check_is_fitted(self)
        return self._fit

    @property
    def coef_(self) -> NDArray[np.float64]:
        """Weights, actions × features."""
        return self._fitted().weights

    @property
    def n_iter_(self) -> int:
        """Evaluations done."""
        return self._fitted().iterations

    @property
    def converged_(self) -> bool:
        """Whether weights and policy stopped changing."""
        return self._fitted().converged

    @property
    def cycle_(self) -> int | None:
        """Length of the circle that the policy ran in, if it did."""
        return self._fitted().cycle

    def __sklearn_is_fitted__(self):
        return hasattr(self, "_fit")
