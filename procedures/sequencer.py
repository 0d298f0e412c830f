"""Carries out a plan, and is the only thing that decides what happens next: from the plan and the journal alone.

Steps that the journal holds as DONE are skipped, so running and resuming are the same call. A step stands on others
that put the bench into a physical state: a collect on its index, its restabilisation, its setpoint and the devices'
identity. Those that are DONE in the journal but not in effect in this process are restored (done again, recorded as
events, never as a second result): a chamber cools while the controller is dead, so the soak starts over.

What is done to units is done to all of them at once (a stage). One that is lost, wrong or silent is set aside, with its
reason on record, and the others go on; what happens to the last one, or to the chamber, ends the run.

**The promise of the safe state.** Whatever ends a run (its end, a device, an interlock, a stop request, a full disk,
an error in this program), `_leave` runs and brings the chamber to its safe state *before* it writes anything, because
the journal may be what failed. It tries for minutes where the chamber does not answer, looks at the air until that
shows that the chamber does what it acknowledged (`safe_air`), and the outcome says: SAFE, NOT SAFE or NOT KNOWN.
Only a chamber that is not the one the bench file names is left alone. SIGKILL is the watchdog's to answer.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from datetime import datetime
from itertools import takewhile

from drivers.errors import CommandRefused, DeviceError, SetpointOutOfLimits, WrongDevice
from procedures.actions import Actions, rest
from procedures.attended import Attendant
from procedures.collect import Times
from procedures.interlocks import InterlockTripped
from procedures.journal_protocol import Outcome, StepResult
from procedures.plan import Plan, Step, StepKind, lasting_s
from procedures.requests import PauseAsked
from procedures.safe_air import Left
from procedures.settings import CollectSettings, Restabilisation
from procedures.stop import StopRequested
from procedures.sweep_outcome import SweepOutcome, SweepState, state_after, why
from procedures.verdict import NOT_GOOD
from procedures.watch import Watch
from procedures.words import counted

# What steps stand on, in the order in which it has to be restored, each on those before it; and why it is done again.
_STANDS_ON: Mapping[StepKind, str] = {
    StepKind.IDENTIFY: "another device may have been connected",
    StepKind.SETPOINT: "a chamber that nobody commands drifts away",
    StepKind.RESTABILISE: "nothing shows that the unit stayed in equilibrium",
    StepKind.INDEX: "the unit may have been moved",
}
# A pause lets a collect be finished: its samples are good, and it is over in a minute or two.
_INTERRUPTED_BY_A_PAUSE = (StepKind.SETPOINT, StepKind.RESTABILISE, StepKind.INDEX)
_NEVER_RETRIED = (WrongDevice, SetpointOutOfLimits, CommandRefused)
Ends = Sequence[tuple[Step, StepResult]]
"""How steps of a stage ended: they are committed at once."""


@dataclass(eq=False)
class Sequencer:
    """Runs a plan on the bench that it looks at through `watch`. `run` may be called once.

    `powered_on` is when the unit was switched on, where that is known; `attendant` puts the positioner's questions,
    which is to look at the bench meanwhile; `first` is done before anything moves and raises as a step does.
    """

    plan: Plan
    watch: Watch
    _: KW_ONLY
    powered_on: datetime | None = None
    attendant: Attendant | None = None
    first: Callable[[], None] | None = None
    _touched = False
    _unsettled = 0

    def __post_init__(self) -> None:
        if self.attendant is not None:
            self.attendant.attend(self.watch)
        self._done: set[str] = set()
        self._failed: dict[str, str] = {}  # by step key, why
        self._in_effect: dict[tuple[StepKind, str | None], str] = {}  # the stage, by kind and unit
        self._open: dict[str, tuple[Step, int]] = {}  # begun in the journal, not ended, by key

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
        recorded = dict(self.watch.journal.completed())
        self._done = {step.key for step in self.plan.steps if step.key in recorded}
        power_on_s = None if self.powered_on is None else (self.powered_on - self.watch.began).total_seconds()
        self._actions = Actions(self.watch, recorded, Times(power_on_s))
        self.watch.show("sweep_began", self.plan, frozenset(self._done))
        pending = [step for step in self.plan.steps if step.key not in self._done]
        if not pending:
            return
        if self.first is not None:
            self.first()
        if self._done:
            done, total = len(self._done), len(self.plan.steps)
            message = f"resumed with {done} of {total} steps done, next is {pending[0].key}"
            self.watch.event("resumed", message, next=pending[0].key, done=done)
        for stage in self.plan.stages:
            steps = [step for step in stage if step.key not in self._done]
            blocked = self._prepare(steps)
            for step in self._going_on(steps) if blocked else ():
                self._failed[step.key] = f"{blocked} could not be done"
                self.watch.event("skipped", f"{step.key} cannot be done: {blocked} was not", step=step.key)
            if not blocked:
                self._do(self._going_on(steps))
        if (StepKind.SAFE_STATE, None) not in self._in_effect:  # nothing is measured from its last setpoint on
            final = self._before(self.plan.steps[-1], StepKind.SETPOINT)
            after = self.plan.steps[final[0].index :] if final else ()
            if final and not any(step.kind is StepKind.COLLECT for step in after):
                self._restore(final)  # although that step was DONE in an earlier run

    def _going_on(self, steps: Sequence[Step]) -> Sequence[Step]:
        return [step for step in steps if step.unit is None or step.unit in self.watch.units]

    def _leave(self, cause: BaseException | None) -> Left:
        """Reach the safe state, then close the journal's open step and record why. Return how the chamber is left."""
        left = Left(reason="the air has shown that it is in its safe state")
        if self._touched and (StepKind.SAFE_STATE, None) not in self._in_effect:
            left = self._actions.make_safe(cause)
        reason = why(cause)
        try:
            outcome = Outcome.ABORTED if isinstance(cause, StopRequested) else Outcome.ERROR
            self._end([(step, StepResult(outcome, reason)) for step, _ in self._open.values()])
            if cause is not None:
                kind = "interlock" if isinstance(cause, InterlockTripped) else state_after(cause).value
                self.watch.event(kind, reason, **(self.watch.evidence() if kind == "interlock" else {}))
            if self._touched:
                kind = "safe-state" if left.safe else "safe-state-not-reached"
                self.watch.event(kind, left.reason, chamber=left.word.value)
        except Exception as failure:
            # The journal itself failed. Nothing more can be recorded; the outcome carries the first cause.
            if cause is not None:
                cause.add_note(f"and the journal could not record it: {failure}")
        return left

    def _outcome(self, cause: Exception | None, left: Left) -> SweepOutcome:
        lacking, aside = [step for step in self.plan.steps if step.key not in self._done], self.watch.aside
        missing, partly = tuple(step.key for step in lacking), False
        if cause is not None:
            state, reason = state_after(cause), why(cause)
        elif not left.safe:
            state, reason = SweepState.FAILED, left.reason
        elif partly := bool(missing) and {step.unit for step in lacking} <= aside.keys():
            whole = f"complete for {len(self.plan.units) - len(aside)} of {counted(len(self.plan.units), 'unit')}"
            so = "; ".join(f"{unit} ({why_so})" for unit, why_so in aside.items())
            state, reason = SweepState.INCOMPLETE, f"{whole}; set aside: {so}"
        elif missing:
            because = f": {self._failed[missing[0]]}" if missing[0] in self._failed else ""
            state = SweepState.INCOMPLETE
            reason = f"{counted(len(missing), 'step')} not done, the first is {missing[0]}{because}"
        else:
            state, reason = SweepState.COMPLETE, "every step is done"
        fatal = cause if state in (SweepState.FAILED, SweepState.ERROR) else None
        return SweepOutcome(state, reason, missing, partly, left, fatal)

    # One stage: a step of the chamber, or one of each unit

    def _prepare(self, steps: Sequence[Step]) -> str:
        """Put into effect what `steps` stand on; return the key of what cannot be, or nothing."""
        stands = bool(steps) and steps[0].kind is not StepKind.SAFE_STATE
        for kind in takewhile(lambda each: each is not steps[0].kind, _STANDS_ON) if stands else ():
            going = self._going_on(steps)
            units = {step.unit for step in going}
            lacking = [
                base
                for base in self._before(steps[0], kind)
                if going
                and (base.unit is None or base.unit in units or units == {None})
                and self._in_effect.get((kind, base.unit)) != base.stage
            ]
            for base in lacking:
                if base.key in self._failed:
                    return base.key
            if self._going_on(lacking) and not self._restore(lacking):
                self._failed.setdefault(lacking[0].key, "it could not be done again")
                return lacking[0].key
        return ""

    def _before(self, step: Step, kind: StepKind) -> Sequence[Step]:
        """Return the nearest steps of a kind before `step`: by construction of a plan, those it stands on."""
        stages = self.plan.stages
        return next((each for each in reversed(stages) if each[0].index < step.index and each[0].kind is kind), ())

    def _restore(self, steps: Sequence[Step]) -> bool:
        """Do steps again that are DONE in the journal, as events; return whether they are in effect now."""
        steps = self._going_on(steps)
        for step in steps:
            message = f"doing {step.key} again, because {_STANDS_ON[step.kind]}"
            self.watch.event("restoring", message, step=step.key)
        results = self._with_retries(steps, recorded=False)
        steps = self._going_on(steps)
        for step in steps:
            result = results[step.key]
            self.watch.event("restored", f"{step.key}: {result.reason}", step=step.key, data=dict(result.data))
        return not [step for step in steps if not self._now_in_effect(step, results[step.key])]

    def _do(self, steps: Sequence[Step]) -> None:
        results = self._with_retries(steps, recorded=True)
        for step in self._going_on(steps):
            if not self._now_in_effect(step, results[step.key]):
                self._failed[step.key] = results[step.key].reason

    def _begin(self, steps: Sequence[Step], *, recorded: bool) -> None:
        attempts = self.watch.journal.begin(*steps) if recorded else [0] * len(steps)
        if recorded:
            self._open.update((step.key, (step, attempt)) for step, attempt in zip(steps, attempts, strict=True))
        self._touched = True
        behind = (each for each in self.plan.steps[steps[0].index :] if each.stage != steps[0].stage)
        later = (each for each in behind if each.key not in self._done)
        begun = list(zip(steps, attempts, strict=True))
        self.watch.stage_began(begun, lasting_s(later), len(self._done), len(self.plan.steps))

    def _end(self, ended: Ends) -> None:
        if not ended:
            return
        self.watch.journal.end(*((*self._open[step.key], result) for step, result in ended))
        for step, result in ended:
            del self._open[step.key]
            if result.outcome is Outcome.DONE:
                self._done.add(step.key)
            self.watch.show("step_ended", step, result)

    def _with_retries(self, steps: Sequence[Step], *, recorded: bool) -> Mapping[str, StepResult]:
        """Perform steps, some tries each, and return the results to keep by key; what is restored is not `recorded`."""
        kept: dict[str, StepResult] = {}

        def end(ended: Ends) -> None:
            if recorded:
                self._end(ended)
            kept.update((step.key, result) for step, result in ended)

        tries = _Tries(steps, self.watch.polling.device_attempts)
        while steps := self._going_on(steps):
            blocked = self._hold(steps)
            steps = self._going_on(steps)
            if steps:
                self._begin(steps, recorded=recorded)
            if blocked:
                lost = StepResult(Outcome.FAILED, f"{blocked} could not be restored after the pause")
                end([(step, lost) for step in steps])
            if blocked or not steps:
                break
            try:
                self.watch.interruptible = steps[0].kind in _INTERRUPTED_BY_A_PAUSE
                results = self._actions.perform(steps)
            except PauseAsked as pause:
                paused = StepResult(Outcome.ABORTED, f"{pause}; done again afterwards")
                end([(step, paused) for step in steps])
                continue
            except DeviceError as error:
                results = {step.key: error for step in steps}
            finally:
                self.watch.interruptible = False
            ended, given_up, again = tries.judge(steps, results, self.watch.aside)
            end(ended)
            for step in steps:
                if step.key in given_up:
                    self._give_up(step, given_up[step.key])
                elif step.key in again:
                    self.watch.event("retry", again[step.key], step=step.key)
            steps = [step for step in steps if step.key in again]
            self._before_trying_again(steps, results)
        return kept

    def _give_up(self, step: Step, error: DeviceError) -> None:
        tripped = InterlockTripped("device", f"{step.key}: {error}", of_unit=step.unit is not None)
        tripped.__cause__ = error
        if step.unit is None:
            raise tripped
        self.watch.set_aside(step.unit, tripped)

    def _before_trying_again(self, steps: Sequence[Step], results: Mapping[str, StepResult | DeviceError]) -> None:
        """Give devices time; index units again that do not stand, or lie, as collects that were not good want it."""
        bad = {step.key: each for step in steps if isinstance(each := results[step.key], StepResult)}
        if len(bad) < len(steps):
            for _ in self.watch.wait(self.watch.now_s + self.watch.polling.retry_wait_s):
                pass  # it is looked at meanwhile
        lies = {step.unit: str(bad[step.key].data.get("wrong_pose", "")) for step in steps if step.key in bad}
        turned = {
            unit
            for unit, wrong in lies.items()
            if wrong or self.watch.devices.units[unit or ""].positioner.position() != steps[0].position
        }
        index = [each for each in self._before(steps[0], StepKind.INDEX) if each.unit in turned] if turned else []
        if index:
            self.watch.remark = "; ".join(dict.fromkeys(filter(None, lies.values())))
            self._restore(index)
            self.watch.remark = ""

    def _hold(self, steps: Sequence[Step]) -> str:
        """Return once nothing is suspected and nobody pauses; return the key of what a pause undid for good, if any."""
        self.watch.hold_until_clear()
        while self.watch.desk.pause is not None:
            soaks = steps if steps[0].kind is StepKind.RESTABILISE else self._before(steps[0], StepKind.RESTABILISE)
            settings = Restabilisation.from_parameters(soaks[0].parameters) if soaks else Restabilisation()
            soaked = bool(soaks) and self._in_effect.get((StepKind.RESTABILISE, None)) == soaks[0].key
            lost = rest(self.watch, settings, self.watch.interlocks.pause_s, soaked=soaked)
            undone = [StepKind.IDENTIFY, StepKind.INDEX, *([StepKind.RESTABILISE] if lost else [])]
            self._in_effect = {of: stage for of, stage in self._in_effect.items() if of[0] not in undone}
            self.watch.hold_until_clear()
            blocked = self._prepare(steps)
            if blocked:
                return blocked
        return ""

    def _now_in_effect(self, step: Step, result: StepResult) -> bool:
        """Note what a step put into effect (no plan comes back to a key); end the night where soaks never settle."""
        if step.kind is StepKind.RESTABILISE:
            self._unsettled = 0 if result.outcome is Outcome.DONE else self._unsettled + 1
            if self._unsettled >= self.watch.interlocks.unsettled_soaks:
                raise InterlockTripped("soak-never-settles", f"{self._unsettled} soaks in a row: {result.reason}")
        if result.outcome is not Outcome.DONE:
            self._in_effect.pop((step.kind, step.unit), None)
            return False
        self._in_effect[step.kind, step.unit] = step.stage
        return True


class _Tries:
    """What is left of the attempts of some steps: at a device as many as are said, of a collect as its settings say."""

    def __init__(self, steps: Sequence[Step], device_attempts: int) -> None:
        self._collects = {step.key: CollectSettings.from_parameters(step.parameters).attempts for step in steps}
        self._devices = {step.key: device_attempts for step in steps}

    def judge(
        self, steps: Sequence[Step], results: Mapping[str, StepResult | DeviceError], aside: Mapping[str, str]
    ) -> tuple[Ends, Mapping[str, DeviceError], Mapping[str, str]]:
        """Return how steps ended, errors of those given up, why others are tried again; `aside` says why by unit."""
        ended, given_up, again = list[tuple[Step, StepResult]](), dict[str, DeviceError](), dict[str, str]()
        for step in steps:
            if step.unit in aside:
                ended.append((step, StepResult(Outcome.ERROR, aside[step.unit or ""])))
            elif isinstance(result := results[step.key], DeviceError):
                self._devices[step.key] -= 1
                ended.append((step, StepResult(Outcome.ERROR, str(result))))
                if (tries := self._devices[step.key]) <= 0 or isinstance(result, _NEVER_RETRIED):
                    given_up[step.key] = result
                else:
                    again[step.key] = f"{step.key}: {result}; {tries} more tries"
            else:
                self._collects[step.key] -= 1
                # A collect's own samples are asked: a soak that was not good is no reason to take it again.
                good = result.outcome is Outcome.DONE and result.data.get("samples_verdict") not in NOT_GOOD
                if step.kind is StepKind.COLLECT and self._collects[step.key] > 0 and not good:
                    result = replace(result, outcome=Outcome.FAILED)
                    again[step.key] = f"{step.key} is taken again: {result.reason}"
                ended.append((step, result))
        return ended, given_up, again
