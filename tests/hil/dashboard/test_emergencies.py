"""The live page when something is wrong, or was, or the night has ended: what it says first, in colour and in words."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from drivers.clock import VirtualClock
from hil.config import load_bench, load_sweep
from hil.dashboard import facts
from hil.dashboard.access import Access
from hil.night import start_night
from hil.records import SqliteJournal
from hil.records.rows import Night
from procedures.plan import make_plan
from procedures.settings import SweepProcedure
from procedures.verdict import Judgement, Verdict
from tests.hil.cli.conftest import SHORT_SWEEP
from tests.hil.dashboard.live_page import TOKEN, served, shown, violations

LOST = "chamber-lost: the chamber does not answer: timeout (ends the sweep after 120 s)"
REPORT = "<!doctype html><title>r</title><style>h1 { color: rgb(1, 2, 3) }</style><h1>The report of unit 014</h1>"


@pytest.fixture(scope="module")
def nights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two complete nights, the first with its report; the verdict on the one that is called bad is FAIL."""
    folder = tmp_path_factory.mktemp("nights")
    sweep = folder / "sweep.yaml"
    sweep.write_text(
        yaml.safe_dump({**SHORT_SWEEP, "temperatures": ["23 degC"], "self_calibrations_per_temperature": 1})
    )
    bench = load_bench("simulated")
    assert start_night(folder / "good", load_sweep(sweep), bench, who="R. Kim").state == "complete"
    shutil.copytree(folder / "good", folder / "bad")
    (folder / "good" / "report.html").write_text(REPORT)
    return folder


@pytest.fixture
def journal(nights: Path) -> Iterator[SqliteJournal]:
    """A night that is at work in the same folder."""
    folder, clock = nights / "trouble", VirtualClock()
    folder.mkdir()
    plan = make_plan(SweepProcedure(title="Small", temperatures_degC=(20.0,), self_calibrations=1))
    SqliteJournal.create(folder, plan, Night(plan.title, "rk", clock.utc(), True, ""))
    with SqliteJournal.open(folder, clock=clock, who="rk") as opened:
        yield opened
    shutil.rmtree(folder)


@pytest.fixture
def page(browser: Any, nights: Path, journal: SqliteJournal, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """The page over all three."""
    real = facts.recorded_verdict
    fail = vars(Judgement(Verdict.FAIL, "1 of 2 solutions; the first is sensor 2, run 1: it moved"))
    monkeypatch.setattr(facts, "recorded_verdict", lambda night: fail if night.folder.name == "bad" else real(night))
    context = browser.new_context()
    with served(nights, Access(TOKEN, "127.0.0.1")) as port:
        opened = context.new_page()
        opened.set_default_timeout(20_000)
        opened.goto(f"http://127.0.0.1:{port}/")
        yield opened
        context.close()


@pytest.mark.slow
def test_nobody_has_to_guess_how_it_stands(page: Any, journal: SqliteJournal) -> None:
    """Cards say verdict, unit and date, and lead to the report; FAIL is not green; an emergency is red until over."""
    card = {
        name: page.locator("#cards li", has=page.locator(f"a[href='#{name}']")) for name in ("good", "bad", "trouble")
    }
    shown(page, "#cards", "MFS-IMU SIM-0001 · by R. Kim · began 1 Oct 1985")
    assert card["good"].locator(".badge.complete").text_content() == "complete"
    assert card["good"].locator(".verdict.PASS").text_content() == "PASS"
    assert card["bad"].locator(".badge.failed").text_content() == "complete, FAIL"
    assert card["bad"].locator(".card.bad .trouble").text_content().startswith("FAIL: 1 of 2 solutions")
    assert card["bad"].locator(".badge.complete").count() == 0
    assert card["trouble"].locator(".badge.running").text_content() == "running"

    with page.expect_popup() as popup:
        card["good"].locator("a.report").click()
    report = popup.value
    shown(report, "h1", "The report of unit 014")
    assert report.evaluate("() => getComputedStyle(document.querySelector('h1')).color") == "rgb(1, 2, 3)"
    assert card["bad"].locator("a.report").count() == 0

    journal.event("interlock-suspected", LOST)
    card["trouble"].locator(".badge.trouble", has_text="running, in trouble").wait_for()
    shown(page, "#cards .card.bad .trouble", "the chamber does not answer")
    assert card["trouble"].locator(".badge.running").count() == 0
    assert violations(page) == []
    card["trouble"].locator(".card").click()
    shown(page, "#banner", "the chamber does not answer: timeout (ends the sweep after 120 s); since 17:00:00 UTC")
    assert page.locator("#banner.bad").count() == 1
    journal.event("interlock-cleared", "chamber-lost cleared after 30 s")
    shown(page, "#over", "over since 17:00:00 UTC")
    page.locator("#banner").wait_for(state="hidden")
    assert page.locator("#state").text_content() == "running"
    assert violations(page) == []


@pytest.mark.slow
def test_words_are_typed_where_words_are_asked_for(page: Any, journal: SqliteJournal) -> None:
    """The serial number of a unit: the dialog has a field for it that must be filled in, and it reaches the journal."""
    question = "Type or scan the serial number of the unit."
    journal.event("prompt", question, prompt=1, timeout_s=3600.0, wants_words=True)
    page.locator("a[href='#trouble']").click()
    shown(page, "#question", question)
    page.locator("#confirm").click()
    shown(page, "#ask-why-label", "Your answer, typed or scanned")
    page.locator("#ask-who").fill("ann")
    page.locator("#ask-token").fill(TOKEN)
    page.wait_for_function("() => !document.querySelector('#ask-yes').disabled")
    page.locator("#ask-yes").click()  # the browser itself asks for the missing answer
    assert journal.requests() == ()
    page.locator("#ask-why").fill("U/014")
    page.locator("#ask-yes").click()
    page.wait_for_timeout(200)
    for _ in range(100):
        if journal.requests():
            break
        page.wait_for_timeout(50)
    (row,) = journal.requests()
    assert (row.kind, row.why, row.prompt) == ("confirm", "U/014", 1)


@pytest.mark.slow
def test_a_report_is_for_those_who_were_told_where_it_is(page: Any) -> None:
    """Its address has a key that the page is told and nobody can guess; no other file of a night has one."""
    shown(page, "#cards", "SIM-0001")
    link = page.locator("a.report").get_attribute("href")
    found = {}
    for path in (link, "/report/guessed/good", link.replace("/good", "/bad"), link.replace("/good", "/..%2f..")):
        found[path] = page.request.get(page.url.split("#")[0].rstrip("/") + path).status
    assert list(found.values()) == [200, 404, 404, 404]
