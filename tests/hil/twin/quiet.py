"""A simulated bench without noise, with the coefficients and terms that a test gives."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from hil.bench import LiveBench
from hil.config import Bench, load_bench, parse_bench

NAMES = ("BA", "BB", "GSA", "GSB", "MUA", "MUB")
SILENT: dict[str, Any] = {
    "angle_random_walk": "0 deg/sqrt(hr)",
    "accelerometers": "0 g",
    "thermometers": "0 degC",
    "supply": "0 V",
    "supply_wander": "0 V",
}


def changed_bench(folder: Path, **simulation: Any) -> Bench:
    """Return the shipped simulated bench with entries of its simulation section replaced or merged."""
    document = yaml.safe_load(load_bench("simulated").text)
    for key, value in simulation.items():
        section = document["simulation"].get(key)
        document["simulation"][key] = {**section, **value} if isinstance(section, dict) else value
    return parse_bench(yaml.safe_dump(document), str(folder / "bench.yaml"))


def quiet_bench(
    folder: Path, values: dict[int, dict[str, float]], terms: list[dict[str, Any]] | None = None, **simulation: Any
) -> Bench:
    """Return a bench without noise and settling whose sensors have constant coefficients; those not given are zero."""
    sensors = {
        number: {
            name: {"unit": "deg/hr" if name[0] == "B" else "deg/hr/g", "value": values.get(number, {}).get(name, 0.0)}
            for name in NAMES
        }
        for number in (1, 2)
    }
    model = {"schema": "hil.model/1", "title": "quiet", "form": "matrix-6", "sensors": sensors, "terms": terms or []}
    (folder / "quiet.yaml").write_text(yaml.safe_dump(model))
    entries: dict[str, Any] = {"model": "quiet", "noise": SILENT, "settling": {"size": "0 deg/hr"}}
    return changed_bench(folder, **(entries | simulation))


def collect(live: LiveBench, position: str, settle_s: float = 30.0, duration_s: float = 10.0) -> dict[str, float]:
    """Index to a position, settle, and return the mean of every decoded field."""
    clock = live.devices.clock
    live.devices.positioner.move_to(position, timeout_s=60.0)
    clock.sleep(settle_s)
    live.devices.imu.discard()
    clock.sleep(duration_s)
    block = live.devices.imu.read_block()
    assert block.counts.ok == len(block) > 0
    return {name: float(np.mean(values)) for name, values in block.fields.items() if re.match("[a-z]", name)}
