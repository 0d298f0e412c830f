"""The pytest plugin that ships with hil: a bench as a fixture, simulated unless a bench file is given.

    pytest -m hardware                                                # on the simulated bench
    pytest --hil-bench my-bench.yaml -m hardware                      # on yours: it moves unit and chamber
    pytest --pyargs hil.acceptance --hil-bench my-bench.yaml          # what hil itself asks of a bench

`live_bench` is the bench of the command line, put together once for the run; whatever happens, the chamber is brought
to its safe state at the end. `simulated_bench` is a new simulated one for each test, on a virtual clock: waiting costs
nothing. A test that may run on hardware is marked `hardware`.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from drivers.positioners.positioner import AskOperator
    from hil.bench import LiveBench
    from hil.config import Bench

SIMULATED = "simulated"


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add `--hil-bench`."""
    parser.getgroup("hil").addoption(
        "--hil-bench",
        default=SIMULATED,
        metavar="BENCH",
        help="the bench that tests marked hardware run on: a bench file, or the name of one that ships with hil "
        "(default: simulated)",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Make the marker known."""
    config.addinivalue_line(
        "markers",
        "hardware: may run on a real bench and move it; on the simulated one unless --hil-bench names another",
    )


def pytest_report_header(config: pytest.Config) -> list[str]:
    """Say which bench it will be, so that nobody moves a real one unawares."""
    name = config.getoption("--hil-bench")
    return [] if name == SIMULATED else [f"hil bench: {name} (tests marked hardware move it)"]


@pytest.fixture(scope="session")
def hil_bench(pytestconfig: pytest.Config) -> Bench:
    """Return the bench file of the command line, read and checked."""
    from hil.config import load_bench
    from hil.errors import InputError

    try:
        return load_bench(pytestconfig.getoption("--hil-bench"))
    except InputError as error:
        raise pytest.UsageError(f"--hil-bench: {error}") from error


@pytest.fixture(scope="session")
def live_bench(hil_bench: Bench, pytestconfig: pytest.Config) -> Iterator[LiveBench]:
    """Return the bench of the command line, open; the chamber is left in its safe state."""
    from hil.bench import build_bench

    ask = _ask_through_pytest(pytestconfig) if hil_bench.imu.positioner == "operator" else None
    with build_bench(hil_bench, ask=ask) as live:
        try:
            yield live
        finally:
            live.devices.chamber.safe_state()


@pytest.fixture
def simulated_bench() -> Iterator[LiveBench]:
    """Return a simulated bench that no other test has used, on a virtual clock."""
    from hil.bench import build_bench
    from hil.config import load_bench

    with build_bench(load_bench(SIMULATED)) as live:
        yield live


def _ask_through_pytest(config: pytest.Config) -> AskOperator:
    """Return what asks the operator on the terminal, past pytest's capture of it."""
    from hil.cli.ask import ask_on_terminal

    def ask(question: str, timeout_s: float) -> bool | None:
        capture = config.pluginmanager.getplugin("capturemanager")
        if capture is None:
            return ask_on_terminal(question, timeout_s)
        with capture.global_and_fixture_disabled():
            return ask_on_terminal(question, timeout_s)

    return ask
