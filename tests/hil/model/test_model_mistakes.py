"""What is wrong with a model file, or with rows for it, is named by file and key."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml

from hil.campaign import Campaign, Collects
from hil.config import check_sweep_against_bench, load_bench, parse_bench, parse_sweep
from hil.errors import InputError
from hil.model import fitting, fitting_campaign, load_model
from tests.hil.model.effect_conditions import ROTOR, campaign
from tests.hil.model.test_models import document, model, written


def _without(name: str) -> dict[str, object]:
    sensors = document()["sensors"]
    assert isinstance(sensors, dict)
    return {2: {key: value for key, value in sensors[2].items() if key != name}}


def _with(name: str, entry: object) -> dict[str, object]:
    sensors = document()["sensors"]
    assert isinstance(sensors, dict)
    return {2: {**sensors[2], name: entry}}


WARMUP = {"effect": "warmup", "parameters": {"W_A": {"unit": "deg/hr", "value": 1.0}}}


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"schema": "hil.model/2"}, "key schema: it is 'hil.model/2'; this program reads hil.model/1"),
        ({"schema": None}, "key schema: it is missing; this program reads hil.model/1"),
        ({"form": "matrix-7"}, "form: unknown form matrix-7"),
        ({"colour": "red"}, "unknown key 'colour'; allowed: form, inside_collects, noise, schema, "),
        ({"noise": {2: {"flicker": 1.0}}}, "noise.2: unknown key 'flicker'; allowed: angle_random_walk, "),
        (
            {"noise": {2: {"rate_randm_walk": 1.0}}},
            "noise.2: unknown key 'rate_randm_walk'; did you mean 'rate_random_",
        ),
        ({"sensors": _without("GSB")}, "sensors.2.GSB: missing"),
        ({"sensors": _with("GSX", {"unit": "deg/hr/g", "value": 1.0})}, "sensors.2.GSX: unknown key"),
        (
            {"sensors": _with("BA", {"unit": "deg/hr", "value": 1.0, "valeu": 2.0})},
            "sensors.2.BA: unknown key 'valeu'; did you mean 'value'?",
        ),
        ({"sensors": _with("BA", {"unit": "deg/hr"})}, "sensors.2.BA: give one of value, polynomial or table"),
        ({"sensors": _with("BA", {"value": 1.0})}, "sensors.2.BA.unit: this key is missing"),
        ({"sensors": _with("BA", {"unit": "deg/hr", "value": float("nan")})}, "sensors.2.BA.value: "),
        ({"sensors": _with("BA", {"unit": "deg/hr", "polynomial": [1.0]})}, "sensors.2.BA.reference_degC: "),
        (
            {"sensors": _with("BA", {"unit": "deg/hr", "table": {"temperature_degC": [0, 0], "value": [1, 2]}})},
            "sensors.2.BA.table: temperature_degC must rise strictly",
        ),
        (
            {"sensors": _with("BA", {"unit": "deg/hr", "table": {"temperature_degC": [0, 1], "value": [1]}})},
            "sensors.2.BA.table: value must have as many entries",
        ),
        ({"sensors": _with("BA", {"unit": "deg/s", "value": 1.0})}, "sensors.2.BA: unit: deg/s given, deg/hr needed"),
        ({"terms": [{**WARMUP, "effect": "warm"}]}, "terms.0.effect: no effect of the catalogue"),
        ({"terms": [{"effect": "warm", "parameters": {}}]}, "terms.0.effect: no effect of the catalogue"),
        ({"terms": [{**WARMUP, "effect": "swap"}]}, "terms.0.effect: swap is a mistake in a record"),
        ({"terms": [{**WARMUP, "effect": "arw"}]}, "terms.0.effect: effect arw scatters averages: write it in noise"),
        (
            {"terms": [{**WARMUP, "parameters": {"Q": {"unit": "1", "value": 1.0}}}]},
            "terms.0.parameters.Q: unknown key",
        ),
        (
            {"terms": [{**WARMUP, "parameters": {}}]},
            "terms.0.parameters: nothing is given; warmup has W_A (deg/hr), W_B (deg/hr) and shape.tau_min (min)",
        ),
        (
            {"noise": {2: {"scatter": [{"effect": "markov"}]}}},
            "noise.2.scatter.0.parameters: nothing is given; markov has sigma_m (deg/hr) and shape.tau_hr (hr)",
        ),
        ({"terms": [WARMUP]}, "terms.0.shape.tau_min: missing; warmup needs it, in min"),
        (
            {"terms": [{**WARMUP, "shape": {"tau_min": 5.0, "tau_s": 3.0}}]},
            "terms.0.shape.tau_s: unknown key for effect warmup; it has tau_min",
        ),
        (
            {"terms": [{**WARMUP, "effect": "turnon", "parameters": {"b_1_A": {"unit": "deg/hr", "value": 1.0}}}]},
            "terms.0.shape.power_cycles: missing; turnon needs it",
        ),
        (
            {"terms": [{**WARMUP, "parameters": {"W_A": {"unit": "mdeg/s", "value": 1.0}}}]},
            "terms.0.parameters.W_A: unit: mdeg/s given, deg/hr needed",
        ),
        (
            {"terms": [{"effect": "empirical:GXY*supply_V", "parameters": {"q": {"unit": "1", "value": 1.0}}}]},
            "terms.0.effect: empirical:GXY*supply_V cannot be in a sensor with channels A, B",
        ),
        ({"terms": [{**WARMUP, "tau": 3}]}, "terms.0: unknown key 'tau'; allowed: "),
    ],
)
def test_mistakes_in_a_model_file_are_named_by_file_and_key(
    changes: dict[str, object], sentence: str, tmp_path: Path
) -> None:
    """One sentence: the file, the key, what is wrong."""
    path = written(tmp_path, document(**changes))
    with pytest.raises(InputError) as refusal:
        load_model(path)
    assert str(refusal.value).startswith((f"{path}: {sentence}", f"{path}, {sentence}"))
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("text", ["a: [", "- 1\n- 2\n", ""])
def test_what_is_no_model_file_is_refused(text: str, tmp_path: Path) -> None:
    """Broken YAML, a list, an empty file."""
    path = tmp_path / "broken.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"broken\.yaml"):
        load_model(path)


def test_a_model_that_does_not_exist_is_refused_with_what_there_is() -> None:
    """The message lists the built-ins."""
    with pytest.raises(InputError, match=r"model nowhere: .*matrix-6-thermal"):
        load_model("nowhere")


def test_values_against_temperature_refuse_rows_without_one() -> None:
    """A NaN temperature is named, not passed through."""
    with pytest.raises(InputError, match=r"BA, BB.* of sensor 2 depend on temperature"):
        load_model("rd-gc-86-1-truth").rates(campaign(every_column=False))


def test_a_term_that_follows_temperature_refuses_rows_without_one(tmp_path: Path) -> None:
    """A value against temperature in rows that have none."""
    curve = {"unit": "deg/hr/day", "polynomial": [1.0, 2.0], "reference_degC": 20.0}
    with pytest.raises(InputError, match="ageing depends on temperature_degC"):
        model(tmp_path, terms=[{"effect": "ageing", "parameters": {"a_A": curve}}]).rates(campaign(every_column=False))


def test_terms_and_noise_of_sensors_that_are_not_there_are_refused(tmp_path: Path) -> None:
    """A model of several sensors serves a campaign of one of them; a number that is nobody's is a slip."""
    values = document()["sensors"][2]  # type: ignore[index]
    warm = {**WARMUP, "sensor": 7, "shape": {"tau_min": 30.0}}
    noise = {3: {"angle_random_walk": {"unit": "deg/sqrt(hr)", "value": 0.1}}}
    for changes, key in (({"terms": [warm]}, r"terms\.0\.sensor: .* 7"), ({"noise": noise}, r"noise\.3: .* 3")):
        with pytest.raises(InputError, match=rf"model\.yaml: {key}; there are 2"):
            fitting(written(tmp_path, document(**changes)), [ROTOR])
        fitting(model(tmp_path, sensors=dict.fromkeys((2, 3, 7), values), **changes), [ROTOR])


@pytest.mark.parametrize(
    ("key", "unit", "noise"),
    [
        ("angle_random_walk", "deg/sqrt(hr)", lambda curve: {"angle_random_walk": curve}),
        ("run_to_run.BA", "deg/hr", lambda curve: {"run_to_run": {"BA": curve}}),
        (
            "scatter.0.parameters.sigma_m",
            "deg/hr",
            lambda curve: {
                "scatter": [{"effect": "markov", "shape": {"tau_hr": 1.0}, "parameters": {"sigma_m": curve}}]
            },
        ),
    ],
)
def test_noise_that_is_negative_at_a_temperature_is_refused_before_the_night(
    key: str, unit: str, noise: Callable[[object], object], tmp_path: Path
) -> None:
    """Of a polynomial without a range only who knows the temperatures can say so: a sweep on its bench, a campaign.

    At temperatures where it is positive, the same file is read.
    """
    curve = {"unit": unit, "polynomial": [1.0, 0.0, -1e-3], "reference_degC": 0.0}
    path = written(tmp_path, document(noise={2: noise(curve)}))
    assert fitting(path, [ROTOR], [30.0, -30.0, np.nan]) == load_model(path)
    rows = campaign(temperatures=(20.0, 50.0))
    measured = Campaign("", "", {2: Collects(rows, np.zeros((len(rows), 2)), np.ones((len(rows), 2)))})
    bench = yaml.safe_load(load_bench("simulated").text)
    bench["simulation"]["model"] = str(path)
    del bench["sensors"][1]
    warm = parse_sweep("title: warm\ntemperatures: [20 degC, 50 degC]\n", "sweep.yaml")
    for ask in (
        lambda: fitting_campaign(path, measured),
        lambda: check_sweep_against_bench(warm, parse_bench(yaml.safe_dump(bench), "bench.yaml")),
    ):
        with pytest.raises(
            InputError, match=rf"noise\.2\.{key}: -1\.\d+ {re.escape(unit)} at \d+.* °C: .* write a tab"
        ):
            ask()
