"""What the other runs of a campaign say of each collect, also where each temperature was met once.

    found = compared_with_neighbours(collects)
    found.judged         # {5: Judgement(INCONCLUSIVE, "collect 15: RA is +300.2 deg/hr from what …")}
    found.not_compared   # {7}: it stands alone at its temperature

A rate should be what the same position showed in the other runs at its temperature (their median), or what runs at the
next colder and warmer temperature lead one to expect. How far it is from that is measured by how far all the others
are: collects further off than `FAR` of that scatter are named. A unit that scatters more is judged more mildly, and a
run without neighbours is not judged, and that is said.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, replace

import numpy as np

from hil.campaign import BoolArray, Collects, Conditions, FloatArray, IntArray
from hil.campaign.laws import FIXTURE_G, from_the_usual_g
from hil.solve.temperatures import level_degC, same_temperature
from procedures.verdict import Judgement, Verdict
from procedures.words import numbered

FAR = 10.0
"""Times the usual scatter: beyond what a unit's own turn-ons and reseats do from time to time."""

OTHER_BIAS = "; the whole run is off by the same: its bias was another, as means and ± of the bias include"
"""Said of a run that has a bias of its own: what a unit does from time to time, it may do again."""
_FAR_MORE = 2.0  # by less do few of a position differ by chance
_NEAR = 4.0  # what a cause must bring a collect back to
_REPEATED = 3  # collects at one position and temperature tell of each other
_ENOUGH = 6  # departures of a kind that tell how large they usually are
_MOST = 0.2  # of the collects: where more stand out, the scatter is not what stands out from it
_SIGMA = 1.4826  # a normal distribution's sigma by its median departure
_WHOLE_RUN = 0.8  # of its collects, off by the same


@dataclass(frozen=True)
class Found:
    """Rows (k,) of one run that stand out, and which rates are `wrong` (n, c)."""

    run: int
    rows: IntArray
    wrong: BoolArray


@dataclass(frozen=True)
class Neighbours:
    """What is wrong with runs whose collects their neighbours contradict, and which runs have none to compare with."""

    judged: Mapping[int, Judgement]
    found: Sequence[Found]
    not_compared: Set[int]


def compared_with_neighbours(collects: Collects, distrusted: Collection[int] = ()) -> Neighbours:
    """Compare each collect of one sensor with those of the other runs; nothing rests on runs that are `distrusted`."""
    departures, runs = _Departures(collects), collects.conditions.run
    every = set(runs.tolist())
    untold = np.isin(runs, list(distrusted))
    apart = departures.settled(untold if not untold.all() else np.zeros_like(untold))
    if apart is None:
        return Neighbours({}, (), every)
    judged, found = {}, []
    for run in np.unique(runs[apart]).tolist():
        judged[run], rows = departures.judge(run, np.flatnonzero(apart & (runs == run)))
        found.append(rows)
    known = departures.known
    return Neighbours(judged, found, every - set(runs[known].tolist()))


def place_in_each_run(conditions: Conditions) -> IntArray:
    """Number collects, (n,), by position and by the how-manieth time that their run took it.

    What drifts through a run shows where a position is taken again: that is compared with its like.
    """
    position = np.unique(conditions.position, return_inverse=True)[1]
    place = np.unique(np.stack([conditions.run, position]), axis=1, return_inverse=True)[1].reshape(-1)
    order = np.argsort(place, kind="stable")
    again = np.empty_like(place)
    again[order] = np.arange(len(place)) - np.searchsorted(place[order], place[order])
    return np.asarray(len(position) * again + position)


class _Departures:
    """How far n collects of c channels are from what others lead one to expect, in units of the usual scatter."""

    def __init__(self, collects: Collects) -> None:
        self._collects = collects
        self._w = collects.conditions.w_channels_deg_per_hr  # another at another heading
        self._rates = collects.rates_deg_per_hr - self._w
        self._label = place_in_each_run(collects.conditions)
        # A collect that lay otherwise than its label says is compared with none of that label.
        elsewhere = from_the_usual_g(collects.conditions) > FIXTURE_G
        self._label[elsewhere] = len(self._label) ** 2 + np.arange(elsewhere.sum())
        self._level = same_temperature(collects.conditions)
        self._temperature_degC = level_degC(collects.conditions)
        self._expected = np.full(self._rates.shape, np.nan)
        self._scale = np.full(self._rates.shape, np.nan)

    def settled(self, distrusted: BoolArray) -> BoolArray | None:
        """Return which collects stand out, (n,), leaving out one per place and turn; None where too many do.

        Nothing is expected by those that are `distrusted`, (n,).
        """
        left_out = distrusted.copy()
        while True:
            score = self._scores(left_out)
            far = np.where(left_out | (score <= FAR), -np.inf, score)
            # What is expected of one collect rests on others: of those that do, only the worst is believed at a time.
            alone = [place for place in self._places() if len(place) < _REPEATED]
            turns = [place for place in self._places() if len(place) >= _REPEATED]
            turns += [np.concatenate([p for p in alone if self._label[p[0]] == label]) for label in self._labels(alone)]
            worst = [place[int(np.argmax(far[place]))] for place in turns if np.any(far[place] > FAR)]
            if not worst:
                return left_out & (score > FAR)
            left_out[worst] = True
            if (left_out & ~distrusted).sum() > max(2, _MOST * np.count_nonzero(~distrusted)):
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
        before, self._expected = self._expected, np.full(self._rates.shape, np.nan)
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
        # Where too few are left that tell, what they told before stands, here and of the scatter.
        self._expected = np.where(np.isnan(self._expected) & left_out[:, None], before, self._expected)
        off = np.abs(self._rates - self._expected)
        floor = np.nan_to_num(self._collects.rates_se_deg_per_hr)
        told = ~left_out & np.isfinite(off).all(axis=1)
        for kind in (repeated, ~repeated):
            if (kind & told).sum() >= _ENOUGH:
                usual = _SIGMA * np.median(off[kind & told], axis=0)
                self._scale[kind] = np.fmax(usual, 2.0 * floor[kind])
        # What MU scatters by shows in one position alone: where that is far more than all do, it is that one's scale.
        if several := self._repeats(~told):
            label = self._label[np.concatenate(several)]
            apart = np.abs(np.concatenate([self._rates[each] - self._rates[np.roll(each, 1)] for each in several]))
            for one in np.unique(label[np.bincount(label)[label] >= _ENOUGH]):
                own, here = np.median(apart[label == one], axis=0), repeated & (self._label == one)
                of_position = np.where(own > _FAR_MORE * np.median(apart, axis=0), _SIGMA / np.sqrt(2.0) * own, 0.0)
                self._scale[here] = np.fmax(self._scale[here], of_position)
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

    @property
    def known(self) -> BoolArray:
        """Of which collects, (n,), it is known what to expect and how far collects usually are from that."""
        return np.asarray(np.isfinite(self._expected + self._scale).all(axis=1))

    def _repeats(self, left_out: BoolArray) -> list[IntArray]:
        """Return the indices of the collects at one position and temperature, where these tell of each other."""
        told = ~left_out & np.isfinite(self._rates).all(axis=1)
        places = [place[told[place]] for place in self._places()]
        return [place for place in places if len(place) >= _REPEATED and self._level[place[0]] >= 0]

    def judge(self, run: int, rows: IntArray) -> tuple[Judgement, Found]:
        """Say what is wrong with the collects `rows`, (k,), of one run, and which rates are."""
        found = Found(run, rows, np.zeros(self._rates.shape, dtype=bool))
        conditions = self._collects.conditions
        named = numbered("collect", conditions.collect[rows].tolist())
        off = self._rates[rows] - self._expected[rows]
        every = np.flatnonzero(conditions.run == run)
        apart, scale = (self._rates - self._expected)[every], self._scale[every]
        told = np.isfinite(apart + scale)
        worst = np.unravel_index(int(np.nanargmax(np.abs(off / self._scale[rows]))), off.shape)
        channel = list(conditions.sensor.channels)[int(worst[1])]
        reason = (
            f"{named}: {channel} is {off[worst]:+.1f} deg/hr from what the other runs show at position "
            f"{conditions.position[rows[worst[0]]]}, "
            f"{abs(off[worst]) / self._scale[rows][worst]:.0f} times their scatter"
        )
        # A bias is a run's: nearly all of its collects are off by the same, though not all so far.
        off_too, known = np.abs(apart[:, worst[1]]) > _NEAR * scale[:, worst[1]], told[:, worst[1]].sum()
        unlike = np.any(np.ptp(apart[off_too], axis=0) > FAR * np.fmax.reduce(scale))
        if known > 1 and off_too.sum() >= _WHOLE_RUN * known and not unlike:
            said = f"{reason}{OTHER_BIAS}"
            return Judgement(Verdict.MARGINAL, said), replace(found, rows=every[off_too])
        # A collect with one rate wrong is not to be trusted.
        found.wrong[rows] = np.abs(off) > _NEAR * self._scale[rows]
        return Judgement(Verdict.INCONCLUSIVE, reason), found
