"""How a unit's own parameters scatter from run to run, which of that no repeat averages, and the noise of its collects.

    of = scatter_of_unit(campaign)[2]
    of.sizes["MUA"]        # 4.0: one standard deviation beyond standard errors
    of.at_most["MUA"]      # 12.4: what it may be, as far as so few repeats tell
    of.lasting             # ("BA",): what ages, jumps or differs from visit to visit is the same in neighbouring runs

A mean of repeats is as much surer as they are independent. Runs of a unit that ages follow each other along a line, and
what a temperature's history leaves is the same through a visit: more of them tell no more.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.special import chdtri

from hil.campaign import Campaign, Collects, FloatArray
from hil.model.effects.columns import HOUR_S
from hil.solve.repeats import SensorRepeats, repeats
from hil.solve.runs import solve_campaign
from hil.solve.uncertain import CONFIDENCE, Spread
from hil.solve.wrong_rows import treated


@dataclass(frozen=True)
class UnitScatter:
    """One sensor's: `sizes` by parameter, deg/hr and deg/hr/g, the `lasting`, which repeats do not average, and why.

    No size is larger than `at_most` with a probability of 95 %: of few repeats it is known badly. `noise` is what its
    collects show of it by channel, deg/√hr; none where nothing tells it.
    """

    sizes: Mapping[str, float] = field(default_factory=dict)
    at_most: Mapping[str, float] = field(default_factory=dict)
    lasting: tuple[str, ...] = ()
    said: tuple[str, ...] = ()
    noise: Mapping[str, float] = field(default_factory=dict)


def scatter_of_unit(campaign: Campaign) -> dict[int, UnitScatter]:
    """Return what repeats show beyond standard errors of each sensor that has some."""
    out = {}
    for number, shown in repeats(campaign, solve_campaign(campaign)).items():
        if shown.repeated:
            both = (shown.spread.beyond, _at_most(shown.spread))
            sizes, at_most = (dict(zip(shown.names, of.tolist(), strict=True)) for of in both)
            said = (*shown.between.in_words, *shown.uneven_in_words)
            noise = _noise(shown, treated(campaign).sensors[number])
            out[number] = UnitScatter(sizes, at_most, tuple(shown.between.lasting), said, noise)
    return out


def _noise(shown: SensorRepeats, rows: Collects) -> dict[str, float]:
    """Return the noise of the usual collect by channel, deg/√hr, where it is known of all: as every command has it."""
    every = shown.noise(rows.rates_se_deg_per_hr) * np.sqrt(rows.conditions.duration_s / HOUR_S)[:, None]
    of_each = [own[np.isfinite(own) & (own > 0.0)] for own in every.T]
    if not all(own.size for own in of_each):
        return {}
    return {name: float(np.median(own)) for name, own in zip(shown.channels, of_each, strict=True)}


def _at_most(spread: Spread) -> FloatArray:
    """Return what parameters (p,) scatter by beyond standard errors at most: the variance of a run is chi-square's."""
    freedom = np.clip(spread.freedom, 1.0, 1e6)
    stated = np.where(spread.degrees > 0, spread.stated, 0.0) ** 2
    whole = (stated + spread.beyond**2) * freedom / chdtri(freedom, CONFIDENCE)
    return np.where(spread.degrees > 0, np.sqrt(np.maximum(whole - stated, 0.0)), spread.beyond)
