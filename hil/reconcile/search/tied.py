"""Parameters that act on several blocks: what it is worth that they are one number, not one in each."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hil.campaign import FloatArray
from hil.reconcile.search.evidence import Options


@dataclass(frozen=True)
class AtBest:
    """A set in one block at one point of the noise: Gram (k, k), score (k,), owners, and the sizes that are best."""

    gram: FloatArray
    score: FloatArray
    owner: Sequence[tuple[int, int]]
    members: Sequence[int]
    options: Sequence[Options]
    best: Sequence[int]
    slack: Mapping[int, float]

    def prior(self, instead: Mapping[int, int]) -> tuple[dict[int, float], FloatArray, FloatArray]:
        """Return log weight by member, mean (k,) and deviation (k,), with other sizes for some of the members."""
        picked = [(j, own, instead.get(j, o)) for j, own, o in zip(self.members, self.options, self.best, strict=True)]
        mean = np.concatenate([np.zeros(0), *(own.mean[o] for _, own, o in picked)])
        deviation = np.concatenate([np.zeros(0), *(own.deviation[o] for _, own, o in picked)])
        return {j: float(own.log_weights[o]) for j, own, o in picked}, mean, deviation

    def at(self, mean: FloatArray) -> float:
        """Return how much better than none the amplitudes `mean` (k,) explain the data, log."""
        return float(mean @ (self.score - 0.5 * self.gram @ mean))


def tied_gain(blocks: Sequence[AtBest], tied: Sequence[int]) -> float:
    """How much more probable the data are if tied parameters are one number in all blocks, not one in each (log)."""
    apart = 0.0
    for block in blocks:
        weights, mean, deviation = block.prior({})
        apart += block.at(mean) + _gaussian(block.gram, block.score - block.gram @ mean, deviation)
        apart += sum(weights.get(j, 0.0) + block.slack.get(j, 0.0) for j in tied)
    apart -= sum(max(block.slack.get(j, 0.0) for block in blocks) for j in tied)
    tried = [sorted({b.best[b.members.index(j)] for b in blocks if j in b.members}) for j in tied]
    return max(_one_number(blocks, dict(zip(tied, sizes, strict=True))) for sizes in itertools.product(*tried)) - apart


def _one_number(blocks: Sequence[AtBest], sizes: Mapping[int, int]) -> float:
    keys: dict[tuple[int, ...], int] = {}
    for b, block in enumerate(blocks):
        for j, k in block.owner:
            keys.setdefault((j, k) if j in sizes else (j, k, b), len(keys))
    gram, score, deviation = np.zeros((len(keys), len(keys))), np.zeros(len(keys)), np.zeros(len(keys))
    weight: dict[int, float] = {}
    known = 0.0
    for b, block in enumerate(blocks):
        weights, mean, own = block.prior(sizes)
        known += block.at(mean)
        index = np.array([keys[(j, k) if j in sizes else (j, k, b)] for j, k in block.owner], dtype=np.int64)
        if len(index):
            gram[np.ix_(index, index)] += block.gram
            score[index] += block.score - block.gram @ mean
            deviation[index] = own
        weight |= {j: weights[j] for j in sizes if j in weights}
    return known + _gaussian(gram, score, deviation) + sum(weight.values())


def _gaussian(gram: FloatArray, score: FloatArray, deviation: FloatArray) -> float:
    """Log Bayes factor of amplitudes N(0, deviation²) against none, in units of the noise."""
    if not len(score):
        return 0.0
    scaled = np.eye(len(score)) + gram * np.multiply.outer(deviation, deviation)
    factor = np.linalg.cholesky(scaled)
    z = np.linalg.solve(factor, score * deviation)
    return float(0.5 * z @ z - np.sum(np.log(np.diag(factor))))
