"""Whole runs that disagree with all others in a way that neither noise nor an effect of the catalogue does.

A channel whose sign was turned in two runs of twelve, or which was dead, or written in another unit: the noise from run
to run is estimated from those runs too, and swallows them. So each run is compared with what the others measured at the
same position and temperature, in units of what is usual among the runs (a median, which a quarter of bad runs cannot
move). What is the same in all rows of a run is left to the search: a bias that steps has names of its own. So is a row
that stands out by itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hil.campaign import BoolArray, Campaign, Conditions, FloatArray, IntArray
from hil.reconcile.search.candidates import Candidate
from hil.solve.identifiability import independent_columns, kept_shares, orthonormal, project_out
from hil.solve.rows import Block

_LEAST_RUNS = 8
_SHARE = 0.25
_LEAST_ROWS = 3  # of a run: fewer cannot tell a bad run from a bad row
_LEAST_FREEDOM = 8
_SUSPECT = 3.5  # times the usual: such runs are kept out of the fit that they are judged by
_LIMIT, _FEW = 5.0, 30.0  # times the usual, and more where the runs are few: noise of any kind reaches half of it
_RECOGNISED = (2.5, 6.0)  # times the usual, beside a bias and with it, of a run whose rates are turned or nothing
_PLAIN = 15.0  # times the usual, of a recognised run that differs by a bias alone
FALSE = 0.002  # of declaring any run bad in a clean campaign; measured, it is less
_LEAST_SCALE = 0.5  # of the stated noise
_LEAST_SHARE = 0.02  # of what the rates vary by
_ORDER = 4
_SLIGHT = 0.05  # a column of which less than this is left beside the others is theirs
_ROUNDS = 60
_LIKE = 0.25  # what is left of a departure that has been recognised
_EXPLAINED = 0.3  # what is left of one that an effect of the catalogue explains
_SEEN = 0.9  # leverage from which a run is fitted by itself alone
_EXTENDED = 4.0  # and from which what the others say is carried too far


@dataclass(frozen=True)
class BadRun:
    """One channel of one run that does not agree with the others.

    `run` is the campaign's own number, `rows` (m,) index the sensor's collects, `size` and `usual` are in deg/hr: how
    far the run is from what the others predict (rms), and how far runs usually are. `kind` is "sign", "factor", "dead"
    or "", and `factor` what the predicted rates have to be multiplied by.
    """

    sensor: int
    channel: int
    run: int
    rows: IntArray
    size: float
    usual: float
    score: float
    kind: str
    factor: float


def bad_runs(campaign: Campaign, blocks: Sequence[Block], candidates: Sequence[Candidate]) -> list[BadRun]:
    """Return the runs that disagree with all others, in order; none where they are more than a quarter.

    What a catalogue effect of `candidates` explains, fitted to all rows, is the search's to find.
    """
    out: list[BadRun] = []
    for block in blocks:
        for channel in np.unique(block.channel).tolist():
            out += _of_channel(campaign, block.take(block.channel == channel), channel, candidates)
    return sorted(out, key=lambda bad: (bad.sensor, bad.run, bad.channel))


def _of_channel(campaign: Campaign, block: Block, channel: int, candidates: Sequence[Candidate]) -> list[BadRun]:
    collects = campaign.sensors[block.sensor]
    judged = departures(block, collects.conditions)
    if judged is None:
        return []
    raw = collects.rates_deg_per_hr[block.rows, channel]
    runs, inverse = np.unique(block.run, return_inverse=True)
    kinds = [_kind(raw[inverse == k], (raw - judged.left)[inverse == k], judged.usual) for k in range(len(runs))]
    far = judged.score > _LIMIT + _FEW / len(runs)
    known = np.array([kind in {"sign", "dead"} for kind, _ in kinds])
    both = (judged.score > _RECOGNISED[0]) & (judged.whole > _RECOGNISED[1])
    bad = far | (known & (both | (judged.whole > _PLAIN)))
    if not bad.any() or bad.sum() > _SHARE * len(runs):
        return []
    bad &= judged.has_others(bad)
    bad &= ~_follows_a_condition(block, collects.conditions, judged.left, inverse, bad)
    bad &= ~_explained(block, judged.design, inverse, bad, candidates)
    return [
        BadRun(
            sensor=block.sensor,
            channel=channel,
            run=int(collects.conditions.run[block.rows[inverse == k][0]]),
            rows=block.rows[inverse == k],
            size=float(np.sqrt(np.mean(judged.left[inverse == k] ** 2))),
            usual=judged.usual,
            score=float(max(judged.score[k], judged.whole[k])),
            kind=kinds[k][0],
            factor=kinds[k][1],
        )
        for k in np.flatnonzero(bad).tolist()
    ]


@dataclass(frozen=True)
class Departures:
    """How far each of R runs is from the others: `score` (R,) by what is not a bias, `whole` (R,) by all of it.

    Both are in units of `usual`, deg/hr. `left` (N,) is the difference at each row; `station` (R,) where the run was;
    `design` (N, p) is what the runs have in common.
    """

    score: FloatArray
    whole: FloatArray
    usual: float
    left: FloatArray
    station: IntArray
    design: FloatArray

    def has_others(self, bad: BoolArray) -> BoolArray:
        """Whether another run at the same temperature is as usual: else it is the temperature that differs, (R,)."""
        return np.array([bool(np.any(~bad & (self.station == s))) for s in self.station.tolist()])


def departures(block: Block, conditions: Conditions) -> Departures | None:
    """Compare the runs of one channel's block with each other; None where the layout cannot bear it."""
    runs, inverse = np.unique(block.run, return_inverse=True)
    if len(runs) < _LEAST_RUNS:
        return None
    design = _means(block, conditions, inverse)
    if design is None or len(block.y) - design.shape[1] < _LEAST_FREEDOM:
        return None
    first = _spread(_by_most_runs(design, block.y, inverse), inverse, len(runs))
    order = np.argsort(-first)[: int(_SHARE * len(runs))]
    suspect = np.isin(np.arange(len(runs)), order) & (first > _SUSPECT * np.median(first))
    left, leverage = _by_the_others(design, block.y, suspect[inverse])
    share = np.bincount(inverse, leverage) / np.bincount(inverse)
    widen = np.sqrt(np.where(suspect, 1.0 + share, np.clip(1.0 - share, 1.0 - _SEEN, None)))
    seen = share < np.where(suspect, _EXTENDED, _SEEN)
    own = left / widen[inverse]
    station = np.array([int(np.median(block.station[inverse == k])) for k in range(len(runs))])
    spread = _spread(own, inverse, len(runs))
    usable = seen & np.isfinite(spread)
    if usable.sum() < _LEAST_RUNS:
        return None
    least = _LEAST_SHARE * float(np.median(np.abs(block.y - np.median(block.y))))
    if block.sigma_stated:
        least = max(least, _LEAST_SCALE * float(np.median(block.sigma)))
    least = max(least, 1e-12)
    usual = max(float(np.median(spread[usable])), least)
    whole = np.sqrt(np.bincount(inverse, own**2) / np.bincount(inverse))
    whole_usual = max(float(np.median(whole[usable])), least)
    score = np.array([_without_one(own[inverse == k]) for k in range(len(runs))])
    beside = np.array([_beside_neighbours(own, inverse, station, suspect, k) for k in range(len(runs))])
    return Departures(
        np.where(usable, np.minimum(score, beside) / usual, 0.0),
        np.where(usable, whole / whole_usual, 0.0),
        usual,
        left,
        station,
        design,
    )


def _means(block: Block, conditions: Conditions, inverse: IntArray) -> FloatArray | None:
    """What the runs have in common, (N, p): a value for each position (or a slope with f) at each temperature.

    Smooth in temperature where a temperature has fewer than three runs; None where no temperature has a second.
    """
    labels = conditions.position[block.rows]
    names = np.unique(labels)
    seen_in = [len(np.unique(inverse[labels == name])) for name in names]
    f = conditions.f_g[block.rows]
    if min(seen_in) >= _LEAST_ROWS:
        places = (labels[:, None] == names).astype(np.float64)
    else:
        places = np.hstack([np.ones((len(block.y), 1)), f[:, np.std(f, axis=0) > 0.05]])
    numbers = np.unique(block.station)
    runs_at = [len(np.unique(inverse[block.station == s])) for s in numbers]
    if len(numbers) == 1:
        steps = np.ones((len(block.y), 1))
    elif min(runs_at) >= _LEAST_ROWS:
        steps = (block.station[:, None] == numbers).astype(np.float64)
    elif len(numbers) > 2 and max(runs_at) > 1:
        temperature = conditions.columns["temperature_degC"][block.rows]
        unit = 2.0 * (temperature - temperature.min()) / max(float(np.ptp(temperature)), 1e-12) - 1.0
        order = min(_ORDER, len(numbers) - 2)
        steps = np.polynomial.chebyshev.chebvander(np.clip(unit, -1.0, 1.0), order)
    else:
        return None
    rich = (places[:, :, None] * steps[:, None, :]).reshape(len(block.y), -1)
    return orthonormal(independent_columns(np.hstack([rich, block.base, conditions.w_deg_per_hr[block.rows]]), _SLIGHT))


def _by_most_runs(design: FloatArray, y: FloatArray, inverse: IntArray) -> FloatArray:
    """What a fit leaves (N,) that minimises the sum over runs of each run's distance: most runs decide."""
    weight = np.ones(len(y))
    left = y
    for _ in range(_ROUNDS):
        root = np.sqrt(weight)
        left = y - design @ np.linalg.lstsq(design * root[:, None], y * root, rcond=1e-10)[0]
        distance = np.sqrt(np.bincount(inverse, left**2) / np.bincount(inverse))
        weight = 1.0 / np.maximum(distance, 1e-3 * np.median(distance) + 1e-12)[inverse]
    return left


def _by_the_others(design: FloatArray, y: FloatArray, suspect: BoolArray) -> tuple[FloatArray, FloatArray]:
    """What the fit to the rows that are not suspect leaves at every row, and every row's leverage, both (N,)."""
    good = design[~suspect]
    inverse = np.linalg.pinv(good.T @ good, rcond=1e-10)
    leverage = np.einsum("ij,jk,ik->i", design, inverse, design)
    # Rows of which the others say nothing count as fitted by themselves alone.
    unseen = np.linalg.norm(design - design @ (inverse @ (good.T @ good)), axis=1) > 1e-6
    return y - design @ (inverse @ (good.T @ y[~suspect])), np.where(unseen, np.inf, leverage)


def _spread(left: FloatArray, inverse: IntArray, count: int) -> FloatArray:
    """Scatter of each run's rows about their own mean, (R,); NaN where it has too few."""
    out = np.full(count, np.nan)
    for k in range(count):
        own = left[inverse == k]
        if len(own) >= _LEAST_ROWS:
            out[k] = float(np.std(own, ddof=1))
    return out if np.all(np.isfinite(out)) else np.where(np.isfinite(out), out, np.nanmedian(out))


def _without_one(left: FloatArray) -> float:
    """The scatter of a run's rows without the one that does most for it."""
    if len(left) < _LEAST_ROWS:
        return 0.0
    return min(float(np.std(np.delete(left, i), ddof=1)) for i in range(len(left)))


def _beside_neighbours(left: FloatArray, inverse: IntArray, station: IntArray, suspect: BoolArray, run: int) -> float:
    """The scatter of a run's rows, the worst left out, beside its usual neighbours at the same temperature.

    Rows are matched by their order within the run; where that is not possible the run stands by itself.
    """
    own = left[inverse == run]
    same = np.flatnonzero(~suspect & (station == station[run]) & (np.arange(len(station)) != run))
    others = [left[inverse == k] for k in same.tolist()]
    others = [other for other in others if len(other) == len(own)]
    return _without_one(own - np.mean(others, axis=0)) if others else _without_one(own)


def _kind(raw: FloatArray, predicted: FloatArray, usual: float) -> tuple[str, float]:
    """Recognise what a run's rates are of the predicted ones: of the other sign, in another unit, or not at all."""
    size = float(predicted @ predicted)
    if len(raw) < 2 or size == 0.0:
        return "", 1.0
    noise, length = usual * np.sqrt(len(raw)), float(np.sqrt(size))
    factor = float(raw @ predicted) / size
    rest, moved = float(np.linalg.norm(raw - factor * predicted)), abs(factor - 1.0) * length
    if length < 2.0 * noise or rest > max(_LIKE * moved, 2.0 * noise):
        return "", 1.0
    for kind, exact in (("sign", -1.0), ("dead", 0.0)):
        if abs(factor - exact) * length < max(0.1 * length, 2.0 * noise):
            return kind, exact
    return "factor", factor


def _follows_a_condition(
    block: Block, conditions: Conditions, left: FloatArray, inverse: IntArray, bad: BoolArray
) -> BoolArray:
    """Whether a recorded condition explains a run: what it does to the other runs predicts this one, (R,)."""
    out = np.zeros(len(bad), dtype=bool)
    f = conditions.f_g[block.rows]
    places = np.hstack([np.ones((len(left), 1)), f[:, np.std(f, axis=0) > 0.05]])
    good = ~bad[inverse]
    for values in conditions.columns.values():
        x = values[block.rows]
        if not np.all(np.isfinite(x)) or np.ptp(x[good]) <= 1e-9 * np.abs(x).max():
            continue
        columns = places * ((x - x[good].mean()) / x[good].std())[:, None]
        fit = np.linalg.lstsq(columns[good], left[good], rcond=1e-3)[0]
        rest = left - columns @ fit
        for k in np.flatnonzero(bad & ~out).tolist():
            here = inverse == k
            out[k] = np.std(rest[here]) < 0.5 * np.std(left[here])
    return out


def _explained(
    block: Block, design: FloatArray, inverse: IntArray, bad: BoolArray, candidates: Sequence[Candidate]
) -> BoolArray:
    """Whether an effect of the catalogue, fitted to all rows beside what the runs have in common, explains a run, (R,).

    A large effect may act in a few runs alone: vibration that was strong once, or the first run after a cold start.
    """
    out = np.zeros(len(bad), dtype=bool)
    if not bad.any():
        return out
    alone = project_out(design, block.y)
    for candidate in candidates:
        if candidate.tier != 1 or candidate.sensor != block.sensor:
            continue
        columns = block.select(candidate.columns)
        columns = columns[:, kept_shares(design, columns) > _SLIGHT]
        if columns.shape[1] == 0:
            continue
        rest = project_out(orthonormal(project_out(design, columns), 1e-6), alone)
        for k in np.flatnonzero(bad).tolist():
            here = inverse == k
            out[k] |= bool(np.std(rest[here]) < _EXPLAINED * np.std(alone[here]))
    return out


def rows_of(bad: Sequence[BadRun]) -> list[dict[str, Any]]:
    """Return every rate of bad runs, in the form in which outlying rows are left out of a campaign."""
    return [{"sensor": b.sensor, "row": row, "channel": b.channel} for b in bad for row in b.rows.tolist()]
