"""Promise: an experiment over many seeds gives the same tables whoever works on it, and does nothing twice."""

import json
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import pytest
import sklearn
from rings import dask_that_loses_a_worker, finished, program, script

import adagio

NAME, SEEDS = "pose-lspi", [11, 12, 13]


def sweep(folder, seeds=SEEDS, **options):
    return adagio.experiment(NAME, seeds, smoke=True, out=folder / "out", cache=folder / "cache", **options)


def kept(folder):
    """The settings that are kept, and when each was computed."""
    return {path.name: path.stat().st_mtime_ns for path in (folder / "cache").iterdir()}


def files(folder):
    """All results but result.json, which says how long it took."""
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.name != "result.json"}


def found(result):
    """All of a result, but how long it took, where it is, and which build made it."""
    return {key: value for key, value in result.items() if key not in ("seconds", "folder", "program")}


@pytest.fixture(scope="module")
def here(tmp_path_factory):
    return sweep(tmp_path_factory.mktemp("here"))


def test_here_and_by_the_program(here, tmp_path):
    out, cache = tmp_path / "out", tmp_path / "cache"
    program("experiment", NAME, "--smoke", "--seeds", "11..13", "--out", out, "--cache", cache)
    assert found(here) == found(json.loads((out / "result.json").read_text()))
    assert files(here["folder"]) == files(out)
    assert here["seeds"] == SEEDS and "Bands over seeds 11 to 13" in str(here["notes"])
    assert here == {**json.loads((here["folder"] / "result.json").read_text()), "folder": here["folder"]}


def test_by_processes_and_not_twice(here, tmp_path):
    with ProcessPoolExecutor(2, get_context("spawn")) as client:
        assert found(sweep(tmp_path, client=client)) == found(here)
        before = kept(tmp_path)
        again = adagio.experiment(NAME, SEEDS, client=client, smoke=True, out=tmp_path / "again", cache=tmp_path / "cache")
    assert found(again) == found(here) and kept(tmp_path) == before and len(before) == len(here["cache"])


def test_forked_processes(here, tmp_path):
    text = """
        import sys
        from concurrent.futures import ProcessPoolExecutor
        from multiprocessing import get_context
        import adagio

        for seeds in ([11], [11, 12]):  # the second time from a process that has made tables
            with ProcessPoolExecutor(2, get_context("fork")) as client:
                out = f"{sys.argv[1]}/{len(seeds)}"
                adagio.experiment("online", seeds, client=client, smoke=True, out=out, cache=sys.argv[1] + "/cache")
    """
    finished(script(text, tmp_path), 120)  # its agents have threads
    with ProcessPoolExecutor(2, get_context("fork")) as client, pytest.raises(RuntimeError, match="spawn"):
        sweep(tmp_path, client=client)


def test_by_threads(here, tmp_path):
    with ThreadPoolExecutor(2) as client:
        assert found(sweep(tmp_path, client=client)) == found(here)


def test_by_dask_with_a_worker_that_is_killed(here, tmp_path):
    with dask_that_loses_a_worker() as engine:
        assert found(sweep(tmp_path, client=engine)) == found(here)


def test_what_was_begun_goes_on(here, tmp_path):
    class Engine:
        """It does two seeds, and then no more."""

        done = 0

        def submit(self, function, *arguments):
            if Engine.done == 2:
                raise KeyError("not today")
            Engine.done += 1
            function(*arguments)
            future = Future()
            future.set_result(None)
            return future

    with pytest.raises(KeyError, match="not today"):
        sweep(tmp_path, client=Engine())
    begun = kept(tmp_path)
    assert 3 * len(begun) == 2 * len(here["cache"]) and not (tmp_path / "out").exists()
    assert found(sweep(tmp_path)) == found(here)
    assert begun.items() < kept(tmp_path).items()


def test_any_seeds_and_one(here, tmp_path):
    two = sweep(tmp_path, (13, 11, 13))
    assert two["seeds"] == [11, 13] and "Bands over seeds 11, 13:" in str(two["notes"])
    before = kept(tmp_path)
    one = adagio.experiment(NAME, [11], smoke=True, out=tmp_path / "one", cache=tmp_path / "cache")
    assert one["seeds"] == [11] and "Bands" not in str(one["notes"]) and kept(tmp_path) == before


def test_default_folders(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "experiments" / NAME
    for number in ("001", "002"):
        assert (tmp_path / adagio.experiment(NAME, [11], smoke=True, vectors=50)["folder"]).samefile(folder / number)
    assert {path.name for path in folder.iterdir()} == {"001", "002", "cache"}


def test_data_of_packages(tmp_path):
    packages = Path(sklearn.__file__).parent.parent
    result = adagio.experiment("digits", [11], smoke=True, data=[packages], out=tmp_path / "out", cache=tmp_path / "cache")
    assert all(0 <= row["test error, %"] <= 100 for row in result["tables"][0]["rows"])
    with pytest.raises(ValueError, match="pip install scikit-learn"):
        adagio.experiment("digits", [11], smoke=True, data=[tmp_path], out=tmp_path / "two", cache=tmp_path / "cache")


def test_bad_calls(here, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def refused(text, name=NAME, seeds=SEEDS, error=ValueError, **options):
        with pytest.raises(error, match=text):
            adagio.experiment(name, seeds, smoke=True, **options)

    refused("there are slowness, .*did you mean pose-lspi", "pose-lpsi")
    refused("there is no seed", seeds=[])
    refused("more than 1000", seeds=range(1001))
    refused("-1 is not allowed", seeds=[-1])
    refused("float", seeds=[1.5], error=TypeError)
    refused("int", seeds=11, error=TypeError)
    refused("20 to 20 000", vectors=7)
    refused("one world", world="lab")
    refused("there is no world \"moon\"; there are lab, ", "worlds", world="moon")
    refused("one of them", quick=True)
    refused("exists already", out=here["folder"])
    assert not list(tmp_path.iterdir())
    (tmp_path / "file").touch()
    refused("file", cache=tmp_path / "file" / "cache", error=RuntimeError)


def test_ctrl_c_keeps_what_is_done(tmp_path):
    text = """
        import signal, sys, threading, time
        from pathlib import Path
        import adagio
        cache = Path(sys.argv[1])

        def interrupt():
            while len(list(cache.glob("*.json"))) < 2:
                time.sleep(0.01)
            signal.raise_signal(signal.SIGINT)

        threading.Thread(target=interrupt, daemon=True).start()
        try:
            adagio.experiment("pose-lspi", quick=True, out=cache / "out", cache=cache)
            sys.exit("nobody interrupted it")
        except KeyboardInterrupt:
            print(len(list(cache.glob("*.json"))))
    """
    assert int(finished(script(text, tmp_path / "cache"), 120)) < 20
