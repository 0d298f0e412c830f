"""The simulated chamber's air: ramp limit, overshoot, ambient when off, and a history that does not change."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.simulators.chambers.plant import ChamberPlant

HEATING, COOLING, SETTLING_S = 3.0, 2.0, 60.0


def _plant() -> ChamberPlant:
    return ChamberPlant(heating_degC_per_min=HEATING, cooling_degC_per_min=COOLING, settling_s=SETTLING_S)


def _slopes(air: np.ndarray, step_s: float) -> np.ndarray:
    return np.diff(air) / step_s * 60.0


def test_it_begins_at_ambient_and_stays_there() -> None:
    """An unconditioned chamber in a room of 22 °C reads 22 °C."""
    air = ChamberPlant(ambient_degC=22.0).air_degC(np.arange(0.0, 3600.0))
    np.testing.assert_array_equal(air, 22.0)


def test_it_ramps_at_its_limit_overshoots_as_stated_and_settles() -> None:
    """From 22 to 60 °C at 3 °C/min: 12.7 minutes and a lag, overshoot v b / e, then ripple alone."""
    plant = _plant()
    plant.command(60.0, 100.0)
    times = np.arange(0.0, 5000.0)
    air = plant.air_degC(times)
    np.testing.assert_array_equal(air[:101], 22.0)
    assert _slopes(air, 1.0).max() == pytest.approx(HEATING, rel=1e-6)
    reached_s = times[np.argmax(air >= 60.0)]
    assert reached_s == pytest.approx(100.0 + 38.0 / HEATING * 60.0 + 20.0, abs=2.0)
    assert air.max() - 60.0 == pytest.approx(HEATING / 60.0 * SETTLING_S / math.e, abs=0.06)
    settled = air[times > reached_s + 15 * 60]
    assert np.abs(settled - 60.0).max() == pytest.approx(0.05, abs=0.002)


def test_a_small_step_overshoots_little() -> None:
    """A host that ramps in steps of 0.2 °C is not thrown off by each of them."""
    plant = _plant()
    plant.command(22.2, 0.0)
    overshoot = plant.air_degC(np.arange(0.0, 3600.0)).max() - 22.2
    assert 0.05 < overshoot <= 0.3 * 0.2 + 0.05


def test_it_cools_at_its_own_limit() -> None:
    """Cooling is slower than heating."""
    plant = _plant()
    plant.command(-29.7, 0.0)
    assert _slopes(plant.air_degC(np.arange(0.0, 3600.0)), 1.0).min() == pytest.approx(-COOLING, rel=1e-6)


def test_switched_off_it_leaks_to_ambient() -> None:
    """One time constant later, 1/e of the difference is left."""
    plant = ChamberPlant(ambient_degC=22.0, leak_s=3600.0)
    plant.command(60.0, 0.0)
    hot = plant.advance(7200.0)
    plant.command(None, 7200.0)
    assert plant.advance(7200.0 + 3600.0) == pytest.approx(22.0 + (hot - 22.0) / math.e, abs=1e-9)


def test_a_dead_plant_takes_a_setpoint_and_does_not_follow() -> None:
    """Until it is revived."""
    plant = _plant()
    plant.fail(dead=True, at_s=0.0)
    plant.command(60.0, 10.0)
    assert plant.commanded_degC == 60.0
    assert plant.advance(3600.0) == pytest.approx(22.0)
    plant.fail(dead=False, at_s=3600.0)
    assert plant.advance(7200.0) == pytest.approx(60.0, abs=0.1)


def test_the_same_setpoint_again_disturbs_nothing() -> None:
    """Writing what already holds must not bump the air."""
    once, twice = _plant(), _plant()
    for plant in (once, twice):
        plant.command(40.0, 0.0)
    twice.advance(600.0)
    twice.command(40.0, 600.0)
    times = np.arange(0.0, 3600.0)
    np.testing.assert_array_equal(once.air_degC(times), twice.air_degC(times))


def test_history_does_not_change_when_a_command_comes_late() -> None:
    """What has been asked for stays; the late command takes effect from there."""
    plant = _plant()
    plant.command(60.0, 0.0)
    asked = np.arange(0.0, 601.0)
    before = plant.air_degC(asked)
    plant.command(-20.0, 300.0)
    np.testing.assert_array_equal(plant.air_degC(asked), before)
    assert plant.advance(1200.0) < before[-1]


def test_arrays_and_single_moments_agree() -> None:
    """The unit's thermal model asks arrays, the controller asks moments: it is one temperature."""
    plant = _plant()
    for at_s, setpoint in ((0.0, 60.0), (400.0, -10.0), (3000.0, None), (5000.0, 30.0)):
        plant.command(setpoint, at_s)
        plant.advance(at_s)
    times = np.linspace(-10.0, 8000.0, 997)
    np.testing.assert_allclose(plant.air_degC(times), [plant.advance(t) for t in times], rtol=0, atol=1e-12)
    assert plant.air_degC(np.empty(0)).shape == (0,)


@settings(max_examples=60)
@given(
    commands=st.lists(
        st.tuples(st.floats(0.0, 1800.0), st.one_of(st.none(), st.floats(-60.0, 90.0))), min_size=1, max_size=8
    )
)
def test_whatever_is_commanded_the_air_is_continuous_and_keeps_the_ramp_limits(
    commands: list[tuple[float, float | None]],
) -> None:
    """Reversals in mid-ramp, commands while it overshoots, switching off and on: no jump, no faster than the limits."""
    plant, now_s = _plant(), 0.0
    for wait_s, setpoint in commands:
        now_s += wait_s
        plant.command(setpoint, now_s)
        plant.advance(now_s)
    air = plant.air_degC(np.arange(0.0, now_s + 3600.0, 0.5))
    slopes = _slopes(air, 0.5)
    assert slopes.max() <= HEATING + 1e-6
    assert slopes.min() >= -COOLING - 1e-6


def test_rates_are_positive() -> None:
    """A negative cooling rate is a sign mistake and is refused."""
    with pytest.raises(ValueError, match="positive"):
        ChamberPlant(cooling_degC_per_min=-2.0)


def test_it_remembers_which_setpoint_it_was_told_and_since_when() -> None:
    """The same again, and the end of conditioning, are no new setpoint; before the first there is none."""
    plant = ChamberPlant()
    for setpoint, at_s in ((30.0, 10.0), (30.0, 20.0), (None, 25.0), (40.0, 50.0)):
        plant.command(setpoint, at_s)
    setpoints, since_s = plant.setpoint_at(np.array([0.0, 10.0, 49.0, 50.0, 60.0]))
    np.testing.assert_array_equal(setpoints, [np.nan, 30.0, 30.0, 40.0, 40.0])
    np.testing.assert_array_equal(since_s, [np.nan, 0.0, 39.0, 0.0, 10.0])
