"""A frame description in words: what `hil frames check` says about a file that can be used.

print(explain_frames(load_description("configs/imus/stim300.yaml")))
"""

from collections.abc import Iterator

from drivers.frames.checksum_kinds import ChecksumDescription, CrcKind, CrcParameters, FletcherKind, NoChecksum, SumKind
from drivers.frames.description import FrameDescription, StreamDescription
from drivers.frames.fields import FieldDescription
from drivers.frames.lengths import LengthDescription
from drivers.frames.roles import Roles

_NAMES = {
    (32, 0x04C11DB7, 0xFFFFFFFF, False, False, 0): "CRC-32/MPEG-2",
    (32, 0x04C11DB7, 0xFFFFFFFF, True, True, 0xFFFFFFFF): "CRC-32/ISO-HDLC",
    (16, 0x1021, 0, False, False, 0): "CRC-16/XMODEM",
    (16, 0x1021, 0x1D0F, False, False, 0): "CRC-16/SPI-FUJITSU",
    (16, 0x1021, 0xFFFF, False, False, 0): "CRC-16/IBM-3740",
}
_TYPES = {"fp12.20": "12.20 fixed point", "fp16.32": "16.32 fixed point", "item": "in the item's number format"}
_TYPES |= {"f16": "half precision", "f32": "single precision", "f64": "double precision"}
_FORMATS = {"u": "unsigned", "i": "signed"}


def explain_frames(description: StreamDescription) -> str:
    """Return the description in words: the stream, each frame with its fields, what they are for, and what is weak."""
    lines = [f"{description.name}: {len(description.frames)} frame types, {description.byte_order}-endian"]
    lines += [f"  source: {description.source}"] if description.source else []
    lines += [f"  verified: {description.verified}"] if description.verified else []
    lines.append(
        f"  {description.baudrate} baud, {description.sample_rate_hz:g} samples per second unless told otherwise"
    )
    if description.packets is not None:
        lines.append(f"  in packets ({description.packets.kind}), each of them one frame")
    if description.sync:
        lines.append(f"  every frame begins with {_hex(description.sync)}")
    if description.optional_delimiter:
        lines.append(f"  {_hex(description.optional_delimiter)} may follow every frame; the first good frame tells")
    for name, parameter in description.parameters.items():
        choices = "a number" if parameter.choices is None else ", ".join(map(str, parameter.choices))
        unit = f" {parameter.unit}" if parameter.unit else ""
        lines.append(
            f"  the bench file sets {name} ({parameter.meaning}): {choices}{unit}; else {parameter.default}{unit}"
        )
    for name, frame in description.frames.items():
        lines += ["", *_frame(description, name, frame)]
    lines += ["", *_roles(description.roles)]
    warnings = list(_warnings(description))
    if warnings:
        lines += ["", "worth knowing:", *(f"  {warning}" for warning in warnings)]
    return "\n".join(lines) + "\n"


def _hex(data: bytes) -> str:
    return data.hex(" ").upper()


def _frame(description: StreamDescription, name: str, frame: FrameDescription) -> Iterator[str]:
    headers = " or ".join(map(str, description.headers(name))) or "anything"
    title = f"{name}{f' ({frame.meaning})' if frame.meaning else ''}"
    if frame.parts:
        together = f"with the same {frame.by}" if frame.by else "one after another"
        yield f"{title}: put together from {', '.join(frame.parts)}, {together}"
        return
    yield f"{title}: begins with {headers}, {_length(frame)}"
    if frame.delimiter:
        yield f"  ends with {_hex(frame.delimiter)}"
    if frame.text is not None:
        forms = " or ".join(
            f"{_crc(each) if each.kind == 'crc' else 'XOR'}, in {each.stored} digits after {each.mark!r}"
            for each in frame.text.checksums
        )
        yield f"  a line of text; {forms or 'no checksum'}"
    else:
        yield f"  {_checksum(frame.checksum)}"
    offsets = description.offsets(name)
    for field, described in frame.fields.items():
        place = "" if frame.text is not None else f"byte {offsets[field]}: "
        yield f"  {place}{field}, {_field(described)}"
    if frame.items is not None:
        yield f"  from byte {frame.items.begin}: items, each with its id and length; what is not listed is skipped"
        for item in frame.items.known.values():
            mask = f" (seen through {item.mask:#x})" if item.mask is not None else ""
            fields = "; ".join(f"{field}, {_field(described)}" for field, described in item.fields.items())
            yield f"    item {item.id:#x}{mask}: {fields}"
    if frame.counter is not None:
        counter = frame.counter
        yield f"  {counter.field} counts by {counter.step} from frame to frame and comes round at {counter.modulus}"
    elif frame.time is not None:
        yield f"  no counter: {frame.time.field} tells what is missing, at the rate above"
    for field, bits in frame.status.items():
        said = ", ".join(f"{bit.bit} {name}{_good(bit.good)}" for name, bit in bits.items())
        yield f"  bits of {field}: {said}"


def _good(good: int | None) -> str:
    return "" if good is None else f" (good is {good})"


def _length(frame: FrameDescription) -> str:
    length = frame.length
    if isinstance(length, LengthDescription):
        extended = f", or further on where it is {length.extended.mark}" if length.extended is not None else ""
        order = f" ({length.byte_order}-endian)" if length.type == "u16" else ""
        told = f"the number at byte {length.at}{order} and {length.plus} more{extended}"
        return f"{length.shortest} to {length.longest} bytes: {told}"
    return f"at most {frame.longest} bytes" if length is None else f"{length} bytes"


def _crc(kind: CrcParameters) -> str:
    known = _NAMES.get((kind.width, kind.poly, kind.init, kind.refin, kind.refout, kind.xorout))
    turned = {(False, False): "not reflected", (True, True): "reflected"}.get((kind.refin, kind.refout))
    turned = turned or f"only its {'input' if kind.refin else 'output'} reflected"
    last = f"XOR {kind.xorout:#x} at the end" if kind.xorout else "no XOR at the end"
    return f"{known or f'CRC-{kind.width}'} (polynomial {kind.poly:#x}, initially {kind.init:#x}, {turned}, {last})"


def _checksum(kind: ChecksumDescription) -> str:
    if isinstance(kind, NoChecksum):
        return "no checksum"
    if isinstance(kind, CrcKind):
        words = _crc(kind)
        words += f", zeros added up to a multiple of {kind.pad_to}" if kind.pad_to > 1 else ""
    elif isinstance(kind, SumKind):
        words = f"{'negated ' if kind.negate else ''}sum of {kind.word}-byte words, {kind.width} bits"
    else:
        words = "Fletcher's two sums" if isinstance(kind, FletcherKind) else "exclusive or of the bytes"
    parts = [
        f"the byte{'s' * (len(part) > 1)} {_hex(part)} (not sent)"
        if isinstance(part, bytes)
        else f"bytes {part[0]} to {'its end' if part[1] is None else part[1] - 1}"
        for part in kind.span or ((0, None),)
    ]
    words += f", over {', '.join(parts)}, stored {kind.stored}-endian"
    words += f" at byte {kind.at}" if kind.at is not None else ""
    if kind.confirm:
        words += ", believed after damage only where the next frame confirms it"
    return words


def _field(field: FieldDescription) -> str:
    kind = _TYPES.get(field.type)
    if kind is None and field.is_integer:
        kind = f"{field.type[1:]}-bit {_FORMATS[field.type[0]]}"
    words = kind or (f"{field.size} characters" if field.type == "text" else field.type)
    words += f", behind {field.label!r}" if field.label else ""
    words += f", bits {field.mask:#x}" if field.mask is not None else ""
    words += f", {field.byte_order}-endian" if field.byte_order is not None else ""
    words += f", × {field.scale:.10g}" if field.scale != 1.0 else ""
    words += f" {'+' if field.offset > 0 else '−'} {abs(field.offset):.10g}" if field.offset else ""
    scaled = field.scale != 1.0 or field.offset != 0.0
    words += f"{' ' if scaled else ', in '}{field.unit}" if field.unit else ""
    if field.when is not None:
        seen = f" & {field.when.mask:#x}" if field.when.mask is not None else ""
        words += f", where {field.when.field}{seen} is {field.when.equals:#x}"
    return words


def _roles(roles: Roles | None) -> Iterator[str]:
    if roles is None:
        yield "no roles: the stream can be decoded, but no field is known to be a rate"
        return
    yield f"samples come in {roles.frame}"
    for number, sensor in roles.sensors.items():
        rates = ", ".join(f"{channel} is {field}" for channel, field in sensor.rates.items())
        yield f"  sensor {number}: rates {rates} (deg/hr)"
        if sensor.accelerations:
            axes = ", ".join(f"{axis} is {field}" for axis, field in sensor.accelerations.items())
            yield f"    accelerations {axes} (g)"
        yield f"    temperature {'is ' + sensor.temperature if sensor.temperature else 'is not told'}"


def _warnings(description: StreamDescription) -> Iterator[str]:
    for name, frame in description.frames.items():
        kind = frame.checksum
        if frame.parts:
            continue
        if isinstance(kind, NoChecksum) and (frame.text is None or not frame.text.checksums):
            yield f"{name} has no checksum: damage in it goes unnoticed"
        elif frame.text is None and not isinstance(kind, CrcKind) and not kind.confirm:
            yield f"{name}: so weak a checksum matches by chance; with checksum.confirm, the next frame is asked too"
        if frame.counter is not None:
            frames = frame.counter.modulus // frame.counter.step
            seconds = frames / description.sample_rate_hz
            if frames <= 256:
                yield f"{name}: the counter comes round in {seconds:.3g} s; longer outages are told by the clock alone"
    roles = description.roles
    if roles is not None:
        frame = description.frames[roles.frame]
        if frame.counter is None and frame.time is None:
            yield f"{roles.frame} has neither counter nor time: a lost frame shows only in when the others arrive"
