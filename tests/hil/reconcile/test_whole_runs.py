"""What is wrong with all rates of a run: signs, channels or sensors exchanged; found, and put right."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.campaign import Campaign, Sensor
from hil.reconcile.outcome.page import page
from hil.solve.wrong_rows import MENDED, wrong_rows
from procedures.verdict import Judgement, Verdict
from tests.hil.reconcile.hidden_effects import hidden_campaign
from tests.hil.reconcile.test_swap import found, swaps
from tests.hil.solve.runs_of_a_unit import with_rates
from tests.hil.solve.test_wrong_runs import noisy_beside_quiet


@pytest.mark.slow
def test_a_run_with_the_other_sensors_rates_is_mended_for_both() -> None:
    """As `hil solve` does: they are one mistake, in two sensors, and nothing of it is left out."""
    one, other = (hidden_campaign(seed, temperatures=(-10.0, 23.0, 50.0)).sensors[2] for seed in (5, 6))
    first = Sensor(1, ("A", "B", "S"), {"RA": "A", "RB": "B"})
    filed = {2: one, 1: replace(other, conditions=replace(other.conditions, sensor=first))}
    w = one.conditions.w_channels_deg_per_hr
    filed[1] = replace(filed[1], rates_deg_per_hr=w - 0.5 * (filed[1].rates_deg_per_hr - w))
    here = one.conditions.run == 3
    rates = {
        n: np.where(here[:, None], filed[3 - n].rates_deg_per_hr, rows.rates_deg_per_hr) for n, rows in filed.items()
    }
    torn = Campaign("t", "", {n: replace(rows, rates_deg_per_hr=rates[n]) for n, rows in filed.items()})
    result = found(torn, prove=False)
    assert sorted((row["sensor"], row["run"], row["done"]) for row in result.rows) == [(1, 3, MENDED), (2, 3, MENDED)]
    assert all("the rates look like the other sensor's" in row["why"] for row in result.rows)
    assert result.outliers == []


@pytest.mark.slow
def test_a_run_that_is_only_noisy_has_its_own_rates() -> None:
    """Those of the quiet sensor beside it agree better with all; but it has its own, and not these."""
    one = noisy_beside_quiet()
    assert not any(effect.id == "swap" for effect in found(one, "matrix-6", prove=False).effects)
    torn = replace(one, contradicted={(9, 1): Judgement(Verdict.FAIL, "its sign is turned")})
    rates = torn.sensors[1].rates_deg_per_hr * np.where(torn.sensors[1].conditions.run == 9, -3.0, 1.0)[:, None]
    torn = with_rates(torn, rates, 1)
    assert not any("used as measured by hil solve" in each for each in found(torn, "matrix-6", prove=False).notes)


WRONG = {
    "a sign": (lambda rates: rates * [1.0, -1.0], "the sign of RB looks turned", ["RB"]),
    "both signs": (lambda rates: -rates, "the signs look turned", ["RA", "RB"]),
    "channels": (lambda rates: rates[:, ::-1], "RA and RB look exchanged", ["RA", "RB"]),
}


@pytest.mark.parametrize(
    ("kind", "searched"),
    [
        *((kind, False) for kind in WRONG),
        *(pytest.param(kind, True, marks=pytest.mark.slow) for kind in ("both signs", "channels")),  # a sign is below
    ],
)
def test_what_is_wrong_with_a_whole_run_solve_and_the_search_say_and_mend_alike(kind: str, *, searched: bool) -> None:
    """A sign, all of them, or the channels: what was filed less what would have been is one term."""
    wrong, said, channels = WRONG[kind]
    made = hidden_campaign(3, temperatures=(-10.0, 23.0, 50.0), positions=("1", "2", "3", "4"))
    rates = made.sensors[2].rates_deg_per_hr.copy()
    here = made.sensors[2].conditions.run == 2
    rates[here] = wrong(rates[here])
    torn = replace(made, sensors={2: replace(made.sensors[2], rates_deg_per_hr=rates)})
    (quick,) = wrong_rows(torn)[2].rows
    assert (quick.run, quick.done) == (2, MENDED)
    assert said in quick.why
    if not searched:
        return
    result = found(torn, prove=False)
    (row,) = result.rows
    assert (row["run"], row["done"], row["channels"]) == (2, MENDED, channels)
    assert said in row["why"]
    assert "labels or signs in the record are wrong" in page(result)


@pytest.mark.slow
def test_signs_turned_in_many_runs_are_all_put_right() -> None:
    """Of long runs three were asked about, whatever `hil solve` named; the other turned ones were effects."""
    made = hidden_campaign(3, temperatures=(-10.0, 23.0, 50.0), positions=tuple("1342431"), runs_each=3)
    rates, run = made.sensors[2].rates_deg_per_hr.copy(), made.sensors[2].conditions.run
    turned = sorted({*run.tolist()})[1::2][:4]
    rates[np.isin(run, turned), 0] *= -1.0
    result = found(replace(made, sensors={2: replace(made.sensors[2], rates_deg_per_hr=rates)}), prove=False)
    assert {effect.id for effect in result.effects} == {"swap"}
    assert [row["run"] for row in result.rows] == swaps(result) == turned
