"""campaign.yaml: what was measured, where, with which channels."""

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields
from datetime import date
from pathlib import Path
from typing import Annotated, Self

from pydantic import BaseModel, BeforeValidator, Field, StrictBool, ValidationError, field_validator, model_validator

from drivers.strict_yaml import Section, check_schema, first_mistake, parse_yaml
from hil.campaign.data import SCHEMA, Campaign, Sensor, Technology
from hil.errors import InputError
from procedures.pose import PoseTolerance
from procedures.verdict import Judgement, Verdict
from procedures.words import harmless, listed

_DATE = re.compile(r"\b\d{4}-[01]\d-[0-3]\d\b")
_Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
_Whole = Annotated[int, Field(strict=True)]  # what sensors and runs are called by
_Name = Annotated[str, Field(min_length=1)]
_Text = Annotated[str, BeforeValidator(lambda value: "" if value is None else harmless(str(value)))]


def hangs_together(axes: Sequence[str], channels: Mapping[str, str]) -> None:
    """Raise `ValueError`, with the key, where axes are not three or a channel measures about none of them."""
    if len(set(axes)) != 3:
        raise ValueError(f"axes: three different names are needed, not {', '.join(axes)}")
    for channel, axis in channels.items():
        if axis not in axes:
            raise ValueError(f"channels.{channel}: there is no axis {axis!r}; allowed: {', '.join(axes)}")


class _Layout(Section):
    """A sensor: three axes, and which of them each channel measures about."""

    axes: tuple[_Name, ...] = Field(min_length=3, max_length=3)
    channels: dict[_Name, str] = Field(min_length=1)
    technology: Technology = ""

    @model_validator(mode="after")
    def _hangs_together(self) -> Self:
        hangs_together(self.axes, self.channels)
        return self

    def sensor(self, number: int) -> Sensor:
        """Return the sensor, its channels in the order of their axes: the six parameters of a rotor depend on none."""
        first, second, third = self.axes
        ordered = dict(sorted(self.channels.items(), key=lambda item: self.axes.index(item[1])))
        return Sensor(number, (first, second, third), ordered, self.technology)


OF_A_SENSOR = frozenset(_Layout.model_fields)


class _Series(BaseModel):
    block_s: _Number | None = None
    collects: _Number = 0.0


class _Judged(Section):
    verdict: Verdict
    reason: _Text = ""


class _Keys(Section):
    """What campaign.yaml may say, beside `schema`."""

    title: _Text = ""
    source: _Text = ""
    notes: _Text = ""
    sensors: dict[_Whole, _Layout] = Field(min_length=1)
    conditions: dict[_Text, _Text] = Field(default_factory=dict)
    site: dict[_Text, _Number] = Field(default_factory=dict)
    identity: dict[_Text, _Text] = Field(default_factory=dict)
    series: _Series = _Series()
    pose: PoseTolerance = PoseTolerance()
    verdicts: dict[_Whole, _Judged] = Field(default_factory=dict)
    missing: tuple[_Text, ...] = ()
    simulated: StrictBool = False
    centrifuge: StrictBool = False
    rebuilt: StrictBool = False
    taken_as_zero: tuple[_Text, ...] = ()
    largest_standard_error_deg_per_hr: Annotated[_Number, Field(gt=0.0)] | None = None

    @field_validator("site")
    @classmethod
    def _on_earth(cls, site: dict[str, float]) -> dict[str, float]:
        if abs(latitude := site.get("latitude_deg", 0.0)) > 90.0:
            raise ValueError(f"latitude_deg {latitude:g}: it must be from -90 to +90 deg")
        return site


@dataclass(frozen=True)
class Header:
    """The checked contents of campaign.yaml: a `campaign` without its collects; `extra` are keys that are not known.

    `series` says of how many collects series were written, 0 where it does not.
    """

    campaign: Campaign
    sensors: Mapping[int, Sensor]
    extra: tuple[str, ...]
    series: float


def parse_header(text: str, path: Path) -> Header:
    """Read and check the text of a campaign.yaml, which stands at `path`; raise InputError with that and the key."""
    keys = parse_yaml(text, str(path))
    check_schema(keys, SCHEMA, str(path))
    del keys["schema"]
    extra = tuple(sorted(str(key) for key in keys.keys() - _Keys.model_fields.keys()))
    known = {key: value for key, value in keys.items() if str(key) not in extra and value is not None}
    try:
        said = _Keys.model_validate(known)
    except ValidationError as error:
        nothing = f"; nothing is known of {listed(extra)}" if extra else ""
        raise InputError(f"{path}, key {first_mistake(error, known)}{nothing}") from None
    as_said = {field.name: getattr(said, field.name) for field in fields(Campaign) if hasattr(said, field.name)}
    otherwise = {
        "title": said.title or path.parent.name,
        "sensors": {},
        "condition_units": said.conditions,
        "simulated": said.simulated or said.notes.startswith("SIMULATED"),
        "folder": path.parent,
        "series_block_s": said.series.block_s,
        "verdicts": {n: Judgement(of.verdict, of.reason or "no reason is given") for n, of in said.verdicts.items()},
        "largest_se": said.largest_standard_error_deg_per_hr,
    }
    campaign = Campaign(**(as_said | otherwise))
    sensors = {number: layout.sensor(number) for number, layout in said.sensors.items()}
    return Header(campaign, sensors, extra, said.series.collects)


def day_of(source: str) -> date | None:
    """Return the first date, such as 1985-10-01, in the words about where a campaign comes from."""
    for said in _DATE.findall(source):
        with suppress(ValueError):  # the 39th of a month
            return date.fromisoformat(said)
    return None
