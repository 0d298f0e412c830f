"""Bench, sweep and campaign files with anything in them: understood or refused in one sentence, never half of it.

The shipped files are changed where the structure is (a value, a key, a section); bytes of campaign files are fuzzed
beside their reader. Everything goes through the command line.
"""

from __future__ import annotations

import copy
import datetime
import json
import math
import os
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drivers.chambers import CHAMBER_DRIVERS, ChamberLimits, ChamberOptions, SafeState
from drivers.clock import VirtualClock
from drivers.errors import DeviceError
from drivers.simulators.memory import MemoryTransport
from hil.cli.app import run
from hil.config import load_bench
from hil.files.strict import find_config

_JUNK: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 10**30, 0.5, math.nan, math.inf, "", " ", "x", "nan degC", "1e999 degC", "-300 degC"),
    *(
        "45 kg",
        "45 min",
        "200 degC",
        "20 degC",
        "1 2 3",
        "sim://imu",
        "sim://chamber",
        "/dev/null",
        "../../..",
        "é\u2028",
    ),
    *(
        "{}",
        "[",
        "9" * 400,
        [],
        [None],
        [[]],
        {},
        {"a": 1},
        {1: 2},
        {None: None},
        datetime.date(2020, 1, 1),
        b"\xff\x00",
    ),
)
_BENCHES = (
    "simulated",
    *(
        pytest.param(f"{name}-example", marks=pytest.mark.slow)
        for name in ("espec-stim300", "voetsch-vectornav", "watlow-f4-kvh1750")
    ),
)
_EXAMPLES = int(os.environ.get("HIL_FUZZ_EXAMPLES", "12"))
_FUZZED = settings(max_examples=_EXAMPLES, suppress_health_check=[HealthCheck.function_scoped_fixture])


def places(document: object, above: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the place of every value in a document."""
    pairs = (
        document.items() if isinstance(document, dict) else enumerate(document) if isinstance(document, list) else ()
    )
    for key, value in pairs:
        yield (*above, key)
        yield from places(value, (*above, key))


@st.composite
def changed(draw: st.DrawFn, document: dict[str, Any]) -> dict[str, Any]:
    """Return the document with one to three values, keys or sections changed, removed or put in."""
    document = copy.deepcopy(document)
    for _ in range(draw(st.integers(1, 3))):
        place = draw(st.sampled_from(list(places(document))))
        *above, key = place
        parent: Any = document
        for each in above:
            parent = parent[each]
        match draw(st.sampled_from(["value", "value", "value", "remove", "key", "text", "graft"])):
            case "value":
                parent[key] = copy.deepcopy(draw(st.sampled_from(_JUNK)))  # it may be changed in its turn
            case "remove":
                del parent[key]
            case "key" if isinstance(parent, dict):
                parent[draw(st.sampled_from(["x", 1, None, "", str(key) + "s"]))] = parent.pop(key)
            case "graft":
                other = draw(st.sampled_from(list(places(document))))
                found: Any = document
                for each in other:
                    found = found[each]
                parent[key] = copy.deepcopy(found)
            case _:
                parent[key] = draw(st.text(max_size=8))
        if not document:
            break
    return document


def asked(*arguments: object) -> tuple[int, str, str]:
    """Return exit status and both outputs of a command; it must be understood or refused in one sentence."""
    out, err = StringIO(), StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        status = run([str(each) for each in arguments])
    said = err.getvalue()
    assert "internal error" not in said, said
    assert "Traceback" not in said
    assert status in (0, 2), said
    if status == 2:
        assert out.getvalue() == ""
        refusals = [line for line in said.splitlines() if line.startswith("hil: ")]
        assert len(refusals) == 1, said
    return status, out.getvalue(), said


def read(kind: str, name: str) -> dict[str, Any]:
    """Return a shipped file as YAML gives it."""
    return dict(yaml.safe_load(find_config(kind, name).read_text()))


def safe_setpoints(plan: str, low_degC: float, high_degC: float) -> None:
    """Every temperature of the plan lies within the bench's limits."""
    for step in json.loads(plan)["steps"]:
        temperature = step.get("temperature_degC")
        assert temperature is None or low_degC <= temperature <= high_degC


@pytest.mark.slow
@pytest.mark.parametrize("name", _BENCHES)
@_FUZZED
@given(data=st.data())
def test_a_changed_bench_file_is_understood_or_refused(tmp_path: Path, name: str, data: st.DataObject) -> None:
    """Where it is understood, no step of the plan is outside the limits that it gives."""
    document = data.draw(changed(read("benches", name)))
    path = tmp_path / "bench.yaml"
    path.write_text(yaml.safe_dump(document, sort_keys=False, allow_unicode=True))
    status, out, _ = asked("plan", "rd-gc-86-1", "--bench", path, "--json")
    if status == 0:
        limits = load_bench(path).chamber.limits
        assert math.isfinite(limits.low_degC)
        assert math.isfinite(limits.high_degC)
        safe_setpoints(out, limits.low_degC, limits.high_degC)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["rd-gc-86-1", "quick"])
@_FUZZED
@given(data=st.data())
def test_a_changed_sweep_file_is_understood_or_refused(tmp_path: Path, name: str, data: st.DataObject) -> None:
    """Where it is understood, no step is outside the bench's limits."""
    path = tmp_path / "sweep.yaml"
    document = data.draw(changed(read("sweeps", name)))
    path.write_text(yaml.safe_dump(document, sort_keys=False, allow_unicode=True))
    status, out, _ = asked("plan", path, "--bench", "simulated", "--json")
    if status == 0:
        safe_setpoints(out, -45.0, 75.0)


@pytest.mark.slow
@_FUZZED
@given(data=st.data())
def test_changed_faults_are_understood_or_refused(tmp_path: Path, data: st.DataObject) -> None:
    """The list of faults is read as strictly as the rest."""
    faults = [
        {"at": "2 h", "device": "imu", "kind": "corrupted_bytes", "size": 0.1, "duration": "5 min"},
        {"at": "T1/S1/restabilise", "device": "chamber", "kind": "runaway", "size": "5 delta_degC"},
        {"at": "1 h", "device": "clock", "kind": "jump", "size": "-10 min"},
    ]
    document = data.draw(changed({"faults": faults}))
    path = tmp_path / "bench.yaml"
    path.write_text(yaml.safe_dump({**read("benches", "simulated"), **document}, sort_keys=False, allow_unicode=True))
    asked("plan", "rd-gc-86-1", "--bench", path, "--json")


_CAMPAIGN = {
    "schema": "hil.campaign/1",
    "title": "t",
    "source": "s",
    "site": {"latitude_deg": 34.6, "heading_deg": 30.0},
    "sensors": {2: {"axes": ["A", "B", "S"], "channels": {"RA": "A", "RB": "B"}}},
    "conditions": {"supply_V": "supply voltage, volt"},
    "verdicts": {1: {"verdict": "MARGINAL", "reason": "r"}},
}
_HEAD = (
    "collect,run,sensor,position,start_s,duration_s,f_A_g,f_B_g,f_S_g,w_A_deg_per_hr,w_B_deg_per_hr,w_S_deg_per_hr,"
    "RA_deg_per_hr,RB_deg_per_hr,RA_se_deg_per_hr,RB_se_deg_per_hr,temperature_degC,supply_V"
)
_ROWS = (
    "1,1,2,1,0,60,-1,0,0,0,0,0,1,2,0.1,0.1,20,28",
    "2,1,2,2,100,60,1,0,0,0,0,0,3,4,0.1,0.1,20,28",
    "3,1,2,3,200,60,0,0,1,0,0,0,5,6,0.1,0.1,20,28",
)
_CELLS = (
    "",
    " ",
    "x",
    "nan",
    "inf",
    "-inf",
    "1e400",
    "1e-400",
    "0x10",
    "1,5",
    '"',
    "1;2",
    "-999",
    "0",
    "é",
    "\u2212 1",
    "1e3",
)


@pytest.mark.parametrize("command", [pytest.param("solve", marks=pytest.mark.slow), "import"])
@_FUZZED
@given(data=st.data())
def test_a_changed_campaign_is_understood_or_refused(tmp_path: Path, command: str, data: st.DataObject) -> None:
    """Header, cells, columns and rows; a refused import leaves nothing behind."""
    header = data.draw(st.one_of(st.just(_CAMPAIGN), changed(_CAMPAIGN)))
    table = [line.split(",") for line in (_HEAD, *_ROWS)]
    for _ in range(data.draw(st.integers(0, 3))):
        row = data.draw(st.integers(0, len(table) - 1))
        column = data.draw(st.integers(0, len(table[row]) - 1)) if table[row] else 0
        match data.draw(st.sampled_from(["cell", "cell", "cut", "row", "column"])):
            case "cell" if table[row]:
                table[row][column] = data.draw(st.sampled_from(_CELLS))
            case "cut":
                del table[row][column:]
            case "row":
                table.append(list(table[row]))
            case _:
                for line in table:
                    del line[column : column + 1]
    folder, out = tmp_path / "campaign", tmp_path / "imported"
    folder.mkdir(exist_ok=True)
    (folder / "campaign.yaml").write_text(yaml.safe_dump(header, sort_keys=False, allow_unicode=True))
    (folder / "collects.csv").write_text("\n".join(",".join(line) for line in table) + "\n")
    if command == "solve":
        asked("solve", folder, "--json")
        return
    status, _, _ = asked("import", folder / "collects.csv", out)
    assert out.exists() == (status == 0)
    for path in sorted(out.rglob("*"), reverse=True) if out.exists() else ():
        path.unlink() if path.is_file() else path.rmdir()
    if out.exists():
        out.rmdir()


class _Babbler:
    """A device that answers every request with what it was given, and remembers what it was sent."""

    def __init__(self, replies: list[bytes]) -> None:
        self._replies = replies
        self._due: list[bytes] = []
        self.sent = b""

    def receive(self, data: bytes, now_s: float) -> None:
        self.sent += data
        if self._replies:
            self._due.append(self._replies.pop(0))

    def transmit(self, now_s: float) -> bytes:
        due, self._due = b"".join(self._due), []
        return due

    def next_transmission(self, now_s: float) -> float | None:
        return now_s if self._due else None


@pytest.mark.parametrize("driver", sorted(set(CHAMBER_DRIVERS) - {"box"}))
@_FUZZED
@given(data=st.data())
def test_a_chamber_that_answers_anything_gives_a_named_error(driver: str, data: st.DataObject) -> None:
    """Bytes of any kind, and pieces of real replies: a device error or an answer, in bounded time, nothing else."""
    piece = st.one_of(
        st.binary(max_size=24),
        st.sampled_from(
            [b"23.0,23.0,80.0,-50.0\r\n", b"OK\r\n", b"CONSTANT\r\n", b"P300 1.0\r\n", b"1\r", b"\x01\x03\x02\x00\xe6"]
        ),
    )
    device = _Babbler(data.draw(st.lists(piece, max_size=30)))
    clock = VirtualClock()
    port = MemoryTransport(device, clock, "sim://chamber")
    options = ChamberOptions(
        limits=ChamberLimits(-35.0, 65.0), safe=SafeState("hold", 25.0), celsius_confirmed=True, expected_model=None
    )
    chamber = CHAMBER_DRIVERS[driver].build(port, clock, options)
    for call in (
        chamber.identify,
        chamber.prepare,
        chamber.read,
        lambda: chamber.set_temperature(30.0),
        lambda: chamber.set_temperature(300.0),
        chamber.safe_state,
    ):
        try:
            answer = call()
        except DeviceError:
            continue
        assert answer is None or getattr(answer, "model", None) is not None or -100.0 < answer.temperature_degC < 250.0
    assert b"300" not in device.sent
    assert clock.now() < 3600.0
