"""What the averages scatter by: stated and observed, of every channel, and the effect on the scatter that was found."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hil.campaign import Conditions, FloatArray, IntArray
from hil.model import Model
from hil.model.curve import Constant
from hil.model.effects.base import Parameter, VarianceEffect
from hil.model.forms import bias_names
from hil.model.stated_noise import SensorNoise
from hil.reconcile.result import Disagreement
from hil.reconcile.search.fitted import Fitted, FittedBlock
from hil.reconcile.search.noise import Points
from hil.reconcile.search.posterior import Posterior
from hil.reconcile.search.set_in_block import SetInBlock
from hil.reconcile.search.sets import SensorSearch, Set

EXCESS = 1.5
"""Times the standard errors, from which on it is said that the averages scatter by more."""


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
        return {
            "low": self.value * np.exp(-_WIDTH * self.relative),
            "high": self.value * np.exp(_WIDTH * self.relative),
        }


def found_scatter(
    posterior: Posterior, chosen: Mapping[int, Set], fit: Fitted, name: str, conditions: Mapping[int, Conditions]
) -> list[FoundScatter]:
    """Return what was found of one effect on the scatter, one entry per block in which it is more probable than not."""
    out = []
    for block in fit.blocks:
        own = block.search
        sensor = own.block.sensor
        search = posterior.searches[sensor]
        b = next(i for i, s in enumerate(search.blocks) if s is own)
        weighed = search.in_block(chosen[sensor], b)
        total = weighed.terms_log + own.points.log_prior
        kinds = [k for k, kind in enumerate(own.noise.kinds) if kind.effect.id == name]
        here = np.isin(own.points.kind, kinds)
        if not here.any() or np.logaddexp.reduce(total[here]) < np.logaddexp.reduce(total[own.points.kind < 0]):
            continue
        here &= total > total[here].max() - _TOLD
        points, weighed = _finely(search, chosen[sensor], b, np.flatnonzero(here))
        total = weighed.terms_log + points.log_prior
        weight = np.exp(total - np.logaddexp.reduce(total))
        scales = np.array([weighed.left_at(t)[1] for t in range(len(points))])
        sizes = points.amount * np.sqrt(scales) * own.unit
        best = own.noise.kinds[int(points.kind[np.argmax(weight)])]
        log_mean = float(weight @ np.log(sizes))
        spread = float(np.sqrt(weight @ (np.log(sizes) - log_mean) ** 2))
        size = float(np.exp(log_mean))
        value = size / best.unit_deg_per_hr
        channel = list(conditions[sensor].sensor.channels)[int(own.block.channel[0])]
        out.append(FoundScatter(best.effect, sensor, channel, best.shape, best.parameter, value, spread, size))
    return out


def _finely(search: SensorSearch, chosen: Set, b: int, at: IntArray) -> tuple[Points, SetInBlock]:
    """Weigh a set in a block again, for each of some points at amounts all over the factor of two that it stands for.

    The search's own grid is coarser than what a night tells of a size.
    """
    steps = np.exp(_GRID * ((np.arange(_STEPS) + 0.5) / _STEPS - 0.5))
    coarse = search.blocks[b].points.take(np.repeat(at, _STEPS))
    fine = replace(coarse, amount=coarse.amount * np.tile(steps, len(at)))
    block = replace(search.blocks[b], points=fine, _filters=())
    block.measure(block.y)
    blocks = [block if k == b else other for k, other in enumerate(search.blocks)]
    return fine, SensorSearch(blocks, search.terms).in_block(chosen, b)


_GRID = float(np.log(2.0))
_STEPS = 8
_TOLD = 9.0  # logs below the most probable: what is less so says nothing of a size
_WIDTH = 1.96


def pooled(found: Sequence[FoundScatter]) -> list[FoundScatter]:
    """Return one entry per sensor: the channels' values, weighed by their errors, both in the logarithm."""
    out = []
    for sensor in dict.fromkeys(f.sensor for f in found):
        own = [f for f in found if f.sensor == sensor]
        weight = np.array([f.relative**-2 for f in own])
        value = float(np.exp(weight @ np.log([f.value for f in own]) / weight.sum()))
        size = float(np.sqrt(np.mean([f.deg_per_hr**2 for f in own])))
        relative = float(weight.sum() ** -0.5)
        out.append(replace(own[0], channel="", value=value, relative=relative, deg_per_hr=size))
    return out


def ordinary(
    posterior: Posterior,
    chosen: Mapping[int, Set],
    fit: Fitted,
    conditions: Mapping[int, Conditions],
    found: Sequence[FoundScatter],
    model: Sequence[str],
) -> list[dict[str, Any]]:
    """Return what every channel's averages scatter by, beside what their standard errors explain: key `noise`.

    `model` names what the averages scatter about: a form, and what was added to it.
    """
    out = []
    for block in fit.blocks:
        own = block.search.block
        variance, offset = _observed(posterior.searches[own.sensor], chosen[own.sensor], block)
        channels = list(conditions[own.sensor].sensor.channels)
        for c in np.unique(own.channel):
            rows = own.channel == c
            observed = float(np.sqrt(np.mean(variance[rows])))
            stated = float(np.sqrt(np.mean(own.sigma[rows] ** 2))) if own.sigma_stated else None
            known = own.sigma**2 + block.search.noise.stated_variance() if own.sigma_stated else None
            scatter = [f for f in found if (f.sensor, f.channel) == (own.sensor, channels[c])]
            out.append(
                {
                    "sensor": own.sensor,
                    "channel": channels[c],
                    "under": " + ".join(model) + ", calibrated at each temperature" * block.calibrated,
                    "stated_deg_per_hr": stated,
                    "explained_deg_per_hr": None if known is None else float(np.sqrt(np.mean(known[rows]))),
                    "observed_deg_per_hr": observed,
                    "run_offset_deg_per_hr": offset,
                    "scatter": [{"id": f.effect.id, "deg_per_hr": f.deg_per_hr} for f in scatter],
                }
            )
    return out


def _observed(search: SensorSearch, chosen: Set, block: FittedBlock) -> tuple[FloatArray, float]:
    """Return the variance of a block's rows, (N,), (deg/hr)², and the offset of a run in it, deg/hr.

    The mean over all that is probable with the kind of scatter that was found: a point of the grid is a factor of two.
    """
    own = block.search
    weighed, points = search.in_block(chosen, next(i for i, s in enumerate(search.blocks) if s is own)), own.points
    total = np.where(points.kind == points.kind[block.at], weighed.terms_log + points.log_prior, -np.inf)
    scales = np.array([weighed.left_at(t)[1] for t in range(len(points))])
    weight = np.exp(total - np.logaddexp.reduce(total)) * scales * own.unit**2
    return weight @ own.noise.variance(points), float(np.sqrt(weight @ points.offset**2))


def with_offsets(model: Model, noise: Sequence[Mapping[str, Any]], conditions: Mapping[int, Conditions]) -> Model:
    """Return the model with the ordinary offset of each run as well: `run_to_run` of every bias that states none."""
    sections = dict(model.noise)
    for each in noise:
        own, size = conditions[each["sensor"]], each["run_offset_deg_per_hr"]
        stated = sections.get(each["sensor"], SensorNoise())
        name = bias_names(own.sensor)[list(own.sensor.channels).index(each["channel"])]
        if size > 0.0 and name not in stated.run_to_run:
            se = size * float(np.hypot(_GRID / np.sqrt(12.0), 1.0 / np.sqrt(2.0 * len(np.unique(own.run)))))
            offsets = {**stated.run_to_run, name: Constant(unit="deg/hr", value=size, se=se)}
            sections[each["sensor"]] = stated.model_copy(update={"run_to_run": offsets})
    return model.model_copy(update={"noise": sections})


def places(found: Mapping[str, Sequence[FoundScatter]], chance: float) -> list[Disagreement]:
    """Return the channels that an effect scatters, with by how much."""
    return [
        Disagreement({"sensor": f.sensor, "channel": f.channel}, f.deg_per_hr, f.deg_per_hr * f.relative, chance)
        for several in found.values()
        for f in several
    ]


def in_words(noise: Sequence[Mapping[str, Any]]) -> list[str]:
    """Say where the averages scatter by more than standard errors and model explain, one sentence per channel."""
    return [
        f"sensor {n['sensor']}, {n['channel']}: about {n['under']}, the averages scatter "
        f"{n['observed_deg_per_hr'] / n['explained_deg_per_hr']:.2g} times as much as their standard errors "
        f"{'and the model say' if n['explained_deg_per_hr'] > 1.01 * n['stated_deg_per_hr'] else 'say'}, "
        f"by {n['observed_deg_per_hr']:.3g} deg/hr"
        for n in noise
        if n["stated_deg_per_hr"] and n["observed_deg_per_hr"] > EXCESS * n["explained_deg_per_hr"]
    ]
