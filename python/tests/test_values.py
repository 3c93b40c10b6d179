"""Values of actions, on the chain walk: 20 states in a row, left (0) or right (1), reward at both ends.

A step from an end pays 1; an action fails once in ten times, and its opposite happens. Lagoudakis & Parr 2003, §9.1.
"""

import pickle

import numpy as np
import pytest

from adagio import LSPI, LocalValues

STATES, GAMMA = 20, 0.9
REWARDS = np.isin(np.arange(STATES), [0, STATES - 1]).astype(float)


def step(states, actions):
    return np.clip(states + 2 * np.asarray(actions) - 1, 0, STATES - 1)


def exact():
    """Optimal values, states × actions, by iteration."""
    states, q = np.arange(STATES), np.zeros((STATES, 2))
    for _ in range(1000):
        value = q.max(axis=1)
        follow = np.column_stack([0.9 * value[step(states, a)] + 0.1 * value[step(states, 1 - a)] for a in (0, 1)])
        q = REWARDS[:, None] + GAMMA * follow
    return q


def random_steps(n, seed):
    random = np.random.default_rng(seed)
    states, actions = random.integers(0, STATES, n), random.integers(0, 2, n)
    following = step(states, np.where(random.random(n) < 0.9, actions, 1 - actions))
    return states, actions, REWARDS[states], following


def powers(states, degree=4):
    return (np.asarray(states)[:, None] / (STATES - 1)) ** np.arange(degree + 1)


@pytest.mark.parametrize("mixing", [0.3, 1.0])
def test_lspi_finds_the_optimal_values_of_a_table(mixing):
    # All transitions, weighed with their probabilities.
    states, actions, success = (part.ravel() for part in np.meshgrid(np.arange(STATES), [0, 1], [True, False]))
    following = step(states, np.where(success, actions, 1 - actions))
    table = np.eye(STATES)
    weights = np.where(success, 0.9, 0.1)
    lspi = LSPI(GAMMA, mixing=mixing, max_iter=500, tol=1e-12)
    lspi.fit(table[states], actions, REWARDS[states], table[following], sample_weight=weights)
    assert lspi.converged_ and lspi.cycle_ is None and lspi.n_iter_ >= 2
    np.testing.assert_allclose(lspi.coef_.T, exact(), atol=1e-8)
    np.testing.assert_allclose(lspi.action_values(table), exact(), atol=1e-8)
    np.testing.assert_array_equal(lspi.policy(table), [0] * 10 + [1] * 10)


def test_lspi_finds_the_policy_from_random_steps_in_a_polynomial():
    states, actions, rewards, following = random_steps(5000, seed=1)
    lspi = LSPI(GAMMA).fit(powers(states), actions, rewards, powers(following))
    wrong = lspi.policy(powers(np.arange(STATES))) != exact().argmax(axis=1)
    assert lspi.converged_ and wrong.sum() <= 1
    again = pickle.loads(pickle.dumps(lspi))
    np.testing.assert_array_equal(again.coef_, lspi.coef_)
    np.testing.assert_array_equal(again.policy(powers([3])), lspi.policy(powers([3])))
    assert (again.n_iter_, again.converged_, again.n_features_in_) == (lspi.n_iter_, True, 5)


def test_nothing_follows_where_an_episode_ends():
    phi = np.ones((2, 1))
    lspi = LSPI(GAMMA, mixing=1.0).fit(phi, [0, 1], [1.0, 0.5], phi, terminal=[True, False])
    # Action 0 pays 1 and ends; action 1 pays 0.5 for ever: 0.5/(1 − γ).
    np.testing.assert_allclose(lspi.coef_, [[1.0], [5.0]])


def test_an_action_that_was_never_tried_is_worth_nothing_known():
    states, actions, rewards, following = random_steps(500, seed=2)
    for method in (LSPI(GAMMA, n_actions=3), LocalValues(gamma=GAMMA, n_actions=3)):
        method.fit(powers(states), actions, rewards, powers(following))
        method = pickle.loads(pickle.dumps(method))
        values = method.action_values(powers(np.arange(STATES)))
        assert values.shape == (STATES, 3) and np.all(values[:, 2] == -np.inf)
        assert method.policy(powers(np.arange(STATES))).max() == 1


def test_the_options_of_lspi_reach_it():
    states, actions, rewards, following = random_steps(300, seed=3)
    given = powers(states), actions, rewards, powers(following)
    plain = LSPI(GAMMA).fit(*given)
    for options in ({"ridge": 10.0}, {"soft": True}, {"closeness": 0.5}, {"max_iter": 2}, {"gamma": 0.5}):
        assert not np.allclose(LSPI(**{"gamma": GAMMA, **options}).fit(*given).coef_, plain.coef_), options
    drawn = [LSPI(start="drawn", max_iter=1, random_state=seed).fit(*given).coef_ for seed in (1, 1, 2)]
    assert np.array_equal(drawn[0], drawn[1]) and not np.array_equal(drawn[0], drawn[2])
    first = LSPI(start="first", max_iter=1).fit(*given).coef_
    assert not np.array_equal(first, LSPI(max_iter=1).fit(*given).coef_)


def test_local_values_are_the_exact_ones_where_transitions_are_sure():
    # Every state and action once, nobody fails: the value of a transition is that of its action.
    states, actions = np.repeat(np.arange(STATES), 2), np.tile([0, 1], STATES)
    following = step(states, actions)
    values = LocalValues(1, gamma=GAMMA).fit(states[:, None], actions, REWARDS[states], following[:, None])
    q = np.zeros((STATES, 2))
    for _ in range(1000):
        q = REWARDS[:, None] + GAMMA * q.max(axis=1)[step(np.arange(STATES)[:, None], [0, 1])]
    np.testing.assert_allclose(values.action_values(np.arange(STATES)[:, None]), q, atol=1e-4)
    assert values.converged_ and values.n_features_in_ == 1


def test_local_values_find_the_way_to_a_goal():
    random = np.random.default_rng(0)
    # A square of 1 m × 1 m; steps of 0.1 to the four sides; the goal is its upper right corner.
    points, actions = random.uniform(0, 1, (3000, 2)), random.integers(0, 4, 3000)
    moves = 0.1 * np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
    following = np.clip(points + moves[actions], 0, 1)
    arrived = following.min(axis=1) > 0.85
    values = LocalValues(gamma=0.95).fit(points, actions, arrived.astype(float), following, terminal=arrived)
    assert values.converged_ and values.arrival_ > 0.99
    restored = pickle.loads(pickle.dumps(values))
    at = random.uniform(0, 1, (200, 2))
    np.testing.assert_array_equal(restored.action_values(at), values.action_values(at))
    assert (restored.arrival_, restored.n_iter_) == (values.arrival_, values.n_iter_)
    for _ in range(25):
        at = np.clip(at + moves[restored.policy(at)], 0, 1)
        at[at.min(axis=1) > 0.85] = 1.0
    assert (at.min(axis=1) == 1.0).mean() > 0.99
