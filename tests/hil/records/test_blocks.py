"""Data blocks: whole or absent, self-describing, and any damage is found."""

from __future__ import annotations

import errno
import os
import stat
import subprocess
import sys
from collections.abc import Callable
from dataclasses import astuple
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from drivers.clock import VirtualClock
from drivers.imu import SampleBlock
from hil.files.durable import PARTIAL, RealDisk, write_durably
from hil.records import SqliteJournal
from hil.records.blocks import BLOCKS, BlockWriter, DamagedBlock, FieldMeaning, read_raw, read_samples
from hil.records.verify import verify_night
from procedures.journal_protocol import Outcome, StepResult
from procedures.plan import Plan, Step, StepKind

Do = Callable[[SqliteJournal, Step, VirtualClock], None]

_STEP = Step(3, "T1/S1/C1/collect", StepKind.COLLECT, 0.0, 60.0, position="1")
_SAMPLES = SampleBlock(np.arange(5) / 10.0, {"rate_A2": np.array([1.0, -2.5, 0.001, 4.0, 5.0])}, raw=b"\xa5\x5a" * 99)


class RecordingDisk(RealDisk):
    """The real disk, which keeps the order of operations and can be full at one of them."""

    def __init__(self, full_at: str = "") -> None:
        self.operations: list[str] = []
        self._full_at = full_at

    def _note(self, operation: str) -> None:
        self.operations.append(operation)
        if self._full_at and self._full_at in operation:
            raise OSError(errno.ENOSPC, "No space left on device")

    def write(self, path: Path, data: bytes) -> None:
        """Write half of it where the disk is full."""
        try:
            self._note(f"write {path.name}")
        except OSError:
            super().write(path, data[: len(data) // 2])
            raise
        super().write(path, data)

    def rename(self, source: Path, target: Path) -> None:
        """Rename."""
        self._note(f"rename {source.name} {target.name}")
        super().rename(source, target)

    def synchronise_folder(self, folder: Path) -> None:
        """Synchronise."""
        self._note(f"synchronise {folder.name}")
        super().synchronise_folder(folder)


def test_samples_and_raw_bytes_come_back_exactly(tmp_path: Path) -> None:
    """Values to the last bit, units and roles, and the mark of a simulation."""
    writer = BlockWriter(tmp_path, simulated=True)
    writer.meanings = {"": {"rate_A2": FieldMeaning("deg/hr", "rate", 2, "RA")}}
    samples_block, raw_block = writer.write(_STEP, 1, _SAMPLES)
    samples = read_samples(tmp_path, samples_block)
    np.testing.assert_array_equal(samples.time_s, _SAMPLES.time_s)
    np.testing.assert_array_equal(samples.of("rate", 2)["RA"], _SAMPLES.fields["rate_A2"])
    assert samples.meanings["rate_A2"].unit == "deg/hr"
    assert samples.simulated
    assert read_raw(tmp_path, raw_block) == _SAMPLES.raw


@pytest.mark.slow
def test_reading_a_block_starts_no_thread(tmp_path: Path) -> None:
    """A command that only looks ends at once and cleanly: Arrow's thread pools can abort an interpreter that exits."""
    block, _ = BlockWriter(tmp_path, simulated=True).write(_STEP, 1, _SAMPLES)
    script = (
        "import os, sys, pathlib, hil.records.blocks as b\n"
        "count = lambda: len(os.listdir('/proc/self/task'))\n"
        f"before = count(); b.read_samples(pathlib.Path({str(tmp_path)!r}), b.Block(*{astuple(block)!r}))\n"
        "sys.exit(count() - before)\n"
    )
    assert subprocess.run([sys.executable, "-c", script], check=False, timeout=50).returncode == 0


def test_a_block_explains_itself_to_any_parquet_reader(tmp_path: Path) -> None:
    """Unit per column and the simulation mark are in the file, not only in the journal."""
    writer = BlockWriter(tmp_path, simulated=True)
    writer.meanings = {"": {"rate_A2": FieldMeaning("deg/hr", "rate", 2, "RA")}}
    (block, _) = writer.write(_STEP, 1, _SAMPLES)
    schema = pq.read_schema(tmp_path / block.path)
    assert schema.metadata[b"simulated"] == b"true"
    assert schema.metadata[b"step"] == b"T1/S1/C1/collect"
    assert schema.field("rate_A2").metadata[b"unit"] == b"deg/hr"
    assert schema.field("time_s").metadata[b"unit"] == b"s"


def test_a_bench_may_keep_no_raw_bytes(tmp_path: Path) -> None:
    """Without raw bytes there is one block."""
    writer = BlockWriter(tmp_path, simulated=False, keep_raw=False)
    assert [block.kind for block in writer.write(_STEP, 1, _SAMPLES)] == ["samples"]


def test_a_file_is_written_then_renamed_then_its_folder_synchronised(tmp_path: Path) -> None:
    """The order in which a power failure can do no harm."""
    disk = RecordingDisk()
    write_durably(disk, tmp_path / "x.parquet", b"data")
    partial = f"{PARTIAL}x.parquet"
    assert disk.operations == [f"write {partial}", f"rename {partial} x.parquet", f"synchronise {tmp_path.name}"]


def test_file_and_folder_are_forced_to_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file is synchronised with all its bytes, before it gets its name; then the folder is."""
    seen: list[tuple[bool, int, bool]] = []
    fsync = os.fsync

    def watched(descriptor: int) -> None:
        status = os.fstat(descriptor)
        is_folder = stat.S_ISDIR(status.st_mode)
        seen.append((is_folder, 0 if is_folder else status.st_size, (tmp_path / "x").exists()))
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", watched)
    write_durably(RealDisk(), tmp_path / "x", b"12345")
    assert seen == [(False, 5, False), (True, 0, True)]


@pytest.mark.parametrize("operation", ["write", "rename"])
def test_a_full_disk_leaves_neither_block_nor_rubbish(tmp_path: Path, operation: str) -> None:
    """Nothing stands under the block's name, and the half-written file is removed."""
    (tmp_path / BLOCKS).mkdir()
    writer = BlockWriter(tmp_path, simulated=True)
    writer.disk = RecordingDisk(full_at=operation)
    with pytest.raises(OSError, match="No space left"):
        writer.write(_STEP, 1, _SAMPLES)
    assert list((tmp_path / BLOCKS).iterdir()) == []


@pytest.mark.parametrize("operation", ["write", "rename", "synchronise", ".raw.zst"])
def test_a_full_disk_leaves_the_journal_consistent(
    new_night: Path, plan: Plan, clock: VirtualClock, do: Do, operation: str
) -> None:
    """The collect has not happened; when there is space again it is done, and the night is complete and sound."""
    disk = RecordingDisk(full_at=operation)
    first = next(step.index for step in plan.steps if step.kind is StepKind.COLLECT)
    with SqliteJournal.open(new_night, clock=clock) as journal:
        journal.block_writer.disk = disk
        for step in plan.steps[:first]:
            do(journal, step, clock)
        with pytest.raises(OSError, match="No space left"):
            do(journal, plan.steps[first], clock)
        assert plan.steps[first].key not in journal.completed()
        assert journal.blocks() == ()
        assert journal.damage() == []
        journal.event("disk_full", "there was no space left")
    with SqliteJournal.open(new_night, clock=clock) as journal:
        for step in plan.steps[first:]:
            do(journal, step, clock)
    assert verify_night(new_night)["problems"] == []


def test_any_damage_to_a_block_is_found(tmp_path: Path) -> None:
    """Each flipped byte, a shortened file, a missing file."""
    writer = BlockWriter(tmp_path, simulated=True)
    for block, read in zip(writer.write(_STEP, 1, _SAMPLES), (read_samples, read_raw), strict=True):
        path = tmp_path / block.path
        good = path.read_bytes()
        for position in range(0, len(good), 37):
            path.write_bytes(good[:position] + bytes([good[position] ^ 1]) + good[position + 1 :])
            with pytest.raises(DamagedBlock, match="hash"):
                read(tmp_path, block)
        path.write_bytes(good[:-1])
        with pytest.raises(DamagedBlock, match="were written"):
            read(tmp_path, block)
        path.unlink()
        with pytest.raises(DamagedBlock, match="missing"):
            read(tmp_path, block)


def test_a_result_without_samples_has_no_block(journal: SqliteJournal, plan: Plan) -> None:
    """Only collects leave blocks."""
    step = plan.steps[0]
    journal.end((step, *journal.begin(step), StepResult(Outcome.DONE)))
    assert journal.blocks() == ()
