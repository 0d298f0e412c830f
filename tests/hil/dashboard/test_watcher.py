"""What the live page is told of a folder of nights: of each, at once, at any length; and of a folder that has gone."""

from __future__ import annotations

import asyncio
import cProfile
import gc
import json
import math
import os
import shutil
import tracemalloc
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.clock import VirtualClock
from drivers.frames.roles import SensorRole
from hil.dashboard.watcher import MOST_NIGHTS, Watcher
from hil.errors import InputError
from hil.files.lock import FolderLock
from hil.records import open_readonly
from hil.records.live import LIVE_NAME, LiveFiles
from hil.records.reader import JOURNAL_NAME
from procedures.progress import Snapshot
from tests.hil.dashboard.watched_night import Watched

SENSORS = {number: SensorRole(rates={"RA": "a", "RB": "b"}, temperature="t") for number in (2, 1)}


def a_night_of(folder: Path, hours: int, clock: VirtualClock) -> LiveFiles:
    """Replace a night's trace by one of some hours at one second, and return what writes on."""
    (folder / "live.trace").unlink(missing_ok=True)
    files = LiveFiles(folder, SENSORS, every_s=0.5, clock=clock)
    for second in range(hours * 3600):
        files.update(_snapshot(folder, float(second)))
    return files


def _snapshot(folder: Path, elapsed_s: float) -> Snapshot:
    if folder not in _STEPS:
        with open_readonly(folder) as journal:
            _STEPS[folder] = journal.plan.steps[-1]
    rates = {f"{number}.{channel}": 12.0 + elapsed_s % 7.0 for number in (1, 2) for channel in ("RA", "RB")}
    collecting = elapsed_s % 3600.0 > 1800.0
    return Snapshot(
        step=_STEPS[folder],
        attempt=1,
        elapsed_s=elapsed_s,
        step_elapsed_s=1.0,
        step_remaining_s=2.0,
        finishing_utc=datetime(2026, 1, 1, tzinfo=UTC),
        chamber_degC=20.0 + elapsed_s % 11.0,
        setpoint_degC=20.0,
        unit_degC={1: 21.0, 2: 22.0},
        rates_deg_per_hr=rates if collecting else {},
        rates_se_deg_per_hr=rates if collecting else {},
        rates_now_deg_per_hr=rates,
    )


_STEPS: dict[Path, Any] = {}


def _in_use() -> int:
    """Return how many bytes are in use: what nobody refers to is not, however rarely a large process looks for it."""
    gc.collect()
    return tracemalloc.get_traced_memory()[0]


def _work(watcher: Watcher) -> tuple[int, int]:
    """Return an update's calls and the bytes that it holds at most: the same whatever else this machine is doing."""
    before = _in_use()
    tracemalloc.reset_peak()
    profile = cProfile.Profile()
    profile.enable()
    frame = watcher.frame(watcher.look())
    profile.disable()
    assert b'"temperatures":' in frame
    assert len(frame) < 20_000
    return sum(entry.callcount for entry in profile.getstats()), tracemalloc.get_traced_memory()[1] - before


@pytest.mark.slow
def test_fifteen_hours_at_one_second_are_brought_up_to_date_as_fast_as_one_and_in_bounded_memory(
    night: Watched, tmp_path: Path
) -> None:
    """An update takes as much work, journal and all, however long the night is; what is kept does not grow."""
    work: dict[int, list[tuple[int, int]]] = {}
    for hours in (1, 15):
        folder = tmp_path / f"{hours}h"
        shutil.copytree(night[0], folder)
        clock = VirtualClock()
        files = a_night_of(folder, hours, clock)
        watcher = Watcher(folder)
        watcher.frame(watcher.look())
        tracemalloc.start()
        in_use = [_in_use()]
        for second in range(60):
            clock.sleep(1.0)  # so that what was traced is written out
            files.update(_snapshot(folder, hours * 3600.0 + second))
            os.utime(folder / JOURNAL_NAME, ns=(second, second))  # something was committed as well
            work.setdefault(hours, []).append(_work(watcher))
            in_use.append(_in_use())
        tracemalloc.stop()
        files.close()
        # Of a second in the middle: the table of the interpreter's own strings is laid anew at once, in any of them.
        assert np.median(np.diff(in_use)) < 8_000
        assert len(watcher.frame(watcher.whole())) < 500_000
    assert max(calls for calls, _ in work[15]) < 1.1 * max(calls for calls, _ in work[1])
    # Of an update in the middle, for a curve that is full is laid in buckets of twice the width in one of them.
    held = {hours: np.median(np.asarray(of), axis=0)[1] for hours, of in work.items()}
    assert held[15] < 1.1 * held[1]


@pytest.mark.slow
def test_a_folder_shows_its_nights_and_says_of_a_damaged_one_that_it_is(night: Watched, tmp_path: Path) -> None:
    """One bad file hides no other night; nights appear and vanish by themselves."""
    for name in ("a", "bench-2/b"):
        shutil.copytree(night[0], tmp_path / name)
    (tmp_path / "damaged").mkdir()
    (tmp_path / "damaged" / JOURNAL_NAME).write_bytes(b"no database" * 100)
    watcher = Watcher(tmp_path)
    changed = watcher.look()
    assert set(changed) == {"a", "bench-2/b", "damaged"}
    assert changed["damaged"]["head"]["state"] == "unreadable"
    assert "damaged" in changed["damaged"]["head"]["reason"]
    assert changed["bench-2/b"]["head"]["state"] == "complete"
    assert watcher.look() == {}
    (tmp_path / "a" / JOURNAL_NAME).unlink()
    watcher.look()
    assert set(json.loads(watcher.frame({})[6:])["shown"]) == {"bench-2/b", "damaged"}


def test_of_many_nights_the_newest_are_shown_and_the_others_counted(night: Watched, tmp_path: Path) -> None:
    """A folder of years stays a page; the one that is at work is on it, however old its files are."""
    for number in range(MOST_NIGHTS + 3):
        journal = tmp_path / f"night-{number:02d}" / JOURNAL_NAME
        journal.parent.mkdir()
        journal.write_bytes((night[0] / JOURNAL_NAME).read_bytes())
        os.utime(journal, ns=(0, (1000 + number) * 10**9))
    watcher = Watcher(tmp_path)
    shown = set(watcher.look())
    assert shown == {f"night-{number:02d}" for number in range(3, MOST_NIGHTS + 3)}
    assert json.loads(watcher.frame({})[6:])["not_shown"] == 3
    with FolderLock(tmp_path / "night-03").acquire():
        watcher.look()
        newest = tmp_path / "night-00" / JOURNAL_NAME
        os.utime(newest, ns=(0, 9000 * 10**9))
        watcher.look()
        shown_now = json.loads(watcher.frame({})[6:])["shown"]
        assert shown_now[:2] == ["night-03", "night-00"]  # who works stands first, then the newest
        assert shown_now[2:] == sorted(shown_now[2:], reverse=True)


def test_a_folder_whose_name_is_no_text_hides_no_other_night(night: Watched, tmp_path: Path) -> None:
    """Any bytes may be a folder's name on this file system, and not every text is one that a browser takes."""
    for name in ("a", os.fsdecode(b"b\xff")):
        shutil.copytree(night[0], tmp_path / name)
    watcher = Watcher(tmp_path)
    watcher.look()
    shown = json.loads(watcher.frame({})[6:])["shown"]
    assert {each.encode().decode() for each in shown} == {"a", "b\\xff"}
    assert watcher.night("b\\xff").folder.is_dir()


def test_a_number_that_is_none_is_not_shown_and_breaks_nothing(killed: Path, tmp_path: Path) -> None:
    """JSON has no NaN, and a page that was sent one would read nothing at all: of a night that is at work."""
    shutil.copytree(killed, tmp_path / "nights" / "a")
    live = tmp_path / "nights" / "a" / LIVE_NAME
    document = json.loads(live.read_text()) | {"chamber_degC": math.nan, "stream_hz": math.inf}
    live.write_text(json.dumps(document | {"pid": os.getpid()}))
    watcher = Watcher(tmp_path / "nights")
    with FolderLock(tmp_path / "nights" / "a").acquire():
        frame = watcher.frame(watcher.look())
    told = json.loads(frame[6:], parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))
    now = told["nights"]["a"]["head"]["now"]
    assert (now["chamber_degC"], now["stream"]["hz"]) == (None, None)


def test_a_folder_that_has_gone_is_not_taken_for_one_without_nights(night: Watched, tmp_path: Path) -> None:
    """Nothing is known of its nights any more, which is another thing than that there are none."""
    shutil.copytree(night[0], tmp_path / "nights" / "a")
    watcher = Watcher(tmp_path / "nights")
    assert set(watcher.look()) == {"a"}
    (tmp_path / "nights").rename(tmp_path / "elsewhere")
    with pytest.raises(InputError, match="there is no such folder any more"):
        watcher.look()
    (tmp_path / "elsewhere").rename(tmp_path / "nights")
    watcher.look()
    assert json.loads(watcher.frame({})[6:])["shown"] == ["a"]


def test_pages_are_told_when_the_folder_cannot_be_looked_at_and_everything_once_it_can(
    night: Watched, tmp_path: Path
) -> None:
    """No file can be opened any more, say: what the page shows is then old, and the watcher goes on trying."""
    shutil.copytree(night[0], tmp_path / "a")
    failing = [OSError(24, "Too many open files"), OSError(24, "Too many open files")]

    class Failing(Watcher):
        """Cannot look twice, then can."""

        def look(self) -> Mapping[str, Any]:
            if failing:
                raise failing.pop()
            return super().look()

    async def watched() -> list[dict[str, Any]]:
        watcher = Failing(tmp_path, every_s=0.01)
        told: list[dict[str, Any]] = []
        async with watcher.watching(), watcher.page() as updates:
            while len(told) < 20 and not (told and told[-1]["nights"]):
                told.append(json.loads((await updates.get())[6:]))
        return told

    told = asyncio.run(watched())
    assert "Too many open files" in told[0]["problem"]
    assert told[-1]["problem"] == ""
    assert "results" in told[-1]["nights"]["a"]


def test_a_night_that_can_be_read_again_is_told_from_its_beginning(night: Watched, tmp_path: Path) -> None:
    """Pages that were told it cannot be read have nothing left that could be brought up to date."""
    journal = shutil.copytree(night[0], tmp_path / "a") / JOURNAL_NAME
    watcher = Watcher(tmp_path)
    whole = set(watcher.look()["a"])
    assert {"results", "temperatures"} <= whole
    journal.write_bytes(b"damaged" * 100)
    assert watcher.look()["a"]["head"]["state"] == "unreadable"
    journal.write_bytes((night[0] / JOURNAL_NAME).read_bytes())
    assert whole <= set(watcher.look()["a"])
