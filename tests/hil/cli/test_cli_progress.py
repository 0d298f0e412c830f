"""The panel that a technician looks at while a sweep runs."""

from __future__ import annotations

import io
from dataclasses import replace
from datetime import UTC, datetime

import pytest
from rich.console import Console

from drivers.frames.counts import StreamCounts
from hil.cli.progress import LineProgress, TerminalProgress, onlooker
from procedures.plan import Step, StepKind
from procedures.progress import Snapshot

_COLLECT = Step(5, "T1/S1/C2/collect", StepKind.COLLECT, 0.0, 60.0, 23.4, 1, "2")
_NOW = Snapshot(
    step=_COLLECT,
    attempt=1,
    elapsed_s=5000.0,
    step_elapsed_s=20.0,
    step_remaining_s=40.0,
    finishing_utc=datetime(2026, 3, 1, 5, 59, tzinfo=UTC),
    chamber_degC=23.5,
    setpoint_degC=23.4,
    unit_degC={2: 23.31},
    rates_deg_per_hr={"2.RA": 12.3},
    rates_se_deg_per_hr={"2.RA": 0.45},
    stream=StreamCounts(ok=1000, lost=2, bad_checksum=1),
    note="averaging",
    steps_done=60,
    steps_total=179,
)


def _drawn(now: Snapshot, width: int = 100) -> list[str]:
    drawn = io.StringIO()
    console = Console(file=drawn, width=width, force_terminal=True, color_system=None)
    panel = TerminalProgress(console, simulated=True)
    panel._title = "RD-GC-86-1, eight temperatures"
    panel.update(now)
    console.print(panel.drawn())
    return drawn.getvalue().splitlines()


def test_everything_a_technician_asks_for_has_a_line_of_its_own() -> None:
    """How far, what now, when it ends, how warm, the rates so far, the stream; a simulation's mark at the top."""
    lines = _drawn(_NOW)
    texts = (
        "RD-GC-86-1, eight temperatures  SIMULATED",
        "━",
        "60 of 179 steps",
        "Collect 2 at 23.4 °C, averaging",
        "20 s gone, 40 s to go",
        f"{_NOW.finishing_utc.astimezone():%a %d %b %H:%M}",
        "chamber 23.5 (setpoint 23.4), sensor 2 23.3",
        "2.RA +12.30 ± 0.45",
        "1000 good, 2 lost, 1 damaged",
    )
    found = [[n for n, line in enumerate(lines) if text in line.replace("\u00a0", " ")] for text in texts]
    assert found == [[0], [1], [2], [3], [4], [5], [6], [7], [8]]


@pytest.mark.parametrize("width", [40, 24])
def test_a_narrow_window_loses_nothing(width: int) -> None:
    """A strip of tmux: every fact is there, and no line is longer than the window."""
    lines = _drawn(_NOW, width)
    assert max(len(line) for line in lines) <= width
    text = " ".join(" ".join(lines).replace("\u00a0", " ").split())
    for fact in ("SIMULATED", "60 of 179", "Collect 2", "40 s to go", "23.5", "+12.30 ± 0.45", "2 lost"):
        assert fact in text


def test_between_collects_the_rates_of_the_moment_are_shown_without_an_error() -> None:
    """A number with an error is an average; one without is what the channel shows now."""
    lines = _drawn(replace(_NOW, rates_deg_per_hr={}, rates_se_deg_per_hr={}, rates_now_deg_per_hr={"2.RA": -7.5}))
    line = next(line for line in lines if "2.RA" in line)
    assert "-7.50" in line
    assert "±" not in line


@pytest.mark.parametrize(("term", "kind"), [("xterm", TerminalProgress), ("dumb", LineProgress)])
def test_a_terminal_that_cannot_move_its_cursor_gets_lines(
    term: str, kind: type, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Emacs' shell, a serial console: lines with times, as in a pipe."""
    monkeypatch.setenv("TERM", term)
    console = Console(file=io.StringIO(), force_terminal=True)
    assert isinstance(onlooker(console, quiet=False, simulated=True), kind)


def test_a_step_that_takes_longer_than_planned_is_not_said_to_end_now() -> None:
    """A soak that still waits for evidence after its scheduled time has no end that could be told."""
    lines = _drawn(replace(_NOW, step_elapsed_s=3420.0, step_remaining_s=0.0))
    assert any("57 min gone, longer than planned" in line for line in lines)


@pytest.mark.parametrize("shown", [LineProgress, lambda console: TerminalProgress(console, simulated=True)])
def test_the_column_of_times_goes_on_through_the_second_day(shown) -> None:
    """A night may last longer than a day, and its end is commanded when no poll shows the time."""
    said = io.StringIO()
    onlooker = shown(Console(file=said, width=80))
    onlooker.update(_NOW)
    onlooker.event("safe-state-commanded", "the air is at 40.0 °C", 100_000.0)
    assert said.getvalue().strip() == "27:46:40  safe-state-commanded: the air is at 40.0 °C"
