"""What the other runs of a campaign say of each collect: the quick form of the question what is wrong with rows.

    contradicted_by_neighbours(collects)   # {5: Judgement(FAIL, "collects 13 and 14 look exchanged: …")}

A rate should be what the same position showed in the other runs at its temperature (their median), or what runs at the
next colder and warmer temperature lead one to expect. How far it is from that is measured by how far all the others
are: collects further off than `FAR` of that scatter are named, with the cause under which they would not be, where
there is one. A unit that scatters more is judged more mildly; a single run has no neighbours and is not judged.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from hil.campaign import BoolArray, Collects, FloatArray, IntArray
from hil.solve.temperatures import level_degC, same_temperature
from procedures.verdict import Judgement, Verdict
from procedures.words import numbered

FAR = 10.0
"""Times the usual scatter: beyond what a unit's own turn-ons and reseats do from time to time."""

_NEAR = 4.0  # what a cause must bring a collect back to
_REPEATED = 3  # collects at one position and temperature tell of each other
_ENOUGH = 6  # departures of a kind that tell how large they usually are
_MOST = 0.2  # of the collects: where more stand out, the scatter is not what stands out from it
_SIGMA = 1.4826  # a normal distribution's sigma by its median departure
_WHOLE_RUN = 0.8  # of its collects, off by the same


def contradicted_by_neighbours(collects: Collects) -> Mapping[int, Judgement]:
    """Return what is wrong with the runs whose collects their neighbours contradict, by run."""
    departures = _Departures(collects)
    apart = departures.settled()
    if apart is None or not apart.any():
        return {}
    runs = collects.conditions.run
    return {run: departures.judge(np.flatnonzero(apart & (runs == run))) for run in np.unique(runs[apart]).tolist()}


class _Departures:
    """How far n collects of c channels are from what others lead one to expect, in units of the usual scatter."""

    def __init__(self, collects: Collects) -> None:
        self._collects = collects
        self._rates = collects.rates_deg_per_hr
        _, self._label = np.unique(collects.conditions.position, return_inverse=True)
        self._level = same_temperature(collects.conditions)
        self._temperature_degC = level_degC(collects.conditions)
        self._expected = np.full(self._rates.shape, np.nan)
        self._scale = np.full(self._rates.shape, np.nan)

    def settled(self) -> BoolArray | None:
        """Return which collects stand out, (n,), leaving out one per place and turn; None where too many do."""
        left_out = np.zeros(len(self._rates), dtype=bool)
        while True:
            score = self._scores(left_out)
            far = np.where(left_out | (score <= FAR), -np.inf, score)
            # What is expected of one collect rests on others: of those that do, only the worst is believed at a time.
            alone = [place for place in self._places() if len(place) < _REPEATED]
            turns = [place for place in self._places() if len(place) >= _REPEATED]
            turns += [np.concatenate([p for p in alone if self._label[p[0]] == label]) for label in self._labels(alone)]
            worst = [place[int(np.argmax(far[place]))] for place in turns if np.any(far[place] > FAR)]
            if not worst:
                return left_out
            left_out[worst] = True
            if left_out.sum() > max(2, _MOST * len(left_out)):
                return None

    def _labels(self, places: Sequence[IntArray]) -> IntArray:
        return np.unique([self._label[place[0]] for place in places]).astype(np.int64)

    def _places(self) -> Iterator[IntArray]:
        """Yield the indices of the collects at one position and temperature."""
        number = self._label * (int(self._level.max(initial=0)) + 2) + self._level + 1
        order = np.argsort(number, kind="stable")
        yield from np.split(order, np.flatnonzero(np.diff(number[order])) + 1)

    def _scores(self, left_out: BoolArray) -> FloatArray:
        """Return the largest departure of each collect's channels, (n,), NaN or 0 where nothing is expected."""
        self._expected[:] = np.nan
        repeated = np.zeros(len(self._rates), dtype=bool)
        places = list(self._places())
        for place in places:
            kept = place[~left_out[place]]
            for i in place:
                others = kept[kept != i]
                if len(others) >= _REPEATED - 1 and self._level[i] >= 0:
                    self._expected[i], repeated[i] = self._middle(i, others), True
        for label in np.unique(self._label):
            self._between(np.flatnonzero((self._label == label) & (self._level >= 0)), repeated, left_out)
        off = np.abs(self._rates - self._expected)
        floor = np.nan_to_num(self._collects.rates_se_deg_per_hr)
        for kind in (repeated, ~repeated):
            known = kind & ~left_out & np.isfinite(off).all(axis=1)
            usual = _SIGMA * np.median(off[known], axis=0) if known.sum() >= _ENOUGH else np.inf
            self._scale[kind] = np.maximum(usual, 2.0 * floor[kind])
        with np.errstate(invalid="ignore", divide="ignore"):
            scores: FloatArray = np.nan_to_num(off / self._scale, nan=0.0, posinf=0.0).max(axis=1)
        return scores

    def _middle(self, i: int, others: IntArray) -> FloatArray:
        """Return the median of other collects, (c,); of two the nearer one, lest one that is wrong accuses both."""
        if len(others) > _REPEATED - 1:
            return np.asarray(np.median(self._rates[others], axis=0))
        apart = np.linalg.norm(self._rates[others] - self._rates[i], axis=1)
        return np.asarray(self._rates[others[int(np.argmin(np.nan_to_num(apart, nan=np.inf)))]])

    def _between(self, rows: IntArray, repeated: BoolArray, left_out: BoolArray) -> None:
        """Expect of collects without repeats what lies between the next colder and the next warmer temperature."""
        kept, temperature_degC = rows[~left_out[rows]], self._temperature_degC
        levels = np.unique(self._level[kept])
        if temperature_degC is None or len(levels) < 2:
            return
        groups = [kept[self._level[kept] == level] for level in levels]
        means = np.array([self._rates[group].mean(axis=0) for group in groups])
        at = np.array([temperature_degC[group].mean() for group in groups])
        for i in rows[~repeated[rows]]:
            others = levels != self._level[i]
            below, above = np.flatnonzero(others & (levels < self._level[i])), np.flatnonzero(levels > self._level[i])
            if len(below) and len(above):
                low, high = below[-1], above[0]
                share = (temperature_degC[i] - at[low]) / (at[high] - at[low])
                self._expected[i] = means[low] + share * (means[high] - means[low])

    def judge(self, rows: IntArray) -> Judgement:
        """Say what is wrong with the collects `rows`, (k,), of one run."""
        conditions = self._collects.conditions
        named = numbered("collect", conditions.collect[rows].tolist())
        for i in rows:
            for j in rows[rows > i]:
                if self._fits(i, self._rates[j]) and self._fits(j, self._rates[i]):
                    pair = numbered("collect", conditions.collect[[i, j]].tolist())
                    positions = " and ".join(conditions.position[[i, j]].tolist())
                    reason = f"{pair} look exchanged: each shows what the other runs show at the other's position"
                    return Judgement(Verdict.FAIL, f"{reason} ({positions})")
        if all(self._fits(i, -self._rates[i]) for i in rows):
            return Judgement(Verdict.FAIL, f"{named}: the signs look turned: the other runs show the same with minus")
        off = self._rates[rows] - self._expected[rows]
        worst = np.unravel_index(int(np.nanargmax(np.abs(off / self._scale[rows]))), off.shape)
        channel = list(conditions.sensor.channels)[int(worst[1])]
        reason = (
            f"{named}: {channel} is {off[worst]:+.1f} deg/hr from what the other runs show at position "
            f"{conditions.position[rows[worst[0]]]}, "
            f"{abs(off[worst]) / self._scale[rows][worst]:.0f} times their scatter"
        )
        whole = len(rows) >= _WHOLE_RUN * np.count_nonzero(conditions.run == conditions.run[rows[0]])
        alike = np.all(np.ptp(off, axis=0) <= FAR * np.nanmax(self._scale[rows], axis=0))
        if len(rows) > 1 and whole and alike:
            return Judgement(Verdict.MARGINAL, f"{reason}; the whole run is off by the same: its bias was another")
        return Judgement(Verdict.INCONCLUSIVE, reason)

    def _fits(self, i: int, rates: FloatArray) -> bool:
        return bool(np.all(np.abs(rates - self._expected[i]) <= _NEAR * self._scale[i]))
