"""What is given is read, or refused; what a bench makes is marked as the bench is."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from hil.cli.app import run
from tests.hil.audit.folders import written


@pytest.mark.parametrize(
    "command",
    [
        ("plan", "quick", "--bench", "simulated"),
        ("visibility", "quick"),
        pytest.param(("budget", "quick", "--draws", "100"), marks=pytest.mark.slow),
        pytest.param(("design", "quick", "--goal", "MU 20 deg/hr"), marks=pytest.mark.slow),
    ],
    ids=lambda command: command[0],
)
def test_of_a_simulated_bench_every_answer_is_marked_simulated(
    command: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    """One sweep on one bench: `plan` said so, and the others not."""
    run([*command, "--json"])
    assert json.loads(capsys.readouterr().out)["simulated"] is True


@pytest.mark.slow
def test_an_option_that_would_not_be_read_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A bench, of collects that were measured; an earlier campaign, where no limit is of a change."""
    folder = str(written("good", tmp_path / "good"))
    limits = tmp_path / "limits.yaml"
    limits.write_text('{title: t, origin: o, sensors: {2: {BA: {high: "9000 deg/hr"}}}}')
    assert run(["visibility", folder, "--bench", "nonsense"]) == 2
    assert "--bench is for a sweep" in capsys.readouterr().err
    for given in ((), ("--limits", str(limits))):
        assert run(["solve", folder, "--against", folder, *given]) == 2
        assert "--against is for limits of changes" in capsys.readouterr().err
    limits.write_text(limits.read_text().replace("high:", "change:"))
    assert run(["solve", folder, "--against", folder, "--limits", str(limits)]) == 0
