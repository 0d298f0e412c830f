"""Which self-calibrations of a night rest on samples that are lost or damaged, and so must be done again.

The average of a collect is in the journal, but without its samples nobody can show that it is right. It is not enough
to take that one collect again: the equations take the collects of a self-calibration as simultaneous, under one soak.
So the whole self-calibration is done again, soak and all; the others stand. Lost raw bytes alone are no reason: the
samples prove the average, and `hil verify` names what is lost.
"""

from __future__ import annotations

from collections.abc import Mapping

from hil.blocks import SAMPLES, DamagedBlock, checked_bytes
from hil.journal_reader import JournalReader
from procedures.plan import StepKind


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
