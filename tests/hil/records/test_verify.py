"""`hil verify` finds every kind of damage, and calls harmless what is harmless."""

from __future__ import annotations

import contextlib
import re
import sqlite3
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from drivers.clock import VirtualClock
from drivers.imu import SampleBlock
from hil.cli.told import lines_of
from hil.errors import Damaged, InputError
from hil.records import SqliteJournal
from hil.records.blocks import stem_of
from hil.records.journal import JOURNAL_NAME
from hil.records.ledger import TABLES
from hil.records.status import night_status
from hil.records.verify import verify_night
from procedures.journal_protocol import Outcome, StepResult
from procedures.plan import Plan, StepKind
from tests.hil.records.conftest import carry_out


def blocks_of(folder: Path) -> list[Path]:
    """Return the block files."""
    return sorted((folder / "blocks").iterdir())


def tamper(folder: Path, *statements: str) -> None:
    """Change the journal as somebody with a database program would, all protection switched off."""
    connection = sqlite3.connect(folder / JOURNAL_NAME, isolation_level=None)
    connection.execute("DROP TRIGGER an_ended_attempt_stays")
    connection.execute("DROP TRIGGER a_block_stays")
    connection.execute("DROP TRIGGER an_answer_stays")
    for statement in statements:
        connection.execute(statement)
    connection.close()


def test_a_full_night_is_complete(full_night: Path, plan: Plan) -> None:
    """Every step done and every block intact: complete, without problems."""
    collects = len(plan.of_kind(StepKind.COLLECT))
    assert verify_night(full_night) == {
        "schema": "hil.verify/1",
        "complete": True,
        "state": "complete",
        "reason": "every planned step is done",
        "judgement": None,
        "simulated": True,
        "problems": [],
        "blocks_checked": 2 * collects,
        "notes": [],
        "signature": "not signed",
    }


def test_a_flipped_byte_in_any_block_is_found(full_night: Path) -> None:
    """One bit in the middle of each block, samples and raw bytes alike."""
    for path in blocks_of(full_night):
        good = path.read_bytes()
        middle = len(good) // 2
        path.write_bytes(good[:middle] + bytes([good[middle] ^ 0x10]) + good[middle + 1 :])
        result = verify_night(full_night)
        assert not result["complete"]
        (problem,) = result["problems"]
        assert path.name in problem
        assert "hash" in problem
        path.write_bytes(good)
    assert verify_night(full_night)["complete"]


def test_a_deleted_or_shortened_block_is_found(full_night: Path) -> None:
    """A block that is gone, and one that lost its end."""
    first, second = blocks_of(full_night)[:2]
    first.unlink()
    second.write_bytes(second.read_bytes()[:-10])
    problems = verify_night(full_night)["problems"]
    assert len(problems) == 2
    assert f"{first.name}: the block is missing" in problems[0]
    assert second.name in problems[1]
    assert "were written" in problems[1]


@pytest.mark.parametrize("which", ["min", "max"])
@pytest.mark.parametrize("table", [*TABLES, "ledger"])
def test_a_deleted_journal_row_is_found(full_night: Path, table: str, which: str) -> None:
    """Any row of any table, the last one included."""
    tamper(full_night, f"DELETE FROM {table} WHERE rowid = (SELECT {which}(rowid) FROM {table})")  # noqa: S608
    result = verify_night(full_night)
    assert not result["complete"]
    words = (
        "ledger|newest were lost" if table == "ledger" else f"row .* of the table {table} was deleted|night is missing"
    )
    assert any(re.search(words, problem) for problem in result["problems"]), result["problems"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("UPDATE steps SET temperature_degC = 21.0 WHERE number = 3", "row 3 of the table steps (T1/S1/C1/index)"),
        ("UPDATE night SET configuration = 'bench: other'", "row 1 of the table night (Small)"),
        ("UPDATE night SET title = title || '.', began_utc = 'yesterday'", "row 1 of the table night"),
        ("UPDATE attempts SET data = replace(data, 'PASS', 'FAIL') WHERE id = 4", "row 4 of the table attempts"),
        ("UPDATE attempts SET reason = 'excellent' WHERE id = 2", "row 2 of the table attempts"),
        ("UPDATE attempts SET began_s = began_s + 0.001 WHERE id = 2", "row 2 of the table attempts"),
        ("UPDATE blocks SET sha256 = 'no' WHERE id = 1", "row 1 of the table blocks (T1/S1/C1/collect)"),
        ("UPDATE heartbeats SET readings = '{' WHERE id = 3", "row 3 of the table heartbeats"),
        ("UPDATE events SET message = 'all went badly'", "row 1 of the table events (note)"),
        ("UPDATE requests SET who = 'ann'", "row 1 of the table requests (pause)"),
        ("UPDATE controllers SET seen_s = seen_s + 1", "row 1 of the table controllers"),
        ("UPDATE ledger SET link = upper(link) WHERE n = 7", "entry 7 of its ledger"),
        ("UPDATE ledger SET rows = '{' WHERE n = 7", "entry 7 of its ledger"),
        (
            "INSERT INTO events (controller, at_s, kind, message, evidence) VALUES (1, 0, 'x', 'y', '{}')",
            "row 2 of the",
        ),
        ("DELETE FROM night", "row 1 of the table night was deleted"),
    ],
)
def test_a_changed_journal_row_is_found(full_night: Path, change: str, words: str) -> None:
    """Numbers, plan, configuration, signs of life: whatever was written is in the chain."""
    tamper(full_night, change)
    result = verify_night(full_night)
    assert not result["complete"]
    assert any(words in problem for problem in result["problems"]), result["problems"]


def test_a_damaged_database_file_is_found_wherever_it_is_damaged(full_night: Path) -> None:
    """A page of rubbish, anywhere in the file, is a problem in words and never a traceback."""
    path = full_night / JOURNAL_NAME
    good = path.read_bytes()
    for start in range(0, len(good), 4096):
        path.write_bytes(good[:start] + b"\xa5" * 4096 + good[start + 4096 :])
        assert verify_night(full_night)["problems"], f"the damage at byte {start} was not found"
    path.write_bytes(good[: len(good) // 2])
    assert verify_night(full_night)["problems"]


@pytest.mark.parametrize("table", [*TABLES, "ledger"])
def test_a_letter_changed_in_the_words_that_make_a_table_is_found(full_night: Path, table: str) -> None:
    """Row numbers that are none any more: named by whoever reads, and no internal error."""
    with contextlib.closing(sqlite3.connect(full_night / JOURNAL_NAME, isolation_level=None)) as connection:
        connection.execute("PRAGMA writable_schema = ON")
        changed = "UPDATE sqlite_master SET sql = replace(sql, 'PRIMARY', 'PRIMASY') WHERE name = ?"
        connection.execute(changed, (table,))
    assert verify_night(full_night)["problems"]
    with contextlib.suppress(Damaged):
        assert night_status(full_night)["problems"]


def test_a_wrong_average_is_found_although_every_hash_is_right(journal: SqliteJournal, plan: Plan) -> None:
    """Averages are computed again from the samples."""
    step = plan.of_kind(StepKind.COLLECT)[0]
    for sign, expected in ((1.0, 0), (-1.0, 1)):
        (attempt,) = journal.begin(step)
        data = {"sensors": {"2": {"rates": {"RA": {"mean_deg_per_hr": sign * 2.0}}}}}
        samples = SampleBlock(np.arange(3.0), {"rate_A2": np.array([1.0, 2.0, 3.0])})
        journal.end((step, attempt, StepResult(Outcome.FAILED, "", data, samples)))
        found = [each for each in verify_night(journal.folder)["problems"] if "average to 2.000000" in each]
        assert len(found) == expected


def test_a_collect_without_samples_is_found(journal: SqliteJournal, plan: Plan) -> None:
    """A DONE collect must have its samples."""
    step = plan.of_kind(StepKind.COLLECT)[0]
    journal.end((step, *journal.begin(step), StepResult(Outcome.DONE)))
    assert any("no samples are recorded" in problem for problem in verify_night(journal.folder)["problems"])


def test_what_a_crash_left_behind_is_a_note_and_no_problem(full_night: Path, clock: VirtualClock) -> None:
    """A block of an attempt that never ended, and unfinished files, are harmless, and are said; any other is damage."""
    with SqliteJournal.open(full_night, clock=clock) as journal:
        step = journal.plan.steps[4]
        journal.withdraw([step.key], "again")
        journal.begin(step)
        carry_out(journal, step, clock)
    left = full_night / "blocks" / f"{stem_of(step.index, step.key, 2)}.parquet"
    left.write_bytes(b"x")
    (full_night / "blocks" / ".partial-00004-orphan-9.raw.zst").write_bytes(b"x")
    result = verify_night(full_night)
    assert result["complete"], result["problems"]
    assert len(result["notes"]) == 2
    assert all("harmless" in note for note in result["notes"])
    left.rename(left.with_name(f"{stem_of(step.index, step.key, 4)}.parquet"))
    (problem,) = verify_night(full_night)["problems"]
    assert "-4.parquet was recorded, and the journal knows nothing of the attempt" in problem


def test_a_night_that_is_not_finished_names_what_is_missing(
    new_night: Path, plan: Plan, clock: VirtualClock, do: Callable[..., None]
) -> None:
    """One sentence for each self-calibration and each step around them."""
    second = next(step.index for step in plan.steps if step.self_calibration == 2)
    with SqliteJournal.open(new_night, clock=clock) as journal:
        for step in plan.steps[: second - 1]:
            do(journal, step, clock)
    found, status = verify_night(new_night), night_status(new_night)
    assert {name: found[name] for name in ("state", "reason")} == {name: status[name] for name in ("state", "reason")}
    said = [*lines_of(found, {"folder": "n", "wrong": [], "lacking": found["problems"]})]
    assert str(said[0]).startswith("n: incomplete, not judged, ")
    assert said[1] == f"not judged: {status['reason']}; hil report judges what is there"
    assert found["problems"][:2] == [
        "missing: self-calibration 1 at 20.0 °C: collect at position 3",
        "missing: self-calibration 2 at 20.0 °C: all of it",
    ]


def test_a_folder_without_a_night_is_bad_input(tmp_path: Path) -> None:
    """Nothing to verify is not the same as damage."""
    with pytest.raises(InputError, match="holds no night"):
        verify_night(tmp_path)
