"""Scale factors and misalignment of gyros from the turns between poses, whose beginnings and ends gravity gives.

    found = fit_turns(log, stretches, f_g, rest_deg_per_hr)
    found.document(), found.sentences  # None where the log has too few turns

While a unit turns with w, f turns along its axes as df/dt = -w × f. With w = (1 + D)(r - b), where r is what the gyros
show and b what they show at rest on both sides, f of one pose must come out as f of the next (D. Tedaldi, A. Pretto,
E. Menegatti, ICRA 2014, the calibration of gyros). D, 3 × 3, is fitted by Gauss and Newton's method, with a prior of
0 ± 0.1 as for the accelerometers; its errors come from the residuals, two for each turn. D_YX is what the rate about X
adds to that about Y. A turn about the vertical leaves f where it was: gravity tells nothing of it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from typing import Any

import numpy as np
from scipy.special import stdtrit

from hil.analysis.log.accelerometer import LEVEL, PRIOR, TOLD, parameters_told
from hil.analysis.log.reading import AXES, Log
from hil.analysis.log.static import Stretch
from hil.campaign import FloatArray
from procedures.words import counted, listed, numbered

NAMES = tuple(f"D_{to}{of}" for to, of in product(AXES, AXES))
_LONGEST_S = 60.0  # beyond, the noise of the integral is what is seen
_STEP, _ITERATIONS = 1e-6, 8
_START_RAD = 1e-3  # of a turn's end: from here the residuals go on
_ASTRAY_DEG = 20.0
_WOUND_RAD = 10.0  # of a turn: from here on a D within its prior brings its end anywhere, and so tells nothing


@dataclass(frozen=True)
class Turns:
    """D as `values` (9,) with `sd` and half of the 95 % interval (9,), of `turns`, whose ends miss by `missed_deg`.

    `turns` are the numbers of the poses that they begin in. `astray` is true where no small D makes rates of turns.
    """

    turns: tuple[int, ...]
    values: FloatArray
    sd: FloatArray
    half: FloatArray
    missed_deg: float
    astray: bool

    def document(self) -> dict[str, Any]:
        """Return what was found, by the parameters' names."""
        parameters = parameters_told(NAMES, self.values, self.sd, self.half, ("1",) * len(NAMES))
        found = {"missed_deg": self.missed_deg, "parameters": {} if self.astray else parameters}
        return {"model": "w = (1 + D)(r - b)", "turns": list(self.turns), **found}

    @property
    def sentences(self) -> list[str]:
        """Say what the turns tell, and what not."""
        which = f"gyros: {counted(len(self.turns), 'turn')} (behind {numbered('collect', self.turns, to='-')})"
        lacking = [name for name, sd in zip(NAMES, self.sd, strict=True) if sd > TOLD * PRIOR]
        if self.astray:
            found = (
                f"the integral of the rates misses the next pose by {self.missed_deg:.0f} deg: the unit, a sign or the "
                "order of the gyros' columns is wrong, or the axes are left-handed"
            )
        else:
            found = f"their ends come out to {self.missed_deg:.2g} deg rms with D of the gyros fitted"
            if lacking:
                found += f"; not told: {listed(lacking)} (a turn about the vertical is invisible to gravity)"
        return [f"{which}: {found}"]


def fit_turns(log: Log, stretches: Sequence[Stretch], f_g: FloatArray, rest_deg_per_hr: FloatArray) -> Turns | None:
    """Fit to the turns between neighbouring poses of `f_g` and rates at rest, (n, 3) each.

    None where there are too few: it takes five without a gap in time that are no longer than a minute.
    """
    segment = np.cumsum(log.begins)
    chosen = [
        (k, slice(one.rows.stop - 1, other.rows.start + 1))
        for k, (one, other) in enumerate(pairwise(stretches))
        if segment[one.rows.start] == segment[other.rows.start]
        and log.time_s[other.rows.start] - log.time_s[one.rows.stop - 1] <= _LONGEST_S
    ]
    if 2 * len(chosen) <= len(NAMES):
        return None
    longest = max(rows.stop - rows.start for _, rows in chosen) - 1
    angle = np.zeros((longest, len(chosen), 3))  # r - b over each step, rad; nothing behind the end of a turn
    for t, (k, rows) in enumerate(chosen):
        rates = log.rates_deg_per_hr[rows] - 0.5 * (rest_deg_per_hr[k] + rest_deg_per_hr[k + 1])
        steps = 0.5 * (rates[1:] + rates[:-1]) * np.diff(log.time_s[rows])[:, None]
        angle[: len(steps), t] = np.deg2rad(steps / 3600.0)
    begin = np.array([k for k, _ in chosen])
    first = np.degrees(np.sqrt(np.mean(_missed(np.zeros((1, 9)), angle, f_g[begin], f_g[begin + 1]) ** 2) * 3.0))
    values, sigma = np.zeros(9), _START_RAD
    for _ in range(_ITERATIONS):
        trials = values + np.vstack([np.zeros(9), _STEP * np.eye(9)])
        missed = _missed(trials, angle, f_g[begin], f_g[begin + 1]).reshape(10, -1)
        slopes = (missed[1:] - missed[0]).T / _STEP
        information = slopes.T @ slopes / sigma**2
        covariance = np.linalg.inv(information + np.eye(9) / PRIOR**2)
        freedom = 2 * len(begin) - float(np.trace(covariance @ information))
        values = values - covariance @ (slopes.T @ missed[0] / sigma**2 + values / PRIOR**2)
        sigma = float(np.sqrt(missed[0] @ missed[0] / max(freedom, 1.0)))
    sd = np.sqrt(np.diag(covariance))
    missed_deg = float(np.degrees(np.sqrt(missed[0] @ missed[0] / len(begin))))
    wound = float(np.median(np.linalg.norm(angle, axis=-1).sum(axis=0))) > _WOUND_RAD
    astray = min(float(first), np.inf if wound else missed_deg) > _ASTRAY_DEG
    missed_deg = float(first) if astray else missed_deg
    half = sd * float(stdtrit(max(freedom, 1.0), LEVEL))
    return Turns(tuple((begin + 1).tolist()), values, sd, half, missed_deg, astray)


def _missed(trials: FloatArray, angle: FloatArray, before: FloatArray, after: FloatArray) -> FloatArray:
    """Return by how much f (t, 3), turned by the steps (m, t, 3) under each of the D (p, 9), misses: (p, t, 3)."""
    gain = np.eye(3) + trials.reshape(-1, 3, 3)
    f = np.broadcast_to(before, (len(gain), *before.shape))
    for step in angle:
        w = np.einsum("pij,tj->pti", gain, step)
        size = np.linalg.norm(w, axis=-1, keepdims=True)
        axis = w / np.where(size > 0.0, size, 1.0)
        along = np.sum(axis * f, axis=-1, keepdims=True) * axis
        f = along + (f - along) * np.cos(size) - np.cross(axis, f) * np.sin(size)
    return np.asarray(f - after)
