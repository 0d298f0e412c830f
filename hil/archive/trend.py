"""What became of a parameter between calibrations: nothing, a drift, a jump; what cannot be told apart is not.

    found = trend(months, values, sd)     # (n,) each, in the order of time
    found.word                            # nothing shown, drift, jump, drift and jump, drift or jump, cannot tell
    found.per_month                       # Uncertain: of the model that was chosen, or of a straight line

Four models are held against each other by the Bayesian information criterion: a constant, a straight line, a step
between two calibrations (with two at least on either side), and both. Scatter between calibrations beyond the stated
standard deviations widens every interval (Birge); less than stated narrows none. A step pays for the places where it
might have been, and few values pay more (half the correction of Hurvich and Tsai). Nothing is named that is not better
than its rivals by `MARGIN`, odds of twenty to one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hil.campaign import FloatArray
from hil.solve.repeats import Uncertain

MARGIN = 2.0 * math.log(20.0)
LEAST = 4
"""Calibrations that it takes to tell anything: a line has two left then."""

_EACH_SIDE = 2
_UNKNOWN, _NOTHING = "cannot tell", "nothing shown"
_SHEWHART = 1.128  # of the mean range of two values, by their standard deviation (d2 for n = 2)
_SIGMAS = 3.0


@dataclass(frozen=True)
class Fit:
    """One model: values (p,) of its columns with covariance (p, p), where its step is, and what it costs (lower wins).

    `step` is the place of the first calibration after it, 0 where there is none; `line` says that it has a slope.
    """

    line: bool
    step: int
    values: FloatArray
    covariance: FloatArray
    freedom: int
    cost: float

    def of(self, place: int) -> Uncertain:
        """Return one of the values with its uncertainty."""
        sd = math.sqrt(float(self.covariance[place, place]))
        return Uncertain(float(self.values[place]), sd, self.freedom, self.freedom, "")


@dataclass(frozen=True)
class Trend:
    """What was found, with the model by which `per_month` and `jump` are stated."""

    word: str
    fit: Fit | None
    per_month: Uncertain | None = None
    jump: Uncertain | None = None

    @property
    def step(self) -> int:
        """The place of the first calibration after a jump; 0 where none was found."""
        return self.fit.step if self.fit is not None and self.jump is not None else 0


def trend(months: FloatArray, values: FloatArray, sd: FloatArray) -> Trend:
    """Say what n values (n,) with standard deviations (n,) did over `months` (n,), which rise."""
    if len(values) < LEAST or not np.all(np.isfinite(sd)) or not np.all(sd > 0.0):
        if len(values) > 2 and np.all(np.isfinite(sd)) and np.all(sd > 0.0):
            line = fitted(months, values, sd, line=True)
            return Trend(_UNKNOWN, line, line.of(1))
        return Trend(_UNKNOWN, None)
    steps = [step for step in range(_EACH_SIDE, len(values) - _EACH_SIDE + 1) if months[step] > months[step - 1]]
    steady, line = (fitted(months, values, sd, line=with_line) for with_line in (False, True))
    jumps = [fitted(months, values, sd, line=False, step=step, places=len(steps)) for step in steps]
    both = [fitted(months, values, sd, line=True, step=s, places=len(steps)) for s in steps if len(values) > LEAST]
    best = {_NOTHING: steady, "drift": line}
    for word, several in (("jump", jumps), ("drift and jump", both)):
        if several:
            best[word] = min(several, key=lambda each: each.cost)
    order = sorted(best, key=lambda word: best[word].cost)
    if best[_NOTHING].cost - best[order[0]].cost < MARGIN:
        return Trend(_NOTHING, line, line.of(1))
    word, rivals = order[0], [each for each in order[1:] if best[each].cost - best[order[0]].cost < MARGIN]
    if {"drift", "jump"} <= {word, *rivals}:
        return Trend("drift or jump", line, line.of(1))
    if word == "drift and jump" and rivals:  # the simpler one that explains nearly as much
        word = rivals[0]
    found = best[word]
    slope = found.of(1) if found.line else None
    return Trend(word, found, slope, found.of(len(found.values) - 1) if found.step else None)


def at_one_temperature(together: Trend, since: float, months: FloatArray, values: FloatArray, sd: FloatArray) -> Trend:
    """Return the trend of values (n,) at one temperature by the model of `together`, with its step `since` a month."""
    if together.fit is None or len(values) < LEAST - 1:
        return Trend(_UNKNOWN, None)
    step = int(np.searchsorted(months, since)) if together.step else 0
    step = step if step < len(values) else 0  # nothing was measured here after it
    found = fitted(months, values, sd, line=together.fit.line, step=step)
    slope = found.of(1) if found.line else None
    return Trend(together.word, found, slope, found.of(len(found.values) - 1) if step else None)


def fitted(
    months: FloatArray, values: FloatArray, sd: FloatArray, *, line: bool, step: int = 0, places: int = 1
) -> Fit:
    """Fit a constant to values (n,), with a `line` and a `step` that might have been at so many `places`."""
    columns = columns_of(months, months, line=line, step=step) / sd[:, None]
    count, parameters = columns.shape
    inverse = np.linalg.pinv(columns.T @ columns)
    found = inverse @ (columns.T @ (values / sd))
    squares = float(np.sum((values / sd - columns @ found) ** 2))
    freedom = max(count - parameters, 1)
    scale = max(1.0, squares / freedom)
    told = parameters + (step > 0)  # where a step is, is told by the values as well
    few = told * (told + 1.0) / max(count - told - 1, 0.5)
    cost = count * math.log(scale) + squares / scale + told * math.log(count) + 2.0 * math.log(places) * (step > 0)
    return Fit(line, step, found, inverse * scale, freedom, cost + few)


def columns_of(at: FloatArray, months: FloatArray, *, line: bool, step: int) -> FloatArray:
    """Return a model's columns (k, p) at k instants, for calibrations at `months` (n,)."""
    columns = [np.ones_like(at)]
    if line:
        columns.append(at - months.mean())
    if step:
        columns.append((at >= months[step]).astype(np.float64))
    return np.stack(columns, axis=1)


def predicted(fit: Fit, at: FloatArray, months: FloatArray, sigmas: float) -> tuple[FloatArray, FloatArray]:
    """Return the parameter at k instants by a fit, (k,), and the half width of its interval at so many sigmas."""
    columns = columns_of(at, months, line=fit.line, step=fit.step)
    sd = np.sqrt(np.einsum("ij,jk,ik->i", columns, fit.covariance, columns))
    return columns @ fit.values, sd * Uncertain(0.0, 1.0, fit.freedom, fit.freedom, "").expanded(sigmas)


def control_limits(earlier: FloatArray, sd: FloatArray) -> Uncertain | None:
    """Return where the next of a unit's values should be by its own earlier ones (m,), None for fewer than three.

    A chart of single values (Shewhart): the scatter is that of neighbours, so that a slow drift does not widen it, and
    never less than the standard deviations (m,) that are stated. Of few values it is known badly, and wide.
    """
    count = len(earlier)
    if count < LEAST - 1:
        return None
    scatter = max(float(np.mean(np.abs(np.diff(earlier)))) / _SHEWHART, float(np.sqrt(np.mean(sd**2))))
    return Uncertain(float(earlier.mean()), scatter * math.sqrt(1.0 + 1.0 / count), count - 1, count, "")


def control_half_width(limits: Uncertain) -> float:
    """Return half the width of control limits: what chance passes as rarely as three sigma."""
    return limits.expanded(_SIGMAS)
