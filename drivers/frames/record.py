"""A frame as one record: functions made for a layout, as `namedtuple` makes a class, for a few frames at a time.

Reading a frame by a loop over its fields costs more than the arithmetic. Here each layout gets functions written out in
full, of nothing but its offsets, scales and checksum: no name and no text of a description comes into them.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from drivers.frames.crc import REVERSED_BITS
from drivers.frames.layout import FrameLayout, TextLayout

if TYPE_CHECKING:
    from drivers.frames.sequence import FrameSequence

Floats = tuple[float, ...]
Taking = Callable[[bytes, "FrameSequence"], list[Floats] | None]

MOST_TUPLES = 128  # frames from which on tuples are made of columns faster than of bytes
_WRITTEN_OUT = 8  # frames up to which a function without a loop is faster

_CODES = {"u8": "B", "i8": "b", "u16": "H", "i16": "h", "u32": "I", "i32": "i", "u64": "Q", "i64": "q"}
_CODES |= {"f32": "f", "f64": "d", "fp12.20": "i"}
_HALVES = {"u24": ("H", "B", 16), "i24": ("H", "b", 16), "fp16.32": ("I", "h", 32)}  # low, high, bits of the low

_READ = """
def read(data):
    return [({values},) for {names} in iter_unpack(data)]
"""

_TAKE = """
def take(data, sequence):
    last, ready = sequence.last, {ready}
    {names} = unpack(data)
    if {good}:
        sequence.last = {counter}
        sequence.number += {n}
        return [{records}]
"""

_TAKE_SEVERAL = """
def take(data, sequence):
    found, last = [], sequence.last
    for {names} in iter_unpack(data):
        if not ({good}):
            return None
        found.append(({values},))
        last = {counter}
    if not all_match(data, {length}):
        return None
    sequence.last = last
    sequence.number += len(found)
    return found
"""


@dataclass(frozen=True)
class _Record:
    """One frame as a record: the struct codes with the byte order before them, and what to write for frame `{k}`.

    `tables` holds the values of fields of one byte: looking one up is cheaper than computing it.
    """

    order: str
    codes: str
    names: str
    values: str
    counter: str
    tables: Mapping[str, list[float]]


def _record(layout: FrameLayout, counter: str | None = None) -> _Record | None:
    """Return a layout's record; None where not every field has a place of its own in it."""
    orders = {layout.order(field) for field in layout.numeric.values()}
    if isinstance(layout, TextLayout) or len(orders) != 1 or layout.absent:
        return None
    little = orders == {"little"}
    codes, names, at = f"{len(layout.header)}s", ["header{k}"], len(layout.header)
    values: dict[str, str] = {}
    tables: dict[str, list[float]] = {}
    counted = "0"
    for number, name in enumerate(sorted(layout.numeric, key=lambda each: layout.offsets[each])):
        field, offset = layout.numeric[name], layout.offsets[name]
        if offset < at or field.mask is not None or field.when is not None:
            return None
        if field.type in _HALVES:
            low, high, bits = _HALVES[field.type]
            low_first = little or field.type == "fp16.32"
            code, pair = (low + high, "lh") if low_first else (high + low, "hl")
            names += [f"{half}{number}_{{k}}" for half in pair]
            wire = f"(h{number}_{{k}} * {1 << bits} + l{number}_{{k}})"
        else:
            code, wire = _CODES[field.type], f"v{number}_{{k}}"
            names.append(wire)
        codes += "x" * (offset - at) + code
        at = offset + field.width
        factor, shift = layout.factor(name), f" + {field.offset!r}" if field.offset else ""
        if field.type == "u8":
            plain = [value * factor for value in range(256)]
            tables[f"table{number}"] = [value + field.offset for value in plain] if shift else plain
            values[name] = f"table{number}[{wire}]"
        elif factor != 1.0:
            values[name] = f"{factor!r} * {wire}{shift}"
        else:
            values[name] = (wire if field.type in ("f32", "f64") else f"{wire} / 1") + shift
        if name == counter:
            counted = wire
    codes += "x" * (layout.length - at - len(layout.delimiter))
    if layout.delimiter:
        codes += f"{len(layout.delimiter)}s"
        names.append("delimiter{k}")
    all_values = ", ".join(values[name] for name in layout.numeric)
    return _Record("<" if little else ">", codes, ", ".join(names), all_values, counted, tables)


@lru_cache(maxsize=256)
def record_reader(layout: FrameLayout) -> Callable[[bytes], list[Floats]] | None:
    """Return the function that reads good frames as tuples of plain floats: all numeric fields in their units.

    Return None where not every field has a place of its own in a record.
    """
    record = _record(layout)
    if record is None:
        return None
    source = _READ.format(values=record.values, names=record.names).format(k=0)
    read: Callable[[bytes], list[Floats]] = _made(source, "read", iter_unpack=_each(record), **record.tables)
    return read


@lru_cache(maxsize=256)
def record_takers(layout: FrameLayout, counter: str | None, step: int, modulus: int) -> Mapping[int, Taking]:
    """Return the functions that verify and read a few frames, by how many bytes they take.

    They give the frames' tuples, and the sequence goes on; they give None, and nothing changes, where a header, a
    delimiter or a checksum is wrong, or where field `counter` is not `step` more than in the frame before, modulo
    `modulus`. There are none where `record_reader` gives None.
    """
    record = _record(layout, counter)
    if record is None:
        return {}
    test = layout.checksum.residue
    reverses = test is not None and test.reverses
    known: dict[str, Any] = {
        "header": layout.header,
        "delimiter": layout.delimiter,
        "matches": layout.checksum.matches,
        "all_match": layout.checksum.all_match,
        "register": None if test is None else test.register,
        "reversed_bits": REVERSED_BITS,
        "iter_unpack": _each(record),
        **record.tables,
    }

    def good(k: int, before: str) -> list[str]:
        ends = [f"header{k} == header", *([f"delimiter{k} == delimiter"] if layout.delimiter else [])]
        counted = record.counter.format(k=k)
        return ends + ([f"({counted} - {before}) % {modulus} == {step}"] if counter is not None else [])

    def verified(k: int, n: int) -> str:
        first, after = (0, layout.length) if test is None else (test.start, test.after)
        part = f"ready[{first + k * layout.length}:{after + k * layout.length}]"
        part = "ready" if (n, first, after) == (1, 0, layout.length) else part
        if test is None:
            return f"matches({part})"
        begin = f", {test.begin}" if test.begin or test.register is not zlib.crc32 else ""
        return f"register({part}{begin}) == {test.residue}"

    takers: dict[int, Taking] = {}
    for n in range(1, _WRITTEN_OUT + 1):
        counters = ["last", *(record.counter.format(k=k) for k in range(n))]
        conditions = [each for k in range(n) for each in good(k, counters[k])] + [verified(k, n) for k in range(n)]
        source = _TAKE.format(
            ready="data.translate(reversed_bits)" if reverses else "data",
            names=", ".join(record.names.format(k=k) for k in range(n)),
            good=" and ".join(conditions),
            counter=counters[n],
            n=n,
            records=", ".join(f"({record.values.format(k=k)},)" for k in range(n)),
        )
        unpack = struct.Struct(record.order + record.codes * n).unpack
        takers[n * layout.length] = _made(source, "take", unpack=unpack, **known)
    source = _TAKE_SEVERAL.format(
        names=record.names.format(k=0),
        good=" and ".join(good(0, "last")),
        values=record.values.format(k=0),
        counter=record.counter.format(k=0),
        length=layout.length,
    )
    several = _made(source, "take", **known)
    return takers | {n * layout.length: several for n in range(_WRITTEN_OUT + 1, MOST_TUPLES)}


def _each(record: _Record) -> Callable[[bytes], Any]:
    return struct.Struct(record.order + record.codes).iter_unpack


def _made(source: str, name: str, **known: Any) -> Any:
    exec(source, known)  # noqa: S102 - numbers and offsets of a checked description, and nothing else
    return known[name]
