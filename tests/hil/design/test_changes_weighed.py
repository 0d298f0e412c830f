"""A document takes a map of each sensor, and one more for every change that is weighed: no map twice."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from hil.design.visibility import document
from hil.design.visibility.document import visibility_document
from hil.solve.changes import CHANGES, Change
from tests.hil.model.effect_conditions import campaign

ROWS = campaign(temperatures=(20.0,), runs_each=2)
STATED = {2: np.full((len(ROWS), 2), 0.5)}


@pytest.mark.parametrize(
    ("changes", "sigmas", "maps"),
    [
        ((), {}, 1),
        ((), STATED, 1),
        (CHANGES[:2], {}, 3),
        (CHANGES[:2], STATED, 4),  # further rows have no standard errors: before and after are weighed without
    ],
    ids=["planned", "measured", "planned, two changes", "measured, two changes"],
)
def test_what_is_not_asked_for_takes_no_map(
    changes: Sequence[Change], sigmas: Any, maps: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the map alone is wanted, of one sensor it is one; that of a plan is the one from which changes start."""
    made, visibility = [], document.visibility
    monkeypatch.setattr(document, "visibility", lambda *of, **how: made.append(of) or visibility(*of, **how))
    told: Any = visibility_document({2: ROWS}, "a night", sigmas=sigmas, changes=changes)
    assert len(made) == maps
    assert {each["change"] for each in told["changes"]} == {each.name for each in changes}
