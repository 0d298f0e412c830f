"""Somebody wants the sweep to end: a signal, a command, a button. The sweep ends in the safe state.

A second Ctrl-C says the same thing again; it does not skip the safe state. A handler only sets a flag: nothing is
interrupted in the middle of a write. Whatever waits, waits in pieces and asks between them.

A signal that the process was told to ignore (`nohup` does so with SIGHUP) stays ignored. So are, meanwhile, those with
which a terminal stops a process: a controller that Ctrl-Z has put to sleep watches over nothing.
"""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Self


def _known(*names: str) -> tuple[signal.Signals, ...]:
    return tuple(getattr(signal, name) for name in names if hasattr(signal, name))


_SIGNALS = _known("SIGINT", "SIGQUIT", "SIGTERM", "SIGHUP")
_THAT_STOP = _known("SIGTSTP", "SIGTTIN", "SIGTTOU")


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
    def on_signals(self) -> Iterator[Self]:
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
