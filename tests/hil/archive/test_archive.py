"""An archive takes everything up once, whole or not at all; its index is made from the folders and nothing else."""

from __future__ import annotations

import errno
import json
import shutil
import sqlite3
from contextlib import closing
from dataclasses import replace
from http.client import HTTPConnection
from pathlib import Path

import numpy as np
import pytest

from hil.analysis.thermal.estimate import find_stations
from hil.archive.folder import read_entry, take_up
from hil.archive.history import history
from hil.archive.index import opened_index
from hil.archive.page import history_page
from hil.archive.places import INDEX_NAME, MARK, found
from hil.archive.taking_in import update
from hil.campaign import Campaign
from hil.campaign.reader import read_campaign
from hil.campaign.writer import write_campaign
from hil.cli.app import run as hil
from hil.config import parse_bench
from hil.config.bench import load_bench
from hil.dashboard.access import Access
from hil.errors import InputError
from hil.files.durable import RealDisk
from hil.night import start_night
from hil.records import open_readonly
from hil.records.export import export_campaign
from hil.solve import repeats, solve_campaign
from procedures.verdict import Judgement, Verdict
from tests.hil.archive.conftest import COUNT, DAYS, DRIFT, JUMP, of_life
from tests.hil.dashboard.live_page import TOKEN, served
from tests.hil.report.report_pages import TWO


@pytest.mark.slow
def test_a_life_tells_drift_from_jump(archive: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """What was put in comes out, with intervals that hold it; what was not is not found; the limits are reached."""
    capsys.readouterr()
    assert hil(["history", "0042", "--archive", str(archive), "--limits", "rd-gc-86-1", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    found = {(each["sensor"], each["parameter"]): each for each in document["parameters"]}
    for sensor in (1, 2):
        slope = found[sensor, "BA"]["drift_per_month"]
        assert found[sensor, "BA"]["finding"] == "drift"
        assert slope["low"] < DRIFT < slope["high"] < 1.2 * DRIFT
    jump = found[2, "BB"]["jump"]
    assert found[2, "BB"]["finding"] == "jump"
    assert jump["low"] < JUMP < jump["high"]
    assert jump["between"] == ["2024-09-30", "2024-12-30"]
    assert not found[2, "BB"]["differs_between_temperatures"]
    rest = found.keys() - {(1, "BA"), (2, "BA"), (2, "BB")}
    assert {found[each]["finding"] for each in rest} == {"nothing shown"}
    for of in found[2, "BB"]["temperatures"]:  # control limits are those since its jump
        assert not of["control"]["outside"]
        assert abs(of["control"]["centre"] - of["values"][-1]["value"]) < 5.0
    assert document["next_calibration"]["due"] >= document["campaigns"][-1]["began_utc"][:10]
    one = found[1, "BB"]
    unknown = one | {"temperatures": [of | {"control": None} for of in one["temperatures"]]}
    for those, word in ((one, "no"), (unknown, "–")):  # limits that nobody knows are not kept
        assert f'<td class="wrap">{word}</td>' in history_page(document | {"parameters": [those]})
    unused = [each | {"used": False} for each in document["campaigns"]]  # the page counts what its table lists
    assert f"{len(unused)} calibrations in the archive, 0 of them used" in history_page(
        document | {"campaigns": unused, "parameters": []}
    )
    table, life = tmp_path / "values.csv", tmp_path / "life"
    asked = ["--archive", str(archive), "--csv", str(table), "--out", str(life)]
    assert hil(["history", "0042", *asked]) == 0
    assert "jumped by" in (said := capsys.readouterr().out)
    assert "limits are known" in said
    assert len(table.read_text().splitlines()) == 1 + COUNT * 2 * 2 * 6
    assert hil(["solve", str(life), "--json"]) == 0
    runs = {each["run"] for each in json.loads(capsys.readouterr().out)["solutions"]}
    assert len(runs) == COUNT * 4
    starts_s = read_campaign(life).sensors[2].conditions.start_s
    assert float(np.ptp(starts_s)) == pytest.approx((COUNT - 1) * DAYS * 86400.0, rel=0.01)  # the calendar's


@pytest.mark.slow
def test_the_live_page_has_the_units_and_each_ones_life(archive: Path, campaigns: list[Path]) -> None:
    """Behind an address that only the stream tells; a unit that is not there is 404."""

    def asked(port: int, path: str) -> tuple[int, str]:
        with closing(HTTPConnection("127.0.0.1", port, timeout=30.0)) as connection:
            connection.request("GET", path)
            answer = connection.getresponse()
            stream = path == "/api/stream"
            return answer.status, (answer.readline() if stream else answer.read()).decode()

    with served(campaigns[0].parent, Access(TOKEN, "127.0.0.1"), archive) as port:
        address = json.loads(asked(port, "/api/stream")[1].removeprefix("data: "))["units"]
        status, text = asked(port, address)
        assert (status, f'href="{address}0042?model=MFS-IMU"' in text) == (200, True)
        status, text = asked(port, f"{address}0042?model=MFS-IMU")
        assert (status, text.count("<figure>")) == (200, 12)
        assert "jumped by" in text
        assert asked(port, f"{address}0043")[0] == 404
        assert asked(port, "/units/guessed/0042")[0] == 404
    with served(campaigns[0].parent, Access(TOKEN, "127.0.0.1")) as port:
        assert json.loads(asked(port, "/api/stream")[1].removeprefix("data: "))["units"] == ""


def test_the_index_says_what_solve_says(archive: Path, measured: Campaign) -> None:
    """Means and uncertainties to the digit, at the temperatures of `hil thermal`."""
    campaign = of_life(measured, 3)
    shown = repeats(campaign, solve_campaign(campaign))
    with opened_index(archive) as index:
        (name,) = [each.name for each in index.entries("0042") if each.began_utc.startswith("2024-09-30")]
        known = [each for each in index.means("0042") if each.entry == name]
    told = {(each.sensor, each.parameter, each.temperature_degC): each.value for each in known}
    for number, of in shown.items():
        for mean in of.means:
            for parameter, value in mean.values.items():
                assert told[number, parameter, mean.temperature_degC] == value
        own_degC = sorted({each.own_degC for each in known if each.sensor == number})
        assert own_degC == find_stations(campaign.sensors[number].conditions).centre_degC.tolist()


def test_a_run_that_is_not_good_costs_the_means_that_hold_it(measured: Campaign, tmp_path: Path) -> None:
    """As in the report; its other temperatures are numbers to rely on, and were said to tell nothing of the unit."""
    told = {}
    for word in (Verdict.PASS, Verdict.INCONCLUSIVE, Verdict.FAIL):  # one that FAILs is in no mean
        source = write_campaign(replace(of_life(measured, 1), verdicts={1: Judgement(word, "why")}), tmp_path / word)
        entry = take_up(archive := tmp_path / f"archive of {word}", source).entry
        update(archive)
        with opened_index(archive) as index:
            found = history(index, "0042")
            told[word] = {(each.sensor, each.parameter, each.temperature_degC) for each in index.means("0042")}
        assert [each["used"] for each in found["campaigns"]] == [True]
        is_told = f"{entry}: is {word} and tells of the unit what its means without such runs do: 2 of 8 solutions"
        assert [is_told in each for each in found["said"]] == [True] * (word is not Verdict.PASS)
    shown = repeats(campaign := of_life(measured, 1), solve_campaign(campaign))
    its = {(n, name, mean.temperature_degC) for n, of in shown.items() for mean in of.means for name in mean.values}
    holds_it = {(n, mean.temperature_degC) for n, of in shown.items() for mean in of.means if 1 in mean.runs}
    assert told[Verdict.PASS] == told[Verdict.FAIL] == its
    assert told[Verdict.INCONCLUSIVE] == {each for each in its if (each[0], each[2]) not in holds_it}


def test_a_unit_of_which_nothing_is_usable_has_no_table_of_findings(
    measured: Campaign, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of a model that nobody named; the archive was made for it, which is said, for its name may have been misspelt."""
    known = {run: Judgement(Verdict.FAIL, "the unit moved") for run in range(1, 5)}
    bad = write_campaign(replace(of_life(measured, 1, model=""), verdicts=known), tmp_path / "bad")
    asked = ["archive", str(tmp_path / "new"), str(bad)]
    assert hil(asked) == hil(asked) == 0
    assert capsys.readouterr().out.count("new: a new archive, 1 campaign, 1 of them read now\n") == 1
    assert hil(["history", "0042", "--archive", str(tmp_path / "new")]) == 0
    first, *rest = capsys.readouterr().out.splitlines()
    assert first == "unit 0042: 1 calibration (0 good enough to tell anything), 2024-04-01"
    assert rest == ["next calibration: no date (no limits are known: --limits names them)"]


@pytest.mark.slow
def test_a_night_takes_the_place_of_its_export(night: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Whichever comes first, the night is there in the end, once, with what only a night has."""
    export_campaign(night, export := tmp_path / "export")
    for number, sources in enumerate(([export, night], [night, export])):
        folder = tmp_path / f"{number}"
        assert [hil(["archive", str(folder), str(each)]) for each in sources] == [0, 0]
        assert ("an export of this night" in capsys.readouterr().out) == (number == 0)
        (entry,) = found(folder)[0]
        facts, _, configuration = read_entry(folder, entry)
        assert facts["night"]["id"]
        assert configuration["bench"]
        assert update(folder)["gone"] == []


def test_a_table_that_was_corrected_is_of_the_night_whose_place_it_takes(night: Path, tmp_path: Path) -> None:
    """When it was, by which bench and which record: with it all that the night's folder could still tell had gone."""
    folder = tmp_path / "archive"
    before = read_entry(folder, take_up(folder, night).entry)
    exported = replace(before[1], folder=None, recorded={})
    for mrad in (3.0, 0.0):  # corrected twice: the second time it is a table's place that is taken
        rows = exported.sensors[2].conditions
        poses = replace(rows, f_g=rows.f_g + mrad * 1e-3, w_deg_per_hr=rows.w_deg_per_hr + 0.1)
        table = replace(exported, sensors={**exported.sensors, 2: replace(exported.sensors[2], conditions=poses)})
        taken = take_up(folder, write_campaign(table, tmp_path / f"{mrad}"))
        facts, _, configuration = read_entry(folder, taken.entry)
        assert "whose labels or poses were others" in taken.replaces
        assert facts == {**before[0], "from": str(tmp_path / f"{mrad}"), "sha256": facts["sha256"]}
        assert configuration == before[2]
        assert take_up(folder, night).before
    other = tmp_path / "the table first"
    first = read_entry(other, take_up(other, tmp_path / "3.0").entry)
    linked = take_up(other, night)
    facts, kept, configuration = read_entry(other, linked.entry)
    assert "which did not say of which night it is" in linked.replaces
    assert (first[0]["night"], facts["night"]["id"]) == (None, before[0]["night"]["id"])
    assert configuration == before[2]
    assert np.array_equal(kept.sensors[2].conditions.f_g, first[1].sensors[2].conditions.f_g)  # as corrected
    assert take_up(other, night).before
    assert len(found(other)[0]) == 1


def test_an_archive_that_lost_its_mark_is_founded_again(
    copy: Path, measured: Campaign, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Over the same folders, and nothing is lost; not over a folder of something else."""
    before = sorted(copy.rglob("*"))
    (copy / MARK).unlink()
    more = write_campaign(of_life(measured, 1, serial="0043"), tmp_path / "more")
    for command in (["units", "--archive", str(copy)], ["archive", str(copy)], ["archive", str(copy), str(more)]):
        assert hil(command) == 2
        assert f"its archive.yaml is lost; hil archive {copy} --found founds it again" in capsys.readouterr().err
    assert hil(["archive", str(copy), "--found"]) == 0
    assert sorted(copy.rglob("*")) == before
    assert hil(["history", "0042", "--archive", str(copy)]) == 0
    assert hil(["archive", str(tmp_path), "--found"]) == 2
    assert hil(["archive", str(tmp_path / "new"), "--found"]) == 0


def test_nobody_begins_a_night_whose_archive_takes_nothing(
    copy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not there, none, or not to be written: check says it, and run does not begin."""
    bench = tmp_path / "bench.yaml"
    for archive, why in ((tmp_path / "none", "there is no such folder"), (tmp_path, "is no archive"), (copy, "")):
        bench.write_text(f"{load_bench('simulated').text}\narchive: {archive}\n")
        assert hil(["check", str(bench)]) == (3 if why else 0)
        assert ("NOT  archive: " in (said := capsys.readouterr().out)) == bool(why)
        assert why in said
    monkeypatch.setattr("os.access", lambda path, _mode: Path(path) != copy)
    assert hil(["run", "quick", "--bench", str(bench), "--out", str(tmp_path / "night")]) == 3
    assert f"NOT  archive: {copy}: cannot be written" in capsys.readouterr().err
    assert not (tmp_path / "night").exists()


@pytest.mark.slow
def test_a_file_that_cannot_be_written_is_told_by_its_name(
    archive: Path,
    night: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Not by the name that it has while it is written; as for every file that somebody asks for."""
    write = RealDisk.write

    def full(disk: RealDisk, path: Path, data: bytes) -> None:
        if path.is_relative_to(tmp_path):
            raise OSError(errno.EROFS, "Read-only file system", str(path))
        write(disk, path, data)  # a bench that is looked at is laid out elsewhere

    monkeypatch.setattr(RealDisk, "write", full)
    for command in (
        ("units", "--archive", str(archive), "--csv", str(tmp_path / "a.csv")),
        ("history", "0042", "--archive", str(archive), "--csv", str(tmp_path / "a.csv")),
        ("history", "0042", "--archive", str(archive), "--page", str(tmp_path / "a.html")),
        ("certificate", str(night), "--draft", "--out", str(tmp_path / "a.html")),
        ("report", str(night), "--out", str(tmp_path / "a.html")),
    ):
        assert hil(command) == 2
        assert f"hil: {command[-1]}: cannot be written: Read-only file system\n" in capsys.readouterr().err


def test_two_units_with_one_serial_are_told_apart(
    copy: Path, measured: Campaign, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """By their model, and where the very same rates are said to be of both."""
    other = write_campaign(of_life(measured, 2, model="STIM300"), tmp_path / "other")
    take_up(copy, other)
    update(copy)
    with opened_index(copy) as index:
        with pytest.raises(InputError, match="two units have this serial number: MFS-IMU, STIM300"):
            history(index, "0042")
        assert sum(each["used"] for each in history(index, "0042", "MFS-IMU")["campaigns"]) == COUNT
        assert [each["remark"] for each in index.units()] == 2 * ["two units have this serial number"]


@pytest.mark.slow
def test_a_night_that_was_carried_on_is_one_calibration(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What it was before stands beside it in the archive; units and history count it once, with what has most."""
    with closing(sqlite3.connect(copy / INDEX_NAME)) as index, index:
        index.execute("UPDATE entries SET night = 'one' WHERE name IN (SELECT name FROM entries ORDER BY name LIMIT 2)")
        index.execute("UPDATE entries SET verdict = 'FAIL', good = 0 WHERE night = 'one'")
    assert hil(["units", "--archive", str(copy), "--json"]) == 0
    assert [each["campaigns"] for each in json.loads(capsys.readouterr().out)["units"]] == [COUNT - 1]
    assert hil(["history", "0042", "--archive", str(copy)]) == 0
    told = f"unit 0042 MFS-IMU: {COUNT - 1} calibrations ({COUNT - 2} good enough to tell anything), "
    assert told in capsys.readouterr().out


def test_rates_whose_labels_were_corrected_take_the_place_of_what_they_were(
    copy: Path, measured: Campaign, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """They are another calibration of the same rates: with the labels exchanged the unit had FAILed for good."""
    one = of_life(measured, 21)
    order = np.arange(len(one.sensors[2]))
    order[[0, 1]] = [1, 0]
    rows = one.sensors[2].conditions
    turned = {"position": rows.position[order], "f_g": rows.f_g[order], "w_deg_per_hr": rows.w_deg_per_hr[order]}
    exchanged = replace(one, sensors={**one.sensors, 2: replace(one.sensors[2], conditions=replace(rows, **turned))})
    wrong, right = (write_campaign(each, tmp_path / name) for each, name in ((exchanged, "wrong"), (one, "right")))
    assert hil(["archive", str(copy), str(wrong)]) == 0
    assert hil(["archive", str(copy), str(right)]) == 0
    assert ", whose labels or poses were others" in capsys.readouterr().out
    taken = take_up(copy, right)
    assert taken.before
    assert read_entry(copy, taken.entry)[1].sensors[2].conditions.position.tolist() == rows.position.tolist()
    assert len(found(copy)[0]) == COUNT + 1


def test_nothing_is_taken_up_twice_or_from_what_does_not_say_enough(
    copy: Path, campaigns: list[Path], measured: Campaign, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The very same rates are known by them; no serial, no date, a contradiction, no archive: status 2, no change."""
    before = sorted(copy.rglob("*"))
    assert hil(["archive", str(copy), str(campaigns[0])]) == 0
    assert "was there before, with the very same rates: nothing was added" in capsys.readouterr().out
    bare = write_campaign(replace(of_life(measured, 20), identity={}, source=""), tmp_path / "bare")
    for asked, why in (
        (["--date", "2026-03-01"], "--serial"),
        (["--serial", "0043"], "--date"),
        (["--serial", "0043", "--date", "soon"], "is no date"),
    ):
        assert hil(["archive", str(copy), str(bare), *asked]) == 2
        assert why in capsys.readouterr().err
    assert hil(["archive", str(copy), str(campaigns[0]), "--serial", "0043"]) == 2
    assert hil(["archive", str(tmp_path), str(campaigns[0])]) == 2
    assert hil(["archive", str(copy), str(tmp_path / "none"), str(campaigns[1])]) == 4
    assert hil(["units"]) == 2
    assert hil(["history", "0044", "--archive", str(copy)]) == 2
    assert sorted(copy.rglob("*")) == before
    assert hil(["archive", str(copy), str(bare), "--serial", "a/../b", "--date", "2026-03-01"]) == 0
    assert len(found(copy, "a/../b")[0]) == 1


@pytest.mark.slow
def test_a_night_is_taken_up_at_its_end_and_outlived_by_what_was_averaged(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Where its bench names an archive; moved away, it is told; what the bench file says now is told from then."""
    text = load_bench("simulated").text
    for number in range(2):
        bench = parse_bench(
            f"{text}\narchive: {tmp_path / 'archive'}\ntitle: bench {number}\n".replace(
                "title: Simulated bench, unit and chamber in process\n", ""
            ),
            "bench.yaml",
        )
        assert start_night(tmp_path / f"night-{number}", TWO, bench, who="rk", seed=number).exit_status == 0
    with open_readonly(tmp_path / "night-1") as journal:
        assert [each.kind for each in journal.events()].count("archived") == 1
    shutil.move(tmp_path / "night-0", tmp_path / "elsewhere")
    assert hil(["history", "SIM-0001", "--archive", str(tmp_path / "archive")]) == 0
    out = capsys.readouterr()
    assert "what it was taken up from is not at" in out.err
    assert "were measured at the same time: clocks of simulated nights begin alike" in out.err
    assert "SIMULATED" in out.out
    assert "bench.title: bench 0 → bench 1" in out.out
    facts, campaign, _ = read_entry(tmp_path / "archive", found(tmp_path / "archive")[0][0])
    assert facts["state"] == "complete"
    assert campaign.simulated
    bench = parse_bench(f"{text}\narchive: {tmp_path}\n", "bench.yaml")
    assert start_night(tmp_path / "night-2", TWO, bench, who="rk", seed=5).exit_status == 0
    with open_readonly(tmp_path / "night-2") as journal:
        assert [each.kind for each in journal.events()].count("not-archived") == 1
