"""A frame description: said in words, and put to a file of raw bytes: what is in it, and its frames as a table.

A counter that is described wrongly gives good frames with a false account of what is missing, which is said in words.
The file is read in chunks, so that memory does not grow with it; with `out` it is read twice, the first time to know
which fields occur. Columns: time, place in the file and number of each frame, then the description's, in its units.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping
from decimal import Decimal
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from drivers.frames.batch import Decoded, FrameBatch
from drivers.frames.checksums import CrcKind
from drivers.frames.counts import StreamCounts
from drivers.frames.decoder import StreamDecoder
from drivers.frames.description import FrameDescription, StreamDescription, load_description
from drivers.frames.fields import FieldDescription
from drivers.frames.roles import CounterDescription
from drivers.frames.wire import FloatArray
from drivers.given_file import opened
from hil.bench.guess import crc_names, misfit
from hil.errors import InputError
from hil.files.durable import whole_file
from hil.files.page import filled
from hil.files.strict import find_config

if TYPE_CHECKING:
    import pyarrow as pa

SCHEMA = "hil.decode/1"
_CHUNK = 1 << 22  # bytes
_SUFFIXES = (".parquet", ".csv")
_PLACES = 6  # decimals up to which rounding a 32-bit count times its scale gives the nearest float
_FEW = 10  # frames from which on a counter's habit can be told
_JITTER = 0.01  # of a clock that stamps frames
_OFF = 0.05  # a clock, and a rate that was heard for two seconds, may be off by so much
_PLACE = ("frame", "position", "sequence")  # the columns before the fields
_TYPES = {"fp12.20": "12.20 fixed point", "fp16.32": "16.32 fixed point", "item": "in the item's number format"}
_TYPES |= {"f16": "half precision", "f32": "single precision", "f64": "double precision"}


def load_frames_named(name: str | Path, **otherwise: Any) -> StreamDescription:
    """Load a description (see `load_description`) by name or path; raise `InputError` where it cannot be used."""
    return load_description(find_config("imus", name), **otherwise)


def decode_file(path: Path, description: StreamDescription, *, out: Path | None = None) -> dict[str, Any]:
    """Decode the file and return the document of `hil decode` (schema hil.decode/1); write the table to `out`.

    `out` ends in .parquet or .csv. Raise `InputError` where a file cannot be read or written; `out` is then as it was.
    """
    if out is not None and out.suffix.lower() not in _SUFFIXES:
        raise InputError(f"{out}: the table is written as .parquet or .csv; give a name that ends so")
    if out is not None and out.exists() and path.exists() and out.samefile(path):
        raise InputError(f"{out}: is the file of raw bytes itself, which the table would replace; name another file")
    summary, seen = _summary(path, description)
    document = {"schema": SCHEMA, "file": str(path), "description": description.name, **summary}
    if out is not None:
        _write_table(path, description, seen, out)
        document["out"] = str(out)
    return document


def _decoded(path: Path, description: StreamDescription) -> Iterator[Decoded]:
    decoder = StreamDecoder(description)
    with opened(path) as file:
        while chunk := file.read(_CHUNK):
            yield decoder.feed(chunk)
    yield decoder.finish()


def _summary(path: Path, description: StreamDescription) -> tuple[dict[str, Any], dict[str, set[str]]]:
    """Return what a file holds, as `hil decode` says it, and by the type of frame that occurs the fields that do."""
    counts, numbers, seen = StreamCounts(), dict.fromkeys(description.frames, 0), dict[str, set[str]]()
    habits = {name: CounterHabit(name, frame, description.sample_rate_hz) for name, frame in description.frames.items()}
    first: tuple[str, FrameBatch] | None = None
    last: tuple[str, FrameBatch] | None = None
    for decoded in _decoded(path, description):
        counts += decoded.counts
        found = [(name, batch) for name, batch in decoded.frames.items() if len(batch)]
        for name, batch in found:
            numbers[name] += len(batch)
            habits[name].add(batch)
            fields = batch.layout.description.all_fields
            seen.setdefault(name, set()).update(of for of in fields if fields[of].is_text or batch.told(of).any())
        if found:
            first = first or min(found, key=lambda each: int(each[1].starts[0]))
            last = max(found, key=lambda each: int(each[1].starts[-1]))
    warnings = list(misfit(path, description, counts))
    if counts.duplicate > counts.ok:
        repeated = "most frames repeat the counter of the one before and are left out"
        warnings.append(f"{repeated}: compare counter.modulus and step")
    return {
        "frames": {name: count for name, count in numbers.items() if count},
        **vars(counts),
        "first": first and _fields_of(first[1], 0),
        "last": last and _fields_of(last[1], -1),
        "first_frame": first and first[0],
        "last_frame": last and last[0],
        "warnings": [*warnings, *chain.from_iterable(habit.mistakes() for habit in habits.values())],
    }, seen


def _fields_of(batch: FrameBatch, at: int) -> dict[str, Any]:
    """Return one frame's fields: whole numbers as such, None where it does not have a field."""
    values: dict[str, Any] = {}
    for field, described in batch.layout.description.all_fields.items():
        if described.is_text:
            values[field] = batch.text(field)[at]
            continue
        value = float(printed(batch.column(field)[[at]], described)[0])
        plain = described.scale == 1.0 and described.offset == 0.0 and described.type[0] in "ui"
        whole = plain and math.isfinite(value)
        values[field] = int(batch.wire(field)[at]) if whole else value if math.isfinite(value) else None
    return values


def printed(values: FloatArray, field: FieldDescription) -> FloatArray:
    """Return values, (n,), with the decimals that whole counts times a decimal scale can have: 0.57 for 57 of 0.01."""
    if not (field.type[0] in "ui" and field.type[1:].isdigit()):
        return values
    places = [-int(Decimal(repr(each)).normalize().as_tuple().exponent) for each in (field.scale, field.offset)]
    return np.round(values, max(0, *places)) if max(places) <= _PLACES else values


def _write_table(path: Path, description: StreamDescription, seen: Mapping[str, set[str]], out: Path) -> None:
    """Write the frames in the order of their arrival; the file appears whole or not at all."""
    import pyarrow as pa
    import pyarrow.csv as pa_csv
    import pyarrow.parquet as pq

    columns = [pa.field("frame", pa.string()), pa.field("position", pa.int64()), pa.field("sequence", pa.int64())]
    placed = set(_PLACE)
    for name, frame in description.frames.items():
        for field, described in frame.all_fields.items():
            if field in seen.get(name, ()) and field not in placed:
                placed.add(field)
                kind = pa.string() if described.is_text else pa.float64()
                columns.append(pa.field(field, kind, metadata={"unit": described.unit} if described.unit else None))
    schema, parquet = pa.schema(columns), out.suffix.lower() == ".parquet"
    written_by = pq.ParquetWriter if parquet else pa_csv.CSVWriter
    with whole_file(out) as partial, partial.open("wb") as file, written_by(file, schema) as writer:
        for decoded in _decoded(path, description):
            writer.write_table(_table(decoded, schema, for_reading=not parquet))


def _table(decoded: Decoded, schema: pa.Schema, *, for_reading: bool) -> pa.Table:
    """Return the frames of one chunk, null where one has no such field; `for_reading` with decimals that can be."""
    import pyarrow as pa

    parts = []
    for name, batch in decoded.frames.items():
        if not len(batch):
            continue
        n, fields = len(batch), batch.layout.description.all_fields
        columns: list[Any] = [pa.array([name] * n), pa.array(batch.starts), pa.array(batch.sequence)]
        for column in list(schema)[len(_PLACE) :]:
            described = fields.get(column.name)
            if described is None or described.is_text != pa.types.is_string(column.type):
                columns.append(pa.nulls(n, column.type))
            elif described.is_text:
                columns.append(pa.array(batch.text(column.name)))
            else:
                values = batch.column(column.name)
                values = printed(values, described) if for_reading else values
                columns.append(pa.array(values, mask=~batch.told(column.name)))
        parts.append(pa.Table.from_arrays(columns, schema=schema))
    if not parts:
        return schema.empty_table()
    table = pa.concat_tables(parts)
    if len(parts) == 1:
        return table
    return table.take(pa.array(np.argsort(table["position"].to_numpy(), kind="stable")))


def explain_frames(description: StreamDescription) -> str:
    """Return the description in words: the stream, each frame with its fields, what they are for, and what is weak."""
    told = {"names": crc_names(), "types": _TYPES, "warnings": list(_warnings(description))}
    return filled("hil.bench", "frames_check.txt.j2", r=description, **told).rstrip("\n") + "\n"


def _warnings(description: StreamDescription) -> Iterator[str]:
    for name, frame in description.frames.items():
        kind = frame.checksum
        if frame.parts:
            continue
        if kind.kind == "none" and (frame.text is None or not frame.text.checksums):
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


class CounterHabit:
    """How a frame type's counter (or clock) really moves; `rate_hz` is at which frames come: as described, or heard."""

    def __init__(self, name: str, frame: FrameDescription, rate_hz: float) -> None:
        self._name = name
        self._told_by = frame.counter or frame.time
        self._rate_hz = rate_hz
        self._moves: Counter[int] = Counter()
        self._last: int | None = None
        self._most = 0

    def add(self, batch: FrameBatch) -> None:
        """Take the next good frames."""
        if self._told_by is None:
            return
        told = batch.told(self._told_by.field)
        values = batch.wire(self._told_by.field)[told].astype(np.int64)
        if not len(values):
            return
        self._most = max(self._most, int(values.max()))
        moves, times = np.unique(np.diff(values if self._last is None else [self._last, *values]), return_counts=True)
        self._moves.update(dict(zip(moves.tolist(), times.tolist(), strict=True)))
        self._last = int(values[-1])
        for move, _ in self._moves.most_common()[256:]:
            del self._moves[move]

    def mistakes(self) -> Iterator[str]:
        """Say where step, resolution or modulus are not what the frames show; nothing where too few were seen."""
        told_by = self._told_by
        if told_by is None:
            return
        place = f"frames.{self._name}.{'counter' if isinstance(told_by, CounterDescription) else 'time'}"
        so_lost, field, modulus = "lost and duplicate mean nothing", told_by.field, told_by.modulus
        if modulus is not None and self._most >= modulus:
            yield f"{place}.modulus: is {modulus}, but {field} goes up to {self._most}; {so_lost}"
            return
        ahead = sorted(Counter({move: times for move, times in self._moves.items() if move > 0}).elements())
        back = Counter({move: times for move, times in self._moves.items() if move < 0})
        if len(ahead) + back.total() < _FEW or not ahead:
            return
        usual = ahead[len(ahead) // 2]
        near = [move for move in ahead if abs(move - usual) <= max(1.0, _JITTER * usual)]
        if 2 * len(near) <= len(ahead) + back.total():
            return
        step = sum(near) / len(near)
        asks = f"{so_lost}. Is the sample rate (--rate, imu.rate) the unit's?"
        if not isinstance(told_by, CounterDescription):
            if abs(step * told_by.resolution * self._rate_hz - 1.0) > _OFF:
                yield (
                    f"{place}.resolution: is {told_by.resolution:.4g} s, but {field} moves by {step:.6g} from frame to "
                    f"frame, which at {self._rate_hz:.4g} Hz is {_tick(step * self._rate_hz)}; {asks}"
                )
        elif near[0] != near[-1] and abs(step - told_by.step) > 0.5 and usual > 2:
            tick = _tick(step * self._rate_hz)
            yield (
                f"{place}: {field} counts no frames: it moves by {near[0]} to {near[-1]} from frame to frame, so that "
                f"at {self._rate_hz:.4g} Hz the counter is a clock of {tick}; describe it as time: {{field: {field}, "
                f"resolution: {tick.removesuffix(' s')}, modulus: {modulus}}} in the place of counter. {asks}"
            )
        elif usual != told_by.step:
            yield f"{place}.step: is {told_by.step}, but {field} moves by {usual} from frame to frame; {asks}"
        if not back:
            return
        fall, turns = back.most_common(1)[0]
        if turns > 1 and 2 * turns > back.total() and near[0] == near[-1] and usual - fall != modulus:
            yield f"{place}.modulus: is {modulus}, but {field} comes round at {usual - fall}; {so_lost}"


def _tick(per_second: float) -> str:
    """Return what one count of a clock is worth: one that clocks have, where it is near."""
    usual = [2.0**n for n in range(10, 25)] + [10.0**n for n in range(2, 10)]
    nearest = min(usual, key=lambda each: abs(math.log(per_second / each)))
    return f"1/{nearest if abs(nearest / per_second - 1.0) < _OFF else round(per_second):.0f} s"


def wrong_counter(description: StreamDescription, raw: bytes, rate_hz: float) -> Iterator[str]:
    """Say what a described counter or clock is not, by the frames in `raw`, which came at `rate_hz`."""
    name = "" if description.roles is None else description.roles.frame
    habit = CounterHabit(name, description.frames[name], rate_hz)
    habit.add(StreamDecoder(description).feed(raw)[name])
    yield from habit.mistakes()
