"""The chamber alone, from the command line: read, set, stop; refused where it must be, and the unit left alone."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
import yaml

import hil.cli.chamber as chamber_command
from hil.bench import build_bench
from hil.config import Bench, load_bench, parse_bench
from hil.twin.serve import Simulation
from tests.hil.twin.serving import client_bench, served

LOGGED = ("chamber: prepare", "chamber: set temperature", "chamber: safe state")


def bench_file(folder: Path, **chamber: Any) -> Path:
    """The simulated bench with some keys of its chamber changed."""
    document = yaml.safe_load(load_bench("simulated").text)
    document["chamber"] |= chamber
    path = folder / "my-bench.yaml"
    path.write_text(yaml.safe_dump(document, sort_keys=False, allow_unicode=True))
    return path


def logged(ended: Any) -> list[dict[str, Any]]:
    """The log lines on standard error."""
    return [json.loads(line) for line in ended.stderr.splitlines() if line.startswith("{")]


@pytest.fixture
def simulation() -> Iterator[Simulation]:
    """The simulated devices on pseudo-terminals, in real time."""
    document = yaml.safe_load(load_bench("simulated").text)
    document["chamber"] |= {"driver": "simserv", "model": ""}  # of all chambers the one with the least pacing
    with served(parse_bench(yaml.safe_dump(document), "served.yaml")) as running:
        yield running


@pytest.fixture
def client(simulation: Simulation, tmp_path: Path) -> Path:
    """A bench file whose chamber is behind a port; the unit's port is not even there."""
    bench = client_bench(simulation.bench, {"imu": "/dev/ttyNONE7", "chamber": simulation.ports["chamber"]})
    path = tmp_path / "client.yaml"
    path.write_text(bench.text)
    return path


def test_reading_is_one_document_and_sends_no_command(hil: Any) -> None:
    """What the chamber says, as JSON and for people; nothing is logged because nothing is commanded."""
    ended = hil("chamber", "simulated", "read", "--json")
    document = json.loads(ended.stdout)
    assert ended.returncode == 0
    assert ended.stderr == ""
    assert document == {
        "schema": "hil.chamber/1",
        "bench": "simulated",
        "simulated": True,
        "action": "read",
        "model": "P300 SIMULATED 1.00",
        "temperature_degC": pytest.approx(23.0, abs=0.2),
        "setpoint_degC": 23.0,
        "mode": "OFF",
        "low_limit_degC": -75.0,
        "high_limit_degC": 105.0,
        "alarms": [],
    }
    assert "alarms: none" in hil("chamber", "simulated", "read").stdout


@pytest.mark.parametrize(
    ("given", "degC"), [("-20", -20.0), ("-20 degC", -20.0), ("68 degF", 20.0), ("−4 degF", -20.0), ("33.3", 33.3)]
)
def test_setting_is_read_back_and_logged(hil: Any, given: str, degC: float) -> None:
    """A negative number is a temperature and no option; who and when are on standard error before it is sent."""
    ended = hil("chamber", "simulated", "set", given, "--json")
    document = json.loads(ended.stdout)
    assert ended.returncode == 0, ended.stderr
    assert document["setpoint_degC"] == pytest.approx(degC)
    assert document["mode"] == "CONSTANT"
    assert [line["event"] for line in logged(ended)] == ["chamber: prepare", "chamber: set temperature"]
    assert all(line["who"] and line["utc"] for line in logged(ended))
    assert logged(ended)[-1]["setpoint_degC"] == pytest.approx(degC)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("set", "75.1"), "outside the limits"),
        (("set", "-50 degF"), "outside the limits"),
        (("set", "20 kg"), "is not a temperature"),
        (("set", "nan"), "is not a temperature"),
        (("set", "--yess"), "is not a temperature"),
        (("set",), "set needs a temperature"),
        (("read", "20"), "read takes no temperature"),
        (("stop", "20"), "stop takes no temperature"),
    ],
)
def test_what_cannot_be_set_is_refused_before_a_port_is_opened(
    hil: Any, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], words: str
) -> None:
    """Status 2, one sentence."""
    monkeypatch.setattr("hil.bench.open_chamber", lambda _: pytest.fail("a port was opened"))
    ended = hil("chamber", "simulated", *arguments)
    assert ended.returncode == 2
    assert ended.stdout == ""
    assert words in ended.stderr
    assert len(ended.stderr.strip().splitlines()) == 1


@pytest.mark.slow(seconds=15)
def test_stop_is_the_safe_state_through_a_port(hil: Any, simulation: Simulation, client: Path) -> None:
    """The chamber that was set stands by; its unit is not needed for that."""
    assert hil("chamber", client, "set", "30", "--yes").returncode == 0
    assert simulation.devices.plant.commanded_degC == 30.0
    ended = hil("chamber", client, "stop", "--json")
    assert ended.returncode == 0, ended.stderr
    assert json.loads(ended.stdout)["mode"] in ("STANDBY", "OFF")
    assert simulation.devices.plant.commanded_degC is None
    assert [line["event"] for line in logged(ended)] == ["chamber: safe state"]


def test_a_bench_in_use_is_refused(hil: Any, simulation: Simulation, client: Path) -> None:
    """A night holds its ports: nobody else drives its chamber."""
    night = client_bench(simulation.bench, simulation.ports)
    with build_bench(night):
        ended = hil("chamber", client, "set", "30", "--yes")
    assert ended.returncode == 3
    assert "somebody else has the port open" in ended.stderr
    assert not logged(ended)


def real_bench(tmp_path: Path) -> tuple[Path, Bench]:
    """A bench that is not simulated, on a port that is not there."""
    document = yaml.safe_load(load_bench("simulated").text)
    del document["simulation"]
    document["clock"] = "system"
    document["imu"]["port"] = document["chamber"]["port"] = "/dev/ttyNONE7"
    path = tmp_path / "real.yaml"
    path.write_text(yaml.safe_dump(document))
    return path, parse_bench(path.read_text(), "real.yaml")


@pytest.mark.parametrize(("answer", "asked"), [(False, "not set"), (True, "/dev/ttyNONE7: there is no such port")])
def test_a_real_chamber_moves_only_when_somebody_agreed(
    hil: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, answer: bool, asked: str
) -> None:
    """Without a yes nothing is opened; with it the port is."""
    monkeypatch.setattr(typer, "confirm", lambda *_, **__: answer)
    path, _ = real_bench(tmp_path)
    ended = hil("chamber", path, "set", "30")
    assert ended.returncode == 2
    assert asked in ended.stderr
    assert "will go to 30.00 °C" in ended.stderr


def test_yes_and_stop_do_not_ask(hil: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Whoever wants to stop a chamber is not asked why."""
    monkeypatch.setattr(typer, "confirm", lambda *_, **__: pytest.fail("asked"))
    path, _ = real_bench(tmp_path)
    for arguments in (("set", "30", "--yes"), ("stop",), ("read",)):
        assert "there is no such port" in hil("chamber", path, *arguments).stderr


def test_a_ramp_is_stepped_to_its_end(hil: Any, tmp_path: Path) -> None:
    """A controller without a ramp of its own is not left at the first step, nor sent the last one at once."""
    ended = hil("chamber", bench_file(tmp_path, ramp="1 degC/min"), "set", "28", "--json")
    document = json.loads(ended.stdout)
    assert ended.returncode == 0, ended.stderr
    assert document["setpoint_degC"] == pytest.approx(28.0)
    assert document["temperature_degC"] > 26.0  # it has taken its minutes
    assert "stepped from here" in ended.stderr


def test_a_setpoint_that_was_not_taken_ends_in_the_safe_state(hil: Any, tmp_path: Path) -> None:
    """The panel is locked after the chamber was prepared: status 3, and the safe state was asked for."""
    document = yaml.safe_load(load_bench("simulated").text)
    document["chamber"] |= {"driver": "watlow-f4", "model": ""}
    document["simulation"]["chamber_faults"] = [{"kind": "panel_lock", "begins": "1 h"}]
    path = tmp_path / "bench.yaml"
    path.write_text(yaml.safe_dump(document))
    live_clock: list[float] = []
    set_it = chamber_command._set

    def later(commanded: Any, device: Any, clock: Any, *more: Any) -> None:
        before = device.prepare

        def slowly() -> None:
            before()
            clock.sleep(3600.0)
            live_clock.append(clock.now())

        device.prepare = slowly
        set_it(commanded, device, clock, *more)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(chamber_command, "_set", later)
        ended = hil("chamber", path, "set", "40")
    assert live_clock
    assert ended.returncode == 3
    assert [line["event"] for line in logged(ended)] == list(LOGGED)
