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
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Self

import numpy as np
from scipy.special import chdtrc, fdtrc

from hil.campaign import BoolArray, Conditions, FloatArray, IntArray
from hil.campaign.data import known_mean
from hil.solve.identifiability import orthonormal
from hil.solve.temperatures import agrees, runs_by_temperature, told_by, visits
from hil.solve.uncertain import RARE, Spread
from procedures.verdict import Judgement, Verdict
from procedures.words import listed, numbered

ASKS = ": hil reconcile asks what it is"
NO_NOISE = "what a recorded column explains of it is no noise; hil reconcile looks"
"""Said where what repeats scatter by is taken for what changes from run to run by itself."""
_VERY_RARE = 0.1 * RARE  # chance of a jump that is none, where more than noise scatters: runs are judged by it
_USUAL = 0.05  # chance of noise that is no larger
_BETTER = 6.0  # twice the log of how much likelier one of two makes what is seen, 20 times: it alone is told
_DRIFT = 3  # order in time of what is no jump
_SAME = 0.999  # of its square: a column that has so much of time is no other
_UNSEEN = 1e-6  # of a column: what differs by less at any temperature, or by rounding alone, explains nothing
_JUMP = 2  # what is fitted of a jump: its size and its place
TIME, WAY = "time", "the way to a temperature"
_NOTHING = 1e-12  # of the whole: what arithmetic leaves


@dataclass(frozen=True)
class Jump:
    """By how much, in `unit`, a parameter is another somewhere between a run `before` and one `after`; `sd` of that.

    `alone`: one run alone may be another than all others, as it certainly is where that run is both.
    """

    size: float
    sd: float
    unit: str
    before: int
    after: int
    alone: bool = False


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
        steps = {name: {jump.before} for name, jump in self.jumps.items() if jump.before == jump.after}
        return {n: frozenset(steps.get(n, ())) | self.another.get(n, frozenset()) for n in {*steps, *self.another}}

    @property
    def lasting(self) -> list[str]:
        """Return the parameters of which runs of one visit have the same in common: what ages, jumps or is history."""
        ages = (name for name, columns in self.follow.items() if {TIME, WAY} & {*columns})
        steps = (n for n, jump in self.jumps.items() if jump.before != jump.after and n not in self.another)
        return list(dict.fromkeys([*ages, *steps, *self.of_visits]))

    @property
    def in_words(self) -> list[str]:
        """Say which parameters follow what, and which jump where; nothing where nothing explains what they do."""
        return self._said(self.jumps)

    @property
    def not_judged(self) -> list[str]:
        """Say the same but for what verdicts say."""
        return self._said(name for name in self.jumps if name not in self.apart)

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
        by_place: dict[tuple[int, int, bool], list[str]] = {}
        for name in names:
            each = self.jumps[name]
            several = by_place.setdefault((each.before, each.after, each.alone), [])
            how = "" if several else " is another" if each.before == each.after else " jumps"
            several.append(f"{name}{how} by {each.size:+.3g} ± {each.sd:.2g} {each.unit}")
        return [f"{listed(said)} {_where(*place)}{ASKS}" for place, said in by_place.items()]


def _where(before: int, after: int, alone: bool) -> str:
    """Say between which runs something jumps, or in which it is another."""
    if before == after:
        return f"in run {before} alone, and in no mean"
    return f"between run {before} and run {after}{', or in one run alone' * alone}"


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
    drivers = [*_drivers(number, visit, conditions)]
    follow, jumps, apart = dict[str, tuple[str, ...]](), dict[str, Jump](), dict[str, tuple[int, ...]]()
    places: list[tuple[int, int]] | None = None
    while places != []:  # where one value jumps another does, by less than would be seen elsewhere
        for p, (name, unit) in enumerate(units.items()):
            here = np.flatnonzero(np.isfinite(values[:, p]))
            if name not in {*follow, *jumps} and spread.certain[p] and np.all(sd[here, p] > 0.0):
                compared = visit[here] if differ[p] else here
                at = here, p
                own = _Compared.of(values[at], sd[at], errors[at], group[here], compared, number[here])
                columns, step = own.explained([(of, x[here]) for of, x in drivers], places)
                if columns and not (WAY in columns and differ[p]):  # what visits differ by is said of those
                    follow[name] = columns
                if step is not None:
                    jumps[name] = Jump(step.size, step.sd, unit, step.before, step.after, step.alone)
                    if told_by(conditions) is not None:
                        apart[name] = tuple(number[here[step.runs]].tolist())
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

    time = of_each(conditions.start_s)
    time = (time - time.mean()) / max(float(np.ptp(time)), 1.0)
    for order in range(1, _DRIFT + 1):
        yield TIME, np.vander(time, order + 1)[:, :-1]
    degC = np.array([np.nan if at is None else at for at, _ in visits(conditions)])
    if np.isfinite(degC).all():
        for first in (-1.0, 1.0):  # from where the first was reached nobody knows
            yield WAY, np.sign(np.diff(degC, prepend=degC[0] - first))[visit][:, None]
    for name, column in conditions.columns.items():
        shown = of_each(column)
        if np.isfinite(shown).all() and np.ptp(shown) > _UNSEEN * np.abs(shown).max():
            yield name, (shown - shown.mean())[:, None] / np.ptp(shown)


@dataclass(frozen=True)
class _Step:
    """A jump by `size`, one standard deviation `sd`, between a run `before` and one `after`.

    `runs` (r,) are those that others contradict; `alone`: one run alone may be another, as it is where it is both.
    """

    size: float
    sd: float
    before: int
    after: int
    runs: BoolArray
    alone: bool


@dataclass(frozen=True)
class _Compared:
    """Values (m,) in the order of time, of runs or means of visits, each in one `group`; `whose` (r,) a run's is.

    With each its first run and its last, by their `number` (m, 2), and how much of its variance is its `noise`'s (m,).
    """

    values: FloatArray
    weight: FloatArray
    noise: FloatArray
    group: IntArray
    whose: IntArray
    share: FloatArray
    number: IntArray

    @classmethod
    def of(
        cls,
        values: FloatArray,
        sd: FloatArray,
        errors: FloatArray,
        group: IntArray,
        compared: IntArray,
        number: IntArray,
    ) -> Self:
        """Take together what is to be compared together; runs are in the order of time."""
        _, first, whose = np.unique(compared, return_index=True, return_inverse=True)
        weight = _sums(whose, sd**-2.0)
        share = sd**-2.0 / weight[whose]
        last = len(whose) - 1 - np.unique(compared[::-1], return_index=True)[1]
        ends = np.stack([number[first], number[last]], axis=1)
        noise = weight * _sums(whose, (share * np.nan_to_num(errors)) ** 2)
        return cls(_sums(whose, share * values), weight, noise, group[first], whose, share, ends)

    def beside(self, columns: FloatArray) -> FloatArray:
        """Return columns (m, q) less their mean at each temperature, weighed."""
        place = np.unique(self.group, return_inverse=True)[1]
        whole = _sums(place, self.weight)
        means = np.stack([_sums(place, self.weight * column) / whole for column in columns.T], axis=1)
        return np.asarray((columns - means[place]) * np.sqrt(self.weight)[:, None])

    def explained(
        self, drivers: Sequence[tuple[str, FloatArray]], places: Sequence[tuple[int, int]] | None
    ) -> tuple[tuple[str, ...], _Step | None]:
        """Return the columns (r, q) that explain best what values differ by at one temperature; or the jump that does.

        Neither where what explains it may be chance, or is history. If `places`, runs before and after, are given, only
        a jump there is asked about.
        """
        seen = self.beside(self.values[:, None])[:, 0]
        whole, freedom = float(seen @ seen), len(seen) - len(np.unique(self.group))
        if freedom <= _JUMP or whole <= 0.0:
            return (), None
        product, norm, first, last = self._jumps(seen)
        seen_at = norm > _UNSEEN * norm.max(initial=0.0)
        if places is not None:
            ends = np.stack([self.number[first, 1], self.number[last, 0]])
            seen_at &= np.any([(ends[0] >= one) & (ends[1] <= other) for one, other in places], axis=0)
        there = np.flatnonzero(seen_at)
        (product, norm), (first, last) = (product[there], norm[there]), (first[there], last[there])
        left, tried = whole - product**2 / norm, [*self._tried(drivers, seen)]
        of_steps = _score(left, whole, freedom, _JUMP)
        of_drivers = np.array([_score(whole - shown, whole, freedom, q) for _, shown, q in tried])
        best_step, best = of_steps.min(initial=np.inf), of_drivers.min(initial=np.inf)
        if self._uneven(seen, whole, freedom) < min(best_step, best):  # which no one run, nor column, makes
            return (), None
        among = len(there) + len(tried) * (places is None)
        if best_step + _BETTER < best:
            k, alike = int(np.argmin(of_steps)), of_steps < best_step + _BETTER
            by_noise = max(float(np.mean(self.noise)), _NOTHING)  # that makes what is left, and hardly what goes
            usual = chdtrc(freedom - 1, left[k] / by_noise) > _USUAL
            usual &= chdtrc(1, (whole - left[k]) / by_noise) < _VERY_RARE**2
            rare = RARE if usual or places is not None else _VERY_RARE
            if _chance(float(left[k]), whole, freedom, 1) * among < rare:
                sd = float(np.sqrt(left[k] / (freedom - _JUMP + 1) / norm[k]))
                start, end = int(first[alike].min()), int(last[alike].max())
                both = np.intersect1d(self.group[: last[k]], self.group[last[k] :])
                parted = np.isin(self.group, both) if first[k] < last[k] else self.group == self.group[first[k]]
                runs = self.whose == start if start == end else parted[self.whose]
                alone = bool(np.any(first[alike] == last[alike]))
                after = -1.0 if first[k] == last[k] == start < end else 1.0  # what is off there is what goes, and comes
                before, then = int(self.number[start, 1]), int(self.number[end, 0])
                return (), _Step(after * float(product[k] / norm[k]), sd, before, then, runs, alone)
        elif best < best_step and places is None:
            _, shown, fitted = tried[int(np.argmin(of_drivers))]
            names = dict.fromkeys(name for (name, *_), of in zip(tried, of_drivers, strict=True) if of < best + _BETTER)
            if _chance(whole - shown, whole, freedom, fitted) * among < RARE:
                return tuple(names), None
        return (), None

    def _uneven(self, seen: FloatArray, whole: float, freedom: int) -> float:
        """Return the score of values that scatter more at one temperature, whichever that is best."""
        squares, count = _sums(self.group, seen**2), np.bincount(self.group) - 1.0
        here, rest = squares / np.maximum(count, 1.0), np.maximum(whole - squares, _NOTHING * whole)
        others = rest / np.maximum(freedom - count, 1.0)
        more = (count > 0.0) & (here > others)
        logs = count * np.log(np.where(more, here, 1.0)) + (freedom - count) * np.log(others)
        scores = logs - freedom * np.log(whole / freedom) + _JUMP * np.log(freedom)
        return float(np.min(scores, where=more, initial=np.inf))

    def _tried(self, drivers: Sequence[tuple[str, FloatArray]], seen: FloatArray) -> Iterator[tuple[str, float, int]]:
        """Yield by name the squares of what is seen that each of some columns (r, q) explains, and by how many."""
        time = np.zeros((len(seen), 0))
        for name, columns in drivers:
            shown = self.beside(np.stack([_sums(self.whose, self.share * of) for of in columns.T], axis=1))
            basis = orthonormal(shown, _UNSEEN)
            if name == TIME and not time.size:
                time = basis
            same = name not in (TIME, WAY) and np.sum((time.T @ basis) ** 2) > _SAME
            if np.sum(shown**2) > _UNSEEN**2 * self.weight.sum() and not same:
                yield name, float(np.sum((basis.T @ seen) ** 2)), basis.shape[1]

    def _jumps(self, seen: FloatArray) -> tuple[FloatArray, FloatArray, IntArray, IntArray]:
        """Return of a step after each value, and of each value alone, its product with what is seen, and its square.

        And the last value before it and the first after it, which is one where a value is alone; (2 m - 1,) each. Means
        of several runs are none that one run alone makes.
        """
        count, root = len(seen), np.sqrt(self.weight)
        of_group = np.bincount(self.group, self.weight)[self.group]
        by_step, place = np.zeros(count), np.arange(count)
        for k in np.unique(self.group):
            here = np.flatnonzero(self.group == k)
            up_to = np.cumsum(self.weight[here])
            by_step[here] = np.diff(up_to * (1.0 - up_to / up_to[-1]), prepend=0.0)
        alone = self.weight * (1.0 - self.weight / of_group) * (np.bincount(self.whose) == 1)
        product = np.concatenate([-np.cumsum(root * seen)[:-1], root * seen])
        first, last = (np.concatenate([of, place]) for of in (place[:-1], place[1:]))
        return product, np.concatenate([np.cumsum(by_step)[:-1], alone]), first, last


def _sums(whose: IntArray, of_each: FloatArray) -> FloatArray:
    """Return the sums (m,) of what is whose, (r,) each."""
    return np.bincount(whose, of_each).astype(np.float64)


def _score(left: FloatArray | float, whole: float, freedom: int, fitted: int) -> FloatArray:
    """Return twice the log of how much less likely values are with what leaves so much of the whole (BIC)."""
    return np.asarray(freedom * np.log(np.maximum(left / whole, _NOTHING)) + fitted * np.log(freedom))


def _chance(left: float, whole: float, freedom: int, fitted: int) -> float:
    """Return the chance of so little left of what only scatters."""
    rest = freedom - fitted
    if rest < 1:
        return 1.0
    return float(fdtrc(fitted, rest, (whole - left) / fitted / max(left / rest, _NOTHING * whole)))
