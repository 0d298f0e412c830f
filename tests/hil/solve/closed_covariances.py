"""Covariances in closed form, transcribed: what the solver's must come to."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from tests.hil.solve.closed_forms import contractor_solution


def matrix_covariance(G: ArrayLike) -> np.ndarray:
    """Return the covariance of the six parameters for white noise of 1 deg/hr in every rate; shape (..., 6, 6)."""
    g1, g2, g3 = np.moveaxis(np.asarray(G, dtype=np.float64), -1, 0)
    square = g1**2 + g3**2
    gs = (g1**2 + 3 * g3**2) / (2 * square**2)
    mu = (3 * g1**2 + g3**2) / (2 * square**2)
    bias = 0.5 + g2**2 * gs
    bias_gs = -g3 / (2 * square)  # BA with GSA; BB with GSB has the other sign
    bias_mu = -g1 / (2 * square)  # BA with MUB; BB with MUA has the other sign
    cross_gs = -g2 * gs  # BA with GSB, BB with GSA
    cross_mu = -g1 * g2 * g3 / square**2  # BA with MUA, BB with MUB
    gs_mu = g1 * g3 / square**2  # GSA with MUB, GSB with MUA
    zero = np.zeros_like(gs)
    rows = [
        [bias, zero, bias_gs, cross_gs, cross_mu, bias_mu],
        [zero, bias, cross_gs, -bias_gs, -bias_mu, cross_mu],
        [bias_gs, cross_gs, gs, zero, zero, gs_mu],
        [cross_gs, -bias_gs, zero, gs, gs_mu, zero],
        [cross_mu, -bias_mu, zero, gs_mu, mu, zero],
        [bias_mu, cross_mu, gs_mu, zero, zero, mu],
    ]
    return np.stack([np.stack(np.broadcast_arrays(*row), axis=-1) for row in rows], axis=-2)


def contractor_covariance(G: ArrayLike, covariance: ArrayLike) -> np.ndarray:
    """Propagate the covariance of the rates through (A-13)-(A-16); shape (..., 4, 4).

    `covariance` (..., 6, 6) is that of (RA1, RB1, RA2, RB2, RA3, RB3); for white noise it is sigma² times the identity.
    """
    gravity = np.asarray(G, dtype=np.float64)
    unit_rates = np.eye(6).reshape(6, 3, 2)
    # The four are linear in the rates: their response to one rate at a time is the Jacobian.
    jacobian = np.swapaxes(contractor_solution(unit_rates, gravity[..., None, :], np.zeros(3)), -1, -2)
    return np.asarray(jacobian @ np.asarray(covariance, dtype=np.float64) @ np.swapaxes(jacobian, -1, -2))
