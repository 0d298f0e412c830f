"""A small night in a folder: two self-calibrations of three collects, written without devices."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.clock import VirtualClock
from drivers.imu import SampleBlock
from hil.night.log import NightLog
from hil.records import SqliteJournal
from hil.records.blocks import FieldMeaning
from hil.records.requests import request
from hil.records.rows import Night
from procedures.journal_protocol import Outcome, StepResult
from procedures.plan import Plan, Step, StepKind, make_plan
from procedures.requests import RequestKind
from procedures.settings import SweepProcedure

MEANINGS = {
    "rate_A2": FieldMeaning("deg/hr", "rate", 2, "RA"),
    "rate_B2": FieldMeaning("deg/hr", "rate", 2, "RB"),
    "rotor_2_degC": FieldMeaning("degC", "temperature", 2),
    "supply_V": FieldMeaning("V"),
}


@pytest.fixture(autouse=True)
def every_night_has_its_log(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """As a controller's: what a night without one says is that it was lost."""
    opened = SqliteJournal.open
    with ExitStack() as logs:

        def logged(folder: Path, *, clock: VirtualClock, **options: Any) -> SqliteJournal:
            journal = opened(folder, clock=clock, **options)
            journal.listen(logs.enter_context(closing(NightLog(folder, clock, "rk"))).say)
            return journal

        monkeypatch.setattr(SqliteJournal, "open", logged)
        yield


@pytest.fixture
def clock() -> VirtualClock:
    """A clock that jumps."""
    return VirtualClock()


@pytest.fixture
def plan() -> Plan:
    """One temperature, two self-calibrations."""
    return make_plan(SweepProcedure(title="Small", temperatures_degC=(20.0,), self_calibrations=2))


def collect_result(step: Step, start_s: float) -> StepResult:
    """Return what a good collect leaves behind: 200 samples at 10 Hz, different for every step."""
    random = np.random.default_rng(step.index)
    fields = {name: random.normal(5.0, 1.0, 200) for name in MEANINGS}
    rates = {
        channel: {
            "mean_deg_per_hr": float(np.mean(fields[field])),
            "se_deg_per_hr": 0.07,
            "drift_deg_per_hr_per_min": 0.0,
        }
        for channel, field in (("RA", "rate_A2"), ("RB", "rate_B2"))
    }
    data: dict[str, Any] = {
        "position": step.position,
        "start_s": start_s,
        "duration_s": 20.0,
        "n_samples": 200,
        "n_expected": 200,
        "n_missing": 0,
        "sensors": {
            "2": {
                "rates": rates,
                "accelerations": {"A": 0.0, "B": 0.0},
                "temperature_degC": 24.0,
                "dTdt_degC_per_min": 0.01,
            }
        },
        "conditions": {"supply_V": 28.0},
        "chamber_degC": 20.0,
        "setpoint_degC": 20.0,
        "time_since_power_on_s": start_s,
        "time_since_setpoint_s": 3600.0,
        "time_since_index_s": 60.0,
        "counts": {"ok": 200},
        "verdict": "PASS",
        "reason": "stationary",
    }
    block = SampleBlock(start_s + np.arange(200) / 10.0, fields, raw=random.bytes(4000))
    return StepResult(Outcome.DONE, "stationary", data, block)


def carry_out(journal: SqliteJournal, step: Step, clock: VirtualClock) -> None:
    """Do a step as planned, with the result it would have."""
    (attempt,) = journal.begin(step)
    start_s = journal.now_s()
    clock.sleep(step.duration_s)
    if step.kind is StepKind.COLLECT:
        journal.end((step, attempt, collect_result(step, start_s)))
    else:
        journal.end((step, attempt, StepResult(Outcome.DONE, "as planned", {"verdict": "PASS", "reason": "in band"})))


@pytest.fixture
def new_night(tmp_path: Path, plan: Plan, clock: VirtualClock) -> Path:
    """A folder with a night that has not begun."""
    folder = tmp_path / "night"
    folder.mkdir()
    night = Night(
        "Small", "rk", clock.utc(), simulated=True, configuration="bench: test", seed=7, versions={"hil": "0"}
    )
    SqliteJournal.create(folder, plan, night)
    return folder


OpenJournal = Callable[[], SqliteJournal]


@pytest.fixture
def journal(new_night: Path, clock: VirtualClock) -> Iterator[SqliteJournal]:
    """The night's journal, open for writing."""
    with SqliteJournal.open(new_night, clock=clock, who="rk") as opened:
        opened.block_writer.meanings[""] = MEANINGS
        yield opened


@pytest.fixture
def full_night(new_night: Path, plan: Plan, clock: VirtualClock) -> Path:
    """A folder with a night in which every step was done."""
    with SqliteJournal.open(new_night, clock=clock, who="rk") as opened:
        opened.block_writer.meanings[""] = MEANINGS
        for step in plan.steps:
            carry_out(opened, step, clock)
            opened.heartbeat(step, {"chamber_degC": 20.0})
        opened.event("note", "all went well")
        request(new_night, RequestKind.PAUSE, "rk", "lunch")
    return new_night


@pytest.fixture
def do() -> Callable[[SqliteJournal, Step, VirtualClock], None]:
    """`do(journal, step, clock)` carries out a step as planned."""
    return carry_out
