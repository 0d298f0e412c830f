"""How sure reconcile is of the values that it finds, against units whose truth is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.campaign import Campaign
from hil.reconcile import reconcile
from tests.hil.solve.runs_of_a_unit import campaign

SLOPES = {"b1_A": 0.5, "b1_B": 0.3}


def cut_short(seed: int, scatter: float = 2.0) -> Campaign:
    """Return two runs at each of two setpoints, each at its own temperature, whose biases differ from run to run."""
    one, rng = campaign(4, 2, seed, scatter=0.0), np.random.default_rng(200 + seed)
    rows = one.sensors[2]
    away, own = rng.uniform(-6.0, 6.0, 4).repeat(3), rng.normal(0.0, scatter, (4, 2)).repeat(3, axis=0)
    columns = rows.conditions.columns | {"temperature_degC": rows.conditions.columns["temperature_degC"] + away}
    rates = rows.rates_deg_per_hr + np.outer(away, [*SLOPES.values()]) + own
    conditions = replace(rows.conditions, columns=columns)
    return replace(one, sensors={2: replace(rows, conditions=conditions, rates_deg_per_hr=rates)})


def slopes(seed: int) -> list[tuple[float, bool]]:
    """Return by how many of its errors each slope of the bias is off, and whether its interval holds the unit's."""
    found = [each for each in reconcile(cut_short(seed), "matrix-6", prove=False).effects if each.id == "bias_T"]
    told = [(each, SLOPES[each["name"]]) for of in found for each in of.parameters if each["name"] in SLOPES]
    return [((each["value"] - truth) / each["se"], each["low"] <= truth <= each["high"]) for each, truth in told]


@pytest.mark.slow
def test_a_slope_says_over_which_temperatures_it_was_measured() -> None:
    """And about which it is one; that of the middle alone tells nothing of where it holds."""
    one = campaign(12, 3, seed=1, scatter=2.0)
    (found,) = [each for each in reconcile(one, "matrix-6", prove=False).effects if each.id == "bias_T"]
    assert {each["at"] for each in found.parameters} == {"-12.0 to 48.0 degC, about 18 degC (the unit's own)"}


@pytest.mark.slow
def test_errors_of_few_runs_that_scatter_are_about_as_large_as_stated() -> None:
    """Of a slope that a search has found, for which it has to be large: by the likeliest noise they were 2.5 times.

    Of fourteen units these are found to follow temperature. By a noise in which four runs do not scatter, slopes of the
    last but one were 6 times their errors off.
    """
    told = {seed: slopes(seed) for seed in (1, 5, 6, 7, 9, 10)}
    off, inside = zip(*(each for of in told.values() for each in of), strict=True)
    assert len(off) > 9
    assert np.sqrt(np.mean(np.square(off))) < 1.9
    assert np.mean(inside) > 0.9
    assert all(abs(each) < 3.0 and holds for each, holds in told[9])
    assert len(told[9]) == 2
