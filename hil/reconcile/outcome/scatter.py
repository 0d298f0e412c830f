"""The effect on the scatter that was found: how large it is, and in which channels."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtri

from hil.campaign import BoolArray, Conditions, FloatArray
from hil.model.effects.base import Parameter, VarianceEffect
from hil.model.effects.scatter import Scatter
from hil.reconcile.result import Disagreement
from hil.reconcile.search.likely_noise import DEPTH
from hil.reconcile.search.points import Kind, Points
from hil.reconcile.search.posterior import Found, Posterior
from hil.reconcile.search.set_in_block import SetInBlock
from hil.reconcile.search.sets import SensorSearch, Set
from hil.solve.uncertain import CONFIDENCE

GRID = float(np.log(2.0))
"""What a point of the grid of sizes stands for, in logs."""


@dataclass(frozen=True)
class FoundScatter:
    """An effect on the scatter of one sensor: its parameter with value and error, and the `channels` that show it.

    Of all `there` are. A size is as uncertain upwards as downwards in its logarithm: `relative` is the deviation there.
    """

    effect: VarianceEffect
    sensor: int
    channels: tuple[str, ...]
    there: tuple[str, ...]
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
    def some(self) -> tuple[str, ...]:
        """The channels, where they are not all of the sensor's."""
        return () if {*self.channels} == {*self.there} else self.channels

    def parts(self, conditions: Conditions) -> list[Scatter]:
        """Return the independent parts of what n collects scatter by it, deg/hr."""
        of_unit_size = (
            part.within(self.some, conditions.sensor) for part in self.effect.scatter(conditions, self.shape)
        )
        return [replace(part, columns=part.columns * self.value) for part in of_unit_size]

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
            there = tuple(block.noise.conditions.sensor.channels)
            here = tuple(there[c] for c in np.unique(block.block.channel))
            out.append(FoundScatter(kind.effect, number, here, there, kind.shape, kind.parameter, value, spread, size))
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
    amounts, offsets = (np.exp(GRID * ((np.arange(n) + 0.5) / n - 0.5)) for n in _STEPS)
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
        channels = tuple(channel for f in own for channel in f.channels)
        out.append(replace(own[0], channels=channels, value=value, relative=relative, deg_per_hr=size))
    return out


def places(found: Sequence[FoundScatter], chance: float) -> list[Disagreement]:
    """Return the channels that an effect scatters, with by how much."""
    return [
        Disagreement(
            {"sensor": f.sensor, "channel": channel, "of": "scatter", "effect": f.effect.id},
            f.deg_per_hr,
            f.deg_per_hr * f.relative,
            chance,
        )
        for f in found
        for channel in f.channels
    ]
