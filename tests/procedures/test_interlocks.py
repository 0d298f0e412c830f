"""Interlocks: suspicion, clearing, and tripping after the grace and not before."""

from __future__ import annotations

from dataclasses import replace

import pytest

from drivers.chamber import ChamberLimits, ChamberReading
from drivers.imu import StreamCounts
from procedures.interlocks import Interlocks, InterlockTripped, Look, standard_interlocks
from procedures.settings import InterlockSettings

READING = ChamberReading(20.0, 20.0, 80.0, -50.0, "CONSTANT")
GOOD = Look(
    0.0,
    1.0,
    20,
    StreamCounts(ok=20),
    20.0,
    READING,
    chamber_fresh=True,
    unit_degC={2: 25.0},
    commanded_degC=20.0,
    arrived=True,
)
SETTINGS = InterlockSettings()


def _make():
    told = []
    rules = standard_interlocks(SETTINGS, ChamberLimits(-45.0, 75.0))
    return Interlocks(rules, lambda kind, message: told.append((kind, message))), told


def _air(temperature_degC, **more):
    return replace(GOOD, chamber=replace(READING, temperature_degC=temperature_degC, **more))


BAD = {
    "chamber-lost": (replace(GOOD, chamber_fresh=False, chamber_error="no answer"), SETTINGS.chamber_loss_s),
    "chamber-alarm": (_air(20.0, alarms=("HIGH",)), SETTINGS.alarm_grace_s),
    "chamber-limits": (replace(_air(78.5), arrived=False), SETTINGS.chamber_limit_grace_s),
    "setpoint-changed": (_air(20.0, setpoint_degC=20.5), SETTINGS.setpoint_grace_s),
    "setpoint-not-followed": (_air(23.5), SETTINGS.follow_grace_s),
    "unit-limits": (replace(GOOD, unit_degC={1: 20.0, 2: 91.0}), SETTINGS.unit_limit_grace_s),
    "stream-lost": (replace(GOOD, samples=0, counts=StreamCounts()), SETTINGS.stream_loss_s),
}


@pytest.mark.parametrize("name", BAD)
def test_each_trips_after_its_grace_and_not_before(name):
    """At half the grace it is suspected, at the grace it trips and names itself."""
    look, grace_s = BAD[name]
    interlocks, told = _make()
    interlocks.evaluate(replace(look, time_s=100.0))
    assert name in interlocks.suspected
    interlocks.evaluate(replace(look, time_s=100.0 + 0.5 * grace_s))
    with pytest.raises(InterlockTripped, match=name):
        interlocks.evaluate(replace(look, time_s=100.0 + grace_s))
    assert [kind for kind, _ in told] == ["interlock-suspected"]


@pytest.mark.parametrize("name", BAD)
def test_each_clears_and_begins_its_grace_anew(name):
    """A condition that comes and goes is on record each time and never adds up."""
    look, grace_s = BAD[name]
    interlocks, told = _make()
    for i in range(4):
        interlocks.evaluate(replace(look, time_s=i * grace_s))
        interlocks.evaluate(replace(GOOD, time_s=(i + 0.5) * grace_s))
        assert interlocks.suspected == ""
    assert [kind for kind, _ in told] == ["interlock-suspected", "interlock-cleared"] * 4


@pytest.mark.parametrize("name", ["chamber-alarm", "chamber-limits", "setpoint-changed", "setpoint-not-followed"])
def test_looks_without_a_new_reading_say_nothing(name):
    """An old reading neither trips nor clears."""
    look, grace_s = BAD[name]
    interlocks, _ = _make()
    interlocks.evaluate(replace(look, time_s=0.0))
    interlocks.evaluate(replace(GOOD, time_s=1.0, chamber_fresh=False))
    assert name in interlocks.suspected
    interlocks.evaluate(replace(look, time_s=grace_s + 1.0, chamber_fresh=False))


def test_one_sighting_never_trips_however_late_the_next_look():
    """A grace of nothing still needs two looks."""
    interlocks = Interlocks(
        standard_interlocks(replace(SETTINGS, alarm_grace_s=0.0), ChamberLimits(-45, 75)), lambda _kind, _message: None
    )
    interlocks.evaluate(BAD["chamber-alarm"][0])
    with pytest.raises(InterlockTripped):
        interlocks.evaluate(BAD["chamber-alarm"][0])


def test_a_good_bench_gives_no_suspicion():
    """Nor does a ramp, far from its setpoint before it arrives."""
    interlocks, told = _make()
    interlocks.evaluate(GOOD)
    interlocks.evaluate(replace(_air(-20.0), arrived=False))
    interlocks.evaluate(replace(GOOD, commanded_degC=None, chamber=replace(READING, setpoint_degC=55.0)))
    assert told == []


def test_a_stream_of_mostly_damaged_frames_is_a_lost_stream():
    """Good frames among more bad ones; a few bad ones are not."""
    interlocks, _ = _make()
    interlocks.evaluate(replace(GOOD, samples=15, counts=StreamCounts(ok=15, bad_checksum=5)))
    assert interlocks.suspected == ""
    interlocks.evaluate(replace(GOOD, samples=5, counts=StreamCounts(ok=5, bad_checksum=15)))
    assert "15 of 20 frames" in interlocks.suspected


def test_a_drain_too_short_to_expect_a_frame_says_nothing():
    """Nothing after a tenth of a second at 20 Hz is no loss."""
    interlocks, told = _make()
    interlocks.evaluate(replace(GOOD, samples=0, counts=StreamCounts(), stream_span_s=0.1))
    assert told == []
