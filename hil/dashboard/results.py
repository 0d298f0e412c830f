"""What a night has given so far: the collects of every self-calibration that has begun, and the parameters solved.

The parameters are those of `hil solve`, by the same call.
"""

from pathlib import Path
from typing import Any

from hil.analysis.night_verdict import night_solutions
from hil.errors import Damaged
from hil.records import JournalReader
from hil.solve import RunSolution
from hil.solve.document import solution_document
from procedures.journal_protocol import StepResult
from procedures.plan import Step, StepKind

_SHOWN = ("sensor", "model", "verdict", "reason", "assumed", "parameters")


class ResultsSoFar:
    """The results of one night, read again when it has got on; solved again when a self-calibration was finished."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.damage = ""  # which records are not what was written, so that no parameters are shown
        self._solved: tuple[int, ...] = ()
        self.solutions: list[RunSolution] = []
        self._solutions: dict[int, list[dict[str, Any]]] = {}

    def read(self, journal: JournalReader) -> list[dict[str, Any]]:
        """Return a row for every self-calibration that has begun; solutions only where all of its steps are done."""
        completed = journal.completed()
        begun = {
            number: steps
            for number, steps in journal.plan.self_calibrations.items()
            if any(step.key in completed for step in steps)
        }
        done = tuple(number for number, steps in begun.items() if all(step.key in completed for step in steps))
        if done != self._solved:
            self._solutions, self._solved = self._solve(), done
        return [
            {
                "number": number,
                "temperature_degC": steps[0].temperature_degC,
                "done": number in done,
                "collects": [
                    _collect(step, completed.get(step.key)) for step in steps if step.kind is StepKind.COLLECT
                ],
                "solutions": self._solutions.get(number, []) if number in done else [],
            }
            for number, steps in begun.items()
        ]

    def _solve(self) -> dict[int, list[dict[str, Any]]]:
        self.damage, self.solutions = "", []
        try:
            campaign, self.solutions = night_solutions(self._folder)
        except Damaged as damage:
            self.damage = f"ERROR: {damage}"
            return {}
        rows: dict[int, list[dict[str, Any]]] = {}
        for each in () if campaign is None else solution_document(campaign, self.solutions)["solutions"]:
            rows.setdefault(each["run"] or 0, []).append({key: each[key] for key in _SHOWN})
        return rows


def _collect(step: Step, result: StepResult | None) -> dict[str, Any]:
    data = result.data if result else {}
    return {"position": step.position, "verdict": data.get("verdict"), "reason": data.get("reason", "")}
