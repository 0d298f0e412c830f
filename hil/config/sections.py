"""A procedure's dataclass of settings as a section of a configuration file, with units.

`Restabilisation.at_least_s` is written `at_least: 45 min`, `band_degC` is `band: 0.5 degC`. The names and defaults stay
in one place, the procedures; what a file does not give keeps its default.
"""

from collections.abc import Mapping
from dataclasses import MISSING, fields
from typing import Any, get_args, get_type_hints

from pydantic import BeforeValidator, create_model

from hil.files import units
from hil.files.strict import Section, validated_inside

_BY_SUFFIX: Mapping[str, Any] = {
    "_deg_per_hr_per_min": units.DegreesPerHourPerMinute,
    "_degC_per_min": units.CelsiusPerMinute,
    "_degC": units.CelsiusDifference,
    "_deg": units.Degrees,
    "_g": units.Gravities,
    "_s": units.Seconds,
}
_POINTS = frozenset({"unit_low_degC", "unit_high_degC", "low_degC", "high_degC", "temperature_degC"})
"""The readings of a thermometer among the differences."""


def _key_and_type(name: str, plain: Any) -> tuple[str, Any]:
    for suffix, quantity in _BY_SUFFIX.items():
        if name.endswith(suffix):
            quantity = units.Celsius if name in _POINTS else quantity
            return name.removesuffix(suffix), quantity | None if type(None) in get_args(plain) else quantity
    return name, plain


def settings_of(settings: type) -> BeforeValidator:
    """Return what reads a mapping of a file as a procedure's settings, or raises `ValueError` where it cannot be."""

    def read(given: object) -> Any:
        hints = get_type_hints(settings, include_extras=True)
        keys = {name: _key_and_type(name, hint) for name, hint in hints.items()}
        # A key that is not given has no value here: the dataclass has the default.
        needed = {item.name for item in fields(settings) if item.default is MISSING}
        given_by: dict[str, Any] = {key: (kind, ... if name in needed else None) for name, (key, kind) in keys.items()}
        model = create_model(f"{settings.__name__}Section", __base__=Section, __doc__=settings.__doc__, **given_by)
        section = validated_inside(model, given)
        said = {name: key for name, (key, _) in keys.items() if key in section.model_fields_set}
        return settings(**{name: getattr(section, key) for name, key in said.items()})

    return BeforeValidator(read)
