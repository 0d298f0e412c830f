"""The `faults` of a bench file: validated in words, and made to happen on the simulated devices."""

from __future__ import annotations

import json
import random
from pathlib import Path

import pytest

from benchmarks.reliability.random_faults import NEVER, draw_faults
from benchmarks.reliability.rehearsal import with_faults
from drivers.clock import VirtualClock
from drivers.errors import TransportError
from hil.bench import build_bench
from hil.config import Bench, load_bench, parse_bench, parse_sweep
from hil.config.simulation import CATALOGUE, Fault
from hil.errors import InputError
from hil.night import resume_night, start_night
from hil.records import open_readonly
from hil.records.status import night_status
from hil.records.verify import verify_night
from procedures.plan import make_plan

_SWEEP = parse_sweep(
    """
title: A small night
temperatures: [23 degC]
self_calibrations_per_temperature: 1
positions: [1, 3]
restabilisation: {at_least: 5 min, window: 5 min, ceiling: 60 min, unit_band: 5 degC, unit_slope: 5 degC/min}
collect: {settle: 5 s, duration: 20 s}
""",
    "small.yaml",
)


def bench_with(*lines: str) -> Bench:
    """Return the simulated bench with these faults, written as a file has them."""
    text = load_bench("simulated").text + "faults:\n" + "".join(f"  - {line}\n" for line in lines)
    return parse_bench(text, "bench.yaml")


def events(folder: Path) -> list[str]:
    """Return the events of a night, kind and message."""
    with open_readonly(folder) as journal:
        return [f"{event.kind}: {event.message}" for event in journal.events()]


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (
            "{at: 2 h, device: imu, kind: silense}",
            "faults.0.kind: 'silense' is nothing that happens to imu; did you mean",
        ),
        ("{at: 2 h, device: oven, kind: silence}", "faults.0.device: 'oven' is not allowed"),
        ("{at: 2 kg, device: imu, kind: silence}", "is not a time"),
        ("{at: -2 h, device: imu, kind: silence}", "cannot be"),
        ("{at: '', device: imu, kind: silence}", "a step's key"),
        ("{device: imu, kind: silence}", "faults.0.at: this key is missing"),
        ("{at: 2 h, device: imu, kind: silence, size: 0.5}", "silence has no size"),
        ("{at: 2 h, device: imu, kind: corrupted_bytes, size: 1.5}", "not a share of the frames"),
        ("{at: 2 h, device: imu, kind: corrupted_bytes, size: half}", "not a share of the frames"),
        ("{at: 2 h, device: chamber, kind: sensor_break, size: 5 min}", "is not a temperature"),
        ("{at: 2 h, device: controller, kind: killed, duration: 5 min}", "happens in a moment"),
        ("{at: 2 h, device: imu, kind: silence, duration: 5}", "has no unit"),
        ("{at: 2 h, device: imu, kind: silence, for: 5 min}", "unknown key 'for'"),
        ("just a word", "must be a mapping"),
    ],
)
def test_a_fault_that_makes_no_sense_is_refused_in_words(line: str, words: str) -> None:
    """The message names the place and says what is allowed."""
    with pytest.raises(InputError) as refused:
        bench_with(line)
    assert words in str(refused.value)
    assert "bench.yaml: faults" in str(refused.value)


def test_a_real_bench_has_no_faults() -> None:
    """Only what is simulated can be told to fail."""
    text = load_bench("espec-stim300-example").text + "faults: [{at: 1 h, device: imu, kind: silence}]\n"
    with pytest.raises(InputError, match="only what is simulated"):
        parse_bench(text, "bench.yaml")


def test_a_fault_at_a_step_that_the_sweep_does_not_have_is_refused(tmp_path: Path) -> None:
    """Before anything begins, with the nearest step."""
    with pytest.raises(InputError, match=r"faults.0.at: 'T1/S1/C9/collect' is no step of small.yaml; did you mean"):
        start_night(tmp_path / "n", _SWEEP, bench_with("{at: T1/S1/C9/collect, device: imu, kind: silence}"))
    assert not (tmp_path / "n").exists()


@pytest.mark.parametrize(("device", "kind"), [(device, kind) for device, kinds in CATALOGUE.items() for kind in kinds])
def test_everything_in_the_catalogue_can_happen(device: str, kind: str) -> None:
    """Each is accepted by what it happens to, with its usual size, for a time and for ever."""
    fault = Fault.model_validate({"at": "1 s", "device": device, "kind": kind})
    with build_bench(with_faults(load_bench("simulated"), [fault]), ask=lambda _question, _timeout_s: True) as live:
        live.devices.clock.sleep(0.5)
        if device != "controller":
            live.devices.imu.read_block()
            live.devices.clock.sleep(2.0)


@pytest.mark.parametrize(
    ("kind", "size", "told"),
    [
        ("late", "4 s", {"delay_s": 4.0}),
        ("sensor_break", "-150 degC", {"reading": -150.0}),
        ("runaway", "30 kelvin", {"astray_degC": 30.0}),
        ("corrupted_bytes", None, {"delay_s": 3.0, "astray_degC": 60.0}),
    ],
)
def test_the_size_of_a_chambers_fault_reaches_its_simulator(
    kind: str, size: str | None, told: dict[str, float]
) -> None:
    """Under the name that it has there, and nothing else is set."""
    fault = Fault.model_validate({"at": "1 h", "device": "chamber", "kind": kind, "size": size})
    with build_bench(with_faults(load_bench("simulated"), [fault])) as live:
        assert live.simulators is not None
        (happens,) = live.simulators.chamber._faults
        assert {name: getattr(happens, name) for name in told} == told


def test_silence_ends_when_it_is_said_to(tmp_path: Path) -> None:
    """A stream that stops for 40 s is suspected, comes back, and the night goes on to its end."""
    bench = bench_with("{at: T1/S1/restabilise, device: imu, kind: silence, duration: 40 s}")
    assert start_night(tmp_path / "n", _SWEEP, bench).state == "complete"
    said = events(tmp_path / "n")
    assert any(each.startswith("interlock-suspected: stream-lost") for each in said)
    assert any(each.startswith("interlock-cleared: stream-lost") for each in said)


@pytest.mark.parametrize(
    ("line", "state", "words"),
    [
        ("{at: 3 min, device: chamber, kind: alarm}", "failed", "chamber-alarm"),
        ("{at: 3 min, device: chamber, kind: silence, duration: 4 min}", "failed", "chamber-lost"),
        ("{at: 3 min, device: chamber, kind: power_cycle, duration: 20 s}", "failed", "chamber-stopped"),
        ("{at: 3 min, device: chamber, kind: fahrenheit}", "failed", "°F"),
        ("{at: 3 min, device: chamber, kind: runaway}", "failed", "setpoint-not-followed|chamber"),
        ("{at: 3 min, device: imu, kind: unplugged, duration: 4 min}", "failed", "stream-lost"),
        ("{at: 3 min, device: imu, kind: dropped_bytes, size: 1.0}", "failed", "stream-lost"),
        ("{at: 1 min, device: disk, kind: full}", "failed", "disk is full"),
        ("{at: 3 min, device: clock, kind: jump, size: -2 h}", "complete", ""),
        ("{at: 3 min, device: imu, kind: garbage, size: 0.1, duration: 2 min}", "complete", ""),
    ],
)
def test_a_fault_ends_a_night_for_its_own_reason_or_not_at_all(
    tmp_path: Path, line: str, state: str, words: str
) -> None:
    """The reason names what was wrong, the chamber is safe, and the records are sound."""
    opened = []
    outcome = start_night(tmp_path / "n", _SWEEP, bench_with(line), opened=opened.append)
    assert outcome.state == state, outcome.reason
    assert any(word in outcome.reason for word in words.split("|"))
    assert opened[0].simulators is not None
    assert opened[0].simulators.chamber.mode in ("STANDBY", "OFF")
    assert [each for each in verify_night(tmp_path / "n")["problems"] if not each.startswith("missing")] == []


@pytest.mark.slow
def test_a_full_disk_has_room_again(tmp_path: Path) -> None:
    """A night that a full disk ended is carried on when the fault is over."""
    bench = bench_with("{at: T1/S1/C2/collect, device: disk, kind: full, duration: 10 min}")
    assert start_night(tmp_path / "n", _SWEEP, bench).state == "failed"
    assert resume_night(tmp_path / "n").state == "complete"


def test_a_wrong_counter_costs_what_it_claims_to_have_lost(tmp_path: Path) -> None:
    """Five frames are missed at its beginning."""
    with build_bench(bench_with("{at: 10 s, device: imu, kind: wrong_counter, duration: 10 s}")) as live:
        lost = []
        for _ in range(3):
            live.devices.clock.sleep(8.0)
            lost.append(live.devices.imu.read_block().counts.lost)
    assert lost[0] == 0
    assert lost[1] == 5


def test_a_cable_that_is_pulled_fails_every_call_until_it_is_put_back() -> None:
    """The unit's port, by the clock."""
    with build_bench(bench_with("{at: 10 s, device: imu, kind: unplugged, duration: 10 s}")) as live:
        live.devices.clock.sleep(9.0)
        assert len(live.devices.imu.read_block()) > 0
        live.devices.clock.sleep(2.0)
        with pytest.raises(TransportError, match="the port is gone"):
            live.devices.imu.read_block()
        live.devices.clock.sleep(10.0)
        live.devices.imu.read_block()
        live.devices.clock.sleep(1.0)
        assert len(live.devices.imu.read_block()) > 0


def test_nobody_answers_while_the_operator_is_away() -> None:
    """The question is put, and no answer comes."""
    bench = bench_with("{at: 10 s, device: operator, kind: no_answer, duration: 10 s}")
    with build_bench(bench, ask=lambda _question, _timeout_s: True) as live:
        assert live.faults is not None
        ask = live.faults.answering(lambda _question, _timeout_s: True)
        answers = []
        for _ in range(3):
            answers.append(ask("placed?", 1.0))
            live.devices.clock.sleep(12.0)
    assert answers == [True, None, True]


def test_the_wall_clock_jumps_and_the_campaign_s_time_does_not() -> None:
    """`now` goes on; `utc` is what somebody set."""
    clock = VirtualClock()
    before = clock.utc()
    clock.wall_jumps.append((10.0, -3600.0))
    clock.sleep(9.0)
    assert (clock.utc() - before).total_seconds() == 9.0
    clock.sleep(1.0)
    assert (clock.utc() - before).total_seconds() == -3590.0
    assert clock.now() == 10.0


def test_a_night_that_is_carried_on_meets_only_what_is_still_to_come(tmp_path: Path) -> None:
    """The alarm of the first part is history; a silence later on is not."""
    bench = bench_with(
        "{at: 3 min, device: chamber, kind: alarm, duration: 10 min}",
        "{at: 45 min, device: imu, kind: silence, duration: 10 min}",
    )
    assert "chamber-alarm" in start_night(tmp_path / "n", _SWEEP, bench).reason
    outcome = resume_night(tmp_path / "n", down_s=2400.0)
    assert "stream-lost" in outcome.reason
    assert night_status(tmp_path / "n")["state"] in {"failed", "incomplete"}


@pytest.mark.slow
def test_random_faults_are_the_same_for_a_seed_and_make_sense() -> None:
    """A thousand draws are all faults that a file may hold; every kind comes up."""
    plan = make_plan(_SWEEP.procedure())
    seen = set()
    for seed in range(1000):
        drawn = draw_faults(random.Random(seed), plan, (1, 5))
        assert 1 <= len(drawn) <= 5
        assert [each.model_dump(exclude_none=True) for each in drawn] == [
            each.model_dump(exclude_none=True) for each in draw_faults(random.Random(seed), plan, (1, 5))
        ]
        seen |= {(fault.device, fault.kind) for fault in drawn}
        json.dumps([fault.model_dump(exclude_none=True) for fault in drawn])
    assert seen == {(device, kind) for device, kinds in CATALOGUE.items() for kind in kinds if kind not in NEVER}


def test_every_fault_is_in_the_reference() -> None:
    """Device, kind and meaning stand in docs/reference/configuration.md."""
    text = (Path(__file__).resolve().parents[3] / "docs" / "reference" / "configuration.md").read_text()
    for device, kinds in CATALOGUE.items():
        for kind, meaning in kinds.items():
            assert f"| `{device}` | `{kind}` | {meaning.means} |" in text


def test_glitches_are_short_and_none_is_for_ever() -> None:
    """What lasts at all lasts no longer than was asked for."""
    plan = make_plan(_SWEEP.procedure())
    drawn = [fault for seed in range(200) for fault in draw_faults(random.Random(seed), plan, (1, 5), 10.0)]
    lasting = [fault.duration_s for fault in drawn if fault.meaning.lasts]
    assert None not in lasting
    assert 8.0 < max(each for each in lasting if each is not None) <= 10.0
