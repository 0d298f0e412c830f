"""The poll: the one place where a running sweep looks at the bench.

Every step waits through `Watch`, so that at every poll, whatever the step, the stream is drained, the chamber is read,
the interlocks are judged, a stop request is heard, the journal gets its sign of life and onlookers see the state.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field
from datetime import datetime, timedelta
from typing import Any

from drivers.chambers import ChamberReading
from drivers.errors import DeviceError, WrongDevice
from drivers.imu import SampleBlock
from drivers.imu.samples import means
from procedures.devices import BenchDevices
from procedures.interlocks import Interlocks, InterlockTripped, Look, standard_interlocks
from procedures.journal_protocol import Journal
from procedures.plan import Step, StepKind
from procedures.progress import Progress, Snapshot
from procedures.requests import Control, Desk, PauseAsked
from procedures.settings import InterlockSettings, Polling
from procedures.stop import StopRequest
from procedures.unit_watch import UnitWatch, labelled
from procedures.words import counted, hours_minutes

Looks = Mapping[str, Look]
"""A look at each unit that goes on, by its name, and at the chamber that they share."""

_WALL_JUMP_S = 5.0
UNSEEN_S = 300.0
"""For so long no device is waited for: in a longer silence nobody looked."""
_HOLD_CEILING_S = 3600.0
_IDENTITY_S = 10.0  # more than a unit is given to say who it is
_TICK_S = 1e-6  # sleeping for less may not move a clock at all


@dataclass(eq=False)
class Watch:
    """Looks at the bench and tells everybody. Campaign time counts from the UTC instant `began`, also across a resume.

    `control`: where people's requests come from; `vital` tells a watchdog of life; `disk_free_mb`: the records' room.
    """

    devices: BenchDevices
    journal: Journal
    stop: StopRequest
    _: KW_ONLY
    began: datetime
    interlocks: InterlockSettings = field(default_factory=InterlockSettings)
    polling: Polling = field(default_factory=Polling)
    onlookers: Sequence[Progress] = ()
    control: Control | None = None
    vital: Callable[[float], None] | None = None
    disk_free_mb: Callable[[], float] | None = None
    commanded_degC: float | None = field(default=None, init=False)
    look: Look | None = field(default=None, init=False)
    _step: Step | None = field(default=None, init=False)  # the present one, or the first of several at once
    _attempt = _steps_done = _steps_total = 0
    _step_began_s = _later_s = 0.0  # the clock's; planned time of everything after this step
    arrived = False
    interruptible = False  # whether a pause ends the present step at once
    resting = False  # a pause is in effect
    note = ""
    remark = ""  # said before the next question to people: why it is asked again
    _chamber_s = _heartbeat_s = _progress_s = -math.inf
    _answered_s = -math.inf  # the chamber, for the last time
    _wall_off_s = 0.0  # as it was last recorded

    def __post_init__(self) -> None:
        clock = self.devices.clock
        # Within one run time is monotonic, whatever happens to the wall clock; across a resume it is the wall clock's.
        self._offset_s = (clock.utc() - self.began).total_seconds() - clock.now()
        self._drained_s = clock.now()
        self.desk = Desk(self.control, self.stop, self.event)
        rules = standard_interlocks(self.interlocks, self.devices.chamber.limits)
        self._suspects = Interlocks(rules, lambda *said: self.event(*said, **self.evidence()))
        self.units = {
            name: UnitWatch(name, each, self.event, lambda: self.alive(_IDENTITY_S))
            for name, each in self.devices.units.items()
        }
        """Those that go on, by name."""
        self.aside: dict[str, str] = {}  # why, by name

    # Time

    @property
    def now_s(self) -> float:
        """The clock's seconds."""
        return self.devices.clock.now()

    def campaign_s(self, clock_s: float | None = None) -> float:
        """Return campaign seconds: of now, or of a reading of the clock."""
        return (self.now_s if clock_s is None else clock_s) + self._offset_s

    # What is told

    def event(self, kind: str, message: str, **evidence: Any) -> None:
        """Record something that happened, and let onlookers see it."""
        self.journal.event(kind, message, **evidence)
        self.tell(kind, message)

    def tell(self, kind: str, message: str) -> None:
        """Let onlookers see that something happened, which need not be recorded."""
        self.show("event", kind, message, self.campaign_s())

    def stage_began(self, steps: Sequence[tuple[Step, int]], later_s: float, steps_done: int, steps_total: int) -> None:
        """Polls belong to these steps, each with its attempt, from now on; what is planned behind takes `later_s`."""
        self._step, self._attempt = steps[0][0], max(attempt for _, attempt in steps)
        self._step_began_s, self._later_s = self.now_s, later_s
        self._steps_done, self._steps_total = steps_done, steps_total
        self.note = ""
        for unit in self.units.values():
            unit.rates_deg_per_hr, unit.rates_se_deg_per_hr = {}, {}
        # Onlookers see a new step at once; what a move read in between is no rate of theirs.
        self._progress_s = -math.inf
        for step, attempt in steps:
            self.show("step_began", step, attempt)

    def show(self, what: str, *arguments: object) -> None:
        """Let onlookers see what need not be recorded here; `what` is a method of theirs."""
        for onlooker in tuple(self.onlookers):
            try:
                getattr(onlooker, what)(*arguments)
            except Exception as error:  # an onlooker, or its closed terminal, must not end a night
                self.onlookers = [each for each in self.onlookers if each is not onlooker]
                self.journal.event("onlooker-lost", f"progress is no longer shown: {error!r}")

    # Looking

    def evidence(self, unit: str | None = None) -> dict[str, Any]:
        """Return what the newest look saw, or the newest at one unit, for the record."""
        look = self.look if unit is None else self.units[unit].look
        if look is None:
            return {}
        chamber = {} if look.chamber is None else {"chamber": vars(look.chamber), "chamber_fresh": look.chamber_fresh}
        seen = ("commanded_degC", "unit_degC", "samples", "stream_span_s", "disk_free_mb")
        return chamber | {name: getattr(look, name) for name in seen} | {"counts": vars(look.counts)}

    def alive(self, silent_s: float = 0.0) -> None:
        """Tell a watchdog that the controller lives, and for how long it may be silent now. Called at every poll."""
        if self.vital is not None:
            self.vital(silent_s)

    def commanded(self, setpoint_degC: float | None) -> None:
        """Tell the interlocks what the chamber was told to hold (None: nothing any more)."""
        self.commanded_degC, self.arrived = setpoint_degC, False

    def forget_stream(self, units: Iterable[str]) -> None:
        """Throw away what these of the units that go on sent so far."""
        for name in self.units.keys() & set(units):
            self.units[name].forget()
        self._progress_s = -math.inf

    def set_aside(self, unit: str, cause: Exception) -> None:
        """Go on without a unit, with the reason on record; raise the `cause` where no other goes on."""
        if unit in self.aside:
            return
        if self.units.keys() <= {unit}:
            raise cause
        evidence = self.evidence(unit)
        del self.units[unit]
        self.aside[unit] = str(cause)
        self._suspects.forget(unit)
        going = counted(len(self.units), "unit")
        said = f"unit {unit} is set aside, {going} on: {cause}"
        self.event("unit-set-aside", said, unit=unit, why=str(cause), **evidence)

    def wait(self, until_s: float) -> Iterator[Looks]:
        """Yield a look at each unit that goes on, at each poll, until the clock shows `until_s`.

        At least one poll takes place. Raises `StopRequested`, `InterlockTripped`, `PauseAsked` (where one may pause).
        """
        while True:
            remaining_s = until_s - self.now_s
            self.devices.clock.sleep(min(self.polling.read_interval_s, max(remaining_s, 0.0)))
            yield self.poll()
            if self.now_s >= until_s - _TICK_S:
                return

    def hold_until_clear(self) -> None:
        """Return once nothing is suspected; a trip, or a ceiling for what nobody hears of, is an `InterlockTripped`."""
        if not self._suspects.suspected:
            return
        give_up_s = self.now_s + _HOLD_CEILING_S
        self.event("hold", f"holding: {self._suspects.suspected}")
        while self._suspects.suspected:
            self.note = "holding"
            if self.now_s >= give_up_s:
                raise InterlockTripped("held-too-long", self._suspects.suspected)
            self.look_again()
        self.event("hold-ended", "nothing is suspected any more")
        self.note = ""

    def look_again(self) -> Looks:
        """Wait for one read interval and return the looks after it."""
        *_, looks = self.wait(self.now_s + self.polling.read_interval_s)
        return looks

    def poll(self) -> Looks:
        """Drain the streams, read the chamber where it is due, judge, tell. Raises as `wait`, `PauseAsked` too."""
        self.alive(self.polling.read_interval_s)  # a bench may be looked at more seldom than a watchdog is patient
        self.desk.hear(self._when_a_pause_would_begin())
        self.stop.check()
        unseen_s = self.now_s - self._drained_s
        if unseen_s > UNSEEN_S + self.polling.read_interval_s:
            said = f"nobody looked for {hours_minutes(unseen_s)}: the computer slept, or the program was stopped"
            self.event("nobody-looked", said, unseen_s=unseen_s)
        drained = self._drain()
        self._drained_s = self.now_s
        fresh, chamber_error = self._read_chamber()
        self._answered_s = self._drained_s if fresh else self._answered_s
        disk_free_mb = None if self.disk_free_mb is None else self.disk_free_mb()
        # Interlocks come before anything that could fail for another reason.
        looks = {
            name: Look(
                time_s=self._drained_s,
                stream_span_s=span_s,
                samples=len(block),
                counts=block.counts,
                sample_rate_hz=self.units[name].imu.sample_rate_hz,
                unit=name,
                block=block,
                chamber=fresh or (self.look.chamber if self.look else None),
                chamber_fresh=fresh is not None,
                chamber_error=chamber_error,
                stream_error=stream_error,
                unit_degC={n: mean for n, mean, _ in means(block, self.units[name].temperature_fields)},
                commanded_degC=self.commanded_degC,
                arrived=self.arrived,
                frozen_s=self.units[name].unchanged_s(block, self._drained_s),
                disk_free_mb=disk_free_mb,
                resting=self.resting,
            )
            for name, (block, span_s, stream_error) in drained.items()
        }
        first = next(iter(looks))
        for name, look in looks.items():
            self.look = self.units[name].look = look
            try:
                self._suspects.evaluate(look, chamber=name == first)
            except InterlockTripped as tripped:
                if not tripped.of_unit:
                    raise
                self.set_aside(name, tripped)
        looks = {name: look for name, look in looks.items() if name in self.units}
        self.look = next(iter(looks.values()))
        self._heartbeat(looks)
        self._snapshot(looks)
        if self.interruptible and self.desk.pause is not None:
            raise PauseAsked(f"paused by {self.desk.pause}")
        return looks

    def _when_a_pause_would_begin(self) -> str:
        if self.interruptible:
            return "at once"
        sampling = self._step is not None and self._step.kind is StepKind.COLLECT
        return "when this collect is finished" if sampling else "before the next step"

    def _drain(self) -> Mapping[str, tuple[SampleBlock, float, str]]:
        drained = {}
        for name, unit in tuple(self.units.items()):
            try:
                drained[name] = unit.drain(resting=self.resting)
            except WrongDevice as wrong:
                self.set_aside(name, wrong)
        return drained

    def _read_chamber(self) -> tuple[ChamberReading | None, str]:
        if self.now_s - self._chamber_s < self.polling.interval_s - 1e-6:
            return None, ""
        self._chamber_s = self.now_s
        try:
            return self.devices.chamber.read(), ""
        except DeviceError as failure:
            return None, str(failure)

    # Telling

    def _heartbeat(self, looks: Looks) -> None:
        look = next(iter(looks.values()))
        if self._step is None or look.time_s - self._heartbeat_s < self.polling.heartbeat_s:
            return
        self._heartbeat_s = look.time_s
        readings = {
            f"unit_{labelled(name, number)}_degC": value
            for name, each in looks.items()
            for number, value in each.unit_degC.items()
        }
        if look.chamber is not None and look.time_s - self._answered_s <= self.polling.heartbeat_s:
            readings |= {"chamber_degC": look.chamber.temperature_degC, "setpoint_degC": look.chamber.setpoint_degC}
        self.journal.heartbeat(self._step, readings)
        # Each time that somebody set the wall clock is recorded; campaign time goes on by the monotonic one.
        off_s = (self.devices.clock.utc() - self.began).total_seconds() - self.campaign_s()
        if abs(off_s - self._wall_off_s) > _WALL_JUMP_S:
            self.event("wall-clock-jump", f"the wall clock is off by {off_s:+.0f} s since the start")
            self._wall_off_s = off_s

    def _snapshot(self, looks: Looks) -> None:
        look = next(iter(looks.values()))
        if self._step is None or look.time_s - self._progress_s < self.polling.progress_s:
            return
        since_s, self._progress_s = look.time_s - self._progress_s, look.time_s
        in_step_s = look.time_s - self._step_began_s
        remaining_s = max(self._step.duration_s - in_step_s, 0.0)
        finishing = self.began + timedelta(seconds=self.campaign_s(look.time_s) + remaining_s + self._later_s)
        note = ", ".join(filter(None, (self.note, self._suspects.countdown(look.time_s))))
        for name, each in looks.items():
            unit = self.units[name]
            frames, unit.shown_ok = unit.stream.ok - unit.shown_ok, unit.stream.ok
            self.show(
                "update",
                Snapshot(
                    step=self._step.of(name),
                    attempt=self._attempt,
                    elapsed_s=self.campaign_s(look.time_s),
                    step_elapsed_s=in_step_s,
                    step_remaining_s=remaining_s,
                    finishing_utc=finishing,
                    chamber_degC=look.chamber.temperature_degC if look.chamber else None,
                    setpoint_degC=look.chamber.setpoint_degC if look.chamber else None,
                    chamber_age_s=look.time_s - self._answered_s if look.chamber else None,
                    unit=name,
                    unit_degC=each.unit_degC,
                    rates_deg_per_hr=unit.rates_deg_per_hr,
                    rates_se_deg_per_hr=unit.rates_se_deg_per_hr,
                    rates_now_deg_per_hr={k: mean for k, mean, _ in means(each.block, unit.rate_fields)},
                    stream=unit.stream,
                    stream_hz=frames / since_s if math.isfinite(since_s) else None,
                    stream_nominal_hz=each.sample_rate_hz,
                    note=note,
                    steps_done=self._steps_done,
                    steps_total=self._steps_total,
                ),
            )
