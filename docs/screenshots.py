"""Makes the pictures of the pages in docs/images; needs Chromium and the dev extra.

    .venv/bin/python docs/screenshots.py [FOLDER]

A simulated night runs at speed beside one that waits for its operator, the recommended sweep is held against the
contractor's model, four units share a chamber, a unit has a life and a fleet some faults; the pictures are what a
browser then shows.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from PIL import Image
from playwright.sync_api import Browser, sync_playwright

from hil.campaign import Campaign
from hil.campaign.writer import write_campaign
from hil.files.strict import find_config
from hil.records.export import campaign_of_night

IMAGES = Path(__file__).parent / "images"
COLOURS = 64  # enough for a page of few colours, and a third of the size
SWEEP: dict[str, Any] = {
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
            for name, (page, at) in _pages(folder).items():
                _take(browser, f"{page.as_uri()}{at}", "() => true", images / f"{name}.png", (1280, 800), "light")
            browser.close()
        finally:
            for process in processes:
                process.kill()
                process.wait()


def _pages(folder: Path) -> dict[str, tuple[Path, str]]:
    """Write every page that is a file, and return it by its picture's name, with the place on it."""
    night, four, found, archive = (folder / name for name in ("recommended", "four", "found", "archive"))
    _hil("run", "recommended", "--bench", "simulated", "--out", night, "--quiet", stdout=subprocess.DEVNULL).wait()
    measured = campaign_of_night(night)
    rates = {n: rows.conditions.w_channels_deg_per_hr for n, rows in measured.sensors.items()}
    plain = replace(measured, sensors={n: replace(of, rates_deg_per_hr=rates[n]) for n, of in measured.sensors.items()})
    short = folder / "short.yaml"
    short.write_text(
        yaml.safe_dump({**SWEEP, "collect": {**SWEEP["collect"], "duration": "60 s"}, "title": "Four units"})
    )
    # A unit that drifts by 0.8 deg/hr a month, and whose bias jumped in its fourth year; of a fleet every ninth jumps.
    life = [
        _changed(
            measured,
            folder / f"life-{k}",
            k,
            "0042",
            date(2021 + k // 2, 1 + k % 2 * 6, 11),
            0.1,
            4.8 * k,
            25.0 * (k > 6),
        )
        for k in range(10)
    ]
    fleet = [
        _changed(plain, folder / f"unit-{k}", k, f"{100 + k}", date(2025, 1 + k % 12, 3), 0.9, 0.0, 8.0 * (k % 9 == 4))
        for k in range(40)
    ]
    for command in (
        ("reconcile", night, "--model", "collins-4", "--out", found),
        ("report", night, "--limits", "rd-gc-86-1"),
        ("certificate", night, "--draft"),
        ("run", short, "--bench", "simulated-four", "--out", four, "--quiet"),
        ("report", four),
        ("archive", archive, *life),
        ("history", "0042", "--archive", archive, "--page", folder / "history.html"),
        ("fleet", *fleet, "--model", "matrix-6-thermal", "--out", folder / "fleet.html"),
    ):
        _hil(*command, stdout=subprocess.DEVNULL).wait()
    return {
        "reconciliation": (found / "reconciliation.html", ""),
        "in-spec": (night / "report.html", "#in-spec"),
        "certificate": (night / "certificate.html", ""),
        "several-units": (four / "report.html", ""),
        "history": (folder / "history.html", ""),
        "fleet": (folder / "fleet.html", ""),
    }


def _changed(
    measured: Campaign, folder: Path, seed: int, serial: str, day: date, noise: float, drifted: float, jump: float
) -> Path:
    """Write a simulated campaign with more noise, and with a bias that drifted, and jumps in the middle."""
    rng, sensors = np.random.default_rng(seed), {}
    for number, rows in measured.sensors.items():
        late = rows.conditions.run > (0 if drifted else 13)
        more = drifted + jump * late[:, None]
        sensors[number] = replace(
            rows, rates_deg_per_hr=rows.rates_deg_per_hr + more + rng.normal(0.0, noise, (len(rows), 2))
        )
    identity = {"model": "SIMULATED", "serial": serial}
    said = {"title": f"unit {serial}", "source": f"simulated, {day}", "identity": identity}
    return write_campaign(replace(measured, sensors=sensors, recorded={}, **said), folder)


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
