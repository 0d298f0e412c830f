"""The systemd examples that ship call commands that exist, with options that they have."""

from __future__ import annotations

import configparser
import shlex
from pathlib import Path

import pytest

SERVICES = Path(__file__).resolve().parents[3] / "configs" / "service"


@pytest.mark.parametrize("name", ["hil-night", "hil-safe-at-boot", "hil-watchdog"])
def test_a_unit_runs_a_command_with_the_options_that_it_has(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Each option stands in the command's own help; no shell is in between."""
    from hil.cli.app import run

    unit = _unit(f"{name}.service")
    program, command, *arguments = shlex.split(unit["Service"]["ExecStart"])
    assert program == "/opt/hil/bin/hil"
    assert run([command, "--help"]) == 0
    said = capsys.readouterr().out
    for option in (word for word in arguments if word.startswith("--")):
        assert option in said


def test_a_stop_gives_the_controller_the_time_that_it_takes_for_the_safe_state() -> None:
    """And kills nothing beside it: the watchdog must outlive a killed controller."""
    from procedures.settings import Polling

    service = _unit("hil-night.service")["Service"]
    usual = Polling()
    assert float(service["TimeoutStopSec"]) > usual.safe_state_s + usual.safe_air_s + 60.0
    assert service["KillMode"] == "process"
    assert service["Restart"] == "no"


def test_a_watchdog_that_is_killed_is_started_at_once_and_always() -> None:
    """No waiting, no limit to how often; and a night brings it with it."""
    unit = _unit("hil-watchdog.service")
    assert (unit["Service"]["Restart"], unit["Service"]["RestartSec"]) == ("always", "100ms")
    assert unit["Unit"]["StartLimitIntervalSec"] == "0"
    assert _unit("hil-night.service")["Unit"]["Wants"] == "hil-watchdog.service"


def _unit(name: str) -> configparser.ConfigParser:
    unit = configparser.ConfigParser(interpolation=None)
    unit.optionxform = str  # type: ignore[assignment, method-assign]
    unit.read_string((SERVICES / name).read_text(encoding="utf-8"))
    return unit
