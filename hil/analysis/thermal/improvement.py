"""Does modelling help? The error at a temperature that was left out, with a constant and with the curve.

The form is chosen anew without the temperature that is predicted, so that choosing it cannot flatter the result; four
temperatures are too few for that. The range comes from drawing the temperatures of the campaign again: it tells whether
the answer hangs on a few of them. It is no interval for the share that another campaign would show, which it holds in
40 to 83 of 100 (benchmarks/test_thermal_rates.py); that modelling helps is said of 2 of 100 where nothing depends on
temperature.
"""

from dataclasses import dataclass

import numpy as np

from hil.analysis.thermal.choice import Choice, choose
from hil.analysis.thermal.estimate import Estimates
from hil.analysis.thermal.forms import candidate_forms
from hil.campaign import FloatArray, IntArray
from hil.solve.repeats import CONFIDENCE

_RESAMPLES = 2000
_DRAWS = 199
_LEAST_TO_CHOOSE = 4


@dataclass(frozen=True)
class Improvement:
    """Held-out rms error with a constant and with the curve, and the share of it that modelling takes away.

    `low` and `high` bound `share` in `CONFIDENCE` of the resamples; `confidence` is how many of them modelling helps.
    `chosen_anew` says that the form was chosen without each temperature that it predicts.
    """

    constant: float
    modelled: float
    share: float
    low: float
    high: float
    confidence: float
    chosen_anew: bool

    @property
    def is_certain(self) -> bool:
        """Whether modelling helps whichever of the temperatures are drawn."""
        return self.low > 0.0


def improvement(constant: FloatArray, modelled: FloatArray, weight: FloatArray) -> Improvement:
    """Compare held-out errors (S,) of constant and model, weighted."""
    rng = np.random.default_rng(0)
    drawn = rng.integers(len(weight), size=(_RESAMPLES, len(weight)))
    before, after = weight * constant**2, weight * modelled**2

    def share(places: IntArray | slice) -> FloatArray:
        first, second = before[places].sum(axis=-1), after[places].sum(axis=-1)
        return np.asarray(np.where(first > 0.0, 1.0 - np.sqrt(second / np.maximum(first, 1e-300)), 0.0))

    resampled = share(drawn)
    tail = 0.5 * (1.0 - CONFIDENCE)
    low, high = np.quantile(resampled, [tail, 1.0 - tail])
    return Improvement(
        constant=float(np.sqrt(before.sum())),
        modelled=float(np.sqrt(after.sum())),
        share=float(share(slice(None))),
        low=float(low),
        high=float(high),
        confidence=float(np.mean(resampled > 0.0)),
        chosen_anew=len(weight) > _LEAST_TO_CHOOSE,
    )


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
        own = choose(
            temperature_degC[shown],
            values.values[shown],
            values.covariance[np.ix_(shown, shown)],
            highest_order=highest_order,
            draws=_DRAWS,
        )
        out[left] = errors[own.form.name][left]
    return out
