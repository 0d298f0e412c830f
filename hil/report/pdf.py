"""The report as PDF, printed by the browser of this machine; nothing is fetched and nothing is installed for it."""

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from hil.errors import InputError
from hil.files.durable import write_result

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
_PRINTS_WITHIN_S = 120.0


def find_browser() -> Path:
    """Return the browser that prints; raise `InputError` where this machine has none."""
    found = next(filter(None, map(shutil.which, BROWSERS)), None)
    if found is None:
        raise InputError(
            f"--pdf: no browser is on this machine that could print it ({', '.join(BROWSERS)}); on Debian: apt-get "
            "install chromium. The report itself needs none: leave --pdf out, and print it from any browser"
        )
    return Path(found)


def write_pdf(page: Path, path: Path) -> None:
    """Print the HTML file `page` as the PDF `path`; raise `InputError` where the browser cannot."""
    browser = find_browser()
    with tempfile.TemporaryDirectory(prefix="hil-") as folder:
        made = Path(folder) / "report.pdf"
        command = [
            str(browser),
            "--headless",
            "--disable-gpu",
            "--no-first-run",
            "--host-resolver-rules=MAP * ~NOTFOUND",  # the page asks the network for nothing, nor shall the browser
            "--no-pdf-header-footer",
            f"--user-data-dir={folder}/profile",
            f"--print-to-pdf={made}",
            *(["--no-sandbox"] if os.geteuid() == 0 else []),  # root has no sandbox; the page has no script
            page.resolve().as_uri(),
        ]
        try:
            ended = subprocess.run(command, capture_output=True, text=True, timeout=_PRINTS_WITHIN_S, check=False)  # noqa: S603 - a list, no shell
        except subprocess.TimeoutExpired:
            raise InputError(f"{path}: {browser.name} did not print it within {_PRINTS_WITHIN_S:.0f} s") from None
        if not made.is_file():
            last = (ended.stderr.strip().splitlines() or ["it says nothing"])[-1]
            raise InputError(f"{path}: {browser.name} could not print it: {last}")
        write_result(path, made.read_bytes())
