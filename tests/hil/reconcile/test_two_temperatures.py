"""Of two temperatures nobody knows what lies between: no square of temperature is asked of them."""

from __future__ import annotations

import numpy as np
import pytest

from hil.model import load_model
from hil.model.effects.catalogue import effect_by_id
from hil.reconcile.search.problem import pose
from tests.hil.analysis.thermal.nights import rotor_night


@pytest.mark.parametrize(("temperatures_degC", "bends"), [((16.0, 51.0), False), ((16.0, 33.0, 51.0), True)])
def test_a_square_of_temperature_is_asked_of_three_temperatures(
    temperatures_degC: tuple[float, ...], *, bends: bool
) -> None:
    """The slope at 25 °C was 0.34 ± 0.87 beside a bend that two temperatures cannot hold; it is .645 ± .035."""
    night = rotor_night(np.random.default_rng(1), {}, temperatures_degC=temperatures_degC)
    problem = pose(night, load_model("matrix-6"), [effect_by_id("bias_T"), effect_by_id("GS_T")])
    followed = [each for each in problem.candidates if each.tier == 1]
    assert {each.name for each in followed} == {"bias_T", "GS_T"}
    assert any(p.unit.endswith("degC^2") for each in followed for p in each.parameters) is bends
    for each in followed:
        again = each.rebuilt(night.sensors[2].conditions, problem.sensors[2].base)
        np.testing.assert_array_equal(again, each.columns)
