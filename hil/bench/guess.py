"""What a recording of an unknown unit might be: what a person looks for in a hex dump, and a description to start from.

    document = guess_file(Path("unknown.bin"))
    document["fits"], document["length"], document["description"]

Which shipped descriptions read it; how often it repeats itself; which bytes come again and again at that distance;
which checksum stands where; what counts. Nothing of it is certain, and the description says so.
"""

from __future__ import annotations

import contextlib
from collections import Counter
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from pydantic import TypeAdapter

from drivers.frames.checksum_kinds import ChecksumDescription
from drivers.frames.checksums import FrameChecksum
from drivers.frames.wire import read_column
from drivers.given_file import opened
from hil.bench.decode_advice import that_read
from hil.errors import InputError

SCHEMA = "hil.frames-guess/1"
_LOOK = 1 << 17  # bytes from the beginning of a file
_LONGEST = 512  # bytes of a frame that is looked for
_MOST = 0.9  # of frames agree where something is taken for a rule
_FEW = 12  # frames, fewer of which show nothing
_CRCS = [(16, 0x1021, init, False, 0) for init in (0, 0xFFFF, 0x1D0F)]  # width, polynomial, init, reflected, XOR
_CRCS += [(16, 0x1021, 0, True, 0), (16, 0x1021, 0xFFFF, True, 0), (16, 0x1021, 0xFFFF, True, 0xFFFF)]
_CRCS += [(16, 0x8005, 0, True, 0), (16, 0x8005, 0xFFFF, True, 0), (32, 0x04C11DB7, 0, True, 0)]
_CRCS += [(32, 0x04C11DB7, 0xFFFFFFFF, False, 0), (32, 0x04C11DB7, 0xFFFFFFFF, True, 0xFFFFFFFF)]
_TRIED = 6  # places at which a frame may begin
_CHECKSUM: TypeAdapter[ChecksumDescription] = TypeAdapter(ChecksumDescription)
Bytes = NDArray[np.uint8]


def guess_file(path: Path) -> dict[str, Any]:
    """Look at the beginning of a recording and return the document of `hil frames guess`.

    Raise `InputError` where the file cannot be read or holds too little.
    """
    with opened(path) as file:
        data = file.read(_LOOK)
    if len(data) < 4 * _FEW:
        raise InputError(f"{path}: {len(data)} bytes are too few to guess from; record some seconds")
    printable = sum(32 <= byte < 127 or byte in b"\t\r\n" for byte in data) / len(data)
    fits = sorted(that_read(data, least=0.05), reverse=True)
    found = _lines(data) if printable > _MOST else _frames(np.frombuffer(data, np.uint8))
    head: dict[str, Any] = {
        "schema": "hil.frames/1",
        "name": path.stem,
        "verified": "by nothing: guessed from a recording",
    }
    head |= {"sample_rate_hz": 100, "byte_order": "little"}
    return {
        "schema": SCHEMA,
        "file": str(path),
        "bytes": len(data),
        "fits": [{"description": name, "share": share, "frames": ok} for share, ok, name in fits],
        **{key: value for key, value in found.items() if key != "stream"},
        "description": yaml.safe_dump(head | found["stream"], sort_keys=False) if "stream" in found else None,
    }


def _lines(data: bytes) -> dict[str, Any]:
    """Describe lines of text by how the usual one begins and what its tokens are."""
    lines = [line.rstrip(b"\r") for line in data.split(b"\n")[1:-1]]
    separator = max(",;\t ", key=lambda each: sum(each.encode() in line for line in lines))
    shapes = Counter((line.count(separator.encode()), line.split(separator.encode())[0][:1]) for line in lines)
    (number, first), times = shapes.most_common(1)[0]
    begins = not (first[:1].isdigit() or first in (b"-", b"+", b"."))
    sample = next(line for line in lines if line.count(separator.encode()) == number and line.startswith(first))
    words = sample.decode().partition("*")[0].split(separator)
    fields = {
        f"value_{at}": {"type": "decimal" if word.strip().lstrip("+-").replace(".", "", 1).isdigit() else "word"}
        for at, word in enumerate(words[begins:])
    }
    frame: dict[str, Any] = {"text": {"separator": separator}, "fields": fields}
    frame |= {"id": (words[0] + separator).encode().hex(" ").upper()} if begins else {}
    if b"*" in sample:
        frame["text"]["checksums"] = [{"kind": "xor", "mark": "*", "first": 1, "stored": "hex", "digits": 2}]
    return {"lines": times, "stream": {"packets": {"kind": "lines"}, "frames": {"line": frame}}}


def _frames(data: Bytes) -> dict[str, Any]:
    """Describe frames by the bytes that come again at the distance at which the recording repeats itself."""
    lags = range(4, min(_LONGEST, len(data) // _FEW))
    alike = np.array([np.mean(data[lag:] == data[:-lag]) for lag in lags])
    document: dict[str, Any] = {"repeats_every": lags[int(np.flatnonzero(alike > 0.95 * alike.max())[0])]}
    pairs = data[:-1].astype(np.int64) << 8 | data[1:]
    candidates = []
    for pair in np.argsort(np.bincount(pairs, minlength=65536))[-32:].tolist():
        places = np.flatnonzero(pairs == pair)
        gaps = Counter(np.diff(places).tolist()).most_common(1)
        if gaps and gaps[0][1] >= _FEW and gaps[0][0] >= 4:
            candidates.append((gaps[0][0] * gaps[0][1], -int(places[0]), gaps[0][0], places))
    if not candidates:
        return document
    best = max(each[0] for each in candidates)
    first: Bytes | None = None
    likely = sorted((each for each in candidates if 2 * each[0] > best), key=lambda each: each[:2], reverse=True)
    for _, _, length, places in likely[:_TRIED]:
        starts = _beginning(data, places[:-1][np.diff(places) == length], length)
        rows = np.ascontiguousarray(sliding_window_view(data, length)[starts])
        found = _checksum(rows)
        first = rows if first is None else first
        if found is not None:
            return document | _described(rows, found)
    return document | ({} if first is None else _described(first, None))


def _beginning(data: Bytes, starts: NDArray[np.int64], length: int) -> NDArray[np.int64]:
    """Return where frames begin of which `starts`, (n,), are the places of two bytes that all have."""
    starts = starts[(starts > 8) & (starts + length + 2 <= len(data))]
    for step, line_end in (
        (1, True),
        (-1, False),
    ):  # not with the end of the line before; with the first that they share
        while len(starts):
            byte = data[starts - (step < 0)]
            if np.ptp(byte) or (int(byte[0]) in b"\r\n") != line_end or not byte[0] or starts[0] < 2:
                break
            starts = starts + step
    return starts


Sum = tuple[dict[str, Any], int]  # a checksum as it is described, and the size of the delimiter behind it


@cache
def _checks(length: int) -> list[tuple[Sum, FrameChecksum]]:
    """Return the checksums that frames of this length may carry."""
    crcs: list[dict[str, Any]] = [
        {"kind": "crc", "width": width, "poly": poly, "init": init, "refin": turned, "refout": turned, "xorout": last}
        for width, poly, init, turned, last in _CRCS
    ]
    others: list[dict[str, Any]] = [crcs[-2] | {"pad_to": 4}, {"kind": "fletcher"}, {"kind": "xor"}]
    others += [{"kind": "sum", "width": width, "negate": sign} for width, sign in product((16, 8), (False, True))]
    others += [
        {"kind": "sum", "width": 16, "word": 2, "word_order": order, "negate": sign}
        for order, sign in product(("big", "little"), (False, True))
    ]
    given: list[Sum] = [
        ({**kind, "stored": order, "span": [first, None]}, tail)
        for kind, order, tail, first in product([*crcs, *others], ("big", "little"), range(3), range(4))
    ]
    given += [
        ({**kind, "stored": order, "at": at, "span": [[0, at], [at + kind["width"] // 8, None]]}, 0)
        for kind, order, at in product(crcs, ("big", "little"), range(2, 8))
    ]
    checks = []
    for kind, tail in given:
        with contextlib.suppress(ValueError):
            described = _CHECKSUM.validate_python(kind)
            covered = sum(len(range(*part)) for part in described.covered(length - tail) if isinstance(part, tuple))
            described.check_span(covered)
            if covered > 2:
                checks.append(((kind, tail), FrameChecksum(described, length - tail)))
    return checks


def _checksum(rows: Bytes) -> Sum | None:
    """Return a checksum that most of the frames carry, shape (n, length), and the size of the delimiter behind it."""
    few = [bytes(row) for row in rows[:: max(1, len(rows) // 6)][:6]]
    for found, check in _checks(rows.shape[1]) if len(rows) >= _FEW else ():
        if sum(map(check.matches, few)) < len(few) - 1 or check.matches_rows(rows).mean() < _MOST:
            continue
        if not found[1] or not np.ptp(rows[:, -found[1] :], axis=0).any():
            return found
    return None


def _described(rows: Bytes, found: Sum | None) -> dict[str, Any]:
    """Say what frames, bytes of shape (n, length), have in common, and make a stream of it."""
    kind, tail = ({"kind": "none"}, 0) if found is None else found
    kind = {key: value for key, value in kind.items() if value is not False and value != 0}
    described, length = _CHECKSUM.validate_python(kind), rows.shape[1]
    at, end = described.position(length - tail), described.content_end(length - tail)
    steady = [np.bincount(column).max() > _MOST * len(rows) for column in rows.T]
    sync = min(4, at, max(1, next((place for place, same in enumerate(steady) if not same), length)))
    taken = set(range(at, at + described.size))
    fields: dict[str, Any] = {}
    frame: dict[str, Any] = {"length": length, "checksum": kind, "fields": fields}
    frame |= {"delimiter": rows[0, length - tail :].tobytes().hex(" ").upper()} if tail else {}
    counter = _counter(rows, sync, end, taken)
    if counter is not None:
        bits = int(counter["type"][1:])
        fields["count"] = {key: counter[key] for key in ("type", "at", "byte_order")}
        frame["counter"] = {"field": "count", "modulus": 1 << bits, "step": counter["step"]}
        taken |= set(range(counter["at"], counter["at"] + bits // 8))
    fields |= {f"byte_{place}": {"type": "u8", "at": place} for place in range(sync, end) if place not in taken}
    begins = rows[0, :sync].tobytes().hex(" ").upper()
    return {
        "length": length,
        "frames": len(rows),
        "sync": begins,
        "checksum": None if found is None else kind,
        "counter": counter,
        "stream": {"sync": begins, "frames": {"frame": frame}},
    }


def _counter(rows: Bytes, first: int, end: int, taken: set[int]) -> dict[str, Any] | None:
    """Return what steps by the same from frame to frame, bytes (n, length), between two places."""
    found = []
    for (size, order), at in product(((1, "little"), (2, "little"), (2, "big")), range(first, end)):
        if at + size <= end and not taken & set(range(at, at + size)):
            values = read_column(rows, at, f"u{8 * size}", "little" if order == "little" else "big").astype(np.int64)
            step, times = Counter((np.diff(values) % (1 << 8 * size)).tolist()).most_common(1)[0]
            if 0 < step <= 1 << 4 * size and times > _MOST * (len(rows) - 1) and not (1 << 8 * size) % step:
                found.append(
                    (times, size, -step, {"at": at, "type": f"u{8 * size}", "byte_order": order, "step": step})
                )
    return max(found, key=lambda each: each[:3])[3] if found else None
