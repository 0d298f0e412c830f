"""`hil watchdog`: a second process that makes the chamber safe when the controller cannot."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path
from tempfile import TemporaryDirectory

from drivers.clock import Clock, SystemClock
from hil.cli.exit_status import Exit
from hil.cli.output import messages
from hil.errors import InputError
from hil.files.lock import LOCK_NAME
from procedures.plan import Plan
from procedures.progress import Progress, Snapshot
from procedures.stop import StopRequest

_LOOK_S = 0.5  # for a night that begins
_ANEW_S = 5.0  # between two starts: one that cannot start costs little


def watchdog(
    folder: Path, bench: str | None = None, timeout: float = 60.0, kill: bool = True, nights: bool = False
) -> int:
    """Watch a night from another process; bring its chamber to the safe state when its controller dies or hangs.

    Ends with status 0 when the controller has ended by itself, 3 when the watchdog made the chamber safe, 5 when it
    is NOT SAFE, 6 when that is NOT KNOWN: then somebody must go to the chamber.
    """
    from hil.config import load_bench
    from hil.config.ports import SIMULATED_SCHEME
    from hil.config.recorded import configuration_of
    from hil.night.notify import Notifier
    from hil.night.watchdog import Patience, Watchdog
    from hil.records import open_readonly

    stop = StopRequest()
    with TemporaryDirectory(prefix="hil-watchdog-") as named_files, stop.on_signals():
        while nights and not stop.requested:
            folder, nights = next(((each, False) for each in _begun(folder)), (folder, True))
            SystemClock().sleep(_LOOK_S)
        if nights:
            return Exit.DONE
        if bench is None:
            with open_readonly(folder) as journal:
                on = configuration_of(journal.night.configuration, Path(named_files))[0]
        else:
            on = load_bench(bench)
        if on.chamber.port.startswith(SIMULATED_SCHEME):
            gone = "its chamber is simulated inside the controller and dies with it"
            raise InputError(
                f"{folder}: {gone}: nothing to watch or to make safe; a night that was killed hil resume carries on"
            )
        patience = Patience(timeout_s=timeout, look_s=min(1.0, timeout / 5.0), term_s=min(10.0, timeout))
        with closing(Notifier(on.notify, f"{on.name}{' SIMULATED' * on.simulated}, {folder.name}", _say)) as notifier:
            ended = Watchdog(folder, on, patience=patience, kill=kill, say=_say, stop=stop).run()
            if ended.exit_status != Exit.DONE:
                notifier.tell("fault", ended.message)
    _say(ended.message)
    return ended.exit_status


def _begun(folder: Path) -> Iterator[Path]:
    """Yield the nights in `folder` whose controller is at work, or died: one that ends takes its name off its lock."""
    return (lock.parent for lock in folder.glob(f"*/{LOCK_NAME}") if lock.stat().st_size)


class WatchdogBeside(Progress):
    """Starts `hil watchdog` for a night once there is something to watch; it outlives the terminal and the controller.

    One that ends before the night does is started anew, at once. What it says goes into watchdog.log in
    the night's folder.
    """

    def __init__(self, folder: Path, clock: Clock | None = None) -> None:
        self._folder = folder
        self._clock = clock or SystemClock()
        self._started: subprocess.Popen[bytes] | None = None
        self._started_s = 0.0

    def sweep_began(self, plan: Plan, done: frozenset[str]) -> None:  # noqa: ARG002 - an onlooker's
        self._start()

    def update(self, snapshot: Snapshot) -> None:  # noqa: ARG002 - an onlooker's
        """Look whether it lives: nobody else would miss it before it is needed."""
        if self._started is None or self._clock.now() - self._started_s < _ANEW_S:
            return
        if self._started.poll() is not None:
            _say(f"warning: the watchdog has ended (status {self._started.returncode}); another one is started")
            self._start()

    def _start(self) -> None:
        self._started_s = self._clock.now()
        command = [sys.executable, "-m", "hil", "watchdog", str(self._folder.resolve())]
        try:
            with (self._folder / "watchdog.log").open("ab") as log:
                self._started = subprocess.Popen(  # noqa: S603 - our own program, and no shell
                    command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True
                )
        except OSError as error:
            _say(f"warning: no watchdog could be started ({error.strerror}); start it with hil watchdog {self._folder}")


def _say(what: str) -> None:
    with suppress(OSError):  # a closed terminal must not end the watch
        messages().print(what)
