"""The notify section of a bench file: whom to tell what. Addresses are secrets, so the file only says where they stand.

notify:
  to: [env:HIL_NOTIFY, file:/etc/hil/notify]      # one address per line or word there
  about: [started, needs-you, fault, finished]
"""

import logging
import os
from pathlib import Path
from typing import Any, Literal, get_args

from pydantic import Field, field_validator

from drivers.given_file import read_text
from hil.errors import InputError
from hil.files.strict import Section

Topic = Literal["started", "needs-you", "fault", "finished"]


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
    """Return apprise's messenger, or None where a plain POST of JSON will do.

    Raises `InputError`, without the address, where neither can send to it.
    """
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
