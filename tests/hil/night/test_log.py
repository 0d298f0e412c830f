"""The log of a night: bounded, whoever writes it."""

from __future__ import annotations

import json
from pathlib import Path

from drivers.clock import VirtualClock
from hil.night.log import NightLog


def test_a_log_that_has_grown_is_rotated_and_bounded(tmp_path: Path) -> None:
    """A service that flaps for months fills no disk; the newest lines are in log.jsonl."""
    log = NightLog(tmp_path, VirtualClock(), "rk", largest=200, kept=2)
    for number in range(20):
        log.say("a line", {"number": number})
    log.close()
    files = sorted(path.name for path in tmp_path.iterdir())
    assert files == ["log.jsonl", "log.jsonl.1", "log.jsonl.2"]
    lines = [
        json.loads(line)["number"] for name in reversed(files) for line in (tmp_path / name).read_text().splitlines()
    ]
    assert lines == list(range(lines[0], 20))
    assert all(path.stat().st_size < 400 for path in tmp_path.iterdir())
