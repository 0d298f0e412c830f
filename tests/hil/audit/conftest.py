"""Commands without what no answer stands in."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from hil.reconcile import campaigns, fleet


@pytest.fixture
def only_answers(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Make nothing in which no answer stands: pictures, and most of the names for which a fleet is screened."""
    monkeypatch.setattr("hil.files.page.drawn", lambda _figure: b"<svg></svg>")
    for of in ("EFFECTS", "VARIANCE_EFFECTS"):
        monkeypatch.setattr(fleet, of, getattr(fleet, of)[:2])
    campaigns._screen.cache_clear()
    yield
    campaigns._screen.cache_clear()
