"""Makes the faults of a bench file happen on its simulated devices, clock, disk and controller.

`hil.bench` does this for every bench that is simulated in process. A night is begun with the injector's `disk`, and
with itself as an onlooker: it sees the steps that faults wait for. A night that is carried on meets the faults that
are still to come, and those that are still going on by the clock; what happened in a moment has happened.
"""

import errno
import math
import os
import signal
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from drivers.clock import Clock, VirtualClock
from drivers.positioners.positioner import AskOperator
from drivers.simulators.chambers.controller import ChamberFault, ChamberFaultKind
from drivers.simulators.memory import MemoryTransport
from drivers.simulators.unit import FaultWindow, ImuFault
from hil.config.ports import unit_port
from hil.config.simulation import Fault
from hil.files.durable import RealDisk
from hil.twin.devices import SimulatedBench
from hil.twin.motion import FROM_THE_START, Resumed
from procedures.plan import Step
from procedures.progress import Progress, Snapshot

_EXCHANGED_IN_S = 8.0


class FullDisk(RealDisk):
    """The operating system's files, on a disk that is full from time to time."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self.full_between: list[tuple[float, float]] = []

    def write(self, path: Path, data: bytes) -> None:
        """Write half of `data` and raise `OSError` while the disk is full."""
        if any(begins_s <= self._clock.now() < ends_s for begins_s, ends_s in self.full_between):
            path.write_bytes(data[: len(data) // 2])
            raise OSError(errno.ENOSPC, "No space left on device")
        super().write(path, data)


class FaultInjector(Progress):
    """The faults of one bench in one process; what waited for a step that has begun before has happened."""

    def __init__(self, faults: Sequence[Fault], clock: Clock, resumed: Resumed = FROM_THE_START) -> None:
        begun = resumed.begun
        over = {*begun, *(key.partition("@")[0] for key in begun)}  # a step, and the stage of all units
        self._waiting = [fault for fault in faults if fault.at_s is None and fault.at not in over]
        self._timed = [fault for fault in faults if fault.at_s is not None]
        self._clock = clock
        self._begun_s = clock.now() - resumed.gone_s  # what the clock showed, or would have shown, when the night began
        self._kill_s = math.inf
        self._operator: list[tuple[str, float, float]] = []
        self._devices: SimulatedBench | None = None
        self._ports: Mapping[str, MemoryTransport] = {}
        self.disk = FullDisk(clock)
        """The disk for the night's blocks."""

    def inject(self, devices: SimulatedBench, ports: Mapping[str, MemoryTransport]) -> None:
        """Let the faults happen to these devices at their times."""
        self._devices, self._ports = devices, ports
        for fault in self._timed:
            self._let_happen(fault, self._begun_s + (fault.at_s or 0.0))

    def answering(self, ask: AskOperator) -> AskOperator:
        """Return who answers questions, except while nobody does."""

        def answer(question: str, timeout_s: float) -> bool | None:
            given = ask(question, timeout_s)
            return None if self._operator_has("no_answer") else given

        return answer

    def hands(self, positions: Sequence[str]) -> Callable[[str], None]:
        """Return what an operator does with the simulated unit: lays it as asked, except while they lay it wrong."""

        def turn(position: str) -> None:
            if self._operator_has("wrong_position"):
                position = positions[(positions.index(position) + 1) % len(positions)]
            if self._devices is not None:
                for imu in self._devices.imus.values():
                    imu.turn_by_hand(position, self._clock.now())

        return turn

    def step_began(self, step: Step, attempt: int) -> None:  # noqa: ARG002 - an onlooker's
        """Let happen what waits for this step, once; not when it is done again."""
        for fault in [each for each in self._waiting if each.at in (step.key, step.stage)]:
            self._waiting.remove(fault)
            self._let_happen(fault, self._clock.now())
        self._kill_if_due()

    def update(self, snapshot: Snapshot) -> None:  # noqa: ARG002 - an onlooker's
        """Kill the controller once that is due."""
        self._kill_if_due()

    def _kill_if_due(self) -> None:
        if self._clock.now() >= self._kill_s:
            os.kill(os.getpid(), signal.SIGKILL)

    def _operator_has(self, kind: str) -> bool:
        return any(k == kind and begins_s <= self._clock.now() < ends_s for k, begins_s, ends_s in self._operator)

    def _let_happen(self, fault: Fault, begins_s: float) -> None:
        """Give the fault to whom it concerns, unless it was over before this process began."""
        ends_s = begins_s + (math.inf if fault.duration_s is None else fault.duration_s)
        devices, meaning = self._devices, fault.meaning
        if (ends_s if meaning.lasts else begins_s) < self._clock.now() or devices is None:
            return
        units = [fault.unit] if fault.unit else list(devices.imus)
        match fault.device:
            case "imu" | "chamber" if fault.kind == "unplugged":
                keys = [unit_port(name) for name in units] if fault.device == "imu" else ["chamber.port"]
                for key in self._ports.keys() & keys:
                    self._ports[key].pulled_between.append((begins_s, ends_s))
            case "imu":
                kind, share = ImuFault(meaning.simulated), fault.amount if meaning.size else 1.0
                for name in units:
                    devices.imus[name].inject(FaultWindow(kind, begins_s, ends_s, share))
                    if kind is ImuFault.EXCHANGED:
                        stall = FaultWindow(ImuFault.STALL, begins_s, begins_s + _EXCHANGED_IN_S)
                        devices.imus[name].inject(stall)
            case "chamber":
                size: dict[str, Any] = {meaning.sets: fault.amount} if meaning.sets else {}
                kinds = [ChamberFaultKind(meaning.simulated)]
                if fault.kind == "power_cycle" and fault.duration_s is not None:
                    kinds.append(ChamberFaultKind.DEAF)
                for each in kinds:
                    devices.chamber.inject(ChamberFault(each, begins_s, times=None, ends_s=ends_s, **size))
            case "disk":
                self.disk.full_between.append((begins_s, ends_s))
            case "operator":
                self._operator.append((fault.kind, begins_s, ends_s))
            case "controller":
                self._kill_s = min(self._kill_s, begins_s)
            case "clock" if isinstance(self._clock, VirtualClock):
                self._clock.wall_jumps.append((begins_s, fault.amount))
