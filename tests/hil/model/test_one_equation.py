"""Every part that needs rates asks the one equation: change a term there, and each of their answers changes."""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from hil.campaign import Conditions, FloatArray
from hil.design.budget.sources import Scene
from hil.design.visibility.map import base_values
from hil.model import load_model
from hil.model.effects.catalogue import effect_by_id
from hil.model.equation import RD_GC_86_1_SENSOR_2, pickoff_rates
from hil.model.forms import matrix_6_form
from hil.reconcile.search.problem import base_at
from hil.twin.sensor import SimulatedSensor
from tests.hil.model.effect_conditions import ROTOR, campaign, rotor_base

VALUES = np.array([22.0, -38.0, 60.0, -25.0, -37.0, -7.5])
LEANING = (0.98, 0.1, -0.15)
ROWS = campaign(g=LEANING)
BASE = rotor_base(ROWS)


def of_a_model(rows: Conditions) -> FloatArray:
    """A model file with values."""
    return load_model("rd-gc-86-1-truth").rates(rows)


def of_the_columns(rows: Conditions) -> FloatArray:
    """What the solver fits, which is without the earth rate."""
    return np.asarray(matrix_6_form(ROTOR).columns(rows) @ VALUES)


def of_visibility(rows: Conditions) -> FloatArray:
    """The base that a design assumes."""
    return base_values(rows, None).rates


def of_the_search(rows: Conditions) -> FloatArray:
    """The base that reconcile has fitted."""
    return base_at(matrix_6_form(ROTOR), rows, VALUES).rates


def of_the_budget(rows: Conditions) -> FloatArray:
    """A scene, asked in the bench frame."""
    axes = np.array([RD_GC_86_1_SENSOR_2[label].axes for label in rows.position])
    scene = Scene(rows, axes, BASE, np.ones_like(BASE.bias))
    return scene.rates(scene.gravity, scene.earth_rate, BASE.bias)


def of_the_twin(rows: Conditions) -> FloatArray:
    """A simulated sensor."""
    coefficients = np.concatenate([BASE.bias, BASE.k.reshape(len(rows), -1)], axis=1)
    two_channels = cast(SimulatedSensor, SimpleNamespace(channels=2))
    return SimulatedSensor.rates(two_channels, coefficients, rows.f_g, rows.w_channels_deg_per_hr)


def of_an_effect(identifier: str, **shape: float) -> Callable[[Conditions], FloatArray]:
    """The columns of an effect that acts through B, K and w."""
    return lambda rows: effect_by_id(identifier).columns(rows, BASE, shape)


ASKED: dict[str, tuple[Callable[[Conditions], FloatArray], str]] = {
    "model": (of_a_model, "Bfw"),
    "columns": (of_the_columns, "Bf"),
    "visibility": (of_visibility, "Bfw"),
    "search": (of_the_search, "Bfw"),
    "budget": (of_the_budget, "Bfw"),
    "twin": (of_the_twin, "Bfw"),
    "tilt": (of_an_effect("tilt"), "f"),
    "accel": (of_an_effect("accel"), "f"),
    "index": (of_an_effect("index"), "fw"),
    "T_lag": (of_an_effect("T_lag"), "Bf"),
}
WEIGHTS = {"B": (2.0, 1.0, 1.0), "f": (1.0, 2.0, 1.0), "w": (1.0, 1.0, 2.0)}


@pytest.mark.parametrize(("part", "term"), [(part, term) for part, (_, terms) in ASKED.items() for term in terms])
def test_a_term_changed_in_the_equation_changes_every_answer(
    part: str, term: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Bias, K·f or w counted twice: whoever wrote the equation out for itself would answer as before."""
    ask = ASKED[part][0]
    before = ask(ROWS)
    on_bias, on_k, on_w = WEIGHTS[term]

    def otherwise(bias: FloatArray, k: FloatArray, f_g: FloatArray, w_channels: FloatArray) -> FloatArray:
        return pickoff_rates(on_bias * np.asarray(bias), on_k * np.asarray(k), f_g, on_w * np.asarray(w_channels))

    for name, module in list(sys.modules.items()):
        if name.startswith("hil.") and getattr(module, "pickoff_rates", None) is pickoff_rates:
            monkeypatch.setattr(module, "pickoff_rates", otherwise)
    assert np.max(np.abs(ask(ROWS) - before)) > 1e-3


def test_all_that_know_the_whole_equation_answer_alike() -> None:
    """The same B, K, f and w give the same rates in the search, the budget and the twin."""
    for ask in (of_the_search, of_the_budget, of_the_twin):
        np.testing.assert_allclose(ask(ROWS), BASE.rates, rtol=1e-12, atol=1e-9)


def test_one_row_is_the_same_alone_and_among_others() -> None:
    """To the last bit: a simulated unit may be asked for any number of samples at a time."""
    rng = np.random.default_rng(3)
    bias, k, f_g, w = (rng.normal(size=(50, *shape)) for shape in ((2,), (2, 3), (3,), (2,)))
    together = pickoff_rates(bias, k, f_g, w)
    alone = [pickoff_rates(bias[i : i + 1], k[i : i + 1], f_g[i : i + 1], w[i : i + 1])[0] for i in range(50)]
    np.testing.assert_array_equal(together, alone)
