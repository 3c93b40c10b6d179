"""Examples in docstrings and the README run and are true."""

import contextlib
import doctest
import importlib.util
import io
import os
import pkgutil
import re
import subprocess
import sys
from pathlib import Path

import pytest

import adagio


@pytest.mark.parametrize("name", [module.name for module in pkgutil.iter_modules(adagio.__path__)])
def test_docstrings(name):
    module = importlib.import_module(f"adagio.{name}")
    assert doctest.testmod(module).failed == 0


README = (Path(__file__).parent.parent / "README.md").read_text()
SERIES, ROOM = re.findall(r"```python\n(.*?)```", README, re.DOTALL)


def test_readme(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "agg")
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(SERIES, {})
    assert float(printed.getvalue().splitlines()[0]) > 0.99
    for name in adagio.__all__:
        assert f"| `{name}` |" in README
    assert (tmp_path / "series.png").stat().st_size > 10_000


def test_readme_room(tmp_path):
    if not importlib.util.find_spec("miniworld"):
        assert not os.environ.get("ADAGIO_REQUIRE_WORLDS"), "miniworld is missing"
        pytest.skip("miniworld is not installed")
    short = ROOM.replace("steps=10_000", "steps=300")
    assert short != ROOM
    printed = subprocess.run([sys.executable, "-c", short], cwd=tmp_path, check=True, capture_output=True, text=True)
    assert "'ended': 0" in printed.stdout  # it explores for longer than that
    run = adagio.open(tmp_path / "logs" / "agent-seed1")
    assert run.actions == ["left", "right", "ahead"] and run.report["run"]["actions"] >= 299
    assert len(run.frames["observation"]) > 2 * 299  # and those between
