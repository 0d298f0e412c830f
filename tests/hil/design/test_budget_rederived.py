"""The error budget beside the report's own six equations, differentiated by hand: nothing of hil's solver is used.

An odd case on purpose: south of the equator, a bench that leans, a sequence with a fourth position.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
import yaml

from hil.config import load_bench, load_sweep, parse_bench
from hil.config.sweep import parse_sweep
from hil.design.budget.budget import Budget, analytic_share, response
from hil.design.budget.scenes import RunScene, planned_scenes
from hil.design.budget.sources import stated_by
from hil.model import Model, load_model
from hil.model.curve import Constant

Vector = np.ndarray
SEQUENCE = ("1", "3", "2", "3", "1", "4")
INDEX_DEG = {"1": -90.0, "2": 90.0, "3": 0.0, "4": 180.0}
LATITUDE, HEADING = np.radians(-34.6), np.radians(200.0)
G = np.array([np.sqrt(1 - 0.02**2 - 0.05**2), 0.02, -0.05])
KNOWN = {
    "angle_random_walk": "0.2 deg/sqrt(hr)",
    "bias_instability": "0.8 deg/hr",
    "tilt": "0.1 deg",
    "accelerometer": "1 mg",
    "heading": "1 deg",
    "latitude": "0.5 deg",
    "earth_rate": "0.2 deg/hr",
    "gravity": "2 mg",
    "index": "0.1 deg",
    "drift": "0.5 deg/hr/min",
    "bias_slope": "2 deg/hr/degC",
}
E = 1e-5
"""A small error, for derivatives by difference."""


@pytest.fixture(scope="module")
def scene() -> RunScene:
    """The third self-calibration at -29.7 °C of sensor 2, on the odd bench."""
    document = yaml.safe_load(load_bench("simulated").text)
    document["site"] = {"latitude": "-34.6 deg", "heading": "200 deg", "G2": "20 mg", "G3": "-50 mg"}
    document["uncertainties"] = KNOWN
    sweep = yaml.safe_load(load_sweep("rd-gc-86-1").text)
    sweep["positions"] = [int(label) for label in SEQUENCE]
    bench = parse_bench(yaml.safe_dump(document), "odd.yaml")
    return planned_scenes(parse_sweep(yaml.safe_dump(sweep), "odd-sweep.yaml"), bench)[2][2]


def turn(axis: Vector, angle: float) -> Vector:
    """Return the matrix that turns about an axis (Rodrigues)."""
    x, y, z = axis / np.linalg.norm(axis)
    across = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * across + (1 - np.cos(angle)) * across @ across)


def rates(parameters: Vector, gravity: list[Vector], earth: list[Vector]) -> Vector:
    """Equations (1) to (6) of the report, and what they become at 180 degrees."""
    ba, bb, gsa, gsb, mua, mub = parameters
    found = []
    for label, g, w in zip(SEQUENCE, gravity, earth, strict=True):
        sin, cos = np.sin(np.radians(INDEX_DEG[label])), np.cos(np.radians(INDEX_DEG[label]))
        f_a, f_b, f_s = g[0] * sin + g[2] * cos, g[1], g[0] * cos - g[2] * sin
        found += [
            ba + gsa * f_a + gsb * f_b + mub * f_s + w[0] * sin + w[2] * cos,
            bb - gsb * f_a + gsa * f_b - mua * f_s + w[1],
        ]
    return np.array(found)


def by_hand(scene: RunScene) -> dict[str, Vector]:
    """Return what each source contributes to (BA, BB, GSA, GSB, MUA, MUB), one standard deviation."""
    (gsa, gsb, mub), (_, _, minus_mua) = scene.scene.base.k[0]
    parameters = np.array([0.0, 0.0, gsa, gsb, -minus_mua, mub])
    level = 15.041067 * np.array(
        [np.sin(LATITUDE), np.cos(LATITUDE) * np.cos(HEADING), np.cos(LATITUDE) * np.sin(HEADING)]
    )
    lean = np.cross([1.0, 0.0, 0.0], G)
    earth = turn(lean, float(np.arcsin(np.linalg.norm(lean)))) @ level
    n = len(SEQUENCE)
    still, spinning = [G] * n, [earth] * n
    # Differences of the rates with one parameter at 1: the columns, then plain least squares.
    right = rates(parameters, still, spinning)
    columns = [rates(each, still, [0.0 * earth] * n) for each in np.eye(6)]
    inverse = np.linalg.pinv(np.stack(columns, -1))

    def effect(gravity: list[Vector], rotation: list[Vector]) -> Vector:
        return np.asarray(inverse @ (rates(parameters, gravity, rotation) - right) / E)

    def leaning(axis: Vector) -> Vector:
        return effect([turn(axis, E) @ G] * n, [turn(axis, E) @ earth] * n)

    def moved(place: int) -> Vector:
        own = [turn(np.array([0.0, 1.0, 0.0]), E if each == place else 0.0) for each in range(n)]
        return effect([matrix @ G for matrix in own], [matrix @ earth for matrix in own])

    def root(parts: list[Vector]) -> Vector:
        return np.sqrt(np.sum(np.square(parts), axis=0))

    up = G / np.linalg.norm(G)
    east = np.cross(earth - (earth @ up) * up, up)
    axis_2, axis_3 = np.eye(3)[1:]
    spread = np.linalg.norm(inverse, axis=1)
    minutes = scene.scene.minutes
    ramp_a, ramp_b = inverse[:, 0::2] @ minutes, inverse[:, 1::2] @ minutes
    return {
        "noise": 0.2 / np.sqrt(60.0 / 3600.0) * spread,
        "instability": 0.8 * np.sqrt(2.0 * np.log(2.0) / np.pi) * spread,
        "tilt": np.radians(0.1) * root([leaning(axis_2), leaning(axis_3)]),
        "accelerometer": 1e-3 * root([leaning(axis_2), leaning(axis_3)]),
        "heading": np.radians(1.0) * np.abs(effect(still, [turn(up, E) @ earth] * n)),
        "latitude": np.radians(0.5) * np.abs(effect(still, [turn(east, E) @ earth] * n)),
        "earth_rate": 0.2 * root([effect(still, [earth + E * each] * n) for each in np.eye(3)]),
        "gravity": 2e-3 * np.abs(effect([G + E * up] * n, spinning)),
        "index": np.radians(0.1) * root([moved(place) for place in range(n)]),
        "drift": 0.5 * root([ramp_a, ramp_b]),
        "soak": 0.05 / np.sqrt(3.0) * 2.0 * np.abs(ramp_a + ramp_b),
    }


def test_every_source_is_what_the_reports_equations_make_of_it(scene: RunScene) -> None:
    """All eleven sources on all six parameters; how a leaning bench is turned is a convention, of second order."""
    expected = by_hand(scene)
    to_parameters = response(scene.scene, scene.form)
    order = [scene.form.names.index(name) for name in ("BA", "BB", "GSA", "GSB", "MUA", "MUB")]
    assert {source.id for source in scene.sources} == set(expected)
    for source in scene.sources:
        found = analytic_share(source, scene.scene, to_parameters)[order]
        assert found == pytest.approx(expected[source.id], rel=2e-3, abs=2e-5), source.id


def test_the_draws_agree_with_it(scene: RunScene) -> None:
    """And the simulated column, whose errors are not small here, is the same within its own error."""
    assert Budget(scene.scene, scene.sources, scene.form, draws=20_000, seed=4).agrees


def test_errors_of_attitude_act_on_the_parameters_of_that_temperature(scene: RunScene, reference: Path) -> None:
    """GS and MU are those that the twin's truth has at the setpoint, not those 8 °C beside it."""
    with (reference / "twin_params.csv").open(encoding="utf-8") as lines:
        cold = next(csv.DictReader(lines))
    (gsa, gsb, mub), (_, _, minus_mua) = scene.scene.base.k[0]
    assert gsa == pytest.approx(float(cold["GSA_assumed"]), abs=0.1)
    assert gsb == pytest.approx(float(cold["GSB_assumed"]), abs=0.1)
    assert mub == pytest.approx(float(cold["MUB"]), abs=0.5)
    assert -minus_mua == pytest.approx(float(cold["MUA"]), abs=1.0)


def test_a_model_of_the_sweeps_own_temperatures_serves_for_the_next_night() -> None:
    """Its curves refuse to be extrapolated; the plan of the same temperatures does not ask them to."""
    shipped = load_model("rd-gc-86-1-truth")
    curves = {
        name: Constant(unit=each.unit, value=1.0, valid_degC=(-29.72, 60.0))
        for name, each in shipped.sensors[2].items()
    }
    model = Model(schema=shipped.schema_, title="t", form="matrix-6", sensors={2: curves})
    assert planned_scenes(load_sweep("rd-gc-86-1"), load_bench("simulated"), model)[2]


def test_what_a_model_states_that_runs_scatter_by_is_a_source() -> None:
    """A run's BA and MU scatter by just what is stated of them: collects of one run tell them as they then are."""
    shipped = load_model("rd-gc-86-1-truth")
    curves = {name: Constant(unit=each.unit, value=1.0) for name, each in shipped.sensors[2].items()}
    said = {
        "run_to_run": {"BA": {"unit": "deg/hr", "value": 2.0}},
        "scatter": [{"effect": "MU_rr", "parameters": {"s_mu": {"unit": "deg/hr/g", "value": 5.0}}}],
    }
    stating = Model(schema=shipped.schema_, title="t", form="matrix-6", sensors={2: curves}, noise={2: said})
    one = planned_scenes(load_sweep("rd-gc-86-1"), load_bench("simulated"), stating)[2][0]
    (stated,) = (each for each in one.sources if each.id == "stated")
    budget = Budget(one.scene, one.sources, one.form, draws=20_000, seed=4)
    share = next(each for each in budget.shares if each.source is stated)
    wanted = {"BA": 2.0, "BB": 0.0, "GSA": 0.0, "GSB": 0.0, "MUA": 5.0, "MUB": 5.0}
    assert dict(zip(budget.names, share.analytic, strict=True)) == pytest.approx(wanted, abs=1e-6)
    assert budget.from_run_to_run[budget.names.index("MUA")] > 5.0
    assert budget.agrees
    silent = Model(schema=shipped.schema_, title="t", form="matrix-6", sensors={2: curves})
    assert not [
        each
        for each in planned_scenes(load_sweep("rd-gc-86-1"), load_bench("simulated"), silent)[2][0].sources
        if each.id == "stated"
    ]


def test_what_scatters_inside_a_run_is_in_the_errors_of_what_was_measured() -> None:
    """And once only: as a source besides it had widened every part of a campaign's budget by as much again."""
    shipped = load_model("rd-gc-86-1-truth")
    said = {
        "run_to_run": {"BA": {"unit": "deg/hr", "value": 2.0}},
        "collect_to_collect": {"BA": {"unit": "deg/hr", "value": 5.0}},
    }
    stating = Model(schema=shipped.schema_, title="t", form="matrix-6", sensors=shipped.sensors, noise={2: said})
    scene = planned_scenes(load_sweep("recommended"), load_bench("simulated"), stating)[2][0].scene
    for measured, size in ((True, 2.0), (False, float(np.hypot(2.0, 5.0)))):
        (source,) = stated_by(stating, scene.conditions, measured=measured)
        of_a = source.columns(scene)[:, 0]
        assert np.sqrt(np.sum(of_a**2, axis=1)) == pytest.approx(size, abs=0.4)
