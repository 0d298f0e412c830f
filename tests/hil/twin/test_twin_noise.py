"""What is random in the simulated unit has the stated size, follows the seed, and ignores how often it is asked."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.simulators.chambers.plant import ChamberPlant
from hil.bench import build_bench
from hil.config import Bench
from hil.model import load_model
from hil.twin import SimulatedUnit
from hil.twin.devices import SimulatedBench, simulate_devices
from hil.twin.motion import Resumed
from hil.twin.scatter import RUNS, drawn_base
from tests.hil.twin.quiet import changed_bench, quiet_bench
from tests.hil.twin.truth import truth_of

_MINUTE = 1200  # samples


def _devices(bench: Bench, **how: Any) -> SimulatedBench:
    return simulate_devices(bench, begins_s=0.0, resumed=Resumed(**how))


def _unit(bench: Bench, **how: Any) -> SimulatedUnit:
    roles = bench.frames.roles
    assert roles is not None
    assert bench.simulation_model is not None
    plant = how.pop("plant", None) or ChamberPlant(ambient_degC=23.0)
    return SimulatedUnit(bench, load_model(bench.simulation_model), roles, plant, **({"sample_rate_hz": 20.0} | how))


@pytest.mark.slow
def test_averages_scatter_by_angle_random_walk_over_root_time(tmp_path: Path) -> None:
    """N = 0.12 deg/√hr gives 0.93 deg/hr in averages of 60 s and half of that in four minutes."""
    bench = changed_bench(tmp_path, settling={"size": "0 deg/hr"}, noise={"run_to_run": False})
    unit = _unit(bench)
    minutes = 400
    signals = unit.signals(np.arange(minutes * _MINUTE) / 20.0)
    for field in ("rate_A1", "rate_B1", "rate_A2", "rate_B2"):
        means = signals[field].reshape(minutes, _MINUTE).mean(axis=1)[100:]  # after the warm-up
        slow = np.polyval(np.polyfit(np.arange(len(means)), means, 2), np.arange(len(means)))
        sigma = np.std(means - slow, ddof=3)
        assert sigma == pytest.approx(0.12 * np.sqrt(60.0), rel=0.15)
        longer = (means - slow).reshape(-1, 4).mean(axis=1)
        assert np.std(longer, ddof=1) == pytest.approx(0.12 * np.sqrt(15.0), rel=0.3)


def test_white_noise_is_white_and_independent_between_channels(tmp_path: Path) -> None:
    """No correlation from sample to sample or from channel to channel."""
    signals = _unit(changed_bench(tmp_path)).signals(6000.0 + np.arange(40000) / 20.0)
    rates = np.stack([signals[f"rate_{axis}"] for axis in ("A1", "B1", "A2", "B2")])
    rates = rates - rates.mean(axis=1, keepdims=True)
    correlation = np.corrcoef(np.concatenate([rates[:, 1:], rates[:, :-1]]))
    assert np.max(np.abs(correlation - np.eye(8))) < 5.0 / np.sqrt(40000)


def test_a_unit_beside_others_of_its_kind_is_the_same_to_the_bit(tmp_path: Path) -> None:
    """Also where one was not listened to for hours; its supply, its scatter and its position are its own."""
    bench, plant = changed_bench(tmp_path), ChamberPlant(ambient_degC=23.0)
    benches = [bench.model_copy(update={"simulation": bench.simulation.model_copy(update={"seed": n})}) for n in (1, 2)]
    first = _unit(benches[0], plant=plant)
    beside = _unit(benches[1], plant=plant, alike=first)
    plant.command(40.0, 0.0)
    alone = _unit(benches[1], plant=plant)
    for unit in (beside, alone):
        unit.start_move("2", 30.0, 35.0)
    for begin_s, end_s in ((0.0, 60.0), (60.0, 4.0 * 3600.0), (4.0 * 3600.0, 4.0 * 3600.0 + 30.0)):
        for at_s in np.arange(begin_s, end_s, 600.0):
            first.signals(np.arange(at_s, min(at_s + 600.0, end_s)))
        own, shared = (unit.signals(np.arange(begin_s, end_s)) for unit in (alone, beside))
        for field, values in own.items():
            assert np.array_equal(values, shared[field]), field


def test_slow_noise_is_there_only_when_asked_for(tmp_path: Path) -> None:
    """Bias instability and rate random walk of the model file: hours differ by much more than white noise."""
    spreads = {}
    for slow in (False, True):
        noise = {"slow": slow, "run_to_run": False}
        unit = _unit(changed_bench(tmp_path, noise=noise, start={"powered_for": "10 h"}), sample_rate_hz=1.0)
        rate = unit.signals(np.arange(20 * 3600) * 1.0)["rate_A2"]
        spreads[slow] = np.std(rate.reshape(20, -1).mean(axis=1))
    assert spreads[False] < 0.3
    assert spreads[True] > 3.0 * spreads[False]


def _night(devices: SimulatedBench, polls_s: list[float]) -> bytes:
    """Carry out the same commands with other polls between them; return every byte that was sent."""
    commands = [
        (10.0, "chamber", b"MODE,CONSTANT\r\n"),
        (12.0, "chamber", b"TEMP,S40.0\r\n"),
        (400.0, "imu", b"$MFS,INDEX,1*50\r\n"),
        (460.3, "imu", b"$MFS,INDEX,2*53\r\n"),
        (800.0, "chamber", b"TEMP,S-5.0\r\n"),
        (2000.0, "imu", b"$MFS,INDEX,1*50\r\n"),
        (2002.1, "imu", b"$MFS,INDEX,3*52\r\n"),
    ]
    events = [(at_s, device, line) for at_s, device, line in commands] + [(at_s, "poll", b"") for at_s in polls_s]
    sent = b""
    for at_s, device, line in sorted(events):
        if device == "poll":
            sent += devices.imu.transmit(at_s)
        else:
            (devices.imu if device == "imu" else devices.chamber).receive(line, at_s)
    return sent


@pytest.mark.slow
@pytest.mark.parametrize("terms", [pytest.param(False, marks=pytest.mark.slow), True])
def test_the_same_bytes_come_however_often_the_unit_is_polled(terms: bool, tmp_path: Path) -> None:
    """Every second or so, every 30 s or once: moves, ramps, slow noise and a term that remembers change nothing."""
    term = {
        "effect": "hyst",
        "parameters": {"h_A": {"unit": "deg/hr", "value": 4.0}, "h_B": {"unit": "deg/hr", "value": -3.0}},
        "shape": {"half_width_degC": 2.0},
    }
    if terms:
        bench = quiet_bench(
            tmp_path, {2: {"BA": 10.0}}, [term], noise={"slow": True, "angle_random_walk": "1 deg/sqrt(hr)"}
        )
    else:
        bench = changed_bench(tmp_path, noise={"slow": True})
    often = [*np.arange(0.97, 3000.0, 0.97 if not terms else 3.7).tolist(), 3000.0]
    bytes_ = [_night(_devices(bench), polls) for polls in (often, np.arange(30.0, 3001.0, 30.0).tolist(), [3000.0])]
    assert len(bytes_[0]) > 3000 * 20 * 59
    assert bytes_[0] == bytes_[1] == bytes_[2]


def test_the_same_seed_gives_the_same_bytes_and_another_seed_others(tmp_path: Path) -> None:
    """Also the number of an earlier part of the night: what is carried on has new noise."""
    first, again = (_night(_devices(changed_bench(tmp_path)), [3000.0]) for _ in range(2))
    assert first == again
    assert first != _night(_devices(changed_bench(tmp_path, seed=862)), [3000.0])
    assert first != _night(_devices(changed_bench(tmp_path), session=1), [3000.0])


def _runs_of(unit: SimulatedUnit, moves: list[tuple[float, str]]) -> list[int]:
    """Return after each move the self-calibration that the unit takes it to belong to: the last that has begun."""
    runs = []
    for at_s, position in moves:
        unit.start_move(position, at_s, at_s + 5.0)
        unit.signals(np.array([at_s + 5.0]))
        runs.append(max(run for run in range(1, 10) if _has_begun(unit, run)))
    return runs


def _has_begun(unit: SimulatedUnit, run: int) -> bool:
    try:
        truth_of(unit, run, 2)
    except ValueError:
        return False
    return True


def _scatter(unit: SimulatedUnit, bench: Bench, run: int, sensor: int) -> dict[str, float]:
    """Return by how much what a sensor really was differs from its model."""
    assert bench.simulation_model is not None
    truth, curves = truth_of(unit, run, sensor), load_model(bench.simulation_model).sensors[sensor]
    at = np.array([truth.temperature_degC])
    return {name: value - float(curves[name].at(at)[0]) for name, value in truth.parameters.items()}


def test_a_self_calibration_begins_with_a_return_to_a_position_after_a_rest(tmp_path: Path) -> None:
    """Re-taking a collect does not begin one, nor does a long wait before a position that is still due."""
    unit = _unit(changed_bench(tmp_path))
    unit.start_move("3", 0.0, 0.0)  # where it is at power-on
    moves = [(3000.0, "1"), (3100.0, "2"), (3150.0, "2"), (6000.0, "3"), (9000.0, "1"), (9100.0, "2"), (9200.0, "3")]
    assert _runs_of(unit, [*moves, (9300.0, "1"), (9900.0, "2"), (13000.0, "1")]) == [1, 1, 1, 1, 2, 2, 2, 2, 2, 3]


def test_run_to_run_scatter_is_part_of_the_truth_and_of_the_rates(tmp_path: Path) -> None:
    """Two self-calibrations at one temperature differ in bias and MU, not in GS."""
    unit = _unit(changed_bench(tmp_path, start={"powered_for": "10 h"}))
    _runs_of(unit, [(3000.0, "1"), (3100.0, "3"), (9000.0, "1"), (9100.0, "3")])
    unit.signals(np.array([10000.0]))
    first, second = (truth_of(unit, run, 2).parameters for run in (1, 2))
    assert {name for name in first if abs(first[name] - second[name]) > 1e-6} == {"BA", "BB", "MUA", "MUB"}
    with pytest.raises(ValueError, match=r"self-calibration 3 of the simulated unit has not begun"):
        truth_of(unit, 3, 2)


def test_run_to_run_scatter_has_the_models_size_and_correlation(tmp_path: Path) -> None:
    """Pooled sigmas and correlations of the model file, over many self-calibrations."""
    model_file = changed_bench(tmp_path).simulation_model
    assert model_file is not None
    noise = load_model(model_file).noise[2]
    sizes, factor = noise.run_to_run, noise.correlation_factor()
    drawn = [drawn_base(7, (RUNS, run, 2), sizes, factor, 20.0) for run in range(1, 2001)]
    table = {name: np.array([each[name] for each in drawn]) for name in drawn[0]}
    for name, sigma in {"BA": 1.8, "BB": 4.3, "MUA": 3.74, "MUB": 3.95}.items():
        assert np.std(table[name]) == pytest.approx(sigma, rel=0.08)
        assert abs(np.mean(table[name])) < 4.0 * sigma / np.sqrt(2000)
    for pair, rho in (("BA MUB", 0.1), ("BB MUA", -0.11), ("BA BB", 0.0)):
        first, second = pair.split()
        assert np.corrcoef(table[first], table[second])[0, 1] == pytest.approx(rho, abs=0.09)


def test_a_night_that_is_carried_on_keeps_the_scatter_of_its_self_calibrations(tmp_path: Path) -> None:
    """The fifth self-calibration is the same unit whether or not the controller died before it."""
    bench = changed_bench(tmp_path)
    straight, resumed = _unit(bench), _unit(bench, resumed=Resumed(5, session=1))
    _runs_of(straight, [(3000.0 * n + dt, position) for n in range(1, 6) for dt, position in ((0, "1"), (90, "2"))])
    _runs_of(resumed, [(3000.0, "2")])  # its second collect was the one that was lost
    for number in (1, 2):
        scatter = _scatter(straight, bench, 5, number)
        assert max(map(abs, scatter.values())) > 0.1
        assert _scatter(resumed, bench, 5, number) == pytest.approx(scatter, abs=1e-9)


def test_the_self_calibration_after_a_resumed_one_is_another_run(tmp_path: Path) -> None:
    """A controller that died between two collects does not make the unit repeat itself in the next self-calibration."""
    bench = changed_bench(tmp_path)
    straight, resumed = _unit(bench), _unit(bench, resumed=Resumed(5, ("1",), 1))
    _runs_of(straight, [(3000.0 * n + dt, position) for n in range(1, 7) for dt, position in ((0, "1"), (90, "2"))])
    assert _runs_of(resumed, [(3000.0, "2"), (6000.0, "1"), (6090.0, "2")]) == [5, 6, 6]
    assert _scatter(resumed, bench, 6, 2) == pytest.approx(_scatter(straight, bench, 6, 2), abs=1e-9)


def test_run_to_run_scatter_can_be_switched_off(tmp_path: Path) -> None:
    """Then the truth is the model."""
    bench = changed_bench(
        tmp_path, noise={"run_to_run": False}, start={"powered_for": "10 h", "temperature": "23.39 degC"}
    )
    with build_bench(bench) as live:
        live.devices.positioner.move_to("1", 60.0)
        live.devices.clock.sleep(60.0)
        live.devices.imu.read_block()
        assert live.simulators is not None
        truth = truth_of(live.simulators.unit, 1, 2)
    assert truth.temperature_degC == pytest.approx(23.39, abs=0.01)
    assert truth.parameters["BA"] == pytest.approx(17.7333, abs=0.02)
    assert truth.parameters["MUA"] == pytest.approx(9.1933, abs=0.02)
