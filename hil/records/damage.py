"""Which self-calibrations of a night rest on samples that are lost or damaged, and so must be done again.

The average of a collect is in the journal, but without its samples nobody can show that it is right. It is not enough
to take that one collect again: the equations take the collects of a self-calibration as simultaneous, under one soak.
So the whole self-calibration is done again, soak and all; the others stand. Lost raw bytes alone are no reason: the
samples prove the average, and `hil verify` names what is lost.

`lost_blocks` only looks whether the files are there, for those who ask often; whoever states a number that rests on
them reads them all.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from hil.records.blocks import SAMPLES, DamagedBlock, checked_bytes
from hil.records.reader import JournalReader
from hil.records.rows import BlockRow
from procedures.plan import StepKind


@dataclass(frozen=True)
class LostBlock:
    """A block of a DONE attempt whose file is not there as it was written, and what that asks for."""

    row: BlockRow
    what: str  # missing, or how long it is

    @property
    def samples(self) -> bool:
        """Whether the average rests on it: then its self-calibration is to be done again."""
        return self.row.block.kind == SAMPLES

    def __str__(self) -> str:
        advice = "hil resume does its self-calibration again" if self.samples else "hil replay needs them, nothing else"
        kind = "samples" if self.samples else "raw bytes"
        return f"{self.row.block.path}: {self.what}: the {kind} of {self.row.step_key}; {advice}"


def lost_blocks(folder: Path, rows: Iterable[BlockRow], done: Collection[tuple[str, int]]) -> list[LostBlock]:
    """Return the blocks of the `done` attempts (step key, number) that are missing or of another length.

    Nothing is read: whether the bytes are right is for `hil verify` and `damaged_self_calibrations`.
    """
    lost = []
    for row in rows:
        if (row.step_key, row.attempt) not in done:
            continue
        try:
            size = (folder / row.block.path).stat().st_size
        except OSError as error:
            lost.append(LostBlock(row, "missing" if isinstance(error, FileNotFoundError) else str(error.strerror)))
            continue
        if size != row.block.size:
            lost.append(LostBlock(row, f"{size} bytes instead of {row.block.size}"))
    return lost


def refuse_damaged_samples(journal: JournalReader) -> None:
    """Raise `DamagedBlock` where the samples of a DONE collect are not as they were written."""
    damaged = damaged_self_calibrations(journal)
    if damaged:
        number, what = next(iter(damaged.items()))
        more = f" (and {len(damaged) - 1} more like it)" if len(damaged) > 1 else ""
        raise DamagedBlock(
            f"{journal.folder}: {what}: self-calibration {number} rests on it{more}; nothing is stated. hil resume does it "
            f"again, hil repair {journal.folder} --out NEW leaves it out"
        )


def damaged_self_calibrations(journal: JournalReader) -> Mapping[int, str]:
    """Return the self-calibrations with a DONE collect whose samples are not as they were written, and what is wrong.

    Reads every block of samples once, and compares its hash.
    """
    blocks = {(row.step_key, row.attempt): row.block for row in journal.blocks() if row.block.kind == SAMPLES}
    steps = journal.steps_by_key()
    damaged: dict[int, list[str]] = {}
    for key, done in journal.done_attempts().items():
        step = steps[key]
        if step.kind is not StepKind.COLLECT or step.self_calibration is None:
            continue
        block = blocks.get((key, done.attempt))
        try:
            if block is None:
                raise DamagedBlock(f"{key}: no samples are recorded with it")
            checked_bytes(journal.folder, block)
        except DamagedBlock as damage:
            damaged.setdefault(step.self_calibration, []).append(str(damage))
    return {number: "; ".join(reasons) for number, reasons in damaged.items()}
