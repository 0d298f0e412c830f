"""Whatever stands where a file should: one sentence that names it, status 2, nothing written, and soon."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet
import pytest

from hil.files.strict import find_config
from tests.hil.campaign.test_campaign_reader import ROWS, YAML, table
from tests.hil.cli.test_cli_bad_input import refused

pytestmark = pytest.mark.timeout(30)

SERIES = "t_s,RA_deg_per_hr,RB_deg_per_hr\n0,1,2\n1,1,2\n"


@pytest.fixture
def campaign(tmp_path: Path) -> Path:
    """A good campaign folder with one series."""
    folder = tmp_path / "campaign"
    (folder / "series").mkdir(parents=True)
    (folder / "campaign.yaml").write_text(YAML)
    (folder / "collects.csv").write_text(table(*ROWS))
    (folder / "series" / "0001.csv").write_text(SERIES)
    return folder


def pipe(path: Path) -> None:
    """Nobody will ever write into it."""
    os.mkfifo(path)


def endless(path: Path) -> None:
    """A name that leads to bytes without end."""
    path.symlink_to("/dev/zero")


def sparse(path: Path) -> None:
    """More bytes than any memory has."""
    with path.open("wb") as file:
        file.truncate(10**13)


WITH_A_FILE: dict[str, tuple[object, ...]] = {
    "sweep": ("plan", "BAD", "--bench", "simulated"),
    "bench": ("plan", "quick", "--bench", "BAD"),
    "frame description": ("frames", "check", "BAD"),
    "frames of a capture": ("decode", __file__, "--frames", "BAD"),
    "model": ("solve", "CAMPAIGN", "--model", "BAD"),
    "recording": ("allan", "BAD", "--rate", "100", "--unit", "deg/s"),
    "published table": ("audit", "BAD"),
    "table to import": ("import", "BAD", "OUT"),
    "log to import": ("import", "log", "BAD", "OUT"),
    "token": ("dashboard", "CAMPAIGN", "--token-file", "BAD"),
    "capture": ("decode", "BAD", "--frames", "mfs"),
}


@pytest.mark.parametrize("made", [pipe, endless, sparse, Path.mkdir])
@pytest.mark.parametrize("what", WITH_A_FILE)
def test_what_is_no_file_is_not_read(
    hil: Any, campaign: Path, tmp_path: Path, what: str, made: Callable[[Path], None]
) -> None:
    """Wherever a command takes a file; raw bytes of any length are read piece by piece, and so are not tried."""
    if (what, made) == ("capture", sparse):
        return
    bad = tmp_path / "bad.yaml"
    made(bad)
    there = {"BAD": bad, "CAMPAIGN": campaign, "OUT": tmp_path / "out"}
    before = sorted(tmp_path.rglob("*"))
    ended = hil(*(there.get(str(each), each) for each in WITH_A_FILE[what]))
    refused(ended, "bad.yaml", {pipe: "a pipe", endless: "a device", sparse: "10,000,000.0 MB"}.get(made, "folder"))
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize(("made", "kind"), [(pipe, "a pipe"), (endless, "a device"), (sparse, "a file")])
def test_what_is_no_folder_is_said(
    hil: Any, campaign: Path, tmp_path: Path, made: Callable[[Path], None], kind: str
) -> None:
    """Nobody is told that it is not there."""
    bad = tmp_path / "bad"
    made(bad)
    for command in (("solve", bad), ("thermal", bad), ("report", campaign, "--against", bad), ("dashboard", bad)):
        refused(hil(*command), "bad", f"is {kind}, not a folder")


@pytest.mark.parametrize("made", [pipe, endless, sparse, Path.mkdir])
@pytest.mark.parametrize("name", ["campaign.yaml", "collects.csv", "series/0001.csv", "series/0001.parquet"])
def test_what_is_no_file_of_a_campaign_is_not_read(
    hil: Any, campaign: Path, name: str, made: Callable[[Path], None]
) -> None:
    """Nor where a campaign's folder has it."""
    if name.startswith("series"):
        (campaign / "series" / "0001.csv").unlink()
    (campaign / name).unlink(missing_ok=True)
    made(campaign / name)
    refused(hil("solve", campaign), name)


def test_a_pipe_in_place_of_a_nights_files_keeps_nobody_waiting(hil: Any, night: Path, tmp_path: Path) -> None:
    """A block is named as damaged; what is only for onlookers, as if it were not there."""
    copy = tmp_path / "night"
    shutil.copytree(night, copy)
    block = min((copy / "blocks").iterdir())
    for path in (block, copy / "live.json", copy / "live.trace", copy / "controller.lock", copy / "heartbeat.json"):
        path.unlink(missing_ok=True)
        os.mkfifo(path)
    ended = hil("verify", copy)
    assert ended.returncode == 4
    assert f"{block.name}: is a pipe" in ended.stdout + ended.stderr
    assert hil("status", copy).returncode == 4


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_two_columns_of_one_name_in_a_series_are_refused(hil: Any, campaign: Path, kind: str) -> None:
    """Neither can be believed. The same in a recording."""
    path = campaign / "series" / "0001.csv"
    path.write_text("t_s,RA_deg_per_hr,RA_deg_per_hr,RB_deg_per_hr\n0,1,2,3\n1,1,2,3\n")
    if kind == "parquet":
        path.unlink()
        path = path.with_suffix(".parquet")
        columns = [pa.array([0.0, 1.0])] * 4
        names = ["t_s", "RA_deg_per_hr", "RA_deg_per_hr", "RB_deg_per_hr"]
        pa.parquet.write_table(pa.Table.from_arrays(columns, names=names), path)
    refused(hil("solve", campaign), path.name, "row 1: column RA_deg_per_hr stands there twice")
    refused(hil("allan", path), path.name, "row 1: column RA_deg_per_hr stands there twice")


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (f"site: {{latitude_deg: {'9' * 5000}}}", ("line 10, column 22", "999… is no value")),
        ("a: &a [x, x, x]\n" + "\n".join(f"{n}: &{n} [{f'*{o},' * 30}]" for o, n in zip("abcde", "bcdef", strict=True)),
         ("more than 200000 values",)),
        ("# " + "nothing " * 600_000, ("4.8 MB", "HIL_LARGEST_FILE_MB=5")),
        ("k" * 100_000 + ": [", ("line 10",)),
        (f"series: {{block_s: {'x' * 100_000}}}", ("key series.block_s", "must be a number", "xxx…")),
        ("title: \x1b[2J", ("campaign.yaml",)),
    ],
    ids=["digits", "aliases", "comment", "key", "value", "escape"],
)  # fmt: skip
def test_text_that_would_take_all_time_or_all_screen_is_a_sentence(
    hil: Any, campaign: Path, line: str, words: tuple[str, ...]
) -> None:
    """In any YAML: here in a campaign's."""
    with (campaign / "campaign.yaml").open("a") as file:
        file.write(line + "\n")
    ended = hil("solve", campaign)
    refused(ended, "campaign.yaml", *words)
    assert len(ended.stderr) < 1700
    assert "\x1b" not in ended.stderr


def test_a_frame_description_of_aliases_of_aliases_is_refused(hil: Any, tmp_path: Path) -> None:
    """Its fields would be as many as the stars."""
    path = tmp_path / "unit.yaml"
    bomb = "x0: &x0 {type: u8}\n" + "".join(
        f"x{n}: &x{n} {{{', '.join(f'{key}: *x{n - 1}' for key in 'abcdefghij')}}}\n" for n in range(1, 9)
    )
    path.write_text(bomb + find_config("imus", "mfs").read_text())
    refused(hil("frames", "check", path), "unit.yaml, line", "more than 200000 values")


def test_a_name_that_is_too_long_is_bad_input(hil: Any, tmp_path: Path) -> None:
    """The system has no such names, so nobody can have meant one."""
    name = tmp_path / ("n" * 300)
    for command in ("status", "resume", "solve", "report", "verify", "dashboard", "export", "import"):
        refused(hil(command, name, *([tmp_path / "out"] if command in {"export", "import"} else [])), "nnn")
    refused(hil("plan", name.name, "--bench", "simulated"), "nnn")
    refused(hil("run", "quick", "--bench", "simulated", "--out", name), "nnn")
    assert list(tmp_path.iterdir()) == []
