"""A simulated unit that streams the frames of a description and indexes between collect positions.

It encodes from the same description as the driver decodes from. The physics (what the rates, accelerations and
temperatures are) is somebody else's: `UnitPhysics`. Here are the frame clock, counter, status, index timing, the
answers to commands, and the faults it can be told to have.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field
from enum import StrEnum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.frames.description import StreamDescription
from drivers.frames.layout import FrameLayout, encode_rows
from drivers.frames.roles import IndexRole
from drivers.frames.wire import FloatArray, Rows
from drivers.imu import ImuIdentity

Mask = NDArray[np.bool_]

_COUNTER_AHEAD = 5
_ANOTHER_COUNTER = 12345
_LONGEST_LINE = 128  # bytes without a line end before they are thrown away, as a small command buffer would


class ImuFault(StrEnum):
    """The ways in which a unit's stream and its index misbehave."""

    DROPPED_FRAMES = "dropped_frames"  # whole frames never arrive; the counter goes on
    FLIPPED_BITS = "flipped_bits"  # one bit of a frame is wrong
    GARBAGE = "garbage"  # a burst of random bytes stands before a frame
    DROPPED_BYTES = "dropped_bytes"  # one byte of a frame never arrives
    WRONG_COUNTER = "wrong_counter"  # the unit's counter is ahead of its frames by five
    REPEATED_FRAMES = "repeated_frames"  # a frame is sent twice
    STALL = "stall"  # the stream stops
    FROZEN = "frozen"  # every value stays as it is; counter and checksum go on
    SPIN_FAULT = "spin_fault"  # a rotor is not at speed, and the status says so
    EXCHANGED = "exchanged"  # another unit is there, with a serial number and a counter of its own
    SILENT_IDENTITY = "silent_identity"  # the identity is asked for in vain
    INDEX_REFUSED = "index_refused"  # an index command only sets the fault bit
    INDEX_NEVER_FINISHES = "index_never_finishes"  # an index move begins and does not end
    INDEX_WRONG_POSITION = "index_wrong_position"  # it arrives, but elsewhere
    INDEX_SLIPS = "index_slips"  # it says that it has arrived; the unit has not turned


@dataclass(frozen=True)
class FaultWindow:
    """One fault from `begins_s` up to `ends_s`; `probability` is per frame, of those that concern single frames."""

    fault: ImuFault
    begins_s: float = 0.0
    ends_s: float = math.inf
    probability: float = 1.0


class UnitPhysics(Protocol):
    """What the unit measures. Times are the bench clock's, s, and never go backwards."""

    def start_move(self, position: str, begins_s: float, ends_s: float) -> None:
        """Turn to `position` (its label), arriving at `ends_s`. Called once at the start for the first position."""

    def signals(self, times_s: FloatArray) -> Mapping[str, FloatArray]:
        """Return the signals at `times_s`, shape (n,), by frame field name and in the field's unit."""


@dataclass(frozen=True)
class IndexSettings:
    """How the unit indexes: position labels with their codes, the position at power-on, and the time a move takes."""

    positions: Mapping[str, int]
    first: str
    move_s: float = 10.0


@dataclass(eq=False)
class SimulatedImu:
    """A `SimulatedDevice` that streams from `starts_s` on; `seed` is the faults'. `ValueError` without roles."""

    description: StreamDescription
    physics: UnitPhysics
    _: KW_ONLY
    identity: ImuIdentity = ImuIdentity("MFS", "SIM-0001", "simulated")  # noqa: RUF009 - frozen
    index: IndexSettings = IndexSettings({"1": 1, "2": 2, "3": 3, "4": 4}, first="1")
    faults: Sequence[FaultWindow] = ()
    starts_s: float = 0.0
    seed: int = 0
    _frozen: dict[str, float] | None = field(default=None, init=False)
    _next = 0  # number of the next frame
    _rejected = False
    _index_failed = False  # at the last command
    _arrives_s = -math.inf

    def __post_init__(self) -> None:
        roles, starts_s = self.description.roles, self.starts_s
        if roles is None:
            raise ValueError(f"{self.description.name}: a description without roles cannot be simulated")
        self._roles = roles
        self._rate_hz = self.description.sample_rate_hz
        self._faults = list(self.faults)
        self._rng = np.random.default_rng(self.seed)
        self._layout = FrameLayout(self.description, roles.frame)
        self._code = self.index.positions[self.index.first]  # where it is, or where it is going
        self.physics.start_move(self.index.first, starts_s, starts_s)
        self._outbox: list[bytes] = []
        self._line = bytearray()

    def inject(self, window: FaultWindow) -> None:
        """Let one more thing go wrong."""
        self._faults.append(window)

    def turn_by_hand(self, position: str, now_s: float) -> None:
        """Let somebody lay the unit as in `position`; its index, if it has one, knows nothing of it."""
        self._stream(now_s)
        begins_s = max(now_s, self._time(self._next - 1))
        self.physics.start_move(position, begins_s, begins_s + self.index.move_s)

    def receive(self, data: bytes, now_s: float) -> None:
        """Take bytes of command lines; a complete line is carried out at once."""
        self._stream(now_s)
        self._line += data
        *lines, self._line = self._line.split(b"\n")
        for line in lines:
            self._rejected = not self._carry_out(bytes(line) + b"\n", now_s)
        if len(self._line) > _LONGEST_LINE:
            self._line.clear()

    def transmit(self, now_s: float) -> bytes:
        self._stream(now_s)
        sent = b"".join(self._outbox)
        self._outbox.clear()
        return sent

    def next_transmission(self, now_s: float) -> float | None:
        return now_s if self._outbox else max(now_s, self._time(self._next))

    def _active(self, fault: ImuFault, now_s: float) -> bool:
        return bool(self._during(fault, np.array([now_s]))[0])

    def _during(self, fault: ImuFault, times_s: FloatArray, rng: np.random.Generator | None = None) -> Mask:
        """Tell for each time whether `fault` is on, shape (n,); with `rng`, whether it strikes the frame sent then."""
        struck = np.zeros(len(times_s), np.bool_)
        for window in self._faults:
            if window.fault == fault:
                on = (times_s >= window.begins_s) & (times_s < window.ends_s)
                struck |= on if rng is None else on & (rng.random(len(times_s)) < window.probability)
        return struck

    def _time(self, number: int) -> float:
        return self.starts_s + number / self._rate_hz

    def _carry_out(self, line: bytes, now_s: float) -> bool:
        """Carry out one line; False where it is not a command of this unit, or its checksum is wrong."""
        commands = self.description.commands
        if commands is None:
            return False
        if commands.identify is not None and line == commands.line(commands.identify):
            if not self._active(ImuFault.SILENT_IDENTITY, now_s):
                self._outbox.append(self._identity_frame(self._active(ImuFault.EXCHANGED, now_s)))
            return True
        for label, code in self.index.positions.items():
            if commands.index is not None and line == commands.line(commands.index.replace("{code}", str(code))):
                self._turn(label, max(now_s, self._time(self._next - 1)))
                return True
        return False

    def _turn(self, label: str, now_s: float) -> None:
        """Move to a commanded position, from where it is if it is moving."""
        on = {fault for fault in ImuFault if self._active(fault, now_s)}
        self._index_failed = ImuFault.INDEX_REFUSED in on
        if self._index_failed:
            return
        if ImuFault.INDEX_WRONG_POSITION in on:
            label = next(other for other in self.index.positions if other != label)
        self._code = self.index.positions[label]
        self._arrives_s = math.inf if ImuFault.INDEX_NEVER_FINISHES in on else now_s + self.index.move_s
        if on.isdisjoint({ImuFault.INDEX_NEVER_FINISHES, ImuFault.INDEX_SLIPS}):
            self.physics.start_move(label, now_s, self._arrives_s)

    def _identity_frame(self, another: bool) -> bytes:
        role = self._roles.identity
        if role is None or role.frame is None:
            return b""
        texts = {role.model: self.identity.model}
        texts |= {role.serial: self.identity.serial + "B" * another} if role.serial else {}
        texts |= {role.firmware: self.identity.firmware} if role.firmware else {}
        return encode_rows(FrameLayout(self.description, role.frame), texts, 1).tobytes()

    def _stream(self, now_s: float) -> None:
        due = math.floor((now_s - self.starts_s) * self._rate_hz + 1e-6) + 1
        if due <= self._next:
            return
        numbers = np.arange(self._next, due)
        self._next = due
        times_s = self.starts_s + numbers / self._rate_hz
        rows = self._encode(numbers, times_s)
        self._outbox.append(self._spoil(rows, times_s))

    def _encode(self, numbers: NDArray[np.int64], times_s: FloatArray) -> Rows:
        columns: dict[str, FloatArray | NDArray[np.int64]] = dict(self.physics.signals(times_s))
        if self._faults:
            self._freeze(columns, times_s)
        counter = self._layout.description.counter
        if counter is not None:
            if self._faults:
                ahead = _COUNTER_AHEAD * self._during(ImuFault.WRONG_COUNTER, times_s)
                numbers = numbers + ahead + _ANOTHER_COUNTER * self._during(ImuFault.EXCHANGED, times_s)
            columns[counter.field] = (numbers * counter.step) % counter.modulus
        time = self._layout.description.time
        if time is not None and counter is None:
            ticks = np.floor(times_s / time.resolution + 1e-6) % (time.modulus or 2.0**63)
            field = self._layout.description.all_fields[time.field]
            columns[time.field] = ticks * field.scale + field.offset
        if self._roles.index is not None:
            self._write_index(self._roles.index, columns, times_s)
        return encode_rows(self._layout, columns, len(numbers))

    def _freeze(self, columns: dict[str, FloatArray | NDArray[np.int64]], times_s: FloatArray) -> None:
        frozen = self._during(ImuFault.FROZEN, times_s)
        if not frozen.any():
            self._frozen = None
            return
        first = int(np.argmax(frozen))
        if self._frozen is None:
            self._frozen = {name: float(values[first]) for name, values in columns.items()}
        for name, held in self._frozen.items():
            columns[name] = np.where(frozen, held, columns[name])
        if not frozen[-1]:
            self._frozen = None

    def _write_index(
        self, role: IndexRole, columns: dict[str, FloatArray | NDArray[np.int64]], times_s: FloatArray
    ) -> None:
        moving = times_s < self._arrives_s
        columns[role.position] = ~moving * np.int64(self._code)  # 0 while it moves
        bits = {role.moving: moving, role.in_position: ~moving}
        if self._index_failed and role.fault is not None:
            bits[role.fault] = np.ones(len(times_s), np.bool_)
        if self._rejected and role.rejected is not None:
            bits[role.rejected] = np.ones(len(times_s), np.bool_)
        if self._faults:
            bits["spin_fault"] = self._during(ImuFault.SPIN_FAULT, times_s)
        for word_name, described in self._layout.description.status.items():
            word = np.zeros(len(times_s), np.int64)
            for name, bit in described.items():
                if name in bits:
                    word |= bits[name].astype(np.int64) << bit.bit
            columns[word_name] = word

    def _spoil(self, rows: Rows, times_s: FloatArray) -> bytes:
        during, rng = self._during, self._rng
        if not self._faults:
            return rows.tobytes()
        flipped = np.flatnonzero(during(ImuFault.FLIPPED_BITS, times_s, rng))
        rows[flipped, rng.integers(0, rows.shape[1], len(flipped))] ^= (1 << rng.integers(0, 8, len(flipped))).astype(
            np.uint8
        )
        sent = ~during(ImuFault.DROPPED_FRAMES, times_s, rng) & ~during(ImuFault.STALL, times_s)
        repeated = during(ImuFault.REPEATED_FRAMES, times_s, rng) & sent
        garbage = during(ImuFault.GARBAGE, times_s, rng)
        cut = during(ImuFault.DROPPED_BYTES, times_s, rng)
        if not (garbage | repeated | cut).any():
            return (rows if sent.all() else rows[sent]).tobytes()
        pieces: list[bytes] = []
        for number in range(len(rows)):
            if garbage[number]:
                pieces.append(rng.bytes(int(rng.integers(1, 2 * rows.shape[1]))))
            if sent[number]:
                frame = rows[number].tobytes()
                lost = int(rng.integers(len(frame))) if cut[number] else len(frame)
                pieces.append((frame[:lost] + frame[lost + 1 :]) * (2 if repeated[number] else 1))
        return b"".join(pieces)
