"""A computer that slept, a process that was stopped: what nobody saw is no evidence, and is said."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.reliability.suspend import suspended
from drivers.clock import SystemClock, VirtualClock
from hil.night.watchdog import Patience, Watchdog


@pytest.mark.parametrize(
    ("step", "share", "lasts_s"),
    [pytest.param("T1/S1/restabilise", 0.9, 120.0, marks=pytest.mark.slow), ("T1/S1/C2/collect", 0.5, 25.0)],
)
def test_an_hour_in_which_nobody_looked_is_said_and_counts_for_nothing(
    tmp_path: Path, step: str, share: float, lasts_s: float
) -> None:
    """The soak begins again, the collect is taken again."""
    found = suspended(tmp_path, step, share, lasts_s, 3600.0)
    assert found["wrong"] == []
    assert found["ended"].startswith("complete")
    assert found["said"][0].startswith("nobody looked for 6")
    if "collect" in step:
        assert [each.split(":")[0] for each in found["attempts"]] == ["FAILED", "DONE"]
        assert "instead of 20: nobody looked meanwhile" in found["attempts"][0]


def test_a_watchdog_that_slept_itself_takes_no_controller_for_dead(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both wake: the controller has its time to beat again."""
    clock, asked = VirtualClock(), []
    dog = Watchdog(tmp_path, None, patience=Patience(), say=lambda _: None, clock=clock)  # type: ignore[arg-type]
    monkeypatch.setattr("hil.night.watchdog.living_owner", lambda _: "a controller")
    monkeypatch.setattr(dog, "_end_silent", lambda _: asked.append(clock.now()))
    beat = type("Beat", (), {"silent_s": 0.0})()
    monkeypatch.setattr("hil.night.watchdog.read_heartbeat", lambda _: beat)
    looks, sleep = iter(range(200)), clock.sleep

    def asleep(seconds: float) -> None:
        look = next(looks)
        sleep(seconds + (3600.0 if look == 10 else 0.0))
        if look == 100:
            dog.stop.request("enough")

    monkeypatch.setattr(clock, "sleep", asleep)
    dog.run()
    assert asked
    assert min(asked) > 3600.0 + 10.0 + Patience().timeout_s


def test_the_clock_goes_on_while_the_computer_is_suspended(monkeypatch: pytest.MonkeyPatch) -> None:
    """By the boot time where the system has it, which a stopped CLOCK_MONOTONIC is not."""
    import time

    clock, wanted = SystemClock(), getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)
    monkeypatch.setattr(time, "clock_gettime", lambda which: 1e9 if which == wanted else 0.0)
    assert clock.now() > 1e8


@pytest.mark.slow
def test_an_hour_asleep_anywhere_in_a_night_is_not_silent() -> None:
    """In the middle of every step; `make reliability` tries their beginnings and ends, too."""
    root = Path(__file__).resolve().parents[3]
    command = [sys.executable, "-m", "benchmarks.reliability.suspend", "--shares", "0.5"]
    assert json.loads(subprocess.run(command, cwd=root, stdout=subprocess.PIPE, check=False).stdout)["problems"] == []
