"""MU that is another at each visit to a temperature, and the same in its runs: not another in each run."""

from __future__ import annotations

import numpy as np
import pytest

from hil.reconcile import reconcile
from hil.reconcile.outcome.sentences import summary
from tests.hil.reconcile.hidden_effects import base_rates, campaign_of, lay_out, noise

BY_VISIT = np.array([4.0, 0.0, -5.0, 6.0, 2.0, -6.0])
BY_RUN = np.array([4.0, -1.0, 0.0, 5.0, -5.0, 2.0, 6.0, -4.0, 2.0, -3.0, -6.0, 1.0])


@pytest.mark.slow
@pytest.mark.parametrize("of_visit", [1.0, 0.0], ids=["visit", "run"])
def test_it_is_told_whose_mu_is_another(of_visit: float) -> None:
    """Six visits of two runs, to two temperatures in turn; the written model scatters by what was found."""
    rows = lay_out(np.random.default_rng(3), (-10.0, 40.0) * 3, 2)
    mu = BY_VISIT[(rows.run - 1) // 2] if of_visit else BY_RUN[rows.run - 1]
    rates = base_rates(rows, thermal=False) + noise(rows, np.random.default_rng(4), run_bias=0.0)
    rates[:, 1] -= mu * rows.f[:, 2]
    result = reconcile(campaign_of(rows, rates), "matrix-6", prove=False)
    (found,) = result.effects
    assert (found.id, found.kind, found.shapes[2].values) == ("MU_rr", "named", {"of_visit": of_visit})
    assert ("the same in all runs of a visit" in " ".join(summary(result))) == bool(of_visit)
    assert result.model_after is not None
    (written,) = result.model_after.noise[2].scatter
    assert written.shape == {"of_visit": of_visit}
    assert (written.channels, found.parameters[0]["channels"]) == (("RB",), ("RB",))
    (part,) = result.model_after.stated_scatter(campaign_of(rows, rates).sensors[2].conditions)
    assert (np.abs(part.columns).max(axis=(0, 2)) > 0.0).tolist() == [False, True]  # MUA alone scatters, not MUB
