"""`hil replay` shows a night to be what its raw bytes give, and finds whatever is not."""

from __future__ import annotations

import errno
import hashlib
import json
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from hil.cli.app import run
from hil.config import load_bench, parse_sweep
from hil.errors import InputError
from hil.files.durable import RealDisk
from hil.night import resume_night, start_night
from hil.night.replay import replay_night
from hil.records import open_readonly
from hil.records.blocks import RAW, SAMPLES, Block, read_raw
from hil.records.ledger import HEAD_NAME, Ledger
from hil.records.reader import JOURNAL_NAME

SHORT = parse_sweep(
    """
title: Short self-calibrations
temperatures: [23 degC]
self_calibrations_per_temperature: 2
positions: [1, 2, 3]
restabilisation: {at_least: 10 min, window: 5 min, ceiling: 60 min, unit_band: 5 degC, unit_slope: 2 degC/min}
collect: {settle: 5 s, duration: 20 s}
""",
    "short.yaml",
)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A complete night; tests work on copies."""
    folder = tmp_path_factory.mktemp("recorded") / "night"
    assert start_night(folder, SHORT, load_bench("simulated"), who="rk").state == "complete"
    return folder


@pytest.fixture
def night(recorded: Path, tmp_path: Path) -> Path:
    """A copy of the night, to be damaged."""
    return Path(shutil.copytree(recorded, tmp_path / "night"))


def first_block(folder: Path, kind: str) -> tuple[str, Block]:
    """Return the first block of a kind and the step it belongs to."""
    with open_readonly(folder) as journal:
        return next((row.step_key, row.block) for row in journal.blocks() if row.block.kind == kind)


def tamper(folder: Path, statement: str, *values: object) -> None:
    """Change the journal, all protection switched off, and forge its chain: only the bytes contradict it."""
    with closing(sqlite3.connect(folder / JOURNAL_NAME, isolation_level=None)) as connection:
        connection.execute("DROP TRIGGER IF EXISTS an_ended_attempt_stays")
        connection.execute("DROP TRIGGER IF EXISTS a_block_stays")
        with Ledger(connection, folder).transaction():
            connection.execute(statement, values)


def forge(folder: Path, block: Block, stored: bytes, rows: int, content: bytes = b"") -> None:
    """Put other contents in place of a block, with hashes that agree: nothing but decoding can tell."""
    (folder / block.path).write_bytes(stored)
    tamper(
        folder,
        "UPDATE blocks SET sha256 = ?, size = ?, rows = ?, content_sha256 = ? WHERE path = ?",
        hashlib.sha256(stored).hexdigest(),
        len(stored),
        rows,
        hashlib.sha256(content).hexdigest() if content else "",
        block.path,
    )


def change_data(folder: Path, change: Callable[[dict[str, Any]], None]) -> str:
    """Change what is recorded of the first collect; return its step."""
    key, _ = first_block(folder, SAMPLES)
    with open_readonly(folder) as journal:
        data = dict(journal.done_attempts()[key].data)
    change(data)
    tamper(folder, "UPDATE attempts SET data = ? WHERE step_key = ? AND outcome = 'DONE'", json.dumps(data), key)
    return key


def test_a_sound_night_is_identical_to_the_digit(recorded: Path) -> None:
    """Every collect is computed again, and nothing differs."""
    assert replay_night(recorded) == {
        "schema": "hil.replay/1",
        "simulated": True,
        "identical": True,
        "collects_checked": 6,
        "differences": [],
        "raw_missing": [],
    }


@pytest.mark.slow
def test_a_night_carried_on_by_another_clock_is_identical(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """After a resume the bench's clock is not the campaign's: what was averaged is still what was recorded."""
    write = RealDisk.write

    def full(disk: RealDisk, path: Path, data: bytes) -> None:
        if "C2" in path.name:
            raise OSError(errno.ENOSPC, "No space left on device", str(path))
        write(disk, path, data)

    folder = tmp_path / "resumed"
    with monkeypatch.context() as patch:
        patch.setattr(RealDisk, "write", full)
        assert start_night(folder, SHORT, load_bench("simulated")).state != "complete"
    assert resume_night(folder).state == "complete"
    document = replay_night(folder)
    assert document["differences"] == []
    assert (document["identical"], document["collects_checked"]) == (True, 6)


def test_the_command_says_so(recorded: Path, night: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Status 0 and words, one JSON document on request; status 4 where raw bytes are missing, 2 for no night."""
    assert run(["replay", str(recorded)]) == 0
    assert "identical to the digit, 6 collects computed again  SIMULATED" in capsys.readouterr().out
    key, block = first_block(night, RAW)
    (night / block.path).unlink()
    assert run(["replay", str(night), "--json"]) == 4
    document = json.loads(capsys.readouterr().out)
    assert (document["identical"], document["raw_missing"], document["collects_checked"]) == (False, [key], 5)
    assert run(["replay", str(night)]) == 4
    assert f"missing: the raw bytes of {key}" in capsys.readouterr().out
    assert run(["replay", str(night.parent)]) == 2


def test_a_raw_block_that_was_never_recorded_is_missing(night: Path) -> None:
    """A night without raw bytes cannot be shown to be anything."""
    tamper(night, "DELETE FROM blocks WHERE kind = ?", RAW)
    document = replay_night(night)
    assert not document["identical"]
    assert document["collects_checked"] == 0
    assert len(document["raw_missing"]) == 6


@pytest.mark.parametrize("kind", [RAW, SAMPLES])
def test_a_flipped_byte_in_a_block_is_a_difference(night: Path, kind: str) -> None:
    """The damaged file is named; the other collects are still computed."""
    _, block = first_block(night, kind)
    data = bytearray((night / block.path).read_bytes())
    data[len(data) // 2] ^= 0x10
    (night / block.path).write_bytes(data)
    document = replay_night(night)
    assert not document["identical"]
    (difference,) = document["differences"]
    assert block.path in difference
    assert "hash" in difference


def test_a_flipped_byte_with_forged_hashes_is_found_by_decoding(night: Path) -> None:
    """One frame fails its checksum: the raw bytes no longer hold the samples."""
    key, block = first_block(night, RAW)
    raw = bytearray(read_raw(night, block))
    raw[len(raw) // 2] ^= 0x01
    sink = pa.BufferOutputStream()
    with pa.CompressedOutputStream(sink, "zstd") as stream:
        stream.write(bytes(raw))
    forge(night, block, bytes(sink.getvalue()), len(raw), bytes(raw))
    (difference,) = replay_night(night)["differences"]
    assert difference.startswith(f"{key}: the raw bytes hold ")


def test_a_changed_sample_with_forged_hashes_is_found(night: Path) -> None:
    """The last digit of one stored sample, in a column that nothing averages."""
    _, block = first_block(night, SAMPLES)
    table = pq.read_table(night / block.path)
    values = table.column("counter").to_pylist()
    values[7] += 1.0
    at = table.schema.get_field_index("counter")
    table = table.set_column(at, table.schema.field(at), pa.array(values))
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink)
    forge(night, block, bytes(sink.getvalue()), block.rows)
    (difference,) = replay_night(night)["differences"]
    assert f"1 of {block.rows} samples of counter are not what the raw bytes hold, the first is number 8" in difference


def test_an_average_changed_in_its_last_digit_is_found(night: Path) -> None:
    """One average of one channel."""

    def change(data: dict[str, Any]) -> None:
        data["sensors"]["2"]["rates"]["RA"]["mean_deg_per_hr"] += 1e-9

    key = change_data(night, change)
    document = replay_night(night)
    assert not document["identical"]
    assert document["differences"][0].startswith(f"{key}: sensors 2 rates RA mean_deg_per_hr: ")
    assert len(document["differences"]) == 1


def test_a_changed_temperature_is_found(night: Path) -> None:
    """Not only rates are averages."""

    def change(data: dict[str, Any]) -> None:
        data["sensors"]["1"]["temperature_degC"] += 0.01

    key = change_data(night, change)
    (difference,) = replay_night(night)["differences"]
    assert difference.startswith(f"{key}: sensors 1 temperature_degC: ")


@pytest.mark.parametrize("data", ["[]", "{", '{"sensors": 3}', "{}"])
def test_a_ruined_record_is_a_difference_in_words(night: Path, data: str) -> None:
    """Whatever stands in the journal: a sentence, never a traceback."""
    key, _ = first_block(night, SAMPLES)
    tamper(night, "UPDATE attempts SET data = ? WHERE step_key = ? AND outcome = 'DONE'", data, key)
    (night / HEAD_NAME).write_text("")
    document = replay_night(night)
    assert not document["identical"]
    assert document["differences"]


def test_a_folder_without_a_night_is_bad_input(tmp_path: Path) -> None:
    """There is nothing to replay."""
    with pytest.raises(InputError, match="holds no night"):
        replay_night(tmp_path)
