"""A page that is slow to take what it is sent: what the watcher keeps for it, and what it gets in the end."""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from drivers.clock import SystemClock
from hil.dashboard.watcher import Watcher
from hil.records import SqliteJournal
from hil.records.rows import Night
from procedures.plan import make_plan
from procedures.settings import SweepProcedure


class Stepped(Watcher):
    """Looks when it is told to, so that a test can tell before and after a look apart."""

    def __init__(self, root: Path) -> None:
        super().__init__(root, every_s=0.001)
        self._begun, self._allowed, self._ending = threading.Semaphore(0), threading.Semaphore(0), False

    def look(self) -> Mapping[str, Any]:
        """Say that a look begins, which has decided whether everything is sent with it, and wait."""
        self._begun.release()
        if not self._ending:
            self._allowed.acquire()
        return super().look()

    async def begun(self) -> None:
        """Wait until a look has begun."""
        assert await asyncio.to_thread(self._begun.acquire, timeout=10.0)

    async def step(self) -> None:
        """Let the look that has begun end, and the next one begin: what it made has been sent then."""
        self._allowed.release()
        await self.begun()

    def end(self) -> None:
        """Let the last look end as well."""
        self._ending = True
        self._allowed.release()


def test_a_page_that_takes_nothing_fills_no_memory_and_is_told_everything_once_it_does(tmp_path: Path) -> None:
    """A phone that went to sleep costs the others nothing; what it missed comes in one piece."""
    plan = make_plan(SweepProcedure(title="A night", temperatures_degC=(20.0,)))
    SqliteJournal.create(tmp_path, plan, Night(plan.title, "rk", SystemClock().utc(), True, ""))

    async def sleeping() -> list[bytes]:
        watcher = Stepped(tmp_path)
        async with watcher.watching(), watcher.page() as updates:
            await watcher.begun()
            for _ in range(4):
                await watcher.step()
            assert updates.full()
            await watcher.step()
            assert updates.empty()  # it is not worth keeping: everything will come
            await watcher.step()
            await watcher.step()
            watcher.end()
            return [updates.get_nowait(), updates.get_nowait()]

    everything, change = (json.loads(frame[6:])["nights"] for frame in asyncio.run(sleeping()))
    assert {"head", "events", "results", "plan", "temperatures"} <= set(everything[tmp_path.name])
    assert change == {}
