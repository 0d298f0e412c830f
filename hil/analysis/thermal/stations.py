"""The temperatures of a campaign, and from which side each self-calibration came to its own."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from hil.campaign import Conditions, FloatArray, IntArray
from hil.errors import InputError
from hil.solve.temperatures import same_temperature


@dataclass(frozen=True)
class Stations:
    """The temperatures that were visited, rising, and where each of n rows belongs.

    `number` (n,) indexes `centre_degC` (S,), the mean temperature of a station's rows. `direction` (n,) is +1 where the
    run came to its temperature from below, -1 from above, 0 where that is not known (the first of a night).
    """

    number: IntArray
    centre_degC: FloatArray
    direction: FloatArray

    def __len__(self) -> int:
        return len(self.centre_degC)

    @property
    def both_directions(self) -> IntArray:
        """The stations that were reached from below and from above."""
        found = [
            place for place in range(len(self)) if {-1.0, 1.0} <= set(self.direction[self.number == place].tolist())
        ]
        return np.array(found, dtype=np.int64)


def find_stations(conditions: Conditions, apart_degC: float | None = None) -> Stations:
    """Group rows by temperature, as `same_temperature` does; raises `InputError` where the rows have none."""
    temperature = conditions.columns.get("temperature_degC")
    if temperature is None or not np.all(np.isfinite(temperature)):
        what = "lacks the column temperature_degC" if temperature is None else "has rows without temperature_degC"
        raise InputError(f"sensor {conditions.sensor.number}: the campaign {what}; nothing can be said against it")
    number = same_temperature(conditions, apart_degC)
    centre = np.array([np.mean(temperature[number == place]) for place in range(number.max() + 1)])
    rising = np.argsort(centre, kind="stable")
    number = np.argsort(rising)[number]
    return Stations(number, centre[rising], _directions(conditions, number))


def _directions(conditions: Conditions, number: IntArray) -> FloatArray:
    """Return the side from which each row's station was entered, in the order in which the rows were taken."""
    direction = np.zeros(len(number))
    came = 0.0
    order = np.argsort(conditions.start_s, kind="stable")
    for before, here in pairwise(order.tolist()):
        if number[here] != number[before]:
            came = float(np.sign(number[here] - number[before]))
        direction[here] = came
    return direction
