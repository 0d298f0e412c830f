"""The live page in the system's Chromium, through simulated nights at speed: what people see, and what they can do."""

from __future__ import annotations

import os
import shutil
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from subprocess import Popen
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest

from drivers.clock import VirtualClock
from drivers.frames.roles import SensorRole
from hil.cli.app import run
from hil.dashboard.access import Access
from hil.records import SqliteJournal, open_readonly
from hil.records.live import TRACE_NAME, LiveFiles, trace_columns
from hil.records.rows import Night
from procedures.plan import Step, make_plan
from procedures.progress import Snapshot
from procedures.settings import SweepProcedure
from tests.hil.dashboard.live_page import TOKEN, Dashboard, begin_night, bench_file, served, sweep_file

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed, so no browser is driven")
axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="no axe-core to audit the page with")

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = pytest.mark.skipif(
    CHROMIUM is None, reason="no Chromium on this machine (Debian: apt-get install chromium)"
)

SOON_MS = 20_000
DESKTOP, PHONE = {"width": 1280, "height": 800}, {"width": 390, "height": 844}


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """The system's Chromium, without a window."""
    options = ["--no-sandbox"] if os.geteuid() == 0 else []
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=options)
        yield browser
        browser.close()


@dataclass
class Nights:
    """A dashboard over a folder, and the nights that tests begin in it."""

    dashboard: Dashboard
    files: Path
    processes: list[Popen[bytes]] = field(default_factory=list)

    def begin(self, name: str, *, operator: bool = False, **changes: Any) -> Popen[bytes]:
        """Begin a night called `name` at speed."""
        bench = bench_file(self.files, name, operator=operator)
        speed = changes.pop("speed", None)
        sweep = sweep_file(self.files, **changes)
        process = begin_night(self.dashboard.root / name, sweep, bench, **({"speed": speed} if speed else {}))
        self.processes.append(process)
        return process


@pytest.fixture(scope="module")
def nights(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Nights]:
    """A dashboard that shows a folder of nights, and ends with the tests."""
    folder = tmp_path_factory.mktemp("bench")
    (folder / "nights").mkdir()
    (folder / "token").write_text(TOKEN)
    running = Nights(Dashboard(folder / "nights", folder / "token"), folder)
    running.dashboard.begin()
    yield running
    assert running.dashboard.end() == 0


@pytest.fixture(autouse=True)
def nights_of_one_test(nights: Nights) -> Iterator[None]:
    """A night that goes on after its test would only keep the next one waiting."""
    yield
    while nights.processes:
        process = nights.processes.pop()
        process.kill()
        process.wait(10.0)


@pytest.fixture
def open_page(browser: Any, nights: Nights) -> Iterator[Callable[..., Any]]:
    """Open the page at a night; whatever a page asks of the network or says in its console is judged at the end."""
    contexts, requested, complaints = [], [], []

    def opened(night: str = "", *, url: str = "", size: dict[str, int] = DESKTOP, scheme: str = "light") -> Any:
        context = browser.new_context(viewport=size, color_scheme=scheme)
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(SOON_MS)
        page.on("request", lambda request: requested.append(request.url))
        page.on("console", lambda message: complaints.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.goto(f"{url or nights.dashboard.url}#{night}")
        return page

    yield opened
    for context in contexts:
        context.close()
    assert {urlsplit(url).hostname for url in requested} == {"127.0.0.1"}
    # A refused connection or request is told by the browser itself, whatever the page does about it.
    assert [each for each in complaints if not each.startswith("Failed to load resource")] == []


def shown(page: Any, place: str, text: str) -> None:
    """Wait until a place of the page shows a text."""
    page.locator(place, has_text=text).wait_for(state="visible")


def ask(page: Any, button: str, who: str, why: str = "", token: str = TOKEN) -> None:
    """Press a button of the page and answer its dialog."""
    page.locator(f"#{button}").click()
    page.locator("#ask-who").fill(who)
    if why:
        page.locator("#ask-why").fill(why)
    page.locator("#ask-token").fill(token)
    page.locator("#ask-yes").click()


def asked(nights: Nights, name: str) -> list[tuple[str, str, str, bool | None]]:
    """Return what the journal holds of requests: kind, who, why, accepted."""
    with open_readonly(nights.dashboard.root / name) as journal:
        return [(row.kind, row.who, row.why, row.accepted) for row in journal.requests()]


@pytest.mark.slow(seconds=16)
def test_a_whole_night_is_watched_to_its_end(nights: Nights, open_page: Callable[..., Any]) -> None:
    """Countdown, temperatures and rates change; errors shrink during a collect; results appear; then it is complete."""
    nights.begin("watched", temperatures=["40 degC"])
    page = open_page("watched")
    page.locator("#simulated").wait_for(state="visible")
    page.locator(".mean", has_text=".").first.wait_for()
    places = ["#step", "#remaining", "#tiles", ".mean", ".se"]
    read = "(places) => places.map((place) => document.querySelector(place)?.textContent || '')"
    seen: list[list[str]] = []
    for _ in range(300):
        if page.locator("#state").text_content() == "complete":
            break
        seen.append(page.evaluate(read, places))
        page.wait_for_timeout(100)
    for column in range(4):
        assert len({line[column] for line in seen}) > 3, places[column]
    errors: dict[str, list[float]] = {}
    for step, *_, error in seen:
        if error.startswith("±"):
            errors.setdefault(step, []).append(float(error.removeprefix("±")))
    assert any(each[-1] < each[0] for each in errors.values())
    assert all(sorted(each, reverse=True) == each for each in errors.values())
    assert page.locator("#state").text_content() == "complete"
    shown(page, "#results", "PASS")
    assert page.locator("#results tbody tr").count() == 2  # a line for each sensor
    shown(page, "#done", "1 of 1 self-calibrations")
    shown(page, "#events", "safe state")
    page.locator("#controls").wait_for(state="hidden")  # nobody is there any more who could be asked
    update_ms = page.evaluate("() => performance.getEntriesByName('hil-update').at(-1).duration")
    assert update_ms < 100.0
    zone = page.evaluate("() => Intl.DateTimeFormat('en-GB', {timeZoneName: 'short'}).formatToParts().at(-1).value")
    assert all(zone in page.locator(place).first.text_content() for place in ("#finishing", "#events time", "#about"))
    page.locator("#temperature-chart").hover()
    shown(page, "#temperature-told", "Chamber")
    page.set_viewport_size(PHONE)
    assert page.evaluate("() => document.documentElement.scrollWidth") <= 390
    page.wait_for_function(
        "() => document.querySelector('#temperature-chart canvas').getBoundingClientRect().right <= 390"
    )
    narrow = (
        "() => [...document.querySelectorAll('#results td, #results tbody th')]"
        ".map(e => [e.innerText, e.dataset.name, e.getBoundingClientRect().right])"
    )
    cells = page.evaluate(narrow)
    assert len(cells) == 3 + 2 * (2 + 6)
    assert all(right <= 390 for _, _, right in cells)  # no parameter has to be scrolled for
    assert sum(name in {"MUB", "GSA"} and "deg/hr/g" in text for text, name, _ in cells) == 4


@pytest.mark.slow(seconds=20)
def test_a_question_is_answered_and_a_night_paused_continued_and_aborted(
    nights: Nights, open_page: Callable[..., Any]
) -> None:
    """Each takes a confirmation, a name and the token, and stands in the journal with who asked; phone in portrait."""
    nights.begin("attended", operator=True)
    page = open_page("attended", size=PHONE)
    shown(page, "#question", "position 1")
    assert page.title().startswith("asks: Bring the unit to position 1")  # so that a tab behind others says so, too
    ask(page, "confirm", "ann", token=TOKEN[::-1])
    shown(page, "#ask-error", "not right")
    assert asked(nights, "attended") == []
    page.locator("#ask-no").click()
    # A double click on a button must not press the one that appears below it.
    pressed = "() => { document.querySelector('#abort').click(); return document.querySelector('#ask-yes').disabled; }"
    assert page.evaluate(pressed)
    page.locator("#ask-no").click()
    ask(page, "confirm", "ann")
    shown(page, "#toast", "confirmed")
    shown(page, "#question", "position 2")
    page.locator("#confirm").click()  # name and token are known now
    page.locator("#ask-yes").click()
    shown(page, "#step", "Collect 2")
    ask(page, "pause", "ben", "a look at the cable")
    shown(page, "#state", "paused")
    shown(page, "#note", "ben (live page): a look at the cable")
    ask(page, "continue", "ben")
    shown(page, "#state", "running")
    ask(page, "abort", "ann", "enough")
    shown(page, "#state", "aborted")
    assert asked(nights, "attended") == [
        ("confirm", "ann (live page)", "", True),
        ("confirm", "ann (live page)", "", True),
        ("pause", "ben (live page)", "a look at the cable", True),
        ("continue", "ben (live page)", "", True),
        ("abort", "ann (live page)", "enough", True),
    ]
    assert page.evaluate("() => document.documentElement.scrollWidth <= innerWidth")  # nothing hangs over the side


@pytest.mark.slow(seconds=14)
def test_a_killed_controller_is_told_within_five_seconds_and_a_dashboard_that_comes_back_is_found(
    nights: Nights, open_page: Callable[..., Any]
) -> None:
    """The page says what is dead: the controller, or its own server; and it goes on by itself."""
    controller = nights.begin("killed", speed=60)
    page = open_page("killed")
    shown(page, "#state", "running")
    page.locator("#remaining", has_text=":").wait_for(state="visible")
    assert page.locator("#banner").is_hidden()

    controller.send_signal(signal.SIGSTOP)  # it hangs: it neither works nor dies
    began = time.monotonic()
    shown(page, "#banner", "has shown nothing for")
    assert time.monotonic() - began < 6.5  # 4 s old at the earliest, then a look
    controller.send_signal(signal.SIGKILL)
    began = time.monotonic()
    shown(page, "#banner", "THE CHAMBER MAY STILL BE CONDITIONING")
    assert time.monotonic() - began < 5.0
    shown(page, "#state", "controller dead")
    assert violations(page) == []

    nights.dashboard.end()
    shown(page, "#banner", "No connection to the dashboard")
    shown(page, "#link", "no connection")
    nights.dashboard.begin()
    shown(page, "#link", "live")
    shown(page, "#banner", "THE CHAMBER MAY STILL BE CONDITIONING")


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


@pytest.mark.slow
def test_fifteen_hours_at_one_second_are_brought_up_to_date_in_less_than_100_ms(
    nights: Nights, open_page: Callable[..., Any]
) -> None:
    """The page's own part of it: taking a second's news in and drawing both curves anew."""
    folder, clock = nights.dashboard.root / "long", VirtualClock()
    folder.mkdir()
    plan = make_plan(SweepProcedure(title="Fifteen hours", temperatures_degC=(20.0,)))
    SqliteJournal.create(folder, plan, Night(plan.title, "rk", clock.utc(), True, ""))
    with SqliteJournal.open(folder, clock=clock, who="rk") as journal:
        journal.begin(plan.steps[0])
        LiveFiles(folder, SENSORS, every_s=0.5).close()  # leaves the head of a trace
        rows = np.random.default_rng(1).normal(20.0, 1.0, (15 * 3600, len(trace_columns(SENSORS)))).astype("<f4")
        rows[:, 0] = np.arange(15 * 3600)
        with (folder / TRACE_NAME).open("ab") as trace:
            trace.write(rows.tobytes())
        files = LiveFiles(folder, SENSORS, every_s=0.5)
        page = open_page("long")
        taken = []
        for second in range(4):
            files.update(during(plan.steps[0], 15 * 3600.0 + second))
            page.wait_for_timeout(1000)
            taken += page.evaluate("() => performance.getEntriesByName('hil-update').map((each) => each.duration)")
        files.close()
        shown(page, "#tiles", "19.9")
    assert max(taken[1:]) < 100.0  # the first may be the page's beginning, when there is everything to draw
    assert len(set(taken)) > 2


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


SENSORS = {number: SensorRole(rates={"RA": "a", "RB": "b"}, temperature="t") for number in (1, 2)}


def during(step: Step, elapsed_s: float) -> Snapshot:
    """Return what a controller shows in the midst of a collect."""
    rates = {f"{number}.{channel}": 12.0 for number in SENSORS for channel in ("RA", "RB")}
    shows = {"rates_deg_per_hr": rates, "rates_se_deg_per_hr": rates, "rates_now_deg_per_hr": rates}
    end = datetime(1985, 10, 2, 12, tzinfo=UTC)
    return Snapshot(step, 1, elapsed_s, 10.0, 50.0, end, 19.9, 20.0, {1: 21.0, 2: 22.0}, **shows)


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


def violations(page: Any) -> list[str]:
    """Return what axe-core finds wrong with what is on the page now, in both colour schemes."""
    found = []
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        for each in axe.Axe().run(page).response["violations"]:
            found += [f"{scheme}: {each['id']}: {node['html']}: {node['failureSummary']}" for node in each["nodes"]]
    return found
