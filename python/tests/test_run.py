"""Promise: a recorded run opens as the arrays that ``adagio export`` writes, and its model says the same of images."""

import json
import re
import tempfile
import time

import numpy as np
import pytest
from rings import Ring, agent_of, drive, program, report_of

import adagio


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    ring = Ring(4)
    agent = agent_of(ring, tmp_path_factory.mktemp("recorded") / "run", actions=1200)
    drive(agent, ring, 10**6)
    agent.close()
    return ring, agent.run


def test_it_holds_what_an_export_holds(recorded, tmp_path):
    _, path = recorded
    run = adagio.open(path)
    program("export", path, "--out", tmp_path / "out")
    about = json.loads((tmp_path / "out" / "about.json").read_text())
    assert run.about == about
    assert run.actions == about["actions"] == ["by 1", "by -1", "by 2", "by -2"]
    assert run.tasks == about["tasks"] == ["goal"]
    assert run.report == report_of(path) and run.report["digest"] == about["model"]["digest"]
    assert run.scenario == (path / "scenario.toml").read_text()
    for file, arrays in about["files"].items():
        name = file.removesuffix(".npz")
        table = getattr(run, name)
        assert set(table) == set(arrays) and name in repr(table)
        with np.load(tmp_path / "out" / file) as archive:
            for array in arrays:
                np.testing.assert_array_equal(table[array], archive[array])
                assert table[array] is table[array]
    assert run.frames["q_values"].shape == (1201, 1, 4) and run.decisions["q_values"].shape == (1200, 4)
    with pytest.raises(RuntimeError, match="value.places"):
        assert run.places


def test_a_report_counts_actions_of_every_kind(recorded, tmp_path):
    program("report", recorded[1], "--out", tmp_path / "report")
    counted = re.search(r"It drove ([\d\s]+) actions", (tmp_path / "report" / "report.html").read_text())[1]
    taken = adagio.open(recorded[1]).transitions["action"]
    assert set(taken) == {0, 1, 2, 3} and int("".join(counted.split())) == len(taken)


def test_no_files_are_left(recorded, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    run = adagio.open(recorded[1])
    assert len(run.frames) > 5
    assert not list(tmp_path.iterdir())
    assert run.frames["observation"].shape == (1201, 16, 32, 3)


def test_linear_values_of_any_number_of_actions(tmp_path):
    ring = Ring(7)
    settings = {"policy": {"explore_share": 1.0}, "value": {"method": "lspi"}}
    agent = agent_of(ring, tmp_path / "run", actions=800, **settings)
    drive(agent, ring, 10**6)
    agent.close()
    run = adagio.open(tmp_path / "run")
    features = run.frames["features"]
    assert run.model["weights"].shape == (1, 7, features.shape[1])
    q = features @ run.model["weights"][0].T
    np.testing.assert_allclose(q, run.frames["q_values"][:, 0], rtol=1e-9, atol=1e-9 * abs(q).max())


def test_features_and_values_of_images(recorded):
    ring, path = recorded
    run = adagio.open(path)
    features, q = run.features(ring.pictures), run.q_values(ring.pictures, "goal")
    assert features.shape == (24, run.frames["features"].shape[1]) and features.dtype == np.float64
    assert q.shape == (24, 4)
    # The observations that the run has made are those of the same pictures.
    one = np.flatnonzero(np.isclose(run.frames["features"], features[3], atol=1e-12).all(axis=1))[0]
    np.testing.assert_array_equal(q[3], run.frames["q_values"][one, 0])
    np.testing.assert_array_equal(run.features(list(ring.pictures)), features)
    # The products of many columns at a time differ in their last bits.
    np.testing.assert_allclose(run.features(ring.pictures[3]), features[3:4], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(run.features(ring.pictures[:, ::-1][:, ::-1]), features)
    np.testing.assert_array_equal(run.q_values(ring.pictures[3], 0), q[3:4])
    grey = ring.pictures[..., 0]
    np.testing.assert_array_equal(run.features(grey[3]), run.features(np.repeat(grey[3, ..., None], 3, axis=2)))
    # Of another size: some pixels for each one of an observation.
    small = run.frames["observation"][:5]
    large = small.repeat(2, axis=1).repeat(3, axis=2)
    np.testing.assert_array_equal(run.features(large), run.features(small))
    assert run.features([]).shape == (0, features.shape[1])
    # A step towards the goal is worth more than one away from it.
    assert (q[4:9, 1] > q[4:9, 0]).all() and (q[15:20, 0] > q[15:20, 1]).all()


def test_a_run_without_a_model_says_so(tmp_path):
    ring = Ring(2)
    agent = agent_of(ring, tmp_path / "run")
    agent.act(ring.picture)
    time.sleep(1.5)  # the log is flushed once a second
    run = adagio.open(agent.run)
    assert run.report is None and len(run.frames["frame"]) > 0
    agent.close()
    run = adagio.open(agent.run)
    assert run.report["run"]["frames"] == len(run.frames["frame"]) == 1
    assert "features" not in run.frames and run.about["model"] is None
    for call in (lambda: run.features(ring.picture), lambda: run.q_values(ring.picture, "goal"), lambda: run.model):
        with pytest.raises(RuntimeError, match="holds no checkpoint: the run ended before its first model"):
            call()


def test_what_does_not_exist_is_said(recorded, tmp_path):
    ring, path = recorded
    run = adagio.open(path)
    with pytest.raises(RuntimeError, match="cannot open the run"):
        adagio.open(tmp_path / "nowhere")
    with pytest.raises(RuntimeError, match="holds no log file"):
        adagio.open(tmp_path)
    with pytest.raises(ValueError, match="there is no task 'lamp': there are goal"):
        run.q_values(ring.picture, "lamp")
    with pytest.raises(ValueError, match="there is no task number 1: there are 1"):
        run.q_values(ring.picture, 1)
    with pytest.raises(KeyError, match="frames has no array 'x': there are action"):
        run.frames["x"]
    with pytest.raises(ValueError, match="smaller than an observation of 32 × 16"):
        run.features(ring.picture[:10])


def test_damage_is_warned_of(recorded, tmp_path):
    whole = (recorded[1] / "run_000.mcap").read_bytes()
    at = len(whole) // 10
    (tmp_path / "run_000.mcap").write_bytes(whole[:at] + bytes(1000) + whole[at + 1000 :])
    run = adagio.open(tmp_path)
    with pytest.warns(UserWarning, match="frames or records of .* could not be used"):
        assert 0 < len(run.frames["frame"]) < 1201
    assert run.about["damaged"] > 0


def test_a_policy_drives_by_the_model_alone(recorded):
    _, path = recorded
    run, ways = adagio.open(path), []
    for policy in [run.policy("goal"), run.policy(0)]:
        ring, taken = Ring(4), []
        for _ in range(20):
            policy.reset()
            picture, shortest, actions, reward = ring.reset(), ring.shortest(), 0, 0.0
            while not reward and actions < 40:
                reward = ring.step(policy.act(picture, blocked=False))
                picture, actions = ring.picture, actions + 1
            taken.append((actions, shortest))
        ways.append(taken)
    assert ways[0] == ways[1]
    actions, shortest = np.sum(ways[0], axis=0)
    assert shortest <= actions < 1.3 * shortest
    policy = run.policy("goal")
    for wrong, error in [({"image": None}, TypeError), ({"odometry": (np.nan, 0, 0)}, ValueError)]:
        with pytest.raises(error):
            policy.act(**{"image": ring.picture, **wrong})
    for task, error in [("nope", ValueError), (1, ValueError), (-1, OverflowError), (None, TypeError)]:
        with pytest.raises(error):
            run.policy(task)
