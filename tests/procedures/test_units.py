"""Several units in one chamber: done to all at once, judged each for itself, and one that fails set aside."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drivers.clock import VirtualClock
from drivers.errors import CommandRefused, DeviceError, WrongDevice
from drivers.positioners.positioner import move_all
from procedures.devices import BenchDevices
from procedures.journal_protocol import Outcome
from procedures.plan import lasting_s, make_plan
from procedures.settings import SweepProcedure
from procedures.sweep_outcome import SweepState

UNITS = ("0041", "0042", "0043")
SICK = "0042"


@pytest.fixture
def chamberful(new_bench: Callable[[], Any]) -> Any:
    """A bench of fakes with three units on one fixture."""

    class Chamberful(type(new_bench())):  # type: ignore[misc]
        def __init__(self) -> None:
            super().__init__()
            self.imus = {unit: type(self.imu)(self.clock, self.chamber, self.table) for unit in UNITS}
            for unit, imu in self.imus.items():
                imu.serial, imu.port = unit, f"sim://{unit}"

        @property
        def devices(self) -> BenchDevices:
            units = {name: BenchDevices(self.clock, imu, self.chamber, self.table) for name, imu in self.imus.items()}
            return replace(units[UNITS[0]], units=units)

        @property
        def plan(self) -> Any:
            return make_plan(self.sweep, UNITS)

        @property
        def sick(self) -> Any:
            return self.imus[SICK]

        def aside(self) -> list[str]:
            return [message for kind, message, _ in self.record.events if kind == "unit-set-aside"]

        def done(self, unit: str) -> set[str]:
            return {key for key in self.record.results if key.endswith(f"@{unit}")}

    return Chamberful()


def _at(began_s: float, ends_s: float = np.inf) -> Callable[[float], bool]:
    return lambda t: began_s <= t < ends_s


def test_what_is_done_to_units_is_done_to_all_at_once(chamberful: Any) -> None:
    """One soak and one move for all; a collect of each over the same seconds, by its own samples."""
    chamberful.sick.extra = lambda t: np.full_like(t, 100.0)
    assert chamberful.run().state is SweepState.COMPLETE
    assert chamberful.table.moves == ["1", "2", "1", "2"]
    at = {unit: chamberful.record.results[f"T1/S1/C1/collect@{unit}"].data for unit in UNITS}
    assert len({(each["start_s"], each["duration_s"]) for each in at.values()}) == 1
    means = {unit: each["sensors"]["2"]["rates"]["RA"]["mean_deg_per_hr"] for unit, each in at.items()}
    assert means[SICK] - means["0041"] == pytest.approx(100.0)
    soak = chamberful.record.results["T1/S1/restabilise"].data
    assert set(soak["unit"]) == {f"{unit}.2" for unit in UNITS}
    assert chamberful.plan.total_s == pytest.approx(make_plan(chamberful.sweep).total_s)


@pytest.mark.parametrize("fault", ["silent", "broken", "damaged"])
def test_a_unit_that_fails_is_set_aside_and_the_others_go_on(chamberful: Any, fault: str) -> None:
    """Its reason is on record, its chamber-mates are complete, and the outcome says for how many of how many."""
    setattr(chamberful.sick, fault, _at(2000.0))
    outcome = chamberful.run()
    assert chamberful.chamber.safe
    assert (outcome.state, outcome.partly) == (SweepState.INCOMPLETE, True)
    assert outcome.reason.startswith(f"complete for 2 of 3 units; set aside: {SICK} (stream-lost")
    assert len(chamberful.aside()) == 1
    assert {key.partition("@")[2] for key in outcome.missing} == {SICK}
    assert len(chamberful.done("0041")) == len(chamberful.done("0043")) == 9 > len(chamberful.done(SICK))


def test_the_last_unit_ends_the_night(chamberful: Any) -> None:
    """What happens to all units is as fatal as what happens to the one of a bench of one."""
    for imu in chamberful.imus.values():
        imu.silent = _at(2000.0)
    outcome = chamberful.run()
    assert (outcome.state, outcome.partly) == (SweepState.FAILED, False)
    assert "stream-lost" in outcome.reason
    assert len(chamberful.aside()) == len(UNITS) - 1


def test_a_lost_chamber_ends_all(chamberful: Any) -> None:
    """It is nobody's fault of the units: none is set aside."""
    chamberful.chamber.silent = _at(2000.0, 2900.0)
    outcome = chamberful.run()
    assert outcome.state is SweepState.FAILED
    assert "chamber-lost" in outcome.reason
    assert chamberful.aside() == []


def test_another_unit_behind_a_port_is_set_aside_before_its_samples_count(chamberful: Any) -> None:
    """A cable that was exchanged in the night: nothing of the stranger is recorded as the unit's."""

    def exchange(t: float) -> bool:
        if t >= 2000.0 and chamberful.sick.serial == SICK:
            chamberful.sick.serial, chamberful.sick.unsure = "9999", True
        return False

    chamberful.sick.broken = exchange
    identify = chamberful.sick.identify

    def known() -> Any:
        found = identify()
        if found.serial == "9999":
            raise WrongDevice("the unit says serial '9999'")
        return found

    chamberful.sick.identify = known
    assert chamberful.run().partly
    assert "9999" in chamberful.aside()[0]


def test_only_the_unit_that_was_not_good_is_taken_again(chamberful: Any) -> None:
    """The others have their collect, and wait."""
    first: list[float] = []

    def drifts_at_first(t: np.ndarray) -> np.ndarray:
        first.extend(t[:1] if chamberful.table.where and not first else [])
        return np.where(t < (first or [0.0])[0] + 75.0, 2.0 * t, 0.0)

    chamberful.sick.extra = drifts_at_first
    assert chamberful.run().state is SweepState.COMPLETE
    taken = [key for key, _, result in chamberful.record.ends if "collect" in key and result.outcome is Outcome.FAILED]
    assert taken
    assert {key.partition("@")[2] for key in taken} == {SICK}


@pytest.mark.slow
def test_a_soak_that_one_unit_never_ends_is_held_against_that_unit_alone(chamberful: Any) -> None:
    """At the ceiling all are collected; only the unit that had not settled is called INCONCLUSIVE for it."""
    settled = chamberful.sick._unit_degC
    chamberful.sick._unit_degC = lambda: settled() + 0.004 * (chamberful.clock.now() % 600.0)
    chamberful.run()
    soak = chamberful.record.results["T1/S1/restabilise"].data
    assert {unit: each["verdict"] for unit, each in soak["units"].items()} == {
        "0041": "PASS",
        SICK: "INCONCLUSIVE",
        "0043": "PASS",
    }
    assert all(f"{SICK}.2" in each for each in soak["units"][SICK]["waiting_for"])
    verdicts = {unit: chamberful.record.results[f"T1/S1/C1/collect@{unit}"].data["verdict"] for unit in UNITS}
    assert verdicts == {"0041": "PASS", SICK: "INCONCLUSIVE", "0043": "PASS"}


def test_a_soak_waits_no_more_for_a_unit_that_was_set_aside(chamberful: Any) -> None:
    """It ends by the evidence of the others, long before its ceiling."""
    chamberful.sick.silent = _at(300.0)
    assert chamberful.run().partly
    soak = chamberful.record.results["T1/S1/restabilise"].data
    assert (soak["verdict"], SICK in soak["units"]) == ("PASS", False)
    assert soak["waited_s"] < 0.5 * chamberful.sweep.restabilisation.ceiling_s


def test_complete_for_some_means_that_nothing_else_is_missing(chamberful: Any) -> None:
    """A collect of a unit that goes on gave no mean: then the night is incomplete, whoever was set aside."""
    chamberful.sick.silent = _at(2000.0)
    chamberful.imus["0043"].extra = lambda t: np.full_like(t, np.nan)
    outcome = chamberful.run()
    assert (outcome.state, outcome.partly) == (SweepState.INCOMPLETE, False)
    assert "complete for" not in outcome.reason


def test_a_resume_tries_a_unit_again_that_was_set_aside(chamberful: Any) -> None:
    """What is missing is measured once its cable is back, each step once; the others' results stand."""
    chamberful.sick.silent = _at(2000.0, 20_000.0)
    assert chamberful.run().partly
    before = dict(chamberful.record.results)
    chamberful.reboot(after_s=20_000.0)
    assert chamberful.run().state is SweepState.COMPLETE
    assert before.items() <= chamberful.record.results.items()


def test_a_stage_ends_at_once_and_one_without_a_result_is_done_again(chamberful: Any, killed: Any) -> None:
    """Killed after the first of them, all have ended; a unit whose result was withdrawn since is taken again, alone."""
    collects = [f"T1/S1/C2/collect@{unit}" for unit in UNITS]

    def dies(_call: int, when: str) -> None:
        if when == "after" and collects[0] in chamberful.record.results:
            raise killed

    with pytest.raises(killed):
        chamberful.run(dies)
    assert set(collects) <= set(chamberful.record.results)
    del chamberful.record.results[f"T1/S1/C2/collect@{SICK}"]
    chamberful.reboot()
    assert chamberful.run().state is SweepState.COMPLETE
    assert set(chamberful.record.results) == {step.key for step in chamberful.plan.steps}
    assert [chamberful.record.begins.count(key) for key in collects] == [1 + (SICK in key) for key in collects]


class _Slow:
    """A positioner that takes so many waits of a second; `fails` at its end."""

    def __init__(self, waits: int, fails: bool = False) -> None:
        self.waits, self.fails, self.told = waits, fails, 0

    def moving(self, position: str, timeout_s: float) -> Any:
        self.told += 1
        for _ in range(self.waits):
            yield 1.0
        if self.fails:
            raise CommandRefused("it refuses")

    def move_to(self, position: str, timeout_s: float) -> None:
        raise AssertionError(f"{position} within {timeout_s} s: it was to move beside the others")

    def position(self) -> str | None:
        return "1"


def test_units_move_beside_one_another_and_one_fixture_is_told_once() -> None:
    """As long as the slowest takes; what failed stands under its own unit."""
    clock, fixture = VirtualClock(), _Slow(3)
    began_s = clock.now()
    positioners = {"a": fixture, "b": _Slow(7), "c": _Slow(5, fails=True), "d": fixture}
    failed = move_all(positioners, clock, "1", 60.0)
    assert clock.now() - began_s == pytest.approx(7.0)
    assert fixture.told == 1
    assert {name: type(error) for name, error in failed.items()} == {"c": CommandRefused}
    assert issubclass(CommandRefused, DeviceError)


def test_a_plan_of_many_units_is_as_long_as_that_of_one() -> None:
    """Steps of one stage take place at once: neither the end nor any beginning moves."""
    sweep = SweepProcedure(title="x", temperatures_degC=(20.0, 40.0))
    one, many = make_plan(sweep), make_plan(sweep, UNITS)
    assert many.total_s == one.total_s
    assert lasting_s(many.steps) == pytest.approx(lasting_s(one.steps))
    assert [stage[0].starts_s for stage in many.stages] == [step.starts_s for step in one.steps]
    alone = many.of_unit(SICK)
    assert [step.stage for step in alone.steps] == [step.key for step in one.steps]
