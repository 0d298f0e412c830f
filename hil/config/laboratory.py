"""Who measures, and with what: the `laboratory` and `equipment` sections of a bench file, which certificates state.

laboratory: {name: Gyro laboratory, address: "Street 1, Town", method: WI-17, edition: "3"}
equipment:
  - {name: chamber thermometer, number: KA-0012, certificate: D-K-15070 2025-11, traceable_to: PTB, due: 2026-11-30}
"""

from collections.abc import Sequence
from datetime import date
from typing import Annotated

from pydantic import AfterValidator, BeforeValidator, Field

from hil.files.strict import NAME, REMARK, Section, one_line


def _day(value: object) -> object:
    try:
        return value if isinstance(value, date) else date.fromisoformat(str(value))
    except ValueError:
        raise ValueError(f"{value!r} is no date; write it as 2026-11-30") from None


def _name(value: str) -> str:
    if not (said := one_line("a name", value, 2 * NAME)):
        raise ValueError("it is empty")
    return said


_Name = Annotated[str, AfterValidator(_name)]
_Text = Annotated[str, Field(max_length=REMARK)]


class LaboratorySection(Section):
    """Who answers for a certificate, and by which `method` in which `edition` it was measured."""

    name: _Name
    address: _Text = ""
    accreditation: _Text = ""
    method: _Name
    edition: Annotated[_Name, BeforeValidator(str)]


class InstrumentSection(Section):
    """An instrument that a number rests upon: its `number`, its own certificate, and until when that is good."""

    name: _Name
    number: Annotated[_Name, BeforeValidator(str)]
    certificate: _Text = ""
    traceable_to: _Text = ""
    due: Annotated[date, BeforeValidator(_day)]


def each_once(given: Sequence[InstrumentSection]) -> Sequence[InstrumentSection]:
    """Return instruments; raise `ValueError` where two have one number."""
    numbers = [each.number for each in given]
    for number in numbers:
        if numbers.count(number) > 1:
            raise ValueError(f"{number}: two instruments have this number")
    return given
