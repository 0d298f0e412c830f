"""Whether parameters are measured well enough to say anything of them.

A standard error as large as what a parameter usually is tells next to nothing about it, however well the residuals
agree. The usual size is the catalogue's: the middle of what is typical for a rotor sensor; for any other, whose
technology a campaign does not tell, that of the technology where it is largest. A bench may ask for more.
"""

import math
from collections.abc import Mapping
from dataclasses import replace

from hil.campaign import Sensor
from hil.model.effects.catalogue import effect_by_id
from hil.model.forms import PER_G, RATE
from procedures.verdict import Judgement, Verdict
from procedures.words import listed

_ROTOR = {each.name: each.size for effect in ("bias", "GS", "MU_real") for each in effect_by_id(effect).parameters}
_OTHER = {
    each.name: max(replace(each, typical=size).size for size in each.typical_other.values())
    for effect in ("bias", "g_sensitivity")
    for each in effect_by_id(effect).parameters
}


def usual_size(parameter: str, sensor: Sensor) -> float:
    """Return how large a bias, deg/hr, or an acceleration sensitivity, deg/hr/g, of a `sensor` usually is.

    >>> round(usual_size("BA", Sensor(2, ("A", "B", "S"), {"RA": "A", "RB": "B"})), 1)
    15.8
    """
    sizes = _ROTOR if sensor.is_rotor else _OTHER
    return sizes.get(parameter, sizes.get(parameter[0], math.inf))


def measured_well_enough(
    errors: Mapping[str, tuple[float | None, str]], sensor: Sensor, accepted: float | None
) -> Judgement:
    """Judge standard `errors` with their units, by parameter, against what is `accepted`, deg/hr (at 1 g), or usual."""
    limits = {
        name: accepted or usual_size(name, sensor)
        for name, (se, unit) in errors.items()
        if se is not None and unit in (RATE, PER_G)
    }
    poor = {name: se for name, limit in limits.items() if (se := errors[name][0] or 0.0) > limit}
    if not poor:
        return Judgement(Verdict.PASS, "")
    worst = max(poor, key=lambda name: poor[name] / limits[name])
    why = "is accepted" if accepted else "such a parameter usually is"
    return Judgement(
        Verdict.INCONCLUSIVE,
        f"{listed(poor)} not measured well enough to say: the standard error of {worst} is {poor[worst]:.3g} "
        f"{errors[worst][1]}, more than {why} ({limits[worst]:.3g})",
    )
