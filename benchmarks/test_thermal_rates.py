"""How often `hil thermal` says what is true, on whole nights of the published layout: no dependence, and known forms.

python -m pytest benchmarks/test_thermal_rates.py -s -p no:randomly --timeout 1200
"""

from __future__ import annotations

from collections import Counter

import numpy as np

from hil.thermal import fit_thermal
from tests.hil.thermal.nights import Curve, rotor_night, scaled

NIGHTS = 100
FLAT: dict[str, Curve] = {"BA": lambda t: 20.0 + 0.0 * t, "GSA": lambda t: 50.0 + 0.0 * t}
CURVED: dict[str, Curve] = {
    "BA": lambda t: 20.0 + 15.0 * scaled(t),
    "BB": lambda t: -5.0 + 40.0 * (4 * scaled(t) ** 3 - 3 * scaled(t)),
    "GSA": lambda t: 55.0 + 10.0 * scaled(t),
    "GSB": lambda t: -25.0 - 4.0 * scaled(t),
    "MUB": lambda t: 20.0 * scaled(t) ** 2,
}
FORMS = {"BA": "linear", "BB": "cubic", "GSA": "linear", "GSB": "linear", "MUA": "constant", "MUB": "quadratic"}


def test_a_sensor_without_dependence_is_called_so() -> None:
    """All six parameters constant in about 95 of 100 nights."""
    rng = np.random.default_rng(99)
    constant = 0
    for _ in range(NIGHTS):
        parameters = fit_thermal(rotor_night(rng, FLAT)).sensors[2].parameters
        constant += all(each.finding == "constant" for each in parameters.values())
    print(f"\nno dependence: all six parameters constant in {constant} of {NIGHTS} nights")
    assert constant >= 0.88 * NIGHTS


def test_known_forms_are_found() -> None:
    """Lines, a quadratic, a cubic and a constant, each as what it is."""
    rng = np.random.default_rng(100)
    right: Counter[str] = Counter()
    for _ in range(NIGHTS // 2):
        parameters = fit_thermal(rotor_night(rng, CURVED)).sensors[2].parameters
        right.update(name for name, form in FORMS.items() if parameters[name].form == form)
    print(f"\nright form, of {NIGHTS // 2} nights: {', '.join(f'{name} {right[name]}' for name in FORMS)}")
    assert min(right[name] for name in FORMS) >= 0.75 * (NIGHTS // 2)
