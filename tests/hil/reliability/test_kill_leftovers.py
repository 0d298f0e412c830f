"""What a kill leaves behind, and what becomes of it: unfinished files, unfinished folders, links of terminals."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from drivers.clock import SystemClock
from hil.config import load_bench, parse_bench, parse_sweep
from hil.files.durable import PARTIAL, RealDisk, make_folders
from hil.night import start_night
from hil.records.blocks import BLOCKS, BlockWriter
from procedures.stop import StopRequest
from tests.hil.twin.serving import served

_SWEEP = parse_sweep("title: T\ntemperatures: [23 degC]\nself_calibrations_per_temperature: 1\npositions: [1]\n", "t")


def begun(folder: Path) -> str:
    """Begin a night that somebody stops at once, and return its state."""
    stop = StopRequest()
    stop.request("enough")
    return start_night(folder, _SWEEP, load_bench("simulated"), stop=stop).state


def dead_process() -> int:
    """Return the number of a process that is no more."""
    child = subprocess.Popen([sys.executable, "-c", ""])
    child.wait()
    return child.pid


def test_unfinished_blocks_go_when_the_night_is_carried_on(tmp_path: Path) -> None:
    """A `.partial-` file belongs to nobody once its writer is dead; whole blocks stay, named in the journal or not."""
    (tmp_path / BLOCKS).mkdir()
    for name in (f"{PARTIAL}00003-x-1.raw.zst", f"{PARTIAL}00003-x-1.parquet", "00002-x-1.parquet"):
        (tmp_path / BLOCKS / name).write_bytes(b"x")
    BlockWriter(tmp_path, simulated=True)
    assert [path.name for path in (tmp_path / BLOCKS).iterdir()] == ["00002-x-1.parquet"]


def test_an_unfinished_night_of_a_dead_process_goes_and_that_of_a_living_one_stays(tmp_path: Path) -> None:
    """A second start of the same night clears away what the first, killed while it made the folder, has left."""
    dead, living, other = (tmp_path / f"{PARTIAL}{name}" for name in (f"n-{dead_process()}", "n-1", f"n2-{2**30}"))
    for folder in (dead, living, other):
        (folder / BLOCKS).mkdir(parents=True)
    assert begun(tmp_path / "n") == "aborted"
    assert sorted(tmp_path.iterdir()) == sorted([living, other, tmp_path / "n"])


def test_folders_above_a_night_are_durable_before_it_is_made(tmp_path: Path) -> None:
    """Each new folder's own folder is synchronised; where one cannot be made, none stays."""
    synchronised: list[Path] = []

    class Watched(RealDisk):
        def synchronise_folder(self, folder: Path) -> None:
            synchronised.append(folder)

    made = make_folders(Watched(), tmp_path / "a" / "b")
    assert made == [tmp_path / "a" / "b", tmp_path / "a"]
    assert synchronised == [tmp_path, tmp_path / "a"]
    assert make_folders(Watched(), tmp_path / "a") == []

    class Broken(RealDisk):
        def synchronise_folder(self, folder: Path) -> None:
            if folder.name == "c":
                raise OSError("broken")

    with pytest.raises(OSError, match="broken"):
        make_folders(Broken(), tmp_path / "c" / "d")
    assert not (tmp_path / "c").exists()


@pytest.mark.slow
def test_the_links_of_a_simulation_that_was_killed_are_replaced(tmp_path: Path) -> None:
    """After kill -9 of `hil simulate` its terminals' links lead nowhere; the next one puts its own in their place."""
    text = load_bench("simulated").text.replace("clock: virtual", "clock: system")
    for device in ("imu", "chamber"):
        text = text.replace(f"sim://{device}", str(tmp_path / device))
    (tmp_path / "bench.yaml").write_text(text)
    command = [sys.executable, "-m", "hil", "simulate", str(tmp_path / "bench.yaml")]
    child = subprocess.Popen(command, stdout=subprocess.PIPE)
    assert child.stdout is not None
    child.stdout.readline()
    first = os.readlink(tmp_path / "imu")
    child.send_signal(signal.SIGKILL)
    child.communicate()
    assert (tmp_path / "imu").is_symlink()
    for _ in range(100):  # the terminal goes with the process, a moment later
        if not (tmp_path / "imu").exists():
            break
        SystemClock().sleep(0.02)
    assert not (tmp_path / "imu").exists(), f"{first} is still there"
    with served(parse_bench(text, "bench.yaml")) as simulation:
        assert simulation.ports["imu"] == str(tmp_path / "imu")
        assert (tmp_path / "imu").exists()
    assert not (tmp_path / "imu").is_symlink()
