"""Interlocks: suspicion, clearing, and tripping after the grace and not before."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.chambers import ChamberLimits, ChamberReading
from drivers.clock import VirtualClock
from drivers.frames.counts import StreamCounts
from drivers.frames.roles import SensorRole
from drivers.imu import SampleBlock
from procedures.interlocks import Interlocks, InterlockTripped, Look, standard_interlocks
from procedures.settings import InterlockSettings
from procedures.unit_watch import UnitWatch

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
    frozen_s={"2.RA": 0.0, "2.RB": 40.0},
    disk_free_mb=5000.0,
)
SETTINGS = InterlockSettings()


RULES = standard_interlocks(SETTINGS, ChamberLimits(-45.0, 75.0))


def _make():
    told = []
    rules = [each for each in RULES if not each.name.endswith("-rate")]  # these are bad only beside looks before
    return Interlocks(rules, lambda kind, message: told.append((kind, message))), told


def _air(temperature_degC, **more):
    return replace(GOOD, chamber=replace(READING, temperature_degC=temperature_degC, **more))


BAD = {
    "chamber-lost": (replace(GOOD, chamber_fresh=False, chamber_error="no answer"), SETTINGS.chamber_loss_s),
    "chamber-alarm": (_air(20.0, alarms=("HIGH",)), SETTINGS.alarm_grace_s),
    "chamber-limits": (replace(_air(78.5), arrived=False), SETTINGS.chamber_limit_grace_s),
    "chamber-stopped": (_air(20.0, mode="STANDBY"), SETTINGS.setpoint_grace_s),
    "setpoint-changed": (_air(20.0, setpoint_degC=20.5), SETTINGS.setpoint_grace_s),
    "setpoint-not-followed": (_air(23.5), SETTINGS.follow_grace_s),
    "unit-limits": (replace(GOOD, unit_degC={1: 20.0, 2: 91.0}), SETTINGS.unit_limit_grace_s),
    "stream-lost": (replace(GOOD, samples=0, counts=StreamCounts(), stream_span_s=2.5), SETTINGS.stream_loss_s),
    "stream-frozen": (replace(GOOD, frozen_s={"2.RA": 31.0, "2.RB": 90.0}), 0.5 * SETTINGS.frozen_s),
    "disk-low": (replace(GOOD, disk_free_mb=1.0), SETTINGS.disk_grace_s),
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


@pytest.mark.parametrize(
    ("name", "move"),
    [
        ("chamber-rate", lambda look, degC: replace(look, chamber=replace(READING, temperature_degC=20.0 + degC))),
        ("unit-rate", lambda look, degC: replace(look, unit_degC={2: 20.0 + degC})),
    ],
)
@pytest.mark.parametrize(("degC_per_min", "trips"), [(30.0, True), (-30.0, True), (5.0, False)])
def test_a_temperature_that_runs_away_trips_by_its_rate(name, move, degC_per_min, trips):
    """Up or down, before any limit is reached; a quick ramp does not, and one wrong reading clears again."""
    rule = next(each for each in standard_interlocks(SETTINGS, ChamberLimits(-45.0, 75.0)) if each.name == name)
    said = [rule.problem(move(replace(GOOD, time_s=t), degC_per_min * t / 60.0)) for t in np.arange(0.0, 300.0, 10.0)]
    assert bool(said[-1]) is trips
    assert said[0] is None
    glitch = [
        rule.problem(move(replace(GOOD, time_s=1000.0 + t), 50.0 * (t == 0.0))) for t in np.arange(0.0, 300.0, 10.0)
    ]
    assert glitch[-1] == ""


def test_the_countdown_names_what_is_suspected_and_the_seconds_that_are_left():
    """A chamber that does not answer: what somebody at the terminal sees."""
    interlocks, _ = _make()
    assert interlocks.countdown(0.0) == ""
    look, grace_s = BAD["chamber-lost"]
    interlocks.evaluate(replace(look, time_s=100.0))
    assert interlocks.countdown(130.0).endswith(f"safe state in {grace_s - 30.0:.0f} s unless it clears")
    assert "does not answer: no answer" in interlocks.countdown(130.0)


def test_in_a_pause_the_stream_may_be_unplugged_and_the_chamber_may_not():
    """A pause is for cables; what the chamber does matters all the same."""
    interlocks, _ = _make()
    for name in ("stream-lost", "stream-frozen"):
        look, grace_s = BAD[name]
        for time_s in (0.0, 2.0 * grace_s):
            interlocks.evaluate(replace(look, time_s=time_s, resting=True))
    look, grace_s = BAD["chamber-alarm"]
    interlocks.evaluate(replace(look, time_s=1000.0, resting=True))
    with pytest.raises(InterlockTripped, match="chamber-alarm"):
        interlocks.evaluate(replace(look, time_s=1000.0 + grace_s, resting=True))


def test_a_rate_that_never_changes_is_timed_and_noise_is_not():
    """Across drains; a change anywhere begins it anew."""
    sensors = {2: SensorRole(rates={"RA": "rate_A2", "RB": "rate_B2"})}
    devices: Any = SimpleNamespace(imu=SimpleNamespace(sensors=sensors), clock=VirtualClock())
    watch = UnitWatch("", devices, lambda *_: None, lambda: None)

    def block(b_deg_per_hr):
        return SampleBlock(np.zeros(3), {"rate_A2": np.array([1.0, 2.0, 1.5]), "rate_B2": np.full(3, b_deg_per_hr)})

    seen = [dict(watch.unchanged_s(block(b), t)) for t, b in ((0.0, 4.0), (10.0, 4.0), (35.0, 4.0), (40.0, 5.0))]
    assert [each["2.RB"] for each in seen] == [0.0, 10.0, 35.0, 0.0]
    assert [each["2.RA"] for each in seen] == [0.0] * 4


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
