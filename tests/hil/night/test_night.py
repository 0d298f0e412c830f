"""A whole night through the production path on the simulated bench: begun, cut off, carried on, exported."""

from __future__ import annotations

import errno
import json
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hil.campaign.reader import read_campaign
from hil.config import load_bench, parse_bench, parse_sweep
from hil.errors import InputError
from hil.files.durable import PARTIAL, RealDisk
from hil.night import resume_night, start_night
from hil.records import open_readonly
from hil.records.blocks import SAMPLES, read_samples
from hil.records.export import campaign_of_night, export_campaign
from hil.records.status import night_status
from hil.records.verify import verify_night
from hil.report.night import night_content
from procedures.journal_protocol import Outcome
from procedures.stop import StopRequest
from tests.hil.short_sweeps import short_sweep

SWEEP = short_sweep(self_calibrations=2)
SHORT = parse_sweep(SWEEP, "short.yaml")


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A complete night; a test that changes it works on a copy."""
    folder = tmp_path_factory.mktemp("finished") / "night"
    outcome = start_night(folder, SHORT, load_bench("simulated"), who="rk")
    assert (outcome.state, outcome.exit_status) == ("complete", 0)
    return folder


def test_a_night_is_complete_and_sound(finished: Path) -> None:
    """Every step done, every block right, who and with what in the record."""
    assert verify_night(finished)["problems"] == []
    assert night_status(finished)["state"] == "complete"
    with open_readonly(finished) as journal:
        assert (journal.night.who, journal.night.seed, journal.night.simulated) == ("rk", 861, True)
        assert set(journal.night.versions or {}) >= {"hil", "numpy", "python", "sqlite"}
        assert "temperatures: [" in SWEEP
        assert "A short night" in journal.night.configuration
        samples = [row.block for row in journal.blocks() if row.block.kind == SAMPLES]
    assert len(samples) == 4
    assert all(read_samples(finished, block).simulated for block in samples)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_samples_and_another_seed_others(finished: Path, tmp_path: Path) -> None:
    """A simulated night is reproducible to the byte, and the seed that was used is in the record."""

    def hashes(folder: Path) -> list[str]:
        with open_readonly(folder) as journal:
            return [row.block.sha256 for row in journal.blocks()]

    start_night(tmp_path / "same", SHORT, load_bench("simulated"))
    start_night(tmp_path / "other", SHORT, load_bench("simulated"), seed=5)
    assert hashes(tmp_path / "same") == hashes(finished)
    assert not set(hashes(tmp_path / "other")) & set(hashes(finished))
    with open_readonly(tmp_path / "other") as journal:
        assert journal.night.seed == 5


def test_the_log_says_who_moved_what_and_when(finished: Path) -> None:
    """One JSON object per line; each setpoint, move and safe state is in it."""
    lines = [json.loads(line) for line in (finished / "log.jsonl").read_text().splitlines()]
    assert all(line["who"] == "rk" and line["utc"] for line in lines)
    said = [line["event"] for line in lines]
    assert said.count("positioner: move") == 4
    assert {"chamber: prepare", "chamber: set temperature", "chamber: safe state", "night ends"} <= set(said)


@pytest.mark.parametrize("content", ["a file", "a night", "a text file"])
def test_an_existing_folder_is_never_written_into(finished: Path, tmp_path: Path, content: str) -> None:
    """A folder that holds anything is refused in one sentence."""
    target = tmp_path / "night"
    if content == "a night":
        shutil.copytree(finished, target)
    elif content == "a file":
        target.mkdir()
        (target / "notes.txt").write_text("mine")
    else:
        target.write_text("mine")
    with pytest.raises(InputError, match=r"holds a night already|is not empty"):
        start_night(target, SHORT, load_bench("simulated"))


def test_bad_input_leaves_nothing_behind(tmp_path: Path) -> None:
    """A temperature outside the limits, a port that does not exist, a seed for a real bench, a place that is a file."""
    bench = load_bench("simulated")
    (tmp_path / "file").write_text("")
    hot = parse_sweep(SWEEP.replace("23 degC", "200 degC"), "hot.yaml")
    text = bench.text.replace("port: sim://imu", "port: /dev/no-such-port").replace("clock: virtual", "clock: system")
    no_port = parse_bench(text, bench.source)
    for target, sweep, where, words in (
        (tmp_path / "a" / "b", hot, bench, "outside the limits"),
        (tmp_path / "a" / "b", SHORT, no_port, "there is no such port"),
        (tmp_path / "file" / "b", SHORT, bench, "is not a folder"),
    ):
        with pytest.raises(InputError, match=words):
            start_night(target, sweep, where)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_an_empty_folder_may_be_used(tmp_path: Path) -> None:
    """A folder that somebody made for it; a stop at once is an aborted night with its whole plan."""
    stop = StopRequest()
    stop.request("rk changed their mind")
    (tmp_path / "night").mkdir()
    outcome = start_night(tmp_path / "night", SHORT, load_bench("simulated"), stop=stop)
    assert (outcome.state, outcome.reason, outcome.exit_status) == ("aborted", "rk changed their mind", 1)
    assert night_status(tmp_path / "night")["state"] == "aborted"
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(PARTIAL)]


@pytest.mark.slow
def test_a_full_disk_ends_a_night_safely_and_it_can_be_carried_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second collect finds no space: the chamber is made safe, the first stays, and later nothing is missing."""
    write, written = RealDisk.write, []

    def full(self: RealDisk, path: Path, data: bytes) -> None:
        if path.suffix == ".zst":
            written.append(path)
        if len(written) == 2:
            raise OSError(errno.ENOSPC, "No space left on device")
        write(self, path, data)

    folder = tmp_path / "night"
    with monkeypatch.context() as patched:
        patched.setattr(RealDisk, "write", full)
        outcome = start_night(folder, SHORT, load_bench("simulated"))
    assert (outcome.state, outcome.exit_status) == ("failed", 1)
    assert "No space left" in outcome.reason
    assert "NOT SAFE" not in outcome.reason
    assert [problem for problem in verify_night(folder)["problems"] if "missing: " not in problem] == []
    rows, notes = export_campaign(folder, tmp_path / "campaign")  # a partial night exports what it has, and says so
    assert rows == 2
    assert any("not complete; missing: self-calibration 1" in note for note in notes)
    assert read_campaign(tmp_path / "campaign").missing[0].startswith("self-calibration 1")
    assert resume_night(folder).state == "complete"
    assert verify_night(folder)["problems"] == []


# Is killed in the middle of the collect at position 3 of the first self-calibration.
_CHILD = """
import os, signal, sys
from hil.config import load_bench, parse_sweep
from hil.records.journal import SqliteJournal
from hil.night import start_night

begin = SqliteJournal.begin

def killed(journal, step):
    attempt = begin(journal, step)
    if step.kind == "collect" and len(journal.completed()) >= 6:
        os.kill(os.getpid(), signal.SIGKILL)
    return attempt

SqliteJournal.begin = killed
start_night(sys.argv[1], parse_sweep(sys.argv[2], "short.yaml"), load_bench("simulated"), who="child")
"""


@pytest.mark.slow
def test_a_night_whose_controller_was_killed_is_carried_on(finished: Path, tmp_path: Path) -> None:
    """After SIGKILL what was done stays, the cut-off attempt is redone, time has passed, and the rates are the same."""
    folder = tmp_path / "night"
    child = subprocess.run([sys.executable, "-c", _CHILD, str(folder), SWEEP], check=False)
    assert child.returncode == -signal.SIGKILL
    before = night_status(folder)
    assert before["state"] == "incomplete"
    assert before["reason"] == "the controller was killed, or lost its power"
    with open_readonly(folder) as journal:
        done, blocks = journal.completed(), journal.blocks()
    outcome = resume_night(folder, who="morning shift")
    assert (outcome.state, outcome.exit_status) == ("complete", 0)
    assert verify_night(folder)["problems"] == []
    with open_readonly(folder) as journal:
        after = journal.completed()
        assert {key: after[key] for key in done} == done
        assert journal.blocks()[: len(blocks)] == blocks
        kinds = [event.kind for event in journal.events()]
        assert kinds[:3] == ["night-begins", "lock_taken_over", "night-resumed"]
        resumed = next(event for event in journal.events() if event.kind == "night-resumed")
        assert resumed.message.startswith("morning shift carried on")
        assert resumed.evidence["down_s"] == pytest.approx(1800.0, abs=1.0)
        starts = [after[step.key].data["start_s"] for step in journal.plan.steps if step.kind == "collect"]
        assert starts == sorted(starts)
        attempts = [each for each in journal.attempts() if each.outcome is Outcome.DONE]
        assert len({each.step_key for each in attempts}) == len(attempts)
    with open_readonly(finished) as journal:
        undisturbed = journal.completed()
    for key in (step for step in after if "collect" in step):
        rates, expected = (each[key].data["sensors"]["2"]["rates"] for each in (after, undisturbed))
        for channel, rate in rates.items():
            difference = rate["mean_deg_per_hr"] - expected[channel]["mean_deg_per_hr"]
            assert abs(difference) < 4.0 * np.hypot(rate["se_deg_per_hr"], expected[channel]["se_deg_per_hr"])


@pytest.mark.slow
def test_a_resume_uses_the_configuration_of_the_beginning(tmp_path: Path) -> None:
    """The bench file may be edited or lost meanwhile; the copies in the folder too."""
    bench_file = tmp_path / "my-bench.yaml"
    bench_file.write_text(load_bench("simulated").text.replace("name: simulated", "name: mine"))
    stop = StopRequest()
    stop.request("later")
    folder = tmp_path / "night"
    start_night(folder, SHORT, load_bench(bench_file), seed=99, stop=stop)
    bench_file.unlink()
    shutil.rmtree(folder / "configuration")
    assert resume_night(folder).state == "complete"
    assert campaign_of_night(folder).source.startswith("recorded by hil on bench mine")


def test_resuming_a_complete_night_changes_nothing(finished: Path) -> None:
    """There is nothing to do, and nothing is done."""
    before = {path: path.stat().st_mtime_ns for path in finished.rglob("*") if path.suffix != ".sqlite-shm"}
    assert resume_night(finished).state == "complete"
    assert {path: path.stat().st_mtime_ns for path in finished.rglob("*") if path in before} == before


def test_an_exported_night_reads_back_as_it_was_recorded(finished: Path, tmp_path: Path) -> None:
    """Rows, numbers, series: what `hil solve` reads is what the journal holds."""
    rows, _ = export_campaign(finished, tmp_path / "campaign")
    campaign = read_campaign(tmp_path / "campaign")
    assert campaign.simulated
    assert list(campaign.warnings) == []
    assert campaign.notes.startswith("SIMULATED: these are no measurements.")
    assert rows == 8
    numbers = sorted(int(n) for rows in campaign.sensors.values() for n in rows.conditions.collect)
    assert numbers == list(range(1, 9))
    bench = load_bench("simulated")
    with open_readonly(finished) as journal:
        collects = [step for step in journal.plan.steps if step.kind == "collect"]
        completed = journal.completed()
        blocks = {row.step_key: row.block for row in journal.blocks() if row.block.kind == SAMPLES}
    for number, rows in campaign.sensors.items():
        for i, step in enumerate(collects):
            data = completed[step.key].data
            record = data["sensors"][str(number)]
            conditions = rows.conditions
            assert conditions.run[i] == step.self_calibration
            assert conditions.start_s[i] == data["start_s"]
            assert rows.rates_deg_per_hr[i, 1] == record["rates"]["RB"]["mean_deg_per_hr"]
            assert rows.rates_se_deg_per_hr[i, 0] == record["rates"]["RA"]["se_deg_per_hr"]
            assert conditions.columns["temperature_degC"][i] == record["temperature_degC"]
            assert conditions.columns["supply_V"][i] == data["conditions"]["supply_V"]
            assert conditions.columns["spin_period_us"][i] == record["conditions"]["spin_period_us"]
            assert conditions.columns["time_since_index_s"][i] == data["time_since_index_s"]
            orientation = bench.sensors[number].built[step.position or ""]
            np.testing.assert_array_equal(conditions.f_g[i], orientation.components(bench.site.gravity_g()))
            series = campaign.series(int(conditions.collect[i]))
            assert series is not None
            samples = read_samples(finished, blocks[step.key])
            assert len(series.t_s) == pytest.approx(20, abs=1)
            assert 0.0 <= series.t_s[0] < 1.0
            t_s = samples.time_s - data["start_s"]
            sixth = samples.of("rate", number)["RA"][(t_s > 5.0 - 1e-3) & (t_s < 6.0 - 1e-3)]
            (row,) = np.flatnonzero(np.floor(series.t_s) == 5.0)
            assert len(sixth) == 20
            assert series.rates_deg_per_hr[row, 0] == pytest.approx(float(np.mean(sixth)), rel=1e-12)


def test_the_report_s_own_orientation_is_what_is_exported(finished: Path) -> None:
    """Position 1 of sensor 2: (f_A, f_B, f_S) = (-G1, G2, G3) and the same for the earth rate."""
    site = load_bench("simulated").site
    first = campaign_of_night(finished).sensors[2].conditions
    assert first.position[0] == "1"
    np.testing.assert_allclose(first.f_g[0], site.gravity_g() * [-1.0, 1.0, 1.0], atol=1e-15)
    np.testing.assert_allclose(first.w_deg_per_hr[0], site.earth_rate_deg_per_hr() * [-1.0, 1.0, 1.0], atol=1e-15)


def test_a_night_without_a_collect_is_not_exported(tmp_path: Path) -> None:
    """There is nothing to export, and no folder is made."""
    stop = StopRequest()
    stop.request("at once")
    start_night(tmp_path / "none", SHORT, load_bench("simulated"), stop=stop)
    with pytest.raises(InputError, match="no collect of this night was completed"):
        export_campaign(tmp_path / "none", tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_sensor_that_the_bench_does_not_orient_is_not_exported(tmp_path: Path) -> None:
    """The unit streams two sensors; a bench file that knows one gives a campaign of one."""
    text = load_bench("simulated").text
    one = text[: text.index("  1:\n")] + text[text.index("imu:\n") :]
    start_night(tmp_path / "night", SHORT, parse_bench(one, "one.yaml"))
    assert list(campaign_of_night(tmp_path / "night").sensors) == [2]


def test_an_alarm_ends_a_night_with_status_three_and_the_chamber_safe(tmp_path: Path) -> None:
    """An interlock is a failed night: its reason is in the status, the safe state in the log."""
    text = load_bench("simulated").text
    alarmed = text.replace("simulation:\n", "simulation:\n  chamber_faults: [{kind: alarm, begins: 5 min}]\n")
    outcome = start_night(tmp_path / "night", SHORT, parse_bench(alarmed, "alarmed.yaml"))
    assert (outcome.state, outcome.exit_status) == ("failed", 3)
    status = night_status(tmp_path / "night")
    assert status["state"] == "failed"
    assert "alarm" in status["reason"]
    assert '"chamber: safe state"' in (tmp_path / "night" / "log.jsonl").read_text()


def test_a_night_that_wears_its_chamber_out_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A setpoint that was written too often is among the night's events, for the report; a plain night has none."""
    monkeypatch.setattr("drivers.chambers.guards._WORTH_SAYING_NIGHTS", 1e9)
    start_night(tmp_path / "worn", SHORT, load_bench("simulated"))
    kinds = [(kind, message) for _, kind, message in night_content(tmp_path / "worn").events]
    assert [message for kind, message in kinds if kind == "wear" and "is worn out in" in message]


def test_a_plain_night_wears_nothing_out(finished: Path) -> None:
    """Two setpoints are nothing."""
    assert "wear" not in [kind for _, kind, _ in night_content(finished).events]


def test_an_export_never_overwrites(finished: Path, tmp_path: Path) -> None:
    """A folder with anything in it is refused; an empty one is used."""
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "x").write_text("mine")
    with pytest.raises(InputError, match="is not empty"):
        export_campaign(finished, tmp_path / "full")
    assert [path.name for path in (tmp_path / "full").iterdir()] == ["x"]
    (tmp_path / "empty").mkdir()
    assert export_campaign(finished, tmp_path / "empty")[0] == 8


def test_an_export_of_damaged_samples_leaves_no_half_made_folder(finished: Path, tmp_path: Path) -> None:
    """A block that is not what was written ends the export, and nothing stands in its place."""
    copy = tmp_path / "night"
    shutil.copytree(finished, copy)
    last = sorted((copy / "blocks").glob("*.parquet"))[-1]
    last.write_bytes(last.read_bytes()[:-1])
    with pytest.raises(InputError, match="were written"):
        export_campaign(copy, tmp_path / "out")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["night"]


@pytest.mark.parametrize("damage", ["lost", "changed"])
def test_a_resume_does_a_self_calibration_again_whose_samples_are_damaged(
    finished: Path, tmp_path: Path, damage: str
) -> None:
    """All of it, soak included, because its collects count as simultaneous; the other stands, byte for byte."""
    folder = tmp_path / "night"
    shutil.copytree(finished, folder)
    with open_readonly(folder) as journal:
        samples = {row.step_key: folder / row.block.path for row in journal.blocks() if row.block.kind == SAMPLES}
        before = journal.completed()
    victim = samples["T1/S1/C2/collect"]
    if damage == "lost":
        victim.unlink()
    else:
        victim.write_bytes(victim.read_bytes()[:-1] + b"x")
    others = {key: path.read_bytes() for key, path in samples.items() if "S2" in key}
    outcome = resume_night(folder)
    assert (outcome.state, outcome.exit_status) == ("complete", 0)
    with open_readonly(folder) as journal:
        after = journal.completed()
        (event,) = [event for event in journal.events() if event.kind == "damage"]
        soaks = [each.outcome for each in journal.attempts() if each.step_key == "T1/S1/restabilise"]
    assert soaks == [Outcome.FAILED, Outcome.DONE]
    assert after["T1/S1/C1/collect"].data["start_s"] > before["T1/S1/C1/collect"].data["start_s"]
    assert {key: after[key] for key in after if "S2" in key} == {key: before[key] for key in before if "S2" in key}
    assert {key: path.read_bytes() for key, path in samples.items() if "S2" in key} == others
    assert "self-calibration 1 is done again as a whole" in event.message
    assert victim.name in event.message
    assert any(kind == "damage" for _, kind, _ in night_content(folder).events)  # and the report says so
    document = verify_night(folder)
    assert document["complete"], document["problems"]
    assert any(victim.name in note for note in document["notes"])
    assert len(list(campaign_of_night(folder).sensors)) == 2
