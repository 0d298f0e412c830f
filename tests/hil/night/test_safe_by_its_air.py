"""A chamber that acknowledges its safe state and does not do it, through bytes: journal, status, exit status, check."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml

from hil.cli.app import run as hil
from hil.config import load_bench, parse_bench, parse_sweep
from hil.night import resume_night, start_night
from hil.records import open_readonly
from hil.records.status import night_status
from procedures.stop import StopRequest
from tests.hil.twin.serving import client_bench, served

SWEEP = """
title: One short self-calibration in the heat
temperatures: [60 degC]
self_calibrations_per_temperature: 1
positions: [1, 3]
restabilisation: {at_least: 5 min, window: 5 min, ceiling: 60 min, unit_band: 9 degC, unit_slope: 5 degC/min}
collect: {settle: 5 s, duration: 20 s}
"""
LIES = "faults: [{at: T1/S1/C1/collect, device: chamber, kind: %s}]\n"


def started(folder: Path, fault: str, **more: object):
    """Carry such a night out on the simulated bench."""
    text = load_bench("simulated").text + (LIES % fault if fault else "")
    return start_night(folder, parse_sweep(SWEEP, "hot.yaml"), parse_bench(text, "bench.yaml"), **more)  # type: ignore[arg-type]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "status", "word"),
    [
        ("", 0, "SAFE"),
        ("not_carried_out", 5, "NOT SAFE"),
        ("silence", 6, "NOT KNOWN"),
    ],
)
def test_three_words_have_three_ends(tmp_path: Path, fault: str, status: int, word: str) -> None:
    """The exit status, the status document and the journal say the same; over 60 °C that nothing stopped never 0."""
    ended = started(tmp_path / "n", fault)
    assert ended.exit_status == status, ended
    found = night_status(tmp_path / "n")
    assert found["chamber"] == word
    with open_readonly(tmp_path / "n") as journal:
        last = [event for event in journal.events() if event.kind.startswith("safe-state") and event.evidence][-1]
        told = " ".join(attempt.reason for attempt in journal.attempts())
    assert last.evidence == {"chamber": word}
    if status:
        assert word in ended.reason
        assert any(word in line for line in found["problems"])
    else:
        assert (found["state"], found["problems"]) == ("complete", [])
        assert last.message == "the air has shown that it is in its safe state"
        assert "THE CHAMBER IS SAFE: the air has moved from 60" in told
        assert "before a door is opened, see that it is there" in told


@pytest.mark.slow
def test_an_abort_over_a_chamber_that_does_not_obey_is_not_safe_until_it_does(tmp_path: Path) -> None:
    """5, not 1; a resume that ends well says SAFE again."""
    stop = StopRequest()

    class Aborts:
        def __getattr__(self, name: str):
            return lambda *_: stop.request("enough") if name == "step_ended" and "C1/collect" in str(_) else None

    ended = started(tmp_path / "n", "not_carried_out", stop=stop, onlookers=[Aborts()])
    assert (ended.state, ended.exit_status) == ("aborted", 5)
    assert ended.reason.startswith("enough; THE CHAMBER IS NOT SAFE: standby was acknowledged and is not carried out")
    assert resume_night(tmp_path / "n").exit_status == 0
    assert night_status(tmp_path / "n")["chamber"] == "SAFE"


@pytest.mark.slow
@pytest.mark.timeout(60)
def test_chamber_stop_over_a_pseudo_terminal_ends_by_what_the_air_does(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Through pyserial: 5 where the air stays at 60 °C behind a STANDBY for as long as it may."""
    document = yaml.safe_load(load_bench("simulated").text)
    document["chamber"] |= {"driver": "simserv", "model": ""}  # of all chambers the one with the least pacing
    document["simulation"]["start"]["temperature"] = "60 degC"
    with served(parse_bench(yaml.safe_dump(document), "served.yaml")) as simulation:
        client = yaml.safe_load(client_bench(simulation.bench, simulation.ports).text)
        client["polling"] = {"interval": "0.1 s", "safe_air": "0.2 s"}
        path = tmp_path / "bench.yaml"
        path.write_text(yaml.safe_dump(client))
        assert hil(["chamber", str(path), "stop"]) == 5
    assert "THE CHAMBER IS NOT SAFE: standby was acknowledged and is not carried out" in capsys.readouterr().err


def test_a_sweep_that_ends_in_the_heat_is_warned_about_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """In check and in plan; with a final temperature, or one at which a door may be opened, nothing is said."""
    for name, more, said in (("hot", "", 1), ("final", "final: 23 degC\n", 0)):
        path = tmp_path / f"{name}.yaml"
        path.write_text(SWEEP + more)
        assert hil(["check", str(path), "--bench", "simulated", "--json"]) == 0
        ends = [each for each in json.loads(capsys.readouterr().out)["findings"] if each["subject"] == "end"]
        assert [each["good"] for each in ends] == [True] * said
        assert all("in standby with the chamber at 60.0 °C; better: final: 23 degC" in each["message"] for each in ends)
        assert hil(["plan", str(path), "--bench", "simulated"]) == 0
        assert capsys.readouterr().err.count("final: 23 degC") == said
    assert hil(["plan", "quick", "--bench", "simulated"]) == 0
    assert "final" not in capsys.readouterr().err
