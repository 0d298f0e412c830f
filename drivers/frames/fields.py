"""Fields as they are written in a description: type, place, scale; arrays, bit fields, turns; and lengths."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from drivers.frames.notation import ByteOrder, Factor, Name
from drivers.strict_yaml import Section

FieldType = Literal[
    "u8", "i8", "u16", "i16", "u24", "i24", "u32", "i32", "u40", "i40", "u48", "i48", "u56", "i56", "u64", "i64",
    "f16", "f32", "f64", "fp12.20", "fp16.32", "text", "item", "decimal", "word", "line",
]  # fmt: skip
SIZES = {f"{kind}{8 * size}": size for size in range(1, 9) for kind in "ui"}
SIZES |= {"f16": 2, "f32": 4, "f64": 8, "fp12.20": 4, "fp16.32": 6}
FIXED_POINT = {"fp12.20": 2.0**-20, "fp16.32": 2.0**-32}
TOKENS = ("decimal", "word", "line")
"""The types that only a line of text has."""


class When(Section):
    """The field is there only in frames in which `field`, seen through `mask`, is `equals`: a multiplexed field."""

    field: Name
    mask: int | None = Field(default=None, gt=0)
    equals: int = Field(ge=0)

    def _check(self) -> None:
        if self.mask is not None and self.equals & ~self.mask:
            raise ValueError(f"equals: {self.equals:#x} has bits that the mask {self.mask:#x} hides")


class FieldDescription(Section):
    """One field: its value is `wire value × scale + offset`, in `unit`.

    `at` is the offset from the frame's first byte; without it the field follows the one before it, `skip` bytes later.
    A text field has `size` bytes of ASCII, padded with NUL or spaces. `mask` takes some bits of an integer, moved down
    so that the lowest of them counts 1; in a signed one the highest is the sign. `fp12.20` and `fp16.32` are fixed
    point, the latter with its fraction first. In a frame of items, type `item` is the type that the item's id tells. In
    a frame of text, `decimal` is the next number, an integer type the next in hexadecimal digits (two's complement),
    `word` the next whatever it is, and `line` the whole line; a number may stand behind its `label`.
    """

    type: FieldType
    at: int | None = Field(default=None, ge=0)
    skip: int = Field(default=0, ge=0)
    size: int | None = Field(default=None, ge=1)
    byte_order: ByteOrder | None = None
    mask: int | None = Field(default=None, gt=0)
    scale: Factor = 1.0
    offset: Factor = 0.0
    unit: str = ""
    when: When | None = None
    label: str = ""

    def _check(self) -> None:
        if (self.type == "text") != (self.size is not None):
            raise ValueError("size is given for a text field, and only for a text field")
        if self.scale == 0.0:
            raise ValueError("scale must not be 0")
        if self.mask is not None and (not self.is_integer or self.mask >> (8 * self.width)):
            raise ValueError(f"mask: {self.mask:#x} is not a part of an integer; this is {self.type}")

    @property
    def width(self) -> int:
        """Bytes on the wire; 0 where the description does not tell."""
        return self.size if self.size is not None else SIZES.get(self.type, 0)

    @property
    def is_text(self) -> bool:
        """True where the value is text."""
        return self.type in ("text", "word", "line")

    @property
    def is_integer(self) -> bool:
        """True where the value is an integer on the wire."""
        return self.type[0] in "ui" and self.type[1:].isdigit()

    @property
    def bits(self) -> int:
        """How many bits of the wire value are the field's."""
        return 8 * self.width if self.mask is None else (self.mask >> self.shift).bit_length()

    @property
    def shift(self) -> int:
        """By how many bits the masked value is moved down."""
        return 0 if self.mask is None else (self.mask & -self.mask).bit_length() - 1


def _expand_arrays(given: Any) -> Any:
    """Replace a field with `names: [x, y, z]` (or `count: 3`) by one field for each, `stride` bytes apart."""
    if not isinstance(given, dict):
        return given
    expanded: dict[Any, Any] = {}
    for name, value in given.items():
        if not isinstance(value, dict) or not {"names", "count", "stride"} & set(value):
            if name in expanded:
                raise ValueError(f"{name}: is already the name of an element of an array before it")
            expanded[name] = value
            continue
        field = dict(value)
        labels = _labels(name, field.pop("names", None), field.pop("count", None))
        width = SIZES.get(str(field.get("type")), 0)
        stride = field.pop("stride", width)
        if not isinstance(stride, int) or isinstance(stride, bool) or stride < width:
            raise ValueError(f"{name}.stride: must be a number of bytes, at least the element's {width}")
        for number, label in enumerate(labels):
            if f"{name}_{label}" in given or f"{name}_{label}" in expanded:
                raise ValueError(f"{name}: its element {name}_{label} has the name of another field")
            element = dict(field)
            if isinstance(field.get("at"), int):
                element["at"] = field["at"] + number * stride
            elif number:
                element["skip"] = stride - width
            expanded[f"{name}_{label}"] = element
    return expanded


def _labels(name: Any, names: Any, count: Any) -> list[str]:
    if (names is None) == (count is None):
        raise ValueError(f"{name}: an array has names or a count, and not both")
    if names is not None:
        if not isinstance(names, list) or not names or len({str(label) for label in names}) < len(names):
            raise ValueError(f"{name}.names: must be a list of different names, such as [x, y, z]")
        return [str(label).lower() if label is True or label is False else str(label) for label in names]
    if not isinstance(count, int) or isinstance(count, bool) or not 1 <= count <= 4096:
        raise ValueError(f"{name}.count: must be a number from 1 to 4096")
    return [str(number) for number in range(count)]


Fields = Annotated[dict[Name, FieldDescription], BeforeValidator(_expand_arrays)]


def field_offsets(fields: Mapping[str, FieldDescription], first: int) -> dict[str, int]:
    """Place the fields: at `at` where it is given, otherwise right after the field before."""
    offsets: dict[str, int] = {}
    following = first
    for name, field in fields.items():
        offsets[name] = following + field.skip if field.at is None else field.at
        following = offsets[name] + field.width
    return offsets


def check_places(
    fields: Mapping[str, FieldDescription], first: int, begin: int, end: int, checksum: range = range(0)
) -> None:
    """Raise `ValueError` where a field lies outside [begin, end) or in the checksum, or two share a byte without need.

    Fields without `at` begin at `first`. Bit fields share bytes, and so do fields that take turns with one another,
    or stand where what tells their turn stands.
    """
    taken: dict[int, list[str]] = {}
    for name, offset in field_offsets(fields, first).items():
        field = fields[name]
        if offset < begin or offset + field.width > end:
            raise ValueError(
                f"fields.{name}: bytes {offset} to {offset + field.width - 1} are not between the header's end "
                f"({begin}) and the checksum ({end})"
            )
        if set(checksum) & set(range(offset, offset + field.width)):
            raise ValueError(f"fields.{name}: lies in the checksum")
        if field.mask is not None:
            continue
        for byte in range(offset, offset + field.width):
            owners = taken.setdefault(byte, [])
            for owner in owners:
                if not _may_share(fields, name, owner):
                    raise ValueError(f"fields.{name}: byte {byte} already belongs to {owner}")
            owners.append(name)


def _may_share(fields: Mapping[str, FieldDescription], name: str, other: str) -> bool:
    """Tell whether two fields may share bytes: one tells the other's turns, or no frame has both."""
    mine, theirs = fields[name].when, fields[other].when
    if mine is None or theirs is None:
        return (mine is not None and mine.field == other) or (theirs is not None and theirs.field == name)
    if mine.field != theirs.field:
        return False
    common = mine.mask if theirs.mask is None else theirs.mask if mine.mask is None else mine.mask & theirs.mask
    return (mine.equals ^ theirs.equals) & (~0 if common is None else common) != 0


def check_turns(fields: Mapping[str, FieldDescription]) -> None:
    """Raise `ValueError` where a multiplexed field is told by something that is no unsigned field."""
    for name, field in fields.items():
        if field.when is not None:
            selector = fields.get(field.when.field)
            if selector is None or selector.type[0] != "u" or selector.when is not None:
                raise ValueError(
                    f"fields.{name}.when.field: {field.when.field!r} is not an unsigned field that is always there"
                )


LONGEST = 65536


class ExtendedLength(Section):
    """Where the length has the value `mark`, the true one stands at `at`, and the frame is `plus` longer than that."""

    mark: int = Field(ge=0)
    at: int = Field(ge=1)
    type: Literal["u8", "u16"] = "u16"
    byte_order: ByteOrder = "big"
    plus: int = Field(ge=0)


class LengthDescription(Section):
    """The frame's length stands in it: the number at `at`, and `plus` bytes more, between `least` and `most`.

    Where a frame is shorter than the `whole`, it was sent without the zeros at its content's end.
    """

    at: int = Field(ge=1)
    type: Literal["u8", "u16"] = "u8"
    byte_order: ByteOrder = "big"
    plus: int = Field(ge=0)
    least: int | None = Field(default=None, ge=2)
    most: int | None = Field(default=None, ge=2, le=LONGEST)
    whole: int | None = Field(default=None, ge=2, le=LONGEST)
    extended: ExtendedLength | None = None

    def _check(self) -> None:
        if self.shortest > self.longest:
            raise ValueError(f"least: {self.shortest} is more than the most, {self.longest}")
        if self.shortest < self.at + SIZES[self.type]:
            raise ValueError(f"least: a frame of {self.shortest} bytes ends before its length at {self.at}")

    @property
    def shortest(self) -> int:
        """Bytes that a frame has at least."""
        return max(self.plus, 2) if self.least is None else self.least

    @property
    def longest(self) -> int:
        """Bytes that a frame has at most."""
        if self.most is not None:
            return self.most
        return min(LONGEST, (1 << 8 * SIZES[self.type]) - 1 + self.plus)

    @property
    def places(self) -> list[int]:
        """The bytes of a frame that tell its length."""
        places = list(range(self.at, self.at + SIZES[self.type]))
        longer = self.extended
        return places if longer is None else [*places, *range(longer.at, longer.at + SIZES[longer.type])]

    def of(self, data: bytes, start: int) -> int | None:
        """Return the length of the frame at `start`: 0 where it is none, None where it is not told yet."""
        end = start + self.at + SIZES[self.type]
        if end > len(data):
            return None
        told, plus = int.from_bytes(data[start + self.at : end], self.byte_order), self.plus
        longer = self.extended
        if longer is not None and told == longer.mark:
            end = start + longer.at + SIZES[longer.type]
            if end > len(data):
                return None
            told, plus = int.from_bytes(data[start + longer.at : end], longer.byte_order), longer.plus
        length = told + plus
        return length if self.shortest <= length <= self.longest else 0
