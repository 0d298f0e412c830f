"""What runs of one temperature differ by, where something explains it: a recorded column, or a jump at some time.

    found = between_runs(units, runs, values, errors, conditions)
    found.follow              # {"BA": ("supply_V",)}: what that explains is no scatter from run to run
    found.jumps["MUA"]        # Jump(size=20.1, sd=1.9, unit="deg/hr/g", before=12, after=13)
    found.judged[5]           # no run is a PASS that others contradict across a jump

Of each parameter all is asked at once, and of all temperatures together: every recorded column, time, the way to a
temperature, a jump between any two runs, a run that alone is another, and one temperature at which values scatter more.
What scatters is what each leaves (an F test), and the best of them is told where so much is hardly chance of any that
was tried. Where visits to a temperature differ by more than runs of one do, the means of visits are compared: runs of
one have in common what history made of them. A jump is told where neither a column, nor a drift, nor the way to a
temperature comes near to it: of runs before and after it, at one temperature, each measures another unit. Where values
scatter more at one temperature, and nothing explains it, its runs contradict each other, too.

Where each temperature was gone to once, visits are compared with a curve over temperature instead: what jumps off it
may as well be what the unit does there, and of one run alone at its temperature nobody knows which it is.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np

from hil.campaign import Conditions, FloatArray, IntArray
from hil.campaign.data import known_mean
from hil.solve.compared import DRIFT, TIME, UNSEEN, WAY, Answer, Compared, Jump, Places, curve_over
from hil.solve.temperatures import agrees, runs_by_temperature, told_by, visits
from hil.solve.uncertain import Spread
from procedures.verdict import Judgement, Verdict
from procedures.words import listed, numbered

ASKS = ": hil reconcile asks what it is"
NO_NOISE = "what a recorded column explains of it is no noise; hil reconcile looks"
"""Said where what repeats scatter by is taken for what changes from run to run by itself."""
_DOES = ", or the unit does so "
_ONCE = f"{_DOES}between their temperatures: each was gone to once; go back to one of before to tell"
_ALONE = f"{_DOES}at its temperature, at which no other run was made: make one to tell"


@dataclass(frozen=True)
class BetweenRuns:
    """What explains what a sensor's runs of one temperature differ by, by parameter: columns to `follow`, or `jumps`.

    `apart` are the runs at temperatures that were measured before and after a jump; none where no temperature was
    recorded, which may be what jumps. `uneven` are those at a temperature at which a parameter scatters more than at
    others, and nothing tells why. `of_visits` are parameters that differ between visits to a temperature. `agrees`
    says whether values repeat where the setpoint or where the thermometer is the same, if these contradict each other.
    `another` are by parameter runs of which rates say that it was another; a jump beside one of them may be that, too.
    """

    follow: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    jumps: Mapping[str, Jump] = field(default_factory=dict)
    apart: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    uneven: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    of_visits: Sequence[str] = ()
    agrees: Sequence[str] = ()
    another: Mapping[str, frozenset[int]] = field(default_factory=dict)

    @property
    def alone(self) -> Mapping[str, frozenset[int]]:
        """Return by parameter the runs in which alone it is another: no mean has them, nor what repeats scatter by."""
        steps = {name: {j.before} for name, j in self.jumps.items() if j.before == j.after and not j.once}
        return {n: frozenset(steps.get(n, ())) | self.another.get(n, frozenset()) for n in {*steps, *self.another}}

    @property
    def lasting(self) -> list[str]:
        """Return the parameters of which runs of one visit have the same in common: what ages, jumps or is history."""
        ages = (name for name, columns in self.follow.items() if {TIME, WAY} & {*columns})
        steps = (n for n, j in self.jumps.items() if j.before != j.after and not j.once and n not in self.another)
        return list(dict.fromkeys([*ages, *steps, *self.of_visits]))

    @property
    def in_words(self) -> list[str]:
        """Say which parameters follow what, and which jump where; nothing where nothing explains what they do."""
        return self._said(self.jumps)

    @property
    def not_judged(self) -> list[str]:
        """Say the same but for what verdicts say."""
        return self._said(name for name in self.jumps if name not in self.apart)

    @property
    def off_a_curve(self) -> list[str]:
        """Say which of those jump off a curve over temperature, which no search for what moves rates tells from one."""
        return self._jumps(name for name, jump in self.jumps.items() if jump.once)

    def _said(self, jumps: Iterable[str]) -> list[str]:
        alike: dict[tuple[str, ...], list[str]] = {}
        for name, columns in self.follow.items():
            alike.setdefault(columns, []).append(name)
        said = [
            f"{listed(names)} follow{'s' * (len(names) == 1)} {' or '.join(columns)} from run to run: {NO_NOISE}"
            for columns, names in alike.items()
        ]
        return [*said, *self._jumps(jumps), *self.agrees]

    @property
    def judged(self) -> dict[int, Judgement]:
        """Return by run the judgement that it has at best: others, across a jump, contradict it."""
        found = {}
        every = *self.apart.values(), *self.uneven.values(), *self.another.values()
        for run in sorted({run for of in every for run in of}):
            said = self._jumps(name for name, of in self.apart.items() if run in of)
            alike = dict[tuple[int, ...], list[str]]()
            for name, of in self.uneven.items():
                if run in of:
                    alike.setdefault(of, []).append(name)
            said += [
                f"{listed(names)} differ{'s' * (len(names) == 1)} in {numbered('run', of)}, of one temperature, by "
                f"more than at others{ASKS}"
                for of, names in alike.items()
            ]
            own = [name for name, of in self.another.items() if run in of]
            said += [f"{listed(own)} of the run is in no mean"] if own else []
            found[run] = Judgement(Verdict.MARGINAL, "; ".join(said))
        return found

    def _jumps(self, names: Iterable[str]) -> list[str]:
        by_place: dict[tuple[int, int, bool, bool], list[str]] = {}
        for name in names:
            each = self.jumps[name]
            several = by_place.setdefault((each.before, each.after, each.alone, each.once), [])
            how = "" if several else " is another" if each.before == each.after else " jumps"
            several.append(f"{name}{how} by {each.size:+.3g} ± {each.sd:.2g} {each.unit}")
        return [f"{listed(said)} {_where(*place)}" for place, said in by_place.items()]


def _where(before: int, after: int, alone: bool, once: bool) -> str:
    """Say between which runs something jumps, or in which it is another, and who asks what it is."""
    if before == after:
        return f"in run {before} alone{_ALONE if once else f', and in no mean{ASKS}'}"
    return f"between run {before} and run {after}{', or in one run alone' * alone}{_ONCE if once else ASKS}"


def between_runs(
    units: Mapping[str, str],
    runs: Sequence[int],
    values: FloatArray,
    errors: FloatArray,
    conditions: Conditions,
    another: Mapping[str, frozenset[int]] = MappingProxyType({}),
) -> BetweenRuns:
    """Return what explains what values (r, p) of runs differ by, NaN where not told, with standard errors (r, p).

    `units` are those of the parameters, `conditions` those of all their collects; `another` are by parameter runs of
    which it is known that it was another.
    """
    begins_s = {run: float(np.min(conditions.start_s[rows])) for run, rows in conditions.of_each_run.items()}
    in_time = np.argsort([begins_s[run] for run in runs], kind="stable")
    number, values, errors = np.array(runs)[in_time], values[in_time], errors[in_time]
    group, visit = (_place(number, of) for of in (runs_by_temperature(conditions), visits(conditions)))
    again = np.array([len(np.unique(visit[group == k])) > 1 for k in group])
    spread, there, of_one = (
        Spread.of(values[some], errors[some], by[some])
        for some, by in ((again | True, group), (again, group), (again, visit))
    )
    differ, sd = there.more_than(of_one), spread.sd(errors)
    every = [*_drivers(number, visit, conditions)]
    follow, jumps, apart = dict[str, tuple[str, ...]](), dict[str, Jump](), dict[str, tuple[int, ...]]()

    def asked(p: int, compared: IntArray, places: Places, degC: FloatArray | None = None) -> Answer:
        name, here = [*units][p], np.flatnonzero(np.isfinite(values[:, p] if degC is None else values[:, p] + degC))
        if name in {*follow, *jumps} or not len(here) or not np.all(sd[here, p] > 0.0):
            return (), None, []
        at, by_noise, along, known = (here, p), errors, None, 0.0
        drivers = [(of, x[here]) for of, x in (every if degC is None else _drifts(visit))]
        if degC is not None:  # about a curve visits lie as near as runs of one temperature scatter
            along, by_noise, known = degC[here], sd, float(spread.degrees[p])
            bends = (curve_over(along, len(np.unique(compared[here])), more)[:, :more] for more in (1, 2))
            drivers += [("temperature", bend) for bend in bends]
        own = Compared.of(values[at], sd[at], by_noise[at], group[here], compared[here], number[here], along, known)
        return own.explained(units[name], drivers, places)

    places: Places = None
    while places != []:  # where one value jumps another does, by less than would be seen elsewhere
        for p, name in enumerate(units):
            if spread.certain[p]:
                columns, step, runs_apart = asked(p, visit if differ[p] else np.arange(len(number)), places)
                if columns and not (WAY in columns and differ[p]):  # what visits differ by is said of those
                    follow[name] = columns
                if step is not None:
                    jumps[name] = step
                    if told_by(conditions) is not None:
                        apart[name] = tuple(runs_apart)
        places = [(jump.before, jump.after) for jump in jumps.values()] if places is None else []
    # What is in no mean is the same, whether a run alone was another or something jumped beside it.
    ends = {n: {j.before, j.after} for n, j in jumps.items() if j.alone}
    more = {n for n, of in ends.items() if another.get(n, frozenset()) - of}
    beside = [n for n, of in ends.items() if n not in more and len(of) > 1 and of & another.get(n, frozenset())]
    if unexplained := {n: of for n, of in another.items() if n in {*beside, *more} or n not in {*follow, *jumps}}:
        out = np.array([[run in unexplained.get(name, ()) for name in units] for run in number.tolist()])
        rest = between_runs(units, number.tolist(), np.where(out, np.nan, values), errors, conditions)
        said, contradicted = {n: jumps[n] for n in beside}, {n: apart[n] for n in beside if n in apart}
        return replace(rest, jumps={**rest.jumps, **said}, apart={**rest.apart, **contradicted}, another=unexplained)
    degC = np.array([np.nan if at is None else at for at, _ in visits(conditions)])[visit]
    for p, name in enumerate(units if not again.any() else ()):
        _, step, _ = asked(p, visit, None, degC)
        if step is not None:
            jumps[name] = replace(step, once=True)
            if step.before == step.after:
                apart[name] = (step.after,)
    of_visits = [name for name, more in zip(units, differ, strict=True) if more]
    uneven = dict[str, tuple[int, ...]]()
    for p, name in enumerate(units):
        if spread.uneven[p] and spread.certain[p] and name not in {*follow, *jumps, *of_visits}:
            of_each = [(group == k) & np.isfinite(values[:, p]) for k in range(group.max() + 1)]
            most = max(filter(np.any, of_each), key=lambda here: float(np.var(values[here, p])))
            uneven[name] = tuple(sorted(number[most].tolist()))
    return BetweenRuns(follow, jumps, apart, uneven, of_visits, agrees(number, values, errors, conditions))


def _place(number: IntArray, groups: Sequence[tuple[float | None, tuple[int, ...]]]) -> IntArray:
    """Return in which group each run is, (r,)."""
    at = {run: k for k, (_, runs) in enumerate(groups) for run in runs}
    return np.array([at[run] for run in number.tolist()])


def _drivers(number: IntArray, visit: IntArray, conditions: Conditions) -> Iterator[tuple[str, FloatArray]]:
    """Yield what runs (r,) may follow, (r, q) each: time, the way to a temperature, and every column that is known."""
    rows = [conditions.of_each_run[run] for run in number.tolist()]

    def of_each(column: FloatArray) -> FloatArray:
        return np.array([known_mean(column[of]) for of in rows])

    yield from _drifts(of_each(conditions.start_s))
    degC = np.array([np.nan if at is None else at for at, _ in visits(conditions)])
    if np.isfinite(degC).all():
        for first in (-1.0, 1.0):  # from where the first was reached nobody knows
            yield WAY, np.sign(np.diff(degC, prepend=degC[0] - first))[visit][:, None]
    for name, column in conditions.columns.items():
        shown = of_each(column)
        if np.isfinite(shown).all() and np.ptp(shown) > UNSEEN * np.abs(shown).max():
            yield name, (shown - shown.mean())[:, None] / np.ptp(shown)


def _drifts(time: FloatArray | IntArray) -> Iterator[tuple[str, FloatArray]]:
    """Yield what a drift of every order is in a time (r,), whatever its unit, (r, order) each."""
    time = np.asarray((time - time.mean()) / max(float(np.ptp(time)), 1.0), dtype=np.float64)
    for order in range(1, DRIFT + 1):
        yield TIME, np.vander(time, order + 1)[:, :-1]
