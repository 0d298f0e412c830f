"""How large what is in a set may be: every size of its members by how probable the rows make it."""

import numpy as np

from hil.campaign import FloatArray
from hil.reconcile.search.evidence import bordered, eliminated
from hil.reconcile.search.set_in_block import SetInBlock


def over_sizes(of: SetInBlock, t: int, times: int) -> list[dict[int, int]]:
    """Return a size of every member, by place, of a set in a block, each so often as it is probable.

    That is so many `times`, at a point of the noise. Of what hardly moves the rows all sizes below what they tell are
    as probable: no value is as sure as the least of them would make it.
    """
    out: list[dict[int, int]] = [{} for _ in range(times)]
    for m, j in enumerate(of.members):
        ends = np.cumsum(np.exp(log_sizes(of, m, t)))
        shares = (np.random.default_rng(j).permutation(times) + 0.5) / times * ends[-1]
        for every, size in zip(out, np.searchsorted(ends, shares).tolist(), strict=True):
            every[j] = size
    return out


def log_sizes(of: SetInBlock, member: int, t: int) -> FloatArray:
    """Return the log probability (o,) of the sizes of a member at a point of the noise, beside the best of others.

    Of what is told by its mean, and not by its size, the best alone is.
    """
    own, here = of.options[member], [j == of.members[member] for j, _ in of.owner]
    mean, deviation = (np.repeat(each[None], len(own), axis=0) for each in of.prior())
    mean[:, here], deviation[:, here] = own.mean, own.deviation
    scale, gram, score = of.scales_left[t], of.gram[t], of.score[t]
    root, pull = deviation / np.sqrt(scale), score - mean @ gram
    squares = of.beside.rss[t] - np.sum(mean * (score + pull), axis=1)
    left, half_log_det = eliminated(bordered(gram[..., None] * (root.T[:, None] * root.T), (pull * root).T, squares))
    log = own.log_weights - half_log_det - 0.5 * left / scale
    log[np.any(own.mean != own.mean[of.best[member]], axis=1)] = -np.inf
    return np.asarray(log - np.logaddexp.reduce(log))
