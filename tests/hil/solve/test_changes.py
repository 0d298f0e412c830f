"""Changes to a sweep and additions to a campaign are made of the same moves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.campaign import Conditions
from hil.model.effects.history import setpoint_step
from hil.solve.changes import (
    additions,
    with_both_directions,
    with_collect_4,
    with_every_run_twice,
    with_second_heading,
)
from tests.hil.model.effect_conditions import campaign, triad_poses

ROWS = campaign()


def added(name: str, conditions: Conditions = ROWS) -> Conditions:
    """Return the rows of the addition whose name begins so."""
    return next(one.rows for one in additions(conditions) if one.name.startswith(name))


@pytest.mark.parametrize(
    ("change", "addition"),
    [
        (with_collect_4, "Collect 4"),
        (with_second_heading, "the same positions at a heading"),
        (with_every_run_twice, "the same collects once more"),
    ],
)
def test_a_change_to_a_sweep_adds_the_rows_of_the_addition(change: object, addition: str) -> None:
    """The same positions, f and w; only how long one waits before them differs."""
    changed, rows = change(ROWS), added(addition)  # type: ignore[operator]
    further = changed.rows(np.argsort(changed.start_s, kind="stable"))
    new = further.rows(
        np.flatnonzero(further.position == "4") if addition == "Collect 4" else np.arange(len(ROWS), len(further))
    )
    assert new.position.tolist() == rows.position.tolist()
    assert new.run.tolist() == rows.run.tolist()
    np.testing.assert_allclose(new.f_g, rows.f_g, atol=1e-12)
    np.testing.assert_allclose(new.w_deg_per_hr, rows.w_deg_per_hr, atol=1e-12)


def test_collect_4_has_the_spin_axis_down_and_the_clock_goes_on() -> None:
    """It has f = (-G3, G2, -G1), one for every run, after its last collect; the power has been on longer by then."""
    rows = added("Collect 4")
    assert rows.run.tolist() == np.unique(ROWS.run).tolist()
    np.testing.assert_allclose(rows.f_g, np.tile([0.0, 0.0, -1.0], (len(rows), 1)), atol=1e-12)
    last = np.array([ROWS.start_s[ROWS.run == run].max() for run in rows.run])
    on = np.array([ROWS.columns["time_since_power_on_s"][ROWS.run == run].max() for run in rows.run])
    np.testing.assert_allclose(rows.columns["time_since_power_on_s"] - on, rows.start_s - last)


def test_a_heading_turns_what_is_level_and_leaves_what_is_vertical() -> None:
    """Gravity stays; the level earth rate keeps its size and stands across the old one."""
    rows = added("the same positions at a heading")
    vertical = np.sum(ROWS.w_deg_per_hr * ROWS.f_g, axis=1, keepdims=True) * ROWS.f_g
    before, after = ROWS.w_deg_per_hr - vertical, rows.w_deg_per_hr - vertical
    np.testing.assert_allclose(np.sum(before * after, axis=1), 0.0, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(after, axis=1), np.linalg.norm(before, axis=1))


def test_backwards_begins_with_what_was_last() -> None:
    """Runs and collects in reverse order of time, each at its own setpoint, approached from the other side."""
    sweep = swept(-20.0, 0.0, 40.0, 50.0)
    rows = added("the same collects in reverse order", sweep)
    assert np.all(np.diff(rows.start_s) > 0.0)
    assert rows.position.tolist() == sweep.position[np.argsort(-sweep.start_s)].tolist()
    assert np.all(np.diff(rows.run) >= 0)
    setpoint, slope = (rows.columns[name] for name in ("setpoint_degC", "dTdt_degC_per_min"))
    np.testing.assert_allclose(setpoint, sweep.columns["setpoint_degC"][::-1])
    assert np.all(slope[setpoint < 50.0] < 0.0)
    assert rows.start_s.min() > sweep.start_s.max()


def test_a_triad_is_turned_upside_down() -> None:
    """It has no index axis; every pose has its opposite."""
    poses = triad_poses()
    np.testing.assert_allclose(added("every pose upside down", poses).f_g, -poses.f_g)
    assert not any(one.name.startswith("Collect") for one in additions(poses))


def swept(*temperatures: float) -> Conditions:
    """Return a sweep of two runs at each temperature, of which each is approached as the order has it."""
    rows = campaign(temperatures=temperatures, runs_each=2)
    step = setpoint_step(rows, 23.0)
    left = np.exp(-rows.columns["time_since_setpoint_s"] / 1800.0) * step
    columns = {"temperature_degC": rows.columns["setpoint_degC"] - left, "dTdt_degC_per_min": left / 30.0}
    columns["case_degC"] = rows.columns["setpoint_degC"] - 0.5 * left
    return replace(rows, columns={**rows.columns, **columns})


def test_temperatures_in_reverse_order_are_reached_as_that_order_has_it() -> None:
    """What a sweep through the reversed temperatures shows; of a sweep that is its own reverse there is no other."""
    assert with_both_directions(swept(-10.0, 20.0, 50.0, 20.0, -10.0)) is None
    both = with_both_directions(swept(-20.0, 0.0, 40.0, 50.0))
    assert both is not None
    back, wanted = both.rows(np.arange(len(both) // 2, len(both))), swept(50.0, 40.0, 0.0, -20.0)
    assert np.all(np.diff(back.run) >= 0)
    away = np.arange(6, len(wanted))  # the first setpoint is the last of the sweep before
    for name in ("setpoint_degC", "temperature_degC", "case_degC", "dTdt_degC_per_min", "time_since_setpoint_s"):
        np.testing.assert_allclose(back.columns[name][away], wanted.columns[name][away], atol=1e-6)
