"""What the unit's parameters are: at temperatures of the thermometer that curves are of, in runs that are named."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from hil.campaign import Campaign
from hil.model import Model, load_model
from hil.model.effects.base import Effect
from hil.model.effects.catalogue import effect_by_id
from hil.reconcile.outcome.answer import Answer
from hil.reconcile.outcome.improve import improved
from hil.reconcile.outcome.values import before_and_after
from hil.reconcile.result import before_and_after_in_words
from hil.reconcile.rivals import Rival
from hil.reconcile.search.problem import pose
from tests.hil.analysis.thermal.nights import rotor_night

_TWO_DEGC = (10.0, 40.0)


def _values(
    night: Campaign, name: str, sizes: Sequence[float], alike: Sequence[Effect] = (), **shape: float
) -> tuple[list[dict[str, Any]], Model]:
    """Return what is said with an effect of known sizes in a shape, and the improved model."""
    problem = pose(night, load_model("matrix-6"), [effect_by_id(name)])
    term = next(c for c in problem.candidates if c.name == name and shape.items() <= dict(c.shape).items())
    terms = [(term, {k: (size, 0.1) for k, size in enumerate(sizes)})]
    model = improved(problem.model, problem.sensors, terms, [], {name: {}}, frozenset())
    return before_and_after(problem.model, model, problem.sensors, terms, frozenset(), {name: alike}), model


def test_the_temperature_is_that_of_the_curve_wherever_the_chamber_was_set() -> None:
    """BB was "-2.7 at 0.0 °C (as set)" where the unit went from 4 to 14 °C and its curve gave -20.2 at 0 °C."""
    night = rotor_night(np.random.default_rng(3), {}, temperatures_degC=(0.0, 40.0, 60.0), run_to_run={}, white=1e-6)
    rows = night.sensors[2]
    set_to = np.round(rows.conditions.columns["temperature_degC"])
    unit = set_to + np.linspace(14.0, 4.0, len(rows.conditions))
    moved = replace(rows.conditions, columns={"temperature_degC": unit, "setpoint_degC": set_to})
    bias = np.stack([1.2 * (unit - 25.0), 0.02 * (unit - 25.0) ** 2], axis=1)
    night = replace(night, sensors={2: replace(rows, conditions=moved, rates_deg_per_hr=rows.rates_deg_per_hr + bias)})
    found, model = _values(night, "bias_T", (1.2, 0.0, 0.0, 0.02))
    assert {each["name"] for each in found} == {"BA", "BB"}
    for each in found:
        where = set_to == set_to[np.argmin(abs(unit - each["temperature_degC"]))]
        assert (each["temperature_of"], each["run"]) == ("temperature_degC", None)
        assert each["temperature_degC"] == pytest.approx(unit[where].mean())
        above = each["temperature_degC"] - 25.0
        own = {"BA": 1.2 * above, "BB": 0.02 * above**2}[each["name"]]
        assert each["after"] == pytest.approx(model.sensors[2][each["name"]].at(0.0) + own, abs=1e-3)


def test_a_step_inside_a_run_is_no_other_parameter_of_that_run() -> None:
    """A bias that jumps before the last collects of a run had been another GSA, GSB and MU of it."""
    night = rotor_night(np.random.default_rng(3), {}, temperatures_degC=(20.0,), runs=4, run_to_run={}, white=1e-6)
    rows, step = night.sensors[2], effect_by_id("jump")
    others = {("GSA", None): 0.0, ("MUB", None): 0.0}
    for from_run, told in ((3.0, {("BA", 1): 0.0, ("BA", 4): 12.0}), (4.0, {("BA", None): 0.0})):
        shape = {"from_run": from_run, "from_collect": 1.0}
        jumps = step.columns(rows.conditions, None, shape) @ np.array([12.0, 0.0])
        stepped = replace(night, sensors={2: replace(rows, rates_deg_per_hr=rows.rates_deg_per_hr + jumps)})
        found, _ = _values(stepped, "jump", (12.0, 0.0), **shape)
        assert {(each["name"], each["run"]): round(each["after"], 3) + 0.0 for each in found} == {**told, **others}


def test_what_changes_little_beside_a_large_jump_is_told_too() -> None:
    """GSB had stood in no line where MU of the same unit had jumped by 60: by each effect what it changes."""
    night = rotor_night(np.random.default_rng(3), {}, temperatures_degC=(0.0, 20.0, 40.0), run_to_run={}, white=1e-6)
    problem = pose(night, load_model("matrix-6"), [effect_by_id("GS_T"), effect_by_id("MU_jump")])
    shape = {"from_run": 2.0, "runs_held": 1.0}
    jump = next(c for c in problem.candidates if c.name == "MU_jump" and shape.items() <= dict(c.shape).items())
    law = next(c for c in problem.candidates if c.name == "GS_T")
    terms = [(jump, {0: (60.0, 0.1)}), (law, {0: (0.1, 0.01)})]
    after = improved(problem.model, problem.sensors, terms, [], {"MU_jump": {}, "GS_T": {}}, frozenset())
    found = before_and_after(problem.model, after, problem.sensors, terms, frozenset(), {})
    assert {each["name"] for each in found} == {"MUA", "GSA"}


def test_what_goes_on_changing_with_time_is_said_in_the_first_and_the_last_run() -> None:
    """BA was 19.9, at a time six hours before the first of runs that rose from 24.6 to 72.8."""
    night = rotor_night(np.random.default_rng(4), {}, temperatures_degC=(25.0,), runs=9, run_to_run={}, white=1e-6)
    rows = night.sensors[2]
    aged = replace(rows.conditions, start_s=rows.conditions.start_s + 86400.0 * rows.conditions.run)
    rates = rows.rates_deg_per_hr + np.array([5.0, 0.0]) * (aged.start_s / 86400.0)[:, None]
    night = replace(night, sensors={2: replace(rows, conditions=aged, rates_deg_per_hr=rates)})
    found, _ = _values(night, "ageing", (5.0, 0.0))
    days = aged.start_s / 86400.0
    assert [(each["name"], each["run"]) for each in found] == [("BA", 1), ("BA", 9)]
    for each in found:
        assert each["after"] == pytest.approx(5.0 * days[aged.run == each["run"]].mean(), abs=0.1)
        assert each["before"] == pytest.approx(5.0 * days.mean(), abs=0.1)
    (told,) = before_and_after_in_words(found)
    assert "°C (the unit's own) in run 1, without it" in told
    assert "in run 9" in told


def test_which_of_equals_leads_does_not_decide_what_a_parameter_is_at_a_temperature() -> None:
    """BB of one night was -11.2, of another -16.2 at 10 °C and -0.2 at 40 °C: a hysteresis or a curve led by 1 %."""
    night = rotor_night(np.random.default_rng(5), {}, temperatures_degC=_TWO_DEGC, run_to_run={}, white=1e-6)
    rows = night.sensors[2]
    side = np.where(rows.conditions.columns["temperature_degC"] < 25.0, -6.0, 6.0)
    rates = rows.rates_deg_per_hr + np.stack([0.0 * side, side], axis=1)
    night = replace(night, sensors={2: replace(rows, rates_deg_per_hr=rates)})
    as_curve, _ = _values(night, "bias_T", (0.0, 0.4))
    as_loop, _ = _values(night, "hyst", (0.0, 6.0), [effect_by_id("bias_T")], from_degC=20.0, half_width_degC=5.0)
    beside, _ = _values(night, "hyst", (0.0, 6.0), from_degC=20.0, half_width_degC=5.0)
    assert [each["name"] for each in as_curve] == [each["name"] for each in as_loop] == ["BB", "BB"]
    for each, other in zip(as_curve, as_loop, strict=True):
        assert each["temperature_degC"] == other["temperature_degC"]
        assert each["after"] == pytest.approx(other["after"], abs=0.05)
    assert not [each for each in beside if each["temperature_degC"] is not None], "nothing that looks the same"


def test_what_looks_the_same_and_follows_temperature_is_asked_of_the_rivals() -> None:
    """A rival that the data tell apart is none, nor one that parameters do not follow."""
    laid = {
        k: SimpleNamespace(follows=e.follows, candidate=SimpleNamespace(effect=e))
        for k, e in enumerate(map(effect_by_id, ("hyst", "bias_T", "bias_grad", "ageing", "jump")))
    }
    rivals = [Rival(e.candidate.effect.id, 0.2, 1.0 if k < 4 else 0.5, terms={2: k}) for k, e in laid.items() if k]
    found = SimpleNamespace(names=[SimpleNamespace(terms={2: [0]}, rivals=rivals)])
    posterior = SimpleNamespace(term=lambda _, j: laid[j])
    answer = Answer(*cast(Any, (None, None, posterior, found, None, (), 0.05, False, ())))
    assert {own: [each.id for each in of] for own, of in answer.alike.items()} == {"hyst": ["bias_T", "ageing"]}
