"""Whether a night is complete and undamaged: every step, every block, every byte.

It trusts nothing but hashes and arithmetic: the journal is held against its chain and what stands beside it, every
block against its hash and its contents, log and configuration beside it against what the journal has on record, and
every recorded average is computed again from the samples.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hil.config.recorded import CONFIGURATION, key_file, lost_files
from hil.errors import Damaged, InputError
from hil.files.durable import PARTIAL
from hil.records.blocks import BLOCKS, RAW, DamagedBlock, Samples, read_raw, read_samples
from hil.records.curve import trace_damage
from hil.records.damage import lost_blocks
from hil.records.ledger import HEAD_NAME, read_key, signed
from hil.records.reader import reading
from hil.records.rows import Attempt, BlockRow
from hil.records.status import missing_in_words, recorded_end, recorded_verdict, state_of
from hil.records.units import night_of, unit_folder

MISSING = "missing: "
"""How what of the plan is not there begins among the problems: no record of it is wrong."""

_TOLERANCE_DEG_PER_HR = 1e-6  # the order of the sum may differ, by much less than this


def verify_night(folder: Path | str, key: Path | None = None) -> dict[str, Any]:
    """Return the document hil.verify/1 of a night; raise `InputError` where the folder holds none.

    `state` and `reason` are those of its status. `notes` names what is harmless: a block that a crash left unrecorded.
    `signature` says whether the head is signed with `key` (else that of the night's bench).
    """
    given, folder = Path(folder), night_of(Path(folder))
    problems, notes = list[str](), list[str]()
    rows: Sequence[BlockRow] = ()
    complete, signature, state, reason = False, "whether it is signed was not looked at", "incomplete", ""
    verdict: dict[str, str] | None = None
    simulated = None
    try:
        with reading(given, damaged_too=True) as journal:
            problems += journal.found
            simulated = journal.night.simulated
            rows = journal.blocks()
            attempts = {(each.step_key, each.attempt): each for each in journal.attempts()}
            for row in rows:
                attempt = attempts.get((row.step_key, row.attempt))
                found = _check_block(folder, row, attempt)
                if attempt and attempt.withdrawn:
                    notes += [f"{each}; it counts no more, and was done again" for each in found]
                else:
                    problems += found
            problems += [each.what for each in lost_blocks(journal, read=False) if "no samples" in each.what]
            if not problems:  # what is damaged cannot say what stood beside it
                problems += [*journal.log_damage(), *lost_files(journal.night.configuration, folder / CONFIGURATION)]
                for unit in journal.plan.units:
                    trace = recorded_end(journal, unit).get("trace", {})
                    problems += trace_damage(unit_folder(journal.folder, unit), trace)
                signature, wrong = _signature(folder, key or key_file(journal.night.configuration))
                problems += [f"{HEAD_NAME}: {signature}"] if wrong else []
            orphans = _orphans(folder, journal.blocks(of_all=True))
            notes += [each for each in orphans if each.partition(":")[0] not in str(problems)]
            missing = missing_in_words(journal.plan, journal.completed(), tuple(attempts.values()))
            complete, verdict, (state, reason) = not missing, recorded_verdict(journal), state_of(journal)
            if problems:
                verdict = {"verdict": "ERROR", "reason": problems[0]}
            problems += [f"{MISSING}{what}" for what in missing]
    except Damaged as error:  # it cannot be believed any further
        problems += [] if problems else [str(error)]
        verdict = {"verdict": "ERROR", "reason": problems[0]}
    told = {"complete": complete and not problems, "state": state, "reason": reason, "judgement": verdict}
    told |= {"simulated": simulated, "problems": problems}
    return {"schema": "hil.verify/1", **told, "blocks_checked": len(rows), "notes": notes, "signature": signature}


def _signature(folder: Path, path: Path | None) -> tuple[str, bool]:
    """Return in words whether the head is signed with the key in a file, and whether that is not as it should be."""
    try:
        fits = signed(folder, read_key(path))
    except InputError as error:
        return f"whether it is signed by the bench's key cannot be told: {error}", False
    if fits is None:
        return "not signed" if path is None else f"not signed, and the bench has a key ({path})", path is not None
    if path is None:
        return "signed, and no key is named to prove it with", False
    return "signed by the bench's key" if fits else f"the signature does not fit the key in {path}", not fits


def _check_block(folder: Path, row: BlockRow, attempt: Attempt | None) -> list[str]:
    try:
        if row.block.kind == RAW:
            read_raw(folder, row.block)
            return []
        samples = read_samples(folder, row.block)
    except DamagedBlock as damage:
        return [str(damage)]
    return list(_wrong_averages(row, samples, attempt.data)) if attempt else []


def _wrong_averages(row: BlockRow, samples: Samples, data: Mapping[str, Any]) -> Iterator[str]:
    """Yield a sentence for every recorded average that the samples do not give."""
    for sensor, record in data.get("sensors", {}).items():
        for channel, rates in samples.of("rate", int(sensor)).items():
            recorded = record.get("rates", {}).get(channel, {}).get("mean_deg_per_hr")
            good = rates[samples.good]
            if recorded is None or not len(good):
                continue
            mean = float(np.mean(good))
            if not math.isclose(mean, recorded, rel_tol=0.0, abs_tol=_TOLERANCE_DEG_PER_HR):
                yield (
                    f"{row.block.path}: the samples of channel {channel} of sensor {sensor} average to {mean:.6f} "
                    f"deg/hr, but {recorded:.6f} deg/hr is recorded for {row.step_key}"
                )


def _orphans(folder: Path, rows: Sequence[BlockRow]) -> Iterator[str]:
    known = {row.block.path for row in rows}
    for name in sorted(path.name for path in folder.glob(f"{BLOCKS}/*")):
        if name.startswith(PARTIAL):
            yield f"{BLOCKS}/{name}: an unfinished block, left behind by a crash; harmless"
        elif f"{BLOCKS}/{name}" not in known:
            yield f"{BLOCKS}/{name}: no journal row names this block (a crash came before); harmless"
