"""From the unit's truth through bytes, decoder, averages, journal and solver back to it: intervals keep their word."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import hil.night.run
from hil.bench import LiveBench, build_bench
from hil.config import load_bench, load_sweep
from hil.night import start_night
from hil.records.export import campaign_of_night
from hil.solve import solve_campaign
from tests.hil.twin.truth import truth_of

PARAMETERS = ("BA", "BB", "GSA", "GSB", "MUA", "MUB")
SEEDS = (1, 3)
RUNS = 50

SWEEP: dict[str, Any] = {
    "title": "Many self-calibrations at one temperature",
    "temperatures": ["23 degC"],
    "restabilisation": {"at_least": "30 s", "window": "30 s", "slope": "1 degC/min", "unit_slope": "1 degC/min"},
    "collect": {"settle": "30 s", "duration": "60 s"},
}


def still_bench(folder: Path) -> Path:
    """The simulated bench, warmed through, without scatter from run to run: what is left is noise within collects."""
    document = yaml.safe_load(load_bench("simulated").text)
    document["simulation"]["start"]["powered_for"] = "8 h"
    document["simulation"]["noise"]["run_to_run"] = False
    path = folder / "still.yaml"
    path.write_text(yaml.safe_dump(document))
    return path


@pytest.fixture
def benches(monkeypatch: pytest.MonkeyPatch) -> list[LiveBench]:
    """The benches that nights build, so that a test can ask the simulated unit for the truth afterwards."""
    built: list[LiveBench] = []

    def remember(*arguments: Any, **options: Any) -> LiveBench:
        built.append(build_bench(*arguments, **options))
        return built[-1]

    monkeypatch.setattr(hil.night.run, "build_bench", remember)
    return built


def pulls_of(folder: Path, benches: list[LiveBench], runs: int, seeds: Iterable[int]) -> dict[str, list[float]]:
    """Run nights of so many self-calibrations; return by how many standard errors each parameter was off."""
    sweep = folder / "sweep.yaml"
    sweep.write_text(yaml.safe_dump(SWEEP | {"self_calibrations_per_temperature": runs}))
    bench = load_bench(still_bench(folder))
    pulls: dict[str, list[float]] = {name: [] for name in PARAMETERS}
    for seed in seeds:
        night = folder / f"night-{seed}"
        assert start_night(night, load_sweep(sweep), bench, seed=seed).exit_status == 0
        simulators = benches[-1].simulators
        assert simulators is not None
        for solution in solve_campaign(campaign_of_night(night)):
            truth = truth_of(simulators.unit, 1, solution.sensor).parameters  # the same in every run
            for name in PARAMETERS:
                found = solution.parameters[name]
                assert found.value is not None
                assert found.se is not None
                pulls[name].append((found.value - truth[name]) / found.se)
    return pulls


@pytest.mark.slow(seconds=11)
@pytest.mark.timeout(600)  # two nights of fifty self-calibrations
def test_95_percent_intervals_cover_the_truth_93_to_97_percent(tmp_path: Path, benches: list[LiveBench]) -> None:
    """|estimate - truth| < 1.96 standard errors as often, per parameter, as that says; .9 of an error covers 91 %."""
    pulls = pulls_of(tmp_path, benches, RUNS, SEEDS)
    for name, values in pulls.items():
        assert len(values) == 2 * RUNS * len(SEEDS)
        assert max(map(abs, values)) < 4.0, name
        covered = float(np.mean(np.abs(values) < 1.96))
        assert 0.93 <= covered <= 0.97, f"{name}: {covered:.3f}"
        assert abs(float(np.mean(values))) < 4.0 / np.sqrt(len(values)), f"{name} is biased"
