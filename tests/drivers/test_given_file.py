"""What is no file of a bearable size is refused in one sentence, without waiting for it and without reading it."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import pytest

from drivers.errors import InputError
from drivers.given_file import LARGER, TEXT_MB, opened, read_bytes, read_text


def no_files(folder: Path) -> dict[str, Path]:
    """Make one of each thing that can stand where a file should; return them by what they are called."""
    paths = {what: folder / what[2:] for what in ("a folder", "a pipe", "a socket", "a device")}
    paths["a folder"].mkdir()
    os.mkfifo(paths["a pipe"])
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(os.path.relpath(paths["a socket"]))
    paths["a device"].symlink_to("/dev/zero")
    return paths


@pytest.mark.timeout(10)
def test_what_is_no_file_is_called_by_its_name_and_not_opened(tmp_path: Path) -> None:
    """A pipe into which nobody writes would keep the program for ever, a device gives bytes without end."""
    for what, path in no_files(tmp_path).items():
        with pytest.raises(InputError) as refusal:
            read_bytes(path)
        assert str(refusal.value) == f"{path}: is {what}, not a file; give the name of a file"


@pytest.mark.timeout(10)
def test_a_file_that_becomes_a_pipe_before_it_is_opened_does_not_keep_us(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is looked at again after it was opened."""
    pipe, stat = tmp_path / "pipe", os.stat
    os.mkfifo(pipe)
    monkeypatch.setattr(os, "stat", lambda path, **more: stat(__file__ if path == pipe else path, **more))
    with pytest.raises(InputError, match="is a pipe"):
        read_bytes(pipe)


def test_a_file_that_is_too_large_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The sentence says how it is read all the same."""
    path = tmp_path / "large.yaml"
    with path.open("wb") as file:
        file.truncate(6_400_000)
    with pytest.raises(InputError) as refusal:
        read_text(path)
    assert str(refusal.value) == (
        f"{path}: it is 6.4 MB, more than the {TEXT_MB} MB that are read of such a file; is it the right one? "
        f"{LARGER}=7 in the environment reads it"
    )
    monkeypatch.setenv(LARGER, "7")
    assert len(read_text(path)) == 6_400_000
    monkeypatch.setenv(LARGER, "7 MB")
    with pytest.raises(InputError, match="'7 MB' is no whole number of MB"):
        read_text(path)


def test_a_file_that_grows_without_end_is_read_up_to_the_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Some say that they are empty: what counts is what comes."""
    path = tmp_path / "growing"
    path.write_bytes(b"x" * 5_000_000)
    empty = os.stat_result((0o100644, 0, 0, 1, 0, 0, 0, 0, 0, 0))
    monkeypatch.setattr(os, "fstat", lambda _: empty)
    with pytest.raises(InputError, match=r"it is at least 4\.0 MB, more than the 4 MB"):
        read_bytes(path)


def test_a_file_that_is_streamed_may_be_of_any_size(tmp_path: Path) -> None:
    """A recording of raw bytes is read piece by piece."""
    path = tmp_path / "night.bin"
    with path.open("wb") as file:
        file.truncate(10**12)
    with opened(path) as file:
        assert file.read(3) == b"\0\0\0"


def test_what_cannot_be_read_says_why(tmp_path: Path) -> None:
    """Missing, beneath a file, or not text; a byte order mark is none of the text."""
    path = tmp_path / "x.yaml"
    with pytest.raises(InputError, match="there is no such file"):
        read_text(path)
    path.write_bytes(b"ab\xff")
    with pytest.raises(InputError, match=r"is not UTF-8 text \(byte 2\)"):
        read_text(path)
    with pytest.raises(InputError, match=r"cannot be read \(Not a directory\)"):
        read_text(path / "y.yaml")
    path.write_bytes(b"\xef\xbb\xbfa: 1\r\n")
    assert read_text(path) == "a: 1\r\n"


def test_a_message_is_cut_at_a_screen() -> None:
    """Its beginning names the file, its end says what to do."""
    said = str(InputError("my.yaml: " + "x" * 100_000 + "; give a shorter one"))
    assert len(said) < 1600
    assert said.startswith("my.yaml: xxx")
    assert said.endswith("xx; give a shorter one")
    assert "more characters" in said
    assert str(InputError("short")) == "short"
