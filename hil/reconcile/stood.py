"""How the sensors of units stood, so that what is laid out for one of them serves others."""

from collections.abc import Mapping

import numpy as np

from hil.campaign import Campaign, Conditions, FloatArray, IntArray
from hil.campaign.stand_ins import WIDEST_DEGC
from hil.solve.temperatures import ELSEWHERE_DEGC, same_temperature

SAME_G = 0.05
"""Units whose accelerations differ by more stood in other positions."""


def beside_the_earth(campaign: Campaign) -> dict[int, FloatArray]:
    """Return the rates of each sensor less the earth's, (n, c) deg/hr: what of a unit is no part of the layout."""
    return {n: of.rates_deg_per_hr - of.conditions.w_channels_deg_per_hr for n, of in campaign.sensors.items()}


class Stood:
    """How the sensors of a campaign stood, by their number: in which positions and runs, at which temperatures."""

    def __init__(self, conditions: Mapping[int, Conditions]) -> None:
        self._known = {
            n: (rows, _in_order(rows), same_temperature(rows) if "temperature_degC" in rows.columns else None)
            for n, rows in conditions.items()
        }

    def like(self, campaign: Campaign) -> bool:
        """Whether every sensor stood so in another campaign."""
        others = campaign.sensors
        return all(n in others and _alike(others[n].conditions, *known) for n, known in self._known.items())


def _alike(other: Conditions, known: Conditions, order: IntArray, levels: IntArray | None) -> bool:
    if len(known) != len(other) or known.sensor.channels != other.sensor.channels:
        return False
    if (levels is None) != ("temperature_degC" not in other.columns):
        return False
    if np.any(order != _in_order(other)) or np.any(np.abs(known.f_g - other.f_g) >= SAME_G):
        return False
    if levels is None:
        return True
    apart = other.columns["temperature_degC"] - known.columns["temperature_degC"]
    near = bool(np.all(np.abs(apart[levels >= 0]) <= WIDEST_DEGC))
    return near and all(abs(np.mean(apart[levels == k])) <= ELSEWHERE_DEGC for k in set(levels[levels >= 0].tolist()))


def _in_order(conditions: Conditions) -> IntArray:
    return np.unique(conditions.run, return_inverse=True)[1]
