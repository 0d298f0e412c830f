"""Processes that share work: they end with the one that they work for, at once where it gives up."""

import os
import signal
import sys
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from functools import partial
from multiprocessing import get_context, parent_process
from multiprocessing.process import BaseProcess
from multiprocessing.synchronize import Event
from threading import Thread, current_thread, main_thread
from types import FrameType
from typing import Any

_given_up: Event | None = None  # of a process that works for another

Map = Callable[[Callable[[Any], Any], Iterable[Any]], Iterator[Any]]
"""What carries a function out over many things, in their order, as `map` does."""


@contextmanager
def processes(count: int) -> Iterator[Map]:
    """Give what maps a function over things, in order, by processes that end with it; one alone is this process."""
    if count == 1:
        yield map
        return
    context = get_context("spawn")
    given_up = context.Event()
    as_before = signal.signal(signal.SIGTERM, _told_to_end) if current_thread() is main_thread() else None
    with ProcessPoolExecutor(count, context, end_with_parent, (given_up,)) as pool:
        try:
            yield lambda function, things: pool.map(partial(_unless_given_up, function), things)
        except BaseException:
            given_up.set()  # what waits in the pool's own queue cannot be cancelled
            pool.shutdown(wait=False, cancel_futures=True)
            raise
        finally:
            if as_before is not None:
                signal.signal(signal.SIGTERM, as_before)


def _told_to_end(number: int, frame: FrameType | None) -> None:  # noqa: ARG001 - the signature of a handler
    raise KeyboardInterrupt(signal.Signals(number).name)  # as from a terminal: what works for this one ends, too


def end_with_parent(given_up: Event | None) -> None:
    """Let this process end when the one that it works for has, in whatever way: nobody else would tell it.

    What a terminal says to all of them (Ctrl-C) is for that one to hear. Where it gives up, what is at work is told to
    end, once: told again while it clears up, it would leave things behind. What waits for work ends with the pool.
    """
    global _given_up
    _given_up = given_up
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if given_up is not None:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        Thread(target=_tell, args=(given_up,), daemon=True).start()
    if (parent := parent_process()) is not None:
        Thread(target=_outlive, args=(parent,), daemon=True).start()


def _unless_given_up(function: Callable[[Any], Any], thing: Any) -> Any:
    signal.signal(signal.SIGTERM, _end)
    try:
        if _given_up is not None and _given_up.is_set():
            sys.exit(1)
        return function(thing)
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)


def _end(number: int, frame: FrameType | None) -> None:  # noqa: ARG001 - the signature of a handler
    sys.exit(1)


def _tell(given_up: Event) -> None:
    given_up.wait()
    os.kill(os.getpid(), signal.SIGTERM)


def _outlive(parent: BaseProcess) -> None:
    parent.join()
    os._exit(1)
