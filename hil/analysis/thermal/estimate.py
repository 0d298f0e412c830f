"""Generalised least squares over all rows of a sensor: parameters free at every temperature, or along chosen forms.

One system for all positions and temperatures: the columns of the measurement equation, each times a basis in
temperature. Where temperatures were reached from both sides, half the difference is a parameter of its own, so that the
curve is the middle one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from hil.analysis.thermal.noise import RateNoise
from hil.analysis.thermal.stations import Stations
from hil.campaign import Collects, FloatArray
from hil.model.forms import LinearForm
from hil.solve import solve

CONFIDENCE = 0.95
_PRIOR_ROWS = 3  # stated standard errors count as much as this many rows (see ScalePrior)


@dataclass(frozen=True)
class Layout:
    """The rows of one sensor with its columns: `columns` (n, c, p) of the form, and how temperature enters.

    `middle_degC` and `half_degC` scale temperature to -1 … 1 for polynomials. `hysteresis` says that half the
    difference between the two directions is estimated.
    """

    collects: Collects
    form: LinearForm
    columns: FloatArray
    stations: Stations
    middle_degC: float
    half_degC: float
    hysteresis: bool

    @property
    def temperature_degC(self) -> FloatArray:
        """The temperature of each row, (n,)."""
        return np.asarray(self.collects.conditions.columns["temperature_degC"])

    def station_basis(self) -> FloatArray:
        """One column per temperature, (n, S)."""
        return np.asarray(self.stations.number[:, None] == np.arange(len(self.stations)), dtype=np.float64)

    def power_basis(self, order: int) -> FloatArray:
        """Powers of the scaled temperature, (n, order + 1)."""
        return self.powers(self.temperature_degC, order)

    def powers(self, temperature_degC: FloatArray, order: int) -> FloatArray:
        """Powers of the scaled temperature at k temperatures, (k, order + 1)."""
        scaled = (temperature_degC - self.middle_degC) / self.half_degC
        return np.asarray(np.polynomial.polynomial.polyvander(scaled, order))

    def design(self, bases: Sequence[FloatArray]) -> FloatArray:
        """Return the columns of every parameter along its basis (n, k_p), parameter by parameter, (n, c, q)."""
        parts = [self.columns[:, :, [p]] * basis[:, None, :] for p, basis in enumerate(bases)]
        if self.hysteresis:
            parts.append(self.columns * (0.5 * self.stations.direction)[:, None, None])
        return np.concatenate(parts, axis=2)


@dataclass(frozen=True)
class Estimates:
    """Values (q,) with their covariance, and the degrees of freedom behind each variance (infinite where stated)."""

    values: FloatArray
    covariance: FloatArray
    freedom: FloatArray
    chi_square: float

    @property
    def se(self) -> FloatArray:
        """Standard errors, (q,)."""
        return np.sqrt(np.diagonal(self.covariance))

    @property
    def half_width(self) -> FloatArray:
        """Half the width of each interval at `CONFIDENCE`, (q,)."""
        return np.asarray(self.se * student.ppf(0.5 + 0.5 * CONFIDENCE, self.freedom))

    def part(self, start: int, count: int) -> Estimates:
        """Return `count` values from `start` on."""
        here = slice(start, start + count)
        return Estimates(self.values[here], self.covariance[here, here], self.freedom[here], self.chi_square)

    def scaled(self, factors: FloatArray) -> Estimates:
        """Return each value times a factor, (q,)."""
        return Estimates(
            self.values * factors, self.covariance * np.outer(factors, factors), self.freedom, self.chi_square
        )


def estimate(layout: Layout, noise: RateNoise, bases: Sequence[FloatArray]) -> Estimates:
    """Fit all parameters along their bases, (n, k_p), at once; hysteresis last, one value per parameter."""
    rates = layout.collects.rates_deg_per_hr - layout.collects.conditions.w_channels_deg_per_hr
    design = layout.design(bases)[noise.row, noise.channel]
    covariance = noise.covariance
    solution = solve(design, rates[noise.row, noise.channel], covariance=covariance)
    operator = solution.covariance @ design.T @ np.linalg.inv(covariance)
    white = np.einsum("qm,m,qm->q", operator, noise.white, operator)
    run = np.einsum("qm,mn,qn->q", operator, noise.run, operator)
    return Estimates(solution.values, solution.covariance, _freedom(noise, white, run), float(solution.chi_square))


def _freedom(noise: RateNoise, white: FloatArray, run: FloatArray) -> FloatArray:
    """Satterthwaite's degrees of freedom of a variance that is the sum of two estimated ones, (q,)."""
    if noise.stated:
        return np.full(len(white), np.inf)
    # Where every run is one collect, white noise shows between runs and nowhere else.
    rows = max(noise.rows_left or noise.runs_left, 1) + _PRIOR_ROWS
    per_part = white**2 / rows + (run**2 / noise.runs_left if noise.runs_left else 0.0)
    return np.asarray((white + run) ** 2 / np.maximum(per_part, 1e-300))


def repeatability(layout: Layout, noise: RateNoise) -> Mapping[str, float]:
    """Return what one self-calibration's value scatters by, per parameter: rms over the runs that can give it alone."""
    design = layout.columns[noise.row, noise.channel]
    rates = np.zeros(len(design))
    runs = layout.collects.conditions.run[noise.row]
    squares: list[FloatArray] = []
    for run in np.unique(runs):
        here = np.flatnonzero(runs == run)
        own = noise.covariance[np.ix_(here, here)]
        found = solve(design[here], rates[here], covariance=own, rank_tolerance=1e-3)
        squares.append(np.diagonal(found.covariance))
    with np.errstate(invalid="ignore"):
        known = np.array(squares)
        mean = np.array([np.mean(c[np.isfinite(c)]) if np.isfinite(c).any() else np.nan for c in known.T])
    return dict(zip(layout.form.names, np.sqrt(mean).tolist(), strict=True))
