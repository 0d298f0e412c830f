"""What the rates do by themselves: white noise, run-to-run changes and slow correlation, on a grid.

The covariance of a block of rows is, up to one unknown scale s²,

    V = D + tau_b^2 R_rho(runs) + tau_k^2 sum_axes f f'(same run) + tau_c^2 R_phi(collects)

with D from the stated standard errors, R_rho an AR(1) correlation over runs (a random walk is its limit), `tau_k` the
run-to-run change of the acceleration sensitivity (MU that reseats), and `tau_c` correlation from collect to collect.
Everything downstream averages over this grid, each point weighted by its restricted likelihood and by the weakly
informative prior given here, so that eight runs are enough to be cautious and twenty-four are enough to be precise.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.linalg import lapack

from hil.campaign import FloatArray, IntArray
from hil.solve.rows import Block

_RUN_BIAS = (0.0, 0.7, 1.4, 2.5, 4.5, 9.0)
_RUN_CORRELATION = (0.0, 0.6, 0.97)
_RUN_SENSITIVITY = (0.0, 0.7, 1.4, 2.8, 5.6)
_COLLECT_DRIFT = (0.0, 0.8, 2.0)
_COLLECT_CORRELATION = (0.6, 0.95)
_LEVELLING = (0.1, 0.4, 1.0)
_LEVELLING_PRIOR = {0.1: -1.6, 0.4: -1.0, 1.0: -0.7}  # stated errors leave out what differs from collect to collect


@dataclass(frozen=True)
class NoiseGrid:
    """Points of the noise grid, shape (t,) each: ratios to the white noise, correlations, and the log prior.

    `levelling` is the share of the mean variance added to every row's stated variance: standard errors from a handful
    of samples are themselves uncertain, and a row must not win by luck.
    """

    run_bias: FloatArray
    run_correlation: FloatArray
    run_sensitivity: FloatArray
    collect_drift: FloatArray
    collect_correlation: FloatArray
    levelling: FloatArray
    log_prior: FloatArray

    def __len__(self) -> int:
        return len(self.log_prior)

    def take(self, index: IntArray) -> NoiseGrid:
        """Return the grid restricted to `index`."""
        return NoiseGrid(*(getattr(self, name)[index] for name in self.__dataclass_fields__))


def noise_grid(block: Block) -> NoiseGrid:
    """Return the grid of noise models that the layout can tell apart; where stated noise is trusted, that alone."""
    runs = len(np.unique(block.run))
    rows_per_run = len(block.y) / runs / len(np.unique(block.channel))
    many_runs = runs >= 4 and rows_per_run > 1.5
    run_bias = _RUN_BIAS if many_runs else (0.0,)
    run_sensitivity = _RUN_SENSITIVITY if many_runs else (0.0,)
    if block.sigma_trusted:
        one, zero = np.ones(1), np.zeros(1)
        return NoiseGrid(zero, zero, zero, zero, _COLLECT_CORRELATION[0] * one, zero, zero)
    unequal = float(np.ptp(block.sigma)) > 1e-6 * float(np.mean(block.sigma))
    levelling = (_LEVELLING if block.sigma_stated else _LEVELLING[::2]) if unequal else (1.0,)
    points, priors = [], []
    for bias, rho, sensitivity, drift, phi, level in product(
        run_bias, _RUN_CORRELATION, run_sensitivity, _COLLECT_DRIFT, _COLLECT_CORRELATION, levelling
    ):
        if (bias == 0 and rho != 0) or (drift == 0 and phi != _COLLECT_CORRELATION[0]):
            continue
        if many_runs and drift > 1:  # with runs, slow correlation is the run term's
            continue
        prior = -np.log1p((bias / 3.0) ** 2) - (np.log(3.0) if bias > 0 else 0.0)
        prior += -1.5 if sensitivity > 0 else 0.0
        prior += {0.0: 0.0, 0.8: -1.7, 2.0: -2.2}[drift]
        prior += _LEVELLING_PRIOR.get(level, 0.0) if len(levelling) > 1 else 0.0
        points.append((bias, rho, sensitivity, drift, phi, level))
        priors.append(prior)
    columns = np.array(points, dtype=np.float64).T
    log_prior = np.array(priors)
    log_prior -= np.logaddexp.reduce(log_prior)
    bias_, rho_, sensitivity_, drift_, phi_, level_ = columns
    return NoiseGrid(bias_, rho_, sensitivity_, drift_, phi_, level_, log_prior)


def covariances(block: Block, grid: NoiseGrid) -> FloatArray:
    """Return V at every grid point, shape (t, N, N), in units of the mean white variance of the block."""
    variance = block.sigma**2 / np.mean(block.sigma**2)
    same_channel = block.channel[:, None] == block.channel[None, :]
    lag = np.abs(block.run[:, None] - block.run[None, :]).astype(np.float64)
    step = np.abs(block.order[:, None] - block.order[None, :]).astype(np.float64)
    # The grid has few different correlations, so that every covariance is a sum of the same few matrices.
    parts = [np.diag(variance), np.eye(len(variance))]
    amounts = [1.0 - grid.levelling, grid.levelling]
    parts.append(np.where(same_channel & (lag == 0), block.f_random @ block.f_random.T, 0.0))
    amounts.append(grid.run_sensitivity**2)
    for sizes, correlation, apart in (
        (grid.run_bias, grid.run_correlation, lag),
        (grid.collect_drift, grid.collect_correlation, step),
    ):
        for value in np.unique(correlation[sizes > 0.0]):
            parts.append(np.where(same_channel, value**apart, 0.0))
            amounts.append(np.where(correlation == value, sizes**2, 0.0))
    return np.asarray(np.tensordot(np.array(amounts).T, np.array(parts), axes=1))


def whiteners(block: Block, grid: NoiseGrid) -> tuple[FloatArray, FloatArray]:
    """Return W with W'W = V^-1, shape (t, N, N), and half the log determinant of V, shape (t,)."""
    factor: FloatArray = np.linalg.cholesky(covariances(block, grid)).astype(np.float64, copy=False)
    half_log_det: FloatArray = np.sum(np.log(np.diagonal(factor, axis1=1, axis2=2)), axis=1)
    for lower in factor:
        lower[...] = lapack.dtrtri(lower.T)[0].T
    return factor, half_log_det
