"""The plugin that ships with hil, as a laboratory's own tests use it: in a pytest of its own."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from hil.bench import LiveBench
from hil.config import load_bench


def _pytest(folder: Path, *arguments: str) -> tuple[int, str]:
    """Run pytest as in a folder that is not this project's; return its exit status and what it said."""
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:randomly", "-W", "error"]
    done = subprocess.run(
        [*command, "--rootdir", str(folder), *arguments], cwd=folder, capture_output=True, text=True, timeout=50
    )
    return done.returncode, done.stdout + done.stderr


def test_a_simulated_bench_is_a_fixture(simulated_bench: LiveBench) -> None:
    """Here and now: an hour passes at once."""
    chamber = simulated_bench.devices.chamber
    chamber.prepare()
    chamber.set_temperature(60.0)
    simulated_bench.devices.clock.sleep(3600.0)
    assert abs(chamber.read().temperature_degC - 60.0) < 0.5
    assert simulated_bench.simulated


@pytest.mark.slow
def test_a_bench_file_is_named_on_the_command_line_and_in_the_header(tmp_path: Path) -> None:
    """Another chamber, the same suite; a laboratory's own test beside it sees the same bench."""
    document = yaml.safe_load(load_bench("simulated").text)
    document["chamber"] |= {
        "driver": "watlow-f4",
        "model": "F4",
        "safe_state": {"action": "hold", "temperature": "23 degC"},
    }
    (tmp_path / "my-bench.yaml").write_text(yaml.safe_dump(document))
    (tmp_path / "test_ours.py").write_text(
        "import pytest\n"
        "@pytest.mark.hardware\n"
        "def test_ours(live_bench):\n"
        "    assert live_bench.devices.chamber.identify().model == 'F4'\n"
    )
    arguments = ["--hil-bench", "my-bench.yaml", "-m", "hardware", "test_ours.py", "--pyargs", "hil.acceptance"]
    status, said = _pytest(tmp_path, *arguments)
    assert (status, "6 passed" in said) == (0, True), said


@pytest.mark.slow
def test_a_chamber_that_lies_fails_the_suite(tmp_path: Path) -> None:
    """A panel that is locked does not take a setpoint: acceptance says no, and names what was refused."""
    document = yaml.safe_load(load_bench("simulated").text)
    document["simulation"]["chamber_faults"] = [{"kind": "panel_lock"}]
    (tmp_path / "my-bench.yaml").write_text(yaml.safe_dump(document))
    status, said = _pytest(tmp_path, "--pyargs", "hil.acceptance", "--hil-bench", "my-bench.yaml")
    assert status == 1
    assert "PROTECT ON" in said


@pytest.mark.slow
def test_a_bench_that_cannot_be_read_is_one_sentence(tmp_path: Path) -> None:
    """No traceback through the fixtures."""
    status, said = _pytest(tmp_path, "--pyargs", "hil.acceptance", "--hil-bench", "nowhere.yaml", "-x")
    assert status != 0
    assert "--hil-bench:" in said
    assert "nowhere" in said
