"""Runs that contradict each other, where too few were made for a wrong collect to stand out among its neighbours.

contradicting(collects, {13, 14, 15})   # {14: "runs 13–14 differ by 38 times their standard errors in …"}
"""

from collections.abc import Set
from itertools import combinations, pairwise

import numpy as np

from hil.campaign import Collects
from hil.model.forms import default_form
from hil.solve.identifiability import orthonormal
from hil.solve.neighbours import FAR, place_in_each_run
from hil.solve.temperatures import runs_by_temperature
from procedures.words import numbered

_SOUND = 0.25  # of the pairs that repeat each other, at least
_CHANGED = 0.25  # of its size: more no temperature changes what neither a bias nor MU moves


def contradicting(collects: Collects, runs: Set[int]) -> dict[int, str]:
    """Return those of the `runs` that another, at their temperature or at the next, contradicts; say by how much.

    They differ in what neither a bias nor MU moves; at two temperatures by more than these make. Of two alone nobody
    knows which is wrong; one with which another at its temperature agrees is not.
    """
    differ = []
    conditions, form = collects.conditions, default_form(collects.conditions)
    rates, columns = collects.rates_deg_per_hr - conditions.w_channels_deg_per_hr, form.columns(conditions)
    columns = columns[..., [name.startswith(("B", "MU")) for name in form.names]]
    groups, alike = runs_by_temperature(conditions), place_in_each_run(conditions)
    place = {run: k for k, (_, at) in enumerate(groups) for run in at if run in runs}
    near = [pair for pair in combinations(place, 2) if place[pair[0]] == place[pair[1]]]
    for pair in dict.fromkeys([*near, *pairwise(place)]):
        one, other = (np.flatnonzero(conditions.run == run) for run in pair)
        first, second = np.nonzero(alike[one][:, None] == alike[other])
        one, other = one[first], other[second]
        sigma = np.hypot(*(collects.rates_se_deg_per_hr[rows] for rows in (one, other)))
        sigma = np.where(sigma > 0.0, sigma, np.nan)  # 0 states nothing
        shown = np.stack([rates[one] / sigma, rates[other] / sigma], axis=-1)
        known = np.isfinite(shown).all(axis=-1)
        basis = orthonormal((columns[one] / sigma[..., None])[known])
        left = shown[known] - basis @ (basis.T @ shown[known])
        apart, size = float(np.linalg.norm(left[:, 0] - left[:, 1])), float(np.linalg.norm(left, axis=0).max())
        times = apart / np.sqrt(max(len(left) - basis.shape[1], 1))
        steps = place[pair[1]] - place[pair[0]]
        repeated = not steps and groups[place[pair[0]]][0] is not None
        differ.append((pair, times, repeated, repeated or (steps <= 1 and apart > _CHANGED * size)))
    # Standard errors may be too small: most repeats then differ by as many times as many.
    usual = np.quantile([1.0, *(t for _, t, repeated, _ in differ if repeated)], _SOUND, method="lower")
    out: dict[int, str] = {}
    agree: set[int] = set()
    for pair, times, repeated, told in differ:
        if told and times > FAR * max(usual, 1.0):
            by = f"{times:.0f} times their standard errors in what neither a bias nor MU moves"
            why = f"{numbered('run', pair)} differ by {by}: a collect of one is wrong or exchanged"
            out = dict.fromkeys(pair, why) | out
        elif repeated:
            agree |= set(pair)
    return {run: why for run, why in out.items() if run not in agree}
