"""Processes that work for another end with it, however it ended."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

_ASKING = """
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from hil.files.processes import processes
from procedures.stop import StopRequest


def draw(place):
    stop = StopRequest()
    with TemporaryDirectory(dir=place) as own, stop.on_signals():  # as a night does
        Path(own, "at work").touch()
        while not stop.requested:
            time.sleep(0.01)


if __name__ == "__main__":
    with processes(2) as mapped:
        drawing = mapped(draw, [sys.argv[1]] * 4)
        while len([*Path(sys.argv[1]).glob("*/at work")]) < 2:
            time.sleep(0.01)
        print("drawing", flush=True)
        next(drawing)
"""


@pytest.mark.slow
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_who_is_stopped_leaves_no_process_behind(how: signal.Signals, tmp_path: Path) -> None:
    """They hold its output open as long as they live: it ends when they have. But killed they leave nothing."""
    script, place = tmp_path / "asking.py", tmp_path / "draws"
    script.write_text(_ASKING, encoding="utf-8")
    place.mkdir()
    asking = subprocess.Popen(
        [sys.executable, str(script), str(place)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert asking.stdout is not None
    assert asking.stdout.readline() == "drawing\n"
    asking.send_signal(how)
    said, told = asking.communicate(timeout=60.0)
    assert said == ""
    if how is not signal.SIGKILL:
        assert ("KeyboardInterrupt: SIGTERM" if how is signal.SIGTERM else "KeyboardInterrupt") in told
        assert "leaked" not in told
        assert "Process" not in told  # none of those that work adds a traceback of its own
        assert [*place.iterdir()] == []


@pytest.mark.parametrize(("told", "given_up"), [("SIGINT", "None"), ("SIGTERM", "Event()")])
def test_a_process_that_works_for_another_leaves_the_keyboard_to_it_and_ends_with_its_pool(
    told: str, given_up: str
) -> None:
    """Ctrl-C goes to all processes of a terminal: one of them answers it, without the tracebacks of the others.

    One that waits for work has nothing to clear up; if it ended so, those that clear up would be told a second time.
    """
    code = (
        "import os, signal, time; from multiprocessing import Event; from hil.files.processes import end_with_parent; "
        f"end_with_parent({given_up}); os.kill(os.getpid(), signal.{told}); print('at work')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("at work\n", "")
