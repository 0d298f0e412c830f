"""Parameters that act on several blocks: what it is worth that they are one number, not one in each.

What the rows say of amplitudes is bounded from below by a normal density, under which each block has of the noise what
these very amplitudes leave probable (variational Bayes: Bishop 2006, 10.1). Apart and together, the bound is the same.
"""

import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from hil.campaign import FloatArray, IntArray
from hil.reconcile.search.set_in_block import CLOSE, SetInBlock


def tied_gain(blocks: Sequence[SetInBlock], without: Sequence[SetInBlock], tied: Sequence[int]) -> float:
    """How much more probable the data are if tied parameters are one number in all blocks, not one in each (log).

    `without` is the set without these: where blocks disagree, the one number is next to nothing, and sizes of others
    and the noise are as if it were not there.
    """
    sizes = [dict(zip(block.members, block.best, strict=True)) for block in blocks]
    others = [
        own | dict(zip(block.members, block.best, strict=True)) for own, block in zip(sizes, without, strict=True)
    ]
    slack = [dict(zip(block.members, block.slack_at_best, strict=True)) for block in blocks]
    left, left_without = ([block.left_free() for block in own] for own in (blocks, without))
    apart = sum(_bound([block], [own], [start], ()) for block, own, start in zip(blocks, sizes, left, strict=True))
    # What other sizes add is in every block's evidence, and once in that of the one number.
    again = sum(sum(of := [own[j] for own in slack if j in own]) - max(of) for j in tied)
    tried = [sorted({own[j] for own in sizes if j in own}) for j in tied]
    starts = [(sizes, left, dict(zip(tied, each, strict=True))) for each in itertools.product(*tried)]
    starts += [(others, left_without, dict.fromkeys(tied, 0))]  # the smallest size
    together = max(_bound(blocks, [own | one for own in of], start, tied) for of, start, one in starts)
    return together - apart - again


def _bound(
    blocks: Sequence[SetInBlock], sizes: Sequence[Mapping[int, int]], left: Sequence[FloatArray], tied: Sequence[int]
) -> float:
    """How probable the blocks' rows are at least (log), with members of some `sizes`, of which those `tied` are one.

    Raised from where the amplitudes leave `left` (t,) of each block.
    """
    keys: dict[tuple[int, ...], int] = {}
    index = [
        np.array([keys.setdefault((j, k) if j in tied else (j, k, b), len(keys)) for j, k in block.owner], np.int64)
        for b, block in enumerate(blocks)
    ]
    mean, deviation, log_weights = np.zeros(len(keys)), np.zeros(len(keys)), {}
    for b, (block, own, size) in enumerate(zip(blocks, index, sizes, strict=True)):
        mean[own], deviation[own] = block.prior(size)
        for j, options in zip(block.members, block.options, strict=True):
            log_weights[(j,) if j in tied else (j, b)] = float(options.log_weights[size[j]])
    return sum(log_weights.values()) + _raised(blocks, index, mean, deviation, left)


def _raised(
    blocks: Sequence[SetInBlock],
    index: Sequence[IntArray],
    mean: FloatArray,
    deviation: FloatArray,
    left: Sequence[FloatArray],
) -> float:
    """Raise the bound by turns: of the amplitudes with this noise, and of the noise that these amplitudes leave."""
    bound, size = -np.inf, len(mean)
    noise = [block.noise_where(own) for block, own in zip(blocks, left, strict=True)]
    while True:
        gram, score = np.eye(size), np.zeros(size)
        for block, own, (_, precision) in zip(blocks, index, noise, strict=True):
            inner = np.tensordot(precision, block.gram, 1)
            gram[own[:, None], own] += inner * (deviation[own][:, None] * deviation[own])
            score[own] += deviation[own] * (precision @ block.score - inner @ mean[own])
        spread = np.linalg.inv(gram)
        far = spread @ score
        at, apart = mean + deviation * far, spread * (deviation[:, None] * deviation)
        squares = at[:, None] * at + apart
        noise = [
            block.noise_where(
                block.beside.rss
                - 2.0 * block.score @ at[own]
                + block.gram.reshape(len(block.gram), -1) @ squares[own[:, None], own].ravel()
            )
            for block, own in zip(blocks, index, strict=True)
        ]
        before, cost = bound, 0.5 * (np.trace(spread) + far @ far - size + np.linalg.slogdet(gram)[1])
        bound = sum(log for log, _ in noise) - float(cost)
        if bound < before + CLOSE:
            return max(bound, before)
