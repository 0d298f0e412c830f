"""How values are written in a description: bytes as hex digits, factors as products, names; and its base class."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict

from drivers.frames.scale_factor import parse_factor

ByteOrder = Literal["little", "big"]


def _parse_bytes(value: Any) -> Any:
    """Read `FE 81 FF 55` as bytes."""
    if isinstance(value, bytes):
        return value
    if isinstance(value, int) and not isinstance(value, bool):
        raise ValueError(f"write bytes as quoted hex digits, two per byte, not as the number {value}")
    if not isinstance(value, str):
        raise ValueError("bytes are written as hex digits, two per byte: FE 81 FF 55")
    try:
        return bytes.fromhex(value)
    except ValueError:
        raise ValueError(f"{value!r} are not hex digits, two per byte") from None


def _parse_whole(value: Any) -> Any:
    """Read `2000/125` as 16; what is no whole number is refused."""
    number = parse_factor(value)
    if number != round(number):
        raise ValueError(f"{value!r} is {number:g}, not a whole number")
    return round(number)


def _identifier(value: str) -> str:
    if not value.isidentifier():
        raise ValueError(f"{value!r} is not a name (letters, digits and _)")
    return value


HexBytes = Annotated[bytes, BeforeValidator(_parse_bytes)]
Factor = Annotated[float, BeforeValidator(parse_factor)]
WholeNumber = Annotated[int, BeforeValidator(_parse_whole)]
Name = Annotated[str, AfterValidator(_identifier)]


class Described(BaseModel):
    """Base of everything in a description: unknown keys are errors, and nothing changes after it was read."""

    model_config = ConfigDict(extra="forbid", frozen=True)
