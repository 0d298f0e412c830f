"""What the fields are for: which is the rate of which sensor, which the temperature, and which tell of the stream.

The rest of the project asks for rates in deg/hr, accelerations in g and temperatures in °C. A description gives them so
(`scale: 3600*2^-14, unit: deg/hr`), and a field with another unit in such a role is refused, never converted.
"""

from collections.abc import Iterable, Mapping
from typing import Literal

from pydantic import Field

from drivers.frames.fields import FieldDescription
from drivers.frames.notation import Factor, WholeNumber
from drivers.strict_yaml import Section


class CounterDescription(Section):
    """The field that counts frames, `step` (perhaps a quotient, `2000/${rate}`) by frame, modulo `modulus`."""

    field: str
    modulus: int = Field(gt=1)
    step: WholeNumber = Field(default=1, ge=1)


class TimeDescription(Section):
    """The unit's time, `resolution` s a count, modulo `modulus`: without a counter it tells what is missing."""

    field: str
    resolution: Factor = Field(gt=0)
    modulus: int | None = Field(default=None, gt=1)


class StatusBit(Section):
    """One bit of a status field; `good` is the value it has when nothing is wrong, None where it only informs."""

    bit: int = Field(ge=0, lt=64)
    good: Literal[0, 1] | None = 0
    meaning: str = ""


class AtRest(Section):
    """What a sound unit's rates are at rest by the data sheet, deg/hr and deg/sqrt(hr); all may be left out."""

    full_scale_deg_per_hr: float | None = Field(default=None, gt=0.0)
    bias_deg_per_hr: float | None = Field(default=None, gt=0.0)
    angle_random_walk_deg_per_root_hr: float | None = Field(default=None, gt=0.0)


class SensorRole(Section):
    """Which decoded fields belong to one sensor.

    `rates` maps channel name (RA, RB, GX …) to field name, deg/hr; `accelerations` maps sensor axis (A, B, S, X …)
    to field name, g; `temperature` is the unit's own sensor, °C, or None where there is none. `conditions` maps
    the campaign columns that belong to this sensor alone (`spin_period_us`) to field names.
    """

    rates: dict[str, str] = Field(min_length=1)
    at_rest: AtRest = AtRest()
    accelerations: dict[str, str] = Field(default_factory=dict)
    temperature: str | None = None
    conditions: dict[str, str] = Field(default_factory=dict)


class IndexRole(Section):
    """How the stream tells the collect position: the field with its code, and the status bits around a move."""

    position: str
    moving: str
    in_position: str
    fault: str | None = None
    rejected: str | None = None


class IdentityRole(Section):
    """The frame that says who the unit is, with its text fields; or, without a frame, a model name from here."""

    frame: str | None = None
    model: str
    serial: str | None = None
    firmware: str | None = None


class Roles(Section):
    """All roles. `frame` is the frame type that carries the samples; `conditions` maps campaign columns to fields."""

    frame: str
    sensors: dict[int, SensorRole] = Field(min_length=1)
    conditions: dict[str, str] = Field(default_factory=dict)
    index: IndexRole | None = None
    identity: IdentityRole | None = None


def check_roles(
    roles: Roles, frames: Mapping[str, Mapping[str, FieldDescription]], bits: Mapping[str, Iterable[str]]
) -> None:
    """Raise `ValueError` naming the key of a role without such a field or status bit, or with another unit."""
    if roles.frame not in frames:
        raise ValueError(f"roles.frame: there is no frame {roles.frame!r}")
    fields = frames[roles.frame]
    for number, sensor in roles.sensors.items():
        place = f"roles.sensors.{number}"
        _check_fields(f"{place}.rates", sensor.rates, fields, "deg/hr")
        _check_fields(f"{place}.accelerations", sensor.accelerations, fields, "g")
        _check_fields(f"{place}.conditions", sensor.conditions, fields, None)
        if sensor.temperature is not None:
            _check_fields(place, {"temperature": sensor.temperature}, fields, "degC")
    _check_fields("roles.conditions", roles.conditions, fields, None)
    if roles.index is not None:
        _check_fields("roles.index", {"position": roles.index.position}, fields, None)
        for key in ("moving", "in_position", "fault", "rejected"):
            bit = getattr(roles.index, key)
            if bit is not None and bit not in bits[roles.frame]:
                raise ValueError(f"roles.index.{key}: there is no status bit {bit!r} in frame {roles.frame!r}")
    if roles.identity is not None and (frame := roles.identity.frame) is not None:
        if frame not in frames:
            raise ValueError(f"roles.identity.frame: there is no frame {frame!r}")
        for key in ("model", "serial", "firmware"):
            name = getattr(roles.identity, key)
            if name is not None and (name not in frames[frame] or frames[frame][name].type != "text"):
                raise ValueError(f"roles.identity.{key}: there is no text field {name!r} in frame {frame!r}")


def _check_fields(
    place: str, wanted: Mapping[str, str], fields: Mapping[str, FieldDescription], unit: str | None
) -> None:
    for key, name in wanted.items():
        if name not in fields or fields[name].is_text:
            raise ValueError(f"{place}.{key}: there is no numeric field {name!r} in the sample frame")
        if unit is not None and fields[name].unit != unit:
            given = fields[name].unit or "no unit"
            raise ValueError(f"{place}.{key}: field {name!r} has {given}; scale it to {unit} and say so in its unit")
