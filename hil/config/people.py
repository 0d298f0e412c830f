"""The people of a bench: who measures, and with what, which certificates state; and whom to tell of a night.

laboratory: {name: Gyro laboratory, address: "Street 1, Town", method: WI-17, edition: "3"}
equipment:
  - {name: chamber thermometer, number: KA-0012, certificate: D-K-15070 2025-11, traceable_to: PTB, due: 2026-11-30}
notify:
  to: [env:HIL_NOTIFY, file:/etc/hil/notify]      # one address per line or word there: they are secrets
  about: [started, needs-you, fault, finished]
"""

import logging
import os
from collections.abc import Sequence
from datetime import date
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import AfterValidator, BeforeValidator, Field, field_validator

from drivers.given_file import read_text
from hil.errors import InputError
from hil.files.strict import NAME, REMARK, Section, one_line

Topic = Literal["started", "needs-you", "fault", "finished"]


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


class NotifySection(Section):
    """`to` names environment variables (`env:NAME`) and files (`file:PATH`) that hold the addresses."""

    to: tuple[str, ...] = Field(min_length=1)
    about: tuple[Topic, ...] = get_args(Topic)

    @field_validator("to")
    @classmethod
    def _only_references(cls, to: tuple[str, ...]) -> tuple[str, ...]:
        for place, reference in enumerate(to):
            kind, _, name = reference.partition(":")
            if kind not in {"env", "file"} or not name or name.startswith("//"):
                # What was written may be an address, and so is not repeated here.
                raise ValueError(
                    f"entry {place + 1} is neither env:NAME nor file:PATH; an address does not belong into the bench "
                    "file, which every night keeps a copy of: put it into a variable or a file and name that"
                )
        return to


def addresses_of(reference: str) -> list[str]:
    """Return the addresses that a reference stands for; raise `InputError`, without them, where there is none."""
    kind, _, name = reference.partition(":")
    text = os.environ.get(name) if kind == "env" else read_text(Path(name).expanduser())
    if text is None:
        raise InputError("the variable is not set")
    found = [word for line in text.splitlines() for word in line.split() if not line.lstrip().startswith("#")]
    if not found:
        raise InputError("it holds no address")
    return found


def messenger_of(address: str) -> Any:
    """Return apprise's messenger, None where a POST will do; `InputError`, without the address, where neither can."""
    logging.getLogger("apprise").disabled = True  # it would print addresses
    try:
        import apprise
    except ImportError:
        why = "this kind of address needs apprise: pip install 'hil[notify]'"
    else:
        messenger = apprise.Apprise()
        if messenger.add(address):
            return messenger
        why = "apprise does not understand the address"
    if not address.startswith(("http://", "https://")):
        raise InputError(why)
    return None
