"""The night's questions on the terminal: heard without ever waiting."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator

import pytest

from hil.cli.ask import TerminalQuestions


@pytest.fixture
def typed(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """Where to write what somebody types."""
    reads, writes = os.pipe()
    with os.fdopen(reads) as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        yield writes
    os.close(writes)


def test_an_answer_is_taken_when_it_comes_and_rubbish_is_asked_again(
    typed: int, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nothing, rubbish, yes, no."""
    questions = TerminalQuestions()
    questions.put("Bring the unit to position 1.", 600.0)
    assert questions.answer() is None
    os.write(typed, b"maybe\n")
    assert questions.answer() is None
    os.write(typed, b"YES\n")
    assert questions.answer() is True
    os.write(typed, b"n\n")
    assert questions.answer() is False
    questions.settle("confirmed")
    said = capsys.readouterr().err
    assert said.count("position 1.  [yes/no, within 10 min]\n") == 2  # again below what was typed wrong
    questions.put("Bring the unit to position 3.", 30.0)
    assert "within 30 s]" in capsys.readouterr().err
    assert "please answer yes or no" in said
    assert said.endswith("confirmed\n")


def test_where_nobody_can_type_nothing_is_heard(monkeypatch: pytest.MonkeyPatch) -> None:
    """Standard input at its end, as a service has it, and closed."""
    with open(os.devnull) as nothing:
        monkeypatch.setattr(sys, "stdin", nothing)
        assert TerminalQuestions().answer() is None
    assert TerminalQuestions().answer() is None
