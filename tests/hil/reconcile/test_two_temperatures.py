"""Of two temperatures nobody knows what lies between: no square of temperature is asked of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from hil.campaign import Conditions, FloatArray
from hil.design.visibility.map import visibility
from hil.model import built_in_model, load_model
from hil.model.effects.base import Base, Parameter
from hil.model.effects.catalogue import EFFECTS, effect_by_id
from hil.model.effects.columns import above_reference, per_channel
from hil.model.effects.thermal import BiasTemperature
from hil.reconcile import reconcile
from hil.reconcile.proof.experiment import separation
from hil.reconcile.search.layout import coarse
from hil.reconcile.search.problem import pose
from tests.hil.analysis.thermal.nights import rotor_night
from tests.hil.reconcile.hidden_effects import hidden_campaign


@pytest.mark.parametrize(("temperatures_degC", "bends"), [((16.0, 51.0), False), ((16.0, 33.0, 51.0), True)])
def test_a_square_of_temperature_is_asked_where_temperatures_tell_it_from_a_line(
    temperatures_degC: tuple[float, ...], *, bends: bool
) -> None:
    """The slope at 25 °C was 0.34 ± 0.87 beside a bend that two temperatures cannot hold; it is .645 ± .035."""
    night = rotor_night(np.random.default_rng(1), {}, temperatures_degC=temperatures_degC)
    problem = pose(night, load_model("matrix-6"), [effect_by_id("bias_T"), effect_by_id("GS_T")])
    followed = [each for each in problem.candidates if each.tier == 1]
    assert {each.name for each in followed} == {"bias_T", "GS_T"}
    assert any(p.power == 2 for each in followed for p in each.parameters) is bends
    for each in followed:
        again = each.rebuilt(night.sensors[2].conditions, problem.sensors[2].base)
        np.testing.assert_array_equal(again, each.columns)


@pytest.mark.parametrize(("temperatures_degC", "told"), [((16.0, 51.0), 1), ((16.0, 33.0, 51.0), 2)])
def test_before_a_night_no_more_of_a_curve_is_promised_than_is_asked_about_after_it(
    temperatures_degC: tuple[float, ...], told: int
) -> None:
    """It was said from which b2 on a bend would show that two temperatures cannot hold."""
    night = rotor_night(np.random.default_rng(1), {}, temperatures_degC=temperatures_degC)
    sights = visibility(night.sensors[2].conditions, built_in_model("matrix-6"))
    for effect in (effect_by_id("bias_T"), effect_by_id("GS_T")):
        sight = sights.sight(effect.id)
        assert sight is not None
        shown = [each.parameter for each in sight.smallest]
        (asked, *_) = pose(night, built_in_model("matrix-6"), [effect]).candidates
        assert (shown, {each.power for each in shown}) == ([*asked.parameters], {*range(1, told + 1)})


class _InKelvin(BiasTemperature):
    """The same in another spelling, to the third order."""

    parameters = tuple(
        Parameter(f"b{k}", f"deg/hr/K**{k}", (0.2 * 50.0**-k, 2.0 * 50.0**-k), power=k) for k in (1, 2, 3)
    )

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        powers = above_reference(conditions)[:, None] ** np.arange(1, 4)
        return per_channel(powers, conditions.sensor)


@pytest.mark.parametrize("temperatures", [2, 3, 4])
def test_the_power_of_temperature_is_declared_and_no_spelling_of_a_unit(temperatures: int) -> None:
    """One temperature more tells one power more."""
    degC = (12.0, 30.0, 41.0, 55.0)[:temperatures]
    night = rotor_night(np.random.default_rng(1), {}, temperatures_degC=degC)
    (curve,) = [c for c in pose(night, load_model("matrix-6"), [_InKelvin()]).candidates if c.tier == 1]
    assert {each.power for each in curve.parameters} == {*range(1, temperatures)}


def test_two_setpoints_tell_a_bend_where_the_unit_was_at_more_temperatures() -> None:
    """As where soaks were cut short."""
    night = rotor_night(np.random.default_rng(1), {}, temperatures_degC=(12.0, 20.0, 47.0, 55.0))
    setpoint = np.where(night.sensors[2].conditions.columns["temperature_degC"] < 30.0, 16.0, 51.0)
    moved = replace(
        night.sensors[2].conditions, columns=dict(night.sensors[2].conditions.columns, setpoint_degC=setpoint)
    )
    night = replace(night, sensors={2: replace(night.sensors[2], conditions=moved)})
    (curve,) = [c for c in pose(night, load_model("matrix-6"), [effect_by_id("bias_T")]).candidates if c.tier == 1]
    assert [each.name for each in curve.parameters] == ["b1_A", "b1_B", "b2_A", "b2_B"]


def test_an_experiment_has_no_more_of_a_curve_than_two_temperatures_told() -> None:
    """Its columns on further rows are those of the parameters that were asked about."""
    night = rotor_night(np.random.default_rng(1), {}, temperatures_degC=(16.0, 51.0))
    problem = pose(night, load_model("matrix-6"), [effect_by_id("bias_T"), effect_by_id("hyst")])
    rival = next(each for each in problem.candidates if each.name == "hyst")
    for curve in (each for each in problem.candidates if each.name == "bias_T"):
        found = separation((curve, np.full(len(curve.parameters), 0.5)), rival, problem.sensors[2], None, 1.0)
        assert found is not None
        assert found[1] < 5.0, "both are a step of 17.5 deg/hr here"


_LINES = {
    "BA": (15.0, -0.2),
    "BB": (5.0, 0.7),
    "GSA": (59.0, 0.25),
    "GSB": (-24.0, -0.1),
    "MUA": (6.0, 0.22),
    "MUB": (-4.0, 0.12),
}
"""Every parameter of a unit at 20 °C, deg/hr (at 1 g), and what it does with temperature, by °C."""


@pytest.mark.slow
def test_where_all_parameters_follow_two_temperatures_nothing_else_is_named() -> None:
    """A scale factor and a step, each at 100 %, left 16 deg/hr: sets that fit badly had seemed probable."""
    curves = {name: lambda degC, of=of: of[0] + of[1] * (degC - 20.0) for name, of in _LINES.items()}
    how = {"temperatures_degC": (-20.0, 45.0), "run_to_run": {}, "white": 0.9, "positions": ("1", "2", "3", "1")}
    result = reconcile(rotor_night(np.random.default_rng(1), curves, **how), "matrix-6")
    assert result.calibrated or {each.id for each in result.effects} == {"bias_T", "GS_T", "MU_real"}
    assert result.gap.after < 1.5 * result.gap.noise_floor
    assert all(channel["run_offset_deg_per_hr"] < 1.0 for channel in result.noise)


def test_beside_values_at_each_temperature_no_law_of_it_is_asked_about() -> None:
    """The unit was a little off each mean, so that a line was not quite those values: one night in two had laws named.

    What acts inside a temperature is asked about as before.
    """
    night = hidden_campaign(4, positions=("1", "2", "3"))
    problem = pose(night, load_model("matrix-6"), EFFECTS)
    stand = coarse(problem, (), ())
    follow = coarse(problem, (), (), stand)
    asked, then = ({term.name for term in found[2].terms if term.tier == 1} for found in (stand, follow))
    assert asked - then == {"bias_T", "GS_T", "MU_real", "k2", "scale", "phase", "ageing"}
    assert {"jump", "MU_jump", "supply", "bias_Tdot", "hyst"} <= then
