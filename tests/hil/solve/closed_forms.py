"""The report's closed forms for the three collects of sensor 2, transcribed: what the solver must reproduce.

`rates` has shape (..., 3, 2): Collects 1, 2, 3 by (RA, RB), deg/hr. `G` (..., 3) and `W` (..., 3) are (G1, G2, G3) in g
and (W1, W2, W3) in deg/hr along the bench axes 1-2-3. Of the misprints in RD-GC-86-1 the corrected form is followed, as
`hil.analysis.published.reproduction` says.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike


def matrix_solution(rates: ArrayLike, G: ArrayLike, W: ArrayLike) -> np.ndarray:
    """Solve for the six parameters by eqs. (11), (12), (A-23)-(A-26); shape (..., 6), deg/hr and deg/hr/g.

    (A-21), (A-22) are (11), (12) again; (A-17), (A-18) are (A-23), (A-24).
    """
    (ra1, ra2, ra3), (rb1, rb2, rb3) = by_channel(rates)
    (g1, g2, g3), (w1, w2, w3) = parts(G), parts(W)
    square = g1**2 + g3**2
    mua = ((rb1 + rb2 - 2 * rb3) * g1 + (rb2 - rb1) * g3) / (2 * square)  # (11)
    mub = ((2 * ra3 - ra1 - ra2 - 2 * w3) * g1 + (ra1 - ra2 + 2 * w1) * g3) / (2 * square)  # (12)
    gsa = (ra2 - ra1 - 2 * w1) / (2 * g1) + mub * g3 / g1
    gsb = (rb1 - rb2) / (2 * g1) + mua * g3 / g1
    ba = (ra1 + ra2) / 2 - gsb * g2
    bb = (rb1 + rb2 - 2 * w2) / 2 - gsa * g2
    return stacked(ba, bb, gsa, gsb, mua, mub)


def contractor_solution(rates: ArrayLike, G: ArrayLike, W: ArrayLike) -> np.ndarray:
    """Solve for BA, BB, GSA, GSB as the contractor did, MU taken as zero: eqs. (A-13)-(A-16); shape (..., 4)."""
    (ra1, ra2, ra3), (rb1, rb2, rb3) = by_channel(rates)
    (g1, g2, g3), (w1, w2, w3) = parts(G), parts(W)
    gsa = (ra2 - ra1 - 2 * w1) / (2 * g1)
    gsb = (rb1 - rb2) / (2 * g1)
    ba = ra3 - gsa * g3 - gsb * g2 - w3
    bb = rb3 - gsa * g2 + gsb * g3 - w2
    return stacked(ba, bb, gsa, gsb)


def by_channel(rates: ArrayLike) -> np.ndarray:
    """Return [channel][collect] with the batch behind, from (..., 3, 2)."""
    return np.moveaxis(np.asarray(rates, dtype=np.float64), (-1, -2), (0, 1))


def parts(vector: ArrayLike) -> np.ndarray:
    """Return [component] with the batch behind, from (..., 3)."""
    return np.moveaxis(np.asarray(vector, dtype=np.float64), -1, 0)


def stacked(*those: np.ndarray) -> np.ndarray:
    """Return parts (...) of one batch as (..., p)."""
    return np.stack(np.broadcast_arrays(*those), axis=-1)
