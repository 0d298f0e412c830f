"""Bad input: one clear sentence, status 2, no traceback, and nothing left behind."""

from __future__ import annotations

import errno
import os
import sqlite3
from pathlib import Path
from typing import Any

import pytest
import yaml

from hil.cli.exit_status import run_to_exit
from hil.cli.night import refuse_but_demo
from hil.config import load_sweep
from hil.config.sweep import parse_sweep
from hil.errors import InputError
from hil.files.strict import find_config
from hil.records import SqliteJournal
from hil.records.units import writable


def shipped(kind: str, name: str) -> dict[str, Any]:
    """A configuration file that ships, as YAML gives it."""
    return dict(yaml.safe_load(find_config(kind, name).read_text()))


def refused(ended: Any, *words: str) -> None:
    """Status 2, one sentence with `words`, no traceback."""
    assert ended.returncode == 2, ended.stderr
    assert ended.stdout == ""
    assert "Traceback" not in ended.stderr
    assert len(ended.stderr.strip().splitlines()) == 1
    for word in words:
        assert word in ended.stderr


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("temperatures", ["20 kg"], ("temperatures", "kg")),
        ("temperatures", ["200 degC"], ("200", "limits")),
        ("temperatures", [], ("temperatures",)),
        ("colour", "blue", ("colour",)),
        ("self_calibrations_per_temperature", 0, ("self_calibrations_per_temperature",)),
        ("positions", [1, 2, 9], ("9",)),
    ],
)
def test_a_wrong_sweep_is_refused(hil: Any, tmp_path: Path, key: str, value: object, words: tuple[str, ...]) -> None:
    """A wrong unit, a temperature outside the chamber's limits, an unknown key, a position that the bench lacks."""
    path = tmp_path / "sweep.yaml"
    path.write_text(yaml.safe_dump({**shipped("sweeps", "rd-gc-86-1"), key: value}))
    out = tmp_path / "night"
    refused(hil("run", path, "--bench", "simulated", "--out", out), "sweep.yaml", *words)
    assert not out.exists()
    assert sorted(each.name for each in tmp_path.iterdir()) == ["sweep.yaml"]


def test_a_port_that_does_not_exist_is_refused(hil: Any, tmp_path: Path) -> None:
    """The message names the key and the port; nothing is begun."""
    bench = shipped("benches", "simulated")
    bench["clock"] = "system"
    bench["imu"]["port"] = str(tmp_path / "ttyNONE")
    path = tmp_path / "bench.yaml"
    path.write_text(yaml.safe_dump(bench))
    out = tmp_path / "night"
    refused(hil("run", "quick", "--bench", path, "--out", out, "--yes"), "imu.port", "ttyNONE", "begin hil simulate")
    assert not out.exists()


def test_names_that_nobody_knows_are_refused(hil: Any, tmp_path: Path) -> None:
    """An unknown sweep, bench, folder or model: which one, and what there is."""
    refused(hil("plan", "nonsense", "--bench", "simulated"), "nonsense", "rd-gc-86-1")
    refused(hil("plan", "rd-gc-86-1", "--bench", "nonsense"), "nonsense", "simulated")
    for command in ("solve", "status", "verify"):
        refused(hil(command, tmp_path / "nowhere"), "nowhere: there is no such folder")
    refused(hil("status", tmp_path), "journal")
    refused(hil("resume", tmp_path), "journal")


def test_a_folder_that_is_neither_is_refused(hil: Any, tmp_path: Path) -> None:
    """A folder without campaign.yaml and without a journal is not guessed at."""
    refused(hil("solve", tmp_path), "campaign.yaml")
    refused(hil("report", tmp_path), "campaign.yaml")


def test_a_page_for_a_folder_that_is_read_only_may_go_elsewhere(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Whoever was given an archive to read is told how; one that is writable is taken as it is."""
    assert writable(tmp_path) == tmp_path
    monkeypatch.setattr(os, "access", lambda *_: False)
    with pytest.raises(InputError, match="is read-only; --out says where else"):
        writable(tmp_path)


def test_usage_errors_have_status_2(hil: Any) -> None:
    """An unknown command or option is bad usage."""
    assert hil("explode").returncode == 2
    assert hil("plan", "rd-gc-86-1", "--nonsense").returncode == 2
    assert hil("run", "rd-gc-86-1").returncode == 2


@pytest.mark.parametrize("command", ["run", "resume", "status", "solve", "verify", "export", "simulate", "report"])
def test_every_command_helps(hil: Any, command: str) -> None:
    """--help says what the command does and ends with 0."""
    ended = hil(command, "--help")
    assert ended.returncode == 0
    assert "Usage" in ended.stdout


def test_the_demo_does_not_replace_what_is_not_a_demo(hil: Any, tmp_path: Path) -> None:
    """A folder with something else in it is refused and kept."""
    keep = tmp_path / "keep.txt"
    keep.write_text("mine")
    refused(hil("demo", "--out", tmp_path), str(tmp_path))
    assert keep.read_text() == "mine"
    refused(hil("demo", "--out", keep), str(keep), "is a file")
    assert keep.read_text() == "mine"


@pytest.mark.slow
def test_the_demo_replaces_nothing_but_a_demo(hil: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Simulated or not: who ran a night may want it, and an export that was put there as well."""
    night = tmp_path / "night"
    assert hil("run", "quick", "--bench", "simulated", "--out", night, "--yes", "--operator", "R. Kim").returncode == 0
    before = sorted(each.name for each in night.iterdir())
    refused(hil("demo", "--out", night), str(night), "that R. Kim carried out", "would be lost")
    assert sorted(each.name for each in night.iterdir()) == before
    demo, quick = tmp_path / "demo", load_sweep("quick")
    monkeypatch.setattr("hil.config.load_sweep", lambda _: quick)
    assert [hil("demo", "--out", demo, "--quiet").returncode for _ in range(2)] == [0, 0]
    longer = parse_sweep(quick.text.replace("positions: [1, 2, 3]", "positions: [1, 2, 3, 4]"), quick.source)
    with pytest.raises(InputError, match="of another sweep"):
        refuse_but_demo(demo, longer)
    (demo / "export").mkdir()
    with pytest.raises(InputError, match="export beside a night, which would be lost"):
        refuse_but_demo(demo, quick)


def test_what_is_stopped_from_the_keyboard_says_so_whoever_hears_it_first(capsys: pytest.CaptureFixture[str]) -> None:
    """The command line's own library ends with a number of its own; tidying up may fail for that."""

    def stopped() -> None:
        raise SystemExit(130)

    def interrupted() -> None:
        raise KeyboardInterrupt

    def untidied() -> None:
        try:
            raise KeyboardInterrupt
        finally:
            os.close(2**30)

    def told() -> None:
        try:
            raise KeyboardInterrupt("SIGTERM")
        except KeyboardInterrupt as ending:
            raise SystemExit(130) from ending

    assert [run_to_exit(each) for each in (stopped, interrupted, untidied, told)] == [1, 1, 1, 1]
    assert capsys.readouterr().err == "hil: stopped from the keyboard\n" * 3 + "hil: stopped by SIGTERM\n"


def test_a_name_in_another_encoding_is_refused_before_anything_is_written(hil: Any, tmp_path: Path) -> None:
    """As an old stick has them: a journal cannot record it, and a sound night would seem damaged."""
    refused(hil("run", "quick", "--bench", "simulated", "--out", f"{tmp_path}/pr\udcfcf"), "the name is not UTF-8")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("kind", [errno.EROFS, errno.EACCES, errno.EPERM])
def test_a_folder_that_nobody_can_write_is_a_wrong_name(kind: int) -> None:
    """Of what is given, as any that is not there; to whoever has no permission, too."""

    def read_only() -> None:
        raise OSError(kind, "cannot be written", "found")

    assert run_to_exit(read_only) == 2


def test_a_disk_without_room_for_the_journal_is_one_sentence(
    hil: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The night cannot even begin: refused, and nothing is left behind."""

    def full(*_arguments: object) -> None:
        raise sqlite3.OperationalError("database or disk is full")

    monkeypatch.setattr(SqliteJournal, "create", full)
    out = tmp_path / "night"
    refused(hil("run", "quick", "--bench", "simulated", "--out", out), str(out), "disk is full")
    assert list(tmp_path.iterdir()) == []


def test_a_journal_that_cannot_be_read_is_damaged_in_words(capsys: pytest.CaptureFixture[str]) -> None:
    """Bytes gone wrong in the middle of the file are no defect of the program."""

    def malformed() -> None:
        raise sqlite3.DatabaseError("database disk image is malformed")

    assert run_to_exit(malformed) == 4
    assert capsys.readouterr().err == (
        "hil: ERROR: the journal is damaged (database disk image is malformed); hil verify says how far\n"
    )
