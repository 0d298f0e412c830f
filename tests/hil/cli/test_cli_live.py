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
import yaml

from hil.config import Bench, load_bench, load_sweep
from tests.hil.twin.serving import client_bench


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    """The simulated bench with a quick index, so that the test is short; simserv is the chamber with least pacing."""
    document = yaml.safe_load(load_bench("simulated").text)
    document["chamber"] |= {"driver": "simserv", "model": ""}
    document["simulation"]["index_time"] = "0.5 s"
    path = tmp_path / "quick-bench.yaml"
    path.write_text(yaml.safe_dump(document))
    return load_bench(path)


@pytest.fixture
def ports(bench: Bench) -> Iterator[dict[str, str]]:
    """A simulated unit and chamber on pseudo-terminals, served by a process of their own."""
    command = [sys.executable, "-m", "hil", "simulate", bench.source]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert server.stdout is not None
    try:
        yield dict(json.loads(server.stdout.readline())["ports"])
    finally:
        server.send_signal(signal.SIGTERM)
        server.wait(10)
        server.stdout.close()


@pytest.mark.slow(seconds=33)
@pytest.mark.timeout(180)  # real seconds: a chamber's own pacing, on a machine that may be busy
def test_a_sweep_runs_through_real_ports(
    hil_process: Any, hil: Any, bench: Bench, ports: dict[str, str], tmp_path: Path
) -> None:
    """Real bytes, real pyserial, the system clock: a shortened sweep becomes a complete night that verifies."""
    client = yaml.safe_load(client_bench(bench, ports).text)
    client["polling"] = {"interval": "1 s", "read_interval": "0.25 s"}
    live = tmp_path / "live.yaml"
    live.write_text(yaml.safe_dump(client))
    sweep = yaml.safe_load(load_sweep("quick").text)
    sweep["restabilisation"] |= {"at_least": "4 s", "window": "4 s", "excursion": "4 s"}
    shortened = tmp_path / "shortened.yaml"
    shortened.write_text(yaml.safe_dump(sweep))
    night = tmp_path / "night"
    ended = hil_process("run", shortened, "--bench", live, "--out", night, "--yes")
    assert ended.returncode == 0, ended.stderr
    assert "restabilised after" in ended.stderr
    assert json.loads(hil("verify", night, "--json").stdout)["complete"] is True
    solutions = json.loads(hil("solve", night, "--json").stdout)["solutions"]
    assert {each["sensor"] for each in solutions} == {1, 2}
    for solution in solutions:
        assert solution["parameters"]["BA"]["se"] > 0.0
    assert json.loads(hil("status", night, "--json").stdout)["simulated"] is True
