"""The language in which a unit's byte stream is described: one YAML file per unit, no code.

    schema: hil.frames/1
    name: Example unit
    byte_order: big
    sync: FE 81
    frames:
      sample:
        id: FF 55
        length: 36
        checksum: {kind: crc, width: 32, poly: 0x04C11DB7, init: 0xFFFFFFFF}
        fields:
          rate_X: {type: f32, scale: 3600, unit: deg/hr}
          sequence: {type: u8, at: 29}
        counter: {field: sequence, modulus: 128}

`load_description` reads such a file; what is wrong with it is said in one sentence that names the key. The decoder and
the encoder work from the same description, so a simulated unit cannot disagree with the driver about a byte.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag, ValidationError, model_validator

from drivers.errors import InputError
from drivers.frames.checksum_kinds import ChecksumDescription, NoChecksum
from drivers.frames.fields import FieldDescription, Fields, check_places, check_turns, field_offsets
from drivers.frames.items import ItemsDescription
from drivers.frames.lengths import LONGEST, LengthDescription
from drivers.frames.notation import ByteOrder, Described, Factor, HexBytes, Name, WholeNumber
from drivers.frames.parameters import ParameterDescription, put_in, values_of
from drivers.frames.roles import Roles, check_roles
from drivers.frames.text_frames import TextDescription
from drivers.given_file import read_text
from drivers.strict_yaml import first_mistake, parse_yaml


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


Length = Annotated[
    Annotated[int, Tag("<number>")] | Annotated[LengthDescription, Tag("<told>")],
    Discriminator(lambda given: "<told>" if isinstance(given, dict | LengthDescription) else "<number>"),
]


class FrameDescription(Described):
    """One frame type. `length` counts every byte on the wire, from the sync to the delimiter.

    The header is the stream's `sync` followed by this frame's `id` (or one of `more_ids`, which mean the same frame).
    The checksum stands right before the delimiter unless it says otherwise. A frame of `items` or `text` has the fields
    that it has; every other one has fields at fixed places.
    """

    id: HexBytes = b""
    more_ids: list[HexBytes] = Field(default_factory=list)
    meaning: str = ""
    length: Length | None = None
    delimiter: HexBytes = b""
    checksum: ChecksumDescription = NoChecksum(kind="none")
    fields: Fields = Field(default_factory=dict)
    items: ItemsDescription | None = None
    text: TextDescription | None = None
    counter: CounterDescription | None = None
    time: TimeDescription | None = None
    status: dict[str, dict[Name, StatusBit]] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _one_kind(self) -> FrameDescription:
        if (self.length is None) == (self.text is None):
            raise ValueError("length: is given for every frame but one of text")
        if isinstance(self.length, int) and not 2 <= self.length <= LONGEST:
            raise ValueError(f"length: {self.length} is not between 2 and {LONGEST}")
        if self.text is None and "checksum" not in self.model_fields_set:
            raise ValueError("checksum: this key is missing (kind: none where the frame has none)")
        if self.text is not None and (
            not self.delimiter or self.items is not None or "checksum" in self.model_fields_set
        ):
            raise ValueError("text: a line has a delimiter, its checksum under text.checksums, and no items")
        return self

    @property
    def all_fields(self) -> dict[str, FieldDescription]:
        """Every field that a frame of this type may have, those of its items included."""
        return self.fields | (self.items.all_fields() if self.items is not None else {})

    @property
    def shortest(self) -> int:
        """Bytes that a frame has at least."""
        if isinstance(self.length, LengthDescription):
            return self.length.shortest
        return 4 if self.length is None else self.length

    @property
    def longest(self) -> int:
        """Bytes that a frame has at most."""
        if isinstance(self.length, LengthDescription):
            return self.length.longest
        if self.text is not None:
            return self.text.most
        return self.shortest


class CommandsDescription(Described):
    """What the host may send.

    A line is `prefix + command + suffix`; `{xor}` in the suffix is the XOR of the command's bytes in two hexadecimal
    digits. `index` holds `{code}`, the number of the position.
    """

    prefix: str = "$"
    suffix: str = "*{xor}\r\n"
    identify: str | None = None
    index: str | None = None

    def line(self, command: str) -> bytes:
        """Return the bytes on the wire for `command`."""
        check = 0
        for byte in command.encode("ascii"):
            check ^= byte
        return (self.prefix + command + self.suffix.replace("{xor}", f"{check:02X}")).encode("ascii")


class StreamDescription(Described):
    """Everything that is needed to read, and to simulate, one unit's stream.

    `optional_delimiter` follows every frame, or none, as the unit is set; the first good frame tells. It counts in no
    frame's length. `verified` says how sure the description is: by captured bytes, or by manuals alone.
    """

    schema_name: Literal["hil.frames/1"] = Field(alias="schema")
    name: str
    source: str = ""
    verified: str = ""
    baudrate: int = Field(default=115200, gt=0)
    sample_rate_hz: Factor = Field(gt=0)
    partial_frame_wait_s: float = Field(default=0.25, gt=0)
    byte_order: ByteOrder
    sync: HexBytes = b""
    optional_delimiter: HexBytes = b""
    parameters: dict[Name, ParameterDescription] = Field(default_factory=dict)
    frames: dict[Name, FrameDescription] = Field(min_length=1)
    commands: CommandsDescription | None = None
    roles: Roles | None = None

    @model_validator(mode="after")
    def _consistent(self) -> StreamDescription:
        _check_headers(self)
        for name, frame in self.frames.items():
            try:
                _check_frame(self, frame)
            except ValueError as error:
                raise ValueError(f"frames.{name}.{error}") from None
        if self.roles is not None:
            check_roles(
                self.roles, {name: frame.all_fields for name, frame in self.frames.items()}, self._status_bits()
            )
        return self

    def _status_bits(self) -> dict[str, set[str]]:
        return {name: {bit for bits in frame.status.values() for bit in bits} for name, frame in self.frames.items()}

    def header(self, name: str) -> bytes:
        """Return the bytes with which frame `name` begins (the first of them, where it has several ids)."""
        return self.sync + self.frames[name].id

    def headers(self, name: str) -> list[bytes]:
        """Return all the bytes with which frame `name` may begin."""
        return [self.sync + each for each in (self.frames[name].id, *self.frames[name].more_ids)]

    def offsets(self, name: str) -> dict[str, int]:
        """Return the offset of each field at a fixed place from the first byte of frame `name`."""
        return field_offsets(self.frames[name].fields, len(self.header(name)))


def _check_headers(stream: StreamDescription) -> None:
    headers = sorted(header for name in stream.frames for header in stream.headers(name))
    if b"" in headers:
        raise ValueError("sync: a stream without a sync needs an id in every frame")
    for first, second in pairwise(headers):
        if first == second:
            raise ValueError("frames: two frames have the same id, so that nothing tells them apart")
        if second.startswith(first):
            raise ValueError(
                f"frames: the header {first.hex(' ').upper()} is the beginning of {second.hex(' ').upper()}, "
                "so that nothing tells them apart"
            )
    if stream.optional_delimiter and any(header[0] == stream.optional_delimiter[0] for header in headers):
        raise ValueError("optional_delimiter: begins like a frame")


def _check_frame(stream: StreamDescription, frame: FrameDescription) -> None:
    header_end = len(stream.sync) + len(frame.id)
    if any(len(other) != len(frame.id) for other in frame.more_ids):
        raise ValueError("more_ids: have as many bytes as the id")
    check_turns(frame.fields)
    if frame.text is not None:
        _check_text(frame)
    else:
        _check_layout(frame, header_end)
    _check_references(frame)


def _check_text(frame: FrameDescription) -> None:
    for name, field in frame.fields.items():
        if field.type not in ("decimal", "line") or field.at is not None or field.mask is not None:
            raise ValueError(f"fields.{name}.type: in a frame of text, fields are decimal or line, in their order")


def _check_layout(frame: FrameDescription, header_end: int) -> None:
    kind, varies = frame.checksum, isinstance(frame.length, LengthDescription)
    body_end = frame.shortest - len(frame.delimiter)
    at = kind.position(body_end)
    if varies and (kind.at is not None or (kind.span is not None and kind.span[1] is not None)):
        raise ValueError(
            "checksum: in a frame of varying length, it stands before the delimiter and covers [first, null]"
        )
    if at < header_end or at + kind.size > body_end:
        raise ValueError(f"checksum.at: the checksum lies at bytes {at} to {at + kind.size - 1}, outside")
    start, end = kind.covered(body_end)
    if not 0 <= start < end <= at:
        raise ValueError(f"checksum.span: [{start}, {end}] is not a part of the bytes before the checksum (0 to {at})")
    kind.check_span(end - start)
    for name, field in frame.fields.items():
        if field.type in ("item", "decimal", "line"):
            raise ValueError(f"fields.{name}.type: {field.type} has no fixed place")
    # Fields may look at the id where several ids mean this frame.
    begin = header_end - len(frame.id) if frame.more_ids else header_end
    check_places(frame.fields, header_end, begin, at)
    if frame.items is not None:
        if not header_end <= frame.items.begin <= at:
            raise ValueError(f"items.begin: byte {frame.items.begin} is not between {header_end} and {at}")
        double = next((name for name in frame.items.all_fields() if name in frame.fields), None)
        if double is not None:
            raise ValueError(f"items: the field {double!r} is already one of the frame")


def _check_references(frame: FrameDescription) -> None:
    fields = frame.all_fields
    if frame.counter is not None:
        field = fields.get(frame.counter.field)
        if field is None or field.type[0] != "u" or field.when is not None:
            raise ValueError(f"counter.field: {frame.counter.field!r} is not an unsigned field of this frame")
        bits = 8 * field.width if field.mask is None else (field.mask >> field.shift).bit_length()
        if frame.counter.modulus > 1 << bits:
            raise ValueError(f"counter.modulus: {frame.counter.modulus} does not fit in a {field.type}")
        if frame.counter.modulus % frame.counter.step:
            raise ValueError("counter.step: does not divide the modulus, so that a wrap would look like a gap")
    if frame.time is not None and (frame.time.field not in fields or fields[frame.time.field].type[0] != "u"):
        raise ValueError(f"time.field: {frame.time.field!r} is not an unsigned field of this frame")
    for name, bits_of in frame.status.items():
        field = fields.get(name)
        if field is None or field.type[0] != "u":
            raise ValueError(f"status.{name}: is not an unsigned field of this frame")
        for bit_name, bit in bits_of.items():
            if bit.bit >= 8 * field.width:
                raise ValueError(f"status.{name}.{bit_name}: a {field.type} has no bit {bit.bit}")


def parse_description(
    text: str,
    origin: str = "description",
    *,
    parameters: Mapping[str, object] | None = None,
    sample_rate_hz: float | None = None,
) -> StreamDescription:
    """Read a description from YAML text; `origin` (a file name) begins every message of `InputError`.

    `parameters` are what the bench file says about the unit, `sample_rate_hz` the rate where it is not the usual one.
    """
    content = parse_yaml(text, origin)
    if sample_rate_hz is not None:
        content["sample_rate_hz"] = sample_rate_hz
    try:
        content = _with_values(content, parameters or {})
        return StreamDescription.model_validate(content)
    except ValidationError as error:
        raise InputError(f"{origin}: {first_mistake(error, content)}") from None
    except ValueError as error:
        raise InputError(f"{origin}: {error}") from None


def _with_values(content: dict[str, Any], given: Mapping[str, object]) -> dict[str, Any]:
    """Return the content with its parameters put in; what is wrong with the parameters themselves comes first."""
    described = content.get("parameters") or {}
    if not isinstance(described, dict):
        raise ValueError("parameters: is a mapping of names to what they mean")
    try:
        parameters = _Parameters.model_validate({"parameters": described}).parameters
    except ValidationError as error:
        raise ValueError(first_mistake(error, content)) from None
    values = values_of(parameters, given, content.get("sample_rate_hz"))
    rest = {key: value for key, value in content.items() if key != "parameters"}
    return {**put_in(rest, values), "parameters": described}


class _Parameters(Described):
    parameters: dict[Name, ParameterDescription]


def load_description(
    path: Path | str,
    *,
    parameters: Mapping[str, object] | None = None,
    sample_rate_hz: float | None = None,
) -> StreamDescription:
    """Read the description in the file `path`; raise `InputError` where it cannot be used.

    `parameters` and `sample_rate_hz` are those of `parse_description`.
    """
    return parse_description(read_text(path), str(path), parameters=parameters, sample_rate_hz=sample_rate_hz)
