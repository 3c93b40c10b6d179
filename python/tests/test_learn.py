"""Promise: many logs give one model, with the same bits whoever works on them."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
from rings import Ring, agent_of, dask_that_loses_a_worker, drive, program

import adagio


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    folder, paths = tmp_path_factory.mktemp("logs"), []
    for seed in range(3):
        ring = Ring(2)
        ring.at = 3 + seed
        agent = agent_of(ring, folder / f"run-{seed}", actions=600, seed=seed + 1)
        drive(agent, ring, 10**6)
        agent.close()
        paths.append(agent.run)
    return paths


@pytest.fixture(scope="module")
def here(logs, tmp_path_factory):
    return adagio.learn(logs, out=tmp_path_factory.mktemp("here") / "model")


def test_here_and_by_the_program(logs, here, tmp_path):
    program("learn", *reversed(logs), "--no-evaluate", "--workers", 2, "--out", tmp_path / "model")
    assert f'"digest": "{here["digest"]}"' in (tmp_path / "model" / "report.json").read_text()
    assert here["learned_from"]["frames"] == 3 * 601 and here["tasks"] == []
    assert (here["run"] / "checkpoint.safetensors").is_file()


def test_by_threads(logs, here, tmp_path):
    with ThreadPoolExecutor(2) as client:
        assert adagio.learn(logs, out=tmp_path / "model", client=client)["digest"] == here["digest"]


def test_by_dask_with_a_worker_that_is_killed(logs, here, tmp_path):
    with dask_that_loses_a_worker() as engine:
        assert adagio.learn(logs, out=tmp_path / "model", client=engine)["digest"] == here["digest"]


def test_settings_and_errors(logs, here, tmp_path):
    other = adagio.learn(logs[:1], out=tmp_path / "model", slow={"features": 5})
    assert other["model"]["features"] == 5
    with pytest.raises(ValueError, match="are the same log"):
        adagio.learn([logs[0], logs[0]], out=tmp_path / "no")
    with pytest.raises(ValueError, match="slow.features"):
        adagio.learn(logs, out=tmp_path / "no", slow={"features": -1})
    with pytest.raises(RuntimeError, match="nowhere"):
        adagio.learn([tmp_path / "nowhere"], out=tmp_path / "no")
    with pytest.raises(TypeError, match="True or False"):
        adagio.learn(logs, out=tmp_path / "no", evaluate={"starts": 5})
    with pytest.warns(UserWarning, match="nowhere.*left out"):
        assert adagio.learn([tmp_path / "nowhere", logs[0]], out=tmp_path / "rest")["learned_from"]["frames"] == 601

    def refuses(*_):
        raise KeyError("not today")

    class Engine:
        submit = refuses

    with pytest.raises(KeyError, match="not today"):
        adagio.learn(logs, out=tmp_path / "begun", client=Engine())
    # What was begun goes on.
    assert adagio.learn(logs, out=tmp_path / "begun")["digest"] == here["digest"]
    assert not (tmp_path / "no").exists()


def test_other_threads_run_meanwhile(logs, tmp_path):
    ticks, over = [], threading.Event()

    def tick():
        while not over.wait(0.005):
            ticks.append(time.monotonic())

    thread = threading.Thread(target=tick)
    thread.start()
    adagio.learn(logs, out=tmp_path / "model")
    over.set()
    thread.join()
    assert max(b - a for a, b in zip(ticks, ticks[1:])) < 1.0 and len(ticks) > 20
