"""What the tests of the live page stand on: nights that run at speed in processes of their own, and a dashboard."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
import yaml

from hil.dashboard.access import Access
from hil.dashboard.server import create_app, listen, server
from hil.dashboard.watcher import Watcher
from hil.files.strict import find_config

SWEEP: dict[str, Any] = {
    "title": "A short night",
    "temperatures": ["30 degC", "20 degC"],
    "self_calibrations_per_temperature": 1,
    "positions": [1, 2, 3],
    "restabilisation": {"at_least": "15 min", "ceiling": "4 h", "unit_band": "5 degC", "unit_slope": "2 degC/min"},
    "collect": {"settle": "10 s", "duration": "30 min", "index_timeout": "7 h", "drift_limit": "60 deg/hr/min"},
}
SPEED = 600  # a collect takes 3 s: long enough to be seen by a page that is told once a second
TOKEN = "abcd-efgh-jkmn-pqrs"  # noqa: S105 - of a test


SOON_MS = 20_000
DESKTOP, PHONE = {"width": 1280, "height": 800}, {"width": 390, "height": 844}


def sweep_file(folder: Path, **changes: Any) -> Path:
    """Write a sweep of two temperatures and return its file."""
    path = folder / "sweep.yaml"
    path.write_text(yaml.safe_dump(SWEEP | changes))
    return path


def bench_file(folder: Path, name: str, *, operator: bool = False) -> Path:
    """Write a simulated bench that is looked at every 20 s of the night, and return its file."""
    text = find_config("benches", "simulated").read_text()
    text = text.replace(
        "polling: {interval: 30 s, read_interval: 30 s}", "polling: {interval: 20 s, read_interval: 20 s}"
    )
    text = text.replace("name: simulated", f"name: {name}")
    path = folder / f"{name}.yaml"
    path.write_text(text.replace("positioner: indexing", "positioner: operator") if operator else text)
    return path


def begin_night(folder: Path, sweep: Path, bench: Path, speed: float = SPEED) -> subprocess.Popen[bytes]:
    """Begin a night in the new `folder`; wait for nothing."""
    command = [
        sys.executable,
        "-m",
        "hil",
        "run",
        sweep,
        "--bench",
        bench,
        "--out",
        folder,
        "--speed",
        speed,
        "--quiet",
    ]
    return subprocess.Popen(
        [str(each) for each in command],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def free_port() -> int:
    """Return a port of this machine that nobody listens at."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return int(listener.getsockname()[1])


@dataclass
class Dashboard:
    """`hil dashboard` in a process of its own, which can be ended and begun again at the same address."""

    root: Path
    token_file: Path
    port: int = field(default_factory=free_port)
    process: subprocess.Popen[str] | None = None

    @property
    def url(self) -> str:
        """Where the page is."""
        return f"http://127.0.0.1:{self.port}/"

    def begin(self) -> None:
        """Start it and wait until it listens."""
        options = ["--port", str(self.port), "--token-file", str(self.token_file)]
        self.process = subprocess.Popen(
            [sys.executable, "-m", "hil", "dashboard", str(self.root), *options], stdout=subprocess.PIPE, text=True
        )
        assert self.process.stdout is not None
        assert self.process.stdout.readline().strip() == self.url

    def end(self, again_s: float | None = None) -> int:
        """End it as Ctrl-C does, pressed again and again where `again_s` says how soon; return its exit status."""
        if self.process is None:
            return 0
        self.process.send_signal(signal.SIGINT)
        while again_s is not None and self.process.poll() is None:
            time.sleep(again_s)
            self.process.send_signal(signal.SIGINT)
        status = self.process.wait(20.0)
        assert self.process.stdout is not None
        self.process.stdout.close()
        self.process = None
        return status


@contextmanager
def served(root: Path, access: Access, archive: Path | None = None) -> Iterator[int]:
    """Serve the nights of `root` from a thread of this process by the rules of `access`; give the port."""
    listener = listen("127.0.0.1", 0)
    app = create_app(Watcher(root, archive=archive), access)
    serving = server(app)
    thread = threading.Thread(target=serving.run, kwargs={"sockets": [listener]})
    thread.start()
    try:
        yield listener.getsockname()[1]
    finally:
        serving.should_exit = True
        thread.join(10.0)
        listener.close()
    assert not thread.is_alive()


@dataclass
class Nights:
    """A dashboard over a folder, and the nights that tests begin in it."""

    dashboard: Dashboard
    files: Path
    processes: list[subprocess.Popen[bytes]] = field(default_factory=list)

    def begin(self, name: str, *, operator: bool = False, **changes: Any) -> subprocess.Popen[bytes]:
        """Begin a night called `name` at speed."""
        bench = bench_file(self.files, name, operator=operator)
        speed = changes.pop("speed", None)
        sweep = sweep_file(self.files, **changes)
        process = begin_night(self.dashboard.root / name, sweep, bench, **({"speed": speed} if speed else {}))
        self.processes.append(process)
        return process

    def end(self) -> None:
        """End the nights that go on."""
        while self.processes:
            process = self.processes.pop()
            process.kill()
            process.wait(10.0)


def shown(page: Any, place: str, text: str) -> None:
    """Wait until a place of the page shows a text."""
    page.locator(place, has_text=text).wait_for(state="visible")


def ask(page: Any, button: str, who: str, why: str = "", token: str = TOKEN) -> None:
    """Press a button of the page and answer its dialog."""
    page.locator(f"#{button}").click()
    page.locator("#ask-who").fill(who)
    if why:
        page.locator("#ask-why").fill(why)
    page.locator("#ask-token").fill(token)
    page.locator("#ask-yes").click()


def violations(page: Any) -> list[str]:
    """Return what axe-core finds wrong with what is on the page now, in both colour schemes."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="no axe-core to audit the page with")
    found = []
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        for each in axe.Axe().run(page).response["violations"]:
            found += [f"{scheme}: {each['id']}: {node['html']}: {node['failureSummary']}" for node in each["nodes"]]
    return found
