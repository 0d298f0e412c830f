"""How the unit lay, by its accelerometers and the other sensor, says which labels are put right, and which are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hil.campaign import Campaign
from hil.campaign.plausibility import judged_by_its_records
from hil.solve import solve_campaign
from hil.solve.causes import Cause
from hil.solve.omissions import what_is_wrong
from hil.solve.wrong_rows import LEFT_OUT, MENDED, in_the_file, lies_off_g, pooled, treated, wrong_rows
from procedures.verdict import Verdict
from tests.hil.audit.folders import FOLDERS
from tests.hil.solve.runs_of_a_unit import with_column


def made(name: str) -> Campaign:
    """Return one of the small campaigns."""
    return FOLDERS[name]()


def test_labels_of_a_body_are_exchanged_for_all_its_sensors() -> None:
    """The accelerometers tell it of both sensors, the rates of one alone: both are mended, FAIL, and in the means."""
    body = made("labels exchanged in a body")
    assert [(r["sensor"], r["collects"], r["done"]) for r in what_is_wrong(body)["rows"]] == [
        (1, [13, 14], MENDED), (2, [49, 50], MENDED),
    ]  # fmt: skip
    mended, sound = treated(body).sensors[2].rates_deg_per_hr, made("two sensors").sensors[2].rates_deg_per_hr
    np.testing.assert_array_equal(mended, sound)
    assert all(5 in rows.conditions.run for rows in pooled(body).sensors.values())
    assert {(e.run, e.verdict) for e in solve_campaign(body) if e.run == 5} == {(5, Verdict.FAIL)}
    (alone,) = what_is_wrong(replace(body, sensors={2: body.sensors[2]}))["rows"]
    assert (alone["done"], "recorded with" in alone["why"]) == (MENDED, False), "nothing was recorded with it"


def test_who_says_that_accelerometers_tell_an_exchange_has_asked_those_of_its_rows() -> None:
    """Those of other rows tell nothing of it."""
    filed = made("labels exchanged in a body").sensors[1]
    exchanged = Cause("exchanged", 5, (12, 13))
    as_filed, as_the_other = lies_off_g(filed, exchanged)
    assert as_the_other < 0.1 < as_filed
    assert "as f says)" not in in_the_file(filed, exchanged)
    columns = {n: np.where(np.arange(len(of)) > 11, np.nan, of) for n, of in filed.conditions.columns.items()}
    without = replace(filed, conditions=replace(filed.conditions, columns=columns))
    assert all(np.isnan(each) for each in lies_off_g(without, exchanged))
    assert "no accelerometer tells which" in in_the_file(without, exchanged)


def test_what_accelerometers_put_right_the_other_sensor_does_not_exchange_back() -> None:
    """Of a sensor that shows the same at both positions the other says what labels are, as it lay and not as filed."""
    body, sound, rng = made("labels exchanged in a body"), made("two sensors").sensors[1], np.random.default_rng(0)
    rates = sound.rates_deg_per_hr + rng.normal(0.0, 1.0, sound.rates_deg_per_hr.shape)
    rates[1::3] = rates[::3] + rng.normal(0.0, 1.0, rates[1::3].shape)
    first = replace(body.sensors[1], rates_deg_per_hr=rates, rates_se_deg_per_hr=np.ones(rates.shape))
    (wrong,) = wrong_rows(replace(body, sensors={**body.sensors, 1: first}))[1].rows
    assert (wrong.run, wrong.collects, wrong.done) == (5, (13, 14), MENDED)


def test_of_one_sensor_that_is_solved_the_other_tells_as_much() -> None:
    """Both sensors' rates of run 3 stand under each other: whoever solves one of them knows it by the other."""
    filed = made("two sensors")
    here = {n: rows.conditions.run == 3 for n, rows in filed.sensors.items()}
    rates = {n: (-0.5 if n == 1 else 1.0) * rows.rates_deg_per_hr for n, rows in filed.sensors.items()}
    rates[1][here[1]], rates[2][here[2]] = rates[2][here[2]].copy(), rates[1][here[1]].copy()
    sensors = {n: replace(rows, rates_deg_per_hr=rates[n]) for n, rows in filed.sensors.items()}
    torn = replace(filed, sensors=sensors)
    assert [each.why for each in wrong_rows(torn)[2].rows if "other sensor" in each.why]
    every = [(each.run, each.verdict, each.reason) for each in solve_campaign(torn) if each.sensor == 2]
    assert [(each.run, each.verdict, each.reason) for each in solve_campaign(torn, None, 2)] == every


def test_what_accelerometers_exchange_and_rates_do_not_is_in_no_mean() -> None:
    """Nobody knows which of the two is wrong: the run is solved as filed, FAILs, and is in nothing else."""
    torn = judged_by_its_records(made("contradicted"))
    assert torn.exchanged == {2: [(16, 17)]}
    assert what_is_wrong(torn)["rows"] == []
    assert set(torn.sensors[2].conditions.run) - set(pooled(torn).sensors[2].conditions.run) == {6}


def test_what_an_accelerometer_turned_for_good_shows_exchanges_nothing() -> None:
    """Each collect of position 1 seems to lie as in 2, and the reverse, in every run: it is the accelerometer."""
    one = made("good")
    shown = one.sensors[2].conditions.columns["accelerometer_A_g"]
    turned = with_column(one, accelerometer_A_g=-shown)
    assert turned.contradicted.keys() == {(run, 2) for run in range(1, 13)}
    assert turned.exchanged.get(2, []) == []
    np.testing.assert_array_equal(treated(turned).sensors[2].rates_deg_per_hr, one.sensors[2].rates_deg_per_hr)


def test_two_collects_that_lay_wrong_but_not_as_each_other_exchange_nothing() -> None:
    """Of run 6 the first lay as in position 2, the second as in position 3."""
    one = made("good")
    f = one.sensors[2].conditions.f_g
    shown = {}
    for axis, name in enumerate("ABS"):
        own = one.sensors[2].conditions.columns[f"accelerometer_{name}_g"].copy()
        own[15], own[16] = f[16, axis], f[17, axis]
        shown[f"accelerometer_{name}_g"] = own
    wrong = with_column(one, **shown)
    assert (6, 2) in wrong.contradicted
    assert wrong.exchanged == {2: []}


def test_a_label_that_f_gives_the_lie_to_mends_no_rates() -> None:
    """Two labels are exchanged and f, w and rates are right: the records say so, and the numbers stay what they are."""
    good = made("good")
    rows = good.sensors[2]
    labels = rows.conditions.position.copy()
    labels[[12, 13]] = labels[[13, 12]]
    relabelled = replace(rows, conditions=replace(rows.conditions, position=labels))
    wrong = wrong_rows(replace(good, sensors={2: relabelled}))[2]
    np.testing.assert_array_equal(wrong.collects.rates_deg_per_hr, rows.rates_deg_per_hr)
    assert not [row for row in wrong.rows if row.done in (MENDED, LEFT_OUT)]
