"""Several units in one chamber, one night: recorded together, solved, exported and told of each by itself."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.campaign.reader import read_campaign
from hil.cli.app import run as cli
from hil.config import Bench, load_bench, parse_bench, parse_sweep
from hil.dashboard.watcher import Watcher
from hil.errors import InputError
from hil.files.strict import find_config
from hil.night import resume_night, start_night
from hil.night.replay import replay_night
from hil.records import JournalReader, reading
from hil.records.documents import export_documents
from hil.records.export import campaign_of_night, export_campaign
from hil.records.reader import proven_once, units_in
from hil.records.status import night_status
from hil.records.verify import verify_night
from tests.hil.short_sweeps import short_sweep
from tests.hil.twin.truth import truth_of

UNITS = ("0041", "0042", "0043")
SHORT = parse_sweep(short_sweep(), "short.yaml")
_ONE = load_bench("simulated")


def _bench(units: str = "", faults: str = "", source: str = _ONE.source) -> Bench:
    """Return the simulated bench with a list of units in the place of its one."""
    listed = units or "".join(f'  - {{model: MFS-IMU, serial: "{each}", port: "sim://imu"}}\n' for each in UNITS)
    text = re.sub(r"^unit: .*$", f"units:\n{listed}", _ONE.text, flags=re.M)
    return parse_bench(f"{text}\nfaults:\n{faults}" if faults else text, source)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A night of three units that was complete for two: the other fell silent in its second collect."""
    folder = tmp_path_factory.mktemp("units") / "night"
    silent = '  - {at: T1/S1/C2/collect, device: imu, unit: "0042", kind: silence}'
    ended = start_night(folder, SHORT, _bench(faults=silent), who="rk")
    assert (ended.state, ended.exit_status) == ("incomplete", 9)
    assert ended.reason.startswith("complete for 2 of 3 units; set aside: 0042 (stream-lost")
    return folder


def test_a_night_says_how_each_unit_stands(finished: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One line for each; what is missing is missing of the unit that was set aside, and of nothing else."""
    status = night_status(finished)
    cli(["status", str(finished)])
    assert "steps, 0 of 1 self-calibrations are whole in every unit\n" in capsys.readouterr().out
    told = {
        each["unit"]: (each["state"], each["set_aside"], each["self_calibrations_done"]) for each in status["units"]
    }
    assert told == {"0041": ("complete", False, 1), "0042": ("incomplete", True, 0), "0043": ("complete", False, 1)}
    assert "no good frame" in status["units"][1]["reason"]
    assert status["missing"]
    assert all("unit 0042: " in each for each in status["missing"])
    assert {each.partition(": ")[0] for each in verify_night(finished)["problems"]} == {"missing"}
    assert replay_night(finished)["identical"]


def test_a_unit_is_asked_for_by_its_folder(finished: Path) -> None:
    """It is a night of its own to whoever reads: its plan, its verdict, its serial number, its temperatures."""
    own = night_status(finished / "units" / "0041")
    assert (own["state"], own["identity"]["serial"]) == ("complete", "0041")
    own = verify_night(finished / "units" / "0041")
    assert (own["complete"], own["notes"]) == (True, [])  # the other units' blocks are no orphans
    with reading(finished / "units" / "0041") as journal:
        beat = journal.last_heartbeat()
        assert beat is not None
        assert {"unit_1_degC", "unit_2_degC", "chamber_degC"} <= set(beat.readings)
        assert not [name for name in beat.readings if "0043" in name]
    assert "set aside at 1985-" in night_status(finished / "units" / "0042")["reason"]
    with pytest.raises(InputError, match=r"there is no unit 0099 in this night; name one by its folder: .*0041, 0042"):
        night_status(finished / "units" / "0099")
    with pytest.raises(InputError, match="a night of several units; name one by its folder"):
        campaign_of_night(finished)
    with pytest.raises(InputError, match=r"is not carried on by itself; hil resume .*night carries on with all"):
        resume_night(finished / "units" / "0042")
    assert not (finished / "units" / "0042" / "controller.lock").exists()


def test_the_live_page_proves_the_journal_once_for_all_units(finished: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """At the first look; at the next, where nothing was recorded, not at all; and it sees what the others see."""
    proofs = []
    prove = JournalReader.damage
    monkeypatch.setattr(JournalReader, "damage", lambda own, *how: proofs.append(own.unit) or prove(own, *how))
    watcher = Watcher(finished)
    for left in finished.glob("journal.sqlite-*"):  # as nobody has read it yet
        left.unlink()
    heads = {name: parts["head"] for name, parts in watcher.look().items()}
    assert proofs == [""]
    assert not watcher.look()
    assert proofs == [""]
    assert {name: head["state"] for name, head in heads.items() if "units" in name} == {
        f"units/{each['unit']}": each["state"] for each in night_status(finished)["units"]
    }
    with proven_once(finished), reading(finished) as whole, reading(finished / "units" / "0041") as own:
        assert (whole.unit, own.unit) == ("", "0041")
        assert len(own.plan.steps) < len(whole.plan.steps)
        with reading(finished) as again:
            assert len(again.completed()) == len(whole.completed())


def test_what_is_wrong_with_a_listed_unit_is_told_with_unit_and_key() -> None:
    """Where it stands in its entry; what is wrong for all of them is told where that stands."""
    for entry, why in (
        ("port: 3", "units.1.port: 3 is not a port"),
        ('port: "sim://imu", rate: fast', "units.1.rate: 'fast' is not a frequency"),
        ('port: "sim://imu", simulation: {sed: 3}', "units.1.simulation: unknown key 'sed'; did you mean 'seed'"),
        ('port: "sim://imu", simulation: 3', "units.1.simulation: must be a mapping"),
        ('port: "sim://imu", sensors: {1: {}}', "units.1.sensors.1.axes: this key is missing"),
    ):
        listed = f'  - {{model: A, serial: "0041", port: "sim://imu"}}\n  - {{model: A, serial: "0042", {entry}}}\n'
        with pytest.raises(InputError, match=re.escape(f"bench.yaml: {why}")):
            _bench(listed, source="bench.yaml")
    text = load_bench("simulated").text.replace("latitude:", "latitud:")
    listed = re.sub(r"^unit: .*$", 'units: [{model: A, serial: "0041", port: "sim://imu"}]', text, flags=re.M)
    with pytest.raises(InputError, match=r"bench.yaml: site: unknown key 'latitud'"):
        parse_bench(listed, "bench.yaml")


def test_a_name_that_a_simulated_unit_cannot_say_is_told_before_anything(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its frame has room for so many characters: file, key and how many; no night is begun."""
    bench = tmp_path / "bench.yaml"
    for key, given in (("serial", "serial: SN-00420042004200"), ("model", "model: MFS-IMU-of-long-name")):
        bench.write_text(re.sub(rf"{key}: [\w-]+", given, _ONE.text, count=1))
        assert cli(["run", "quick", "--bench", str(bench), "--out", str(tmp_path / "night")]) == 2
        said = capsys.readouterr().err
        assert f"{bench}: unit.{key}: '{given.split()[1]}'" in said
        assert "has room for 16 characters" in said
    assert not (tmp_path / "night").exists()


@pytest.mark.slow
def test_a_damaged_unit_has_no_report_and_the_others_have_theirs(
    finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Told on the page over all of them and by the exit status; folders of units that were deleted come back.

    It is not complete, whether it is asked for by itself or as one of the night's.
    """
    night = Path(shutil.copytree(finished, tmp_path / "night"))
    with reading(night / "units" / "0041") as journal:
        block = next(row.block for row in journal.blocks() if row.block.kind == "samples")
    (night / block.path).write_bytes(b"")
    own, (one, *_) = night_status(night / "units" / "0041"), night_status(night)["units"]
    assert (one["state"], one["reason"]) == (own["state"], own["reason"])
    assert (one["state"], one["set_aside"], one["self_calibrations_done"]) == ("incomplete", False, 1)
    shutil.rmtree(night / "units")
    assert cli(["report", str(night)]) == 4
    out = capsys.readouterr()
    assert f"ERROR: {night}" in out.err
    assert sorted(str(path.relative_to(night)) for path in night.rglob("report.html")) == [
        "report.html",
        "units/0042/report.html",
        "units/0043/report.html",
    ]
    page = (night / "report.html").read_text()
    assert 'href="units/0043/report.html"' in page
    assert "units/0041/report.html" not in page
    assert "0041" in page
    assert block.path in page
    shutil.rmtree(night / "units")
    assert cli(["certificate", str(night / "units" / "0043"), "--draft"]) == 0
    assert (night / "units" / "0043" / "certificate.html").is_file()
    with pytest.raises(InputError, match="there is no unit 0099"):
        campaign_of_night(night / "units" / "0099")
    assert cli(["report", str(night / "units" / "0099")]) == 2
    assert not (night / "units" / "0099").exists()


@pytest.mark.slow
def test_a_fault_at_a_stage_happens_once_in_a_night(tmp_path: Path) -> None:
    """To all units at once; not again when the night is carried on and another unit comes to that stage first."""
    early = '  - {at: T1/S1/C1/collect, device: imu, unit: "0041", kind: silence, duration: 40 min}\n'
    stage = "  - {at: T1/S1/C2/collect, device: imu, kind: silence, duration: 40 min}"
    night = tmp_path / "night"
    assert start_night(night, SHORT, _bench(faults=early + stage), who="rk").exit_status != 0
    with reading(night) as journal:
        begun = {each.step_key for each in journal.attempts()}
    assert "T1/S1/C2/collect@0041" not in begun  # which begins it for the first time now
    assert "T1/S1/C2/collect@0042" in begun
    ended = resume_night(night, down_s=2.0 * 3600.0)
    assert (ended.state, ended.exit_status) == ("complete", 0)


def test_whoever_takes_nights_takes_each_unit_of_one(finished: Path, tmp_path: Path) -> None:
    """The archive all of them, documents one by its folder; nobody a unit that is not there."""
    assert units_in(finished) == {unit: finished / "units" / unit for unit in UNITS}
    assert units_in(finished / "units" / "0041") == {}
    assert units_in(tmp_path) == {}
    assert cli(["archive", str(tmp_path / "archive"), str(finished)]) == 0
    assert sorted(path.name for path in (tmp_path / "archive").glob("unit-*")) == [f"unit-{unit}" for unit in UNITS]
    documents = tmp_path / "0043.jsonl"
    export_documents(finished / "units" / "0043", documents)
    assert json.loads(documents.read_text().splitlines()[0])[1]["serial"] == "0043"
    with pytest.raises(InputError, match="there is no unit 0099 in this night"):
        campaign_of_night(finished / "units" / "0099")


@pytest.mark.slow
def test_what_one_unit_fails_with_is_in_no_others_record(tmp_path: Path) -> None:
    """Its port is gone while all are turned: no attempt of the others ends with that."""
    gone = '  - {at: T1/S1/C2/index, device: imu, unit: "0042", kind: unplugged}'
    ended = start_night(tmp_path / "night", SHORT, _bench(faults=gone))
    assert ended.reason.startswith("complete for 2 of 3 units; set aside: 0042")
    for unit in ("0041", "0043"):
        with reading(tmp_path / "night" / "units" / unit) as journal:
            assert not [each for each in journal.attempts() if "port is gone" in each.reason]
            assert "ERROR" not in {str(each.outcome) for each in journal.attempts()}


@pytest.mark.slow
def test_each_unit_has_its_campaign(finished: Path, tmp_path: Path) -> None:
    """A folder by serial number; of the unit that was set aside as far as it got, and it says so."""
    export_campaign(finished, tmp_path / "out")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == list(UNITS)
    campaigns = {unit: read_campaign(tmp_path / "out" / unit) for unit in UNITS}
    assert [each.identity["serial"] for each in campaigns.values()] == list(UNITS)
    assert [len(each.sensors[2].conditions) for each in campaigns.values()] == [2, 1, 2]
    assert campaigns["0042"].missing
    assert not campaigns["0041"].missing
    rates = [campaigns[unit].sensors[2].rates_deg_per_hr for unit in ("0041", "0043")]
    assert not np.allclose(rates[0], rates[1], atol=0.1)  # each has its own noise


def test_each_unit_has_its_file_of_another_format(finished: Path, tmp_path: Path) -> None:
    """It is named by serial number and ends as what was asked for."""
    export_campaign(finished, tmp_path / "out.mat", "mat")
    assert sorted(path.name for path in (tmp_path / "out.mat").iterdir()) == [f"{unit}.mat" for unit in UNITS]


@pytest.mark.slow
def test_a_list_of_one_is_the_bench_of_one(tmp_path: Path) -> None:
    """To the digit: the mechanism is the same, only names are written."""
    listed = '  - {model: MFS-IMU, serial: "SIM-0001", port: "sim://imu"}\n'
    ended = [
        start_night(tmp_path / "one", SHORT, _ONE),
        start_night(tmp_path / "listed", SHORT, _bench(listed)),
    ]
    assert [each.exit_status for each in ended] == [0, 0]
    one, of_list = (campaign_of_night(each.folder) for each in ended)
    for number, rows in one.sensors.items():
        assert np.array_equal(rows.rates_deg_per_hr, of_list.sensors[number].rates_deg_per_hr)
        assert np.array_equal(rows.conditions.start_s, of_list.sensors[number].conditions.start_s)


@pytest.mark.slow
def test_each_unit_is_solved_for_its_own_truth(tmp_path: Path) -> None:
    """Units of other coefficients and orientations in one air: nobody's rates end up in another's solution."""
    from hil.solve import solve_campaign

    truth = find_config("models", "rd-gc-86-1-truth").read_text()
    other = tmp_path / "other.yaml"
    other.write_text(truth.replace("polynomial: [-54.0, -0.2]", "polynomial: [-154.0, -0.2]"))
    model = f'simulation: {{model: "{other}", seed: 99}}'
    listed = f"""  - {{model: MFS-IMU, serial: "a", port: "sim://imu"}}
  - {{model: MFS-IMU, serial: "b", port: "sim://imu", rate: 40 Hz, {model}}}
"""
    sweep = parse_sweep(short_sweep().replace("[1, 3]", "[1, 2, 3]"), "short.yaml")
    opened: list[Any] = []
    start_night(tmp_path / "night", sweep, _bench(listed), opened=opened.append)
    assert replay_night(tmp_path / "night")["identical"]
    for unit, gsa in (("a", -54.0), ("b", -154.0)):
        for found in solve_campaign(campaign_of_night(tmp_path / "night" / "units" / unit)):
            true = truth_of(opened[0].simulators.units[unit], 1, found.sensor).parameters
            for name, value in found.parameters.items():
                assert abs(value.value - true[name]) < 6.0 * value.se + 0.5, (unit, found.sensor, name)
            if found.sensor == 1:
                assert found.parameters["GSA"].value == pytest.approx(gsa, abs=10.0)


@pytest.mark.slow
def test_killed_and_resumed_it_is_complete(tmp_path: Path) -> None:
    """SIGKILL in a collect of three units: what had ended stands, each step is done once, every byte is right."""
    killed = "  - {at: T1/S1/C2/collect@0042, device: controller, kind: killed}"
    (tmp_path / "bench.yaml").write_text(_bench(faults=killed).text)
    (tmp_path / "sweep.yaml").write_text(SHORT.text)
    command = [sys.executable, "-m", "hil", "run", "sweep.yaml", "--bench", "bench.yaml", "--out", "night", "--quiet"]
    assert subprocess.run(command, cwd=tmp_path, check=False, capture_output=True).returncode == -9
    assert resume_night(tmp_path / "night").exit_status == 0
    assert verify_night(tmp_path / "night")["problems"] == []
    assert replay_night(tmp_path / "night")["identical"]
    assert [each["state"] for each in night_status(tmp_path / "night")["units"]] == ["complete"] * len(UNITS)


@pytest.mark.parametrize(
    ("listed", "said"),
    [
        (
            '  - {model: A, serial: "1", port: "sim://imu"}\n  - {model: A, serial: 1, port: "sim://imu"}',
            "1 stands there twice",
        ),
        (
            '  - {model: A, serial: "1", port: /dev/x}\n  - {model: A, serial: "2", port: /dev/x}',
            "port of unit 1 already",
        ),
        ("  - {model: A, serial: ask, port: /dev/x}", "units.0.serial: 'ask'"),
        ('  - {model: A, serial: "../1", port: /dev/x}', "each unit of a list has a serial number"),
        ('  - {model: A, serial: "1", prot: /dev/x}', "'prot' is not known here; did you mean 'port'"),
        ("  []", "a list is needed"),
        ('  - {model: A, serial: "1", port: "sim://imu"}\nunit: {model: A, serial: x}', "leave this out, or units"),
        ('  - {model: A, serial: "1", port: tcp://x}', "ports begin with"),
    ],
)
def test_a_list_that_cannot_be_is_refused_in_one_sentence(listed: str, said: str) -> None:
    """It names the entry and the key, and what to do."""
    with pytest.raises(InputError, match=re.escape(said)) as refused:
        _bench(listed)
    assert "\n" not in str(refused.value)


def test_a_fault_of_a_unit_that_is_not_there_is_refused() -> None:
    """As any name that nobody has."""
    with pytest.raises(InputError, match=r"faults.0.unit: there is no unit '0099'"):
        _bench(faults='  - {at: 1 h, device: imu, unit: "0099", kind: silence}')
    with pytest.raises(InputError, match="happens to no unit"):
        _bench(faults='  - {at: 1 h, device: chamber, unit: "0041", kind: silence}')


def test_the_record_of_each_unit_is_one_document(finished: Path) -> None:
    """What a program reads of a night of several: JSON without a surprise."""
    with reading(finished) as journal:
        ends = [event for event in journal.events() if event.kind == "verdict"]
    assert [each.evidence.get("unit", "") for each in ends] == [*UNITS, ""]
    assert ends[-1].evidence["verdict"] == "INCONCLUSIVE"
    assert json.dumps(night_status(finished))
