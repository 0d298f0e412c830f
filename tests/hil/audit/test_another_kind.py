"""A model of another kind of sensor: every command refuses it in the same words."""

from __future__ import annotations

from pathlib import Path

import pytest

from hil.cli.app import run
from tests.hil.audit.folders import written

OF_A_FOLDER = {
    "solve": ["solve", "{folder}"],
    "thermal": ["thermal", "{folder}"],
    "budget": ["budget", "{folder}", "--draws", "100"],
    "budget of a sweep": ["budget", "quick", "--draws", "100"],
    "visibility": ["visibility", "{folder}"],
    "visibility of a sweep": ["visibility", "quick"],
    "reconcile": ["reconcile", "{folder}", "--out", "{folder}/out"],
}


@pytest.mark.parametrize("command", OF_A_FOLDER)
def test_a_triads_model_is_no_rotors(command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nobody is given the answer that another model has."""
    folder = written("one run", tmp_path / "campaign")
    assert run([*(each.format(folder=folder) for each in OF_A_FOLDER[command]), "--model", "triad-12"]) == 2
    told = capsys.readouterr()
    assert "triad-12 needs one channel about each of the three axes; matrix-6 fits it" in told.err
    assert told.out == ""
