"""What a set of collects can and cannot tell, in words: "BA + GSA is seen, BA - GSA is not".

Each row of the design sees one combination of the parameters. Where the rows do not span every parameter, the
directions left over change no rate at all: no amount of averaging finds them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.campaign import FloatArray

LEAK = 1e-4
"""A parameter counts as known where an unseen combination of size 100 moves it by less than 0.01 deg/hr.

That is the resolution of the report's own runs. Below it a tilt of a tenth of a milliradian would make every bias
unknowable.
"""


@dataclass(frozen=True)
class Observability:
    """One design's verdict.

    `seen` (q, p) holds the combinations that are seen of parameters that are not seen by themselves, `seen_text` the
    same in words; `sentences` has one for each group of entangled parameters.
    """

    seen: FloatArray
    seen_text: tuple[str, ...]
    sentences: tuple[str, ...]


def directions_seen(
    rows: FloatArray, scale: FloatArray, tolerance: float
) -> tuple[FloatArray, NDArray[np.bool_], NDArray[np.bool_]]:
    """Split parameter space by what unweighted rows (..., m, p) see, columns divided by `scale` (..., p).

    Returns orthonormal directions (..., p, p) as rows, which of them are seen (..., p), and which parameters are
    known (..., p). Weights play no part: what can be seen is a matter of orientations, not of noise.
    """
    _, singular, directions = np.linalg.svd(rows / scale[..., None, :], full_matrices=True)
    padded = np.zeros(directions.shape[:-1])
    padded[..., : singular.shape[-1]] = singular
    seen = padded > tolerance * np.maximum(padded[..., :1], np.finfo(np.float64).tiny)
    leak = np.sqrt(np.einsum("...pq,...p->...q", directions**2, (~seen).astype(np.float64)))
    return np.asarray(directions), np.asarray(seen), np.asarray(leak <= LEAK)


def describe(names: Sequence[str], rows: FloatArray, scale: FloatArray, tolerance: float) -> Observability:
    """Put into words what one design (m, p) can and cannot know of the parameters called `names`."""
    directions, seen, known = directions_seen(rows, scale, tolerance)
    blind = directions[~seen]
    mixing = blind.T @ blind
    combinations: list[FloatArray] = []
    texts: list[str] = []
    sentences: list[str] = []
    for group in linked_groups(np.abs(mixing) > LEAK**2, ~known):
        members = [names[j] for j in group]
        unseen_count = round(float(np.trace(mixing[np.ix_(group, group)])))
        visible = _readable(_span(directions[seen][:, group], len(group) - unseen_count) * scale[group])
        hidden = _readable(_span(blind[:, group], unseen_count) / scale[group])
        for row in visible:
            combinations.append(np.zeros(len(names)))
            combinations[-1][group] = row
            texts.append(combination_text(members, row))
        sentences.append(
            _sentence(texts[len(texts) - len(visible) :], [combination_text(members, row) for row in hidden])
        )
    return Observability(np.array(combinations).reshape(-1, len(names)), tuple(texts), tuple(sentences))


def combination_text(names: Sequence[str], coefficients: FloatArray) -> str:
    """Write a combination, (p,), as people do, without terms below a thousandth of the largest.

    >>> combination_text(("BA", "GSA", "GSB"), np.array([1.0, 1e-5, -0.016]))
    'BA - 0.016 GSB'
    """
    text = ""
    for name, value in zip(names, coefficients, strict=True):
        if abs(value) < 1e-3 * np.abs(coefficients).max():
            continue
        size = "" if abs(abs(value) - 1.0) < 5e-4 else f"{abs(value):.3g} "
        sign = (" - " if value < 0 else " + ") if text else ("-" if value < 0 else "")
        text += f"{sign}{size}{name}"
    return text


def _sentence(visible: Sequence[str], hidden: Sequence[str]) -> str:
    plural = "are" if len(hidden) > 1 else "is"
    if not visible:
        return f"{', '.join(hidden)} {plural} not seen"
    return f"{', '.join(visible)} {'are' if len(visible) > 1 else 'is'} seen, {', '.join(hidden)} {plural} not"


def linked_groups(linked: NDArray[np.bool_], entangled: NDArray[np.bool_]) -> list[list[int]]:
    """Gather the entangled of k things into groups that are linked (k, k) to one another, in order of first member."""
    members = np.flatnonzero(entangled)
    if not len(members):
        return []
    from scipy.sparse.csgraph import connected_components  # imported late: few designs have anything entangled

    count, group = connected_components(linked[np.ix_(members, members)], directed=False)
    return [members[group == number].tolist() for number in range(count)]


def _span(rows: FloatArray, count: int) -> FloatArray:
    """Return `count` orthonormal rows that span the given ones."""
    return np.asarray(np.linalg.svd(rows.T @ rows)[2][:count])


def _readable(rows: FloatArray) -> FloatArray:
    """Reduce rows so that each holds one parameter, scaled to 1, that no other row holds."""
    reduced = rows.copy()
    for i in range(len(reduced)):
        pivot = int(np.argmax(np.abs(reduced[i]) > 0.5 * np.abs(reduced[i]).max()))
        reduced[i] /= reduced[i, pivot]
        others = np.arange(len(reduced)) != i
        reduced[others] -= reduced[others, pivot, None] * reduced[i]
    return reduced
