"""Forms that a parameter may take against temperature, each judged by predicting the temperature it was not shown.

`Form.held_out` returns for values at S temperatures the error at each, of the curve through the other S - 1.
It is batched, so that a thousand simulated campaigns cost as much as one loop. At the ends a polynomial has to reach
beyond what it was shown, as it would in use; the interpolating forms hold their end value.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy.interpolate import PchipInterpolator

from hil.campaign import FloatArray, IntArray

POLYNOMIAL, MONOTONE, TABLE = "polynomial", "monotone", "table"
_LOWEST_STEP_DEGC = 1e-6


class Form(Protocol):
    """One form. `order` is that of a polynomial (0: constant), None for the others."""

    @property
    def name(self) -> str:
        """What the form is called: constant, linear, quadratic, cubic, polynomial of order n, monotone, table."""

    @property
    def order(self) -> int | None:
        """The order of a polynomial."""

    def held_out(self, values: FloatArray) -> FloatArray:
        """Return value less prediction at each temperature when it is left out; (..., S) from (..., S)."""

    def fitted(self, values: FloatArray) -> FloatArray:
        """Return the form fitted to all temperatures, at those temperatures; (..., S) from (..., S)."""


@dataclass(frozen=True)
class PolynomialForm:
    """A polynomial of an order, by least squares with `weight` (S,) (inverse variances)."""

    temperature_degC: FloatArray
    weight: FloatArray
    degree: int

    @property
    def name(self) -> str:
        """constant, linear, quadratic, cubic, or polynomial of order n."""
        names = ("constant", "linear", "quadratic", "cubic")
        return names[self.degree] if self.degree < len(names) else f"{POLYNOMIAL} of order {self.degree}"

    @property
    def order(self) -> int | None:
        """The order."""
        return self.degree

    @cached_property
    def _hat(self) -> FloatArray:
        root = np.sqrt(self.weight)
        span = np.linalg.qr(root[:, None] * _scaled_powers(self.temperature_degC, self.degree))[0]
        return np.asarray((span @ span.T) * root[None, :] / root[:, None])

    @cached_property
    def _left_out(self) -> FloatArray:
        """The matrix that makes held-out errors of values: residuals over one less the leverage."""
        return np.asarray((np.eye(len(self.weight)) - self._hat) / (1.0 - np.diagonal(self._hat))[:, None])

    def held_out(self, values: FloatArray) -> FloatArray:
        """See `Form`."""
        return np.asarray(values @ self._left_out.T)

    def fitted(self, values: FloatArray) -> FloatArray:
        """See `Form`."""
        return np.asarray(values @ self._hat.T)


@dataclass(frozen=True)
class TableForm:
    """The values themselves, (..., S), interpolated by PCHIP."""

    temperature_degC: FloatArray
    name: str = TABLE
    order: int | None = None

    def held_out(self, values: FloatArray) -> FloatArray:
        """See `Form`."""
        return _left_out_one_by_one(self.temperature_degC, values, lambda _, shown: shown)

    def fitted(self, values: FloatArray) -> FloatArray:
        """See `Form`."""
        return values


@dataclass(frozen=True)
class MonotoneForm:
    """The nearest values, (..., S), that only rise or only fall (isotonic least squares), interpolated by PCHIP."""

    temperature_degC: FloatArray
    weight: FloatArray
    name: str = MONOTONE
    order: int | None = None

    def held_out(self, values: FloatArray) -> FloatArray:
        """See `Form`."""
        return _left_out_one_by_one(
            self.temperature_degC, values, lambda shown, these: monotone(these, self.weight[shown])
        )

    def fitted(self, values: FloatArray) -> FloatArray:
        """See `Form`."""
        return monotone(values, self.weight)


class _Shape(Protocol):
    def __call__(self, shown: IntArray, values: FloatArray, /) -> FloatArray: ...


def _left_out_one_by_one(temperature_degC: FloatArray, values: FloatArray, shape: _Shape) -> FloatArray:
    count = len(temperature_degC)
    errors = np.empty_like(values)
    for left in range(count):
        shown = np.flatnonzero(np.arange(count) != left)
        # Between two temperatures PCHIP is made of them and the next on either side.
        near = slice(max(left - 2, 0), left + 2) if 0 < left < count - 1 else slice(-2, None) if left else slice(2)
        curve = PchipInterpolator(temperature_degC[shown[near]], shape(shown, values[..., shown])[..., near], axis=-1)
        at = np.clip(temperature_degC[left], temperature_degC[shown[0]], temperature_degC[shown[-1]])
        errors[..., left] = values[..., left] - curve(at)
    return errors


def monotone(values: FloatArray, weight: FloatArray) -> FloatArray:
    """Return the nearest values (weighted least squares) that only rise or only fall, whichever is nearer; (..., S)."""
    rising = _rising(values, weight)
    falling = -_rising(-values, weight)
    worse = ((values - rising) ** 2 @ weight) > ((values - falling) ** 2 @ weight)
    return np.where(worse[..., None], falling, rising)


def _rising(values: FloatArray, weight: FloatArray) -> FloatArray:
    """Isotonic regression as max over starts of min over ends of the mean between, batched.

    `scipy.optimize.isotonic_regression` takes one row at a time: a whole fit, with its thousand draws, takes four times
    as long with it.
    """
    count = values.shape[-1]
    cumulated = np.concatenate([np.zeros((*values.shape[:-1], 1)), np.cumsum(values * weight, axis=-1)], axis=-1)
    total = np.concatenate([[0.0], np.cumsum(weight)])
    start, end = np.arange(count)[:, None], np.arange(count)[None, :] + 1
    with np.errstate(divide="ignore", invalid="ignore"):
        means = (cumulated[..., end] - cumulated[..., start]) / (total[end] - total[start])
    means = np.where(end > start, means, np.inf)
    least = np.minimum.accumulate(means[..., ::-1], axis=-1)[..., ::-1]  # over ends at or after each place
    return np.asarray(np.where(end > start, least, -np.inf).max(axis=-2))


def _scaled_powers(temperature_degC: FloatArray, order: int) -> FloatArray:
    """Powers of the temperature scaled to -1 … 1, which keeps high orders apart, (S, order + 1)."""
    middle = 0.5 * (temperature_degC.min() + temperature_degC.max())
    half = max(0.5 * float(np.ptp(temperature_degC)), _LOWEST_STEP_DEGC)
    return np.asarray(np.polynomial.polynomial.polyvander((temperature_degC - middle) / half, order))


def candidate_forms(temperature_degC: FloatArray, weight: FloatArray, highest_order: int) -> list[Form]:
    """Return the forms that temperatures (S,), °C, can judge, the simplest first: polynomials, monotone, table.

    A polynomial must leave at least one temperature over when one is held out (three temperatures allow a line).
    """
    count = len(temperature_degC)
    highest = min(highest_order, max(count - 3, 1)) if count >= 3 else 0
    forms: list[Form] = [PolynomialForm(temperature_degC, weight, order) for order in range(highest + 1)]
    if count >= 4:
        forms += [MonotoneForm(temperature_degC, weight), TableForm(temperature_degC)]
    return forms
