"""A value is known no better than the shape that it belongs to: its interval is that over all shapes that may be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.model.effects.dynamics import IndexSettling
from hil.reconcile import reconcile
from hil.reconcile.result import FoundEffect
from tests.hil.reconcile.hidden_effects import hidden_campaign

TRUE = {"S_A": 90.0, "S_B": -50.0}


def settling(seed: int, tau_s: float) -> FoundEffect:
    """What is found of a disturbance that dies away with `tau_s`, where collects begin 40 to 50 s after the index."""
    plain = hidden_campaign(seed, quiet=0.5)
    rows = plain.sensors[2]
    since = 40.0 + 10.0 * np.random.default_rng(seed).random(len(rows.conditions))
    conditions = replace(rows.conditions, columns={**rows.conditions.columns, "time_since_index_s": since})
    added = IndexSettling().columns(conditions, None, {"tau_s": tau_s}) @ np.array([*TRUE.values()])
    hidden = replace(rows, conditions=conditions, rates_deg_per_hr=rows.rates_deg_per_hr + added)
    found = reconcile(replace(plain, sensors={2: hidden}), "matrix-6-thermal", prove=False).effects
    return next(effect for effect in found if effect.id == "settle")


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_size_is_no_surer_than_the_time_constant(seed: int) -> None:
    """From 45 s on a fast decay of a large one is a slow decay of a small one."""
    found = settling(seed, 20.0)
    low, high = found.shape_range["tau_s"]
    assert low <= 20.0 <= high
    assert "is possible" in found.shape_in_words
    for each in found.parameters:
        assert each["low"] <= TRUE[each["name"]] <= each["high"]
        assert each["low"] < each["value"] < each["high"]
        assert each["se"] < each["high"] - each["low"]
