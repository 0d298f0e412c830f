"""A recorded night computed again from its raw bytes: every average, to the last digit.

The bytes are decoded with the frame description that the night had, compared column by column with the stored samples,
and reduced by the function that the bench used; what is solved from the same averages is the same. Taken as recorded is
what no bytes hold: the times of the samples, the duration of the collect, and what the driver counted. No tolerance.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from drivers.clock import VirtualClock
from drivers.errors import TransportError
from drivers.frames.counts import StreamCounts
from drivers.frames.decoder import StreamDecoder
from drivers.imu import SampleBlock
from drivers.imu.samples import FloatArray
from drivers.imu.stream import StreamImu
from drivers.transports.transport import ClosedPort
from hil.config import Bench
from hil.config.recorded import configuration_of
from hil.errors import Damaged, InputError
from hil.records import reading
from hil.records.blocks import RAW, SAMPLES, Block, DamagedBlock, Samples, read_raw, read_samples
from procedures.collect import join, reduce_collect
from procedures.plan import StepKind
from procedures.settings import CollectSettings
from procedures.words import counted

SCHEMA = "hil.replay/1"
_TAKEN = "counts"  # as recorded: the driver also counts what no byte tells, such as bytes that overflowed


def replay_night(folder: Path | str) -> dict[str, Any]:
    """Return the document hil.replay/1 of a night; raise `InputError` where the folder holds none.

    `raw_missing` names the collects whose raw bytes are not there, `differences` says in words what does not come out
    as recorded. `identical` is true where at least one collect was checked and both lists are empty.
    """
    simulated: bool | None = None
    checked, raw_missing, differences = 0, list[str](), list[str]()
    try:
        with reading(Path(folder), damaged_too=True) as journal:
            differences += journal.found
            simulated = journal.night.simulated
            with tempfile.TemporaryDirectory(prefix="hil-") as files:
                bench, sweep = configuration_of(journal.night.configuration, Path(files))
                streams = {name: _Stream(own, sweep.collect) for name, own in bench.each.items()}
            blocks = {(row.step_key, row.attempt, row.block.kind): row.block for row in journal.blocks()}
            done = journal.done_attempts()
            for step in (step for step in journal.plan.of_kind(StepKind.COLLECT) if step.key in done):
                attempt = done[step.key]
                raw, stored = (blocks.get((step.key, attempt.attempt, kind)) for kind in (RAW, SAMPLES))
                if raw is None or not (journal.folder / raw.path).exists():
                    raw_missing.append(step.key)
                    continue
                checked += stored is not None
                different = _different_collect(journal.folder, attempt.data, streams[step.unit or ""], raw, stored)
                differences += [f"{step.key}: {each}" for each in different]
    except Damaged as error:
        differences += [] if differences else [str(error)]  # damage, which has been named by then
    identical = bool(checked) and not differences and not raw_missing
    told = {"schema": SCHEMA, "simulated": simulated, "identical": identical, "collects_checked": checked}
    return told | {"differences": differences, "raw_missing": raw_missing}


def _different_collect(
    folder: Path, data: Mapping[str, Any], stream: _Stream, raw: Block, stored: Block | None
) -> Iterator[str]:
    """Yield a sentence for everything in which a collect that is computed again is not what was recorded."""
    if stored is None:
        yield "no samples are recorded with the collect"
        return
    try:
        samples, content = read_samples(folder, stored), read_raw(folder, raw)
    except DamagedBlock as damage:
        yield str(damage)
        return
    columns = stream.decode(content, len(samples.time_s))
    yield from (different := list(_different_samples(samples, columns)))
    if different and any(len(column) != len(samples.time_s) for column in columns.values()):
        return  # without the frames that belong to the stored times nothing can be averaged
    for name, value in stream.reduce(samples.time_s, columns, data).items():
        if name != _TAKEN:
            yield from _different((name,), data.get(name), value)


class _Stream:
    """What the bytes of a night's unit mean, as it was at the night's beginning."""

    def __init__(self, bench: Bench, settings: CollectSettings) -> None:
        if (description := bench.frames).roles is None:
            raise InputError(f"{description.name}: roles: missing, so that no field is known to be a rate")
        self.description, self.frame = description, description.roles.frame
        self.settings, clock = settings, VirtualClock()
        port = ClosedPort(bench.imu.port, clock, TransportError("a replay has no port"))
        self.imu = StreamImu(port, description, clock)  # for what it says about its fields

    def decode(self, raw: bytes, expected: int) -> Mapping[str, FloatArray]:
        """Return the columns of the frames in a collect's bytes, which begin where the decoder was reset."""
        decoder = StreamDecoder(self.description)
        batches = [decoder.feed(raw)[self.frame]]
        if len(batches[0]) < expected:
            batches.append(decoder.finish()[self.frame])  # the stream paused, and the driver waited no longer
        return join(SampleBlock(batch.starts.astype(np.float64), batch.columns) for batch in batches).fields

    def reduce(self, time_s: FloatArray, columns: Mapping[str, FloatArray], data: Mapping[str, Any]) -> dict[str, Any]:
        """Return the data of the collect, as the bench computes it."""
        known = {field.name for field in fields(StreamCounts)}
        counts = StreamCounts(**{name: int(n) for name, n in data.get(_TAKEN, {}).items() if name in known})
        samples = SampleBlock(time_s, columns, counts)
        return reduce_collect(samples, float(data["duration_s"]), self.imu, self.settings)[0]


def _different_samples(samples: Samples, columns: Mapping[str, FloatArray]) -> Iterator[str]:
    """Yield a sentence for every column in which the decoded frames are not the stored samples."""
    n = len(samples.time_s)
    decoded = len(next(iter(columns.values()))) if columns else 0
    if decoded != n:
        yield f"the raw bytes hold {counted(decoded, 'good frame')}, stored are {counted(n, 'sample')}"
        return
    nothing = np.full(n, np.nan)
    for name in dict.fromkeys([*samples.fields, *columns]):
        stored, found = samples.fields.get(name, nothing), columns.get(name, nothing)
        wrong = np.flatnonzero(~((stored == found) | (np.isnan(stored) & np.isnan(found))))
        if len(wrong):
            at = int(wrong[0])
            yield (
                f"{len(wrong)} of {n} samples of {name} are not what the raw bytes hold, the first is number {at + 1}: "
                f"{float(stored[at])!r} is stored, {float(found[at])!r} was decoded"
            )


def _different(path: Sequence[str], recorded: Any, computed: Any) -> Iterator[str]:
    """Yield a sentence for every value, at any depth, that is not the same."""
    if isinstance(recorded, Mapping) and isinstance(computed, Mapping):
        for name in dict.fromkeys([*recorded, *computed]):
            yield from _different((*path, str(name)), recorded.get(name), computed.get(name))
    elif isinstance(recorded, list) and isinstance(computed, list) and len(recorded) == len(computed):
        for number, (one, other) in enumerate(zip(recorded, computed, strict=True), 1):
            yield from _different((*path, str(number)), one, other)
    elif recorded != computed and (recorded == recorded or computed == computed):  # no NaN is itself
        yield f"{' '.join(path)}: {recorded!r} is recorded, the raw bytes give {computed!r}"
