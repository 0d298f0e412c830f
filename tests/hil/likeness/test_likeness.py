"""hil twin: the same night again, through bytes; what was simulated is kept, and a campaign's plan is inferred."""

from __future__ import annotations

import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml

from benchmarks.blind.cases import make_case, write_case
from benchmarks.blind.night import Design
from benchmarks.blind.poses import write_triad
from hil.config import load_bench, load_sweep
from hil.config.recorded import configuration_of, configuration_text
from hil.config.sweep import parse_sweep
from hil.errors import InputError
from hil.likeness import draws, likeness
from hil.likeness.again import configuration
from hil.likeness.features import RESOLUTION, features
from hil.model import Model, load_model
from hil.night import start_night
from hil.records.export import export_campaign, open_source
from tests.hil.short_sweeps import short_sweep
from tests.hil.twin.test_twin_scatter import scattering

TRUTH = "rd-gc-86-1-truth"


@pytest.fixture(scope="module")
def night(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short night, two positions."""
    folder = tmp_path_factory.mktemp("night") / "night"
    sweep = parse_sweep(short_sweep(self_calibrations=2), "sweep.yaml")
    assert start_night(folder, sweep, load_bench("simulated")).exit_status == 0
    return folder


def ask(folder: Path, keep: Path, model: Model | str = TRUTH, **how: Any) -> dict[str, Any]:
    """Ask with few draws, in this process."""
    chosen = load_model(model) if isinstance(model, str) else model
    return likeness(folder, chosen, **{"draws": 3, "keep": keep, "workers": 1, **how})


@pytest.mark.slow
def test_draws_are_kept_and_not_simulated_again(night: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever was interrupted goes on, to the same result; another model, or seed, is simulated anew."""
    first = ask(night, tmp_path)
    assert first["schema"] == "hil.twin/1"
    assert set(first["parts"]) == {"averages", "run_scatter", "series", "conditions"}
    assert all(0.0 < each <= 1.0 for each in first["parts"].values())
    assert [json.loads(path.read_text())["simulated"] for path in sorted(tmp_path.iterdir())] == [True] * 3
    kept = [json.loads(key) for key in json.loads((tmp_path / "draw-0003.json").read_text())["numbers"]]
    assert not [name for part, _, name in kept if part == "averages" and name.split("_")[-1] in RESOLUTION]
    (tmp_path / "draw-0003.json").unlink()
    began: list[int] = []

    def counted(*given: Any, **options: Any) -> Any:
        began.append(options["seed"])
        if len(began) > 1:
            raise KeyboardInterrupt
        return start_night(*given, **options)

    monkeypatch.setattr(draws, "start_night", counted)
    assert ask(night, tmp_path) == first
    assert len(began) == 1
    for other in ({"seed": 2}, {"model": load_model(TRUTH).model_copy(update={"noise": {}})}):
        with pytest.raises(KeyboardInterrupt):
            ask(night, tmp_path, **other)


def test_that_a_night_was_interrupted_tells_it_from_no_other(tmp_path: Path) -> None:
    """An hour between two of its runs is no condition of its model; an hour between all of them is."""
    source = open_source(write_case(make_case(1, ("k2",), d=0.01), tmp_path / "campaign"))
    form = load_model("matrix-6")

    def late(*runs: int) -> dict[str, float]:
        sensors = {}
        for number, collects in source.sensors.items():
            rows = collects.conditions
            by = 3600.0 * np.isin(rows.run, runs) * (1.0 + np.searchsorted(runs, rows.run))
            since = {"time_since_setpoint_s": rows.columns["time_since_setpoint_s"] + by}
            late = replace(rows, start_s=rows.start_s + by, columns={**rows.columns, **since})
            sensors[number] = replace(collects, conditions=late)
        laid = replace(source, sensors=sensors)
        found = features(laid, form, calibrated=True)
        return {key: value for key, value in found.items() if json.loads(key)[0] == "conditions"}

    plain = late()
    floor = {key: RESOLUTION.get(key.rstrip('"]').split("_")[-1], 0.01) for key in plain}
    assert max(abs(value - plain[key]) / floor[key] for key, value in late(11).items()) < 2.0
    assert max(abs(value - plain[key]) / floor[key] for key, value in late(*range(2, 25)).items()) > 10.0


@pytest.mark.slow
def test_what_every_command_leaves_out_is_compared_with_nothing(
    night: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run that its own samples contradict: it is told, and no night is asked for it. Nor for a unit's temperature.

    Nor for a row that the search alone left out.
    """
    export_campaign(night, tmp_path / "campaign")
    table = tmp_path / "campaign" / "collects.csv"
    (tmp_path / "campaign" / "series" / "0003.csv").unlink()
    head, *rows = csv.reader(table.read_text().splitlines())
    for row in rows:
        if (row[head.index("sensor")], row[head.index("collect")]) == ("1", "3"):
            row[head.index("RA_deg_per_hr")] = str(float(row[head.index("RA_deg_per_hr")]) + 400.0)
        if (row[head.index("sensor")], row[head.index("run")]) == ("2", "2"):
            row[head.index("RA_deg_per_hr")] = str(float(row[head.index("RA_deg_per_hr")]) + 400.0)
    head[head.index("temperature_degC")] = "remark"  # the chamber's stands in for it, which the model asks for
    table.write_text("\n".join(",".join(row) for row in (head, *rows)) + "\n")

    def copied(folder: Path, *_: Any, **__: Any) -> SimpleNamespace:
        shutil.copytree(night, folder)
        return SimpleNamespace(exit_status=0)

    monkeypatch.setattr(draws, "start_night", copied)
    off = {"sensor": 1, "run": 1, "collects": [3], "channels": ["RA"], "done": "mended", "why": "it is off"}
    found = ask(tmp_path / "campaign", tmp_path / "kept", wrong=[off])
    assert found["runs_not_used"] == {"2": [2]}
    assert found["rows"] == [{**off, "done": "left out"}]
    doubted = ask(tmp_path / "campaign", tmp_path / "kept", wrong=[{**off, "done": "used"}])
    assert doubted["parts"]["run_scatter"] < 1e-3
    # The same collects of the same night; of what is inside them the last digit depends on where an array begins.
    assert found["parts"]["averages"] == found["parts"]["run_scatter"] == 1.0


@pytest.mark.slow
def test_of_several_units_one_is_simulated_by_itself(tmp_path: Path) -> None:
    """Its own bench, and what it has for itself."""
    assert start_night(tmp_path / "four", load_sweep("quick"), load_bench("simulated-four")).exit_status == 0
    own = tmp_path / "four" / "units" / "SIM-0002"
    document, assumed = configuration(own, open_source(own))
    assert not assumed
    model = Path(load_bench("simulated").simulation_model or "").read_text()
    bench, _ = configuration_of(yaml.safe_dump({**document, "model": model}), tmp_path / "files")
    assert (bench.unit.serial, bench.units) == ("SIM-0002", {})


def test_too_few_draws_and_a_model_that_is_no_ones_are_refused(night: Path, tmp_path: Path) -> None:
    """In a sentence, before anything is simulated."""
    with pytest.raises(InputError, match="3 at least"):
        ask(night, tmp_path / "kept", draws=2)
    with pytest.raises(InputError, match="triad"):
        ask(night, tmp_path / "kept", "triad-12")
    assert not (tmp_path / "kept").exists()


def test_the_plan_of_a_campaign_is_inferred_from_its_collects(tmp_path: Path) -> None:
    """Temperatures, runs, positions and times; and at each position the gravity and earth rate that were given."""
    design = Design(temperatures_degC=(23.0, 40.0), runs_per_temperature=2, positions=("1", "3", "4", "2"))
    source = open_source(folder := write_case(make_case(1, design=design), tmp_path / "campaign"))
    document, assumed = configuration(folder, source)
    assert assumed
    model = Path(load_bench("simulated").simulation_model or "").read_text()
    bench, sweep = configuration_of(yaml.safe_dump({**document, "model": model}), tmp_path / "files")
    assert (sweep.positions, sweep.self_calibrations_per_temperature) == (("1", "3", "4", "2"), 2)
    rows = source.sensors[2].conditions
    assert sweep.collect.duration_s == rows.duration_s[0]
    inside = rows.columns["temperature_degC"]
    warm = [float(np.mean(inside[rows.run < 3])), float(np.mean(inside[rows.run > 2]))]
    assert sweep.temperatures == pytest.approx(warm, abs=0.06)
    gravity, earth = bench.site.gravity_g(), bench.site.earth_rate_deg_per_hr()
    for row, position in enumerate(rows.position.tolist()):
        lies = bench.sensors[2].built[position]
        assert lies.components(gravity) == pytest.approx(rows.f_g[row], abs=1e-3)
        assert lies.components(earth) == pytest.approx(rows.w_deg_per_hr[row], abs=0.02)
    for kept in (slice(1, None), slice(1, None, 3)):  # one collect is missing; hardly any run has the same
        own = {2: source.sensors[2].rows(np.arange(len(rows))[kept])}
        lacking = replace(source, folder=tmp_path, sensors=own)
        if kept.step is None:
            assert configuration(tmp_path, lacking)[0]["sweep"]["positions"] == document["sweep"]["positions"]
            continue
        with pytest.raises(InputError, match="no plan can be inferred: it takes the same collects in most runs"):
            configuration(tmp_path, lacking)
    uneven = replace(source, folder=tmp_path, sensors={2: source.sensors[2].rows(np.flatnonzero(rows.run > 1))})
    with pytest.raises(InputError, match=r"it takes as many runs at most temperatures \(1, 2\)$"):
        configuration(tmp_path, uneven)


@pytest.mark.slow
def test_a_night_of_a_real_bench_is_simulated_on_its_own_chamber_and_unit(night: Path, tmp_path: Path) -> None:
    """Other ports, a clock that jumps, nobody told and nothing failing; and somebody who turns the unit as asked."""
    bench = yaml.safe_load(load_bench("simulated").text)
    bench["imu"]["positioner"] = "operator"
    bench["faults"] = [{"device": "imu", "kind": "silence", "at": "identify", "for": "10 h"}]
    text = configuration_text(load_bench("simulated"), parse_sweep(short_sweep(), "sweep.yaml"))
    document = yaml.safe_load(text) | {"bench": bench}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hil.likeness.again.understood", lambda _: document)
        told, assumed = configuration(night, open_source(night))
        assert not assumed
        assert "faults" not in told["bench"]
        found = ask(night, tmp_path / "kept")
    assert found["p_value"] > 0.0


def test_where_nothing_tells_a_temperature_none_is_named(tmp_path: Path) -> None:
    """Nobody set 0 °C, nor measured it: a place is a position, and what stands by temperature is of them all."""
    source = open_source(write_case(make_case(1), tmp_path / "campaign"))
    rows = source.sensors[2].conditions
    unknown = replace(source.sensors[2], conditions=replace(rows, columns={}))
    form = Model(schema="hil.model/1", title="the report's", form="matrix-6")
    numbers = features(replace(source, sensors={2: unknown}), form, calibrated=False)
    told = [where for _, where, _ in map(json.loads, numbers)]
    assert {"channel", "position"} == {name for where in told for name in where} - {"sensor"}
    assert json.dumps(["conditions", {"sensor": 2}, "duration_s"]) in numbers


def test_what_sensors_have_in_common_is_drawn_once_for_all(tmp_path: Path) -> None:
    """Frost, and the pier that moves: as the simulated bench has it. What wanders in each sensor is its own."""
    source = open_source(write_case(make_case(1), tmp_path / "campaign"))
    rows = replace(source.sensors[2], rates_se_deg_per_hr=np.zeros_like(source.sensors[2].rates_deg_per_hr))
    first = replace(rows, conditions=replace(rows.conditions, sensor=replace(rows.conditions.sensor, number=1)))
    source = replace(source, sensors={1: first.rows(np.arange(len(rows)) % 5 > 0), 2: rows})
    shared = {}
    for effect in ("frost", "base", "markov"):
        noise = {number: {"scatter": [scattering(effect)]} for number in (1, 2)}
        document = load_model(TRUTH).model_dump(by_alias=True, exclude_unset=True)
        model = Model.model_validate({**document, "noise": noise})
        drawn = draws.night_of_averages(source, model, np.random.default_rng(1)).sensors
        one, two = (own.rates_deg_per_hr - model.rates(own.conditions) for own in drawn.values())
        shared[effect] = np.allclose(one, two[np.arange(len(rows)) % 5 > 0])
        assert np.abs(one).max() > 0.1
    assert shared == {"frost": True, "base": True, "markov": False}


@pytest.mark.slow(seconds=8)
def test_a_triads_campaign_is_told_from_the_model_that_lacks_its_sensitivity(tmp_path: Path) -> None:
    """By hand or by another program: whatever the axes are called, with the full matrix it cannot be told."""
    write_triad(1, 60.0, tmp_path / "campaign")
    assert ask(tmp_path / "campaign", tmp_path / "with", "triad-12")["p_value"] > 0.01
    assert ask(tmp_path / "campaign", tmp_path / "without", "constant", draws=5)["p_value"] < 0.001
