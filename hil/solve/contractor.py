"""The contractor's four parameters from a run of collects: GS from Collects 1 and 2, bias from Collect 3.

Eqs. (A-13)-(A-16) of RD-GC-86-1 take MU as zero, let the mean of Collects 1 and 2 go unused, and so use six rates for
four numbers. That is least squares in which Collects 1 and 2 have a bias of their own: this module says it so, and then
the collects may be repeated, come in any order and have measured f. What the two biases differ by is the residual of
the contractor's model, -MUB G1 and +MUA G1 where the sensor has MU.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hil.campaign import Collects, FloatArray, IntArray
from hil.model.forms import collins_4_form
from hil.solve.least_squares import Solution, solve

METHOD = "GS from Collects 1 and 2, bias from Collect 3, MU taken as zero: eqs. (A-13)-(A-16)"


def report_collects(f_g: FloatArray) -> IntArray:
    """Recognise the report's orientations by f (n, 3): 1 with A down, 2 with A up, 3 with S up, 0 for any other.

    Labels play no part: what an orientation is called says less than where gravity points.
    """
    direction = f_g / np.linalg.norm(f_g, axis=-1, keepdims=True)
    a, s = direction[:, 0], direction[:, 2]
    return np.select([a < -0.9, a > 0.9, s > 0.9], [1, 2, 3], 0).astype(np.int64)


def can_follow(collects: Collects) -> bool:
    """Tell whether these collects hold the report's three orientations, each with both rates measured."""
    return {1, 2, 3} <= set(report_collects(collects.conditions.f_g)[_measured(collects)].tolist())


def solve_as_contractor(collects: Collects, sigma: FloatArray | None) -> Solution:
    """Follow (A-13)-(A-16); `sigma` (n, 2) is the noise of the rates, or None where it is not stated.

    The solution has BA, BB, GSA, GSB and the residuals that these leave of the used rates; `chi_square` on
    `degrees_of_freedom` tests the four-parameter model against stated noise.
    """
    used = _measured(collects) & (report_collects(collects.conditions.f_g) > 0)
    chosen = collects.rows(used)
    conditions = chosen.conditions
    form = collins_4_form(conditions.sensor)
    columns = form.columns(conditions)
    early = report_collects(conditions.f_g) < 3
    own_bias = columns[..., :2] * early[:, None, None]
    late_bias = columns[..., :2] * ~early[:, None, None]
    design = np.concatenate([late_bias, columns[..., 2:], own_bias], -1).reshape(-1, 6)
    observed = (chosen.rates_deg_per_hr - conditions.w_channels_deg_per_hr).reshape(-1)
    full = solve(design, observed, np.ones(len(observed)) if sigma is None else sigma[used].reshape(-1))
    contrast = np.array([[-1.0, 0, 0, 0, 1, 0], [0, -1.0, 0, 0, 0, 1]])
    gap = contrast @ full.values
    chi_square = float(full.chi_square + gap @ np.linalg.solve(contrast @ full.covariance @ contrast.T, gap))
    degrees = len(observed) - 4
    return replace(
        full,
        names=form.names,
        values=full.values[:4],
        covariance=full.covariance[:4, :4] * (1.0 if sigma is not None else chi_square / degrees),
        residuals=(observed.reshape(-1, 2) - columns @ full.values[:4]).reshape(-1),
        chi_square=np.asarray(chi_square),
        rank=full.rank - 2,
        degrees_of_freedom=np.asarray(degrees),
    )


def _measured(collects: Collects) -> NDArray[np.bool_]:
    """Mark the collects in which every channel was measured, shape (n,)."""
    return np.asarray(~np.any(np.isnan(collects.rates_deg_per_hr), axis=-1))
