"""Parameters that act on several blocks: what it is worth that they are one number, not one in each.

What the rows say of amplitudes is bounded from below by a normal density, under which each block has of the noise what
these very amplitudes leave probable (variational Bayes: Bishop 2006, 10.1). Apart and together, the bound is the same.
Bounds are raised side by side: one of fewer amplitudes than another is filled up with such as are nothing.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.campaign import FloatArray, IntArray
from hil.reconcile.search.noise import LARGEST
from hil.reconcile.search.set_in_block import CLOSE, SetInBlock

Tied = tuple[Sequence[SetInBlock], Sequence[SetInBlock], Sequence[int]]
"""A set by block, the same without what is tied, and the members that are."""


@dataclass(frozen=True)
class _Start:
    """Where a bound is raised from: amplitudes with `mean` and `deviation` (p,), and what they leave of blocks, (t,).

    `index` (k,) tells which of them each block has.
    """

    blocks: Sequence[SetInBlock]
    index: Sequence[IntArray]
    mean: FloatArray
    deviation: FloatArray
    log_weight: float
    left: Sequence[FloatArray]

    @classmethod
    def of(
        cls,
        blocks: Sequence[SetInBlock],
        sizes: Sequence[Mapping[int, int]],
        left: Sequence[FloatArray],
        tied: Sequence[int] = (),
    ) -> "_Start":
        """Start with members of some `sizes`, of which those `tied` are one."""
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
        return cls(blocks, index, mean, deviation, sum(log_weights.values()), left)


def tied_gains(sets: Sequence[Tied]) -> list[float]:
    """How much more probable the data are if tied parameters are one number in all blocks, not one in each (log).

    Where blocks disagree, the one number is next to nothing, and sizes of others and the noise are as if it were not
    there.
    """
    apart: list[list[_Start]] = []
    together: list[list[_Start]] = []
    again = []
    for blocks, without, tied in sets:
        sizes = [dict(zip(block.members, block.best, strict=True)) for block in blocks]
        others = [
            own | dict(zip(block.members, block.best, strict=True)) for own, block in zip(sizes, without, strict=True)
        ]
        slack = [dict(zip(block.members, block.slack_at_best, strict=True)) for block in blocks]
        left, left_without = ([block.left for block in own] for own in (blocks, without))
        apart.append([_Start.of([block], [own], [of]) for block, own, of in zip(blocks, sizes, left, strict=True)])
        # What other sizes add is in every block's evidence, and once in that of the one number.
        again.append(sum(sum(of := [own[j] for own in slack if j in own]) - max(of) for j in tied))
        tried = [sorted({own[j] for own in sizes if j in own}) for j in tied]
        starts = [(sizes, left, dict(zip(tied, each, strict=True))) for each in itertools.product(*tried)]
        starts += [(others, left_without, dict.fromkeys(tied, 0))]  # the smallest size
        together.append([_Start.of(blocks, [own | one for own in of], start, tied) for of, start, one in starts])
    if not sets:
        return []
    alone = np.sum([_bounds(own) for own in zip(*apart, strict=True)], axis=0).tolist()
    every, ends = _bounds([start for own in together for start in own]), np.cumsum([len(own) for own in together])
    best = [max(own) for own in np.split(every, ends[:-1])]
    return [float(one - own - more) for one, own, more in zip(best, alone, again, strict=True)]


def _bounds(starts: Sequence[_Start]) -> FloatArray:
    """How probable the same blocks' rows are at least (log), raised from some starts, (m,).

    By the noise that these leave, or that nothing does: sizes that leave much explain it by noise.
    """
    starts = [*starts, *(replace(each, left=[block.beside.rss for block in each.blocks]) for each in starts)]
    numbers = max(len(block.points) * (len(block.owner) + 1) ** 2 for start in starts for block in start.blocks)
    most = max(1, LARGEST // numbers)
    few = [starts[first : first + most] for first in range(0, len(starts), most)]
    own, none = np.split(np.concatenate([_Raised(each).bounds() for each in few]), 2)
    return np.asarray(np.maximum(own, none))


class _Raised:
    """Bounds from m starts side by side: by block inner products (m, t, k, k) and (m, t, k), and places (m, k)."""

    def __init__(self, starts: Sequence[_Start]) -> None:
        self.starts = starts
        size = max(len(start.mean) for start in starts)
        self.mean, self.deviation = np.zeros((2, len(starts), size + 1))
        for m, start in enumerate(starts):
            self.mean[m, : len(start.mean)], self.deviation[m, : len(start.mean)] = start.mean, start.deviation
        self.blocks, self.parts = starts[0].blocks, []
        for b, block in enumerate(self.blocks):
            wide = max(len(start.index[b]) for start in starts)
            gram, score = (np.zeros((len(starts), len(block.points), *(wide,) * n)) for n in (2, 1))
            index = np.full((len(starts), wide), size)
            for m, start in enumerate(starts):
                k, own = len(start.index[b]), start.blocks[b]
                gram[m, :, :k, :k], score[m, :, :k], index[m, :k] = own.gram, own.score, start.index[b]
            self.parts.append((gram.reshape(*gram.shape[:2], -1), score, index))

    def bounds(self) -> FloatArray:
        """Raise by turns: of the amplitudes with this noise, and of the noise that these amplitudes leave."""
        out, climbing = np.full(len(self.starts), -np.inf), np.arange(len(self.starts))
        left = [np.array(own) for own in zip(*(start.left for start in self.starts), strict=True)]
        noise = [block.noise_where(own) for block, own in zip(self.blocks, left, strict=True)]
        while len(climbing):
            left, cost = self._turn(climbing, [precision for _, precision in noise])
            noise = [block.noise_where(own) for block, own in zip(self.blocks, left, strict=True)]
            bound = sum(log for log, _ in noise) - cost
            climbs = bound >= out[climbing] + CLOSE
            out[climbing] = np.maximum(bound, out[climbing])
            climbing, noise = climbing[climbs], [(log[climbs], precision[climbs]) for log, precision in noise]
        return np.asarray(out + [start.log_weight for start in self.starts])

    def _turn(self, some: IntArray, noise: Sequence[FloatArray]) -> tuple[list[FloatArray], FloatArray]:
        """Return what the likeliest amplitudes leave of each block, (s, t), and what they cost (log), (s,).

        From `some` of the starts (s,), where each point of the noise of a block counts as far as told, (s, t).
        """
        mean, deviation, each = self.mean[some], self.deviation[some], np.arange(len(some))
        gram, score = np.tile(np.eye(mean.shape[1]), (len(some), 1, 1)), np.zeros(mean.shape)
        places = []
        for (inner, shown, index), precision in zip(self.parts, noise, strict=True):
            alone, pairs = (each[:, None], own := index[some]), (each[:, None, None], own[:, :, None], own[:, None])
            of_block, far = (precision[:, None] @ inner[some]).reshape(*own.shape, own.shape[1]), deviation[alone]
            gram[pairs] += of_block * (far[:, :, None] * far[:, None])
            score[alone] += far * ((precision[:, None] @ shown[some])[:, 0] - _times(of_block, mean[alone]))
            places.append((alone, pairs))
        spread = np.asarray(np.linalg.inv(gram), dtype=np.float64)
        far = _times(spread, score)
        at, apart = mean + deviation * far, spread * (deviation[:, :, None] * deviation[:, None])
        squares = at[:, :, None] * at[:, None] + apart
        left = [
            block.beside.rss
            - 2.0 * _times(shown[some], at[alone])
            + _times(inner[some], squares[pairs].reshape(len(some), -1))
            for block, (inner, shown, _), (alone, pairs) in zip(self.blocks, self.parts, places, strict=True)
        ]
        free = np.einsum("spp->s", spread) - mean.shape[1]
        return left, 0.5 * (free + np.sum(far**2, axis=1) + np.linalg.slogdet(gram)[1])


def _times(matrices: FloatArray, vectors: FloatArray) -> FloatArray:
    """Return the product of each matrix (m, a, b) with its vector (m, b)."""
    return np.asarray((matrices @ vectors[..., None])[..., 0])
