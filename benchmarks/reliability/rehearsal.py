"""Nights with random faults on a simulated bench, and what was survived.

    for night in rehearse(sweep, bench, nights=100, seed=1, folder=Path("rehearsals")):
        night.document()     # faults, how it ended and why, whether the chamber is safe, what is wrong (nothing)

Every night runs in a process of its own, through the production path, with faults of `hil.config.simulation` drawn by
its seed. Where one of them kills the controller the night is carried on, as a service would. A night is survived when
it is complete, or incomplete with a reason that one of its faults explains and a safe chamber; when its records are
sound; and when no self-calibration that is called PASS has a parameter that the simulated unit does not have.
"""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarks.reliability.random_faults import draw_faults
from hil.bench import LiveBench
from hil.config import Bench, parse_bench
from hil.config.simulation import Fault
from hil.config.sweep import Sweep, check_sweep_against_bench, planned
from hil.errors import Damaged, InputError
from hil.files.strict import parse_yaml
from hil.night import NightOutcome, resume_night, start_night
from hil.records import open_readonly
from hil.records.export import campaign_of_night
from hil.records.reader import JOURNAL_NAME
from hil.records.status import night_status
from hil.records.units import unit_folder
from hil.records.verify import verify_night
from hil.solve import solve_campaign
from procedures.journal_protocol import StepResult
from procedures.plan import Step, StepKind
from procedures.progress import Progress
from procedures.verdict import Verdict, self_calibration_verdict
from tests.hil.twin.truth import truth_of

SIGMAS = 5.0
_LEFT_ALONE_S = 3600.0  # a chamber is judged so long after the end: its own timer may have had to stop it
_CAUSES: Mapping[str, frozenset[str]] = {
    "chamber-": frozenset({"chamber"}),
    "setpoint-": frozenset({"chamber"}),
    "ramp-too-long": frozenset({"chamber"}),
    "soak-never-settles": frozenset({"chamber", "imu"}),
    "unit-": frozenset({"chamber", "imu"}),
    "stream-": frozenset({"imu"}),
    "held-too-long": frozenset({"chamber", "imu"}),
    "device": frozenset({"chamber", "imu", "operator"}),
    "the disk is full": frozenset({"disk"}),
    "wall-clock": frozenset({"clock"}),
}
"""Which devices' faults may be behind a reason that begins so."""


@dataclass(frozen=True)
class Rehearsal:
    """One night: its seed and faults, how it ended, and what is wrong with that (nothing where it was survived)."""

    seed: int
    faults: tuple[Fault, ...]
    state: str
    reason: str
    safe: bool
    carried_on: int
    verdicts: Mapping[str, int]
    wrong: tuple[str, ...]

    @property
    def survived(self) -> bool:
        """True where nothing is wrong with how it ended."""
        return not self.wrong

    def document(self) -> dict[str, Any]:
        """Return it as JSON can hold it."""
        return {
            **vars(self),
            "faults": [fault.model_dump(exclude_none=True) for fault in self.faults],
            "survived": self.survived,
        }


def rehearse(
    sweep: Sweep,
    bench: Bench,
    *,
    nights: int,
    seed: int,
    folder: Path,
    faults: tuple[int, int] = (1, 5),
    longest_s: float | None = None,
) -> Iterator[Rehearsal]:
    """Yield `nights` rehearsals below `folder`; the folder of one that was not survived is kept.

    `faults` is how many each has, at least and at most, besides those of the bench file; with `longest_s` they are
    glitches that last no longer. Raises `InputError` for a
    bench that is not simulated in process under a virtual clock.
    """
    check_sweep_against_bench(sweep, bench)
    if bench.simulation is None or bench.clock != "virtual":
        raise InputError(
            f"{bench.source}: only a bench that is simulated in process, with clock: virtual, is rehearsed"
        )
    for number in range(seed, seed + nights):
        where = folder / f"night-{number}"
        yield _rehearsed(sweep, bench, number, where, faults, longest_s)


def _rehearsed(
    sweep: Sweep, bench: Bench, seed: int, where: Path, count: tuple[int, int], longest_s: float | None
) -> Rehearsal:
    where.mkdir(parents=True)
    plan = planned(sweep, bench)
    drawn = draw_faults(random.Random(seed), plan, count, longest_s)
    faulty = with_faults(bench, (*bench.faults, *drawn))
    night, carried_on = where / "night", 0
    told = _in_child(lambda: _first(night, sweep, faulty, seed))
    while told is None and carried_on <= len(faulty.faults):
        carried_on += 1
        again = (
            (lambda: _next(night)) if (night / JOURNAL_NAME).exists() else (lambda: _first(night, sweep, faulty, seed))
        )
        told = _in_child(again)
    if told is None:
        told = {"state": "failed", "reason": "the controller died again and again", "safe": False, "wrong": ["died"]}
    wrong, verdicts = list(told["wrong"]), dict[str, int]()
    if (night / JOURNAL_NAME).exists():
        wrong += wrong_end(told, begun(night, faulty.faults))
        found, verdicts = wrong_records(night, told["state"])
        wrong += [*found, *wrongly_aside(night, begun(night, faulty.faults))]
    else:
        wrong += wrong_end(told, faulty.faults)
    if not wrong:
        shutil.rmtree(where)
    return Rehearsal(
        seed, faulty.faults, told["state"], told["reason"], told["safe"], carried_on, verdicts, tuple(wrong)
    )


def with_faults(bench: Bench, faults: Sequence[Fault]) -> Bench:
    """Return the bench as if its file had these faults."""
    document = parse_yaml(bench.text, bench.source)
    document["faults"] = [fault.model_dump(exclude_none=True) for fault in faults]
    return parse_bench(yaml.safe_dump(document, sort_keys=False, allow_unicode=True), bench.source)


# In a process of its own


def _in_child(work: Callable[[], dict[str, Any]]) -> dict[str, Any] | None:
    """Return what `work` returns in a child, None where the child was killed."""
    read, write = os.pipe()
    sys.stdout.flush()
    child = os.fork()
    if child == 0:
        status = 1
        try:
            os.close(read)
            with os.fdopen(write, "w") as pipe:
                json.dump(work(), pipe)
            status = 0
        except BaseException:
            traceback.print_exc()
        finally:
            sys.stderr.flush()
            os._exit(status)
    os.close(write)
    with os.fdopen(read) as pipe:
        text = pipe.read()
    _, status = os.waitpid(child, 0)
    ended = os.waitstatus_to_exitcode(status)
    if ended == -signal.SIGKILL:
        return None
    if ended != 0:
        return {"state": "failed", "reason": "internal error", "safe": False, "wrong": [f"internal error ({ended})"]}
    return dict(json.loads(text))


def _first(night: Path, sweep: Sweep, bench: Bench, seed: int) -> dict[str, Any]:
    witness = Witness(night.parent)
    return witness.tell(start_night(night, sweep, bench, seed=seed, onlookers=[witness], opened=witness.look_at))


def _next(night: Path) -> dict[str, Any]:
    witness = Witness(night.parent)
    return witness.tell(resume_night(night, onlookers=[witness], opened=witness.look_at))


class Witness(Progress):
    """Knows the truth: writes down what the unit really was, and looks at the chamber when all is over."""

    def __init__(self, folder: Path) -> None:
        self._file = folder / "truth.jsonl"
        self._live: LiveBench | None = None

    def look_at(self, live: LiveBench) -> None:
        """Keep the bench that is about to be used."""
        self._live = live

    def step_ended(self, step: Step, result: StepResult) -> None:
        """Write down what each sensor's parameters really were during a collect."""
        del result
        if step.kind is not StepKind.COLLECT or self._live is None or self._live.simulators is None:
            return
        with self._file.open("a") as file:
            unit = step.unit or ""
            for sensor in self._live.bench.each[unit].sensors:
                run = step.self_calibration or 0
                truth = truth_of(self._live.simulators.units[unit], run, sensor)
                line = {"unit": unit, "run": run, "sensor": sensor, "parameters": dict(truth.parameters)}
                file.write(json.dumps(line) + "\n")

    def tell(self, outcome: NightOutcome) -> dict[str, Any]:
        """Return how the night ended, and what is wrong with the chamber an hour later."""
        told = {"state": outcome.state, "reason": outcome.reason, "safe": True, "wrong": []}
        if self._live is None or self._live.simulators is None:
            return told
        clock, chamber = self._live.devices.clock, self._live.simulators.chamber
        safe = self._live.bench.chamber.safe_state

        def is_safe() -> bool:
            chamber.receive(b"", clock.now())
            if safe.temperature_degC is None:
                return chamber.mode in ("OFF", "STANDBY")
            return chamber.mode == "CONSTANT" and abs(chamber.setpoint_degC - safe.temperature_degC) < 0.2

        told["safe"] = is_safe()
        if not told["safe"]:
            clock.sleep(_LEFT_ALONE_S)
            told["safe"] = is_safe()
        if not told["safe"] and outcome.exit_status not in (5, 6):
            told["wrong"] = [
                f"the chamber is in mode {chamber.mode} at {chamber.setpoint_degC:g} °C, and nobody was told"
            ]
        return told


# What is wrong


def begun(night: Path, faults: Sequence[Fault]) -> list[Fault]:
    """Return the faults that had begun before the night ended: no other can be the reason."""
    with open_readonly(night) as journal:
        steps = {attempt.step_key for attempt in journal.attempts()}
        last_s = max((controller.seen_s for controller in journal.controllers()), default=0.0)
    return [fault for fault in faults if (fault.at in steps if fault.at_s is None else fault.at_s <= last_s)]


def wrong_end(told: Mapping[str, Any], faults: Sequence[Fault]) -> list[str]:
    """Return what is wrong with how the night ended: a chamber that is not safe, a reason that nothing explains."""
    wrong = [] if told["safe"] else ["the chamber is not in its safe state"]
    if told["state"] == "complete":
        return wrong
    causes = [devices for begins, devices in _CAUSES.items() if str(told["reason"]).startswith(begins)]
    meddled = {fault.device for fault in faults}
    if told["state"] != "incomplete" and not any(devices & meddled for devices in causes):
        wrong.append(f"the reason is explained by no fault that had begun: {told['reason']}")
    return wrong


def wrong_records(night: Path, state: str) -> tuple[list[str], dict[str, int]]:
    """Return what is wrong with the records, and how many self-calibrations have which verdict."""
    found = verify_night(night)
    wrong = [problem for problem in found["problems"] if not problem.startswith("missing: ")]
    if (state == "complete") != bool(found["complete"]):
        wrong.append(f"the night was called {state}, and verify says {'complete' if found['complete'] else 'missing'}")
    with open_readonly(night) as journal:
        units = journal.plan.units
    every: list[Verdict] = []
    for unit in units:
        with open_readonly(unit_folder(night, unit)) as journal:
            completed, runs = journal.completed(), journal.plan.self_calibrations
        verdicts = {run: self_calibration_verdict(steps, completed).verdict for run, steps in runs.items()}
        wrong += _wrong_numbers(night, unit, [run for run, verdict in verdicts.items() if verdict is Verdict.PASS])
        every += verdicts.values()
    return wrong, {verdict.value: every.count(verdict) for verdict in Verdict}


def wrongly_aside(night: Path, faults: Sequence[Fault]) -> Iterator[str]:
    """Yield a sentence for every unit that was set aside although nothing had happened to it or to its chamber."""
    if any(fault.device == "chamber" for fault in faults):
        return
    harmed = {fault.unit for fault in faults if fault.device == "imu"}
    for each in night_status(night)["units"]:
        if each["set_aside"] and each["unit"] not in harmed:
            yield f"unit {each['unit']} was set aside, and nothing had happened to it: {each['reason']}"


def _wrong_numbers(night: Path, unit: str, passed: Sequence[int]) -> Iterator[str]:
    """Yield a sentence for every parameter called PASS that is not what the unit really was."""
    if not passed:
        return
    truths: dict[tuple[int, int], list[Mapping[str, float]]] = {}
    for line in (night.parent / "truth.jsonl").read_text().splitlines():
        truth = json.loads(line)
        if truth["unit"] != unit:
            continue
        truths.setdefault((truth["run"], truth["sensor"]), []).append(truth["parameters"])
    try:
        solutions = solve_campaign(campaign_of_night(unit_folder(night, unit)))
    except Damaged:  # nothing is called PASS over it; what is damaged `verify` has said
        return
    for solution in solutions:
        if solution.run not in passed or solution.run is None:
            continue
        for name, estimate in solution.parameters.items():
            seen = [truth[name] for truth in truths[solution.run, solution.sensor]]
            if estimate.value is None or estimate.se is None:
                continue
            # While a self-calibration goes on the unit itself changes a little: no estimate is better than that.
            off = max(min(seen) - estimate.value, estimate.value - max(seen), 0.0)
            if off > SIGMAS * float(np.hypot(estimate.se, max(seen) - min(seen))):
                yield (
                    f"{unit} self-calibration {solution.run} is called PASS, but {name} of sensor {solution.sensor} is "
                    f"{estimate.value:.3f} ± {estimate.se:.3f}, in truth {seen[-1]:.3f}"
                )
