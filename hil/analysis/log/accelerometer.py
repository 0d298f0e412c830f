"""Bias, scale factor and misalignment of three accelerometers from poses at rest: in each of them |f| is 1 g.

    fitted = Accelerometers(mean_g, se_g)      # (n, 3) each, or (…, n, 3): many units at once
    fitted.f_g(mean_g)                             # (n, 3): along which the acceleration reaction lies
    fitted.rows()                                  # the nine parameters with 95 % intervals

    m = S N f + b,   S = diag(s_X, s_Y, s_Z),   N = [[1, 0, 0], [a_YX, 1, 0], [a_ZX, a_ZY, 1]]

is what the accelerometers show, m; the axes are the accelerometers' own: X lies along accelerometer X, Y in the plane
of X and Y (a_YX says how far accelerometer Y leans towards X, and so on). That is the sensor model of Tedaldi, Pretto
and Menegatti (ICRA 2014), written for what is shown instead of for f, and the multi-position method of
E.-H. Shin and N. El-Sheimy ("A new calibration method for strapdown inertial navigation systems", Z. Verm. 127, 2002).
How the frame as a whole lies in the unit, no |f| tells: nine parameters are all that there are.

Gauss and Newton's method on |N⁻¹ S⁻¹ (m − b)| − 1, weighted by the standard errors of the means. With u along f and
v = (S N)⁻ᵀ u its derivative by an entry (j, k) of S N is −v_j f_k, by b_j −v_j. A prior of 0 ± 0.1 (g, rad, of the
scale factor's departure from 1) is far wider than any accelerometer is off: it leaves alone what the poses tell, and
what they do not tell stays at it, and is said.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.special import chdtrc, stdtrit

from hil.campaign import FloatArray

NAMES = ("b_X", "b_Y", "b_Z", "s_X", "s_Y", "s_Z", "a_YX", "a_ZX", "a_ZY")
"""The nine parameters, in the order of all arrays."""

_UNITS = ("g",) * 3 + ("1",) * 3 + ("rad",) * 3
_LEANS = ((1, 0), (2, 0), (2, 1))
PRIOR = 0.1
TOLD = 0.5  # of the prior: what is known no better is not told by the poses
_ITERATIONS, _CONVERGED = 60, 1e-12
_IMPROBABLE = 0.01
_CERTAIN = 1e6  # degrees of freedom of who knows the noise
LEVEL = 0.975


class Accelerometers:
    """Nine parameters `values` (…, 9), their `covariance` (…, 9, 9), and the residuals |f| − 1, g, of the poses (…, n).

    They are fitted to the means (…, n, 3) of n poses at rest with their standard errors, both in g. `inflation` (…) is
    by how much standard errors of the poses were enlarged because |f| scatters beyond them, 1 where it does not;
    `freedom` (…) is how many residuals are left. `sd` (…, 9) is one standard deviation, `half_width` (…, 9) half the
    95 % interval: Student's where the residuals themselves told the noise.
    """

    def __init__(self, mean_g: FloatArray, se_g: FloatArray) -> None:
        sigma = np.maximum(se_g, np.finfo(float).eps)
        start = np.zeros((*mean_g.shape[:-2], len(NAMES)))
        start[..., 3:6] = 1.0
        found = _fitted(mean_g, sigma, start)
        freedom, chi_square = np.maximum(mean_g.shape[-2] - found[-1], 0.0), found[-2]
        # Noise that was stated too small shows in |f|: enlarged, once, and what the prior holds is weighed anew.
        poor = (freedom >= TOLD) & (chdtrc(np.maximum(freedom, 1.0), chi_square) < _IMPROBABLE)
        self.inflation = np.where(poor, np.sqrt(chi_square / np.maximum(freedom, 1.0)), 1.0)
        if poor.any():
            found = _fitted(mean_g, sigma * self.inflation[..., None, None], found[0])
        self.values, self.covariance, self.residuals_g, _, told = found
        self.freedom = np.maximum(mean_g.shape[-2] - told, 0.0)
        self.sd = np.sqrt(np.diagonal(self.covariance, axis1=-2, axis2=-1))
        known = np.where(self.inflation > 1.0, np.maximum(self.freedom, 1.0), _CERTAIN)
        self.half_width = self.sd * stdtrit(known, LEVEL)[..., None]

    def f_g(self, mean_g: FloatArray) -> FloatArray:
        """Return f, g, of what the accelerometers show, both (…, n, 3); of what length it comes out."""
        return _f(self.values, mean_g)

    def rows(self) -> dict[str, dict[str, Any]]:
        """Return the parameters of one unit by their names, with units, intervals, and whether the poses tell them."""
        return parameters_told(NAMES, self.values, self.sd, self.half_width, _UNITS)


def parameters_told(
    names: Sequence[str], values: FloatArray, sd: FloatArray, half: FloatArray, units: Sequence[str]
) -> dict[str, dict[str, Any]]:
    """Return parameters (p,) by their names, with half of their 95 % intervals (p,), and whether the poses tell them.

    Told is what is known better than the prior alone says.
    """
    return {
        name: {
            "value": float(values[p]),
            "sd": float(sd[p]),
            "low": float(values[p] - half[p]),
            "high": float(values[p] + half[p]),
            "unit": units[p],
            "told": bool(sd[p] <= TOLD * PRIOR),
        }
        for p, name in enumerate(names)
    }


def _fitted(
    mean_g: FloatArray, sigma_g: FloatArray, values: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return values, covariance, residuals, their sum of squares in standard errors, how many parameters are told."""
    nominal = np.array([0.0] * 3 + [1.0] * 3 + [0.0] * 3)
    prior = np.eye(len(NAMES)) / PRIOR**2
    for _ in range(_ITERATIONS):
        f, matrix = _f(values, mean_g), _matrix(values)
        size = np.linalg.norm(f, axis=-1)
        v = np.swapaxes(np.linalg.solve(np.swapaxes(matrix, -1, -2), np.swapaxes(f / size[..., None], -1, -2)), -1, -2)
        weight = 1.0 / np.sum(np.square(v * sigma_g), axis=-1)
        scale = values[..., None, 3:6]
        # By the scale factors, S N f without S; by the leans, s_j f_k.
        shown = np.einsum("...jk,...nk->...nj", matrix, f) / scale
        leans = [v[..., j] * scale[..., j] * f[..., k] for j, k in _LEANS]
        slopes = -np.concatenate([v, v * shown, np.stack(leans, -1)], axis=-1)
        information = np.einsum("...np,...n,...nq->...pq", slopes, weight, slopes)
        covariance = np.linalg.inv(information + prior)
        pull = np.einsum("...np,...n,...n->...p", slopes, weight, 1.0 - size) + (nominal - values) @ prior
        step = np.einsum("...pq,...q->...p", covariance, pull)
        values = values + step
        if np.abs(step).max(initial=0.0) < _CONVERGED:
            break
    residuals = np.linalg.norm(_f(values, mean_g), axis=-1) - 1.0
    told = np.einsum("...pq,...qp->...", covariance, information)
    return values, covariance, residuals, np.sum(weight * residuals**2, axis=-1), told


def _matrix(values: FloatArray) -> FloatArray:
    """Return S N, (…, 3, 3)."""
    matrix = np.zeros((*values.shape[:-1], 3, 3)) + np.eye(3)
    for p, (j, k) in enumerate(_LEANS):
        matrix[..., j, k] = values[..., 6 + p]
    return np.asarray(matrix * values[..., 3:6, None])


def _f(values: FloatArray, mean_g: FloatArray) -> FloatArray:
    matrix = _matrix(values)
    return np.asarray(np.swapaxes(np.linalg.solve(matrix, np.swapaxes(mean_g - values[..., None, :3], -1, -2)), -1, -2))
