"""Choosing a form: the simplest that nothing richer beats by more than noise would, judged on what was left out.

Beginning with the constant, the held-out error of the form at hand is compared with the least held-out error of all
richer forms. By how much the richer ones win where the form at hand is true is simulated with the noise of the values;
only a win that noise gives in fewer than `FALSE_ALARM` of campaigns moves on to the next form. So a polynomial is taken
for a higher one in 5 of 100 campaigns. For polynomials the comparison does not depend on the size of the noise, only on
how it is shared among the temperatures. The first step, away from the constant, is taken for several parameters of a
sensor: `first_alarm` is smaller, so that a sensor without temperature dependence is called so in 95 of 100 campaigns.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hil.analysis.thermal.forms import Form, candidate_forms
from hil.campaign import FloatArray

FALSE_ALARM = 0.05
_DUST = 1e-6


@dataclass(frozen=True)
class Choice:
    """The chosen form, the comparisons that led to it, and the held-out error (weighted rms) of every candidate.

    A step has the form at hand, its held-out error, the best of the richer ones, and the chance of noise. `held_out`
    and `held_out_constant` (S,) are the errors at each temperature, in the parameter's unit.
    """

    form: Form
    steps: Sequence[Mapping[str, Any]]
    errors: dict[str, float]
    held_out: FloatArray
    held_out_constant: FloatArray
    weight: FloatArray

    @property
    def chance_of_constant(self) -> float:
        """How often noise alone would make some form beat the constant by as much, were the constant true."""
        return float(self.steps[0]["chance"]) if self.steps else 1.0


def choose(
    temperature_degC: FloatArray,
    values: FloatArray,
    covariance: FloatArray,
    *,
    highest_order: int,
    seed: int = 0,
    draws: int = 999,
    first_alarm: float = FALSE_ALARM,
) -> Choice:
    """Choose a form for `values` (S,) with `covariance` (S, S) at S temperatures, rising; `draws` simulate noise."""
    weight = levelled_weights(covariance)
    forms = candidate_forms(temperature_degC, weight, highest_order)
    errors = {form.name: float(score(form, values, weight)) for form in forms}
    # Rounding is no dependence: an error this far below the noise counts as none.
    dust = _DUST * float(np.sqrt(np.mean(np.diagonal(covariance))))
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal((draws, len(values))) @ _root(covariance).T
    steps: list[dict[str, Any]] = []
    chosen = forms[0]
    for place, form in enumerate(forms):
        richer = forms[place + 1 :]
        chosen = form
        if not richer or form.order is None:
            break
        best = min(errors[each.name] for each in richer)
        win = float(np.log(np.hypot(errors[form.name], dust)) - np.log(np.hypot(best, dust)))
        chance = _chance(form, richer, form.fitted(values), noise, weight, win)
        steps.append({"form": form.name, "error": errors[form.name], "best_richer": best, "chance": chance})
        if chance > (FALSE_ALARM if steps[1:] else first_alarm):
            break
    if chosen.order is None:  # no polynomial will do: of the others the one that predicts better
        chosen = min((form for form in forms if form.order is None), key=lambda form: errors[form.name])
    if errors[chosen.name] > errors[forms[0].name]:
        chosen = forms[0]
    return Choice(chosen, steps, errors, chosen.held_out(values), forms[0].held_out(values), weight)


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


def _chance(
    form: Form, richer: Sequence[Form], truth: FloatArray, noise: FloatArray, weight: FloatArray, win: float
) -> float:
    """Return how often the richer forms win by at least `win` where `truth` (S,) with `noise` (d, S) was measured."""
    drawn = truth + noise
    own = score(form, drawn, weight)
    best = np.min([score(each, drawn, weight) for each in richer], axis=0)
    wins = np.count_nonzero(np.log(own) - np.log(best) >= win)
    return float((1 + wins) / (1 + len(noise)))


def _root(covariance: FloatArray) -> FloatArray:
    """Return a square root, also where some combination is known exactly."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
