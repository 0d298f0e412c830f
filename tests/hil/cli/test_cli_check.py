"""The pre-flight: it looks at everything, moves nothing, and says what to do about each thing that is wrong."""

from __future__ import annotations

import json
import re
import socket
from contextlib import ExitStack
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml

import hil.bench.preflight
from hil.config import load_bench, load_sweep, parse_bench
from tests.hil.twin.serving import client_bench, served

SUBJECTS = [
    "imu.port",
    "chamber.port",
    "unit",
    "stream",
    "sensor 1 at rest",
    "sensor 2 at rest",
    "pose",
    "unit temperature",
    "index",
    "chamber",
    "mode",
    "alarms",
    "native limits",
    "left alone",
    "limits",
    "wear",
    "disk",
    "clock",
    "duration",
]


def bench_file(folder: Path, **changes: dict[str, Any]) -> Path:
    """The simulated bench with some of its keys changed, section by section."""
    document = yaml.safe_load(load_bench("simulated").text)
    for section, keys in changes.items():
        document[section] = {**document[section], **keys}
    path = folder / "my-bench.yaml"
    path.write_text(yaml.safe_dump(document, sort_keys=False, allow_unicode=True))
    return path


def told(ended: Any) -> dict[str, dict[str, Any]]:
    """The findings of a `--json` check, by subject."""
    document = json.loads(ended.stdout)
    assert document["schema"] == "hil.check/1"
    return {finding["subject"]: finding for finding in document["findings"]}


def test_both_orders_look_at_the_same(hil: Any, short_sweep: Path) -> None:
    """The sweep first or the bench first: the same findings, all good, each with its four keys."""
    sweep_first = hil("check", short_sweep, "--bench", "simulated", "--json")
    bench_first = hil("check", "simulated", "--sweep", short_sweep, "--json")
    assert sweep_first.returncode == bench_first.returncode == 0
    document = json.loads(sweep_first.stdout)
    assert document["good"] is True
    assert document["simulated"] is True
    assert [finding["subject"] for finding in document["findings"]] == SUBJECTS
    assert all(set(finding) == {"subject", "good", "message", "advice"} for finding in document["findings"])
    assert list(told(bench_first)) == SUBJECTS
    assert "sensor 2 15.0 °C" in told(bench_first)["unit temperature"]["message"]  # its rotors have just spun up
    assert told(bench_first)["wear"]["message"].startswith("at most 2 setpoint writes")


def test_a_sensor_that_the_bench_does_not_list_is_not_judged(hil: Any, tmp_path: Path) -> None:
    """The frames have both sensors; the bench was left one of them, and the other was judged all the same."""
    document = yaml.safe_load(bench_file(tmp_path).read_text())
    del document["sensors"][1]
    bench_file(tmp_path).write_text(yaml.safe_dump(document, sort_keys=False, allow_unicode=True))
    found = told(hil("check", tmp_path / "my-bench.yaml", "--json"))
    assert [subject for subject in found if subject.endswith("at rest")] == ["sensor 2 at rest"]
    assert re.fullmatch(r"sensor 2 [\d.]+ °C", found["unit temperature"]["message"])


def test_a_bench_alone_is_enough(hil: Any) -> None:
    """What depends on a sweep is left out, and how to have it is said."""
    ended = hil("check", "simulated", "--json")
    assert ended.returncode == 0
    found = told(ended)
    assert list(found) == [subject for subject in SUBJECTS if subject != "wear"]
    assert "--sweep" in found["duration"]["advice"]
    assert "24 h" in found["disk"]["message"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("quick",), "quick is a sweep, not a bench"),
        (("nonsense",), "there is no bench of this name"),
        (("quick", "--bench", "simulated", "--sweep", "quick"), "hil check BENCH --sweep SWEEP"),
        (("simulated", "--sweep", "nonsense"), "there is no sweep of this name"),
        (("quick", "--bench", "nonsense"), "there is no bench of this name"),
    ],
)
def test_what_cannot_be_meant_is_one_sentence(hil: Any, arguments: tuple[str, ...], words: str) -> None:
    """Status 2 and nothing on standard output."""
    ended = hil("check", *arguments)
    assert ended.returncode == 2
    assert ended.stdout == ""
    assert words in ended.stderr
    assert len(ended.stderr.strip().splitlines()) == 1


@pytest.mark.parametrize(
    ("changes", "subject", "message", "advice"),
    [
        pytest.param(
            {"unit": {"serial": "SIM-0002"}}, "unit", "SIM-0001", "correct model and serial", marks=pytest.mark.slow
        ),
        ({"chamber": {"model": "SCP"}}, "chamber", "P300", "chamber.model"),
        pytest.param({"imu": {"rate": "25 Hz"}}, "stream", "Hz", "imu", marks=pytest.mark.slow),
        ({"interlocks": {"unit_low": "40 degC"}}, "unit temperature", "°C", "interlocks"),
        (
            {"chamber": {"limits": {"low": "40 degC", "high": "75 degC"}}},
            "chamber",
            "now 23.0 °C",
            "outside the bench's 40 … 75 °C",
        ),
    ],
)
def test_what_is_wrong_is_named_with_what_to_do(
    hil: Any, tmp_path: Path, changes: dict[str, Any], subject: str, message: str, advice: str
) -> None:
    """Status 3; the finding says what and what to do; the other device was looked at all the same."""
    document = yaml.safe_load(load_bench("simulated").text)
    if "interlocks" in changes:
        document["interlocks"] = changes.pop("interlocks")
    for section, keys in changes.items():
        document[section] = {**document[section], **keys}
    text = yaml.safe_dump(document, sort_keys=False, allow_unicode=True)
    if subject in ("unit", "stream"):
        # The unit is what it is, the file says something else: two benches, one served, one asked.
        served_bench = parse_bench(load_bench("simulated").text, "served.yaml")
        with ExitStack() as opened:
            simulation = opened.enter_context(served(served_bench))
            path = tmp_path / "client.yaml"
            path.write_text(client_bench(parse_bench(text, "client.yaml"), simulation.ports).text)
            ended = hil("check", path, "--json")
    else:
        path = tmp_path / "bench.yaml"
        path.write_text(text)
        ended = hil("check", path, "--json")
    found = told(ended)
    assert ended.returncode == 3
    assert json.loads(ended.stdout)["good"] is False
    assert [name for name, finding in found.items() if not finding["good"]] == [subject]
    assert message in found[subject]["message"]
    assert advice in found[subject]["advice"]


def test_a_silent_chamber_and_a_silent_unit_are_told_apart(hil: Any, tmp_path: Path) -> None:
    """The chamber does not answer: how its line must be set is said, and the unit is good."""
    simulation = yaml.safe_load(load_bench("simulated").text)["simulation"]
    silent = {**simulation, "chamber_faults": [{"kind": "silence", "times": None}]}
    ended = hil("check", bench_file(tmp_path, simulation=silent, chamber={"baud": 9600}), "--json")
    found = told(ended)
    assert ended.returncode == 3
    assert [name for name, finding in found.items() if not finding["good"]] == ["chamber"]
    assert "9600 baud, 8 data bits, parity none" in found["chamber"]["advice"]
    assert "wire-a-chamber" in found["chamber"]["advice"]


def test_bad_frames_are_not_good_enough(hil: Any, tmp_path: Path) -> None:
    """A single damaged frame in two seconds is a bad line: zero is the number."""
    simulation = yaml.safe_load(load_bench("simulated").text)["simulation"]
    noisy = {**simulation, "imu_faults": [{"fault": "flipped_bits", "probability": 0.03}]}
    ended = hil("check", bench_file(tmp_path, simulation=noisy), "--json")
    assert ended.returncode == 3
    assert told(ended)["stream"]["good"] is False
    assert "shielded" in told(ended)["stream"]["advice"]


@pytest.mark.parametrize(
    ("fault", "subject", "advice"),
    [
        ("alarm", "alarms", "acknowledge it at the chamber's panel"),
        ("program", "mode", "end it at the chamber's panel"),
    ],
)
def test_alarms_and_programs_are_for_the_panel(hil: Any, tmp_path: Path, fault: str, subject: str, advice: str) -> None:
    """A standing alarm and a program that runs keep a night from beginning."""
    simulation = yaml.safe_load(load_bench("simulated").text)["simulation"]
    wrong = {**simulation, "chamber_faults": [{"kind": fault}]}
    chamber = {"driver": "watlow-f4", "model": ""}
    found = told(hil("check", bench_file(tmp_path, simulation=wrong, chamber=chamber), "--json"))
    assert [name for name, finding in found.items() if not finding["good"]] == [subject]
    assert advice in found[subject]["advice"]


def test_a_controller_without_limits_needs_its_limiter(hil: Any, tmp_path: Path) -> None:
    """Nothing that the software could set: said, and not held against the bench."""
    path = bench_file(tmp_path, chamber={"driver": "voetsch-ascii2", "model": ""})
    ended = hil("check", path, "--json")
    assert ended.returncode == 0, ended.stdout
    assert "limiter by hand" in told(ended)["native limits"]["advice"]
    assert "over-temperature cut-out" in told(ended)["left alone"]["advice"]


def test_what_happens_to_a_chamber_that_is_left_alone_is_said(hil: Any, tmp_path: Path) -> None:
    """It goes on, or its own timer stops it; a timer that could be armed is recommended."""
    advised = told(hil("check", bench_file(tmp_path, chamber={"driver": "espec"}), "--json"))["left alone"]
    assert "dead_man: 3 h" in advised["advice"]
    armed = told(hil("check", bench_file(tmp_path, chamber={"driver": "espec", "dead_man": "90 min"}), "--json"))
    assert "stops the chamber 90 min after" in armed["left alone"]["message"]


@pytest.mark.slow
def test_a_port_that_is_not_there_is_bad_input_and_the_rest_is_looked_at(hil: Any, tmp_path: Path) -> None:
    """The chamber's simulation is not there: status 2, told once with what to begin, and the unit was heard."""
    with served(load_bench("simulated")) as simulation:
        client = client_bench(load_bench("simulated"), {"imu": simulation.ports["imu"], "chamber": "/dev/ttyNONE7"})
        path = tmp_path / "bench.yaml"
        path.write_text(client.text)
        ended = hil("check", path, "--json")
    found = told(ended)
    assert ended.returncode == 2
    assert "no such port" not in ended.stderr
    assert found["unit"]["good"] is True
    assert found["stream"]["good"] is True
    assert found["chamber.port"]["good"] is False
    assert "/dev/ttyNONE7: there is no such port" in found["chamber.port"]["message"]
    assert found["chamber.port"]["advice"].startswith(f"begin hil simulate {path} in another shell")
    assert "chamber" not in found


@pytest.mark.slow
def test_a_device_server_that_is_off_is_a_finding(hil: Any, tmp_path: Path) -> None:
    """Status 3 and what to look at; the clock is the computer's."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        number = free.getsockname()[1]
    with served(load_bench("simulated")) as simulation:
        nobody = f"socket://127.0.0.1:{number}"
        client = client_bench(load_bench("simulated"), {"imu": nobody, "chamber": simulation.ports["chamber"]})
        path = tmp_path / "bench.yaml"
        path.write_text(client.text)
        ended = hil("check", path)
    assert ended.returncode == 3
    assert "NOT  imu.port" in ended.stdout
    assert "TO DO: ping the address" in ended.stdout
    assert "ok   chamber: P300" in ended.stdout
    assert "ok   clock" in ended.stdout


def test_a_host_ramp_wears_the_memory(hil: Any, tmp_path: Path) -> None:
    """Every step of a ramp from here is a write: 23 → -29.7 → 60 °C at half a degree per step."""
    ended = hil("check", bench_file(tmp_path, chamber={"ramp": "0.5 degC/min"}), "--sweep", "rd-gc-86-1", "--json")
    wear = told(ended)["wear"]
    sweep = load_sweep("rd-gc-86-1")
    stops = [sweep.start, *sweep.temperatures, *([] if sweep.final is None else [sweep.final])]
    travelled = sum(abs(b - a) for a, b in pairwise(stops))
    assert 2 * travelled <= int(wear["message"].split()[2]) <= 2 * travelled + 2 * len(stops)


@pytest.mark.parametrize(
    ("known", "year", "good", "words"),
    [
        (True, 2026, True, "synchronised"),
        (False, 2026, True, "not synchronised"),
        (None, 2026, True, "cannot be told"),
        (True, 1970, False, "cannot be"),
    ],
)
def test_the_clock_is_judged(
    monkeypatch: pytest.MonkeyPatch, known: bool | None, year: int, good: bool, words: str
) -> None:
    """A clock that lost its battery is refused; one that nobody sets is told."""
    monkeypatch.setattr(hil.bench.preflight, "synchronised", lambda: known)
    clock = SimpleNamespace(utc=lambda: datetime(year, 11, 20, tzinfo=UTC))
    live: Any = SimpleNamespace(devices=SimpleNamespace(clock=clock), bench=SimpleNamespace(clock="system"))
    finding = hil.bench.preflight._clock(live)
    assert finding.good is good
    assert words in finding.message
    assert bool(finding.advice) is (known is not True or not good)


def test_the_kernel_is_asked_and_nothing_is_set() -> None:
    """Whatever this machine answers, it is one of the three."""
    assert hil.bench.preflight.synchronised() in (True, False, None)
