"""The unit follows the chamber's air with two lags, so that 45 minutes matter, and warms itself after spin-on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hil.bench import build_bench
from hil.campaign import FloatArray
from hil.config.simulation import ThermalSection
from hil.twin.thermal import ThermalUnit
from tests.hil.twin.quiet import changed_bench, collect, quiet_bench


def _ramp(times_s: FloatArray) -> FloatArray:
    """Return air that goes from 0 to 15.3 °C at 3 °C/min and stays there."""
    return np.minimum(15.3, 3.0 * times_s / 60.0)


def _still(times_s: FloatArray) -> FloatArray:
    """Return air that is at one temperature all the time."""
    return np.full(len(times_s), 15.3)


def _wave(times_s: FloatArray) -> FloatArray:
    """Return air that moves all the time."""
    return np.asarray(20.0 + 0.01 * times_s + 3.0 * np.sin(times_s / 300.0))


def _warm(**lags: str) -> ThermalSection:
    return ThermalSection(**lags)  # type: ignore[arg-type]  # as a file gives them


def _rotor(thermal: ThermalUnit, minutes: float) -> float:
    return float(thermal.advance(minutes * 60.0)[1][-1, 2])


@pytest.mark.parametrize(
    ("case_lag", "rotor_lag", "left_degC"),
    [("12 min", "10 min", (1.58, 0.051, 0.001)), ("15 min", "20 min", (4.63, 0.639, 0.075))],
)
def test_45_minutes_after_a_step_a_tenth_of_it_is_left(
    case_lag: str, rotor_lag: str, left_degC: tuple[float, float, float]
) -> None:
    """Between two of the published temperatures, after 45, 90 and 135 minutes, from the ramp's beginning."""
    settings = _warm(case_lag=case_lag, rotor_lag=rotor_lag)
    thermal = ThermalUnit(settings, _ramp, start_degC=0.0, begins_s=0.0, powered_for_s=1e6)
    for minutes, left in zip((45.0, 90.0, 135.0), left_degC, strict=True):
        assert 15.3 - _rotor(thermal, minutes) == pytest.approx(left, rel=0.02, abs=0.0005)


def test_the_lags_are_those_of_the_differential_equations() -> None:
    """Against an integrator, with air that never stands still."""
    settings = _warm(case_lag="12 min", rotor_lag="10 min")
    thermal = ThermalUnit(settings, _wave, start_degC=20.0, begins_s=0.0, powered_for_s=1e6)
    times_s, state, slopes = thermal.advance(7200.0)

    def slope(t: float, y: FloatArray) -> FloatArray:
        air = _wave(np.array([t]))[0]
        return np.array([(air - y[0]) / 720.0, (y[0] - y[1]) / 600.0])

    exact = solve_ivp(slope, (0.0, 7200.0), [20.0, 20.0], t_eval=times_s, rtol=1e-9, atol=1e-9).y.T
    np.testing.assert_allclose(state[:, 1:], exact, atol=1e-3)
    np.testing.assert_allclose(slopes[1:-1], np.gradient(exact, times_s, axis=0)[1:-1], atol=2e-6)


def test_a_unit_that_has_just_spun_up_warms_itself() -> None:
    """8 °C are missing at spin-on and come with 15 minutes; afterwards it reads the temperature of its soak."""
    settings = _warm(self_heating="8 degC", self_heating_lag="15 min")
    thermal = ThermalUnit(settings, _still, start_degC=15.3, begins_s=100.0, powered_for_s=0.0)
    times_s, state, _ = thermal.advance(100.0 + 4 * 3600.0)
    np.testing.assert_allclose(state[:, 2], 15.3 - 8.0 * np.exp(-(times_s - 100.0) / 900.0), atol=1e-9)
    np.testing.assert_allclose(state[:, 1], 15.3, atol=1e-9)


@pytest.mark.slow
def test_the_unit_lags_behind_the_chamber_in_the_bytes(tmp_path: Path) -> None:
    """After a step of the setpoint air, case and rotor follow in this order and meet in the end."""
    with build_bench(changed_bench(tmp_path, start={"powered_for": "10 h"})) as live:
        live.devices.chamber.prepare()
        live.devices.chamber.set_temperature(60.0)
        seen = []
        for _ in range(2):
            live.devices.clock.sleep(1200.0)
            air_degC = live.devices.chamber.read().temperature_degC
            fields = live.devices.imu.read_block().fields
            seen.append((air_degC, fields["case_degC"][-1], fields["rotor_2_degC"][-1]))
        live.devices.clock.sleep(6 * 3600.0)
        live.devices.imu.discard()
        live.devices.clock.sleep(60.0)
        fields = live.devices.imu.read_block().fields
    assert all(air > case + 0.5 > rotor + 1.0 for air, case, rotor in seen)
    assert fields["case_degC"].mean() == pytest.approx(60.0, abs=0.05)
    assert fields["rotor_2_degC"].mean() == pytest.approx(60.0, abs=0.05)


def test_coefficients_follow_the_rotors_temperature_not_the_chambers(tmp_path: Path) -> None:
    """A bias of 1 deg/hr per °C shows the rotor's lag in the rate itself."""
    bench = quiet_bench(tmp_path, {}, start={"powered_for": "10 h"})
    model = tmp_path / "quiet.yaml"
    slope = "BA: {unit: deg/hr, polynomial: [0.0, 1.0], reference_degC: 0.0}"
    text = model.read_text()
    begin = text.index("  2:")
    model.write_text(text[:begin] + text[begin:].replace("BA:\n      unit: deg/hr\n      value: 0.0", slope))
    with build_bench(bench) as live:
        level = collect(live, "1")
        live.devices.chamber.prepare()
        live.devices.chamber.set_temperature(60.0)
        live.devices.clock.sleep(1800.0)
        live.devices.imu.discard()
        live.devices.clock.sleep(20.0)
        means = {name: float(np.mean(values)) for name, values in live.devices.imu.read_block().fields.items()}
    moved = means["rotor_2_degC"] - level["rotor_2_degC"]
    assert 5.0 < moved < 35.0
    assert means["rate_A2"] - level["rate_A2"] == pytest.approx(moved, abs=0.02)
