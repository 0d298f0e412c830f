"""How often `hil thermal` says what is true, on whole nights of the published layout: no dependence, and known forms.

python -m pytest benchmarks/test_thermal_rates.py -s -p no:randomly --timeout 2400
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np

from hil.analysis.thermal.choice import Choice, Improvement, nested_errors
from hil.analysis.thermal.estimate import Estimates
from hil.analysis.thermal.fit import ParameterFit, fit_thermal
from hil.campaign import Campaign
from tests.hil.analysis.thermal.nights import PUBLISHED_DEGC, Curve, rotor_night, scaled

NIGHTS = 100
FLAT: dict[str, Curve] = {"BA": lambda t: 20.0 + 0.0 * t, "GSA": lambda t: 50.0 + 0.0 * t}
POWERS = {  # of the scaled temperature
    "BA": (20.0, 15.0),
    "BB": (-5.0, -120.0, 0.0, 160.0),
    "GSA": (55.0, 10.0),
    "GSB": (-25.0, -4.0),
    "MUA": (0.0,),
    "MUB": (0.0, 0.0, 20.0),
}
FORMS = ("constant", "linear", "quadratic", "cubic")
SCATTER_OF_TABLE_1 = {  # from run to run at the eight temperatures, physics notes section D
    "BA": (3.9, 1.3, 1.6, 1.6, 0.6, 1.6, 1.6, 0.3),
    "BB": (2.7, 3.0, 14.3, 3.4, 0.8, 7.7, 0.3, 0.3),
    "MUA": (7.3, 1.5, 10.2, 0.3, 4.8, 4.2, 0.3, 0.9),
    "MUB": (0.3, 1.3, 6.4, 6.3, 0.3, 3.7, 5.6, 0.8),
}


def as_uneven_as_table_1(rng: np.random.Generator) -> Campaign:
    """Return a flat night whose scatter differs from temperature to temperature as Table 1's does."""
    parts = [
        rotor_night(
            rng, FLAT, temperatures_degC=(degC,), run_to_run={n: s[place] for n, s in SCATTER_OF_TABLE_1.items()}
        )
        for place, degC in enumerate(PUBLISHED_DEGC)
    ]
    whole = rotor_night(rng, FLAT)
    collects = whole.sensors[2]
    rates = np.concatenate([part.sensors[2].rates_deg_per_hr for part in parts])
    return replace(whole, sensors={2: replace(collects, rates_deg_per_hr=rates)})


def curve(powers: tuple[float, ...]) -> Curve:
    """Return a polynomial in the scaled temperature."""
    return lambda t: np.polynomial.polynomial.polyval(scaled(t), powers)


def covered(fit: ParameterFit, powers: tuple[float, ...], middle_degC: float) -> np.ndarray:
    """Return whether each coefficient's interval holds the truth."""
    inner = np.polynomial.Polynomial([(middle_degC - 15.15) / 44.85, 1.0 / 44.85])
    truth = np.zeros(len(powers))
    own = sum((value * inner**power for power, value in enumerate(powers)), np.polynomial.Polynomial([0.0])).coef
    truth[: len(own)] = own[: len(powers)]
    return np.abs(fit.coefficients.values - truth) <= fit.coefficients.half_width


def test_a_sensor_without_dependence_is_called_so() -> None:
    """All six parameters constant in about 95 of 100 nights."""
    rng = np.random.default_rng(99)
    constant = 0
    for _ in range(NIGHTS):
        parameters = fit_thermal(rotor_night(rng, FLAT)).sensors[2].parameters
        constant += all(each.finding == "constant" for each in parameters.values())
    print(f"\nno dependence: all six parameters constant in {constant} of {NIGHTS} nights")
    assert constant >= 0.88 * NIGHTS


def test_uneven_scatter_is_taken_for_dependence_more_often() -> None:
    """Where the scatter differs between temperatures as Table 1's: in some 15 of 100 nights, without improvement."""
    rng = np.random.default_rng(101)
    constant = claimed = 0
    for _ in range(NIGHTS):
        sensor = fit_thermal(as_uneven_as_table_1(rng)).sensors[2]
        constant += all(each.finding == "constant" for each in sensor.parameters.values())
        claimed += sensor.improvement.is_certain
    print(f"\nuneven scatter: all constant in {constant} of {NIGHTS} nights, improvement claimed in {claimed}")
    assert constant >= 0.78 * NIGHTS
    assert claimed <= 0.05 * NIGHTS


def test_known_forms_are_found_and_their_coefficients_covered() -> None:
    """Lines, a quadratic, a cubic and a constant, each as what it is; then 93-97 % of the intervals hold the truth."""
    rng = np.random.default_rng(100)
    right: Counter[str] = Counter()
    held: list[np.ndarray] = []
    curves = {name: curve(powers) for name, powers in POWERS.items()}
    for _ in range(NIGHTS // 2):
        sensor = fit_thermal(rotor_night(rng, curves)).sensors[2]
        for name, powers in POWERS.items():
            fit = sensor.parameters[name]
            if fit.form == FORMS[len(powers) - 1]:
                right[name] += 1
                held.append(covered(fit, powers, sensor.layout.middle_degC))
    share = float(np.mean(np.concatenate(held)))
    print(f"\nright form, of {NIGHTS // 2} nights: {', '.join(f'{name} {right[name]}' for name in POWERS)}")
    print(f"intervals of {len(np.concatenate(held))} coefficients that hold the truth: {share:.1%}")
    assert min(right[name] for name in POWERS) >= 0.75 * (NIGHTS // 2)
    assert 0.92 <= share <= 0.98


def test_improvement_is_claimed_where_there_is_some_and_its_range_is_no_interval() -> None:
    """One parameter, noise 1: flat, and lines. Drawing temperatures again does not span 95 % of repeats."""
    degC = np.array(PUBLISHED_DEGC)
    rng = np.random.default_rng(3)
    for slope in (0.0, 3.0, 10.0):
        found, before, after = [], [], []
        for _ in range(NIGHTS):
            values = slope * scaled(degC) + rng.standard_normal(8)
            own = Estimates(values, np.eye(8), 16.0)
            choice = Choice(degC, values, np.eye(8), highest_order=5)
            errors = nested_errors(degC, own, choice, 5)
            found.append(Improvement(choice.held_out_constant, errors, choice.weight))
            before.append(float(choice.weight @ choice.held_out_constant**2))
            after.append(float(choice.weight @ errors**2))
        truth = 1.0 - np.sqrt(np.mean(after) / np.mean(before))
        claimed = np.mean([each.is_certain for each in found])
        holds = np.mean([each.low <= truth <= each.high for each in found])
        print(f"\nslope {slope:g}: removes {truth:.0%}; claimed in {claimed:.0%}; the range holds it in {holds:.0%}")
        assert claimed <= 0.05 if slope == 0.0 else claimed >= 0.4
