"""What several commands search for, searched for once."""

from __future__ import annotations

import pickle
from typing import Any

import pytest

from hil.campaign import Campaign
from hil.reconcile import scattering, workflow
from hil.reconcile.outcome.answer import Answer


@pytest.fixture
def searched_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Search once where `hil scatter` and `hil reconcile` ask the same of the same rows, to the last bit.

    What else they ask is searched for by itself; what each makes of an answer is its own.
    """
    searched, answers = workflow.searched, dict[bytes, Answer]()

    def once(campaign: Campaign, *asked: Any, prove: bool = True) -> Answer:
        question = pickle.dumps((campaign, asked, prove))
        if question not in answers:
            answers[question] = searched(campaign, *asked, prove=prove)
        return answers[question]

    for module in (workflow, scattering):
        monkeypatch.setattr(module, "searched", once)
