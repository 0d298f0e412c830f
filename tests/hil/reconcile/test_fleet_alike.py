"""What a layout shows just alike in every unit no number of units tells apart."""

from __future__ import annotations

import numpy as np
import pytest

from hil.campaign import Campaign
from hil.model import load_model
from hil.model.effects.catalogue import BASE_EFFECTS, EFFECTS, VARIANCE_EFFECTS
from hil.reconcile.fleet import Asked, Screen
from hil.reconcile.search.layout import searches
from hil.reconcile.search.lookalikes import names_alike
from hil.reconcile.search.problem import pose
from tests.hil.reconcile.hidden_effects import base_rates, campaign_of, lay_out

SQUARED = ("1", "3", "2", "4")
"""With these four collects what goes with the square of fS is what goes on from collect to collect."""


def unit(seed: int, k2: float) -> Campaign:
    """Three temperatures twice; the square of fS moves RA."""
    rng = np.random.default_rng(seed)
    rows = lay_out(rng, (-20.0, 20.0, 60.0), 2, SQUARED)
    rates = base_rates(rows, thermal=False) + rng.normal(0.0, 0.9, (len(rows), 2))
    rates[:, 0] += k2 * rows.f[:, 2] ** 2
    return campaign_of(rows, rates)


@pytest.mark.slow
def test_units_that_have_k2_do_not_have_drift_for_certain() -> None:
    """Of three units that drift was 99.3 %, with no rival: how usual it is was counted once for each."""
    units = [unit(seed, 9.0 * (seed % 2)) for seed in range(5)]
    screen = Screen.of(units, "matrix-6")
    weighed = screen.weigh([screen.rates(each) for each in units])
    for found in (each for each in screen.asked.findings(weighed) if each.statistic > 3.0):
        assert {"drift", "k2"} <= {*found.names}
    shared = screen.asked.in_common(screen.asked.mixed(weighed)[None], len(units))
    assert {"drift", "k2"} <= {shared.name, *(name for name, _ in shared.rivals)}
    assert shared.few < shared.fraction


def test_where_nothing_may_be_missing_nothing_is_alike() -> None:
    """A screen of a campaign in which no effect is asked about ended in an internal error."""
    problem = pose(unit(1, 0.0), load_model("matrix-6"), ())
    assert names_alike(searches(problem, (), VARIANCE_EFFECTS[:1]).values()) == {}


def test_only_what_is_alike_in_every_block_is_alike() -> None:
    """Supply is not; nor is any name alike itself."""
    problem = pose(unit(1, 0.0), load_model("matrix-6"), (*BASE_EFFECTS, *EFFECTS))
    alike = names_alike(searches(problem, (), VARIANCE_EFFECTS[:1]).values())
    assert "k2" in alike["drift"]
    assert "drift" in alike["k2"]
    assert "supply" not in {name for others in alike.values() for name in others} | {*alike}
    assert not any(name in others for name, others in alike.items())


@pytest.mark.parametrize("units", [1, 5, 40])
def test_many_units_tell_what_looks_alike_apart_no_better_than_one(units: int) -> None:
    """How usual each is at its size parts them, which is counted once; what looks otherwise is parted by every unit."""
    asked = Asked(["drift", "k2", "supply"], np.log([0.1, 0.2, 0.1]), follows=False, alike={"drift": ["k2"]})
    by_name = np.tile(np.array([[30.0], [30.0 - np.log(4.0)], [29.5]]), units)
    shared = asked.in_common(np.stack([asked.mixed(by_name)]), units)
    assert (shared.name, shared.fraction) == ("drift", 1.0)
    rivals = dict(shared.rivals)
    assert rivals["k2"] / shared.share == pytest.approx(0.2 / 0.1 / 4.0, rel=0.02)
    assert ("supply" in rivals) == (units == 1)
