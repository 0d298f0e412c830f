"""Carries out a plan, and is the only thing that decides what happens next: from the plan and the journal alone.

    sequencer = Sequencer(plan, devices, journal, stop, began=began)
    with stop.on_signals():
        outcome = sequencer.run()

Steps that the journal holds as DONE are skipped, so running and resuming are the same call. A step stands on others
that put the bench into a physical state: a collect on its index, its restabilisation, its setpoint and the devices'
identity. Those that are DONE in the journal but not in effect in this process are restored (done again, recorded as
events, never as a second result): a chamber cools while the controller is dead, so the soak starts over.

**The promise of the safe state.** Whatever ends a run (its end, a device, an interlock, a stop request, a full disk,
an error in this program), `_leave` runs and brings the chamber to its safe state *before* it writes anything, because
the journal may be what failed. It tries for minutes where the chamber does not answer, looks at the air until that
shows that the chamber does what it acknowledged (`safe_air`), and the outcome says: SAFE, NOT SAFE or NOT KNOWN.
Only a chamber that is not the one the bench file names is left alone. SIGKILL is the watchdog's to answer.
"""

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from datetime import datetime

from drivers.errors import CommandRefused, DeviceError, SetpointOutOfLimits, WrongDevice
from procedures.actions import Actions
from procedures.attended import Attendant
from procedures.devices import BenchDevices
from procedures.interlocks import InterlockTripped, standard_interlocks
from procedures.journal_protocol import Journal, Outcome, StepResult
from procedures.pause import rest
from procedures.plan import Plan, Step, StepKind
from procedures.progress import Progress, Silent
from procedures.requests import Control, PauseAsked
from procedures.runaway import rate_interlocks
from procedures.safe_air import Left, Word, not_commanded
from procedures.settings import CollectSettings, InterlockSettings, Polling, Restabilisation
from procedures.stop import StopRequest, StopRequested
from procedures.sweep_outcome import SweepOutcome, SweepState, state_after, why
from procedures.verdict import NOT_GOOD, Verdict
from procedures.watch import Position, Watch
from procedures.words import counted

# What each kind of step stands on, in the order in which it has to be restored.
_STANDS_ON: Mapping[StepKind, tuple[StepKind, ...]] = {
    StepKind.IDENTIFY: (),
    StepKind.SETPOINT: (StepKind.IDENTIFY,),
    StepKind.RESTABILISE: (StepKind.IDENTIFY, StepKind.SETPOINT),
    StepKind.INDEX: (StepKind.IDENTIFY, StepKind.SETPOINT, StepKind.RESTABILISE),
    StepKind.COLLECT: (StepKind.IDENTIFY, StepKind.SETPOINT, StepKind.RESTABILISE, StepKind.INDEX),
    StepKind.SAFE_STATE: (),
}
_WHY_AGAIN: Mapping[StepKind, str] = {
    StepKind.IDENTIFY: "another device may have been connected",
    StepKind.SETPOINT: "a chamber that nobody commands drifts away",
    StepKind.RESTABILISE: "nothing shows that the unit stayed in equilibrium",
    StepKind.INDEX: "the unit may have been moved",
}
# A pause lets a collect be finished: its samples are good, and it is over in a minute or two.
_INTERRUPTED_BY_A_PAUSE = (StepKind.SETPOINT, StepKind.RESTABILISE, StepKind.INDEX)
_NEVER_RETRIED = (WrongDevice, SetpointOutOfLimits, CommandRefused)
_LEAST_WAIT_S = 0.1
_SAFE_STATE_SILENCE_S = 200.0  # longer than a driver tries at a chamber that answers late or not at all


class Sequencer:
    """Runs a plan on a bench. `began` is the UTC instant from which campaign time counts, also across a resume.

    `powered_on` is when the unit was switched on, where that is known; `control` is where people's requests come from;
    `attendant` puts the positioner's questions, which is to look at the bench meanwhile; `first` is done before
    anything moves and raises as a step does; `vital` tells a watchdog that the controller lives; `disk_free_mb` says
    how much room the records have. `run` may be called once.
    """

    def __init__(
        self,
        plan: Plan,
        devices: BenchDevices,
        journal: Journal,
        stop: StopRequest,
        *,
        began: datetime,
        interlocks: InterlockSettings | None = None,
        polling: Polling | None = None,
        progress: Progress | None = None,
        powered_on: datetime | None = None,
        control: Control | None = None,
        attendant: Attendant | None = None,
        first: Callable[[], None] | None = None,
        vital: Callable[[float], None] | None = None,
        disk_free_mb: Callable[[], float] | None = None,
    ) -> None:
        self._plan = plan
        self._devices = devices
        self._journal = journal
        self._began = began
        self._interlocks = interlocks or InterlockSettings()
        self._polling = polling or Polling()
        self._power_on_s = None if powered_on is None else (powered_on - began).total_seconds()
        rules = (*standard_interlocks(self._interlocks, devices.chamber.limits), *rate_interlocks(self._interlocks))
        onlooker = progress or Silent()
        self._watch = Watch(devices, journal, stop, rules, self._polling, onlooker, began, control, vital, disk_free_mb)
        if attendant is not None:
            attendant.attend(self._watch)
        self._first = first
        self._done: set[str] = set()
        self._failed: dict[str, str] = {}  # by step key, why
        self._in_effect: dict[StepKind, str] = {}
        self._open: tuple[Step, int] | None = None  # begun in the journal, not ended
        self._touched = False
        self._unsettled = 0

    # The run and its ways out

    def run(self) -> SweepOutcome:
        """Carry out what is not DONE yet. Never raises an `Exception`: the outcome says what happened."""
        cause: Exception | None = None
        try:
            self._sweep()
        except Exception as error:
            cause = error
        except BaseException as error:  # an interrupt that nobody turned into a stop request
            self._leave(error)
            raise
        return self._outcome(cause, self._leave(cause))

    def _sweep(self) -> None:
        """Do every step that is not DONE, restoring first what it stands on."""
        recorded = dict(self._journal.completed())
        self._done = {step.key for step in self._plan.steps if step.key in recorded}
        self._actions = Actions(self._devices, self._watch, self._interlocks, recorded, self._power_on_s)
        self._watch.sweep_began(self._plan, frozenset(self._done))
        pending = [step for step in self._plan.steps if step.key not in self._done]
        if not pending:
            return
        if self._first is not None:
            self._first()
        if self._done:
            done, total = len(self._done), len(self._plan.steps)
            message = f"resumed with {done} of {total} steps done, next is {pending[0].key}"
            self._watch.event("resumed", message, next=pending[0].key, done=done)
        for step in pending:
            blocked = self._prepare(step)
            if blocked:
                self._failed[step.key] = f"{blocked} could not be done"
                self._watch.event("skipped", f"{step.key} cannot be done: {blocked} was not", step=step.key)
            else:
                self._do(step)
        if StepKind.SAFE_STATE not in self._in_effect:
            self._end_again()

    def _end_again(self) -> None:
        """Bring the chamber to its final temperature although that step was DONE in an earlier run."""
        final = self._before(self._plan.steps[-1], StepKind.SETPOINT)
        if final is not None and not any(
            step.kind is StepKind.COLLECT for step in self._plan.steps[final.index :]
        ):  # nothing is measured there
            self._restore(final)

    def _leave(self, cause: BaseException | None) -> Left:
        """Reach the safe state, then close the journal's open step and record why. Return how the chamber is left."""
        left = self._make_safe(cause)
        reason = why(cause)
        try:
            if self._open is not None:
                outcome = Outcome.ABORTED if isinstance(cause, StopRequested) else Outcome.ERROR
                self._end(*self._open, StepResult(outcome, reason))
            if cause is not None:
                kind = "interlock" if isinstance(cause, InterlockTripped) else state_after(cause).value
                self._watch.event(kind, reason, **(self._watch.evidence() if kind == "interlock" else {}))
            if self._touched:
                kind = "safe-state" if left.safe else "safe-state-not-reached"
                self._watch.event(kind, left.reason, chamber=left.word.value)
        except Exception as failure:
            # The journal itself failed. Nothing more can be recorded; the outcome carries the first cause.
            if cause is not None:
                cause.add_note(f"and the journal could not record it: {failure}")
        return left

    def _make_safe(self, cause: BaseException | None) -> Left:
        """Command the safe state, with retries, and look at what the air does; return how the chamber is left."""
        if not self._touched or StepKind.SAFE_STATE in self._in_effect:
            return Left(reason="the air has shown that it is in its safe state")
        if self._actions.chamber_refused:
            why_not = f"what answers is not the bench's chamber, so nothing was sent to it ({cause})"
            return Left(Word.NOT_KNOWN, why_not)
        problem = ""
        give_up_s = self._devices.clock.now() + self._polling.safe_state_s
        while True:
            self._watch.alive(_SAFE_STATE_SILENCE_S)
            try:
                return self._actions.watch_air(self._devices.chamber.safe_state())
            except Exception as failure:
                said, problem = bool(problem), f"the chamber could not be brought to its safe state: {failure}"
                left = not_commanded(failure, problem)
            if not said:
                with suppress(Exception):  # trying goes on whether or not this can be recorded
                    self._watch.event("safe-state-retry", f"{problem}; {why(cause)}")
            left_s = give_up_s - self._devices.clock.now()
            if left_s <= 0.0:
                return left
            self._watch.tell("safe-state-retry", f"the chamber is not safe yet, trying again, {left_s:.0f} s left")
            self._devices.clock.sleep(max(self._polling.retry_wait_s, _LEAST_WAIT_S))

    def _outcome(self, cause: Exception | None, left: Left) -> SweepOutcome:
        missing = tuple(step.key for step in self._plan.steps if step.key not in self._done)
        if cause is not None:
            state, reason = state_after(cause), why(cause)
        elif not left.safe:
            state, reason = SweepState.FAILED, left.reason
        elif missing:
            because = f": {self._failed[missing[0]]}" if missing[0] in self._failed else ""
            state = SweepState.INCOMPLETE
            reason = f"{counted(len(missing), 'step')} not done, the first is {missing[0]}{because}"
        else:
            state, reason = SweepState.COMPLETE, "every step is done"
        return SweepOutcome(
            state=state,
            reason=reason,
            missing=missing,
            left=left,
            error=cause if state in (SweepState.FAILED, SweepState.ERROR) else None,
        )

    # One step

    def _prepare(self, step: Step) -> str:
        """Put into effect what `step` stands on; return the key of what cannot be, or nothing."""
        for kind in _STANDS_ON[step.kind]:
            base = self._before(step, kind)
            if base is None or self._in_effect.get(kind) == base.key:
                continue
            if base.key in self._failed or not self._restore(base):
                self._failed.setdefault(base.key, "it could not be done again")
                return base.key
        return ""

    def _before(self, step: Step, kind: StepKind) -> Step | None:
        """Return the nearest step of a kind before `step`: by construction of a plan, the one it stands on."""
        return next((each for each in reversed(self._plan.steps[: step.index]) if each.kind is kind), None)

    def _restore(self, step: Step) -> bool:
        """Do a step again that is DONE in the journal, as an event; return whether it is in effect now."""
        self._watch.event("restoring", f"doing {step.key} again, because {_WHY_AGAIN[step.kind]}", step=step.key)
        result = self._with_retries(step, lambda: self._begin(step, attempt=0), _unrecorded)
        evidence = dict(result.data)
        self._watch.event("restored", f"{step.key}: {result.reason}", step=step.key, data=evidence)
        return self._now_in_effect(step, result)

    def _do(self, step: Step) -> None:
        """Do a step and commit its result."""

        def begin() -> None:
            attempt = self._journal.begin(step)
            self._open = (step, attempt)
            self._begin(step, attempt)

        def end(result: StepResult) -> None:
            if self._open is not None:
                self._end(*self._open, result)

        result = self._with_retries(step, begin, end)
        if not self._now_in_effect(step, result):
            self._failed[step.key] = result.reason

    def _begin(self, step: Step, attempt: int) -> None:
        self._touched = True
        later_s = sum(each.duration_s for each in self._plan.steps[step.index + 1 :] if each.key not in self._done)
        total = len(self._plan.steps)
        self._watch.step_began(Position(step, attempt, self._watch.now_s, later_s, len(self._done), total))

    def _end(self, step: Step, attempt: int, result: StepResult) -> None:
        self._journal.end(step, attempt, result)
        self._open = None
        if result.outcome is Outcome.DONE:
            self._done.add(step.key)
        self._watch.step_ended(step, result)

    def _with_retries(self, step: Step, begin: Callable[[], None], end: Callable[[StepResult], None]) -> StepResult:
        """Perform a step until it has a result to keep: device errors and bad collects are tried again, bounded."""
        collects_left = int(CollectSettings.from_parameters(step.parameters).attempts)
        devices_left = self._polling.device_attempts
        while True:
            blocked = self._hold(step)
            begin()
            if blocked:
                end(lost := StepResult(Outcome.FAILED, f"{blocked} could not be restored after the pause"))
                return lost
            try:
                self._watch.interruptible = step.kind in _INTERRUPTED_BY_A_PAUSE
                result = self._actions.perform(step)
            except PauseAsked as pause:
                end(StepResult(Outcome.ABORTED, f"{pause}; done again afterwards"))
                continue
            except DeviceError as error:
                devices_left -= 1
                end(StepResult(Outcome.ERROR, str(error)))
                if devices_left <= 0 or isinstance(error, _NEVER_RETRIED):
                    raise InterlockTripped("device", f"{step.key}: {error}") from error
                self._watch.event("retry", f"{step.key}: {error}; {devices_left} more tries", step=step.key)
                for _ in self._watch.wait(self._watch.now_s + self._polling.retry_wait_s):
                    pass  # it is looked at meanwhile
                continue
            finally:
                self._watch.interruptible = False
            collects_left -= 1
            if step.kind is StepKind.COLLECT and collects_left > 0 and _not_good(result):
                end(replace(result, outcome=Outcome.FAILED))
                self._watch.event("retry", f"{step.key} is taken again: {result.reason}", step=step.key)
                self._back_in_position(step, result.data.get("wrong_pose", ""))
                continue
            end(result)
            return result

    def _hold(self, step: Step) -> str:
        """Return once nothing is suspected and nobody pauses; return the key of what a pause undid for good, if any."""
        self._watch.hold_until_clear()
        while self._watch.desk.pause is not None:
            soak = step if step.kind is StepKind.RESTABILISE else self._before(step, StepKind.RESTABILISE)
            settings = Restabilisation() if soak is None else Restabilisation.from_parameters(soak.parameters)
            soaked = soak is not None and self._in_effect.get(StepKind.RESTABILISE) == soak.key
            lost = rest(self._watch, settings, self._interlocks.pause_s, soaked=soaked)
            undone = [StepKind.IDENTIFY, StepKind.INDEX, *([StepKind.RESTABILISE] if lost else [])]
            for kind in undone:
                self._in_effect.pop(kind, None)
            self._watch.hold_until_clear()
            blocked = self._prepare(step)
            if blocked:
                return blocked
        return ""

    def _back_in_position(self, step: Step, wrong_pose: str) -> None:
        """Index again where the unit is not confirmed to stand, or does not lie, as the collect wants it."""
        index = self._before(step, StepKind.INDEX)
        if index is not None and (wrong_pose or self._devices.positioner.position() != step.position):
            self._watch.remark = wrong_pose
            self._restore(index)
            self._watch.remark = ""

    def _now_in_effect(self, step: Step, result: StepResult) -> bool:
        """Note what the step put into effect; end the night where soaks never settle.

        What is in effect is compared by key, and a plan never comes back to a key it has left, so a new setpoint needs
        no list of what it undoes.
        """
        if step.kind is StepKind.RESTABILISE:
            self._unsettled = 0 if result.outcome is Outcome.DONE else self._unsettled + 1
            if self._unsettled >= self._interlocks.unsettled_soaks:
                raise InterlockTripped("soak-never-settles", f"{self._unsettled} soaks in a row: {result.reason}")
        if result.outcome is not Outcome.DONE:
            self._in_effect.pop(step.kind, None)
            return False
        self._in_effect[step.kind] = step.key
        return True


def _unrecorded(_result: StepResult) -> None:
    """Leave no result: the step has one."""


def _not_good(result: StepResult) -> bool:
    """Tell a collect whose own samples are not good; a soak that was not is no reason to take it again."""
    return result.outcome is not Outcome.DONE or Verdict(result.data["samples_verdict"]) in NOT_GOOD
