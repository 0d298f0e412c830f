"""Shared by all tests: the reference material where it stands beside the checkout, and one hypothesis profile."""

from __future__ import annotations

import gc
import os
import shutil
import signal
from contextlib import suppress
from importlib import import_module
from pathlib import Path

import pytest
from hypothesis import settings

# Before anything imports numpy, as the command line does: each worker has one core, and more threads only wait in turn.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

settings.register_profile("hil", deadline=None, derandomize=bool(os.environ.get("CI")))
settings.load_profile("hil")

# A script that starts the tests in the background hands them signals that are ignored, and so to all that they start.
for _number in (signal.SIGINT, signal.SIGQUIT, signal.SIGHUP):
    if signal.getsignal(_number) is signal.SIG_IGN:
        signal.signal(_number, signal.default_int_handler if _number == signal.SIGINT else signal.SIG_DFL)

_MEMORY = Path("/dev/shm")  # noqa: S108 - a folder in memory
_ENOUGH = 4e9  # bytes; all tests write a tenth of it
if os.access(_MEMORY, os.W_OK) and shutil.disk_usage(_MEMORY).free > _ENOUGH:
    # A night says after each step that it is on the disk: waiting for that is a third of its time, and shows nothing.
    os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", str(_MEMORY))

_SHARED = Path(__file__).resolve().parents[2] / "shared"


gc.disable()  # through the collection, which only makes what stays


def pytest_sessionstart(session: pytest.Session) -> None:
    """Let each of several workers begin with its own share of the test modules, so that each is compiled once.

    All workers import all of them in the same order: on a fresh clone each would compile every one at the same time.
    """
    worker = getattr(session.config, "workerinput", None)
    if worker is None or session.config.args_source is not pytest.Config.ArgsSource.TESTPATHS:
        return
    tests = Path(__file__).resolve().parent
    mine = int(worker["workerid"].removeprefix("gw"))
    for path in sorted(tests.rglob("test_*.py"))[mine :: worker["workercount"]]:
        with suppress(Exception, pytest.skip.Exception):  # collecting the module says it
            import_module(".".join(path.relative_to(tests.parent).with_suffix("").parts))


@pytest.hookimpl(trylast=True)  # after the order was shuffled
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the longest, so that none of them is under way alone when all others are done."""

    def seconds(item: pytest.Item) -> float:
        mark = item.get_closest_marker("slow")
        return mark.kwargs.get("seconds", 0.0) if mark else 0.0

    items.sort(key=seconds, reverse=True)


def pytest_collection_finish() -> None:
    """Take thousands of collected tests, which stay to the end, out of what is searched for garbage."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)  # a search makes many small arrays, and looking through them is a tenth of it
    gc.enable()


@pytest.fixture(scope="session")
def reference() -> Path:
    """Folder with the report's tables and the golden bytes; the test is skipped where it is absent."""
    folder = _SHARED / "reference"
    if not folder.is_dir():
        pytest.skip("the reference folder (../shared/reference) is not beside this checkout")
    return folder


@pytest.fixture(scope="session")
def reference_data() -> Path:
    """Folder with real measurements by others; the test is skipped where it is absent."""
    folder = Path(os.environ.get("HIL_REFERENCE_DATA", _SHARED / "data"))
    if not folder.is_dir():
        pytest.skip("no reference data: neither ../shared/data nor the folder named by HIL_REFERENCE_DATA exists")
    return folder
