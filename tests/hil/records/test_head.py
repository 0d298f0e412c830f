"""The head of a night's chain as its file is read."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from drivers.clock import VirtualClock
from hil.records import SqliteJournal
from hil.records.ledger import HEAD_NAME, read_head
from procedures.plan import Plan


def test_a_head_of_a_night_that_could_not_be_signed_is_still_read(tmp_path: Path) -> None:
    """A hundred bytes, as heads were before signatures; any other length is damage."""
    head, text = tmp_path / HEAD_NAME, f"hil.head/1 7 {'a' * 64}"
    head.write_text(text.ljust(100))
    assert read_head(tmp_path) == (7, "a" * 64)
    head.write_text(text.ljust(120))
    assert read_head(tmp_path) == (0, "damaged")


def test_the_head_is_forced_to_the_disk_with_what_it_then_says(
    new_night: Path, plan: Plan, clock: VirtualClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After a step has begun the last that was synchronised of the head is all of it."""
    synchronised: list[tuple[int, str]] = []
    fdatasync = os.fdatasync

    def watched(descriptor: int) -> None:
        if os.path.samestat(os.fstat(descriptor), (new_night / HEAD_NAME).stat()):
            synchronised.append(read_head(new_night))
        fdatasync(descriptor)

    with SqliteJournal.open(new_night, clock=clock) as journal:
        before = read_head(new_night)
        monkeypatch.setattr(os, "fdatasync", watched)
        journal.begin(plan.steps[0])
        assert synchronised[-1] == read_head(new_night) != before
