"""A night that several modules read, and its report; searches that commands share; the browser that shows pages."""

from __future__ import annotations

import os
import pickle
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from hil.cli.app import run as hil
from hil.config import load_bench
from hil.night import start_night
from hil.reconcile import workflow
from hil.reconcile.search.posterior import Posterior
from hil.reconcile.search.problem import Problem
from hil.solve import wrong_rows
from tests.hil.report.report_pages import TWO


@pytest.fixture(scope="session")
def night(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A complete night of two temperatures, two self-calibrations each: to be read, not written to."""
    folder = tmp_path_factory.mktemp("reported") / "night"
    assert start_night(folder, TWO, load_bench("simulated"), who="rk").state == "complete"
    return folder


@pytest.fixture(scope="session")
def page(night: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    """Its report, written by the command."""
    out = tmp_path_factory.mktemp("report") / "report.html"
    assert hil(["report", str(night), "--out", str(out)]) == 0
    return out.read_text()


@pytest.fixture
def searched_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Search once where the same is asked of the same rows, to the last bit: what is missing, which rows are wrong.

    What else is asked is searched for by itself; what each makes of what is probable, and proves of it, is its own.
    """
    likelier, probable = workflow._likelier, dict[bytes, Posterior]()
    found, wrong = wrong_rows._wrong_rows, dict[bytes, Any]()

    def once(of: Problem, scattering: Any) -> Posterior:
        question = pickle.dumps((of.campaign, of.model, [each.name for each in of.candidates], scattering))
        if question not in probable:
            probable[question] = likelier(of, scattering)
        return probable[question]

    def wrong_once(*asked: Any) -> Any:
        if (question := pickle.dumps(asked)) not in wrong:
            wrong[question] = found(*asked)
        return wrong[question]

    monkeypatch.setattr(workflow, "_likelier", once)
    monkeypatch.setattr(wrong_rows, "_wrong_rows", wrong_once)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """The system's Chromium, without a window."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: no browser is driven")
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if chromium is None:
        pytest.skip("no Chromium on this machine (Debian: apt-get install chromium)")
    options = ["--no-sandbox"] if os.geteuid() == 0 else []
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium, args=options)
        yield browser
        browser.close()
