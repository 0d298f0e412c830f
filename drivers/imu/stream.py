"""The IMU driver: any unit whose stream has a frame description, and the index of a unit that can turn itself.

imu = StreamImu(open_port("/dev/ttyUSB0", clock=clock, baudrate=115200), description, clock)
imu.identify()
IndexingPositioner(imu, clock, {"1": 1, "2": 2, "3": 3}).move_to("2", timeout_s=60.0)
block = imu.read_block()
"""

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, field, replace

import numpy as np

from drivers.clock import Clock
from drivers.errors import DeviceError, DeviceTimeout, ProtocolError, WrongDevice
from drivers.frames.batch import Decoded, FrameBatch
from drivers.frames.counts import StreamCounts
from drivers.frames.decoder import StreamDecoder
from drivers.frames.description import StreamDescription
from drivers.frames.roles import SensorRole
from drivers.frames.wire import IntArray
from drivers.imu.samples import FloatArray, ImuIdentity, SampleBlock
from drivers.transports import Transport
from drivers.transports.live_reader import LiveReader

LOST_S = 2.0  # without a frame, or missing by its counter: what is behind the port by then may be another unit
_IDENTITY_S = 5.0  # for which an answer is waited
_ASK_AGAIN = 3  # times that the identity is asked for within the time-out
_DRIFT = 200e-6  # s/s; crystal oscillators are within 100 ppm each
_RESTART_S = 2.0  # a counter so far ahead of the clock was not counting: it began anew
_MEASURED_S = 20.0  # over which the rate is measured …
_AGREED = 0.02  # … twice, to the same result …
_ANOTHER_RATE = 0.04  # … before it is believed: no oscillator is so far off
_SILENCE_S = 1.0  # without a counter, frames so late mean that others were lost before them


@dataclass(frozen=True)
class IndexStatus:
    """What the newest good frame says of the index; since `since_s` all say the same place and movement."""

    time_s: float
    since_s: float
    code: int  # the number of the position, as the unit counts
    moving: bool
    in_position: bool
    fault: bool
    rejected: bool

    @property
    def place(self) -> tuple[int, bool, bool]:
        """Where it says that it is: code, moving, in position."""
        return self.code, self.moving, self.in_position


@dataclass(eq=False)
class StreamImu:
    """A unit that streams over a transport. Sensors are numbered as in the bench file (the report's sensor 2 is 2).

    `conditions` maps campaign columns to fields that are neither rates nor accelerations.
    `expected` is what the bench file says about the unit: where its model or serial number is given, `identify` refuses
    another. Raises `ValueError` for a description without roles.
    """

    transport: Transport
    description: StreamDescription
    clock: Clock
    _: KW_ONLY
    expected: ImuIdentity | None = None
    index_status: IndexStatus | None = field(default=None, init=False)  # of the newest good frame that tells it
    unsure = False  # whether the stream was lost since the unit said who it is
    _interrupted = True  # the next samples do not continue the ones before
    _last_s = 0.0  # when the newest sample was taken

    def __post_init__(self) -> None:
        if self.description.roles is None:
            raise ValueError(f"{self.description.name}: roles: missing, so that no field is known to be a rate")
        self._roles = roles = self.description.roles
        self.port, self.sample_rate_hz = self.transport.name, self.description.sample_rate_hz
        self.conditions: Mapping[str, str] = roles.conditions
        self.sensors: Mapping[int, SensorRole] = roles.sensors
        self._decoder = StreamDecoder(self.description)
        counter = self.description.frames[roles.frame].counter
        turn_frames = None if counter is None else counter.modulus // counter.step
        self._sample_clock = SampleClock(self.sample_rate_hz, turn_frames)

    def read_block(self) -> SampleBlock:
        """Decode what has arrived since the last call; never waits, perhaps empty."""
        try:
            raw = self.transport.read_available()
        except DeviceError:
            self.unsure = True
            raise
        arrival_s = self.clock.now()
        decoded, times_s = self._take(raw, arrival_s)
        counts, batch = decoded.counts, decoded[self._roles.frame]
        if isinstance(self.transport, LiveReader) and (overflow := self.transport.take_overflow()):
            counts += StreamCounts(overflow_bytes=overflow)
        return SampleBlock(times_s, batch.columns, counts, raw, arrival_s)

    def discard(self) -> StreamCounts:
        """Throw away what has arrived, an unfinished frame too; return what that was. It does not count as lost."""
        counts = self.read_block().counts
        self._decoder.reset()
        self._interrupted = True
        return counts

    def identify(self) -> ImuIdentity:
        """Ask the unit who it is, or, where it cannot be asked, wait for a good sample.

        Samples that arrive meanwhile are thrown away. Raise `DeviceTimeout` where no good frame (or no answer) arrives,
        `WrongDevice` where the unit is not the expected one.
        """
        self.discard()
        begins_s = self.clock.now()
        deadline_s = begins_s + _IDENTITY_S
        asked, arrived, counts = 0, 0, StreamCounts()
        commands = self.description.commands
        while (now_s := self.clock.now()) < deadline_s:
            if now_s >= begins_s + asked * _IDENTITY_S / _ASK_AGAIN:
                if commands is not None and commands.identify is not None:
                    self.transport.write(commands.line(commands.identify))
                asked += 1
            raw = self.transport.read(1, min(deadline_s - now_s, 2.0 / self.sample_rate_hz))
            raw += self.transport.read_available()
            decoded, _ = self._take(raw, self.clock.now())
            arrived += len(raw)
            counts += decoded.counts
            found = self._identity_in(decoded)
            if found is not None:
                for what in ("model", "serial"):
                    wanted, given = getattr(self.expected, what, ""), getattr(found, what)
                    if wanted and wanted != given:
                        raise WrongDevice(
                            f"{self.port}: the unit says {what} {given!r}, {wanted!r} is what the bench file says or "
                            "somebody typed; connect the right unit or correct that"
                        )
                self.unsure = False
                return found
        raise DeviceTimeout(self._no_identity(arrived, counts))

    def command_index(self, code: int) -> None:
        """Send the command to index to a position; `ProtocolError` where the description gives no such command."""
        commands = self.description.commands
        if commands is None or commands.index is None or self._roles.index is None:
            raise ProtocolError(f"{self.port}: {self.description.name} has no index command; use an operator")
        self.transport.write(commands.line(commands.index.replace("{code}", str(code))))

    def close(self) -> None:
        """Release the port."""
        self.transport.close()

    def _take(self, raw: bytes, arrival_s: float) -> tuple[Decoded, FloatArray]:
        decoded = self._decoder.feed(raw, arrival_s)
        batch = decoded[self._roles.frame]
        if not len(batch):
            return decoded, np.empty(0)
        times_s, correction = self._sample_clock.stamp(batch.sequence, arrival_s)
        gap_s = max(float(times_s[0]) - self._last_s, float((times_s[1:] - times_s[:-1]).max(initial=0.0)))
        jumped = correction != 0 and decoded.counts.lost > LOST_S * self.sample_rate_hz
        self.unsure |= jumped or (gap_s > LOST_S and not self._sample_clock.anew)
        self._last_s = float(times_s[-1])
        if correction and not self._interrupted:
            lost = max(0, decoded.counts.lost + correction)
            decoded = Decoded(decoded.frames, replace(decoded.counts, lost=lost))
        self._interrupted = False
        self.index_status = self._status_in(batch, times_s)
        return decoded, times_s

    def _status_in(self, batch: FrameBatch, times_s: FloatArray) -> IndexStatus | None:
        role = self._roles.index
        if role is None:
            return None
        codes, on = batch.wire(role.position), set[str]()
        same, code = codes == codes[-1], int(codes[-1])
        for name, bits in batch.layout.description.status.items():
            words = batch.wire(name)
            newest = int(words[-1])
            on |= {each for each, bit in bits.items() if newest >> bit.bit & 1}
            if mask := sum(1 << bits[each].bit for each in (role.moving, role.in_position) if each in bits):
                same &= words & mask == newest & mask
        moving, in_position = role.moving in on, role.in_position in on
        before, whole = self.index_status, bool(same.all())
        if before is not None and whole and before.place == (code, moving, in_position):
            since_s = before.since_s
        else:
            since_s = float(times_s[0 if whole else len(same) - int(np.argmin(same[::-1]))])
        fault, rejected = role.fault in on, role.rejected in on
        return IndexStatus(float(times_s[-1]), since_s, code, moving, in_position, fault, rejected)

    def _identity_in(self, decoded: Decoded) -> ImuIdentity | None:
        role = self._roles.identity
        if role is None or role.frame is None:
            model = self.description.name if role is None else role.model
            return ImuIdentity(model) if len(decoded[self._roles.frame]) else None
        batch = decoded[role.frame]
        if not len(batch):
            return None
        serial, firmware = (batch.text(name)[-1] if name else "" for name in (role.serial, role.firmware))
        return ImuIdentity(batch.text(role.model)[-1], serial, firmware)

    def _no_identity(self, arrived: int, counts: StreamCounts) -> str:
        begin = f"{self.port}: within {_IDENTITY_S:g} s "
        name = self.description.name
        if not arrived:
            return begin + "nothing arrived; is the unit powered, and is the cable in the right port?"
        if not counts.ok:
            return begin + (
                f"{arrived} byte{'s' * (arrived != 1)} arrived but no good {name} frame (bad checksum "
                f"{counts.bad_checksum}, unknown id {counts.unknown_id}); check the baud rate, and that {name} "
                "describes this unit"
            )
        return begin + f"the unit streamed good frames ({counts.ok}) but did not say who it is; check its receive line"


class SampleClock:
    """Places frames of one stream in time; `turn_frames` is when the counter comes round, None where there is none.

    The counter gives even spacing; the arrival tells where on the clock it belongs. A frame can arrive late, never
    early, so that the earliest arrivals are the right ones: the offset between counter and clock is the least that was
    seen, let go slowly (`_DRIFT`) because the unit's oscillator is not the bench's. A unit that is set to another rate
    is followed at the rate that it has, so that its samples are where they were taken.
    """

    def __init__(self, rate_hz: float, turn_frames: int | None) -> None:
        self._period_s = 1.0 / rate_hz
        self._measured = (-np.inf, 0, np.inf)  # since when, from which frame on, and the period that came out before
        self._turn_frames = turn_frames
        self._offset_s: float | None = None
        self.anew = True  # whether the newest frames were placed without regard to those before them
        self._shift = 0  # frames that the counter did not show
        self._last_sequence = 0
        self._last_time_s = -np.inf
        self._last_arrival_s = 0.0

    def stamp(self, sequence: IntArray, arrival_s: float) -> tuple[FloatArray, int]:
        """Return the times of n ≥ 1 frames that had arrived by `arrival_s`, shape (n,), s, never decreasing.

        `sequence` is their unwrapped counter in frames. The second value corrects the number of lost frames: whole
        turns of the counter unseen in an outage (positive), or what only a counter begun anew seems to skip (negative).
        """
        self._follow(int(sequence[-1]), arrival_s)
        self.anew = self._offset_s is None
        numbers = sequence + self._shift
        correction = 0
        if self._offset_s is None:
            self._offset_s = arrival_s - float(numbers[-1]) * self._period_s
        else:
            correction = self._correction(arrival_s - float(numbers[-1]) * self._period_s - self._offset_s)
            if correction:
                # Frames went missing at the widest step; those before it are where they were.
                steps = np.diff(numbers, prepend=self._last_sequence)
                numbers[int(np.argmax(steps)) :] += correction
                self._shift += correction
            latest_s = arrival_s - float(numbers[-1]) * self._period_s
            drifted_s = self._offset_s + _DRIFT * (arrival_s - self._last_arrival_s)
            follows_s = self._last_time_s + 0.5 * self._period_s - float(numbers[0]) * self._period_s
            self._offset_s = max(min(latest_s, drifted_s), follows_s)
        times_s = self._offset_s + numbers.astype(np.float64) * self._period_s
        self._last_sequence = int(numbers[-1])
        self._last_time_s = float(times_s[-1])
        self._last_arrival_s = arrival_s
        return times_s, correction if self._turn_frames is not None else 0

    def _follow(self, newest: int, arrival_s: float) -> None:
        """Count by the rate that the unit has, where that is another one than the description's for long enough."""
        began_s, first, before_s = self._measured
        passed_s, frames = arrival_s - began_s, newest - first
        if 0.0 <= passed_s < _MEASURED_S and frames >= 0:
            return
        period_s = passed_s / frames if frames > 0 else np.inf
        self._measured = (arrival_s, newest, period_s)
        if frames <= 0 or abs(period_s - before_s) > _AGREED * period_s:
            return
        if abs(period_s - self._period_s) > _ANOTHER_RATE * period_s:
            self._period_s, self._offset_s = period_s, None

    def _correction(self, late_s: float) -> int:
        """Return by how many frames the sequence is behind the clock, given how late the newest frame seems."""
        if late_s < -_RESTART_S:
            return int(np.floor(late_s / self._period_s))
        if self._turn_frames is None:
            return int(late_s / self._period_s) if late_s > _SILENCE_S else 0
        turns = round(late_s / (self._turn_frames * self._period_s))
        return max(0, turns) * self._turn_frames
