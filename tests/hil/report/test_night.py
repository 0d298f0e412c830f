"""The report of a night: it says what was asked, done, lost and done again."""

from __future__ import annotations

import csv
import re
import shutil
from html import unescape
from itertools import pairwise
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest

from drivers.clock import VirtualClock
from hil.cli.app import run as hil
from hil.config import load_bench
from hil.night import resume_night, start_night
from hil.records import SqliteJournal
from hil.report.night import night_content
from procedures.stop import StopRequest
from procedures.verdict import Judgement, Verdict
from procedures.words import ranges
from tests.hil.report.report_pages import TWO, Tables, solved

REJECTED = [("self-calibration 4: Collect 3 at 30.0 °C, attempt 1", "failed")]
"""What the stationarity of so short a collect rejects on the simulated bench: always the same, by its seed."""


def test_the_verdict_comes_first_and_says_what_was_asked_done_and_missing(page: str) -> None:
    """In this order: good or not, what to do, the worst margin, what changed, what was done, what was judged."""
    text = " ".join(re.sub(r"<[^>]+>", " ", page[page.index("<main>") :]).split())
    order = (
        "PASS – Measured well: everything that was asked for is there",
        "Nothing has to be done",
        "worst margin drift within a collect",
        "changed since not compared",
        "done 4 of 4 self-calibrations, 12 of 12 collects",
        "Judged is the measurement",
        "hil reconcile",
        "bias of channel A, BA",
        "Sensor 2 ",
        "Asked: 4 self-calibrations at 2 temperatures (20.0, 30.0 °C)",
        "each after at least 10 min of restabilisation",
    )
    places = [text.index(each) for each in order]
    assert places == sorted(places)
    assert re.search(r"done [^.]* 1985-10-01 \d\d:00 [A-Z]+ to ", text)  # with its time zone
    assert "12 collects: 4800 good frames; nothing else came. 4800 of 4800 expected samples" in text


@pytest.mark.slow
def test_only_who_asks_reads_the_published_words(night: Path, page: str) -> None:
    """The vocabulary is the sweep's: a night without it has no contractor, no numbers of equations and tables."""
    from dataclasses import replace

    from hil.records.export import campaign_of_night
    from hil.report.content import gather
    from hil.report.page import render

    content = night_content(night)
    assert content.vocabulary == "rd-gc-86-1"
    plain = render(gather(campaign_of_night(night), replace(content, vocabulary="plain")))
    for word in ("ontractor", "Table 1", "(A-30)", "eq. (", "seven ways"):
        assert word in page
        assert word not in plain
    assert "drift per g along the spin axis, MUA" in plain
    assert 'href="#glossary"' in plain


def test_a_reason_is_said_once(page: str) -> None:
    """Not beside each of the self-calibrations that it holds for."""
    assert page.count("no residual: six equations, six unknowns") == 1
    assert "sensor 2, runs 1–4; sensor 1, runs 1–4: no residual" in page


@pytest.mark.slow
def test_the_report_says_in_which_runs_the_contractors_model_is_contradicted(
    night: Path, page: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """MU taken for zero leaves residuals: the verdicts are those of `hil solve --model collins-4`."""
    found = {s["run"]: s["verdict"] for s in solved(capsys, str(night), "--model", "collins-4") if s["sensor"] == 2}
    failed = [run for run, verdict in found.items() if verdict == "FAIL"]
    assert failed
    said = re.search(r"The contractor.s model, MU = 0: (.*?)</p>", unescape(page))
    assert said is not None
    assert re.search(r"FAIL \(contradicted\) in runs? ([^;.]*)", said[1])[1] == ranges(failed)  # type: ignore[index]


def test_everything_that_is_asked_of_a_report_is_in_it(page: str) -> None:
    """Seven biases, scatter, soaks, stream, rejected data, assumptions, what cannot be known, provenance, hashes."""
    tables = Tables(page).found
    assert len(tables["table-a-1-sensor-2"]) == 1 + 4
    assert [cell[0] for cell in tables["table-a-1-sensor-2"][0][1:8]] == [f"(A-{n})" for n in range(27, 34)]
    assert {"scatter-sensor-1", "scatter-sensor-2", "margins", "soaks", "events", "files"} <= set(tables)
    assert "collects" not in tables  # of which each was good, as a sentence says
    assert [row[5] for row in tables["soaks"][1:]] == [["time"]] * 4
    assert [(row[1][0], row[2][0].partition(":")[0]) for row in tables["rejected"][1:]] == REJECTED
    for heading in ("What was assumed", "What these collects cannot tell", "Provenance", "Words and symbols"):
        assert f"><summary><h2>{heading}</h2></summary>" in page
    assert "configuration, SHA-256" in page


def test_the_files_hashes_are_those_of_the_files(night: Path, page: str) -> None:
    """A reader can hold every block against the page."""
    import hashlib

    rows = Tables(page).found["files"][1:]
    assert len(rows) == 2 * (12 + len(REJECTED))
    for path, size, digest in rows:
        data = (night / path[0]).read_bytes()
        assert (int(size[0]), digest[0]) == (len(data), hashlib.sha256(data).hexdigest())


def test_the_picture_of_the_night_marks_soaks_collects_and_events(page: str) -> None:
    """Told to eyes by a legend, to ears by a sentence."""
    picture = page[page.index('aria-label="Temperatures through') :]
    picture = picture[: picture.index("</svg>")]
    assert "4 soaks, 12 collects" in picture[: picture.index(">")]
    for label in ("setpoint", "chamber", "unit, sensor 1", "restabilising", "collect", "event", "temperature, °C"):
        assert f">{label}</text>" in picture


def test_every_id_of_the_page_is_its_own_and_every_reference_is_met(page: str) -> None:
    """Nine pictures by one library would otherwise share their clip paths."""
    ids = re.findall(r' id="([^"]+)"', page)
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'["(]#([^")]+)', page)) <= set(ids)


def test_headings_are_in_order_and_heads_of_tables_say_what_they_head(page: str) -> None:
    """No level is jumped; every th has its scope, every table its caption, every picture its words."""
    levels = [int(level) for level in re.findall(r"<h(\d)", page)]
    assert levels[0] == 1
    assert all(after - before <= 1 for before, after in pairwise(levels))
    assert len(re.findall("<th ", page)) == len(re.findall('<th scope="(?:col|row)"', page))
    assert "<th>" not in page
    assert page.count("<table ") == page.count("<caption ")
    assert page.count("<svg ") == len(re.findall(r'<svg [^>]*role="img" aria-label="[^"]{20,}"', page))


@pytest.mark.slow
def test_an_interrupted_night_is_not_good_and_says_what_was_done_again(night: Path, tmp_path: Path) -> None:
    """Stopped by a person, carried on later: before, what is missing; after, who, what was discarded and why."""
    folder = tmp_path / "night"
    shutil.copytree(night, folder)
    with SqliteJournal.open(folder, clock=VirtualClock(), who="rk", keep_raw=True) as journal:
        keys = {step.key for step in journal.plan.self_calibrations[4]}
        journal.withdraw(keys, "done again, because samples were damaged: a test")
    assert hil(["report", str(folder)]) == 0
    page = (folder / "report.html").read_text()
    assert "Incomplete: " in page or "Not conclusive" in page
    assert "self-calibration 4 at 30.0 °C" in page[: page.index("<table")]
    assert resume_night(folder, who="ann", stop=StopRequest()).state == "complete"
    assert hil(["report", str(folder)]) == 0
    page = (folder / "report.html").read_text()
    tables = Tables(page).found
    assert any("ann carried on" in " ".join(row[2]) for row in tables["resumes"])
    assert any("samples were damaged: a test" in " ".join(row[2]) for row in tables["rejected"])
    ways = {row[2][0].partition(":")[0] for row in tables["rejected"][1:]}
    assert ways == {"withdrawn", "failed"}
    assert "in 3 parts" in page  # began, withdrawn, carried on
    content = night_content(folder)
    gap = np.flatnonzero(np.isnan(content.temperatures["chamber"]))
    assert len(gap) == 1  # while nobody measured, no line is drawn
    assert content.hours[gap[0]] == pytest.approx(content.hours[gap[0] + 1])


def test_a_night_that_lost_half_of_itself_is_never_called_usable(night: Path, page: str) -> None:
    """However good what is there: how much is missing is the first thing that is said."""
    from dataclasses import replace

    from hil.records.export import campaign_of_night
    from hil.report.content import gather, good, headline

    content = gather(campaign_of_night(night), night_content(night))
    worst = max(content.verdict_counts(), key=lambda verdict: Judgement(verdict, "").severity)
    verdict, said = good(replace(content, night=replace(content.night, state="failed", self_calibrations=(2, 4))))
    assert said.startswith("Failed: 2 of 4 self-calibrations are missing")
    assert verdict == (Verdict.FAIL if worst is Verdict.FAIL else Verdict.INCONCLUSIVE)
    running = replace(content, night=replace(content.night, state="running", reason="", self_calibrations=(2, 4)))
    assert headline(running).endswith(" The night is running.")
    lost = replace(content.night, state="incomplete", self_calibrations=(4, 4), reason="the samples of 2 are lost")
    assert good(replace(content, night=lost))[1].startswith("Incomplete: the samples of 2 are lost;")


@pytest.mark.slow
def test_a_mean_says_which_of_its_runs_must_not_be_relied_upon(night: Path) -> None:
    """Under the number of runs, for each temperature; what FAILed is in no mean, and nothing where all are good."""
    from dataclasses import replace

    from hil.records.export import campaign_of_night
    from hil.report.content import gather
    from hil.report.page import render
    from hil.report.sensor_view import key_numbers, sensor_view

    campaign = campaign_of_night(night)
    passed = Judgement(Verdict.PASS, "")
    for judged, first in (
        (passed, (2, [])),
        (Judgement(Verdict.FAIL, "moved"), (1, [])),
        (Judgement(Verdict.INCONCLUSIVE, "moved"), (2, ["1 INCONCLUSIVE"])),
    ):
        content = gather(replace(campaign, verdicts={1: judged, 2: passed, 3: passed, 4: passed}))
        view = sensor_view(content.sensors[0])
        assert view["table"]["runs"] == [first, (2, [])]
        page = render(content)
        assert ("run 1 FAILed by what was recorded" in page) == (judged.verdict is Verdict.FAIL)
        assert ("INCONCLUSIVE or FAIL" in page) == ("no numbers to rely on" in page) == bool(first[1])
        heads = [head[3] for head in key_numbers(content.sensors)["heads"]]
        assert heads[0] in (", ".join(first[1]), "")
        assert ("then measure again" in page) == (judged is not passed)


def test_a_hundred_per_cent_are_all_of_them(night: Path) -> None:
    """One sample of a million that is missing is not rounded away."""
    from hil.report.page import stream_in_words

    one = {**night_content(night).collects[0], "n_samples": 999_999, "n_expected": 1_000_000}
    assert "(99.99 %)" in stream_in_words([one])
    assert "(100.00 %)" in stream_in_words([{**one, "n_samples": 1_000_000}])


def test_collects_that_lost_frames_are_counted(night: Path) -> None:
    """Counts are those of the decoder, collect by collect; the sentence adds them up."""
    from dataclasses import replace

    from hil.report.page import night_view, stream_in_words

    collects = list(night_content(night).collects)
    counts = {**collects[3]["counts"], "bad_checksum": 2, "lost": 5, "resyncs": 1}
    hurt = {**collects[3], "counts": counts, "n_samples": 393}
    one = replace(night_content(night), collects=[*collects[:3], hurt, *collects[4:]])
    view = night_view(one)
    ((_, counts),) = view["troubled"]  # zeros are in no row and in no column
    assert [counts[name] for _, _, name in view["counts"]] == [2, 5, 1]
    words = stream_in_words(one.collects)
    assert "2 frames bad, 5 frames lost and 1 resync," in words
    assert "4793 of 4800 expected samples" in words
    assert "in 1 of them." in words


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["csv", pytest.param("parquet", marks=pytest.mark.slow)])
def test_the_tables_beside_the_report_hold_the_full_numbers(
    night: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str
) -> None:
    """Every parameter to the last bit of `hil solve`, with its unit; and every table says that it is simulated."""
    assert hil(["report", str(night), "--out", str(tmp_path / "r.html"), f"--{kind}"]) == 0
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"r.html", *(f"r-{n}.{kind}" for n in ("parameters", "collects", "soaks", "temperatures"))}
    path = tmp_path / f"r-parameters.{kind}"
    if kind == "csv":
        with path.open() as file:
            rows = list(csv.DictReader(file))
        assert {row["simulated"] for row in rows} == {"true"}
    else:
        table = pyarrow.parquet.read_table(path)
        assert table.schema.metadata[b"simulated"] == b"true"
        rows = table.to_pylist()
    of = {(int(r["sensor"]), int(r["run"]), r["model"], r["parameter"]): r for r in rows}
    for solution in solved(capsys, str(night)):
        for name, each in solution["parameters"].items():  # type: ignore[attr-defined]
            row = of[solution["sensor"], solution["run"], "matrix-6", name]  # type: ignore[index]
            assert (float(row["value"]), float(row["se"]), row["unit"]) == (each["value"], each["se"], each["unit"])
            assert [float(row[key]) for key in ("sd", "low", "high")] == [each[key] for key in ("sd", "low", "high")]


def test_no_browser_no_pdf_and_nothing_written(
    night: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The message names what to install, and the way without."""
    monkeypatch.setenv("PATH", str(tmp_path))
    out = tmp_path / "r.html"
    assert hil(["report", str(night), "--out", str(out), "--pdf"]) == 2
    assert not out.exists()
    said = capsys.readouterr().err
    assert "apt-get install chromium" in " ".join(said.split())


def test_a_report_has_somewhere_to_go(night: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A folder that is not there, or a folder in place of a file, is said in one sentence."""
    assert hil(["report", str(night), "--out", str(tmp_path / "no" / "r.html")]) == 2
    assert hil(["report", str(night), "--out", str(tmp_path)]) == 2
    assert hil(["report", str(tmp_path / "nowhere")]) == 2
    before = (night / "journal.sqlite").read_bytes()
    assert hil(["report", str(night), "--out", str(night / "journal.sqlite")]) == 2
    assert (night / "journal.sqlite").read_bytes() == before
    assert "Traceback" not in capsys.readouterr().err


def test_a_night_that_came_to_no_collect_has_a_report_that_says_why(tmp_path: Path) -> None:
    """Stopped before the first collect: not good, nothing solved, everything missing; and no number anywhere."""
    stop = StopRequest()
    stop.request("a cable was pulled")
    start_night(tmp_path / "night", TWO, load_bench("simulated"), who="rk", stop=stop)
    assert hil(["report", str(tmp_path / "night")]) == 0
    page = (tmp_path / "night" / "report.html").read_text()
    assert "nothing solved. The night was aborted" in page
    assert "a cable was pulled" in page
    assert "self-calibrations 1–4 at 20.0 °C to 30.0 °C: all of them" in page
    assert "No residual is left" not in page
    assert "nothing: no collect was solved" in page
    assert "SIMULATED: no device was measured" in page
    assert 'id="runs-sensor' not in page


def test_a_device_that_flaps_all_night_makes_no_report_that_cannot_be_opened(night: Path) -> None:
    """Thousands of events and attempts: the first are listed, the page says how many are not."""
    from dataclasses import replace

    from hil.report.page import MOST_EVENTS, night_view

    many = [("1985-10-01 17:00:00", "retry", "the chamber did not answer")] * (MOST_EVENTS + 700)
    content = replace(night_content(night), events=many, event_hours=np.linspace(0, 1, len(many)), rejected=many)
    view = night_view(content)
    for name in ("events", "rejected"):
        assert len(view[name]) == MOST_EVENTS
        assert view["more"][name] == 700
    assert len(view["svg"]) < 1_000_000
