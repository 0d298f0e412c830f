"""The same commands on live ports: `hil simulate` in one process, `hil run` through pyserial in another."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from hil.config import load_bench
from hil.simulate import client_bench


@pytest.fixture
def ports() -> Iterator[dict[str, str]]:
    """A simulated unit and chamber on pseudo-terminals, served by a process of their own."""
    server = subprocess.Popen([sys.executable, "-m", "hil", "simulate", "simulated"], stdout=subprocess.PIPE, text=True)
    assert server.stdout is not None
    try:
        yield dict(json.loads(server.stdout.readline())["ports"])
    finally:
        server.send_signal(signal.SIGTERM)
        server.wait(10)
        server.stdout.close()


@pytest.mark.timeout(180)  # real seconds: a chamber's own pacing, on a machine that may be busy
def test_a_sweep_runs_through_real_ports(hil_process: Any, hil: Any, ports: dict[str, str], tmp_path: Path) -> None:
    """Real bytes, real pyserial, the system clock: a shortened sweep becomes a complete night that verifies."""
    bench = tmp_path / "bench.yaml"
    bench.write_text(client_bench(load_bench("simulated"), ports).text)
    night = tmp_path / "night"
    ended = hil_process("run", "quick", "--bench", bench, "--out", night, "--yes")
    assert ended.returncode == 0, ended.stderr
    assert json.loads(hil("verify", night, "--json").stdout)["complete"] is True
    solutions = json.loads(hil("solve", night, "--json").stdout)["solutions"]
    assert {each["sensor"] for each in solutions} == {1, 2}
    for solution in solutions:
        assert solution["parameters"]["BA"]["se"] > 0.0
    assert json.loads(hil("status", night, "--json").stdout)["simulated"] is True
