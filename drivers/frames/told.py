"""What some fields tell of the stream itself: which frame this is, when it was taken, whether the unit is well."""

from typing import Literal

from pydantic import Field

from drivers.frames.notation import Described, Factor, WholeNumber


class CounterDescription(Described):
    """The field that counts frames: it takes `step` more from frame to frame, modulo `modulus`.

    The step may be a quotient, such as `2000/${rate}` for a unit that counts its internal samples.
    """

    field: str
    modulus: int = Field(gt=1)
    step: WholeNumber = Field(default=1, ge=1)


class TimeDescription(Described):
    """The field with the unit's own time. Without a counter, it tells how many frames are missing.

    `resolution` is what one of its wire counts is worth, in seconds; it comes round after `modulus` counts.
    """

    field: str
    resolution: Factor = Field(gt=0)
    modulus: int | None = Field(default=None, gt=1)


class StatusBit(Described):
    """One bit of a status field; `good` is the value it has when nothing is wrong, None where it only informs."""

    bit: int = Field(ge=0, lt=64)
    good: Literal[0, 1] | None = 0
    meaning: str = ""
