"""What scatters averages: coefficients drawn anew or remembered, their covariance and their draws."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.campaign import Conditions, FloatArray, IntArray, Sensor
from hil.model.effects.columns import HOUR_S, flattened, middle_hr, per_channel


@dataclass(frozen=True)
class Scatter:
    """Coefficients that scatter: of which rows they are the same, or how long they remember.

    `columns` (n, c, p): what a coefficient of unit size does to each rate. Either `group` (n,), integer labels: they
    are drawn anew for each label. Or `tau_s`, s: they wander with that correlation time (Gauss-Markov, unit variance);
    infinite with `walk`: a random walk of unit variance per hour from the first row on. `of_angle`: what is white is
    the angle, not the rate, so that in a series one sample loses what the one before has gained. `common`: the one
    cause that several sensors share; each has the same coefficients then. Empty where it is the sensor's own.
    """

    columns: FloatArray
    group: IntArray | None = None
    tau_s: float | None = None
    walk: bool = False
    of_angle: bool = False
    common: str = ""

    def within(self, channels: Collection[str], sensor: Sensor) -> Scatter:
        """Return it in some channels of a sensor alone; in all where none is named."""
        here = np.array([not channels or channel in channels for channel in sensor.channels])
        return replace(self, columns=self.columns * here[:, None])

    @property
    def is_white(self) -> bool:
        """Whether every row has coefficients of its own (of two rows or more)."""
        return self.group is not None and len(np.unique(self.group)) == len(self.group)

    def covariance(self, conditions: Conditions) -> FloatArray:
        """Return the covariance of the rates of n collects, shape (n·c, n·c), rows (n, c) flattened."""
        seen, channels, hours = flattened(self.columns), self.columns.shape[1], middle_hr(conditions)
        return np.asarray((seen @ seen.T) * np.kron(self.between(self, hours, hours), np.ones((channels, channels))))

    def coefficients(self, hours: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return one draw of the coefficients of n rows, (n, p), that were measured at `hours`, (n,)."""
        count = self.columns.shape[2]
        if self.group is not None:
            labels, of_row = np.unique(self.group, return_inverse=True)
            return np.asarray(rng.standard_normal((len(labels), count))[of_row])
        order = np.argsort(hours, kind="stable")
        steps = rng.standard_normal((len(hours), count))
        keep, kick = self.step(np.diff(hours[order]))
        walked = [np.zeros(count) if self.walk else steps[0]] if len(hours) else []
        for row in range(1, len(hours)):
            walked.append(keep[row - 1] * walked[-1] + kick[row - 1] * steps[row])
        values = np.empty((len(hours), count))
        values[order] = walked
        return values

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


def drawn(
    parts: Sequence[Sequence[Scatter]], conditions: Sequence[Conditions], rng: np.random.Generator
) -> list[FloatArray]:
    """Return one draw of each sensor's rates, (n, c) each, by the parts of its scatter, deg/hr.

    The covariance of each is the sum of its parts' `covariance`; what is common to sensors is drawn once for all rows.
    """
    hours = [middle_hr(each) for each in conditions]
    rates = [np.zeros((len(each), len(each.sensor.channels))) for each in conditions]
    alike: dict[tuple[str, int, int], dict[int, Scatter]] = {}
    for k, own in enumerate(parts):
        for place, part in enumerate(own):
            met = sum(other.common == part.common for other in own[:place])
            alike.setdefault((part.common, -1 if part.common else k, met), {})[k] = part
    for of in alike.values():
        several = [*of.values()]
        widest = max(several, key=lambda part: part.columns.shape[2])
        groups = [part.group for part in several if part.group is not None]
        whole = replace(widest, group=np.concatenate(groups) if groups else None)
        values = whole.coefficients(np.concatenate([hours[k] for k in of]), rng)
        ends = np.cumsum([len(hours[k]) for k in of])[:-1]
        for (k, part), here in zip(of.items(), np.split(values, ends), strict=True):
            rates[k] += np.einsum("ncp,np->nc", part.columns, here[:, : part.columns.shape[2]])
    return rates


def white(sigma: FloatArray, conditions: Conditions, *, of_angle: bool = False) -> tuple[Scatter, ...]:
    """Return coefficients that each row draws anew for each channel, of sizes `sigma` (n,)."""
    return (Scatter(per_channel(sigma, conditions.sensor), group=np.arange(len(conditions)), of_angle=of_angle),)


def averaged_s(conditions: Conditions) -> FloatArray:
    """Return how long each row was averaged, s, (n,); of no duration it counts as one second."""
    return np.maximum(conditions.duration_s, 1.0)
