"""Shared by all tests: the reference material where it stands beside the checkout, and one hypothesis profile."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import settings

# Before anything imports numpy, as the command line does: each worker has one core, and more threads only wait in turn.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

settings.register_profile("hil", deadline=None, derandomize=bool(os.environ.get("CI")))
settings.load_profile("hil")

_SHARED = Path(__file__).resolve().parents[2] / "shared"


@pytest.fixture(scope="session")
def reference() -> Path:
    """Folder with the report's tables and the golden bytes; the test is skipped where it is absent."""
    folder = _SHARED / "reference"
    if not folder.is_dir():
        pytest.skip("the reference folder (../shared/reference) is not beside this checkout")
    return folder


@pytest.fixture(scope="session")
def reference_data() -> Path:
    """Folder with real measurements by others; the test is skipped where it is absent."""
    folder = Path(os.environ.get("HIL_REFERENCE_DATA", _SHARED / "data"))
    if not folder.is_dir():
        pytest.skip("no reference data: neither ../shared/data nor the folder named by HIL_REFERENCE_DATA exists")
    return folder
