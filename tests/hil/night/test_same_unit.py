"""The unit behind the port is asked again who it is whenever its stream was lost: no sample counts before."""

from __future__ import annotations

from pathlib import Path

import pytest

from hil.config import Bench, load_bench, parse_bench, parse_sweep
from hil.night import NightOutcome, resume_night, start_night
from hil.night.replay import replay_night
from hil.records import open_readonly
from tests.hil.short_sweeps import short_sweep

SWEEP = short_sweep("settle: 5 s, duration: 60 s")


def bench_with(fault: str, serial: str = '""') -> Bench:
    """Return the simulated bench with a fault of its unit, looked at every 5 s; its serial number is not given."""
    text = load_bench("simulated").text.replace("serial: SIM-0001", f"serial: {serial}")
    text = text.replace("read_interval: 30 s", "read_interval: 5 s")
    return parse_bench(f"{text}faults: [{{device: imu, {fault}}}]\n", "bench.yaml")


def night(folder: Path, bench: Bench) -> NightOutcome:
    """Carry a small night out."""
    return start_night(folder, parse_sweep(SWEEP, "sweep.yaml"), bench)


def told(folder: Path, kind: str) -> list[str]:
    """Return what the night's events of a kind say."""
    with open_readonly(folder) as journal:
        return [event.message for event in journal.events() if event.kind == kind]


@pytest.mark.parametrize(
    ("at", "serial"),
    [
        pytest.param("12 min", '""', marks=pytest.mark.slow),
        ("T1/S1/C2/collect", '""'),
        ("T1/S1/C2/index", '""'),
        ("5 min", "SIM-0001"),
    ],
)
def test_a_unit_exchanged_behind_its_port_never_passes_for_the_first(tmp_path: Path, at: str, serial: str) -> None:
    """In a soak, in a collect, while it turns: the step fails and names both; a resume refuses it as well."""
    ended = night(tmp_path / "n", bench_with(f"at: {at}, kind: exchanged", serial))
    assert (ended.state, ended.exit_status) == ("failed", 3), ended
    if serial == '""':
        assert "the unit behind sim://imu is now MFS-IMU S/N B simulated, the night began with MFS-IMU" in ended.reason
    else:
        assert "the unit says serial 'SIM-0001B', 'SIM-0001' is what the bench file says" in ended.reason
        assert "the night began with MFS-IMU S/N SIM-0001" in ended.reason
    with open_readonly(tmp_path / "n") as journal:
        last = journal.attempts()[-1]
        assert (last.outcome, "began with" in last.reason) == ("ERROR", True)
        assert "T1/S1/C2/collect" not in journal.completed()
    if at.endswith("min"):  # the other one is still there
        assert "began with" in resume_night(tmp_path / "n", down_s=600.0).reason


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "asked"),
    [
        ("at: 5 min, kind: unplugged, duration: 20 s", 1),
        ("at: T1/S1/C1/collect, kind: silence, duration: 10 s", 1),
        ("at: 5 min, kind: silence, duration: 1 s", 0),
        ("at: 5 min, kind: dropped_frames, size: 0.2, duration: 2 min", 0),
    ],
)
def test_the_same_unit_goes_on_and_says_so(tmp_path: Path, fault: str, asked: int) -> None:
    """After a cable that came loose it is asked once; a short gap is none. What was recorded replays to the digit."""
    assert night(tmp_path / "n", bench_with(fault)).state == "complete"
    assert (
        told(tmp_path / "n", "unit-back")
        == ["the unit's stream was lost and is back; it is MFS-IMU simulated, as before"] * asked
    )
    assert replay_night(tmp_path / "n")["identical"]


@pytest.mark.slow
def test_a_unit_that_does_not_say_who_it_is_any_more_is_not_believed(tmp_path: Path) -> None:
    """It streams good frames, and no sample of it counts: after a minute the night is over, for that reason."""
    text = "at: 5 min, kind: silence, duration: 20 s}, {device: imu, at: 5 min, kind: silent_identity"
    ended = night(tmp_path / "n", bench_with(text))
    assert ended.exit_status == 3
    assert "stream-lost: the unit's stream failed: it was lost and is back, and the unit does not say" in ended.reason
