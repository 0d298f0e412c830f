"""A distribution outside the package brings a chamber, an effect, a positioner and frames, as the how-to has them."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[3]
HOW_TO = (ROOT / "docs" / "how-to" / "bring-your-own.md").read_text(encoding="utf-8")
PYTHON, TOML = (re.findall(rf"```{kind}\n(.*?)```", HOW_TO, re.DOTALL) for kind in ("python", "toml"))

_KILN = """
class Kiln:
    temperature, temperature_setpoint = 21.5, 20.0
    def shutdown(self): ...

open_kiln = Kiln
"""


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the how-to's package by its own pyproject.toml, and lay what it builds where it can be found."""
    source, site = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("site")
    package = source / "acme_bench"
    package.mkdir()
    (source / "pyproject.toml").write_text(TOML[0], encoding="utf-8")
    (package / "__init__.py").write_text("\n\n".join([*PYTHON, _KILN]), encoding="utf-8")
    shutil.copy(ROOT / "configs/chambers/binder-mk53.yaml", package / "oven.yaml")
    shutil.copy(ROOT / "configs/imus/mfs.yaml", package / "imu.yaml")
    backend = tomllib.loads(TOML[0])["build-system"]["build-backend"]
    build = [sys.executable, "-c", f"import {backend} as backend; backend.build_wheel('.')"]
    subprocess.run(build, check=True, cwd=source, timeout=60)
    shutil.unpack_archive(next(source.glob("*.whl")), site, "zip")
    return site


def _run(site: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), str(site)])}
    command = [sys.executable, "-m", *arguments]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False, cwd=site, timeout=120)


@pytest.mark.slow
def test_its_effect_is_in_the_catalogue(installed: Path) -> None:
    """With ours, by its own id."""
    done = _run(installed, "hil", "effects")
    assert done.returncode == 0, done.stderr
    assert "acme-humidity" in done.stdout


def _bench(tmp_path: Path, **changes: Any) -> Path:
    document = yaml.safe_load((ROOT / "configs/benches/simulated.yaml").read_text(encoding="utf-8"))
    document["chamber"] |= {"driver": "acme-oven", "model": "", "celsius_confirmed": True}
    document["chamber"] = {key: value for key, value in document["chamber"].items() if key != "terminator"} | changes
    document["chamber"]["safe_state"] = {"action": "hold", "temperature": "25 degC"}
    document["imu"]["description"] = "acme-imu"
    path = tmp_path / "bench.yaml"
    path.write_text(yaml.safe_dump(document), encoding="utf-8")
    return path


@pytest.mark.slow
def test_a_bench_file_may_name_its_chamber_and_its_frames(installed: Path, tmp_path: Path) -> None:
    """And check finds nothing wrong with either."""
    done = _run(installed, "hil", "check", str(_bench(tmp_path)))
    assert "MK53" in done.stdout, done.stdout + done.stderr
    assert done.returncode == 0, done.stdout


@pytest.mark.slow
def test_a_chamber_that_its_library_opens_has_a_port_of_its_own(installed: Path, tmp_path: Path) -> None:
    """The how-to's kiln, put together from a bench file that names no port of ours; a unit has none such."""
    path = _bench(tmp_path, driver="acme-kiln", port="own://kiln")
    path.write_text(path.read_text().replace("clock: virtual", "clock: system"), encoding="utf-8")
    done = _run(installed, "hil", "chamber", str(path), "read")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "21.5" in done.stdout
    path.write_text(path.read_text().replace("sim://imu", "own://imu"), encoding="utf-8")
    assert "ports begin with" in _run(installed, "hil", "chamber", str(path), "read").stderr


@pytest.mark.slow
def test_it_is_held_to_what_ours_must_do(installed: Path) -> None:
    """By the tests that ship; what cannot be stopped must hold, what has no simulator is not tried."""
    done = _run(installed, "pytest", "-q", "-p", "no:cacheprovider", "--pyargs", "hil.acceptance", "-k", "brought")
    assert done.returncode == 0, done.stdout
    assert "4 passed, 3 skipped" in done.stdout


@pytest.mark.slow
def test_what_cannot_be_loaded_is_told_with_its_distribution(installed: Path, tmp_path: Path) -> None:
    """One sentence, no traceback; and nobody else hears of it."""
    broken = tmp_path / "broken-2.0.dist-info"
    broken.mkdir()
    (broken / "METADATA").write_text("Metadata-Version: 2.1\nName: broken\nVersion: 2.0\n", encoding="utf-8")
    (broken / "entry_points.txt").write_text("[hil.chambers]\nsmoke = nowhere:OVEN\n", encoding="utf-8")
    done = _run(tmp_path, "hil", "check", str(_bench(tmp_path, driver="smoke")))
    assert done.returncode == 2
    assert "smoke: broken 2.0 brings it (hil.chambers: nowhere:OVEN), and it cannot be loaded" in done.stderr
    assert "Traceback" not in done.stderr
    assert _run(tmp_path, "hil", "check", "simulated").returncode == 0
