"""The head of a night's chain as its file is read."""

from __future__ import annotations

from pathlib import Path

from hil.records.ledger import HEAD_NAME, read_head


def test_a_head_of_a_night_that_could_not_be_signed_is_still_read(tmp_path: Path) -> None:
    """A hundred bytes, as heads were before signatures; any other length is damage."""
    head, text = tmp_path / HEAD_NAME, f"hil.head/1 7 {'a' * 64}"
    head.write_text(text.ljust(100))
    assert read_head(tmp_path) == (7, "a" * 64)
    head.write_text(text.ljust(120))
    assert read_head(tmp_path) == (0, "damaged")
