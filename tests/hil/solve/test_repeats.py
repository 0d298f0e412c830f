"""Which runs repeat each other: those at one temperature, and none whose temperature nobody knows."""

from __future__ import annotations

import numpy as np

from hil.campaign import Conditions, Sensor
from hil.solve.repeats import runs_by_temperature

SENSOR = Sensor(2, ("A", "B", "S"), {"RA": "A", "RB": "B"})


def conditions(columns: dict[str, list[float]]) -> Conditions:
    """Two collects in each run, with the given columns."""
    n = 2 * len(next(iter(columns.values()), [0.0, 0.0, 0.0]))
    return Conditions(
        SENSOR,
        collect=np.arange(1, n + 1),
        run=np.repeat(np.arange(1, n // 2 + 1), 2),
        position=np.array(["1", "2"] * (n // 2)),
        start_s=np.arange(n) * 100.0,
        duration_s=np.full(n, 60.0),
        f_g=np.zeros((n, 3)),
        w_deg_per_hr=np.zeros((n, 3)),
        columns={name: np.repeat(np.array(values), 2) for name, values in columns.items()},
    )


def test_the_setpoint_counts_before_the_units_own_temperature() -> None:
    """Runs at one setpoint are repeats although the unit read a little otherwise; groups come coldest first."""
    found = runs_by_temperature(
        conditions({"setpoint_degC": [40.0, -20.0, 40.0], "temperature_degC": [48.0, -11.0, 46.0]})
    )
    assert found == [(-20.0, (2,)), (40.0, (1, 3))]


def test_a_run_of_unknown_temperature_repeats_no_other() -> None:
    """Each stands alone, without a temperature, and nothing is NaN."""
    found = runs_by_temperature(conditions({"temperature_degC": [20.0, np.nan, 20.2, np.nan]}))
    assert [runs for _, runs in found] == [(1, 3), (2,), (4,)]
    assert [at for at, _ in found][1:] == [None, None]


def test_without_any_temperature_all_runs_are_repeats() -> None:
    """There is nothing to tell them apart by."""
    assert runs_by_temperature(conditions({})) == [(None, (1, 2, 3))]
