"""What a running controller shows to other processes: its newest state, a trace at one second, that it lives.

    live.json       the newest state (schema hil.live/1), replaced at most once a second of real time
    live.trace      a line of JSON that names the columns, then float32 rows, one for each second of the campaign
    heartbeat.json  changes at least every few seconds, in place: a watchdog judges by that, on a clock of its own

They are for onlookers. They are not durable, nothing is derived from them, and a night without them is as good: the
journal is the truth, but it is written once a minute, which is too seldom to look at.
"""

import json
import math
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import KW_ONLY, asdict, dataclass, field, fields
from datetime import datetime
from io import BufferedWriter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.clock import Clock, SystemClock
from drivers.frames.counts import StreamCounts
from drivers.frames.roles import SensorRole
from drivers.given_file import opened, read_bytes, read_text
from drivers.imu.samples import rate_fields
from hil.errors import InputError
from hil.files.durable import PARTIAL
from hil.records.rows import to_json
from hil.records.units import unit_folder
from procedures.plan import Step
from procedures.progress import Progress, Snapshot

LIVE_NAME, TRACE_NAME, HEARTBEAT_NAME = "live.json", "live.trace", "heartbeat.json"
SCHEMA = "hil.live/1"
OLD_AFTER_S = 4.0
"""A state of a living controller that is older is called old: with a look a second, people know within 5 s."""
SILENCE_BORNE_S = 60.0
"""A living controller that has not beaten for so long, beyond what it asked for, hangs."""

_EVERY_S = 1.0
_SIZE = 160  # bytes of a heartbeat, always: a shorter text must leave no rest of a longer one
_LATE_POLLS = 3.0
_TOO_CLOSE_S = 0.95  # of the campaign: polls are a little less than a second apart now and then

Rows = NDArray[np.float32]


@dataclass(frozen=True)
class Heartbeat:
    """One beat. `silent_s` is for how long none may follow: a device is being waited for."""

    pid: int
    count: int
    utc: str
    silent_s: float

    @property
    def at(self) -> datetime:
        """When it was, by the wall clock."""
        return datetime.fromisoformat(self.utc)


class HeartbeatFile:
    """Writes the heartbeat of this process; real time also where the night's is simulated. Close it."""

    def __init__(self, folder: Path) -> None:
        self._clock = SystemClock()
        self._file = os.open(folder / HEARTBEAT_NAME, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o644)
        self._count = 0
        self._last_s = -_EVERY_S
        self._silent_s = 0.0

    def alive(self, silent_s: float = 0.0) -> None:
        """Beat, unless the last one is younger than a second and promised as much. Never raises `OSError`."""
        now_s = self._clock.now()
        if now_s - self._last_s < _EVERY_S and silent_s == self._silent_s:
            return
        self._count += 1
        self._last_s, self._silent_s = now_s, silent_s
        beat = Heartbeat(os.getpid(), self._count, self._clock.utc().isoformat(), silent_s)
        with suppress(OSError):
            os.pwrite(self._file, json.dumps(asdict(beat)).ljust(_SIZE).encode(), 0)

    def close(self) -> None:
        """Release the file. It stays where it is."""
        os.close(self._file)


def read_heartbeat(folder: Path) -> Heartbeat | None:
    """Return the newest heartbeat in `folder`, None where there is none (or it is just being written)."""
    try:
        beat = Heartbeat(**json.loads(read_bytes(folder / HEARTBEAT_NAME)))
        return beat if beat.at.tzinfo is not None else None
    except (InputError, ValueError, TypeError):
        return None


def trace_columns(sensors: Mapping[int, SensorRole]) -> list[str]:
    """Return the columns of a bench's trace.

    Campaign seconds; °C of the chamber, its setpoint and each sensor; then per rate ("2.RA", deg/hr) the mean of the
    moment, and during a collect the running mean and its standard error.
    """
    units = [f"unit_{number}_degC" for number, each in sensors.items() if each.temperature is not None]
    rates = [f"{label}{suffix}" for label in rate_fields(sensors) for suffix in ("", " mean", " se")]
    return ["t_s", "chamber_degC", "setpoint_degC", *units, *rates]


@dataclass(eq=False)
class LiveFiles(Progress):
    """An onlooker that writes both files into a unit's folder. A full disk ends the writing, never the night.

    `every_s`: real time between polls; `announced_s`: the silence that a heartbeat asks for, longer is a device.
    """

    folder: Path
    sensors: Mapping[int, SensorRole]
    _: KW_ONLY
    every_s: float
    announced_s: float = 0.0
    unit: str = ""
    clock: Clock = field(default_factory=SystemClock)  # real time also where the night's is simulated

    def __post_init__(self) -> None:
        folder = unit_folder(self.folder, self.unit)
        self._path = folder / LIVE_NAME
        self._columns = trace_columns(self.sensors)
        self._written_s = self._traced_s = -math.inf
        self._last: Snapshot | None = None
        self._trace: BufferedWriter | None = None
        with suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            self._trace = _open_trace(folder / TRACE_NAME, self._columns)

    def update(self, snapshot: Snapshot) -> None:
        """Add a row to the trace, and replace the state where the last is a second old; pass over other units."""
        if snapshot.unit != self.unit:
            return
        self._last = snapshot
        if self._trace is None:
            return
        try:
            if snapshot.elapsed_s - self._traced_s >= _TOO_CLOSE_S:
                self._traced_s = snapshot.elapsed_s
                self._trace.write(_row(snapshot, self._columns).tobytes())
            if self.clock.now() - self._written_s >= _EVERY_S:
                self._write(snapshot)
        except OSError:
            self._give_up()

    def close(self) -> None:
        """Write the newest state and close."""
        with suppress(OSError):
            if self._trace is not None and self._last is not None:
                self._write(self._last)
        self._give_up()

    def _write(self, snapshot: Snapshot) -> None:
        self._written_s = self.clock.now()
        if self._trace is not None:
            self._trace.flush()
        state = {**asdict(snapshot), "step": snapshot.step.key, "finishing_utc": snapshot.finishing_utc.isoformat()}
        head = {"schema": SCHEMA, "pid": os.getpid(), "written_utc": self.clock.utc().isoformat()}
        head |= {"every_s": max(self.every_s, _EVERY_S), "announced_s": self.announced_s}
        partial = self._path.with_name(f"{PARTIAL}{LIVE_NAME}")
        partial.write_text(to_json(head | state), encoding="utf-8")
        partial.replace(self._path)

    def _give_up(self) -> None:
        trace, self._trace = self._trace, None
        if trace is not None:
            with suppress(OSError):
                trace.close()


def _open_trace(path: Path, columns: Sequence[str]) -> BufferedWriter:
    """Open a trace to append whole rows; begin a new one where there is none, or one with other columns."""
    head = json.dumps({"schema": SCHEMA, "dtype": "<f4", "columns": list(columns)}).encode() + b"\n"
    with suppress(OSError), path.open("rb") as file:
        if file.read(len(head)) == head:
            rows = (path.stat().st_size - len(head)) // _size(columns)
            os.truncate(path, len(head) + rows * _size(columns))  # a killed controller may leave half a row
            return path.open("ab")
        path.unlink()  # whoever reads it then sees another file, not a shorter one
    trace = path.open("wb")
    trace.write(head)
    return trace


def _size(columns: Sequence[str]) -> int:
    return 4 * len(columns)


def _row(now: Snapshot, columns: Sequence[str]) -> Rows:
    values = {"t_s": now.elapsed_s, "chamber_degC": now.chamber_degC, "setpoint_degC": now.setpoint_degC}
    values |= {f"unit_{number}_degC": value for number, value in now.unit_degC.items()}
    values |= now.rates_now_deg_per_hr
    values |= {f"{label} mean": value for label, value in now.rates_deg_per_hr.items()}
    values |= {f"{label} se": value for label, value in now.rates_se_deg_per_hr.items()}
    row = [values.get(column) for column in columns]
    return np.array([math.nan if value is None else value for value in row], dtype="<f4")


def read_live(folder: Path) -> dict[str, Any] | None:
    """Return the newest state that a controller has shown, or None where there is none that can be read."""
    try:
        text = read_text(folder / LIVE_NAME)
        document = json.loads(text, parse_constant=lambda _: None)  # NaN is no number to show
    except (InputError, ValueError, RecursionError):
        return None
    return document if isinstance(document, dict) and document.get("schema") == SCHEMA else None


def age_s(live: Mapping[str, Any], beat: Heartbeat | None, now: datetime) -> tuple[float, bool]:
    """Return how old by the wall clock a state is that the controller at work has shown, and whether that is too old.

    Each poll shows a new one. A heartbeat that announces a longer silence than a poll does says that a device is being
    waited for; `beat` is None where there is none of this controller.
    """
    age = max((now - datetime.fromisoformat(live["written_utc"])).total_seconds(), 0.0)
    borne_s = max(OLD_AFTER_S, _LATE_POLLS * float(live["every_s"]))
    if beat is not None and beat.silent_s > live.get("announced_s", 0.0):
        borne_s += beat.silent_s
    return age, age > borne_s


def snapshot_of(live: Mapping[str, Any], steps: Mapping[str, Step]) -> Snapshot | None:
    """Return the snapshot that a state was written from; None where it belongs to no step of this plan."""
    step = steps.get(str(live["step"]))
    if step is None:
        return None
    known = {each.name: live[each.name] for each in fields(Snapshot) if each.name in live}
    known |= {"step": step, "finishing_utc": datetime.fromisoformat(live["finishing_utc"])}
    known |= {"unit_degC": {int(number): value for number, value in live["unit_degC"].items()}}
    return Snapshot(**(known | {"stream": StreamCounts(**live["stream"])}))


class TraceReader:
    """Reads what was added to a night's trace since the last time, at most so many rows at once.

    `columns` is empty until there is a trace. One that was begun anew (`begun_anew` after that call) is read anew.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / TRACE_NAME
        self._offset = 0
        self._inode = 0
        self.columns: list[str] = []
        self.begun_anew = False

    def read(self, at_most: int = 100_000) -> Rows:
        """Return the new rows, shape (n, columns)."""
        self.begun_anew = False
        with suppress(InputError), opened(self._path) as file:
            status = os.fstat(file.fileno())
            if status.st_ino != self._inode or status.st_size < self._offset:
                self.columns, self._offset, self._inode, self.begun_anew = [], 0, status.st_ino, True
            if not self.columns and (line := file.readline()).endswith(b"\n"):
                with suppress(ValueError, KeyError, TypeError):
                    self.columns, self._offset = [str(name) for name in json.loads(line)["columns"]], len(line)
            if self.columns:
                file.seek(self._offset)
                data = file.read(at_most * _size(self.columns))
                whole = len(data) // _size(self.columns) * _size(self.columns)
                self._offset += whole
                return np.frombuffer(data[:whole], dtype="<f4").reshape(-1, len(self.columns))
        return np.empty((0, len(self.columns)), dtype="<f4")
