"""What scikit-learn expects of an estimator, pickling, and threads."""

import copy
import multiprocessing
import pickle
import signal
import threading
import time

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.exceptions import NotFittedError
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.utils.estimator_checks import parametrize_with_checks

from adagio import ALD, IncSFA, KernelSFA, LSPI, LocalValues, SFA

SLOW = [SFA(2), KernelSFA(2, sigma=2.0), IncSFA(2, random_state=0)]
TRANSFORMERS = [*SLOW, ALD(2.0)]
X = np.cumsum(np.random.default_rng(0).standard_normal((400, 4)), axis=0) / 10


def named(estimator):
    return type(estimator).__name__


# Without exceptions.
@parametrize_with_checks([SFA(), KernelSFA(), IncSFA(), ALD()])
def test_scikit_learn_checks(estimator, check):
    check(estimator)


@pytest.mark.parametrize("estimator", TRANSFORMERS, ids=named)
@pytest.mark.parametrize("copied", [copy.deepcopy, lambda fitted: pickle.loads(pickle.dumps(fitted))])
def test_a_copy_gives_the_same_and_goes_on_alike(estimator, copied):
    fitted = clone(estimator).fit(X[:250])
    other = copied(fitted)
    np.testing.assert_array_equal(other.transform(X), fitted.transform(X))
    # Before a model was solved, too.
    other = copied(fitted.partial_fit(X[250:300]))
    np.testing.assert_array_equal(other.partial_fit(X[300:]).transform(X), fitted.partial_fit(X[300:]).transform(X))


@pytest.mark.parametrize("estimator", TRANSFORMERS, ids=named)
def test_names_of_features_and_frames(estimator):
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame(X, columns=list("abcd"))
    fitted = clone(estimator).set_output(transform="pandas").fit(frame)
    features = fitted.transform(frame)
    names = [f"{type(estimator).__name__.lower()}{i}" for i in range(features.shape[1])]
    assert list(features.columns) == list(fitted.get_feature_names_out()) == names
    assert list(fitted.feature_names_in_) == list("abcd")
    both = fitted + fitted if isinstance(estimator, SFA) else fitted
    assert list(both.feature_names_in_) == list("abcd")


@pytest.mark.parametrize("estimator", SLOW, ids=named)
def test_in_a_pipeline(estimator):
    pipeline = make_pipeline(StandardScaler(), clone(estimator))
    scaled = StandardScaler().fit_transform(X)
    np.testing.assert_allclose(pipeline.fit_transform(X), clone(estimator).fit(scaled).transform(scaled))


@pytest.mark.parametrize("estimator", [*TRANSFORMERS, LSPI(), LocalValues()], ids=named)
def test_nothing_is_there_before_a_fit(estimator):
    names = [name for name in dir(type(estimator)) if name.endswith("_") and not name.startswith("_")]
    assert names
    for name in names:
        assert not hasattr(estimator, name)
        with pytest.raises(NotFittedError):
            getattr(estimator, name)


def test_one_object_from_many_threads():
    sfa, errors = SFA(2).fit(X), []

    def use(seed):
        try:
            for _ in range(50):
                part = X[seed : seed + 50]
                sfa.partial_fit(part, lengths=[50])
                assert sfa.transform(part).shape == (50, 2)
        except Exception as error:
            errors.append(error)

    threads = [threading.Thread(target=use, args=(seed,)) for seed in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(timeout=60)
        assert not thread.is_alive()
    assert not errors, errors
    # All of them were learned from, in whatever order.
    expected = SFA(2).fit(X)
    for seed in range(8):
        for _ in range(50):
            expected.partial_fit(X[seed : seed + 50], lengths=[50])
    np.testing.assert_allclose(sfa.delta_values_, expected.delta_values_, rtol=1e-9)


def _fit_and_send(pipe):
    pipe.send(KernelSFA(2, sigma=2.0).fit(X).transform(X))


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="there is no fork here")
def test_a_forked_process_has_threads_of_its_own():
    expected = KernelSFA(2, sigma=2.0).fit(X).transform(X)
    context = multiprocessing.get_context("fork")
    here, there = context.Pipe()
    process = context.Process(target=_fit_and_send, args=(there,))
    process.start()
    assert here.poll(60), "the forked process hangs"
    np.testing.assert_array_equal(here.recv(), expected)
    process.join()


def test_ctrl_c_is_heard():
    x = np.random.default_rng(0).standard_normal((200_000, 20))
    timer = threading.Timer(0.3, signal.raise_signal, [signal.SIGINT])
    timer.start()
    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        # Minutes of work.
        KernelSFA(2, sigma=1.0, nu=1e-9, budget=4000).fit(x)
    assert time.monotonic() - began < 20
