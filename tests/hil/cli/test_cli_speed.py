"""`--speed`: a simulated night that can be watched is the same night."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from drivers.clock import PacedClock, VirtualClock
from hil.config import load_bench, load_sweep
from hil.night import start_night
from hil.records.export import campaign_of_night


def test_a_night_that_is_watched_gives_what_it_gives_unwatched(tmp_path: Path) -> None:
    """Real time is waited for and nothing else changes: every average to the last digit."""
    sweep, bench = load_sweep("quick"), load_bench("simulated")
    rates = []
    for name, speed in (("jumping", None), ("watched", 100_000.0)):
        assert start_night(tmp_path / name, sweep, bench, speed=speed).state == "complete"
        campaign = campaign_of_night(tmp_path / name)
        rates.append([collects.rates_deg_per_hr.tolist() for collects in campaign.sensors.values()])
    assert rates[0] == rates[1]


def test_the_slower_it_is_watched_the_oftener_it_looks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A bench file that looks every 30 s would stand still on a page at 20 times real time."""
    monkeypatch.setattr("drivers.clock.SystemClock.sleep", lambda *_: None)  # nobody waits in a test
    seen: list[float] = []
    slept = VirtualClock.sleep
    monkeypatch.setattr(PacedClock, "sleep", lambda clock, seconds: (seen.append(seconds), slept(clock, seconds))[0])
    start_night(tmp_path / "night", load_sweep("quick"), load_bench("simulated"), speed=20.0)
    assert max(seen) <= 5.0


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (("--bench", "simulated-pty", "--speed", "10", "--yes"), "a speed needs clock: virtual"),
        (("--bench", "simulated", "--speed", "0"), "the speed must be positive, not 0"),
        (("--bench", "simulated", "--speed", "nan"), "the speed must be positive, not nan"),
    ],
)
def test_a_speed_that_makes_no_sense_leaves_nothing_behind(
    hil: Any, tmp_path: Path, arguments: tuple[str, ...], complaint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Real devices do not hurry."""
    monkeypatch.setattr("hil.bench.assemble.check_ports", lambda *_: None)  # the pseudo-terminals need not be there
    ended = hil("run", "quick", *arguments, "--out", tmp_path / "night")
    assert ended.returncode == 2
    assert complaint in ended.stderr
    assert not (tmp_path / "night").exists()
