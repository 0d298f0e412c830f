"""On other systems, and beside other people's packages: what does not work there says so at once."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from hil.bench.assemble import check_ports
from hil.bench.lock import port_names
from hil.config import load_bench
from hil.errors import InputError
from tests.hil.audit.folders import written
from tests.hil.cli.test_cli_start import GIVEN, OPTIONS  # a bench whose chamber is at COM3

ROOT = Path(__file__).resolve().parents[2]

LIKE_WINDOWS = """
import asyncio, builtins, multiprocessing, os, pkgutil, signal, subprocess, sys, tempfile, uvicorn
OURS, UNIX = ("hil", "drivers", "procedures"), ("fcntl", "termios", "tty", "pty", "pwd", "grp", "resource")
real = builtins.__import__
def imported(name, globals=None, *rest, **named):
    if name in UNIX and (globals or {}).get("__name__", "").partition(".")[0] in OURS:
        raise ImportError(f"Windows has no {name}")
    return real(name, globals, *rest, **named)
builtins.__import__ = imported
for name in "O_DIRECTORY O_NOFOLLOW O_NONBLOCK O_CLOEXEC getuid fchmod pwrite openpty ttyname tcgetpgrp".split():
    delattr(os, name)
for name in "SIGHUP SIGQUIT SIGKILL SIGTSTP SIGTTIN SIGTTOU".split():
    delattr(signal, name)
"""

EVERY_MODULE = """
import hil, drivers, procedures
for top in (hil, drivers, procedures):
    for module in pkgutil.walk_packages(top.__path__, f"{top.__name__}."):
        if ".acceptance." not in module.name and not module.name.endswith("__main__"):
            __import__(module.name)
print("imported")
"""

COMMANDS = """
from hil.cli.app import run
for line in sys.argv[1:]:
    print(f"hil {line}: {run(line.split())}", file=sys.stderr)
"""


def on_windows(code: str, *arguments: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run code in a process in which hil finds nothing that Windows lacks, as far as it can be taken away."""
    command = [sys.executable, "-c", LIKE_WINDOWS + code, *map(str, arguments)]
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run(command, capture_output=True, text=True, check=False, env=env, cwd=cwd)


@pytest.mark.slow
def test_every_module_can_be_imported_without_what_windows_lacks(tmp_path: Path) -> None:
    """No fcntl, no terminals, no signals of terminals."""
    done = on_windows(EVERY_MODULE, cwd=tmp_path)
    assert (done.stdout, done.stderr) == ("imported\n", "")


@pytest.mark.slow
def test_a_campaign_is_solved_and_a_night_refused_in_one_sentence(tmp_path: Path) -> None:
    """What was measured is worked on; what would move something does not begin, and leaves nothing behind."""
    written("short soaks", tmp_path / "campaign")
    done, refused = (
        ("solve campaign", "export campaign a.mat --format mat"),
        (
            "check simulated",
            "run quick --bench simulated --out night",
            "simulate simulated",
        ),
    )
    said = on_windows(COMMANDS, *done, *refused, cwd=tmp_path).stderr.splitlines()
    assert {f"hil {line}: 0" for line in done} <= set(said)
    for line in refused[:2]:
        (ended,) = (at for at, text in enumerate(said) if text == f"hil {line}: 2")
        assert said[ended - 1].startswith("hil: benches are driven and nights carried out on Linux or macOS: ")
    assert "hil: this system has no pseudo-terminals; serve on TCP ports instead: --tcp" in said
    assert {path.name for path in tmp_path.iterdir()} == {"campaign", "a.mat"}


def test_ports_are_called_as_windows_calls_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """COM3 is a port, whatever its letters; it is missing where the machine does not list it."""
    from hil.cli.app import run

    assert run(["init", str(tmp_path / "bench.yaml"), *OPTIONS]) == 0
    bench = load_bench(tmp_path / "bench.yaml")
    assert bench.chamber.port == GIVEN["--chamber-port"] == "COM3"
    with pytest.raises(InputError, match=r"chamber\.port: COM3: there is no such port; .*plug the adapter in"):
        check_ports(bench)
    monkeypatch.setattr("hil.bench.assemble.existing_ports", lambda: ["COM3"])
    check_ports(bench)
    assert port_names("com3") == port_names(r"\\.\COM3") == {"COM3"} != port_names("COM4")


@pytest.mark.parametrize("floor", ["drivers", "procedures"])
def test_somebody_elses_package_is_named(floor: str, tmp_path: Path) -> None:
    """A folder of that name beside the script, or where `python -m hil` is started; one sentence, and what to do."""
    (tmp_path / floor).mkdir()
    (tmp_path / floor / "__init__.py").touch()
    script = tmp_path / "mine.py"
    script.write_text("import hil\n")
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    for command in (["-m", "hil", "--version"], [str(script)]):
        done = subprocess.run(
            [sys.executable, *command], capture_output=True, text=True, check=False, env=env, cwd=tmp_path
        )
        said = done.stderr.strip().splitlines()
        assert f"the package '{floor}' that Python finds is not hil's own ({tmp_path / floor})" in said[-1]
        assert "pipx install hil" in said[-1]
        assert (len(said) == 1) == (command[0] == "-m"), "only a program needs a traceback"
