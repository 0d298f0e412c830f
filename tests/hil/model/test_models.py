"""Model files: values against temperature, terms, round trips, and one clear sentence for every mistake."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from hil.errors import InputError
from hil.model import Model, Term, built_in_model, load_model, save_model
from hil.model.curve import Constant, Polynomial, Table, TableRows
from hil.model.effects.base import Effect
from hil.model.effects.catalogue import EFFECTS, effect_by_id
from hil.model.effects.history import joined
from hil.model.equation import pickoff_rates, rotor_matrix
from tests.hil.model.effect_conditions import ROTOR, TERMS, TRIAD, campaign, one_run, power_cycled, triad_poses

UNITS = {"BA": "deg/hr", "BB": "deg/hr"}


def document(**changes: object) -> dict[str, object]:
    """Return a valid model file's document, with changes."""
    values = {name: {"unit": UNITS.get(name, "deg/hr/g"), "value": value} for name, value in TERMS.items()}
    return {"schema": "hil.model/1", "title": "unit", "form": "matrix-6", "sensors": {2: values}, **changes}


def written(tmp_path: Path, content: object) -> Path:
    """Write a model file and return its path."""
    path = tmp_path / "model.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


def model(tmp_path: Path, **changes: object) -> Model:
    """Return the model of a valid document, with changes."""
    return load_model(written(tmp_path, document(**changes)))


def test_model_without_terms_is_the_equation(tmp_path: Path) -> None:
    """R = B + K·f + w with the values of the file."""
    conditions = campaign()
    t = TERMS
    expected = pickoff_rates(
        [t["BA"], t["BB"]],
        rotor_matrix(t["GSA"], t["GSB"], t["MUA"], t["MUB"]),
        conditions.f_g,
        conditions.w_channels_deg_per_hr,
    )
    assert np.allclose(model(tmp_path).rates(conditions), expected)


def test_shipped_truth_passes_through_the_printed_means_of_table_1(reference: Path) -> None:
    """At every printed temperature BA, BB, MUA, MUB are the printed digits, doubtful ones included; GS the assumed."""
    truth = load_model("rd-gc-86-1-truth")
    with (reference / "twin_params.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    base = truth.base_at(ROTOR, np.array([float(row["temperature_C"]) for row in rows]))
    for index, row in enumerate(rows):
        matrix = rotor_matrix(*(float(row[name]) for name in ("GSA_assumed", "GSB_assumed", "MUA", "MUB")))
        assert np.allclose(base.bias[index], [float(row["BA"]), float(row["BB"])], atol=1e-9)
        assert np.allclose(base.k[index], matrix, atol=1e-9)


def test_shipped_truth_never_swings_beyond_the_printed_means_between_them() -> None:
    """Monotone between plateaus: no value outside its two neighbours, and the end values hold outside the table."""
    truth = load_model("rd-gc-86-1-truth")
    for curve in truth.sensors[2].values():
        assert isinstance(curve, Table)
        knots, values = np.array(curve.table.temperature_degC), np.array(curve.table.value)
        for low, high, first, second in zip(knots, knots[1:], values, values[1:], strict=False):
            between = curve.at(np.linspace(low, high, 50))
            assert between.min() >= min(first, second) - 1e-9
            assert between.max() <= max(first, second) + 1e-9
        assert curve.at([-80.0, 90.0]) == pytest.approx([values[0], values[-1]])
        assert curve.slope_at([-80.0, 90.0]) == pytest.approx([0.0, 0.0])


def test_shipped_truth_says_what_is_assumed_and_scatters_as_table_1_does() -> None:
    """Noise section: 0.12 deg/√hr when warm and more in the cold, the pooled run-to-run scatter and its correlation."""
    truth = load_model("rd-gc-86-1-truth")
    assert "assumed" in truth.source
    noise = truth.noise[2]
    assert noise.angle_random_walk.at([25.0])[0] == pytest.approx(0.12)
    assert noise.angle_random_walk.at([-29.7])[0] == pytest.approx(1.5 / np.sqrt(60.0), abs=1e-3)
    assert {name: curve.at([0.0])[0] for name, curve in noise.run_to_run.items()} == {
        "BA": 1.8,
        "BB": 4.3,
        "MUA": 3.74,
        "MUB": 3.95,
    }
    assert noise.correlation == {"BA MUB": 0.1, "BB MUA": -0.11}


@given(st.lists(st.floats(-50.0, 50.0), min_size=1, max_size=4), st.floats(-30.0, 60.0))
def test_slope_of_a_polynomial_is_its_derivative(coefficients: list[float], temperature: float) -> None:
    """Compared with a central difference."""
    curve = Polynomial(unit="deg/hr", polynomial=tuple(coefficients), reference_degC=20.0)
    numeric = (curve.at([temperature + 1e-3]) - curve.at([temperature - 1e-3])) / 2e-3
    assert curve.slope_at([temperature]) == pytest.approx(numeric, rel=1e-5, abs=1e-4)


def test_base_slopes_are_those_of_the_curves() -> None:
    """Slopes of bias and K agree with differences of the base itself."""
    truth = load_model("rd-gc-86-1-truth")
    at = np.array([-20.0, 0.0, 15.0, 55.0])
    base, above, below = (truth.base_at(ROTOR, at + step) for step in (0.0, 1e-4, -1e-4))
    assert base.bias_slope == pytest.approx((above.bias - below.bias) / 2e-4, rel=1e-4, abs=1e-6)
    assert base.k_slope == pytest.approx((above.k - below.k) / 2e-4, rel=1e-4, abs=1e-6)


def test_terms_add_their_columns_times_their_values(tmp_path: Path) -> None:
    """A term with a shape, a term that follows temperature, and a term of another sensor."""
    terms = [
        {
            "effect": "warmup",
            "sensor": 2,
            "parameters": {"W_A": {"unit": "deg/hr", "value": 10.0}},
            "shape": {"tau_min": 8.0},
        },
        {
            "effect": "vre",
            "parameters": {"K_v_B": {"unit": "deg/hr/g^2", "polynomial": [100.0, 2.0], "reference_degC": 20.0}},
        },
        {"effect": "ageing", "sensor": 1, "parameters": {"a_A": {"unit": "deg/hr/day", "value": 1e6}}},
    ]
    conditions = campaign()
    plain, extended = model(tmp_path), model(tmp_path, terms=terms)
    warm = effect_by_id("warmup").columns(conditions, None, {"tau_min": 8.0})[:, 0, 0]
    rms = conditions.columns["vibration_rms_g"] ** 2
    change = extended.rates(conditions) - plain.rates(conditions)
    assert change[:, 0] == pytest.approx(10.0 * warm)
    assert change[:, 1] == pytest.approx((100.0 + 2.0 * (conditions.columns["temperature_degC"] - 20.0)) * rms)


def test_rates_of_a_part_of_the_night_are_those_of_the_whole_with_its_history(tmp_path: Path) -> None:
    """Hysteresis and soak remember: with the earlier rows as history the later rows are the same."""
    terms = [
        {
            "effect": "hyst",
            "parameters": {"h_A": {"unit": "deg/hr", "value": 4.0}},
            "shape": {"half_width_degC": 5.0},
        },
        {
            "effect": "soak_insufficient",
            "parameters": {"b_A": {"unit": "deg/hr/degC", "value": 1.0}},
            "shape": {"tau_min": 12.0},
        },
    ]
    conditions, remembering = campaign(), model(tmp_path, terms=terms)
    rows = np.arange(len(conditions))
    head, tail = _part(conditions, rows < 40), _part(conditions, rows >= 40)
    whole = remembering.rates(conditions)
    assert remembering.rates(tail, history=head) == pytest.approx(whole[40:])
    assert not np.allclose(remembering.rates(tail), whole[40:])
    assert np.array_equal(joined(head, tail).f_g, conditions.f_g)


@pytest.mark.parametrize(
    ("effect", "name", "unit", "shape"),
    [
        ("hyst", "h_A", "deg/hr", {"half_width_degC": 5.0}),
        ("soak_insufficient", "b_A", "deg/hr/degC", {"tau_min": 12.0}),
    ],
)
def test_a_term_knows_whence_the_unit_came_where_it_says_so(
    tmp_path: Path, effect: str, name: str, unit: str, shape: dict[str, float]
) -> None:
    """The first rows are as after a row at that temperature; a file without it means that nothing is known."""
    term = {"effect": effect, "parameters": {name: {"unit": unit, "value": 1.0}}, "shape": shape}
    conditions, silent = campaign(), model(tmp_path, terms=[term])
    before = _part(conditions, np.arange(len(conditions)) == 0)
    columns = {**before.columns, "temperature_degC": np.full(1, 20.0), "setpoint_degC": np.full(1, 20.0)}
    past = replace(before, start_s=before.start_s - 7200.0, columns=columns)
    saying = model(tmp_path, terms=[{**term, "shape": {**shape, "from_degC": 20.0}}])
    assert saying.rates(conditions) == pytest.approx(silent.rates(conditions, history=past))
    assert not np.allclose(saying.rates(conditions), silent.rates(conditions))


def test_a_column_that_is_there_but_empty_contributes_nothing(tmp_path: Path) -> None:
    """Before the first setpoint there is no time since it; a column that is not there at all is refused."""
    terms = [
        {
            "effect": "soak_insufficient",
            "parameters": {"b_A": {"unit": "deg/hr/degC", "value": 1.0}},
            "shape": {"tau_min": 12.0},
        }
    ]
    soaking, conditions = model(tmp_path, terms=terms), one_run()
    empty = {**conditions.columns, "time_since_setpoint_s": np.full(3, np.nan)}
    assert soaking.rates(replace(conditions, columns=empty)) == pytest.approx(model(tmp_path).rates(conditions))
    del empty["time_since_setpoint_s"]
    with pytest.raises(InputError, match="soak_insufficient needs time_since_setpoint_s"):
        soaking.rates(replace(conditions, columns=empty))


def test_saved_models_read_back_equal(tmp_path: Path) -> None:
    """The shipped truth, and a model with terms, an empirical one among them."""
    terms = (
        Term(
            effect="empirical:MUA*supply_V",
            sensor=2,
            parameters={"q": Constant(unit="deg/hr/g per supply_V", value=1.5, se=0.2)},
            shape={"reference": 28.0},
            added={"campaign": "night", "gap_before_deg_per_hr": 3.0, "date": "1985-10-01"},
        ),
        Term(
            effect="MU_real",
            parameters={
                "MUB": Table(
                    unit="deg/hr/g", table=TableRows(temperature_degC=(0.0, 20.0), value=(1.0, 2.0), se=(0.1, 0.2))
                )
            },
        ),
    )
    truth = load_model("rd-gc-86-1-truth")
    for original in (truth, truth.model_copy(update={"terms": terms, "version": 2}), built_in_model("collins-4")):
        save_model(original, tmp_path / "again.yaml")
        assert load_model(tmp_path / "again.yaml") == original


@pytest.mark.parametrize("name", ["constant", "collins-4", "matrix-6", "matrix-6-thermal", "triad-12"])
def test_built_in_models_have_no_values(name: str) -> None:
    """They are fitted; asked for values they say so."""
    built_in = load_model(name)
    assert built_in.form == name
    assert not built_in.has_values(ROTOR)
    with pytest.raises(InputError, match=f"model {name}: it has no values for sensor 2"):
        built_in.base_at(ROTOR, np.array([20.0]))


def test_triad_model_gives_its_full_matrix(tmp_path: Path) -> None:
    """Row by channel, column by axis; not symmetric."""
    names = [f"G{row}{axis}" for row in "XYZ" for axis in "XYZ"]
    values = {f"B{axis}": {"unit": "deg/hr", "value": 10.0 * i} for i, axis in enumerate("XYZ")}
    values |= {name: {"unit": "deg/hr/g", "value": float(i)} for i, name in enumerate(names)}
    triad = load_model(
        written(tmp_path, {"schema": "hil.model/1", "title": "t", "form": "triad-12", "sensors": {1: values}})
    )
    base = triad.base_at(TRIAD, np.array([20.0]))
    assert np.allclose(base.k[0], np.arange(9.0).reshape(3, 3))
    assert np.allclose(base.bias[0], [0.0, 10.0, 20.0])
    assert triad.rates(triad_poses(every_column=False)).shape == (24, 3)


def _part(conditions, rows):  # type: ignore[no-untyped-def]
    return replace(
        conditions,
        **{
            name: getattr(conditions, name)[rows]
            for name in ("collect", "run", "position", "start_s", "duration_s", "f_g", "w_deg_per_hr")
        },
        columns={name: values[rows] for name, values in conditions.columns.items()},
    )


def test_the_example_of_the_reference_page_is_a_model(tmp_path: Path) -> None:
    """The YAML in docs/reference/model-files.md loads and can be evaluated."""
    page = Path(__file__).resolve().parents[3] / "docs" / "reference" / "model-files.md"
    example = page.read_text(encoding="utf-8").split("```yaml\n")[1].split("```")[0]
    path = tmp_path / "example.yaml"
    path.write_text(example, encoding="utf-8")
    assert np.all(np.isfinite(load_model(path).rates(campaign())))


@pytest.mark.parametrize(
    "effect", [one for one in EFFECTS if one.in_models and one.applies_to(ROTOR)], ids=lambda e: e.id
)
def test_every_effect_can_be_a_term_and_comes_out_the_same_in_pieces(effect: Effect, tmp_path: Path) -> None:
    """Typical sizes in a model file: finite, not nothing, and collect by collect with its history as all at once."""
    conditions = campaign(("1", "3", "2", "4"), temperatures=(10.0, 40.0, -20.0), runs_each=2, g=(0.99, 0.05, -0.02))
    if effect.id == "turnon":  # asked about only where the power was cycled
        conditions = power_cycled(conditions)
    values = {p.name: {"unit": p.unit, "value": p.size} for p in effect.parameters_for(conditions)}
    shape = dict(effect.shape_grid(conditions)[-1])
    simulated = model(
        tmp_path,
        sensors={2: {**_sloping(), "GSB": {"unit": "deg/hr/g", "value": -25.0}}},
        terms=[{"effect": effect.id, "parameters": values, "shape": shape}],
    )
    whole = simulated.rates(conditions)
    added = whole - simulated.model_copy(update={"terms": ()}).rates(conditions)
    assert np.all(np.isfinite(added))
    assert np.abs(added).max() > 1e-4
    rows = np.arange(len(conditions))
    for first in (9, 16):
        head, tail = _part(conditions, rows < first), _part(conditions, (rows >= first) & (rows < first + 1))
        assert simulated.rates(tail, history=head) == pytest.approx(whole[first : first + 1])


def _sloping() -> dict[str, object]:
    """The terms of a sensor whose bias follows temperature, so that a lag shows."""
    sensors = document()["sensors"]
    assert isinstance(sensors, dict)
    return {**sensors[2], "BA": {"unit": "deg/hr", "polynomial": [22.0, -0.2], "reference_degC": 25.0}}
