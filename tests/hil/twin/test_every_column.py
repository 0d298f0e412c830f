"""With the same seed, a night with an effect minus the night without it is the catalogue's column: for every effect."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from hil.campaign import Campaign, Conditions, FloatArray
from hil.config.sweep import parse_sweep
from hil.errors import InputError
from hil.model import Model, load_model
from hil.model.effects.base import Effect
from hil.model.effects.catalogue import EFFECTS
from hil.night import start_night
from hil.records.export import open_source
from tests.hil.twin.quiet import quiet_bench

_SWEEP = """
title: Up and down again
temperatures: [23 degC, 35 degC, 29 degC]
self_calibrations_per_temperature: 2
positions: [1, 3, 4, 2]
restabilisation: {at_least: 15 min, window: 3 min, ceiling: 1 h, band: 2 degC, slope: 20 degC/min, unit_band: 15 degC,
  unit_slope: 20 degC/min}
collect: {settle: 60 s, duration: 20 s, drift_limit: 100000 deg/hr/min}
"""
_VALUES = {"BA": 22.0, "BB": -18.0, "GSA": 60.0, "GSB": -25.0, "MUA": 9.0, "MUB": -7.5}
# No unit has these, or no rotor: why not.
_CANNOT = {"swap": "is a mistake in a record", "vre": "needs vibration_rms_g", "g_gain": "cannot be in a sensor"}
_STEPS = 0.003  # deg/hr, of the stream


def _night(folder: Path, terms: Sequence[Any] = ()) -> tuple[Campaign, Model]:
    """Carry the sweep out on a bench without noise, through bytes."""
    folder.mkdir()
    noise = {"supply_wander": "0.3 V", "run_to_run": False, "new_run_after_rest": "2 min"}
    looks = {"noise": noise, "start": {"temperature": "20 degC"}}
    bench = quiet_bench(folder, {1: _VALUES, 2: _VALUES}, list(terms), **looks)
    path = folder / "quiet.yaml"
    leaning = {"table": {"temperature_degC": [0.0, 60.0], "value": [10.0, 40.0]}, "unit": "deg/hr"}
    document = yaml.safe_load(path.read_text())
    for number in (1, 2):
        document["sensors"][number]["BA"] = leaning
    path.write_text(yaml.safe_dump(document))
    sweep = parse_sweep(_SWEEP, "sweep.yaml")
    assert start_night(folder / "night", sweep, bench).exit_status == 0
    return open_source(folder / "night"), load_model(path)


def _term(effect: Effect, conditions: Conditions, sensor: int) -> dict[str, Any]:
    """An effect at the upper end of what is typical, each parameter a little smaller than the one before."""
    shapes = {each.name: each.grid or (1.0,) for each in effect.shapes_for(conditions)}
    shape = {name: grid[len(grid) // 2] * (1.0 if len(grid) > 1 else 1.01) for name, grid in shapes.items()}
    if "from_degC" in shape:  # rotors that were switched off, in the air in which the unit stood
        shape["from_degC"] = 12.0 if "temperature_degC" in effect.needs else 20.0
    parameters = {
        each.name: {"unit": each.unit, "value": each.typical[1] * 0.9**place}
        for place, each in enumerate(effect.parameters_for(conditions))
    }
    return {"effect": effect.id, "sensor": sensor, "shape": shape, "parameters": parameters}


def _column(effect: Effect, term: dict[str, Any], model: Model, conditions: Conditions) -> FloatArray:
    """What the catalogue says that it does to these rows, (n, c); what remembers temperature knows where it was."""
    values = [each["value"] for each in term["parameters"].values()]
    columns = effect.columns(conditions, model.base_for(conditions), term["shape"])
    return np.asarray(np.einsum("ncp,p->nc", columns, values))


@pytest.fixture(scope="module")
def without(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    """The night with nothing added."""
    return _night(tmp_path_factory.mktemp("without") / "night")[0]


_CAN = [each for each in EFFECTS if each.id not in _CANNOT]
_EXACT, _IDEAL = ([each for each in _CAN if bool(each.idealises) is idealised] for idealised in (False, True))


@pytest.mark.slow
@pytest.mark.parametrize(
    "effects",
    [*(_EXACT[k::4] for k in range(4)), *(_IDEAL[k::3] for k in range(3))],
    ids=lambda effects: "-".join(each.id for each in effects),
)
def test_night_minus_night_is_the_column(effects: list[Effect], without: Campaign, tmp_path: Path) -> None:
    """The sum of columns, within 1 % of the smallest in every collect, half of the effects in each sensor.

    An effect whose class says by what its column differs stands alone in its sensor.
    """
    terms = [(n, e, _term(e, without.sensors[n].conditions, n)) for k, e in enumerate(effects) for n in (1 + k % 2,)]
    night, model = _night(tmp_path / "with", [term for _, _, term in terms])
    for number, of in night.sensors.items():
        columns = {e.id: _column(e, term, model, of.conditions) for n, e, term in terms if n == number}
        sizes = {name: np.abs(column).max() for name, column in columns.items()}
        assert min(sizes.values()) > 10.0 * _STEPS, sizes
        off = np.abs(of.rates_deg_per_hr - without.sensors[number].rates_deg_per_hr - sum(columns.values()))
        idealises = any(each.id in columns and each.idealises for each in effects)
        # Of the first collect no campaign knows from where it was reached.
        assert off[int(idealises) :].max() <= (0.04 if idealises else 0.01) * min(sizes.values()) + _STEPS, sizes


@pytest.mark.parametrize("effect", [each for each in EFFECTS if each.id in _CANNOT], ids=lambda each: each.id)
def test_what_cannot_be_simulated_says_why_before_anything_begins(effect: Effect, tmp_path: Path) -> None:
    """A mistake in a record is no unit's, nothing vibrates here, and a rotor has no G."""
    parameters = {f"{effect.parameters[0].name}_A": {"unit": effect.parameters[0].unit, "value": 1.0}}
    with pytest.raises(InputError, match=_CANNOT[effect.id]):
        _night(tmp_path / "with", [{"effect": effect.id, "sensor": 2, "shape": {}, "parameters": parameters}])
    assert not (tmp_path / "with" / "night").exists()
