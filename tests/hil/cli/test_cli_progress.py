"""The panel that a technician looks at while a sweep runs."""

from __future__ import annotations

import io
from dataclasses import replace
from datetime import UTC, datetime

from rich.console import Console

from hil.cli.progress import TerminalProgress
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
    note="averaging",
    steps_done=60,
    steps_total=179,
)


def _drawn(now: Snapshot) -> list[str]:
    drawn = io.StringIO()
    console = Console(file=drawn, width=100, force_terminal=True, color_system=None)
    panel = TerminalProgress(console, simulated=True)
    panel.update(now)
    console.print(panel._render())
    return drawn.getvalue().splitlines()


def test_everything_a_technician_asks_for_has_a_line_of_its_own() -> None:
    """How far, what now, how warm, the rates so far, and when it ends; the mark of a simulation at the top."""
    lines = _drawn(_NOW)
    assert "SIMULATED   60 of 179 steps" in lines[0]
    texts = (
        "━",
        "Collect 2 at 23.4 °C, averaging",
        "20 s gone, 40 s to go",
        "chamber 23.5 °C (setpoint 23.4)",
        "+12.30",
    )
    found = [[number for number, line in enumerate(lines) if text in line] for text in texts]
    assert found == [[1], [2], [3], [4], [5]]


def test_a_step_that_takes_longer_than_planned_is_not_said_to_end_now() -> None:
    """A soak that still waits for evidence after its scheduled time has no end that could be told."""
    lines = _drawn(replace(_NOW, step_elapsed_s=3420.0, step_remaining_s=0.0))
    assert any("57 min gone, longer than planned" in line for line in lines)
