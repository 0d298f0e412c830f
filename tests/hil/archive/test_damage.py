"""What is broken, gone or unreadable in an archive is told, and the rest answers."""

from __future__ import annotations

import errno
import json
import os
import shutil
from pathlib import Path
from typing import Any

import pytest

from hil.archive.folder import _replaced, read_entry, take_up
from hil.archive.history import history
from hil.archive.index import opened_index
from hil.archive.places import ENTRY, INDEX_NAME, found
from hil.archive.taking_in import update
from hil.campaign import Campaign
from hil.campaign.reader import read_campaign
from hil.campaign.writer import write_campaign
from hil.cli.app import run as hil
from hil.errors import InputError
from hil.files.durable import RealDisk
from tests.hil.archive.conftest import COUNT, of_life


@pytest.mark.slow
def test_what_is_broken_gone_or_new_is_told_and_the_rest_answers(
    copy: Path, campaigns: list[Path], measured: Campaign, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A flipped number, a folder that went, one that came beside; an index that is lost or no index at all."""
    first, second, third, *_ = found(copy)[0]
    for number, (old, new) in enumerate(
        {"serial: '0042'": "serial: '0043'", "began_utc: '": "began_utc: 'on "}.items()
    ):
        entry = copy / found(copy)[0][-1 - number] / ENTRY
        entry.write_text((text := entry.read_text()).replace(old, new, 1))
        with pytest.raises(InputError, match=r"another unit's folder|when it was measured"):
            read_entry(copy, f"unit-0042/{entry.parent.name}")
        entry.write_text(text)
    assert hil(["archive", str(copy)]) == 0
    capsys.readouterr()
    table = copy / first / "campaign" / "collects.csv"
    table.write_text(table.read_text().replace("7", "8", 1))
    shutil.rmtree(copy / second)
    (copy / third / ENTRY).write_text("schema: [")
    with opened_index(copy) as index:
        assert [each.partition(":")[0] for each in index.behind("0042")] == [second, first, third]
        assert sum(each["used"] for each in history(index, "0042")["campaigns"]) == COUNT - 1
    assert hil(["archive", str(copy)]) == 4
    assert "not what was taken up (another hash)" in (said := capsys.readouterr().err)
    assert f"{second}: is gone" in said
    assert hil(["history", "0042", "--archive", str(copy)]) == 0
    assert f"{COUNT - 3} calibrations" in capsys.readouterr().out
    assert hil(["units", "--archive", str(copy), "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)["units"]
    assert (row["campaigns"], row["cannot_be_read"]) == (COUNT - 3, 2)
    for spoil in (b"", b"no index at all", None):
        if spoil is None:
            (copy / INDEX_NAME).unlink()
        else:
            (copy / INDEX_NAME).write_bytes(spoil)
        assert hil(["units", "--archive", str(copy)]) == 2
        assert "--rebuild makes it from the folders" in capsys.readouterr().err
        assert hil(["archive", str(copy), "--rebuild"]) == 4
        capsys.readouterr()
        assert hil(["history", "0042", "--archive", str(copy), "--json"]) == 0
        assert len(json.loads(capsys.readouterr().out)["campaigns"]) == COUNT - 3


@pytest.mark.slow
def test_an_entry_that_lost_its_note_is_told_and_taken_up_anew(
    copy: Path, campaigns: list[Path], capsys: pytest.CaptureFixture[str]
) -> None:
    """Its averages are still there; without archived.yaml nobody says of which unit, when, or that they are sound."""
    entry = found(copy)[0][0]
    (copy / entry / ENTRY).unlink()
    assert hil(["archive", str(copy), "--rebuild"]) == 4
    assert f"{entry}: cannot be read" in capsys.readouterr().err
    assert hil(["units", "--archive", str(copy), "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)["units"]
    assert (row["campaigns"], row["cannot_be_read"]) == (COUNT - 1, 1)
    assert hil(["archive", str(copy), *map(str, campaigns)]) == 0
    capsys.readouterr()
    assert hil(["units", "--archive", str(copy), "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)["units"]
    assert (row["campaigns"], row["cannot_be_read"]) == (COUNT, 0)


def test_an_entry_whose_note_lacks_something_is_told_and_tells_no_mean(copy: Path) -> None:
    """Its averages can be solved; but nobody says where they came from, and so it is read whole or not at all."""
    entry = found(copy)[0][0]
    note = copy / entry / ENTRY
    note.write_text(note.read_text().replace("\nfrom: ", "\nwhence: "))
    assert set(update(copy)["cannot_be_read"]) == {entry}
    with opened_index(copy) as index:
        assert entry not in {each.entry for each in index.means("0042")}


@pytest.mark.slow
def test_a_unit_that_cannot_be_looked_into_is_told_and_the_others_answer(
    copy: Path, measured: Campaign, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its entries stay in the index, and are answered from again when it can be; a rebuild goes on without them."""
    take_up(copy, write_campaign(of_life(measured, 1, serial="0043"), tmp_path / "other"))
    update(copy)
    scan = os.scandir

    def closed(path: Path) -> Any:
        if Path(path).name == "unit-0043":
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return scan(path)

    for asked in ([], ["--rebuild"]):
        with monkeypatch.context() as patched:
            patched.setattr("os.scandir", closed)
            capsys.readouterr()
            assert hil(["archive", str(copy), *asked, "--json"]) == 4
            document = json.loads(capsys.readouterr().out)
            assert document["cannot_be_read"] == {"unit-0043": "Permission denied"}
            assert document["gone"] == []
            assert hil(["units", "--archive", str(copy)]) == 0
            assert "unit-0043: cannot be read (Permission denied)" in (said := capsys.readouterr().err)
            assert "is gone" not in said
            assert hil(["history", "0042", "--archive", str(copy)]) == 0
            assert hil(["history", "0043", "--archive", str(copy)]) == 2
        assert hil(["history", "0043", "--archive", str(copy)]) == (2 if asked else 0)
        assert hil(["archive", str(copy)]) == 0
        assert hil(["history", "0043", "--archive", str(copy)]) == 0


def test_what_is_damaged_is_taken_up_anew_and_what_is_sound_never(
    copy: Path, campaigns: list[Path], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """From its source, in one step; what only cannot be read at the moment is left as it is."""
    first = found(copy)[0][0]
    table = copy / first / "campaign" / "collects.csv"
    table.write_text((text := table.read_text()).replace("7", "8", 1))
    with monkeypatch.context() as patched:
        patched.setattr(RealDisk, "rename", lambda *_: (_ for _ in ()).throw(OSError(errno.ENOSPC, "no space")))
        assert hil(["archive", str(copy), str(campaigns[0])]) == 2
    assert table.read_text() != text
    assert hil(["archive", str(copy)]) == 4
    assert "NIGHT_OR_CAMPAIGN takes up anew what is damaged" in capsys.readouterr().err
    assert hil(["archive", str(copy), str(campaigns[0])]) == 0
    assert f"in the place of {first}, which was damaged" in capsys.readouterr().out
    assert table.read_text() == text
    assert sorted(path.name for path in (copy / "unit-0042").iterdir()) == [name[10:] for name in found(copy)[0]]
    inode, known = (copy / first).stat().st_ino, read_campaign(campaigns[0])
    assert not take_up(copy, campaigns[0]).replaces
    with monkeypatch.context() as patched:
        patched.setattr("os.open", lambda *_, **__: (_ for _ in ()).throw(OSError(errno.EIO, "I/O error")))
        with pytest.raises(InputError, match="I/O error"):
            _replaced(copy, first, known, by_night=True)
    assert (copy / first).stat().st_ino == inode
