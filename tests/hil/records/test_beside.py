"""What stands beside a journal is held against it: log, configuration, signature; and a journal that is gone."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from drivers.clock import VirtualClock
from hil.cli.app import run
from hil.config import load_bench
from hil.errors import Damaged, InputError
from hil.night.log import NightLog
from hil.night.run import judge
from hil.records import SqliteJournal, open_readonly
from hil.records.blocks import BLOCKS
from hil.records.ledger import HEAD_NAME, Ledger
from hil.records.live import TRACE_NAME
from hil.records.reader import JOURNAL_NAME, is_night, refuse_existing
from hil.records.rows import Night
from hil.records.verify import verify_night
from hil.records.witnesses import LOG_KEPT, LOG_NAME
from procedures.journal_protocol import Outcome, StepResult
from procedures.plan import Plan


def problems(folder: Path) -> str:
    """Return what is wrong by `hil verify`."""
    return "; ".join(verify_night(folder)["problems"])


def lines(folder: Path) -> list[str]:
    """Return the lines of the log that say how attempts ended."""
    return [line for line in (folder / LOG_NAME).read_text().splitlines(keepends=True) if '"step ends"' in line]


def test_a_log_that_is_lost_shortened_or_edited_is_said(full_night: Path) -> None:
    """Whatever of it: an end that it does not tell, another number, all. One without its oldest part is sound."""
    log = full_night / LOG_NAME
    good, ends = log.read_text(), lines(full_night)
    assert problems(full_night) == ""
    for bad in (good.replace(ends[-1], ""), good.replace(ends[3], ""), good.replace("0.07", "0.06")):
        log.write_text(bad)
        assert problems(full_night).startswith("log.jsonl was shortened or edited: it does not say how ")
    log.write_text("".join(ends[4:]))
    assert "how identify, attempt 1, ended, and 3 more" in problems(full_night)
    log.unlink()
    assert problems(full_night).startswith("log.jsonl was lost")
    (full_night / f"{LOG_NAME}.{LOG_KEPT}").touch()
    assert problems(full_night) == ""


def test_every_other_line_is_sealed_with_the_verdict(full_night: Path, clock: VirtualClock) -> None:
    """What was logged until then; what came later is not, until the next verdict."""
    log = full_night / LOG_NAME
    for _ in range(2):
        with SqliteJournal.open(full_night, clock=clock) as journal:
            journal.event("safe-state", "made safe at 20.0 °C")
            judge(journal, "complete")
    good = log.read_text()
    assert problems(full_night) == ""
    for old, new in (("20.0 °C", "60.0 °C"), ('"who"', '"why"'), (lines(full_night)[0], 2 * lines(full_night)[0])):
        log.write_text(good.replace(old, new, 1))
        assert "log.jsonl was shortened or edited: it is not what it was when the night was judged" in problems(
            full_night
        )
    log.write_text(good + "and so on\n")
    assert problems(full_night) == ""


def test_a_trace_of_full_length_is_what_it_was_when_the_night_was_judged(full_night: Path, clock: VirtualClock) -> None:
    """As the report says, which draws it; one that was lost or cut off with the power is none."""
    trace = full_night / TRACE_NAME
    trace.write_bytes(b"a head and rows")
    with SqliteJournal.open(full_night, clock=clock) as journal:
        judge(journal, "complete")
    assert problems(full_night) == ""
    trace.write_bytes(b"a head and rowS")
    assert problems(full_night) == f"{TRACE_NAME}: is not what was written; without it the journal's marks are drawn"
    trace.write_bytes(b"a head")
    assert problems(full_night) == ""


def test_a_killed_controller_need_not_have_said_how_its_last_attempt_ended(
    new_night: Path, plan: Plan, clock: VirtualClock, do: Callable[..., None], tmp_path: Path
) -> None:
    """Of the one before it has."""
    with SqliteJournal.open(new_night, clock=clock) as journal:
        for step in plan.steps[:3]:
            do(journal, step, clock)
        killed = Path(shutil.copytree(new_night, tmp_path / "killed"))
    log, last = killed / LOG_NAME, lines(killed)[-2:]
    for gone, named in ((last[1], False), (last[0], True)):
        log.write_text(log.read_text().replace(gone, ""))
        assert (LOG_NAME in problems(killed)) == named


def test_nor_how_those_ended_that_ended_with_it(new_night: Path, plan: Plan, clock: VirtualClock) -> None:
    """A stage is committed at once: a kill just then leaves none of it in the log, and that is no loss."""
    steps, done = plan.steps[:3], StepResult(Outcome.DONE)
    with SqliteJournal.open(new_night, clock=clock) as journal:
        for stage in (steps[:1], steps[1:]):
            clock.sleep(1.0)
            journal.end(*((step, attempt, done) for step, attempt in zip(stage, journal.begin(*stage), strict=True)))
        log, ends = new_night / LOG_NAME, lines(new_night)
        text = log.read_text()
        for gone, named in ((ends[1:], False), (ends[:1], True)):
            log.write_text("".join(line for line in text.splitlines(keepends=True) if line not in gone))
            assert (LOG_NAME in problems(new_night)) == named


@pytest.mark.slow
def test_a_file_of_the_configuration_that_is_lost_or_another_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As the journal has it on record; and a key in the bench file signs the head."""
    key, bench, night = tmp_path / "key", tmp_path / "bench.yaml", tmp_path / "night"
    bench.write_text(f"{load_bench('simulated').text}\nrecord: {{key: {key}}}\n")
    begin = ["run", "quick", "--bench", str(bench), "--out", str(night), "--quiet"]
    key.write_text("short")
    assert run(begin) == 2
    assert "is no key" in capsys.readouterr().err
    key.write_text("a key of the bench that nobody guesses\n")
    assert run(begin) == 0
    assert run(["verify", str(night)]) == 0
    assert "signed by the bench's key" in capsys.readouterr().out
    model, imu = (night / "configuration" / name for name in ("model.yaml", "imu.yaml"))
    good = model.read_bytes()
    model.write_bytes(good + b"\n")
    imu.unlink()
    assert run(["verify", str(night)]) == 4
    said = capsys.readouterr().out
    assert "configuration/model.yaml is not what the journal has on record" in said
    assert "configuration/imu.yaml is lost" in said
    assert "night: NOT as it was written" in said


def test_the_head_is_signed_with_the_key_of_the_bench(full_night: Path, tmp_path: Path) -> None:
    """Signed, not signed, or it does not fit: each in words, and damage where the bench has a key."""
    key, other, head = tmp_path / "key", tmp_path / "other", full_night / HEAD_NAME
    other.write_text("another key, of another bench")

    def said() -> tuple[str, bool]:
        document = verify_night(full_night, key)
        return document["signature"], document["complete"]

    assert said() == (f"whether it is signed by the bench's key cannot be told: {key}: there is no such file", True)
    key.write_text("a key of the bench that nobody guesses")
    assert said() == (f"not signed, and the bench has a key ({key})", False)
    unsigned = head.read_bytes()
    _sign(full_night, key)
    signed = head.read_bytes()
    assert said() == ("signed by the bench's key", True)
    assert verify_night(full_night)["signature"] == "signed, and no key is named to prove it with"
    assert not verify_night(full_night, other)["complete"]
    for bad in (
        unsigned[:79] + b"\0" + unsigned[80:],
        signed.replace(signed[100:101], b"0" if signed[100:101] != b"0" else b"1"),
        signed[:-9],
    ):
        head.write_bytes(bad)
        assert not said()[1]
    head.write_bytes(unsigned)
    assert verify_night(full_night)["complete"]


def _sign(folder: Path, key: Path) -> None:
    """Let somebody who has the key commit something."""
    with SqliteJournal.open(folder, clock=VirtualClock()) as journal:
        journal._ledger._key = key.read_bytes()


def test_whoever_writes_takes_the_key_from_the_configuration(new_night: Path, plan: Plan, tmp_path: Path) -> None:
    """A controller, its watchdog, who asks something: without a file that can be read it is not signed, and goes on."""
    key, folder = tmp_path / "key", tmp_path / "other"
    folder.mkdir()
    text = yaml.safe_dump({"bench": {"record": {"key": str(key)}}})
    night = Night("Small", "rk", VirtualClock().utc(), simulated=True, configuration=text)
    SqliteJournal.create(folder, plan, night)
    assert Ledger(open_readonly(folder)._connection, folder)._key == b""
    key.write_text("a key of the bench that nobody guesses\n")
    assert Ledger(open_readonly(folder)._connection, folder)._key == b"a key of the bench that nobody guesses"


@pytest.mark.parametrize("left", [HEAD_NAME, pytest.param(BLOCKS, marks=pytest.mark.slow)])
def test_a_journal_that_is_gone_or_empty_beside_what_it_wrote_is_damage(
    full_night: Path, left: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Never no night: whatever is asked of it ends with status 4, and says what to do."""
    (full_night / JOURNAL_NAME).unlink()
    shutil.rmtree(full_night / BLOCKS) if left == HEAD_NAME else (full_night / HEAD_NAME).unlink()
    for empty in (False, True):
        for command in ("status", "verify", "report", "solve", "resume", "replay", "pause --why x", "repair --out NEW"):
            name, *options = command.split()
            assert run([name, str(full_night), *options]) == 4, command
            said = "".join(capsys.readouterr())
            assert f"{JOURNAL_NAME}: is {'empty' if empty else 'gone'}; journal.head or blocks beside it" in said, (
                command
            )
            assert "put it back from a copy" in said
        (full_night / JOURNAL_NAME).touch()
    assert is_night(full_night)
    with pytest.raises(InputError, match="it holds a night already"):
        refuse_existing(full_night)


def test_a_campaign_folder_is_no_night_and_what_takes_it_is_said(tmp_path: Path) -> None:
    """Whoever asks how it stands, or whether it is whole, is sent on."""
    (tmp_path / "campaign.yaml").touch()
    with pytest.raises(InputError, match=r"holds no night.*it is a campaign folder: hil solve, report"):
        verify_night(tmp_path)


def test_an_empty_file_with_nothing_beside_it_is_no_night(tmp_path: Path) -> None:
    """Somebody's empty file."""
    NightLog(tmp_path, VirtualClock(), "rk").close()
    for words in (f"there is no {JOURNAL_NAME}", "is empty, and nothing is beside it"):
        with pytest.raises(InputError, match=f"holds no night.*{words}") as refused:
            verify_night(tmp_path)
        assert not isinstance(refused.value, Damaged)
        (tmp_path / JOURNAL_NAME).touch()
