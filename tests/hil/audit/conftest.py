"""What several commands search for, searched for once."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from typing import Any

import pytest

from hil.campaign import Campaign
from hil.reconcile import campaigns, fleet, scattering, workflow
from hil.reconcile.outcome.answer import Answer
from hil.solve import wrong_rows


@pytest.fixture
def searched_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Search once where commands ask the same of the same rows, to the last bit: what is missing, which rows are wrong.

    What else they ask is searched for by itself; what each makes of an answer is its own.
    """
    searched, answers = workflow.searched, dict[bytes, Answer]()
    found, wrong = wrong_rows._wrong_rows, dict[bytes, Any]()

    def once(campaign: Campaign, *asked: Any, prove: bool = True) -> Answer:
        question = pickle.dumps((campaign, asked, prove))
        if question not in answers:
            answers[question] = searched(campaign, *asked, prove=prove)
        return answers[question]

    def wrong_once(*asked: Any) -> Any:
        if (question := pickle.dumps(asked)) not in wrong:
            wrong[question] = found(*asked)
        return wrong[question]

    for module in (workflow, scattering):
        monkeypatch.setattr(module, "searched", once)
    monkeypatch.setattr(wrong_rows, "_wrong_rows", wrong_once)


@pytest.fixture
def only_answers(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Make nothing in which no answer stands: pictures, and most of the names for which a fleet is screened."""
    monkeypatch.setattr("hil.files.page.drawn", lambda _figure: b"<svg></svg>")
    for of in ("EFFECTS", "VARIANCE_EFFECTS"):
        monkeypatch.setattr(fleet, of, getattr(fleet, of)[:2])
    campaigns._screen.cache_clear()
    yield
    campaigns._screen.cache_clear()
