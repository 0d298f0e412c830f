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

from collections.abc import Mapping
from functools import reduce
from itertools import combinations
from operator import xor
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import Discriminator, Field, Tag, field_validator

from drivers.errors import InputError, worded
from drivers.frames.checksums import ChecksumDescription, PlainKind
from drivers.frames.fields import (
    LONGEST,
    TOKENS,
    FieldDescription,
    Fields,
    LengthDescription,
    check_places,
    check_turns,
    field_offsets,
)
from drivers.frames.items import ItemsDescription
from drivers.frames.notation import (
    ByteOrder,
    Factor,
    Header,
    HexBytes,
    HexHeader,
    Name,
    ParameterDescription,
    put_in,
    values_of,
)
from drivers.frames.packets import PacketDescription
from drivers.frames.roles import CounterDescription, Roles, StatusBit, TimeDescription, check_roles
from drivers.frames.text_frames import TextDescription
from drivers.given_file import read_text
from drivers.strict_yaml import Section, first_mistake, parse_yaml

_DEEPEST = 8  # files that include one another

Length = Annotated[
    Annotated[int, Tag("<number>")] | Annotated[LengthDescription, Tag("<told>")],
    Discriminator(lambda given: "<told>" if isinstance(given, dict | LengthDescription) else "<number>"),
]


class FrameDescription(Section):
    """One frame type. `length` counts every byte on the wire, from the sync to the delimiter.

    The header is the stream's `sync` followed by this frame's `id` (or one of `more_ids`, which mean the same frame);
    in an id, `xx` is any byte. The checksum stands right before the delimiter unless it says otherwise. A frame of
    `items` or `text` has the fields that it has; every other one has fields at fixed places. A sample of `parts` has
    their fields, in this order, or `by` the field that is the same in all. Text without a delimiter ends with (CR) LF.
    """

    id: HexHeader = Header(())
    more_ids: list[HexHeader] = Field(default_factory=list)
    meaning: str = ""
    length: Length | None = None
    delimiter: HexBytes = b""
    parts: list[Name] = Field(default_factory=list)
    by: Name | None = None
    checksum: ChecksumDescription = PlainKind(kind="none")
    fields: Fields = Field(default_factory=dict)
    items: ItemsDescription | None = None
    text: TextDescription | None = None
    counter: CounterDescription | None = None
    time: TimeDescription | None = None
    status: dict[str, dict[Name, StatusBit]] = Field(default_factory=dict)

    def _check(self) -> None:
        if [self.length is None, self.text is None, not self.parts].count(False) != 1:
            raise ValueError("length: is given for every frame but one of text, or of parts")
        if self.parts and self.model_fields_set - {"parts", "by", "meaning", "counter", "time"}:
            raise ValueError("parts: what a sample of several frames holds stands with these")
        if isinstance(self.length, int) and not 2 <= self.length <= LONGEST:
            raise ValueError(f"length: {self.length} is not between 2 and {LONGEST}")
        if self.length is not None and "checksum" not in self.model_fields_set:
            raise ValueError("checksum: this key is missing (kind: none where the frame has none)")
        if self.text is not None and (self.items is not None or "checksum" in self.model_fields_set):
            raise ValueError("text: a line has its checksum under text.checksums, and no items")

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


class CommandsDescription(Section):
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
        check = reduce(xor, command.encode("ascii"), 0)
        return (self.prefix + command + self.suffix.replace("{xor}", f"{check:02X}")).encode("ascii")


class StreamDescription(Section):
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
    packets: PacketDescription | None = None
    optional_delimiter: HexBytes = b""
    parameters: dict[Name, ParameterDescription] = Field(default_factory=dict)
    frames: dict[Name, FrameDescription] = Field(min_length=1)
    commands: CommandsDescription | None = None
    roles: Roles | None = None

    @field_validator("frames")
    @classmethod
    def _with_parts(cls, frames: dict[str, FrameDescription]) -> dict[str, FrameDescription]:
        """Give samples of several frames the fields and the status of these."""
        return {name: _joined(name, frame, frames) if frame.parts else frame for name, frame in frames.items()}

    def _check(self) -> None:
        _check_headers(self)
        for name, frame in self.frames.items():
            with worded(ValueError, f"frames.{name}."):
                _check_frame(self, frame)
        if self.roles is not None:
            frames = self.frames.items()
            bits = {name: {bit for bits in frame.status.values() for bit in bits} for name, frame in frames}
            check_roles(self.roles, {name: frame.all_fields for name, frame in frames}, bits)

    @property
    def tells_serial(self) -> bool:
        """Whether a unit says its serial number."""
        role = None if self.roles is None else self.roles.identity
        return role is not None and role.frame is not None and role.serial is not None

    def headers(self, name: str) -> list[Header]:
        """Return all the bytes with which frame `name` may begin; the first of them is what is written."""
        frame = self.frames[name]
        return [Header((*self.sync, *each.told)) for each in (frame.id, *frame.more_ids)]

    def offsets(self, name: str) -> dict[str, int]:
        """Return the offset of each field at a fixed place from the first byte of frame `name`."""
        return field_offsets(self.frames[name].fields, len(self.headers(name)[0]))


def _joined(name: str, frame: FrameDescription, frames: Mapping[str, FrameDescription]) -> FrameDescription:
    fields: dict[str, FieldDescription] = {}
    status: dict[str, dict[Name, StatusBit]] = {}
    for part in frame.parts:
        if part not in frames or frames[part].parts or frame.parts.count(part) > 1:
            raise ValueError(f"{name}.parts: {part!r} is not one of the other frames, once")
        own = frames[part].all_fields
        if frame.by is not None and frame.by not in own:
            raise ValueError(f"{name}.by: {part} has no field {frame.by!r}")
        double = next((field for field in own if field in fields and field != frame.by), None)
        if double is not None:
            raise ValueError(f"{name}.parts: the field {double!r} of {part} has the name of one in a part before it")
        fields, status = fields | own, status | frames[part].status
    return frame.model_copy(update={"fields": fields, "status": status})


def _check_headers(stream: StreamDescription) -> None:
    headers = [header for name, each in stream.frames.items() if not each.parts for header in stream.headers(name)]
    if stream.packets is not None and stream.optional_delimiter:
        raise ValueError("optional_delimiter: packets have ends of their own")
    if b"" in headers and stream.packets is None:
        raise ValueError("sync: a stream without a sync needs an id in every frame, or packets")
    for first, second in combinations(sorted(headers, key=len), 2):
        alike = all(None in pair or pair[0] == pair[1] for pair in zip(first.told, second.told, strict=False))
        if alike and (stream.packets is None or len(first) == len(second)):
            raise ValueError(
                "frames: two frames have the same id, so that nothing tells them apart"
                if len(first) == len(second)
                else f"frames: the header {first} is the beginning of {second}, so that nothing tells them apart"
            )
    if stream.optional_delimiter and any(header[0] == stream.optional_delimiter[0] for header in headers):
        raise ValueError("optional_delimiter: begins like a frame")


def _check_frame(stream: StreamDescription, frame: FrameDescription) -> None:
    header_end = len(stream.sync) + len(frame.id)
    if any(len(other) != len(frame.id) for other in frame.more_ids):
        raise ValueError("more_ids: have as many bytes as the id")
    if not frame.parts:
        check_turns(frame.fields)
    if frame.text is None and not frame.parts:
        _check_layout(stream, frame, header_end)
    for name, field in frame.fields.items() if frame.text is not None else ():
        token = field.type in TOKENS or field.is_integer
        if not token or field.at is not None or field.mask is not None or field.when is not None:
            raise ValueError(
                f"fields.{name}.type: in a frame of text, fields are decimal, word, line or integers (in hexadecimal "
                "digits), in their order"
            )
    _check_references(frame)


def _check_layout(stream: StreamDescription, frame: FrameDescription, header_end: int) -> None:
    kind = frame.checksum
    length = frame.shortest if not isinstance(frame.length, LengthDescription) else frame.length.whole or frame.shortest
    body_end = length - len(frame.delimiter)
    at, end = kind.position(body_end), kind.content_end(body_end)
    header = (*stream.sync, *frame.id.told)
    if any(byte is not None for byte in header[max(at, 0) : at + kind.size]) or not 0 <= at <= body_end - kind.size:
        raise ValueError(f"checksum.at: the checksum lies at bytes {at} to {at + kind.size - 1}, outside")
    covered = kind.covered(body_end)
    for first, last in [part for part in covered if isinstance(part, tuple)]:
        if not (0 <= first < last <= at or at + kind.size <= first < last <= body_end):
            raise ValueError(
                f"checksum.span: [{first}, {last}] is not a part of the bytes before the checksum (0 to {at}), nor of "
                f"those behind it (to {body_end})"
            )
    kind.check_span(sum(len(part) if isinstance(part, bytes) else part[1] - part[0] for part in covered))
    for name, field in frame.fields.items():
        if field.type == "item" or field.type in TOKENS or field.label:
            raise ValueError(f"fields.{name}.type: {field.type} has no fixed place")
    # Fields may look at the id where it leaves bytes open, or several mean this frame.
    begin = len(stream.sync) if frame.more_ids or None in frame.id.told else header_end
    check_places(frame.fields, header_end, begin, end, range(at, at + kind.size))
    if frame.items is not None:
        if not header_end <= frame.items.begin <= end:
            raise ValueError(f"items.begin: byte {frame.items.begin} is not between {header_end} and {end}")
        double = next((name for name in frame.items.all_fields() if name in frame.fields), None)
        if double is not None:
            raise ValueError(f"items: the field {double!r} is already one of the frame")


def _check_references(frame: FrameDescription) -> None:
    fields = frame.all_fields
    if frame.counter is not None:
        field = fields.get(frame.counter.field)
        if field is None or not _counts(field) or field.when is not None:
            raise ValueError(f"counter.field: {frame.counter.field!r} is not an unsigned field of this frame")
        if field.is_integer and frame.counter.modulus > 1 << field.bits:
            raise ValueError(f"counter.modulus: {frame.counter.modulus} does not fit in a {field.type}")
        if frame.counter.modulus % frame.counter.step:
            raise ValueError("counter.step: does not divide the modulus, so that a wrap would look like a gap")
    if frame.time is not None and (frame.time.field not in fields or not _counts(fields[frame.time.field])):
        raise ValueError(f"time.field: {frame.time.field!r} is not an unsigned field of this frame")
    for name, bits_of in frame.status.items():
        field = fields.get(name)
        if field is None or field.type[0] != "u":
            raise ValueError(f"status.{name}: is not an unsigned field of this frame")
        for bit_name, bit in bits_of.items():
            if bit.bit >= 8 * field.width:
                raise ValueError(f"status.{name}.{bit_name}: a {field.type} has no bit {bit.bit}")


def _counts(field: FieldDescription) -> bool:
    return field.type == "decimal" or field.type[0] == "u"


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
    content = _included(parse_yaml(text, origin), origin)
    if sample_rate_hz is not None:
        content["sample_rate_hz"] = sample_rate_hz
    try:
        content = _with_values(content, parameters or {})
        return StreamDescription.model_validate(content)
    except ValueError as error:
        raise InputError(f"{origin}: {first_mistake(error, content)}") from None


def _with_values(content: dict[str, Any], given: Mapping[str, object]) -> dict[str, Any]:
    """Return the content with its parameters put in; what is wrong with the parameters themselves comes first."""
    described = content.get("parameters") or {}
    if not isinstance(described, dict):
        raise ValueError("parameters: is a mapping of names to what they mean")
    parameters = _Parameters.model_validate({"parameters": described}).parameters
    values = values_of(parameters, given, content.get("sample_rate_hz"))
    rest = {key: value for key, value in content.items() if key != "parameters"}
    return {**put_in(rest, values), "parameters": described}


class _Parameters(Section):
    parameters: dict[Name, ParameterDescription]


def whole_text(path: Path | str) -> str:
    """Return the text of a description with what it includes put in; raise `InputError` as a load does."""
    text = read_text(path)
    content = parse_yaml(text, str(path))
    whole = _included(content, str(path)) if "include" in content else {}
    return yaml.safe_dump(whole, sort_keys=False, allow_unicode=True) if whole else text


def _included(content: dict[str, Any], origin: str, depth: int = 0) -> dict[str, Any]:
    """Put in the files that `include` names, relative to `origin`; what a file says itself comes before them."""
    names = content.pop("include", [])
    whole: dict[str, Any] = {}
    for name in names if isinstance(names, list) else [names]:
        path = Path(origin).parent / str(name)
        if depth > _DEEPEST or path.suffix != ".yaml":
            raise InputError(f"{origin}: include: {name} is no .yaml file, or includes itself")
        whole = _over(_included(parse_yaml(read_text(path), str(path)), str(path), depth + 1), whole)
    return _over(content, whole)


def _over(upper: dict[str, Any], lower: dict[str, Any]) -> dict[str, Any]:
    both = {
        key: _over(upper[key], lower[key])
        for key in lower
        if isinstance(upper.get(key), dict) and isinstance(lower[key], dict)
    }
    return {**lower, **upper, **both}


def load_description(path: Path | str, **otherwise: Any) -> StreamDescription:
    """Read a description, with what is `otherwise`, as `parse_description` does; `InputError` where it is of no use."""
    return parse_description(read_text(path), str(path), **otherwise)
