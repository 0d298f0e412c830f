"""A chamber of any kind on the virtual clock: driver, wire that is watched, simulated controller, air."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from drivers.chambers import CHAMBER_DRIVERS, Chamber, ChamberLimits, ChamberOptions, SafeState
from drivers.clock import VirtualClock
from drivers.simulators.chambers.catalogue import CHAMBER_SIMULATORS, SimulatorOptions
from drivers.simulators.chambers.controller import ChamberFault, ChamberFaultKind
from drivers.simulators.chambers.plant import ChamberPlant
from drivers.simulators.memory import MemoryTransport

EXAMPLE_BOX = Path(__file__).resolve().parents[3] / "configs" / "chambers" / "temptronic-ats.yaml"
LIMITS = ChamberLimits(-35.0, 65.0)
HOLD = SafeState("hold", 25.0)


def modbus_setpoints(registers: Sequence[int], scale: float = 10.0) -> Callable[[bytes], list[float]]:
    """Return what finds the setpoints in what a host sent: function 6 to one of these registers, signed tenths."""

    def find(sent: bytes) -> list[float]:
        heads = [bytes((1, 6)) + struct.pack(">H", register) for register in registers]
        places = [at for at in range(len(sent)) if sent[at : at + 4] in heads]
        return [struct.unpack(">h", sent[at + 4 : at + 6])[0] / scale for at in places]

    return find


def float_setpoints(sent: bytes) -> list[float]:
    """Return the setpoints in what a host sent: function 16 to 2782, two registers, low word first."""
    head = bytes((1, 16)) + struct.pack(">HHB", 2782, 2, 4)
    places = [at + len(head) for at in range(len(sent)) if sent[at : at + len(head)] == head]
    return [round(struct.unpack(">f", sent[at + 2 : at + 4] + sent[at : at + 2])[0], 4) for at in places]


@dataclass(frozen=True)
class Kind:
    """What the tests know of a kind of chamber: where setpoints are in its bytes, how a set and a read are called."""

    setpoints: Callable[[bytes], list[float]]
    read: str
    write: str
    tells_unit: bool = False
    native_limits: bool = True
    knows_standby: bool = False
    refuses: bool = True  # says no where it does not do what it is asked
    sees_programs: bool = True
    has_programs: bool = True


def text_setpoints(pattern: bytes) -> Callable[[bytes], list[float]]:
    """Return what finds the setpoints in what a host sent as text."""
    import re

    return lambda sent: [float(value) for value in re.findall(pattern, sent)]


KINDS: dict[str, Kind] = {
    "espec": Kind(text_setpoints(rb"TEMP,S([-0-9.]+)\r\n"), "TEMP?", "TEMP,S", knows_standby=True),
    "watlow-f4": Kind(modbus_setpoints([300]), "read 100", "write 300", tells_unit=True),
    "ezt-570i": Kind(modbus_setpoints([60]), "read 60", "write 60", refuses=False),
    "voetsch-ascii2": Kind(
        text_setpoints(rb"\$00E ([-0-9.]+) "),
        "$00I",
        "$00E",
        native_limits=False,
        refuses=False,
        sees_programs=False,
    ),
    "simserv": Kind(text_setpoints(rb"11001\xb61\xb61\xb6([-0-9.]+)\r"), "11004", "11001", native_limits=False),
    "thermotron": Kind(text_setpoints(rb"SETP1,([-0-9.]+)\r"), "PVAR1?", "SETP1,", native_limits=False),
    "julabo": Kind(
        text_setpoints(rb"OUT_SP_00 ([-0-9.]+)\r"),
        "IN_PV_00",
        "OUT_SP_00",
        refuses=False,
        sees_programs=False,
        has_programs=False,
    ),
    "box": Kind(
        text_setpoints(rb"SETP ([-0-9.]+)\n"), "TEMP?", "SETP ", refuses=False, sees_programs=False, has_programs=False
    ),
    "watlow-f4t": Kind(float_setpoints, "read 2820", "write 2782", tells_unit=True),
}


class Wire:
    """A simulated device, with every byte that the host sends kept."""

    def __init__(self, device: Any) -> None:
        self.device = device
        self.sent = b""

    def receive(self, data: bytes, now_s: float) -> None:
        """Keep, and pass on."""
        self.sent += data
        self.device.receive(data, now_s)

    def transmit(self, now_s: float) -> bytes:
        """Pass on."""
        return bytes(self.device.transmit(now_s))

    def next_transmission(self, now_s: float) -> float | None:
        """Pass on."""
        at_s: float | None = self.device.next_transmission(now_s)
        return at_s


class ChamberBench:
    """A chamber, its controller, its air, and the clock they share."""

    def __init__(
        self,
        name: str,
        *,
        safe: SafeState = HOLD,
        limits: ChamberLimits = LIMITS,
        faults: Sequence[ChamberFault] = (),
        mode: str = "OFF",
        setpoint_degC: float | None = None,
        **options: Any,
    ) -> None:
        description = EXAMPLE_BOX if name == "box" else None
        self.kind = KINDS[name]
        self.clock = VirtualClock()
        self.plant = ChamberPlant()
        self.device: Any = CHAMBER_SIMULATORS[name](
            self.plant,
            SimulatorOptions(
                faults=tuple(faults),
                description=description,
                warning_limits=options.get("warning_limits"),
            ),
        )
        self.device.mode, self.device.strict = mode, True
        if setpoint_degC is not None:
            self.device.setpoint_degC = setpoint_degC
        self.device._condition(0.0)
        self.wire = Wire(self.device)
        self.transport = MemoryTransport(self.wire, self.clock, "sim://chamber")
        self.options = ChamberOptions(limits, safe, description=description, **options)
        self.chamber: Chamber = CHAMBER_DRIVERS[name].build(self.transport, self.clock, self.options)

    def rebuilt(self, **options: Any) -> Chamber:
        """Return another driver on the same port, as after a restart of the program."""
        name = next(name for name, kind in KINDS.items() if kind is self.kind)
        return CHAMBER_DRIVERS[name].build(self.transport, self.clock, replace(self.options, **options))

    def fault(self, kind: ChamberFaultKind, **details: Any) -> None:
        """Let something go wrong from now on."""
        self.device.inject(ChamberFault(kind, **({"begins_s": self.clock.now()} | details)))

    @property
    def setpoints(self) -> list[float]:
        """Every setpoint that went over the wire."""
        return self.kind.setpoints(self.wire.sent)

    def is_safe(self) -> bool:
        """Tell whether the controller is where the bench file wants it left."""
        safe = self.options.safe
        if safe.action == "hold":
            return bool(self.device.mode == "CONSTANT" and self.device.setpoint_degC == safe.temperature_degC)
        return self.device.mode in (("STANDBY", "OFF") if safe.action == "standby" else ("OFF",))
