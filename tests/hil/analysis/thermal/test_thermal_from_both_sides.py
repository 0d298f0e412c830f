"""Each temperature gone to once on the way up and once on the way down: the two are what tells noise."""

from __future__ import annotations

import numpy as np
import pytest

from hil.analysis.thermal.fit import fit_thermal
from tests.hil.reconcile.hidden_effects import base_rates, campaign_of, lay_out


@pytest.mark.parametrize("seed", range(3))
def test_a_law_of_many_standard_errors_is_not_taken_for_noise(seed: int) -> None:
    """What a constant leaves was the noise that judged it: BB went from -9 to 26 deg/hr at p = .17."""
    rng = np.random.default_rng(seed)
    rows = lay_out(rng, (0.0, 30.0, 50.0, 30.0, 0.0), 1)
    rows.temperature = rows.setpoint
    rates = base_rates(rows, thermal=False) + rng.normal(0.0, 0.9, (len(rows), 2))
    rates[:, 1] += 0.7 * rows.temperature
    found = fit_thermal(campaign_of(rows, rates)).of(2)
    assert found.parameters["BB"].form == "linear"
    assert found.parameters["BB"].p_value < 0.05
    assert found.parameters["BB"].repeats == 2
    half = found.parameters["BB"].hysteresis
    assert half is not None
    assert half.se[0] < 2.0
    assert found.parameters["GSA"].finding == "constant"
    assert not any("measured twice" in note for note in found.notes)
