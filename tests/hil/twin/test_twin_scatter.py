"""The simulated unit scatters as its model says, effect by effect: what is stated is what the averages do."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
import yaml

from hil.campaign import FloatArray, Sensor
from hil.config import Bench
from hil.model import load_model
from hil.model.effects.catalogue import VARIANCE_EFFECTS, variance_effect_by_id
from hil.twin.motion import Resumed
from hil.twin.scatter import correlated
from tests.hil.twin.quiet import SILENT, averages, quiet_bench
from tests.hil.twin.test_twin_noise import _devices, _night

_SIZE = 3.0
_OF_A_ROTOR = [
    each.id for each in VARIANCE_EFFECTS if each.applies_to(Sensor(2, ("A", "B", "S"), {"A": "A", "B": "B"}))
]
_SHAPES = {"markov": {"tau_hr": 1.0}, "noise_T": {"at_degC": -4.0}}
_COLD = {  # where frost and retainer noise are at work
    "start": {"temperature": "-4 degC", "powered_for": "10 h"},
    "noise": SILENT | {"new_run_after_rest": "100 s"},
}


def scattering(effect: str) -> dict[str, Any]:
    """Return the entry of a model's noise section for an effect, of size 3 in its unit."""
    parameter = variance_effect_by_id(effect).parameters[0]
    size = {"effect": effect, "parameters": {parameter.name: {"unit": parameter.unit, "value": _SIZE}}}
    return {**size, "shape": _SHAPES.get(effect, {})}


def scattering_bench(
    folder: Path, entries: list[dict[str, Any]], stated: Mapping[str, Any] = MappingProxyType({}), **simulation: Any
) -> Bench:
    """Return a bench that is quiet but for what the entries scatter, the same in both sensors."""
    bench = quiet_bench(folder, {}, None, **simulation)
    path = folder / "quiet.yaml"
    noise = {"noise": {number: {"scatter": entries, **stated} for number in (1, 2)}}
    path.write_text(yaml.safe_dump(yaml.safe_load(path.read_text()) | noise))
    return bench


def misfit(folder: Path, effect: str, seeds: int, runs: int) -> tuple[FloatArray, FloatArray]:
    """Return chi² under the model's own covariance over its degrees of freedom, by rows and by run; and 5 sigma of it.

    Whitened rows are all the same, so that runs which should differ and do not show in their sum over runs. What the
    covariance says cannot scatter must not: it would count as a misfit without bounds.
    """
    total, degrees = np.zeros(2), np.zeros(2)
    for seed in range(seeds):
        bench = scattering_bench(folder, [scattering(effect)], seed=seed, **_COLD)
        assert bench.simulation_model is not None
        model = load_model(bench.simulation_model)
        for conditions, rates in averages(bench, runs).values():
            stated = sum(part.covariance(conditions) for part in model.stated_scatter(conditions))
            if effect == "rrw":  # stated from the first row on; until then it has walked already
                rates = rates - rates[0]
            values, vectors = np.linalg.eigh(stated)
            along, real = rates.ravel() @ vectors, values > 1e-6 * values.max()
            assert np.abs(along[~real]).max(initial=0.0) < 1e-3 * np.sqrt(values.max())
            white = vectors[:, real] @ (along[real] / np.sqrt(values[real]))
            over_runs = np.tile(np.eye(6), runs) / np.sqrt(runs)
            total += np.sum(white**2), np.sum((over_runs @ white) ** 2)
            degrees += real.sum(), np.sum((over_runs @ vectors[:, real]) ** 2)
            if variance_effect_by_id(effect).common_to_sensors:
                break  # the other sensor shows the same
    return total / degrees, 5.0 * np.sqrt(2.0 / degrees)


@pytest.mark.parametrize("effect", _OF_A_ROTOR)
def test_averages_scatter_as_the_model_states(effect: str, tmp_path: Path) -> None:
    """Every effect by its id: its size, which rows it joins, how long it remembers."""
    found, allowed = misfit(tmp_path, effect, *((5, 1) if effect == "turnon" else (1, 8)))
    assert np.all(np.abs(found - 1.0) < allowed)


@pytest.mark.slow
@pytest.mark.parametrize("effect", _OF_A_ROTOR)
def test_averages_scatter_as_the_model_states_over_many_nights(effect: str, tmp_path: Path) -> None:
    """To a seventh and better."""
    found, allowed = misfit(tmp_path, effect, *((60, 2) if effect == "turnon" else (10, 12)))
    assert np.all(np.abs(found - 1.0) < allowed)


def test_what_wanders_is_handed_on_wherever_it_is_interrupted() -> None:
    """Half of what it was, and what is new; nothing asked for is nothing."""
    steps, before = np.array([[1.0, 0.0], [0.0, 4.0], [2.0, 0.0]]), np.array([4.0, -8.0])
    np.testing.assert_array_equal(correlated(0.5, steps, before), [[3.0, -4.0], [1.5, 2.0], [2.75, 1.0]])
    np.testing.assert_array_equal(correlated(0.5, steps[2:], np.array([1.5, 2.0])), [[2.75, 1.0]])
    assert correlated(0.5, steps[:0], before).shape == (0, 2)


def test_what_moves_the_base_is_the_same_in_both_sensors(tmp_path: Path) -> None:
    """Turned into the axes of the bench; what wanders in each sensor by itself is not."""
    shared = {}
    for effect in ("base", "markov"):
        found = averages(scattering_bench(tmp_path, [scattering(effect)], **_COLD), 4)
        shared[effect] = float(np.corrcoef(found[1][1][:, 1], found[2][1][:, 1])[0, 1])
    assert abs(shared["base"]) > 0.99
    assert abs(shared["markov"]) < 0.99


def test_scatter_of_one_effect_does_not_depend_on_what_else_scatters(tmp_path: Path) -> None:
    """Every term has its own stream: with another before it, it draws the same; an unmentioned one draws nothing."""
    alone, other, both = (
        averages(scattering_bench(tmp_path, [scattering(each) for each in ids], **_COLD), 3)[2][1]
        for ids in (["markov"], ["MU_rr"], ["MU_rr", "markov"])
    )
    assert both == pytest.approx(alone + other, abs=1e-9)
    assert averages(scattering_bench(tmp_path, [], **_COLD), 3)[2][1] == pytest.approx(0.0, abs=1e-9)


def test_the_bytes_of_a_scattering_unit_do_not_depend_on_how_often_it_is_polled(tmp_path: Path) -> None:
    """All effects at once, two of them twice; a later part of the night gives other bytes."""
    entries = [scattering(each) for each in (*_OF_A_ROTOR, "markov", "arw")]
    bench = scattering_bench(tmp_path, entries)
    often = [*np.arange(397.0, 470.0, 3.7).tolist(), 480.0]
    first, again, later = (
        _night(_devices(bench, session=session), [380.0, *polls])
        for session, polls in ((0, often), (0, [480.0]), (1, often))
    )
    assert first == again
    assert first != later


def test_a_night_that_is_carried_on_keeps_what_is_drawn_by_run(tmp_path: Path) -> None:
    """The third self-calibration reseats as it would have; what wanders begins anew."""
    bench = scattering_bench(tmp_path, [scattering("MU_rr")], **_COLD)
    straight, resumed = averages(bench, 4)[2][1], averages(bench, 2, resumed=Resumed(3, session=1))[2][1]
    assert resumed == pytest.approx(straight[6:], abs=1e-9)


@pytest.mark.slow
def test_what_changes_from_collect_to_collect_is_the_same_within_one(tmp_path: Path) -> None:
    """A bias of its own in every stay of every sensor, as large as stated; the same for one seed, another for another.

    A night that is carried on draws anew: a collect that is done again is another.
    """
    stated = {"collect_to_collect": {"BA": {"unit": "deg/hr", "value": _SIZE}}}

    def rates(seed: int = 1, **how: Any) -> FloatArray:
        bench = scattering_bench(tmp_path, [], stated, seed=seed, **_COLD)
        return np.concatenate([each[1] for _, each in sorted(averages(bench, 12, **how).items())])

    found = rates()
    assert np.abs(found[:, 1]).max() < 1e-9
    assert len(np.unique(np.round(found[:, 0], 6))) == len(found)
    assert np.std(found[:, 0]) == pytest.approx(_SIZE, rel=0.3)
    assert np.array_equal(found, rates())
    for other in (rates(seed=2), rates(resumed=Resumed(session=1))):
        assert abs(np.corrcoef(found[:, 0], other[:, 0])[0, 1]) < 0.5
    bench = scattering_bench(tmp_path, [], stated, **_COLD)
    often = [*np.arange(397.0, 470.0, 3.7).tolist(), 480.0]
    assert _night(_devices(bench), [380.0, *often]) == _night(_devices(bench), [380.0, 480.0])


def test_a_model_that_states_only_scatter_keeps_the_white_noise_of_the_bench(tmp_path: Path) -> None:
    """The bench's is for sensors of which the model states none."""
    noise = SILENT | {"angle_random_walk": "1 deg/sqrt(hr)"}
    stating = {"angle_random_walk": {"unit": "deg/sqrt(hr)", "value": 0.0}}
    spread = []
    for stated in ({}, stating):
        bench = scattering_bench(tmp_path, [scattering("turnon")], stated, noise=noise)
        spread.append(float(np.std(averages(bench, 4)[2][1], axis=0).max()))
    assert spread[0] == pytest.approx(60.0 / np.sqrt(10.0), rel=0.6)
    assert spread[1] < 1e-9
