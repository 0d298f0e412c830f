"""The simulated devices of a bench: one chamber, the units that lie in its air, the bytes of them all, their faults.

`hil.bench` lets the faults of a bench file happen on devices, clock, disk and controller where all is simulated in this
process. A night is begun with the injector's `disk`, and with itself as an onlooker: it sees the steps that faults wait
for. One that is carried on meets the faults still to come or still going on; a moment's has been.
"""

import errno
import math
import os
import signal
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.clock import Clock, VirtualClock
from drivers.imu import ImuIdentity
from drivers.positioners.positioner import AskOperator
from drivers.simulators.chambers.catalogue import CHAMBER_SIMULATORS, SimulatorOptions
from drivers.simulators.chambers.controller import ChamberFault, ChamberFaultKind, SimulatedController
from drivers.simulators.chambers.plant import ChamberPlant
from drivers.simulators.memory import MemoryTransport
from drivers.simulators.unit import FaultWindow, ImuFault, IndexSettings, SimulatedImu
from hil.config.bench import Bench
from hil.config.ports import unit_port
from hil.config.simulation import Fault
from hil.config.unit import ASK
from hil.errors import InputError, worded
from hil.files.durable import RealDisk
from hil.model import fitting
from hil.twin.motion import FROM_THE_START, Resumed
from hil.twin.sensor import simulation_of
from hil.twin.unit import SimulatedUnit
from procedures.plan import Step
from procedures.progress import Progress, Snapshot

_EXCHANGED_IN_S = 8.0


@dataclass(frozen=True)
class SimulatedBench:
    """The devices of the chamber and, by name, of every unit, and what they share; `unit` is the truth, for tests."""

    imus: Mapping[str, SimulatedImu]
    chamber: SimulatedController
    units: Mapping[str, SimulatedUnit]
    plant: ChamberPlant

    @property
    def imu(self) -> SimulatedImu:
        """The stream of the first unit, or the only one."""
        return next(iter(self.imus.values()))

    @property
    def unit(self) -> SimulatedUnit:
        """The first unit, or the only one."""
        return next(iter(self.units.values()))


def simulate_devices(bench: Bench, *, begins_s: float, resumed: Resumed = FROM_THE_START) -> SimulatedBench:
    """Return the devices that the bench's simulation section describes, at rest at `begins_s` on the caller's clock.

    The chamber begins at the start temperature, whatever it held before: a chamber cools (or warms) while nobody
    controls it. Raises `InputError` where the section, the model and the description do not go together.
    """
    settings = simulation_of(bench)
    plant = ChamberPlant(
        ambient_degC=settings.start.temperature,
        heating_degC_per_min=settings.chamber.heating,
        cooling_degC_per_min=settings.chamber.cooling,
        response_s=settings.chamber.response,
        settling_s=settings.chamber.settling,
        ripple_degC=settings.chamber.ripple,
        leak_s=settings.chamber.leak,
        begins_s=begins_s,
    )
    imus, units = dict[str, SimulatedImu](), dict[str, SimulatedUnit]()
    for name, own in bench.each.items():
        alike = next((units[other] for other in units if _kind(bench.each[other]) == _kind(own)), None)
        units[name] = _unit(own, plant, begins_s=begins_s, resumed=resumed, alike=alike)
        imus[name] = _imu(own, units[name], begins_s)
    options = SimulatorOptions(
        description=bench.chamber_description,
        **bench.chamber.spoken,
        faults=settings.chamber_faults,
        begins_s=begins_s,
    )
    with worded(InputError, f"{bench.source or bench.name}: the simulated chamber: "):
        chamber = CHAMBER_SIMULATORS[bench.chamber.driver](plant, options)
    return SimulatedBench(imus, chamber, units, plant)


def _kind(bench: Bench) -> tuple[object, ...]:
    """Return what a unit is like, all but what is its own: its name, its port, its noise and its faults."""
    own = {"seed": 0, "imu_faults": ()}
    simulation = bench.simulation and bench.simulation.model_copy(update=own)
    return simulation, bench.sensors, bench.imu.model_copy(update={"port": ""}), bench.imu_description, bench.positions


def _unit(bench: Bench, plant: ChamberPlant, **night: Any) -> SimulatedUnit:
    """Return the physics of one unit in the chamber's air."""
    roles = bench.frames.roles
    if roles is None or not set(bench.sensors) <= set(roles.sensors):
        raise InputError(
            f"{bench.source or bench.name}: imu.description: {bench.imu.description} does not say which fields are the "
            f"rates of sensor {', '.join(map(str, bench.sensors))}"
        )
    path = bench.simulation_model or ""
    model = fitting(path, [bench.sensor(number) for number in bench.sensors])
    for number in set(bench.sensors) - set(model.sensors):
        raise InputError(f"{path}: sensors.{number}: missing: a simulated unit needs values of its {model.form}")
    return SimulatedUnit(bench, model, roles, plant, sample_rate_hz=bench.frames.sample_rate_hz, **night)


def _imu(bench: Bench, unit: SimulatedUnit, begins_s: float) -> SimulatedImu:
    """Return the bytes of one unit; raise `InputError` where the frame that says who it is has no room for that."""
    settings, frames = simulation_of(bench), bench.frames
    identity = ImuIdentity(bench.unit.model, "SIM-0001" if bench.unit.serial == ASK else bench.unit.serial, "simulated")
    role = frames.roles.identity if frames.roles else None
    fields = frames.frames[role.frame].fields if role and role.frame else {}
    for key in ("model", "serial"):
        text, field = getattr(identity, key), fields.get(getattr(role, key, None) or "")
        if field is not None and not (text.isascii() and len(text) <= field.width):
            raise InputError(
                f"{bench.source or bench.name}: unit.{key}: {text!r}: a simulated unit says it in a frame of "
                f"{frames.name} that has room for {field.width} characters of ASCII; give a shorter one"
            )
    return SimulatedImu(
        frames,
        unit,
        identity=identity,
        index=IndexSettings(bench.position_codes, settings.start.position, settings.index_time),
        faults=settings.imu_faults,
        starts_s=begins_s,
        seed=settings.seed,
    )


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
