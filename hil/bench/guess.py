"""What a recording of an unknown unit might be: what a person looks for in a hex dump, and a description to start from.

And what to say of one that a frame description does not fit: a wrong one gives no wrong numbers, but no numbers either.
Which shipped descriptions read it; how often it repeats itself; which bytes come again and again at that distance;
which checksum stands where; what counts. Nothing of it is certain, and the description says so.
"""

import contextlib
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from pydantic import TypeAdapter

from drivers.frames.checksums import ChecksumDescription, FrameChecksum
from drivers.frames.counts import StreamCounts
from drivers.frames.decoder import StreamDecoder
from drivers.frames.description import StreamDescription, load_description
from drivers.given_file import opened
from drivers.strict_yaml import packaged
from hil.errors import InputError
from hil.files.page import templates
from hil.files.strict import config_folders
from procedures.words import counted

SCHEMA = "hil.frames-guess/1"
_LOOK = 1 << 17  # bytes from the beginning of a file
_TRY = 1 << 16  # bytes from there that are tried with other descriptions
_LONGEST = 512  # bytes of a frame that is looked for
_MOST = 0.9  # of frames agree where something is taken for a rule
_FEW = 12  # frames, fewer of which show nothing
_KINDS: list[dict[str, Any]] = packaged("hil.bench", "checksums.yaml")["kinds"]
_INSIDE = [kind for kind in _KINDS if kind["kind"] == "crc" and "pad_to" not in kind]  # may stand before the content
_RATE = ("_hz: 100\n", "_hz: 100  # TO DO: no recording tells it; write what the unit sends\n")
_TRIED = 6  # places at which a frame may begin
_CHECKSUM: TypeAdapter[ChecksumDescription] = TypeAdapter(ChecksumDescription)
Bytes = NDArray[np.uint8]


def guess_file(path: Path) -> dict[str, Any]:
    """Return the document of `hil frames guess`; `InputError` for a file that cannot be read or holds too little."""
    with opened(path) as file:
        data = file.read(_LOOK)
    if len(data) < 4 * _FEW:
        raise InputError(f"{path}: too few bytes ({len(data)}) to guess from; record some seconds")
    printable = sum(32 <= byte < 127 or byte in b"\t\r\n" for byte in data) / len(data)
    fits = sorted(that_read(data, least=0.05), reverse=True)
    found = _lines(data) if printable > _MOST else _frames(np.frombuffer(data, np.uint8))
    stream = found.pop("stream", None)
    head: dict[str, Any] = {"schema": "hil.frames/1", "name": path.stem, "verified": "by nothing: guessed"}
    head |= {"sample_rate_hz": 100, "byte_order": "little"}
    return {
        "schema": SCHEMA,
        "file": str(path),
        "bytes": len(data),
        "fits": [{"description": name, "share": share, "frames": ok} for share, ok, name in fits],
        **found,
        "description": yaml.safe_dump(head | stream, sort_keys=False).replace(*_RATE) if stream else None,
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
    best = max((each[0] for each in candidates), default=0)
    likely = sorted((each for each in candidates if 2 * each[0] > best), key=lambda each: each[:2], reverse=True)
    tried = []
    for _, _, length, places in likely[:_TRIED]:
        starts = _beginning(data, places[:-1][np.diff(places) == length], length)
        tried.append(np.ascontiguousarray(sliding_window_view(data, length)[starts]))
        found = _checksum(tried[-1])
        if found is not None:
            return document | _described(tried[-1], found)
    return document | (_described(tried[0], None) if tried else {})


def _beginning(data: Bytes, starts: NDArray[np.int64], length: int) -> NDArray[np.int64]:
    """Return where frames begin of which `starts`, (n,), are the places of two bytes that all have."""
    starts = starts[(starts > 8) & (starts + length + 2 <= len(data))]
    # Not with the end of the line before; with the first that they share.
    for step, line_end in ((1, True), (-1, False)):
        while len(starts):
            byte = data[starts - (step < 0)]
            if np.ptp(byte) or (int(byte[0]) in b"\r\n") != line_end or not byte[0] or starts[0] < 2:
                break
            starts = starts + step
    return starts


@cache
def _checks(length: int, tail: int) -> list[tuple[dict[str, Any], FrameChecksum]]:
    """Return the checksums that frames of this length, with a delimiter of `tail` bytes, may carry."""
    orders = ("big", "little")
    given = [kind | {"stored": order, "span": [at, None]} for kind, order, at in product(_KINDS, orders, range(4))]
    given += [
        kind | {"stored": order, "at": at, "span": [[0, at], [at + kind["width"] // 8, None]]}
        for kind, order, at in product(_INSIDE, orders, range(2, 8))
    ]
    checks = []
    for kind in given:
        with contextlib.suppress(ValueError):
            described = _CHECKSUM.validate_python(kind)
            covered = sum(len(range(*part)) for part in described.covered(length - tail) if isinstance(part, tuple))
            described.check_span(covered)
            if covered > 2:
                checks.append((kind, FrameChecksum(described, length - tail)))
    return checks


def _tail(rows: Bytes) -> int:
    """Return how many bytes at the end of all frames, bytes of shape (n, length), are the same: a delimiter."""
    return next(tail for tail in range(4) if tail == 3 or np.ptp(rows[:, -1 - tail]))


def crc_names() -> dict[tuple[Any, ...], str]:
    """Return what a CRC is called, by its parameters as the file has them."""
    return {tuple(of): name for name, of in packaged("hil.bench", "checksums.yaml")["names"].items()}


def checksum_in_words(found: Mapping[str, Any] | None) -> str:
    """Say what checksum was found, as `hil frames check` says it of one that is described; empty where none was."""
    words: Any = templates("hil.bench").get_template("checksum.txt.j2").make_module({"names": crc_names()})
    return "" if found is None else str(words.checksum(_CHECKSUM.validate_python(found)))


def _checksum(rows: Bytes) -> dict[str, Any] | None:
    """Return a checksum that most of the frames carry, bytes of shape (n, length), as it is described."""
    few = [bytes(row) for row in rows[:: max(1, len(rows) // 6)][:6]]
    for kind, check in _checks(rows.shape[1], _tail(rows)) if len(rows) >= _FEW else ():
        if sum(map(check.matches, few)) >= len(few) - 1 and check.matches_rows(rows).mean() > _MOST:
            return {key: value for key, value in kind.items() if value is not False and value != 0}
    return None


def _described(rows: Bytes, found: dict[str, Any] | None) -> dict[str, Any]:
    """Say what frames, bytes of shape (n, length), have in common, and make a stream of it."""
    kind, tail = ({"kind": "none"}, 0) if found is None else (found, _tail(rows))
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
    seen = {"length": length, "frames": len(rows), "sync": begins, "checksum": found, "counter": counter}
    return seen | {"stream": {"sync": begins, "frames": {"frame": frame}}}


def _counter(rows: Bytes, first: int, end: int, taken: set[int]) -> dict[str, Any] | None:
    """Return what steps by the same from frame to frame, bytes (n, length), between two places."""
    found: list[tuple[int, int, int, dict[str, Any]]] = []
    for kind, at in product(("<u1", "<u2", ">u2"), range(first, end)):
        size = int(kind[2])
        if at + size > end or taken & set(range(at, at + size)):
            continue
        values = np.ascontiguousarray(rows[:, at : at + size]).view(kind)[:, 0].astype(np.int64)
        step, times = Counter((np.diff(values) % (1 << 8 * size)).tolist()).most_common(1)[0]
        if 0 < step <= 1 << 4 * size and times > _MOST * (len(rows) - 1) and not (1 << 8 * size) % step:
            told = {"at": at, "type": f"u{8 * size}", "byte_order": "little" if kind[0] == "<" else "big", "step": step}
            moves = np.ptp(rows[:, at : at + size], axis=0).all()
            shown = size if moves else 0  # a byte that never counts is not shown to belong
            found.append((times, shown, -step, told))
    return max(found, key=lambda each: each[:3])[3] if found else None


def misfit(path: Path, description: StreamDescription, counts: StreamCounts) -> Iterator[str]:
    """Say what is in a file that is mostly (`counts`) in no frame, and what reads it; `InputError` if unreadable."""
    size = path.stat().st_size
    if not counts.skipped_bytes or 2 * counts.skipped_bytes <= size:
        return
    with opened(path) as file:
        data = file.read(_TRY)
    headers = [
        header for name, each in description.frames.items() if not each.parts for header in description.headers(name)
    ]
    begun = sum(1 for header in headers for _ in re.finditer(header.pattern, data, re.DOTALL))
    what = "no good frame is" if not counts.ok else f"{counts.skipped_bytes} of {size} bytes are in no frame"
    said = f"{what} in {size} bytes" if not counts.ok else what
    times = "once" if begun == 1 else f"{begun} times"
    yield f"{said}: in the first {len(data)}, what begins a frame of {description.name} is there {times}"
    others = sorted(that_read(data), reverse=True)
    for share, ok, name in others[:2]:
        read = f"{share:.1%} of the first {len(data)} bytes as {counted(ok, 'good frame')}"
        yield f"{name} reads {read}: try --frames {name}"
    if others:
        return
    if counts.bad_checksum > begun / 2 > 2:
        advice = "compare length, checksum and the byte order of both with the manual"
        yield f"frames begin as described, but their checksums do not match: {advice}"
    yield "no shipped description reads it: compare baud rate, word length and the unit's settings with the manual"


def that_read(data: bytes, least: float = 0.5) -> Iterator[tuple[float, int, str]]:
    """Try the shipped descriptions: of those that read more than `least`, the share, how many frames, and the name."""
    paths = {path.stem: path for folder in config_folders("imus") for path in folder.glob("*.yaml")}
    for name, path in paths.items():
        try:
            decoder = StreamDecoder(load_description(path))
        except InputError:
            continue
        counts = decoder.feed(data).counts + decoder.finish().counts
        share = 1.0 - counts.skipped_bytes / len(data)
        if share > least and counts.ok:
            yield share, counts.ok, name
