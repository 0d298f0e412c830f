"""A frame as one record: functions made for a layout, as `namedtuple` makes a class, for a few frames at a time.

Reading a frame by a loop over its fields costs more than the arithmetic. Here each layout gets two functions written
out in full, of nothing but its offsets, scales and checksum: no name and no text of a description comes into them.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from drivers.frames.crc import REVERSED_BITS
from drivers.frames.layout import FrameLayout, TextLayout

if TYPE_CHECKING:
    from drivers.frames.sequence import FrameSequence

Floats = tuple[float, ...]
Verified = Callable[[bytes, "FrameSequence"], list[Floats] | None]

_CODES = {"u8": "B", "i8": "b", "u16": "H", "i16": "h", "u32": "I", "i32": "i", "u64": "Q", "i64": "q"}
_CODES |= {"f32": "f", "f64": "d", "fp12.20": "i"}
_HALVES = {"u24": ("H", "B", 16), "i24": ("H", "b", 16), "fp16.32": ("I", "h", 32)}  # low, high, bits of the low

_SOURCE = """
def one(data, sequence):
    {names} = unpack(data)
    last, ready = sequence.last, {ready}
    if {good_one}:
        sequence.last = {counter}
        sequence.number += 1
        return [({values},)]

def several(data, sequence):
    found, at, last, ready = [], 0, sequence.last, {ready}
    for {names} in iter_unpack(data):
        if not ({good_next}):
            return None
        found.append(({values},))
        last = {counter}
        at += {length}
    sequence.last = last
    sequence.number += len(found)
    return found

def records(data):
    return [({values},) for {names} in iter_unpack(data)]
"""


@dataclass(frozen=True)
class RecordReader:
    """Reads whole frames of one layout as tuples of plain floats: all numeric fields in their units, in their order.

    `one` takes one frame, `several` more, and the sequence goes on; they return None, and nothing changes, where a
    header, a delimiter or a checksum is wrong or a counter is not one step ahead. `records` takes good frames.
    """

    one: Verified
    several: Verified
    records: Callable[[bytes], list[Floats]]


@lru_cache(maxsize=256)
def record_reader(
    layout: FrameLayout, counter: str | None = None, step: int = 0, modulus: int = 1
) -> RecordReader | None:
    """Return the functions for a layout; field `counter`, if there is one, is `step` more in each, modulo `modulus`.

    Return None where not every field has a record's place of its own.
    """
    orders = {layout.order(field) for field in layout.numeric.values()}
    if isinstance(layout, TextLayout) or len(orders) != 1 or layout.absent:
        return None
    little = orders == {"little"}
    codes, names, at = f"{'<' if little else '>'}{len(layout.header)}s", ["header"], len(layout.header)
    values: dict[str, str] = {}
    counted = "0"
    for number, name in enumerate(sorted(layout.numeric, key=lambda each: layout.offsets[each])):
        field, offset = layout.numeric[name], layout.offsets[name]
        if offset < at or field.mask is not None or field.when is not None:
            return None
        if field.type in _HALVES:
            low, high, bits = _HALVES[field.type]
            low_first = little or field.type == "fp16.32"
            code, pair = (low + high, ("l", "h")) if low_first else (high + low, ("h", "l"))
            names += [f"{half}{number}" for half in pair]
            wire = f"(h{number} * {1 << bits} + l{number})"
        else:
            code, wire = _CODES[field.type], f"v{number}"
            names.append(wire)
        codes += "x" * (offset - at) + code
        at = offset + field.width
        shift = f" + {field.offset!r}" if field.offset else ""
        exact = field.type in ("f32", "f64") and layout.factor(name) == 1.0
        values[name] = wire + ("" if exact else f" * {layout.factor(name)!r}") + shift
        if name == counter:
            counted = wire
    codes += "x" * (layout.length - at - len(layout.delimiter)) + f"{len(layout.delimiter)}s"
    names.append("delimiter")
    in_step = f"({counted} - last) % {modulus} == {step}"
    return _made(layout, codes, names, [values[name] for name in layout.numeric], (counted, in_step))


def _made(
    layout: FrameLayout, codes: str, names: list[str], values: list[str], counting: tuple[str, str]
) -> RecordReader:
    record, test = struct.Struct(codes), layout.checksum.residue
    known: dict[str, Any] = {
        "unpack": record.unpack,
        "iter_unpack": record.iter_unpack,
        "expected": layout.header,
        "ending": layout.delimiter,
        "matches": layout.checksum.matches,
    }
    ready, part, verify = "data", f"[at:at + {layout.length}]", "matches(ready{})"
    if test is not None:
        known |= {"register": test.register, "reversed_bits": REVERSED_BITS}
        ready = "data.translate(reversed_bits)" if test.reverses else "data"
        part = f"[at + {test.start}:at + {test.after}]"
        begin = f", {test.begin}" if test.begin or test.register is not zlib.crc32 else ""
        verify = f"register(ready{{}}{begin}) == {test.residue}"
    whole = test is None or (test.start, test.after) == (0, layout.length)
    good = f"header == expected{' and delimiter == ending' if layout.delimiter else ''} and {counting[1]}"
    source = _SOURCE.format(
        names=", ".join(names),
        values=", ".join(values),
        counter=counting[0],
        ready=ready,
        good_one=f"{good} and {verify.format('' if whole else part.replace('at + ', ''))}",
        good_next=f"{good} and {verify.format(part)}",
        length=layout.length,
    )
    exec(source, known)  # noqa: S102 - numbers and offsets of a checked description, and nothing else
    return RecordReader(known["one"], known["several"], known["records"])
