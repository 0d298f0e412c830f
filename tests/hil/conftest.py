"""A night that several modules read, and its report."""

from __future__ import annotations

from pathlib import Path

import pytest

from hil.cli.app import run as hil
from hil.config import load_bench
from hil.night import start_night
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
