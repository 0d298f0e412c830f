"""The serial number that somebody typed or scanned, operator and note: asked for, compared, and in every record."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import pytest
import yaml

from drivers.imu import ImuIdentity
from hil.campaign.reader import read_campaign
from hil.config import load_bench, load_sweep
from hil.config.recorded import bench_of_record
from hil.errors import InputError
from hil.files.strict import find_config
from hil.night import NightOutcome, Remarks, resume_night, start_night
from hil.records import open_readonly
from hil.records.export import campaign_of_night
from hil.records.requests import request
from hil.records.status import night_status
from procedures.requests import RequestKind
from procedures.stop import StopRequest
from tests.hil.cli.test_cli_bad_input import refused


def bench_file(folder: Path, *, tells: bool, serial: str = "ask") -> Path:
    """A bench whose file has the serial number asked for, and whose unit does, or does not, tell its own."""
    frames = yaml.safe_load(find_config("imus", "mfs").read_text())
    if not tells:
        del frames["roles"]["identity"]["serial"]
    (folder / "my-imu.yaml").write_text(yaml.safe_dump(frames, sort_keys=False))
    document = yaml.safe_load(load_bench("simulated").text)
    document["unit"]["serial"] = serial
    document["largest_standard_error"] = "4 deg/hr"
    document["imu"]["description"] = str(folder / "my-imu.yaml")
    path = folder / "my-bench.yaml"
    path.write_text(yaml.safe_dump(document, sort_keys=False))
    return path


class Page:
    """Somebody at the live page who answers what is asked through the journal, the first time without words."""

    def __init__(self, folder: Path, *answers: str) -> None:
        self.folder, self.answers, self.prompts = folder, answers, 0

    def put(self, question: str, timeout_s: float, *, wants_words: bool) -> None:
        """Answer at once."""
        assert wants_words
        self.prompts += 1
        assert night_status(self.folder)["prompt"]["wants_words"] is True
        for answer in self.answers:
            request(self.folder, RequestKind.CONFIRM, "ann (live page)", answer, prompt=self.prompts)

    def answer(self) -> None:
        """Nobody sits at the terminal."""

    def settle(self, how: str) -> None:
        """Nothing to do."""


@pytest.mark.slow
def test_what_is_typed_stands_in_every_record(hil: Any, one_run: Path, tmp_path: Path) -> None:
    """Folder, journal, status, campaign and report of a unit that does not tell its serial number."""
    bench, campaign, page = bench_file(tmp_path, tells=False), tmp_path / "campaign", tmp_path / "page.html"
    options = ("--serial", "U/014", "--operator", "R. Kim", "--note", "after repair")
    ended = hil("run", one_run, "--bench", bench, *options, "--out", tmp_path / "{serial}")
    assert ended.returncode == 0, ended.stderr
    night = tmp_path / "U-014"
    with open_readonly(night) as journal:
        assert bench_of_record(journal.night.configuration).unit.serial == "U/014"
        assert journal.night.who == "R. Kim"
    said = {"model": "MFS-IMU", "serial": "U/014", "operator": "R. Kim", "note": "after repair"}
    assert json.loads(hil("status", night, "--json").stdout)["identity"] == said
    assert hil("export", night, campaign).returncode == 0
    assert yaml.safe_load((campaign / "campaign.yaml").read_text())["identity"] == said
    assert read_campaign(campaign).identity == said
    assert read_campaign(campaign).largest_se == 4.0
    assert hil("report", campaign, "--out", page).returncode == 0
    assert all(f"<strong>{text}</strong>" in page.read_text() for text in said.values())


def test_where_nobody_can_be_asked_nothing_begins(hil: Any, one_run: Path, tmp_path: Path) -> None:
    """The bench says that it is asked, and nobody typed it: refused, and no folder is left."""
    ended = hil("run", one_run, "--bench", bench_file(tmp_path, tells=False), "--out", tmp_path / "night", "--yes")
    assert ended.returncode == 2
    assert "give --serial" in ended.stderr
    assert not (tmp_path / "night").exists()


class Terminal(io.StringIO):
    """Somebody sits there."""

    def isatty(self) -> bool:
        """Yes."""
        return True


@pytest.mark.parametrize(("serial", "typed"), [("ask", "014\n"), ("", "014\n"), ("", "\n")])
def test_a_folder_that_is_called_by_the_serial_number_has_it_asked_for(
    hil: Any, one_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, serial: str, typed: str
) -> None:
    """Nothing else takes its place: where nobody can be asked, or answers, no folder is made."""
    bench = bench_file(tmp_path, tells=False, serial=serial)
    command = ("run", one_run, "--bench", bench, "--out", tmp_path / "n-{serial}")
    refused(hil(*command), "give --serial")
    monkeypatch.setattr("hil.cli.night._start", lambda _, bench, out, **__: NightOutcome(out, bench.unit.serial, "", 0))
    monkeypatch.setattr("sys.stdin", Terminal(typed))
    ended = hil(*command)
    if typed.strip():
        assert f"{tmp_path / 'n-014'}: 014" in ended.stderr
    else:
        assert (ended.returncode, "nobody answered" in ended.stderr) == (2, True)


@pytest.mark.parametrize(
    ("option", "text", "words"),
    [
        ("--serial", "", "is no serial number"),
        ("--serial", "  ", "is no serial number"),
        ("--serial", "x" * 100_000, "is no serial number"),
        ("--note", "x" * 100_000, "--note: one line of at most 500 characters"),
        ("--operator", "x" * 100_000, "--operator: one line of at most 60 characters"),
        ("--despite", "two\nlines", "--despite: one line of at most 500 characters"),
    ],
)
def test_what_is_said_for_the_record_is_a_line(
    hil: Any, one_run: Path, tmp_path: Path, option: str, text: str, words: str
) -> None:
    """Refused before anything begins, in a sentence that fits on a screen."""
    bench, night = bench_file(tmp_path, tells=False, serial=""), tmp_path / "night"
    ended = hil("run", one_run, "--bench", bench, "--out", night, option, text)
    refused(ended, words)
    assert len(ended.stderr) < 300
    assert not night.exists()


def test_a_resume_can_give_the_serial_number_that_is_missing(hil: Any, one_run: Path, tmp_path: Path) -> None:
    """Once: another one is refused, and so is none at all."""
    bench, night, stop = load_bench(bench_file(tmp_path, tells=False, serial="")), tmp_path / "night", StopRequest()
    stop.request("at once")
    start_night(night, load_sweep(one_run), bench, stop=stop)
    refused(hil("resume", night, "--serial", ""), "is no serial number")
    resume_night(night, who="rk", stop=stop, remarks=Remarks(serial="014"))
    assert night_status(night)["identity"]["serial"] == "014"
    refused(hil("resume", night, "--serial", "015"), "it is a night of unit 014, and 015 was typed")


@pytest.mark.parametrize(("serial", "status"), [pytest.param("SIM-0001", 0, marks=pytest.mark.slow), ("SIM-0002", 3)])
def test_a_unit_that_tells_its_own_is_compared(
    hil: Any,
    one_run: Path,
    tmp_path: Path,
    serial: str,
    status: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Another one than was typed is NOT, in words, before anything moves; it need not be typed at all."""
    monkeypatch.setattr(
        "hil.twin.devices.ImuIdentity", lambda model, _, version: ImuIdentity(model, "SIM-0001", version)
    )
    ended = hil(
        "run", one_run, "--bench", bench_file(tmp_path, tells=True), "--serial", serial, "--out", tmp_path / "night"
    )
    assert ended.returncode == status, ended.stderr
    refusal = "NOT  unit: sim://imu: the unit says serial 'SIM-0001', 'SIM-0002' is what"
    assert (refusal in ended.stderr) is (status == 3)


def test_a_bench_file_that_names_another_is_not_overruled(tmp_path: Path) -> None:
    """Two serial numbers from people: somebody has to say which; and one that could be none is refused."""
    bench = load_bench(bench_file(tmp_path, tells=False, serial="013"))
    with pytest.raises(InputError, match="it says 013, and 014 was typed"):
        bench.of_unit("014")
    assert bench.of_unit("013").unit.serial == "013"
    for text in ("", " 014", "0\n14", "x" * 61):
        with pytest.raises(InputError, match="is no serial number"):
            bench.of_unit(text)


@pytest.mark.slow
def test_the_question_is_answered_on_the_page_before_anything_moves(one_run: Path, tmp_path: Path) -> None:
    """Words are needed: an answer without any is refused, impossible ones are asked for again; then it is known."""
    bench, night = load_bench(bench_file(tmp_path, tells=False)), tmp_path / "night"
    page = Page(night, "", "014")
    assert start_night(night, load_sweep(one_run), bench, who="rk", terminal=page).state == "complete"
    with open_readonly(night) as journal:
        kinds = [event.kind for event in journal.events()]
        accepted = [row.accepted for row in journal.requests()]
        begun = journal.attempts()[0].began_s
        asked = next(event for event in journal.events() if event.kind == "unit-serial")
    assert accepted == [False, True]
    assert asked.evidence == {"serial": "014", "who": "ann (live page)"}
    assert kinds.index("unit-serial") > kinds.index("prompt")
    assert asked.at_s <= begun
    assert campaign_of_night(night).identity["serial"] == "014"


@pytest.mark.slow
def test_without_an_answer_nothing_moves_and_a_resume_asks_again(one_run: Path, tmp_path: Path) -> None:
    """The night ends by itself after an hour in which the chamber was never commanded."""
    bench, night = load_bench(bench_file(tmp_path, tells=False)), tmp_path / "night"
    ended = start_night(night, load_sweep(one_run), bench, who="rk")
    assert (ended.state, ended.exit_status) == ("failed", 3)
    assert "nobody typed the unit's serial number" in ended.reason
    log = (night / "log.jsonl").read_text()
    assert "set temperature" not in log
    assert "safe state" not in log
    assert resume_night(night, terminal=Page(night, "014")).state == "complete"
    assert night_status(night)["identity"]["serial"] == "014"
