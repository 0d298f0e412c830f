"""The live page in the system's Chromium while a night goes on at speed: what people see, and what they can do."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any

import numpy as np
import pytest

from drivers.clock import VirtualClock
from drivers.frames.roles import SensorRole
from hil.records import SqliteJournal, open_readonly
from hil.records.live import TRACE_NAME, LiveFiles, trace_columns
from hil.records.rows import Night
from procedures.plan import Step, make_plan
from procedures.progress import Snapshot
from procedures.settings import SweepProcedure
from tests.hil.dashboard.live_page import PHONE, TOKEN, Nights, ask, shown, violations

SENSORS = {number: SensorRole(rates={"RA": "a", "RB": "b"}, temperature="t") for number in (1, 2)}


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
    shown(page, "#banner", "the simulated chamber ended with its controller")
    assert time.monotonic() - began < 5.0
    shown(page, "#state", "controller dead")
    assert violations(page) == []

    nights.dashboard.end()
    shown(page, "#banner", "No connection to the dashboard")
    shown(page, "#link", "no connection")
    nights.dashboard.begin()
    shown(page, "#link", "live")
    shown(page, "#banner", "the simulated chamber ended with its controller")


def during(step: Step, elapsed_s: float) -> Snapshot:
    """Return what a controller shows in the midst of a collect."""
    rates = {f"{number}.{channel}": 12.0 for number in SENSORS for channel in ("RA", "RB")}
    shows = {"rates_deg_per_hr": rates, "rates_se_deg_per_hr": rates, "rates_now_deg_per_hr": rates}
    end = datetime(1985, 10, 2, 12, tzinfo=UTC)
    return Snapshot(step, 1, elapsed_s, 10.0, 50.0, end, 19.9, 20.0, {1: 21.0, 2: 22.0}, **shows)


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
