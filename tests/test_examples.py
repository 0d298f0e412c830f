"""The examples in docstrings are true: those that begin with >>> are run."""

from __future__ import annotations

import doctest
import importlib
from pathlib import Path

import pytest

_ROOT = Path(__file__).resolve().parents[1]
_WITH_EXAMPLES = [
    ".".join(path.relative_to(_ROOT).with_suffix("").parts).removesuffix(".__init__")
    for floor in ("hil", "procedures", "drivers")
    for path in sorted((_ROOT / floor).rglob("*.py"))
    if ">>> " in path.read_text("utf-8")
]


def test_there_are_examples() -> None:
    """At least a dozen modules show how they are used."""
    assert len(_WITH_EXAMPLES) >= 12


@pytest.mark.parametrize("name", _WITH_EXAMPLES)
def test_examples_do_what_they_say(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """An example knows what its module knows, so that it needs no imports; files are named from the checkout's root."""
    monkeypatch.chdir(_ROOT)
    said: list[str] = []
    runner = doctest.DocTestRunner(verbose=False)
    module = importlib.import_module(name)
    for test in doctest.DocTestFinder(exclude_empty=True).find(module, name):
        runner.run(test, out=said.append)
    assert runner.tries > 0, f"{name}: no example was found by doctest"
    assert runner.failures == 0, "".join(said)
