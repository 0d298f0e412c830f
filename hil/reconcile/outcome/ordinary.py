"""What the averages of every channel scatter by: stated, observed, and explained."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.special import chdtr

from hil.campaign import FloatArray
from hil.model.effects.prior import ALPHA
from hil.model.forms import bias_names
from hil.reconcile.follows import repeated
from hil.reconcile.outcome.scatter import GRID, FoundScatter
from hil.reconcile.rivals import BEYOND
from hil.reconcile.search.fitted import Fitted, FittedBlock
from hil.solve.repeats import SensorRepeats
from hil.solve.uncertain import RARE


def ordinary(
    fit: Fitted,
    found: Sequence[FoundScatter],
    models: Mapping[int, Sequence[str]],
    shown: Mapping[int, SensorRepeats],
) -> list[dict[str, Any]]:
    """Return what every channel's averages scatter by, beside what their standard errors explain: key `noise`.

    `models` name what the averages of each sensor scatter about: a form, and what was added to it; `shown` is what its
    repeats show beside that.
    """
    sensors = [block.search.block.sensor for block in fit.blocks]
    return [
        channel
        for block, number in zip(fit.blocks, sensors, strict=True)
        for channel in _of_channels(block, found, " + ".join(models[number]), shown.get(number))
    ]


def _of_channels(
    block: FittedBlock, found: Sequence[FoundScatter], model: str, shown: SensorRepeats | None
) -> Iterator[dict[str, Any]]:
    """Yield what the channels of a block scatter by: the mean over all that is probable with the kind that was found.

    A point of the grid is a factor of two, so that one alone says little. An offset without error may be chance: where
    it is certain that averages scatter by more, but not whether from run to run, each has what is probable of it. Where
    no more is certain than the noise that `hil solve` knows, by residuals and repeats, a collect has that, as certainly
    as it is told there.
    """
    own, rows_of, points = block.search, block.search.block, block.search.points
    total = np.where(points.sort == points.sort[block.at], block.weighed.terms_log + points.log_prior, -np.inf)
    left, scales = block.weighed.left, block.weighed.scales_left
    (a, b, _), freedom = own.scales[-1], max(own.beside.freedom, 1)
    # Errors that these rows contradict are no part of what is seen, however much larger they are.
    scales = np.where(np.isclose(scales, (b + 0.5 * left) / (a + 0.5 * freedom)), left / freedom, scales) * own.unit**2
    weight = np.exp(total - np.logaddexp.reduce(total))
    runs, none = len(np.unique(rows_of.run)), float(weight[points.offset == 0.0].sum())
    certain = none < ALPHA
    offsets = scales * points.offset**2
    ordinary = np.array([not kind.name for kind in own.noise.kinds], dtype=bool)
    alone = replace(points, amount=points.amount * ordinary, offset=np.zeros(len(points)))
    by_itself = scales[:, None] * own.noise.variance(alone)
    more_than = (weight * scales) @ own.noise.variance(points) - weight @ by_itself
    relative = float(np.sqrt(2.0 / own.beside.freedom)) if own.beside.freedom else np.inf  # nothing is left to know by
    beside, errors = own.noise.stated_variance(), rows_of.sigma**2 * rows_of.sigma_stated
    for c in np.unique(rows_of.channel):
        rows, channel = rows_of.channel == c, list(own.noise.conditions.sensor.channels)[c]
        # Of the usual row: one whose standard error is huge says nothing of what the others scatter by.
        known = float(np.median(errors[rows] + beside[rows]))
        of_rows = np.median(by_itself[:, rows], axis=1)
        more = of_rows + offsets * (not certain)
        mean, middle = (_likely(more, weight, known=sure) for sure in (True, False))
        error = float(np.hypot(np.sqrt(weight @ (more - mean) ** 2), mean * relative))
        stated, by_solve, by_solve_error = rows_of.sigma_stated, 0.0, 0.0
        if shown is not None and shown.noise_told:
            usual = np.full((1, len(own.noise.conditions.sensor.channels)), np.median(rows_of.sigma[rows]))
            by_solve = float(shown.noise(usual)[0, c] ** 2 + np.median(beside[rows]))
            by_solve_error = by_solve * (relative if stated else float(np.sqrt(2.0 / shown.left.freedom[c])))
        least = known if stated else by_solve
        sure = (middle - least) * mean > BEYOND * error * least  # which is as uncertain as what is seen
        offset2, own2 = (_likely(each, weight, known=sure or certain) for each in (offsets, of_rows))
        here = [f for f in found if f.sensor == rows_of.sensor and channel in f.channels]
        noisier = not stated
        if by_solve and not sure:
            own2, error = by_solve, by_solve_error
            noisier |= bool(shown is not None and shown.stated and shown.noise_times[c] > 1.0)
        offset, size = float(np.sqrt(offset2)), float(np.sqrt(max(own2 - known, 0.0)))
        offset_se = offset * float(np.hypot(GRID / np.sqrt(12.0), 1.0 / np.sqrt(2.0 * runs)))
        if sure and offset > 0.0 and not certain:
            offset_se = float(np.hypot(offset_se, 0.5 * np.sqrt(weight @ (offsets - offset2) ** 2) / offset))
        told = (none < RARE or sure) and offset > 0.0
        # An effect on the scatter moves some rows and others not: of what it adds, the mean over all of them.
        seen = own2 + (np.mean(more_than[rows]) if here or sure or certain else offset2)
        yield {
            "sensor": rows_of.sensor,
            "channel": channel,
            "under": model + ", calibrated at each temperature" * block.calibrated,
            "stated_deg_per_hr": float(np.median(rows_of.sigma[rows])) if rows_of.sigma_stated else None,
            "explained_deg_per_hr": float(np.sqrt(known)) if rows_of.sigma_stated else None,
            "observed_deg_per_hr": float(np.sqrt(seen)) if own.beside.freedom else None,
            "run_offset_deg_per_hr": offset if told or repeated([own.noise.conditions]) else None,
            "run_offset_se_deg_per_hr": offset_se if told else None,
            "collect_to_collect_deg_per_hr": size if own.beside.freedom else None,
            "collect_to_collect_se_deg_per_hr": 0.5 * error / size if (sure or noisier) and size > 0.0 else None,
            "scatter": [{"id": f.effect.id, "deg_per_hr": f.deg_per_hr} for f in here],
            **_of_repeats(shown, bias_names(own.noise.conditions.sensor)[c], offset if told else 0.0),
        }


def _of_repeats(shown: SensorRepeats | None, bias: str, offset_deg_per_hr: float) -> dict[str, float]:
    """Return how seldom a bias that has an offset of each run differs so little between runs of one temperature."""
    place = list(shown.names).index(bias) if shown is not None and bias in shown.names else -1
    if shown is None or place < 0 or not offset_deg_per_hr or not (free := float(shown.spread.degrees[place])):
        return {}
    return {"repeats_p_value": float(chdtr(free, free * (shown.spread.observed[place] / offset_deg_per_hr) ** 2))}


def _likely(variances: FloatArray, weight: FloatArray, *, known: bool) -> float:
    """Return the mean of variances (t,) at the points; the middle where they are not known: few runs allow any size."""
    order = np.argsort(variances)
    middle = order[np.searchsorted(np.cumsum(weight[order]), 0.5 * weight.sum())]
    return float(weight @ variances if known else variances[middle])
