"""The noise of a campaign's rates beside a curve that is free at every temperature: white, run-level, heteroscedastic.

The noise models are those of `hil.solve.noise_grid`, on a grid; the one with the largest restricted likelihood is used.
The free curve leaves no misfit that could be taken for noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from hil.campaign import Collects, FloatArray, IntArray, TextArray
from hil.solve.likelihood import NoiseTable, Projection, ScalePrior
from hil.solve.noise_grid import NoiseGrid, covariances, noise_grid
from hil.solve.rows import Block, is_repeated, sensor_blocks

_CELLS = 4_000_000  # of the grid's matrices in memory at a time


@dataclass(frozen=True)
class RateNoise:
    """The noise of m measured rates, in the order `row` (m,), `channel` (m,).

    `white` (m,) and `run` (m, m) are variances, (deg/hr)²; `rows_left` and `runs_left` are the degrees of freedom that
    they were estimated with. `stated` says that the size rests on stated standard errors alone, `known` that there is
    anything to judge the size by.
    """

    row: IntArray
    channel: IntArray
    white: FloatArray
    run: FloatArray
    rows_left: int
    runs_left: int
    stated: bool
    known: bool

    def times(self, factor: float) -> RateNoise:
        """Return the same noise with its variances times a factor."""
        return replace(self, white=factor * self.white, run=factor * self.run)

    @property
    def covariance(self) -> FloatArray:
        """The covariance of the rates, (m, m)."""
        return np.asarray(np.diag(self.white) + self.run)


def rate_noise(number: int, collects: Collects, free: FloatArray, repeated_runs: int) -> RateNoise:
    """Estimate the noise of a sensor's rates beside the columns `free` (n, c, q); channels have noise of their own.

    `repeated_runs` is how many runs there are beyond one per temperature (and direction).
    """
    conditions = collects.conditions
    channels = free.shape[1]
    # A copy of every column for each channel: so no column ties two channels, and each is a block.
    apart = np.concatenate([free * (np.arange(channels) == c)[None, :, None] for c in range(channels)], axis=2)
    blocks = sensor_blocks(number, collects, conditions.w_channels_deg_per_hr, apart)
    alone = not is_repeated(blocks)
    blocks = [replace(block, sigma_trusted=alone and block.sigma_stated) for block in blocks]
    parts = [block_noise(block, block.y[:, None]) for block in blocks]
    white = np.concatenate([white[0] for white, _ in parts])
    if alone:
        white = _levelled(white, blocks, conditions.position)
    rows_left = sum(len(block.y) - block.base.shape[1] for block in blocks)
    stated = all(block.sigma_stated for block in blocks)
    return RateNoise(
        row=np.concatenate([block.rows for block in blocks]),
        channel=np.concatenate([block.channel for block in blocks]),
        white=white,
        run=block_diag(*(run[0] for _, run in parts)),
        rows_left=max(rows_left - repeated_runs * channels, 0),
        runs_left=repeated_runs,
        stated=stated and rows_left <= 0,
        known=stated or rows_left > 0,
    )


def _levelled(white: FloatArray, blocks: Sequence[Block], position: TextArray) -> FloatArray:
    """Draw each variance half way to the mean of its channel and position.

    A standard error that nothing repeats, often from a handful of runs, is itself uncertain: no row must win by luck.
    """
    labels = np.concatenate([np.char.add(f"{place} ", position[block.rows]) for place, block in enumerate(blocks)])
    _, group = np.unique(labels, return_inverse=True)
    mean = np.bincount(group, weights=white) / np.bincount(group)
    return np.asarray(0.5 * white + 0.5 * mean[group])


def block_noise(block: Block, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the white variances (d, N) and the run-level covariances (d, N, N) of a block's most probable noise.

    `y` (N, d) are d sets of rates on the block's rows: one campaign, or many draws of it.
    """
    grid = noise_grid(block)
    if np.any(grid.run_bias > 0):  # with runs, slow correlation is the run term's
        grid = grid.take(np.flatnonzero(grid.collect_drift == 0.0))
    prior = ScalePrior.of(block)
    freedom = len(block.y) - block.base.shape[1]
    log_weight, squares = np.empty((len(grid), y.shape[1])), np.empty((len(grid), y.shape[1]))
    at_once = max(1, _CELLS // len(block.y) ** 2)
    for start in range(0, len(grid), at_once):
        points = np.arange(start, min(start + at_once, len(grid)))
        beside = Projection.of(NoiseTable.on(block, grid.take(points)), block.base)
        _, squares[points], log_weight[points] = beside.log_null(y, prior)
    best = np.argmax(log_weight, axis=0)
    scale = (prior.b + 0.5 * squares[best, np.arange(y.shape[1])]) / max(prior.a + 0.5 * freedom, 0.5)
    own = grid.take(best)
    white = np.diagonal(covariances(block, _white_only(own)), axis1=1, axis2=2) * scale[:, None]
    run = covariances(block, own) * scale[:, None, None]
    diagonal = np.arange(len(block.y))
    run[:, diagonal, diagonal] -= white
    return white, run


def _white_only(grid: NoiseGrid) -> NoiseGrid:
    zero = np.zeros(len(grid))
    return replace(grid, run_bias=zero, run_sensitivity=zero, collect_drift=zero)
