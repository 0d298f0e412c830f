"""Looks at the nights of a folder once a second, beside the event loop, and tells every open page what changed.

All pages get the same bytes, made once. A page that was just opened, or that was too slow to take what it was sent,
gets everything again; so whoever is slow costs nobody anything, and what waits in memory is bounded.
"""

import asyncio
import json
import os
import secrets
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager, nullcontext, suppress
from pathlib import Path

from drivers.clock import SystemClock
from hil.dashboard.facts import NightFacts, Part, Stamp
from hil.errors import InputError
from hil.records.reader import JOURNAL_NAME, proven_once
from hil.records.units import UNITS

EVERY_S = 1.0
MOST_NIGHTS = 12
"""So many nights are shown at once: those at work first, then the newest."""

_WAITING = 4


class Watcher:
    """The nights of a folder, or the one night that the folder is."""

    def __init__(self, root: Path, every_s: float = EVERY_S, archive: Path | None = None) -> None:
        self._root = root
        self.archive = archive
        self._every_s = every_s
        self._nights: dict[str, NightFacts] = {}  # newest first
        self._not_shown = 0
        self._broken: dict[str, Part] = {}
        self._pages: dict[asyncio.Queue[bytes], bool] = {}  # whether it needs everything
        self._wake = asyncio.Event()
        self.reports = f"/report/{secrets.token_urlsafe(16)}/"  # told to pages that may read, and guessed by nobody
        self.units = f"/units/{secrets.token_urlsafe(16)}/" if archive is not None else ""

    @asynccontextmanager
    async def watching(self) -> AsyncIterator[None]:
        """Look again and again meanwhile, in the event loop that serves the pages and before it serves any."""
        with suppress(InputError):  # a page that was open before asks at once: its nights are there, if not yet read
            self._discover()
        looking = asyncio.create_task(self._run())
        try:
            yield
        finally:
            looking.cancel()

    def night(self, identity: str) -> NightFacts:
        """Return a night that is shown; raise `InputError` where it is none of them."""
        night = self._nights.get(identity)
        if night is None:
            raise InputError(f"{identity}: there is no such night on this page")
        return night

    @asynccontextmanager
    async def page(self) -> AsyncIterator[asyncio.Queue[bytes]]:
        """Give a queue of server-sent events: everything first, then what changes."""
        queue: asyncio.Queue[bytes] = asyncio.Queue(_WAITING)
        self._pages[queue] = True
        self._wake.set()
        try:
            yield queue
        finally:
            del self._pages[queue]

    async def _run(self) -> None:
        while True:
            everything = any(self._pages.values())
            try:
                self._send(*await asyncio.to_thread(self._frames, everything))
            except Exception as error:  # no file can be opened any more, say: pages are told, and the next look may do
                said = str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"
                told = self.frame({}, problem=said)
                for queue in self._pages:  # each needs everything when the folder can be looked at again
                    if not queue.full():
                        queue.put_nowait(told)
                    self._pages[queue] = True
            with suppress(TimeoutError):
                await asyncio.wait_for(self._wake.wait(), self._every_s)
            self._wake.clear()

    def _frames(self, everything: bool) -> tuple[bytes, bytes]:
        changed = self.look()
        return self.frame(changed), self.frame(self.whole()) if everything else b""

    def look(self) -> Mapping[str, Part]:
        """Return by night what changed since the last time; `InputError` where the root folder has gone."""
        self._discover()
        changed: dict[str, Part] = {}
        of_one = dict[Path, list[NightFacts]]()  # a night and its units
        for night in self._nights.values():
            of_one.setdefault(night.night, []).append(night)
        for folder, facts in of_one.items():
            stamp = facts[0].recorded
            with proven_once(folder) if any(each.stamp != stamp for each in facts) else nullcontext():
                changed |= {each.identity: parts for each in facts if (parts := self._look_at(each, stamp))}
        return changed

    def _look_at(self, night: NightFacts, stamp: Stamp) -> Part:
        identity = night.identity
        try:
            parts = night.look(stamp)
            if self._broken.pop(identity, None):
                parts = night.whole()  # pages have forgotten what they knew of it
        except Exception as error:  # one night that cannot be read must not hide the others
            head = {"title": identity, "state": "unreadable", "reason": str(error), "working": False}
            parts = {"head": head}
            parts = {} if self._broken.get(identity) == parts else parts
            self._broken[identity] = parts or self._broken[identity]
        return parts

    def _discover(self) -> None:
        """Find the nights that are there, and keep those that are shown; raise `InputError` if the folder has gone."""
        if not self._root.is_dir():  # deleted, or on a disk that is not there any more: its nights have not ended
            raise InputError(f"{self._root}: there is no such folder any more")
        nights = [path.parent for path in self.journals()]
        units = {night: sorted((night / UNITS).glob("*")) for night in nights}  # of a night that lists several
        found = {self._name(each): each for night in nights for each in (night, *units[night])}
        self._nights = {name: self._nights.get(name) or NightFacts(folder, name) for name, folder in found.items()}

    def journals(self) -> list[Path]:
        """Return the journals to show: the root's own, else of the folders below it, newest first."""
        own = self._root / JOURNAL_NAME
        if own.is_file():
            return [own]
        below = [*self._root.glob(f"*/{JOURNAL_NAME}"), *self._root.glob(f"*/*/{JOURNAL_NAME}")]
        self._not_shown = max(len(below) - MOST_NIGHTS, 0)
        return sorted(below, key=self._rank, reverse=True)[:MOST_NIGHTS]

    def _rank(self, journal: Path) -> tuple[bool, float]:
        """Return what is greater for a night that is rather shown. Whoever reads a journal leaves an empty log."""
        known = self._nights.get(self._name(journal.parent))
        newest = 0.0
        for path in (journal, journal.with_name(f"{JOURNAL_NAME}-wal")):
            with suppress(OSError):  # it vanished meanwhile
                found = path.stat()
                newest = max(newest, found.st_mtime if found.st_size else 0.0)
        return known is not None and known.working, newest

    def _name(self, folder: Path) -> str:
        """Return the name of a night: its folder's, with bytes that are no text written as such."""
        name = folder.resolve().name if folder == self._root else str(folder.relative_to(self._root))
        return os.fsencode(name).decode("utf-8", "backslashreplace")

    def whole(self) -> Mapping[str, Part]:
        """Return by night everything that is known of it, for a page that knows nothing yet."""
        return {identity: self._broken.get(identity) or night.whole() for identity, night in self._nights.items()}

    def frame(self, nights: Mapping[str, Part], problem: str = "") -> bytes:
        """Return the server-sent event that tells a page of these nights, or of why they cannot be looked at."""
        head = {"utc": SystemClock().utc().isoformat(timespec="milliseconds"), "folder": self._root.resolve().name}
        # Cards at work by name, so that none moves, then the newest; the units of a night stand behind it.
        order = sorted(self._nights, key=lambda each: (0, each) if self._nights[each].working else (1, ""))
        shown = {"shown": [] if problem else order, "not_shown": self._not_shown}
        document = {**head, **shown, "problem": problem, "nights": nights}
        document |= {"reports": self.reports, "units": self.units}
        return b"data: " + json.dumps(document, separators=(",", ":"), allow_nan=False).encode() + b"\n\n"

    def _send(self, frame: bytes, everything: bytes) -> None:
        for queue, needs_everything in list(self._pages.items()):
            if needs_everything and not everything:
                continue  # opened during the look: the next frame is for it
            if queue.full():
                while not queue.empty():
                    queue.get_nowait()
                self._pages[queue] = True  # with the next look: who is slow need not be hurried for
                continue
            queue.put_nowait(everything if needs_everything else frame)
            self._pages[queue] = False
