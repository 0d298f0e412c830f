"""Rows and runs that may be spoiled: what stands there says nothing, and competes with every effect.

Of a year of nights those are asked about that differ most from their neighbours in the same position.
"""

import itertools
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from hil.campaign import BoolArray, Conditions, FloatArray, IntArray
from hil.model.effects.base import Parameter
from hil.reconcile.search.candidates import Candidate
from hil.solve.rows import Block

MANY = 80
"""Places of one sort that are asked about: every row of a night, and of a year of nights those that are odd."""
NEIGHBOURS = 4
"""Rows to either side, in the same position, that say what a row should be."""


def wrong_rows(number: int, blocks: Sequence[Block], conditions: Conditions, named: BoolArray) -> Iterator[Candidate]:
    """Yield one candidate per rate, one per collect, and one per run and block: what is there says nothing.

    Where there are very many, of collects (n,) that are `named` and of those that differ most from their neighbours.
    """
    shape = (len(conditions), len(conditions.sensor.channels))
    odd = _odd(blocks, conditions, named)
    rows = np.unique(np.concatenate([block.rows for block in blocks]))
    for row in sorted(rows[np.argsort(-odd[rows], kind="stable")][:MANY].tolist()):
        several = np.zeros((*shape, shape[1]))
        several[row] = np.eye(shape[1])
        yield _wrong("row", number, several, {"row": float(row)})
        for channel in range(shape[1]):
            yield _wrong("row", number, several[:, :, channel : channel + 1], {"row": float(row), "channel": channel})
    odd_runs = runs_to_ask(blocks, conditions, named, MANY)
    for block in blocks:
        for run in np.unique(block.run[np.isin(conditions.run[block.rows], odd_runs)]).tolist():
            here = np.flatnonzero(block.run == run)
            if not 1 < len(here) < 0.5 * len(block.y):
                continue
            columns = np.zeros((*shape, len(here)))
            columns[block.rows[here], block.channel[here], np.arange(len(here))] = 1.0
            of_block = {"number": float(conditions.run[block.rows[here[0]]]), "channel": float(block.channel[0])}
            yield _wrong("run", number, columns, of_block)


def runs_to_ask(blocks: Sequence[Block], conditions: Conditions, named: BoolArray, most: int) -> IntArray:
    """Return the numbers of at most so many runs (k,): `named` ones, and those that differ most from neighbours."""
    odd, runs = _odd(blocks, conditions, named), np.unique(conditions.run)
    of_run = np.array([odd[conditions.run == run].mean() for run in runs.tolist()])
    return np.asarray(np.sort(runs[np.argsort(-of_run, kind="stable")[:most]]))


def _odd(blocks: Sequence[Block], conditions: Conditions, named: BoolArray) -> FloatArray:
    """How far each collect (n,) is off its neighbours, in the worst of its channels; further than all where `named`."""
    out = np.where(named, np.inf, 0.0)
    for block in blocks:
        np.maximum.at(out, block.rows, _oddness(block, conditions))
    return out


def _oddness(block: Block, conditions: Conditions) -> FloatArray:
    """How far each row (N,) is off the median of its neighbours in the same position, in units of the noise."""
    left = (block.y - block.base @ np.linalg.lstsq(block.base, block.y, rcond=None)[0]) / block.sigma
    out = np.zeros(len(left))
    for channel, position in itertools.product(np.unique(block.channel), np.unique(conditions.position)):
        here = np.flatnonzero((block.channel == channel) & (conditions.position[block.rows] == position))
        padded = np.pad(left[here], NEIGHBOURS, mode="reflect") if len(here) > NEIGHBOURS else left[here]
        if len(here) > NEIGHBOURS:
            around = np.lib.stride_tricks.sliding_window_view(padded, 2 * NEIGHBOURS + 1)
            out[here] = np.abs(left[here] - np.median(around, axis=1))
    return out


def _wrong(name: str, number: int, columns: FloatArray, shape: Mapping[str, float]) -> Candidate:
    parameters = tuple(Parameter(f"off_{k}", "deg/hr", (1.0, 100.0)) for k in range(columns.shape[2]))
    return Candidate(name, 0, number, columns, parameters, shape=shape, title=f"A {name} that is wrong")
