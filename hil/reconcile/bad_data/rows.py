"""Rows that no model of the unit could explain: glitches, and labels that were exchanged.

Each row, and each collect of all channels together, is judged by its prediction from all other rows under the estimated
noise (externally studentised). What stands out is reported and left out of the search, at most a tenth of the rows.
Where two positions of one run stand out and exchanging their labels mends both, the labels were exchanged: that is a
finding of its own, and it is mended, not left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.special import ndtri, stdtr

from hil.campaign import Campaign, Collects, FloatArray
from hil.reconcile.search.fit import BlockNoise, estimate_noise
from hil.solve.likelihood import NoiseTable
from hil.solve.rows import Block

_SHARE = 0.1
_LEVEL = 0.002  # familywise, of declaring any outlier in clean data
_LEAST_SCORE = 4.5
BEYOND_SCORES = 1e6
_GROSS = 1e4  # times the median departure: no rate of this unit, whatever is missing
_ROUNDING = 1e-9
_ALIKE = 0.99
_LEAST_FREEDOM = 6


def find_outliers(
    blocks: Sequence[Block], tables: Sequence[NoiseTable], rich: Sequence[Sequence[FloatArray]]
) -> list[dict[str, Any]]:
    """Return rows that stand out, strongest first: sensor, row index, channel index, score, size in deg/hr.

    Rows are judged beside a rich model of the means, (N, p), so that a missing effect is not taken for a row's fault.
    """
    out = []
    for block, table, extra in zip(blocks, tables, rich, strict=True):
        flexible = block.with_base(extra[0]) if extra else block
        if len(block.y) - flexible.base.shape[1] < 8:
            flexible = block
        if len(block.y) - flexible.base.shape[1] >= _LEAST_FREEDOM:
            out += _of_block(flexible, block, table)
    return sorted(out, key=lambda o: -abs(o["score"]))


def _of_block(block: Block, plain: Block, table: NoiseTable) -> list[dict[str, Any]]:
    """The outlying rows beside a flexible model of the means; `plain` is the block beside its own base.

    Where a flexible model has hardly more rows than values at a setpoint, all of these stand out alike: the row at
    fault is the one that stands out beside the base, too.
    """
    middle = float(np.median(block.y))
    usual = float(np.median(np.abs(block.y - middle)))
    one_value = usual <= _ROUNDING * max(abs(middle), 1.0)  # of most averages, as coarsely rounded: no measure
    gross = np.abs(block.y - middle) > (np.inf if one_value else _GROSS * usual)
    most = max(1, int(_SHARE * len(block.y)))
    kept = ~gross if 0 < gross.sum() <= most else np.ones(len(block.y), dtype=bool)
    found = [_found(block, int(row), np.inf, float(block.y[row] - middle)) for row in np.flatnonzero(~kept)]
    limit = max(float(-ndtri(_LEVEL / 2 / len(block.y))), _LEAST_SCORE)
    for _ in range(most - len(found)):
        rows = np.flatnonzero(kept)
        less = block.take(kept)
        noise = estimate_noise(less, _on(less, table)) if kept.all() else _reduced(less, table)
        score, size = studentised(less, noise)
        alike = np.flatnonzero(np.abs(score) >= max(limit, _ALIKE * float(np.abs(score).max())))
        if not len(alike):
            break
        beside_base, _ = studentised(plain.take(kept), noise)
        worst = int(alike[np.argmax(np.abs(beside_base[alike]))])
        found.append(_found(block, int(rows[worst]), float(score[worst]), float(size[worst])))
        kept[rows[worst]] = False
    return found


def _found(block: Block, row: int, score: float, size: float) -> dict[str, Any]:
    return {
        "sensor": block.sensor,
        "row": int(block.rows[row]),
        "channel": int(block.channel[row]),
        "score": min(score, BEYOND_SCORES),
        "size_deg_per_hr": size,
    }


def _on(block: Block, table: NoiseTable) -> NoiseTable:
    return table if len(block.y) == table.whitening.shape[1] else NoiseTable.on(block, table.grid)


def _reduced(block: Block, table: NoiseTable) -> BlockNoise:
    return estimate_noise(block, NoiseTable.on(block, table.grid))


def studentised(block: Block, noise: BlockNoise) -> tuple[FloatArray, FloatArray]:
    """Return each row's externally studentised residual (N,), as a normal score, and its size in deg/hr."""
    projector = noise.projector(block.base)
    diagonal = np.clip(np.diagonal(projector), 1e-12, None)
    gradient = projector @ block.y
    size = gradient / diagonal  # the row's departure from its prediction by all others
    squared = gradient**2 / diagonal
    freedom = len(block.y) - block.base.shape[1]
    rss = float(block.y @ gradient)
    seen = diagonal > 1e-3 * np.sum(noise.whitening**2, axis=0)
    scale = np.maximum((rss - squared) / max(freedom - 1, 1), 1e-12)
    t = np.where(seen, gradient / np.sqrt(diagonal) / np.sqrt(scale), 0.0)
    normal = np.sign(t) * -ndtri(np.clip(stdtr(max(freedom - 1, 1), -np.abs(t)), 1e-300, 0.5))
    return normal, size


def left_out(campaign: Campaign, outliers: Sequence[Mapping[str, Any]]) -> Campaign:
    """Return the campaign with the rates of outlying rows empty."""
    sensors = dict(campaign.sensors)
    for number, collects in campaign.sensors.items():
        rates = collects.rates_deg_per_hr.copy()
        for outlier in outliers:
            if outlier["sensor"] == number:
                rates[outlier["row"], outlier["channel"]] = np.nan
        sensors[number] = Collects(collects.conditions, rates, collects.rates_se_deg_per_hr)
    return replace(campaign, sensors=sensors)
