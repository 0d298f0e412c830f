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

from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from drivers.frames.checksum_kinds import ChecksumDescription
from drivers.frames.roles import Roles, check_roles
from drivers.frames.scale_factor import parse_factor

ByteOrder = Literal["little", "big"]
FieldType = Literal["u8", "i8", "u16", "i16", "u24", "i24", "u32", "i32", "u64", "i64", "f32", "f64", "text"]
SIZES = {"u8": 1, "i8": 1, "u16": 2, "i16": 2, "u24": 3, "i24": 3, "u32": 4, "i32": 4, "u64": 8, "i64": 8}
SIZES |= {"f32": 4, "f64": 8}


class DescriptionError(ValueError):
    """A frame description that cannot be used. The message names the file and the key."""


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


def _identifier(value: str) -> str:
    if not value.isidentifier():
        raise ValueError(f"{value!r} is not a name (letters, digits and _)")
    return value


HexBytes = Annotated[bytes, BeforeValidator(_parse_bytes)]
Factor = Annotated[float, BeforeValidator(parse_factor)]
Name = Annotated[str, AfterValidator(_identifier)]


class Described(BaseModel):
    """Base of everything in a description: unknown keys are errors, and nothing changes after it was read."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class FieldDescription(Described):
    """One field: its value is `wire value × scale + offset`, in `unit`.

    `at` is the offset from the frame's first byte; without it the field follows the one before it. A text field has
    `size` bytes of ASCII, padded with NUL or spaces.
    """

    type: FieldType
    at: int | None = Field(default=None, ge=0)
    size: int | None = Field(default=None, ge=1)
    byte_order: ByteOrder | None = None
    scale: Factor = 1.0
    offset: Factor = 0.0
    unit: str = ""

    @model_validator(mode="after")
    def _text_has_a_size(self) -> FieldDescription:
        if (self.type == "text") != (self.size is not None):
            raise ValueError("size is given for a text field, and only for a text field")
        if self.scale == 0.0:
            raise ValueError("scale must not be 0")
        return self

    @property
    def width(self) -> int:
        """Bytes on the wire."""
        return self.size if self.size is not None else SIZES[self.type]


class CounterDescription(Described):
    """The field that counts frames: it takes `step` more from frame to frame, modulo `modulus`."""

    field: str
    modulus: int = Field(gt=1)
    step: int = Field(default=1, ge=1)


class StatusBit(Described):
    """One bit of a status field; `good` is the value it has when nothing is wrong, None where it only informs."""

    bit: int = Field(ge=0, lt=64)
    good: Literal[0, 1] | None = 0
    meaning: str = ""


class FrameDescription(Described):
    """One frame type of fixed length. `length` counts every byte on the wire, from the sync to the delimiter.

    The header is the stream's `sync` followed by this frame's `id`. The checksum stands right before the delimiter
    unless it says otherwise.
    """

    id: HexBytes = b""
    length: int = Field(ge=2, le=65536)
    delimiter: HexBytes = b""
    checksum: ChecksumDescription
    fields: dict[Name, FieldDescription] = Field(default_factory=dict)
    counter: CounterDescription | None = None
    status: dict[str, dict[Name, StatusBit]] = Field(default_factory=dict)


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
    """Everything that is needed to read, and to simulate, one unit's stream."""

    schema_name: Literal["hil.frames/1"] = Field(alias="schema")
    name: str
    source: str = ""
    baudrate: int = Field(default=115200, gt=0)
    sample_rate_hz: float = Field(gt=0)
    partial_frame_wait_s: float = Field(default=0.25, gt=0)
    byte_order: ByteOrder
    sync: HexBytes = b""
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
            check_roles(self.roles, {name: frame.fields for name, frame in self.frames.items()}, self._status_bits())
        return self

    def _status_bits(self) -> dict[str, set[str]]:
        return {name: {bit for bits in frame.status.values() for bit in bits} for name, frame in self.frames.items()}

    def header(self, name: str) -> bytes:
        """Return the bytes with which frame `name` begins."""
        return self.sync + self.frames[name].id

    def offsets(self, name: str) -> dict[str, int]:
        """Return each field's offset from the first byte of frame `name`."""
        return field_offsets(self.frames[name].fields, len(self.header(name)))


def field_offsets(fields: dict[str, FieldDescription], first: int) -> dict[str, int]:
    """Place the fields: at `at` where it is given, otherwise right after the field before."""
    offsets: dict[str, int] = {}
    following = first
    for name, field in fields.items():
        offsets[name] = following if field.at is None else field.at
        following = offsets[name] + field.width
    return offsets


def _check_headers(stream: StreamDescription) -> None:
    lengths = {len(frame.id) for frame in stream.frames.values()}
    if len(lengths) > 1:
        raise ValueError("frames: every frame's id has the same number of bytes")
    if not stream.sync and lengths == {0}:
        raise ValueError("sync: a stream without a sync needs an id in every frame")
    ids = [frame.id for frame in stream.frames.values()]
    if len(set(ids)) < len(ids):
        raise ValueError("frames: two frames have the same id, so that nothing tells them apart")


def _check_frame(stream: StreamDescription, frame: FrameDescription) -> None:
    header_end = len(stream.sync) + len(frame.id)
    body_end = frame.length - len(frame.delimiter)
    at = frame.checksum.position(body_end)
    if at < header_end or at + frame.checksum.size > body_end:
        raise ValueError(f"checksum.at: the checksum lies at bytes {at} to {at + frame.checksum.size - 1}, outside")
    start, end = frame.checksum.covered(body_end)
    if not 0 <= start < end <= at:
        raise ValueError(f"checksum.span: [{start}, {end}] is not a part of the bytes before the checksum (0 to {at})")
    frame.checksum.check_span(end - start)
    taken: dict[int, str] = {}
    for name, offset in field_offsets(frame.fields, header_end).items():
        width = frame.fields[name].width
        if offset < header_end or offset + width > at:
            raise ValueError(
                f"fields.{name}: bytes {offset} to {offset + width - 1} are not between the header's end "
                f"({header_end}) and the checksum ({at})"
            )
        for byte in range(offset, offset + width):
            if byte in taken:
                raise ValueError(f"fields.{name}: byte {byte} already belongs to {taken[byte]}")
            taken[byte] = name
    _check_references(frame)


def _check_references(frame: FrameDescription) -> None:
    if frame.counter is not None:
        field = frame.fields.get(frame.counter.field)
        if field is None or field.type[0] != "u":
            raise ValueError(f"counter.field: {frame.counter.field!r} is not an unsigned field of this frame")
        if frame.counter.modulus > 1 << (8 * field.width):
            raise ValueError(f"counter.modulus: {frame.counter.modulus} does not fit in a {field.type}")
        if frame.counter.modulus % frame.counter.step:
            raise ValueError("counter.step: does not divide the modulus, so that a wrap would look like a gap")
    for name, bits in frame.status.items():
        field = frame.fields.get(name)
        if field is None or field.type[0] != "u":
            raise ValueError(f"status.{name}: is not an unsigned field of this frame")
        for bit_name, bit in bits.items():
            if bit.bit >= 8 * field.width:
                raise ValueError(f"status.{name}.{bit_name}: a {field.type} has no bit {bit.bit}")


class _Loader(yaml.SafeLoader):
    """The safe loader, which also refuses a key that is given twice: the first one would be lost in silence."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Build a mapping; raise where a key repeats."""
        seen: set[str] = set()
        for key, _ in node.value:
            if key.value in seen and key.tag != "tag:yaml.org,2002:merge":
                raise yaml.MarkedYAMLError(problem=f"key {key.value!r} is given twice", problem_mark=key.start_mark)
            seen.add(key.value)
        return super().construct_mapping(node, deep)


def parse_description(text: str, origin: str = "description") -> StreamDescription:
    """Read a description from YAML text; `origin` (a file name) begins every message of `DescriptionError`."""
    try:
        content = yaml.load(text, _Loader)  # noqa: S506 - a safe loader with one more check
    except yaml.YAMLError as error:
        raise DescriptionError(f"{origin}: not YAML: {' '.join(str(error).split())}") from None
    if not isinstance(content, dict):
        raise DescriptionError(f"{origin}: a frame description is a mapping of keys to values")
    try:
        return StreamDescription.model_validate(content)
    except ValidationError as error:
        raise DescriptionError(f"{origin}: {_first_problem(error)}") from None


def load_description(path: Path | str) -> StreamDescription:
    """Read the description in the file `path`; raise `DescriptionError` where it cannot be used."""
    try:
        text = Path(path).read_text(encoding="utf-8")
    except OSError as error:
        raise DescriptionError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise DescriptionError(f"{path}: is not UTF-8 text") from None
    return parse_description(text, str(path))


def _first_problem(error: ValidationError) -> str:
    problems = error.errors(include_url=False)
    first = problems[0]
    place = ".".join(str(part) for part in first["loc"] if part != "function-after")
    message = first["msg"].removeprefix("Value error, ").removesuffix(".")
    rest = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
    return f"{place}: {message}{rest}" if place else f"{message}{rest}"
