"""A model file with named terms drives the simulated unit: what reconcile adds shows in the bytes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.bench import build_bench
from hil.errors import InputError
from hil.model import load_model
from hil.model.effects.catalogue import effect_by_id
from hil.model.effects.thermal import Hysteresis
from tests.hil.twin.quiet import EVERY_S, SILENT, averages, collect, quiet_bench


def _term(
    effect: str, sensor: int | None = 2, shape: dict[str, float] | None = None, **values: tuple[str, float]
) -> Any:
    parameters = {name: {"unit": unit, "value": value} for name, (unit, value) in values.items()}
    term: dict[str, Any] = {"effect": effect, "parameters": parameters, "shape": shape or {}}
    return term if sensor is None else term | {"sensor": sensor}


def _difference(folder: Path, term: Any, **how: Any) -> dict[str, dict[str, float]]:
    """Return by position what a term adds to the mean of every field."""
    means: dict[bool, dict[str, dict[str, float]]] = {}
    for with_term in (False, True):
        bench = quiet_bench(folder, {2: {"BA": 10.0, "GSA": 60.0}}, [term] if with_term else None)
        with build_bench(bench) as live:
            means[with_term] = {position: collect(live, position, **how) for position in ("1", "2", "3", "4")}
    return {
        position: {name: value - means[False][position][name] for name, value in fields.items()}
        for position, fields in means[True].items()
    }


@pytest.mark.slow
def test_an_even_g_squared_term_has_its_own_pattern_over_the_positions(tmp_path: Path) -> None:
    """kSS·fS²: in Collects 3 and 4 alike, where MU changes sign; and only on the sensor that has it."""
    added = _difference(tmp_path, _term("k2", kSS_A=("deg/hr/g^2", 5.0)))
    assert [added[p]["rate_A2"] for p in "1234"] == pytest.approx([0.0, 0.0, 5.0, 5.0], abs=0.01)
    assert all(abs(added[p][name]) < 0.002 for p in "1234" for name in ("rate_B2", "rate_A1", "rate_B1"))


def _half_an_hour(folder: Path, terms: list[Any]) -> np.ndarray:
    with build_bench(quiet_bench(folder, {}, terms)) as live:
        live.devices.clock.sleep(1800.0)
        return np.asarray(live.devices.imu.read_block().fields["rate_A2"])


def test_a_warm_up_term_dies_away_with_time_since_power_on(tmp_path: Path) -> None:
    """W·exp(-t/τ) with τ = 8 min, sample by sample."""
    term = _term("warmup", W_A=("deg/hr", 50.0), W_B=("deg/hr", 0.0), shape={"tau_min": 8.0})
    added = _half_an_hour(tmp_path, [term]) - _half_an_hour(tmp_path, [])
    times_s = np.arange(len(added)) / 20.0
    np.testing.assert_allclose(added, 50.0 * np.exp(-times_s / 480.0), atol=0.3)


def test_the_first_setpoint_is_a_step_from_the_air_as_it_was(tmp_path: Path) -> None:
    """Nobody commanded the 23 °C in which the unit stood; what is left of the step to 60 °C dies away all the same."""
    term, read = _term("soak_insufficient", b_A=("deg/hr/degC", 1.0), shape={"tau_min": 8.0}), []
    for terms in ([term], []):
        with build_bench(quiet_bench(tmp_path, {}, terms)) as live:
            live.devices.chamber.prepare()
            live.devices.chamber.set_temperature(60.0)
            live.devices.imu.discard()
            live.devices.clock.sleep(1800.0)
            read.append(np.asarray(live.devices.imu.read_block().fields["rate_A2"]))
    times_s = np.arange(len(read[0])) / 20.0
    np.testing.assert_allclose((read[0] - read[1])[200:], (37.0 * np.exp(-times_s / 480.0))[200:], atol=0.5)


def test_a_term_on_no_sensor_in_particular_acts_on_both(tmp_path: Path) -> None:
    """A cause outside the sensors: the supply."""
    added = _difference(tmp_path, _term("warmup", None, {"tau_min": 8.0}, W_A=("deg/hr", 50.0), W_B=("deg/hr", 50.0)))
    values = [added["1"][name] for name in ("rate_A1", "rate_B1", "rate_A2", "rate_B2")]
    assert min(values) > 30.0
    assert values == pytest.approx([values[0]] * 4, abs=0.01)


def test_the_rates_of_a_still_unit_are_the_models_own(tmp_path: Path) -> None:
    """With or without a term of size zero, two ways of computing give the same bytes to a thousandth."""
    added = _difference(tmp_path, _term("k2", kSS_A=("deg/hr/g^2", 0.0)))
    assert max(abs(value) for fields in added.values() for value in fields.values()) < 0.0015


def test_a_model_without_values_cannot_drive_the_unit(tmp_path: Path) -> None:
    """It is fitted to data, and has none to give."""
    bench = quiet_bench(tmp_path, {})
    (tmp_path / "quiet.yaml").write_text("schema: hil.model/1\ntitle: empty\nform: matrix-6\n")
    assert load_model(tmp_path / "quiet.yaml").title == "empty"
    with pytest.raises(InputError, match=r"quiet\.yaml: sensors\.1: missing: .* values"):
        build_bench(bench)


def test_a_model_that_does_not_fit_the_bench_is_refused_before_anything_begins(tmp_path: Path) -> None:
    """The names of axes are the bench's: file and key, and which names there are."""
    bench = quiet_bench(tmp_path, {}, [_term("vre", K_v_C=("deg/hr/g^2", 1.0))])
    with pytest.raises(InputError, match=r"quiet\.yaml: terms\.0\.parameters\.K_v_C: .*it has K_v_A, K_v_B"):
        build_bench(bench)


def test_a_warm_up_counts_from_power_on_not_from_the_nights_beginning(tmp_path: Path) -> None:
    """A unit that was on for 8 minutes has lost 1/e of it already."""
    term = _term("warmup", W_A=("deg/hr", 50.0), W_B=("deg/hr", 0.0), shape={"tau_min": 8.0})
    first = []
    for terms in ([term], []):
        with build_bench(quiet_bench(tmp_path, {}, terms, start={"powered_for": "8 min"})) as live:
            live.devices.clock.sleep(2.0)
            first.append(live.devices.imu.read_block().fields["rate_A2"][0])
    assert first[0] - first[1] == pytest.approx(50.0 / np.e, abs=0.2)


@pytest.mark.parametrize(
    ("effect", "parameter", "unit", "shape"),
    [
        ("drift", "d_A", "deg/hr/collect", {"interval_s": EVERY_S, "middle": 1.0}),
        ("settle", "S_A", "deg/hr", {"tau_s": 200.0}),
        ("ageing", "a_A", "deg/hr/day", {}),
        ("jump", "J_A", "deg/hr", {"from_run": 2.0, "runs_held": 1.0}),
        ("hyst", "h_A", "deg/hr", {"half_width_degC": 3.0}),
    ],
)
def test_what_remembers_does_in_the_unit_what_its_column_says(
    effect: str, parameter: str, unit: str, shape: dict[str, float], tmp_path: Path
) -> None:
    """To 1 % over three self-calibrations after power-on, but for what the column's class says that it idealises."""
    noise = SILENT | {"new_run_after_rest": "100 s"}
    terms = [_term(effect, shape=shape, **{parameter: (unit, 100.0)})]
    (conditions, with_it), (_, without) = (
        averages(quiet_bench(tmp_path, {}, given, noise=noise), 3)[2] for given in (terms, [])
    )
    catalogued = effect_by_id(effect)
    column = 100.0 * catalogued.columns(conditions, None, shape)[:, 0, 0]
    known = slice(1, None) if effect == "settle" else slice(None)  # from where the first was reached is not recorded
    if isinstance(catalogued, Hysteresis):
        assert column[0] == 0.0  # as if it had rested there for ever, but it came from 15 °C
        came = conditions.rows(np.array([0, *range(len(conditions))]))
        came.columns["temperature_degC"][0] = 15.0
        column = 100.0 * catalogued.columns(came, None, shape)[1:, 0, 0]
    assert np.abs(column).max() > 0.1
    np.testing.assert_allclose((with_it - without)[known, 0], column[known], rtol=0.01, atol=0.01)
