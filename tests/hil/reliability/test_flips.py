"""A byte flipped, a row edited: whatever states a number says the same to the digit, or names the break."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

_ROOT = Path(__file__).resolve().parents[3]
_QUIET = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}


def flipped(*arguments: str) -> dict[str, Any]:
    """Return what became of the changes."""
    command = [sys.executable, "-m", "benchmarks.reliability.flips", *arguments]
    ended = subprocess.run(command, cwd=_ROOT, env=_QUIET, stdout=subprocess.PIPE, check=False)
    assert ended.returncode in (0, 1)
    return dict(json.loads(ended.stdout))


@pytest.mark.slow
def test_no_flipped_bit_is_silent() -> None:
    """In journal, head, blocks, log and everything else of a complete night."""
    found = flipped("bytes", "--every", "2003", "--seed", "4")
    assert found["problems"] == []
    assert found["named"] > found["the same to the digit"] > 0


@pytest.mark.slow
def test_no_changed_row_is_silent() -> None:
    """A cell edited, a row deleted, doubled or exchanged with the next: every fourth; `make reliability` tries all."""
    found = flipped("rows", "--every", "4")
    assert found["problems"] == []
    assert found["named"] > 100


@pytest.mark.slow
@pytest.mark.parametrize("gone", ["breaks", "refuse_damaged_samples"])
def test_without_its_proofs_the_same_changes_are_silent(gone: str) -> None:
    """A test that cannot fail proves nothing: without the chain rows, without the hashes blocks are believed."""
    arguments = ("rows", "--every", "8") if gone == "breaks" else ("bytes", "--only", "*.parquet", "--every", "3989")
    assert any("SILENT" in each or "nobody" in each for each in flipped(*arguments, "--without", gone)["problems"])
