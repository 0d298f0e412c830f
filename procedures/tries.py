"""How often the steps of a stage are tried: device errors and collects that are not good are tried again, bounded.

tries = Tries(steps, device_attempts=3)
ended, given_up, again = tries.judge(steps, results, aside)
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from drivers.errors import CommandRefused, DeviceError, SetpointOutOfLimits, WrongDevice
from procedures.journal_protocol import Outcome, StepResult
from procedures.plan import Step, StepKind
from procedures.settings import CollectSettings
from procedures.verdict import NOT_GOOD

_NEVER_RETRIED = (WrongDevice, SetpointOutOfLimits, CommandRefused)

Ends = Sequence[tuple[Step, StepResult]]
"""How steps of a stage ended: they are committed at once."""


class Tries:
    """What is left of the attempts that each of some steps has, at its device and at a good collect."""

    def __init__(self, steps: Sequence[Step], device_attempts: int) -> None:
        """Begin with all attempts: as many at a device as the polling says, as many of a collect as its settings."""
        self._collects = {step.key: int(CollectSettings.from_parameters(step.parameters).attempts) for step in steps}
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
