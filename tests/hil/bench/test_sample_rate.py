"""Time, through bytes: a unit at another rate; a counter or a clock that is not what its description says."""

from __future__ import annotations

import re
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.frames.description import StreamDescription
from drivers.frames.layout import encode
from drivers.imu import SampleBlock
from drivers.imu.stream import StreamImu
from drivers.simulators.unit import SimulatedImu
from hil.bench import assemble
from hil.bench.decode import decode_file, load_frames_named
from hil.bench.preflight import Finding, preflight
from hil.config import Bench, load_bench, parse_bench, parse_sweep
from hil.files.strict import find_config
from hil.night import start_night
from hil.night.replay import replay_night
from hil.records import open_readonly
from hil.report.night import night_content
from hil.report.page import stream_in_words
from hil.twin import devices
from tests.hil.short_sweeps import short_sweep

SWEEP = short_sweep("settle: 5 s, duration: 60 s, attempts: 1")


def bench_at(read_interval: str = "30 s", description: str = "mfs") -> Bench:
    """Return the simulated bench, looked at so often."""
    text = load_bench("simulated").text.replace("read_interval: 30 s", f"read_interval: {read_interval}")
    return parse_bench(text.replace("description: mfs", f"description: {description}"), "bench.yaml")


@pytest.fixture
def unit_at(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The rate at which the unit really sends: put one in."""
    rate: list[float] = []

    class Another(SimulatedImu):
        def __init__(self, said: StreamDescription, *arguments: Any, **options: Any) -> None:
            super().__init__(said.model_copy(update={"sample_rate_hz": rate[0]}), *arguments, **options)

    monkeypatch.setattr(devices, "SimulatedImu", Another)
    return rate


@pytest.mark.parametrize(
    ("hz", "n", "verdict", "read_interval"),
    [
        (10.0, 600, "INCONCLUSIVE", "30 s"),
        (19.0, 1140, "MARGINAL", "30 s"),
        (40.0, 2400, "INCONCLUSIVE", "30 s"),
        pytest.param(10.0, 600, "INCONCLUSIVE", "0.5 s", marks=pytest.mark.slow),
        pytest.param(1.0, 60, "INCONCLUSIVE", "0.5 s", marks=pytest.mark.slow),
        pytest.param(200.0, 12000, "INCONCLUSIVE", "5 s", marks=pytest.mark.slow),
        pytest.param(19.5, 1170, "MARGINAL", "5 s", marks=pytest.mark.slow),
        pytest.param(40.0, 2400, "INCONCLUSIVE", "0.5 s", marks=pytest.mark.slow),
    ],
)
def test_a_unit_at_another_rate_is_said_to_send_at_that_rate(
    tmp_path: Path, unit_at: list[float], hz: float, n: int, verdict: str, read_interval: str
) -> None:
    """Half, double or a little off: its rate is named, it turns and is sampled, and no collect of it is PASS."""
    unit_at.append(hz)
    assert start_night(tmp_path / "n", parse_sweep(SWEEP, "s.yaml"), bench_at(read_interval)).state == "complete"
    with open_readonly(tmp_path / "n") as journal:
        collects = [each for key, each in journal.completed().items() if key.endswith("collect")]
        kinds = [event.kind for event in journal.events()]
    assert [each.data["samples_verdict"] for each in collects] == [verdict] * 2
    for each in collects:
        told = rf"(\d+) of 1200 expected samples: the unit sends at ({hz:g}|[\d.]+) Hz, the description says 20; write"
        found = re.search(told, each.reason)
        assert found, each.reason
        assert abs(int(found[1]) - n) <= 2
        assert float(found[2]) == pytest.approx(hz, rel=0.002)
    assert not {"unit-back", "interlock", "retry"} & set(kinds)
    assert replay_night(tmp_path / "n")["identical"]
    if hz > 20.0:
        said = stream_in_words(night_content(tmp_path / "n").collects)
        assert f"{hz / 20.0 - 1.0:.2%} more than the description's rate gives: the unit is faster" in said


def test_an_oscillator_that_is_a_little_off_is_no_other_rate(tmp_path: Path, unit_at: list[float]) -> None:
    """0.06 % more: nothing is said of a collect."""
    unit_at.append(20.012)
    start_night(tmp_path / "n", parse_sweep(SWEEP, "s.yaml"), bench_at())
    with open_readonly(tmp_path / "n") as journal:
        collects = [each for key, each in journal.completed().items() if key.endswith("collect")]
    assert [each.data["samples_verdict"] for each in collects] == ["PASS"] * 2


CLOCK = "time: {field: counter, resolution: 2^-16, modulus: 65536}"
COUNTER = "counter: {field: counter, modulus: 65536}"


def described(folder: Path, name: str, line: str) -> str:
    """Write the shipped description of the simulated unit with another line for its counter."""
    text = find_config("imus", "mfs").read_text()
    assert COUNTER in text
    path = folder / f"{name}.yaml"
    path.write_text(text.replace(COUNTER, line))
    return str(path)


def stream_found(folder: Path, monkeypatch: pytest.MonkeyPatch, *, true: str, said: str) -> Finding:
    """Return what hil check finds of a unit whose counter is `true` where its description says `said`."""
    real, truth = assemble.simulate_devices, bench_at(description=described(folder, "true", true))
    monkeypatch.setattr(assemble, "simulate_devices", lambda _said, **more: real(truth, **more))
    bench = bench_at(description=described(folder, "said", said))
    return next(each for each in preflight(None, bench, folder) if each.subject == "stream")


def test_a_computer_that_looks_late_has_no_unit_at_a_wrong_rate(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Busy with something else for the last half of the two seconds; what arrived meanwhile is read after them."""
    read, looks = StreamImu.read_block, count(1)

    def late(imu: StreamImu) -> SampleBlock:
        return SampleBlock(np.empty(0), {}) if 12 < next(looks) <= 24 else read(imu)

    monkeypatch.setattr(StreamImu, "read_block", late)
    found = next(each for each in preflight(None, bench_at(), tmp_path) if each.subject == "stream")
    assert found.good, found.message
    assert "samples in 4 s (20." in found.message


def test_a_counter_that_is_a_clock_is_said_to_be_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not a cable to look at: 3277, 3276, 3277 is a clock of 1/65536 s; so described, it is."""
    found = stream_found(tmp_path, monkeypatch, true=CLOCK, said=COUNTER)
    assert not found.good
    assert "it moves by 3276 to 3277 from frame to frame" in found.advice
    assert "the counter is a clock of 1/65536 s" in found.advice
    assert "resolution: 1/65536, modulus: 65536}" in found.advice
    assert "cable" not in found.advice
    found = stream_found(tmp_path, monkeypatch, true=CLOCK, said=CLOCK)
    assert (found.good, found.advice) == (True, "")
    assert "0 bad or lost" in found.message


@pytest.mark.parametrize(
    ("true", "said", "words"),
    [
        (CLOCK, CLOCK.replace("2^-16", "1e-6"), "time.resolution: is 1e-06 s, but counter moves by 3276.8"),
        (CLOCK.replace("2^-16", "1e-3"), CLOCK, "at 20 Hz is 1/1000 s"),
        (COUNTER, COUNTER.replace("}", ", step: 2}"), "counter.step: is 2, but counter moves by 1"),
        (COUNTER, COUNTER, ""),
    ],
)
def test_a_wrong_resolution_is_said_as_a_wrong_step_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, true: str, said: str, words: str
) -> None:
    """Where it loses no frame it is a note; where all is right nothing is said."""
    found = stream_found(tmp_path, monkeypatch, true=true, said=said)
    assert words in found.advice
    assert bool(found.advice) == bool(words)


def test_recorded_packets_with_a_clock_lose_nothing(tmp_path: Path) -> None:
    """A thousand S1 packets as a DMU380 sends them at 20 Hz; a rate that is not the unit's is told."""
    ticks = np.floor(np.arange(1002) * 3276.8) % 65536
    path = tmp_path / "s1.bin"
    path.write_bytes(encode(load_frames_named("aceinna"), "scaled_1", {"counter": ticks}))
    found = decode_file(path, load_frames_named("aceinna"))
    assert (found["ok"], found["lost"], found["warnings"]) == (1002, 0, [])
    (warned,) = decode_file(path, load_frames_named("aceinna", sample_rate_hz=100.0))["warnings"]
    assert "time.resolution" in warned
    assert "Is the sample rate (--rate, imu.rate) the unit's?" in warned
