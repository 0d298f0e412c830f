"""What looks the same in these collects as a member of a set, however little it is believed.

What is known before ranks the two, and the data say nothing of it. A search that keeps what is worth something may pass
the other over, and would call the first certain.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise

import numpy as np

from hil.campaign import FloatArray
from hil.reconcile.search.evidence import SEEN
from hil.reconcile.search.sets import SensorSearch, Set
from hil.reconcile.search.terms import IDENTICAL
from hil.solve.identifiability import orthonormal


def lookalikes(search: SensorSearch, chosen: Set) -> dict[int, list[int]]:
    """Return for each effect of a set those that do in every block just what it does beside the base."""
    names = {j: term.name for j, term in enumerate(search.terms) if term.tier == 1}
    if not (own := [j for j in chosen if j in names]):
        return {}
    log_weights = (search.in_block(chosen, b).terms_log + of.points.log_prior for b, of in enumerate(search.blocks))
    return _in_every_block(search, own, names, [int(np.argmax(each)) for each in log_weights])


def names_alike(searches: Iterable[SensorSearch]) -> dict[str, list[str]]:
    """Return by name of one shape, values that stand, those that do just the same in every block of all sensors."""
    alike: dict[str, list[str]] = {}
    for search in searches:
        plain = {j: t.name for j, t in enumerate(search.terms) if t.tier == 1 and t.candidate.form == "constant"}
        many = Counter(plain.values())
        names = {j: name for j, name in plain.items() if many[name] == 1}
        found = _in_every_block(search, [*names], names, [0] * len(search.blocks)) if names else {}
        for j, others in found.items():
            of = [names[k] for k in others]
            alike[names[j]] = [name for name in alike.get(names[j], of) if name in of]
    return {name: others for name, others in alike.items() if others}


def _in_every_block(
    search: SensorSearch, own: Sequence[int], names: Mapping[int, str], at: Sequence[int]
) -> dict[int, list[int]]:
    """Return for each of its `own` terms those of other names that are alike in every block, at a point of each."""
    alike = {j: [k for k, name in names.items() if name != names[j]] for j in own}
    for b, (block, point) in enumerate(zip(search.blocks, at, strict=True)):
        laid = [(j, part.columns) for j in names if (part := search.terms[j].parts[b]) is not None]
        columns = np.hstack([np.zeros((len(block.y), 0)), *(columns for _, columns in laid)])
        white = block.projected(columns, np.array([point]))[0]
        ends = np.cumsum([0, *(columns.shape[1] for _, columns in laid)])
        left = {j: white[:, first:end] for (j, _), (first, end) in zip(laid, pairwise(ends), strict=True)}
        alike = {j: _alike(left, j, others) for j, others in alike.items()}
    return alike


def exchanged(sets: Sequence[Set], alike: Mapping[int, Sequence[int]]) -> list[Set]:
    """Return sets with one of their members exchanged, each for each that is alike."""
    return [tuple(sorted({*chosen, k} - {j})) for chosen in sets for j in chosen for k in alike.get(j, ())]


def _alike(left: dict[int, FloatArray], own: int, others: Sequence[int]) -> list[int]:
    """Return those of some terms of which a block shows just what it does of `own`; what it shows nothing of is alike.

    `left` (N, q) is what the base leaves of each that shows.
    """
    if own not in left:
        return [k for k in others if k not in left]
    basis, out = orthonormal(left[own], SEEN), []
    for k in (k for k in others if k in left):
        other = orthonormal(left[k], SEEN)
        same = other.shape[1] == basis.shape[1] > 0
        if same and np.linalg.svd(basis.T @ other, compute_uv=False).min() > IDENTICAL:
            out.append(k)
    return out
