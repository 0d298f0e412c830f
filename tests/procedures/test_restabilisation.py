# ruff: noqa: ARG005 - temperatures are functions of time, also where they are constant
"""The gate opens on evidence: time, band, slope and the unit's own sensor, held over the window."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from procedures.restabilisation import RestabilisationGate
from procedures.settings import InterlockSettings, Restabilisation

SETTINGS = Restabilisation(at_least_s=2700.0, window_s=600.0, ceiling_s=14400.0)
POLL_S = 10.0


def _opens(air, unit=lambda t: 25.0, settings=SETTINGS, sensors=(2,), until_s=14400.0, gate=None):
    """Return when the gate opens, or None, and the gate."""
    gate = gate or RestabilisationGate(settings, sensors)
    t = 0.0
    while t <= until_s:
        readings = {n: unit(t) for n in sensors if unit(t) is not None}
        if gate.look(t, air(t), 20.0, readings).met:
            return t, gate
        t += POLL_S
    return None, gate


def test_a_bench_that_was_always_still_waits_the_scheduled_time_and_no_longer():
    """45 minutes to the poll, decided by time."""
    opened, gate = _opens(lambda t: 20.0)
    assert opened == 2700.0
    assert gate.decision.decided_by == "time"


def test_being_in_the_band_at_once_is_no_reason_to_return_at_once():
    """Without a scheduled time the window's evidence still has to be there."""
    opened, gate = _opens(lambda t: 20.0, settings=replace(SETTINGS, at_least_s=0.0))
    assert opened == 600.0
    assert gate.decision.decided_by != "time"


def test_the_unit_itself_decides_where_it_lags_behind_the_air():
    """Case and rotor lag of 30 min after a 15 °C step: the slope falls below 0.05 °C/min at 69 minutes."""
    opened, gate = _opens(lambda t: 20.0, lambda t: 25.0 - 15.0 * math.exp(-t / 1800.0))
    # 15/30 exp(-t/30) = 0.05 °C/min at t = 69.1 min; regression over the window sees its middle, 5 min earlier.
    assert opened == pytest.approx((69.1 + 5.0) * 60.0, abs=60.0)
    assert gate.decision.decided_by in ("unit slope (sensor 2)", "unit band (sensor 2)")


def test_the_unit_may_be_warmer_than_the_air():
    """Self-heating of 8 °C is no failure of equilibrium."""
    assert _opens(lambda t: 20.0, lambda t: 28.0)[0] == 2700.0


@pytest.mark.parametrize("creep_degC_per_min", [0.06, -0.06])
def test_a_slow_creep_of_the_air_within_its_band_keeps_the_gate_shut(creep_degC_per_min):
    """0.06 °C/min up or down is a slope, although every reading lies in the band for a while."""
    settings = replace(SETTINGS, at_least_s=600.0)
    opened, gate = _opens(lambda t: 20.0 + creep_degC_per_min * (t - 360.0) / 60.0, settings=settings, until_s=715.0)
    assert opened is None
    assert gate.decision.waiting_for == ("slope",)


def test_a_short_excursion_restarts_the_window_but_not_the_soak():
    """One minute out of the band at minute 40: ten more minutes of evidence, not 45."""
    opened, gate = _opens(lambda t: 21.0 if 2400 <= t < 2460 else 20.0)
    assert opened == pytest.approx(2460.0 + 600.0, abs=POLL_S)
    assert (gate.soak_restarts, gate.window_restarts) == (0, 1)
    assert gate.decision.decided_by in ("band", "slope")


def test_a_long_excursion_restarts_the_soak():
    """Ten minutes out of the band: the unit has begun to follow."""
    opened, gate = _opens(lambda t: 21.0 if 1800 <= t < 2400 else 20.0)
    assert opened == pytest.approx(2400.0 + 2700.0, abs=POLL_S)
    assert (gate.soak_restarts, gate.window_restarts) == (1, 1)


def test_a_stretch_without_looks_is_no_evidence():
    """Twenty minutes in which nobody looked count like twenty minutes outside."""
    gate = RestabilisationGate(SETTINGS, (2,))
    for t in (*np.arange(0.0, 1000.0, POLL_S), *np.arange(2200.0, 4890.0, POLL_S)):
        assert not gate.look(float(t), 20.0, 20.0, {2: 25.0}).met
    assert gate.soak_restarts == 1
    assert gate.look(4900.0, 20.0, 20.0, {2: 25.0}).met


def test_a_noisy_thermometer_is_judged_by_its_slope_and_span():
    """0.05 °C of noise is no reason to wait; 0.5 °C is, and the criterion is named."""
    rng = np.random.default_rng(3)
    assert (
        _opens(lambda t: 20.0 + 0.05 * rng.standard_normal(), lambda t: 25.0 + 0.05 * rng.standard_normal())[0] == 2700
    )
    opened, gate = _opens(lambda t: 20.0, lambda t: 25.0 + 0.5 * rng.standard_normal(), until_s=5000.0)
    assert opened is None
    assert "unit band (sensor 2)" in gate.decision.waiting_for


def test_readings_that_are_not_numbers_lie_outside_the_band():
    """A broken sensor never opens the gate."""
    assert _opens(lambda t: float("nan"), until_s=6000.0)[0] is None


def test_a_thermometer_that_falls_silent_is_no_evidence():
    """The unit has a sensor, and it says nothing for the last ten minutes before the schedule is up."""
    opened, gate = _opens(lambda t: 20.0, lambda t: None if t > 2000 else 25.0, until_s=6000.0)
    assert opened is None
    assert "unit slope (sensor 2)" in gate.decision.waiting_for


def test_once_out_of_the_band_the_gate_is_shut_at_the_same_look():
    """No stale decision."""
    opened, gate = _opens(lambda t: 20.0)
    assert opened is not None
    assert not gate.look(opened + POLL_S, 22.0, 20.0, {2: 25.0}).met


def test_the_result_says_what_decided_with_temperatures_slopes_and_restarts(bench):
    """The journal's record of a soak is complete evidence."""
    bench.run()
    data = bench.record.results["T2/S1/restabilise"].data
    assert data["verdict"] == "PASS"
    assert "decided by" in data["reason"]
    assert data["waited_s"] >= 600.0
    assert data["waiting_for"] == []
    assert abs(data["chamber"]["slope_degC_per_min"]) < 0.05
    assert abs(data["unit"]["2"]["slope_degC_per_min"]) < 0.05
    assert data["unit"]["2"]["temperature_degC"] == pytest.approx(26.0, abs=0.5)


def test_a_unit_without_a_thermometer_relies_on_chamber_and_time_and_says_so(bench):
    """No silent assumption."""
    bench.imu.sensors = {2: bench.imu.sensors[2].model_copy(update={"temperature": None})}
    bench.run()
    data = bench.record.results["T1/S1/restabilise"].data
    assert data["verdict"] == "PASS"
    assert "the unit has no temperature sensor" in data["reason"]
    assert data["waited_s"] == pytest.approx(600.0, abs=POLL_S)


def test_the_ceiling_ends_the_wait(bench):
    """Never restabilised: the wait ends at the ceiling, and says what it was still waiting for."""
    bench.chamber.offset_degC = lambda t: 0.7 if int(t / 100.0) % 2 else 0.0
    bench.interlocks = InterlockSettings()
    bench.run()
    data = bench.record.results["T1/S1/restabilise"].data
    assert data["verdict"] == "INCONCLUSIVE"
    assert data["waited_s"] == pytest.approx(bench.sweep.restabilisation.ceiling_s, abs=1.0)
    assert "band" in data["waiting_for"]
    assert data["window_restarts"] > 3
