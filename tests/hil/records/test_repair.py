"""A damaged night: what is proven is brought back into a new folder, what is lost is said, the old one stays."""

from __future__ import annotations

import json
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from drivers.clock import VirtualClock
from hil.cli.app import run
from hil.config import load_bench, load_sweep
from hil.errors import Damaged, InputError
from hil.files.lock import FolderLock
from hil.night import resume_night, start_night
from hil.night.log import NightLog
from hil.night.repair import repair_night
from hil.records import SqliteJournal, open_readonly
from hil.records.export import campaign_of_night
from hil.records.ledger import HEAD_NAME
from hil.records.reader import JOURNAL_NAME
from hil.records.status import night_status
from hil.records.verify import verify_night
from hil.records.witnesses import LOG_NAME
from procedures.plan import Plan, StepKind

Do = Callable[..., None]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A complete night; tests work on copies."""
    folder = tmp_path_factory.mktemp("recorded") / "night"
    assert start_night(folder, load_sweep("quick"), load_bench("simulated"), who="rk").state == "complete"
    return folder


@pytest.fixture
def night(recorded: Path, tmp_path: Path) -> Path:
    """A copy of the night, to be damaged."""
    return Path(shutil.copytree(recorded, tmp_path / "night"))


def edit(folder: Path, *statements: str) -> None:
    """Change the journal as somebody with a database program would."""
    with closing(sqlite3.connect(folder / JOURNAL_NAME, isolation_level=None)) as connection:
        for (trigger,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'trigger'").fetchall():
            connection.execute(f"DROP TRIGGER {trigger}")
        for statement in statements:
            connection.execute(statement)


def contents(folder: Path) -> dict[str, bytes]:
    """Return every file of a folder."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture
def killed(new_night: Path, plan: Plan, clock: VirtualClock, do: Do, tmp_path: Path) -> Path:
    """A night as kill -9 leaves it after its seventh step: the last step's commits are in the write-ahead log alone."""
    folder = tmp_path / "killed"
    with SqliteJournal.open(new_night, clock=clock, who="rk") as journal:
        log = NightLog(new_night, clock, "rk")
        journal.listen(log.say)
        for step in plan.steps[:7]:
            if step is plan.steps[6]:
                journal._empty_write_ahead_log = lambda: None  # type: ignore[method-assign]
            do(journal, step, clock)
        shutil.copytree(new_night, folder, ignore=shutil.ignore_patterns("*-shm"))
        log.close()
    assert len(verify_night(folder)["problems"]) == len(plan.self_calibrations) + 1
    return folder


@pytest.mark.parametrize("places", [25, pytest.param(300, marks=pytest.mark.slow)])
def test_a_bit_flipped_in_the_write_ahead_log_is_damage_wherever_it_is(
    killed: Path, tmp_path: Path, places: int
) -> None:
    """SQLite takes what follows for the end of its log; the head, the log and the blocks know that there was more."""
    wal = killed / f"{JOURNAL_NAME}-wal"
    good = wal.read_bytes()
    assert len(good) < 40 * 4120, "it holds more than one step"
    for at in range(0, len(good), len(good) // places):
        wal.write_bytes(good[:at] + bytes([good[at] ^ 1 << at % 8]) + good[at + 1 :])
        folder = Path(shutil.copytree(killed, tmp_path / "flipped"))
        status = night_status(folder)
        assert (status["steps_done"] == 7) != bool(status["problems"]), at
        if status["problems"]:
            assert "ERROR: journal.sqlite: " in status["reason"]
            with pytest.raises(Damaged, match="hil repair"):
                resume_night(folder)
        shutil.rmtree(folder)


def test_a_step_that_the_write_ahead_log_lost_is_brought_back_from_the_log(killed: Path, tmp_path: Path) -> None:
    """Its result to the last digit, and its blocks; the damaged folder is not touched."""
    with open_readonly(Path(shutil.copytree(killed, tmp_path / "sound"))) as journal:
        before = journal.completed()
    (killed / f"{JOURNAL_NAME}-wal").write_bytes(b"")
    files = contents(killed)
    document = repair_night(killed, tmp_path / "new")
    assert contents(killed) == files
    assert (document["steps_done"], document["steps_total"]) == (7, 17)
    (restored,) = document["restored"]
    assert restored.endswith(": DONE")
    with open_readonly(tmp_path / "new") as journal:
        assert journal.completed() == before
        assert [each.kind for each in journal.events()] == ["repaired", "verdict"]
    assert all(each.startswith("missing: ") for each in verify_night(tmp_path / "new")["problems"])


def test_a_line_of_the_log_that_was_changed_proves_nothing(killed: Path, tmp_path: Path) -> None:
    """Neither does it bring a step back, nor does it say that one is missing."""
    (killed / f"{JOURNAL_NAME}-wal").write_bytes(b"")
    log = killed / LOG_NAME
    log.write_text(log.read_text().replace('"se_deg_per_hr": 0.07', '"se_deg_per_hr": 0.01'))
    assert repair_night(killed, tmp_path / "new")["steps_done"] == 6


@pytest.mark.parametrize(
    ("damage", "lost"),
    [
        ("UPDATE heartbeats SET readings = '{' WHERE id = 2", ["1 row of the table heartbeats"]),
        ("UPDATE attempts SET reason = 'excellent' WHERE id = 3", []),
        ("UPDATE steps SET key = 'x' WHERE number = 3", []),
        ("DELETE FROM steps WHERE number > 3", []),
        ("DELETE FROM blocks WHERE id = 3", []),
    ],
)
def test_what_is_proven_comes_back_and_what_is_not_is_said(
    recorded: Path, night: Path, tmp_path: Path, damage: str, lost: list[str]
) -> None:
    """From the log, from the configuration; what nothing proves is counted."""
    edit(night, damage)
    assert verify_night(night)["problems"]
    document = repair_night(night, tmp_path / "new")
    assert document["lost"] == lost
    assert verify_night(tmp_path / "new")["problems"] == []
    mended, sound = campaign_of_night(tmp_path / "new"), campaign_of_night(recorded)
    assert all((mended.sensors[n].rates_deg_per_hr == each.rates_deg_per_hr).all() for n, each in sound.sensors.items())


def test_a_self_calibration_whose_samples_are_damaged_counts_no_more_and_can_be_done_again(
    night: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The others stand; the command says what is lost, with status 4, and a resume makes the night complete."""
    block = min((night / "blocks").glob("*.parquet"))
    block.write_bytes(block.read_bytes()[::-1])
    assert run(["repair", str(night), "--out", str(tmp_path / "new"), "--json"]) == 4
    document = json.loads(capsys.readouterr().out)
    assert [block.name in each for each in document["lost"]] == [True]
    status = night_status(tmp_path / "new")
    assert (status["state"], status["self_calibrations_done"]) == ("incomplete", status["self_calibrations_total"] - 1)
    assert resume_night(tmp_path / "new").state == "complete"
    assert verify_night(tmp_path / "new")["problems"] == []


def test_without_a_proven_plan_nothing_is_made(night: Path, tmp_path: Path) -> None:
    """Nor where something is in the way."""
    edit(night, "UPDATE night SET configuration = configuration || ' '")
    with pytest.raises(Damaged, match="Parquet files"):
        repair_night(night, tmp_path / "new")
    (night / JOURNAL_NAME).write_bytes(b"rubbish")
    with pytest.raises(Damaged, match="not proven"):
        repair_night(night, tmp_path / "new")
    with pytest.raises(InputError, match="at work here"), FolderLock(night).acquire():
        repair_night(night, tmp_path / "new")
    with pytest.raises(InputError, match="holds no night"):
        repair_night(tmp_path, tmp_path / "new")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["night"]


def test_a_folder_that_holds_something_is_left_alone(night: Path) -> None:
    """What is repaired gets a folder of its own."""
    with pytest.raises(InputError, match="it exists and is not empty; name a new folder"):
        repair_night(night, night)


def test_a_head_of_another_night_is_no_head(night: Path) -> None:
    """Whatever is wrong with the second witness is said."""
    head = night / HEAD_NAME
    good = head.read_text()
    for bad in (good.replace("/1 ", "/1 1"), good[:-1], good[:-1] + "x", "", good.replace("a", "b"), "hil.head/1 7 x"):
        head.write_text(bad)
        assert HEAD_NAME in night_status(night)["problems"][0]
    head.unlink()
    assert f"{HEAD_NAME} is missing" in night_status(night)["problems"][0]


def test_collects_are_written_once(killed: Path, plan: Plan, clock: VirtualClock, do: Do) -> None:
    """No block takes the name of another, whatever the journal has forgotten."""
    collect = plan.of_kind(StepKind.COLLECT)[1]
    with SqliteJournal.open(killed, clock=clock) as journal:
        journal.withdraw([collect.key], "again")
        journal.begin = lambda *_: [1]  # type: ignore[method-assign]
        with pytest.raises(FileExistsError, match="written before"):
            do(journal, collect, clock)
