"""A simulated bench without noise, with the coefficients and terms that a test gives."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from drivers.simulators.chambers.plant import ChamberPlant
from hil.bench import LiveBench
from hil.campaign import Conditions
from hil.config import Bench, load_bench, parse_bench
from hil.model import load_model
from hil.twin import SimulatedUnit

POSITIONS = ("1", "3", "2")
COLLECT_S, EVERY_S = 10.0, 400.0
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


def averages(bench: Bench, runs: int, **how: Any) -> dict[int, tuple[Conditions, np.ndarray]]:
    """Return by sensor the conditions and the averages of collects, (3 runs, 2), deg/hr, taken without any bytes."""
    roles = bench.frames.roles
    assert roles is not None
    assert bench.simulation is not None
    assert bench.simulation_model is not None
    plant = ChamberPlant(ambient_degC=bench.simulation.start.temperature)
    unit = SimulatedUnit(bench, load_model(bench.simulation_model), roles, plant, sample_rate_hz=1.0, **how)
    unit.signals(np.array([1.0]))
    starts, means, temperatures = [], [], []
    for row in range(runs * len(POSITIONS)):
        at_s = 300.0 + row * EVERY_S
        unit.start_move(POSITIONS[row % 3], at_s + 5.0, at_s + 10.0)
        starts.append(at_s + 260.0)
        unit.signals(starts[-1] - np.array([2.0, 1.0]))  # an angle's white noise goes on from sample to sample
        signals = unit.signals(starts[-1] + np.arange(COLLECT_S))
        means.append({name: float(values.mean()) for name, values in signals.items()})
        temperatures.append(means[-1]["rotor_2_degC"])
    label = np.tile(np.array(POSITIONS), runs)
    out = {}
    gravity, earth_rate = bench.site.gravity_g(), bench.site.earth_rate_deg_per_hr()
    for number in (1, 2):
        axes = [bench.sensors[number].built[position].axes for position in label]
        conditions = Conditions(
            bench.sensor(number),
            collect=np.arange(len(label)),
            run=np.repeat(np.arange(1, runs + 1), 3),
            position=label,
            start_s=np.array(starts),
            duration_s=np.full(len(label), COLLECT_S),
            f_g=np.array([each @ gravity for each in axes]),
            w_deg_per_hr=np.array([each @ earth_rate for each in axes]),
            columns={
                "temperature_degC": np.array(temperatures),
                "time_since_power_on_s": np.array(starts) + bench.simulation.start.powered_for,
                "time_since_index_s": np.full(len(label), 250.0),
            },
        )
        rates = np.array([[mean[f"rate_{axis}{number}"] for axis in "AB"] for mean in means])
        out[number] = conditions, rates - conditions.w_channels_deg_per_hr
    return out
