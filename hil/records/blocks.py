"""Data blocks: the samples and the raw bytes of a collect, as files beside the journal.

    blocks/00012-T1_S2_C3_collect-1.parquet    the samples, one column per decoded field, with units
    blocks/00012-T1_S2_C3_collect-1.raw.zst    the bytes as they arrived, Zstandard (the `zstd` program opens it)

A block is written and made durable before the journal names it. A block that no journal row names is what a crash
between the two leaves behind, of an attempt without an end: harmless. Blocks are never changed, no name used twice.
"""

import errno
import hashlib
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from drivers.given_file import opened
from drivers.imu import SampleBlock
from drivers.imu.samples import FloatArray
from hil.errors import Damaged, InputError, worded
from hil.files.durable import RealDisk, remove_partials, write_durably
from procedures.plan import Step

BLOCKS = "blocks"
SAMPLES_SCHEMA = "hil.samples/1"
SAMPLES, RAW = "samples", "raw"
SUFFIXES = {SAMPLES: ".parquet", RAW: ".raw.zst"}


class DamagedBlock(Damaged):
    """A block is missing, shortened or changed. The message says which, and what is wrong with it."""


@dataclass(frozen=True)
class Block:
    """What the journal records of a block file: enough to find any damage. `rows` counts samples, or raw bytes."""

    kind: str  # SAMPLES or RAW
    path: str  # relative to the night's folder, with forward slashes
    sha256: str  # of the file as stored
    size: int  # of the file as stored, bytes
    rows: int
    content_sha256: str  # of what was encoded: the raw bytes before compression; empty for samples


@dataclass(frozen=True)
class FieldMeaning:
    """A decoded field: unit, role (rate, acceleration, temperature), sensor, and as `name` channel or axis."""

    unit: str = ""
    role: str = ""
    sensor: int = 0
    name: str = ""


@dataclass(frozen=True)
class Samples:
    """The samples of one collect as they were stored: times in seconds of the campaign, columns by field name, (n,)."""

    time_s: FloatArray
    fields: Mapping[str, FloatArray]
    meanings: Mapping[str, FieldMeaning]
    simulated: bool

    @property
    def good(self) -> NDArray[np.bool_]:
        """Which samples were averaged: those in which every rate is a finite number, shape (n,)."""
        rates = [self.fields[field] for field, meaning in self.meanings.items() if meaning.role == "rate"]
        everything = np.ones(len(self.time_s), dtype=np.bool_)
        good: NDArray[np.bool_] = np.logical_and.reduce([everything, *map(np.isfinite, rates)])
        return good

    def of(self, role: str, sensor: int) -> Mapping[str, FloatArray]:
        """Return a sensor's columns of one role by channel or axis: `of("rate", 2)` has RA and RB, shape (n,) each."""
        return {
            meaning.name: self.fields[field]
            for field, meaning in self.meanings.items()
            if meaning.role == role and meaning.sensor == sensor
        }


class BlockWriter:
    """The only writer of a night's blocks: removes what a crash left; `meanings`: each unit's fields, by name."""

    def __init__(self, folder: Path, *, simulated: bool, keep_raw: bool = True) -> None:
        self._folder = folder
        self._simulated = simulated
        self.meanings: dict[str, Mapping[str, FieldMeaning]] = {}
        self._keep_raw = keep_raw
        self.disk = RealDisk()
        remove_partials(folder / BLOCKS)

    def write(self, step: Step, attempt: int, samples: SampleBlock) -> tuple[Block, ...]:
        """Make a collect's samples (campaign seconds) and bytes durable, for the journal to commit, or `OSError`."""
        if not (self._folder / BLOCKS).is_dir():
            (self._folder / BLOCKS).mkdir()
            self.disk.synchronise_folder(self._folder)
        stem = f"{BLOCKS}/{stem_of(step.index, step.key, attempt)}"
        table = self._encode(step, attempt, samples)
        blocks = [self._store(SAMPLES, stem, table, len(samples))]
        if samples.raw and self._keep_raw:
            blocks.append(self._store(RAW, stem, _compress(samples.raw), len(samples.raw), samples.raw))
        return tuple(blocks)

    def _store(self, kind: str, stem: str, data: bytes, rows: int, content: bytes = b"") -> Block:
        path = f"{stem}{SUFFIXES[kind]}"
        if (self._folder / path).exists():  # of an attempt that the journal has lost: it may be all that is left of it
            raise FileExistsError(errno.EEXIST, "this block was written before, and is not replaced", path)
        write_durably(self.disk, self._folder / path, data)
        return Block(kind, path, _sha256(data), len(data), rows, _sha256(content) if content else "")

    def _encode(self, step: Step, attempt: int, samples: SampleBlock) -> bytes:
        columns = {"time_s": samples.time_s, **samples.fields}
        meanings = {"time_s": FieldMeaning("s"), **self.meanings.get(step.unit or "", {})}
        labels = {name: vars(meanings.get(name, FieldMeaning())).items() for name in columns}
        fields = [
            pa.field(name, pa.float64(), nullable=False, metadata={label: str(value) for label, value in of if value})
            for name, of in labels.items()
        ]
        facts = {"schema": SAMPLES_SCHEMA, "step": step.key, "attempt": str(attempt)}
        facts |= {"time": "seconds since the campaign began", "simulated": "true" if self._simulated else "false"}
        arrays = [pa.array(np.asarray(column, dtype=np.float64)) for column in columns.values()]
        sink = pa.BufferOutputStream()
        # Dictionaries cost four times the time on measured numbers and save nothing.
        pq.write_table(
            pa.table(arrays, schema=pa.schema(fields, metadata=facts)), sink, compression="zstd", use_dictionary=False
        )
        return bytes(sink.getvalue())


def stem_of(number: int, key: str, attempt: int) -> str:
    """Return how the names of an attempt's blocks begin, by the step's index and key."""
    return f"{number:05d}-{re.sub(r'[^A-Za-z0-9.-]+', '_', key)}-{attempt}"


def _meaning(labels: Mapping[bytes, bytes]) -> FieldMeaning:
    text = {label.decode(): value.decode() for label, value in labels.items()}
    return FieldMeaning(text.get("unit", ""), text.get("role", ""), int(text.get("sensor", 0)), text.get("name", ""))


def _compress(raw: bytes) -> bytes:
    sink = pa.BufferOutputStream()
    with pa.CompressedOutputStream(sink, "zstd") as stream:
        stream.write(raw)
    return bytes(sink.getvalue())


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def check_length(folder: Path, block: Block) -> None:
    """Raise `DamagedBlock` where the block's file is missing or of another length than what was written."""
    try:
        size = (folder / block.path).stat().st_size
    except OSError as error:
        missing = isinstance(error, FileNotFoundError)
        what = "the block is missing" if missing else f"cannot be read ({error.strerror})"
        raise DamagedBlock(f"{block.path}: {what}") from None
    if size != block.size:
        raise DamagedBlock(f"{block.path}: has {size} bytes, {block.size} were written")


def checked_bytes(folder: Path, block: Block) -> bytes:
    """Return the block's file; raise `DamagedBlock` where it is missing or not what was written."""
    try:
        with opened(folder / block.path) as file:  # what is no file says so, before anybody asks how long it is
            check_length(folder, block)
            data = file.read(block.size + 1)
    except DamagedBlock:
        raise
    except InputError as error:
        if not os.path.lexists(folder / block.path):
            check_length(folder, block)
        raise DamagedBlock(str(error).removeprefix(f"{folder}/")) from None
    if _sha256(data) != block.sha256:
        raise DamagedBlock(f"{block.path}: its hash is not the one recorded: the file was changed or is damaged")
    return data


def read_samples(folder: Path, block: Block) -> Samples:
    """Return the samples of a SAMPLES block; raise `DamagedBlock` unless the file is exactly what was written."""
    data = checked_bytes(folder, block)
    wrong = worded(DamagedBlock, f"{block.path}: is not readable as Parquet (", (pa.ArrowException, OSError), ")")
    # No threads for one small block: Arrow's pools, still alive when a short command exits, now and then abort it.
    with wrong, pq.ParquetFile(pa.BufferReader(data), pre_buffer=False) as file:
        table = file.read(use_threads=False)
    if table.num_rows != block.rows:
        raise DamagedBlock(f"{block.path}: holds {table.num_rows} samples, the journal says {block.rows}")
    columns = {name: table.column(name).to_numpy() for name in table.column_names}
    meanings = {field.name: _meaning(field.metadata or {}) for field in table.schema}
    simulated = (table.schema.metadata or {}).get(b"simulated") == b"true"
    time_s = columns.pop("time_s")
    del meanings["time_s"]
    return Samples(time_s, columns, meanings, simulated)


def read_raw(folder: Path, block: Block) -> bytes:
    """Return the bytes as they arrived; raise `DamagedBlock` unless they are exactly what was written."""
    data = checked_bytes(folder, block)
    wrong = worded(DamagedBlock, f"{block.path}: cannot be decompressed (", (pa.ArrowException, OSError), ")")
    with wrong, pa.CompressedInputStream(pa.BufferReader(data), "zstd") as stream:
        raw = bytes(stream.read())
    if len(raw) != block.rows or _sha256(raw) != block.content_sha256:
        raise DamagedBlock(f"{block.path}: does not decompress to the bytes that arrived")
    return raw
