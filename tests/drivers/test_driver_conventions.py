"""Every chamber, IMU and positioner driver is found by what it can do, and held to the same conventions."""

from __future__ import annotations

import ast
import importlib
import inspect
import pkgutil
import re
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import drivers
from drivers.chambers import CHAMBER_DRIVERS, ChamberLimits, SafeState
from drivers.chambers.controller import Controller
from drivers.chambers.controllers.described import SetpointBox
from drivers.chambers.controllers.description import BoxDescription, SimulatedSection, load_box, parse_box
from drivers.chambers.controllers.questions import (
    AlarmQuestion,
    Command,
    Identity,
    Listing,
    Messages,
    ModbusSection,
    Quantity,
    Requirement,
    Setting,
    StateQuestion,
    Timer,
)
from drivers.chambers.supervised import SupervisedChamber, Supervision
from drivers.clock import VirtualClock
from drivers.simulators.chambers.catalogue import CHAMBER_SIMULATORS
from drivers.simulators.chambers.controller import ChamberFault, ChamberFaultKind
from drivers.simulators.chambers.described import simulated_box
from drivers.simulators.chambers.plant import ChamberPlant
from drivers.simulators.memory import MemoryTransport
from tests.drivers.chambers.chamber_benches import EXAMPLE_BOX

_TESTS = Path(__file__).parent
_ROLES: dict[str, frozenset[str]] = {
    "chamber": frozenset({"identify", "prepare", "read", "set_temperature", "safe_state", "close"}),
    "controller": frozenset({"identify", "state", "write", "start", "stop", "end_program", "close"}),
    "imu": frozenset({"identify", "read_block", "discard", "close"}),
    "positioner": frozenset({"move_to", "position"}),
}
# What is common to all chambers speaks no protocol of its own, a person at a positioner has no bytes, and those of what
# is borrowed are its library's.
_WITHOUT_PROTOCOL = {"SupervisedChamber", "RampedChamber", "OperatorPositioner", "IndexingPositioner"}
_WITHOUT_PROTOCOL |= {"BorrowedController", "BorrowedPositioner"}


def _classes() -> Iterator[tuple[str, type]]:
    """Find every class that does what a driver does: its role and itself."""
    for found in pkgutil.walk_packages(drivers.__path__, "drivers."):
        if found.name.startswith("drivers.simulators"):
            continue
        module = importlib.import_module(found.name)
        for _, kind in inspect.getmembers(module, inspect.isclass):
            if kind.__module__ != found.name or getattr(kind, "_is_protocol", False) or inspect.isabstract(kind):
                continue
            names = {name for name in dir(kind) if not name.startswith("_")}
            for role, needed in _ROLES.items():
                if needed <= names:
                    yield role, kind


DRIVERS = sorted(_classes(), key=lambda pair: pair[1].__qualname__)
SPEAKING = [(role, kind) for role, kind in DRIVERS if kind.__name__ not in _WITHOUT_PROTOCOL]
of_a_driver = pytest.mark.parametrize(("role", "kind"), DRIVERS, ids=lambda value: getattr(value, "__name__", value))
of_a_protocol = pytest.mark.parametrize(("role", "kind"), SPEAKING, ids=lambda value: getattr(value, "__name__", value))


def _module(kind: type) -> ModuleType:
    return importlib.import_module(kind.__module__)


def _docstring(kind: type) -> str:
    return " ".join((_module(kind).__doc__ or "").split())


def test_the_drivers_are_found() -> None:
    """If this list is short the rest proves nothing."""
    found = {kind.__name__ for _, kind in DRIVERS}
    assert {"VoetschAscii", "SetpointBox", "StreamImu", "OperatorPositioner", "IndexingPositioner"} <= found


@of_a_driver
def test_the_module_begins_with_a_worked_example(role: str, kind: type) -> None:
    """How it is made, in code, with its own name."""
    assert kind.__name__ in (_module(kind).__doc__ or "") + (kind.__doc__ or "") or role == "positioner"


@of_a_protocol
def test_the_docstring_says_what_is_verified_and_what_is_inferred(role: str, kind: type) -> None:
    """Nobody may believe that bytes were seen which were not."""
    if role in ("chamber", "controller"):
        text = _docstring(kind)
        assert re.search(r"[Bb]yte-exact|Computed from", text)
        assert "nferred" in text


@of_a_protocol
def test_the_docstring_gives_unit_resolution_or_limits_and_times(role: str, kind: type) -> None:
    """°C, how fine or how far, and how long a reply is waited for or what pauses are kept."""
    if role in ("chamber", "controller"):
        text = _docstring(kind) + " ".join((kind.__doc__ or "").split())
        assert "°C" in text
        assert re.search(r"0\.1 °C|tenths|decimals|registers|16 bits|limits", text)
        assert re.search(r"awaited|[Pp]auses|time-out", text)


@of_a_protocol
def test_a_controller_without_a_dead_man_says_so(role: str, kind: type[Controller]) -> None:
    """Whoever leaves a chamber alone must know that it goes on."""
    if role == "controller" and kind.arm_dead_man is Controller.arm_dead_man:
        assert re.search(r"[Nn]o timer (that )?stops a (chamber|bath) left alone", _docstring(kind))


@of_a_protocol
def test_a_simulator_stands_beside_it(role: str, kind: type) -> None:
    """Under the same name, with a docstring that says what it does and how it misbehaves."""
    own = "unit" if kind.__name__ == "StreamImu" else f"chambers.{kind.__module__.rpartition('.')[2]}"
    simulator = importlib.import_module(f"drivers.simulators.{own}")
    assert simulator.__doc__
    devices = [
        each
        for _, each in inspect.getmembers(simulator, inspect.isclass)
        if each.__module__ == simulator.__name__ and {"receive", "transmit", "next_transmission"} <= set(dir(each))
    ]
    assert devices


@cache
def _names(path: Path) -> set[str]:
    return {node.id for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.Name)}


@of_a_protocol
def test_its_bytes_are_written_down_in_a_test(role: str, kind: type) -> None:
    """A transcript with nothing left over; for a stream, frames that are written down."""
    wanted = {"TranscriptDevice"} if role in ("chamber", "controller") else {kind.__name__}
    tests = [path for path in _TESTS.rglob("test_*.py") if {kind.__name__} | wanted <= _names(path)]
    assert tests, f"no test of {kind.__name__} has a transcript"
    if role in ("chamber", "controller"):
        assert any(".finish()" in path.read_text(encoding="utf-8") for path in tests)


@of_a_protocol
def test_every_chamber_can_be_named_in_a_bench_file(role: str, kind: type) -> None:
    """A driver that no bench file can name is none."""
    if role in ("chamber", "controller"):
        listed = (Path(drivers.__path__[0]) / "chambers" / "catalogue.py").read_text(encoding="utf-8")
        assert re.search(rf"(\(|, |= ){kind.__name__}\b", listed)


@pytest.mark.parametrize("role_and_kind", [pair for pair in DRIVERS if pair[0] == "positioner"], ids=str)
def test_a_positioner_takes_a_time_out(role_and_kind: tuple[str, Any]) -> None:
    """A move that never ends must end."""
    _, kind = role_and_kind
    assert "timeout_s" in inspect.signature(kind.move_to).parameters


@pytest.mark.parametrize("name", CHAMBER_DRIVERS)
def test_every_named_chamber_has_line_settings_and_a_simulator(name: str) -> None:
    """As the maker ships it."""
    driver = CHAMBER_DRIVERS[name]
    assert driver.title
    assert driver.line.baud in (1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200)
    assert name in CHAMBER_SIMULATORS


DESCRIBED = sorted(
    [*(Path(drivers.__path__[0]) / "chambers" / "boxes").glob("*.yaml"), *EXAMPLE_BOX.parent.glob("*.yaml")]
)
of_a_description = pytest.mark.parametrize("path", DESCRIBED, ids=lambda path: path.stem)


def test_the_descriptions_are_found_and_those_of_the_drivers_can_be_named_in_a_bench_file() -> None:
    """If this list is short the rest proves nothing."""
    assert {"watlow-f4", "watlow-f4t", "ezt-570i", "temptronic-ats", "weiss-sb22"} <= {path.stem for path in DESCRIBED}
    own = {path.stem: path for path in DESCRIBED if path.parent.name == "boxes"}
    assert own == {name: driver.description for name, driver in CHAMBER_DRIVERS.items() if driver.description}


@of_a_description
def test_a_description_says_what_is_verified_and_what_is_inferred(path: Path) -> None:
    """Nobody may believe that bytes were seen which were not; and who is left alone goes on where no timer stops it."""
    box = load_box(path)
    assert box.title
    assert re.search(r"[Bb]yte-exact|Computed from|Nothing on a real one", box.verified)
    assert "nferred" in box.verified
    assert box.dead_man_s or re.search(r"[Nn]o timer (that )?stops a (chamber|bath) left alone", box.verified)


@of_a_description
def test_the_bytes_of_a_description_are_written_down_in_a_test(path: Path) -> None:
    """A transcript with nothing left over, in a test that names it."""
    texts = [each.read_text(encoding="utf-8") for each in _TESTS.rglob("test_*.py")]
    names = (f'"{path.stem}"', path.stem.replace("-", "_"), path.stem.replace("-", ""), "EXAMPLE_BOX")
    assert any(
        ".finish()" in text and any(name in text for name in names[: 4 if path == EXAMPLE_BOX else 3]) for text in texts
    )


@of_a_description
def test_a_description_hangs_together(path: Path) -> None:
    """Against the box that it describes: set, reached, alarmed where it tells alarms, made safe, all pauses kept."""
    box = load_box(path)
    device = simulated_box(ChamberPlant(), box, pause_s=box.pause_after_question_s)
    clock = VirtualClock()
    safe = SafeState("off") if box.stop else SafeState("hold", 25.0)
    controller = SetpointBox(MemoryTransport(device, clock, "sim://chamber"), clock, box)
    asks = Supervision(limits=ChamberLimits(-35.0, 65.0), safe=safe, celsius_confirmed=True)
    chamber = SupervisedChamber(controller, clock, replace(asks, dead_man_s=5400.0 if box.dead_man_s else None))
    chamber.prepare()
    chamber.set_temperature(-29.7222)
    clock.sleep(3600.0)
    reading = chamber.read()
    assert reading.temperature_degC == pytest.approx(-29.7, abs=0.1)
    assert (reading.setpoint_degC, reading.alarms) == (pytest.approx(-29.7), ())
    device.inject(ChamberFault(ChamberFaultKind.ALARM, begins_s=clock.now()))
    assert bool(chamber.read().alarms) == bool(box.alarms)
    chamber.safe_state()
    assert device.mode == "OFF" if box.stop else device.setpoint_degC == 25.0
    assert device.ignored_requests == 0


DOCS = EXAMPLE_BOX.parents[2] / "docs"


def test_the_how_tos_description_is_one() -> None:
    """As it stands there, against the box that it describes."""
    text = (DOCS / "how-to" / "describe-a-modbus-chamber.md").read_text(encoding="utf-8")
    box = parse_box(re.findall(r"```yaml\n(.*?)```", text, re.DOTALL)[0], "how-to")
    clock, device = VirtualClock(), simulated_box(ChamberPlant(), box)
    controller = SetpointBox(MemoryTransport(device, clock, "sim://chamber"), clock, box)
    chamber = SupervisedChamber(
        controller, clock, Supervision(limits=ChamberLimits(-35.0, 65.0), safe=SafeState("off"))
    )
    chamber.prepare()
    device.alarms = ("50.3",)
    assert chamber.read().alarms == ("door open",)
    assert chamber.safe_state().action == "off"


def test_the_reference_has_every_key_of_a_description() -> None:
    """In its words, or nobody would know of it."""
    text = (DOCS / "reference" / "chamber-descriptions.md").read_text(encoding="utf-8")
    kinds = (BoxDescription, ModbusSection, SimulatedSection, Identity, StateQuestion, AlarmQuestion, Requirement)
    kinds += (Quantity, Command, Timer, Listing, Messages, Setting)
    keys = {field.alias or key for kind in kinds for key, field in kind.model_fields.items()}
    assert {key for key in keys - {"step"} if not re.search(rf"\b{key}\b", text)} == set()
