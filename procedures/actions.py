"""What a step of each kind does to the bench, apart from when and why: that is the sequencer's.

Every action leaves a `StepResult` or raises: `DeviceError` for a device that did not do what it was asked (which may
be tried again), `InterlockTripped` and `StopRequested` from the polls inside.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from drivers.chambers import SafeState
from drivers.errors import DeviceError, WrongDevice
from drivers.imu import ImuIdentity
from drivers.positioners.positioner import move_all
from procedures.collect import Times, take_collects
from procedures.interlocks import InterlockTripped
from procedures.interlocks import of_unit as whose
from procedures.journal_protocol import Outcome, StepResult, of_unit
from procedures.plan import Step, StepKind
from procedures.restabilisation import restabilise
from procedures.safe_air import Left, Word, not_commanded, watch_air
from procedures.settings import CollectSettings, Restabilisation
from procedures.sweep_outcome import why
from procedures.verdict import Judgement, Verdict
from procedures.watch import Watch

_LEAST_WAIT_S = 0.1
_SAFE_STATE_SILENCE_S = 200.0  # longer than a driver tries at a chamber that answers late or not at all
_READ_S = 100.0  # longer than one look at a chamber that does not answer takes


Results = Mapping[str, StepResult | DeviceError]
"""What came of a stage for each unit by its name, or, given to whoever asked for it, by the step's key."""


@dataclass(eq=False)
class Actions:
    """The actions on a bench; `recorded` are results of completed steps, by key, `times` what collects count from."""

    watch: Watch
    recorded: Mapping[str, StepResult]
    times: Times
    _setpoint_degC: float | None = field(default=None, init=False)
    _soak: Mapping[str, Any] = field(default_factory=dict, init=False)  # the one in effect, as it is recorded
    _ramp_degC_per_min = 3.0
    chamber_refused = False  # what answers is not the bench's chamber: send it nothing at all

    def __post_init__(self) -> None:
        self.devices = self.watch.devices

    def perform(self, steps: Sequence[Step]) -> Results:
        """Do what the steps of one stage say, at once; return what came of each by its key.

        Where one unit's device failed its error stands there; of one that was set aside nothing does. Raises as a poll,
        and `DeviceError`, `InterlockTripped` or `ValueError` for the chamber.
        """
        first, units = steps[0], {step.unit: step.key for step in steps if step.unit is not None}
        match first.kind:
            case StepKind.SETPOINT:
                return {first.key: self._setpoint(first)}
            case StepKind.RESTABILISE:
                return {first.key: self._restabilise(first)}
            case StepKind.SAFE_STATE:
                return {first.key: self._safe_state()}
            case StepKind.IDENTIFY:
                found = self._identify(first, list(units))
            case StepKind.INDEX:
                found = self._index(first, list(units))
            case StepKind.COLLECT:
                found = self._collect(first, list(units))
        return {units[name]: each for name, each in found.items()}

    def _identify(self, step: Step, units: Sequence[str]) -> Results:
        # The chamber first: if the unit is the wrong one, the chamber can still be brought to its safe state.
        try:
            chamber = self.devices.chamber.identify()
        except WrongDevice:
            self.chamber_refused = True
            raise
        found: dict[str, StepResult | DeviceError] = {}
        for name in units:
            recorded, unit = self.recorded.get(step.of(name).key), self.watch.units[name]
            if unit.identity is None and recorded and "imu" in recorded.data:
                unit.identity = ImuIdentity(**recorded.data["imu"])
            try:
                told = unit.same_unit()
                self.devices.refuse_undeclared_simulation(*vars(told).values(), chamber.model)
            except DeviceError as error:
                found[name] = error
            else:
                data = {"imu": dict(vars(told)), "chamber": dict(vars(chamber))}
                found[name] = StepResult(Outcome.DONE, "devices identified", data)
        known = [name for name, each in found.items() if not isinstance(each, DeviceError)]
        if known:
            self.devices.chamber.prepare()
            self.watch.forget_stream(known)
            self.watch.poll()
        return found

    def _setpoint(self, step: Step) -> StepResult:
        """Command the chamber and wait until its air arrives in the band; a ramp that takes too long is a fault."""
        target_degC = step.temperature_degC
        if target_degC is None:
            raise ValueError("a setpoint step without a temperature is no step")
        from_degC = self._command(step, target_degC)
        self._ramp_degC_per_min = step.parameters["ramp_degC_per_min"]
        limits = self.watch.interlocks
        expected_s = 60.0 * abs(target_degC - from_degC) / self._ramp_degC_per_min
        allowed_s = limits.ramp_factor * expected_s + limits.ramp_extra_s
        began_s = self.watch.now_s
        self.watch.note = f"ramping to {target_degC:.1f} °C"
        for looks in self.watch.wait(began_s + allowed_s):
            look = next(iter(looks.values()))
            if look.chamber is None or not look.chamber_fresh:
                continue
            if abs(look.chamber.temperature_degC - target_degC) <= step.parameters["band_degC"]:
                self.watch.arrived = True
                data = {
                    "setpoint_degC": target_degC,
                    "commanded_s": self.times.setpoint_s,
                    "from_degC": from_degC,
                    "ramp_s": self.watch.now_s - began_s,
                }
                return StepResult(Outcome.DONE, f"arrived at {look.chamber.temperature_degC:.1f} °C", data)
        raise InterlockTripped(
            "ramp-too-long", f"the chamber did not reach {target_degC:.1f} °C within {allowed_s / 60.0:.0f} min"
        )

    def _command(self, step: Step, target_degC: float) -> float:
        now = self.devices.chamber.read()
        self.watch.commanded(None)
        self.devices.chamber.set_temperature(target_degC)
        self.watch.commanded(target_degC)
        before = self.recorded.get(step.key)
        held = max(abs(now.setpoint_degC - target_degC), abs(now.temperature_degC - target_degC))
        if before is not None and held <= step.parameters["band_degC"]:
            self.times.setpoint_s = before.data.get("commanded_s")
        elif self._setpoint_degC != target_degC:
            self.times.setpoint_s = self.watch.campaign_s()
        self._setpoint_degC = target_degC
        return now.temperature_degC

    def _restabilise(self, step: Step) -> StepResult:
        """Wait for the evidence; at the ceiling go on to an INCONCLUSIVE self-calibration, or give it up."""
        settings = Restabilisation.from_parameters(step.parameters)
        self._soak = soak = restabilise(self.watch, settings)
        outcome = Outcome.TIMEOUT if soak["waiting_for"] and not settings.collect_at_ceiling else Outcome.DONE
        return StepResult(outcome, soak["reason"], {"setpoint_degC": step.temperature_degC, **soak})

    def _index(self, step: Step, units: Sequence[str]) -> Results:
        position, timeout_s = step.position or "", step.parameters["index_timeout_s"]
        began_s = self.watch.now_s
        self.watch.note = f"moving to position {position}"
        self.watch.poll()
        self.watch.alive(timeout_s)
        positioners = {n: self.devices.units[n].positioner for n in units if n in self.watch.units}
        failed = move_all(positioners, self.devices.clock, position, timeout_s)
        found: dict[str, StepResult | DeviceError] = dict(failed)
        reached = {name: each.position() for name, each in positioners.items() if name not in failed}
        for name, at in reached.items():
            if at != position:
                found[name] = DeviceError(f"the unit was sent to position {position} and confirms {at or 'nothing'}")
        if found.keys() >= set(units):
            return found
        self.watch.forget_stream(reached)
        self.times.index_s = self.watch.campaign_s()
        data = {"position": position, "moved_s": self.watch.now_s - began_s}
        return {name: StepResult(Outcome.DONE, f"at position {position}", data) for name in reached} | found

    def _collect(self, step: Step, units: Sequence[str]) -> Results:
        """Take a collect. After a resume the soak that counts for it is not the one in the journal."""
        settings = CollectSettings.from_parameters(step.parameters)
        those = {name: self.devices.units[name] for name in units}
        soaks = {name: of_unit(self._soak, name) for name in units}
        soaked = {n: [Judgement(Verdict(it["verdict"]), it["reason"])] if it else [] for n, it in soaks.items()}
        return take_collects(self.watch, those, settings, step.position or "", self.times, soaked)

    def _safe_state(self) -> StepResult:
        self.watch.commanded(None)
        self._setpoint_degC = None
        left = self.watch_air(self.devices.chamber.safe_state())
        if not left.safe:
            raise InterlockTripped("chamber-not-safe", left.reason)
        return StepResult(Outcome.DONE, str(left), {"chamber": left.word.value})

    def make_safe(self, cause: BaseException | None) -> Left:
        """Command the safe state, with retries, and look at what the air does; return how the chamber is left."""
        if self.chamber_refused:
            why_not = f"what answers is not the bench's chamber, so nothing was sent to it ({cause})"
            return Left(Word.NOT_KNOWN, why_not)
        problem = ""
        watch, clock = self.watch, self.devices.clock
        give_up_s = clock.now() + watch.polling.safe_state_s
        while True:
            watch.alive(_SAFE_STATE_SILENCE_S)
            try:
                return self.watch_air(self.devices.chamber.safe_state())
            except Exception as failure:
                said, problem = bool(problem), f"the chamber could not be brought to its safe state: {failure}"
                left = not_commanded(failure, problem)
            if not said:
                with suppress(Exception):  # trying goes on whether or not this can be recorded
                    watch.event("safe-state-retry", f"{problem}; {why(cause)}")
            left_s = give_up_s - clock.now()
            if left_s <= 0.0:
                return left
            watch.tell("safe-state-retry", f"the chamber is not safe yet, trying again, {left_s:.0f} s left")
            clock.sleep(max(watch.polling.retry_wait_s, _LEAST_WAIT_S))

    def watch_air(self, safe: SafeState) -> Left:
        """Look at the air until it shows that the safe state acts; nothing but the chamber can end that."""
        watch, told = self.watch, list[str]()

        def waiting(seen: str) -> None:
            watch.alive(watch.polling.interval_s + _READ_S)
            with suppress(Exception):  # a journal that fails must not end the look at the chamber
                (watch.tell if told else watch.event)("safe-state-commanded", seen)
            told.append(seen)

        chamber, clock = self.devices.chamber, self.devices.clock
        return watch_air(chamber, clock, safe, watch.polling, waiting, self._ramp_degC_per_min)


def rest(watch: Watch, settings: Restabilisation, longest_s: float, *, soaked: bool) -> str:
    """Hold the bench as it is until the pause ends; return why the soak must start over, or nothing.

    The setpoint stays commanded, every interlock but the loss of the stream is judged (a pause is for cables), and a
    stop is heard. The soak counts on where readings prove that the air stayed in its band and the unit kept its power;
    `soaked` says that it was finished before. Raises what a poll raises; `InterlockTripped` after `longest_s`.
    """
    asked, setpoint_degC, band = watch.desk.pause, watch.commanded_degC, settings.band_degC
    if asked is None:
        return ""
    at = "" if setpoint_degC is None else f" at {setpoint_degC:.1f} °C"
    air_s, lost = (began_s := watch.now_s), "" if soaked else "it was not finished"
    unit_s: dict[str, float] = {}
    watch.event("pause", f"paused by {asked}; the chamber is held{at}", who=asked.who, why=asked.why)
    watch.resting = True
    try:
        while watch.desk.pause is not None:
            watch.note = f"paused by {asked}"
            if watch.now_s - began_s >= longest_s:
                raise InterlockTripped("paused-too-long", f"paused by {asked}, and nobody came back")
            looks = watch.look_again()
            look = next(iter(looks.values()))
            fresh = look.chamber if look.chamber_fresh else None
            if fresh and setpoint_degC is not None and abs(fresh.temperature_degC - setpoint_degC) <= band:
                air_s = look.time_s
            unit_s.update((name, each.time_s) for name, each in looks.items() if each.samples)
            silent = [n for n in looks if look.time_s - unit_s.get(n, began_s) > settings.excursion_s]
            if soaked and look.time_s - air_s > settings.excursion_s:  # neither may fail for longer
                lost = f"the air was not shown to stay within {band:g} °C of the setpoint"
            elif soaked and silent:
                lost = f"{whose(silent[0])}the unit was silent and may have been without power"
    finally:
        watch.resting, watch.note = False, ""
    lasted_s = watch.now_s - began_s
    soak = f"the soak starts over: {lost}" if lost else "the soak still counts: the air stayed in its band"
    by = watch.desk.continued_by
    said = f"{by} goes on after {lasted_s / 60.0:.0f} min; {soak}"
    watch.event("continue", said, who=by, paused_s=lasted_s, soak_kept=not lost, reason=lost)
    return lost
