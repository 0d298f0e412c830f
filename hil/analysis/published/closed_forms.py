"""The report's closed forms for the three collects of sensor 2 that the solver has not.

`rates` has shape (..., 3, 2): Collects 1, 2, 3 by (RA, RB), deg/hr. `G` (..., 3) and `W` (..., 3) are (G1, G2, G3) in g
and (W1, W2, W3) in deg/hr along the bench axes 1-2-3. Other shapes raise `ValueError`.

Misprints in RD-GC-86-1; the corrected form is followed here:

- eqs. (7)-(10): "+ 2" is a lost division, "/ 2"; as printed they do not even have one dimension;
- eq. (7): its last term, -W1, is right only once the division is restored;
- the matrix equation, row 6 of the left-hand side: RA_2(C3) - W_2 stands for RB_2(C3) - W_2 (C6 has it right);
- the matrix equation, row 6 of the unknowns: MU_SA2 stands for GSB_2;
- the text gives only the G1 term of the contractor's error; `contractor_error` has the G3 terms too.
"""

import numpy as np
from numpy.typing import ArrayLike

from hil.campaign import FloatArray


def contractor_error(G: ArrayLike, mua: ArrayLike, mub: ArrayLike) -> FloatArray:
    """Return contractor's minus true BA, BB, GSA, GSB where MU is not zero; shape (..., 4).

    Exact: BA by MUB (G1 + G3²/G1) + MUA G2 G3/G1, BB by -MUA (G1 + G3²/G1) + MUB G2 G3/G1, GSA by -MUB G3/G1, GSB by
    -MUA G3/G1. With G3 = 0 that is the report's statement, the bias off by MUB G1 and -MUA G1.
    Raises `ValueError` where `G` is not (..., 3).
    """
    g1, g2, g3 = parts(G)
    a, b = np.asarray(mua, dtype=np.float64), np.asarray(mub, dtype=np.float64)
    long, short = g1 + g3**2 / g1, g2 * g3 / g1
    return stacked(b * long + a * short, -a * long + b * short, -b * g3 / g1, -a * g3 / g1)


def seven_biases(
    rates: ArrayLike, G: ArrayLike, W: ArrayLike, gsa: ArrayLike, gsb: ArrayLike, mub: ArrayLike
) -> FloatArray:
    """Return the bias BA seven ways, eqs. (A-27)-(A-33), for given GSA, GSB, MUB; shape (..., 7).

    With the true parameters and no noise they are BA + {0, MUB G3, -MUB G3, MUB G1, 0, 0, 0}.
    Raises `ValueError` for other shapes.
    """
    (ra1, ra2, ra3), _ = by_channel(rates)
    (g1, g2, g3), (w1, _, w3) = parts(G), parts(W)
    a, b, m = (np.asarray(value, dtype=np.float64) for value in (gsa, gsb, mub))
    from_1 = ra1 + a * g1 - b * g2 + w1
    from_2 = ra2 - a * g1 - b * g2 - w1
    from_3 = ra3 - a * g3 - b * g2 - w3  # the contractor's
    mean = (ra1 + ra2) / 2 - b * g2  # the matrix solution
    return stacked(mean, from_1, from_2, from_3, from_1 - m * g3, from_2 + m * g3, from_3 - m * g1)


def by_channel(rates: ArrayLike) -> FloatArray:
    """Return [channel][collect] with the batch behind, from (..., 3, 2); raise `ValueError` for another shape."""
    array = np.asarray(rates, dtype=np.float64)
    if array.shape[-2:] != (3, 2):
        raise ValueError(f"rates {array.shape}: three collects by two channels, (..., 3, 2), are needed")
    return np.moveaxis(array, (-1, -2), (0, 1))


def parts(vector: ArrayLike) -> FloatArray:
    """Return [component] with the batch behind, from (..., 3); raise `ValueError` for another shape."""
    array = np.asarray(vector, dtype=np.float64)
    if array.shape[-1:] != (3,):
        raise ValueError(f"{array.shape}: three components, (..., 3), are needed")
    return np.moveaxis(array, -1, 0)


def stacked(*parts: FloatArray) -> FloatArray:
    """Return parts (...) of one batch as (..., p)."""
    return np.stack(np.broadcast_arrays(*parts), axis=-1)
