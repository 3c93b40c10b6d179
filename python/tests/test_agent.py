"""Promise: a program that drives an `Agent` is learned from like any robot, and no call of it crashes or hangs."""

import gc
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from rings import GOAL, HERE, Ring, agent_of, drive, finished, replayed_digest, report_of, script

import adagio

@pytest.mark.parametrize("n_actions", [2, 4, 7])
def test_it_learns_to_go_to_a_place(n_actions, tmp_path):
    took, shortest, random = [], [], []
    for seed in range(3):
        ring = Ring(n_actions, seed)
        agent = agent_of(ring, tmp_path / str(seed), seed=seed, actions=3000)
        assert drive(agent, ring, 1500) == 1500
        dice = np.random.default_rng(seed)
        for _ in range(15):
            agent.goto("goal")
            action, actions, arrived = agent.act(ring.reset(), reset=True), 0, False
            start = ring.at
            shortest.append(ring.shortest())
            while not arrived and actions < 200:
                arrived, actions = ring.step(action) > 0, actions + 1
                action = agent.act(ring.picture, reward=float(arrived), done=arrived)
            took.append(actions)
            for _ in range(10):
                ring.at, actions = start, 1
                while ring.step(dice.integers(n_actions)) == 0:
                    actions += 1
                random.append(actions)
        report = agent.close()
        assert report == report_of(agent.run) and report["run"]["without_model"] is None
        assert replayed_digest(agent.run) == report["digest"]
    took, shortest, random = np.mean(took), np.mean(shortest), np.mean(random)
    print(f"{n_actions} actions: {took:.1f} steps; the shortest way has {shortest:.1f}, a random walk {random:.1f}")
    assert took < 1.5 * shortest and took < 0.4 * random


def test_the_same_images_give_the_same_digest_however_they_lie_in_memory(tmp_path):
    def strided(image):
        room = np.zeros((2 * image.shape[0], 3 * image.shape[1], 5), np.uint8)
        room[::2, ::3, 1:4] = image
        return room[::2, ::3, 1:4]

    ways = {
        "contiguous": lambda image: image,
        "strided": strided,
        "fortran": np.asfortranarray,
        "negative": lambda image: image[::-1, ::-1, ::-1].copy()[::-1, ::-1, ::-1],
        "read_only": lambda image: np.frombuffer(image.tobytes(), np.uint8).reshape(image.shape),
    }
    digests = set()
    for name, way in ways.items():
        ring = Ring(3)
        agent = agent_of(ring, tmp_path / name, actions=800)
        action = agent.act(way(ring.reset()))
        for _ in range(700):
            reward = ring.step(action)
            action = agent.act(way(ring.picture), reward=reward)
        digests.add(agent.close()["digest"])
    assert len(digests) == 1


def test_an_episode_that_ends_is_no_transition(tmp_path):
    ring = Ring(3)
    agent = agent_of(ring, tmp_path / "run", actions=400)
    frame, ends, begins, actions = 0, set(), {0}, {}
    action = agent.act(ring.reset())
    for step in range(300):
        ring.step(action)
        done, reset = step % 7 == 6, step % 11 == 10
        if step % 3 == 0:
            agent.observe(ring.picture)
            frame += 1
            actions[frame] = action
        frame += 1
        actions[frame] = action
        action = agent.act(ring.picture, reward=0.5, done=done)
        if done:
            assert action is None
            ends.add(frame)
        if done or reset:
            if step % 4 == 0:  # an episode of a single image
                frame += 1
                begins.add(frame)
                assert agent.act(ring.reset(), reset=True, done=True) is None
            frame += 1
            begins.add(frame)
            action = agent.act(ring.reset(), reset=reset)
    ring.step(action)
    frame += 1
    actions[frame] = action
    assert agent.act(ring.picture, done=True) is None  # the last image is kept, too
    agent.close()
    run = adagio.open(agent.run)
    taken = run.frames["action"]
    assert run.frames["frame"].tolist() == list(range(frame + 1))
    assert {number: action for number, action in enumerate(taken) if action >= 0} == actions
    assert set(np.flatnonzero(taken < 0)) == begins
    came_from, came_to = run.transitions["from_frame"], run.transitions["to_frame"]
    assert not begins & set(came_to) and not ends & set(came_from)
    assert len(came_to) == 301 and (came_to - came_from <= 2).all()
    assert (run.transitions["action"] == taken[came_to]).all()
    assert run.transitions["rewards"][:-1].tolist() == [[0.5]] * 300
    replayed_digest(agent.run)


def test_images_out_of_turn_are_refused(tmp_path):
    ring = Ring(2)
    with agent_of(ring, tmp_path / "run") as agent:
        with pytest.raises(RuntimeError, match="no action is under way"):
            agent.observe(ring.picture)
        agent.act(ring.picture)
        agent.observe(ring.picture)
        agent.act(ring.picture, done=True)
        with pytest.raises(RuntimeError, match="no action is under way"):
            agent.observe(ring.picture)
    with pytest.raises(adagio.RunOver, match="the run is over: [12] actions are done"):
        agent.act(ring.picture)
    for call in (lambda: agent.mark("goal"), lambda: agent.goto("goal"), lambda: agent.observe(ring.picture)):
        with pytest.raises(adagio.RunOver):
            call()
    assert agent.close() == report_of(agent.run)


def test_tasks_that_do_not_exist_are_named_with_those_that_do(tmp_path):
    ring = Ring(2)
    tasks = [{"name": "lamp", "goal": "shown"}, {"name": "door", "goal": "shown"}, {"name": "food", "reward": "topic"}]
    actions = [{"name": "on", "forward": 0.5}, {"name": "left", "turn_deg": 30}]
    with agent_of(ring, tmp_path / "run", task=tasks, action=actions) as agent:
        assert agent.tasks == ["lamp", "door", "food"]
        with pytest.raises(ValueError, match=r'"lampe" marks nothing.*\(lamp, door\)'):
            agent.mark("lampe")
        with pytest.raises(ValueError, match=r'no task "nowhere": there are lamp, door, food'):
            agent.goto("nowhere")
        with pytest.raises(ValueError, match=r'no task "lamp" with reward = "topic".*\["food"\]'):
            agent.act(ring.picture, reward={"lamp": 1.0})
        agent.mark("lamp")
        agent.goto("door")
        agent.act(ring.picture)
        agent.goto(None)
        agent.mark("forget lamp")
        agent.act(ring.picture)
    assert adagio.open(agent.run).frames["marked"].tolist() == [[True, False, False], [False] * 3]


def test_a_run_that_was_closed_goes_on(tmp_path):
    ring = Ring(3)
    agent = agent_of(ring, tmp_path / "run", actions=1000)
    drive(agent, ring, 600)
    agent.close()
    agent = adagio.Agent.resume(agent.run)
    assert agent.actions == ["by 1", "by -1", "by 2"] and agent.tasks == ["goal"]
    drive(agent, ring, 10**6)
    report = agent.close()
    assert report["run"]["actions"] == 1000 and report["run"]["resumed"]
    assert replayed_digest(agent.run) == report["digest"]


def test_a_run_that_was_killed_goes_on(tmp_path):
    text = """
        import sys
        from rings import Ring, agent_of
        ring = Ring(3)
        agent = agent_of(ring, sys.argv[1], actions=100_000)
        action = agent.act(ring.reset())
        for step in range(100_000):
            reward = ring.step(action)
            action = agent.act(ring.picture, reward=reward)
            print(step, flush=True)
    """
    run = tmp_path / "run"
    process = script(text, run)
    while int(process.stdout.readline()) < 1500:
        pass
    time.sleep(1.2)  # the log is flushed once a second
    process.kill()
    process.communicate()
    ring = Ring(3)
    agent = adagio.Agent.resume(run)
    recorded = len(adagio.open(run).decisions["frame"])
    assert recorded > 1000
    drive(agent, ring, 300)
    report = agent.close()
    assert report["run"]["actions"] > recorded
    assert replayed_digest(run) == report["digest"]


SLOW = {"robot": {"action_seconds": 2.0}, "agent": {"speed": 1.0}}  # each call of act takes two seconds


def test_ctrl_c_ends_a_call_and_the_run_can_be_closed(tmp_path):
    text = f"""
        import sys, time
        from rings import Ring, agent_of
        ring = Ring(2)
        agent = agent_of(ring, sys.argv[1], **{SLOW})
        agent.act(ring.reset())
        begin = time.monotonic()
        try:
            print("acts", flush=True)
            agent.act(ring.picture)
            sys.exit("nobody interrupted it")
        except KeyboardInterrupt:
            assert time.monotonic() - begin < 1.7
        assert agent.act(ring.picture) in (0, 1)  # the action that is owed
        begin = time.monotonic()
        agent.close()
        print(time.monotonic() - begin)
    """
    process = script(text, tmp_path / "run")
    assert process.stdout.readline() == "acts\n"
    time.sleep(0.5)
    process.send_signal(signal.SIGINT)
    finished(process)
    assert len(adagio.open(tmp_path / "run").frames["frame"]) == 2
    replayed_digest(tmp_path / "run")


def test_one_thread_at_a_time(tmp_path):
    ring = Ring(2)
    agent = agent_of(ring, tmp_path / "run", **SLOW)
    agent.act(ring.reset())
    acting = threading.Thread(target=lambda: agent.act(ring.picture))
    acting.start()
    time.sleep(0.3)
    calls = [lambda: agent.act(ring.picture), lambda: agent.goto("goal"), lambda: agent.mark("goal"), agent.close]
    for call in [*calls, lambda: agent.observe(ring.picture)]:
        with pytest.raises(RuntimeError, match="another thread is in a call"):
            call()
    acting.join()
    agent.close()


@pytest.mark.parametrize("end", ["del agent; gc.collect()", "pass", "sys.exit()", "thread.start(); time.sleep(0.2)"])
def test_an_agent_that_is_forgotten_keeps_nobody_waiting(end, tmp_path):
    text = f"""
        import gc, sys, threading, time
        from rings import Ring, agent_of
        ring = Ring(2)
        agent = agent_of(ring, sys.argv[1], **{SLOW if "thread" in end else {}})
        thread = threading.Thread(target=lambda: agent.act(ring.picture), daemon=True)
        agent.act(ring.reset())
        {end}
    """
    finished(script(text, tmp_path / "run"), 20)
    if "thread" not in end:  # where a thread holds it, the last second of its log is lost
        assert adagio.open(tmp_path / "run").frames["frame"][0] == 0


def test_a_forked_process_is_told_so(tmp_path):
    text = """
        import gc, os, sys
        from rings import Ring, agent_of
        ring = Ring(2)
        agent = agent_of(ring, sys.argv[1])
        agent.act(ring.reset())
        child = os.fork()
        if child == 0:
            try:
                agent.act(ring.picture)
            except RuntimeError as error:
                print(error, flush=True)
            del agent
            gc.collect()
            os._exit(0)
        assert os.waitpid(child, 0)[1] == 0
        agent.act(ring.picture)
        agent.close()
    """
    assert "a forked one cannot drive it" in finished(script(text, tmp_path / "run"))


def test_a_thousand_bad_calls_raise(tmp_path):
    process = subprocess.run(
        [sys.executable, HERE / "bad_calls.py", tmp_path, "1000"], capture_output=True, text=True, timeout=300
    )
    assert process.returncode == 0, f"{process.stdout}{process.stderr}"
    print(process.stdout)


def resident():
    """Megabytes of this process that are in memory."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def test_calls_do_not_use_up_memory(tmp_path):
    calls = 1_000_000 if os.environ.get("ADAGIO_LONG") == "1" else 20_000
    ring = Ring(3)
    pictures = np.ascontiguousarray(ring.pictures[:, :4, :8])
    settings = {
        "vision": {"width": 8, "height": 4},
        "dictionary": {"retained_frames": 1000},
        "value": {"window": 1000},
        "log": {"file_mb": 20.0, "budget_mb": 100.0},
    }
    agent = agent_of(ring, tmp_path / "run", actions=calls + 10, **settings)
    ring.reset()
    action = agent.act(pictures[ring.at])
    memory = []
    for call in range(calls):
        reward = ring.step(action)
        action = agent.act(pictures[ring.at], reward=reward)
        if call % (calls // 20) == 0:
            gc.collect()
            memory.append(resident())
    agent.close()
    print("MB:", [round(of) for of in memory])
    # What is kept of frames and transitions is full by then.
    half = len(memory) // 2
    assert max(memory[half:]) - max(memory[:half]) < 10.0
