"""The parts of the search: drivers as expressions, independent columns, noise that is not double counted, folds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from hil.campaign import Conditions
from hil.errors import InputError
from hil.model.effects.empirical import empirical
from hil.model.effects.followed import driver_columns, driver_reference, driver_values
from hil.reconcile.proof.held_out import by_run, in_blocks
from hil.reconcile.search.evidence import BlockEvidence
from hil.reconcile.search.scan import level, p_value
from hil.solve.identifiability import independent_columns
from hil.solve.likelihood import NoiseTable
from hil.solve.rows import Block, sensor_blocks
from hil.solve.temperatures import same_temperature
from tests.hil.reconcile.hidden_effects import hidden_campaign


def conditions() -> Conditions:
    """Rows of a small night."""
    return hidden_campaign(1, temperatures=(-20.0, 20.0)).sensors[2].conditions


def block() -> Block:
    """Channel RA of a small night with a constant bias as the base."""
    collects = hidden_campaign(1).sensors[2]
    base = np.broadcast_to(np.eye(2), (len(collects.conditions), 2, 2)).copy()
    return sensor_blocks(2, collects, collects.conditions.w_channels_deg_per_hr, base)[0]


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("supply_V", lambda c: c.columns["supply_V"] - np.median(c.columns["supply_V"])),
        ("start_s^2", lambda c: (c.start_s - np.median(c.start_s)) ** 2),
        ("temperature_degC>0.0", lambda c: c.columns["temperature_degC"] > 0.0),
        ("temperature_degC<0.0", lambda c: c.columns["temperature_degC"] <= 0.0),
        ("temperature_degC[-30.0..0]", lambda c: c.columns["temperature_degC"] <= 0.0),
        ("position=3", lambda c: c.position == "3"),
        ("run>2", lambda c: c.run > 2),
        ("position=3&temperature_degC<0.0", lambda c: (c.position == "3") & (c.columns["temperature_degC"] <= 0.0)),
    ],
)
def test_driver_expressions_mean_what_they_say(expression: str, expected: object) -> None:
    """Conditions about their median, powers, steps, ranges, positions, and products of these."""
    rows = conditions()
    assert np.allclose(driver_values(expression, rows), np.asarray(expected(rows), dtype=float))  # type: ignore[operator]


def test_a_driver_keeps_the_reference_of_the_data_it_was_fitted_to() -> None:
    """On other rows the stored reference counts, not their own median; the columns it needs are stated."""
    rows = conditions()
    assert np.allclose(driver_values("supply_V", rows, 28.0), rows.columns["supply_V"] - 28.0)
    assert driver_reference("supply_V^2", rows) == pytest.approx(np.median(rows.columns["supply_V"]))
    assert driver_reference("run>2", rows) == 0.0
    assert driver_columns("position=3&temperature_degC<0.0") == {"temperature_degC"}
    term = empirical("MUB", "temperature_degC>0.0")
    assert np.allclose(
        term.columns(rows, None, {"reference": 0.0})[:, 0, 0], rows.f_g[:, 2] * (rows.columns["temperature_degC"] > 0)
    )


@pytest.mark.parametrize("name", ["oil pressure [bar]", "=cmd", "<b>x</b>", "B-field", "Öl", "I > 2 A"])
def test_a_driver_may_be_a_condition_of_any_name(name: str) -> None:
    """A campaign may call a condition anything; alone, as a power, a step and a range."""
    rows = conditions()
    supply = rows.columns["supply_V"]
    named = replace(rows, columns={**rows.columns, name: supply})
    edge = float(np.median(supply))
    for ending in ("", "^2", f">{edge}", f"<{edge}", f"[{edge}..99.0]"):
        assert np.array_equal(driver_values(name + ending, named), driver_values("supply_V" + ending, rows))
        assert driver_reference(name + ending, named) == driver_reference("supply_V" + ending, rows)
        assert driver_columns(f"position=3&{name}{ending}") == {name}


@pytest.mark.parametrize("expression", ["no_such_column", "supply_V + 1", "supply_V**2", "position"])
def test_a_driver_that_is_no_expression_is_refused(expression: str) -> None:
    """One sentence that names the driver."""
    with pytest.raises(InputError, match="driver"):
        driver_values(expression, conditions())


def test_combinations_of_earlier_columns_are_left_out() -> None:
    """The first of dependent columns stays; a column of zeros goes."""
    a, b = np.arange(5.0), np.ones(5)
    kept = independent_columns(np.column_stack([a, b, 2.0 * a - b, np.zeros(5), a**2]))
    assert np.allclose(kept, np.column_stack([a, b, a**2]))


def at(temperature: list[float], setpoint: list[float] | None = None) -> Conditions:
    """Rows at these temperatures, of which the setpoints may be known."""
    rows = conditions().rows(np.arange(len(temperature)))
    columns = {"temperature_degC": np.array(temperature)}
    return replace(rows, columns=columns | ({} if setpoint is None else {"setpoint_degC": np.array(setpoint)}))


def test_setpoints_are_found_in_the_temperatures() -> None:
    """Gaps of more than 4 degC part setpoints; the coldest is number 0, an empty cell belongs to none."""
    assert same_temperature(at([20.1, -19.0, 19.5, np.nan, -20.0, 60.0])).tolist() == [1, 0, 1, -1, 0, 2]
    assert same_temperature(replace(at([1.0, 2.0, 3.0]), columns={})).tolist() == [0, 0, 0]


def test_known_setpoints_part_what_temperatures_cannot_unless_the_unit_did_not_follow_them() -> None:
    """A unit that has not settled is still at its setpoint; a setpoint that the unit left altogether says nothing."""
    assert same_temperature(at([17.0, 19.5, 22.0, 23.0], [20.0, 20.0, 23.0, 23.0])).tolist() == [0, 0, 1, 1]
    assert same_temperature(at([-20.0, 0.0, 20.0, 40.0], [25.0, 25.0, 25.0, 25.0])).tolist() == [0, 1, 2, 3]


def test_evidence_grows_with_the_effect_and_not_with_the_scale_of_the_column() -> None:
    """Adding the effect raises its Bayes factor; multiplying its column by a thousand changes nothing."""
    own = block()
    column = np.cos(np.arange(len(own.y)))[:, None]
    table = NoiseTable.of(own)
    evidence = BlockEvidence(own, table, [column, 1000.0 * column, np.random.default_rng(0).normal(size=column.shape)])
    quiet = np.random.default_rng(1).normal(size=len(own.y))
    y = np.column_stack([quiet, quiet + 3.0 * column[:, 0]])
    factors = evidence.log_factors(y)
    assert factors[0, 1] > factors[0, 0] + 10.0
    assert np.allclose(factors[0], factors[1], atol=1e-6)
    assert factors[2, 1] < 2.0


def test_folds_hold_every_row_out_once() -> None:
    """By run and by contiguous block, over all blocks."""
    own = block()
    for folds in (by_run([own], [own.run]), in_blocks([own], [own.run])):
        assert np.all(np.sum([fold[0] for fold in folds], axis=0) == 1)
    assert len(by_run([own], [own.run])) == len(np.unique(own.run))


def test_the_level_is_exceeded_at_the_stated_rate_and_the_p_value_agrees_with_it() -> None:
    """For an exponential null alpha is met, also far out where draws are few, and p at the level is alpha."""
    null = np.sort(stats.expon.rvs(size=4000, random_state=1))
    for alpha in (0.05, 0.01):
        threshold = level(null, alpha)
        assert stats.expon.sf(threshold) == pytest.approx(alpha, rel=0.15)
        assert p_value(null, threshold) == pytest.approx(alpha, rel=0.05)
    assert p_value(null, -1.0) == pytest.approx(1.0)
