"""The second tier: a base parameter times something that was logged, for what the catalogue has no name for.

term = EmpiricalTerm("MUA", "supply_V")        # id "empirical:MUA*supply_V", called MUA × supply_V, empirical
"""

from collections.abc import Mapping

import numpy as np

from hil.campaign import Conditions, FloatArray, Sensor
from hil.model.effects.base import Base, Effect, Parameter, ShapeParameter
from hil.model.effects.followed import driver_columns, driver_of, driver_reference, driver_values
from hil.model.forms import fullest_form

PREFIX = "empirical:"
EARTH_RATE = "w"
"""The parameter name that stands for the earth rate's share of the rates (a scale-like term)."""


class EmpiricalTerm(Effect):
    """Base parameter (BA, MUA, GXY … or w) × driver of `followed.py`: certain that it is there, not what it is.

    One instance per pair.
    """

    signature = "The parameter follows the driver; no effect of the catalogue does so."
    experiment = "Vary the driver alone."

    def __init__(self, parameter: str, driver: str) -> None:
        self.parameter = parameter
        self.driver = driver
        self.id = f"{PREFIX}{parameter}*{driver}"  # type: ignore[misc]  # one id per pair, fixed at birth
        self.title = f"{parameter} × {driver}, empirical"  # type: ignore[misc]
        self.equation = f"{parameter} += q ({driver} - reference)"  # type: ignore[misc]
        self.follows = driver_of(driver)  # type: ignore[misc]
        self.lasts = self.follows == "time"  # type: ignore[misc]
        self.needs = driver_columns(driver)  # type: ignore[misc]
        self.parameters = (Parameter("q", f"deg/hr per {driver}", (0.1, 10.0)),)  # type: ignore[misc]

    def applies_to(self, sensor: Sensor) -> bool:
        return self.parameter == EARTH_RATE or self.parameter in fullest_form(sensor).names

    def shapes_for(self, conditions: Conditions) -> tuple[ShapeParameter, ...]:
        """Return the driver's median, which a fitted term must keep."""
        return (ShapeParameter("reference", "", (driver_reference(self.driver, conditions),)),)

    def parameters_for(self, conditions: Conditions) -> tuple[Parameter, ...]:
        """Return q, with its unit; typical is what moves the parameter by 0.1 to 10 over the driver's spread."""
        spread = float(np.std(driver_values(self.driver, conditions))) or 1.0
        unit = "1"
        if self.parameter != EARTH_RATE:
            form = fullest_form(conditions.sensor)
            unit = form.units[form.names.index(self.parameter)]
        return (Parameter("q", f"{unit} per {self.driver}", (0.1 / spread, 10.0 / spread)),)

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        driver = driver_values(self.driver, conditions, shape["reference"])
        if self.parameter == EARTH_RATE:
            own = np.nan_to_num(conditions.w_channels_deg_per_hr)
        else:
            form = fullest_form(conditions.sensor)
            own = form.columns(conditions)[:, :, form.names.index(self.parameter)]
        return np.asarray((own * driver[:, None])[..., None])
