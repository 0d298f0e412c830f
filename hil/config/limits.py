"""The limits file: what a unit's parameters must be for the unit to be in spec, with units and a decision rule.

`low` and `high` bound a parameter's mean at every temperature, `scatter` its standard deviation from run to run,
`change` how far it may be from an earlier campaign's mean, either way, and `span` the largest less the smallest of its
means over the temperatures. Biases are in deg/hr, sensitivities in deg/hr/g. `hil.analysis.in_spec` judges by it.
"""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, SkipValidation

from hil.campaign import Sensor
from hil.errors import InputError, worded
from hil.files.strict import Section, WholeFile, near, validated_inside
from hil.files.units import RATE, RATE_PER_G, to_number
from hil.model.forms import parameter_names
from procedures.words import counted

_Above = Annotated[float, Field(gt=0.0)] | None


class ParameterLimits(Section):
    """What one parameter may be, in deg/hr (a bias) or deg/hr/g; a limit that is not given is none."""

    low: float | None = None
    high: float | None = None
    scatter: _Above = None
    change: _Above = None
    span: _Above = None

    def _check(self) -> None:
        if all(getattr(self, name) is None for name in type(self).model_fields):
            raise ValueError(f"no limit is given; allowed: {', '.join(type(self).model_fields)}")
        if self.low is not None and self.high is not None and self.low >= self.high:
            raise ValueError(f"low: {self.low:g} is not below high, {self.high:g}: no unit could be in spec")


def _parameter(name: str, given: object) -> ParameterLimits:
    """Read one parameter's limits, in the unit of its kind: B… is a bias, all others go with acceleration."""
    kind, plain = RATE if name.startswith("B") else RATE_PER_G, given
    if isinstance(given, dict):
        plain = dict(given)
        for key in given.keys() & ParameterLimits.model_fields.keys():
            with worded(ValueError, f"{key}: "):
                plain[key] = to_number(given[key], kind)
    return validated_inside(ParameterLimits, plain)


def _by_parameter(given: object) -> object:
    """Read the limits of every sensor; raise `ValueError` that begins with the sensor's number and the parameter."""
    found: dict[Any, dict[str, ParameterLimits]] = {}
    for number, of in given.items() if isinstance(given, dict) else ():
        if not isinstance(of, dict) or not of:
            raise ValueError(f"sensor {number}: must be a mapping from parameters, such as BA, to their limits")
        for name, limits in of.items():
            with worded(ValueError, f"sensor {number}, {name}: "):
                found.setdefault(number, {})[str(name)] = _parameter(str(name), limits)
    return found or given


class Limits(WholeFile):
    """A limits file: for which model of unit, by which rule, and each sensor's limits by parameter."""

    folder = "limits"
    title: str
    origin: str
    unit: str = ""
    decision: Literal["guard band", "simple acceptance"] = "guard band"
    k: Annotated[float, Field(gt=0.0, le=6.0)] = 2.0
    sensors: Annotated[
        dict[int, dict[str, SkipValidation[ParameterLimits]]], BeforeValidator(_by_parameter), Field(min_length=1)
    ]

    @property
    def rule(self) -> str:
        """The decision rule in words."""
        return f"guard band of {self.k:g} standard uncertainties (Student's t)" if self.sigmas else "simple acceptance"

    @property
    def sigmas(self) -> float:
        """How many standard uncertainties the guard band is wide; 0 where the value alone decides."""
        return self.k if self.decision == "guard band" else 0.0

    def check(self, sensors: Mapping[int, Sensor], unit: str = "") -> None:
        """Raise `InputError` for another model of `unit`, a sensor that is not there, a parameter that it has not."""
        if unit and self.unit and unit != self.unit:
            raise InputError(f"{self.source}: unit: these are limits of {self.unit}, and the unit is {unit}")
        for number, of in self.sensors.items():
            if number not in sensors:
                there = ", ".join(map(str, sensors))
                raise InputError(f"{self.source}: sensors.{number}: there is no such sensor; allowed: {there}")
            sensor = sensors[number]
            names = parameter_names(sensor)
            for name in of:
                if name not in names:
                    channels = counted(len(sensor.channels), "channel")
                    kind = "a two-channel rotor sensor" if sensor.is_rotor else f"one of {channels}"
                    raise InputError(
                        f"{self.source}: sensors.{number}.{name}: sensor {number} is {kind}, without such a parameter"
                        f"{near(name, names)}"
                    )


load_limits = Limits.load
