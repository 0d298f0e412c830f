"""The watchdog of a night: another process that brings the chamber to its safe state when the controller cannot.

It ends when the controller has ended by itself. It acts when
- the controller has died (killed, out of memory, a crash of the interpreter): proven by its lock, which the kernel
  releases with the process, while the journal says nothing of an end; at once;
- the controller lives but has shown no sign of life for `timeout_s`, beyond what it asked for (stopped, hung): it is
  asked to end (SIGTERM), then killed (SIGKILL), because only one program can drive a chamber; then as above;
- the controller has ended and could not reach the safe state itself;
- the controller is gone and its journal cannot be read, or the folder not be written: the chamber comes first.

While it acts it holds the folder's lock and the bench's, so that nobody resumes meanwhile; a bench that another night
has taken over is left alone. What it did is in the journal. The power of the computer itself is not its to answer: that
is what a chamber's own dead-man timer is for (`dead_man` in the bench file).
"""

import os
import signal
import socket
import sqlite3
from collections.abc import Callable
from contextlib import nullcontext, suppress
from dataclasses import KW_ONLY, dataclass, field
from pathlib import Path

from drivers.clock import Clock, SystemClock
from drivers.errors import DeviceError
from hil.bench import open_chamber
from hil.bench.lock import bench_lock
from hil.config import Bench
from hil.errors import InputError
from hil.files.lock import LOCK_NAME, FolderLock, Owner, living_owner, read_owner
from hil.records import SqliteJournal, open_readonly
from hil.records.live import SILENCE_BORNE_S, read_heartbeat
from hil.records.requests import who_asks
from procedures.safe_air import Left, not_commanded, watch_air
from procedures.stop import StopRequest

_CHAMBER_S = 9.0  # to open the port and be sure of the safe state: what a slow chamber's pacing takes
_KILLED_WITHIN_S = 10.0
_LOOK_S = 0.05


@dataclass(frozen=True)
class Patience:
    """How long the watchdog waits, in seconds of real time."""

    timeout_s: float = SILENCE_BORNE_S  # without a sign of life, beyond what the controller asked for
    look_s: float = 1.0  # between looks
    term_s: float = 10.0  # between asking a silent controller to end and killing it
    safe_state_s: float = 300.0  # how long the safe state is tried for
    retry_s: float = 2.0

    @property
    def after_death_s(self) -> float:
        """How long after the death of its controller a chamber that answers is in its safe state, at most."""
        return self.look_s + _CHAMBER_S

    def after_silence_s(self, asked_for_s: float = 0.0) -> float:
        """How long after the last heartbeat of a hung controller a chamber that answers is in its safe state, at most.

        The silence borne and the one that the controller asked for, the time to end when asked, what a death takes.
        """
        return self.timeout_s + asked_for_s + self.look_s + self.term_s + self.after_death_s


@dataclass(frozen=True)
class Watched:
    """How a watch ended. Status 0: the controller ended by itself; 1: nobody could end it; else `Left.exit_status`."""

    message: str
    exit_status: int


@dataclass(eq=False)
class Watchdog:
    """Watches the night in `folder`, whose chamber it reaches through `bench`. `say` hears what goes on, in words.

    With `kill` False a silent controller that still lives is reported and left alone. Where `stop` is requested the
    watch ends, but never in the middle of a safe state.
    """

    folder: Path
    bench: Bench
    _: KW_ONLY
    patience: Patience = Patience()
    kill: bool = True
    say: Callable[[str], None]
    stop: StopRequest = field(default_factory=StopRequest)
    clock: Clock = field(default_factory=SystemClock)

    def __post_init__(self) -> None:
        self._last: object = None  # the newest heartbeat, and when it was first seen
        self._changed_s = self.clock.now()
        self._reported = self._seen_alive = False

    def run(self) -> Watched:
        """Watch until the controller has ended, one way or the other."""
        self.say(
            f"watching {self.folder}; the chamber is safe {self.patience.after_death_s:.0f} s after a death, "
            f"{self.patience.after_silence_s():.0f} s after the last heartbeat, at most"
        )
        while not self.stop.requested:
            owner = living_owner(self.folder)
            self._seen_alive |= owner is not None
            ended = self._after_the_end() if owner is None else self._end_silent(owner) if self._silent() else None
            if ended is not None:
                return ended
            looked_s = self.clock.now()
            self.clock.sleep(self.patience.look_s)
            if self.clock.now() - looked_s > self.patience.look_s + self.patience.term_s:
                self._changed_s = self.clock.now()  # it slept itself, and so may have the controller
        return Watched(f"the watch ended: {self.stop.reason}; nobody watches {self.folder} now", 0)

    # Looking

    def _silent(self) -> bool:
        beat = read_heartbeat(self.folder)
        if beat is None and self._last is None:
            return False  # a controller that writes none can only be seen to die
        if beat is not None and beat != self._last:
            self._last, self._changed_s, self._reported = beat, self.clock.now(), False
        allowed_s = self.patience.timeout_s + (0.0 if beat is None else beat.silent_s)
        return self.clock.now() - self._changed_s > allowed_s

    def _after_the_end(self) -> Watched | None:
        """Decide what the end of a controller asks for; None where none has begun yet, or one begins just now."""
        try:
            with open_readonly(self.folder) as journal:
                controllers = journal.controllers()
                unsafe = journal.standing("safe-state-not-reached", "safe-state")
        except (sqlite3.Error, InputError) as error:
            # The disk that took the journal may have taken the controller. Safe twice is better than not at all.
            if not self._seen_alive and read_owner(self.folder / LOCK_NAME) is None:
                raise
            return self._act(f"the controller is gone, and its journal cannot be read ({error})")
        if not controllers:
            return None
        last = controllers[-1]
        if last.ended is None:
            return self._act(f"the controller (process {last.pid} on {last.host}) died")
        if unsafe is not None:
            return self._act(f"the controller ended, but {unsafe.message}")
        return Watched(f"the controller has ended: {last.ended}", 0)

    # A controller that lives and is silent

    def _end_silent(self, owner: Owner) -> Watched | None:
        """Ask the controller to end, then kill it; return a failure, or None where the next look decides."""
        silence = f"{owner} has shown no sign of life for {self.clock.now() - self._changed_s:.0f} s"
        if not self.kill:
            if not self._reported:
                self.say(f"{silence}; it is left alone, as asked: go to the chamber")
                self._reported = True
            return None
        if not owner.is_that_process:
            where = "on another machine" if owner.host != socket.gethostname() else "not certainly this one"
            return Watched(f"{silence}, and it is {where}, so it was not killed; GO TO THE CHAMBER", 1)
        self.say(f"{silence}; it is asked to end")
        try:
            os.kill(owner.pid, signal.SIGTERM)
            if self._gone_within(self.patience.term_s, or_beating=True):
                return None
            self.say("it does not react; it is killed")
            if owner.is_that_process:
                os.kill(owner.pid, signal.SIGKILL)
        except ProcessLookupError:
            return None
        except OSError as error:
            return Watched(f"{silence}, and it cannot be ended ({error.strerror}); GO TO THE CHAMBER", 1)
        if not self._gone_within(_KILLED_WITHIN_S):
            return Watched(f"{silence}, and does not even die (a device driver hangs?); GO TO THE CHAMBER", 1)
        return None

    def _gone_within(self, seconds: float, *, or_beating: bool = False) -> bool:
        until_s = self.clock.now() + seconds
        while self.clock.now() < until_s:
            if living_owner(self.folder) is None or (or_beating and not self._silent()):
                return True
            self.clock.sleep(_LOOK_S)
        return False

    # Acting

    def _act(self, why: str) -> Watched | None:
        """Bring the chamber to its safe state; None where somebody has resumed the night meanwhile."""
        lock: FolderLock | None = None
        try:
            lock = FolderLock(self.folder).acquire()
        except InputError as error:
            if living_owner(self.folder) is not None:
                return None
            self.say(f"{error}; the chamber comes first")  # a disk that became read-only
        with lock or nullcontext():
            try:
                with bench_lock(self.bench, self.folder):
                    left = self._make_safe(why)
            except InputError as error:
                return Watched(f"{why}, and its bench is not its own any more, so it was left alone: {error}", 0)
            done = f"could not bring the chamber to its safe state. {left}; GO TO THE CHAMBER"
            message = f"{why}; the watchdog {'brought the chamber to its safe state' if left.safe else done}"
            self._record(lock, message, why, left)
            return Watched(message, left.exit_status(3))

    def _make_safe(self, why: str) -> Left:
        """Try for minutes, or until it is told to end, and look at the air; return how the chamber is left."""
        self.say(f"{why}; the chamber is being brought to its safe state")
        until_s = self.clock.now() + self.patience.safe_state_s
        while True:
            try:
                # Opened anew each time: the dead controller's port may take a moment to be free.
                with open_chamber(self.bench) as (chamber, _):
                    return watch_air(chamber, self.clock, chamber.safe_state(), self.bench.polling, self.say)
            except (DeviceError, InputError) as error:
                left = not_commanded(error, str(error))
            self.say(f"not yet: {left.reason}")
            if self.clock.now() >= until_s or self.stop.requested:
                return left
            self.clock.sleep(self.patience.retry_s)

    def _record(self, lock: FolderLock | None, message: str, why: str, left: Left) -> None:
        """Write into the journal what was done; a journal that fails must not hide it."""
        if lock is None:
            return
        try:
            with SqliteJournal.open(self.folder, clock=self.clock, who=f"watchdog of {who_asks()}", lock=lock) as it:
                it.event("watchdog", message, why=why)
                kind = "safe-state" if left.safe else "safe-state-not-reached"
                it.event(kind, f"by the watchdog: {left.reason}", chamber=left.word.value)
                it.finish(f"failed: {message}")
        except (sqlite3.Error, OSError, InputError) as error:
            with suppress(OSError):
                self.say(f"the journal could not record it: {error}")
