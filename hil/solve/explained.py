"""What explains rates that contradict each other: one posterior over all that may be wrong with a run.

    for each in explanations(collects):
        each.likeliest      # Cause(what="exchanged", run=5, rows=(12, 13)), or None: these rates cannot tell
        each.rivals         # what else it may be, each with its probability

Against nothing being wrong stands, with odds before the data as the search has them: a rate or a collect that may be
anywhere, two collects or two channels under each other's labels, a sign that is turned, another bias of a run, a run of
which nothing holds. What is certain is done, and what is left is asked again
(`hil.solve.causes` has what may be wrong, `hil.solve.whitened` the rates). Labels are a collect's, which the sensors of
a unit have in common: what one tells of them is asked of all.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Self

import numpy as np

from hil.campaign import Collects, FloatArray
from hil.model.effects.data import put_right
from hil.solve.asked import DOUBTED, Asked, OtherSensor
from hil.solve.causes import AS_IT_LAY, MOSTLY, OWN, Cause
from hil.solve.whitened import Whitened, whitened

SURE, CERTAIN = 0.99, 0.95
"""Probability from which what is the likeliest is done: at once, and where nothing else need be."""
HARDLY = 0.05
"""And of nothing being wrong, below which something is."""
OF_THE_RUN = (*OWN, "run")
"""Causes that are a whole run's: none of its rates is mended or left out."""
LISTED = 0.05
"""Probability of what is said beside others."""
_MOST = 0.2  # of the collects: where more are wrong, it is no rows
_UNSEEN = 50.0  # standard errors: what is off by less may not be seen without a word
_NO_ERROR = 20.0  # times its standard errors: whatever it is, what is stated is none
_ANYWHERE = 1e5  # standard errors: no run is off by so much
_MANY = 20  # runs: among more it is not said what would not be seen


@dataclass(frozen=True)
class Explained:
    """What rates that contradict each other come from: the `likeliest`, None where several are; `rivals` are all.

    As they are filed, rates are `times` as far from each other as their standard errors say, and it is as probable as
    `nothing` that nothing is wrong. `ways` are what explains them, one cause or two alike, the likeliest first.
    """

    likeliest: Cause | None
    rivals: tuple[tuple[Cause, float], ...]
    times: float
    nothing: float
    ways: tuple[tuple[Cause, ...], ...] = ()

    @property
    def likely(self) -> float:
        """How probable the likeliest is; what is only left out, among all that may be wrong, as the search has it."""
        p = self.rivals[0][1] if self.rivals else 0.0
        return p / (1.0 - self.nothing) if self.leaves_out else p

    @property
    def leaves_out(self) -> bool:
        """Whether the likeliest is a row that need only be left out."""
        return self.likeliest is not None and self.likeliest.what in ("rate", "collect")

    @property
    def runs(self) -> set[int]:
        """The runs in which something may be wrong."""
        return {cause.run for way in (*self.ways, [cause for cause, _ in self.rivals]) for cause in way}

    @property
    def used(self) -> set[int]:
        """The runs that stay as they are, and of which more need not be said."""
        known = self.likeliest
        return self.runs if known is None else {known.run} if known.what in OF_THE_RUN else set()


def explanations(
    collects: Collects,
    distrusted: Collection[int] = (),
    beside: OtherSensor | None = None,
) -> Iterator[Explained]:
    """Yield what is wrong with the collects, what is certain first, until nothing need be; then what nobody can tell.

    `beside` is what another sensor shows in the same collects. Runs that are `distrusted`, and those of which nobody
    can tell what, say nothing of the others; what is certain of a run that is distrusted is said last.
    """
    runs, left = collects.conditions.run, _Left(collects, beside, frozenset(distrusted))
    unsure: dict[int, Explained] = {}
    enough, done = SURE, 0
    while True:
        found = left.wrong(unsure)
        if found is None:
            if not unsure or enough == CERTAIN:
                break
            enough = CERTAIN
            unsure.clear()
            continue
        needed = CERTAIN if found.leaves_out else enough
        if found.likely < needed:
            found = left.whichever_else(found, unsure)
        cause = found.likeliest
        if cause is None or found.likely < needed or done > _MOST * len(runs):
            among = found.runs or {*runs.tolist()} - left.silent - {*unsure}
            unsure |= dict.fromkeys(among, replace(found, likeliest=None))
        else:
            yield found
            enough = SURE  # what hid behind this may be told now
            unsure.clear()
            done += len(cause.rows) * (cause.what not in OWN)
            left = left.without(cause)
    yield from dict.fromkeys(unsure.values())
    for run in sorted(distrusted):
        found = left.wrong([*unsure], run)
        if found is not None and found.likely > CERTAIN:
            yield found


@dataclass(frozen=True)
class _Left:
    """What is left of collects when some causes are known: runs that say nothing of others, and of their own what."""

    collects: Collects
    beside: OtherSensor | None
    silent: frozenset[int]
    apart: frozenset[tuple[int, str]] = frozenset()
    _without: dict[Cause, Self] = field(default_factory=dict, init=False)
    _wrong: dict[tuple[frozenset[int], int | None], Explained | None] = field(default_factory=dict, init=False)

    def without(self, cause: Cause) -> Self:
        """Return what is left when a further cause is known: one and the same, whoever asks."""
        if cause not in self._without:
            self._without[cause] = self._less(cause)
        return self._without[cause]

    def _less(self, cause: Cause) -> Self:
        left = replace(self, collects=mended(self.collects, cause))
        if cause.what == "run":
            return replace(left, silent=self.silent | {cause.run})
        return replace(left, apart=self.apart | {(cause.run, OWN[cause.what])}) if cause.what in OWN else left

    def wrong(self, unsure: Collection[int], run: int | None = None) -> Explained | None:
        """Return what is wrong with runs of which it may be told, or with one `run`; None for nothing.

        It is asked again of what is unsure when more has to be certain, and beside what was a rival.
        """
        asked = frozenset(unsure), run
        if asked not in self._wrong:
            self._wrong[asked] = self._told(unsure, run)
        return self._wrong[asked]

    def _told(self, unsure: Collection[int], run: int | None) -> Explained | None:
        told = ~np.isin(self.collects.conditions.run, list((self.silent | {*unsure}) - {run}))
        if not told.any():
            return None
        rows = np.flatnonzero(told)
        left, apart = self.collects.rows(told), self.apart
        beside = self.beside and replace(self.beside, rates=self.beside.rates[rows])
        asked = Asked(whitened(left, apart), apart, beside)
        nothing, found = asked.weighed(run)
        no_error = asked.rates.stated and asked.times > _NO_ERROR
        for cause in found[0][0] if found and no_error else ():
            left = mended(left, cause)
        # Nor is what the likeliest leaves as far from any error explained by it.
        if nothing > DOUBTED or (nothing > HARDLY and no_error and Asked(whitened(left, apart)).times > _NO_ERROR):
            return Explained(None, (), asked.times, 0.0) if no_error else None
        every = _by_place(found)
        likeliest = max(every, key=lambda each: every[each], default=())
        # Whatever may be true beside the likeliest is none of its rivals.
        instead = _by_place((causes, p) for causes, p in found if likeliest not in {cause.place for cause in causes})
        at = {cause.place: cause for causes, _ in reversed(found) for cause in causes}  # the likeliest at each place
        ordered = [(likeliest, every[likeliest])] * bool(every)
        ordered += sorted(instead.items(), key=lambda each: -each[1])
        filed = {place: replace(cause, rows=tuple(rows[list(cause.rows)].tolist())) for place, cause in at.items()}
        rivals = tuple((filed[place], p) for place, p in ordered if p > LISTED)
        ways: dict[tuple[Cause, ...], float] = {}
        for causes, p in found:
            way = tuple(filed[cause.place] for cause in causes)
            ways[way] = ways.get(way, 0.0) + p
        listed = sorted((way for way, p in ways.items() if p > LISTED), key=lambda way: -ways[way])
        return Explained(rivals[0][0] if rivals else None, rivals, asked.times, nothing, tuple(listed))

    def whichever_else(self, found: Explained, unsure: Collection[int]) -> Explained:
        """Return what is found, its likeliest as probable as it is alone and beside each rival: both may be true."""
        if found.likeliest is None:
            return found
        (first, p), *others = found.rivals
        rivals = []
        for other, as_probable in others:
            further = self.without(other).wrong(unsure)
            beside = {} if further is None else {cause.place: q for cause, q in further.rivals}
            both = beside.get(first.place, 0.0)
            p += as_probable * both
            rivals.append((other, as_probable * (1.0 - both)))
        listed = ((first, p), *(each for each in rivals if each[1] > LISTED))
        places = {cause.place for cause, _ in listed}
        ways = tuple(way for way in found.ways if places & {cause.place for cause in way})
        return replace(found, rivals=listed, ways=ways)


def _by_place(found: Iterable[tuple[tuple[Cause, ...], float]]) -> dict[tuple[object, ...], float]:
    """Return how probably something is wrong at each place."""
    out: dict[tuple[object, ...], float] = {}
    for causes, p in found:
        for place in dict.fromkeys(cause.place for cause in causes):
            out[place] = out.get(place, 0.0) + p
    return out


def beyond_others(
    collects: Collects, distrusted: Collection[int]
) -> tuple[Mapping[int, tuple[str, ...]], float | None]:
    """Return the runs of which no other tells, or not of all, and how far off a rate must be to be doubted, deg/hr.

    None unless so few runs are there that it is far.
    """
    used = collects.rows(~np.isin(collects.conditions.run, list(distrusted)))
    if not len(used):
        return {}, None
    rates = whitened(used)
    alone = rates.alone
    if len(used.conditions.of_each_run) > _MANY or rates.freedom < 1.0:
        return alone, None
    off = Asked(rates).seen_from()
    if not _in_errors(rates, off) > _UNSEEN:
        return alone, None
    for rows in used.conditions.of_each_run.values():  # one that is wrong makes all seem to scatter more
        moved = used.rates_deg_per_hr.copy()
        moved[rows] += _ANYWHERE / rates.weight.max() * (1.0 + np.arange(len(rows))[:, None]) ** 2
        without = Whitened(replace(used, rates_deg_per_hr=moved))
        off[rows] = np.maximum(off[rows], Asked(without).seen_from()[rows])
    least = _in_errors(rates, off)  # 0 where nothing tells of any: `alone` says that
    return alone, least / float(np.median(rates.weight[rates.known])) if least else None


def _in_errors(rates: Whitened, off_deg_per_hr: FloatArray) -> float:
    """Return the largest of sizes (n, c) that are known, in standard errors."""
    told = np.isfinite(off_deg_per_hr)
    return float(np.max(off_deg_per_hr[told] * rates.weight[told], initial=0.0))


def mended(collects: Collects, cause: Cause) -> Collects:
    """Return the collects with what is wrong put right, or left out."""
    rates, se, rows = collects.rates_deg_per_hr.copy(), collects.rates_se_deg_per_hr.copy(), list(cause.rows)
    if cause.what == "exchanged":
        rates[rows], se[rows] = rates[rows[::-1]], se[rows[::-1]]
    elif cause.what in ("channels", "turned", "all turned"):
        rates[rows] = put_right(rates[rows], cause.what, cause.channels)
        se[rows] = np.abs(put_right(se[rows], cause.what, cause.channels))
    elif cause.what == "sensors":
        rates[rows] = cause.instead
    elif cause.what not in OF_THE_RUN:
        rates[np.ix_(rows, cause.channels or range(rates.shape[1]))] = np.nan
    return replace(collects, rates_deg_per_hr=rates, rates_se_deg_per_hr=se)


@dataclass
class Together:
    """The `collects` of all sensors, with labels put right that are certain in common, and what is `found` beside.

    `exchanged` are those labels: causes by the place of their sensor, and whether the unit's accelerometers tell them;
    `shown` is what each sensor is shown by the other.
    """

    collects: list[Collects]
    failed: Sequence[Set[int]]
    exchanged: list[tuple[Mapping[int, Cause], bool]] = field(default_factory=list)
    shown: list[OtherSensor | None] = field(default_factory=list)
    found: list[list[Explained]] = field(default_factory=list)

    @classmethod
    def of(
        cls,
        collects: Sequence[Collects],
        failed: Sequence[Set[int]],
        lie_exchanged: Sequence[Collection[tuple[int, int]]],
    ) -> Self:
        """Ask every sensor, and again with labels put right in all that one is certain of.

        Of runs that `failed` nothing is held against another's; `lie_exchanged` are collects that lie as each other's.
        """
        out = cls([*collects], failed)
        for causes in _as_the_unit_lay(collects, lie_exchanged):
            if sum(out._likelier(k, cause) for k, cause in causes.items()) > -AS_IT_LAY:
                out._exchange(causes, by_accelerometers=True)
        known: list[Mapping[int, Cause]] = []
        while True:
            out.shown = [out._other_sensor(k) for k in range(len(collects))]
            out.found = [_found(*each) for each in zip(out.collects, failed, out.shown, strict=True)]
            before = len(known)
            for causes in out._in_common():
                if causes not in known:  # either sensor may be certain of it
                    known.append(causes)
                    out._exchange(causes, by_accelerometers=False)
            if len(known) == before:
                return out

    def _exchange(self, causes: Mapping[int, Cause], *, by_accelerometers: bool) -> None:
        self.exchanged.append((causes, by_accelerometers))
        for k, cause in causes.items():
            self.collects[k] = mended(self.collects[k], cause)

    def _likelier(self, k: int, cause: Cause) -> float:
        """Return how much likelier, in logs, a sensor's rates are with labels put right."""
        filed = self.collects[k]
        return Asked(whitened(mended(filed, cause))).as_filed - Asked(whitened(filed)).as_filed

    def _other_sensor(self, k: int) -> OtherSensor | None:
        """Return what the other of two sensors that are alike shows in the same collects, and says of their labels."""
        if len(self.collects) != 2 or len({len(each.conditions.sensor.channels) for each in self.collects}) > 1:
            return None
        collects, other, failed = self.collects[k], self.collects[1 - k], self.failed[1 - k]
        # A run that FAILs by its records would hide in its noise whatever else the other's rates say of the rest.
        asked = cache(lambda silent: Asked(whitened(other.rows(~np.isin(other.conditions.run, [*silent])))))
        shown = _beside(collects, other)
        same = {run for run, rows in collects.conditions.of_each_run.items() if np.isfinite(shown[rows]).any()}
        own, theirs = _beside(other, collects), other.conditions.of_each_run
        return OtherSensor(
            shown,
            cache(lambda run: asked(failed - {run}).labels(run) if run in same else {}),
            cache(lambda run: asked(failed - {run}).with_others(run, own[theirs[run]]) if run in same else -np.inf),
        )

    def _in_common(self) -> Iterator[dict[int, Cause]]:
        """Yield labels that are certain to be exchanged in one sensor, with those of others recorded with them.

        But for sensors whose own rates contradict it by more than it is usual that labels are exchanged for all.
        """
        for k, each in ((k, each.likeliest) for k, of in enumerate(self.found) for each in of):
            if each is None or each.what != "exchanged" or each.run in self.failed[k]:
                continue
            own, out = self.collects[k].conditions, {k: each}
            place = np.searchsorted(own.of_each_run[each.run], each.rows)
            for other, collects in enumerate(self.collects):
                theirs = collects.conditions.of_each_run.get(each.run, np.zeros(0, dtype=np.int64))
                labels = own.position[own.of_each_run[each.run]]
                if other != k and np.array_equal(labels, collects.conditions.position[theirs]):
                    same = replace(each, rows=tuple(theirs[place].tolist()))
                    if self._likelier(other, same) > -MOSTLY:
                        out[other] = same
            if len(out) > 1:
                yield out


def _beside(collects: Collects, other: Collects) -> FloatArray:
    """Return what another sensor shows in the same collects (n, c), NaN where it took none or others."""
    out, theirs = np.full(collects.rates_deg_per_hr.shape, np.nan), other.conditions.of_each_run
    for run, rows in collects.conditions.of_each_run.items():
        there = theirs.get(run, rows[:0])
        if np.array_equal(collects.conditions.position[rows], other.conditions.position[there]):
            out[rows] = other.rates_deg_per_hr[there]
    return out


def _as_the_unit_lay(
    sensors: Sequence[Collects], exchanged: Sequence[Collection[tuple[int, int]]]
) -> list[dict[int, Cause]]:
    """Return the labels that accelerometers exchange: how the unit lay is the body's, and so is whether it is true."""
    out: dict[tuple[int, tuple[int, ...]], dict[int, Cause]] = {}
    for k, (collects, pairs) in enumerate(zip(sensors, exchanged, strict=True)):
        for pair in (each for each in pairs if np.isin(each, collects.conditions.collect).all()):
            rows = np.flatnonzero(np.isin(collects.conditions.collect, pair))
            run = int(collects.conditions.run[rows[0]])
            place = np.searchsorted(collects.conditions.of_each_run[run], rows)
            same = out.setdefault((run, tuple(place.tolist())), {})
            same[k] = Cause("exchanged", run, tuple(rows.tolist()))
    return [*out.values()]


def _found(collects: Collects, failed: Set[int], other: OtherSensor | None) -> list[Explained]:
    """Return what is wrong with collects; where in the end nothing of a run holds, nothing of it was put right."""
    found = [*explanations(collects, failed, other)]
    gone = lost(found)
    return [each for each in found if (c := each.likeliest) is None or c.what == "run" or c.run not in gone]


def lost(found: Iterable[Explained]) -> set[int]:
    """Return the runs of which nothing holds."""
    return {each.likeliest.run for each in found if each.likeliest is not None and each.likeliest.what == "run"}
