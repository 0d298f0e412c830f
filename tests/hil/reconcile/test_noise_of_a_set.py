"""The noise is looked at beside the sets that are found: what one more term would explain, it is not taken for."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from hil.campaign import Campaign
from hil.reconcile import reconcile
from hil.reconcile.outcome.scatter import _sets_with
from hil.reconcile.search.posterior import Found, Posterior
from tests.hil.reconcile.hidden_effects import base_rates, campaign_of, lay_out

FROM_RUN = 19


def life(seed: int, jump_deg_per_hr: float = 15.0) -> Campaign:
    """Return six nights, half a year apart, of a unit whose values follow temperature, MU scatters, and a bias jumps.

    The model has none of it, so that without all of it the jump looks like one step of a walk from night to night.
    """
    rng = np.random.default_rng(seed)
    rows = lay_out(rng, (0.0, 40.0) * 6, 3)
    night = (rows.run - 1) // 6
    rows = replace(rows, start_s=rows.start_s + 1.5e7 * night)
    bias, mu = rng.normal(0.0, 1.5, (37, 2))[rows.run], rng.normal(0.0, 4.0, (37, 2))[rows.run]
    rates = base_rates(rows) + bias + mu * rows.f[:, 2:] + rng.normal(0.0, 0.9, (len(rows), 2))
    rates[rows.run >= FROM_RUN, 0] += jump_deg_per_hr
    return campaign_of(rows, rates)


@pytest.mark.slow
def test_a_jump_is_told_from_a_walk_beside_all_else_that_is_missing() -> None:
    """Beside three laws of temperature a quiet noise without a walk is probable; beside the base alone none is."""
    found = {each.id: each for each in reconcile(life(5), "matrix-6", prove=False).effects}
    assert found["jump"].probability > 0.9
    assert found["jump"].shape["from_run"] == FROM_RUN
    assert not {"rrw", "turnon", "markov"} & found.keys()


@pytest.mark.slow
def test_a_jump_in_a_life_is_found_whatever_the_noise() -> None:
    """Of another life too the jump has its name, and of the same without one it has not."""
    named, without = (
        {each.id for each in reconcile(life(1, size), "matrix-6", prove=False).effects} for size in (15.0, 0.0)
    )
    assert "jump" in named
    assert "jump" not in without


@pytest.mark.slow
def test_what_probably_follows_temperature_is_no_part_of_what_changes_from_run_to_run() -> None:
    """MU follows temperature at 87 %, which calls nothing missing: all of that had been in the size of `MU_rr`, 6.4."""
    rng = np.random.default_rng(1)
    rows = lay_out(rng, (-20.0, 0.0, 20.0, 40.0), 2)
    mu = 0.25 * np.outer(rows.temperature - 10.0, [1.0, -1.0]) + rng.normal(0.0, 3.5, (9, 2))[rows.run]
    rates = base_rates(rows, thermal=False) + mu * rows.f[:, 2:] + rng.normal(0.0, 0.9, (len(rows), 2))
    result = reconcile(campaign_of(rows, rates), "matrix-6", prove=False)
    assert [each.id for each in result.effects] == ["MU_rr"]
    (size,) = result.effects[0].parameters
    assert size["value"] == pytest.approx(3.5, abs=size["se"])


def test_a_size_is_over_all_sets_that_are_likely_by_how_probable_they_are() -> None:
    """Those of the same names count together; those without the effect, or a tenth as probable, do not at all."""
    found = [
        Found({2: (k,)}, frozenset(scatter), float(np.log(share)))
        for k, (scatter, share) in enumerate(
            [(["MU_rr"], 0.4), (["MU_rr"], 0.3), ([], 0.2), (["MU_rr"], 0.05), (["MU_rr"], 0.04)]
        )
    ]
    names = [frozenset(each.split()) for each in ("MU_real", "", "", "MU_real", "k2")]
    asked = SimpleNamespace(sets=found, names=lambda one: names[one.terms[2][0]])
    shares = {one.terms[2]: share for one, share in _sets_with(cast(Posterior, asked), "MU_rr")}
    assert shares == pytest.approx({(0,): 0.6, (1,): 0.4})


@pytest.mark.slow
def test_a_quiet_channel_stays_quiet_beside_a_loud_one() -> None:
    """Rows of both are weighed together where a model has terms: the usual error of both was the quiet one's, too."""
    rng = np.random.default_rng(1)
    rows = lay_out(rng, (-20.0, 0.0, 20.0, 45.0), 3)
    errors = np.tile([0.3, 3.0], (len(rows), 1))
    filed = campaign_of(rows, base_rates(rows) + errors * rng.normal(size=errors.shape)).sensors[2]
    one = Campaign("unlike", "test, simulated", {2: replace(filed, rates_se_deg_per_hr=errors)}, simulated=True)
    first = reconcile(one, "matrix-6", prove=False)
    assert first.model_after is not None
    for result in (first, reconcile(one, first.model_after, prove=False)):
        assert [each["observed_deg_per_hr"] for each in result.noise] == pytest.approx([0.3, 3.0], rel=0.1)
