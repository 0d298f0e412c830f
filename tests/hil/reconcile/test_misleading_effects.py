"""What is made to mislead the search: effects that cancel, that hide in one run, that this design cannot part."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.model import load_model
from hil.model.effects.catalogue import EFFECTS
from hil.reconcile import Reconciliation, reconcile
from hil.reconcile.search.problem import pose
from tests.hil.reconcile.hidden_effects import Hidden, Rows, both, hidden_campaign

HORIZONTAL = 15.041067 * np.cos(np.deg2rad(34.6))


def found(hidden: Hidden | None, model: str = "matrix-6-thermal", seed: int = 7, **layout: object) -> Reconciliation:
    """Reconcile a night in which something is hidden."""
    thermal = model == "matrix-6-thermal"
    return reconcile(hidden_campaign(seed, hidden, thermal=thermal, **layout), model)


def ids(result: Reconciliation) -> list[str]:
    """Ids, in order of name."""
    return sorted(effect.id for effect in result.effects)


def ageing(rows: Rows, size: float = 12.0) -> np.ndarray:
    """A bias that grows over the night, by `size` deg/hr on A and as much the other way on B."""
    return both(rows.start_s / rows.start_s.max(), size, -size)


def wrong_heading(rows: Rows) -> np.ndarray:
    """The horizontal earth rate is turned by 8 degrees."""
    h, off = np.deg2rad(rows.heading), np.deg2rad(8.0)
    theta = np.deg2rad([{"1": -90.0, "2": 90.0, "3": 0.0, "4": 180.0}[p] for p in rows.position])
    level_2, level_3 = np.cos(h + off) - np.cos(h), np.sin(h + off) - np.sin(h)
    return HORIZONTAL * np.stack([level_3 * np.cos(theta), level_2], 1)


@pytest.mark.slow
def test_two_effects_that_nearly_cancel_get_no_third_name() -> None:
    """Ageing up, and a step down in the middle that takes it back: whatever is named is one of the two."""
    result = found(lambda r: ageing(r, 16.0) - both(r.run > 8, 16.0, -16.0))
    assert result.verdict != "named" or set(ids(result)) <= {"ageing", "jump"}
    assert result.verdict != "none"


@pytest.mark.slow
def test_an_effect_beside_ageing_is_found_and_so_is_the_ageing() -> None:
    """Supply and ageing at once."""
    result = found(lambda r: both(r.supply - 28.0, 16.0, -15.0) + ageing(r, 40.0))
    assert {"supply"} < set(ids(result))
    assert len(ids(result)) == 2
    others = next(effect for effect in result.effects if effect.id != "supply")
    assert "ageing" in {others.id} | {rival.id for rival in others.confusable_with}


@pytest.mark.slow
def test_what_one_position_does_in_the_cold_is_empirical() -> None:
    """No effect of the catalogue acts in one position below freezing only: it is stated, not named."""
    result = found(lambda r: both((r.position == "3") & (r.temperature < 0.0), 7.0, -6.0))
    assert result.verdict == "empirical"
    assert "position=3" in result.effects[0].id


@pytest.mark.slow
@pytest.mark.parametrize("run", [6, 11])
def test_what_one_run_does_is_no_law_of_the_unit(run: int) -> None:
    """One self-calibration off by 9 deg/hr in bias: the bearing's other state in that run alone, and no other name."""
    result = found(lambda r: both(r.run == run, 9.0, -9.0))
    for effect in result.effects:
        assert effect.id == "jump" or effect.id.startswith("empirical")
        if effect.id == "jump":
            assert (effect.shape["from_run"], effect.shape["runs_held"]) == (run, 1.0)


@pytest.mark.slow
def test_a_wrong_heading_at_one_heading_is_nobodys_to_find() -> None:
    """At a single heading an error of the earth rate is a constant bias and MU: the fitted base has it already."""
    assert found(wrong_heading).verdict == "none"


@pytest.mark.slow
def test_a_night_whose_temperature_rises_with_time_cannot_part_bias_T_from_ageing() -> None:
    """Ten degrees warmer with every run: whatever leads, the other is among its rivals and the verdict is ambiguous."""
    night = {"temperatures": tuple(np.arange(-30.0, 61.0, 6.0)), "runs_each": 1}
    result = found(lambda r: ageing(r, 40.0), "matrix-6", **night)
    assert result.verdict == "ambiguous"
    rivals = {rival.id for rival in result.effects[0].confusable_with}
    assert {"ageing", "bias_T"} <= rivals | {result.effects[0].id}


def test_what_is_turned_far_is_searched_about_the_base_as_it_is_beside_the_turn() -> None:
    """Under a phase error of 0.2 rad the fitted base is itself turned; the phase's column still is what was hidden."""
    night = hidden_campaign(7, thermal=False)
    collects = night.sensors[2]
    psi = 0.2 * (collects.conditions.columns["temperature_degC"] - 20.0) / 40.0
    turned = psi[:, None] * np.stack([-collects.rates_deg_per_hr[:, 1], collects.rates_deg_per_hr[:, 0]], 1)
    rates = collects.rates_deg_per_hr + turned
    posed = pose(
        replace(night, sensors={2: replace(collects, rates_deg_per_hr=rates)}), load_model("matrix-6"), EFFECTS
    )
    columns = next(c for c in posed.candidates if c.name == "phase").columns[..., 1]
    assert np.vdot(columns, turned) / np.linalg.norm(columns) / np.linalg.norm(turned) > 0.98
