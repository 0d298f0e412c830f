"""The notify section of a bench file: whom to tell what. Addresses are secrets, so the file only says where they stand.

notify:
  to: [env:HIL_NOTIFY, file:/etc/hil/notify]      # one address per line or word there
  about: [started, needs-you, fault, finished]
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field, field_validator

from hil.files.strict import Section

Topic = Literal["started", "needs-you", "fault", "finished"]
_EVERYTHING: tuple[Topic, ...] = ("started", "needs-you", "fault", "finished")


class NotifySection(Section):
    """`to` names environment variables (`env:NAME`) and files (`file:PATH`) that hold the addresses."""

    to: tuple[str, ...] = Field(min_length=1)
    about: tuple[Topic, ...] = _EVERYTHING

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
