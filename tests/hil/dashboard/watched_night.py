"""A night as the live page is told of it, while it goes on, when it is complete, and when its controller was killed."""

from __future__ import annotations

import contextlib
import shutil
import sqlite3
from pathlib import Path
from typing import Any

import pytest
import yaml

from hil.config import load_bench, load_sweep
from hil.dashboard.facts import NightFacts
from hil.night import start_night
from hil.records.ledger import HEAD_NAME, enter_everything
from hil.records.live import HEARTBEAT_NAME
from hil.records.reader import JOURNAL_NAME
from hil.records.witnesses import LOG_NAME
from procedures.progress import Progress, Snapshot

SWEEP = {
    "title": "Two at 30 degrees",
    "temperatures": ["30 degC"],
    "self_calibrations_per_temperature": 2,
    "positions": [1, 2, 3],
    "restabilisation": {"at_least": "20 min", "ceiling": "4 h"},
    "collect": {"settle": "30 s", "duration": "60 s"},
}


Watched = tuple[Path, dict[str, Any], NightFacts]


class Onlooker(Progress):
    """Looks at the night's facts at one moment of it, as the dashboard would."""

    def __init__(self, folder: Path, at: str) -> None:
        self.facts = NightFacts(folder, "night")
        self._at = at
        self.seen: dict[str, Any] = {}

    def update(self, snapshot: Snapshot) -> None:
        """Look once, in the step that is asked for."""
        if snapshot.step.key == self._at and not self.seen:
            self.facts.look()
            self.seen = self.facts.whole()


def watched(folder: Path) -> Watched:
    """A complete night, and what the page was told during the soak of its second self-calibration."""
    sweep = folder / "sweep.yaml"
    sweep.write_text(yaml.safe_dump(SWEEP))
    onlooker = Onlooker(folder / "night", "T1/S2/restabilise")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hil.records.live._EVERY_S", 0.0)  # this night lasts a second; its live file is to keep up
        start_night(folder / "night", load_sweep(str(sweep)), load_bench("simulated"), who="rk", onlookers=[onlooker])
    return folder / "night", onlooker.seen, onlooker.facts


def left_by_a_killed_controller(night: Path, folder: Path) -> Path:
    """The same night as a controller leaves it that was killed in its last step."""
    shutil.copytree(night, folder)
    (folder / HEARTBEAT_NAME).unlink()
    with contextlib.closing(sqlite3.connect(folder / JOURNAL_NAME, isolation_level=None)) as connection:
        connection.execute("DELETE FROM attempts WHERE id = (SELECT max(id) FROM attempts)")
        connection.execute("UPDATE controllers SET ended = NULL")
        connection.execute("DELETE FROM events WHERE kind = 'verdict'")
        connection.execute("DELETE FROM ledger")
        enter_everything(connection)
    (folder / HEAD_NAME).unlink()
    (folder / LOG_NAME).unlink()
    return folder
