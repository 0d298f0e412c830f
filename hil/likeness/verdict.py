"""Which of several nights is unlike the others: p-values of the first, from numbers that were taken of each alike.

Each number of a night is held against the others' mean and spread (Student's t, so that it is smooth), a part's are
combined by the harmonic mean of their p-values, every question of the same weight in however many places it is asked,
and what comes of it is compared with what comes of every other night in the same way. Were the first night simulated
too, each would be as likely to be the most unlike: its rank is exact whatever the numbers depend on. Beyond the most
unlike draw the p-value is in proportion: of independent p-values the ratio of the smallest to the next is uniform.
"""

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.special import stdtr

from hil.campaign import FloatArray
from hil.likeness.features import NORMAL, PARTS, RESOLUTION

SMALLEST = 1e-6
"""Below it a p-value is not said: so few draws cannot vouch for it."""


def verdict(nights: Sequence[Mapping[str, float]], coarse: float = 1.0) -> dict[str, Any]:
    """Return `p_value`, `parts` and `places` of the first night among others that are alike, for hil.twin/1.

    Conditions may differ by `coarse` times their resolution. All are corrected together: `p_value` is the smallest of
    its parts', each compared with the smallest of a draw's. Where a channel stands at a position, and at a temperature
    where any is known, its place has the size of what the fitted form leaves there: the first night's, the least and
    the largest of others.
    """
    keys = sorted(set(nights[0]).intersection(*nights[1:]))
    values = np.array([[night[key] for key in keys] for night in nights])
    told = [json.loads(key) for key in keys]
    floor = np.array([coarse * RESOLUTION.get(name.split("_")[-1], 0.01 / coarse) for _, _, name in told])
    chances = unlike(values, floor)
    asked = [(part, name) for part, _, name in told]
    weight = 1.0 / np.array([asked.count(each) for each in asked])
    p_parts = corrected(chances, weight, [part for part, _, _ in told])
    p_places = corrected(chances, weight, [json.dumps(where) for _, where, _ in told])
    where = [{"where": json.loads(name), "p_value": p} for name, p in p_places.items()]
    sizes = {json.dumps(at): k for k, (part, at, name) in enumerate(told) if (part, name) == ("run_scatter", "size")}
    finest = {"temperature_degC", "position"} & {name for _, at, _ in told for name in at}
    for place in where:
        column = sizes.get(json.dumps(place["where"]))
        if column is not None and finest <= place["where"].keys():
            measured, *drawn = (values[:, column] ** (1.0 / NORMAL)).tolist()
            place["measured_deg_per_hr"] = measured
            place["simulated_deg_per_hr"] = [min(drawn), max(drawn)]
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


def corrected(chances: FloatArray, weight: FloatArray, groups: Sequence[str]) -> dict[str, float]:
    """Return the first night's p-value by group, from p-values (n, k), weights (k,) and the k names of their groups.

    A group's is the harmonic mean of its own, put among the smallest of any group that each other night has.
    """
    names, own = list(dict.fromkeys(groups)), np.array(groups)
    score = np.stack([weight[own == g].sum() / np.sum((weight / chances)[:, own == g], axis=1) for g in names])
    smallest = np.sort(score[:, 1:].min(axis=0))
    rank = np.searchsorted(smallest, score[:, 0])
    placed = (rank + np.where(rank > 0, 1.0, score[:, 0] / smallest[0])) / (len(smallest) + 1)
    return dict(zip(names, np.maximum(placed, SMALLEST).tolist(), strict=True))
