"""Which of several nights is unlike the others: p-values of the first, from numbers that were taken of each alike.

Each number of a night is held against the others' mean and spread (Student's t, so that it is smooth), a part's are
combined by the harmonic mean of their p-values, every question of the same weight in however many places it is asked,
and what comes of it is compared with what comes of every other night in the same way. Were the first night simulated
too, each would be as likely to be the most unlike: its rank is exact whatever the numbers depend on. Beyond the most
unlike draw the p-value is in proportion: of independent p-values the ratio of the smallest to the next is uniform.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.special import stdtr

from hil.campaign import FloatArray
from hil.likeness.features import PARTS, RESOLUTION

SMALLEST = 1e-6
"""Below it a p-value is not said: so few draws cannot vouch for it."""


def verdict(nights: Sequence[Mapping[str, float]], coarse: float = 1.0) -> dict[str, Any]:
    """Return `p_value`, `parts` and `places` of the first night among others that are alike, for hil.twin/1.

    Conditions may differ by `coarse` times their resolution. All are corrected together: `p_value` is the smallest of
    its parts', each compared with the smallest of a draw's.
    """
    keys = sorted(set(nights[0]).intersection(*nights[1:]))
    values = np.array([[night[key] for key in keys] for night in nights])
    told = [json.loads(key) for key in keys]
    floor = np.array([coarse * RESOLUTION.get(name.split("_")[-1], 0.01 / coarse) for _, _, name in told])
    chances = unlike(values, floor)
    parts = {part: [k for k, each in enumerate(told) if each[0] == part] for part in PARTS}
    places: dict[str, list[int]] = {}
    for k, (_, where, _) in enumerate(told):
        places.setdefault(json.dumps(where), []).append(k)
    asked = [(part, name) for part, _, name in told]
    weight = 1.0 / np.array([asked.count(each) for each in asked])
    of_parts, of_places = (
        {name: combined(chances[:, own], weight[own]) for name, own in groups.items() if own}
        for groups in (parts, places)
    )
    p_parts, p_places = (corrected(each) for each in (of_parts, of_places))
    where = [{"where": json.loads(name), "p_value": p} for name, p in p_places.items()]
    return {
        "p_value": min(p_parts.values()),
        "parts": {part: p_parts.get(part) for part in PARTS},
        "places": sorted(where, key=lambda place: place["p_value"]),
    }


def unlike(values: FloatArray, floor: FloatArray) -> FloatArray:
    """Return how unlike the others each night is in each number, (n, k), as two-sided p-values.

    `values` (n, k), `floor` (k,): by how much nights may always differ.
    """
    others = len(values) - 1
    mean = (values.sum(axis=0) - values) / others
    square = ((values**2).sum(axis=0) - values**2) / others
    spread = np.sqrt(np.maximum(square - mean**2, 0.0) * others / (others - 1) * (1.0 + 1.0 / others) + floor**2)
    return np.asarray(np.maximum(2.0 * stdtr(others - 1, -np.abs(values - mean) / spread), 1e-300))


def combined(chances: FloatArray, weight: FloatArray) -> FloatArray:
    """Return the harmonic mean of p-values over the last axis, (n, k) with weights (k,) to (n,)."""
    return np.asarray(weight.sum() / np.sum(weight / chances, axis=1))


def corrected(chances: Mapping[str, FloatArray]) -> dict[str, float]:
    """Return the first night's p-value by name, each against the smallest that every other night has, (n,) each."""
    smallest = np.sort(np.min([each[1:] for each in chances.values()], axis=0))
    return {name: _placed(float(each[0]), smallest) for name, each in chances.items()}


def _placed(chance: float, others: FloatArray) -> float:
    rank = int(np.searchsorted(others, chance))
    share = 1.0 if rank else chance / others[0]
    return max(float((rank + share) / (len(others) + 1)), SMALLEST)
