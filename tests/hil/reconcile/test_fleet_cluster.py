"""A fleet screened by the workers of a Dask cluster: the same to the digit, whoever is killed or of another version."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from importlib import import_module
from pathlib import Path
from time import sleep
from typing import Any

import numpy as np
import pytest

from hil.campaign.writer import write_campaign
from hil.cli.app import run
from hil.reconcile.campaigns import screen_folders
from hil.reconcile.outcome.fleet import fleet_document
from tests.hil.reconcile.fleet_units import MODEL, SHORT
from tests.hil.reconcile.hidden_effects import base_rates, both, campaign_of, noise


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three units, one with a fault, and one that is no campaign."""
    folder = tmp_path_factory.mktemp("fleet")
    for i in range(3):
        effect = both(SHORT.supply - 28.0, 20.0 * (i == 1), -20.0 * (i == 1))
        made = campaign_of(SHORT, base_rates(SHORT) + noise(SHORT, np.random.default_rng(i)) + effect)
        write_campaign(made, folder / f"u{i}")
    (folder / "x-broken").mkdir()
    (folder / "x-broken" / "campaign.yaml").write_text("schema: nonsense\n")
    return folder


@pytest.fixture(scope="module")
def alone(folder: Path) -> dict[str, Any]:
    """What one process says of them."""
    document = fleet_document(screen_folders([folder], "matrix-6-thermal"))
    assert [each["folder"][-2:] for each in document["units"] if each["worth"]] == ["u1"]
    return document


@pytest.mark.slow(seconds=22)
def test_on_a_dask_cluster_too_though_a_worker_is_killed(folder: Path, alone: dict[str, Any]) -> None:
    """A scheduler and two workers as processes, one of them killed at work: the same document as alone."""
    distributed = pytest.importorskip("distributed", reason="distributed is not installed: hil[cluster]")
    with (
        distributed.LocalCluster(2, threads_per_worker=1, processes=True, dashboard_address=":0") as cluster,
        ThreadPoolExecutor(1) as thread,
        distributed.Client(cluster) as client,
    ):
        asked = thread.submit(screen_folders, [folder], "matrix-6-thermal", cluster=cluster.scheduler_address)
        pid = next(iter(client.run(os.getpid).values()))
        while not any(client.processing().values()) and not asked.done():
            sleep(0.005)  # it is the workers' turn
        os.kill(pid, signal.SIGKILL)
        assert fleet_document(asked.result(120.0)) == alone


@pytest.mark.slow(seconds=15)
def test_a_worker_of_another_version_takes_no_part_and_that_is_said(
    folder: Path, alone: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A process whose hil is of another version beside one of this: whole, to the digit; with it alone, refused."""
    pytest.importorskip("distributed", reason="distributed is not installed: hil[cluster]")
    other = tmp_path / "hil-99.dist-info"
    other.mkdir()
    (other / "METADATA").write_text("Metadata-Version: 2.1\nName: hil\nVersion: 99\n")
    with ExitStack() as held:
        scheduler = tmp_path / "scheduler.json"

        def started(what: str, *options: str, path: str = "") -> None:
            command = [sys.executable, "-m", "distributed.cli.dask_" + what, "--scheduler-file", str(scheduler)]
            process = subprocess.Popen(
                [*command, "--no-dashboard", "--dashboard-address", ":0", "--host", "127.0.0.1", *options],
                env={**os.environ, "PYTHONPATH": os.pathsep.join([path, *sys.path])},
                stderr=subprocess.DEVNULL,
            )
            held.callback(process.wait, 60.0)
            held.callback(process.terminate)

        started("scheduler", "--port", "0")
        started("worker", "--no-nanny", "--nthreads", "1", path=str(tmp_path))
        client = held.enter_context(distributed_client(scheduler))
        client.wait_for_workers(1, timeout=60.0)
        asked = ["fleet", str(folder), *MODEL, "--cluster", client.scheduler.address]
        assert run(asked) == 2
        assert "has hil 99" in capsys.readouterr().err
        started("worker", "--no-nanny", "--nthreads", "1")
        client.wait_for_workers(2, timeout=60.0)
        assert run([*asked, "--json"]) == 0
        document = json.loads(capsys.readouterr().out)
        (said,) = document.pop("said")
        assert re.fullmatch(r"tcp://.* has hil 99, not \S+ as here, and took no part", said)
        assert document == {name: each for name, each in alone.items() if name != "said"}
        laid_out = client.run(lambda: import_module("hil.reconcile.campaigns")._screen.cache_info().currsize)
        assert {who in said: count > 0 for who, count in laid_out.items()} == {True: False, False: True}
        assert run(asked) == 0
        assert f"warning: {said}" in capsys.readouterr().err


def distributed_client(scheduler: Path) -> Any:
    """Return who asks the cluster, once its scheduler has said where it is."""
    from distributed import Client

    return Client(scheduler_file=str(scheduler), timeout="60s")
