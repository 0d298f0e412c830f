"""A dashboard over a folder of nights, and pages of it: for tests of what people see."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest

from tests.hil.dashboard.live_page import DESKTOP, SOON_MS, TOKEN, Dashboard, Nights
from tests.hil.dashboard.watched_night import Watched, left_by_a_killed_controller, watched


@pytest.fixture(scope="module")
def night(tmp_path_factory: pytest.TempPathFactory) -> Watched:
    """A complete night, and what the page was told during the soak of its second self-calibration."""
    return watched(tmp_path_factory.mktemp("facts"))


@pytest.fixture
def killed(night: Watched, tmp_path: Path) -> Path:
    """The same night as a controller leaves it that was killed in its last step."""
    return left_by_a_killed_controller(night[0], tmp_path / "killed")


@pytest.fixture(scope="module")
def nights_of_a_module(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Nights]:
    """A dashboard that shows a folder of nights, and ends with the tests."""
    folder = tmp_path_factory.mktemp("bench")
    (folder / "nights").mkdir()
    (folder / "token").write_text(TOKEN)
    running = Nights(Dashboard(folder / "nights", folder / "token"), folder)
    running.dashboard.begin()
    yield running
    assert running.dashboard.end() == 0


@pytest.fixture
def nights(nights_of_a_module: Nights) -> Iterator[Nights]:
    """The same; a night that goes on after its test would only keep the next one waiting."""
    yield nights_of_a_module
    nights_of_a_module.end()


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
