"""What is random about a simulated unit, drawn so that the same seed gives the same bytes however it is polled.

Every kind of noise has its own stream of the seed. White noise is drawn once per sample and slow noise once per grid
point, both in time order; run-to-run scatter is drawn by the number of the self-calibration, not by when it is asked.
"""

from __future__ import annotations

import numpy as np

from hil.campaign import FloatArray
from hil.model.stated_noise import SensorNoise
from hil.twin.thermal import GRID_S

_WHITE, _SLOW, _RUNS, _WANDER = 0, 1, 2, 3
_FLICKER_LAGS_S = np.array([10.0, 100.0, 1000.0, 10000.0])
# Gauss-Markov processes a decade apart, of this standard deviation per unit of bias instability B, have an Allan
# deviation within 5 % of 0.664 B between 20 s and 4 h.
_FLICKER_SIGMA = 0.885


def _generator(seed: int, *key: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


class WhiteNoise:
    """Standard normal numbers, one row per sample, in the order of the samples."""

    def __init__(self, seed: int, session: int, columns: int) -> None:
        self._generator = _generator(seed, _WHITE, session)
        self._columns = columns

    def draw(self, samples: int) -> FloatArray:
        """Return the next rows, shape (samples, columns)."""
        return self._generator.standard_normal((samples, self._columns))


class SlowNoise:
    """Rate random walk and bias instability of `channels` channels, deg/hr, on the grid."""

    def __init__(self, seed: int, session: int, sensor: int, channels: int) -> None:
        self._generator = _generator(seed, _SLOW, session, sensor)
        self._channels = channels
        self._walk = np.zeros((1, channels))
        self._flicker = np.zeros((len(_FLICKER_LAGS_S), channels))

    def advance(self, walk: FloatArray, instability: FloatArray) -> FloatArray:
        """Return the next m grid points, shape (m, channels).

        `walk` (m,) is the rate random walk K in deg/hr/sqrt(hr), `instability` (m,) the bias instability B in deg/hr.
        """
        keep = np.exp(-GRID_S / _FLICKER_LAGS_S)[:, None]
        drawn = self._generator.standard_normal((len(walk), 1 + len(_FLICKER_LAGS_S), self._channels))
        steps = walk[:, None] * np.sqrt(GRID_S / 3600.0) * drawn[:, 0]
        # Accumulated from the last value on, in order, so that the sum does not depend on where it was interrupted.
        walked = np.add.accumulate(np.concatenate([self._walk, steps]), axis=0)[1:]
        self._walk = walked[-1:] if len(walked) else self._walk
        flicker = np.empty((len(walk), self._channels))
        for row, size in enumerate(_FLICKER_SIGMA * instability):
            self._flicker = keep * self._flicker + np.sqrt(1.0 - keep**2) * drawn[row, 1:]
            flicker[row] = size * self._flicker.sum(axis=0)
        return walked + flicker


class Wander:
    """A quantity that wanders about its nominal value with a standard deviation and a correlation time."""

    def __init__(self, seed: int, session: int, sigma: float, lag_s: float) -> None:
        self._generator = _generator(seed, _WANDER, session)
        self._keep = float(np.exp(-GRID_S / lag_s))
        self._kick = sigma * float(np.sqrt(1.0 - self._keep**2))
        self._value = 0.0

    def advance(self, points: int) -> FloatArray:
        """Return the next grid points, shape (points,), as departures from the nominal value."""
        values = np.empty(points)
        for row, drawn in enumerate(self._generator.standard_normal(points).tolist()):
            self._value = self._keep * self._value + self._kick * drawn
            values[row] = self._value
        return values


def run_scatter(seed: int, run: int, sensor: int, noise: SensorNoise, temperature_degC: float) -> dict[str, float]:
    """Return by how much each base parameter of a sensor differs in self-calibration `run` from the model's value."""
    names = sorted(noise.run_to_run)
    at = np.array([temperature_degC])
    sigmas = np.array([float(noise.run_to_run[name].at(at)[0]) for name in names])
    standard = _generator(seed, _RUNS, run, sensor).standard_normal(len(names))
    drawn = sigmas * (noise.correlation_factor() @ standard)
    return dict(zip(names, drawn.tolist(), strict=True))
