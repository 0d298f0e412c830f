"""Which self-calibrations of a night rest on samples that are lost or damaged, and so must be done again.

The average of a collect is in the journal, but without its samples nobody can show that it is right. It is not enough
to take that one collect again: the equations take the collects of a self-calibration as simultaneous, under one soak.
So the whole self-calibration is done again, soak and all; the others stand. Lost raw bytes alone are no reason: the
samples prove the average, and `hil verify` names what is lost.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from hil.records.blocks import SAMPLES, DamagedBlock, check_length, checked_bytes
from hil.records.reader import JournalReader
from procedures.plan import StepKind


@dataclass(frozen=True)
class LostBlock:
    """A block of a DONE attempt whose file is not there as it was written, and what that asks for."""

    step_key: str
    samples: bool  # the average rests on it: then its self-calibration is to be done again
    what: str

    def __str__(self) -> str:
        advice = "hil resume does its self-calibration again" if self.samples else "hil replay needs them, nothing else"
        return f"{self.what}: the {'samples' if self.samples else 'raw bytes'} of {self.step_key}; {advice}"


def lost_blocks(journal: JournalReader, *, read: bool) -> list[LostBlock]:
    """Return blocks of DONE attempts that are not as written (by length, unless `read`), and collects without any."""
    done = {key: each.attempt for key, each in journal.done_attempts().items()}
    without = {step.key for step in journal.plan.of_kind(StepKind.COLLECT)} & done.keys()
    lost = []
    for row in journal.blocks():
        if done.get(row.step_key) != row.attempt:
            continue
        samples = row.block.kind == SAMPLES
        if samples:
            without.discard(row.step_key)
        try:
            if read:
                checked_bytes(journal.folder, row.block)
            else:
                check_length(journal.folder, row.block)
        except DamagedBlock as damage:
            lost.append(LostBlock(row.step_key, samples, str(damage)))
    return lost + [LostBlock(key, True, f"{key}: no samples are recorded with it") for key in sorted(without)]


def damaged_self_calibrations(journal: JournalReader) -> Mapping[int, str]:
    """Return self-calibrations whose samples are not as written, and what is wrong; reads every block of samples."""
    steps, damaged = journal.steps_by_key(), dict[int, str]()
    for each in lost_blocks(journal, read=True):
        number = steps[each.step_key].self_calibration
        if each.samples and number is not None:
            damaged[number] = f"{damaged[number]}; {each.what}" if number in damaged else each.what
    return damaged


def refuse_damaged_samples(journal: JournalReader) -> None:
    """Raise `DamagedBlock` where the samples of a DONE collect are not as they were written."""
    for number, what in damaged_self_calibrations(journal).items():
        raise DamagedBlock(
            f"{journal.folder}/{what}: self-calibration {number} rests on it, so nothing is stated; hil resume does it "
            f"again, hil repair {journal.folder} --out NEW leaves it out"
        )
