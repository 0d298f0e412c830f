"""What scatters averages: coefficients drawn anew or remembered, their covariance and their draws."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil.campaign import Conditions, FloatArray, IntArray
from hil.model.effects.columns import HOUR_S, flattened, middle_hr


@dataclass(frozen=True)
class Scatter:
    """Coefficients that scatter: of which rows they are the same, or how long they remember.

    `columns` (n, c, p): what a coefficient of unit size does to each rate. Either `group` (n,), integer labels: they
    are drawn anew for each label. Or `tau_s`, s: they wander with that correlation time (Gauss-Markov, unit variance);
    infinite with `walk`: a random walk of unit variance per hour from the first row on. `of_angle`: what is white is
    the angle, not the rate, so that in a series one sample loses what the one before has gained.
    """

    columns: FloatArray
    group: IntArray | None = None
    tau_s: float | None = None
    walk: bool = False
    of_angle: bool = False

    @property
    def is_white(self) -> bool:
        """Whether every row has coefficients of its own (of two rows or more)."""
        return self.group is not None and len(np.unique(self.group)) == len(self.group)

    def covariance(self, conditions: Conditions) -> FloatArray:
        """Return the covariance of the rates of n collects, shape (n·c, n·c), rows (n, c) flattened."""
        seen, channels, hours = flattened(self.columns), self.columns.shape[1], middle_hr(conditions)
        return np.asarray((seen @ seen.T) * np.kron(self.between(self, hours, hours), np.ones((channels, channels))))

    def draw(self, conditions: Conditions, rng: np.random.Generator) -> FloatArray:
        """Return one draw of the rates, shape (n, c), of which `covariance` is the covariance."""
        rows, _, count = self.columns.shape
        if self.group is not None:
            labels, of_row = np.unique(self.group, return_inverse=True)
            values = rng.standard_normal((len(labels), count))[of_row]
        else:
            order = np.argsort(middle_hr(conditions), kind="stable")
            steps, between = rng.standard_normal((rows, count)), np.diff(middle_hr(conditions)[order])
            keep, kick = self.step(between)
            walked = [np.zeros(count) if self.walk else steps[0]] if rows else []
            for row in range(1, rows):
                walked.append(keep[row - 1] * walked[-1] + kick[row - 1] * steps[row])
            values = np.empty((rows, count))
            values[order] = walked
        return np.asarray(np.einsum("ncp,np->nc", self.columns, values))

    def step(self, hours: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return what is kept of a coefficient after `hours` (m,), and the deviation of what is new, (m,) each."""
        keep = np.ones_like(hours) if self.walk else np.exp(-hours * HOUR_S / float(self.tau_s or np.nan))
        return keep, np.sqrt(hours) if self.walk else np.sqrt(1.0 - keep**2)

    def between(self, other: Scatter, hours: FloatArray, others: FloatArray) -> FloatArray:
        """Return how alike coefficients are in n rows and in m rows in which they scatter as `other` says, (n, m).

        `hours` (n,) and `others` (m,) are when the rows were measured.
        """
        if self.group is not None and other.group is not None:
            return np.equal.outer(self.group, other.group).astype(np.float64)
        if self.walk:
            return np.asarray(np.minimum.outer(hours, others) - min(hours.min(), others.min()))
        return self.step(np.abs(np.subtract.outer(hours, others)))[0]
