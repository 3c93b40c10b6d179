"""Examples in docstrings and the README run and are true."""

import contextlib
import doctest
import importlib
import io
import pkgutil
import re
from pathlib import Path

import pytest

import adagio


@pytest.mark.parametrize("name", [module.name for module in pkgutil.iter_modules(adagio.__path__)])
def test_docstrings(name):
    module = importlib.import_module(f"adagio.{name}")
    assert doctest.testmod(module).failed == 0


def test_readme():
    text = (Path(__file__).parent.parent / "README.md").read_text()
    (example,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(example, {})
    assert float(printed.getvalue().splitlines()[0]) > 0.99
    for name in adagio.__all__:
        assert f"| `{name}` |" in text
