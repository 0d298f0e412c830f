"""The live page in the system's Chromium over a folder of nights: who may look, and which night is which."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from drivers.clock import VirtualClock
from hil.cli.app import run
from hil.dashboard.access import Access
from hil.records import SqliteJournal
from hil.records.rows import Night
from procedures.plan import make_plan
from procedures.settings import SweepProcedure
from tests.hil.dashboard.live_page import SOON_MS, TOKEN, Nights, ask, served, shown, violations


@pytest.mark.slow
def test_beyond_this_machine_the_page_shows_nothing_until_it_is_given_the_token(
    open_page: Callable[..., Any], tmp_path: Path
) -> None:
    """A wrong token is refused and said to be wrong; the right one is kept for as long as the tab is open."""
    with served(tmp_path, Access(TOKEN, "192.0.2.7")) as port:
        page = open_page(url=f"http://127.0.0.1:{port}/")
        shown(page, "#unlock", "takes a token")
        for token in (TOKEN[::-1], TOKEN):
            assert page.locator("#empty").is_hidden()
            page.locator("#unlock-token").fill(token)
            page.locator("#unlock button").click()
            shown(page, *(("#empty", "No night") if token == TOKEN else ("#unlock-error", "not right")))
        page.reload()
        shown(page, "#empty", "No night")
        assert TOKEN not in page.url


def ended(nights: Nights, name: str, temperature_degC: float) -> None:
    """Make a night that was begun and never went on, with as many things missing as any other of these."""
    folder = nights.dashboard.root / name
    folder.mkdir()
    procedure = SweepProcedure(title=f"At {temperature_degC:.0f}", temperatures_degC=(temperature_degC,))
    SqliteJournal.create(folder, make_plan(procedure), Night(procedure.title, "rk", VirtualClock().utc(), True, ""))


@pytest.mark.slow
def test_another_night_is_never_shown_in_place_of_the_one_that_was_chosen(
    nights: Nights, open_page: Callable[..., Any]
) -> None:
    """Going from one to another writes everything anew; of one that is deleted only the others' cards are left."""
    ended(nights, "first", 41.0)
    ended(nights, "second", 43.0)
    page = open_page("first")
    shown(page, "#missing", "at 41.0 °C")
    page.evaluate("() => { location.hash = 'second'; }")
    shown(page, "#missing", "at 43.0 °C")
    assert "41.0" not in page.locator("#missing").text_content()
    page.locator("#results", has_text="No self-calibration").wait_for()
    shutil.rmtree(nights.dashboard.root / "second")
    page.locator("#night").wait_for(state="hidden")
    shown(page, "#cards", "first")
    assert page.locator("#cards a", has_text="second").count() == 0


@pytest.mark.slow
def test_a_page_that_fails_says_so_and_does_not_blame_the_connection(nights: Nights, browser: Any) -> None:
    """What is then on the page may be old, and only loading it again helps."""
    context = browser.new_context()
    page = context.new_page()
    page.set_default_timeout(SOON_MS)
    page.goto(nights.dashboard.url)
    shown(page, "#link", "live")
    page.evaluate("() => { Map.prototype.keys = () => { throw new Error('a slip'); }; }")
    shown(page, "#banner", "This page has failed (Error: a slip)")
    shown(page, "#link", "live")
    context.close()


@pytest.mark.slow
def test_results_of_several_units_are_unit_by_unit(nights: Nights, open_page: Callable[..., Any]) -> None:
    """The night's page does not call unsolved what is not; each unit's has its parameters, and one word on their ±."""
    out = nights.dashboard.root / "four"
    assert run(["run", "quick", "--bench", "simulated-four", "--out", str(out), "--yes", "--quiet"]) == 0
    page = open_page("four")
    shown(page, "#results", "unit by unit")
    assert "not solved" not in page.locator("#results").inner_text()
    page.evaluate("() => { location.hash = 'four%2Funits%2FSIM-0002'; }")
    shown(page, "#results", "INCONCLUSIVE")
    said = page.locator("#results").inner_text()
    assert "unit by unit" not in said
    assert "what repeats so far show included" in said
    assert "one run's standard error" not in said
    page.evaluate("() => { location.hash = '#'; }")
    counted = len([*nights.dashboard.root.glob("*/journal.sqlite")])
    shown(page, "#title", f": {counted} night")


@pytest.mark.slow(seconds=11)
def test_an_audit_finds_nothing_that_keeps_people_out(nights: Nights, open_page: Callable[..., Any]) -> None:
    """No violation of axe-core's rules, contrast included, in light and dark: a question, a dialog, a collect, many."""
    nights.begin("audited", operator=True)
    ended(nights, "beside", 47.0)
    page = open_page("audited")
    shown(page, "#question", "position 1")
    found = violations(page)
    page.locator("#abort").click()
    found += violations(page)
    page.locator("#ask-no").click()
    ask(page, "confirm", "ann")
    page.locator("#prompt").wait_for(state="hidden")
    page.wait_for_function("() => document.querySelector('.se')?.textContent.startsWith('±')")
    found += violations(page)
    page.evaluate("() => { location.hash = ''; }")
    shown(page, "#cards", "beside")
    found += violations(page)
    page.locator("#cards a", has_text="beside").focus()
    page.wait_for_timeout(1500)  # cards are written anew meanwhile; who goes by keyboard stays where they are
    assert "beside" in page.evaluate("() => document.activeElement.textContent")
    page.keyboard.press("Enter")
    shown(page, "#title", "At 47")
    assert found == []
