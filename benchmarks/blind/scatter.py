"""The hidden effects that move no average but scatter them: their covariance, written anew, and a draw from it.

A covariance is (2n, 2n), the rows of RA over those of RB, at unit size. The numbers that a fitted form would hold fixed
(correlation times, where frost sits, the band of flicker) are the unit's own.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.special import sici

from benchmarks.blind.night import Night

_HOUR_S = 3600.0
MARKOV_HOURS = (0.3, 0.5, 1.0, 2.0, 3.0, 8.0, 10.0, 30.0, 40.0, 60.0)
"""Correlation times that are asked for; a unit's own lies within a fifth of them."""

Scatter = Callable[[Night, np.random.Generator], np.ndarray]


def _channels(between: np.ndarray) -> np.ndarray:
    """The same on both channels, independently."""
    return np.asarray(np.kron(np.eye(2), between))


def _middle_s(n: Night) -> np.ndarray:
    return np.asarray(n.start_s + 0.5 * n.design.collect_s)


def _lag_s(n: Night) -> np.ndarray:
    return np.abs(_middle_s(n)[:, None] - _middle_s(n)[None, :])


def _same_run(n: Night) -> np.ndarray:
    return np.equal.outer(n.run, n.run).astype(float)


def _mu_rr(n: Night, _r: np.random.Generator) -> np.ndarray:
    """MUA and MUB anew in each run; RA has +MUB f_S, RB −MUA f_S."""
    spin = n.f[:, 2]
    return _channels(_same_run(n) * np.outer(spin, spin))


def _gs_rr(n: Night, _r: np.random.Generator) -> np.ndarray:
    """GSA and GSB anew in each run; RA has GSA f_A + GSB f_B, RB GSA f_B − GSB f_A."""
    a, b = n.f[:, 0], n.f[:, 1]
    seen = np.stack([np.concatenate([a, b]), np.concatenate([b, -a])], 1)
    return np.asarray((seen @ seen.T) * np.kron(np.ones((2, 2)), _same_run(n)))


def _rrw(n: Night, _r: np.random.Generator) -> np.ndarray:
    hours = (_middle_s(n) - _middle_s(n)[0]) / _HOUR_S
    return _channels(np.minimum(hours[:, None], hours[None, :]))


def _markov(hours: float) -> Scatter:
    def wanders(n: Night, r: np.random.Generator) -> np.ndarray:
        return _channels(np.exp(-_lag_s(n) / (_HOUR_S * hours * r.uniform(0.8, 1.2))))

    return wanders


def _turnon(n: Night, _r: np.random.Generator) -> np.ndarray:
    """One bias for each time that the supply came on."""
    on = np.round(n.start_s - n.since_power_s)
    return _channels(np.equal.outer(on, on).astype(float))


def _hash(n: Night, _r: np.random.Generator) -> np.ndarray:
    """White, and the stronger the colder below 5 °C."""
    cold = np.maximum(5.0 - n.rotor, 0.0) / 30.0
    return _channels(np.diag(cold**2))


def _frost(n: Night, r: np.random.Generator) -> np.ndarray:
    """An offset of each run near the melting point."""
    near = np.exp(-0.5 * ((n.rotor - r.uniform(-2.0, 2.0)) / r.uniform(4.0, 6.0)) ** 2)
    return _channels(_same_run(n) * np.outer(near, near))


def _flicker(n: Night, r: np.random.Generator) -> np.ndarray:
    """1/f between four times the night's length and twice a collect's: the cosine integral of the lag."""
    low, high = 0.25 / (np.ptp(n.start_s) + n.design.collect_s), r.uniform(0.3, 0.7) / n.design.collect_s
    turn = 2.0 * np.pi * np.maximum(_lag_s(n), 1e-9)
    return _channels(sici(high * turn)[1] - sici(low * turn)[1])


def _base(n: Night, r: np.random.Generator) -> np.ndarray:
    """The pier turns slowly about the bench's axes; each channel sees what its axis has of it."""
    s, c = np.sin(n.theta), np.cos(n.theta)
    zero, one = np.zeros_like(s), np.ones_like(s)
    seen = np.vstack([np.stack([s, zero, c], 1), np.stack([zero, one, zero], 1)])
    slow = np.exp(-_lag_s(n) / r.uniform(900.0, 3600.0))
    return np.asarray((seen @ seen.T) * np.kron(np.ones((2, 2)), slow))


SCATTER: dict[str, Scatter] = {
    "MU_rr": _mu_rr,
    "GS_rr": _gs_rr,
    "rrw": _rrw,
    "turnon": _turnon,
    "hash": _hash,
    "frost": _frost,
    "flicker": _flicker,
    "base": _base,
    **{f"markov@{hours:g} h": _markov(hours) for hours in MARKOV_HOURS},
}
"""Effects on the scatter; the name that is right stands before the @."""


def left_by(base: np.ndarray, covariance: np.ndarray) -> float:
    """Mean variance per degree of freedom that least squares with a base (2n, p) leaves of a covariance (2n, 2n)."""
    q, _ = np.linalg.qr(base)
    return float((np.trace(covariance) - np.sum(q * (covariance @ q))) / (len(base) - q.shape[1]))


def drawn(covariance: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A draw (n, 2) from a covariance (2n, 2n), which may have no inverse."""
    ridge = 1e-9 * np.trace(covariance) / len(covariance)
    factor = np.linalg.cholesky(covariance + ridge * np.eye(len(covariance)))
    return np.asarray((factor @ rng.standard_normal(len(covariance))).reshape(2, -1).T)
