"""What makes repeats scatter: told from how the bias, Collect 3 and their difference MU scatter together.

    >>> signature = scatter_signature([repeats_of_sigmas("A", sigma_c=4.64, sigma_m=1.90, sigma_mu=4.11, runs=19)])
    >>> {name: round(float(each), 2) for name, each in signature.probabilities.items()}
    {'white': 0.03, 'bias': 0.0, 'collect_3': 0.0, 'bias_and_collect_3': 0.97, 'drift': 0.0}
    >>> signature.verdict  # None where these repeats cannot tell
    'bias_and_collect_3'
    >>> print(signature.sentence)
    19 runs: bias and MU (or Collect 3) both change from run to run (probability 0.97)

C is the contractor's bias, which is what Collect 3 shows (B + MU at 1 g, eqs. 5, 6); M is the matrix bias, the mean of
Collects 1 and 2 (eqs. 9, 10); C - M is MU. With the collects in the order 1-2-3 their standard deviations and the
correlation of C with M are

    white noise within collects     (1 : 0.707 : 1.225),  0
    bias from run to run            (1 : 1 : 0),         +1
    MU, or Collect 3 alone          (1 : 0 : 1)
    drift from collect to collect   (1 : 0.5 : 1.5),     -1

For other sequences the solver's own response takes the place of these numbers. Each hypothesis is white noise of the
stated size plus its own effect, whose size in C is taken to lie, log-uniformly, between half and forty times that
noise; so the probabilities are calibrated: of the cases given 90 %, nine in ten are so. They compare these hypotheses
with one another and say nothing of a sixth.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import softmax
from scipy.stats import chi2, f

from hil.campaign import FloatArray

HYPOTHESES: Mapping[str, str] = {
    "white": "white noise within the collects",
    "bias": "the bias changes from run to run",
    "collect_3": "MU, or something else in Collect 3 alone, changes from run to run",
    "bias_and_collect_3": "bias and MU (or Collect 3) both change from run to run",
    "drift": "a drift from collect to collect",
}
"""What repeats may scatter by, in the order of every array of probabilities."""

NAMED = 0.9
"""A hypothesis is named where it has this probability; below it, the repeats cannot tell."""

CONFIDENCE = 0.95

QUIET_COLLECT_DEG_PER_HR = 0.9
"""White noise of a collect where none is stated: Table 1's quiet cells show 0.96, within what four cells can tell."""

PUBLISHED_RAMP = (1.0, -0.5)
"""What a rate rising by 1 deg/hr from each collect to the next, about its mean, adds to C and M in the order 1-2-3."""

_SMALLEST, _LARGEST, _SIZES, _SIZES_OF_TWO = 0.5, 40.0, 48, 24
_DRAWS = 20_000


@dataclass(frozen=True)
class Repeats:
    """How one channel's C and M scattered over `runs` repeats at one temperature.

    `squares` (2, 2) are the sums of squares and products of (C, M) about their means, (deg/hr)²; `white` (2, 2) is the
    covariance that the collects' own noise gives a single run; `ramp` (2,) is how C and M answer to a drift of 1 deg/hr
    per collect, zero where the sequence is immune to it.
    """

    sensor: int
    axis: str
    temperature_degC: float | None
    runs: int
    squares: FloatArray
    white: FloatArray
    ramp: FloatArray


@dataclass(frozen=True)
class Interval:
    """A value with the bounds between which it lies with 95 % confidence; None where nothing is known."""

    value: float | None
    low: float | None
    high: float | None


@dataclass(frozen=True)
class ScatterSignature:
    """How one channel scattered, at one temperature (`temperature_degC`) or pooled over several (None).

    `sigma_c`, `sigma_m`, `sigma_mu` in deg/hr (MU at 1 g); `correlation` of C with M. `more_in_collect_3_p` is the
    probability under white noise alone of C scattering so much more than M. `probabilities` are those of `HYPOTHESES`
    (empty where the sigmas contradict each other); `verdict` is the one that is named, None where none can be.
    """

    sensor: int
    axis: str
    temperature_degC: float | None
    temperatures: int
    runs: int
    degrees_of_freedom: int
    sigma_c: Interval
    sigma_m: Interval
    sigma_mu: Interval
    correlation: Interval
    more_in_collect_3_p: float | None
    probabilities: Mapping[str, float]
    verdict: str | None
    sentence: str

    def document(self) -> dict[str, Any]:
        """Return what `hil solve --json` and `hil scatter --json` print of it."""
        spread = {"sigma_c": self.sigma_c, "sigma_m": self.sigma_m, "sigma_mu": self.sigma_mu}
        return {
            "sensor": self.sensor,
            "axis": self.axis,
            "temperature_degC": self.temperature_degC,
            "temperatures": self.temperatures,
            "runs": self.runs,
            "degrees_of_freedom": self.degrees_of_freedom,
            **{f"{name}_deg_per_hr": vars(each) for name, each in spread.items()},
            "correlation": vars(self.correlation),
            "more_in_collect_3_p": self.more_in_collect_3_p,
            "probabilities": dict(self.probabilities),
            "verdict": self.verdict,
            "sentence": self.sentence,
        }


def repeats_of_sigmas(
    axis: str,
    sigma_c: float,
    sigma_m: float,
    sigma_mu: float,
    runs: int,
    *,
    collect_noise_deg_per_hr: float = QUIET_COLLECT_DEG_PER_HR,
    temperature_degC: float | None = None,
    sensor: int = 2,
) -> Repeats:
    """Return repeats as a table prints them: three standard deviations over n - 1, for the order 1-2-3.

    The covariance of C and M follows from the three: (σC² + σM² - σMU²) / 2.
    """
    both = 0.5 * (sigma_c**2 + sigma_m**2 - sigma_mu**2)
    squares = (runs - 1) * np.array([[sigma_c**2, both], [both, sigma_m**2]])
    white = collect_noise_deg_per_hr**2 * np.diag([1.0, 0.5])
    return Repeats(sensor, axis, temperature_degC, runs, squares, white, np.array(PUBLISHED_RAMP))


def scatter_signature(groups: Sequence[Repeats]) -> ScatterSignature:
    """Tell what made one channel's repeats scatter, from one temperature or from several together.

    Several share the hypothesis, each with a size of its own; those whose printed sigmas contradict each other are left
    out. Raises ValueError where there is nothing to tell: no group, groups of different channels, no run repeated.
    """
    if not groups or len({(group.sensor, group.axis) for group in groups}) != 1:
        raise ValueError("the repeats of one channel are needed")
    first, given = groups[0], len(groups)
    possible = [group for group in groups if _possible(group.squares)]
    groups = possible or groups
    runs = sum(group.runs for group in groups)
    degrees = runs - len(groups)
    if degrees < 1:
        raise ValueError("nothing was repeated: a scatter needs two runs at one temperature")
    squares = np.sum([group.squares for group in groups], axis=0)
    probabilities: dict[str, float] = {}
    if possible:
        evidence = np.sum([log_evidence(each.squares, each.runs - 1, each.white, each.ramp) for each in groups], axis=0)
        probabilities = dict(zip(HYPOTHESES, posterior(evidence).tolist(), strict=True))
    best = max(probabilities, key=lambda name: probabilities[name], default=None)
    verdict = best if best is not None and probabilities[best] >= NAMED else None
    mu = np.array([1.0, -1.0])
    return ScatterSignature(
        first.sensor,
        first.axis,
        first.temperature_degC if given == 1 else None,
        len(groups),
        runs,
        degrees,
        _sigma(squares[0, 0], degrees),
        _sigma(squares[1, 1], degrees),
        _sigma(float(mu @ squares @ mu), degrees),
        correlation_interval(_correlation(squares), degrees),
        more_in_collect_3_p(squares, degrees, np.mean([group.white for group in groups], axis=0)) if possible else None,
        probabilities,
        verdict,
        _sentence(runs, len(groups), given - len(groups), probabilities, verdict),
    )


def log_evidence(squares: FloatArray, degrees: int, white: FloatArray, ramp: FloatArray) -> FloatArray:
    """Return the log evidence of every hypothesis, shape (..., 5), for sums of squares (..., 2, 2).

    The density of normal (C, M) with unknown means, integrated over the sizes of each hypothesis's effects (white noise
    may with probability one half be the stated one and no more); constants that all share are left out. A drift to
    which the sequence is immune has evidence minus infinity.
    """
    noise = float(white[0, 0])
    constant, alone = np.ones((2, 2)), np.diag([1.0, 0.0])
    largest = float(np.max(np.abs(ramp)))
    drift = np.outer(ramp, ramp) / largest**2 if largest > 1e-3 else None
    sizes = noise * np.geomspace(_SMALLEST, _LARGEST, _SIZES) ** 2
    few = noise * np.geomspace(_SMALLEST, _LARGEST, _SIZES_OF_TWO) ** 2
    of_one = sizes[:, None, None]
    of_two = few[:, None, None, None] * constant + few[:, None, None] * alone
    nothing_more = _mean_density(squares, degrees, white[None])
    more_of_it = _mean_density(squares, degrees, white + of_one * white / noise)
    return np.stack(
        [
            np.logaddexp(nothing_more, more_of_it) - math.log(2.0),
            _mean_density(squares, degrees, white + of_one * constant),
            _mean_density(squares, degrees, white + of_one * alone),
            _mean_density(squares, degrees, white + of_two.reshape(-1, 2, 2)),
            np.full(squares.shape[:-2], -np.inf)
            if drift is None
            else _mean_density(squares, degrees, white + of_one * drift),
        ],
        axis=-1,
    )


def posterior(evidence: FloatArray) -> FloatArray:
    """Return the probabilities (..., 5) of hypotheses that are equally likely beforehand."""
    return np.asarray(softmax(evidence, axis=-1))


def correlation_interval(correlation: float | None, degrees: int) -> Interval:
    """Return the exact 95 % interval of a correlation that was estimated with n - 1 = `degrees`.

    Berger and Sun (Annals of Statistics 36, 2008, eq. 30): the posterior under the right-Haar prior, whose intervals
    cover exactly. With two runs nothing is known.
    """
    if correlation is None or abs(correlation) > 1.0 or degrees < 2:
        return Interval(correlation, None, None)
    rng = np.random.default_rng(0)
    sine = math.sqrt(max(1.0 - correlation**2, 1e-12))
    first, second = rng.chisquare(degrees, _DRAWS), rng.chisquare(degrees - 1, _DRAWS)
    tangent = (np.sqrt(second) * correlation / sine - rng.standard_normal(_DRAWS)) / np.sqrt(first)
    low, high = np.quantile(tangent / np.hypot(1.0, tangent), [0.5 * (1 - CONFIDENCE), 0.5 * (1 + CONFIDENCE)])
    return Interval(correlation, float(low), float(high))


def more_in_collect_3_p(squares: FloatArray, degrees: int, white: FloatArray) -> float:
    """Return the probability that white noise of any size makes C scatter this much more than M (an F test).

    `squares` (2, 2) are sums of squares and products of C and M, `white` (2, 2) the covariance of unit white noise.
    """
    own = np.linalg.inv(np.linalg.cholesky(white))
    ratio = own @ squares @ own.T
    return float(f.sf(ratio[0, 0] / max(ratio[1, 1], 1e-300), degrees, degrees))


def _mean_density(squares: FloatArray, degrees: int, covariances: FloatArray) -> FloatArray:
    """Return the log of the mean over k covariances (k, 2, 2) of the density of `squares` (..., 2, 2), shape (...)."""
    a, b, c = covariances[:, 0, 0], covariances[:, 0, 1], covariances[:, 1, 1]
    determinant = a * c - b * b
    spread = (
        c * squares[..., 0, 0, None] - 2.0 * b * squares[..., 0, 1, None] + a * squares[..., 1, 1, None]
    ) / determinant
    logs = -0.5 * (degrees * np.log(determinant) + spread)
    return np.asarray(np.logaddexp.reduce(logs, axis=-1) - math.log(len(covariances)))


def _possible(squares: FloatArray) -> bool:
    """Tell whether these can be sums of squares at all: printed sigmas may contradict each other."""
    return bool(squares[0, 1] ** 2 <= squares[0, 0] * squares[1, 1] * (1.0 + 1e-9))


def _correlation(squares: FloatArray) -> float | None:
    scale = math.sqrt(squares[0, 0] * squares[1, 1])
    return float(squares[0, 1] / scale) if scale > 0.0 else None


def _sigma(square: float, degrees: int) -> Interval:
    value = math.sqrt(max(square, 0.0) / degrees)
    low, high = chi2.ppf([0.5 * (1 + CONFIDENCE), 0.5 * (1 - CONFIDENCE)], degrees)
    return Interval(value, value * math.sqrt(degrees / low), value * math.sqrt(degrees / high))


def _sentence(
    runs: int, temperatures: int, left_out: int, probabilities: Mapping[str, float], verdict: str | None
) -> str:
    where = f"{runs} runs" if temperatures == 1 else f"{runs} runs at {temperatures} temperatures"
    if left_out:
        where += f" ({left_out} left out: standard deviations that contradict each other)"
    if not probabilities:
        return (
            f"{where}: the three standard deviations contradict each other (a correlation beyond ±1), so one is wrong"
        )
    ranked = sorted(probabilities.items(), key=lambda each: -each[1])
    if verdict is not None:
        return f"{where}: {HYPOTHESES[verdict]} (probability {probabilities[verdict]:.2f})"
    left = "; ".join(f"{HYPOTHESES[name]} ({value:.2f})" for name, value in ranked if value >= 0.05)
    excluded = [HYPOTHESES[name] for name, value in ranked if 0.0 < value < 0.01]
    without = f". Hardly: {'; '.join(excluded)}" if excluded else ""
    return f"{where} cannot tell: {left}{without}"
