"""Processes that draw end with the one that asked for them, however it ended."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

_ASKING = """
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from hil.likeness.draws import end_with_parent

if __name__ == "__main__":
    pool = ProcessPoolExecutor(1, get_context("spawn"), end_with_parent)
    drawing = pool.submit(time.sleep, 600.0)
    while not drawing.running():
        time.sleep(0.01)
    print("drawing", flush=True)
    drawing.result()
"""


@pytest.mark.slow
@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGKILL])
def test_who_is_killed_leaves_no_process_behind(how: signal.Signals, tmp_path: object) -> None:
    """They hold its output open as long as they live: it ends when they have."""
    script = f"{tmp_path}/asking.py"
    with open(script, "w", encoding="utf-8") as file:
        file.write(_ASKING)
    asking = subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, text=True)
    assert asking.stdout is not None
    assert asking.stdout.readline() == "drawing\n"
    asking.send_signal(how)
    assert asking.communicate(timeout=60.0)[0] == ""
