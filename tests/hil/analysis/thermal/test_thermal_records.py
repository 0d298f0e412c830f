"""Curves of real units: a warming record, and published coefficients outside the range that they were fitted in."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hil.analysis.thermal.fit import fit_thermal
from hil.campaign import Collects
from hil.errors import InputError
from hil.model.curve import Polynomial
from tests.hil.analysis.thermal.nights import triad_night


@pytest.mark.parametrize(
    "apart_degC", [*(pytest.param(each, marks=pytest.mark.slow) for each in (0.2, 0.3, 0.4, 0.6)), 0.5, 0.8]
)
def test_a_real_warming_record_is_linear_in_one_axis(reference_data: Path, apart_degC: float) -> None:
    """VN-310 warming by 3 °C: gy rises by 0.0041 deg/s per °C, and no quadratic is needed, however it is cut.

    Every mean of a second is a run of its own here. (At 0.35 °C a quadratic wins, by a chance of 0.049.)
    """
    stored = np.genfromtxt(
        reference_data / "temperature" / "vn310-warming-34s.csv", delimiter=",", names=True, deletechars=""
    )
    names = stored.dtype.names
    assert names is not None
    temperature = stored[next(name for name in names if "Temp" in name)]
    rates = np.stack([stored[next(n for n in names if f"UncompGyro::{axis}" in n)] for axis in "XYZ"], -1)
    second = np.arange(len(temperature)) // 20
    mean = np.stack([np.bincount(second, rates[:, c]) / np.bincount(second) for c in range(3)], -1)
    degC = np.bincount(second, temperature) / np.bincount(second)
    night = triad_night(np.random.default_rng(0), {})
    rows = night.sensors[1].conditions.rows(np.arange(len(degC)))
    conditions = replace(rows, run=np.arange(len(degC)), f_g=np.tile([0.0, 0.0, 1.0], (len(degC), 1)))
    conditions = replace(conditions, columns={"temperature_degC": degC})
    in_deg_per_hr = np.degrees(mean) * 3600.0
    collects = Collects(conditions, in_deg_per_hr, np.full(mean.shape, np.nan))
    fit = fit_thermal(replace(night, sensors={1: collects}), "constant", apart_degC=apart_degC).sensors[1]
    found = fit.parameters["BY"]
    assert found.form == "linear"
    assert found.coefficients.values[1] / 3600.0 == pytest.approx(0.0041, abs=0.0008)


def test_published_cubics_that_blow_up_outside_their_range_are_refused_there(reference_data: Path) -> None:
    """Of 32 published sets some are wrong by five times their own span 15 °C further out; the curve refuses."""
    path = reference_data / "temperature" / "published-cubic-coefficients.csv"
    sets = np.genfromtxt(path, delimiter=",", names=True, dtype=None, encoding="utf-8")
    blown = 0
    for each in sets:
        low, high = float(each["tmin_C"]), float(each["tmax_C"])
        cubic = (0.0, *(float(each[f"gyr{power}_x_1e6"]) for power in (1, 2, 3)))
        curve = Polynomial(unit="1e-6 rad/s", polynomial=cubic, reference_degC=35.0, valid_degC=(low, high))
        inside = curve.at(np.linspace(low, high, 50))
        free = Polynomial(unit="1e-6 rad/s", polynomial=cubic, reference_degC=35.0)
        blown += bool(np.abs(free.at([low - 15.0, high + 15.0]) - inside.mean()).max() > 5 * np.ptp(inside))
        for outside in (low - 15.0, high + 15.0):
            with pytest.raises(InputError, match="not extrapolated"):
                curve.at(outside)
    assert blown >= 2
