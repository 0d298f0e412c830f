"""Controller and watchdog are both dead: what is said, and who is left to act."""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest
import yaml

from drivers.clock import SystemClock
from hil.bench import build_bench, open_chamber
from hil.cli.app import run as hil
from hil.cli.watchdog import _begun
from hil.config import Bench, load_bench, load_sweep, parse_bench
from hil.config.recorded import configuration_text
from hil.files.lock import LOCK_NAME, Owner
from hil.records import SqliteJournal
from hil.records.rows import Night
from hil.records.status import night_status
from procedures.plan import make_plan
from tests.hil.twin.serving import client_bench, served


def bench_with(**chamber: Any) -> Bench:
    """Return the simulated bench with another chamber section."""
    document = yaml.safe_load(load_bench("simulated").text)
    document["chamber"] |= chamber
    if "port" in chamber:
        document["clock"] = "system"
    return parse_bench(yaml.safe_dump(document), "bench.yaml")


def killed_night(folder: Path, bench: Bench) -> None:
    """Make a night whose controller was killed while it held 60 °C, and whose watchdog was killed with it."""
    alive = folder.with_name("alive")
    alive.mkdir()
    sweep = load_sweep("quick")
    plan = make_plan(sweep.procedure())
    configuration = configuration_text(bench, sweep, None)
    about = Night("Dead", "rk", SystemClock().utc(), simulated=True, configuration=configuration)
    SqliteJournal.create(alive, plan, about)
    with SqliteJournal.open(alive, clock=SystemClock()) as journal:
        journal.begin(plan.steps[0])
        journal.heartbeat(plan.steps[0], {"chamber_degC": 59.9, "setpoint_degC": 60.0})
        shutil.copytree(alive, folder)  # what a process leaves that is killed now
    shutil.rmtree(alive)
    (folder / LOCK_NAME).write_text(json.dumps(asdict(Owner(os.getpid(), os.uname().nodename, "", "1"))))


def test_status_says_that_the_chamber_may_still_be_conditioning(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In the words of hil pause, with where it was and what to do; once somebody has made it safe, no more."""
    night = tmp_path / "night"
    killed_night(night, bench_with(port="socket://127.0.0.1:1"))
    found = night_status(night)
    (said,) = found["problems"]
    assert said == "THE CHAMBER MAY STILL BE CONDITIONING, at 60.0 °C when it was last heard of"
    assert (found["state"], found["chamber"]) == ("incomplete", None)
    assert hil(["pause", str(night), "--why", "tea"]) == 2
    assert said in capsys.readouterr().err
    assert hil(["status", str(night)]) == 4
    with SqliteJournal.open(night, clock=SystemClock()) as journal:
        journal.event("safe-state", "by hand", chamber="SAFE")
        journal.finish("failed: made safe")
    assert (night_status(night)["problems"], night_status(night)["chamber"]) == ([], "SAFE")


def test_a_simulated_chamber_ends_with_its_controller(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nobody is sent to it, nor told to type what is then refused; the night carries on where it was."""
    night = tmp_path / "night"
    killed_night(night, load_bench("simulated"))
    found = night_status(night)
    assert (found["killed"], found["chamber"]) == (True, "SAFE")
    assert found["problems"] == [found["chamber_in_words"]] == ["the simulated chamber ended with its controller"]
    for command in (["status", str(night)], ["pause", str(night), "--why", "tea"]):
        assert hil(command) != 0
        told = "".join(capsys.readouterr())
        assert f"hil resume {night} carries on" in told
        assert "watchdog" not in told


def test_the_nights_in_a_folder_that_need_a_watchdog_are_those_whose_lock_has_a_name(tmp_path: Path) -> None:
    """A controller takes its name off when it ends; one that died left it."""
    for name, text in (("ended", ""), ("dead", "{}"), ("file", None)):
        (tmp_path / name).mkdir()
        if text is not None:
            (tmp_path / name / LOCK_NAME).write_text(text)
    assert list(_begun(tmp_path)) == [tmp_path / "dead"]


@pytest.mark.slow
@pytest.mark.timeout(60)
def test_a_watchdog_that_is_started_anew_finds_the_night_by_itself(tmp_path: Path) -> None:
    """As systemd does it: told only where nights are, it sees whose lock is a dead one's, and stops the chamber."""
    with served(bench_with(driver="simserv", model="")) as simulation:
        client = client_bench(simulation.bench, simulation.ports)
        with open_chamber(client) as (driven, _):
            driven.prepare()
        (tmp_path / "ended").mkdir()
        (tmp_path / "ended" / LOCK_NAME).touch()
        killed_night(tmp_path / "night", client)
        assert simulation.devices.plant.commanded_degC is not None
        assert hil(["watchdog", "--nights", str(tmp_path)]) == 3
        assert simulation.devices.plant.commanded_degC is None
    assert night_status(tmp_path / "night")["chamber"] == "SAFE"
    assert (tmp_path / "night" / LOCK_NAME).read_text() == ""


def test_a_chamber_with_a_timer_of_its_own_has_it_armed_by_default() -> None:
    """A real one that stands by; not one that holds, is simulated in this process, cannot, or is told not to."""
    real = {"driver": "espec", "port": "/dev/ttyUSB9"}
    hold = {"safe_state": {"action": "hold", "temperature": "25 degC"}}
    for chamber, expected in (
        (real, 10800.0),
        (real | {"dead_man": "1 h"}, 3600.0),
        (real | {"dead_man": None}, None),
        (real | hold, None),
        (real | hold | {"dead_man": "1 h"}, 3600.0),
        ({"driver": "espec"}, None),
        (real | {"driver": "watlow-f4", "model": ""}, None),
    ):
        document = yaml.safe_load(load_bench("simulated").text)
        document["chamber"] |= chamber
        document["clock"] = "system"
        assert parse_bench(yaml.safe_dump(document), "bench.yaml").chamber.night_dead_man == expected, chamber


@pytest.mark.slow(seconds=13)  # a P300 is given its pauses in real time
@pytest.mark.timeout(60)
def test_the_timer_that_nobody_asked_for_is_armed_over_a_serial_line() -> None:
    """By a night; a single command, such as hil chamber set, arms what the bench file says and no more."""
    with served(load_bench("simulated")) as simulation:
        client, chamber = client_bench(simulation.bench, simulation.ports), simulation.devices.chamber
        with open_chamber(client) as (driven, _):
            driven.prepare()
        assert chamber.timer_ends_s is None
        with build_bench(client) as bench:
            bench.devices.chamber.prepare()
        assert chamber.timer_ends_s is not None
