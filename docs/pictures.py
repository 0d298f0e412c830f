"""Makes pictures of the report, the reconciliation and the plots in docs/pictures, from the product itself.

    .venv/bin/python docs/pictures.py

The published night runs on the simulated bench, twice with different noise; the pictures are what a browser then shows.
Needs Chromium and the dev extra.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from pathlib import Path

from playwright.sync_api import Browser, sync_playwright

from hil.cli.app import run as hil
from hil.files.strict import find_config

PICTURES = Path(__file__).parent / "pictures"
PLOTS = (
    ("series", "--sensor", "2", "--run", "7", "--position", "3"),
    ("temperatures",),
    ("parameters", "--sensor", "2"),
    ("allan", "--sensor", "2", "--channel", "RA"),
)


def main() -> None:
    """Run the nights, write what is to be seen of them, and take the pictures."""
    PICTURES.mkdir(exist_ok=True)
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        sys.exit("pictures: there is no Chromium on this machine (Debian: apt-get install chromium)")
    with tempfile.TemporaryDirectory() as made, sync_playwright() as driver:
        folder = Path(made)
        night, earlier, found = folder / "night", folder / "earlier", folder / "found"
        other = folder / "other.yaml"
        other.write_text(find_config("benches", "simulated").read_text().replace("seed: 861", "seed: 77"))
        _done("run", "rd-gc-86-1", "--bench", "simulated", "--out", night, "--quiet")
        _done("run", "rd-gc-86-1", "--bench", other, "--out", earlier, "--quiet")
        _done("report", night, "--against", earlier)
        _done("reconcile", night, "--model", "collins-4", "--out", found)
        for kind, *options in PLOTS:
            _done("plot", kind, night, *options, "--out", PICTURES / f"plot-{kind}.png")
        chromium = driver.chromium.launch(executable_path=browser, args=["--no-sandbox"] if os.geteuid() == 0 else [])
        _take(chromium, night / "report.html", "report.png")
        _take(chromium, night / "report.html", "report-phone.png", width=390)
        _take(chromium, night / "report.html", "report-night.png", at="#night")
        _take(chromium, next(found.glob("*.html")), "reconciliation.png")
        chromium.close()


def _done(*arguments: object) -> None:
    status = hil([str(each) for each in arguments])
    if status != 0:
        sys.exit(f"pictures: hil {arguments[0]} ended with status {status}")


def _take(browser: Browser, page: Path, name: str, *, width: int = 1200, at: str | None = None) -> None:
    context = browser.new_context(viewport={"width": width, "height": 1000})
    tab = context.new_page()
    tab.goto(page.as_uri())
    if at is not None:
        tab.locator(at).evaluate("each => each.scrollIntoView()")
    tab.screenshot(path=PICTURES / name)
    context.close()


if __name__ == "__main__":
    main()
