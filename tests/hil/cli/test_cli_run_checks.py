"""What `hil check` calls NOT stops `hil run` and `hil resume` before anything moves; what it calls ok must run."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml

from drivers.clock import VirtualClock
from hil.bench import build_bench
from hil.bench.preflight import _chamber, _disk, _guarded, _notified, _unit
from hil.config import load_bench, load_sweep, parse_bench
from hil.config.people import NotifySection
from hil.errors import InputError
from hil.files.strict import find_config
from hil.night import start_night
from hil.records import open_readonly
from procedures.devices import BenchDevices
from procedures.plan import make_plan
from procedures.settings import SweepProcedure
from procedures.stop import StopRequest

ONLOOKER = ("sweep_began", "step_began", "update", "event")
WHY = "the technician has cleared the disk meanwhile"


@pytest.fixture
def alarmed(tmp_path: Path) -> Path:
    """A bench whose chamber reports an alarm."""
    document = yaml.safe_load(load_bench("simulated").text)
    document["simulation"]["chamber_faults"] = [{"kind": "alarm"}]
    document["chamber"] |= {"driver": "watlow-f4", "model": ""}
    path = tmp_path / "alarmed.yaml"
    path.write_text(yaml.safe_dump(document, sort_keys=False))
    return path


@pytest.fixture
def huge(monkeypatch: pytest.MonkeyPatch) -> None:
    """No disk is large enough."""
    monkeypatch.setattr("hil.bench.preflight._SPARE_BYTES", 1e18)


def lines(text: str, word: str) -> list[str]:
    """The lines that begin with a word."""
    return [line for line in text.splitlines() if line.startswith(word)]


def wanted(line: str) -> float:
    """How many GB the line about the disk wants."""
    return float(line.split(" GB wanted")[0].split()[-1])


def test_run_refuses_in_the_words_of_check_and_leaves_nothing(
    hil: Any, alarmed: Path, short_sweep: Path, tmp_path: Path
) -> None:
    """Status 3, the same lines, and no folder: nothing has begun."""
    check = hil("check", alarmed, "--sweep", short_sweep)
    ended = hil("run", short_sweep, "--bench", alarmed, "--out", tmp_path / "night")
    assert (check.returncode, ended.returncode) == (3, 3)
    wrong = lines(check.stdout, "NOT")
    assert wrong
    assert lines(ended.stderr, "NOT") == wrong
    assert "acknowledge it at the chamber's panel" in ended.stderr
    assert "hil check says NOT: alarms" in ended.stderr
    assert not (tmp_path / "night").exists()


@pytest.mark.slow
def test_a_reason_lets_it_run_and_stands_in_every_record(hil: Any, huge: None, one_run: Path, tmp_path: Path) -> None:
    """The event says who, why and what; status, report and campaign repeat it."""
    night, campaign, page = tmp_path / "night", tmp_path / "campaign", tmp_path / "report.html"
    assert hil("run", one_run, "--bench", "simulated", "--out", night).returncode == 3
    assert hil("run", one_run, "--bench", "simulated", "--out", night, "--despite", WHY).returncode == 0
    with open_readonly(night) as journal:
        event = next(event for event in journal.events() if event.kind == "despite")
    assert event.evidence["why"] == WHY
    assert event.evidence["findings"][0].startswith("disk: ")
    assert WHY in json.loads(hil("status", night, "--json").stdout)["identity"]["despite"]
    assert hil("export", night, campaign).returncode == 0
    assert WHY in yaml.safe_load((campaign / "campaign.yaml").read_text())["identity"]["despite"]
    assert hil("report", campaign, "--out", page).returncode == 0
    assert WHY in page.read_text()


@pytest.mark.slow
def test_resume_looks_first_too(hil: Any, one_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A night that was cut short is not carried on into a full disk; what is done needs no room any more."""
    night = tmp_path / "night"
    stop = StopRequest()
    onlooker = SimpleNamespace(**dict.fromkeys(ONLOOKER, lambda *_: None))
    onlooker.step_ended = lambda step, _: stop.request("enough") if step.position else None
    outcome = start_night(night, load_sweep(one_run), load_bench("simulated"), stop=stop, onlookers=[onlooker])
    assert outcome.state == "aborted"
    with monkeypatch.context() as patched:
        patched.setattr("hil.bench.preflight._BYTES_PER_SAMPLE", 1e15)
        ended = hil("resume", night)
        assert (ended.returncode, len(lines(ended.stderr, "NOT"))) == (3, 1)
        whole = hil("check", one_run, "--bench", "simulated")
        assert wanted(lines(ended.stderr, "NOT")[0]) < wanted(lines(whole.stdout, "NOT")[0])
    with open_readonly(night) as journal:
        assert len(journal.controllers()) == 1
    assert hil("resume", night, "--note", "the fan again").returncode == 0
    assert json.loads(hil("status", night, "--json").stdout)["identity"]["note"] == "the fan again"


def test_what_is_done_needs_no_room() -> None:
    """Half of the collects, half of the room; and what the disk interlock keeps free comes on top."""
    plan = make_plan(SweepProcedure("t", (20.0,), positions=("1", "2")))
    imu = SimpleNamespace(sample_rate_hz=1e6)
    live: Any = SimpleNamespace(
        devices=SimpleNamespace(units={"": SimpleNamespace(imu=imu)}), bench=load_bench("simulated")
    )

    collects = [step for step in plan.steps if step.position is not None]
    left = [step for step in plan.steps if step is not collects[-1]]
    whole, rest, nothing = (wanted(_disk(steps, live, Path("/")).message) for steps in (plan.steps, left, []))
    assert whole > rest > nothing
    assert nothing == pytest.approx(0.2, abs=0.05)


def test_devices_that_call_themselves_simulated_are_refused_by_check_as_by_run() -> None:
    """A bench file without a simulation section: the first step of a night would fail, so the check does."""
    with build_bench(load_bench("simulated")) as live:
        devices = BenchDevices(
            VirtualClock(), live.devices.imu, live.devices.chamber, live.devices.positioner, simulation_declared=False
        )
        undeclared: Any = SimpleNamespace(devices=devices, bench=live.bench)
        for subject, look in (("unit", _unit), ("chamber", _chamber)):
            (finding,) = _guarded(undeclared, subject, look)  # type: ignore[arg-type]
            assert not finding.good
            assert "has no simulation section" in finding.message
            assert finding.advice.startswith("copy the simulation section")


def test_an_index_that_cannot_be_told_is_refused_before_the_night(tmp_path: Path) -> None:
    """It would fail at the first move, after hours of soaking."""
    document = yaml.safe_load(load_bench("simulated").text)

    def refused(**change: Any) -> str:
        text = yaml.safe_dump({**document, "imu": document["imu"] | change}, sort_keys=False)
        with pytest.raises(InputError) as error:
            build_bench(parse_bench(text, "my-bench.yaml"))
        return str(error.value)

    assert "positions 1 and 2 are both the unit's number 2" in refused(codes={"1": 2, "2": 2})
    frames = yaml.safe_load(find_config("imus", "mfs").read_text())
    del frames["commands"]["index"]
    (tmp_path / "mfs.yaml").write_text(yaml.safe_dump(frames, sort_keys=False))
    told = refused(description=str(tmp_path / "mfs.yaml"))
    assert told.endswith("imu.positioner: MFS has no index command; write positioner: operator")


@pytest.mark.parametrize(
    ("to", "words"),
    [
        ("env:NOT_SET_ANYWHERE", "env:NOT_SET_ANYWHERE: the variable is not set"),
        ("file:/nowhere/notify", "there is no such file"),
        ("file:empty", "it holds no address"),
        ("file:wrong", "address"),
        ("file:right", ""),
    ],
)
def test_somebody_who_could_not_be_told_is_noticed_before_the_night(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, to: str, words: str
) -> None:
    """A variable that is not set, a file without an address, an address that nothing understands; none is printed."""
    monkeypatch.setitem(sys.modules, "apprise", None)
    for name, text in (("empty", "# nobody\n"), ("wrong", "secret://me\n"), ("right", "https://example.org/x")):
        (tmp_path / name).write_text(text)
    monkeypatch.chdir(tmp_path)
    bench = load_bench("simulated").model_copy(update={"notify": NotifySection(to=(to,))})
    (found,) = _notified(bench)
    assert found.good is not bool(words)
    assert words in found.message
    assert "secret" not in found.message


def test_the_demo_looks_first_too(hil: Any, huge: None, tmp_path: Path) -> None:
    """It is refused as any night, and nothing is left."""
    ended = hil("demo", "--out", tmp_path / "demo")
    assert ended.returncode == 3
    assert "NOT  disk" in ended.stderr
    assert list(tmp_path.iterdir()) == []
