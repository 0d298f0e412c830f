"""Labels are a collect's: what one sensor, or accelerometers, tell of them holds where rates hardly say anything."""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import replace

import numpy as np
import pytest

from hil.campaign import Campaign
from hil.campaign.plausibility import judged_by_its_records
from hil.solve import solve_campaign
from hil.solve.wrong_rows import MENDED, wrong_rows
from procedures.verdict import Verdict
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


@pytest.mark.slow
def test_labels_that_one_sensor_is_certain_of_are_put_right_in_the_other() -> None:
    """Whose rates say nothing of them; where they say the contrary, its own stay as they are."""
    filed = exchanged_in_run_5(FOLDERS["two sensors"]())
    told = wrong_rows(hardly_told(filed, 1))
    assert [(n, row.run, row.done) for n in (1, 2) for row in told[n].rows] == [(1, 5, MENDED), (2, 5, MENDED)]
    assert told[1].rows[0].why.endswith("; the same of collects 49–50 of sensor 2, recorded with them")
    sound = FOLDERS["two sensors"]().sensors[1]
    assert wrong_rows(replace(filed, sensors={**filed.sensors, 1: sound}))[1].rows == ()


def test_labels_are_put_right_where_they_are_less_likely_wrong_than_they_are_all_sensors() -> None:
    """By what a noisy sensor shows they are right, but by e^1.4 alone; that all sensors have the same is e^3.5."""
    filed, sound = exchanged_in_run_5(FOLDERS["two sensors"]()), FOLDERS["two sensors"]().sensors[1]
    noise = np.random.default_rng(0).normal(0.0, 60.0, sound.rates_deg_per_hr.shape)
    noisy = replace(
        sound,
        rates_deg_per_hr=sound.rates_deg_per_hr + noise,
        rates_se_deg_per_hr=np.full(noise.shape, 60.0),
    )
    (wrong,) = wrong_rows(replace(filed, sensors={**filed.sensors, 1: noisy}))[1].rows
    assert (wrong.run, wrong.done) == (5, MENDED)


def test_what_accelerometers_say_of_labels_holds_where_no_rate_contradicts_it() -> None:
    """Of rates that tell nothing the unit's own accelerometers are believed, for both sensors."""
    told = wrong_rows(hardly_told(FOLDERS["labels exchanged in a body"](), 1, 2))
    assert [(n, row.run, row.done) for n in (1, 2) for row in told[n].rows] == [(1, 5, MENDED), (2, 5, MENDED)]


def with_collects_13_and_14_exchanged(one: Campaign, what: Collection[str]) -> Campaign:
    """Return a campaign whose two collects have each other's cells in some columns; accelerometers go with none."""
    rows, places = one.sensors[2], np.arange(len(one.sensors[2]))
    places[[12, 13]] = [13, 12]
    columns = {"position": ["position"], "f": ["f_g"], "w": ["w_deg_per_hr"]}
    names = [name for word, several in columns.items() if word in what for name in several]
    conditions = replace(rows.conditions, **{name: getattr(rows.conditions, name)[places] for name in names})
    if "accelerometers" in what:
        shown = {name: of[places] if "accel" in name else of for name, of in conditions.columns.items()}
        conditions = replace(conditions, columns=shown)
    changed = replace(rows, conditions=conditions)
    if "rates" in what:
        rates, errors = rows.rates_deg_per_hr[places], rows.rates_se_deg_per_hr[places]
        changed = replace(changed, rates_deg_per_hr=rates, rates_se_deg_per_hr=errors)
    return judged_by_its_records(replace(one, sensors={2: changed}, contradicted={}, exchanged={}, warnings=()))


@pytest.mark.parametrize("accelerometers", [True, False])
@pytest.mark.parametrize(
    ("wrong", "to_exchange"),
    [
        (["rates"], {"rates"}),
        (["position", "f", "w"], {"position", "f", "w"}),
        (["f", "w"], {"f", "w"}),
        (["rates", "position"], {"rates", "position"}),
    ],
)
def test_who_exchanges_in_the_file_what_is_told_gets_a_pass(
    wrong: list[str], to_exchange: set[str], accelerometers: bool
) -> None:
    """Rates under each other, labels with all that goes by them, and what a first attempt to put them right leaves.

    Where no accelerometer tells how the unit lay, either puts it right, and both are said.
    """
    one = FOLDERS["good"]()
    if not accelerometers:
        rows = one.sensors[2]
        shown = {name: of for name, of in rows.conditions.columns.items() if "accel" not in name}
        one = replace(one, sensors={2: replace(rows, conditions=replace(rows.conditions, columns=shown))})
    filed = with_collects_13_and_14_exchanged(one, wrong)
    (run,) = (each for each in solve_campaign(filed) if each.run == 5)
    assert run.verdict is Verdict.FAIL
    (told,) = re.findall(r" \(exchange their ([^:)]+)", run.reason)
    ways = [set(re.findall(r"\b(rates|position|f|w)\b", way)) for way in told.split(", or their ")]
    assert to_exchange in ways or not accelerometers
    for way in ways:
        right = with_collects_13_and_14_exchanged(filed, way)
        assert [(each.run, each.verdict) for each in solve_campaign(right)] == [(k, Verdict.PASS) for k in range(1, 13)]
