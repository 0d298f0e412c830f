"""The search knows no effect by heart: what it is given it finds, from the catalogue or from elsewhere."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import hil.reconcile
from hil.campaign import Campaign, Collects, Conditions, FloatArray
from hil.model import load_model
from hil.model.effects.base import Base, Effect, Parameter, VarianceEffect
from hil.model.effects.catalogue import effect_by_id, entries, variance_effect_by_id
from hil.model.effects.columns import per_channel
from hil.model.effects.scatter import Scatter
from hil.reconcile import Reconciliation, reconcile, write_result
from tests.hil.reconcile.hidden_effects import Rows, base_rates, campaign_of, hidden_campaign, lay_out, noise

SIX = {"temperatures": (-25.0, -5.0, 10.0, 25.0, 40.0, 55.0), "runs_each": 2}
MOST_LINES = 300


class Humidity(Effect):
    """Bias that follows the relative humidity around the unit."""

    id = "humidity"
    family = "environment"
    title = "Humidity sensitivity"
    equation = "B += K_h (RH - 50 %)"
    per_channel = True
    parameters = (Parameter("K_h", "deg/hr/%", (0.03, 0.6)),)
    needs = frozenset({"humidity_percent"})
    follows = "humidity_percent"
    confusable_with = ("bias_T",)
    experiment = "Purge with dry nitrogen at constant temperature."

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        """Return the humidity less 50 % for each channel."""
        return per_channel(conditions.columns["humidity_percent"] - 50.0, conditions.sensor)


class Reseating(VarianceEffect):
    """GS differs from run to run: the unit is taken out and put back."""

    id = "reseating"
    family = "setup"
    title = "GS from run to run"
    equation = "RA += GS_r fA"
    parameters = (Parameter("s_gs", "deg/hr/g", (0.5, 10.0)),)
    follows = "run"

    def scatter(self, conditions: Conditions, shape: Mapping[str, float]) -> tuple[Scatter, ...]:
        """One coefficient for each run and channel."""
        return (Scatter(per_channel(conditions.f_g[:, 0], conditions.sensor), group=conditions.run),)


def scattered(along: int, size: float, seed: int = 3) -> Campaign:
    """A night in which the sensitivity along an axis differs from run to run by `size` deg/hr/g."""
    rng = np.random.default_rng(seed)
    rows = lay_out(rng, **SIX)  # type: ignore[arg-type]
    values = size * rng.normal(size=(rows.run.max() + 1, 2))[rows.run]
    return campaign_of(rows, base_rates(rows) + noise(rows, rng) + values * rows.f[:, along : along + 1])


@pytest.mark.slow
def test_an_effect_from_outside_the_package_is_found_by_its_name() -> None:
    """A class and a place in the catalogue that is given: name, sizes, what it follows, and its column."""
    humidity = 50.0 + 15.0 * np.random.default_rng(9).normal(size=13)

    def damp(rows: Rows) -> np.ndarray:
        return np.outer(humidity[rows.run] - 50.0, [0.3, -0.25])

    plain = hidden_campaign(7, damp, **SIX)
    collects = plain.sensors[2]
    known = collects.conditions
    columns = {**known.columns, "humidity_percent": humidity[known.run]}
    own = Collects(replace(known, columns=columns), collects.rates_deg_per_hr, collects.rates_se_deg_per_hr)
    catalogue = (Humidity(), effect_by_id("supply"), effect_by_id("jump"), effect_by_id("ageing"))
    result = reconcile(replace(plain, sensors={2: own}), "matrix-6-thermal", catalogue=catalogue)
    assert [(effect.id, effect.kind) for effect in result.effects] == [("humidity", "named")]
    values = {p["name"]: p["value"] for p in result.effects[0].parameters}
    assert values == {"K_h_A": pytest.approx(0.3, abs=0.06), "K_h_B": pytest.approx(-0.25, abs=0.06)}
    assert result.follows[0][0] == "humidity_percent"
    assert result.gap.after < 0.6 * result.gap.before


@pytest.mark.slow
def test_an_effect_on_the_scatter_from_outside_the_package_is_found_by_its_name() -> None:
    """A class with one parameter and `scatter`; that of the catalogue beside it is not taken for it."""
    kinds = (Reseating(), variance_effect_by_id("MU_rr"))
    result = reconcile(scattered(0, 6.0), "matrix-6-thermal", catalogue=(), scattering=kinds)
    assert [(e.id, e.kind, e.acts_on) for e in result.effects] == [("reseating", "named", "scatter")]
    (size,) = result.effects[0].parameters
    assert size["value"] == pytest.approx(6.0, rel=0.4)
    assert 0.2 < size["se"] < 2.0


@pytest.fixture(scope="module")
def restless() -> tuple[Campaign, Reconciliation]:
    """A night in which MU differs from run to run, and what is said of it."""
    campaign = scattered(2, 5.0)
    return campaign, reconcile(campaign, "matrix-6-thermal")


@pytest.mark.slow
def test_mass_unbalance_from_run_to_run_is_an_effect_on_the_scatter(restless: tuple[Campaign, Reconciliation]) -> None:
    """By name, with its size; no name on the mean, and averages are predicted as far as they can be."""
    _, result = restless
    assert result.verdict == "named"
    assert [(e.id, e.acts_on) for e in result.effects] == [("MU_rr", "scatter")]
    assert {each.where["of"] for each in result.disagreements} == {"scatter"}
    (size,) = result.effects[0].parameters
    assert size["value"] == pytest.approx(5.0, rel=0.4)
    assert 0.2 < size["se"] < 2.0
    assert {entry["id"] for channel in result.noise for entry in channel["scatter"]} == {"MU_rr"}
    assert result.gap.log_score is not None
    assert result.gap.log_score["after"] > result.gap.log_score["before"] + 0.1


@pytest.mark.slow
def test_scatter_that_the_written_model_states_is_not_found_again(
    restless: tuple[Campaign, Reconciliation], tmp_path: Path
) -> None:
    """model.yaml holds it as noise of the sensor, with its origin; as the model it leaves nothing to find."""
    campaign, first = restless
    write_result(first, tmp_path)
    improved = load_model(tmp_path / "model.yaml")
    assert improved.terms == ()
    (entry,) = improved.noise[2].scatter
    assert entry.effect == "MU_rr"
    assert entry.parameters["s_mu"].value == pytest.approx(first.effects[0].parameters[0]["value"])
    assert entry.added["campaign"] == campaign.title
    again = reconcile(campaign, improved, prove=False)
    assert (again.verdict, again.effects) == ("none", [])


def sources() -> list[Path]:
    """Every module of the search."""
    return sorted(Path(hil.reconcile.__file__).parent.rglob("*.py"))


def literals(source: Path) -> Iterator[tuple[int, str]]:
    """Yield line and text of every string that is no docstring."""
    tree = ast.parse(source.read_text())
    prose = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in prose:
            yield node.lineno, node.value


@pytest.mark.slow
def test_no_effect_is_named_in_the_search() -> None:
    """What is special about an effect stands on its class: an id as a literal would be a case of its own."""
    ids = {entry.id for entry in entries()} - WORDS
    found = [f"{source.name}:{line}: {text}" for source in sources() for line, text in literals(source) if text in ids]
    assert found == []


WORDS = {"base", "scale", "GS"}
"""Ids that are common words or a parameter as well."""


@pytest.mark.parametrize("source", sources(), ids=lambda source: source.stem)
def test_a_module_of_the_search_is_read_in_one_go(source: Path) -> None:
    """Three hundred lines at most."""
    assert len(source.read_text().splitlines()) <= MOST_LINES
