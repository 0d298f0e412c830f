"""A frame description: said in words, and put to a file of raw bytes: what is in it, and its frames as a table.

    document = decode_file(Path("night.bin"), load_frames_named("stim300"), out=Path("night.parquet"))
    document["ok"], document["lost"], document["first"]
    print(explain_frames(load_frames_named("stim300")))

The file is read in chunks, so that memory does not grow with it; with `out` it is read twice, the first time to know
which fields occur. Columns are those of the description, in its units: the time, place in the file and number of each
frame come first.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from decimal import Decimal
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from drivers.frames.batch import Decoded, FrameBatch
from drivers.frames.checksums import CrcKind, NoChecksum
from drivers.frames.counts import StreamCounts
from drivers.frames.decoder import StreamDecoder
from drivers.frames.description import StreamDescription, load_description
from drivers.frames.fields import FieldDescription
from drivers.frames.wire import FloatArray
from drivers.given_file import opened
from drivers.strict_yaml import packaged
from hil.bench.decode_advice import CounterHabit, misfit
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
_PLACE = ("frame", "position", "sequence")  # the columns before the fields
_TYPES = {"fp12.20": "12.20 fixed point", "fp16.32": "16.32 fixed point", "item": "in the item's number format"}
_TYPES |= {"f16": "half precision", "f32": "single precision", "f64": "double precision"}


def load_frames_named(
    name: str | Path, *, parameters: Mapping[str, object] | None = None, sample_rate_hz: float | None = None
) -> StreamDescription:
    """Load a description by the name of one that ships, or by its path; raise `InputError` where it cannot be used."""
    return load_description(find_config("imus", name), parameters=parameters, sample_rate_hz=sample_rate_hz)


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
    """Decode the file chunk by chunk, up to its last byte."""
    decoder = StreamDecoder(description)
    with opened(path) as file:
        while chunk := file.read(_CHUNK):
            yield decoder.feed(chunk)
    yield decoder.finish()


def _summary(path: Path, description: StreamDescription) -> tuple[dict[str, Any], dict[str, set[str]]]:
    """Return what a file holds: counts, frames by type, its first and last good frame, what does not fit.

    And by the type of frame that occurs, the fields that occur.
    """
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
    """Return values, (n,), with the decimals that whole counts times a decimal scale can have.

    57 counts of 0.01 are 0.57, which binary arithmetic makes 0.5700000000000001. Others are returned as they are.
    """
    if not (field.type[0] in "ui" and field.type[1:].isdigit()):
        return values
    places = [-int(Decimal(repr(each)).normalize().as_tuple().exponent) for each in (field.scale, field.offset)]
    return np.round(values, max(0, *places)) if max(places) <= _PLACES else values


def _write_table(path: Path, description: StreamDescription, seen: Mapping[str, set[str]], out: Path) -> None:
    """Write the frames in the order of their arrival; the file appears whole or not at all."""
    import pyarrow.csv as pa_csv
    import pyarrow.parquet as pq

    schema, parquet = _schema(description, seen), out.suffix.lower() == ".parquet"
    written_by = pq.ParquetWriter if parquet else pa_csv.CSVWriter
    with whole_file(out) as partial, partial.open("wb") as file, written_by(file, schema) as writer:
        for decoded in _decoded(path, description):
            writer.write_table(_table(decoded, schema, for_reading=not parquet))


def _schema(description: StreamDescription, seen: Mapping[str, set[str]]) -> pa.Schema:
    import pyarrow as pa

    columns = [pa.field("frame", pa.string()), pa.field("position", pa.int64()), pa.field("sequence", pa.int64())]
    placed = set(_PLACE)
    for name, frame in description.frames.items():
        for field, described in frame.all_fields.items():
            if field in seen.get(name, ()) and field not in placed:
                placed.add(field)
                kind = pa.string() if described.is_text else pa.float64()
                columns.append(pa.field(field, kind, metadata={"unit": described.unit} if described.unit else None))
    return pa.schema(columns)


def _table(decoded: Decoded, schema: pa.Schema, *, for_reading: bool) -> pa.Table:
    """Return the frames of one chunk as a table; a field that a frame does not have is null.

    `for_reading` gives numbers the decimals that they can have; else they are what the decoder computed.
    """
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
    names = {tuple(of): name for name, of in packaged("hil.bench", "checksums.yaml")["names"].items()}
    told = {"names": names, "types": _TYPES, "warnings": list(_warnings(description))}
    return filled("hil.bench", "frames_check.txt.j2", r=description, **told).rstrip("\n") + "\n"


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
