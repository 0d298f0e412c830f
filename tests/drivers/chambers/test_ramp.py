"""Ramps, by the controller and by the host, and what readings that cannot be true and worn memory have to say."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import pytest

from drivers.chambers import SafeState
from drivers.chambers.guards import ReadingWatch, WriteWear
from drivers.chambers.ramp import RampedChamber, steps_of_a_ramp
from drivers.chambers.supervised import SupervisedChamber
from drivers.clock import VirtualClock
from drivers.errors import SensorFault, SetpointOutOfLimits
from drivers.simulators.chambers.controller import ChamberFaultKind
from tests.drivers.chambers.chamber_benches import ChamberBench


def _ramped(name: str, degC_per_min: float = 1.0) -> tuple[ChamberBench, RampedChamber]:
    bench = ChamberBench(name, safe=SafeState("off"))
    chamber = RampedChamber(bench.chamber, bench.clock, degC_per_min=degC_per_min)
    chamber.prepare()
    return bench, chamber


@pytest.mark.parametrize("name", ["espec", "watlow-f4", "ezt-570i", "julabo"])
def test_the_host_steps_the_setpoint_of_a_controller_without_a_ramp(name: str) -> None:
    """22 to 52 °C at 1 °C/min takes half an hour, in steps of half a degree at least, and no write too many."""
    bench, chamber = _ramped(name)
    assert chamber.native is False
    before = len(bench.setpoints)
    began_s = bench.clock.now()
    chamber.set_temperature(52.0)
    while bench.device.setpoint_degC < 52.0:
        bench.clock.sleep(5.0)
        assert chamber.read().setpoint_degC == 52.0
        if bench.clock.now() - began_s > 2400.0:
            break
    assert 1650.0 < bench.clock.now() - began_s < 1900.0
    steps = bench.setpoints[before:]
    assert len(steps) <= 61
    assert all(later - earlier >= 0.39 for earlier, later in pairwise(steps[:-1]))
    for _ in range(20):
        bench.clock.sleep(60.0)
        chamber.read()
    assert len(bench.setpoints) - before == len(steps)


@pytest.mark.parametrize("name", ["voetsch-ascii2", "simserv", "watlow-f4t"])
def test_a_controller_that_can_ramps_by_itself(name: str) -> None:
    """One setpoint on the wire, and the rate confirmed before."""
    bench, chamber = _ramped(name, 2.5)
    assert chamber.native is True
    before = len(bench.setpoints)
    chamber.set_temperature(52.0)
    assert bench.setpoints[before:] == [52.0]
    assert bench.plant.ramp_degC_per_min == (2.5, 2.5)


def test_a_ramp_goes_down_too_and_may_be_changed_on_its_way() -> None:
    """The new one begins at the air, not at the old step."""
    bench, chamber = _ramped("watlow-f4")
    chamber.set_temperature(10.0)
    for _ in range(30):
        bench.clock.sleep(20.0)
        chamber.read()
    assert 10.0 < bench.device.setpoint_degC < 14.0
    chamber.set_temperature(40.0)
    assert bench.device.setpoint_degC < 15.0


def test_the_end_of_a_ramp_is_checked_before_it_begins() -> None:
    """Not when it gets there."""
    bench, chamber = _ramped("watlow-f4")
    before = len(bench.setpoints)
    with pytest.raises(SetpointOutOfLimits):
        chamber.set_temperature(90.0)
    assert len(bench.setpoints) == before


def test_somebody_elses_setpoint_is_shown_and_not_written_over() -> None:
    """The interlock that compares them must see it."""
    bench, chamber = _ramped("watlow-f4")
    chamber.set_temperature(52.0)
    bench.device.setpoint_degC = 30.0
    before = len(bench.setpoints)
    bench.clock.sleep(60.0)
    assert chamber.read().setpoint_degC == 30.0
    assert len(bench.setpoints) == before


def test_the_safe_state_ends_the_ramp() -> None:
    """And nothing is written afterwards."""
    bench, chamber = _ramped("watlow-f4")
    chamber.set_temperature(52.0)
    chamber.safe_state()
    before = bench.wire.sent
    bench.clock.sleep(600.0)
    chamber.read()
    assert len(bench.setpoints) == len(bench.kind.setpoints(before))
    assert bench.device.mode == "OFF"


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan"), float("inf")])
def test_a_rate_that_is_none_is_refused(rate: float) -> None:
    """Before anything is sent."""
    bench = ChamberBench("watlow-f4")
    with pytest.raises(ValueError, match="positive"):
        RampedChamber(bench.chamber, bench.clock, degC_per_min=rate)


def _watch(*readings: tuple[float, float], **driven: Any) -> ReadingWatch:
    watch = ReadingWatch("chamber")
    for now_s, degC in readings:
        watch.accept(now_s, degC, driven_to_degC=driven.get("to"))
    return watch


def test_a_jump_that_no_air_makes_is_a_fault_until_it_is_gone() -> None:
    """22 °C read as °F: no time that passes makes it right; coming back does."""
    watch = _watch((0.0, 22.0), (5.0, 22.1))
    for now_s in (10.0, 100.0, 10000.0):
        with pytest.raises(SensorFault, match=r"reads 71\.8 °C where it read 22\.1 °C 5 s before"):
            watch.accept(now_s, 71.8, driven_to_degC=None)
    watch.accept(10005.0, 22.3, driven_to_degC=None)


def test_a_fast_chamber_and_a_long_pause_are_no_jump() -> None:
    """15 °C/min, and a night in between."""
    watch = _watch((0.0, 22.0), (60.0, 37.0), (120.0, 52.0))
    watch.accept(40000.0, -30.0, driven_to_degC=None)


def test_a_reading_that_stands_still_is_a_fault_only_on_its_way_somewhere() -> None:
    """At its setpoint, or with nothing to reach, air may read the same for hours."""
    _watch((0.0, 22.0), (5000.0, 22.0))
    _watch((0.0, 60.0), (5000.0, 60.0), to=60.0)
    with pytest.raises(SensorFault, match="without any change for 17 min on its way to 60"):
        _watch((0.0, 22.0), (500.0, 22.0), (1000.0, 22.0), to=60.0)
    _watch((0.0, 22.0), (500.0, 22.1), (1000.0, 22.1), to=60.0)


def test_wear_is_counted_and_told_only_where_it_matters() -> None:
    """A plain night is nothing; a setpoint every ten seconds wears the weaker parts out in a month."""
    clock = VirtualClock()
    wear = WriteWear(clock)
    assert wear.warning() is None
    for _ in range(30):
        wear.writes["setpoint"] += 1
    assert wear.warning() is None
    for _ in range(3600):
        wear.writes["setpoint"] += 1
    clock.sleep(36000.0)
    assert wear.writes == {"setpoint": 3630}
    assert wear.warning() == (
        "setpoint was written 3630 times; at this rate a memory of 100000 writes is worn out in 28 nights: use the "
        "controller's own ramp, or larger steps"
    )


def test_a_chamber_counts_what_it_writes() -> None:
    """Native limits once, then one setpoint at a time; the same setpoint again is no write."""
    bench = ChamberBench("watlow-f4")
    bench.chamber.prepare()
    for _ in range(3):
        bench.chamber.set_temperature(45.0)
    assert isinstance(bench.chamber, SupervisedChamber)
    assert bench.chamber.wear.writes == {"setpoint": 2, "high limit": 1, "low limit": 1}
    assert bench.chamber.wear_warning is None


def test_one_glitch_is_asked_again() -> None:
    """A single reading that cannot be true does not end a night."""
    bench = ChamberBench("simserv")
    bench.chamber.prepare()
    bench.chamber.read()
    asked = bench.wire.sent.count(b"11004")
    bench.fault(ChamberFaultKind.SENSOR_BROKEN, reading=80.0, ends_s=bench.clock.now() + 0.4)  # a read takes 0.6 s
    assert bench.chamber.read().temperature_degC == pytest.approx(22.0, abs=0.2)
    assert bench.wire.sent.count(b"11004") == asked + 2  # the glitch, and what was asked again


def test_every_chamber_tells_its_wear_through_what_is_around_it() -> None:
    """An ESPEC counts its settings too; watch and ramp pass the warning on."""
    bench = ChamberBench("espec")
    bench.chamber.prepare()
    assert bench.chamber.wear_warning is None
    for step in range(400):
        bench.chamber.set_temperature(30.0 + 0.1 * (step % 2))
    warning = RampedChamber(bench.chamber, bench.clock, degC_per_min=1.0).wear_warning
    assert warning is not None
    assert warning.startswith("setpoint was written 40")


def test_a_ramp_says_whether_steps_are_left() -> None:
    """And how many writes it takes, at most, before it begins."""
    bench = ChamberBench("watlow-f4")
    ramped = RampedChamber(bench.chamber, bench.clock, degC_per_min=1.0)
    ramped.prepare()
    assert not ramped.ramping
    ramped.set_temperature(30.0)
    looks = 0
    while ramped.ramping:
        bench.clock.sleep(10.0)
        ramped.read()
        looks += 1
        assert looks < 200
    writes = bench.chamber.wear.writes["setpoint"]
    assert 10 < writes <= steps_of_a_ramp(30.0 - 22.0, 1.0) + 1  # and the one that prepared it
    assert steps_of_a_ramp(0.0, 1.0) == 1
