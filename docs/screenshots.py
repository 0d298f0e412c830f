"""Makes the pictures of the live page and of a reconciliation in docs/images; needs Chromium and the dev extra.

    .venv/bin/python docs/screenshots.py [FOLDER]

A simulated night runs at speed beside one that waits for its operator, and the recommended sweep is held against the
contractor's model; the pictures are what a browser then shows.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import yaml
from PIL import Image
from playwright.sync_api import Browser, sync_playwright

from hil.files.strict import find_config

IMAGES = Path(__file__).parent / "images"
COLOURS = 64  # enough for a page of few colours, and a third of the size
SWEEP = {
    "title": "Three temperatures, unit SIM-0001",
    "temperatures": ["-20 degC", "20 degC", "50 degC"],
    "self_calibrations_per_temperature": 2,
    "positions": [1, 2, 3],
    "restabilisation": {"at_least": "45 min", "ceiling": "4 h"},
    "collect": {"settle": "30 s", "duration": "40 min", "index_timeout": "20 h", "drift_limit": "20 deg/hr/min"},
}
AVERAGING = "() => document.querySelectorAll('#results tr').length > 4 && document.querySelector('.se')?.textContent"


def main(images: Path = IMAGES) -> None:
    """Run the nights and the page, and take the pictures into the folder `images`."""
    images.mkdir(exist_ok=True)
    processes: list[subprocess.Popen[str]] = []
    with tempfile.TemporaryDirectory() as made, sync_playwright() as driver:
        folder = Path(made)
        (folder / "nights").mkdir()
        try:
            processes.append(_night(folder, "bench-1", operator=False))
            processes.append(_night(folder, "bench-2", operator=True))
            processes.append(_hil("dashboard", folder / "nights", "--port", "0", stdout=subprocess.PIPE))
            url = processes[-1].stdout.readline().strip()
            browser = driver.chromium.launch(
                executable_path=shutil.which("chromium") or shutil.which("google-chrome"),
                args=["--no-sandbox"] if os.geteuid() == 0 else [],
            )
            _take(browser, f"{url}#bench-1", AVERAGING, images / "live-page.png", (1280, 800), "light")
            waiting = "() => !document.querySelector('#prompt').hidden"
            _take(browser, f"{url}#bench-2", waiting, images / "live-page-phone.png", (390, 844), "dark")
            night, found = folder / "recommended", folder / "found"
            for command in (
                ("run", "recommended", "--bench", "simulated", "--out", night, "--quiet"),
                ("reconcile", night, "--model", "collins-4", "--out", found),
            ):
                _hil(*command, stdout=subprocess.DEVNULL).wait()
            page = (found / "reconciliation.html").as_uri()
            _take(browser, page, "() => true", images / "reconciliation.png", (1280, 800), "light")
            browser.close()
        finally:
            for process in processes:
                process.kill()
                process.wait()


def _night(folder: Path, name: str, *, operator: bool) -> subprocess.Popen[str]:
    """Begin a simulated night, 900 times as fast as a real one."""
    text = find_config("benches", "simulated").read_text().replace("name: simulated", f"name: {name}")
    bench, sweep = folder / f"{name}.yaml", folder / "sweep.yaml"
    bench.write_text(text.replace("positioner: indexing", "positioner: operator") if operator else text)
    sweep.write_text(yaml.safe_dump(SWEEP))
    out = folder / "nights" / name
    return _hil("run", sweep, "--bench", bench, "--out", out, "--speed", 900, "--quiet", stdout=None)


def _hil(*arguments: object, stdout: int | None) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "hil", *map(str, arguments)]
    return subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=stdout, text=True)  # noqa: S603 - our own


def _take(browser: Browser, url: str, ready: str, path: Path, size: tuple[int, int], scheme: str) -> None:
    viewport = {"width": size[0], "height": size[1]}
    context = browser.new_context(viewport=viewport, color_scheme=scheme)
    page = context.new_page()
    page.goto(url)
    page.wait_for_function(ready, timeout=120_000)
    page.wait_for_timeout(1500)
    page.screenshot(path=path)
    context.close()
    with Image.open(path) as taken:
        taken.convert("RGB").quantize(COLOURS).save(path, optimize=True)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:2]))
