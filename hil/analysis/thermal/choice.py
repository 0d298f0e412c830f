"""Choosing a form: the simplest that nothing richer beats by more than noise would, judged on what was left out.

Beginning with the constant, the held-out error of the form at hand is compared with the least held-out error of all
richer forms. By how much the richer ones win where the form at hand is true is simulated with the noise of the values;
only a win that noise gives in fewer than `FALSE_ALARM` of campaigns moves on to the next form. So a polynomial is taken
for a higher one in 5 of 100 campaigns. For polynomials the comparison does not depend on the size of the noise, only on
how it is shared among the temperatures. The first step, away from the constant, is taken for several parameters of a
sensor: those that are not shown to change, of all together, are `flat` after all (`fit`).

What the choice is worth is judged in the same way: an `Improvement` compares what was left out with a constant.
"""

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator

from hil.analysis.thermal.estimate import Estimates
from hil.campaign import FloatArray, IntArray
from hil.solve.uncertain import CONFIDENCE

FALSE_ALARM = 0.05
_DUST = 1e-6
POLYNOMIALS = ("constant", "linear", "quadratic", "cubic")
MONOTONE, TABLE = "monotone", "table"
_LOWEST_STEP_DEGC = 1e-6
_RESAMPLES = 2000
_DRAWS = 199
_LEAST_TO_CHOOSE = 4


@dataclass(frozen=True)
class Form:
    """One form. `order` is that of a polynomial (0: constant), None for the others.

    `fitted` gives the form fitted to all temperatures, at those temperatures, `held_out` value less prediction at each
    temperature when it is left out; both (..., S) from values (..., S), so that a thousand simulated campaigns cost as
    much as one loop. At the ends a polynomial has to reach beyond what it was shown, as it would in use; the
    interpolating forms hold their end value.
    """

    name: str
    order: int | None
    fitted: Callable[[FloatArray], FloatArray]
    held_out: Callable[[FloatArray], FloatArray]


def polynomial(temperature_degC: FloatArray, weight: FloatArray, order: int) -> Form:
    """Return the form of a polynomial, by least squares with `weight` (S,) (inverse variances)."""
    root = np.sqrt(weight)
    middle = 0.5 * (temperature_degC.min() + temperature_degC.max())
    half = max(0.5 * float(np.ptp(temperature_degC)), _LOWEST_STEP_DEGC)
    scaled = (temperature_degC - middle) / half  # to -1 … 1, which keeps high orders apart
    span = np.linalg.qr(root[:, None] * np.polynomial.polynomial.polyvander(scaled, order))[0]
    hat = (span @ span.T) * root[None, :] / root[:, None]
    # Held-out errors are residuals over one less the leverage.
    left_out = (np.eye(len(weight)) - hat) / (1.0 - np.diagonal(hat))[:, None]
    return Form(
        POLYNOMIALS[order] if order < len(POLYNOMIALS) else f"polynomial of order {order}",
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


class Choice:
    """The chosen form, the comparisons that led to it, and the held-out error (weighted rms) of every candidate.

    A step has the form at hand, its held-out error, the best of the richer ones, and the chance of noise. `held_out`
    and `held_out_constant` (S,) are the errors at each temperature, in the parameter's unit.
    """

    def __init__(
        self,
        temperature_degC: FloatArray,
        values: FloatArray,
        covariance: FloatArray,
        *,
        highest_order: int,
        seed: int = 0,
        draws: int = 999,
    ) -> None:
        """Choose for `values` (S,) with `covariance` (S, S) at S temperatures, rising; `draws` simulate noise."""
        weight = levelled_weights(covariance)
        forms = candidate_forms(temperature_degC, weight, highest_order)
        errors = {form.name: float(score(form, values, weight)) for form in forms}
        # Rounding is no dependence: an error this far below the noise counts as none.
        dust = _DUST * float(np.sqrt(np.mean(np.diagonal(covariance))))
        rng = np.random.default_rng(seed)
        # By eigenvalues, as some combination may be known exactly.
        noise = rng.multivariate_normal(np.zeros(len(values)), covariance, draws, method="eigh", check_valid="ignore")
        steps: list[dict[str, Any]] = []
        chosen = forms[0]
        for place, form in enumerate(forms):
            richer = forms[place + 1 :]
            chosen = form
            if not richer or form.order is None:
                break
            best = min(errors[each.name] for each in richer)
            win = float(np.log(np.hypot(errors[form.name], dust)) - np.log(np.hypot(best, dust)))
            # How often the richer ones win by as much where this form is true, and what was measured is noise.
            drawn = form.fitted(values) + noise
            least = np.min([score(each, drawn, weight) for each in richer], axis=0)
            wins = np.count_nonzero(np.log(score(form, drawn, weight)) - np.log(least) >= win)
            chance = float((1 + wins) / (1 + len(noise)))
            steps.append({"form": form.name, "error": errors[form.name], "best_richer": best, "chance": chance})
            if chance > FALSE_ALARM or win <= 0.0:  # whoever loses by less than noise would make it lose wins nothing
                break
        if chosen.order is None:  # no polynomial will do: of the others the one that predicts better
            chosen = min((form for form in forms if form.order is None), key=lambda form: errors[form.name])
        if errors[chosen.name] > errors[forms[0].name]:
            chosen = forms[0]
        self.form, self.constant, self.steps, self.errors, self.weight = chosen, forms[0], steps, errors, weight
        self.held_out, self.held_out_constant = chosen.held_out(values), forms[0].held_out(values)

    def flat(self) -> "Choice":
        """Return the same comparisons with the constant chosen."""
        found = copy(self)
        found.form, found.held_out = self.constant, self.held_out_constant
        return found

    @property
    def chance_of_constant(self) -> float:
        """How often noise alone would make some form beat the constant by as much, were the constant true."""
        return float(self.steps[0]["chance"]) if self.steps else 1.0


def levelled_weights(covariance: FloatArray) -> FloatArray:
    """Return weights (S,) that sum to 1: inverse variances, a quarter of each its own, the rest the mean of all.

    A standard error from a handful of runs is itself uncertain; one temperature must not win by luck.
    """
    variance = np.diagonal(covariance)
    weight = 1.0 / (0.25 * variance + 0.75 * np.mean(variance))
    return np.asarray(weight / np.sum(weight))


def score(form: Form, values: FloatArray, weight: FloatArray) -> FloatArray:
    """Return the weighted rms held-out error, shape (...) from (..., S)."""
    return np.asarray(np.sqrt(form.held_out(values) ** 2 @ weight))


class Improvement:
    """Held-out rms error with a constant and with the curve, and the share of it that modelling takes away.

    `low` and `high` bound `share` in `CONFIDENCE` of the resamples; `confidence` is how many of them modelling helps.
    `chosen_anew` says that the form was chosen without each temperature that it predicts, so that choosing it cannot
    flatter the result; four temperatures are too few for that. The resamples are the campaign's temperatures drawn
    again: they tell whether the answer hangs on a few of them. It is no interval for the share that another campaign
    would show, which it holds in 40 to 83 of 100 (benchmarks/test_thermal_rates.py); that modelling helps is said of 2
    of 100 where nothing depends on temperature.
    """

    def __init__(self, constant: FloatArray, modelled: FloatArray, weight: FloatArray) -> None:
        """Compare held-out errors (S,) of constant and model, weighted."""
        drawn = np.random.default_rng(0).integers(len(weight), size=(_RESAMPLES, len(weight)))
        before, after = weight * constant**2, weight * modelled**2

        def share(places: IntArray | slice) -> FloatArray:
            first, second = before[places].sum(axis=-1), after[places].sum(axis=-1)
            return np.asarray(np.where(first > 0.0, 1.0 - np.sqrt(second / np.maximum(first, 1e-300)), 0.0))

        resampled, tail = share(drawn), 0.5 * (1.0 - CONFIDENCE)
        self.low, self.high = np.quantile(resampled, [tail, 1.0 - tail]).tolist()
        self.constant, self.modelled = float(np.sqrt(before.sum())), float(np.sqrt(after.sum()))
        self.share = float(share(slice(None)))
        self.confidence = float(np.mean(resampled > 0.0))
        self.chosen_anew = len(weight) > _LEAST_TO_CHOOSE

    @property
    def is_certain(self) -> bool:
        """Whether modelling helps whichever of the temperatures are drawn."""
        return bool(self.low > 0.0)


def nested_errors(temperature_degC: FloatArray, values: Estimates, choice: Choice, highest_order: int) -> FloatArray:
    """Return the error at each temperature (S,) of the form that is chosen, and fitted, without it.

    Where the constant was chosen, or too few temperatures would be left to choose from, it is the chosen form's own.
    """
    count = len(temperature_degC)
    if choice.form.order == 0 or count <= _LEAST_TO_CHOOSE:
        return choice.held_out
    every = {form.name: form for form in candidate_forms(temperature_degC, choice.weight, highest_order)}
    errors = {name: form.held_out(values.values) for name, form in every.items()}
    out = np.empty(count)
    for left in range(count):
        shown = np.flatnonzero(np.arange(count) != left)
        given = temperature_degC[shown], values.values[shown], values.covariance[np.ix_(shown, shown)]
        own = Choice(*given, highest_order=highest_order, draws=_DRAWS)
        out[left] = errors[own.form.name][left]
    return out
