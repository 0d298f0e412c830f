"""What the averages scatter by: stated and observed, of every channel, and the effect on the scatter that was found."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import chdtr, ndtri

from hil.campaign import BoolArray, FloatArray
from hil.files.document import picked
from hil.model.effects.base import Parameter, VarianceEffect
from hil.model.effects.prior import ALPHA
from hil.model.forms import bias_names
from hil.reconcile.follows import repeated
from hil.reconcile.result import Disagreement
from hil.reconcile.rivals import BEYOND
from hil.reconcile.search.fitted import Fitted, FittedBlock
from hil.reconcile.search.likely_noise import DEPTH
from hil.reconcile.search.points import Kind, Points
from hil.reconcile.search.posterior import Found, Posterior
from hil.reconcile.search.set_in_block import SetInBlock
from hil.reconcile.search.sets import SensorSearch, Set
from hil.solve.repeats import SensorRepeats
from hil.solve.uncertain import CONFIDENCE, RARE


@dataclass(frozen=True)
class FoundScatter:
    """An effect on the scatter of one sensor: its parameter with value and error, and where it shows.

    A size is as uncertain upwards as downwards in its logarithm: `relative` is the deviation there.
    """

    effect: VarianceEffect
    sensor: int
    channel: str
    shape: Mapping[str, float]
    parameter: Parameter
    value: float
    relative: float
    deg_per_hr: float

    @property
    def se(self) -> float:
        """One standard deviation, in the parameter's unit."""
        return self.value * self.relative

    @property
    def interval(self) -> dict[str, float]:
        """The 95 % interval."""
        wide = float(np.exp(ndtri(0.5 + 0.5 * CONFIDENCE) * self.relative))
        return {"low": self.value / wide, "high": self.value * wide}


def found_scatter(posterior: Posterior, name: str) -> list[FoundScatter]:
    """Return what was found of one effect on the scatter, one entry per block in which it is more probable than not.

    Beside all that is likely to move the mean: what of that is not so sure that it is called missing scatters nothing.
    """
    likely, out = _sets_with(posterior, name), []
    for number, search in posterior.searches.items():
        shares: dict[tuple[Set, frozenset[str]], float] = {}
        for found, share in likely:
            own = found.terms[number], found.scatter
            shares[own] = shares.get(own, 0.0) + share
        for b, block in enumerate(search.blocks):
            if not any(kind.name == name for kind in block.noise.kinds):
                continue
            each = [_sized(search, b, name, *beside) for beside in shares]
            sizes = np.concatenate([own for own, *_ in each])
            weight = np.concatenate([share * own for (_, own, _), share in zip(each, shares.values(), strict=True)])
            if weight.sum() < 0.5:
                continue
            weight, kind = weight / weight.sum(), each[0][2]
            log_mean = float(weight @ np.log(sizes))
            spread = float(np.sqrt(weight @ (np.log(sizes) - log_mean) ** 2))
            size = float(np.exp(log_mean))
            value = size / kind.unit_deg_per_hr
            channel = list(block.noise.conditions.sensor.channels)[int(block.block.channel[0])]
            out.append(FoundScatter(kind.effect, number, channel, kind.shape, kind.parameter, value, spread, size))
    return out


def _sets_with(posterior: Posterior, name: str) -> list[tuple[Found, float]]:
    """Return the likeliest set with an effect on the scatter beside each that is likely of all else, with its share."""
    every = _by_names(posterior, [found for found in posterior.sets if name in found.scatter])
    likely = [(found, share) for found, share in every if share > _LEAST * every[0][1]]
    return [(found, share / sum(own for _, own in likely)) for found, share in likely]


def likeliest_with(posterior: Posterior, found: Found) -> Found:
    """Return the likeliest set that scatters as a found one and has its names, and more where that is more probable.

    More is what follows temperature: repeats do not differ by it. What they differ by scatters until it has a name.
    """
    own = posterior.names(found)

    def alike(other: Found) -> bool:
        further = [term for term in posterior.members(other) if term.called and term.called not in own]
        known = other.scatter == found.scatter and own <= posterior.names(other)
        return known and all(term.follows == "temperature" for term in further)

    most = next((each for each, _ in _by_names(posterior, [*filter(alike, posterior.sets)])), found)
    return found if posterior.names(most) == own else most


def _by_names(posterior: Posterior, sets: Sequence[Found]) -> list[tuple[Found, float]]:
    """Return the likeliest of those sets that have the same names, with how probable all these are, likeliest first."""
    every: dict[frozenset[str], list[Found]] = {}
    for found in sets:
        every.setdefault(posterior.names(found), []).append(found)
    shares = [(alike[0], float(np.exp([each.log_weight for each in alike]).sum())) for alike in every.values()]
    return sorted(shares, key=lambda each: -each[1])


def _sized(
    search: SensorSearch, b: int, name: str, chosen: Set, scatter: frozenset[str]
) -> tuple[FloatArray, FloatArray, Kind]:
    """Return the sizes (t,), deg/hr, of an effect in one block beside a set and what else scatters, and its shape.

    With how probable each is, (t,): what that leaves to one is that the block has none of it.
    """
    own, weighed = search.blocks[b], search.in_block(chosen, b)
    total = weighed.terms_log + own.points.log_prior
    kinds = np.array([kind.name == name for kind in own.noise.kinds], dtype=bool)
    within = np.array([sort <= scatter for sort in own.noise.sorts])[own.points.sort]
    here = np.any(own.points.amount[:, kinds], axis=1) & within
    there = float(np.exp(np.logaddexp.reduce(total[here]) - np.logaddexp.reduce(total[within])))
    here &= total > total[here].max() - DEPTH
    points, weighed = _finely(search, b, chosen, own.points.take(np.flatnonzero(here)), kinds)
    total = weighed.terms_log + points.log_prior
    weight = np.exp(total - np.logaddexp.reduce(total))
    sizes = points.amount[:, kinds].max(axis=1) * np.sqrt(weighed.scales_left) * own.unit
    kind = own.noise.kinds[int(np.argmax(points.amount[np.argmax(weight)] * kinds))]
    return sizes, there * weight, kind


def _finely(search: SensorSearch, b: int, chosen: Set, likely: Points, kinds: BoolArray) -> tuple[Points, SetInBlock]:
    """Weigh a set in a block again, at amounts and offsets all over the factor of two that a point stands for.

    At every point of the whole grid that is probable beside the set, of the sorts and profiles of some `likely` ones:
    the search keeps what was so before there was a set, and its grid is coarser than what a night tells of a size.
    """
    noise, profiles = search.blocks[b].noise, np.unique(likely.profile)
    grid = noise.grid
    grid = grid.take(np.flatnonzero(np.isin(grid.sort, likely.sort)))
    prior = [noise.log_profile([*noise.profiles][p]) for p in profiles]
    every = grid.take(np.tile(np.arange(len(grid)), len(profiles)))
    every = replace(
        every,
        profile=np.repeat(profiles, len(grid)),
        log_prior=every.log_prior + np.repeat(prior, len(grid)),
    )
    total = _at_points(search, b, chosen, every).terms_log + every.log_prior
    coarse = every.take(np.flatnonzero(total > total.max() - DEPTH))
    amounts, offsets = (np.exp(_GRID * ((np.arange(n) + 0.5) / n - 0.5)) for n in _STEPS)
    fine = coarse.take(np.repeat(np.arange(len(coarse)), len(amounts) * len(offsets)))
    fine = replace(
        fine,
        amount=fine.amount * np.where(kinds, np.tile(np.repeat(amounts, len(offsets)), len(coarse))[:, None], 1.0),
        offset=fine.offset * np.tile(offsets, len(coarse) * len(amounts)),
    )
    return fine, _at_points(search, b, chosen, fine)


def _at_points(search: SensorSearch, b: int, chosen: Set, points: Points) -> SetInBlock:
    """Weigh a set in a block at other points."""
    own = replace(search.blocks[b], points=points, _filters=())
    own.measure(own.y)
    blocks = [own if place == b else other for place, other in enumerate(search.blocks)]
    return SensorSearch(blocks, search.terms).in_block(chosen, b)


_LEAST = 0.1  # how probable a set is beside the likeliest, for a size: less moves none by as much as its error
_GRID = float(np.log(2.0))
_STEPS = (8, 3)  # of an amount, and of an offset, which only stands beside it


def pooled(found: Sequence[FoundScatter]) -> list[FoundScatter]:
    """Return one entry per effect and sensor: the channels' values, weighed by their errors, both in the logarithm."""
    out = []
    for which in dict.fromkeys((f.effect.id, f.sensor) for f in found):
        own = [f for f in found if (f.effect.id, f.sensor) == which]
        weight = np.array([f.relative**-2 for f in own])
        value = float(np.exp(weight @ np.log([f.value for f in own]) / weight.sum()))
        size = float(np.sqrt(np.mean([f.deg_per_hr**2 for f in own])))
        relative = float(weight.sum() ** -0.5)
        out.append(replace(own[0], channel="", value=value, relative=relative, deg_per_hr=size))
    return out


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
        sure = (middle - known) * mean > BEYOND * error * known  # which is as uncertain as what is seen
        offset2, own2 = (_likely(each, weight, known=sure or certain) for each in (offsets, of_rows))
        here = [f for f in found if (f.sensor, f.channel) == (rows_of.sensor, channel)]
        noisier = False
        if shown is not None and shown.noise_told and not sure:
            usual = np.full((1, len(own.noise.conditions.sensor.channels)), np.median(rows_of.sigma[rows]))
            own2 = float(shown.noise(usual)[0, c] ** 2 + np.median(beside[rows]))
            noisier, error = shown.stated and bool(shown.noise_times[c] > 1.0), own2 * relative
        offset, size = float(np.sqrt(offset2)), float(np.sqrt(max(own2 - known, 0.0)))
        offset_se = offset * float(np.hypot(_GRID / np.sqrt(12.0), 1.0 / np.sqrt(2.0 * runs)))
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


def places(found: Sequence[FoundScatter], chance: float) -> list[Disagreement]:
    """Return the channels that an effect scatters, with by how much."""
    where = [picked(f, "sensor channel") | {"of": "scatter", "effect": f.effect.id} for f in found]
    return [
        Disagreement(at, f.deg_per_hr, f.deg_per_hr * f.relative, chance) for at, f in zip(where, found, strict=True)
    ]
