"""Forms that a parameter may take against temperature, each judged by predicting the temperature it was not shown.

`Form.held_out` returns for values at S temperatures the error at each, of the curve through the other S - 1.
It is batched, so that a thousand simulated campaigns cost as much as one loop. At the ends a polynomial has to reach
beyond what it was shown, as it would in use; the interpolating forms hold their end value.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator

from hil.campaign import FloatArray, IntArray

MONOTONE, TABLE = "monotone", "table"
_LOWEST_STEP_DEGC = 1e-6


@dataclass(frozen=True)
class Form:
    """One form. `order` is that of a polynomial (0: constant), None for the others.

    `fitted` gives the form fitted to all temperatures, at those temperatures, `held_out` value less prediction at each
    temperature when it is left out; both (..., S) from values (..., S).
    """

    name: str
    order: int | None
    fitted: Callable[[FloatArray], FloatArray]
    held_out: Callable[[FloatArray], FloatArray]


def polynomial(temperature_degC: FloatArray, weight: FloatArray, order: int) -> Form:
    """Return the form of a polynomial, by least squares with `weight` (S,) (inverse variances)."""
    names = ("constant", "linear", "quadratic", "cubic")
    root = np.sqrt(weight)
    span = np.linalg.qr(root[:, None] * _scaled_powers(temperature_degC, order))[0]
    hat = (span @ span.T) * root[None, :] / root[:, None]
    # Held-out errors are residuals over one less the leverage.
    left_out = (np.eye(len(weight)) - hat) / (1.0 - np.diagonal(hat))[:, None]
    return Form(
        names[order] if order < len(names) else f"polynomial of order {order}",
        order,
        lambda values: np.asarray(values @ hat.T),
        lambda values: np.asarray(values @ left_out.T),
    )


def interpolated(name: str, temperature_degC: FloatArray, shape: Callable[[IntArray, FloatArray], FloatArray]) -> Form:
    """Return the form that PCHIP puts through what `shape` makes of the values at some of the temperatures (S,)."""
    every = np.arange(len(temperature_degC))

    def held_out(values: FloatArray) -> FloatArray:
        errors = np.empty_like(values)
        for left in every.tolist():
            shown = every[every != left]
            # Between two temperatures PCHIP is made of them and the next on either side.
            near = slice(max(left - 2, 0), left + 2) if 0 < left < every[-1] else slice(-2, None) if left else slice(2)
            shaped = shape(shown, values[..., shown])[..., near]
            curve = PchipInterpolator(temperature_degC[shown[near]], shaped, axis=-1)
            at = np.clip(temperature_degC[left], temperature_degC[shown[0]], temperature_degC[shown[-1]])
            errors[..., left] = values[..., left] - curve(at)
        return errors

    return Form(name, None, lambda values: shape(every, values), held_out)


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
    forms = [polynomial(temperature_degC, weight, order) for order in range(highest + 1)]
    if count >= 4:  # the nearest values that only rise or only fall, and the values themselves
        forms.append(interpolated(MONOTONE, temperature_degC, lambda shown, values: monotone(values, weight[shown])))
        forms.append(interpolated(TABLE, temperature_degC, lambda _, values: values))
    return forms
