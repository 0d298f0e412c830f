"""The curves as the autopilots' parameter files: evaluated as these evaluate them they are the curves."""

from __future__ import annotations

import numpy as np
import pytest

from hil.analysis.thermal.files import (
    ARDUPILOT_REFERENCE_DEGC,
    RAD_PER_S,
    autopilot_files,
    bias_polynomials,
)
from hil.analysis.thermal.fit import fit_thermal
from tests.hil.analysis.thermal.nights import rotor_night, scaled, triad_night


@pytest.mark.slow
def test_px4_and_ardupilot_files_correct_as_the_curves_say() -> None:
    """Evaluated as the autopilots evaluate them, the parameters give the bias curves to a microradian per hour."""
    curves = {
        "BX": lambda t: 50.0 + 30.0 * scaled(t),
        "BY": lambda t: -20.0 + 40.0 * scaled(t) ** 2,
        "BZ": lambda t: 10.0 + 60.0 * (4 * scaled(t) ** 3 - 3 * scaled(t)),
        "GXY": lambda t: 4.0 + 0.0 * t,
    }
    fit = fit_thermal(triad_night(np.random.default_rng(13), curves)).sensors[1]
    assert [fit.parameters[name].form for name in ("BX", "BY", "BZ")] == ["linear", "quadratic", "cubic"]
    px4, ardupilot = map(parameters, autopilot_files(fit).values())
    assert px4["TC_G_ENABLE"] == 1
    for axis, name in enumerate(("BX", "BY", "BZ")):
        curve = fit.parameters[name].curve
        for degC in (-29.0, 5.0, 35.0, 59.0):
            delta = degC - px4["TC_G0_TREF"]
            offset = sum(px4[f"TC_G0_X{power}_{axis}"] * delta**power for power in range(4))
            assert offset == pytest.approx(float(curve.at(degC)) * RAD_PER_S, abs=1e-9)
            d = degC - ARDUPILOT_REFERENCE_DEGC
            change = sum(ardupilot[f"INS_TCAL1_GYR{power}_{'XYZ'[axis]}"] * d**power for power in (1, 2, 3)) * 1e-6
            expected = float(curve.at(degC) - curve.at(ARDUPILOT_REFERENCE_DEGC)) * RAD_PER_S
            assert change == pytest.approx(expected, abs=1e-9)
    assert ardupilot["INS_TCAL1_TMAX"] == pytest.approx(60.0, abs=0.5)


@pytest.mark.slow
def test_a_bias_that_needs_more_than_a_cubic_is_exported_with_a_warning() -> None:
    """The files hold cubics: what is lost by that stands in them."""
    curves = {"BX": lambda t: 80.0 * np.polynomial.chebyshev.chebval(scaled(t), [0, 0, 0, 0, 0, 1])}
    fit = fit_thermal(triad_night(np.random.default_rng(14), curves)).sensors[1]
    assert fit.parameters["BX"].choice.form.order not in (0, 1, 2, 3)
    assert "is what the data ask for" in autopilot_files(fit)["px4.params"]
    assert bias_polynomials(fit)[1]


def test_a_rotor_sensor_has_no_autopilot_parameters() -> None:
    """Two channels and MU mean nothing to PX4."""
    rotor = fit_thermal(rotor_night(np.random.default_rng(7), {"BA": lambda t: 20.0 + 15.0 * scaled(t)}))
    assert autopilot_files(rotor.sensors[2]) == {}


def parameters(text: str) -> dict[str, float]:
    """Read either parameter file as an autopilot's ground station does."""
    found = {}
    for line in text.splitlines():
        cells = line.split()
        if cells and not line.startswith("#"):
            name, value = (cells[2], cells[3]) if len(cells) == 5 else cells
            found[name] = float(value)
    return found
