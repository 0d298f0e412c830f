"""The noise section of a model: what it states of the scatter; mistakes in it; a model that does not fit a sensor."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.errors import InputError
from hil.model import Model, fitting, load_model, save_model
from hil.model.effects.catalogue import variance_effect_by_id
from tests.hil.model.effect_conditions import ROTOR, TRIAD, campaign
from tests.hil.model.test_models import document, model, written

RESEATS = {"effect": "MU_rr", "parameters": {"s_mu": {"unit": "deg/hr/g", "value": 3.8}}}
WANDERS = {"effect": "markov", "parameters": {"sigma_m": {"unit": "deg/hr", "value": 2.0}}, "shape": {"tau_hr": 8.0}}
OLDER = {
    "angle_random_walk": {"unit": "deg/sqrt(hr)", "value": 0.12},
    "bias_instability": {"unit": "deg/hr", "value": 0.5},
    "rate_random_walk": {"unit": "deg/hr/sqrt(hr)", "value": 1.0},
    "resolution_deg_per_hr": 0.01,
}
SINKING = {"table": {"temperature_degC": [0.0, 20.0], "value": [1.0, -2.0]}}
SHORT = campaign(temperatures=(0.0, 20.0), runs_each=3)


def stating(tmp_path: Path, **noise: Any) -> Model:
    """Return a model whose noise section states this of sensor 2."""
    return model(tmp_path, noise={2: noise})


def stated(tmp_path: Path, **noise: Any) -> np.ndarray:
    """Return the covariance that it states of a short campaign."""
    parts = stating(tmp_path, **noise).stated_scatter(SHORT)
    return np.asarray(sum((part.covariance(SHORT) for part in parts), start=np.zeros((2 * len(SHORT),) * 2)))


def test_what_the_older_keys_say_is_what_the_catalogue_says(tmp_path: Path) -> None:
    """Walk, flicker and a reseating MU are the catalogue's effects; white noise is in the standard errors already."""
    flicker, rrw, mu = (variance_effect_by_id(name).covariance(SHORT) for name in ("flicker", "rrw", "MU_rr"))
    assert stated(tmp_path, **OLDER) == pytest.approx(0.5**2 * flicker + rrw)
    sigmas = {name: {"unit": "deg/hr/g", "value": 3.8} for name in ("MUA", "MUB")}
    assert stated(tmp_path, run_to_run=sigmas) == pytest.approx(3.8**2 * mu)
    assert stated(tmp_path, scatter=[RESEATS]) == pytest.approx(3.8**2 * mu)


def test_what_scatters_one_channel_scatters_no_other(tmp_path: Path) -> None:
    """The channels that are named; without any all of the sensor."""
    whole, some = (stated(tmp_path, scatter=[{**RESEATS, **of}]) for of in ({}, {"channels": ["RB"]}))
    assert some[1::2, 1::2] == pytest.approx(whole[1::2, 1::2])
    assert whole[::2].any()
    assert not some[::2].any()


def test_correlated_parameters_scatter_together(tmp_path: Path) -> None:
    """BA and MUB move channel A: in position 3 (fS = -1) what they share is taken away, at no other it shows."""
    sigmas = {"BA": {"unit": "deg/hr", "value": 2.0}, "MUB": {"unit": "deg/hr/g", "value": 3.0}}
    covariance = stated(tmp_path, run_to_run=sigmas, correlation={"BA MUB": 0.5})[::2, ::2]
    axial = SHORT.f_g[:3, 2]
    assert np.abs(axial).max() == pytest.approx(1.0)
    expected = 4.0 + 0.5 * 6.0 * np.add.outer(axial, axial) + 9.0 * np.multiply.outer(axial, axial)
    assert covariance[:3, :3] == pytest.approx(expected)
    assert not covariance[:3, 3:].any()


def test_what_changes_from_collect_to_collect_joins_no_two_of_them(tmp_path: Path) -> None:
    """A bias moves its own channel in one collect, MUB as far as the spin axis is pulled."""
    sigmas = {"BA": {"unit": "deg/hr", "value": 2.0}, "MUB": {"unit": "deg/hr/g", "value": 3.0}}
    covariance = stated(tmp_path, collect_to_collect=sigmas)
    assert covariance[::2, ::2] == pytest.approx(np.diag(4.0 + 9.0 * SHORT.f_g[:, 2] ** 2))
    assert not covariance[1::2].any()


def test_sizes_follow_temperature_row_by_row(tmp_path: Path) -> None:
    """A wander that is twice as large at 20 °C as at 0 °C; rows without a temperature are refused."""
    curve = {"unit": "deg/hr", "polynomial": [1.0, 0.05], "reference_degC": 0.0}
    growing = {**WANDERS, "parameters": {"sigma_m": curve}}
    unit = variance_effect_by_id("markov").covariance(SHORT, {"tau_hr": 8.0})
    size = np.repeat(1.0 + 0.05 * SHORT.columns["temperature_degC"], 2)
    assert stated(tmp_path, scatter=[growing]) == pytest.approx(np.multiply.outer(size, size) * unit)
    for noise in ({"scatter": [growing]}, {"run_to_run": {"BA": curve}}):
        with pytest.raises(InputError, match="depends on temperature_degC"):
            stating(tmp_path, **noise).stated_scatter(replace(SHORT, columns={}))


def test_a_sensor_of_which_nothing_is_stated_scatters_by_nothing(tmp_path: Path) -> None:
    """Neither where the model has no noise section, nor where the section is empty."""
    assert not model(tmp_path).stated_scatter(SHORT)
    assert not stated(tmp_path).any()


def test_a_model_that_holds_only_scatter_reads_back_equal(tmp_path: Path) -> None:
    """Also with its record of where it came from."""
    original = stating(tmp_path, scatter=[{**WANDERS, "added": {"campaign": "night"}}, RESEATS])
    save_model(original, tmp_path / "again.yaml")
    again = load_model(tmp_path / "again.yaml")
    assert again == original
    assert [(term.effect, effect.id) for term, effect in again.noise[2].scatter_for(ROTOR)] == [
        ("markov", "markov"),
        ("MU_rr", "MU_rr"),
    ]


@pytest.mark.parametrize(
    ("noise", "sentence"),
    [
        ({"scatter": [{**RESEATS, "effect": "mu_rr"}]}, "scatter.0.effect: no effect that scatters averages has"),
        ({"scatter": [{**RESEATS, "effect": "jump"}]}, "scatter.0.effect: no effect that scatters averages has"),
        ({"scatter": [{**WANDERS, "shape": {}}]}, "scatter.0.shape.tau_hr: missing; markov needs it, in hr"),
        (
            {"scatter": [{**RESEATS, "parameters": {"s": {"unit": "deg/hr/g", "value": 1.0}}}]},
            "scatter.0.parameters.s: unknown key for effect MU_rr; it has s_mu",
        ),
        (
            {"scatter": [{**RESEATS, "parameters": {"s_mu": {"unit": "deg/hr", "value": 1.0}}}]},
            "scatter.0.parameters.s_mu: unit: deg/hr given, deg/hr/g needed",
        ),
        ({**OLDER, "bias_instability": {"unit": "deg/s", "value": 1.0}}, "bias_instability: unit: deg/s given"),
        (
            {"run_to_run": {"MUX": {"unit": "deg/hr/g", "value": 1.0}}},
            "run_to_run.MUX: there is no such base parameter",
        ),
        ({"run_to_run": {"MUA": {"unit": "deg/hr", "value": 1.0}}}, "run_to_run.MUA: unit: deg/hr given"),
        (
            {"collect_to_collect": {"RA": {"unit": "deg/hr", "value": 1.0}}},
            "collect_to_collect.RA: there is no such base parameter; there are BA",
        ),
        ({"correlation": {"BA MUB": 0.1}}, "correlation.BA MUB: write two different names of run_to_run (none)"),
        (
            {
                "run_to_run": {name: {"unit": "deg/hr", "value": 1.0} for name in ("BA", "BB")},
                "correlation": {"BA BB": 1.2},
            },
            "correlation: no scatter has these correlations together",
        ),
        (
            {"scatter": [{**RESEATS, "parameters": {"s_mu": {"unit": "deg/hr/g", "value": -1.0}}}]},
            "scatter.0.parameters.s_mu: -1 deg/hr/g given: a deviation is 0 or more; write it without its sign",
        ),
        ({"scatter": [{**WANDERS, "shape": {"tau_hr": -2.0}}]}, "scatter.0.shape.tau_hr: -2 hr given: it must be more"),
        ({"run_to_run": {"BA": {"unit": "deg/hr", "value": -1.0}}}, "run_to_run.BA: -1 deg/hr given: a deviation is"),
        ({"collect_to_collect": {"BA": {"unit": "deg/hr", **SINKING}}}, "collect_to_collect.BA: -2 deg/hr given"),
        ({**OLDER, "angle_random_walk": {"unit": "deg/sqrt(hr)", "value": -0.1}}, "angle_random_walk: -0.1 deg"),
        ({"run_to_run": {"BA": {"unit": "deg/hr", "value": float("nan")}}}, "run_to_run.BA.value: "),
        ({"resolution_deg_per_hr": -1.0}, "resolution_deg_per_hr: "),
    ],
)
def test_mistakes_in_a_noise_section_are_named_by_file_and_key(
    noise: dict[str, Any], sentence: str, tmp_path: Path
) -> None:
    """When the file is read, not when the night has begun."""
    path = written(tmp_path, document(noise={2: noise}))
    with pytest.raises(InputError) as refusal:
        load_model(path)
    assert str(refusal.value).startswith(f"{path}: noise.2.{sentence}")


def test_a_size_that_falls_below_nothing_at_a_temperature_is_said_when_it_is_met(tmp_path: Path) -> None:
    """A polynomial without a range may be meant for other temperatures; at one that rows have it is refused."""
    falls = {"unit": "deg/hr", "polynomial": [1.0, -0.1], "reference_degC": 20.0}
    loaded = stating(tmp_path, run_to_run={"BA": falls})
    warm = replace(SHORT, columns={"temperature_degC": np.full(len(SHORT), 40.0)})
    with pytest.raises(InputError, match=r"scatter BA is -1 deg/hr at 40 °C: a deviation is 0 or more"):
        loaded.stated_scatter(warm)


@pytest.mark.parametrize(
    ("effect", "parameter", "shape", "sentence"),
    [
        ("vre", "K_v_C", {}, "parameters.K_v_C: unknown key for effect vre; it has K_v_A, K_v_B"),
        ("empirical:MUA*supply_V", "q", {"reference": 28.0}, "parameters.q: unit: deg/hr/g^2 given, deg/hr/g per"),
    ],
)
def test_names_and_units_that_the_layout_gives_are_checked_once_it_is_known(
    effect: str, parameter: str, shape: dict[str, float], sentence: str, tmp_path: Path
) -> None:
    """A model of the form constant may be of any sensor: only the sensor itself can say whether they exist."""
    term = {"effect": effect, "parameters": {parameter: {"unit": "deg/hr/g^2", "value": 1.0}}, "shape": shape}
    path = written(tmp_path, document(form="constant", sensors={}, terms=[term]))
    with pytest.raises(InputError, match=re.escape(f"{path}: terms.0.{sentence}")):
        fitting(path, [ROTOR])
    with pytest.raises(InputError, match="it is not a two-channel rotor sensor"):
        fitting(model(tmp_path), [TRIAD])
    with pytest.raises(InputError, match=r"noise\.2\.scatter\.0\.channels: there is no GX; the sensor has RA and RB"):
        fitting(stating(tmp_path, scatter=[{**RESEATS, "channels": ["GX"]}]), [ROTOR])


def test_an_effect_that_a_sensor_cannot_have_is_refused_where_it_is_meant_for_that_sensor(tmp_path: Path) -> None:
    """MU in a triad; a term for every sensor in which it can exist is left alone where it can in one."""
    mass = {"effect": "MU_real", "parameters": {"MUA": {"unit": "deg/hr/g", "value": 1.0}}}
    triad: dict[str, Any] = {"form": "triad-12", "sensors": {}}
    fitting(model(tmp_path, terms=[mass], form="constant", sensors={}), [TRIAD, ROTOR])
    for changes, place in (
        ({"terms": [mass]}, "terms.0"),
        ({"terms": [{**mass, "sensor": 1}]}, "terms.0"),
        ({"noise": {1: {"scatter": [RESEATS]}}}, ""),
    ):
        with pytest.raises(
            InputError, match=rf"model.yaml: {place or 'noise.1.scatter.0'}.effect: .* can(not be in| be in no)"
        ):
            fitting(written(tmp_path, document(**changes, **triad)), [TRIAD])


def test_the_shipped_model_fits_its_sensors() -> None:
    """Nothing is said where nothing is wrong, also of parameters that only the data name."""
    assert fitting("rd-gc-86-1-truth", [ROTOR]) == load_model("rd-gc-86-1-truth")


def test_a_drift_through_all_runs_is_refused_and_within_runs_is_read(tmp_path: Path) -> None:
    """It is ageing now; what was written of a drift within runs keeps its meaning."""
    drift = {"effect": "drift", "parameters": {"d_A": {"unit": "deg/hr/collect", "value": 1.0}}}
    shape = {"interval_s": 120.0, "middle": 1.0}
    model(tmp_path, terms=[{**drift, "shape": {**shape, "through_runs": 0.0}}])
    with pytest.raises(InputError, match=r"terms\.0\.shape\.through_runs: unknown key for effect drift; it has"):
        model(tmp_path, terms=[{**drift, "shape": {**shape, "through_runs": 1.0}}])
