"""What a report takes from the journal of a night."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hil.campaign import FloatArray
from hil.journal_reader import JournalReader, open_readonly
from hil.journal_records import Heartbeat
from hil.report.content import NightContent
from hil.status import night_status
from procedures.plan import StepKind
from procedures.verdict import self_calibration_verdict

_SECONDS_PER_HOUR = 3600.0
_TRACES = {"chamber": "chamber_degC", "setpoint": "setpoint_degC"}


def night_content(folder: Path) -> NightContent:
    """Read state, verdicts, events, temperatures and provenance of the night in `folder`."""
    status = night_status(folder)
    with open_readonly(folder) as journal, journal.snapshot():
        done = journal.completed()
        beats = journal.heartbeats()
        collects = [attempt.began_s for key, attempt in journal.done_attempts().items() if _is_collect(journal, key)]
        return NightContent(
            state=str(status["state"]),
            missing=list(status["missing"]),
            judgements={
                number: self_calibration_verdict(steps, done)
                for number, steps in journal.plan.self_calibrations.items()
            },
            events=[
                (f"{journal.night.utc(event.at_s):%Y-%m-%d %H:%M:%S}", event.kind, event.message)
                for event in journal.events()
            ],
            hours=np.array([beat.at_s for beat in beats]) / _SECONDS_PER_HOUR,
            temperatures=_temperatures(beats),
            collect_hours=np.array(collects) / _SECONDS_PER_HOUR,
            provenance=_provenance(journal, folder),
        )


def _is_collect(journal: JournalReader, key: str) -> bool:
    return journal.steps_by_key()[key].kind is StepKind.COLLECT


def _temperatures(beats: Sequence[Heartbeat]) -> dict[str, FloatArray]:
    """Chamber, setpoint and one unit thermometer, NaN where a heartbeat lacks it."""
    names = dict(_TRACES)
    unit = next((name for beat in beats for name in beat.readings if name.startswith("unit")), None)
    if unit is not None:
        names["unit"] = unit
    return {
        label: np.array([beat.readings.get(name, np.nan) for beat in beats], dtype=np.float64)
        for label, name in names.items()
        if any(name in beat.readings for beat in beats)
    }


def _provenance(journal: JournalReader, folder: Path) -> list[tuple[str, str]]:
    night = journal.night
    told = [
        ("began (UTC)", f"{night.began_utc:%Y-%m-%d %H:%M:%S}" + (" (simulated time)" if night.simulated else "")),
        ("who", night.who),
        ("folder", folder.name),
        ("seed", "" if night.seed is None else str(night.seed)),
        *((f"version of {name}", version) for name, version in (night.versions or {}).items()),
    ]
    return [(name, value) for name, value in told if value]
