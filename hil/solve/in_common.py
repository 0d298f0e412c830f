"""Labels are a collect's, which the sensors of a unit have in common: what one tells of them is asked of all."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Self

import numpy as np

from hil.campaign import Collects, FloatArray
from hil.solve.asked import Asked, OtherSensor
from hil.solve.causes import AS_IT_LAY, MOSTLY, Cause
from hil.solve.explained import Explained, explanations, mended
from hil.solve.whitened import whitened


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
