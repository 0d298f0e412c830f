"""A matrix of cases whose quick part shows every pair of values; the rest of it is slow."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from itertools import combinations
from typing import Any

import pytest


def every_pair(cases: Sequence[tuple[Hashable, ...]]) -> list[Any]:
    """Return all cases for `parametrize`: quick are the first that together hold every pair of values of two columns.

    They are chosen along the diagonals of the matrix, where few of them hold many pairs; always the same.
    """
    columns = [
        {value: place for place, value in enumerate(dict.fromkeys(column))} for column in zip(*cases, strict=True)
    ]
    diagonals = sorted(cases, key=lambda case: sum(map(dict.__getitem__, columns, case)) % 5)
    seen: set[Any] = set()
    quick = set()
    for case in diagonals:
        pairs = set(combinations(enumerate(case), 2))
        if not pairs <= seen:
            seen |= pairs
            quick.add(case)
    return [pytest.param(*case, marks=() if case in quick else pytest.mark.slow) for case in cases]
