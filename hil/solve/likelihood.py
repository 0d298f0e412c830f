"""How probable a block of rows is under models of its means: restricted likelihood over a grid of noise models."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil.campaign import FloatArray
from hil.solve.identifiability import project_out
from hil.solve.noise_grid import NoiseGrid, whiteners
from hil.solve.rows import Block

_STATED_DOF = 3.0  # how strongly stated standard errors hold the scale
_TRUSTED_DOF = 12.0  # and where they are all there is to judge by


@dataclass(frozen=True)
class NoiseTable:
    """A block's noise models: whitening matrices W (t, N, N) and half log determinants (t,), made once."""

    grid: NoiseGrid
    whitening: FloatArray
    half_log_det: FloatArray

    @classmethod
    def on(cls, block: Block, grid: NoiseGrid) -> NoiseTable:
        """Compute the table of a block's layout on a given grid."""
        whitening, half_log_det = whiteners(block, grid)
        return cls(grid, whitening, half_log_det)


@dataclass(frozen=True)
class Projection:
    """Rows whitened with the base projected out: whitening (t, N, N), base's span (t, N, p), log weights (t,)."""

    whitening: FloatArray
    basis: FloatArray
    log_weight: FloatArray
    freedom: int

    @classmethod
    def of(cls, noise: NoiseTable, base: FloatArray) -> Projection:
        """Project `base` (N, p) out at every noise point."""
        log_weight = noise.grid.log_prior - noise.half_log_det
        if base.shape[1] == 0:
            return cls(noise.whitening, np.zeros((len(log_weight), base.shape[0], 0)), log_weight, base.shape[0])
        span, r = np.linalg.qr(base)
        white = noise.whitening @ span
        factor = np.linalg.cholesky(np.swapaxes(white, 1, 2) @ white)
        log_weight = log_weight - np.sum(np.log(np.diagonal(factor, axis1=1, axis2=2)), axis=1)
        log_weight = log_weight - np.sum(np.log(np.abs(np.diagonal(r))))
        basis = white @ np.swapaxes(np.linalg.inv(factor), 1, 2)
        return cls(noise.whitening, basis, log_weight, base.shape[0] - base.shape[1])

    def beside(self, white: FloatArray) -> FloatArray:
        """Return whitened columns (t, N, k) less their part in the base."""
        return project_out(self.basis, white)

    def log_null(self, y: FloatArray, prior: ScalePrior) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return residuals (t, N, m), RSS (t, m) and the log marginal likelihood of the base alone (t, m)."""
        residual = self.beside(self.whitening @ y)
        rss = np.sum(residual**2, axis=1)
        power = prior.a + 0.5 * self.freedom
        return residual, rss, self.log_weight[:, None] - power * np.log(prior.b + 0.5 * rss)


@dataclass(frozen=True)
class ScalePrior:
    """Inverse-gamma prior of the scale s²: flat where nothing is stated, weakly held by stated standard errors."""

    a: float
    b: float

    @classmethod
    def of(cls, block: Block) -> ScalePrior:
        """Return the prior of a block."""
        if not block.sigma_stated:
            return cls(0.0, 1e-12)
        strength = _TRUSTED_DOF if block.sigma_trusted else _STATED_DOF
        return cls(0.5 * strength, 0.5 * strength * float(np.mean(block.sigma**2)))
