"""The sequence for a stated goal: which collects, how long, how often repeated, so that a night is well spent.

    goal = Goal(targets={"MU": 0.5}, drift_immune=True, residuals=2, time_s=24 * 3600.0)
    proposal = propose(load_sweep("rd-gc-86-1"), load_bench("simulated"), goal)
    proposal.best.positions, proposal.best.duration_s, proposal.best.repeats
    proposal.missing                       # () or what the goal asks for and no sequence gives in the time

Every candidate is weighed with the whole error budget of the bench, not with noise alone: longer collects average
noise and let a drift grow, repeats average what varies from run to run and nothing else. Of those that meet the goal
the shortest night wins, then the most certain one; where none does, of those that come as near as any. The soak is the
base sweep's; it takes most of the time.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np

from hil.campaign import FloatArray
from hil.config.bench import Bench, load_bench
from hil.config.sweep import LONGEST_DAYS, MOST_OF_ONE, Sweep, check_sweep_against_bench, load_sweep
from hil.design.budget.budget import analytic_share, response
from hil.design.budget.sources import Scene, sources
from hil.design.sequence.sequences import Worth, palindromes, scene_of, sequence_worth, sequences
from hil.design.sequence.unit_scatter import UnitScatter
from hil.errors import InputError, worded
from hil.files.strict import config_folders
from hil.files.units import RATE, to_number
from hil.model import load_model
from hil.model.effects.columns import HOUR_S
from hil.model.forms import LinearForm, default_form
from procedures.plan import make_plan
from procedures.words import counted

DURATIONS_S = (60.0, 120.0, 180.0, 300.0, 600.0)
LONGEST_S = LONGEST_DAYS * 86400.0
MOST_REPEATS = 8
"""So many are tried where none is enough, for what the bench is uncertain by is not averaged."""
_AS_NEAR = 1.05
"""An uncertainty that misses the goal and is no more than so many times the nearest: no longer night is worth less."""
_UNIFORM = 1.0 / np.sqrt(3.0)
_FEWEST = 3
_LEAST_TARGET = 1e-6  # deg/hr: nothing that turns with the earth is known so well


@dataclass(frozen=True)
class Goal:
    """What is asked for. `targets` are the largest standard deviations of the mean at one temperature, by parameter.

    "B", "GS" and "MU" stand for all that begin so. `drift_immune` asks it of the parameters in `targets` (of all
    where there are none). `residuals` are degrees of freedom left in one self-calibration; `tells_even_terms` asks that
    MU be told from terms in the square of the acceleration. `time_s` is the whole night's; `sensors` () means all.
    `scatter` is how every sensor's parameters change from run to run, `shown` what repeats showed of each.
    """

    targets: Mapping[str, float]
    drift_immune: bool = False
    residuals: int = 0
    tells_even_terms: bool = False
    time_s: float | None = None
    sensors: tuple[int, ...] = ()
    repeats: int | None = None
    scatter: Mapping[str, float] = field(default_factory=dict)
    shown: Mapping[int, UnitScatter] = field(default_factory=dict)


@dataclass(frozen=True)
class Candidate:
    """One sequence at one duration of its collects, repeated so often at each temperature.

    `worth` and `total` (the standard deviation of the mean, deg/hr or deg/hr/g) are by sensor, then parameter.
    """

    positions: tuple[str, ...]
    duration_s: float
    repeats: int
    time_s: float
    worth: Mapping[int, Worth]
    total: Mapping[int, Mapping[str, float]]

    @property
    def sequence(self) -> str:
        """The positions as people write them: 1-3-2; x-up, x-down where labels are words."""
        return ("-" if max(map(len, self.positions)) <= 2 else ", ").join(self.positions)


@dataclass(frozen=True)
class Proposal:
    """The best candidate, and what it lacks (nothing where the goal is met).

    `compared` are the base sweep's own sequence and its usual variants, with the base sweep's durations and repeats.
    `with_more_time` meets a goal that the time does not allow, where anything does. `at_most` is the best again where
    runs scatter by as much as what told it leaves possible.
    """

    best: Candidate
    missing: tuple[str, ...]
    compared: tuple[Candidate, ...]
    at_most: Candidate
    with_more_time: Candidate | None = None


def parse_target(text: str) -> tuple[str, float]:
    """Read a target such as "MU 0.5 deg/hr" or "GSA 0.3 deg/hr/g"; raise `InputError` where it is none."""
    name, _, quantity = text.strip().partition(" ")
    wrong = f"{text!r} is no target; write a parameter and"
    with worded(InputError, f"{wrong} its uncertainty, 'MU 0.5 deg/hr' (", end=")"):
        value = to_number(re.sub(r"/\s*g\s*$", "", quantity), RATE)
    if not name or not _LEAST_TARGET <= value < np.inf:
        raise InputError(f"{wrong} an uncertainty of {_LEAST_TARGET:g} deg/hr or more, 'MU 0.5 deg/hr'")
    return name, value


def propose(sweep: Sweep, bench: Bench, goal: Goal) -> Proposal:
    """Return the best sequence for a goal, on the temperatures and soaks of `sweep`.

    Raises `InputError` for a parameter or sensor that the bench does not have, a sweep that it cannot carry out, or
    where no sequence of its positions can know every parameter.
    """
    check_sweep_against_bench(sweep, bench)
    sensors = goal.sensors or tuple(bench.sensors)
    for number in sensors:
        if number not in bench.sensors:
            raise InputError(f"bench {bench.name} has no sensor {number}; it has {', '.join(map(str, bench.sensors))}")
    weigher = _Weigher(sweep, bench, goal, sensors)
    targets = spelled_out(goal.targets, dict.fromkeys(name for form in weigher.forms.values() for name in form.names))
    if goal.time_s is not None and weigher.shortest_s() > goal.time_s:
        raise _too_little_time(sweep, goal, weigher.shortest_s())
    arranged = dict.fromkeys([*sequences(bench.positions), sweep.positions, *palindromes(sweep.positions)])
    kinds = [kind for positions in arranged if (kind := weigher.kind(positions)) is not None]
    if not kinds:
        raise InputError(
            f"bench {bench.name}: neither the sweep's positions nor three or four of the bench's let every parameter "
            "be known; give it positions that point gravity along more axes"
        )
    durations_s = sorted({*DURATIONS_S, sweep.collect.duration_s})
    every = [
        weigher.weigh(kind, seconds, count)
        for kind in kinds
        for seconds in durations_s
        for count in weigher.counts(kind, seconds, targets)
    ]
    weighed = [(_lacks(candidate, goal, targets), candidate) for candidate in every]
    found = [each for each in weighed if each[1].time_s <= weigher.longest_s]
    if not found:
        raise _too_little_time(sweep, goal, min(each.time_s for each in every))
    nearest = min(found, key=lambda each: _rank(each[0], each[1], targets))[1]
    missing, best = min(found, key=lambda each: _rank(_lacks(each[1], goal, targets, nearest), each[1], targets))
    meeting = [each for each in weighed if missing and not each[0] and each[1].time_s <= LONGEST_S]
    longer = min(meeting, key=lambda each: _rank(each[0], each[1], targets), default=(None, None))[1]
    variants = [kind for positions in _variants(sweep, bench) if (kind := weigher.kind(positions)) is not None]
    duration_s, repeats = sweep.collect.duration_s, sweep.self_calibrations_per_temperature
    compared = tuple(weigher.weigh(kind, duration_s, repeats) for kind in variants)
    most = {number: replace(of, sizes=of.at_most) for number, of in goal.shown.items()}
    worst = _Weigher(sweep, bench, replace(goal, shown=most), sensors)
    at_most = next(worst.weigh(k, best.duration_s, best.repeats) for k in [worst.kind(best.positions)] if k is not None)
    return Proposal(best, tuple(text for text, _ in missing), compared, at_most, longer)


def _too_little_time(sweep: Sweep, goal: Goal, shortest_s: float) -> InputError:
    return InputError(
        f"{sweep.source}: the shortest night with its {counted(len(sweep.temperatures), 'temperature')} takes "
        f"{shortest_s / 3600.0:.1f} h, not {(goal.time_s or 0.0) / 3600.0:.1f} h; allow more time, or fewer "
        "temperatures or repeats"
    )


@dataclass(frozen=True)
class _Kind:
    """A sequence with its worth for each sensor, and the variances of its parameters, (p,) by sensor and part.

    The parts follow the duration of the collects: `noise` falls with it, `ramp` grows with the square of the time
    between them, `run` does not change, and `bench`, with what of the unit lasts, is not averaged by repeats either.
    """

    positions: tuple[str, ...]
    worth: Mapping[int, Worth]
    variances: Mapping[int, Mapping[str, FloatArray]]


class _Weigher:
    """Weighs sequences on one bench, at the middle of the sweep's temperatures."""

    def __init__(self, sweep: Sweep, bench: Bench, goal: Goal, sensors: Sequence[int]) -> None:
        self._sweep, self._bench, self._goal, self._sensors = sweep, bench, goal, sensors
        self._model = None if bench.simulation_model is None else load_model(bench.simulation_model)
        self._temperature = float(np.median(sweep.temperatures))
        slope = sweep.restabilisation.unit_slope_degC_per_min * _UNIFORM
        self._sources = sources(bench.uncertainties, bench.name, slope, "", "")
        # What each sensor is solved for, where all of the bench's positions are there.
        all_of_them = {number: scene_of(bench, number, bench.positions, sweep.collect) for number in sensors}
        self.forms = {number: default_form(scene.conditions) for number, scene in all_of_them.items()}
        self.least = goal.repeats or sweep.self_calibrations_per_temperature
        self.longest_s = LONGEST_S if goal.time_s is None else goal.time_s
        self._times_s: dict[tuple[int, float], tuple[float, float]] = {}

    def shortest_s(self) -> float:
        """Return how long the shortest night takes: three short collects, repeated as often as must be."""
        return self._time_s(_FEWEST, min(*DURATIONS_S, self._sweep.collect.duration_s), self.least)

    def kind(self, positions: tuple[str, ...]) -> _Kind | None:
        """Return a sequence's worth, None where some sensor's parameters cannot be known from it."""
        worth, variances = {}, {}
        for number in self._sensors:
            scene = scene_of(self._bench, number, positions, self._sweep.collect, self._temperature, self._model)
            form, noise = self.forms[number], self._goal.shown.get(number, UnitScatter()).noise
            if [*noise] == [*scene.conditions.sensor.channels]:
                as_shown = np.array([*noise.values()]) / np.sqrt(self._sweep.collect.duration_s / HOUR_S)
                scene = replace(scene, noise_times=as_shown / scene.sigma[0])
            one = sequence_worth(scene, form)
            if one is None:
                return None
            worth[number], variances[number] = one, self._variances(scene, form)
        return _Kind(positions, worth, variances)

    def _variances(self, scene: Scene, form: LinearForm) -> dict[str, FloatArray]:
        to_parameters = response(scene, form)
        parts = {part: np.zeros(len(form.names)) for part in ("noise", "ramp", "run", "bench")}
        for each in self._sources:
            part = each.id if each.id == "noise" else "ramp" if each.is_ramp else each.varies
            parts[part] += analytic_share(each, scene, to_parameters) ** 2
        number, stated = scene.conditions.sensor.number, spelled_out(self._goal.scatter, form.names)
        shown = self._goal.shown.get(number, UnitScatter())
        own = spelled_out({**shown.sizes, **stated}, form.names)
        lasting = {*shown.lasting} - stated.keys()
        for part, names in (("bench", lasting), ("run", own.keys() - lasting)):
            parts[part] += np.array([own.get(name, 0.0) ** 2 * (name in names) for name in form.names])
        return parts

    def counts(self, kind: _Kind, duration_s: float, targets: Mapping[str, float]) -> list[int]:
        """Return how often it may be repeated: as often as must be, as the targets take, and as the time allows.

        The more often, the longer and the more certain: no other count can be the best.
        """
        needed = self.least
        for number, (varying, bench) in self._variances_at(kind, duration_s).items():
            for name, *own in zip(kind.worth[number].white, varying, bench, strict=True):
                room = targets.get(name, np.inf) ** 2 - own[1]
                needed = max(needed, int(np.ceil(own[0] / room)) if room > 0.0 else MOST_REPEATS)
        first_s, more_s = (self._time_s(len(kind.positions), duration_s, self.least + more) for more in (0, 1))
        fits = self.least + int((self.longest_s - first_s) // (more_s - first_s))
        return sorted({self.least, min(needed, MOST_OF_ONE), max(self.least, min(needed, fits, MOST_OF_ONE))})

    def _variances_at(self, kind: _Kind, duration_s: float) -> dict[int, tuple[FloatArray, FloatArray]]:
        """Return the variances (p,) of each sensor's parameters that repeats average, and those that they do not."""
        collect = self._sweep.collect
        longer = duration_s / collect.duration_s
        moving_s = collect.index_s + collect.settle_s
        apart = (moving_s + duration_s) / (moving_s + collect.duration_s)
        return {
            number: (parts["noise"] / longer + parts["ramp"] * apart**2 + parts["run"], parts["bench"])
            for number, parts in kind.variances.items()
        }

    def weigh(self, kind: _Kind, duration_s: float, repeats: int) -> Candidate:
        """Return a candidate with the standard deviations of its means."""
        total = {
            number: dict(zip(kind.worth[number].white, np.sqrt(varying / repeats + bench).tolist(), strict=True))
            for number, (varying, bench) in self._variances_at(kind, duration_s).items()
        }
        time_s = self._time_s(len(kind.positions), duration_s, repeats)
        return Candidate(kind.positions, duration_s, repeats, time_s, kind.worth, total)

    def _time_s(self, collects: int, duration_s: float, repeats: int) -> float:
        """Return how long the plan takes: of the collects their number counts, and each repeat takes as long."""
        key = collects, duration_s
        if key not in self._times_s:
            once = replace(
                self._sweep.procedure(),
                positions=("",) * collects,
                collect=replace(self._sweep.collect, duration_s=duration_s),
                self_calibrations=1,
            )
            first_s, both_s = (make_plan(each).total_s for each in (once, replace(once, self_calibrations=2)))
            self._times_s[key] = first_s, both_s - first_s
        first_s, each_s = self._times_s[key]
        return first_s + (repeats - 1) * each_s


def _variants(sweep: Sweep, bench: Bench) -> list[tuple[str, ...]]:
    own = sweep.positions
    found = [own]
    if len(own) == len(set(own)) == _FEWEST:
        swapped = (own[0], own[2], own[1])
        found += [swapped, *palindromes(swapped)]
        if fourth := next((label for label in bench.positions if label not in own), None):
            four = (*own, fourth)
            found += [four, *palindromes(four)]
    return found


def spelled_out(sizes: Mapping[str, float], known: Iterable[str]) -> dict[str, float]:
    """Spell out B, GS, MU (or any beginning of names); raise `InputError` for a name that none of `known` has."""
    names = list(known)
    found: dict[str, float] = {}
    for name, value in sizes.items():
        members = [name] if name in names else [each for each in names if each.startswith(name)]
        if not members:
            there = f"there is no parameter {name}; there are {', '.join(names)}, and B, GS, MU for several"
            raise InputError(f"{there}{_shipped_with(name)}")
        found |= dict.fromkeys(members, value)
    return found


def _shipped_with(name: str) -> str:
    """Say of which sweep and bench that ship with hil a parameter is, or several that begin so; empty of none."""
    kinds = [
        sorted(file for of in config_folders(kind) for file in of.glob("*.yaml")) for kind in ("sweeps", "benches")
    ]
    for of_sweep, of_bench in product(*kinds):
        sweep, bench = load_sweep(of_sweep), load_bench(of_bench)
        with suppress(InputError):  # whose positions are not the sweep's
            check_sweep_against_bench(sweep, bench)
            scenes = [scene_of(bench, number, sweep.positions, sweep.collect) for number in bench.sensors]
            if any(own.startswith(name) for of in scenes for own in default_form(of.conditions).names):
                return f"; {name} is told by hil design {of_sweep.stem} --bench {of_bench.stem}"
    return ""


def _lacks(
    candidate: Candidate, goal: Goal, targets: Mapping[str, float], nearest: Candidate | None = None
) -> list[tuple[str, float]]:
    """Return what a candidate lacks in words, each with how grave it is (1: twice the asked uncertainty).

    Of what misses a target where it comes `nearest`, if that is given, it lacks none that is hardly more uncertain.
    """
    found: list[tuple[str, float]] = []
    for number, total in candidate.total.items():
        worth = candidate.worth[number]
        for name, asked in targets.items():
            reached = 0.0 if nearest is None else nearest.total[number].get(name, 0.0)
            if name in total and total[name] > (asked if reached <= asked else _AS_NEAR * reached):
                text = f"sensor {number}: {name} ± {total[name]:.3g} instead of {asked:.3g}"
                found.append((text, total[name] / asked - 1.0))
        if goal.drift_immune and not worth.immune([name for name in targets if name in worth.drift] or None):
            found.append((f"sensor {number}: a steady drift is not kept out", 10.0))
        if worth.residuals < goal.residuals:
            short = 1.0 - worth.residuals / goal.residuals
            found.append((f"sensor {number}: {worth.residuals} residuals instead of {goal.residuals}", 10.0 * short))
        if goal.tells_even_terms and not worth.tells_even_terms:
            found.append((f"sensor {number}: MU is not told from terms in the square of the acceleration", 10.0))
    return found


def _rank(
    missing: Sequence[tuple[str, float]], candidate: Candidate, targets: Mapping[str, float]
) -> tuple[float, float, float, int, tuple[str, ...]]:
    """Least missing, then shortest, then most certain; equal ones in the order of their positions."""
    names = targets or {name: 1.0 for total in candidate.total.values() for name in total}
    size = [(total[name] / names[name]) ** 2 for total in candidate.total.values() for name in names if name in total]
    time_min = round(candidate.time_s / 60.0, 1)
    return (
        sum(gravity for _, gravity in missing),
        time_min,
        round(float(np.sum(size)), 6),
        len(candidate.positions),
        candidate.positions,
    )
