"""Somebody wants the sweep to end: a signal, a command, a button. The sweep ends in the safe state.

    stop = StopRequest()
    with stop.on_signals():
        outcome = sequencer.run()

A second Ctrl-C says the same thing again; it does not skip the safe state. A handler only sets a flag: nothing is
interrupted in the middle of a write. Whatever waits, waits in pieces and asks between them.

A signal that the process was told to ignore (`nohup` does so with SIGHUP) stays ignored. So are, meanwhile, those with
which a terminal stops a process: a controller that Ctrl-Z has put to sleep watches over nothing.

Of `processes` that share work only the one that they work for hears a terminal; when it ends, they do.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from functools import partial
from multiprocessing import active_children, get_context, parent_process
from multiprocessing.process import BaseProcess
from multiprocessing.synchronize import Event
from threading import Thread
from types import FrameType
from typing import Any


def _known(*names: str) -> tuple[signal.Signals, ...]:
    """Return the signals that this system has: Windows has few."""
    return tuple(getattr(signal, name) for name in names if hasattr(signal, name))


_SIGNALS = _known("SIGINT", "SIGQUIT", "SIGTERM", "SIGHUP")
_THAT_STOP = _known("SIGTSTP", "SIGTTIN", "SIGTTOU")
_given_up: Event | None = None  # of a process that works for another

Map = Callable[[Callable[[Any], Any], Iterable[Any]], Iterator[Any]]


class StopRequested(Exception):
    """Raised at the next poll after a stop was asked for; carries who asked."""


class StopRequest:
    """A flag that is set once and stays set. The first reason is kept."""

    reason = ""  # who asked

    @property
    def requested(self) -> bool:
        """True once somebody asked."""
        return bool(self.reason)

    def request(self, reason: str) -> None:
        """Ask for the end of the sweep."""
        self.reason = self.reason or reason

    def check(self) -> None:
        """Raise `StopRequested` where somebody asked."""
        if self.requested:
            raise StopRequested(self.reason)

    @contextmanager
    def on_signals(self) -> Iterator[StopRequest]:
        """Turn signals into a stop request, then put the handlers back; in the main thread alone (`ValueError`)."""
        former = {number: signal.getsignal(number) for number in (*_SIGNALS, *_THAT_STOP)}
        for number in _SIGNALS:
            if former[number] is not signal.SIG_IGN:
                signal.signal(number, self._handle)
        for number in _THAT_STOP:
            signal.signal(number, signal.SIG_IGN)
        try:
            yield self
        finally:
            for number, handler in former.items():
                signal.signal(number, handler)

    def _handle(self, number: int, frame: FrameType | None) -> None:  # noqa: ARG002 - the signature of a handler
        key = "Ctrl-C, " if number == signal.SIGINT else ""
        self.request(f"stopped by {key}{signal.Signals(number).name}")


@contextmanager
def processes(count: int) -> Iterator[Map]:
    """Give what carries a function out over many things, in their order, by processes that share the work.

    They end with it, and at once where it is given up. One alone is this process.
    """
    if count == 1:
        yield map
        return
    context = get_context("spawn")
    given_up = context.Event()
    with ProcessPoolExecutor(count, context, end_with_parent, (given_up,)) as pool:
        try:
            yield lambda function, things: pool.map(partial(_unless_given_up, function), things)
        except BaseException:
            given_up.set()  # what waits in the pool's own queue cannot be cancelled
            pool.shutdown(wait=False, cancel_futures=True)
            for child in active_children():
                child.terminate()
            raise


def end_with_parent(given_up: Event | None) -> None:
    """Let this process end when the one that it works for has, in whatever way: nobody else would tell it.

    What a terminal says to all of them (Ctrl-C) is for that one to hear. Told to end, it leaves nothing behind.
    """
    global _given_up
    _given_up = given_up
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    if (parent := parent_process()) is not None:
        Thread(target=_outlive, args=(parent,), daemon=True).start()


def _unless_given_up(function: Callable[[Any], Any], thing: Any) -> Any:
    if _given_up is not None and _given_up.is_set():
        sys.exit(1)
    return function(thing)


def _outlive(parent: BaseProcess) -> None:
    parent.join()
    os._exit(1)
