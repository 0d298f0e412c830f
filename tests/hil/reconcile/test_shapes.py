"""A value is known no better than the shape that it belongs to: its interval is that over all shapes that may be."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.blind.cases import Design, make_case, write_case
from hil.campaign.reader import read_campaign
from hil.campaign.stand_ins import OWN
from hil.model.effects.dynamics import IndexSettling
from hil.model.effects.empirical import EmpiricalTerm
from hil.model.effects.followed import driver_reference
from hil.model.effects.g_squared import SquaredAcceleration
from hil.reconcile import reconcile
from hil.reconcile.outcome.sentences import errors_in_words, summary
from hil.reconcile.result import FoundEffect, Shape
from hil.reconcile.search.candidates import drivers, second_tier
from tests.hil.reconcile.hidden_effects import both, hidden_campaign

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


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_size_is_no_surer_than_the_time_constant(seed: int) -> None:
    """From 45 s on a fast decay of a large one is a slow decay of a small one."""
    found = settling(seed, 20.0)
    low, high = found.shapes[2].may_be["tau_s"]
    assert low <= 20.0 <= high
    assert "is possible" in found.shape_in_words
    for each in found.parameters:
        assert each["low"] <= TRUE[each["name"]] <= each["high"]
        assert each["low"] < each["value"] < each["high"]
        assert each["se"] < each["high"] - each["low"]


@pytest.mark.slow
def test_what_positions_cannot_part_is_no_surer_than_what_is_typical() -> None:
    """Of kAA and kSS four positions tell the difference, of kAS nothing: what is sure is no value of the six."""
    true = {"kAA_A": 1.0, "kAA_B": 0.5, "kSS_A": -0.4, "kSS_B": -1.0, "kAS_A": -0.6, "kAS_B": 0.3}
    plain = hidden_campaign(1, quiet=0.2, positions=tuple("1342431"))
    rows = plain.sensors[2]
    added = SquaredAcceleration().columns(rows.conditions, None, {}) @ np.array([*true.values()])
    hidden = replace(rows, rates_deg_per_hr=rows.rates_deg_per_hr + added)
    result = reconcile(replace(plain, sensors={2: hidden}), "matrix-6-thermal", prove=False)
    (found,) = (effect for effect in result.effects if effect.id == "k2")
    for each in found.parameters:
        assert each["low"] <= true[each["name"]] <= each["high"]
        assert 0.05 < each["se"] < 2.0  # deg/hr/g²: the largest that is typical is 1, and a larger one is no wonder
    (term,) = result.model_after.terms
    assert {curve.se < 0.05 for name, curve in term.parameters.items() if "AS" not in name} == {True}  # type: ignore[operator]


def test_an_acceleration_drives_no_coefficient() -> None:
    """It shows the pose: g along X that follows it is a product of accelerations, which the catalogue describes."""
    rows = hidden_campaign(1).sensors[2].conditions
    shown = {f"accelerometer_{axis}_g": rows.f_g[:, k] for k, axis in enumerate(rows.sensor.axes)}
    known = [driver.name for driver in drivers(replace(rows, columns={**rows.columns, **shown}))]
    assert known == [driver.name for driver in drivers(rows)]
    assert "supply_V" in known


def test_a_term_without_a_name_changes_the_base_parameters_that_it_says() -> None:
    """In its channel each column is that of the base parameter times the driver, but for the sign."""
    rows = hidden_campaign(1).sensors[2].conditions
    changed = set()
    for candidate in second_tier(2, rows):
        order = len(candidate.parameters) // len(candidate.changes)
        for channel, name in enumerate(candidate.changes) if order == 1 else ():
            changed.add(name)
            about = {"reference": driver_reference(candidate.driver, rows)}
            own = EmpiricalTerm(name, candidate.driver).columns(rows, None, about)[:, channel, 0]
            assert np.abs(candidate.columns[:, channel, channel]) == pytest.approx(np.abs(own), abs=1e-9)
            assert candidate.parameters[channel].name == f"{name} × {candidate.driver}"
    assert changed == {"BA", "BB", "GSA", "GSB", "MUA", "MUB"}


@pytest.mark.slow
def test_each_sensor_has_a_shape_of_its_own() -> None:
    """One name, two steps at different times: what is said is where each is, and so it is written."""
    short = {"temperatures": (-10.0, 23.0, 50.0), "runs_each": 3, "quiet": 0.5}
    first = hidden_campaign(42, lambda r: both(r.run >= 8, 25.0, 20.0), **short).sensors[2]
    night = hidden_campaign(41, lambda r: both(r.run >= 5, 25.0, -22.0), **short)
    first = replace(first, conditions=replace(first.conditions, sensor=replace(first.conditions.sensor, number=1)))
    result = reconcile(replace(night, sensors={1: first, 2: night.sensors[2]}), "matrix-6-thermal", prove=False)
    (found,) = result.effects
    assert found.shape_in_words == "from run 8 on (sensor 1) and from run 5 on (sensor 2)"
    assert f", {found.shape_in_words}," in " ".join(summary(result))
    starts = {number: shape["from_run"] for number, shape in found.document()["shape_of_sensor"].items()}
    written = {str(term.sensor): term.shape["from_run"] for term in result.model_after.terms}
    assert starts == {"1": 8, "2": 5} == written


@pytest.mark.slow
def test_what_turns_or_delays_the_base_is_measured_by_the_base_that_is_beside_it(tmp_path: Path) -> None:
    """Of a base that was fitted without a late thermometer slopes are flatter, and the lag by so much longer."""
    case = make_case(7003, ("T_lag",), d=15.0, design=Design(positions=("1", "3", "4", "2")))
    late_min = float(np.nanmedian(case.signals[0] / (case.truth.slope * case.night.rotor_slope[:, None])))
    result = reconcile(read_campaign(write_case(case, tmp_path / "c")), "matrix-6-thermal", prove=False)
    (lag,) = (each for effect in result.effects if effect.id == "T_lag" for each in effect.parameters)
    assert abs(lag["value"] - late_min) < 2.0 * lag["se"]


@pytest.mark.slow
def test_a_step_has_the_temperatures_of_the_runs_in_which_it_is() -> None:
    """Of the collects before it nothing is known of it; and whose ± a shape is in that is not settled is said."""
    plain = hidden_campaign(7, lambda rows: both(rows.run > 7, 12.0, -11.0))
    result = reconcile(plain, "matrix-6-thermal", prove=False)
    (jump,) = (effect for effect in result.effects if effect.id == "jump")
    rows = plain.sensors[2].conditions
    own = rows.columns[OWN][rows.run > 7]
    assert {each["at"] for each in jump.parameters} == {f"{own.min():.1f} to {own.max():.1f} degC (the unit's own)"}
    settled, open_ = (replace(jump, shapes={2: Shape({"run": 8.0}, may_be)}) for may_be in ({}, {"run": [8, 9]}))
    assert errors_in_words(replace(result, effects=[settled])) == "every ± is one standard error"
    assert "of a parameter over all shapes" in errors_in_words(replace(result, effects=[open_]))


@pytest.mark.slow
@pytest.mark.parametrize(("tau_min", "ends"), [(30.0, 0), (200.0, 1)])
def test_a_time_constant_at_the_end_of_what_was_tried_is_said_to_be_that(tau_min: float, ends: int) -> None:
    """A warm-up slower than any was stated as 114 to 128 min, and its size by several times its error too small."""
    night = hidden_campaign(3, lambda rows: both(np.exp(-rows.start_s / (60.0 * tau_min)), 60.0, -45.0), runs_each=3)
    result = reconcile(night, "matrix-6-thermal", prove=False)
    assert result.effects[0].id == "warmup"
    last = "warmup, sensor 2: time constant 128 min is the last that was tried: what lies beyond it is in no ±"
    assert [note for note in result.notes if "that was tried" in note] == [last] * ends
