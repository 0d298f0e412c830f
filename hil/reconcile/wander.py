"""The noise inside the collects as white noise and flicker, where it is coloured: by moments of the series.

A standard error that allows for correlated samples holds both; drawn as white noise they would be another noise.

    wander = wandering(campaign, 1)  # None where white noise is all that shows
    wander.size, wander.se           # bias instability, deg/hr
"""

from dataclasses import dataclass
from functools import cache

import numpy as np

from hil.campaign import Campaign, Conditions, FloatArray
from hil.model.effects.columns import middle_hr
from hil.model.effects.inside import FEWEST, FEWEST_BESIDE
from hil.model.effects.noise import BiasInstability
from hil.model.effects.scatter import Scatter
from hil.model.effects.series import blocked

_BEYOND = 3.0  # errors from which on what neighbours leave unexplained is not chance
_USUAL = 0.5  # of the mean is what half of the collects show at least: .9 of flicker
_FINE = 5  # points by which a block is averaged


@dataclass(frozen=True)
class Wander:
    """Bias instability `size` ± `se`, deg/hr, and the white noise beside it, `white` (n, c), deg/√hr, of some collects.

    `within` and `between` are what it scatters averages by inside a run and from run to run, deg/hr.
    """

    size: float
    se: float
    conditions: Conditions
    white: FloatArray
    within: float
    between: float


def wandering(campaign: Campaign, number: int) -> Wander | None:
    """Return what the series of a sensor show beyond chance, over all its collects and channels.

    Half the variance of neighbouring blocks' differences is that of the white noise, and so is the variance about a
    straight line; each has as much of flicker on top as the covariance of that says.
    """
    rows = campaign.sensors[number].conditions
    parts = BiasInstability().scatter(rows, {})
    sizes = np.array([part.columns[0, 0, 0] ** 2 for part in parts])
    seen = np.full((5, len(rows), len(rows.sensor.channels)), np.nan)
    for row, collect in enumerate(rows.collect.tolist()):
        if (series := campaign.series(collect)) is None:
            continue
        for channel in range(seen.shape[2]):
            times, rates = blocked(series, channel)
            if len(rates) >= FEWEST:
                x, block_s = times - times.mean(), round(float(np.median(np.diff(times))), 3)
                left = rates - rates.mean() - x * (x @ rates / (x @ x))
                moments = float(np.mean(np.diff(rates) ** 2)) / 2.0, float(left @ left) / (len(rates) - 2)
                of_flicker = sizes @ [_moments(float(part.tau_s or 0.0), len(rates), block_s) for part in parts]
                seen[:, row, channel] = *moments, *of_flicker, block_s / 3600.0
    known = seen[:, np.isfinite(seen[0])]
    if known.shape[1] < FEWEST_BESIDE:
        return None
    more, unit = known[1] - known[0], float(np.mean(known[3] - known[2]))
    square, error = float(more.mean()) / unit, float(more.std()) / len(more) ** 0.5 / unit
    white = np.sqrt(np.maximum(seen[0] - seen[2] * square, 0.0) * seen[4])
    often = np.median(more) > _USUAL * more.mean()  # what a few collects show is no noise of all
    if not often or square <= _BEYOND * error or np.nanmedian(white) <= 0.0:
        return None
    hours, runs = middle_hr(rows), [rows.run == run for run in np.unique(rows.run)]
    middles = np.array([hours[run].mean() for run in runs])
    of_runs = np.array([np.mean([part.between(part, hours[run], hours[run]).mean() for run in runs]) for part in parts])
    of_all = np.array([part.between(part, middles, middles).mean() for part in parts])
    within, between = sizes @ (1.0 - of_runs), sizes @ np.maximum(of_runs - of_all, 0.0)
    size = square**0.5
    return Wander(size, error / (2.0 * size), rows, white, size * float(within) ** 0.5, size * float(between) ** 0.5)


@cache
def _moments(tau_s: float, count: int, block_s: float) -> tuple[float, float]:
    """Return what a wander of unit size adds to half the variance of steps from block to block, and to that of blocks.

    That is about a straight line through all the blocks of a series.
    """
    fine = (np.arange(count * _FINE) + 0.5) * block_s / _FINE / 3600.0
    wanders = Scatter(np.ones((1, 1, 1)), tau_s=tau_s)
    alike = wanders.between(wanders, fine, fine)
    blocks = alike.reshape(count, _FINE, count, _FINE).mean(axis=(1, 3))
    line, _ = np.linalg.qr(np.stack([np.ones(count), np.arange(count) - 0.5 * (count - 1)], axis=1))
    left = float(np.trace(blocks) - np.trace(line.T @ blocks @ line)) / (count - 2)
    return float(blocks.diagonal().mean() - blocks.diagonal(1).mean()), left
