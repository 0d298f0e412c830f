"""Labels are a collect's: what one sensor, or accelerometers, tell of them holds where rates hardly say anything."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hil.campaign import Campaign
from hil.solve.wrong_rows import MENDED, wrong_rows
from tests.hil.audit.folders import FOLDERS


def hardly_told(one: Campaign, *sensors: int) -> Campaign:
    """Return a campaign in which some sensors show the same at positions 1 and 2, but for noise of 1 deg/hr."""
    rng, alike = np.random.default_rng(0), {}
    for number in sensors:
        rates = one.sensors[number].rates_deg_per_hr.copy()
        rates[::3] = rates[1::3] = 0.5 * (rates[::3] + rates[1::3])
        alike[number] = replace(one.sensors[number], rates_deg_per_hr=rates + rng.normal(0.0, 1.0, rates.shape))
    return replace(one, sensors={**one.sensors, **alike})


def exchanged_in_run_5(one: Campaign) -> Campaign:
    """Return a campaign whose collects 1 and 2 of run 5 stand under each other, in all sensors."""
    sensors = {}
    for number, rows in one.sensors.items():
        rates, first = rows.rates_deg_per_hr.copy(), int(np.flatnonzero(rows.conditions.run == 5)[0])
        rates[[first, first + 1]] = rates[[first + 1, first]]
        sensors[number] = replace(rows, rates_deg_per_hr=rates)
    return replace(one, sensors=sensors)


def test_labels_that_one_sensor_is_certain_of_are_put_right_in_the_other() -> None:
    """Whose rates say nothing of them; where they say the contrary, its own stay as they are."""
    filed = exchanged_in_run_5(FOLDERS["two sensors"]())
    told = wrong_rows(hardly_told(filed, 1))
    assert [(n, row.run, row.done) for n in (1, 2) for row in told[n].rows] == [(1, 5, MENDED), (2, 5, MENDED)]
    assert told[1].rows[0].why.endswith("; the same of collects 49–50 of sensor 2, recorded with them")
    contrary = replace(filed, sensors={**filed.sensors, 1: FOLDERS["two sensors"]().sensors[1]})
    assert wrong_rows(contrary)[1].rows == ()


def test_what_accelerometers_say_of_labels_holds_where_no_rate_contradicts_it() -> None:
    """Of rates that tell nothing the unit's own accelerometers are believed, for both sensors."""
    told = wrong_rows(hardly_told(FOLDERS["labels exchanged in a body"](), 1, 2))
    assert [(n, row.run, row.done) for n in (1, 2) for row in told[n].rows] == [(1, 5, MENDED), (2, 5, MENDED)]
