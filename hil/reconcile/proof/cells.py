"""Where simulation and measurement disagree: cells of the campaign, with one error rate for the whole map.

A cell is a set of rows that share a channel and a position, a range of temperatures, a range of runs, or both. Its
score is the estimate of one extra offset in these rows beside the fitted base, over its standard error; the largest
scores that noise alone would give over all cells are simulated, so that a stated q-value holds for the map as a whole.
Cells are taken greedily, each beside those already taken, so that one fault is reported once. This is for a
disagreement to which no effect could be added; where one was added, `places` says where it acts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import ndtr

from hil.campaign import Conditions, FloatArray
from hil.reconcile.result import Disagreement
from hil.reconcile.search.fit import BlockNoise
from hil.solve.identifiability import orthonormal, project_out
from hil.solve.rows import Block

_DRAWS = 1000
_MOST = 12
_LEAST_KEPT = 0.15


@dataclass(frozen=True)
class _Cell:
    block: int
    where: Mapping[str, Any]
    rows: FloatArray
    breadth: int


def disagreements(
    blocks: Sequence[Block],
    noise: Sequence[BlockNoise],
    conditions: Mapping[int, Conditions],
    alpha: float,
    rng: np.random.Generator,
) -> list[Disagreement]:
    """Return the places of disagreement, largest first; none where no cell stands out of the noise."""
    cells = [cell for b, block in enumerate(blocks) for cell in _cells(b, block, conditions[block.sensor])]
    white = [
        (n.whitening @ block.base, n.whitening @ block.y, n.whitening) for block, n in zip(blocks, noise, strict=True)
    ]
    spans = [orthonormal(base) for base, _, _ in white]
    residual = [project_out(span, y) for span, (_, y, _) in zip(spans, white, strict=True)]
    columns = [project_out(spans[c.block], white[c.block][2] @ c.rows) for c in cells]
    kept = [
        float(np.linalg.norm(v)) / max(float(np.linalg.norm(white[c.block][2] @ c.rows)), 1e-12)
        for c, v in zip(cells, columns, strict=True)
    ]
    usable = [i for i, k in enumerate(kept) if k > _LEAST_KEPT]
    if not usable:
        return []
    limit, tests = _largest_by_chance(usable, cells, columns, residual, alpha, rng)
    taken: list[tuple[int, float]] = []
    directions: list[list[FloatArray]] = [[] for _ in blocks]
    while len(taken) < _MOST:
        best, score = _next_cell(usable, cells, columns, residual, directions)
        if best is None or abs(score) < limit:
            break
        taken.append((best, score))
        c = cells[best]
        direction = _less(columns[best], directions[c.block])
        direction = direction / np.linalg.norm(direction)
        directions[c.block].append(direction)
        residual[c.block] = residual[c.block] - direction * float(direction @ residual[c.block])
    return _report(taken, cells, white, tests)


def _report(
    taken: Sequence[tuple[int, float]],
    cells: Sequence[_Cell],
    white: Sequence[tuple[FloatArray, FloatArray, FloatArray]],
    tests: float,
) -> list[Disagreement]:
    """Fit the taken cells of each block together: sizes and errors beside each other and the base."""
    out = []
    for b, (base, y, whitening) in enumerate(white):
        here = [(i, score) for i, score in taken if cells[i].block == b]
        if not here:
            continue
        design = np.hstack([base, whitening @ np.array([cells[i].rows for i, _ in here]).T])
        scale = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
        inverse = np.linalg.pinv(design / scale, rcond=1e-7)
        values, errors = (inverse @ y) / scale, np.linalg.norm(inverse, axis=1) / scale
        for k, (i, score) in enumerate(here):
            place = base.shape[1] + k
            if len(here) > 1 and abs(values[place]) < 2.0 * errors[place]:
                continue  # what it showed is told by the other places
            q = -np.expm1(tests * np.log1p(-min(2.0 * float(ndtr(-abs(score))), 0.999999)))
            out.append(
                (
                    abs(score),
                    Disagreement(
                        cells[i].where, float(values[place]), float(errors[place]), float(min(max(q, 1e-12), 1.0))
                    ),
                )
            )
    return [d for _, d in sorted(out, key=lambda pair: -abs(pair[1].size_deg_per_hr))]


def _largest_by_chance(
    usable: Sequence[int],
    cells: Sequence[_Cell],
    columns: Sequence[FloatArray],
    residual: Sequence[FloatArray],
    alpha: float,
    rng: np.random.Generator,
) -> tuple[float, float]:
    """Return the score that the largest cell exceeds with probability alpha, and the effective number of tests."""
    largest = np.zeros(_DRAWS)
    for b, r in enumerate(residual):
        here = [columns[i] / np.linalg.norm(columns[i]) for i in usable if cells[i].block == b]
        if here:
            draws = rng.standard_normal((len(r), _DRAWS))
            largest = np.maximum(largest, np.abs(np.array(here) @ draws).max(axis=0))
    limit = float(np.quantile(largest, 1.0 - alpha))
    single = 2.0 * float(ndtr(-limit))
    return limit, float(np.log1p(-alpha) / np.log1p(-single))


def _next_cell(
    usable: Sequence[int],
    cells: Sequence[_Cell],
    columns: Sequence[FloatArray],
    residual: Sequence[FloatArray],
    directions: Sequence[Sequence[FloatArray]],
) -> tuple[int | None, float]:
    """The cell with the largest score; of nearly equal ones the broadest, and the one with the smallest offset."""
    best, best_rank, best_score = None, -np.inf, 0.0
    for i in usable:
        b = cells[i].block
        direction = _less(columns[i], directions[b])
        size = float(np.linalg.norm(direction))
        if size < 0.3 * float(np.linalg.norm(columns[i])):
            continue
        score = float(direction @ residual[b]) / size
        rank = abs(score) + 0.05 * cells[i].breadth + 0.2 * size / float(np.linalg.norm(cells[i].rows))
        if rank > best_rank:
            best, best_rank, best_score = i, rank, score
    return best, best_score


def _less(column: FloatArray, directions: Sequence[FloatArray]) -> FloatArray:
    for direction in directions:
        column = column - direction * float(direction @ column)
    return column


def _cells(b: int, block: Block, conditions: Conditions) -> list[_Cell]:
    """Channel × (any position or one) × (any temperature, a contiguous range of setpoints, or of runs)."""
    names = list(conditions.sensor.channels)
    position = conditions.position[block.rows]
    labels = np.unique(position)
    places: list[str | None] = [None, *labels.tolist()] if 1 < len(labels) < 13 else [None]
    out: list[_Cell] = []
    for channel in np.unique(block.channel):
        own = block.channel == channel
        for label in places:
            rows = own if label is None else own & (position == label)
            where: dict[str, Any] = {"sensor": block.sensor, "channel": names[channel]}
            if label is not None:
                where["position"] = label
                out.append(_Cell(b, where, rows.astype(np.float64), 3))
            out += [
                _Cell(b, {**where, **extra}, (rows & mask).astype(np.float64), breadth)
                for extra, mask, breadth in _ranges(block, conditions)
            ]
        if len(labels) >= 13:
            out += [
                _Cell(
                    b,
                    {"sensor": block.sensor, "channel": names[channel], "position": label},
                    (own & (position == label)).astype(np.float64),
                    0,
                )
                for label in labels
            ]
    return [cell for cell in out if cell.rows.sum() > 0]


def _ranges(block: Block, conditions: Conditions) -> list[tuple[dict[str, Any], FloatArray, int]]:
    """Contiguous ranges of setpoints and of runs, each with the rows it covers."""
    out: list[tuple[dict[str, Any], FloatArray, int]] = []
    temperature = conditions.columns.get("temperature_degC")
    numbers = np.unique(block.station)
    if temperature is not None and len(numbers) > 1:
        for i in range(len(numbers)):
            for j in range(i, len(numbers)):
                if j - i + 1 < len(numbers):
                    mask = (block.station >= numbers[i]) & (block.station <= numbers[j])
                    span = temperature[block.rows[mask]]
                    extra = {"temperature_degC": [round(float(span.min()), 1), round(float(span.max()), 1)]}
                    out.append((extra, mask, 2 if j > i else 1))
    runs = np.unique(block.run)
    widths = [w for w in (1, 2, 3, 4, 6, 8, 12, 16) if w < len(runs)]
    for width in widths:
        for start in range(0, len(runs) - width + 1, max(1, width // 3)):
            mask = (block.run >= runs[start]) & (block.run <= runs[start + width - 1])
            labels = list(dict.fromkeys(conditions.run[block.rows[mask]].tolist()))
            out.append(({"runs": labels}, mask, 0))
    return out
