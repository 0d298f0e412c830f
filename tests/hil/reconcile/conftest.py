"""A fleet that several modules screen, and its screen."""

from __future__ import annotations

from pathlib import Path

import pytest

from hil.reconcile.campaigns import Screened, screen_folders
from tests.hil.reconcile.fleet_units import written_fleet


@pytest.fixture(scope="session")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a fleet: to be read, not written to."""
    return written_fleet(tmp_path_factory.mktemp("fleet"))


@pytest.fixture(scope="session")
def screened(fleet: Path) -> Screened:
    """What that fleet's screen says, by one process."""
    return screen_folders([fleet], "matrix-6-thermal")
