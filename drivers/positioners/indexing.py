"""The unit's own index turns it, and its stream confirms where it stands."""

from collections.abc import Iterator, Mapping
from dataclasses import KW_ONLY, dataclass, field

from drivers.clock import Clock
from drivers.errors import CommandRefused, DeviceTimeout
from drivers.imu.stream import IndexStatus, StreamImu

_CONFIRMED_LATE_S = 0.3  # between looks at a move that may end at any moment
_DRAINED_S = 1.0  # between looks at a move that cannot end yet: the system holds so much of a stream for us


@dataclass(eq=False)
class IndexingPositioner:
    """A `drivers.positioners.positioner.Positioner` by the unit's own index, confirmed in its stream.

    `positions` maps a position's label to its number in the command and in the stream. Samples that arrive during a
    move are thrown away: they are no part of any collect. A position counts as reached when every frame of `confirm_s`
    says so; the first `reaction_s` after the command say nothing: the unit may not have read it yet.

    The stream is looked at every `poll_s` at first, then less often, at most `_CONFIRMED_LATE_S` apart, so that a move
    is confirmed that soon. A move that was made before is known to take its time: until then the stream is only drained
    now and then, and looked at again when it should have arrived.
    """

    imu: StreamImu
    clock: Clock
    positions: Mapping[str, int]
    _: KW_ONLY
    poll_s: float = 0.1
    confirm_s: float = 0.25
    reaction_s: float = 0.2
    # From command to arrival, by start and target:
    _usual_s: dict[tuple[int | None, int], float] = field(default_factory=dict, init=False)

    @property
    def _labels(self) -> Mapping[int, str]:
        return {code: label for label, code in self.positions.items()}

    def position(self) -> str | None:
        """Return the position that the newest frame confirms, or None: moving, not known, or not one of ours."""
        if self.imu.index_status is None:
            self.imu.read_block()
        status = self.imu.index_status
        if status is None or status.moving or not status.in_position:
            return None
        return self._labels.get(status.code)

    def move_to(self, position: str, timeout_s: float) -> None:
        """Go to `position` and return once the stream confirms it; `CommandRefused`, or `DeviceTimeout` where late."""
        for wait_s in self.moving(position, timeout_s):
            self.clock.sleep(wait_s)

    def moving(self, position: str, timeout_s: float) -> Iterator[float]:
        """Do as `move_to` (`CommandRefused`, `DeviceTimeout`), and yield how many seconds to wait each time."""
        if position not in self.positions:
            known = ", ".join(self.positions)
            raise CommandRefused(f"{self.imu.port}: there is no position {position!r}; the bench file gives {known}")
        code = self.positions[position]
        self.imu.discard()
        start = self.imu.index_status
        move = (None if start is None else start.code, code)
        self.imu.command_index(code)
        begins_s = self.clock.now()
        valid_s, tries = begins_s + self.reaction_s, 1
        status = None
        while (elapsed_s := self.clock.now() - begins_s) < timeout_s:
            wait_s = self._until_next_look(elapsed_s, status, self._usual_s.get(move, 0.0))
            yield min(wait_s, max(timeout_s - elapsed_s, self.poll_s))
            self.imu.read_block()
            newest = self.imu.index_status
            if newest is None or newest.time_s < valid_s:
                continue
            status = newest
            if status.rejected and tries == 1:  # the line was damaged on its way; once more
                self.imu.command_index(code)
                valid_s, tries = self.clock.now() + self.reaction_s, 2
                continue
            if status.rejected:
                raise CommandRefused(f"{self.imu.port}: the unit does not understand the index command")
            if status.fault:
                at_fault = f"the unit reports an index fault on the way to position {position!r}; look at it"
                raise CommandRefused(f"{self.imu.port}: {at_fault}")
            if status.place == (code, False, True):
                reached_s = max(status.since_s, valid_s)
                if status.time_s - reached_s >= self.confirm_s:
                    self._usual_s[move] = reached_s - begins_s
                    return
        raise DeviceTimeout(
            f"{self.imu.port}: position {position!r} was not confirmed within {timeout_s:g} s; {self._said(status)}"
        )

    def _until_next_look(self, elapsed_s: float, status: IndexStatus | None, usual_s: float) -> float:
        if status is None or not status.moving:
            return self.poll_s
        arrives_s = usual_s + self.confirm_s - elapsed_s
        if arrives_s > _CONFIRMED_LATE_S:
            return min(arrives_s + self.poll_s, _DRAINED_S)
        return min(max(self.poll_s, elapsed_s / 4.0), _CONFIRMED_LATE_S)

    def _said(self, status: IndexStatus | None) -> str:
        if status is None:
            return "no good frame arrived since the command"
        if status.moving:
            return "the unit says that it is still moving"
        place = self._labels.get(status.code, f"number {status.code}")
        where = "in" if status.in_position else "near"
        return f"the unit says that it is {where} position {place!r}"
