"""A night of the simulated bench, bytes and all, comes back as the curves that the unit was given."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from hil.cli.app import run
from hil.config import load_bench

TRUTH = {
    "BA": {"unit": "deg/hr", "polynomial": [20.0, 0.5], "reference_degC": 20.0},
    "BB": {"unit": "deg/hr", "value": -12.0},
    "GSA": {"unit": "deg/hr/g", "polynomial": [55.0, 0.0, 0.02], "reference_degC": 20.0},
    "GSB": {"unit": "deg/hr/g", "value": -25.0},
    "MUA": {"unit": "deg/hr/g", "value": 9.0},
    "MUB": {"unit": "deg/hr/g", "value": 0.0},
}


def noise() -> dict[str, object]:
    """White noise as shipped, little scatter from run to run."""
    none = {"unit": "deg/hr", "value": 0.0}
    white = {"unit": "deg/sqrt(hr)", "value": 0.12}
    walk = {"unit": "deg/hr/sqrt(hr)", "value": 0.0}
    scatter = {"BA": {"unit": "deg/hr", "value": 0.5}, "MUB": {"unit": "deg/hr/g", "value": 0.5}}
    return {
        "angle_random_walk": white,
        "bias_instability": none,
        "rate_random_walk": walk,
        "resolution_deg_per_hr": 0.01,
        "run_to_run": scatter,
    }


@pytest.mark.slow
def test_a_simulated_night_gives_back_its_truth(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Linear BA, quadratic GSA, the rest constant; every true value within its interval, widened for six at a time."""
    model = {"schema": "hil.model/1", "title": "truth", "form": "matrix-6", "sensors": {1: TRUTH, 2: TRUTH}}
    (tmp_path / "truth.yaml").write_text(yaml.safe_dump({**model, "noise": {1: noise(), 2: noise()}}))
    bench = yaml.safe_load(load_bench("simulated").text)
    bench["simulation"]["model"] = "truth"
    (tmp_path / "bench.yaml").write_text(yaml.safe_dump(bench))
    sweep = {
        "title": "Six temperatures",
        "temperatures": [f"{each} degC" for each in (-20, -5, 10, 25, 40, 55)],
        "self_calibrations_per_temperature": 2,
        "positions": [1, 2, 3],
        "restabilisation": {"at_least": "60 min", "ceiling": "8 h"},
        "collect": {"settle": "60 s", "duration": "60 s"},
    }
    (tmp_path / "sweep.yaml").write_text(yaml.safe_dump(sweep))
    sweep_file, bench_file, night = (str(tmp_path / name) for name in ("sweep.yaml", "bench.yaml", "night"))
    arguments = [sweep_file, "--bench", bench_file, "--out", night]
    assert run(["run", *arguments, "--quiet"]) == 0
    capsys.readouterr()
    assert run(["thermal", str(tmp_path / "night"), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["simulated"]
    found = next(each for each in document["sensors"] if each["sensor"] == 2)["parameters"]
    forms = {name: each["form"] for name, each in found.items()}
    assert forms == {"BA": "linear", "BB": "constant", "GSA": "quadratic"} | dict.fromkeys(
        ("GSB", "MUA", "MUB"), "constant"
    )
    for name, each in found.items():
        middle = each["reference_degC"]
        powers = TRUTH[name].get("polynomial", [TRUTH[name].get("value")])
        shifted = np.polynomial.Polynomial(powers)(np.polynomial.Polynomial([middle - 20.0, 1.0]))
        expected = shifted.coef if len(powers) > 1 else powers
        for coefficient, value in zip(each["coefficients"], expected, strict=True):
            assert abs(coefficient["value"] - value) < 4 * coefficient["se"] + 1e-9, (name, coefficient, value)
